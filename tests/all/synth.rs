//! A synthetic recording read back from its bag, against the truth that its metadata names.
#![expect(clippy::unwrap_used, reason = "a step that fails fails the test")]

use std::collections::BTreeMap;

use nalgebra::Point3;
use veneer::bag::{BagReader, TopicRoles, metadata};
use veneer::geom::{CameraModel, ColorImage, DepthImage, RigidTransform};
use veneer::ingest::{Event, EventSource, MeshUpdate};
use veneer::mesh::TriMesh;
use veneer::synth::{
    GroundTruth, METADATA_NAME, SceneName, SynthColorFormat, SynthNoise, SynthOptions, synthesize,
};

#[derive(Default)]
struct Recording {
    camera: Option<CameraModel>,
    colors: BTreeMap<i64, ColorImage>,
    depths: BTreeMap<i64, DepthImage>,
    poses: BTreeMap<i64, RigidTransform>,
    blocks: BTreeMap<veneer::ingest::event::MeshBlockKey, TriMesh>,
    num_mesh_messages: u32,
}

fn read(path: &std::path::Path) -> Recording {
    let mut reader = BagReader::open(path, &TopicRoles::default()).unwrap();
    let mut recording = Recording::default();
    while let Some(event) = reader.next_event() {
        match event.event.unwrap() {
            Event::Color(header, image) => {
                let image = image.decode().unwrap();
                recording.colors.insert(header.stamp.as_nanos(), image);
            }
            Event::Depth(header, image) => {
                let image = image.decode().unwrap();
                recording.depths.insert(header.stamp.as_nanos(), image);
            }
            Event::ColorInfo(_, camera) => recording.camera = Some(camera),
            Event::Transforms(transforms) => {
                for transform in transforms {
                    let stamp = transform.header.stamp.as_nanos();
                    recording.poses.insert(stamp, transform.parent_from_child);
                }
            }
            Event::Mesh(_, MeshUpdate::Blocks { blocks, .. }, soup) => {
                assert_eq!(soup.num_dropped_triangles, 0);
                recording.num_mesh_messages += 1;
                recording.blocks.extend(blocks);
            }
            _ => {}
        }
    }
    assert!(reader.losses().is_empty(), "{:?}", reader.losses());
    recording
}

#[test]
fn a_bag_of_a_known_scene_agrees_with_its_truth() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("tabletop.mcap");
    let options = SynthOptions {
        seed: 5,
        num_frames: Some(6),
        width: 320,
        height: 240,
        grow: 3,
        color: SynthColorFormat::Png,
        noise: SynthNoise::default(),
        ..SynthOptions::default()
    };
    let summary = synthesize(SceneName::Tabletop, &options, &path, &mut |_, _| {}).unwrap();
    let recording = read(&path);
    assert_eq!(recording.num_mesh_messages, 3);
    let num_triangles: usize = recording.blocks.values().map(TriMesh::num_triangles).sum();
    assert_eq!(num_triangles, summary.num_triangles);

    let description = metadata(&path, METADATA_NAME).unwrap().unwrap();
    let truth = GroundTruth::from_metadata(&description).unwrap();
    let camera = recording.camera.unwrap().pinhole;
    let [focal_px, ..] = camera.intrinsics_px();
    assert_eq!(recording.colors.len(), 6);
    let mut errors: Vec<f32> = Vec::new();
    for (stamp, color) in &recording.colors {
        let depth = &recording.depths[stamp];
        let world_from_camera = &recording.poses[stamp];
        let eye = Point3::from(*world_from_camera.translation());
        for at in (0..color.pixels().len()).step_by(11) {
            let depth_m = f64::from(depth.depths_m()[at]);
            let pixel = [(at % 320) as f64, (at / 320) as f64];
            let point = world_from_camera.transform_point(&camera.unproject(pixel, depth_m));
            let Some(expected) = truth.true_srgb(&point, &(eye - point), depth_m / focal_px) else {
                continue;
            };
            let seen = color.pixels()[at];
            let error: f32 = (0..3)
                .map(|c| (f32::from(seen[c]) - expected[c]).abs())
                .sum();
            errors.push(error / 3.0);
        }
    }
    errors.sort_by(f32::total_cmp);
    assert!(
        errors.len() > 20_000,
        "{} pixels have a truth",
        errors.len()
    );
    // Pixels across outlines, and fine print at a slant, are the tail.
    assert!(
        errors[errors.len() / 2] < 0.7,
        "median {}",
        errors[errors.len() / 2]
    );
    assert!(
        errors[errors.len() * 8 / 10] < 4.0,
        "80 % {}",
        errors[errors.len() * 8 / 10]
    );
}
