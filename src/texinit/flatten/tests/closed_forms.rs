//! Maps that are known: unrolling of developable surfaces, conformal maps of the plane, the
//! stereographic projection; and what holds of any surface: Gauss–Bonnet, a boundary that closes.

use std::f64::consts::PI;

use super::whole_components::{sphere, surface_of};
use super::*;
use crate::texinit::flatten::bff::{Curvature, Numbering};
use crate::texinit::flatten::cut::Surface;
use crate::texinit::flatten::{Boundary, DiskError, DiskMap, DiskSurface};

/// Place of each vertex of a mesh without seams.
fn points_of(mesh: &TriMesh, map: &DiskMap) -> Vec<[f64; 2]> {
    let mut points = vec![[f64::NAN; 2]; mesh.num_vertices()];
    for (corners, flat) in mesh.triangles().iter().zip(&map.corners_m) {
        for k in 0..3 {
            points[corners[k] as usize] = flat[k];
        }
    }
    points
}

/// Largest distance between two sets of points after the best rotation and shift (and scale, where
/// asked), as a share of their size.
fn misfit(points: &[[f64; 2]], expected: &[[f64; 2]], may_scale: bool) -> f64 {
    let mean = |points: &[[f64; 2]]| {
        let share = 1.0 / points.len() as f64;
        points.iter().fold([0.0; 2], |sum, p| {
            [sum[0] + share * p[0], sum[1] + share * p[1]]
        })
    };
    let (from, to) = (mean(points), mean(expected));
    // As complex numbers: Σ conj(p) q / Σ |p|² turns and scales p to q.
    let (mut re, mut im, mut norm, mut size) = (0.0, 0.0, 0.0, 0.0_f64);
    let pairs = || {
        points.iter().zip(expected).map(|(p, q)| {
            let (p, q) = (
                [p[0] - from[0], p[1] - from[1]],
                [q[0] - to[0], q[1] - to[1]],
            );
            (p, q)
        })
    };
    for (p, q) in pairs() {
        re += p[0] * q[0] + p[1] * q[1];
        im += p[0] * q[1] - p[1] * q[0];
        norm += p[0] * p[0] + p[1] * p[1];
        size = size.max(q[0].hypot(q[1]));
    }
    if !may_scale {
        norm = re.hypot(im);
    }
    let (re, im) = (re / norm, im / norm);
    let distance = |(p, q): ([f64; 2], [f64; 2])| {
        (re * p[0] - im * p[1] - q[0]).hypot(im * p[0] + re * p[1] - q[1])
    };
    pairs().map(distance).fold(0.0, f64::max) / size
}

/// A patch of a cone of half-angle `asin(slope)`: rulings are straight, so it unrolls to a sector.
#[test]
fn cones_and_cylinders_unroll_exactly() {
    let (slope, columns, rows) = (0.3_f64, 30_u32, 8_u32);
    let turn = |i: u32| 2.2 * PI * f64::from(i) / f64::from(columns - 1) * 0.8;
    let reach = |i: u32, j: u32| 0.5 + 0.2 * f64::from(j) + 0.03 * noise(i * 37 + j);
    let cone = grid(columns, rows, false, |i, j| {
        let (angle, slant) = (turn(i), reach(i, j));
        let height = (1.0 - slope * slope).sqrt() * slant;
        [
            slope * slant * angle.cos(),
            slope * slant * angle.sin(),
            height,
        ]
    });
    // Between two rulings the faces are flat: the angle there is that of their chord.
    let step = turn(1);
    let flat_step = 2.0 * (slope * (0.5 * step).sin()).asin();
    let sector: Vec<[f64; 2]> = (0..rows)
        .flat_map(|j| (0..columns).map(move |i| (i, j)))
        .map(|(i, j)| {
            let angle = -f64::from(i) * flat_step;
            [reach(i, j) * angle.cos(), reach(i, j) * angle.sin()]
        })
        .collect();
    let tube = grid(columns, rows, false, |i, j| {
        [turn(i).cos(), turn(i).sin(), reach(i, j)]
    });
    let chord = 2.0 * (0.5 * step).sin();
    let rectangle: Vec<[f64; 2]> = (0..rows)
        .flat_map(|j| (0..columns).map(move |i| (i, j)))
        .map(|(i, j)| [f64::from(i) * chord, reach(i, j)])
        .collect();
    for (mesh, expected) in [(cone, sector), (tube, rectangle)] {
        let map = DiskSurface::new(&mesh)
            .unwrap()
            .flatten(Boundary::Isometric)
            .unwrap();
        assert!(misfit(&points_of(&mesh, &map), &expected, false) < 1e-9);
        assert!(map.distortion.quasi_conformal_max < 1.0 + 1e-8);
        assert!((map.distortion.stretch_linf - 1.0).abs() < 1e-8);
        assert!(map.closure.gap < 1e-9, "{:?}", map.closure);
        let result = flatten(&mesh, &whole()).unwrap();
        assert!(worst_length_error(&mesh, &result.charts) < 1e-9);
    }
}

