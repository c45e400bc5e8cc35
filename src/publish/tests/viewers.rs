//! What viewers make of the messages: rviz2's rules for markers, Foxglove's for scenes, mesh_tools'.

use std::collections::BTreeMap;

use super::made::{Made, Scan};
use super::{everything, messages_of, only};
use crate::export::PageFormat;
use crate::publish::{OutputTopic, PublishParams, Publisher, mesh_pieces};
use crate::wire::marker::{self, Marker};
use crate::wire::scene_update;
use crate::wire::{
    MarkerArray, MeshGeometryStamped, MeshMaterialsStamped, Message, SceneUpdate, WireHeader,
};

/// A triangle as it is shown: corners, and the colours there.
type Shown = ([[f64; 3]; 3], [[u8; 3]; 3]);

fn nearest(image: &image::RgbImage, [u, v]: [f32; 2]) -> [u8; 3] {
    let at = |share: f32, side: u32| ((share * side as f32) as u32).min(side - 1);
    image
        .get_pixel(at(u, image.width()), at(v, image.height()))
        .0
}

/// What rviz2's marker display holds: by name, and each must be new when it is added.
#[derive(Default)]
struct Rviz {
    markers: BTreeMap<(String, i32), Vec<Shown>>,
    textures: BTreeMap<String, (String, i32)>,
}

impl Rviz {
    fn apply(&mut self, array: &MarkerArray<'_>) {
        for marker in &array.markers {
            let name = (marker.ns.to_owned(), marker.id);
            match marker.action {
                marker::ADD => {
                    let shown = self.shown(marker);
                    let was = self.markers.insert(name.clone(), shown);
                    assert!(was.is_none(), "{name:?} gets a second texture");
                    let resource = marker.tail.texture_resource.to_owned();
                    let was = self.textures.insert(resource, name);
                    assert!(was.is_none(), "two markers share a texture");
                }
                marker::DELETE => assert!(self.markers.remove(&name).is_some(), "{name:?}"),
                marker::DELETE_ALL => self.markers.clear(),
                other => panic!("action {other}"),
            }
        }
    }

    /// What `TriangleListMarker` does with a message.
    fn shown(&self, marker: &Marker<'_>) -> Vec<Shown> {
        assert_eq!(marker.kind, marker::TRIANGLE_LIST);
        assert!(!marker.points.is_empty() && marker.points.len().is_multiple_of(3));
        assert_eq!(marker.points.len(), marker.tail.uv_coordinates.len());
        assert_eq!((marker.color, marker.scale), ([1.0; 4], [1.0; 3]));
        assert!(marker.colors.is_empty() && marker.frame_locked);
        assert!(
            marker
                .tail
                .texture_resource
                .starts_with("embedded://veneer_")
        );
        let format = match marker.tail.texture.format.as_ref() {
            "png" => image::ImageFormat::Png,
            "jpg" => image::ImageFormat::Jpeg,
            other => panic!("Ogre has no codec '{other}'"),
        };
        let file = &marker.tail.texture.data;
        let texture = image::load_from_memory_with_format(file, format)
            .unwrap()
            .into_rgb8();
        let origin = marker.pose.position_m;
        let corners = marker.points.as_chunks::<3>().0;
        let uvs = marker.tail.uv_coordinates.as_chunks::<3>().0;
        corners
            .iter()
            .zip(uvs)
            .map(|(corners, uvs)| {
                assert!(uvs.as_flattened().iter().all(|c| (0.0..=1.0).contains(c)));
                (
                    corners.map(|p| [0, 1, 2].map(|axis| p[axis] + origin[axis])),
                    uvs.map(|uv| nearest(&texture, uv)),
                )
            })
            .collect()
    }

    fn all(&self) -> Vec<Shown> {
        let mut all: Vec<Shown> = self.markers.values().flatten().copied().collect();
        sort(&mut all);
        all
    }
}

