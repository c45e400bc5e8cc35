//! `veneer eval` as a person would run it, and textured meshes of other programs read back.

use std::path::{Path, PathBuf};

use proptest::prelude::*;
use serde_json::Value;
use veneer::export::{ExportParams, TexturedMesh, write_all};
use veneer::geom::{PinholeCamera, RigidTransform};
use veneer::import::model;
use veneer::render::{
    RasterWorkspace, RenderParams, ViewBuffer, rasterize, render_model, render_textured,
};

use crate::command::{said, small_tabletop, veneer, veneer_ok};
use crate::textured_room::Room;

/// LPIPS weights beside the checkout; says so aloud where they are not there.
fn lpips_weights() -> Option<PathBuf> {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../shared/lpips/lpips_alex.safetensors");
    if path.is_file() {
        return Some(path);
    }
    eprintln!("SKIPPED: no LPIPS weights at ../shared/lpips");
    None
}

fn number(value: &Value) -> f64 {
    value
        .as_f64()
        .unwrap_or_else(|| panic!("{value} is no number"))
}

#[test]
fn a_small_recording_is_evaluated() {
    let dir = tempfile::tempdir().unwrap();
    let bag = dir.path().join("tabletop.mcap");
    let mut args = vec!["--quiet", "synth", "tabletop", "-o", bag.to_str().unwrap()];
    args.extend(["--frames", "24", "--width", "240", "--height", "180"]);
    args.extend(["--edge-length-m", "0.04"]);
    veneer_ok(&args);
    let made = dir.path().join("made");
    let args = ["--quiet", "replay", bag.to_str().unwrap(), "--out"];
    veneer_ok(&[&args[..], &[made.to_str().unwrap()]].concat());

    let out = dir.path().join("eval");
    // A mesh that was painted with the held-out photos, too.
    let theirs = format!("theirs={}", made.join("scan.obj").display());
    let methods = format!("t-only,l2avg,every-3,t-only-noise,{theirs}");
    let mut args = vec!["--quiet", "eval", bag.to_str().unwrap()];
    args.extend(["--out", out.to_str().unwrap(), "--methods", &methods]);
    args.extend(["--hold-out", "6", "--json", "--textures"]);
    let weights = lpips_weights();
    if let Some(weights) = &weights {
        args.extend(["--lpips-weights", weights.to_str().unwrap()]);
    }
    let printed = veneer_ok(&args);
    let report: Value = serde_json::from_str(&printed).unwrap();
    let written = std::fs::read_to_string(out.join("eval.json")).unwrap();
    assert_eq!(serde_json::from_str::<Value>(&written).unwrap(), report);

    let methods = report["methods"].as_array().unwrap();
    let of = |name: &str| methods.iter().find(|m| m["method"] == name).unwrap();
    let names: Vec<&str> = methods
        .iter()
        .map(|m| m["method"].as_str().unwrap())
        .collect();
    assert_eq!(
        names,
        ["t-only", "l2avg", "every-3", "t-only-noise", "theirs"]
    );
    let views = report["views"].as_array().unwrap();
    let num_training = report["num_training_views"].as_u64().unwrap();
    let num_keyframes = usize::try_from(num_training).unwrap() + views.len();
    assert_eq!(views.len(), num_keyframes.div_ceil(6));
    assert_eq!(of("t-only")["num_views"], num_training);
    assert_eq!(of("every-3")["num_views"], num_training.div_ceil(3));
    assert_eq!(of("theirs")["num_views"], Value::Null);
    for method in methods {
        for measure in [
            "ssim",
            "s3",
            "grad",
            "psnr",
            "coverage",
            "ssim_uniform",
            "s3_whole",
        ] {
            assert!(number(&method[measure]) > 0.0, "{measure} of {method}");
        }
        assert_eq!(method["lpips"].is_number(), weights.is_some());
        // Each mean is that of its views.
        let at = names
            .iter()
            .position(|name| *name == method["method"])
            .unwrap();
        let sum: f64 = views.iter().map(|v| number(&v["scores"][at]["ssim"])).sum();
        let mean = sum / views.len() as f64;
        assert!((mean - number(&method["ssim"])).abs() < 1e-12);
    }
    // Wrong poses cost more than any choice of frames.
    assert!(number(&of("t-only-noise")["ssim"]) < number(&of("t-only")["ssim"]) - 0.02);
    assert!(number(&of("t-only")["ssim"]) > 0.6, "{}", of("t-only"));

    for view in views {
        assert!(number(&view["nearest_training_deg"]) > 0.0);
        let scores = view["scores"].as_array().unwrap();
        assert!(
            scores
                .iter()
                .all(|score| number(&score["common_share"]) > 0.1)
        );
        // Methods on true poses are compared on the same pixels; the disturbed one is alone.
        let of = |at: usize| [&scores[at]["cut_px"], &scores[at]["common_share"]];
        assert!([1, 2, 4].iter().all(|&at| of(at) == of(0)));
        let sheet = std::fs::read(out.join(view["sheet"].as_str().unwrap())).unwrap();
        let sheet = veneer::geom::EncodedColor::from_file(sheet.into()).unwrap();
        // Four pictures of the view side by side, a row for each method.
        assert!(sheet.width() > 4 * 240 && sheet.height() > 5 * 180);
        sheet.decode().unwrap();
    }
    let markdown = std::fs::read_to_string(out.join("eval.md")).unwrap();
    assert!(markdown.contains("| `t-only-noise` |"));
    assert!(out.join("textures/l2avg/scan.glb").is_file());

    // The same bag and methods give the same numbers, times apart, on any number of threads.
    let again = dir.path().join("again");
    let at = args
        .iter()
        .position(|arg| *arg == out.to_str().unwrap())
        .unwrap();
    args[at] = again.to_str().unwrap();
    args.extend(["--threads", "1"]);
    let mut second: Value = serde_json::from_str(&veneer_ok(&args)).unwrap();
    let mut first = report;
    for report in [&mut first, &mut second] {
        for method in report["methods"].as_array_mut().unwrap() {
            method["seconds"] = Value::Null;
        }
    }
    assert_eq!(first, second);
}

