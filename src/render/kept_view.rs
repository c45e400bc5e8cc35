//! The depths of a view, kept while surface comes and goes.
//!
//! What comes is drawn into them; where something goes, that part of the view is drawn anew once it
//! is looked at. The depths are to the last bit those of the whole mesh drawn at once: the nearest wins,
//! whatever the order.

use nalgebra::Point3;

use super::part::MeshPart;
use super::raster::{RasterWorkspace, ViewBuffer, draw_inverse, draw_triangles_inverse};
use super::window::PixelWindow;
use crate::geom::{PinholeCamera, RigidTransform};
use crate::mesh::TriMesh;

/// Where a view is looked from: the camera has the size of the view.
#[derive(Clone, Copy, Debug)]
pub struct ViewPoint<'a> {
    /// The camera.
    pub camera: &'a PinholeCamera,
    /// Where it stands.
    pub camera_from_world: &'a RigidTransform,
}

/// Scratch memory of drawing, worth keeping from view to view.
#[derive(Clone, Debug, Default)]
pub struct ViewScratch {
    raster: RasterWorkspace,
    view: ViewBuffer,
}

/// The depths of all of a view.
#[derive(Clone, Debug, PartialEq)]
pub struct KeptView {
    size: [usize; 2],
    /// Row by row, 1/m; 0 where there is nothing.
    inverse_depth: Vec<f32>,
    /// What has to be drawn anew.
    stale: PixelWindow,
}

impl KeptView {
    /// Draws all that the part of the mesh shows, which has all that the camera may see.
    pub fn of(
        mesh: &TriMesh,
        part: &MeshPart,
        from: ViewPoint<'_>,
        scratch: &mut ViewScratch,
    ) -> Self {
        let whole = PixelWindow::whole(from.camera.width(), from.camera.height());
        let mut view = Self {
            size: whole.size().map(|side| side as usize),
            inverse_depth: vec![0.0; Self::num_bytes_of(from.camera) / size_of::<f32>()],
            stale: whole,
        };
        view.redraw(mesh, part, from, scratch);
        view
    }

    /// Bytes that a camera's view takes.
    pub fn num_bytes_of(camera: &PinholeCamera) -> usize {
        camera.width() as usize * camera.height() as usize * size_of::<f32>()
    }

    /// Bytes that it takes.
    pub fn num_bytes(&self) -> usize {
        size_of_val(&*self.inverse_depth)
    }

    /// Surface came: triangles in space, which show in a window of the view or nowhere.
    pub fn add(
        &mut self,
        triangles_m: &[[Point3<f64>; 3]],
        window: PixelWindow,
        from: ViewPoint<'_>,
        scratch: &mut ViewScratch,
    ) {
        if window.is_empty() {
            return;
        }
        let [width, height] = window.size();
        let view = &mut scratch.view;
        view.clear(width, height);
        let rows = view.depth_m.chunks_exact_mut(width as usize);
        for (row, known) in rows.zip(self.rows(window)) {
            row.copy_from_slice(known);
        }
        draw_triangles_inverse(
            triangles_m,
            from.camera,
            from.camera_from_world,
            window,
            view,
        );
        self.take(window, view);
    }

    /// Surface went from a window of the view.
    pub fn forget(&mut self, window: PixelWindow) {
        self.stale = self.stale.around(window);
    }

    /// What has to be drawn anew.
    pub fn stale(&self) -> PixelWindow {
        self.stale
    }

    /// Draws anew what is stale; the part of the mesh has all that may show there.
    pub fn redraw(
        &mut self,
        mesh: &TriMesh,
        part: &MeshPart,
        from: ViewPoint<'_>,
        scratch: &mut ViewScratch,
    ) {
        let window = std::mem::take(&mut self.stale);
        if window.is_empty() {
            return;
        }
        let ViewScratch { raster, view } = scratch;
        let ViewPoint {
            camera,
            camera_from_world,
        } = from;
        draw_inverse(mesh, part, camera, camera_from_world, window, raster, view);
        self.take(window, view);
    }

    /// Rows of a window, 1/m.
    pub(super) fn rows(&self, window: PixelWindow) -> impl Iterator<Item = &[f32]> {
        let [left, top] = window.start.map(|px| px as usize);
        let [right, bottom] = [0, 1].map(|axis| (window.end[axis] as usize).min(self.size[axis]));
        let rows = self.inverse_depth.chunks_exact(self.size[0].max(1));
        let rows = rows.take(bottom).skip(top);
        rows.map(move |row| row.get(left..right).unwrap_or_default())
    }

