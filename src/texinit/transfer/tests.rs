#![expect(
    clippy::cast_possible_truncation,
    reason = "the numbers of a test are small"
)]

mod forms;
mod maps;

use super::*;
use crate::atlas::TexelSource;
use crate::atlas::texels::for_each_texel_within;
use crate::geom::color::{linear_from_srgb, srgb_from_linear};
use crate::render::{RenderParams, render_textured};
use crate::texinit::analytic_scene::{Panel, Scene, grey, red, waves};
use crate::texinit::assign::{AssignParams, assign_poses};
use nalgebra::Point3;
use proptest::prelude::*;

const WALL: Panel = Panel {
    min: [-1.0, -0.7],
    max: [1.0, 0.7],
    z: 3.0,
    cells: [20, 14],
    paint: waves,
};
const BOARD: Panel = Panel {
    min: [-0.2, -0.2],
    max: [0.2, 0.2],
    z: 2.0,
    cells: [1, 1],
    paint: red,
};

fn paint(
    scene: &Scene,
    layout: &AtlasLayout,
    assign: &AssignParams,
    params: &TransferParams,
) -> (Assignment, TexturePage, TransferReport) {
    let mesh = scene.mesh();
    let decode = |frame: usize| Ok(scene.frames[frame].clone());
    let assignment = assign_poses(&mesh, &scene.poses, &decode, assign, &|_| ()).unwrap();
    let (texture, report) = transfer_poses(
        &mesh,
        layout,
        &assignment,
        &scene.poses,
        &decode,
        params,
        &|_| (),
    )
    .unwrap();
    (assignment, TexturePage::clone(&texture.pages[0]), report)
}

/// Visits every owned texel of the first panel with its point on it.
fn for_each_wall_texel(
    scene: &Scene,
    layout: &AtlasLayout,
    mut visit: impl FnMut(TriangleId, usize, Point3<f64>),
) {
    let mesh = scene.mesh();
    for &triangle in &layout.charts[0].triangles {
        let corners = mesh.corners_m(triangle);
        for_each_texel_within(
            &layout.corners_texel[triangle.index()],
            layout.page_size_texel,
            |x, y, w| {
                let [a, b, c] = w.map(f64::from);
                let point = Point3::from(
                    corners[0].coords * a + corners[1].coords * b + corners[2].coords * c,
                );
                visit(
                    triangle,
                    (y * layout.page_size_texel[0] + x) as usize,
                    point,
                );
            },
        );
    }
}

/// The same picture past the outline of the wall.
const BACKDROP: Panel = Panel {
    min: [-9.0, -9.0],
    max: [9.0, 9.0],
    ..WALL
};

fn slanted_views(panels: Vec<Panel>, has_depth: bool) -> Scene {
    let mut scene = Scene {
        panels,
        ..Scene::default()
    };
    scene.photograph([-0.6, 0.0, 0.9], 0.25, &[BACKDROP], has_depth);
    scene.photograph([0.7, 0.1, 0.7], -0.3, &[BACKDROP], has_depth);
    scene.photograph([0.1, -0.1, 0.0], 0.0, &[BACKDROP], has_depth);
    scene
}

#[test]
fn texels_have_the_colour_of_their_point_and_name_their_frame() {
    let scene = slanted_views(vec![WALL], true);
    let layout = scene.layout(60.0);
    let (assignment, page, report) = paint(
        &scene,
        &layout,
        &AssignParams::default(),
        &TransferParams::default(),
    );
    let (mut worst, mut num, mut frames) = (0.0f64, 0usize, [0; 3]);
    for_each_wall_texel(&scene, &layout, |triangle, index, point| {
        let Some(label) = assignment.label[triangle.index()] else {
            return;
        };
        frames[label as usize] += 1;
        assert_eq!(page.source[index], TexelSource::keyframe(100 + label));
        assert!(page.confidence[index] > 0);
        for (byte, expected) in page.srgb[index].iter().zip(waves(point.x, point.y)) {
            worst = worst.max((f64::from(*byte) - expected).abs());
        }
        num += 1;
    });
    // Half a step of rounding twice, and the curvature of the waves over a pixel of 2 cm.
    assert!(worst < 3.0, "{worst}");
    assert!(
        num > 8000 && frames[..2].iter().all(|&n| n > 500),
        "{num} {frames:?}"
    );
    assert_eq!(report.num_assigned, num);
}

