//! The hand that holds the camera: a smooth path with a tremor.

use nalgebra::{Matrix3, Point3, Rotation3, UnitQuaternion, Vector3};

use crate::geom::RigidTransform;

use super::hash::Stream;

/// A camera path through looks (eye, target), by uniform Catmull–Rom splines of both, with smooth
/// jitter of the eye and of the direction. World frame: z up.
#[derive(Clone, Debug)]
pub(super) struct HandHeldPath {
    looks_m: Vec<[[f64; 3]; 2]>,
    duration_s: f64,
    tremor: Stream,
}

/// Amplitude of the tremor: 6 mm and 0.4° at about one swing a second.
const TREMOR_M: f64 = 0.006;
const TREMOR_RAD: f64 = 0.007;
const TREMOR_HZ: f64 = 1.7;

impl HandHeldPath {
    pub(super) fn new(looks_m: &[[[f64; 3]; 2]], duration_s: f64, seed: u64) -> Self {
        Self {
            looks_m: looks_m.to_vec(),
            duration_s: duration_s.max(1e-9),
            tremor: Stream::new(seed, "tremor"),
        }
    }

    /// Pose of the optical frame (x right, y down, z forward) at a time from the path's start.
    pub(super) fn world_from_camera(&self, time_s: f64) -> RigidTransform {
        let share = (time_s / self.duration_s).clamp(0.0, 1.0);
        let [eye, target] = [0, 1].map(|end| self.spline(share, end));
        let shake = |channel: u64| self.tremor.sub(channel).walk(time_s * TREMOR_HZ);
        let eye = eye + Vector3::new(shake(0), shake(1), shake(2)) * TREMOR_M;
        let steady = look_at(&eye, &target);
        let twist = UnitQuaternion::from_scaled_axis(
            Vector3::new(shake(3), shake(4), shake(5)) * TREMOR_RAD,
        );
        RigidTransform::from_parts(steady * twist, eye.coords)
    }

    fn spline(&self, share: f64, end: usize) -> Point3<f64> {
        let last = self.looks_m.len().saturating_sub(1);
        let at = share * last as f64;
        #[expect(
            clippy::cast_possible_truncation,
            clippy::cast_sign_loss,
            reason = "in 0..=last"
        )]
        let index = (at.floor() as usize).min(last.saturating_sub(1));
        let t = at - index as f64;
        let knot = |k: usize| {
            let look = self.looks_m.get(k.min(last));
            look.map_or_else(Vector3::zeros, |look| Vector3::from(look[end]))
        };
        let (p0, p1) = (knot(index.saturating_sub(1)), knot(index));
        let (p2, p3) = (knot(index + 1), knot(index + 2));
        let linear = (p2 - p0) * t;
        let square = (p0 * 2.0 - p1 * 5.0 + p2 * 4.0 - p3) * (t * t);
        let cubic = (p1 * 3.0 - p0 - p2 * 3.0 + p3) * (t * t * t);
        Point3::from(p1 + (linear + square + cubic) * 0.5)
    }
}

/// Orientation of an optical frame at `eye` that looks at `target` with the world's z up.
fn look_at(eye: &Point3<f64>, target: &Point3<f64>) -> UnitQuaternion<f64> {
    let forward = (target - eye).normalize();
    let right = forward.cross(&Vector3::z()).normalize();
    let columns = Matrix3::from_columns(&[right, forward.cross(&right), forward]);
    UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(columns))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn looks_at_its_targets_right_way_up() {
        let looks = [
            [[0.0, 0.0, 1.0], [2.0, 0.0, 1.0]],
            [[0.5, 0.0, 1.0], [0.5, 2.0, 0.5]],
        ];
        let path = HandHeldPath::new(&looks, 10.0, 1);
        let pose = path.world_from_camera(10.0);
        let target_in_camera = pose.inverse().transform_point(&Point3::new(0.5, 2.0, 0.5));
        assert!(target_in_camera.z > 1.9);
        assert!(target_in_camera.x.abs() + target_in_camera.y.abs() < 0.08);
        let up_in_camera = pose.inverse().transform_vector(&Vector3::z());
        assert!(
            up_in_camera.y < -0.9,
            "optical y points down: {up_in_camera}"
        );
    }

    #[test]
    fn moves_smoothly() {
        let looks: Vec<_> = (0..8)
            .map(|k| {
                let a = f64::from(k);
                [[a.cos(), a.sin(), 1.0], [2.0 * a.cos(), 2.0 * a.sin(), 0.5]]
            })
            .collect();
        let path = HandHeldPath::new(&looks, 8.0, 3);
        for k in 0..7_990 {
            let time_s = f64::from(k) * 1e-3;
            let (angle_rad, distance_m) = path
                .world_from_camera(time_s)
                .distance_to(&path.world_from_camera(time_s + 1e-3));
            assert!(
                angle_rad < 0.004 && distance_m < 0.003,
                "jump at {time_s} s"
            );
        }
    }
}
