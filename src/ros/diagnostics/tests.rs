use super::super::inputs;
use super::super::names::{NameResolver, NodeIdentity};
use super::*;
use crate::config::Config;

fn all_inputs() -> Vec<Input> {
    let names = NameResolver::new(NodeIdentity::new("/", "veneer").unwrap(), &[]).unwrap();
    inputs::inputs(&names, &Config::default()).unwrap()
}

fn silent(inputs: &[Input]) -> Vec<InputObservation<'_>> {
    inputs
        .iter()
        .map(|input| InputObservation {
            input,
            num_publishers: 0,
            published_for: None,
            counts: TopicCounts::default(),
            rate_hz: 0.0,
            age: None,
            num_new_drops: 0,
        })
        .collect()
}

fn heard(observation: &mut InputObservation<'_>) {
    observation.num_publishers = 1;
    observation.counts.num_received = 10;
    observation.counts.num_taken = 10;
    observation.age = Some(Duration::from_millis(30));
}

fn observe<'a>(
    inputs: Vec<InputObservation<'a>>,
    complaints: &'a [String],
    paint: &'a PaintStatus,
) -> Observation<'a> {
    Observation {
        state: State::Active,
        is_paused: false,
        now: Some(Stamp::from_nanos(1)),
        inputs,
        complaints,
        capture: None,
        paint,
        why_whole: None,
        num_captures_replaced: 0,
        outputs: &[],
        publish_depth: 256,
        pose_source: PoseSource::Auto,
        transports: [Transport::Auto; 2],
        memory_bytes: 0,
        socket_remedy: None,
        notes: &[],
        queue_bytes: 0,
        journal: None,
    }
}

#[test]
fn what_is_missing_is_named_with_its_topic_and_remedy() {
    let all = all_inputs();
    let paint = PaintStatus::default();
    let found = findings(&observe(silent(&all), &[], &paint));
    let inputs = &found[0];
    assert_eq!(inputs.level, Level::Error);
    for words in [
        "/rgb/image/compressed or /rgb/image",
        "/rgb/camera_info",
        "/mesh",
        "no camera pose on any of /tf, /pose, /odom",
        "remap",
    ] {
        assert!(
            inputs.message.contains(words),
            "{words}: {}",
            inputs.message
        );
    }
    assert!(!inputs.message.contains("depth"), "{}", inputs.message);
}

#[test]
fn nothing_is_wrong_where_all_that_is_needed_arrives() {
    let all = all_inputs();
    let mut seen = silent(&all);
    let wanted = ["/rgb/image", "/rgb/camera_info", "/mesh", "/odom"];
    for observation in &mut seen {
        if wanted.contains(&observation.input.topic.as_str()) {
            heard(observation);
        }
    }
    let paint = PaintStatus::default();
    let found = findings(&observe(seen, &[], &paint));
    let worst = found.iter().map(|f| f.level).max();
    assert_eq!(worst, Some(Level::Ok), "{found:?}");
}

#[test]
fn drops_silence_and_mismatches_are_told() {
    let all = all_inputs();
    let mut seen = silent(&all);
    seen.iter_mut().for_each(heard);
    seen[0].num_new_drops = 3;
    let info = seen
        .iter_mut()
        .find(|i| i.input.topic == "/rgb/camera_info");
    info.unwrap().age = Some(Duration::from_secs(9));
    let complaints = ["/mesh is published as something".to_owned()];
    let paint = PaintStatus {
        last_error: Some("no texel".to_owned()),
        ..PaintStatus::default()
    };
    let found = findings(&observe(seen, &complaints, &paint));
    assert!(found[0].message.contains("topic_queue_size"), "{found:?}");
    assert!(found[0].message.contains("silent for 9 s"), "{found:?}");
    assert!(found[1].message.contains("/mesh is published as"));
    let painting = found.iter().find(|f| f.part == "painting").unwrap();
    assert_eq!(painting.level, Level::Error);
}

#[test]
fn what_the_environment_asks_for_in_vain_is_a_warning() {
    let all = all_inputs();
    let paint = PaintStatus::default();
    let notes = ["ROS_X is set, and cannot be had".to_owned()];
    let seen = Observation {
        notes: &notes,
        ..observe(silent(&all), &[], &paint)
    };
    let found = findings(&seen);
    let network = found.iter().find(|f| f.part == "network").unwrap();
    assert_eq!(network.level, Level::Warn);
    assert!(network.message.contains("ROS_X"), "{}", network.message);
}

#[test]
fn the_message_says_node_part_and_level() {
    let finding = Finding {
        level: Level::Warn,
        part: "inputs",
        message: "x".to_owned(),
        values: vec![value("a", 1)],
    };
    let bytes = message(Stamp::from_nanos(5), "/veneer", &[finding]);
    let array = DiagnosticArray::decode(&bytes).unwrap();
    assert_eq!(array.status.len(), 1);
    let status = &array.status[0];
    assert_eq!((status.level, status.name), (1, "/veneer: inputs"));
    assert_eq!(
        (status.message, &status.values[..]),
        ("x", &[("a", "1")][..])
    );
}

#[test]
fn that_each_change_paints_the_whole_is_told_with_its_reason() {
    let paint = PaintStatus {
        num_painted: 3,
        num_charts_waiting: 5,
        num_poses_waiting: 2,
        num_frames_waiting: 4,
        ..PaintStatus::default()
    };
    let mut seen = observe(vec![], &[], &paint);
    let painting = |seen: &Observation<'_>| {
        let found = findings(seen);
        found.into_iter().find(|f| f.part == "painting").unwrap()
    };
    let found = painting(&seen);
    assert!(!found.message.contains("whole"), "{}", found.message);
    let expected = [
        ("charts to refine", "5"),
        ("keyframes to align", "2"),
        ("keyframes to paint", "4"),
    ];
    for (key, number) in expected {
        let value = found.values.iter().find(|(name, _)| name == key);
        assert_eq!(value.unwrap().1, number);
    }
    seen.why_whole = Some("texsmooth.iterations");
    let found = painting(&seen);
    assert_eq!(found.level, Level::Ok);
    assert!(
        found.message.contains("texsmooth.iterations"),
        "{}",
        found.message
    );
}
