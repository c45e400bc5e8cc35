//! What is known of a keyframe's view without drawing it.

use nalgebra::{Point3, Rotation3};

use crate::geom::{PinholeCamera, RigidTransform};
use crate::render::visibility::depth_slope_m;
use crate::render::{BoundingBox, DepthBound, Frustum, VisibilityParams};

/// A camera where it stands.
pub(super) struct KnownView<'a> {
    pub(super) camera: &'a PinholeCamera,
    pub(super) camera_from_world: &'a RigidTransform,
    pub(super) frustum: Frustum,
    rotation: Rotation3<f64>,
    params: &'a VisibilityParams,
}

impl<'a> KnownView<'a> {
    /// What is hidden, and how deep it looks, is decided by `params`.
    pub(super) fn new(
        camera: &'a PinholeCamera,
        camera_from_world: &'a RigidTransform,
        params: &'a VisibilityParams,
    ) -> Self {
        Self {
            camera,
            camera_from_world,
            frustum: Frustum::new(camera, camera_from_world, params.far_m),
            rotation: camera_from_world.rotation().to_rotation_matrix(),
            params,
        }
    }

    pub(super) fn may_see(&self, bounds: &BoundingBox) -> bool {
        self.frustum.may_see(bounds)
    }

    pub(super) fn in_camera(&self, corners_m: &[Point3<f64>; 3]) -> [Point3<f64>; 3] {
        let translation = self.camera_from_world.translation();
        corners_m.map(|corner| Point3::from(self.rotation * corner.coords + translation))
    }

    /// The pixels of a triangle's corners; `None` unless all are in front of the camera.
    pub(super) fn corners_px(&self, corners_in_camera: &[Point3<f64>; 3]) -> Option<[[f64; 2]; 3]> {
        let [a, b, c] = corners_in_camera.map(|corner| self.camera.project(&corner));
        Some([a?, b?, c?])
    }

    /// Whether nothing of a triangle shows, by how far the view sees at most; no without a bound.
    pub(super) fn hides(
        &self,
        corners_in_camera: &[Point3<f64>; 3],
        bound: Option<&DepthBound>,
    ) -> bool {
        let Some(bound) = bound else {
            return false;
        };
        let Some(corners_px) = self.corners_px(corners_in_camera) else {
            return false;
        };
        let [a, b, c] = corners_in_camera;
        let center = Point3::from((a.coords + b.coords + c.coords) / 3.0);
        let slope_m = depth_slope_m(self.camera, &center, &(b - a).cross(&(c - a)));
        let nearest_m = a.z.min(b.z).min(c.z);
        bound.hides(&corners_px, nearest_m, slope_m, self.params)
    }
}
