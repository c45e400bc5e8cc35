#![expect(
    clippy::cast_possible_truncation,
    reason = "the numbers of a test are small"
)]

use super::*;
use crate::mesh::TriangleId;
use nalgebra::{UnitQuaternion, Vector3};
use proptest::prelude::*;

pub(in crate::render) fn draw_view(
    mesh: &TriMesh,
    camera: &PinholeCamera,
    camera_from_world: &RigidTransform,
) -> ViewBuffer {
    let mut view = ViewBuffer::default();
    rasterize(
        mesh,
        camera,
        camera_from_world,
        &mut RasterWorkspace::default(),
        &mut view,
    );
    view
}

pub(in crate::render) fn mesh_of(positions: Vec<[f64; 3]>, triangles: Vec<[u32; 3]>) -> TriMesh {
    let positions = positions.into_iter().map(Point3::from).collect();
    TriMesh::from_soup(positions, triangles).unwrap().0
}

fn camera() -> PinholeCamera {
    PinholeCamera::new([90.0, 95.0, 48.3, 35.1], 96, 72).unwrap()
}

/// All hits of a ray, by Möller and Trumbore, in f64: (depth along z, triangle, smallest
/// barycentric weight).
fn intersect_all(
    mesh: &TriMesh,
    pose: &RigidTransform,
    ray: &Vector3<f64>,
) -> Vec<(f64, u32, f64)> {
    let mut hits = vec![];
    for id in mesh.triangle_ids() {
        let [a, b, c] = mesh.corners_m(id).map(|p| pose.transform_point(&p));
        let (ab, ac) = (b - a, c - a);
        let p = ray.cross(&ac);
        let det = ab.dot(&p);
        if det.abs() < 1e-14 {
            continue;
        }
        let s = -a.coords;
        let u = s.dot(&p) / det;
        let q = s.cross(&ab);
        let v = ray.dot(&q) / det;
        let depth_m = ac.dot(&q) / det;
        if depth_m >= NEAR_M {
            hits.push((depth_m, id.0, u.min(v).min(1.0 - u - v)));
        }
    }
    hits
}

/// Distance in pixels from a pixel to the nearest projected edge that is in front.
fn distance_to_edges_px(
    mesh: &TriMesh,
    camera: &PinholeCamera,
    pose: &RigidTransform,
    [x, y]: [f64; 2],
) -> f64 {
    let mut nearest = f64::INFINITY;
    for id in mesh.triangle_ids() {
        let corners = mesh.corners_m(id).map(|p| pose.transform_point(&p));
        for i in 0..3 {
            let (mut a, mut b) = (corners[i], corners[(i + 1) % 3]);
            if a.z < b.z {
                std::mem::swap(&mut a, &mut b);
            }
            if a.z <= NEAR_M {
                continue;
            }
            if b.z < NEAR_M {
                b = a + (b - a) * ((a.z - NEAR_M) / (a.z - b.z));
            }
            let project = |p: &Point3<f64>| nalgebra::Vector2::from(camera.project(p).unwrap());
            let (p, q) = (project(&a), project(&b));
            let pixel = nalgebra::Vector2::new(x, y);
            let t = ((pixel - p).dot(&(q - p)) / (q - p).norm_squared().max(1e-30)).clamp(0.0, 1.0);
            nearest = nearest.min((p + (q - p) * t - pixel).norm());
        }
    }
    nearest
}

pub(in crate::render) fn random_scene(seed: u64, num_triangles: usize, spread: f64) -> TriMesh {
    let mut state = seed.wrapping_mul(0x9E37_79B9_7F4A_7C15) | 1;
    let mut next = || {
        state ^= state << 13;
        state ^= state >> 7;
        state ^= state << 17;
        (state >> 11) as f64 / (1u64 << 53) as f64
    };
    let mut positions = vec![];
    let mut triangles = vec![];
    for i in 0..num_triangles {
        let center = [next() * 4.0 - 2.0, next() * 4.0 - 2.0, next() * 5.0 - 0.5];
        for _ in 0..3 {
            positions.push(center.map(|c| c + (next() - 0.5) * spread));
        }
        let first = (3 * i) as u32;
        triangles.push([first, first + 1, first + 2]);
    }
    mesh_of(positions, triangles)
}

