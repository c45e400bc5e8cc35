//! Which way is up in a data set's world, and the turn that makes it +z, as ROS has it (REP 103).
//!
//! Captures are in the first camera's frame, or y up. The guess starts from how the cameras are
//! held (image up plus against the view, for scanners look level or down) and climbs to the mean
//! normal of the mesh's faces in a narrowing cone around it: floors, tables and ceilings are what
//! a scan has most of in that direction. Faces count by area and with either sign. Limits: a scan
//! of nothing but slopes has no answer, and one of a steep roof a wrong one; then say it by hand.

use nalgebra::{Unit, UnitQuaternion, Vector3};

use crate::geom::RigidTransform;
use crate::mesh::TriMesh;

use super::options::{SignedAxis, WorldUp};
use super::scan::Scan;

/// Half angles of the cones, in turn; the narrow ones repeat until the mean hardly moves.
const CONES_DEG: [f64; 9] = [60.0, 45.0, 30.0, 20.0, 10.0, 10.0, 5.0, 5.0, 5.0];

/// Cameras whose ups nearly cancel out say nothing (1: all are held alike).
const MIN_AGREEMENT: f64 = 0.2;

/// Level faces are at least this share of the mesh's area, or what was found is chance.
const MIN_LEVEL_AREA_SHARE: f64 = 0.03;

/// An axis this near is meant: phones know gravity better than a mesh's normals do.
const SNAP_DEG: f64 = 3.0;

/// Up in the data set's world.
pub(super) fn up_in_world(
    option: WorldUp,
    scan: &Scan,
    mesh: Option<&TriMesh>,
) -> Option<Unit<Vector3<f64>>> {
    match option {
        WorldUp::AsRecorded => None,
        WorldUp::Axis(axis) => Some(direction(axis)),
        WorldUp::Level => {
            let poses = scan.frames.iter().map(|frame| &frame.world_from_camera);
            estimate(poses, mesh?).map(snapped)
        }
    }
}

/// The smallest turn that takes `up` to +z.
pub(super) fn turn(up: &Unit<Vector3<f64>>) -> RigidTransform {
    let rotation = UnitQuaternion::rotation_between_axis(up, &Vector3::z_axis())
        // Upside down: any half turn does.
        .unwrap_or_else(|| {
            UnitQuaternion::from_axis_angle(&Vector3::x_axis(), std::f64::consts::PI)
        });
    RigidTransform::from_parts(rotation, Vector3::zeros())
}

fn direction(axis: SignedAxis) -> Unit<Vector3<f64>> {
    match axis {
        SignedAxis::X => Vector3::x_axis(),
        SignedAxis::NegX => -Vector3::x_axis(),
        SignedAxis::Y => Vector3::y_axis(),
        SignedAxis::NegY => -Vector3::y_axis(),
        SignedAxis::Z => Vector3::z_axis(),
        SignedAxis::NegZ => -Vector3::z_axis(),
    }
}

fn estimate<'a>(
    poses: impl ExactSizeIterator<Item = &'a RigidTransform>,
    mesh: &TriMesh,
) -> Option<Unit<Vector3<f64>>> {
    // In the optical frame y is down and z along the view.
    let up_in_camera = Vector3::new(0.0, -1.0, -1.0).normalize();
    let num_poses = poses.len() as f64;
    let held: Vector3<f64> = poses
        .map(|world_from_camera| world_from_camera.transform_vector(&up_in_camera))
        .sum();
    let mut up = Unit::try_new(held, MIN_AGREEMENT * num_poses)?;
    let normals: Vec<Vector3<f64>> = mesh
        .triangle_ids()
        .map(|triangle| mesh.scaled_normal(triangle))
        .collect();
    let mut level_area = 0.0;
    for half_angle_deg in CONES_DEG {
        let (mean, area) = mean_in_cone(&normals, &up, half_angle_deg.to_radians().cos());
        up = Unit::try_new(mean, f64::MIN_POSITIVE)?;
        level_area = area;
    }
    let whole_area: f64 = normals.iter().map(Vector3::norm).sum();
    (level_area >= MIN_LEVEL_AREA_SHARE * whole_area).then_some(up)
}

/// Sum of the normals whose lines are in the cone, and of their lengths.
fn mean_in_cone(
    normals: &[Vector3<f64>],
    axis: &Unit<Vector3<f64>>,
    min_cosine: f64,
) -> (Vector3<f64>, f64) {
    let mut sum = Vector3::zeros();
    let mut total = 0.0;
    for normal in normals {
        let length = normal.norm();
        let along = normal.dot(axis);
        if along.abs() > min_cosine * length {
            sum += normal * along.signum();
            total += length;
        }
    }
    (sum, total)
}

fn snapped(up: Unit<Vector3<f64>>) -> Unit<Vector3<f64>> {
    let min_cosine = SNAP_DEG.to_radians().cos();
    let mut axes = SignedAxis::ALL.map(|(_, axis)| direction(axis)).into_iter();
    axes.find(|axis| axis.dot(&up) >= min_cosine).unwrap_or(up)
}