#[test]
fn a_flat_disk_is_only_moved() {
    let plane = noisy_plane(25);
    let map = DiskSurface::new(&plane)
        .unwrap()
        .flatten(Boundary::Isometric)
        .unwrap();
    let in_plane: Vec<[f64; 2]> = plane
        .positions_m()
        .iter()
        .map(|p| [p.x, p.z / 0.8])
        .collect();
    assert!(misfit(&points_of(&plane, &map), &in_plane, false) < 1e-9);
    assert!(map.log_scale.iter().all(|u| u.abs() < 1e-9));
}

/// A rectangle in the plane, [0, 1] × [0, 1.5], of even triangles.
fn rectangle(side: u32) -> TriMesh {
    grid(side, side, false, |i, j| {
        let [x, y] = [i, j].map(|i| f64::from(i) / f64::from(side - 1));
        [x, 1.5 * y, 0.0]
    })
}

fn exponential(mesh: &TriMesh) -> Vec<[f64; 2]> {
    let exp = |p: &Point3<f64>| [p.x.exp() * p.y.cos(), p.x.exp() * p.y.sin()];
    mesh.positions_m().iter().map(exp).collect()
}

/// The exponential map scales lengths by e^x: given that at the boundary, it is found.
#[test]
fn scale_factors_at_the_boundary_give_the_exponential_map() {
    let error = |side: u32| {
        let mesh = rectangle(side);
        let disk = DiskSurface::new(&mesh).unwrap();
        let scale: Vec<f64> = disk
            .boundary()
            .iter()
            .map(|&v| mesh.positions_m()[disk.mesh_vertices()[v as usize].unwrap() as usize].x)
            .collect();
        let map = disk.flatten(Boundary::LogScale(&scale)).unwrap();
        // u is harmonic, so it is x inside as well.
        for (u, v) in map.log_scale.iter().zip(disk.mesh_vertices()) {
            let x = mesh.positions_m()[v.unwrap() as usize].x;
            assert!((u - x).abs() < 1e-9, "{u} {x}");
        }
        misfit(&points_of(&mesh, &map), &exponential(&mesh), false)
    };
    let (coarse, fine) = (error(17), error(33));
    assert!(fine < 4e-3, "{fine}");
    assert!(fine < 0.6 * coarse, "{fine} {coarse}");
}

/// And given the angles that its image turns by: two arcs, two straight sides, four corners.
#[test]
fn angles_at_the_boundary_give_the_exponential_map() {
    let error = |side: u32| {
        let mesh = rectangle(side);
        let disk = DiskSurface::new(&mesh).unwrap();
        let step = 1.5 / f64::from(side - 1);
        let angle = |&v: &u32| {
            let p = mesh.positions_m()[disk.mesh_vertices()[v as usize].unwrap() as usize];
            let is_corner = |at: f64, end: f64| at == 0.0 || at == end;
            let arc = match p.x {
                0.0 => -step,
                1.0 => step,
                _ => 0.0,
            };
            if is_corner(p.x, 1.0) && is_corner(p.y, 1.5) {
                FRAC_PI_2 + 0.5 * arc
            } else {
                arc
            }
        };
        let angles: Vec<f64> = disk.boundary().iter().map(angle).collect();
        assert!((angles.iter().sum::<f64>() - TAU).abs() < 1e-9);
        let map = disk.flatten(Boundary::ExteriorAngles(&angles)).unwrap();
        misfit(&points_of(&mesh, &map), &exponential(&mesh), true)
    };
    let (coarse, fine) = (error(17), error(33));
    assert!(fine < 1e-2, "{fine}");
    assert!(fine < 0.7 * coarse, "{fine} {coarse}");
}

