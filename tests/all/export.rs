//! Exported files, opened by programs that are not ours: Khronos' glTF validator and trimesh.

#![expect(
    clippy::unwrap_used,
    reason = "a test fails by panicking, its helpers included"
)]
#![expect(clippy::print_stderr, reason = "a skipped test must be seen")]

use std::path::{Path, PathBuf};
use std::process::Command;

use serde_json::{Value, json};
use veneer::export::{ExportParams, NormalMode, PageFormat, TexturedMesh, hashes, write_all};
use veneer::mesh::{TriMesh, TriangleId};

use crate::python;
use crate::textured_room::{PAGE, Room};

/// Pinned, so that a new release cannot change what passes.
const VALIDATOR: &str = "gltf-validator@2.0.0-dev.3.10";

const VALIDATE_JS: &str = r#"
const fs = require("fs");
const validator = require("gltf-validator");
validator
  .validateBytes(new Uint8Array(fs.readFileSync(process.argv[2])), { maxIssues: 100 })
  .then((report) => console.log(JSON.stringify(report)))
  .catch((error) => { console.error(String(error)); process.exit(1); });
"#;

fn npm_folder() -> Option<PathBuf> {
    let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join("gltf-validator");
    std::fs::create_dir_all(&folder).unwrap();
    std::fs::write(folder.join("validate.js"), VALIDATE_JS).unwrap();
    if folder
        .join("node_modules/gltf-validator/package.json")
        .exists()
    {
        return Some(folder);
    }
    let installed = Command::new("npm")
        .args([
            "install",
            "--no-save",
            "--no-audit",
            "--no-fund",
            "--prefix",
        ])
        .arg(&folder)
        .arg(VALIDATOR)
        .output();
    match installed {
        Ok(output) if output.status.success() => Some(folder),
        Ok(output) => {
            let reason = String::from_utf8_lossy(&output.stderr).into_owned();
            eprintln!("SKIPPED: npm cannot install {VALIDATOR}: {reason}");
            None
        }
        Err(error) => {
            eprintln!("SKIPPED: no npm: {error}");
            None
        }
    }
}

fn validate(npm: &Path, glb: &Path) -> Value {
    let output = Command::new("node")
        .arg(npm.join("validate.js"))
        .arg(glb)
        .output()
        .unwrap();
    assert!(
        output.status.success(),
        "{}",
        String::from_utf8_lossy(&output.stderr)
    );
    serde_json::from_slice(&output.stdout).unwrap()
}

fn export(room: &Room, out: &Path, params: &ExportParams) {
    let textured = TexturedMesh::new(&room.mesh, &room.layout, &room.texture).unwrap();
    write_all(&textured, out, params).unwrap();
}

#[test]
fn glb_passes_the_khronos_validator() {
    let Some(npm) = npm_folder() else { return };
    let mut room = Room::new();
    let folder = tempfile::tempdir().unwrap();
    let check = |name: &str, room: &Room, params: ExportParams| {
        let out = folder.path().join(name);
        export(room, &out, &params);
        let report = validate(&npm, &out.join("scan.glb"));
        let issues = &report["issues"];
        assert_eq!(issues["numErrors"], 0, "{name}: {issues:#}");
        assert_eq!(issues["numWarnings"], 0, "{name}: {issues:#}");
        assert_eq!(report["info"]["drawCallCount"], 2, "{name}");
        assert_eq!(
            report["info"]["totalTriangleCount"],
            room.mesh.num_triangles(),
            "{name}"
        );
    };
    check("smooth", &room, ExportParams::default());
    let flat_jpeg = ExportParams {
        normals: NormalMode::Flat,
        glb_pages: PageFormat::Jpeg { quality: 85 },
        ..ExportParams::default()
    };
    check("flat", &room, flat_jpeg);
    // Coordinates of a surveyed site, and triangles without area.
    let far = room.mesh.positions_m().iter().map(|p| {
        let mut p = *p;
        p.x += 448_262.0;
        p.y += 5_411_932.0;
        p
    });
    let mut triangles = room.mesh.triangles().to_vec();
    triangles[0] = [0, 0, 1];
    triangles[1] = [5, 5, 5];
    room.mesh = TriMesh::from_soup(far.collect(), triangles).unwrap().0;
    check("far", &room, ExportParams::default());
}

