//! Bags of every shape, whole and damaged: what is read must be what was written before the
//! damage.

use std::collections::BTreeMap;
use std::io::Cursor;
use std::path::Path;

use mcap::records::MessageHeader;
use mcap::{WriteOptions, Writer};
use proptest::prelude::*;

use super::*;
use crate::geom::{DepthEncoding, Stamp};
use crate::ingest::{Event, EventSource, TimedEvent};
use crate::wire::geometry::WirePose;
use crate::wire::header::WireHeader;
use crate::wire::tf_message::TransformStamped;
use crate::wire::{Image, Message, PoseStamped, TfMessage, TopicRole};

fn header(nanos: u64) -> WireHeader<'static> {
    WireHeader {
        stamp: Stamp::from_nanos(i64::try_from(nanos).unwrap()),
        frame_id: "cam",
    }
}

/// Colour, depth and TF messages, and a topic that nobody reads, at 1 ms steps.
fn messages(num: u64) -> Vec<(usize, u64, Vec<u8>)> {
    let pixels: Vec<u8> = (0..=255).cycle().take(4 * 3 * 3).collect();
    (0..num)
        .map(|i| {
            let nanos = 1_000_000 * (i + 1);
            let image = |encoding, step| Image {
                header: header(nanos),
                height: 3,
                width: 4,
                encoding,
                is_bigendian: false,
                step,
                data: &pixels[..3 * step as usize],
            };
            let bytes = match i % 4 {
                0 => image("rgb8", 12).encode(),
                1 => image("16UC1", 8).encode(),
                2 => TfMessage {
                    transforms: vec![TransformStamped {
                        header: header(nanos),
                        child_frame_id: "cam",
                        transform: WirePose {
                            position_m: [i as f64, 0.0, 0.0],
                            ..WirePose::IDENTITY
                        },
                    }],
                }
                .encode(),
                _ => vec![0, 1, 0, 0, 9],
            };
            (usize::try_from(i % 4).unwrap(), nanos, bytes)
        })
        .collect()
}

const TOPICS: [(&str, &str, &str); 4] = [
    ("/color/image_raw", Image::TYPE_NAME, Image::SCHEMA),
    ("/depth/image_raw", Image::TYPE_NAME, Image::SCHEMA),
    ("/tf", TfMessage::TYPE_NAME, TfMessage::SCHEMA),
    ("/unused", "std_msgs/msg/UInt8", "uint8 data\n"),
];

/// What becomes of a bag that is written with certain options.
fn write(options: WriteOptions, messages: &[(usize, u64, Vec<u8>)]) -> Vec<u8> {
    let mut writer: Writer<_> = options
        .profile("ros2")
        .create(Cursor::new(Vec::new()))
        .unwrap();
    let channels = TOPICS.map(|(topic, type_name, schema)| {
        let schema = writer
            .add_schema(type_name, "ros2msg", schema.as_bytes())
            .unwrap();
        writer
            .add_channel(schema, topic, "cdr", &BTreeMap::new())
            .unwrap()
    });
    for (sequence, (topic, log_time, bytes)) in messages.iter().enumerate() {
        let header = MessageHeader {
            channel_id: channels[*topic],
            sequence: u32::try_from(sequence).unwrap(),
            log_time: *log_time,
            publish_time: *log_time,
        };
        writer.write_to_known_channel(&header, bytes).unwrap();
    }
    writer.finish().unwrap();
    writer.into_inner().into_inner()
}

fn shapes() -> Vec<(&'static str, WriteOptions)> {
    let plain = || WriteOptions::new().compression(None).compression_threads(0);
    let small = |o: WriteOptions| o.chunk_size(Some(600));
    let bare = |o: WriteOptions| {
        o.emit_summary_records(false)
            .emit_summary_offsets(false)
            .emit_message_indexes(false)
    };
    let zstd = || plain().compression(Some(mcap::Compression::Zstd));
    let lz4 = || plain().compression(Some(mcap::Compression::Lz4));
    vec![
        ("one chunk", plain()),
        ("small chunks", small(plain())),
        ("zstd", small(zstd())),
        ("lz4", small(lz4())),
        ("no chunks", plain().use_chunks(false)),
        ("no chunks, no summary", bare(plain().use_chunks(false))),
        ("no index", bare(small(plain()))),
        ("zstd, no index", bare(small(zstd()))),
        ("lz4, no index", bare(small(lz4()))),
        (
            "no message index",
            small(zstd()).emit_message_indexes(false),
        ),
        ("no chunk index", small(lz4()).emit_chunk_indexes(false)),
        (
            "no repeated channels",
            small(plain()).repeat_channels(false).repeat_schemas(false),
        ),
    ]
}

