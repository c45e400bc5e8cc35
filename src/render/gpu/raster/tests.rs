use super::*;
use crate::render::gpu::tests::device;
use crate::render::part::MeshRuns;
use crate::render::raster::tests::{draw_view, mesh_of, random_scene};
use nalgebra::{UnitQuaternion, Vector3};
use proptest::prelude::*;

/// Both pictures of a view, and how they differ.
struct Compared {
    cpu: ViewBuffer,
    gpu: ViewBuffer,
    num_covered: usize,
    differing: Vec<[u32; 2]>,
    /// Largest difference of depth where the ids are equal, relative.
    max_depth_error: f32,
}

fn compare(
    gpu: &GpuRasterizer,
    mesh: &TriMesh,
    camera: &PinholeCamera,
    pose: &RigidTransform,
) -> Compared {
    let mut on_gpu = ViewBuffer::default();
    let part = MeshRuns::new(mesh).in_view(camera, pose, f64::INFINITY);
    let mut loaded = gpu.load(mesh).unwrap();
    loaded
        .rasterize(mesh, &part, camera, pose, &mut on_gpu)
        .unwrap();
    compare_views(draw_view(mesh, camera, pose), on_gpu)
}

fn compare_views(cpu: ViewBuffer, gpu: ViewBuffer) -> Compared {
    assert_eq!((cpu.width, cpu.height), (gpu.width, gpu.height));
    assert_eq!(cpu.triangle.len(), gpu.triangle.len());
    assert_eq!(cpu.triangle.len(), gpu.depth_m.len());
    let mut compared = Compared {
        num_covered: cpu.triangle.iter().filter(|&&t| t != NO_TRIANGLE).count(),
        differing: vec![],
        max_depth_error: 0.0,
        cpu,
        gpu,
    };
    let (cpu, gpu) = (&compared.cpu, &compared.gpu);
    for index in 0..cpu.triangle.len() {
        if cpu.triangle[index] == gpu.triangle[index] {
            let (expected, found) = (cpu.depth_m[index], gpu.depth_m[index]);
            let error = (found - expected).abs() / expected.max(1e-6);
            assert!(error.is_finite(), "{found} for {expected}");
            compared.max_depth_error = compared.max_depth_error.max(error);
        } else {
            let index = u32::try_from(index).unwrap();
            compared
                .differing
                .push([index % cpu.width, index / cpu.width]);
        }
    }
    compared
}

impl Compared {
    /// Whether another triangle, or nothing, is within one pixel in the CPU's picture.
    fn is_at_edge(&self, [x, y]: [u32; 2]) -> bool {
        let view = &self.cpu;
        let id = |x: u32, y: u32| view.triangle[(y * view.width + x) as usize];
        let around = |v: u32, size: u32| v.saturating_sub(1)..=(v + 1).min(size - 1);
        around(y, view.height)
            .any(|row| around(x, view.width).any(|column| id(column, row) != id(x, y)))
    }

    /// Whether the triangles of a pixel that differs have the same depth there, nearly.
    fn is_nearly_tied(&self, [x, y]: [u32; 2]) -> bool {
        let index = (y * self.cpu.width + x) as usize;
        let (a, b) = (self.cpu.depth_m[index], self.gpu.depth_m[index]);
        (a - b).abs() <= 1e-5 * a.min(b)
    }

    fn assert_equal_but_for_edges(&self, max_differing_share: f64, what: &str) {
        let share = self.differing.len() as f64 / self.num_covered.max(1) as f64;
        assert!(
            share <= max_differing_share,
            "{what}: {} of {} covered pixels differ",
            self.differing.len(),
            self.num_covered
        );
        for &pixel in &self.differing {
            assert!(
                self.is_at_edge(pixel) || self.is_nearly_tied(pixel),
                "{what}: {pixel:?} is not at an edge"
            );
        }
        let error = self.max_depth_error;
        assert!(error <= 1e-4, "{what}: depths differ by {error}");
    }
}

fn rasterizer() -> Option<GpuRasterizer> {
    device().map(|device| GpuRasterizer::new(device).unwrap())
}

fn camera() -> PinholeCamera {
    PinholeCamera::new([190.0, 195.0, 98.3, 70.1], 200, 150).unwrap()
}

fn turned(angles: [f64; 3], translation: [f64; 3]) -> RigidTransform {
    RigidTransform::from_parts(
        UnitQuaternion::from_euler_angles(angles[0], angles[1], angles[2]),
        Vector3::from(translation),
    )
}

