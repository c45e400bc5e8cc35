//! Oracles of the whole stage: analytic surfaces, invariants on any soup, real captures.

use std::f64::consts::{FRAC_PI_2, TAU};

use nalgebra::Point3;
use proptest::prelude::*;

use super::bff::{Boundary, flatten_disk};
use super::cut::{euler_characteristic, make_disk};
use super::laplacian::{Metric, edge_weights};
use super::*;
use crate::mesh::adjacency::{boundary_loops, vertices_of_corners};

fn mesh(positions: Vec<[f64; 3]>, triangles: Vec<[u32; 3]>) -> TriMesh {
    let positions = positions.into_iter().map(Point3::from).collect();
    TriMesh::from_soup(positions, triangles).unwrap().0
}

/// `columns` × `rows` vertices placed by `place(i, j)`, two triangles per cell, wrapping round in
/// `i` where asked.
fn grid(columns: u32, rows: u32, is_closed: bool, place: impl Fn(u32, u32) -> [f64; 3]) -> TriMesh {
    let mut positions = Vec::new();
    for j in 0..rows {
        positions.extend((0..columns).map(|i| place(i, j)));
    }
    let mut triangles = Vec::new();
    for j in 0..rows - 1 {
        for i in 0..columns - u32::from(!is_closed) {
            let (i1, low, high) = ((i + 1) % columns, j * columns, (j + 1) * columns);
            triangles.push([low + i, low + i1, high + i1]);
            triangles.push([low + i, high + i1, high + i]);
        }
    }
    mesh(positions, triangles)
}

/// Numbers in [-1, 1) that look random and are the same everywhere.
fn noise(seed: u32) -> f64 {
    let mut x = seed.wrapping_mul(0x9e37_79b9).wrapping_add(0x85eb_ca6b);
    x ^= x >> 16;
    x = x.wrapping_mul(0x7feb_352d);
    x ^= x >> 15;
    x = x.wrapping_mul(0x846c_a68b);
    x ^= x >> 16;
    f64::from(x) / f64::from(u32::MAX) * 2.0 - 1.0
}

mod absorbing;
mod closed_forms;
mod whole_components;

fn whole() -> FlattenParams {
    FlattenParams {
        mode: ChartMode::Paper,
        max_cones: 0,
        ..Default::default()
    }
}

/// A plane, its inner vertices moved about, tilted in space.
fn noisy_plane(side: u32) -> TriMesh {
    let pitch = 1.0 / f64::from(side - 1);
    grid(side, side, false, |i, j| {
        let is_inner = i > 0 && j > 0 && i < side - 1 && j < side - 1;
        let shift = if is_inner { 0.2 * pitch } else { 0.0 };
        let x = f64::from(i) * pitch + shift * noise(i * 977 + j);
        let y = f64::from(j) * pitch + shift * noise(i * 977 + j + 5_000_000);
        [x + 3.0, 0.6 * y - 1.0, 0.8 * y]
    })
}

/// A cap of the unit sphere around +z.
fn cap(rings: u32, opening_rad: f64, noise_m: f64) -> TriMesh {
    let mut positions = vec![[0.0, 0.0, 1.0]];
    let mut triangles = Vec::new();
    let around = 6 * rings;
    for r in 1..=rings {
        let polar = opening_rad * f64::from(r) / f64::from(rings);
        for i in 0..around {
            let turn = TAU * f64::from(i) / f64::from(around);
            let radius = 1.0 + noise_m * noise(r * 7919 + i);
            positions.push([
                radius * polar.sin() * turn.cos(),
                radius * polar.sin() * turn.sin(),
                radius * polar.cos(),
            ]);
        }
    }
    for i in 0..around {
        let j = (i + 1) % around;
        triangles.push([0, 1 + i, 1 + j]);
        for r in 1..rings {
            let (inner, outer) = (1 + (r - 1) * around, 1 + r * around);
            triangles.push([inner + i, outer + i, outer + j]);
            triangles.push([inner + i, outer + j, inner + j]);
        }
    }
    mesh(positions, triangles)
}

