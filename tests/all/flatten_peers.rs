//! Boundary first flattening beside libigl: its operators, its least-squares conformal maps and its
//! harmonic maps, on noisy analytic surfaces and on charts of a real capture.

use std::path::Path;
use std::process::Command;

use nalgebra::Point3;
use serde_json::{Value, json};
use veneer::import::mesh_file;
use veneer::mesh::TriMesh;
use veneer::texinit::flatten::{
    Boundary, ChartDistortion, DiskMap, DiskSurface, FlattenParams, flatten,
};

use crate::python;

/// Numbers in [-1, 1) that look random and are the same everywhere.
fn noise(seed: u32) -> f64 {
    let x = f64::from(seed);
    2.0 * ((12.9898 * x).sin() * 43_758.545_3).rem_euclid(1.0) - 1.0
}

/// `side`² vertices over [-1, 1]², two triangles per cell.
fn sheet(side: u32, place: impl Fn(f64, f64) -> [f64; 3]) -> TriMesh {
    let pitch = 2.0 / f64::from(side - 1);
    let mut positions = Vec::new();
    let mut triangles = Vec::new();
    for j in 0..side {
        for i in 0..side {
            let shift = |seed: u32| 0.15 * pitch * noise(seed + 2 * (j * side + i));
            let (x, y) = (f64::from(i) * pitch - 1.0, f64::from(j) * pitch - 1.0);
            positions.push(Point3::from(place(x + shift(1), y + shift(2))));
            if i + 1 < side && j + 1 < side {
                let a = j * side + i;
                triangles.push([a, a + 1, a + side + 1]);
                triangles.push([a, a + side + 1, a + side]);
            }
        }
    }
    TriMesh::from_soup(positions, triangles).unwrap().0
}

fn analytic() -> Vec<(String, TriMesh)> {
    let bumps = |x: f64, y: f64| [x, y, 0.3 * (3.0 * x).sin() * (2.5 * y).cos()];
    let bell = |x: f64, y: f64| [x, y, 0.8 * (-4.0 * (x * x + y * y)).exp()];
    // Most of a sphere by stereographic projection from its south pole.
    let dome = |x: f64, y: f64| {
        let d = 1.0 + x * x + y * y;
        [2.0 * x / d, 2.0 * y / d, (2.0 - d) / d]
    };
    let saddle = |x: f64, y: f64| [x, y, 0.7 * (x * x - y * y)];
    vec![
        ("bumps".to_owned(), sheet(40, bumps)),
        ("bell".to_owned(), sheet(45, bell)),
        ("dome".to_owned(), sheet(40, dome)),
        ("saddle".to_owned(), sheet(30, saddle)),
    ]
}

/// Whether a triangle is so nearly collinear that ours lengthens all edges a little, which libigl
/// does not (the Laplacian's mollification).
fn has_needle(mesh: &TriMesh) -> bool {
    let sides: Vec<[f64; 3]> = mesh
        .triangle_ids()
        .map(|t| {
            let [a, b, c] = mesh.corners_m(t);
            [(b - a).norm(), (c - b).norm(), (a - c).norm()]
        })
        .collect();
    let mean = sides.iter().flatten().sum::<f64>() / (3 * sides.len()) as f64;
    sides.iter().any(|sides| {
        let longest = sides.iter().copied().fold(0.0, f64::max);
        sides.iter().sum::<f64>() - 2.0 * longest < 1e-5 * mean
    })
}

/// Largest charts of a capture that are disks as they stand, each as a mesh of its own.
fn captured(name: &str, num_charts: usize) -> Vec<(String, TriMesh)> {
    let path =
        Path::new(env!("CARGO_MANIFEST_DIR")).join(format!("../shared/data/{name}/mesh.ply"));
    if !path.is_file() {
        eprintln!("SKIPPED: no {}", path.display());
        return Vec::new();
    }
    let (mesh, _) = mesh_file::read(&path).unwrap();
    let mut charts = flatten(&mesh, &FlattenParams::default()).unwrap().charts;
    charts.sort_by_key(|chart| std::cmp::Reverse(chart.triangles.len()));
    let alone = charts.iter().map(|chart| {
        let mut vertices: Vec<u32> = chart
            .triangles
            .iter()
            .flat_map(|t| mesh.triangles()[t.index()])
            .collect();
        vertices.sort_unstable();
        vertices.dedup();
        let place = |v: u32| u32::try_from(vertices.binary_search(&v).unwrap()).unwrap();
        let triangles = chart
            .triangles
            .iter()
            .map(|t| mesh.triangles()[t.index()].map(place));
        let positions = vertices.iter().map(|&v| mesh.positions_m()[v as usize]);
        TriMesh::from_soup(positions.collect(), triangles.collect())
            .unwrap()
            .0
    });
    let is_plain_disk = |mesh: &TriMesh| {
        DiskSurface::new(mesh).is_ok_and(|disk| disk.mesh_vertices().len() == mesh.num_vertices())
            && !has_needle(mesh)
    };
    let found: Vec<_> = alone
        .filter(is_plain_disk)
        .take(num_charts)
        .enumerate()
        .map(|(i, mesh)| (format!("{name} {i}"), mesh))
        .collect();
    assert_eq!(found.len(), num_charts, "{name} has charts that are disks");
    found
}

struct Case {
    name: String,
    isometric: DiskMap,
    circle: DiskMap,
}