fn open(bytes: &[u8], roles: &TopicRoles) -> Result<BagReader, BagError> {
    let file = tempfile::NamedTempFile::new().unwrap();
    std::fs::write(file.path(), bytes).unwrap();
    // The mapping outlives the file's name.
    BagReader::open(file.path(), roles)
}

fn read(bytes: &[u8]) -> (Vec<TimedEvent>, Vec<String>) {
    let mut reader = open(bytes, &TopicRoles::default()).unwrap();
    let events = std::iter::from_fn(|| reader.next_event()).collect();
    (events, reader.losses().to_vec())
}

fn stamps(events: &[TimedEvent]) -> Vec<u64> {
    let nanos = events.iter().map(|e| e.received.as_nanos());
    nanos.map(|n| u64::try_from(n).unwrap()).collect()
}

/// Log times of the messages that are read.
fn expected(messages: &[(usize, u64, Vec<u8>)]) -> Vec<u64> {
    let used = messages.iter().filter(|(topic, ..)| *topic < 3);
    used.map(|(_, time, _)| *time).collect()
}

#[test]
fn every_shape_gives_the_same_events() {
    let messages = messages(60);
    let mut first = None;
    for (shape, options) in shapes() {
        let (events, losses) = read(&write(options, &messages));
        assert_eq!(losses, [] as [String; 0], "{shape}");
        assert_eq!(stamps(&events), expected(&messages), "{shape}");
        assert!(events.iter().all(|e| e.event.is_ok()), "{shape}");
        assert_eq!(first.get_or_insert(events.clone()), &events, "{shape}");
    }
    let events = first.unwrap();
    assert!(matches!(&events[0].event, Ok(Event::Color(h, _)) if &*h.frame_id == "cam"));
    let Ok(Event::Depth(_, depth)) = &events[1].event else {
        unreachable!("{:?}", events[1])
    };
    assert_eq!(depth.encoding(), DepthEncoding::U16Mm { big_endian: false });
}

#[test]
fn messages_out_of_order_are_merged_by_time() {
    let mut messages = messages(60);
    // Deterministic shuffle; ties come in the order of channels, then of the file.
    messages.sort_by_key(|(_, time, _)| (time / 1_000_000 * 37) % 61);
    for message in &mut messages[..10] {
        message.1 = 7;
    }
    let mut by_time: Vec<_> = messages.iter().filter(|m| m.0 < 3).collect();
    by_time.sort_by_key(|(topic, time, _)| (*time, *topic));
    for (shape, options) in shapes() {
        let (events, _) = read(&write(options, &messages));
        assert_eq!(stamps(&events).len(), by_time.len(), "{shape}");
        for (event, (topic, time, bytes)) in events.iter().zip(&by_time) {
            assert_eq!(event.received.as_nanos(), i64::try_from(*time).unwrap());
            if *topic == 0 {
                let stamp = Image::decode(bytes).unwrap().header.stamp;
                assert!(matches!(&event.event, Ok(Event::Color(h, _)) if h.stamp == stamp));
            }
        }
    }
}

#[test]
fn seeking_continues_at_the_time_asked_for() {
    let messages = messages(60);
    for (shape, options) in shapes() {
        let mut reader = open(&write(options, &messages), &TopicRoles::default()).unwrap();
        let all = expected(&messages);
        for from in [30_500_000u64, 1, 45_000_000, 0, 99_000_000] {
            reader.seek(Stamp::from_nanos(i64::try_from(from).unwrap()));
            let events: Vec<_> = std::iter::from_fn(|| reader.next_event()).collect();
            let later: Vec<u64> = all.iter().copied().filter(|&t| t >= from).collect();
            assert_eq!(stamps(&events), later, "{shape} from {from}");
        }
    }
}

