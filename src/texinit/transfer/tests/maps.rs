//! What the maps of sources and confidence say, on scenes where the answer is known.

use super::*;

#[test]
fn every_texel_shows_the_colour_of_the_frame_that_it_names() {
    fn shade_0(_: f64, _: f64) -> [f64; 3] {
        [40.0, 120.0, 120.0]
    }
    fn shade_1(_: f64, _: f64) -> [f64; 3] {
        [80.0, 120.0, 120.0]
    }
    fn shade_2(_: f64, _: f64) -> [f64; 3] {
        [120.0; 3]
    }
    let shades: [fn(f64, f64) -> [f64; 3]; 3] = [shade_0, shade_1, shade_2];
    let mut scene = Scene {
        panels: vec![WALL],
        ..Scene::default()
    };
    let views = [
        ([-0.6, 0.0, 0.9], 0.25),
        ([0.7, 0.1, 0.7], -0.3),
        ([0.1, -0.1, -1.0], 0.0),
    ];
    for ((position, yaw_rad), paint) in views.into_iter().zip(shades) {
        scene.panels[0].paint = paint;
        scene.photograph(position, yaw_rad, &[Panel { paint, ..BACKDROP }], true);
    }
    let layout = scene.layout(40.0);
    // Else the frame of the middle shade would win everywhere.
    let colour_blind = AssignParams {
        color_weight: 0.0,
        ..AssignParams::paper()
    };
    let (assignment, page, _) = paint(&scene, &layout, &colour_blind, &TransferParams::default());
    let mut num_by_frame = [0; 3];
    for_each_wall_texel(&scene, &layout, |triangle, index, _| {
        let label = assignment.label[triangle.index()].unwrap();
        assert_eq!(page.source[index], TexelSource::keyframe(100 + label));
        assert_eq!(page.srgb[index][0], [40, 80, 120][label as usize]);
        num_by_frame[label as usize] += 1;
    });
    assert!(
        num_by_frame[..2].iter().all(|&n| n > 300),
        "{num_by_frame:?}"
    );
    // Whatever no triangle owns has neither source nor confidence.
    let num_owned: usize = num_by_frame.iter().sum();
    let is_blank = |i: &usize| page.source[*i] == TexelSource::NONE && page.confidence[*i] == 0;
    let num_blank = (0..page.source.len()).filter(is_blank).count();
    assert_eq!(num_blank, page.source.len() - num_owned);
}

/// Confidence at the wall's texels of a single view, beside pixels per texel and the sine of the
/// angle to the surface, by area and by angle.
fn confidences(position: [f64; 3], yaw_rad: f64, texels_per_m: f64) -> Vec<(u8, f64, f64)> {
    let mut scene = Scene {
        panels: vec![WALL],
        ..Scene::default()
    };
    scene.photograph(position, yaw_rad, &[BACKDROP], true);
    let layout = scene.layout(texels_per_m);
    let (_, page, _) = paint(
        &scene,
        &layout,
        &AssignParams::paper(),
        &TransferParams::default(),
    );
    let mesh = scene.mesh();
    let camera_from_world = scene.poses[0].world_from_camera.inverse();
    let mut found = vec![];
    for_each_wall_texel(&scene, &layout, |triangle, index, _| {
        match page.source[index] {
            TexelSource::NONE => assert_eq!(page.confidence[index], 0),
            TexelSource::MEAN => assert_eq!(page.confidence[index], MEAN_CONFIDENCE),
            source => assert_eq!(source, TexelSource::keyframe(100)),
        }
        if page.source[index].as_keyframe().is_none() {
            return;
        }
        let corners = mesh.corners_m(triangle);
        let [a, b, c] = corners.map(|corner| {
            let p = camera_from_world.transform_point(&corner);
            [150.0 * p.x / p.z, 150.0 * p.y / p.z]
        });
        let area_px2 = 0.5 * ((b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])).abs();
        let area_texel2 = mesh.area_m2(triangle) * texels_per_m * texels_per_m;
        let center = (corners[0].coords + corners[1].coords + corners[2].coords) / 3.0;
        let ray = center - nalgebra::Vector3::from(position);
        // The wall's normal is the z axis.
        found.push((
            page.confidence[index],
            (area_px2 / area_texel2).sqrt(),
            ray.z / ray.norm(),
        ));
    });
    found
}

#[test]
fn confidence_is_resolution_times_the_sine_of_the_view() {
    let views = [
        ([0.0, 0.0, 0.0], 0.0),
        ([-1.5, 0.0, 0.3], 0.5),
        ([1.8, 0.2, 1.2], -0.75),
    ];
    for (position, yaw_rad) in views {
        for texels_per_m in [12.0, 40.0, 100.0] {
            let found = confidences(position, yaw_rad, texels_per_m);
            assert!(found.len() > 150, "{}", found.len());
            for (confidence, pixels_per_texel, sine) in found {
                let expected = 255.0 * pixels_per_texel.min(1.0) * sine;
                // The triangles are small, yet not points.
                assert!(
                    (f64::from(confidence) - expected).abs() < 2.0 + 0.02 * expected,
                    "{confidence} for {expected}"
                );
            }
        }
    }
}

#[test]
fn confidence_falls_with_obliqueness_and_with_distance() {
    let mean = |position, yaw_rad, texels_per_m| {
        let found = confidences(position, yaw_rad, texels_per_m);
        found.iter().map(|(c, _, _)| f64::from(*c)).sum::<f64>() / found.len() as f64
    };
    // Pixels to spare: only the angle counts.
    let by_angle = [
        ([0.0, 0.0, 0.5], 0.0),
        ([-1.5, 0.0, 0.8], 0.5),
        ([-2.4, 0.0, 1.4], 0.9),
    ]
    .map(|(position, yaw_rad)| mean(position, yaw_rad, 12.0));
    assert!(
        by_angle[0] > 235.0 && by_angle.is_sorted_by(|a, b| a > &(b + 20.0)),
        "{by_angle:?}"
    );
    // Head-on: only the resolution counts, in inverse proportion to distance.
    let by_distance = [2.0, 4.0, 8.0].map(|d| mean([0.0, 0.0, 3.0 - d], 0.0, 100.0));
    for pair in by_distance.windows(2) {
        assert!((pair[0] / pair[1] - 2.0).abs() < 0.25, "{by_distance:?}");
    }
}
