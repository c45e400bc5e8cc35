//! Streams in which messages are lost, come twice, late or out of order, in which the mesh, the
//! pose, the clock and the camera jump, and images do not decode: live, message by message.

use std::collections::BTreeMap;
use std::sync::{Arc, OnceLock};

use nalgebra::{Point3, UnitQuaternion, Vector3};
use veneer::geom::{
    CameraModel, ColorImage, EncodedColor, EncodedDepth, PinholeCamera, RigidTransform, Stamp,
};
use veneer::ingest::event::StampedTransform;
use veneer::ingest::{Event, EventSource, Header, MeshUpdate, Rejection, TimedEvent};
use veneer::mesh::{SoupReport, TriMesh};
use veneer::pipeline::{
    Capture, LiveScan, NoProgress, Painter, PipelineParams, StageClock, gather,
};

const TOPICS: [&str; 6] = ["tf", "color_info", "color", "depth_info", "depth", "mesh"];
const NUM_FRAMES: i64 = 60;
const FRAME_NS: i64 = 33_000_000;
const CLOCK_BACK_NS: i64 = 5_000_000_000;

/// SplitMix64.
struct Random(u64);

impl Random {
    fn below(&mut self, end: u64) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let z = (self.0 ^ (self.0 >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        let z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        (z ^ (z >> 31)) % end
    }

    fn index(&mut self, len: usize) -> usize {
        usize::try_from(self.below(len as u64)).unwrap()
    }

    fn byte_below(&mut self, end: u64) -> u8 {
        u8::try_from(self.below(end)).unwrap()
    }

    fn happens(&mut self, per_mille: u64) -> bool {
        self.below(1000) < per_mille
    }
}

/// What goes wrong, in thousandths of the messages or frames.
#[derive(Clone, Copy, Debug, Default)]
struct Faults {
    lost: u64,
    twice: u64,
    swapped: u64,
    late: u64,
    mesh_jumps: u64,
    pose_jumps: u64,
    undecodable: u64,
    /// In the middle of the stream, nanoseconds.
    clock_back_ns: i64,
    other_camera: bool,
}

struct Made {
    random: Random,
    faults: Faults,
    events: Vec<TimedEvent>,
    /// By the stamp of the colour image.
    sent: BTreeMap<Stamp, Sent>,
    /// Messages that came twice, by topic.
    num_twice: [u64; TOPICS.len()],
}

/// A frame as its senders made it.
struct Sent {
    image: EncodedColor,
    camera: CameraModel,
    world_from_camera: RigidTransform,
}

fn camera(focal_px: f64) -> CameraModel {
    let intrinsics_px = [focal_px, focal_px, 23.5, 17.5];
    CameraModel::ideal(PinholeCamera::new(intrinsics_px, 48, 36).unwrap())
}

/// The pictures of the path, which are the same in every stream.
fn color(frame: i64) -> EncodedColor {
    static PICTURES: OnceLock<Vec<EncodedColor>> = OnceLock::new();
    let pictures = PICTURES.get_or_init(|| (0..NUM_FRAMES as u64).map(picture).collect());
    pictures[usize::try_from(frame).unwrap()].clone()
}

fn picture(seed: u64) -> EncodedColor {
    let mut random = Random(seed);
    let cells: Vec<u8> = (0..12 * 9).map(|_| 60 + random.byte_below(140)).collect();
    let pixels = (0..48 * 36).map(|i| [cells[i / 48 / 4 * 12 + i % 48 / 4]; 3]);
    let image = ColorImage::new(48, 36, pixels.collect()).unwrap();
    EncodedColor::png_from_image(&image).unwrap()
}

/// A PNG of the right size whose pixels do not unpack.
fn undecodable() -> EncodedColor {
    let mut bytes = color(1).bytes().to_vec();
    let data = bytes.windows(4).position(|w| w == b"IDAT").unwrap() + 4;
    bytes[data..data + 20].fill(0xff);
    EncodedColor::from_file(bytes.into()).unwrap()
}

fn depth() -> EncodedDepth {
    static DEPTH: OnceLock<EncodedDepth> = OnceLock::new();
    let encode = || EncodedDepth::png_from_u16_mm(48, 36, &[1500; 48 * 36]).unwrap();
    DEPTH.get_or_init(encode).clone()
}

/// A wall in front of the camera's path, a strip of squares.
fn wall(num_squares: u32, is_flipped: bool) -> TriMesh {
    let corners = (0..=num_squares).flat_map(|i| {
        let x = 0.2 * f64::from(i) - 0.5;
        [Point3::new(x, -0.5, 1.5), Point3::new(x, 0.5, 1.5)]
    });
    let mut triangles: Vec<[u32; 3]> = (0..num_squares)
        .flat_map(|i| {
            let [a, b, c, d] = [0, 1, 2, 3].map(|k| 2 * i + k);
            [[a, b, c], [b, d, c]]
        })
        .collect();
    if is_flipped {
        triangles.reverse();
    }
    TriMesh::from_soup(corners.collect(), triangles).unwrap().0
}

fn header(frame_id: &str, nanos: i64) -> Header {
    Header {
        stamp: Stamp::from_nanos(nanos),
        frame_id: frame_id.into(),
    }
}

impl Made {
    fn stream(seed: u64, faults: Faults) -> Vec<TimedEvent> {
        Self::new(seed, faults).events
    }