#[test]
fn what_makes_no_sense_is_refused() {
    let dir = tempfile::tempdir().unwrap();
    let bag = small_tabletop(dir.path(), &[]);
    let out = dir.path().join("eval");
    let refused = |extra: &[&str], code: i32, words: &str| {
        let mut args = vec!["--quiet", "eval", bag.to_str().unwrap()];
        args.extend(["--out", out.to_str().unwrap()]);
        args.extend(extra);
        let output = veneer(&args);
        let text = said(&output);
        assert_eq!(output.status.code(), Some(code), "{extra:?}: {text}");
        assert!(text.contains(words), "{extra:?}: {text}");
    };
    refused(
        &["--methods", "best"],
        2,
        "unknown method 'best'; known are l2avg, t-only",
    );
    refused(
        &["--methods", "a=/nowhere/mesh.obj"],
        1,
        "/nowhere/mesh.obj",
    );
    refused(
        &["--methods", "a=/nowhere/mesh.stl"],
        1,
        ".obj, .glb, .gltf, .ply",
    );
    refused(&["--place", "a=/nowhere.json"], 1, "/nowhere.json");
    refused(&["--hold-out", "1"], 2, "--hold-out");
    refused(
        &["--lpips-weights", "/nowhere.safetensors"],
        1,
        "/nowhere.safetensors",
    );
    let not_weights = dir.path().join("weights");
    std::fs::write(&not_weights, "no weights").unwrap();
    refused(
        &["--lpips-weights", not_weights.to_str().unwrap()],
        1,
        "not a safetensors file",
    );
}

/// Where a camera may stand in the room, looking level.
fn views() -> Vec<(PinholeCamera, RigidTransform)> {
    let camera = PinholeCamera::new([220.0, 220.0, 159.5, 119.5], 320, 240).unwrap();
    [0.4f64, 2.2, 4.0]
        .into_iter()
        .map(|heading| {
            let (sin, cos) = heading.sin_cos();
            // Rows: the camera's axes in the world (x right, y down, z forward).
            let matrix = [
                [sin, 0.0, cos, 1.6],
                [-cos, 0.0, sin, 1.4],
                [0.0, -1.0, 0.0, 1.3],
                [0.0, 0.0, 0.0, 1.0],
            ];
            (
                camera,
                RigidTransform::try_from_matrix(&matrix).unwrap().inverse(),
            )
        })
        .collect()
}