#[test]
fn averaging_paints_the_same_smooth_texture() {
    let scene = slanted_views(vec![WALL], true);
    let layout = scene.layout(60.0);
    let params = TransferParams {
        mode: TransferMode::L2Avg,
        ..TransferParams::default()
    };
    let (_, page, report) = paint(&scene, &layout, &AssignParams::default(), &params);
    let mut num = 0;
    for_each_wall_texel(&scene, &layout, |_, index, point| {
        if page.source[index] != TexelSource::MEAN {
            return;
        }
        assert_eq!(page.confidence[index], MEAN_CONFIDENCE);
        for (byte, expected) in page.srgb[index].iter().zip(waves(point.x, point.y)) {
            assert!((f64::from(*byte) - expected).abs() < 3.0);
        }
        num += 1;
    });
    assert_eq!(report.num_assigned, 0);
    assert_eq!(report.num_mean, num);
    assert!(num > 9000);
}

#[test]
fn means_are_taken_in_linear_light() {
    let mut scene = Scene {
        panels: vec![WALL],
        ..Scene::default()
    };
    scene.panels[0].paint = grey;
    scene.photograph([0.0; 3], 0.0, &[], true);
    scene.panels[0].paint = red;
    scene.photograph([0.0; 3], 0.0, &[], true);
    let layout = scene.layout(30.0);
    let params = TransferParams {
        mode: TransferMode::L2Avg,
        ..TransferParams::default()
    };
    let (_, page, _) = paint(&scene, &layout, &AssignParams::default(), &params);
    let expected: [u8; 3] = [[120, 250], [120, 0], [120, 0]].map(|pair| {
        srgb_from_linear((linear_from_srgb(pair[0]) + linear_from_srgb(pair[1])) / 2.0)
    });
    let center = page.srgb.len() / 2 + page.width as usize / 2;
    assert_eq!(page.source[center], TexelSource::MEAN);
    assert_eq!(page.srgb[center], expected);
}

#[test]
fn coarse_texels_average_a_fine_pattern() {
    // Stripes of 4 cm, two pixels each, on texels of 20 cm.
    fn stripes(x: f64, _: f64) -> [f64; 3] {
        [if (x / 0.04).floor() % 2.0 == 0.0 {
            255.0
        } else {
            0.0
        }; 3]
    }
    let mut scene = Scene {
        panels: vec![Panel {
            paint: stripes,
            ..WALL
        }],
        ..Scene::default()
    };
    scene.photograph([0.0; 3], 0.0, &[], true);
    let layout = scene.layout(5.0);
    let (_, page, _) = paint(
        &scene,
        &layout,
        &AssignParams::default(),
        &TransferParams::default(),
    );
    let mut num = 0;
    for_each_wall_texel(&scene, &layout, |_, index, point| {
        if page.source[index].as_keyframe().is_some() && point.x.abs() < 0.8 {
            // 2½ periods a texel: between 40 and 60 % of light.
            let light = linear_from_srgb(page.srgb[index][0]);
            assert!((light - 0.5).abs() < 0.13, "{light} at {point}");
            num += 1;
        }
    });
    assert!(num > 20);
}

#[test]
fn what_hides_part_of_a_large_triangle_is_not_painted_on_it() {
    let wall = Panel {
        cells: [1, 1],
        ..WALL
    };
    let mut scene = Scene {
        panels: vec![wall, BOARD],
        ..Scene::default()
    };
    scene.photograph([0.0, 0.0, -0.5], 0.0, &[BACKDROP], false);
    scene.photograph([0.5, 0.0, -0.6], 0.0, &[BACKDROP], false);
    let layout = scene.layout(60.0);
    let (assignment, page, report) = paint(
        &scene,
        &layout,
        &AssignParams::default(),
        &TransferParams::default(),
    );
    assert!(assignment.label[..2].iter().all(Option::is_some));
    assert!(assignment.is_partly_hidden[..2].contains(&true));
    let (mut num_red, mut num_mean) = (0, 0);
    for_each_wall_texel(&scene, &layout, |_, index, point| {
        num_mean += usize::from(page.source[index] == TexelSource::MEAN);
        if page.source[index] != TexelSource::NONE {
            let error = (f64::from(page.srgb[index][2]) - waves(point.x, point.y)[2]).abs();
            num_red += usize::from(error > 20.0);
        }
    });
    // The board hides about 1100 texels.
    assert_eq!(num_red, 0);
    assert!(num_mean > 300, "{num_mean}");
    assert_eq!(report.num_mean, num_mean);
}

