//! Cones, cuts through them and boundary conditions, against closed forms and conservation laws.

use std::f64::consts::PI;

use super::*;
use crate::texinit::flatten::bff::{Curvature, Numbering};
use crate::texinit::flatten::cones::{Cones, place_cones};
use crate::texinit::flatten::cut::Surface;

fn with_cones() -> FlattenParams {
    FlattenParams {
        mode: ChartMode::Paper,
        ..Default::default()
    }
}

/// An octahedron's faces split in four `rounds` times, on the unit sphere.
pub(super) fn sphere(rounds: u32, place: impl Fn([f64; 3]) -> [f64; 3]) -> TriMesh {
    let coarse = octahedron();
    let mut triangles: Vec<[[f64; 3]; 3]> = coarse
        .triangle_ids()
        .map(|t| coarse.corners_m(t).map(|p| [p.x, p.y, p.z]))
        .collect();
    let middle = |a: [f64; 3], b: [f64; 3]| {
        let sum = [a[0] + b[0], a[1] + b[1], a[2] + b[2]];
        let norm = sum.iter().map(|c| c * c).sum::<f64>().sqrt();
        sum.map(|c| c / norm)
    };
    for _ in 0..rounds {
        triangles = triangles
            .into_iter()
            .flat_map(|[a, b, c]| {
                let [ab, bc, ca] = [middle(a, b), middle(b, c), middle(c, a)];
                [[a, ab, ca], [ab, b, bc], [ca, bc, c], [ab, bc, ca]]
            })
            .collect();
    }
    let positions = triangles.iter().flatten().map(|&p| place(p)).collect();
    let indices = (0..triangles.len() as u32).map(|t| [3 * t, 3 * t + 1, 3 * t + 2]);
    mesh(positions, indices.collect())
}

pub(super) fn surface_of(mesh: &TriMesh) -> Surface {
    let manifold = Manifold::new(mesh).unwrap();
    let corners = mesh
        .triangle_ids()
        .map(|t| manifold.oriented_corners_m(mesh, t))
        .collect();
    Surface::filled(corners, manifold.mates().to_vec())
}

/// Curvature that scaling by e^u leaves at each vertex: Ω + A u inside, k + A u at the boundary.
fn remaining_curvature(surface: &Surface, log_scale: &[f64]) -> Vec<f64> {
    let metric = Metric::new(&surface.corners_m).unwrap();
    let boundary = surface.boundary_vertices();
    let numbering = Numbering::pinning(surface.num_vertices, &boundary);
    let curvature = Curvature::new(&surface.vertices, &metric, &numbering);
    let given = |vertex: usize| {
        let place = numbering.places()[vertex] as usize;
        let at_boundary = place.checked_sub(numbering.num_interior());
        at_boundary.map_or_else(|| curvature.interior[place], |i| curvature.boundary[i])
    };
    let mut remaining: Vec<f64> = (0..surface.num_vertices).map(given).collect();
    for (a, b, weight) in edge_weights(&surface.mates, &surface.vertices, &metric) {
        let (a, b) = (a as usize, b as usize);
        let flux = weight * (log_scale[a] - log_scale[b]);
        remaining[a] += flux;
        remaining[b] -= flux;
    }
    remaining
}

/// All curvature sits at cones and boundary, and sums to 2πχ.
fn check_cones(surface: &Surface, cones: &Cones, euler: f64) {
    let boundary = surface.boundary_vertices();
    let remaining = remaining_curvature(surface, &cones.log_scale);
    let mut total = 0.0;
    for (vertex, remaining) in remaining.iter().enumerate() {
        if cones.vertices.contains(&vertex) || boundary.contains(&vertex) {
            assert!(cones.log_scale[vertex].abs() < 1e-12);
            total += remaining;
        } else {
            assert!(remaining.abs() < 1e-8, "{remaining} at {vertex}");
            assert!(cones.log_scale[vertex].abs() <= 0.2 || cones.vertices.len() == 100);
        }
    }
    assert!((total - TAU * euler).abs() < 1e-7, "{total}");
}