/// Per pixel: whether it and those two around it show one chart. Where charts meet, surfaces are
/// equally far, and which is drawn goes by the order of triangles, which formats change.
fn is_within_chart(room: &Room, camera: &PinholeCamera, pose: &RigidTransform) -> Vec<bool> {
    let mut view = ViewBuffer::default();
    let mut workspace = RasterWorkspace::default();
    rasterize(&room.mesh, camera, pose, &mut workspace, &mut view);
    let (width, height) = (view.width as usize, view.height as usize);
    let chart = |x: usize, y: usize| {
        let triangle = view.triangle[y * width + x] as usize;
        room.layout.chart_of_triangle.get(triangle)
    };
    (0..width * height)
        .map(|i| {
            let (x, y) = (i % width, i / width);
            let rows = y.saturating_sub(2)..(y + 3).min(height);
            let mut around =
                rows.flat_map(|y| (x.saturating_sub(2)..(x + 3).min(width)).map(move |x| (x, y)));
            around.all(|(near_x, near_y)| chart(near_x, near_y) == chart(x, y))
        })
        .collect()
}

#[test]
fn exports_read_back_look_like_the_original() {
    let room = Room::new();
    let textured = TexturedMesh::new(&room.mesh, &room.layout, &room.texture).unwrap();
    let dir = tempfile::tempdir().unwrap();
    write_all(&textured, dir.path(), &ExportParams::default()).unwrap();
    let params = RenderParams::default();
    for name in ["scan.glb", "scan.obj", "scan.ply"] {
        let model = model::read(&dir.path().join(name)).unwrap();
        assert_eq!(
            model.mesh().num_triangles(),
            room.mesh.num_triangles(),
            "{name}"
        );
        assert_eq!(model.num_dropped_triangles(), 0);
        for (camera, pose) in views() {
            let (layout, texture) = (&room.layout, &room.texture);
            let ours =
                render_textured(&room.mesh, layout, texture, &camera, &pose, &params).unwrap();
            let theirs = render_model(&model, &camera, &pose, &params).unwrap();
            let num_seen = ours.mask.iter().filter(|&&m| m).count();
            assert!(num_seen > 60_000, "{num_seen}");
            let is_within = is_within_chart(&room, &camera, &pose);
            let mut num_compared = 0;
            for (i, _) in is_within.iter().enumerate().filter(|(_, within)| **within) {
                assert_eq!(ours.mask[i], theirs.mask[i], "{name}: pixel {i}");
                let (a, b) = (ours.color.pixels()[i], theirs.color.pixels()[i]);
                let off = a.iter().zip(b).map(|(a, b)| a.abs_diff(b)).max().unwrap();
                assert!(off <= 1, "{name}: pixel {i} is {b:?}, not {a:?}");
                num_compared += usize::from(ours.mask[i]);
            }
            assert!(num_compared > 50_000, "{num_compared}");
        }
    }
}

/// The JSON and the binary chunk of a GLB.
fn chunks(glb: &[u8]) -> (Value, &[u8]) {
    let word = |at: usize| u32::from_le_bytes(glb[at..at + 4].try_into().unwrap()) as usize;
    let end = 20 + word(12);
    let json = serde_json::from_slice(&glb[20..end]).unwrap();
    (json, &glb[end + 8..end + 8 + word(end)])
}

#[test]
fn buffers_and_images_beside_a_gltf_file_are_found() {
    let room = Room::new();
    let textured = TexturedMesh::new(&room.mesh, &room.layout, &room.texture).unwrap();
    let dir = tempfile::tempdir().unwrap();
    write_all(&textured, dir.path(), &ExportParams::default()).unwrap();
    let glb = std::fs::read(dir.path().join("scan.glb")).unwrap();
    let (mut json, binary) = chunks(&glb);
    std::fs::write(dir.path().join("the data.bin"), binary).unwrap();
    json["buffers"][0]["uri"] = "the%20data.bin".into();
    // One image stays in the buffer, the other is the page beside it.
    let image = &mut json["images"][1];
    *image = serde_json::json!({ "uri": "atlas/page_1.png" });
    let path = dir.path().join("scan.gltf");
    std::fs::write(&path, json.to_string()).unwrap();

    let inside = model::read(&dir.path().join("scan.glb")).unwrap();
    let beside = model::read(&path).unwrap();
    assert_eq!(inside.mesh().positions_m(), beside.mesh().positions_m());
    let (camera, pose) = views().remove(0);
    let [a, b] = [inside, beside]
        .map(|model| render_model(&model, &camera, &pose, &RenderParams::default()).unwrap());
    assert_eq!(a, b);

    std::fs::remove_file(dir.path().join("the data.bin")).unwrap();
    let error = model::read(&path).unwrap_err().to_string();
    assert!(error.contains("the data.bin"), "{error}");
}

