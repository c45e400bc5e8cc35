use super::*;

fn topics(list: &[(&str, MessageType, &str)]) -> Topics {
    let view = |&(name, message_type, encoding): &(&str, MessageType, &str)| {
        let peek = Peek {
            encoding: encoding.to_owned(),
            frame_id: if name.contains("other") {
                "other"
            } else {
                "cam"
            }
            .to_owned(),
            has_triangles: encoding == "triangles",
        };
        let view = TopicView {
            message_type,
            has_messages: encoding != "none",
            peek: Some(peek),
        };
        (name.to_owned(), view)
    };
    list.iter().map(view).collect()
}

fn plan(list: &[(&str, MessageType, &str)]) -> TopicPlan {
    TopicPlan::resolve(&TopicRoles::default(), &topics(list), |_| true).unwrap()
}

use MessageType as T;

#[test]
fn a_realsense_bag() {
    let plan = plan(&[
        ("/camera/color/image_raw", T::Image, "rgb8"),
        (
            "/camera/color/image_raw/compressed",
            T::CompressedImage,
            "rgb8; jpeg compressed bgr8",
        ),
        ("/camera/color/camera_info", T::CameraInfo, ""),
        ("/camera/depth/image_rect_raw", T::Image, "16UC1"),
        ("/camera/depth/camera_info", T::CameraInfo, ""),
        (
            "/camera/aligned_depth_to_color/image_raw",
            T::Image,
            "16UC1",
        ),
        (
            "/camera/aligned_depth_to_color/camera_info",
            T::CameraInfo,
            "",
        ),
        ("/camera/infra1/image_rect_raw", T::Image, "mono8"),
        ("/camera/infra1/camera_info", T::CameraInfo, ""),
        ("/tf", T::Tf, ""),
        ("/tf_static", T::Tf, ""),
        ("/nvblox_node/mesh", T::NvbloxMesh, ""),
        ("/markers", T::MarkerArray, ""),
    ]);
    let topic = |role| plan.topic(role).unwrap();
    assert_eq!(
        topic(TopicRole::Color),
        "/camera/color/image_raw/compressed"
    );
    assert_eq!(
        topic(TopicRole::Depth),
        "/camera/aligned_depth_to_color/image_raw"
    );
    assert_eq!(topic(TopicRole::ColorInfo), "/camera/color/camera_info");
    assert_eq!(
        topic(TopicRole::DepthInfo),
        "/camera/aligned_depth_to_color/camera_info"
    );
    assert_eq!(topic(TopicRole::Transforms), "/tf");
    assert_eq!(topic(TopicRole::StaticTransforms), "/tf_static");
    assert_eq!(topic(TopicRole::Mesh), "/nvblox_node/mesh");
    assert_eq!(plan.pose_source, PoseSource::Tf);
    assert_eq!(plan.missing, []);
}

#[test]
fn registered_depth_takes_the_info_of_its_frame() {
    let plan = plan(&[
        ("/rgb/image", T::Image, "bgr8"),
        ("/rgb/camera_info", T::CameraInfo, ""),
        (
            "/depth_registered/image/compressedDepth",
            T::CompressedImage,
            "16UC1; compressedDepth",
        ),
        ("/odom", T::Odometry, ""),
        ("/mesh_markers", T::Marker, "triangles"),
    ]);
    assert_eq!(plan.topic(TopicRole::DepthInfo), Some("/rgb/camera_info"));
    assert_eq!(plan.pose_source, PoseSource::Odom);
    assert_eq!(plan.topic(TopicRole::Odometry), Some("/odom"));
    assert_eq!(plan.topic(TopicRole::Mesh), Some("/mesh_markers"));
    assert_eq!(plan.missing, []);
}

#[test]
fn what_is_missing_comes_with_its_remedy() {
    let plan = plan(&[
        ("/other/image_rect", T::Image, "bgr8"),
        ("/cam2/camera_info", T::CameraInfo, ""),
        ("/cam3/camera_info", T::CameraInfo, ""),
        ("/tf", T::Tf, "none"),
        ("/markers", T::Marker, "cubes"),
    ]);
    let remedies: Vec<_> = plan
        .missing
        .iter()
        .map(|m| (m.role, m.remedy.as_str()))
        .collect();
    assert_eq!(remedies.len(), 3, "{remedies:?}");
    assert_eq!(remedies[0].0, TopicRole::ColorInfo);
    assert!(remedies[0].1.contains("/other/camera_info"));
    assert_eq!(remedies[1].0, TopicRole::Transforms);
    assert_eq!(remedies[2].0, TopicRole::Mesh);
}

#[test]
fn names_of_the_configuration_win_or_are_refused_with_what_there_is() {
    let topics = topics(&[
        ("/a/image/compressed", T::CompressedImage, "jpeg"),
        ("/b/image", T::Image, "rgb8"),
        ("/pose", T::PoseStamped, ""),
        ("/tf", T::Tf, ""),
    ]);
    let mut roles = TopicRoles {
        color: Some("/a/image".into()),
        pose: Some("/pose".into()),
        ..TopicRoles::default()
    };
    let plan = TopicPlan::resolve(&roles, &topics, |_| true).unwrap();
    assert_eq!(plan.topic(TopicRole::Color), Some("/a/image/compressed"));
    assert_eq!(plan.pose_source, PoseSource::Pose);
    roles.color = Some("/pose".into());
    let words = TopicPlan::resolve(&roles, &topics, |_| true)
        .unwrap_err()
        .to_string();
    assert!(
        words.contains("/b/image") && words.contains("PoseStamped"),
        "{words}"
    );
}

#[test]
fn a_tf_tree_that_does_not_move_the_camera_gives_way() {
    let list = [
        ("/image", T::Image, "rgb8"),
        ("/tf", T::Tf, ""),
        ("/goal_pose", T::PoseStamped, ""),
        ("/slam/camera_pose", T::PoseStamped, ""),
    ];
    let resolve = |moves| {
        TopicPlan::resolve(&TopicRoles::default(), &topics(&list), |frame| {
            assert_eq!(frame, "cam");
            moves
        })
        .unwrap()
    };
    assert_eq!(resolve(true).pose_source, PoseSource::Tf);
    assert_eq!(resolve(false).pose_source, PoseSource::Pose);
    assert_eq!(
        resolve(false).topic(TopicRole::Pose),
        Some("/slam/camera_pose")
    );
}

#[test]
fn corrections_of_our_own_type_are_taken_and_paths_only_where_named() {
    let list = [
        ("/loop/corrections", T::PoseCorrections, ""),
        ("/plan", T::Path, ""),
    ];
    assert_eq!(
        plan(&list).topic(TopicRole::Corrections),
        Some("/loop/corrections")
    );
    assert_eq!(plan(&list[1..]).topic(TopicRole::Corrections), None);
    let roles = TopicRoles {
        corrections: Some("/plan".to_owned()),
        ..TopicRoles::default()
    };
    let named = TopicPlan::resolve(&roles, &topics(&list), |_| true).unwrap();
    assert_eq!(named.topic(TopicRole::Corrections), Some("/plan"));
}