fn sort(shown: &mut [Shown]) {
    shown.sort_by(|a, b| {
        let key = |s: &Shown| s.0.map(|p| p.map(|c| (c * 1e6).round() as i64));
        key(a).cmp(&key(b))
    });
}

/// What should be shown.
fn expected(made: &Made) -> Vec<Shown> {
    let [width, height] = made.layout.page_size_texel;
    let mut all: Vec<Shown> = made
        .mesh
        .triangle_ids()
        .map(|t| {
            let page = &made.texture.pages[made.layout.page_of(t) as usize];
            let corners = made.mesh.corners_m(t).map(Into::into);
            let colors = made.layout.corners_texel[t.index()].map(|[x, y]| {
                let (x, y) = ((x as u32).min(width - 1), (y as u32).min(height - 1));
                page.srgb[(y * width + x) as usize]
            });
            (corners, colors)
        })
        .collect();
    sort(&mut all);
    all
}

fn assert_same(shown: &[Shown], made: &Made) {
    let expected = expected(made);
    assert_eq!(shown.len(), expected.len());
    for (a, b) in shown.iter().zip(&expected) {
        let pairs = a.0.as_flattened().iter().zip(b.0.as_flattened());
        assert!(
            pairs.into_iter().all(|(a, b)| (a - b).abs() < 1e-6),
            "{a:?} {b:?}"
        );
        assert_eq!(a.1, b.1);
    }
}

fn exact(max_message_bytes: usize, history_messages: usize) -> PublishParams {
    PublishParams {
        max_message_bytes,
        history_messages,
        viewer_format: PageFormat::Png,
        ..PublishParams::default()
    }
}

#[test]
fn rviz_shows_the_scan_after_every_revision_early_and_late() {
    for (seed, history, origin_m) in [(21, 1000, 0.0), (22, 12, 4e6), (23, 30, 0.0)] {
        let mut scan = Scan::new(seed);
        scan.origin_m = origin_m;
        let mut publisher = Publisher::new(exact(30_000, history));
        let mut early = Rviz::default();
        let mut kept: Vec<Vec<u8>> = Vec::new();
        for revision in 1..10 {
            let made = scan.made();
            let outgoing = publisher
                .publish(&made.snapshot(revision), &only(OutputTopic::Markers))
                .unwrap();
            for message in messages_of(&outgoing, OutputTopic::Markers) {
                assert!(message.len() <= 30_000);
                early.apply(&MarkerArray::decode(message).unwrap());
                kept.push(message.to_vec());
            }
            assert_same(&early.all(), &made);
            let since_whole = publisher.num_messages_since_whole(OutputTopic::Markers);
            assert!(since_whole <= history);
            let mut late = Rviz::default();
            for message in &kept[kept.len() - since_whole..] {
                late.apply(&MarkerArray::decode(message).unwrap());
            }
            assert_same(&late.all(), &made);
            scan.change(seed + revision);
        }
    }
}

#[test]
fn a_small_change_sends_few_markers() {
    let mut scan = Scan::new(24);
    scan.page_size_texel = [768, 768];
    for _ in 0..300 {
        scan.add();
    }
    let mut publisher = Publisher::new(exact(60_000, 1000));
    let whole = publisher
        .publish(&scan.made().snapshot(1), &everything)
        .unwrap();
    scan.paint(5);
    let change = publisher
        .publish(&scan.made().snapshot(2), &everything)
        .unwrap();
    for topic in [
        OutputTopic::Markers,
        OutputTopic::Scene,
        OutputTopic::MeshGeometry,
    ] {
        let [num_whole, num_change] = [&whole, &change].map(|o| messages_of(o, topic).len());
        assert!(num_whole > 20, "{topic:?}: {num_whole}");
        assert!((1..8).contains(&num_change), "{topic:?}: {num_change}");
    }
}

