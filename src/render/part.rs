//! Which part of a mesh a camera may see.
//!
//! A scanned mesh lists neighbours near one another, so that runs of consecutive triangles are
//! small in space. [`MeshRuns`] keeps a bounding box for each run; a camera then looks at the runs
//! that reach into its view, and at the vertices that these use. Order and indices stay the
//! mesh's. A mesh in random order is looked at whole, at hardly any cost.

use std::ops::Range;

use nalgebra::{Point3, Vector3};
use rayon::prelude::*;

use crate::geom::{PinholeCamera, RigidTransform};
use crate::mesh::{TriMesh, TriangleId};

use super::window::PixelWindow;

/// Triangles that share a box.
const RUN_SIZE: usize = 64;
/// Runs whose boxes are looked at together.
const GROUP_SIZE: usize = 64;
/// Vertices that are wanted together.
const BLOCK_SIZE: u32 = 64;
/// The view is taken to reach this far past the image, pixels.
const MARGIN_PX: f64 = 2.0;

/// An axis-aligned box.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BoundingBox {
    center: Point3<f64>,
    half_size: Vector3<f64>,
}

impl BoundingBox {
    /// The box around some triangles of a mesh.
    pub fn of(mesh: &TriMesh, triangles: impl IntoIterator<Item = TriangleId>) -> Self {
        Self::around(triangles.into_iter().flat_map(|t| mesh.corners_m(t)))
    }

    /// The box around some points, metres.
    pub fn around(points_m: impl IntoIterator<Item = Point3<f64>>) -> Self {
        let mut min = Point3::from([f64::INFINITY; 3]);
        let mut max = Point3::from([f64::NEG_INFINITY; 3]);
        for point in points_m {
            min = min.inf(&point);
            max = max.sup(&point);
        }
        Self {
            center: nalgebra::center(&min, &max),
            half_size: (max - min) / 2.0,
        }
    }

    /// The box around some boxes.
    pub(crate) fn around_all<'a>(boxes: impl IntoIterator<Item = &'a Self>) -> Self {
        Self::around(boxes.into_iter().flat_map(Self::corners_m))
    }

    /// Whether the two may have a point in common; somewhat widened, so that rounding cannot part them. A box
    /// around nothing meets none.
    pub(crate) fn meets(&self, other: &Self) -> bool {
        let apart_m = (self.center - other.center).abs();
        let reach_m = self.half_size + other.half_size;
        let rounding_m = 1e-9 * (1.0 + self.center.coords.amax() + reach_m.amax());
        (0..3).all(|axis| apart_m[axis] <= reach_m[axis] + rounding_m)
    }

    /// Its corners, metres.
    pub fn corners_m(&self) -> [Point3<f64>; 8] {
        std::array::from_fn(|corner| {
            let side = |axis: usize| if corner >> axis & 1 == 1 { 1.0 } else { -1.0 };
            let reach = Vector3::from_fn(|axis, _| side(axis) * self.half_size[axis]);
            self.center + reach
        })
    }
}

/// What a camera may see, as half-spaces of the world.
#[derive(Clone, Debug)]
pub struct Frustum {
    /// Inside: normal · point + offset ≥ 0. The first is depth along the camera's axis.
    half_spaces: [(Vector3<f64>, f64); 5],
    /// Depth along the camera's axis of what is still looked at, metres.
    far_m: f64,
}

impl Frustum {
    /// The view of a camera up to a depth of `far_m` metres (infinite for no end), somewhat widened:
    /// what rounding may put into the image is inside.
    pub fn new(camera: &PinholeCamera, camera_from_world: &RigidTransform, far_m: f64) -> Self {
        let window = PixelWindow::whole(camera.width(), camera.height());
        Self::of_window(camera, camera_from_world, far_m, window)
    }