fn check_each_triangle_once(mesh: &TriMesh, charts: &[FlatChart]) {
    let mut count = vec![0; mesh.num_triangles()];
    for chart in charts {
        assert_eq!(chart.triangles.len(), chart.corners_m.len());
        assert!(!chart.triangles.is_empty());
        for triangle in &chart.triangles {
            count[triangle.index()] += 1;
        }
        assert!(
            chart
                .corners_m
                .iter()
                .flatten()
                .flatten()
                .all(|c| c.is_finite())
        );
        assert!(chart.distortion.quasi_conformal_mean.is_finite());
    }
    assert!(count.iter().all(|c| *c == 1));
}

/// Largest relative difference between the sides on the surface and in the plane.
fn worst_length_error(mesh: &TriMesh, charts: &[FlatChart]) -> f64 {
    let mut worst: f64 = 0.0;
    for chart in charts {
        for (&triangle, flat) in chart.triangles.iter().zip(&chart.corners_m) {
            let corners = mesh.corners_m(triangle);
            for k in 0..3 {
                let n = (k + 1) % 3;
                let length = (corners[n] - corners[k]).norm();
                let flat = (flat[n][0] - flat[k][0]).hypot(flat[n][1] - flat[k][1]);
                worst = worst.max((flat / length - 1.0).abs());
            }
        }
    }
    worst
}

#[test]
fn a_plane_is_flat() {
    let plane = noisy_plane(30);
    let result = flatten(&plane, &whole()).unwrap();
    assert_eq!(result.charts.len(), 1);
    assert!(worst_length_error(&plane, &result.charts) < 1e-9);
    assert!(result.charts[0].distortion.quasi_conformal_max < 1.0 + 1e-9);
    assert!(result.report.seam_length_m == 0.0);
}

#[test]
fn a_long_boundary_gives_the_same_plane_by_two_factors() {
    let plane = noisy_plane(80);
    let result = flatten(&plane, &whole()).unwrap();
    assert!(worst_length_error(&plane, &result.charts) < 1e-8);
}

#[test]
fn a_bent_strip_keeps_its_lengths() {
    // A cylinder's rulings and equal steps along its arc: each cell unrolls to a rectangle.
    let strip = grid(40, 12, false, |i, j| {
        let turn = 1.5 * TAU * f64::from(i) / 40.0;
        let radius = 0.5;
        [radius * turn.cos(), radius * turn.sin(), 0.1 * f64::from(j)]
    });
    let result = flatten(&strip, &whole()).unwrap();
    assert_eq!(result.charts.len(), 1);
    assert!(worst_length_error(&strip, &result.charts) < 1e-9);
}

#[test]
fn a_tube_is_cut_once_along_its_length() {
    let tube = grid(24, 9, true, |i, j| {
        let turn = TAU * f64::from(i) / 24.0;
        [turn.cos(), turn.sin(), 0.25 * f64::from(j)]
    });
    let result = flatten(&tube, &whole()).unwrap();
    assert_eq!(result.charts.len(), 1);
    assert_eq!(result.report.solve.num_cut_edges, 8);
    assert!((result.report.seam_length_m - 2.0).abs() < 1e-9);
    assert!(worst_length_error(&tube, &result.charts) < 1e-9);
}

#[test]
fn a_small_hole_in_a_plane_is_no_seam() {
    let plane = noisy_plane(20);
    let kept: Vec<[u32; 3]> = plane
        .triangles()
        .iter()
        .enumerate()
        .filter(|(t, _)| !(318..326).contains(t))
        .map(|(_, corners)| *corners)
        .collect();
    let holed = TriMesh::from_soup(plane.positions_m().to_vec(), kept)
        .unwrap()
        .0;
    let result = flatten(&holed, &whole()).unwrap();
    assert_eq!(result.charts.len(), 1);
    assert_eq!(result.report.solve.num_filled_holes, 1);
    assert_eq!(result.report.seam_length_m, 0.0);
    assert!(worst_length_error(&holed, &result.charts) < 1e-9);
}

