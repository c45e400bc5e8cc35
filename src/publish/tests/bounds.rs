//! No message is over the bound, whatever the scan is like.

use nalgebra::Point3;
use proptest::prelude::*;

use super::made::{Made, Scan};
use super::{everything, messages_of};
use crate::atlas::{AtlasLayout, AtlasTexture, ChartId, PlacedChart, TexelRect, TexturePage};
use crate::export::PageFormat;
use crate::mesh::TriMesh;
use crate::publish::{MIN_MESSAGE_BYTES, OutputTopic, PublishError, PublishParams, Publisher};
use crate::wire::{MarkerArray, Message};

/// One page of noise under triangles given by their corners.
fn noise(page_size_texel: [u32; 2], triangles: &[[[f32; 2]; 3]]) -> Made {
    let [width, height] = page_size_texel;
    let corners = triangles.iter().flatten();
    let positions_m: Vec<Point3<f64>> = corners
        .map(|[x, y]| Point3::new(f64::from(*x) * 0.001, f64::from(*y) * 0.001, 1.0))
        .collect();
    let indices = (0..triangles.len() as u32).map(|t| [3 * t, 3 * t + 1, 3 * t + 2]);
    let (mesh, _) = TriMesh::from_soup(positions_m, indices.collect()).unwrap();
    let mut page = TexturePage::blank(width, height);
    let mut state = 1u64;
    for texel in &mut page.srgb {
        state = state
            .wrapping_mul(6_364_136_223_846_793_005)
            .wrapping_add(1);
        let [.., r, g, b] = state.to_le_bytes();
        *texel = [r, g, b];
    }
    let rect = TexelRect {
        x: 0,
        y: 0,
        width,
        height,
    };
    let layout = AtlasLayout {
        page_size_texel,
        num_pages: 1,
        texels_per_m: 1000.0,
        charts: vec![PlacedChart::whole_rect(
            0,
            rect,
            1000.0,
            mesh.triangle_ids().collect(),
        )],
        chart_of_triangle: vec![ChartId(0); triangles.len()],
        corners_texel: triangles.to_vec(),
    };
    Made {
        frame_id: "map".to_owned(),
        mesh,
        layout,
        texture: AtlasTexture::from_iter([page]),
        keyframes: Vec::new(),
    }
}

fn marker_area_m2(messages: &[&[u8]]) -> f64 {
    let mut area = 0.0;
    for message in messages {
        for marker in MarkerArray::decode(message).unwrap().markers {
            for corners in marker.points.as_chunks::<3>().0 {
                let [a, b, c] = corners.map(Point3::from);
                area += (b - a).cross(&(c - a)).norm() * 0.5;
            }
        }
    }
    area
}

fn assert_bounded(made: &Made, params: PublishParams) {
    let outgoing = Publisher::new(params)
        .publish(&made.snapshot(1), &everything)
        .unwrap();
    let longest = outgoing.iter().map(|m| m.bytes.len()).max();
    assert!(longest <= Some(params.max_message_bytes), "{longest:?}");
    let area_m2 = marker_area_m2(&messages_of(&outgoing, OutputTopic::Markers));
    assert!((area_m2 - made.area_m2()).abs() <= 1e-6 * area_m2.max(1e-9));
    for topic in [OutputTopic::Scene, OutputTopic::MeshGeometry] {
        assert!(!messages_of(&outgoing, topic).is_empty());
    }
}

#[test]
fn a_triangle_as_large_as_its_page_is_divided() {
    let made = noise([1024, 512], &[[[0.0, 0.0], [1024.0, 0.0], [0.0, 512.0]]]);
    for viewer_format in [PageFormat::Png, PageFormat::Jpeg { quality: 100 }] {
        for max_message_bytes in [MIN_MESSAGE_BYTES, 190_000] {
            let params = PublishParams {
                max_message_bytes,
                viewer_format,
                tile_texel: 1024,
                ..PublishParams::default()
            };
            assert_bounded(&made, params);
        }
    }
}

#[test]
fn ten_thousand_triangles_on_one_texel_are_divided_by_number() {
    let made = noise([64, 64], &[[[8.1, 8.1], [8.2, 8.1], [8.1, 8.2]]; 10_000]);
    assert_bounded(&made, PublishParams::default());
    let made = noise([64, 64], &[[[8.0, 8.0]; 3]; 5000]);
    let params = PublishParams {
        max_message_bytes: MIN_MESSAGE_BYTES,
        ..PublishParams::default()
    };
    assert_bounded(&made, params);
}

#[test]
fn a_long_frame_id_leaves_less_room_or_none() {
    let mut scan = Scan::new(31);
    scan.frame_id = "f".repeat(3000);
    let params = PublishParams {
        max_message_bytes: 40_000,
        ..PublishParams::default()
    };
    assert_bounded(&scan.made(), params);
    scan.frame_id = "f".repeat(50_000);
    let made = scan.made();
    for topic in OutputTopic::ALL {
        let refused = Publisher::new(params).publish(&made.snapshot(1), &|t| t == topic);
        assert!(
            matches!(refused, Err(PublishError::DoesNotFit { .. })),
            "{topic:?}"
        );
    }
}

#[test]
fn an_empty_scan_is_a_state_too() {
    let made = noise([64, 64], &[]);
    let outgoing = Publisher::new(PublishParams::default())
        .publish(&made.snapshot(1), &everything)
        .unwrap();
    for topic in [
        OutputTopic::TexturedMesh,
        OutputTopic::Markers,
        OutputTopic::Scene,
    ] {
        assert_eq!(messages_of(&outgoing, topic).len(), 1, "{topic:?}");
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(24))]

    #[test]
    fn no_message_is_over_the_bound(
        corners in prop::collection::vec(prop::array::uniform3((0.0f32..=300.0, 0.0f32..=200.0)), 1..80),
        max_message_bytes in MIN_MESSAGE_BYTES..60_000,
        tile_texel in 16u32..300,
        quality in 1u8..=100,
        is_jpeg in any::<bool>(),
    ) {
        let triangles: Vec<_> = corners.into_iter().map(|t| t.map(|(x, y)| [x, y])).collect();
        let made = noise([300, 200], &triangles);
        let format = if is_jpeg { PageFormat::Jpeg { quality } } else { PageFormat::Png };
        assert_bounded(&made, PublishParams {
            max_message_bytes,
            tile_texel,
            format,
            viewer_format: format,
            history_messages: 10,
        });
    }
}