#[test]
fn truncation_at_any_byte_gives_a_prefix() {
    let messages = messages(16);
    for (shape, options) in shapes() {
        let bytes = write(options, &messages);
        let (whole, _) = read(&bytes);
        let mut num_events = whole.len();
        let file = tempfile::NamedTempFile::new().unwrap();
        std::fs::write(file.path(), &bytes).unwrap();
        for length in (0..bytes.len()).rev() {
            file.as_file().set_len(length as u64).unwrap();
            let Ok(mut reader) = BagReader::open(file.path(), &TopicRoles::default()) else {
                assert!(length < record::MAGIC.len(), "{shape} {length}");
                continue;
            };
            let events: Vec<_> = std::iter::from_fn(|| reader.next_event()).collect();
            assert!(!reader.losses().is_empty(), "{shape} {length}");
            let same = events.iter().zip(&whole).all(|(a, b)| a.event == b.event);
            assert!(same && events.len() <= num_events, "{shape} {length}");
            if length >= bytes.len() - record::MAGIC.len() {
                assert_eq!(
                    events.len(),
                    whole.len(),
                    "{shape}: only the end mark is cut"
                );
            }
            num_events = events.len();
        }
        assert_eq!(num_events, 0, "{shape}");
    }
}

#[test]
fn damage_inside_a_chunk_loses_that_chunk_and_says_so() {
    let messages = messages(60);
    for (shape, options) in shapes().into_iter().take(4).skip(1) {
        let mut bytes = write(options, &messages);
        let mut chunks = Vec::new();
        let mut at = record::MAGIC.len();
        while let Ok(record) = record::record_at(&bytes, at, bytes.len() - record::MAGIC.len()) {
            at = record.body.end;
            chunks.extend((record.opcode == record::op::CHUNK).then_some(record.body));
        }
        let middle = &chunks[chunks.len() / 2];
        bytes[middle.end - middle.len() / 3] ^= 0x10;
        let (events, losses) = read(&bytes);
        assert_eq!(losses.len(), 1, "{shape} {losses:?}");
        let (read, all) = (stamps(&events), expected(&messages));
        assert!(
            read.len() < all.len() && read.len() > all.len() / 2,
            "{shape}"
        );
        assert!(read.iter().all(|t| all.contains(t)));
        assert!(read.contains(&all[0]) && read.contains(&all[all.len() - 1]));
    }
}

#[test]
fn broken_framing_goes_on_at_the_next_chunk_of_the_index() {
    let messages = messages(60);
    let options = || WriteOptions::new().compression(None).chunk_size(Some(600));
    let mut bytes = write(options(), &messages);
    // The first message index record: its length points past everything.
    let mut at = record::MAGIC.len();
    while bytes[at] != record::op::MESSAGE_INDEX {
        let record = record::record_at(&bytes, at, bytes.len()).unwrap();
        at = record.body.end;
    }
    bytes[at + 1..at + 9].fill(0xff);
    let (events, losses) = read(&bytes);
    assert_eq!(stamps(&events), expected(&messages));
    assert_eq!(
        losses,
        [] as [String; 0],
        "listed chunks do not need their message indexes"
    );
    // Without a summary the walk ends there, and says so.
    let mut bytes = write(options().emit_chunk_indexes(false), &messages);
    bytes[at + 1..at + 9].fill(0xff);
    let (events, losses) = read(&bytes);
    assert!(!events.is_empty() && events.len() < expected(&messages).len());
    assert!(
        losses.iter().any(|l| l.contains(&format!("byte {at}"))),
        "{losses:?}"
    );
}

#[test]
fn what_is_no_bag_is_named() {
    let words = |bytes: &[u8]| match open(bytes, &TopicRoles::default()) {
        Err(error) => error.to_string(),
        Ok(_) => String::new(),
    };
    assert!(words(b"").contains("empty"));
    assert!(words(b"SQLite format 3\0....").contains("ros2 bag convert"));
    assert!(words(b"#ROSBAG V2.0\n").contains("ROS 1"));
    assert!(words(b"hello").contains("not an MCAP"));
    let missing = BagReader::open(Path::new("/nowhere/at.mcap"), &TopicRoles::default());
    assert!(
        missing
            .err()
            .unwrap()
            .to_string()
            .contains("/nowhere/at.mcap")
    );
}