/// A spherical cap flattens to a disk by stereographic projection; with u = 0 on its boundary the
/// radius is that of the boundary circle, here compared before the scale to equal area.
#[test]
fn a_cap_becomes_the_stereographic_disk() {
    let opening = 1.0_f64;
    let surface = cap(40, opening, 0.0);
    let (disk, points) = flat_disk(&surface);
    let center = points[0];
    let boundary = boundary_points(&disk, &points);
    for point in &boundary {
        let radius = (point[0] - center[0]).hypot(point[1] - center[1]);
        assert!((radius / opening.sin() - 1.0).abs() < 5e-3, "{radius}");
    }
    // Half way up: the stereographic radius is proportional to tan(polar / 2).
    let half = 1 + 19 * 240;
    let point = points[half];
    let radius = (point[0] - center[0]).hypot(point[1] - center[1]);
    let expected = opening.sin() * (0.25 * opening).tan() / (0.5 * opening).tan();
    assert!(
        (radius / expected - 1.0).abs() < 5e-3,
        "{radius} {expected}"
    );
}

#[test]
fn a_hemisphere_becomes_conformal_as_it_is_refined() {
    let error = |rings| {
        let result = flatten(&cap(rings, FRAC_PI_2, 0.0), &whole()).unwrap();
        result.charts[0].distortion
    };
    let (coarse, fine) = (error(15), error(30));
    assert!(fine.quasi_conformal_max < 1.05, "{fine:?}");
    assert!(fine.quasi_conformal_mean - 1.0 < 0.6 * (coarse.quasi_conformal_mean - 1.0));
}

#[test]
fn a_noisy_hemisphere_stays_nearly_conformal() {
    let noisy = flatten(&cap(30, FRAC_PI_2, 0.004), &whole()).unwrap();
    let distortion = noisy.charts[0].distortion;
    assert!(distortion.quasi_conformal_mean < 1.1, "{distortion:?}");
    assert!(distortion.quasi_conformal_max < 2.0, "{distortion:?}");
}

/// The disk of the mesh in vertex order of the mesh (its corners are numbered by first use).
fn flat_disk(surface: &TriMesh) -> (cut::Disk, Vec<[f64; 2]>) {
    let manifold = Manifold::new(surface).unwrap();
    let corners = surface
        .triangle_ids()
        .map(|t| manifold.oriented_corners_m(surface, t))
        .collect();
    let disk = make_disk(corners, manifold.mates().to_vec()).unwrap();
    let flat = flatten_disk(&disk, Boundary::Isometric).unwrap().points_m;
    let mut points = vec![[f64::NAN; 2]; surface.num_vertices()];
    for (local, global) in disk.vertices.iter().zip(surface.triangles()) {
        for k in 0..3 {
            points[global[k] as usize] = flat[local[k] as usize];
        }
    }
    (disk, points)
}

fn boundary_points(disk: &cut::Disk, _points: &[[f64; 2]]) -> Vec<[f64; 2]> {
    let flat = flatten_disk(disk, Boundary::Isometric).unwrap().points_m;
    disk.boundary
        .iter()
        .map(|&h| flat[disk.vertices[h as usize / 3][h as usize % 3] as usize])
        .collect()
}

#[test]
fn gauss_bonnet_holds() {
    for surface in [noisy_plane(9), cap(8, 2.0, 0.02)] {
        let (disk, _) = flat_disk(&surface);
        let metric = Metric::new(&disk.corners_m).unwrap();
        let numbering = bff::Numbering::new(&disk);
        let curvature = bff::Curvature::new(&disk.vertices, &metric, &numbering);
        let total: f64 = curvature.interior.iter().chain(&curvature.boundary).sum();
        assert!((total - TAU).abs() < 1e-9, "{total}");
    }
}

#[test]
fn the_boundary_curve_closes() {
    let angles: Vec<f64> = (0..50).map(|i| 0.2 * noise(i)).collect();
    let excess = (TAU - angles.iter().sum::<f64>()) / 50.0;
    let angles: Vec<f64> = angles.iter().map(|a| a + excess).collect();
    let lengths: Vec<f64> = (0..50).map(|i| 1.0 + 0.3 * noise(i + 1000)).collect();
    let (curve, _) = bff::closed_curve(&lengths, &angles).unwrap();
    let mut heading = 0.0;
    for i in 0..50 {
        heading += angles[i];
        let [a, b] = [curve[i], curve[(i + 1) % 50]];
        let (dx, dy) = (b[0] - a[0], b[1] - a[1]);
        let across = dy * f64::cos(heading) - dx * f64::sin(heading);
        let along = dx * f64::cos(heading) + dy * f64::sin(heading);
        assert!(
            across.abs() < 1e-9,
            "edge {i} keeps its direction, the last one too"
        );
        assert!(along > 0.0);
    }
}