    fn new(seed: u64, faults: Faults) -> Self {
        let mut made = Self {
            random: Random(seed),
            faults,
            events: Vec::new(),
            sent: BTreeMap::new(),
            num_twice: [0; TOPICS.len()],
        };
        made.record();
        made.disturb();
        made
    }

    fn push(&mut self, nanos: i64, topic: &str, event: Event) {
        let topic = TOPICS.iter().position(|t| *t == topic).unwrap();
        self.events.push(TimedEvent {
            received: Stamp::from_nanos(nanos),
            topic,
            event: Ok(event),
        });
    }

    /// The stream as its senders made it.
    fn record(&mut self) {
        let (mut clock, mut num_squares, mut is_flipped) = (10_000_000_000, 3, false);
        for i in 0..NUM_FRAMES {
            clock += FRAME_NS;
            if i == NUM_FRAMES / 2 {
                clock -= self.faults.clock_back_ns;
            }
            let is_other = self.faults.other_camera && i > NUM_FRAMES / 3;
            let camera = camera(if is_other { 55.0 } else { 45.0 });
            let jump = if self.random.happens(self.faults.pose_jumps) {
                4.0
            } else {
                0.0
            };
            let x = 0.03 * i as f64 + jump;
            let pose = RigidTransform::from_parts(
                UnitQuaternion::from_euler_angles(0.0, 0.002 * i as f64, 0.0),
                Vector3::new(x, 0.0, 0.0),
            );
            let transform = StampedTransform {
                header: header("map", clock),
                child_frame_id: Arc::from("cam"),
                parent_from_child: pose,
            };
            self.push(clock, "tf", Event::Transforms(vec![transform]));
            let cam = || header("cam", clock);
            self.push(clock, "color_info", Event::ColorInfo(cam(), camera));
            let image = if self.random.happens(self.faults.undecodable) {
                undecodable()
            } else {
                color(i)
            };
            let sent = Sent {
                image: image.clone(),
                camera,
                world_from_camera: pose,
            };
            self.sent.insert(Stamp::from_nanos(clock), sent);
            self.push(clock, "color", Event::Color(cam(), image));
            self.push(clock, "depth_info", Event::DepthInfo(cam(), camera));
            self.push(clock, "depth", Event::Depth(cam(), depth()));
            if i % 6 == 0 {
                num_squares += 1;
                if self.random.happens(self.faults.mesh_jumps) {
                    num_squares = 1 + u32::from(self.random.byte_below(8));
                    is_flipped = self.random.happens(500);
                }
                let mesh = MeshUpdate::Whole(wall(num_squares, is_flipped));
                let mesh = Event::Mesh(header("map", clock), mesh, SoupReport::default());
                self.push(clock, "mesh", mesh);
            }
        }
    }

    /// What the network makes of it.
    fn disturb(&mut self) {
        let mut events = std::mem::take(&mut self.events);
        events.retain(|_| !self.random.happens(self.faults.lost));
        for at in 1..events.len() {
            if self.random.happens(self.faults.swapped) {
                events.swap(at - 1, at);
            }
        }
        for at in 0..events.len() {
            if self.random.happens(self.faults.late) {
                let event = events.remove(at);
                let later = at + self.random.index((events.len() - at).min(40) + 1);
                events.insert(later.min(events.len()), event);
            }
        }
        for event in events {
            let is_twice = self.random.happens(self.faults.twice);
            if is_twice {
                self.num_twice[event.topic] += 1;
                self.events.push(event.clone());
            }
            self.events.push(event);
        }
        // Messages arrive in the order in which they arrive.
        let mut received = Stamp::from_nanos(0);
        for event in &mut self.events {
            received = received.max(event.received);
            event.received = received;
        }
    }
}

/// Events from memory.
struct Recorded {
    topics: Vec<String>,
    events: std::vec::IntoIter<TimedEvent>,
}

impl EventSource for Recorded {
    fn topics(&self) -> &[String] {
        &self.topics
    }