#[test]
fn one_scale_for_all_is_a_similarity() {
    let surface = cap(12, 1.1, 0.01);
    let disk = DiskSurface::new(&surface).unwrap();
    let plain = disk.flatten(Boundary::Isometric).unwrap();
    let twice = vec![2_f64.ln(); disk.boundary().len()];
    let twice = disk.flatten(Boundary::LogScale(&twice)).unwrap();
    for (a, b) in plain
        .corners_m
        .iter()
        .flatten()
        .zip(twice.corners_m.iter().flatten())
    {
        assert!((2.0 * a[0] - b[0]).abs() < 1e-9 && (2.0 * a[1] - b[1]).abs() < 1e-9);
    }
    let ratio = twice.distortion.area_ratio_max / plain.distortion.area_ratio_max;
    assert!((ratio - 4.0).abs() < 1e-9);
    assert!((twice.distortion.stretch_l2 - plain.distortion.stretch_l2).abs() < 1e-9);
}

/// The whole cap against the stereographic projection; the error falls as triangles do.
#[test]
fn caps_of_any_opening_are_projected_stereographically() {
    let error = |rings: u32, opening: f64| {
        let surface = cap(rings, opening, 0.0);
        let disk = DiskSurface::new(&surface).unwrap();
        let map = disk.flatten(Boundary::Isometric).unwrap();
        let expected: Vec<[f64; 2]> = surface
            .positions_m()
            .iter()
            .map(|p| {
                let scale = opening.sin() / (0.5 * opening).tan() / (1.0 + p.z);
                [scale * p.x, scale * p.y]
            })
            .collect();
        misfit(&points_of(&surface, &map), &expected, false)
    };
    for opening in [0.4, 1.0, 1.5, 2.0] {
        let (coarse, fine) = (error(10, opening), error(20, opening));
        assert!(fine < 0.02, "{opening}: {fine}");
        assert!(fine < 0.5 * coarse, "{opening}: {fine} {coarse}");
    }
}

/// Outsides of unit cubes.
fn cubes(cells: &[[i32; 3]]) -> TriMesh {
    let mut positions = Vec::new();
    let mut triangles = Vec::new();
    for cell in cells {
        for axis in 0..3 {
            for side in [0, 1] {
                let mut beside = *cell;
                beside[axis] += 2 * side - 1;
                if cells.contains(&beside) {
                    continue;
                }
                let first = positions.len() as u32;
                for [u, v] in [[0, 0], [1, 0], [1, 1], [0, 1]] {
                    let mut corner = *cell;
                    corner[axis] += side;
                    corner[(axis + 1) % 3] += u;
                    corner[(axis + 2) % 3] += v;
                    positions.push(corner.map(f64::from));
                }
                let [a, b, c, d] = [0, 1, 2, 3].map(|k| first + k);
                if side == 1 {
                    triangles.extend([[a, b, c], [a, c, d]]);
                } else {
                    triangles.extend([[a, c, b], [a, d, c]]);
                }
            }
        }
    }
    mesh(positions, triangles)
}

/// A plate with so many square holes through it, in a row: as many handles.
fn plate(num_holes: i32) -> TriMesh {
    let cells: Vec<[i32; 3]> = (0..2 * num_holes + 1)
        .flat_map(|x| (0..3).map(move |y| [x, y, 0]))
        .filter(|[x, y, _]| x % 2 == 0 || *y != 1)
        .collect();
    cubes(&cells)
}

fn without(mesh: &TriMesh, gone: &[usize]) -> TriMesh {
    let mut triangles = mesh.triangles().to_vec();
    let mut index = 0;
    triangles.retain(|_| {
        index += 1;
        !gone.contains(&(index - 1))
    });
    TriMesh::from_soup(mesh.positions_m().to_vec(), triangles)
        .unwrap()
        .0
}

