use nalgebra::{Point3, UnitQuaternion, Vector3};
use proptest::prelude::*;

use super::super::event::Header;
use super::*;

const MS: i64 = 1_000_000;

fn tree() -> TransformTree {
    TransformTree::new(&IngestParams::default())
}

fn pose(angle_rad: f64, x: f64) -> RigidTransform {
    RigidTransform::from_parts(
        UnitQuaternion::from_axis_angle(&Vector3::z_axis(), angle_rad),
        Vector3::new(x, 0.0, 0.0),
    )
}

fn transform(
    parent: &str,
    child: &str,
    ms: i64,
    parent_from_child: RigidTransform,
) -> StampedTransform {
    StampedTransform {
        header: Header {
            stamp: Stamp::from_nanos(ms * MS),
            frame_id: Arc::from(parent),
        },
        child_frame_id: Arc::from(child),
        parent_from_child,
    }
}

fn ms(ms: i64) -> Stamp {
    Stamp::from_nanos(ms * MS)
}

/// Distance of where two transforms put a few points.
fn error(a: &RigidTransform, b: &RigidTransform) -> f64 {
    [[0.0; 3], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]
        .map(|p| {
            let p = Point3::from(p);
            (a.transform_point(&p) - b.transform_point(&p)).norm()
        })
        .into_iter()
        .fold(0.0, f64::max)
}

#[test]
fn screw_motion_is_interpolated_exactly() {
    // The body turns about its own axis and moves along it; the camera sits off the axis, so
    // that its own path is a helix.
    let axis = nalgebra::Unit::new_normalize(Vector3::new(1.0, 2.0, -0.5));
    let start = Vector3::new(0.3, -1.0, 2.0);
    let body_at = |s: f64| {
        RigidTransform::from_parts(
            UnitQuaternion::from_axis_angle(&axis, 1.7 * s),
            start + axis.into_inner() * (0.8 * s),
        )
    };
    let body_from_camera =
        RigidTransform::try_from_quaternion([0.5, -0.5, 0.5, -0.5], [0.2, 0.1, 0.4]).unwrap();
    let mut tree = tree();
    for i in 0..20 {
        let sample = transform("map", "body", i * 50, body_at(i as f64 * 0.05));
        tree.insert(&sample, false).unwrap();
    }
    let mount = transform("body", "camera", 0, body_from_camera);
    tree.insert(&mount, true).unwrap();
    for nanos in (0..900 * MS).step_by(7_654_321) {
        let stamp = Stamp::from_nanos(nanos);
        let found = tree.lookup("map", "camera", stamp, 0.0).unwrap();
        let expected = body_at(nanos as f64 * 1e-9) * body_from_camera;
        assert!(error(&found, &expected) < 1e-9);
        let back = tree.lookup("camera", "map", stamp, 0.0).unwrap();
        assert!(error(&back, &expected.inverse()) < 1e-9);
    }
}

#[test]
fn branches_meet_at_their_nearest_ancestor() {
    let mut tree = tree();
    // The edge above the ancestor is unknown at the stamp, which must not matter.
    tree.insert(&transform("map", "base", 0, pose(0.0, 9.0)), false)
        .unwrap();
    tree.insert(&transform("base", "left", 0, pose(0.3, 1.0)), true)
        .unwrap();
    tree.insert(&transform("/base", "/right", 0, pose(-0.2, 2.0)), true)
        .unwrap();
    let left_from_right = tree.lookup("left", "right", ms(5_000), 0.0).unwrap();
    let expected = pose(0.3, 1.0).inverse() * pose(-0.2, 2.0);
    assert!(error(&left_from_right, &expected) < 1e-12);
    assert!(matches!(
        tree.lookup("map", "left", ms(5_000), 0.0),
        Err(LookupError::AfterNewest { .. })
    ));
}