#[test]
fn colours_per_vertex_are_read_where_there_is_no_texture() {
    let dir = tempfile::tempdir().unwrap();
    let ply = dir.path().join("colored.ply");
    std::fs::write(
        &ply,
        "ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\n\
         property float z\nproperty uchar red\nproperty uchar green\nproperty uchar blue\n\
         element face 1\nproperty list uchar int vertex_indices\nend_header\n\
         -9 -9 2 10 20 30\n9 -9 2 10 20 30\n0 9 2 10 20 30\n3 0 1 2\n",
    )
    .unwrap();
    let obj = dir.path().join("colored.obj");
    std::fs::write(
        &obj,
        "v -9 -9 2 0.2 0.4 0.6\nv 9 -9 2 0.2 0.4 0.6\nv 0 9 2 0.2 0.4 0.6\nf 1 2 3\n",
    )
    .unwrap();
    let camera = PinholeCamera::new([20.0, 20.0, 7.5, 7.5], 16, 16).unwrap();
    for (path, expected) in [(ply, [10, 20, 30]), (obj, [51, 102, 153])] {
        let model = model::read(&path).unwrap();
        let identity = RigidTransform::identity();
        let view = render_model(&model, &camera, &identity, &RenderParams::default()).unwrap();
        assert!(view.mask.iter().all(|&seen| seen));
        assert_eq!(view.color.pixel_clamped(8, 8), expected);
    }
}

#[test]
fn damaged_and_incomplete_models_are_refused_with_the_reason() {
    let dir = tempfile::tempdir().unwrap();
    let refused = |name: &str, text: &str, words: &str| {
        let path = dir.path().join(name);
        std::fs::write(&path, text).unwrap();
        let error = model::read(&path).unwrap_err().to_string();
        assert!(error.contains(words) && error.contains(name), "{error}");
    };
    let header = "ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\n\
                  property float z\nelement face 1\nproperty list uchar int vertex_indices\n";
    let body = "end_header\n0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n";
    refused(
        "plain.ply",
        &format!("{header}{body}"),
        "neither a texture nor colours",
    );
    let numbered = format!("{header}property int texnumber\ncomment TextureFile a.png\n{body}");
    let numbered = numbered.replace("3 0 1 2\n", "3 0 1 2 4\n");
    refused("number.ply", &numbered, "'4' for a texture's number");
    let lost = numbered.replace("3 0 1 2 4\n", "3 0 1 2 0\n");
    std::fs::write(dir.path().join("lost.ply"), lost).unwrap();
    let error = model::read(&dir.path().join("lost.ply")).unwrap_err();
    assert!(error.to_string().contains("a.png"), "{error}");
    refused("empty.obj", "v 0 0 0\n", "no triangle");
    refused("index.obj", "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 9\n", "OBJ");
    refused(
        "lost.obj",
        "mtllib lost.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n",
        "material",
    );
    refused("not.glb", "glTFgarbage", "glTF");
    refused("empty.gltf", r#"{"asset":{"version":"2.0"}}"#, "no scene");
    let ring = r#"{"asset":{"version":"2.0"},"scene":0,"scenes":[{"nodes":[0]}],
        "nodes":[{"children":[1]},{"children":[0]}]}"#;
    refused("ring.gltf", ring, "no tree");
    let claims = r#"{"asset":{"version":"2.0"},"scene":0,"scenes":[{"nodes":[0]}],
        "nodes":[{"mesh":0}],"meshes":[{"primitives":[{"attributes":{"POSITION":0}}]}],
        "buffers":[{"byteLength":4,"uri":"data:;base64,AAAAAA=="}],
        "bufferViews":[{"buffer":0,"byteLength":4}],
        "accessors":[{"bufferView":0,"componentType":5126,"count":1000000000000,"type":"VEC3",
        "min":[0,0,0],"max":[0,0,0]}]}"#;
    refused("claims.gltf", claims, "past its data");
}