/// Spheres, tori, a surface of two handles, with and without openings.
fn surfaces() -> Vec<(TriMesh, i64)> {
    let rough = sphere(3, |[x, y, z]| [1.3 * x, y + 0.1 * (5.0 * x).sin(), 0.8 * z]);
    let plane_with_holes = without(&noisy_plane(16), &[100, 101, 200, 333]);
    vec![
        (without(&rough, &[5]), 1),
        (without(&rough, &[5, 300, 400]), -1),
        (rough, 2),
        (without(&torus(), &[5]), -1),
        (torus(), 0),
        (without(&plate(2), &[0, 17]), -4),
        (plate(2), -2),
        (plane_with_holes, -2),
        (cap(8, 2.0, 0.02), 1),
        (noisy_plane(9), 1),
    ]
}

#[test]
fn curvature_sums_to_the_euler_characteristic() {
    for (mesh, euler) in surfaces() {
        let manifold = Manifold::new(&mesh).unwrap();
        let (vertices, num_vertices) = vertices_of_corners(manifold.mates());
        assert_eq!(euler_characteristic(num_vertices, manifold.mates()), euler);
        let corners = mesh
            .triangle_ids()
            .map(|t| manifold.oriented_corners_m(&mesh, t));
        let surface = Surface {
            num_real: mesh.num_triangles(),
            corners_m: corners.collect(),
            mates: manifold.mates().to_vec(),
            vertices,
            num_vertices: num_vertices as usize,
            num_filled_holes: 0,
        };
        let metric = Metric::new(&surface.corners_m).unwrap();
        let boundary = surface.boundary_vertices();
        let numbering = Numbering::pinning(surface.num_vertices, &boundary);
        let curvature = Curvature::new(&surface.vertices, &metric, &numbering);
        let total: f64 = curvature.interior.iter().chain(&curvature.boundary).sum();
        assert!((total - TAU * euler as f64).abs() < 1e-9, "{total} {euler}");
    }
}

/// Every kind of surface becomes a disk whose boundary closes: before the correction up to what
/// its triangles are too coarse for, after it to rounding.
#[test]
fn every_surface_is_flattened_and_its_boundary_closes() {
    for (mesh, euler) in surfaces() {
        let disk = DiskSurface::new(&mesh).unwrap();
        for boundary in [Boundary::Isometric, Boundary::Circle] {
            let map = match disk.flatten(boundary) {
                Ok(map) => map,
                Err(error) => panic!("euler {euler}, {boundary:?}: {error}"),
            };
            assert!(map.closure.corrected_gap <= 1e-12, "{:?}", map.closure);
            assert!(map.closure.gap < 0.2, "euler {euler}: {:?}", map.closure);
            assert!(
                map.corners_m
                    .iter()
                    .flatten()
                    .flatten()
                    .all(|c| c.is_finite())
            );
        }
        for params in [whole(), FlattenParams::default()] {
            let result = flatten(&mesh, &params).unwrap();
            check_each_triangle_once(&mesh, &result.charts);
        }
        let closed = surface_of(&mesh);
        assert!(closed.num_real == mesh.num_triangles());
    }
}

/// The uncorrected gap of a smooth surface vanishes with the square of the edge length.
#[test]
fn the_gap_of_the_boundary_vanishes_as_triangles_do() {
    let gap = |side: u32| {
        let hills = grid(side, side, false, |i, j| {
            let [x, y] = [i, j].map(|i| f64::from(i) / f64::from(side - 1));
            [x, y, 0.3 * (3.0 * x + y).sin() * (4.0 * y).cos()]
        });
        let disk = DiskSurface::new(&hills).unwrap();
        disk.flatten(Boundary::Isometric).unwrap().closure
    };
    let [coarse, middle, fine] = [20, 40, 80].map(gap);
    assert!(middle.gap < 0.6 * coarse.gap, "{coarse:?} {middle:?}");
    assert!(fine.gap < 0.6 * middle.gap, "{middle:?} {fine:?}");
    assert!(fine.gap < 1e-3, "{fine:?}");
    assert!(
        fine.corrected_gap <= 1e-12 && fine.max_correction < 0.02,
        "{fine:?}"
    );
}