#[test]
fn a_new_view_of_the_painted_scene_looks_like_its_photo() {
    let mut scene = slanted_views(vec![WALL], true);
    let layout = scene.layout(80.0);
    let (_, page, _) = paint(
        &scene,
        &layout,
        &AssignParams::default(),
        &TransferParams::default(),
    );
    let texture = AtlasTexture::from_iter([page]);
    scene.photograph([-0.2, 0.15, 0.5], 0.15, &[], true);
    let photo = scene.frames[3].clone();
    let camera_from_world = scene.poses[3].world_from_camera.inverse();
    for supersampling in [1, 2] {
        let params = RenderParams { supersampling };
        let view = render_textured(
            &scene.mesh(),
            &layout,
            &texture,
            &photo.color_camera,
            &camera_from_world,
            &params,
        )
        .unwrap();
        let depths = photo.depth.as_ref().unwrap().image.depths_m();
        let (mut num_compared, mut num_differing_in_mask) = (0, 0);
        for (index, &is_seen) in view.mask.iter().enumerate() {
            num_differing_in_mask += usize::from(is_seen != (depths[index] > 0.0));
            if is_seen && depths[index] > 0.0 {
                num_compared += 1;
                let (seen, expected) = (view.color.pixels()[index], photo.color.pixels()[index]);
                for (a, b) in seen.iter().zip(expected) {
                    assert!(
                        a.abs_diff(b) <= 5,
                        "{seen:?} for {expected:?} at pixel {index}"
                    );
                }
            }
        }
        assert!(num_compared > 9000, "{num_compared}");
        // The outline, and texels there that no frame holds.
        assert!(num_differing_in_mask < 400, "{num_differing_in_mask}");
    }
}

#[test]
fn keyframes_give_what_their_decoded_frames_give() {
    use crate::geom::{CameraModel, ColorEncoding, EncodedColor, Stamp};
    use crate::keyframe::KeyframeId;

    let scene = slanted_views(vec![WALL], false);
    let (mesh, layout) = (scene.mesh(), scene.layout(40.0));
    let keyframes: Vec<Arc<Keyframe>> = scene
        .poses
        .iter()
        .zip(&scene.frames)
        .map(|(pose, frame)| {
            let bytes: Vec<u8> = frame.color.pixels().iter().flatten().copied().collect();
            let color = EncodedColor::from_raw(ColorEncoding::Rgb8, 160, 120, 480, bytes.into());
            Arc::new(Keyframe {
                id: KeyframeId(pose.id),
                stamp: Stamp::default(),
                world_from_camera: pose.world_from_camera,
                color: color.unwrap(),
                color_camera: CameraModel::ideal(frame.color_camera),
                depth: None,
                quality: pose.quality,
            })
        })
        .collect();
    let decode = |keyframe: &Keyframe| {
        Ok(Arc::new(DecodedFrame {
            color: keyframe.color.decode()?,
            color_camera: keyframe.color_camera.pinhole,
            depth: None,
        }))
    };
    let (assign_params, params) = (AssignParams::default(), TransferParams::default());
    let assignment =
        crate::texinit::assign::assign(&mesh, &keyframes, &decode, &assign_params, &|_| ())
            .unwrap();
    let (texture, _) = transfer(
        &mesh,
        &layout,
        &assignment,
        &keyframes,
        &decode,
        &params,
        &|_| (),
    )
    .unwrap();
    let (expected_assignment, expected_page, _) = paint(&scene, &layout, &assign_params, &params);
    assert_eq!(assignment, expected_assignment);
    assert_eq!(texture, AtlasTexture::from_iter([expected_page]));
}

#[test]
fn a_wall_that_reaches_behind_the_camera_is_painted_by_the_mean() {
    let wall = Panel {
        min: [-50.0, -0.7],
        max: [50.0, 0.7],
        cells: [1, 1],
        ..WALL
    };
    let mut scene = Scene {
        panels: vec![wall],
        ..Scene::default()
    };
    // Looking along the wall: its far end is in view, its near end behind the camera.
    scene.photograph([0.0, 0.0, 2.0], 1.2, &[], false);
    let mut layout = scene.layout(4.0);
    layout.texels_per_m = 4.0;
    let (assignment, page, report) = paint(
        &scene,
        &layout,
        &AssignParams::default(),
        &TransferParams::default(),
    );
    assert!(assignment.label.iter().all(Option::is_none));
    assert!(report.num_mean > 20, "{report:?}");
    for_each_wall_texel(&scene, &layout, |_, index, point| {
        if page.source[index] == TexelSource::MEAN {
            assert!(point.x > 0.0);
        }
    });
}

