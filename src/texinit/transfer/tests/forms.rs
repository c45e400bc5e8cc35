//! Our form of the transfer and the published program's, against the truth and against a plain
//! evaluation.

use super::*;

/// Stands beside the wall: distances to its two ends are as 2 to 3, all of it in the image.
const BESIDE: ([f64; 3], f64) = ([-1.5, 0.0, 0.3], 0.5);

fn from_beside(wall: Panel) -> Scene {
    let mut scene = Scene {
        panels: vec![wall],
        ..Scene::default()
    };
    scene.photograph(
        BESIDE.0,
        BESIDE.1,
        &[Panel {
            paint: wall.paint,
            ..BACKDROP
        }],
        true,
    );
    scene
}

fn paint_with(scene: &Scene, layout: &AtlasLayout, params: &TransferParams) -> TexturePage {
    let assign = AssignParams {
        pairwise: None,
        ..AssignParams::paper()
    };
    paint(scene, layout, &assign, params).1
}

/// Where a frame of the analytic scenes sees a point.
fn pixel_of(scene: &Scene, frame: usize, point: &Point3<f64>) -> [f64; 2] {
    let p = scene.poses[frame]
        .world_from_camera
        .inverse()
        .transform_point(point);
    [150.0 * p.x / p.z + 79.5, 150.0 * p.y / p.z + 59.5]
}

/// The pixel that the published program takes for a texel with these weights.
fn affine_pixel(scene: &Scene, frame: usize, triangle: TriangleId, weights: [f32; 3]) -> [f64; 2] {
    let corners = scene.mesh().corners_m(triangle);
    let px = corners.map(|corner| pixel_of(scene, frame, &corner));
    [0, 1].map(|axis| (0..3).map(|i| f64::from(weights[i]) * px[i][axis]).sum())
}

#[test]
fn averaging_the_footprint_comes_nearer_to_the_true_mean_than_the_nearest_pixel() {
    // Checks of 3 cm on texels of 10 cm; a pixel covers about 2 cm.
    fn checks(x: f64, y: f64) -> [f64; 3] {
        let parity = ((x / 0.03).floor() + (y / 0.03).floor()).rem_euclid(2.0);
        [255.0 * parity; 3]
    }
    let scene = from_beside(Panel {
        paint: checks,
        ..WALL
    });
    let layout = scene.layout(10.0);
    let error = |params: &TransferParams| {
        let page = paint_with(&scene, &layout, params);
        let (mut sum, mut num) = (0.0, 0.0);
        for_each_wall_texel(&scene, &layout, |_, index, point| {
            let mut light = 0.0;
            for i in 0..40 {
                for j in 0..40 {
                    let offset = |k: i32| (f64::from(k) + 0.5) / 400.0 - 0.05;
                    light += checks(point.x + offset(i), point.y + offset(j))[0] / 255.0 / 1600.0;
                }
            }
            sum += (f64::from(linear_from_srgb(page.srgb[index][0])) - light).abs();
            num += 1.0;
        });
        assert!(num > 200.0);
        sum / num
    };
    let footprint = error(&TransferParams::default());
    let nearest = error(&TransferParams::paper());
    // A pixel is black or white: half off everywhere.
    assert!(nearest > 0.4, "{nearest}");
    assert!(footprint < 0.2 * nearest, "{footprint} against {nearest}");
}

#[test]
fn perspective_is_exact_where_the_affine_lookup_is_off() {
    let scene = from_beside(Panel {
        cells: [1, 1],
        ..WALL
    });
    let layout = scene.layout(60.0);
    let worst = |params: &TransferParams| {
        let page = paint_with(&scene, &layout, params);
        let mut worst = 0.0f64;
        for_each_wall_texel(&scene, &layout, |_, index, point| {
            assert_eq!(page.source[index], TexelSource::keyframe(100));
            for (byte, expected) in page.srgb[index].iter().zip(waves(point.x, point.y)) {
                worst = worst.max((f64::from(*byte) - expected).abs());
            }
        });
        worst
    };
    let ours = worst(&TransferParams::default());
    let affine = worst(&TransferParams::paper());
    assert!(ours < 3.0, "{ours}");
    assert!(affine > 15.0, "{affine}");
}