/// A bumpy wall of `side`² squares, 2 m wide, 2 m ahead, `away_m` from the world's origin.
fn wall(side: u32, away_m: f64) -> TriMesh {
    let mut positions = vec![];
    let mut triangles = vec![];
    for row in 0..=side {
        for column in 0..=side {
            let [u, v] = [column, row].map(|i| f64::from(i) / f64::from(side) * 2.0 - 1.0);
            let bump = 0.1 * (7.0 * u).sin() * (5.0 * v).cos();
            positions.push([u + away_m, v, 2.0 + bump]);
            if row < side && column < side {
                let first = row * (side + 1) + column;
                let below = first + side + 1;
                triangles.push([first, first + 1, below]);
                triangles.push([first + 1, below + 1, below]);
            }
        }
    }
    mesh_of(positions, triangles)
}

#[test]
fn random_triangles_are_drawn_as_on_the_cpu() {
    let Some(gpu) = rasterizer() else { return };
    for (seed, spread) in (1u32..).zip([0.3, 1.5, 4.0, 12.0, 40.0]) {
        let mesh = random_scene(u64::from(seed), 200, spread);
        let pose = turned([0.1, -0.2, 0.3 * f64::from(seed)], [0.1, -0.1, 0.4]);
        let compared = compare(&gpu, &mesh, &camera(), &pose);
        assert!(compared.num_covered > 500, "{}", compared.num_covered);
        compared.assert_equal_but_for_edges(1e-3, &format!("spread {spread} m"));
    }
}

#[test]
fn a_fine_mesh_is_drawn_as_on_the_cpu_near_and_far_from_the_origin() {
    let Some(gpu) = rasterizer() else { return };
    for away_m in [0.0, 1e3, 1e7] {
        let mesh = wall(150, away_m);
        let pose = turned([0.05, 0.3, -0.2], [0.0; 3])
            * RigidTransform::from_parts(
                UnitQuaternion::identity(),
                Vector3::new(-away_m, 0.0, 0.0),
            );
        let compared = compare(&gpu, &mesh, &camera(), &pose);
        assert!(compared.num_covered > 10_000, "{}", compared.num_covered);
        compared.assert_equal_but_for_edges(1e-3, &format!("{away_m} m away"));
    }
}

#[test]
fn triangles_through_the_near_plane_are_drawn_as_on_the_cpu() {
    let Some(gpu) = rasterizer() else { return };
    // A floor 1 km wide, below and behind the camera too, and a sliver through the lens.
    let mesh = mesh_of(
        vec![
            [-500.0, 1.0, -500.0],
            [500.0, 1.0, -450.0],
            [500.0, 1.0, 500.0],
            [-500.0, 1.0, 450.0],
            [-1.0, -1.0, NEAR],
            [0.0, -1.0, 0.02],
            [3.0, 1.0, 3.0],
        ],
        vec![[0, 1, 2], [0, 2, 3], [4, 5, 6]],
    );
    for yaw in [-0.785, -0.6, -0.9] {
        let pose = turned([0.5, yaw, 0.0], [0.0; 3]);
        let compared = compare(&gpu, &mesh, &camera(), &pose);
        assert!(compared.num_covered > 10_000);
        for id in 0..3 {
            assert!(compared.cpu.triangle.contains(&id), "{id} at {yaw}");
        }
        compared.assert_equal_but_for_edges(1e-3, &format!("yaw {yaw}"));
    }
}

const NEAR: f64 = crate::render::raster::NEAR_M;

#[test]
fn of_coincident_triangles_the_lowest_id_is_kept_whichever_way_they_face() {
    let Some(gpu) = rasterizer() else { return };
    let single = wall(20, 0.0);
    let mut triangles = vec![];
    for &[a, b, c] in single.triangles() {
        triangles.extend([[b, c, a], [c, b, a], [a, b, c]]);
    }
    let mesh = TriMesh::from_soup(single.positions_m().to_vec(), triangles)
        .unwrap()
        .0;
    let compared = compare(&gpu, &mesh, &camera(), &turned([0.2, 0.1, 0.1], [0.0; 3]));
    assert!(compared.num_covered > 10_000);
    compared.assert_equal_but_for_edges(1e-3, "triples");
    let seen = compared.gpu.triangle.iter().filter(|&&t| t != NO_TRIANGLE);
    assert_eq!(seen.filter(|&&t| t % 3 != 0).count(), 0);
}