/// The Laplacian is the Dirichlet energy's matrix: of x it gives the area, of a constant nothing.
#[test]
fn the_laplacian_measures_dirichlet_energy() {
    let plane = grid(7, 5, false, |i, j| {
        [f64::from(i) + 0.3 * noise(i + 31 * j), f64::from(j), 0.0]
    });
    let (disk, _) = flat_disk(&plane);
    let metric = Metric::new(&disk.corners_m).unwrap();
    let x: Vec<f64> = {
        let mut x = vec![0.0; disk.num_vertices];
        for (vertices, corners) in disk.vertices.iter().zip(&disk.corners_m) {
            for k in 0..3 {
                x[vertices[k] as usize] = corners[k].x;
            }
        }
        x
    };
    let energy: f64 = edge_weights(&disk.mates, &disk.vertices, &metric)
        .iter()
        .map(|&(a, b, w)| w * (x[a as usize] - x[b as usize]).powi(2))
        .sum();
    let area: f64 = plane.triangle_ids().map(|t| plane.area_m2(t)).sum();
    assert!((energy - area).abs() < 1e-9);
}

fn torus() -> TriMesh {
    let (around, along) = (20, 14);
    let mut triangles = Vec::new();
    let mut positions = Vec::new();
    for j in 0..along {
        for i in 0..around {
            let (u, v) = (
                TAU * f64::from(i) / f64::from(around),
                TAU * f64::from(j) / f64::from(along),
            );
            let radius = 1.0 + 0.4 * v.cos();
            positions.push([radius * u.cos(), radius * u.sin(), 0.4 * v.sin()]);
            let (i1, j1) = ((i + 1) % around, (j + 1) % along);
            let at = |i: u32, j: u32| j * around + i;
            triangles.push([at(i, j), at(i1, j), at(i1, j1)]);
            triangles.push([at(i, j), at(i1, j1), at(i, j1)]);
        }
    }
    mesh(positions, triangles)
}

fn octahedron() -> TriMesh {
    mesh(
        vec![
            [1.0, 0.0, 0.0],
            [-1.0, 0.0, 0.0],
            [0.0, 1.0, 0.0],
            [0.0, -1.0, 0.0],
            [0.0, 0.0, 1.0],
            [0.0, 0.0, -1.0],
        ],
        vec![
            [0, 2, 4],
            [2, 1, 4],
            [1, 3, 4],
            [3, 0, 4],
            [2, 0, 5],
            [1, 2, 5],
            [3, 1, 5],
            [0, 3, 5],
        ],
    )
}

#[test]
fn closed_surfaces_and_handles_are_cut_to_disks() {
    for surface in [torus(), octahedron()] {
        let (disk, _) = flat_disk(&surface);
        let (vertices, num_vertices) = vertices_of_corners(&disk.mates);
        assert_eq!(vertices.len(), surface.num_triangles());
        assert_eq!(euler_characteristic(num_vertices, &disk.mates), 1);
        assert_eq!(boundary_loops(&disk.mates).len(), 1);
        for params in [whole(), FlattenParams::default()] {
            let result = flatten(&surface, &params).unwrap();
            check_each_triangle_once(&surface, &result.charts);
        }
    }
}

/// A Klein bottle's immersion crosses itself, but its connectivity is what counts.
#[test]
fn a_klein_bottle_is_cut_open() {
    let (around, along) = (12_u32, 10_u32);
    let mut positions = Vec::new();
    let mut triangles = Vec::new();
    for j in 0..along {
        for i in 0..around {
            let (u, v) = (
                TAU * f64::from(i) / f64::from(around),
                TAU * f64::from(j) / f64::from(along),
            );
            let s = 2.0 + (0.5 * v).cos() * u.sin() - (0.5 * v).sin() * (2.0 * u).sin();
            let t = (0.5 * v).sin() * u.sin() + (0.5 * v).cos() * (2.0 * u).sin();
            positions.push([s * v.cos(), s * v.sin(), t]);
        }
    }
    for j in 0..along {
        for i in 0..around {
            let at = |i: u32, j: u32| {
                if j == along {
                    (around - i % around) % around
                } else {
                    j * around + i % around
                }
            };
            triangles.push([at(i, j), at(i + 1, j), at(i + 1, j + 1)]);
            triangles.push([at(i, j), at(i + 1, j + 1), at(i, j + 1)]);
        }
    }
    let bottle = mesh(positions, triangles);
    for params in [whole(), FlattenParams::default()] {
        let result = flatten(&bottle, &params).unwrap();
        assert!(result.report.manifold.num_orientation_cuts > 0);
        check_each_triangle_once(&bottle, &result.charts);
    }
}