#[test]
fn the_writer_gives_what_the_reader_reads() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("scan.mcap");
    let pose = PoseStamped {
        header: header(5),
        pose: WirePose::IDENTITY,
    };
    for compression in [Compression::None, Compression::Lz4, Compression::Zstd] {
        let mut bag = BagWriter::create(&path, compression).unwrap();
        let channel = bag
            .add_channel("/pose", PoseStamped::TYPE_NAME, PoseStamped::SCHEMA)
            .unwrap();
        for i in 0..3 {
            bag.write(channel, Stamp::from_nanos(i), &pose.encode())
                .unwrap();
        }
        let pairs = BTreeMap::from([("seed".to_owned(), "7".to_owned())]);
        bag.write_metadata("veneer_scene", pairs.clone()).unwrap();
        let summary = bag.finish().unwrap();
        assert_eq!(summary.num_messages["/pose"], 3);
        assert_eq!(summary.num_bytes, std::fs::metadata(&path).unwrap().len());
        assert_eq!(metadata(&path, "veneer_scene").unwrap(), Some(pairs));
        assert_eq!(metadata(&path, "other").unwrap(), None);
        // A rosbag2 folder stands for the bag in it.
        let mut reader = BagReader::open(folder.path(), &TopicRoles::default()).unwrap();
        assert_eq!(reader.plan().topic(TopicRole::Pose), Some("/pose"));
        let events: Vec<_> = std::iter::from_fn(|| reader.next_event()).collect();
        assert_eq!(events.len(), 3);
        assert!(matches!(&events[2].event, Ok(Event::Pose(h, _)) if h == &header(5).to_header()));
    }
    assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 1);
}

#[test]
fn an_unfinished_bag_leaves_nothing() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("scan.mcap");
    drop(BagWriter::create(&path, Compression::None).unwrap());
    assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 0);
    assert!(
        BagWriter::create(
            &folder.path().join("no/such/folder.mcap"),
            Compression::None
        )
        .is_err()
    );
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(300))]
    #[test]
    fn mutated_bags_never_panic(
        shape in 0usize..12,
        changes in prop::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 1..8),
    ) {
        let (_, options) = shapes().swap_remove(shape);
        let messages = messages(16);
        let mut bytes = write(options, &messages);
        for (at, value) in changes {
            let at = at.index(bytes.len());
            bytes[at] = value;
        }
        if let Ok(mut reader) = open(&bytes, &TopicRoles::default()) {
            let mut num_events = 0;
            while reader.next_event().is_some() {
                num_events += 1;
            }
            prop_assert!(num_events <= 2 * messages.len());
        }
    }
}

#[test]
fn info_counts_rates_gaps_refusals_and_what_is_missing() {
    let mut messages = messages(80);
    // A pause of 50 ms after the first half, and one broken depth image.
    for message in &mut messages[40..] {
        message.1 += 50_000_000;
    }
    messages[5].2.truncate(40);
    let file = tempfile::NamedTempFile::new().unwrap();
    std::fs::write(file.path(), write(WriteOptions::new(), &messages)).unwrap();
    let info = BagInfo::read(file.path(), &TopicRoles::default()).unwrap();
    let topic = |name: &str| info.topics.iter().find(|t| t.topic == name).unwrap();
    let color = topic("/color/image_raw");
    assert_eq!(
        (color.num_messages, color.num_gaps, color.num_refused),
        (20, 1, 0)
    );
    assert_eq!(color.roles, [TopicRole::Color]);
    // 20 messages over 76 + 50 ms.
    assert!((color.rate_hz.unwrap() - 19.0 / 0.126).abs() < 1e-6);
    assert!((color.longest_gap_s - 0.054).abs() < 1e-9);
    assert_eq!(color.encoding.as_deref(), Some("rgb8"));
    let depth = topic("/depth/image_raw");
    assert_eq!(
        (depth.num_refused, depth.roles.as_slice()),
        (1, &[TopicRole::Depth][..])
    );
    assert!(topic("/unused").roles.is_empty());
    // Depth is 1 ms behind colour; the one whose partner is broken has its next 3 ms before.
    let sync = info.sync.as_ref().unwrap();
    assert_eq!((sync.num_color, sync.num_exact), (20, 0));
    assert!((sync.median_s - 0.001).abs() < 1e-12 && (sync.max_s - 0.003).abs() < 1e-12);
    let roles: Vec<_> = info.missing.iter().map(|m| m.role).collect();
    assert_eq!(
        roles,
        [TopicRole::ColorInfo, TopicRole::DepthInfo, TopicRole::Mesh]
    );
    let words = info.to_string();
    for part in [
        "/color/image_raw  sensor_msgs/msg/Image  20 messages  150.8 Hz  1 gaps",
        "used for colour images",
        "1 refused, the first: 0.006000000: sensor_msgs/msg/Image.",
        "record /color/camera_info",
        "no mesh",
    ] {
        assert!(words.contains(part), "{part} in {words}");
    }
    assert!(
        serde_json::to_string(&info)
            .unwrap()
            .contains("\"color_info\"")
    );
}