    /// The part of the view that lies in a window of the camera's image.
    pub fn of_window(
        camera: &PinholeCamera,
        camera_from_world: &RigidTransform,
        far_m: f64,
        window: PixelWindow,
    ) -> Self {
        let [fx, fy, cx, cy] = camera.intrinsics_px();
        let [left, top] = window.start.map(|px| f64::from(px) - MARGIN_PX);
        let [right, bottom] = window.end.map(|px| f64::from(px) - 1.0 + MARGIN_PX);
        let world_from_camera = camera_from_world.inverse();
        let half_spaces = [
            Vector3::z(),
            Vector3::new(fx, 0.0, cx - left),
            Vector3::new(-fx, 0.0, right - cx),
            Vector3::new(0.0, fy, cy - top),
            Vector3::new(0.0, -fy, bottom - cy),
        ]
        .map(|normal| {
            let in_world = world_from_camera.transform_vector(&normal);
            (in_world, normal.dot(camera_from_world.translation()))
        });
        Self { half_spaces, far_m }
    }

    /// Least depth of the box along the camera's axis, metres; negative behind the camera.
    fn nearest_m(&self, bounds: &BoundingBox) -> f64 {
        let (axis, offset) = &self.half_spaces[0];
        axis.dot(&bounds.center.coords) - axis.abs().dot(&bounds.half_size) + offset
    }

    /// False only where no point of the box is in view.
    pub fn may_see(&self, bounds: &BoundingBox) -> bool {
        let is_outside = self.half_spaces.iter().any(|(normal, offset)| {
            let reach = normal.abs().dot(&bounds.half_size);
            let center = normal.dot(&bounds.center.coords);
            // Far past what rounding does to the sum.
            let slack = 1e-9 * (reach + center.abs() + offset.abs());
            center + reach + offset < -slack
        });
        // Widened by far more than rounding.
        let is_too_far = self.nearest_m(bounds) > self.far_m * (1.0 + 1e-6);
        !is_outside && !is_too_far
    }
}

/// A part of a mesh: ascending runs of triangles, and of vertices, all of theirs among them.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct MeshPart {
    triangles: Vec<Range<u32>>,
    /// The same triangles, roughly from the nearest to the farthest.
    front_to_back: Vec<Range<u32>>,
    vertices: Vec<Range<usize>>,
}

impl MeshPart {
    /// All of a mesh.
    #[expect(
        clippy::cast_possible_truncation,
        clippy::single_range_in_vec_init,
        reason = "a mesh has at most 2³² triangles; one run is meant"
    )]
    pub fn whole(mesh: &TriMesh) -> Self {
        let all = 0..mesh.num_triangles() as u32;
        Self {
            triangles: vec![all.clone()],
            front_to_back: vec![all],
            vertices: vec![0..mesh.num_vertices()],
        }
    }

    /// Some of a mesh: ascending runs of its triangles.
    pub fn of_runs(mesh: &TriMesh, runs: Vec<Range<u32>>) -> Self {
        let num_vertices = mesh.num_vertices();
        let mut is_wanted = vec![false; num_vertices.div_ceil(BLOCK_SIZE as usize)];
        for (_, corners) in with_corners(&runs, mesh) {
            for vertex in corners {
                is_wanted[(vertex / BLOCK_SIZE) as usize] = true;
            }
        }
        Self {
            front_to_back: runs.clone(),
            triangles: runs,
            vertices: vertex_runs(&is_wanted, num_vertices),
        }
    }

    /// The triangles as ascending runs.
    pub fn triangle_runs(&self) -> &[Range<u32>] {
        &self.triangles
    }

    /// How many triangles it has.
    pub fn num_triangles(&self) -> usize {
        self.triangles.iter().map(ExactSizeIterator::len).sum()
    }

    /// The triangles, ascending, with their vertices.
    pub fn triangles<'a>(
        &'a self,
        mesh: &'a TriMesh,
    ) -> impl Iterator<Item = (u32, &'a [u32; 3])> + 'a {
        with_corners(&self.triangles, mesh)
    }

    /// The triangles with their vertices, roughly from the nearest to the farthest.
    pub fn front_to_back<'a>(
        &'a self,
        mesh: &'a TriMesh,
    ) -> impl Iterator<Item = (u32, &'a [u32; 3])> + 'a {
        with_corners(&self.front_to_back, mesh)
    }

    /// Sets what `values` has for the part's vertices; it gets the mesh's length, and keeps what
    /// it had, or the default, for the others.
    pub fn map_vertices<T: Clone + Default>(
        &self,
        mesh: &TriMesh,
        values: &mut Vec<T>,
        of: impl Fn(&Point3<f64>) -> T,
    ) {
        values.resize(mesh.num_vertices(), T::default());
        for run in &self.vertices {
            let positions = &mesh.positions_m()[run.clone()];
            for (value, position) in values[run.clone()].iter_mut().zip(positions) {
                *value = of(position);
            }
        }
    }
}