#[test]
fn cones_take_all_the_curvature() {
    let egg = sphere(4, |[x, y, z]| [1.6 * x, y, 0.7 * z]);
    for (mesh, euler) in [(egg, 2.0), (torus(), 0.0), (cap(30, 2.6, 0.0), 1.0)] {
        let surface = surface_of(&mesh);
        let cones = place_cones(&surface, 100).unwrap();
        assert!(!cones.vertices.is_empty());
        check_cones(&surface, &cones, euler);
    }
}

#[test]
fn at_most_so_many_cones_are_placed_and_none_twice() {
    let surface = surface_of(&sphere(4, |p| p));
    for max in [1, 4, 9] {
        let mut vertices = place_cones(&surface, max).unwrap().vertices;
        assert_eq!(vertices.len(), max);
        vertices.sort_unstable();
        vertices.dedup();
        assert_eq!(vertices.len(), max);
    }
}

/// A flat torus is not flat in space, but its tube, cut at both ends, is developable: no cones.
#[test]
fn a_developable_surface_gets_no_cone() {
    let tube = grid(40, 10, true, |i, j| {
        let turn = TAU * f64::from(i) / 40.0;
        [turn.cos(), turn.sin(), 4.0 * f64::from(j)]
    });
    let manifold = Manifold::new(&tube).unwrap();
    let corners = tube
        .triangle_ids()
        .map(|t| manifold.oriented_corners_m(&tube, t));
    let (vertices, num_vertices) = vertices_of_corners(manifold.mates());
    let open = Surface {
        num_real: tube.num_triangles(),
        corners_m: corners.collect(),
        mates: manifold.mates().to_vec(),
        vertices,
        num_vertices: num_vertices as usize,
        num_filled_holes: 0,
    };
    let cones = place_cones(&open, 100).unwrap();
    assert_eq!(cones.vertices, Vec::<usize>::new());
    let disk = open.cut_open(&cones.vertices).unwrap();
    let flat = flatten_disk(&disk, Boundary::Isometric).unwrap().points_m;
    for (corners, vertices) in disk.corners_m.iter().zip(&disk.vertices) {
        for k in 0..3 {
            let [a, b] = [vertices[k], vertices[(k + 1) % 3]].map(|v| flat[v as usize]);
            let length = (corners[(k + 1) % 3] - corners[k]).norm();
            assert!(((a[0] - b[0]).hypot(a[1] - b[1]) - length).abs() < 1e-6 * length);
        }
    }
}

/// Closed surfaces of genus 0, 1 and 2: a disk each, every cone on its boundary, both sides of the
/// cut of one length, and lengths nearly kept where cones are many.
#[test]
fn whole_components_flatten_through_their_cones() {
    let bumpy = sphere(4, |[x, y, z]| {
        let radius = 1.0 + 0.2 * (3.0 * x).sin() * (2.0 * y).cos();
        [radius * x, radius * y, radius * z]
    });
    for mesh in [sphere(4, |p| p), bumpy, torus()] {
        let surface = surface_of(&mesh);
        let cones = place_cones(&surface, 100).unwrap();
        let disk = surface.cut_open(&cones.vertices).unwrap();
        let (_, num_vertices) = vertices_of_corners(&disk.mates);
        assert_eq!(euler_characteristic(num_vertices, &disk.mates), 1);
        let place_on = |h: u32| surface.vertices[h as usize / 3][h as usize % 3] as usize;
        let on_boundary: Vec<usize> = disk.boundary.iter().map(|&h| place_on(h)).collect();
        assert!(cones.vertices.iter().all(|cone| on_boundary.contains(cone)));

        let scale: Vec<f64> = on_boundary.iter().map(|&v| cones.log_scale[v]).collect();
        let flat = flatten_disk(&disk, Boundary::LogScale(&scale))
            .unwrap()
            .points_m;
        let side = |h: u32| {
            let corners = disk.vertices[h as usize / 3];
            let k = h as usize % 3;
            let [a, b] = [corners[k], corners[(k + 1) % 3]].map(|v| flat[v as usize]);
            (a[0] - b[0]).hypot(a[1] - b[1])
        };
        let mut worst: f64 = 1.0;
        for &h in &disk.boundary {
            let mate = surface.mates[h as usize];
            let ratio = side(h) / side(mate);
            worst = worst.max(ratio).max(1.0 / ratio);
        }
        assert!(worst < 1.2, "sides of the cut differ by {worst}");

        let result = flatten(&mesh, &with_cones()).unwrap();
        check_each_triangle_once(&mesh, &result.charts);
        assert!(result.report.solve.num_cones > 0);
        let plain = flatten(&mesh, &whole()).unwrap().report.distortion;
        let coned = result.report.distortion;
        assert!(coned.quasi_conformal_mean < 1.1, "{coned:?}");
        let spread = |d: ChartDistortion| d.area_ratio_max / d.area_ratio_min;
        assert!(spread(coned) < 0.5 * spread(plain), "{coned:?} {plain:?}");
    }
}