#[test]
fn thread_count_leaves_no_trace() {
    let scene = slanted_views(vec![WALL, BOARD], true);
    let layout = scene.layout(50.0);
    let run = |threads: usize, params: &TransferParams| {
        let pool = rayon::ThreadPoolBuilder::new()
            .num_threads(threads)
            .build()
            .unwrap();
        pool.install(|| paint(&scene, &layout, &AssignParams::default(), params))
    };
    for form in [TransferParams::default(), TransferParams::paper()] {
        for mode in [TransferMode::Assigned, TransferMode::L2Avg] {
            let params = TransferParams {
                mode,
                ..form.clone()
            };
            assert_eq!(run(1, &params), run(4, &params));
        }
    }
}

#[test]
fn mismatched_inputs_are_refused() {
    let scene = slanted_views(vec![WALL], false);
    let mesh = scene.mesh();
    let decode = |_: usize| unreachable!();
    let layout = scene.layout(20.0);
    let run = |layout: &AtlasLayout, assignment: &Assignment| {
        transfer_poses(
            &mesh,
            layout,
            assignment,
            &[],
            &decode,
            &TransferParams::default(),
            &|_| (),
        )
        .unwrap_err()
    };
    let num_triangles = mesh.num_triangles();
    let empty = Assignment::default();
    assert!(matches!(
        run(&layout, &empty),
        TransferError::Mismatch { num_labels: 0, .. }
    ));
    let mut labelled = Assignment {
        label: vec![None; num_triangles],
        is_partly_hidden: vec![false; num_triangles],
        ..Assignment::default()
    };
    labelled.label[7] = Some(3);
    let expected = TransferError::Label {
        triangle: 7,
        frame: 3,
        num_frames: 0,
    };
    assert_eq!(run(&layout, &labelled), expected);
    labelled.label[7] = None;
    let mut pageless = layout.clone();
    pageless.num_pages = 0;
    assert_eq!(
        run(&pageless, &labelled),
        TransferError::Page { triangle: 0 }
    );
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]
    #[test]
    fn no_layout_makes_it_panic(
        coordinates in prop::collection::vec(
            prop_oneof![-2.0..2.0f64, 1.0..4.0f64, Just(1e200), Just(0.0)], 9..30),
        corners in prop::collection::vec(
            prop_oneof![-5.0..40.0f32, Just(f32::NAN), Just(f32::INFINITY), Just(1e30)], 6..60),
    ) {
        let positions: Vec<Point3<f64>> =
            coordinates.chunks_exact(3).map(|c| Point3::new(c[0], c[1], c[2])).collect();
        let num = positions.len() as u32;
        let corners_texel: Vec<[[f32; 2]; 3]> = corners
            .chunks_exact(6)
            .map(|c| [[c[0], c[1]], [c[2], c[3]], [c[4], c[5]]])
            .collect();
        let triangles: Vec<[u32; 3]> = (0..corners_texel.len() as u32)
            .map(|i| [i, i + 1, 2 * i + 2].map(|v| v % num))
            .collect();
        let mesh = TriMesh::from_soup(positions, triangles).unwrap().0;
        let views = slanted_views(vec![WALL], true);
        let num_triangles = mesh.num_triangles();
        let layout = AtlasLayout {
            page_size_texel: [32, 16],
            num_pages: 1,
            texels_per_m: 1.0,
            charts: views.layout(5.0).charts,
            chart_of_triangle: vec![crate::atlas::ChartId(0); num_triangles],
            corners_texel,
        };
        let assignment = Assignment {
            label: (0..num_triangles).map(|i| [Some(0), None, Some(2)][i % 3]).collect(),
            is_partly_hidden: (0..num_triangles).map(|i| i % 2 == 0).collect(),
            ..Assignment::default()
        };
        let decode = |frame: usize| Ok(views.frames[frame].clone());
        for params in [TransferParams::default(), TransferParams::paper()] {
            let result = transfer_poses(
                &mesh, &layout, &assignment, &views.poses, &decode, &params, &|_| (),
            );
            prop_assert!(result.is_ok());
        }
    }
}