/// The room's exports, small: what fuzzing starts from.
fn sample(ending: &str) -> Vec<u8> {
    match ending {
        "obj" => b"mtllib a.mtl\nv 0 0 0 1 0 0\nv 1 0 0 0 1 0\nv 0 1 0 0 0 1\nv 1 1 0 1 1 1\n\
            vt 0 0\nvt 1 0\nvt 0 1\nusemtl m\nf 1/1 2/2 3/3\nf 2/2 4/1 3/3\n"
            .to_vec(),
        "ply" => b"ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\n\
            property float z\nproperty uchar red\nproperty uchar green\nproperty uchar blue\n\
            element face 1\nproperty list uchar int vertex_indices\n\
            property list uchar float texcoord\nproperty int texnumber\nend_header\n\
            0 0 0 1 2 3\n1 0 0 4 5 6\n0 1 0 7 8 9\n3 0 1 2 6 0 0 1 0 0 1 0\n"
            .to_vec(),
        _ => {
            let json = br#"{"asset":{"version":"2.0"},"scene":0,"scenes":[{"nodes":[0]}],"nodes":[{"mesh":0}],"meshes":[{"primitives":[{"attributes":{"POSITION":0},"indices":1}]}],"buffers":[{"byteLength":44}],"bufferViews":[{"buffer":0,"byteLength":36},{"buffer":0,"byteOffset":36,"byteLength":6}],"accessors":[{"bufferView":0,"componentType":5126,"count":3,"type":"VEC3","min":[0,0,0],"max":[1,1,0]},{"bufferView":1,"componentType":5123,"count":3,"type":"SCALAR"}]}"#;
            let mut json = json.to_vec();
            json.resize(json.len().next_multiple_of(4), b' ');
            let mut file = b"glTF\x02\0\0\0".to_vec();
            let word = |n: usize| u32::try_from(n).unwrap().to_le_bytes();
            file.extend(word(12 + 8 + json.len() + 8 + 44));
            file.extend(word(json.len()));
            file.extend(b"JSON");
            file.extend(json);
            file.extend(word(44));
            file.extend(b"BIN\0");
            for value in [0.0f32, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0] {
                file.extend(value.to_le_bytes());
            }
            file.extend([0, 0, 1, 0, 2, 0, 0, 0]);
            file
        }
    }
}

#[test]
fn the_samples_of_the_fuzzing_are_read() {
    let dir = tempfile::tempdir().unwrap();
    std::fs::write(dir.path().join("a.mtl"), "newmtl m\nKd 1 0.5 0\n").unwrap();
    for ending in ["obj", "ply", "glb"] {
        let path = dir.path().join(format!("sample.{ending}"));
        std::fs::write(&path, sample(ending)).unwrap();
        let model = model::read(&path).unwrap();
        assert!(model.mesh().num_triangles() > 0, "{ending}");
    }
}

#[test]
fn a_model_whose_accessors_are_missing_is_refused() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("sample.glb");
    let mut file = sample("glb");
    let at = file.windows(9).position(|word| word == b"accessors");
    file[at.unwrap()] = b'b';
    std::fs::write(&path, file).unwrap();
    let refused = model::read(&path).unwrap_err().to_string();
    assert!(refused.contains("accessor"), "{refused}");
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 400, ..ProptestConfig::default() })]
    #[test]
    fn mutated_models_never_panic(
        ending in prop::sample::select(vec!["obj", "ply", "glb"]),
        edits in prop::collection::vec((any::<prop::sample::Index>(), any::<u8>(), 0..3u8), 1..10),
    ) {
        let mut file = sample(ending);
        for (at, byte, kind) in edits {
            let at = at.index(file.len());
            match kind {
                0 => file[at] = byte,
                1 => file.insert(at, byte),
                _ => { file.remove(at); }
            }
        }
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join(format!("mutated.{ending}"));
        std::fs::write(&path, file).unwrap();
        if let Ok(model) = model::read(&path) {
            let camera = PinholeCamera::new([8.0, 8.0, 3.5, 3.5], 8, 8).unwrap();
            let pose = RigidTransform::identity();
            drop(render_model(&model, &camera, &pose, &RenderParams::default()));
        }
    }
}
