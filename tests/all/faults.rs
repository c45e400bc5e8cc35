//! Streams in which messages are lost, come twice, late or out of order, in which the mesh, the
//! pose, the clock and the camera jump, and images do not decode: live, message by message.

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
    clock_back: bool,
    other_camera: bool,
}

struct Made {
    random: Random,
    faults: Faults,
    events: Vec<TimedEvent>,
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
        let mut made = Self {
            random: Random(seed),
            faults,
            events: Vec::new(),
        };
        made.record();
        made.disturb();
        made.events
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
            if self.faults.clock_back && i == NUM_FRAMES / 2 {
                clock -= 5_000_000_000;
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
    let mut scan = LiveScan::new(&PipelineParams::default(), &topics(), 0);
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
        clock_back: some(3) > 0,
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