#[test]
fn trimesh_sees_the_texture_in_every_format() {
    let Some(python) = python::venv("trimesh", &["trimesh==5.2.0", "pillow", "numpy"]) else {
        return;
    };
    let room = Room::new();
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path();
    export(&room, out, &ExportParams::default());
    let samples: Vec<Value> = room
        .mesh
        .triangle_ids()
        .step_by(37)
        .map(|triangle| sample(&room, triangle))
        .collect();
    let on_last_page: Vec<&Value> = samples.iter().filter(|s| s["page"] == 1).collect();
    let write = |name: &str, value: &Value| {
        std::fs::write(out.join(name), value.to_string()).unwrap();
        out.join(name)
    };
    let all = write("samples.json", &json!(samples));
    // trimesh opens one picture of a PLY, the last that is named.
    let last = write("samples_last.json", &json!(on_last_page));
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/all/check_textured.py");
    for (file, samples, up, num_parts) in [
        ("scan.glb", &all, "y-up", 2),
        ("scan.obj", &all, "z-up", 2),
        ("scan.ply", &last, "z-up", 1),
    ] {
        let output = Command::new(&python)
            .arg(&script)
            .arg(out.join(file))
            .arg(samples)
            .arg(up)
            .output()
            .unwrap();
        let errors = String::from_utf8_lossy(&output.stderr);
        assert!(output.status.success(), "{file}: {errors}");
        let seen: Value = serde_json::from_slice(&output.stdout).unwrap();
        assert_eq!(seen["num_parts"], num_parts, "{file}: {seen}");
        assert_eq!(seen["num_faces"], room.mesh.num_triangles(), "{file}");
        assert_eq!(seen["sizes"], json!(vec![PAGE; num_parts]), "{file}");
        let number = |key: &str| seen[key].as_f64().unwrap();
        assert!(
            number("uv_min") >= 0.0 && number("uv_max") <= 1.0,
            "{file}: {seen}"
        );
        assert!(number("worst_distance_m") < 1e-5, "{file}: {seen}");
        // The texel at the middle is within half a texel of it: edges of the pattern differ.
        assert!(number("share_within_8") > 0.97, "{file}: {seen}");
        assert!(number("mean_difference") < 2.0, "{file}: {seen}");
    }
}

fn sample(room: &Room, triangle: TriangleId) -> Value {
    let [a, b, c] = room.mesh.corners_m(triangle);
    let middle = (a.coords + b.coords + c.coords) / 3.0;
    json!({
        "position": [middle.x, middle.y, middle.z],
        "srgb": room.srgb_at_centroid(triangle),
        "page": room.layout.page_of(triangle),
    })
}

#[test]
fn sha256sum_agrees_with_the_list() {
    let room = Room::new();
    let folder = tempfile::tempdir().unwrap();
    let textured = TexturedMesh::new(&room.mesh, &room.layout, &room.texture).unwrap();
    let summary = write_all(&textured, folder.path(), &ExportParams::default()).unwrap();
    hashes::write(folder.path(), &summary.files, &[]).unwrap();
    let Ok(output) = Command::new("sha256sum")
        .args(["-c", "--strict", hashes::FILE_NAME])
        .current_dir(folder.path())
        .output()
    else {
        eprintln!("SKIPPED: no sha256sum");
        return;
    };
    let checked = String::from_utf8_lossy(&output.stdout);
    assert!(output.status.success(), "{checked}");
    assert_eq!(checked.lines().count(), summary.files.len());
}
