use super::super::names::{NodeIdentity, Remap};
use super::*;

fn names(rules: &[(&str, &str)]) -> NameResolver {
    let remaps: Vec<_> = rules.iter().map(|(f, t)| Remap::new(f, t)).collect();
    NameResolver::new(NodeIdentity::new("/", "veneer").unwrap(), &remaps).unwrap()
}

fn offer(topic: &str, message_type: MessageType) -> Offer {
    Offer {
        topic: topic.to_owned(),
        type_name: message_type.name().to_owned(),
        is_reliable: true,
        is_latched: true,
    }
}

fn chosen(inputs: &[Input], choices: &[Choice]) -> Vec<(String, MessageType)> {
    let pair = |c: &Choice| (inputs[c.input].topic.clone(), c.message_type);
    choices.iter().map(pair).collect()
}

#[test]
fn what_is_certain_is_read_at_once() {
    let inputs = inputs(&names(&[]), &Config::default()).unwrap();
    let mut chooser = Chooser::new(&inputs);
    let now = Instant::now();
    let first = chosen(&inputs, &chooser.update(now, &[]));
    let topics: Vec<_> = first.iter().map(|(topic, _)| topic.as_str()).collect();
    assert_eq!(
        topics,
        [
            "/rgb/camera_info",
            "/depth/camera_info",
            "/tf",
            "/tf_static",
            "/odom"
        ]
    );
    assert!(chooser.update(now + SETTLE, &[]).is_empty());
}

#[test]
fn of_two_transports_the_compressed_one_is_taken_even_if_seen_later() {
    let inputs = inputs(&names(&[("rgb/image", "/cam/image")]), &Config::default()).unwrap();
    let mut chooser = Chooser::new(&inputs);
    let now = Instant::now();
    chooser.update(now, &[]);
    let mut offers = vec![offer("/cam/image", MessageType::Image)];
    assert!(chooser.update(now, &offers).is_empty());
    offers.push(offer("/cam/image/compressed", MessageType::CompressedImage));
    assert!(chooser.update(now + SETTLE / 2, &offers).is_empty());
    let choices = chooser.update(now + SETTLE, &offers);
    assert_eq!(
        chosen(&inputs, &choices),
        [(
            "/cam/image/compressed".to_owned(),
            MessageType::CompressedImage
        )]
    );
    assert!(chooser.update(now + 2 * SETTLE, &offers).is_empty());
}

#[test]
fn a_lone_transport_is_taken() {
    let mut config = Config::default();
    let inputs = inputs(&names(&[]), &config).unwrap();
    let mut chooser = Chooser::new(&inputs);
    let now = Instant::now();
    chooser.update(now, &[]);
    let offers = [offer("/depth/image", MessageType::Image)];
    chooser.update(now, &offers);
    let choices = chooser.update(now + SETTLE, &offers);
    assert_eq!(
        chosen(&inputs, &choices),
        [("/depth/image".to_owned(), MessageType::Image)]
    );
    config.set("image_transport", "raw").unwrap();
    let inputs = super::inputs(&names(&[]), &config).unwrap();
    let first = Chooser::new(&inputs).update(now, &[]);
    assert!(
        chosen(&inputs, &first).contains(&("/rgb/image".to_owned(), MessageType::Image)),
        "a transport that was named needs no publisher"
    );
}

#[test]
fn the_mesh_takes_type_and_reliability_from_its_publisher() {
    let inputs = inputs(&names(&[]), &Config::default()).unwrap();
    let mut chooser = Chooser::new(&inputs);
    let now = Instant::now();
    chooser.update(now, &[]);
    let offers = [
        offer("/mesh", MessageType::MarkerArray),
        offer("/mesh", MessageType::NvbloxMesh),
    ];
    chooser.update(now, &offers);
    let choices = chooser.update(now + SETTLE, &offers);
    assert_eq!(choices.len(), 1);
    assert_eq!(choices[0].message_type, MessageType::NvbloxMesh);
    assert!(choices[0].qos.is_reliable && choices[0].qos.is_latched);
}

#[test]
fn corrections_are_read_as_they_are_published() {
    let inputs = inputs(&names(&[]), &Config::default()).unwrap();
    let mut chooser = Chooser::new(&inputs);
    let now = Instant::now();
    let offers = [offer("/pose_corrections", MessageType::Path)];
    chooser.update(now, &offers);
    let choices = chooser.update(now + SETTLE, &offers);
    let expected = ("/pose_corrections".to_owned(), MessageType::Path);
    assert_eq!(chosen(&inputs, &choices), [expected]);
    assert!(choices[0].qos.is_reliable);
}

#[test]
fn one_info_for_both_cameras_is_read_once() {
    let rules = [("rgb/camera_info", "/info"), ("depth/camera_info", "/info")];
    let inputs = inputs(&names(&rules), &Config::default()).unwrap();
    let shared: Vec<_> = inputs.iter().filter(|i| i.topic == "/info").collect();
    assert_eq!(shared.len(), 1);
    assert_eq!(
        shared[0].roles,
        [TopicRole::ColorInfo, TopicRole::DepthInfo]
    );
}

#[test]
fn wrong_types_and_qos_are_told_with_the_remedy() {
    let mut config = Config::default();
    config
        .set(
            "qos_overrides./rgb/image.subscription.reliability",
            "reliable",
        )
        .unwrap();
    config.set("image_transport", "raw").unwrap();
    let inputs = inputs(&names(&[]), &config).unwrap();
    let mut chooser = Chooser::new(&inputs);
    chooser.update(Instant::now(), &[]);
    let mut image = offer("/rgb/image", MessageType::Image);
    image.is_reliable = false;
    let mut text = offer("/mesh", MessageType::Image);
    text.type_name = "std_msgs/msg/String".to_owned();
    let words = complaints(&inputs, &chooser, &[image, text]);
    assert_eq!(words.len(), 2, "{words:?}");
    assert!(words[0].contains("std_msgs/msg/String") && words[0].contains("/mesh"));
    assert!(words[1].contains("best effort") && words[1].contains("/rgb/image"));
    let fine = [offer("/rgb/image", MessageType::Image)];
    assert!(complaints(&inputs, &chooser, &fine).is_empty());
}