    fn take(&mut self, window: PixelWindow, drawn: &ViewBuffer) {
        let [left, top] = window.start.map(|px| px as usize);
        let width = drawn.width as usize;
        let rows = self.inverse_depth.chunks_exact_mut(self.size[0].max(1));
        let drawn = drawn.depth_m.chunks_exact(width.max(1));
        for (row, drawn) in rows.skip(top).zip(drawn) {
            if let Some(row) = row.get_mut(left..left + width) {
                row.copy_from_slice(drawn);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::render::{
        MeshRuns, SurfacePoint, VisibilityBuffer, VisibilityParams, WindowFinder, rasterize_part,
    };
    use nalgebra::{UnitQuaternion, Vector3};
    use proptest::prelude::*;

    fn soup(corners: &[[[f64; 3]; 3]]) -> TriMesh {
        let positions = corners.as_flattened().iter().map(|&p| Point3::from(p));
        let triangles = (0..corners.len() as u32).map(|k| [3 * k, 3 * k + 1, 3 * k + 2]);
        let mesh = TriMesh::from_soup(positions.collect(), triangles.collect());
        mesh.unwrap().0
    }

    fn triangles() -> impl Strategy<Value = Vec<[[f64; 3]; 3]>> {
        // Before and behind the camera, within and beyond the image and the far end.
        let point = [-2.0..2.0, -2.0..2.0, -0.5..6.0];
        let corner = point.prop_map(|p: [f64; 3]| p);
        let spread = [corner.clone(), corner.clone(), corner];
        let small = ([-1.0..1.0, -1.0..1.0, 0.5..4.0], 0.05..0.6).prop_map(
            |([x, y, z], size): ([f64; 3], f64)| {
                [[x, y, z], [x + size, y, z + 0.3 * size], [x, y + size, z]]
            },
        );
        proptest::collection::vec(prop_oneof![1 => spread, 4 => small], 0..24)
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(96))]
        #[test]
        fn what_came_and_went_leaves_the_view_of_what_is_there(
            steps in proptest::collection::vec((triangles(), 0_usize..20), 1..5),
            turn in -0.4..0.4,
        ) {
            let camera = PinholeCamera::new([150.0, 150.0, 79.5, 59.5], 160, 120).unwrap();
            let pose = RigidTransform::from_parts(
                UnitQuaternion::from_axis_angle(&Vector3::y_axis(), turn),
                Vector3::new(0.1, -0.05, 0.2),
            );
            let params = VisibilityParams { far_m: 4.0, max_width_px: 80, ..Default::default() };
            let finder = WindowFinder::new(&camera, &params);
            let own = finder.buffer_camera(&camera).unwrap();
            let from = ViewPoint { camera: &own, camera_from_world: &pose };
            let mut scratch = ViewScratch::default();
            let part_of = |mesh: &TriMesh| {
                MeshRuns::new(mesh).in_view(&own, &pose, params.far_m)
            };
            let window_of = |triangles: &[[Point3<f64>; 3]]| {
                let mut finder = finder;
                for corners in triangles {
                    let [a, b, c] = corners.map(|p| camera.project(&pose.transform_point(&p)));
                    let all = a.zip(b).zip(c);
                    finder.include(all.map(|((a, b), c)| [a, b, c]));
                }
                finder.window()
            };
            let empty = TriMesh::default();
            let mut kept = KeptView::of(&empty, &part_of(&empty), from, &mut scratch);
            let mut there: Vec<[[f64; 3]; 3]> = Vec::new();
            for (came, num_gone) in steps {
                let gone: Vec<_> = there.drain(..num_gone.min(there.len())).collect();
                there.extend(&came);
                let mesh = soup(&there);
                let in_space = |triangles: &[[[f64; 3]; 3]]| -> Vec<[Point3<f64>; 3]> {
                    triangles.iter().map(|t| t.map(Point3::from)).collect()
                };
                kept.forget(window_of(&in_space(&gone)));
                let came = in_space(&came);
                kept.add(&came, window_of(&came), from, &mut scratch);
                kept.redraw(&mesh, &part_of(&mesh), from, &mut scratch);
                prop_assert!(kept.stale().is_empty());

                // Drawn at once, in a window and as a whole: the same tests.
                let mut once = VisibilityBuffer::default();
                once.update(&mesh, &camera, &pose, &params).unwrap();
                let mut loaded = VisibilityBuffer::default();
                loaded.load(&kept, &camera, &params, finder.whole(), 0).unwrap();
                prop_assert_eq!(&loaded.view().depth_m, &once.view().depth_m);
                prop_assert_eq!(loaded.depth_bound(), once.depth_bound());
                for index in 0..160 * 120 / 9 {
                    let [x_px, y_px] = [3 * index % 160, 3 * index / 160 * 3].map(f64::from);
                    let point = SurfacePoint { position_px: [x_px, y_px], depth_m: 2.0, slope_m: 0.01 };
                    let is_near = once.is_near_depth_edge(&point);
                    prop_assert_eq!(loaded.is_near_depth_edge(&point), is_near);
                }
                let mut view = ViewBuffer::default();
                let raster = &mut RasterWorkspace::default();
                rasterize_part(&mesh, &part_of(&mesh), &own, &pose, raster, &mut view);
                let is_far = |depth_m: &f32| f64::from(*depth_m) > params.far_m;
                let near: Vec<f32> = view.depth_m.iter()
                    .map(|depth_m| if is_far(depth_m) { 0.0 } else { *depth_m })
                    .collect();
                prop_assert_eq!(&loaded.view().depth_m, &near);
            }
        }
    }
}
