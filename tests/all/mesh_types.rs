//! One mesh in every message type that can bring it: always the same triangles, painted alike.

use std::path::{Path, PathBuf};

use veneer::bag::{BagWriter, Compression};
use veneer::geom::Stamp;
use veneer::ingest::MeshUpdate;
use veneer::ingest::event::MeshBlockKey;
use veneer::mesh::TriMesh;
use veneer::wire::nvblox_mesh::NvbloxBlock;
use veneer::wire::{
    Marker, MarkerArray, MeshGeometryStamped, MeshUpdateMessage, Message, NvbloxMesh, ShapeMesh,
    WireHeader,
};

use crate::command::{small_tabletop, veneer_ok};

const MESH: &str = "/mesh";

/// A recording and its mesh, in one piece.
struct Scan {
    dir: tempfile::TempDir,
    bag: PathBuf,
    mesh: TriMesh,
    header: WireHeader<'static>,
}

impl Scan {
    fn new() -> Self {
        let dir = tempfile::tempdir().unwrap();
        let bag = small_tabletop(dir.path(), &[]);
        let bytes = std::fs::read(&bag).unwrap();
        let message = mcap::MessageStream::new(&bytes)
            .unwrap()
            .map(Result::unwrap)
            .find(|message| message.channel.topic == MESH)
            .unwrap();
        let message = MeshGeometryStamped::decode(&message.data).unwrap();
        let MeshUpdate::Whole(mesh) = message.to_update().unwrap().0 else {
            panic!("the tabletop comes in one piece");
        };
        let header = WireHeader {
            stamp: message.header.stamp,
            frame_id: "map",
        };
        Self {
            dir,
            bag,
            mesh,
            header,
        }
    }

    /// The recording with other messages in place of its mesh.
    fn with_mesh<'m, M: Message<'m>>(&self, messages: &[M]) -> PathBuf {
        let path = self.dir.path().join("other.mcap");
        let bytes = std::fs::read(&self.bag).unwrap();
        let mut writer = BagWriter::create(&path, Compression::None).unwrap();
        let mut channels = std::collections::BTreeMap::new();
        for message in mcap::MessageStream::new(&bytes).unwrap() {
            let message = message.unwrap();
            let stamp = Stamp::from_nanos(i64::try_from(message.log_time).unwrap());
            let topic = &message.channel.topic;
            if topic == MESH {
                let channel = writer.add_channel(MESH, M::TYPE_NAME, M::SCHEMA).unwrap();
                for message in messages {
                    writer.write(channel, stamp, &message.encode()).unwrap();
                }
                continue;
            }
            let schema = message.channel.schema.as_ref().unwrap();
            let text = std::str::from_utf8(&schema.data).unwrap();
            let channel = *channels
                .entry(topic.clone())
                .or_insert_with(|| writer.add_channel(topic, &schema.name, text).unwrap());
            writer.write(channel, stamp, &message.data).unwrap();
        }
        let name = veneer::synth::METADATA_NAME;
        let description = veneer::bag::metadata(&self.bag, name).unwrap().unwrap();
        writer.write_metadata(name, description).unwrap();
        writer.finish().unwrap();
        path
    }

    /// Two meshes that share no triangle and make up the whole; the vertices at the cut are in
    /// both.
    fn halves(&self) -> [TriMesh; 2] {
        let triangles = self.mesh.triangles();
        let (first, second) = triangles.split_at(triangles.len() / 2);
        [first, second].map(|part| {
            let corners = part.iter().flatten();
            let positions = corners.map(|&v| self.mesh.positions_m()[v as usize]);
            let num = u32::try_from(part.len()).unwrap();
            let triangles = (0..num).map(|t| [3 * t, 3 * t + 1, 3 * t + 2]);
            let (mesh, _) = TriMesh::from_soup(positions.collect(), triangles.collect()).unwrap();
            mesh
        })
    }
}

/// What a replay says of mesh and texture.
struct Painted {
    num_triangles: u64,
    num_charts: f64,
    seen_share: f64,
    error_255: f64,
}