#[cfg(test)]
mod tests {
    use nalgebra::Point3;

    use super::*;

    /// A floor of 2 × 2 m with walls of 2 × `wall_m` on two sides, z up.
    fn corner(wall_m: f64) -> TriMesh {
        let quad = |a: [f64; 3], u: [f64; 3], v: [f64; 3]| {
            let [a, u, v] = [a, u, v].map(Vector3::from);
            [a, a + u, a + u + v, a + v].map(Point3::from)
        };
        let quads = [
            quad([0.0; 3], [2.0, 0.0, 0.0], [0.0, 2.0, 0.0]),
            quad([0.0; 3], [2.0, 0.0, 0.0], [0.0, 0.0, wall_m]),
            quad([0.0; 3], [0.0, 2.0, 0.0], [0.0, 0.0, wall_m]),
        ];
        let triangles =
            (0..3).flat_map(|q| [[4 * q, 4 * q + 1, 4 * q + 2], [4 * q, 4 * q + 2, 4 * q + 3]]);
        TriMesh::from_soup(quads.concat(), triangles.collect())
            .unwrap()
            .0
    }

    /// A camera held level that looks `pitch` below the horizon, in a z-up world.
    fn pose(yaw_rad: f64, pitch_rad: f64, roll_rad: f64) -> RigidTransform {
        let optical = UnitQuaternion::from_euler_angles(-std::f64::consts::FRAC_PI_2, 0.0, 0.0);
        let yaw = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), yaw_rad);
        let pitch = UnitQuaternion::from_axis_angle(&Vector3::x_axis(), -pitch_rad);
        let roll = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), roll_rad);
        RigidTransform::from_parts(yaw * optical * pitch * roll, Vector3::new(1.0, 1.0, 1.5))
    }

    fn assert_up(world_from_level: &UnitQuaternion<f64>, poses: &[RigidTransform], mesh: &TriMesh) {
        let world_from_level = RigidTransform::from_parts(*world_from_level, Vector3::zeros());
        let poses: Vec<_> = poses.iter().map(|pose| world_from_level * *pose).collect();
        let mesh = mesh.transformed(&world_from_level);
        let up = estimate(poses.iter(), &mesh).unwrap();
        let expected = world_from_level.transform_vector(&Vector3::z());
        assert!(up.angle(&expected) < 1e-9, "{up:?} {expected:?}");
        let turned = turn(&up).transform_vector(&expected);
        assert!((turned - Vector3::z()).norm() < 1e-9, "{turned:?}");
    }

    #[test]
    fn the_test_camera_looks_down_and_is_held_upright() {
        let pose = pose(0.3, 0.5, 0.0);
        assert!(pose.transform_vector(&Vector3::z()).z < -0.4);
        assert!(pose.transform_vector(&Vector3::y()).z < -0.8);
    }

    #[test]
    fn up_is_found_in_any_world() {
        for k in 0..40 {
            let k = f64::from(k);
            let turn = UnitQuaternion::from_euler_angles(0.7 * k, 1.3 * k, 2.1 * k);
            // A sweep through half a room; the phone upright, or on its side and looking down.
            let upright: Vec<_> = (0..9).map(|i| pose(0.3 * f64::from(i), 0.5, 0.1)).collect();
            assert_up(&turn, &upright, &corner(2.5));
            let sideways: Vec<_> = (0..9).map(|i| pose(0.1 * f64::from(i), 1.3, 1.5)).collect();
            assert_up(&turn, &sideways, &corner(0.5));
        }
    }

    #[test]
    fn without_evidence_there_is_no_answer() {
        let above = pose(0.0, 0.5, 0.0);
        let upside_down = RigidTransform::from_parts(
            UnitQuaternion::from_axis_angle(&Vector3::x_axis(), std::f64::consts::PI),
            Vector3::zeros(),
        ) * above;
        let mesh = corner(2.5);
        assert_eq!(estimate([above, upside_down].iter(), &mesh), None);
        assert_eq!(estimate([above].iter(), &TriMesh::default()), None);
        assert_eq!(estimate([].iter(), &mesh), None);
    }

    #[test]
    fn axes_are_met_exactly_and_half_turns_are_turns() {
        for (_, axis) in SignedAxis::ALL {
            let exact = direction(axis);
            let near = Unit::new_normalize(exact.into_inner() + Vector3::new(0.02, -0.02, 0.02));
            assert_eq!(snapped(near), exact);
            let turned = turn(&exact).transform_vector(&exact);
            assert!((turned - Vector3::z()).norm() < 1e-15, "{turned:?}");
        }
        let slanted = Unit::new_normalize(Vector3::new(0.0, -0.72, -0.69));
        assert_eq!(snapped(slanted), slanted);
    }
}
