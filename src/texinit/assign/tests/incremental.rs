//! Frames one by one, in any order, with others that come and go: always the batch's result.

use super::*;
use crate::keyframe::FrameQuality;

/// What a random scene is made of: per frame its position, yaw, sharpness, and whether it has
/// depth and can be decoded.
type Views = Vec<([f64; 3], f64, f32, bool, bool)>;

fn scene_of(views: &Views) -> Scene {
    let wall = Panel {
        cells: [12, 9],
        paint: waves,
        ..WALL
    };
    let mut scene = Scene {
        panels: vec![wall, BOARD],
        ..Scene::default()
    };
    for &(position, yaw_rad, sharpness, has_depth, _) in views {
        scene.photograph(position, yaw_rad, &[], has_depth);
        if let Some(pose) = scene.poses.last_mut() {
            pose.quality = FrameQuality {
                sharpness,
                mean_luma: sharpness / 3.0,
                clipped: 0.01,
            };
        }
    }
    scene
}

fn views() -> impl Strategy<Value = Views> {
    let position = [-0.8..0.8f64, -0.4..0.4f64, -0.5..1.4f64];
    let view = (
        position,
        -0.4..0.4f64,
        0.1..3.0f32,
        prop::bool::weighted(0.8),
        prop::bool::weighted(0.85),
    );
    prop::collection::vec(view, 2..7)
}

fn forms() -> [AssignParams; 4] {
    [
        AssignParams::default(),
        AssignParams {
            pairwise: None,
            ..AssignParams::default()
        },
        AssignParams::paper(),
        AssignParams::paper_as_printed(),
    ]
}

const BROKEN: &str = "image encoding 'broken' is not supported";

fn add(table: &mut FrameTable, scene: &Scene, views: &Views, frame: usize) {
    let number = frame as u32;
    if views[frame].4 {
        table.add_pose(number, &scene.poses[frame], &scene.frames[frame]);
    } else {
        table.add_failed(number, BROKEN.to_owned());
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(24))]
    #[test]
    fn any_order_of_arrival_gives_the_batch(
        views in views(),
        keys in prop::collection::vec(any::<u32>(), 7),
        form in 0usize..4,
    ) {
        let scene = scene_of(&views);
        let params = &forms()[form];
        let decode = |frame: usize| match views[frame].4 {
            true => Ok(scene.frames[frame].clone()),
            false => Err(ImageError::Encoding("broken".to_owned())),
        };
        let mesh = Arc::new(scene.mesh());
        let batch = assign_poses(&mesh, &scene.poses, &decode, params, &|_| ()).unwrap();
        let mut order: Vec<usize> = (0..views.len()).collect();
        order.sort_by_key(|&frame| keys[frame]);
        let mut table = FrameTable::new(mesh, params.clone()).unwrap();
        for &frame in &order {
            add(&mut table, &scene, &views, frame);
        }
        prop_assert_eq!(table.assignment(), batch);
    }

    #[test]
    fn frames_that_are_gone_leave_no_trace(
        views in views(),
        comes_and_goes in prop::collection::vec((0usize..7, any::<bool>()), 1..20),
        form in 0usize..4,
    ) {
        let scene = scene_of(&views);
        let params = &forms()[form];
        let mesh = Arc::new(scene.mesh());
        let mut table = FrameTable::new(mesh.clone(), params.clone()).unwrap();
        let mut is_there = vec![false; views.len()];
        for (frame, is_coming) in comes_and_goes {
            let frame = frame % views.len();
            if is_coming {
                add(&mut table, &scene, &views, frame);
            } else {
                prop_assert_eq!(table.remove(frame as u32), is_there[frame]);
            }
            is_there[frame] = is_coming;
        }
        let mut fresh = FrameTable::new(mesh, params.clone()).unwrap();
        for frame in (0..views.len()).rev().filter(|&frame| is_there[frame]) {
            add(&mut fresh, &scene, &views, frame);
        }
        prop_assert_eq!(table.assignment(), fresh.assignment());
        prop_assert_eq!(table.num_bytes(), fresh.num_bytes());
        for frame in 0..views.len() {
            table.remove(frame as u32);
        }
        prop_assert_eq!(table.num_bytes(), 0);
        prop_assert!(table.assignment().label.iter().all(Option::is_none));
    }
}
