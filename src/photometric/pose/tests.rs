//! A wall whose paint is a formula, and cameras whose poses are wrong by a known turn.

#![expect(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "the numbers of a test are small"
)]

use std::sync::Arc;

use nalgebra::{Point3, Vector3};

use super::*;
use crate::atlas::{ChartId, PlacedChart, TexelRect, TexelSource, TexturePage};
use crate::geom::{CameraModel, ColorEncoding, ColorImage, EncodedColor, PinholeCamera, Stamp};
use crate::keyframe::{FrameQuality, KeyframeId};

const WIDTH: u32 = 320;
const HEIGHT: u32 = 240;
const TEXELS_PER_M: f64 = 120.0;
const SIDE_TEXEL: u32 = 364;
const OTHER: TexelSource = TexelSource::keyframe(99);

/// Broad and fine structure that does not repeat within the view.
fn paint(x: f64, y: f64) -> [u8; 3] {
    let broad = 40.0 * (2.3 * x + 1.1 * y).sin() + 30.0 * (3.7 * y - 0.9 * x * x).cos();
    let fine = 20.0 * (9.1 * x + 4.3 * y).sin() * (7.7 * y - 2.0 * x).cos();
    [1.0, 0.8, -0.6].map(|gain| (128.0 + gain * (broad + fine)).round() as u8)
}

fn camera() -> PinholeCamera {
    PinholeCamera::new([300.0, 310.0, 161.0, 117.0], WIDTH, HEIGHT).unwrap()
}

/// A wall of 3 m at z = 2, painted by another keyframe.
fn wall() -> (TriMesh, AtlasLayout, AtlasTexture) {
    let positions = [[-1.5, -1.5], [1.5, -1.5], [1.5, 1.5], [-1.5, 1.5]]
        .map(|[x, y]| Point3::new(x, y, 2.0))
        .to_vec();
    let (mesh, _) = TriMesh::from_soup(positions, vec![[0, 2, 1], [0, 3, 2]]).unwrap();
    let corners_texel = mesh
        .triangle_ids()
        .map(|t| {
            let texel = |v: f64| ((v + 1.5) * TEXELS_PER_M + 2.0) as f32;
            mesh.corners_m(t).map(|p| [texel(p.x), texel(p.y)])
        })
        .collect();
    let rect = TexelRect {
        x: 0,
        y: 0,
        width: SIDE_TEXEL,
        height: SIDE_TEXEL,
    };
    let layout = AtlasLayout {
        page_size_texel: [SIDE_TEXEL; 2],
        num_pages: 1,
        texels_per_m: TEXELS_PER_M,
        charts: vec![PlacedChart::whole_rect(
            0,
            rect,
            TEXELS_PER_M,
            mesh.triangle_ids().collect(),
        )],
        chart_of_triangle: vec![ChartId(0); 2],
        corners_texel,
    };
    let mut page = TexturePage::blank(SIDE_TEXEL, SIDE_TEXEL);
    for (index, texel) in page.srgb.iter_mut().enumerate() {
        let [x, y] = point_of_texel(index);
        *texel = paint(x, y);
    }
    page.source.fill(OTHER);
    (mesh, layout, AtlasTexture::from_iter([page]))
}

fn point_of_texel(index: usize) -> [f64; 2] {
    let side = SIDE_TEXEL as usize;
    [index % side, index / side].map(|texel| (texel as f64 + 0.5 - 2.0) / TEXELS_PER_M - 1.5)
}

fn pose(about_x_rad: f64, about_y_rad: f64) -> RigidTransform {
    RigidTransform::from_parts(
        UnitQuaternion::from_euler_angles(about_x_rad, about_y_rad, 0.0),
        Vector3::new(0.1, -0.05, 0.0),
    )
}

/// What a camera at `pose` sees, without the renderer.
fn photograph(pose: &RigidTransform) -> Arc<DecodedFrame> {
    let camera = camera();
    let origin = pose.translation();
    let mut pixels = vec![];
    for y in 0..HEIGHT {
        for x in 0..WIDTH {
            let ray = pose.transform_vector(&camera.ray(f64::from(x), f64::from(y)));
            let point = origin + ray * ((2.0 - origin.z) / ray.z);
            pixels.push(paint(point.x, point.y));
        }
    }
    Arc::new(DecodedFrame {
        color: ColorImage::new(WIDTH, HEIGHT, pixels).unwrap(),
        color_camera: camera,
        depth: None,
    })
}