fn with_corners<'a>(
    runs: &'a [Range<u32>],
    mesh: &'a TriMesh,
) -> impl Iterator<Item = (u32, &'a [u32; 3])> + 'a {
    runs.iter().flat_map(|run| {
        let corners = &mesh.triangles()[run.start as usize..run.end as usize];
        (run.start..run.end).zip(corners)
    })
}

/// The runs of a mesh with their boxes.
#[derive(Clone, Debug, PartialEq)]
pub struct MeshRuns {
    num_triangles: usize,
    num_vertices: usize,
    bounds: Vec<BoundingBox>,
    /// Around [`GROUP_SIZE`] runs each, so that most of a large mesh is left out at once.
    group_bounds: Vec<BoundingBox>,
    /// Per run: its first block of vertices in `blocks`.
    first_block: Vec<usize>,
    blocks: Vec<u32>,
}

impl MeshRuns {
    /// The runs of `mesh`.
    pub fn new(mesh: &TriMesh) -> Self {
        let mut runs = Self {
            num_triangles: 0,
            num_vertices: 0,
            bounds: vec![],
            group_bounds: vec![],
            first_block: vec![0],
            blocks: vec![],
        };
        runs.renew(mesh, 0);
        runs
    }

    /// Makes these the runs of `mesh`, whose first `num_staying` triangles, and where their vertices lie, are
    /// those of the mesh that they are of.
    pub(crate) fn renew(&mut self, mesh: &TriMesh, num_staying: usize) {
        let num_runs = num_staying.min(self.num_triangles) / RUN_SIZE;
        (self.num_triangles, self.num_vertices) = (mesh.num_triangles(), mesh.num_vertices());
        self.bounds.truncate(num_runs);
        self.first_block.truncate(num_runs + 1);
        self.blocks.truncate(self.first_block[num_runs]);
        let all: Vec<(BoundingBox, Vec<u32>)> = mesh.triangles()[num_runs * RUN_SIZE..]
            .par_chunks(RUN_SIZE)
            .map(|triangles| {
                let corners = triangles.as_flattened();
                let positions_m = corners.iter().map(|&v| mesh.positions_m()[v as usize]);
                let mut blocks: Vec<u32> = corners.iter().map(|v| v / BLOCK_SIZE).collect();
                blocks.sort_unstable();
                blocks.dedup();
                (BoundingBox::around(positions_m), blocks)
            })
            .collect();
        for (bounds, blocks) in all {
            self.bounds.push(bounds);
            self.blocks.extend(blocks);
            self.first_block.push(self.blocks.len());
        }
        let num_groups = num_runs / GROUP_SIZE;
        self.group_bounds.truncate(num_groups);
        let groups = self.bounds[num_groups * GROUP_SIZE..].chunks(GROUP_SIZE);
        self.group_bounds
            .extend(groups.map(BoundingBox::around_all));
    }

    /// The runs whose boxes a view reaches into, ascending.
    fn within<'a>(
        &'a self,
        frustum: &'a Frustum,
    ) -> impl Iterator<Item = (usize, &'a BoundingBox)> + 'a {
        let groups = self.bounds.chunks(GROUP_SIZE).zip(&self.group_bounds);
        let seen = groups
            .enumerate()
            .filter(|(_, (_, bounds))| frustum.may_see(bounds));
        let runs = seen.flat_map(|(group, (runs, _))| (group * GROUP_SIZE..).zip(runs));
        runs.filter(|(_, bounds)| frustum.may_see(bounds))
    }

    /// What the camera may see up to a depth of `far_m` metres: every triangle that is drawn, or lies
    /// in the image, up to there is among it.
    pub fn in_view(
        &self,
        camera: &PinholeCamera,
        camera_from_world: &RigidTransform,
        far_m: f64,
    ) -> MeshPart {
        self.in_frustum(&Frustum::new(camera, camera_from_world, far_m))
    }

    /// The runs that reach into a view.
    #[expect(
        clippy::cast_possible_truncation,
        reason = "a mesh has at most 2³² triangles"
    )]
    pub fn in_frustum(&self, frustum: &Frustum) -> MeshPart {
        let mut part = MeshPart::default();
        let mut by_depth = vec![];
        let block_size = BLOCK_SIZE as usize;
        let mut is_wanted = vec![false; self.num_vertices.div_ceil(block_size)];
        for (run, bounds) in self.within(frustum) {
            let start = run * RUN_SIZE;
            let end = (start + RUN_SIZE).min(self.num_triangles);
            let triangles = start as u32..end as u32;
            push_joined(&mut part.triangles, triangles.clone());
            by_depth.push((frustum.nearest_m(bounds), triangles));
            for &block in &self.blocks[self.first_block[run]..self.first_block[run + 1]] {
                is_wanted[block as usize] = true;
            }
        }
        part.vertices = vertex_runs(&is_wanted, self.num_vertices);
        by_depth.sort_by(|(a, _), (b, _)| a.total_cmp(b));
        part.front_to_back = by_depth.into_iter().map(|(_, run)| run).collect();
        part
    }
}

