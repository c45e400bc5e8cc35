//! The publisher against readers: ours, one that does as rviz2 does, one that reads GLB files.

mod bounds;
mod deltas;
mod made;
mod mirrors;
mod viewers;

use super::*;
use made::Scan;

fn everything(_: OutputTopic) -> bool {
    true
}

fn only(topic: OutputTopic) -> impl Fn(OutputTopic) -> bool {
    move |other| other == topic
}

fn messages_of(outgoing: &[Outgoing], topic: OutputTopic) -> Vec<&[u8]> {
    let messages = outgoing.iter().filter(|message| message.topic == topic);
    messages.map(|message| message.bytes.as_slice()).collect()
}

#[test]
fn what_did_not_change_is_not_sent_again() {
    let made = Scan::new(1).made();
    let mut publisher = Publisher::new(PublishParams::default());
    let first = publisher.publish(&made.snapshot(1), &everything).unwrap();
    for topic in OutputTopic::ALL {
        assert!(!messages_of(&first, topic).is_empty(), "{topic:?}");
    }
    // The same revision again, and a newer one of the same content.
    for revision in [1, 2] {
        let again = publisher.publish(&made.snapshot(revision), &everything);
        assert_eq!(again.unwrap(), []);
    }
    for topic in OutputTopic::ALL {
        publisher.forget(topic);
        let again = publisher.publish(&made.snapshot(2), &everything).unwrap();
        assert!(again.iter().all(|message| message.topic == topic));
        let num_first = messages_of(&first, topic).len();
        assert_eq!(messages_of(&again, topic).len(), num_first, "{topic:?}");
    }
}

/// Who vouches for charts saves a look at each triangle, and changes nothing of what is sent.
#[test]
fn known_keys_give_the_same_messages() {
    let mut scan = Scan::new(3);
    let [mut vouched, mut checked] = [(); 2].map(|()| Publisher::new(PublishParams::default()));
    for revision in 1..8 {
        let made = scan.made();
        let keys = ChartKey::of_all(&made.mesh, &made.layout);
        let known = Snapshot {
            chart_keys: Some(&keys),
            ..made.snapshot(revision)
        };
        let ours = vouched.publish(&known, &everything).unwrap();
        let theirs = checked.publish(&made.snapshot(revision), &everything);
        assert!(revision > 1 || !ours.is_empty());
        assert_eq!(ours, theirs.unwrap());
        scan.change(revision);
    }
}

#[test]
fn a_topic_that_nobody_wants_costs_nothing() {
    let mut made = Scan::new(2).made();
    let mut publisher = Publisher::new(PublishParams::default());
    // Anything computed of this would be an error.
    let chart_of_triangle = std::mem::take(&mut made.layout.chart_of_triangle);
    let nothing = publisher.publish(&made.snapshot(1), &|_| false).unwrap();
    assert_eq!(nothing, []);
    assert!(publisher.publish(&made.snapshot(1), &everything).is_err());
    made.layout.chart_of_triangle = chart_of_triangle;
    for topic in OutputTopic::ALL {
        let mut publisher = Publisher::new(PublishParams::default());
        let outgoing = publisher.publish(&made.snapshot(1), &only(topic)).unwrap();
        assert!(!outgoing.is_empty() && outgoing.iter().all(|m| m.topic == topic));
        // Who comes back gets the whole.
        assert_eq!(
            publisher.publish(&made.snapshot(1), &|_| false).unwrap(),
            []
        );
        let again = publisher.publish(&made.snapshot(1), &only(topic)).unwrap();
        assert_eq!(again.len(), outgoing.len(), "{topic:?}");
    }
}

#[test]
fn a_changed_state_must_be_newer() {
    let mut scan = Scan::new(3);
    let mut publisher = Publisher::new(PublishParams::default());
    publisher
        .publish(&scan.made().snapshot(5), &everything)
        .unwrap();
    scan.paint(7);
    let refused = publisher.publish(&scan.made().snapshot(5), &everything);
    assert!(matches!(
        refused,
        Err(PublishError::NotNewer {
            revision: 5,
            published: 5,
            ..
        })
    ));
    // After a refusal everybody gets the whole.
    let whole = publisher
        .publish(&scan.made().snapshot(6), &everything)
        .unwrap();
    let block = messages_of(&whole, OutputTopic::TexturedMesh)[0];
    assert_eq!(TexturedMeshBlock::decode(block).unwrap().base_revision, 0);
}

#[test]
fn the_thread_count_changes_nothing() {
    let messages = |num_threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(num_threads);
        pool.build().unwrap().install(|| {
            let mut scan = Scan::new(4);
            let mut publisher = Publisher::new(PublishParams {
                max_message_bytes: 20_000,
                ..PublishParams::default()
            });
            let mut all = Vec::new();
            for revision in 1..5 {
                all.extend(
                    publisher
                        .publish(&scan.made().snapshot(revision), &everything)
                        .unwrap(),
                );
                scan.change(revision);
            }
            all
        })
    };
    let reference = messages(1);
    assert!(reference.len() > 20);
    assert!(messages(4) == reference);
}

#[test]
fn parameters_out_of_range_are_refused_by_name() {
    let made = Scan::new(5).made();
    let default = PublishParams::default();
    for (params, name) in [
        (
            PublishParams {
                max_message_bytes: 100,
                ..default
            },
            "max_message_bytes",
        ),
        (
            PublishParams {
                tile_texel: 0,
                ..default
            },
            "tile_texel",
        ),
        (
            PublishParams {
                history_messages: 0,
                ..default
            },
            "history_messages",
        ),
    ] {
        let refused = Publisher::new(params).publish(&made.snapshot(1), &everything);
        assert!(refused.unwrap_err().to_string().contains(name));
    }
}

#[test]
fn keyframes_that_do_not_fit_are_the_oldest() {
    let made = Scan::new(6).made_with_keyframes(400);
    let params = PublishParams {
        max_message_bytes: 10_000,
        ..PublishParams::default()
    };
    let outgoing = Publisher::new(params)
        .publish(&made.snapshot(1), &only(OutputTopic::Keyframes))
        .unwrap();
    assert_eq!(outgoing.len(), 1);
    assert!(outgoing[0].bytes.len() <= 10_000);
    let array = PoseArray::decode(&outgoing[0].bytes).unwrap();
    assert!(array.poses.len() > 170);
    let last = array.poses.last().unwrap().position_m[0];
    let first = array.poses[0].position_m[0];
    assert_eq!((last, first), (399.0, 400.0 - array.poses.len() as f64));
}