#[test]
fn a_piece_goes_in_the_message_in_which_another_takes_its_place() {
    let mut scan = Scan::new(27);
    let mut publisher = Publisher::new(exact(60_000, 1000));
    publisher
        .publish(&scan.made().snapshot(1), &everything)
        .unwrap();
    for seed in 0..20 {
        scan.paint(seed);
    }
    let change = publisher
        .publish(&scan.made().snapshot(2), &everything)
        .unwrap();
    // Nothing went for good: every message that deletes adds what takes the place.
    let mut num_replaced = 0;
    for message in messages_of(&change, OutputTopic::Markers) {
        let array = MarkerArray::decode(message).unwrap();
        let actions: Vec<i32> = array.markers.iter().map(|marker| marker.action).collect();
        assert_eq!(actions.last(), Some(&marker::ADD));
        assert!(
            actions
                .iter()
                .all(|a| [marker::ADD, marker::DELETE].contains(a))
        );
        num_replaced += actions.iter().filter(|a| **a == marker::DELETE).count();
    }
    assert!(num_replaced > 0);
    let mut num_deleted = 0;
    for message in messages_of(&change, OutputTopic::Scene) {
        let update = SceneUpdate::decode(message).unwrap();
        assert!(!update.entities.is_empty());
        num_deleted += update.deletions.len();
    }
    assert!(num_deleted > 0);
}

/// The triangles of a GLB file in the z-up frame, with the colours at their corners.
fn shown_of_glb(bytes: &[u8]) -> Vec<Shown> {
    let file = gltf::Gltf::from_slice(bytes).unwrap();
    let (document, blob) = (file.document, file.blob.unwrap());
    let mut shown = Vec::new();
    let images: Vec<_> = document.images().collect();
    assert_eq!(images.len(), 1);
    let gltf::image::Source::View { view, mime_type } = images[0].source() else {
        panic!("the texture lies outside the file");
    };
    assert_eq!(mime_type, "image/png");
    let png = &blob[view.offset()..view.offset() + view.length()];
    let texture = image::load_from_memory(png).unwrap().into_rgb8();
    for node in document.nodes() {
        let origin = node.transform().decomposed().0;
        let Some(mesh) = node.mesh() else { continue };
        for primitive in mesh.primitives() {
            let reader = primitive.reader(|_| Some(blob.as_slice()));
            let positions: Vec<[f32; 3]> = reader.read_positions().unwrap().collect();
            let uvs: Vec<[f32; 2]> = reader.read_tex_coords(0).unwrap().into_f32().collect();
            let indices: Vec<u32> = reader.read_indices().unwrap().into_u32().collect();
            for corners in indices.as_chunks::<3>().0 {
                shown.push((
                    corners.map(|v| {
                        let p = positions[v as usize];
                        [0, 1, 2].map(|axis| f64::from(p[axis]) + f64::from(origin[axis]))
                    }),
                    corners.map(|v| nearest(&texture, uvs[v as usize])),
                ));
            }
        }
    }
    shown
}