#[test]
fn a_loaded_mesh_draws_any_sequence_of_views_and_sizes() {
    let Some(gpu) = rasterizer() else { return };
    let meshes = [wall(30, 0.0), random_scene(9, 300, 2.0), TriMesh::default()];
    let mut loaded: Vec<_> = meshes.iter().map(|mesh| gpu.load(mesh).unwrap()).collect();
    let sizes = [[200, 150], [1, 1], [320, 80], [200, 150], [33, 65]];
    for (step, [width, height]) in (0u32..).zip(sizes) {
        let camera = camera().resized(width, height).unwrap();
        let pose = turned([0.1 * f64::from(step), 0.0, 0.5], [0.0, 0.0, 0.3]);
        for (mesh, loaded) in meshes.iter().zip(&mut loaded) {
            let part = MeshRuns::new(mesh).in_view(&camera, &pose, f64::INFINITY);
            let mut view = ViewBuffer::default();
            loaded
                .rasterize(mesh, &part, &camera, &pose, &mut view)
                .unwrap();
            let compared = compare_views(draw_view(mesh, &camera, &pose), view);
            assert!(compared.num_covered == 0 || mesh.num_triangles() > 0);
            compared.assert_equal_but_for_edges(1e-3, &format!("{width}x{height}"));
        }
    }
}

#[test]
fn what_a_device_cannot_take_is_refused_with_its_size() {
    let Some(mut small) = device() else { return };
    small.limit_bindings(4_000);
    let gpu = GpuRasterizer::new(small).unwrap();
    let refused = gpu.load(&wall(30, 0.0)).unwrap_err();
    assert!(
        matches!(
            refused,
            GpuError::TooLarge {
                size: 21_600,
                limit: 4_000,
                ..
            }
        ),
        "{refused}"
    );
    // Few vertices, but each triangle is clipped, and its pieces take four times its room.
    let corners = vec![[-1.0, 0.1, 1.0], [1.0, 0.1, 1.0], [0.0, 0.1, -1.0]];
    let mesh = mesh_of(corners, vec![[0, 1, 2]; 100]);
    let camera = PinholeCamera::new([9.0, 9.0, 4.0, 4.0], 9, 9).unwrap();
    let mut loaded = gpu.load(&mesh).unwrap();
    let whole = MeshPart::whole(&mesh);
    let mut view = ViewBuffer::default();
    let pose = RigidTransform::identity();
    let refused = loaded.rasterize(&mesh, &whole, &camera, &pose, &mut view);
    assert!(
        matches!(
            refused,
            Err(GpuError::TooLarge {
                what: "mesh's clipped triangles",
                ..
            })
        ),
        "{refused:?}"
    );
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(48))]
    #[test]
    fn no_mesh_makes_it_fail(
        coordinates in prop::collection::vec(
            prop_oneof![
                -2.0..2.0f64,
                -1e-9..1e-9f64,
                -1e9..1e9f64,
                Just(0.0), Just(NEAR), Just(1e300), Just(-1e300), Just(f64::MAX), Just(1e-300),
            ], 9..60),
        order in prop::collection::vec(0usize..1000, 3..30),
    ) {
        static GPU: std::sync::OnceLock<Option<GpuRasterizer>> = std::sync::OnceLock::new();
        let Some(gpu) = GPU.get_or_init(rasterizer) else { return Ok(()) };
        let positions: Vec<[f64; 3]> =
            coordinates.chunks_exact(3).map(|c| [c[0], c[1], c[2]]).collect();
        let num = positions.len();
        let triangles = order.chunks_exact(3)
            .map(|c| [c[0], c[1], c[2]].map(|i| (i % num) as u32)).collect();
        let mesh = mesh_of(positions, triangles);
        let camera = camera().resized(96, 72).unwrap();
        let view = compare(gpu, &mesh, &camera, &RigidTransform::identity()).gpu;
        for (&id, &depth_m) in view.triangle.iter().zip(&view.depth_m) {
            prop_assert_eq!(id == NO_TRIANGLE, depth_m == 0.0);
            prop_assert!(id == NO_TRIANGLE || (id as usize) < mesh.num_triangles());
            prop_assert!(depth_m == 0.0 || f64::from(depth_m) >= NEAR * 0.999);
        }
    }
}