fn paint(bag: &Path, extra: &[&str]) -> Painted {
    let out = bag.with_extension("out");
    let mut args = vec!["--quiet", "replay", bag.to_str().unwrap()];
    args.extend(["--out", out.to_str().unwrap()]);
    args.extend(extra);
    veneer_ok(&args);
    let text = std::fs::read_to_string(out.join("report.json")).unwrap();
    let report: serde_json::Value = serde_json::from_str(&text).unwrap();
    Painted {
        num_triangles: report["mesh"]["num_triangles"].as_u64().unwrap(),
        num_charts: report["charts"]["num_charts"].as_f64().unwrap(),
        seen_share: report["coverage"]["keyframe_share"].as_f64().unwrap(),
        error_255: report["synthetic"]["mean_abs"].as_f64().unwrap(),
    }
}

/// The other type may number vertices and triangles otherwise, and hold 32-bit floats: charts
/// may be cut elsewhere, but not the scene be another.
fn assert_same<'m, M: Message<'m>>(scan: &Scan, messages: &[M], extra: &[&str]) {
    let expected = paint(&scan.bag, &[]);
    assert!(expected.seen_share > 0.1 && expected.error_255 < 20.0);
    let found = paint(&scan.with_mesh(messages), extra);
    assert_eq!(found.num_triangles, expected.num_triangles);
    let charts = (found.num_charts - expected.num_charts).abs() / expected.num_charts;
    assert!(
        charts < 0.1,
        "{} and {}",
        found.num_charts,
        expected.num_charts
    );
    let seen = (found.seen_share - expected.seen_share).abs();
    assert!(seen < 0.02, "{} is seen", found.seen_share);
    let error = (found.error_255 - expected.error_255).abs();
    assert!(
        error < 0.5,
        "{} and {}",
        found.error_255,
        expected.error_255
    );
}

#[test]
fn shape_mesh() {
    let scan = Scan::new();
    let message = ShapeMesh::from_mesh(&scan.mesh);
    assert_same(&scan, &[message], &["-p", "mesh_frame:=map"]);
}

#[test]
fn marker() {
    let scan = Scan::new();
    let message = Marker::from_mesh(scan.header, "mesh", 3, &scan.mesh);
    assert_same(&scan, &[message], &[]);
}

#[test]
fn marker_array() {
    let scan = Scan::new();
    let halves = scan.halves();
    let markers = [(-7, &halves[0]), (2, &halves[1])];
    let markers = markers.map(|(id, half)| Marker::from_mesh(scan.header, "part", id, half));
    let array = MarkerArray {
        markers: markers.to_vec(),
    };
    assert_same(&scan, &[array], &[]);
}

#[test]
fn nvblox_mesh() {
    #[expect(
        clippy::cast_possible_truncation,
        reason = "the message holds 32-bit floats"
    )]
    let block = |mesh: &TriMesh| NvbloxBlock {
        vertices_m: mesh
            .positions_m()
            .iter()
            .map(|p| [p.x as f32, p.y as f32, p.z as f32])
            .collect(),
        triangles: mesh
            .triangles()
            .as_flattened()
            .iter()
            .map(|v| v.cast_signed())
            .collect(),
        ..NvbloxBlock::default()
    };
    let scan = Scan::new();
    let [first, second] = scan.halves();
    let message = |at, mesh: &TriMesh| NvbloxMesh {
        header: scan.header,
        block_size_m: 0.4,
        block_indices: vec![at],
        blocks: vec![block(mesh)],
        clear: false,
    };
    let messages = [message([0, -1, 0], &first), message([5, 2, 1], &second)];
    assert_same(&scan, &messages, &[]);
}

#[test]
fn mesh_update() {
    let scan = Scan::new();
    let messages: Vec<_> = scan
        .halves()
        .into_iter()
        .zip(1u32..)
        .map(|(half, number)| {
            let key = MeshBlockKey([number.into(), 0, 0]);
            let update = MeshUpdate::Blocks {
                clear: number == 1,
                blocks: vec![(key, half)],
            };
            MeshUpdateMessage::from_update(scan.header, number.into(), &update)
        })
        .collect();
    assert_same(&scan, &messages, &[]);
}