#[test]
fn extrapolation_stops_at_the_tolerance() {
    let mut tree = tree();
    for i in 0..3 {
        tree.insert(
            &transform("map", "cam", 100 + i * 10, pose(0.0, i as f64)),
            false,
        )
        .unwrap();
    }
    let x = |stamp, tolerance_s| {
        tree.lookup("map", "cam", stamp, tolerance_s)
            .map(|t| t.translation().x)
    };
    assert_eq!(x(ms(125), 0.005), Ok(2.0));
    assert!(matches!(
        x(ms(125), 0.004),
        Err(LookupError::AfterNewest { .. })
    ));
    assert!(matches!(
        x(ms(90), 0.009),
        Err(LookupError::BeforeOldest { .. })
    ));
    assert_eq!(x(ms(90), 0.01), Ok(0.0));
    assert_eq!(x(ms(105), 0.0), Ok(0.5));
}

#[test]
fn long_gaps_are_bridged_only_when_nothing_moved() {
    let mut tree = tree();
    tree.insert(&transform("map", "odom", 0, pose(0.0, 1.0)), false)
        .unwrap();
    tree.insert(&transform("map", "odom", 3_000, pose(0.0, 1.001)), false)
        .unwrap();
    tree.insert(&transform("odom", "cam", 0, pose(0.0, 0.0)), false)
        .unwrap();
    tree.insert(&transform("odom", "cam", 3_000, pose(0.0, 0.5)), false)
        .unwrap();
    assert!(tree.lookup("map", "odom", ms(1_500), 0.0).is_ok());
    assert!(matches!(
        tree.lookup("odom", "cam", ms(1_500), 0.0),
        Err(LookupError::Gap { .. })
    ));
}

#[test]
fn cycles_unknown_and_disconnected_frames_are_named() {
    let mut tree = tree();
    for (parent, child) in [("a", "b"), ("b", "c"), ("c", "a"), ("x", "y")] {
        tree.insert(&transform(parent, child, 0, pose(0.0, 1.0)), true)
            .unwrap();
    }
    assert!(matches!(
        tree.lookup("x", "b", ms(0), 0.0),
        Err(LookupError::Cycle { .. })
    ));
    assert!(matches!(
        tree.root_of("a", ms(0)),
        Err(LookupError::Cycle { .. })
    ));
    // Inside the cycle there still is a way.
    assert!(tree.lookup("a", "c", ms(0), 0.0).is_ok());
    assert!(matches!(
        tree.lookup("x", "nowhere", ms(0), 0.0),
        Err(LookupError::UnknownFrame { frame }) if frame == "nowhere"
    ));
    tree.insert(&transform("p", "q", 0, pose(0.0, 1.0)), true)
        .unwrap();
    assert!(matches!(
        tree.lookup("x", "q", ms(0), 0.0),
        Err(LookupError::Disconnected { .. })
    ));
}

#[test]
fn a_reparented_frame_is_known_on_either_side_of_the_change() {
    let mut tree = tree();
    tree.insert(&transform("map", "a", 0, pose(0.0, 10.0)), true)
        .unwrap();
    tree.insert(&transform("map", "b", 0, pose(0.0, 20.0)), true)
        .unwrap();
    for (parent, ms) in [("a", 0), ("a", 10), ("b", 20), ("b", 30)] {
        tree.insert(&transform(parent, "cup", ms, pose(0.0, 1.0)), false)
            .unwrap();
    }
    let x = |stamp| {
        tree.lookup("map", "cup", stamp, 0.0)
            .map(|t| t.translation().x)
    };
    assert_eq!(x(ms(5)), Ok(11.0));
    assert!(matches!(x(ms(15)), Err(LookupError::Reparented { .. })));
    assert_eq!(x(ms(25)), Ok(21.0));
}

#[test]
fn late_repeated_and_restarted_transforms() {
    let mut tree = tree();
    let mut insert = |ms, x| tree.insert(&transform("m", "c", ms, pose(0.0, x)), false);
    assert_eq!(insert(60_000, 0.0), Ok(()));
    assert_eq!(insert(60_020, 2.0), Ok(()));
    assert_eq!(insert(60_010, 1.0), Ok(()));
    assert_eq!(insert(60_010, 5.0), Err(TransformRefusal::Repeated));
    assert_eq!(insert(100, 0.0), Err(TransformRefusal::TooOld));
    assert_eq!(insert(110, 7.0), Ok(()));
    assert_eq!(insert(120, 8.0), Ok(()));
    assert!(tree.lookup("m", "c", ms(60_010), 0.0).is_err());
    assert!(tree.lookup("m", "c", ms(115), 0.0).is_ok());
}