#[test]
fn collapsed_triangles_lie_on_their_edge() {
    let mut triangles = noisy_plane(4).triangles().to_vec();
    triangles.push([0, 1, 1]);
    triangles.push([3, 3, 3]);
    let surface = TriMesh::from_soup(noisy_plane(4).positions_m().to_vec(), triangles)
        .unwrap()
        .0;
    let result = flatten(&surface, &whole()).unwrap();
    check_each_triangle_once(&surface, &result.charts);
    assert_eq!(result.charts.len(), 2);
    let on_edge = result.charts[0].corners_m[18];
    assert_eq!(on_edge[1], on_edge[2]);
    assert_eq!(on_edge[0], result.charts[0].corners_m[0][0]);
}

#[test]
fn parameters_out_of_range_are_named() {
    let params = FlattenParams {
        max_stretch: f64::NAN,
        ..Default::default()
    };
    let error = flatten(&TriMesh::default(), &params).unwrap_err();
    assert!(error.to_string().contains("max_stretch"));
}

#[test]
fn nothing_gives_nothing() {
    for params in [whole(), FlattenParams::default()] {
        let result = flatten(&TriMesh::default(), &params).unwrap();
        assert!(result.charts.is_empty());
    }
}

fn coordinate() -> impl Strategy<Value = f64> {
    prop_oneof![
        8 => -1.0..1.0_f64,
        4 => (-2_i32..3).prop_map(f64::from),
        1 => Just(1e300),
        1 => Just(1e-300),
        1 => Just(-1e160),
    ]
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(400))]
    #[test]
    fn any_soup_keeps_every_triangle(
        positions in proptest::collection::vec(proptest::array::uniform3(coordinate()), 8),
        triangles in proptest::collection::vec(proptest::array::uniform3(0_u32..8), 0..50),
        is_paper in proptest::bool::ANY,
    ) {
        let soup = mesh(positions, triangles);
        let params = if is_paper { whole() } else { FlattenParams::default() };
        let result = flatten(&soup, &params).unwrap();
        check_each_triangle_once(&soup, &result.charts);
        for chart in &result.charts {
            for (triangle, corners) in chart.triangles.iter().zip(&chart.corners_m) {
                let manifold = Manifold::new(&soup).unwrap();
                if params.mode == ChartMode::Streaming && !manifold.is_reversed(*triangle) {
                    prop_assert!(distortion::doubled_area(corners) >= 0.0);
                }
            }
        }
    }
}

/// A plane with a steep bump in its middle: whole, the bump's top would shrink past the bound.
#[test]
fn a_bump_is_slit_not_split() {
    let side = 25;
    let bumpy = grid(side, side, false, |i, j| {
        let [x, y] = [i, j].map(|i| f64::from(i) / 12.0 - 1.0);
        [x, y, 1.5 * (-14.0 * (x * x + y * y)).exp()]
    });
    let params = FlattenParams {
        max_normal_deviation_rad: FRAC_PI_2,
        num_smoothing_rounds: 60,
        max_chart_triangles: 5000,
        ..Default::default()
    };
    let result = flatten(&bumpy, &params).unwrap();
    check_each_triangle_once(&bumpy, &result.charts);
    check_connected(&bumpy, &result.charts);
    assert_eq!(result.charts.len(), 1);
    assert!(result.report.solve.num_slits > 0);
    let distortion = result.charts[0].distortion;
    assert!(distortion.area_ratio_min > 0.1, "{distortion:?}");
}

