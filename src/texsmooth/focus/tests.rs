//! A floor of two charts below a camera.

use nalgebra::{UnitQuaternion, Vector3};

use super::*;
use crate::atlas::{ChartId, PlacedChart, TexelRect};
use crate::geom::{CameraModel, ColorEncoding, EncodedColor, PinholeCamera, RigidTransform, Stamp};
use crate::keyframe::{FrameQuality, KeyframeId};
use crate::render::raster::{RasterWorkspace, ViewBuffer, rasterize};

/// Two squares of a metre that touch at x = 0, 2 m deep.
fn floor() -> (TriMesh, AtlasLayout) {
    let corners = [
        [-1.0, 0.0],
        [0.0, 0.0],
        [0.0, 1.0],
        [-1.0, 1.0],
        [1.0, 0.0],
        [1.0, 1.0],
    ];
    let positions = corners.map(|[x, y]| Point3::new(x, y - 0.5, 2.0)).to_vec();
    let triangles = vec![[0, 1, 2], [0, 2, 3], [1, 4, 5], [1, 5, 2]];
    let (mesh, _) = TriMesh::from_soup(positions, triangles).unwrap();
    let charts = [0u32, 1].map(|chart| {
        let rect = TexelRect {
            x: 10 * chart,
            y: 0,
            width: 10,
            height: 10,
        };
        let triangles = [2 * chart, 2 * chart + 1].map(TriangleId).to_vec();
        PlacedChart::whole_rect(0, rect, 10.0, triangles)
    });
    let layout = AtlasLayout {
        page_size_texel: [20, 10],
        num_pages: 1,
        texels_per_m: 10.0,
        charts: charts.to_vec(),
        chart_of_triangle: [0, 0, 1, 1].map(ChartId).to_vec(),
        corners_texel: vec![[[0.0; 2]; 3]; 4],
    };
    (mesh, layout)
}

fn frame(x_m: f64, turned_rad: f64) -> Arc<Keyframe> {
    let camera = PinholeCamera::new([80.0, 80.0, 63.5, 47.5], 128, 96).unwrap();
    let bytes = vec![0; 128 * 96];
    let color = EncodedColor::from_raw(ColorEncoding::Mono8, 128, 96, 128, bytes.into());
    Arc::new(Keyframe {
        id: KeyframeId(0),
        stamp: Stamp::from_nanos(0),
        world_from_camera: RigidTransform::from_parts(
            UnitQuaternion::from_euler_angles(0.0, turned_rad, 0.1),
            Vector3::new(x_m, 0.0, 0.0),
        ),
        color: color.unwrap(),
        color_camera: CameraModel::ideal(camera),
        depth: None,
        quality: FrameQuality::default(),
    })
}

#[test]
fn the_guess_is_what_a_view_shows_where_nothing_is_hidden() {
    let (mesh, layout) = floor();
    let frames = [
        frame(0.0, 0.0),
        frame(1.0, -0.6),
        frame(-1.5, 0.2),
        frame(0.0, 3.0),
    ];
    for may_change in [[true, false], [false, true]] {
        let focus = Focus::guess(&mesh, &layout, &may_change, &frames);
        for (frame, &guessed) in frames.iter().zip(&focus.num_px) {
            let mut view = ViewBuffer::default();
            rasterize(
                &mesh,
                &frame.color_camera.pinhole,
                &frame.world_from_camera.inverse(),
                &mut RasterWorkspace::default(),
                &mut view,
            );
            let shown = |id: &&u32| may_change.get(**id as usize / 2) == Some(&true);
            let expected = view.triangle.iter().filter(shown).count();
            let bound = 30.0 + 0.05 * expected as f64;
            assert!(
                (guessed as f64 - expected as f64).abs() < bound,
                "{guessed} for {expected}"
            );
        }
        assert_eq!(focus.num_px[3], 0, "behind the camera");
        assert_eq!(focus.num_views(), 3);
    }
    let nothing = Focus::guess(&mesh, &layout, &[false, false], &frames);
    assert_eq!(nothing.num_views(), 0);
    assert_eq!(nothing.draw(StepDraws::new(1, 1)), None);
}

#[test]
fn views_are_drawn_as_often_as_they_have_pixels() {
    let mut focus = Focus {
        num_px: vec![100, 0, 5, 300],
    };
    focus.set(2, 600);
    let mut counts = [0; 4];
    for step in 0..10_000 {
        counts[focus.draw(StepDraws::new(7, step)).unwrap()] += 1;
    }
    assert_eq!(counts[1], 0);
    for (count, expected) in counts.iter().zip([1000, 0, 6000, 3000]) {
        assert!(
            (expected - 200..=expected + 200).contains(count),
            "{counts:?}"
        );
    }
}

#[test]
fn a_small_chart_beside_a_large_one_has_its_point() {
    let (mesh, layout) = floor();
    let small = mesh.filtered(|t| t.index() < 2);
    let shrunk: Vec<_> = small.positions_m().iter().map(|p| p * 1e-3).collect();
    let mut positions = mesh.positions_m().to_vec();
    let first = positions.len() as u32;
    positions.extend(shrunk);
    let mut triangles = mesh.triangles().to_vec();
    triangles.extend(small.triangles().iter().map(|t| t.map(|v| v + first)));
    let (mesh, _) = TriMesh::from_soup(positions, triangles).unwrap();
    let mut layout = layout;
    let mut chart = layout.charts[0].clone();
    chart.triangles = vec![TriangleId(4), TriangleId(5)];
    layout.charts.push(chart);
    let pieces = spread(&mesh, &layout, &[true, true, true]);
    assert!((4096..4100).contains(&pieces.len()), "{}", pieces.len());
    let near = |piece: &&Piece| piece.position_m.z < 1.0;
    assert_eq!(pieces.iter().filter(near).count(), 1);
    let areas: f64 = pieces.iter().map(|piece| piece.normal.norm()).sum();
    assert!((areas - 2.0 - 1e-6).abs() < 1e-9, "{areas}");
}