    fn next_event(&mut self) -> Option<TimedEvent> {
        self.events.next()
    }

    fn losses(&self) -> &[String] {
        &[]
    }
}

fn topics() -> Vec<String> {
    TOPICS.map(str::to_owned).to_vec()
}

/// Feeds a live scan message by message; the accounts must be right after each.
fn live(events: &[TimedEvent]) -> Capture {
    live_with(events, &PipelineParams::default())
}

fn live_with(events: &[TimedEvent], params: &PipelineParams) -> Capture {
    let mut scan = LiveScan::new(params, &topics(), 0);
    let mut revision = 0;
    for (at, event) in events.iter().enumerate() {
        let has_changed = scan.push(event.clone());
        assert_eq!(scan.revision() > revision, has_changed, "message {at}");
        revision = scan.revision();
        assert_adds_up(&scan, at as u64 + 1);
    }
    scan.flush();
    assert_eq!(scan.num_pending(), 0);
    assert_adds_up(&scan, events.len() as u64);
    let capture = scan.capture();
    let store = &capture.store;
    let num_rejected: u64 = store.rejected_by_reason.values().sum();
    assert_eq!(store.num_offered, store.num_admitted + num_rejected);
    let num_gone = store.num_replaced + store.num_evicted;
    assert_eq!(
        capture.keyframes.len() as u64,
        store.num_admitted - num_gone
    );
    capture
}

fn assert_adds_up(scan: &LiveScan, num_pushed: u64) {
    let report = scan.ingest_report();
    let topics = || report.topics.values();
    let num_received: u64 = topics().map(|topic| topic.num_received).sum();
    assert_eq!(num_received, num_pushed, "received");
    let num_done: u64 = topics().map(|t| t.num_used + t.num_refused()).sum();
    assert_eq!(
        num_received,
        num_done + scan.num_pending() as u64,
        "accounts"
    );
}

/// Keyframes and mesh are the same, to the bit; numbers of keyframes too.
#[track_caller]
fn assert_same(a: &Capture, b: &Capture) {
    assert_eq!(a.keyframes.len(), b.keyframes.len());
    assert!(a.keyframes == b.keyframes, "other keyframes");
    assert!(a.mesh == b.mesh, "another mesh");
}

fn any_faults(random: &mut Random) -> Faults {
    let mut some = |most| {
        if random.happens(500) {
            random.below(most)
        } else {
            0
        }
    };
    Faults {
        lost: some(200),
        twice: some(200),
        swapped: some(300),
        late: some(100),
        mesh_jumps: some(900),
        pose_jumps: some(200),
        undecodable: some(200),
        clock_back_ns: if some(3) > 0 { CLOCK_BACK_NS } else { 0 },
        other_camera: some(3) > 0,
    }
}

#[test]
fn whatever_arrives_is_accounted_for_and_is_what_a_batch_makes_of_it() {
    let params = PipelineParams::default();
    let (mut num_painted, mut num_keyframes) = (0, 0);
    for seed in 0..30 {
        let mut random = Random(seed);
        let faults = any_faults(&mut random);
        let events = Made::stream(seed, faults);
        let capture = live(&events);
        let mut source = Recorded {
            topics: topics(),
            events: events.into_iter(),
        };
        let batch = gather(&mut source, &params, &StageClock::new(&NoProgress));
        let Ok(batch) = batch else {
            assert!(!capture.is_paintable(), "{seed}: {faults:?}");
            continue;
        };
        num_keyframes += batch.keyframes.len();
        assert!(batch.keyframes == capture.keyframes, "{seed}: {faults:?}");
        assert_eq!(batch.num_mesh_updates, capture.num_mesh_updates);
        assert_eq!(batch.ingest, capture.ingest);
        if seed % 6 == 0 {
            let painted = Painter::new(&params.keyframe).paint(capture, &params, &NoProgress);
            num_painted += usize::from(painted.is_ok());
        }
    }
    assert!(num_painted > 2, "{num_painted}");
    assert!(num_keyframes > 200, "{num_keyframes}");
}

#[test]
fn what_comes_twice_counts_once() {
    let mut num_twice = 0;
    for seed in 0..8 {
        let once = Made::stream(seed, Faults::default());
        let twice = Made::stream(
            seed,
            Faults {
                twice: 250,
                ..Faults::default()
            },
        );
        num_twice += twice.len() - once.len();
        assert_same(&live(&twice), &live(&once));
    }
    assert!(num_twice > 300, "{num_twice}");
}

#[test]
fn what_cannot_be_used_is_as_if_it_had_not_come() {
    let mut num_bad = 0;
    for seed in 0..8 {
        let faults = Faults {
            undecodable: 250,
            ..Faults::default()
        };
        let mut events = Made::stream(seed, faults);
        let mut random = Random(seed ^ 0xbad);
        for at in (0..events.len()).rev() {
            if random.happens(50) {
                let stamp = events[at].received;
                let topic = random.index(TOPICS.len());
                let rejection = Rejection {
                    topic: TOPICS[topic].to_owned(),
                    stamp,
                    reason: "bytes of something else".to_owned(),
                };
                let event = TimedEvent {
                    received: stamp,
                    topic,
                    event: Err(rejection),
                };
                events.insert(at, event);
            }
        }
        let is_bad = |event: &TimedEvent| match &event.event {
            Ok(Event::Color(_, image)) => image.decode().is_err(),
            Ok(_) => false,
            Err(_) => true,
        };
        let good: Vec<_> = events.iter().filter(|e| !is_bad(e)).cloned().collect();
        num_bad += events.len() - good.len();
        let (with, without) = (live(&events), live(&good));
        assert_eq!(with.keyframes.len(), without.keyframes.len());
        assert!(with.keyframes == without.keyframes, "seed {seed}");
        assert!(with.mesh == without.mesh);
        assert!(with.ingest.num_frames >= without.ingest.num_frames);
    }
    assert!(num_bad > 100, "{num_bad}");
}

#[test]
fn a_mesh_that_shrinks_resets_or_flips_is_the_last_one() {
    for seed in 0..8 {
        let faults = Faults {
            mesh_jumps: 900,
            twice: 100,
            ..Faults::default()
        };
        let events = Made::stream(seed, faults);
        let last = events.iter().rev().find_map(|event| match &event.event {
            Ok(Event::Mesh(_, MeshUpdate::Whole(mesh), _)) => Some(mesh.clone()),
            _ => None,
        });
        let capture = live(&events);
        assert!(capture.mesh.as_deref() == last.as_ref(), "seed {seed}");
    }
}

fn num_refused(capture: &Capture, topic: &str, reason: &str) -> u64 {
    let refused = &capture.ingest.topics[topic].refused_by_reason;
    refused.get(reason).map_or(0, |count| count.num)
}

/// Every keyframe is what was sent at its stamp: image, cameras and pose.
#[track_caller]
fn assert_as_sent(capture: &Capture, made: &Made) {
    for keyframe in &capture.keyframes {
        let sent = &made.sent[&keyframe.stamp];
        assert!(keyframe.color == sent.image, "another image");
        assert_eq!(keyframe.color_camera, sent.camera);
        let depth = keyframe.depth.as_ref().unwrap();
        assert_eq!(depth.camera, sent.camera);
        let (turn_rad, distance_m) = keyframe
            .world_from_camera
            .distance_to(&sent.world_from_camera);
        assert!(turn_rad < 1e-6 && distance_m < 1e-9, "{distance_m} m off");
    }
}

#[test]
fn a_keyframe_is_what_was_sent_at_its_stamp() {
    let plain = Faults {
        twice: 150,
        ..Faults::default()
    };
    let faults = [
        plain,
        Faults {
            other_camera: true,
            ..plain
        },
        Faults {
            clock_back_ns: CLOCK_BACK_NS,
            ..plain
        },
        Faults {
            pose_jumps: 200,
            ..plain
        },
        Faults {
            clock_back_ns: CLOCK_BACK_NS,
            other_camera: true,
            pose_jumps: 100,
            ..plain
        },
    ];
    for (seed, faults) in (0..).zip(faults) {
        let made = Made::new(seed, faults);
        let capture = live(&made.events);
        assert_as_sent(&capture, &made);
        assert!(capture.keyframes.len() > 10);
        // Both cameras, and both times, are among them.
        let stamps: Vec<Stamp> = capture.keyframes.iter().map(|k| k.stamp).collect();
        let num_falls = stamps.windows(2).filter(|two| two[1] < two[0]).count();
        assert_eq!(num_falls, usize::from(faults.clock_back_ns > 0));
        let cameras = capture.keyframes.iter().map(|k| k.color_camera);
        let has_other = cameras.clone().any(|c| c != camera(45.0));
        assert_eq!(has_other, faults.other_camera);
    }
}

#[test]
fn what_is_refused_is_counted_by_its_reason() {
    let twice = Made::new(
        1,
        Faults {
            twice: 200,
            ..Faults::default()
        },
    );
    let capture = live(&twice.events);
    for (topic, num) in TOPICS.iter().zip(twice.num_twice) {
        let reason = match *topic {
            "tf" => "repeated transform (same stamp)",
            "color" | "depth" => "duplicate stamp",
            _ => continue,
        };
        assert!(num > 0);
        assert_eq!(num_refused(&capture, topic, reason), num, "{topic}");
    }
    assert_eq!(capture.ingest.num_frames, NUM_FRAMES.unsigned_abs());

    let undecodable_too = Made::new(
        2,
        Faults {
            undecodable: 250,
            ..Faults::default()
        },
    );
    let images = undecodable_too.sent.values();
    let num_bad = images.filter(|sent| sent.image.decode().is_err()).count();
    let store = live(&undecodable_too.events).store;
    assert!(num_bad > 5);
    let counted = store.rejected_by_reason.get("image does not decode");
    assert_eq!(counted.copied(), Some(num_bad as u64));
    assert_eq!(store.num_offered, NUM_FRAMES.unsigned_abs());

    let set_back = Faults {
        clock_back_ns: CLOCK_BACK_NS,
        ..Faults::default()
    };
    let capture = live(&Made::stream(3, set_back));
    assert_eq!(capture.ingest.sync.num_clock_set_back, 1);
    // An image or two show that the clock was set back, and go with those that waited.
    let num_lost = NUM_FRAMES.unsigned_abs() - capture.ingest.num_frames;
    assert!(num_lost < 5, "{num_lost}");
}

#[test]
fn an_image_that_comes_after_newer_ones_is_refused() {
    let made = Made::new(4, Faults::default());
    let mut events = made.events;
    let is_image =
        |event: &TimedEvent| matches!(&event.event, Ok(Event::Color(..) | Event::Depth(..)));
    let at = events.iter().position(is_image).unwrap();
    let [color, depth] = [events.remove(at), events.remove(at + 1)];
    assert!(is_image(&color) && is_image(&depth));
    let before = live(&events);
    let late_by = events.len() / 3;
    for event in [color, depth] {
        let received = events[late_by].received;
        events.insert(late_by + 1, TimedEvent { received, ..event });
    }
    let after = live(&events);
    assert_same(&after, &before);
    let reason = "late: a newer image of the topic was used or dropped before it came";
    for topic in ["color", "depth"] {
        assert_eq!(num_refused(&after, topic, reason), 1, "{topic}");
    }
}

/// Poses that were sent before the clock was set back are not those of the same stamps after it, even
/// where transforms are lost.
#[test]
fn poses_of_before_the_clock_was_set_back_are_forgotten() {
    let mut params = PipelineParams::default();
    params.ingest.clock_jump_back_s = 0.3;
    let faults = Faults {
        clock_back_ns: 700_000_000,
        ..Faults::default()
    };
    for num_transforms in [0, 4] {
        let made = Made::new(5, faults);
        let middle = made.events.len() / 2;
        let is_after = |at: usize| at >= middle;
        let mut num_left = num_transforms;
        let mut events = Vec::new();
        for (at, event) in made.events.iter().enumerate() {
            let is_transform = matches!(&event.event, Ok(Event::Transforms(_)));
            if is_transform && is_after(at) {
                if num_left == 0 {
                    continue;
                }
                num_left -= 1;
            }
            events.push(event.clone());
        }
        let capture = live_with(&events, &params);
        let stamps: Vec<Stamp> = made.sent.keys().copied().collect();
        let second = |stamp: Stamp| made.sent[&stamp].world_from_camera.translation().x > 0.88;
        let set_back_to = *stamps.iter().find(|stamp| second(**stamp)).unwrap();
        let num_before = capture
            .keyframes
            .iter()
            .filter(|k| !second(k.stamp))
            .count();
        assert!(num_before > 5);
        for keyframe in capture.keyframes.iter().filter(|k| second(k.stamp)) {
            if num_transforms == 0 {
                // What is less than the jump's least length ahead may be of the new time.
                let ahead_s = keyframe.stamp.seconds_since(set_back_to);
                assert!(ahead_s < 0.4, "posed {ahead_s} s after");
            } else {
                let sent = &made.sent[&keyframe.stamp].world_from_camera;
                let (_, distance_m) = keyframe.world_from_camera.distance_to(sent);
                assert!(distance_m < 0.1, "{distance_m} m off");
            }
        }
    }
}