#[test]
fn poses_of_another_frame_start_a_new_track() {
    let mut track = PoseTrack::new(&IngestParams::default());
    let mut insert = |child: &str, at_ms, x| {
        let header = Header {
            stamp: ms(at_ms),
            frame_id: Arc::from("m"),
        };
        track.insert(&header, Some(&Arc::from(child)), pose(0.0, x))
    };
    for (child, at_ms, x) in [
        ("a", 10, 1.0),
        ("a", 30, 1.0),
        ("b", 20, 2.0),
        ("b", 40, 2.0),
    ] {
        assert_eq!(insert(child, at_ms, x), Ok(()));
    }
    assert!(track.at(ms(15), 0.0).is_err(), "a's");
    let (_, found) = track.at(ms(30), 0.0).unwrap();
    assert_eq!(found.translation().x, 2.0);
}

#[test]
fn samples_are_bounded_in_time_and_number() {
    let mut tree = tree();
    for i in 0..40_000 {
        tree.insert(&transform("m", "c", i, pose(0.0, i as f64)), false)
            .unwrap();
    }
    assert!(tree.lookup("m", "c", ms(39_000), 0.0).is_ok());
    assert!(tree.lookup("m", "c", ms(29_000), 0.0).is_err());
    let Some(Edge::Moving(track)) = tree.edge_by_child.get("c") else {
        panic!("a moving edge");
    };
    assert!(track.samples.len() <= 10_001);
}

proptest! {
    #[test]
    fn any_tree_answers_without_panic_and_inverts(
        edges in prop::collection::vec((0u8..6, 0u8..6, -50i64..50, any::<bool>()), 0..60),
        at in -60i64..60,
    ) {
        let mut tree = tree();
        let name = |i: u8| format!("f{i}");
        for (parent, child, ms, is_static) in edges {
            let pose = pose(f64::from(parent), f64::from(child));
            let edge = transform(&name(parent), &name(child), ms, pose);
            let is_stored = tree.insert(&edge, is_static).is_ok();
            prop_assert!(!(is_stored && parent == child));
        }
        for (a, b) in [(0, 1), (2, 3), (5, 0)] {
            let there = tree.lookup(&name(a), &name(b), ms(at), 0.01);
            let back = tree.lookup(&name(b), &name(a), ms(at), 0.01);
            if let (Ok(there), Ok(back)) = (there, back) {
                // In a cycle there are two ways round, which need not agree.
                if tree.root_of(&name(a), ms(at)).is_ok() {
                    prop_assert!(error(&(there * back), &RigidTransform::identity()) < 1e-9);
                }
            }
        }
    }
}

#[test]
fn frames_and_transforms_are_bounded() {
    let mut params = IngestParams::default();
    params.limits.tf_frames = 3;
    params.limits.tf_samples = 4;
    let mut tree = TransformTree::new(&params);
    for i in 0..3 {
        let child = format!("frame {i}");
        tree.insert(&transform("map", &child, 0, pose(0.0, 0.0)), false)
            .unwrap();
    }
    let further = transform("map", "frame 3", 0, pose(0.0, 0.0));
    for is_static in [true, false] {
        let refused = tree.insert(&further, is_static);
        assert_eq!(refused, Err(TransformRefusal::TooManyFrames));
    }
    for i in 1..10 {
        tree.insert(&transform("map", "frame 0", i, pose(0.0, 0.0)), false)
            .unwrap();
    }
    // Of the stamps 0 to 9 the last four are left.
    assert!(tree.lookup("map", "frame 0", ms(6), 0.0).is_ok());
    assert!(tree.lookup("map", "frame 0", ms(5), 0.0).is_err());
}