#[test]
fn what_is_no_disk_or_has_no_map_is_refused() {
    let apart = mesh(
        (0..6)
            .map(|i| [f64::from(i), f64::from(i * i), 0.0])
            .collect(),
        vec![[0, 1, 2], [3, 4, 5]],
    );
    let error = DiskSurface::new(&apart).unwrap_err();
    assert_eq!(error, DiskError::NotConnected { num_pieces: 2 });
    assert!(DiskSurface::new(&TriMesh::default()).is_err());
    let disk = DiskSurface::new(&noisy_plane(4)).unwrap();
    let num_boundary = disk.boundary().len();
    assert_eq!(
        disk.flatten(Boundary::LogScale(&[0.0])).unwrap_err(),
        DiskError::WrongCount {
            num_given: 1,
            num_boundary
        }
    );
    let mut angles = vec![0.5; num_boundary];
    angles[3] = f64::NAN;
    assert!(matches!(
        disk.flatten(Boundary::ExteriorAngles(&angles)),
        Err(DiskError::NotFinite { index: 3, .. })
    ));
    // Twelve sides that turn by turns left and right never come back.
    let zigzag: Vec<f64> = (0..num_boundary)
        .map(|i| if i == 0 { TAU } else { 0.0 })
        .collect();
    assert!(matches!(
        disk.flatten(Boundary::ExteriorAngles(&zigzag)),
        Err(DiskError::Solve(bff::BffError::NotClosed { .. }))
    ));
}

/// Coordinates near the largest numbers have no finite lengths; a sphere with one small opening, all
/// of whose curvature its three sides must take, has no curve that closes. Both are split, counted,
/// and lose no triangle.
#[test]
fn what_cannot_be_solved_is_split_and_counted() {
    let huge = grid(9, 9, false, |i, j| {
        [1e200 * f64::from(i), 1e200 * f64::from(j), 0.0]
    });
    let crooked = sphere(3, |[x, y, z]| {
        let radius = 1.0 + 0.3 * (7.0 * x + 3.0 * z).sin() * (5.0 * y + 1.0).cos();
        [2.0 * radius * x, radius * y, 0.3 * radius * z]
    });
    let opened = (0..crooked.num_triangles()).find_map(|gone| {
        let opened = without(&crooked, &[gone]);
        let disk = DiskSurface::new(&opened).unwrap();
        let error = disk.flatten(Boundary::Isometric).err()?;
        matches!(error, DiskError::Solve(bff::BffError::NotClosed { .. })).then_some(opened)
    });
    for mesh in [huge, opened.unwrap()] {
        let result = flatten(&mesh, &whole()).unwrap();
        check_each_triangle_once(&mesh, &result.charts);
        assert!(result.report.solve.num_split_for_solver > 0);
        assert!(result.charts.len() > 1);
    }
}

/// The option of the stage: one component to one circle, and charts within their bounds.
#[test]
fn charts_become_circles_on_request() {
    let surface = cap(25, 1.2, 0.0);
    let disk_params = FlattenParams {
        boundary: ChartBoundary::Disk,
        ..whole()
    };
    let result = flatten(&surface, &disk_params).unwrap();
    assert_eq!(result.charts.len(), 1);
    let rim = surface.num_vertices() as u32 - 150;
    let mut center = [0.0; 2];
    let mut radii = Vec::new();
    for pass in 0..2 {
        for (corners, flat) in surface.triangles().iter().zip(&result.charts[0].corners_m) {
            for k in 0..3 {
                if pass == 0 && corners[k] == 0 {
                    center = flat[k];
                } else if pass == 1 && corners[k] >= rim {
                    radii.push((flat[k][0] - center[0]).hypot(flat[k][1] - center[1]));
                }
            }
        }
    }
    let area: f64 = surface.triangle_ids().map(|t| surface.area_m2(t)).sum();
    let expected = (area / PI).sqrt();
    assert!(radii.len() > 150);
    for radius in radii {
        assert!(
            (radius / expected - 1.0).abs() < 1e-2,
            "{radius} {expected}"
        );
    }

    // A long strip is bent out of all proportion by a circle: it is split until charts are short.
    let strip = grid(60, 6, false, |i, j| [f64::from(i), f64::from(j), 0.0]);
    let params = FlattenParams {
        boundary: ChartBoundary::Disk,
        ..FlattenParams::default()
    };
    let charts = flatten(&strip, &params).unwrap().charts;
    check_each_triangle_once(&strip, &charts);
    assert!(charts.len() > 5, "{}", charts.len());
    for chart in charts.iter().filter(|chart| chart.triangles.len() > 1) {
        assert!(chart.distortion.quasi_conformal_mean <= params.max_quasi_conformal_mean);
    }
}