#[test]
fn loops_are_filled_as_the_published_program_does() {
    // A square with a hole: the outer loop stays. A sphere with a small opening: it counts as
    // closed. A torus with one: it is filled.
    let loops_left = |mesh: &TriMesh| boundary_loops(&surface_of(mesh).mates).len();
    let without = |mesh: TriMesh, gone: &[usize]| {
        let (positions, mut triangles) = (mesh.positions_m().to_vec(), mesh.triangles().to_vec());
        let mut index = 0;
        triangles.retain(|_| {
            index += 1;
            !gone.contains(&(index - 1))
        });
        TriMesh::from_soup(positions, triangles).unwrap().0
    };
    assert_eq!(loops_left(&without(noisy_plane(9), &[60])), 1);
    assert_eq!(loops_left(&noisy_plane(9)), 1);
    assert_eq!(loops_left(&without(sphere(3, |p| p), &[5])), 0);
    assert_eq!(loops_left(&without(torus(), &[5, 200])), 0);
    let filled = surface_of(&without(torus(), &[5, 200]));
    assert_eq!(filled.num_filled_holes, 2);
    assert_eq!(filled.num_real, torus().num_triangles() - 2);
}

/// Unit circle and stereographic projection: radius tan(polar / 2) / tan(opening / 2).
#[test]
fn a_cap_becomes_a_round_disk_on_request() {
    let opening = 1.3_f64;
    let surface = cap(40, opening, 0.0);
    let (disk, _) = flat_disk(&surface);
    let flat = flatten_disk(&disk, Boundary::Circle).unwrap().points_m;
    let mut points = vec![[f64::NAN; 2]; surface.num_vertices()];
    for (local, global) in disk.vertices.iter().zip(surface.triangles()) {
        for k in 0..3 {
            points[global[k] as usize] = flat[local[k] as usize];
        }
    }
    let radius = |p: [f64; 2]| (p[0] - points[0][0]).hypot(p[1] - points[0][1]);
    let rim = radius(points[points.len() - 1]);
    let around = 240;
    for ring in [5, 20, 33, 40] {
        let polar = opening * ring as f64 / 40.0;
        let expected = (0.5 * polar).tan() / (0.5 * opening).tan();
        for i in (0..around).step_by(17) {
            let actual = radius(points[1 + (ring - 1) * around + i]) / rim;
            assert!(
                (actual / expected - 1.0).abs() < 6e-3,
                "{actual} {expected}"
            );
        }
    }
}

/// The boundary turns by the angles asked for: an oval's.
#[test]
fn the_boundary_turns_as_asked() {
    let (disk, _) = flat_disk(&cap(30, 1.2, 0.0));
    let num = disk.boundary.len();
    let share = |i: usize| 1.0 + 0.5 * (2.0 * TAU * i as f64 / num as f64).cos();
    let angles: Vec<f64> = (0..num).map(|i| TAU / num as f64 * share(i)).collect();
    let flat = flatten_disk(&disk, Boundary::ExteriorAngles(&angles)).unwrap();
    let at = |i: usize| {
        let h = disk.boundary[i % num];
        flat.points_m[disk.vertices[h as usize / 3][h as usize % 3] as usize]
    };
    let heading = |i: usize| {
        let (from, to) = (at(i), at(i + 1));
        (to[1] - from[1]).atan2(to[0] - from[0])
    };
    let mut expected = heading(0);
    for (i, angle) in angles.iter().enumerate().skip(1) {
        expected += angle;
        let off = (heading(i) - expected + PI).rem_euclid(TAU) - PI;
        assert!(off.abs() < 1e-9, "edge {i} is {off} rad off");
    }
}