/// The vertices of the wanted blocks.
fn vertex_runs(is_wanted: &[bool], num_vertices: usize) -> Vec<Range<usize>> {
    let block_size = BLOCK_SIZE as usize;
    let mut runs = vec![];
    for (block, _) in is_wanted.iter().enumerate().filter(|(_, wanted)| **wanted) {
        let start = block * block_size;
        let end = (start + block_size).min(num_vertices);
        push_joined(&mut runs, start..end);
    }
    runs
}

/// Adds a run, to the last one where it follows on.
fn push_joined<T: PartialEq>(runs: &mut Vec<Range<T>>, run: Range<T>) {
    match runs.last_mut() {
        Some(last) if last.end == run.start => last.end = run.end,
        _ => runs.push(run),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::render::{RasterWorkspace, ViewBuffer, rasterize, rasterize_part, rasterize_window};
    use nalgebra::{UnitQuaternion, Vector3};
    use proptest::prelude::*;

    /// A box of 1 m around the origin, of many small triangles, seen from the inside.
    fn room() -> TriMesh {
        let (mut positions, mut triangles) = (vec![], vec![]);
        for (axis, side) in [
            (0, -1.0),
            (0, 1.0),
            (1, -1.0),
            (1, 1.0),
            (2, -1.0),
            (2, 1.0),
        ] {
            let first = u32::try_from(positions.len()).unwrap();
            for i in 0..=20u8 {
                for j in 0..=20u8 {
                    let mut p = [0.0; 3];
                    p[axis] = side;
                    p[(axis + 1) % 3] = f64::from(i) / 10.0 - 1.0;
                    p[(axis + 2) % 3] = f64::from(j) / 10.0 - 1.0;
                    positions.push(Point3::from(p));
                }
            }
            for i in 0..20 {
                for j in 0..20 {
                    let a = first + i * 21 + j;
                    triangles.extend([[a, a + 1, a + 21], [a + 1, a + 22, a + 21]]);
                }
            }
        }
        TriMesh::from_soup(positions, triangles).unwrap().0
    }

    #[test]
    fn runs_are_renewed_from_where_the_mesh_is_another() {
        let mesh = room();
        let num_triangles = mesh.num_triangles();
        assert!(num_triangles > 3 * RUN_SIZE);
        for num_staying in [
            0,
            1,
            RUN_SIZE - 1,
            RUN_SIZE,
            2 * RUN_SIZE + 7,
            num_triangles,
        ] {
            // Behind those that stay there is nothing, the same from behind, or all and more.
            let staying = &mesh.triangles()[..num_staying];
            let reversed = mesh.triangles()[num_staying..].iter().rev().copied();
            let others: [Vec<[u32; 3]>; 3] = [
                Vec::new(),
                reversed.clone().collect(),
                reversed.chain(mesh.triangles().iter().copied()).collect(),
            ];
            for others in others {
                let triangles = [staying, &others].concat();
                let other = TriMesh::from_soup(mesh.positions_m().to_vec(), triangles);
                let (other, _) = other.unwrap();
                let mut runs = MeshRuns::new(&mesh);
                runs.renew(&other, num_staying);
                assert_eq!(runs, MeshRuns::new(&other), "{num_staying}");
            }
        }
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(64))]
        #[test]
        fn nothing_that_is_drawn_is_left_out(
            angles in [-4.0..4.0f64, -4.0..4.0f64, -4.0..4.0f64],
            position in [-1.5..1.5f64, -1.5..1.5f64, -1.5..1.5f64],
            focal_px in 30.0..300.0f64,
            corner_px in [0..80u32, 0..60u32],
            size_px in [1..80u32, 1..60u32],
        ) {
            let mesh = room();
            let runs = MeshRuns::new(&mesh);
            let camera = PinholeCamera::new([focal_px, focal_px, 41.0, 28.0], 80, 60).unwrap();
            let pose = RigidTransform::from_parts(
                UnitQuaternion::from_euler_angles(angles[0], angles[1], angles[2]),
                Vector3::from(position),
            );
            let part = runs.in_view(&camera, &pose, f64::INFINITY);
            let mut workspace = RasterWorkspace::default();
            let [mut whole, mut seen] = [ViewBuffer::default(), ViewBuffer::default()];
            rasterize(&mesh, &camera, &pose, &mut workspace, &mut whole);
            rasterize_part(&mesh, &part, &camera, &pose, &mut RasterWorkspace::default(), &mut seen);
            prop_assert_eq!(&whole, &seen);
            // A window of it, with what reaches into that alone.
            let window = PixelWindow {
                start: corner_px,
                end: [
                    (corner_px[0] + size_px[0]).min(80),
                    (corner_px[1] + size_px[1]).min(60),
                ],
            };
            let frustum = Frustum::of_window(&camera, &pose, f64::INFINITY, window);
            let mut narrow = ViewBuffer::default();
            rasterize_window(
                &mesh, &runs.in_frustum(&frustum), &camera, &pose, window,
                &mut RasterWorkspace::default(), &mut narrow,
            );
            let rows = (window.start[1]..window.end[1]).flat_map(|y| {
                (window.start[0]..window.end[0]).map(move |x| (y * 80 + x) as usize)
            });
            prop_assert!(rows.clone().map(|at| whole.triangle[at]).eq(narrow.triangle));
            prop_assert!(rows.map(|at| whole.depth_m[at]).eq(narrow.depth_m));
            let is_listed = |t: u32| part.triangles(&mesh).any(|(listed, _)| listed == t);
            for triangle in mesh.triangle_ids() {
                let is_inside = mesh.corners_m(triangle).iter().any(|corner| {
                    camera
                        .project(&pose.transform_point(corner))
                        .is_some_and(|px| camera.contains(px))
                });
                prop_assert!(!is_inside || is_listed(triangle.0));
            }
        }
    }

    #[test]
    fn a_narrow_view_takes_little_and_a_view_from_behind_nothing() {
        let mesh = room();
        let runs = MeshRuns::new(&mesh);
        let camera = PinholeCamera::new([200.0, 200.0, 40.0, 30.0], 80, 60).unwrap();
        let num = |z: f64| {
            let pose =
                RigidTransform::from_parts(UnitQuaternion::identity(), Vector3::new(0.0, 0.0, z));
            runs.in_view(&camera, &pose, f64::INFINITY)
                .triangles(&mesh)
                .count()
        };
        assert!(num(0.0) > 0 && 3 * num(0.0) < mesh.num_triangles());
        assert_eq!(num(-3.0), 0);
        assert_eq!(
            MeshPart::whole(&mesh).triangles(&mesh).count(),
            mesh.num_triangles()
        );
        let empty = TriMesh::default();
        assert_eq!(
            MeshRuns::new(&empty).in_view(&camera, &RigidTransform::identity(), f64::INFINITY),
            MeshPart::default()
        );
    }
}