fn check_connected(mesh: &TriMesh, charts: &[FlatChart]) {
    let manifold = Manifold::new(mesh).unwrap();
    let mut label = vec![u32::MAX; mesh.num_triangles()];
    for (c, chart) in (0_u32..).zip(charts) {
        for triangle in &chart.triangles {
            label[triangle.index()] = c;
        }
    }
    let (_, num_parts) =
        crate::mesh::components::components_within(manifold.mates(), |a, b| label[a] == label[b]);
    assert_eq!(num_parts as usize, charts.len());
}

#[test]
fn any_number_of_threads_gives_the_same_charts() {
    let surface = cap(40, 2.5, 0.01);
    let run = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new()
            .num_threads(threads)
            .build()
            .unwrap();
        pool.install(|| flatten(&surface, &FlattenParams::default()).unwrap().charts)
    };
    let one = run(1);
    assert!(one.len() > 3);
    assert_eq!(one, run(2));
    assert_eq!(one, run(4));
}

/// Binary little-endian PLY: float positions first in each vertex, uchar-counted int triangles.
fn read_ply(path: &str) -> Option<TriMesh> {
    let bytes = std::fs::read(path).ok()?;
    let end = bytes.windows(11).position(|w| w == b"end_header\n")? + 11;
    let header = std::str::from_utf8(&bytes[..end]).ok()?;
    let count = |name: &str| -> Option<usize> {
        let line = header.lines().find(|l| l.starts_with(name))?;
        line.rsplit(' ').next()?.parse().ok()
    };
    let (num_vertices, num_faces) = (count("element vertex")?, count("element face")?);
    let stride =
        4 * header.matches("property float").count() + header.matches("property uchar").count();
    let float = |at: usize| f64::from(f32::from_le_bytes(bytes[at..at + 4].try_into().unwrap()));
    let positions = (0..num_vertices)
        .map(|v| [0, 4, 8].map(|o| float(end + v * stride + o)))
        .collect();
    let faces = end + num_vertices * stride;
    let index = |at: usize| u32::from_le_bytes(bytes[at..at + 4].try_into().unwrap());
    let triangles = (0..num_faces)
        .map(|f| [1, 5, 9].map(|o| index(faces + 13 * f + o)))
        .collect();
    Some(mesh(positions, triangles))
}

#[expect(
    clippy::print_stderr,
    reason = "figures of a test run, and a skip that is heard"
)]
fn check_capture(name: &str) {
    let path = format!("{}/../shared/data/{name}", env!("CARGO_MANIFEST_DIR"));
    let Some(surface) = read_ply(&path) else {
        eprintln!("SKIPPED: no {path}");
        return;
    };
    let result = flatten(&surface, &FlattenParams::default()).unwrap();
    check_each_triangle_once(&surface, &result.charts);
    check_connected(&surface, &result.charts);
    let report = &result.report;
    eprintln!(
        "{name}: {} charts, {:.1} triangles each\n{report:#?}",
        report.num_charts,
        surface.num_triangles() as f64 / report.num_charts as f64
    );
    assert!(report.distortion.quasi_conformal_mean < 1.3);
    let area: f64 = surface.triangle_ids().map(|t| surface.area_m2(t)).sum();
    let flat: f64 = result
        .charts
        .iter()
        .flat_map(|c| &c.corners_m)
        .map(|c| 0.5 * distortion::doubled_area(c).abs())
        .sum();
    assert!((flat / area - 1.0).abs() < 0.01, "{flat} of {area} m²");
}

#[test]
fn apartment_capture() {
    check_capture("apt0_structure/mesh.ply");
}

#[test]
fn marker_board_capture() {
    check_capture("charuco_lidar/mesh.ply");
}

/// Whole components of the apartment: what cones change.
#[test]
#[ignore = "a measurement"]
#[expect(clippy::print_stdout, reason = "a measurement is there to be read")]
fn apartment_through_cones() {
    let Some(mesh) = read_ply("../shared/data/apt0_structure/mesh.ply") else {
        return;
    };
    for max_cones in [0, 100, 400] {
        let start = Instant::now();
        let params = FlattenParams {
            max_cones,
            ..whole()
        };
        let report = flatten(&mesh, &params).unwrap().report;
        println!(
            "{max_cones}: {:.2} s, {} charts, {} cones, seams {:.1} m, {:?}",
            start.elapsed().as_secs_f64(),
            report.num_charts,
            report.solve.num_cones,
            report.seam_length_m,
            report.distortion
        );
    }
}
