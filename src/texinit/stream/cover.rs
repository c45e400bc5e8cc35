//! Where in an image surface came or went: what lies there may be hidden or uncovered by it.

use nalgebra::Point3;

use crate::geom::{PinholeCamera, RigidTransform};
use crate::render::{BoundingBox, DepthBound};

use super::view::KnownView;

/// Triangles that share a box.
const CHUNK_SIZE: usize = 64;
/// Blocks along an image.
const NUM_COLUMNS: u32 = 96;
/// What is nearer to the camera's plane than this may be drawn anywhere in the image, metres.
const NEAR_M: f64 = 0.05;

/// Surface that came or went.
pub(super) struct TouchedSurface<'a> {
    gone: Soup<'a>,
    came: Soup<'a>,
}

impl<'a> TouchedSurface<'a> {
    pub(super) fn new(gone: &'a [[Point3<f64>; 3]], came: &'a [[Point3<f64>; 3]]) -> Self {
        Self {
            gone: Soup::new(gone),
            came: Soup::new(came),
        }
    }

    /// The part of an image within `reach_px` of what shows of it; `None` where nothing does. `bound`,
    /// how far the view saw before, is brought up to what is there now.
    pub(super) fn cover(
        &self,
        view: &KnownView<'_>,
        reach_px: f64,
        bound: &mut Option<DepthBound>,
    ) -> Option<(Cover, Shown)> {
        let mut cover = Cover::empty(view.camera, view.camera_from_world);
        let mut shown = Shown::default();
        self.gone.each_in(view, |corners_m| {
            let corners = view.in_camera(corners_m);
            // What was hidden may be behind other surface that went: it is judged by what was there.
            if !view.hides(&corners, bound.as_ref()) {
                cover.add(&corners, reach_px);
                shown.gone_px.push(view.corners_px(&corners));
            }
        });
        if let Some(bound) = bound {
            for corners_px in &shown.gone_px {
                bound.lift(corners_px.as_ref());
            }
        }
        self.came.each_in(view, |corners_m| {
            let corners = view.in_camera(corners_m);
            if !view.hides(&corners, bound.as_ref()) {
                cover.add(&corners, reach_px);
                shown.came.push(*corners_m);
            }
        });
        let is_empty = shown.gone_px.is_empty() && shown.came.is_empty();
        (!is_empty).then_some((cover, shown))
    }
}

/// What a view may show of surface that came or went.
#[derive(Default)]
pub(super) struct Shown {
    /// Pixels of the corners of what went; `None` unless all are in front of the camera.
    pub(super) gone_px: Vec<Option<[[f64; 2]; 3]>>,
    /// What came, in space.
    pub(super) came: Vec<[Point3<f64>; 3]>,
}

/// Triangles in space.
struct Soup<'a> {
    triangles: &'a [[Point3<f64>; 3]],
    /// Of each chunk of triangles.
    bounds: Vec<BoundingBox>,
}

impl<'a> Soup<'a> {
    fn new(triangles: &'a [[Point3<f64>; 3]]) -> Self {
        let chunks = triangles.chunks(CHUNK_SIZE);
        Self {
            bounds: chunks
                .map(|chunk| BoundingBox::around(chunk.iter().flatten().copied()))
                .collect(),
            triangles,
        }
    }

    fn each_in(&self, view: &KnownView<'_>, mut each: impl FnMut(&[Point3<f64>; 3])) {
        let chunks = self.triangles.chunks(CHUNK_SIZE).zip(&self.bounds);
        for (triangles, _) in chunks.filter(|(_, bounds)| view.frustum.may_see(bounds)) {
            triangles.iter().for_each(&mut each);
        }
    }
}

/// Blocks of an image.
#[derive(Debug)]
pub(super) struct Cover {
    camera: PinholeCamera,
    camera_from_world: RigidTransform,
    block_px: f64,
    /// Columns and rows.
    size: [usize; 2],
    /// Row by row.
    is_in: Vec<bool>,
}

