//! What an update costs as the scan grows: walks through copies of one recorded room, side by side, each
//! seen in a few updates, and prints one row of JSON for each room.
//!
//! ```text
//! cargo run --release --example stream_scale -- BAG NUM_ROOMS [UPDATES_PER_ROOM] [PARAMETER:=VALUE …]
//! ```
//!
//! All updates bring about as many triangles and keyframes; what was there before grows. A row has the
//! triangles and keyframes of all rooms so far, the wall times of this room's updates in milliseconds, of
//! their stages together, and of making the messages for `textured_mesh` and for `markers` of them, and the
//! bytes that the state takes.

#![expect(
    clippy::print_stdout,
    reason = "an example is there to be read at the console"
)]

use std::path::Path;
use std::sync::Arc;
use std::time::Instant;

use anyhow::{Context as _, bail, ensure};
use nalgebra::{Point3, Vector3};
use serde_json::json;
use veneer::bag::BagReader;
use veneer::config::Config;
use veneer::geom::{RigidTransform, Stamp};
use veneer::keyframe::{Keyframe, KeyframeId};
use veneer::mesh::TriMesh;
use veneer::pipeline::{NoProgress, Scan, StageClock, StageTime, gather};
use veneer::publish::{OutputTopic, PublishParams, Publisher, Snapshot};
use veneer::texinit::stream::StreamInit;

const USAGE: &str = "stream_scale BAG NUM_ROOMS [UPDATES_PER_ROOM] [PARAMETER:=VALUE …]";
/// Room between the rooms, metres.
const GAP_M: f64 = 1.0;

fn main() -> anyhow::Result<()> {
    let mut args = std::env::args().skip(1);
    let (Some(bag), Some(num_rooms)) = (args.next(), args.next()) else {
        bail!(USAGE);
    };
    let num_rooms: u32 = num_rooms.parse().context(USAGE)?;
    let (mut config, mut num_updates) = (Config::default(), 4);
    for arg in args {
        match arg.split_once(":=") {
            Some((name, value)) => config.set(name, value)?,
            None => num_updates = arg.parse().context(USAGE)?,
        }
    }
    ensure!(num_updates >= 1, USAGE);
    let mut source = BagReader::open(Path::new(&bag), &config.topics)?;
    let clock = StageClock::new(&NoProgress);
    let scan = gather(&mut source, &config.pipeline, &clock)?;

    let mut rooms = Rooms::new(&scan, num_updates);
    let params = &config.pipeline;
    let mut state = StreamInit::new(&params.texinit, &params.stream)?;
    let num_of_room = u32::try_from(scan.keyframes.len())?;
    // A copy's number says of which keyframe it is one; the store decodes that.
    let decode = |keyframe: &Keyframe| {
        let original = &scan.keyframes[(keyframe.id.0 % num_of_room) as usize];
        scan.decode(original)
    };
    let params = PublishParams {
        history_messages: usize::MAX,
        ..config.publish
    };
    let mut publishers = [params; 2].map(Publisher::new);
    let mut revision = 0;
    for room in 0..num_rooms {
        let [mut times_ms, mut blocks_ms, mut markers_ms] = [const { Vec::new() }; 3];
        let clock = StageClock::new(&NoProgress);
        for _ in 0..num_updates {
            rooms.go_on()?;
            let mesh = Arc::new(rooms.mesh()?);
            times_ms.push(timed_ms(|| {
                state.update(&mesh, &rooms.keyframes, &decode, &clock)
            })?);
            clock.begin("messages, and the next mesh", 0);
            revision += 1;
            let chart_keys = state.chart_keys();
            let snapshot = Snapshot {
                stamp: Stamp::default(),
                frame_id: "map",
                session: 1,
                revision,
                mesh: state.mesh(),
                layout: state.layout(),
                texture: state.texture(),
                keyframes: &rooms.keyframes,
                chart_keys: Some(&chart_keys),
            };
            let topics = [OutputTopic::TexturedMesh, OutputTopic::Markers];
            let times = [&mut blocks_ms, &mut markers_ms];
            for ((topic, publisher), times) in topics.iter().zip(&mut publishers).zip(times) {
                times.push(timed_ms(|| publisher.publish(&snapshot, &|t| t == *topic))?);
            }
        }
        let row = json!({
            "room": room,
            "triangles": state.mesh().num_triangles(),
            "keyframes": rooms.keyframes.len(),
            "updates_ms": times_ms,
            "stages_ms": stages_ms(&clock.finish()),
            "textured_mesh_ms": blocks_ms,
            "markers_ms": markers_ms,
            "charts": state.layout().charts.len(),
            "pages": state.layout().num_pages,
            "used_share": state.used_share(),
            "num_bytes": state.num_bytes(),
        });
        println!("{row}");
    }
    Ok(())
}