#[test]
fn foxglove_shows_the_scan_after_every_revision() {
    let mut scan = Scan::new(25);
    let mut publisher = Publisher::new(exact(30_000, 60));
    let mut entities: BTreeMap<String, Vec<Shown>> = BTreeMap::new();
    for revision in 1..8 {
        let made = scan.made();
        let outgoing = publisher
            .publish(&made.snapshot(revision), &only(OutputTopic::Scene))
            .unwrap();
        for message in messages_of(&outgoing, OutputTopic::Scene) {
            assert!(message.len() <= 30_000);
            let update = SceneUpdate::decode(message).unwrap();
            for deletion in update.deletions {
                assert!(deletion.timestamp > made.snapshot(revision).stamp);
                match deletion.kind {
                    scene_update::ALL => entities.clear(),
                    _ => assert!(entities.remove(deletion.id.as_ref()).is_some()),
                }
            }
            for entity in update.entities {
                assert_eq!((entity.frame_id, entity.models.len()), ("map", 1));
                let model = &entity.models[0];
                assert_eq!((model.media_type, model.url), ("model/gltf-binary", ""));
                let was = entities.insert(entity.id.into_owned(), shown_of_glb(&model.data));
                assert!(was.is_none());
            }
        }
        let mut all: Vec<Shown> = entities.values().flatten().copied().collect();
        // f32 positions; round as the expectation is.
        sort(&mut all);
        let expected = expected(&made);
        assert_eq!(all.len(), expected.len());
        let area: f64 = all.iter().map(|(corners, _)| area_m2(corners)).sum();
        assert!((area - made.area_m2()).abs() < 1e-5 * area.max(1e-3));
        let mut colors = [all, expected].map(|shown| {
            let colors: Vec<[u8; 3]> = shown.into_iter().flat_map(|(_, colors)| colors).collect();
            colors
        });
        colors.iter_mut().for_each(|c| c.sort_unstable());
        assert!(colors[0] == colors[1], "revision {revision}");
        scan.change(revision + 70);
    }
}

fn area_m2(corners: &[[f64; 3]; 3]) -> f64 {
    let [a, b, c] = corners.map(nalgebra::Point3::from);
    (b - a).cross(&(c - a)).norm() * 0.5
}

#[test]
fn meshes_of_mesh_msgs_are_the_scan_and_their_services_say_the_same() {
    let made = Scan::new(26).made();
    let params = exact(30_000, 1000);
    let outgoing = Publisher::new(params)
        .publish(&made.snapshot(1), &everything)
        .unwrap();
    let geometries = messages_of(&outgoing, OutputTopic::MeshGeometry);
    let materials = messages_of(&outgoing, OutputTopic::MeshMaterials);
    let pieces = mesh_pieces(&made.snapshot(1), &params).unwrap();
    assert!(pieces.len() > 3);
    assert_eq!(
        (geometries.len(), materials.len()),
        (pieces.len(), pieces.len())
    );
    let header = WireHeader {
        stamp: made.snapshot(1).stamp,
        frame_id: "map",
    };
    let mut shown: Vec<Shown> = Vec::new();
    for ((geometry, material), piece) in geometries.iter().zip(&materials).zip(&pieces) {
        let geometry = MeshGeometryStamped::decode(geometry).unwrap();
        let material = MeshMaterialsStamped::decode(material).unwrap();
        assert_eq!(geometry, piece.geometry(header));
        assert_eq!(material, piece.materials(header));
        assert!(piece.texture(header, 1).is_none());
        let texture = piece.texture(header, 0).unwrap();
        assert!(texture.encode().len() <= params.max_message_bytes);
        assert_eq!(texture.uuid, geometry.uuid);
        assert_eq!(geometry.vertex_normals.len(), geometry.vertices_m.len());
        assert_eq!(material.vertex_tex_coords.len(), geometry.vertices_m.len());
        assert_eq!(
            material.clusters[0].face_indices.len(),
            geometry.faces.len()
        );
        let image = image::RgbImage::from_raw(
            texture.image.width,
            texture.image.height,
            texture.image.data.to_vec(),
        )
        .unwrap();
        let colors = piece.vertex_colors(header).vertex_colors;
        for face in &geometry.faces {
            let corners = face.map(|v| geometry.vertices_m[v as usize]);
            let seen = face.map(|v| nearest(&image, material.vertex_tex_coords[v as usize]));
            let vertex = face.map(|v| {
                let [r, g, b, _] = colors[v as usize];
                [r, g, b].map(|c| (c * 255.0).round() as u8)
            });
            assert_eq!(seen, vertex);
            shown.push((corners, seen));
        }
    }
    sort(&mut shown);
    assert_same(&shown, &made);
    let uuids: std::collections::BTreeSet<&str> = pieces.iter().map(|p| p.uuid()).collect();
    assert_eq!(uuids.len(), pieces.len());
}