impl Cover {
    fn empty(camera: &PinholeCamera, camera_from_world: &RigidTransform) -> Self {
        let block_px = f64::from(camera.width().div_ceil(NUM_COLUMNS).max(1));
        #[expect(
            clippy::cast_possible_truncation,
            clippy::cast_sign_loss,
            reason = "sides of an image"
        )]
        let size = [camera.width(), camera.height()]
            .map(|side| (f64::from(side) / block_px).ceil() as usize);
        Self {
            camera: *camera,
            camera_from_world: *camera_from_world,
            block_px,
            is_in: vec![false; size[0] * size[1]],
            size,
        }
    }

    /// Behind the camera; left, right, above and below of the image widened by `reach_px`. These are
    /// half-spaces, so that what lies in one with all its corners does so altogether.
    fn is_outside(&self, point_in_camera: &Point3<f64>, reach_px: f64) -> [bool; 5] {
        let [fx, fy, cx, cy] = self.camera.intrinsics_px();
        let Point3 { coords } = point_in_camera;
        let (x, y, z) = (coords.x, coords.y, coords.z);
        let right = f64::from(self.camera.width()) + reach_px - cx;
        let bottom = f64::from(self.camera.height()) + reach_px - cy;
        [
            z <= 0.0,
            fx * x + (cx + 1.0 + reach_px) * z < 0.0,
            fx * x - right * z > 0.0,
            fy * y + (cy + 1.0 + reach_px) * z < 0.0,
            fy * y - bottom * z > 0.0,
        ]
    }

    /// Columns and rows, first and last, of the blocks that points in the camera may project into; `None` where
    /// they are all out of the image.
    #[expect(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "clamped to the image before the casts"
    )]
    fn blocks(&self, in_camera: &[Point3<f64>], reach_px: f64) -> Option<[[usize; 2]; 2]> {
        let mut low = [f64::INFINITY; 2];
        let mut high = [f64::NEG_INFINITY; 2];
        let mut nearest_m = f64::INFINITY;
        let mut is_outside = [true; 5];
        for point in in_camera {
            nearest_m = nearest_m.min(point.z);
            for (all, one) in is_outside.iter_mut().zip(self.is_outside(point, reach_px)) {
                *all &= one;
            }
            if let Some(px) = self.camera.project(point) {
                for axis in 0..2 {
                    low[axis] = low[axis].min(px[axis]);
                    high[axis] = high[axis].max(px[axis]);
                }
            }
        }
        if is_outside.contains(&true) {
            return None;
        }
        if nearest_m < NEAR_M {
            return Some(self.size.map(|num| [0, num.saturating_sub(1)]));
        }
        let mut blocks = [[0; 2]; 2];
        for axis in 0..2 {
            let first = ((low[axis] + 0.5 - reach_px) / self.block_px).floor();
            let last = ((high[axis] + 0.5 + reach_px) / self.block_px).floor();
            let end = self.size[axis] as f64;
            if !(first < end && last >= 0.0) {
                return None;
            }
            blocks[axis] = [first.max(0.0) as usize, last.min(end - 1.0) as usize];
        }
        Some(blocks)
    }

    fn add(&mut self, in_camera: &[Point3<f64>; 3], reach_px: f64) {
        if let Some([columns, [top, bottom]]) = self.blocks(in_camera, reach_px) {
            for row in top..=bottom {
                let start = row * self.size[0];
                self.is_in[start + columns[0]..=start + columns[1]].fill(true);
            }
        }
    }

    pub(super) fn is_empty(&self) -> bool {
        !self.is_in.contains(&true)
    }

    /// Whether something between the points may lie in the part.
    pub(super) fn meets<const N: usize>(&self, points_m: &[Point3<f64>; N]) -> bool {
        let to_camera = |point| self.camera_from_world.transform_point(point);
        self.meets_in_camera(&points_m.each_ref().map(to_camera))
    }

    /// The same of points in the camera.
    pub(super) fn meets_in_camera(&self, in_camera: &[Point3<f64>]) -> bool {
        // Rounding to pixels.
        const SLACK_PX: f64 = 1.0;
        let Some([columns, [top, bottom]]) = self.blocks(in_camera, SLACK_PX) else {
            return false;
        };
        (top..=bottom).any(|row| {
            let start = row * self.size[0];
            self.is_in[start + columns[0]..=start + columns[1]].contains(&true)
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::render::VisibilityParams;
    use nalgebra::Vector3;

    fn camera() -> PinholeCamera {
        PinholeCamera::new([100.0, 100.0, 95.5, 71.5], 192, 144).unwrap()
    }

    fn triangle(x: f64, y: f64, z: f64) -> [Point3<f64>; 3] {
        [[0.0, 0.0], [0.1, 0.0], [0.0, 0.1]].map(|[dx, dy]| Point3::new(x + dx, y + dy, z))
    }

    fn cover_of(touched: &TouchedSurface<'_>, pose: &RigidTransform) -> Option<Cover> {
        let (camera, params) = (camera(), VisibilityParams::default());
        let view = KnownView::new(&camera, pose, &params);
        let (cover, _) = touched.cover(&view, 3.0, &mut None)?;
        (!cover.is_empty()).then_some(cover)
    }

    #[test]
    fn what_lies_behind_or_near_meets_and_what_is_far_off_does_not() {
        let identity = RigidTransform::identity();
        let touched = [triangle(0.0, 0.0, 1.0)];
        for touched in [[&touched[..], &[]], [&[], &touched[..]]] {
            let touched = TouchedSurface::new(touched[0], touched[1]);
            let cover = cover_of(&touched, &identity).unwrap();
            assert!(cover.meets(&triangle(0.0, 0.0, 4.0)));
            // 14 px right of it, then 2 px: within reach.
            assert!(!cover.meets(&triangle(0.24, 0.0, 1.0)));
            assert!(cover.meets(&triangle(0.12, 0.0, 1.0)));
            assert!(!cover.meets(&triangle(0.0, 0.0, -1.0)));
            // A triangle that reaches behind the camera through the image may be anywhere in it, one
            // beside the image is not in it.
            let corners = |x: f64| [[x, 0.0, -1.0], [x, 0.1, 1.0], [x, 9.0, 1.0]].map(Point3::from);
            assert!(cover.meets(&corners(0.1)));
            assert!(!cover.meets(&corners(9.0)));
        }
    }

    #[test]
    fn surface_out_of_view_covers_nothing() {
        let turned = RigidTransform::from_parts(
            nalgebra::UnitQuaternion::from_axis_angle(&Vector3::y_axis(), 3.0),
            Vector3::zeros(),
        );
        let touched = [triangle(0.0, 0.0, 1.0)];
        assert!(cover_of(&TouchedSurface::new(&touched, &[]), &turned).is_none());
        let identity = RigidTransform::identity();
        assert!(cover_of(&TouchedSurface::new(&[], &[]), &identity).is_none());
        let far = [triangle(0.0, 0.0, 8.5)];
        assert!(cover_of(&TouchedSurface::new(&far, &far), &identity).is_none());
    }

    #[test]
    fn hidden_surface_covers_nothing_until_what_hides_it_goes() {
        use crate::mesh::TriMesh;
        use crate::render::VisibilityBuffer;
        let wall = [[-9.0, -9.0], [9.0, -9.0], [0.0, 9.0]].map(|[x, y]| Point3::new(x, y, 2.0));
        let (mesh, _) = TriMesh::from_soup(wall.to_vec(), vec![[0, 1, 2]]).unwrap();
        let (camera, params) = (camera(), VisibilityParams::default());
        let identity = RigidTransform::identity();
        let mut buffer = VisibilityBuffer::default();
        buffer.update(&mesh, &camera, &identity, &params).unwrap();
        let view = KnownView::new(&camera, &identity, &params);
        let behind = [triangle(0.0, 0.0, 4.0)];
        let mut bound = Some(buffer.depth_bound().clone());
        for touched in [[&behind[..], &[]], [&[], &behind[..]]] {
            let touched = TouchedSurface::new(touched[0], touched[1]);
            assert!(touched.cover(&view, 3.0, &mut bound).is_none());
        }
        // It comes while a piece of the wall goes.
        let before = [triangle(0.0, 0.0, 2.0)];
        let touched = TouchedSurface::new(&before, &behind);
        let (mut cover, _) = touched.cover(&view, 3.0, &mut bound).unwrap();
        assert!(cover.meets(&behind[0]));
        // From now on nothing hides it.
        (cover, _) = TouchedSurface::new(&[], &behind)
            .cover(&view, 3.0, &mut bound)
            .unwrap();
        assert!(cover.meets(&behind[0]));
    }
}