fn keyframe(id: u32, world_from_camera: RigidTransform) -> Arc<Keyframe> {
    let bytes = vec![0; (WIDTH * HEIGHT) as usize];
    Arc::new(Keyframe {
        id: KeyframeId(id),
        stamp: Stamp::from_nanos(0),
        world_from_camera,
        color: EncodedColor::from_raw(ColorEncoding::Mono8, WIDTH, HEIGHT, WIDTH, bytes.into())
            .unwrap(),
        color_camera: CameraModel::ideal(camera()),
        depth: None,
        quality: FrameQuality::default(),
    })
}

/// Both triangles of the wall were painted by keyframe 0, which is not looked at.
const PAINTED_BY_FIRST: [Option<u32>; 2] = [Some(0), Some(0)];

/// Measures and turns until four rounds are done; the offsets of the last measure.
fn settle(
    truth: &[RigidTransform],
    given: &[RigidTransform],
) -> (Vec<Arc<Keyframe>>, Vec<PoseMeasure>) {
    let (mesh, layout, texture) = wall();
    let photos: Vec<Arc<DecodedFrame>> = truth.iter().map(photograph).collect();
    let mut keyframes: Vec<_> = (0..).zip(given).map(|(i, p)| keyframe(i, *p)).collect();
    let params = PoseParams::default();
    let painted = Painted {
        mesh: &mesh,
        layout: &layout,
        texture: &texture,
        label: &PAINTED_BY_FIRST,
    };
    let measure = |keyframes: &[Arc<Keyframe>]| -> Vec<PoseMeasure> {
        let all = keyframes.iter().enumerate().map(|(index, keyframe)| {
            let photo = PosePhoto::new(&photos[index], &params).unwrap();
            let camera_from_world = keyframe.world_from_camera.inverse();
            measure_pose(painted, index, &camera_from_world, &photo, &params).unwrap()
        });
        all.collect()
    };
    for _ in 0..4 {
        for (index, measured) in measure(&keyframes).into_iter().enumerate() {
            if let Some(offset_px) = measured.offset_px
                && let Some(turned) = turned(&keyframes[index], &given[index], offset_px, &params)
            {
                keyframes[index] = Arc::new(turned);
            }
        }
    }
    let last = measure(&keyframes);
    (keyframes, last)
}

#[test]
fn known_turns_are_taken_out() {
    let truth = [pose(0.0, 0.0), pose(0.03, -0.05), pose(-0.04, 0.02)];
    let given = [pose(0.0, 0.0), pose(0.037, -0.044), pose(-0.045, 0.031)];
    let (keyframes, measures) = settle(&truth, &given);
    for index in 1..3 {
        let offset_px = measures[index].offset_px.unwrap();
        assert!(offset_px.iter().all(|px| px.abs() < 0.1), "{offset_px:?}");
        let residual = measures[index].residual_255.unwrap();
        assert!(residual < 3.0, "{residual}");
        let found = &keyframes[index].world_from_camera;
        // A turn about the axis of view moves the middle of the image by nothing, and stays.
        let axis = |pose: &RigidTransform| pose.transform_vector(&Vector3::z());
        let error_rad = axis(found).angle(&axis(&truth[index]));
        // 0.1 px of a focal length of 300.
        assert!(error_rad < 0.1 / 300.0, "{error_rad}");
        assert_eq!(found.translation(), given[index].translation());
    }
    // What it painted itself says nothing of its pose.
    assert_eq!(measures[0], PoseMeasure::default());
    assert_eq!(keyframes[0].world_from_camera, given[0]);
}

#[test]
fn turns_beyond_the_bound_are_left() {
    let params = PoseParams {
        max_turn_rad: 0.01,
        ..PoseParams::default()
    };
    let given = pose(0.0, 0.0);
    let frame = keyframe(1, given);
    assert!(turned(&frame, &given, [10.0, 0.0], &params).is_none());
    let small = turned(&frame, &given, [3.0, -1.0], &params).unwrap();
    assert!(
        small
            .world_from_camera
            .rotation()
            .angle_to(given.rotation())
            < 0.01
    );
}