/// Milliseconds to a tenth, by name.
fn stages_ms(stages: &[StageTime]) -> serde_json::Value {
    let mut all_ms = std::collections::BTreeMap::new();
    for stage in stages {
        *all_ms.entry(stage.name).or_insert(0.0) += 1e3 * stage.seconds;
    }
    let rounded = all_ms
        .into_iter()
        .map(|(name, ms)| (name.to_owned(), json!((10.0 * ms).round() / 10.0)));
    rounded.collect::<serde_json::Map<_, _>>().into()
}

/// Runs something; how long it took, milliseconds to a tenth.
fn timed_ms<T, E>(run: impl FnOnce() -> Result<T, E>) -> Result<f64, E> {
    let begun = Instant::now();
    run()?;
    Ok((1e4 * begun.elapsed().as_secs_f64()).round() / 10.0)
}

/// Copies of a room, and how much of them was seen.
struct Rooms<'a> {
    scan: &'a Scan,
    num_updates: usize,
    num_done: usize,
    pitch_m: f64,
    positions_m: Vec<Point3<f64>>,
    triangles: Vec<[u32; 3]>,
    keyframes: Vec<Arc<Keyframe>>,
}

impl<'a> Rooms<'a> {
    fn new(scan: &'a Scan, num_updates: usize) -> Self {
        let along = || scan.mesh.positions_m().iter().map(|point| point.x);
        let (low, high) = (
            along().fold(f64::INFINITY, f64::min),
            along().fold(f64::NEG_INFINITY, f64::max),
        );
        Self {
            scan,
            num_updates,
            num_done: 0,
            pitch_m: high - low + GAP_M,
            positions_m: Vec::new(),
            triangles: Vec::new(),
            keyframes: Vec::new(),
        }
    }

    /// The next share of the triangles and keyframes.
    fn go_on(&mut self) -> anyhow::Result<()> {
        let (room, part) = (
            self.num_done / self.num_updates,
            self.num_done % self.num_updates,
        );
        self.num_done += 1;
        let shift_m = Vector3::new(room as f64 * self.pitch_m, 0.0, 0.0);
        if part == 0 {
            let positions = self.scan.mesh.positions_m().iter();
            self.positions_m
                .extend(positions.map(|point| point + shift_m));
        }
        let share = |len: usize| part * len / self.num_updates..(part + 1) * len / self.num_updates;
        let first = u32::try_from(room * self.scan.mesh.num_vertices())?;
        let triangles = self.scan.mesh.triangles();
        let seen = &triangles[share(triangles.len())];
        self.triangles
            .extend(seen.iter().map(|corners| corners.map(|v| v + first)));
        let shift = RigidTransform::from_parts(nalgebra::UnitQuaternion::identity(), shift_m);
        let num_keyframes = self.scan.keyframes.len();
        for index in share(num_keyframes) {
            let original = &self.scan.keyframes[index];
            self.keyframes.push(Arc::new(Keyframe {
                id: KeyframeId(u32::try_from(room * num_keyframes + index)?),
                world_from_camera: shift * original.world_from_camera,
                ..(**original).clone()
            }));
        }
        Ok(())
    }

    fn mesh(&self) -> anyhow::Result<TriMesh> {
        let (mesh, _) = TriMesh::from_soup(self.positions_m.clone(), self.triangles.clone())?;
        Ok(mesh)
    }
}