#[test]
fn ids_and_depths_agree_with_ray_casting_away_from_edges() {
    let camera = camera();
    for seed in 1..5 {
        let mesh = random_scene(seed, 60, [0.3, 1.5, 4.0, 12.0][seed as usize - 1]);
        let pose = RigidTransform::from_parts(
            UnitQuaternion::from_euler_angles(0.1, -0.2, 0.3 * seed as f64),
            Vector3::new(0.1, -0.1, 0.4),
        );
        let view = draw_view(&mesh, &camera, &pose);
        let mut num_checked = 0;
        for y in 0..camera.height() {
            for x in 0..camera.width() {
                let pixel = [f64::from(x), f64::from(y)];
                if distance_to_edges_px(&mesh, &camera, &pose, pixel) < 0.02 {
                    continue;
                }
                let mut hits: Vec<_> = intersect_all(&mesh, &pose, &camera.ray(pixel[0], pixel[1]))
                    .into_iter()
                    .filter(|hit| hit.2 >= 0.0)
                    .collect();
                hits.sort_by(|a, b| a.0.total_cmp(&b.0));
                let index = (y * camera.width() + x) as usize;
                num_checked += 1;
                let Some(&(depth_m, id, _)) = hits.first() else {
                    assert_eq!(
                        view.triangle[index], NO_TRIANGLE,
                        "seed {seed} at {pixel:?}"
                    );
                    assert_eq!(view.depth_m[index], 0.0);
                    continue;
                };
                // Snapping moves depth by 1/512 px of slope; steep triangles feel it.
                let tolerance_m = 0.02 * depth_m;
                let rival = hits.get(1).is_some_and(|h| h.0 < depth_m + tolerance_m);
                if !rival {
                    assert_eq!(
                        view.triangle[index], id,
                        "seed {seed} at {pixel:?}: {hits:?}"
                    );
                    assert!((f64::from(view.depth_m[index]) - depth_m).abs() < tolerance_m);
                }
            }
        }
        assert!(
            num_checked > 5000,
            "only {num_checked} pixels are away from edges"
        );
    }
}

#[test]
fn depth_of_a_slanted_plane_is_analytic() {
    let camera = camera();
    // z = 2 + 0.5 x − 0.3 y, spanned far beyond the view.
    let z = |x: f64, y: f64| 2.0 + 0.5 * x - 0.3 * y;
    let corners = [[-3.0, -3.0], [3.0, -3.0], [3.0, 3.0], [-3.0, 3.0]];
    let mesh = mesh_of(
        corners.map(|[x, y]| [x, y, z(x, y)]).to_vec(),
        vec![[0, 1, 2], [0, 3, 2]],
    );
    let view = draw_view(&mesh, &camera, &RigidTransform::identity());
    for y in 0..72u32 {
        for x in 0..96u32 {
            let ray = camera.ray(f64::from(x), f64::from(y));
            let expected = 2.0 / (1.0 - 0.5 * ray.x + 0.3 * ray.y);
            let index = (y * 96 + x) as usize;
            assert_ne!(view.triangle[index], NO_TRIANGLE);
            let error = (f64::from(view.depth_m[index]) - expected).abs();
            assert!(error < 1e-4, "{error} m at {x}, {y}");
        }
    }
}

#[test]
fn triangles_around_a_vertex_tile_the_view_without_gaps() {
    let camera = camera();
    let mut positions = vec![[0.013, -0.021, 1.0]];
    let mut triangles = vec![];
    for i in 0..37u32 {
        let angle = f64::from(i) / 37.0 * std::f64::consts::TAU;
        positions.push([
            5.0 * angle.cos(),
            5.0 * angle.sin(),
            1.0 + 0.2 * f64::from(i % 3),
        ]);
        triangles.push([0, i + 1, (i + 1) % 37 + 1]);
    }
    let view = draw_view(
        &mesh_of(positions, triangles),
        &camera,
        &RigidTransform::identity(),
    );
    assert!(view.triangle.iter().all(|&t| t != NO_TRIANGLE));
}