#[test]
fn the_published_lookup_is_the_nearest_pixel_of_the_affine_map() {
    let scene = from_beside(Panel {
        cells: [3, 2],
        ..WALL
    });
    let layout = scene.layout(30.0);
    let page = paint_with(&scene, &layout, &TransferParams::paper());
    let mut num = 0;
    for &triangle in &layout.charts[0].triangles {
        let corners = &layout.corners_texel[triangle.index()];
        for_each_texel_within(corners, layout.page_size_texel, |x, y, weights| {
            let px = affine_pixel(&scene, 0, triangle, weights);
            // Half-way cases may round either way.
            if px.iter().any(|v| ((v + 0.5).fract() - 0.5).abs() > 0.4999) {
                return;
            }
            let [column, row] = px.map(|v| (v + 0.5).floor() as usize);
            let expected = scene.frames[0].color.pixels()[row * 160 + column];
            assert_eq!(page.srgb[(y * page.width + x) as usize], expected);
            num += 1;
        });
    }
    assert!(num > 2000);
}

#[test]
fn the_published_mean_takes_every_frame_that_a_texel_projects_into() {
    let mut scene = Scene {
        panels: vec![WALL, BOARD],
        ..Scene::default()
    };
    for (position, yaw_rad) in [
        ([0.0, 0.0, 0.4], 0.0),
        ([0.5, 0.1, 0.6], -0.4),
        ([0.1, 0.0, 1.5], 0.6),
    ] {
        scene.photograph(position, yaw_rad, &[BACKDROP], true);
    }
    let layout = scene.layout(30.0);
    let params = TransferParams {
        mode: TransferMode::L2Avg,
        ..TransferParams::paper()
    };
    let page = paint_with(&scene, &layout, &params);
    let (mut num_by_views, mut num_red) = ([0; 4], 0);
    for &triangle in &layout.charts[0].triangles {
        let corners = &layout.corners_texel[triangle.index()];
        for_each_texel_within(corners, layout.page_size_texel, |x, y, weights| {
            let (mut sum, mut num) = ([0.0; 3], 0usize);
            for frame in 0..3 {
                let [column, row] = affine_pixel(&scene, frame, triangle, weights);
                if (0.0..=159.0).contains(&column) && (0.0..=119.0).contains(&row) {
                    let index = (row + 0.5) as usize * 160 + (column + 0.5) as usize;
                    for (sum, byte) in sum
                        .iter_mut()
                        .zip(scene.frames[frame].color.pixels()[index])
                    {
                        *sum += f64::from(byte);
                    }
                    num += 1;
                }
            }
            let index = (y * page.width + x) as usize;
            num_by_views[num] += 1;
            if num == 0 {
                assert_eq!(page.source[index], TexelSource::NONE);
                return;
            }
            assert_eq!(page.source[index], TexelSource::MEAN);
            for (byte, sum) in page.srgb[index].iter().zip(sum) {
                assert!((f64::from(*byte) - sum / num as f64).abs() <= 0.51);
            }
            // The board is red, the wall is not: what it hides is averaged in all the same.
            num_red += usize::from(page.srgb[index][1] < 45);
        });
    }
    assert!(
        num_by_views[1..].iter().all(|&n| n > 15),
        "{num_by_views:?}"
    );
    assert!(num_red > 20, "{num_red}");
    let seeing = TransferParams {
        mode: TransferMode::L2Avg,
        ..TransferParams::default()
    };
    let page = paint_with(&scene, &layout, &seeing);
    let mut num_red_seen = 0;
    for_each_wall_texel(&scene, &layout, |_, index, _| {
        let is_painted = page.source[index] != TexelSource::NONE;
        num_red_seen += usize::from(is_painted && page.srgb[index][1] < 45);
    });
    assert!(10 * num_red_seen < num_red, "{num_red_seen} of {num_red}");
}