fn solve(name: String, mesh: &TriMesh) -> (Case, Value) {
    let disk = DiskSurface::new(mesh).unwrap();
    let of_mesh: Vec<u32> = disk.mesh_vertices().iter().map(|v| v.unwrap()).collect();
    let isometric = disk.flatten(Boundary::Isometric).unwrap();
    let circle = disk.flatten(Boundary::Circle).unwrap();
    let vertex = |v: u32| of_mesh[v as usize];
    let on_mesh = |map: &DiskMap| {
        let mut uv = vec![[f64::NAN; 2]; mesh.num_vertices()];
        let mut log_scale = vec![f64::NAN; mesh.num_vertices()];
        for (corners, flat) in mesh.triangles().iter().zip(&map.corners_m) {
            for k in 0..3 {
                uv[corners[k] as usize] = flat[k];
            }
        }
        for (&v, u) in of_mesh.iter().zip(&map.log_scale) {
            log_scale[v as usize] = *u;
        }
        json!({ "uv": uv, "log_scale": log_scale })
    };
    let weights = disk.laplacian().unwrap();
    let value = json!({
        "name": name,
        "vertices": mesh.positions_m().iter().map(|p| [p.x, p.y, p.z]).collect::<Vec<_>>(),
        "triangles": mesh.triangles(),
        "boundary": disk.boundary().iter().map(|&v| vertex(v)).collect::<Vec<_>>(),
        "laplacian": weights.iter().map(|&(a, b, w)| json!([vertex(a), vertex(b), w]))
            .collect::<Vec<_>>(),
        "isometric": on_mesh(&isometric),
        "circle": on_mesh(&circle),
    });
    let case = Case {
        name,
        isometric,
        circle,
    };
    (case, value)
}

/// Our figures are numpy's.
fn check_figures(what: &str, ours: &ChartDistortion, theirs: &Value) {
    for (name, value) in [
        ("quasi_conformal_mean", ours.quasi_conformal_mean),
        ("quasi_conformal_max", ours.quasi_conformal_max),
        ("area_ratio_min", ours.area_ratio_min),
        ("area_ratio_max", ours.area_ratio_max),
        ("stretch_l2", ours.stretch_l2),
        ("stretch_linf", ours.stretch_linf),
    ] {
        let theirs = theirs[name].as_f64().unwrap();
        assert!(
            (value - theirs).abs() <= 1e-6 * theirs.abs(),
            "{what}: {name} {value}, by numpy {theirs}"
        );
    }
}

#[test]
fn libigl_agrees_with_every_step_and_is_not_better() {
    let Some(python) = python::venv("igl", &["libigl==2.6.3", "numpy", "scipy"]) else {
        return;
    };
    let mut meshes = analytic();
    meshes.extend(captured("apt0_structure", 8));
    meshes.extend(captured("charuco_lidar", 4));
    let (cases, values): (Vec<Case>, Vec<Value>) = meshes
        .into_iter()
        .map(|(name, mesh)| solve(name, &mesh))
        .unzip();
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("cases.json");
    std::fs::write(&path, json!(values).to_string()).unwrap();
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/all/flatten_peers.py");
    let said = python::run(Command::new(&python).arg(&script).arg(&path)).unwrap();
    let answers: Vec<Value> = said
        .lines()
        .map(|line| serde_json::from_str(line).unwrap())
        .collect();
    assert_eq!(answers.len(), cases.len());

    eprintln!(
        "surface, then mean quasi-conformal error and spread of log area: ours with u = 0, LSCM, ours on a circle, harmonic on a circle"
    );
    for (case, theirs) in cases.iter().zip(&answers) {
        let name = &case.name;
        assert_eq!(theirs["name"], json!(name));
        let number = |key: &str| theirs[key].as_f64().unwrap();
        let of = |map: &str, key: &str| theirs[map][key].as_f64().unwrap();
        let pair = |map: &str| {
            let [conformal, area] =
                ["quasi_conformal_median", "log_area_spread"].map(|k| of(map, k));
            format!("{conformal:.5} {area:.4}")
        };
        eprintln!(
            "{name}: {}, {}, {}, {}; roundness {:.1e}, gap {:.1e}",
            pair("isometric"),
            pair("lscm"),
            pair("circle"),
            pair("harmonic_circle"),
            number("roundness"),
            case.isometric.closure.gap,
        );
        assert!(number("laplacian") < 1e-9, "{name}: cotangents");
        assert!(
            number("flatness") < 1e-9,
            "{name}: curvature is left inside"
        );
        assert!(number("harmonic") < 1e-9, "{name}: x is not harmonic");
        assert!(number("conjugate") < 1e-9, "{name}: y is not its conjugate");
        check_figures(name, &case.isometric.distortion, &theirs["isometric"]);
        // What discrete curvature leaves open; it shrinks with finer triangles.
        let max_gap = if name.contains(' ') { 5e-3 } else { 1e-5 };
        assert!(
            case.isometric.closure.gap < max_gap,
            "{name}: the curve gapes"
        );
        assert!(case.isometric.closure.corrected_gap <= 1e-12);

        // LSCM has the least error of all maps; ours keeps areas better for hardly more.
        let excess = |map: &str| of(map, "quasi_conformal_mean") - 1.0;
        assert!(
            excess("isometric") <= 1.05 * excess("lscm") + 1e-4,
            "{name}"
        );
        let spread = |map: &str| of(map, "log_area_spread");
        assert!(
            spread("isometric") <= 1.01 * spread("lscm") + 1e-4,
            "{name}"
        );
        assert_eq!(of("isometric", "num_flipped"), 0.0, "{name}");
        // A circle crushes the triangles at corners, so the median tells more than the mean.
        let median = |map: &str| of(map, "quasi_conformal_median") - 1.0;
        assert!(median("circle") < median("harmonic_circle"), "{name}");
        if name.contains(' ') {
            assert!(number("roundness") < 1e-2, "{name}");
        } else {
            assert!(number("roundness") < 1e-6, "{name}");
            assert!(median("circle") < 0.04, "{name}");
            check_figures(name, &case.circle.distortion, &theirs["circle"]);
        }
    }
}
