//! Which points of a scene some camera truly sees, by the scene's own ray caster.

use nalgebra::Point3;

use super::bvh::Bvh;
use super::surface::Surface;
use crate::geom::{PinholeCamera, RigidTransform};

/// A photo that a texture was painted from.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PaintingView {
    /// Number of its keyframe, as texel sources have it.
    pub keyframe: u32,
    /// Pose of its optical frame.
    pub world_from_camera: RigidTransform,
    /// Its camera, without distortion.
    pub camera: PinholeCamera,
}

/// What hides a point must be nearer than it by this, metres: surfaces may touch.
const TOLERANCE_M: f64 = 1e-3;

/// The views and what may be in their way.
pub(super) struct Sight {
    bvh: Bvh,
    /// By keyframe.
    views: Vec<(PaintingView, RigidTransform)>,
}

impl Sight {
    pub(super) fn new(surfaces: &[Surface], views: &[PaintingView]) -> Self {
        let mut views: Vec<_> = views
            .iter()
            .map(|view| (*view, view.world_from_camera.inverse()))
            .collect();
        views.sort_by_key(|(view, _)| view.keyframe);
        Self {
            bvh: Bvh::new(surfaces),
            views,
        }
    }

    /// Whether a view shows a point of a surface: the painter is asked first, as it mostly does.
    /// Without any view, everything counts as seen.
    pub(super) fn is_seen(&self, point: &Point3<f64>, painter: u32) -> bool {
        if self.views.is_empty() {
            return true;
        }
        let first = self
            .views
            .binary_search_by_key(&painter, |(view, _)| view.keyframe)
            .unwrap_or(0);
        let others = (0..self.views.len()).filter(|&at| at != first);
        std::iter::once(first)
            .chain(others)
            .any(|at| self.shows(&self.views[at], point))
    }

    fn shows(
        &self,
        (view, camera_from_world): &(PaintingView, RigidTransform),
        point: &Point3<f64>,
    ) -> bool {
        let in_camera = camera_from_world.transform_point(point);
        let is_inside = view
            .camera
            .project(&in_camera)
            .is_some_and(|px| view.camera.contains(px));
        if !is_inside {
            return false;
        }
        let eye = Point3::from(*view.world_from_camera.translation());
        let ray = point - eye;
        let reach = 1.0 - TOLERANCE_M / ray.norm().max(TOLERANCE_M);
        self.bvh.nearest_hit(&eye, &ray, [1e-6, reach]).is_none()
    }
}