#[test]
fn equal_depths_go_to_the_lowest_id_whatever_the_corner_order() {
    let positions = vec![[-1.0, -1.0, 2.0], [1.0, -0.9, 2.5], [0.2, 1.0, 3.0]];
    let orders = [[2, 1, 0], [0, 1, 2], [1, 2, 0], [2, 0, 1]];
    let view = draw_view(
        &mesh_of(positions, orders.to_vec()),
        &camera(),
        &RigidTransform::identity(),
    );
    assert!(view.triangle.contains(&0));
    assert!(view.triangle.iter().all(|&t| t == 0 || t == NO_TRIANGLE));
}

#[test]
fn a_floor_through_the_camera_plane_is_clipped_at_the_near_plane() {
    let camera = camera();
    let mesh = mesh_of(
        vec![[-50.0, 1.0, -50.0], [50.0, 1.0, -50.0], [0.0, 1.0, 80.0]],
        vec![[0, 1, 2]],
    );
    let view = draw_view(&mesh, &camera, &RigidTransform::identity());
    for y in 0..72u32 {
        let ray = camera.ray(48.0, f64::from(y));
        let index = (y * 96 + 48) as usize;
        let expected = 1.0 / ray.y;
        if ray.y > 0.02 {
            let relative = (f64::from(view.depth_m[index]) - expected).abs() / expected;
            assert!(relative < 2e-3, "{relative} in row {y}");
        } else if ray.y < 0.0 {
            assert_eq!(view.triangle[index], NO_TRIANGLE);
        }
    }
}

#[test]
fn barycentrics_of_a_ray_return_its_point() {
    let corners = [[-1.0, -1.0, 2.0], [2.0, -1.0, 3.0], [0.0, 2.0, 5.0]].map(Point3::from);
    let expected = [0.2, 0.5, 0.3];
    let point = corners[0].coords * 0.2 + corners[1].coords * 0.5 + corners[2].coords * 0.3;
    let weights = barycentric(&corners, &(point / point.z)).unwrap();
    for (weight, expected) in weights.iter().zip(expected) {
        assert!((weight - expected).abs() < 1e-12);
    }
    let flat = [Point3::origin(); 3];
    assert_eq!(barycentric(&flat, &Vector3::z()), None);
}

proptest! {
    #[test]
    fn no_mesh_makes_it_panic(
        coordinates in prop::collection::vec(
            prop_oneof![
                -2.0..2.0f64,
                -1e-9..1e-9f64,
                -1e9..1e9f64,
                Just(0.0), Just(NEAR_M), Just(1e300), Just(-1e300), Just(f64::MAX), Just(1e-300),
            ], 9..60),
        order in prop::collection::vec(0usize..1000, 3..30),
    ) {
        let positions: Vec<[f64; 3]> =
            coordinates.chunks_exact(3).map(|c| [c[0], c[1], c[2]]).collect();
        let num = positions.len();
        let triangles = order.chunks_exact(3)
            .map(|c| [c[0], c[1], c[2]].map(|i| (i % num) as u32)).collect();
        let mesh = mesh_of(positions, triangles);
        let view = draw_view(&mesh, &camera(), &RigidTransform::identity());
        for (&id, &depth_m) in view.triangle.iter().zip(&view.depth_m) {
            prop_assert_eq!(id == NO_TRIANGLE, depth_m == 0.0);
            prop_assert!(depth_m == 0.0 || f64::from(depth_m) >= NEAR_M * 0.999);
            if id != NO_TRIANGLE {
                let far = mesh.corners_m(TriangleId(id)).iter().map(|p| p.z).fold(0.0, f64::max);
                prop_assert!(f64::from(depth_m) <= far * 1.001 + 1e-6);
            }
        }
    }
}
