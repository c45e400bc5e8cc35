//! Sensor, path, mesh, truth and score held against each other.

use std::sync::LazyLock;

use nalgebra::Point3;

use super::*;
use crate::synth::{SynthNoise, score};

static ROOM: LazyLock<GroundTruth> = LazyLock::new(|| GroundTruth::new(SceneName::Room, 1));
static TABLETOP: LazyLock<GroundTruth> = LazyLock::new(|| GroundTruth::new(SceneName::Tabletop, 1));

fn truth_of(name: SceneName) -> &'static GroundTruth {
    match name {
        SceneName::Room => &ROOM,
        SceneName::Tabletop => &TABLETOP,
    }
}

fn small() -> SynthOptions {
    SynthOptions {
        width: 160,
        height: 120,
        color: SynthColorFormat::Png,
        ..SynthOptions::default()
    }
}

/// Every fault at once.
fn faulty() -> SynthOptions {
    SynthOptions {
        width: 80,
        height: 60,
        num_frames: Some(5),
        mesh_edge_m: Some(0.05),
        grow: 3,
        color: SynthColorFormat::Jpeg(80),
        noise: SynthNoise::realistic(),
        ..SynthOptions::default()
    }
}

fn record_to_bytes(options: &SynthOptions) -> (Vec<u8>, SynthSummary) {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("bag.mcap");
    let mut calls = Vec::new();
    let summary = record(
        SceneName::Tabletop,
        TABLETOP.clone(),
        options,
        &path,
        &mut |done, all| calls.push((done, all)),
    )
    .unwrap();
    let all = u64::from(summary.num_frames);
    assert_eq!(calls, (1..=all).map(|done| (done, all)).collect::<Vec<_>>());
    (std::fs::read(path).unwrap(), summary)
}

#[test]
fn same_seed_same_bytes_for_any_number_of_threads() {
    let options = faulty();
    let in_pool = |num_threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new()
            .num_threads(num_threads)
            .build()
            .unwrap();
        pool.install(|| record_to_bytes(&options))
    };
    let (bytes, summary) = in_pool(1);
    assert_eq!(summary.num_mesh_messages, 3);
    assert_eq!(summary.bag.num_bytes, bytes.len() as u64);
    assert!(in_pool(2).0 == bytes, "two threads");
    assert!(in_pool(4).0 == bytes, "four threads");
    let other = SynthOptions { seed: 2, ..options };
    assert!(
        record_to_bytes(&other).0 != bytes,
        "another seed, other faults"
    );
}

#[test]
fn light_is_the_same_for_any_number_of_threads() {
    let in_pool = |num_threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new()
            .num_threads(num_threads)
            .build()
            .unwrap();
        pool.install(|| GroundTruth::new(SceneName::Tabletop, 1))
    };
    let (one, three) = (in_pool(1), in_pool(3));
    for (point, normal) in one.sample_points(500, 4) {
        assert_eq!(
            one.true_srgb(&point, &normal, 0.002),
            three.true_srgb(&point, &normal, 0.002)
        );
    }
}

#[test]
fn without_noise_everything_is_exact() {
    for name in SceneName::ALL {
        let truth = truth_of(name);
        let options = small();
        let num_frames = name.default_num_frames();
        let film = Film::new(&truth.scene, &options, num_frames).unwrap();
        for index in (0..num_frames).step_by(17) {
            let frame = film.frame(index).unwrap();
            assert_eq!(frame.published_pose, frame.true_pose);
            let depth = frame.depth.decode().unwrap();
            for (read, exact) in depth.depths_m().iter().zip(&frame.true_depth_m) {
                assert!((read - exact).abs() < 0.000_51, "{read} m is not {exact} m");
            }
        }
    }
}

#[test]
fn unprojected_depth_lies_on_a_surface() {
    for name in SceneName::ALL {
        let truth = truth_of(name);
        let options = small();
        let num_frames = name.default_num_frames();
        let film = Film::new(&truth.scene, &options, num_frames).unwrap();
        for index in (0..num_frames).step_by(23) {
            let frame = film.frame(index).unwrap();
            let depth = frame.depth.decode().unwrap();
            for (at, &depth_m) in depth.depths_m().iter().enumerate().step_by(7) {
                let pixel = [(at % 160) as f64, (at / 160) as f64];
                let point = film.camera.unproject(pixel, f64::from(depth_m));
                let point = frame.true_pose.transform_point(&point);
                let distance_m = truth.scene.surfaces.iter().map(|s| s.distance_to(&point));
                let nearest_m = distance_m.fold(f64::INFINITY, f64::min);
                assert!(
                    nearest_m < 1e-3,
                    "{name} frame {index} pixel {pixel:?}: {nearest_m} m off"
                );
            }
        }
    }
}

/// The tiled caster against the hierarchy, which shares only the primitives' intersection.
#[test]
fn depth_is_the_nearest_hit_of_the_ray() {
    for name in SceneName::ALL {
        let scene = &truth_of(name).scene;
        let bvh = crate::synth::bvh::Bvh::new(&scene.surfaces);
        let options = small();
        let num_frames = name.default_num_frames();
        let film = Film::new(scene, &options, num_frames).unwrap();
        for index in (0..num_frames).step_by(11) {
            let pose = film.path.world_from_camera(film.time_s(index));
            let image = film.expose(&pose, 0.0);
            let eye = Point3::from(*pose.translation());
            for (at, &depth_m) in image.depth_m.iter().enumerate().step_by(13) {
                let ray = film.camera.ray((at % 160) as f64, (at / 160) as f64);
                let direction = pose.transform_vector(&ray);
                let (_, hit) = bvh.nearest_hit(&eye, &direction, [0.02, 1e3]).unwrap();
                assert!(
                    (hit.t - f64::from(depth_m)).abs() < 1e-5,
                    "{name} {index} {at}"
                );
            }
        }
    }
}

/// The hand never enters a body, nor comes nearer than depth sensors see.
#[test]
fn the_path_keeps_its_distance() {
    for name in SceneName::ALL {
        let options = SynthOptions {
            width: 64,
            height: 48,
            supersampling: 1,
            ..small()
        };
        let num_frames = name.default_num_frames();
        let film = Film::new(&truth_of(name).scene, &options, num_frames).unwrap();
        for index in 0..num_frames {
            let pose = film.path.world_from_camera(film.time_s(index));
            let image = film.expose(&pose, 0.0);
            let nearest_m = image.depth_m.iter().copied().fold(f32::INFINITY, f32::min);
            assert!(nearest_m > 0.28, "{name} frame {index}: {nearest_m} m");
        }
    }
}

/// Pixels that show one surface nearly head-on have the colour that the truth gives there.
#[test]
fn pixels_show_the_true_colour() {
    for name in SceneName::ALL {
        let truth = truth_of(name);
        let options = SynthOptions {
            width: 320,
            height: 240,
            ..small()
        };
        let num_frames = name.default_num_frames();
        let film = Film::new(&truth.scene, &options, num_frames).unwrap();
        let [focal_px, ..] = film.camera.intrinsics_px();
        let mut errors = Vec::new();
        for index in (0..num_frames).step_by(19) {
            let frame = film.frame(index).unwrap();
            let image = frame.color.decode().unwrap();
            let eye = frame.true_pose.translation();
            for at in (0..image.pixels().len()).step_by(5) {
                let depth_m = f64::from(frame.true_depth_m[at]);
                let pixel = [(at % 320) as f64, (at / 320) as f64];
                let point = film.camera.unproject(pixel, depth_m);
                let point = frame.true_pose.transform_point(&point);
                let to_eye = (eye - point.coords).normalize();
                if truth.faces_head_on(&point, &to_eye, 0.8) {
                    let footprint_m = depth_m / focal_px;
                    let expected = truth.true_srgb(&point, &to_eye, footprint_m).unwrap();
                    let seen = image.pixels()[at];
                    let error: f32 = (0..3)
                        .map(|c| (f32::from(seen[c]) - expected[c]).abs())
                        .sum();
                    errors.push(error / 3.0);
                }
            }
        }
        errors.sort_by(f32::total_cmp);
        let mean = errors.iter().sum::<f32>() / errors.len() as f32;
        let median = errors[errors.len() / 2];
        assert!(errors.len() > 5_000, "{name}: {} pixels", errors.len());
        // Rounding alone is 0.25 on average; print under a turned pixel is the rest.
        assert!(
            median < 0.6 && mean < 2.0,
            "{name}: median {median}, mean {mean}"
        );
    }
}

#[test]
fn the_path_shows_nearly_all_of_the_scene() {
    for name in SceneName::ALL {
        let truth = truth_of(name);
        let options = SynthOptions {
            supersampling: 1,
            ..small()
        };
        let num_frames = name.default_num_frames();
        let film = Film::new(&truth.scene, &options, num_frames).unwrap();
        let noise = SynthNoise::default();
        let mesh = tessellate::scene_mesh(&truth.scene, 0.08, &noise, 1).unwrap();
        let mut growth = Growth::new(mesh, 0.5);
        for index in 0..num_frames {
            let pose = film.path.world_from_camera(film.time_s(index));
            let image = film.expose(&pose, 0.0);
            growth.see(&film.camera, &pose, &image.depth_m);
        }
        // Of the table-top, the studio and the table's underside are only a backdrop.
        let is_subject = |p: &Point3<f64>| {
            name == SceneName::Room || (p.z > 0.71 && p.x.abs() < 0.7 && p.y.abs() < 0.5)
        };
        let share = growth.seen_area_share(is_subject);
        assert!(share > 0.8, "{name}: {share} of the area is seen");
    }
}

#[test]
fn the_mesh_lies_on_the_surfaces_and_faces_outwards() {
    for name in SceneName::ALL {
        let truth = truth_of(name);
        let noise = SynthNoise::default();
        let mesh = tessellate::scene_mesh(&truth.scene, 0.05, &noise, 1).unwrap();
        assert!(mesh.num_triangles() > 1_000);
        for position in mesh.positions_m().iter().step_by(7) {
            let distance_m = truth.scene.surfaces.iter().map(|s| s.distance_to(position));
            assert!(distance_m.fold(f64::INFINITY, f64::min) < 1e-9, "{name}");
        }
        for triangle in mesh.triangle_ids() {
            let [a, b, c] = mesh.corners_m(triangle);
            let middle = Point3::from((a.coords + b.coords + c.coords) / 3.0);
            let normal = mesh.scaled_normal(triangle);
            assert!(
                truth.faces_head_on(&middle, &normal.normalize(), 0.9),
                "{name}: {triangle:?}"
            );
        }
    }
}

#[test]
fn faults_of_the_mesh_are_as_asked() {
    let scene = &TABLETOP.scene;
    let clean = tessellate::scene_mesh(scene, 0.05, &SynthNoise::default(), 1).unwrap();
    let mesh = |noise: SynthNoise| tessellate::scene_mesh(scene, 0.05, &noise, 1).unwrap();
    let holed = mesh(SynthNoise {
        missing_faces: 0.2,
        ..SynthNoise::default()
    });
    let kept = holed.num_triangles() as f64 / clean.num_triangles() as f64;
    assert!((kept - 0.8).abs() < 0.03, "{kept}");
    let shaken = mesh(SynthNoise {
        mesh_vertex_m: 0.004,
        ..SynthNoise::default()
    });
    let pairs = clean.positions_m().iter().zip(shaken.positions_m());
    let square = pairs.map(|(a, b)| (a - b).norm_squared()).sum::<f64>();
    let deviation_m = (square / (3.0 * clean.num_vertices() as f64)).sqrt();
    assert!((deviation_m - 0.004).abs() < 2e-4, "{deviation_m}");
    let doubled = mesh(SynthNoise {
        double_walls: 2,
        double_wall_offset_m: 0.04,
        ..SynthNoise::default()
    });
    assert!(doubled.num_triangles() > clean.num_triangles() + 10);
    let ghost = &doubled.positions_m()[clean.num_vertices()..];
    for position in ghost {
        let distance_m = scene.surfaces.iter().map(|s| s.distance_to(position));
        assert!(distance_m.fold(f64::INFINITY, f64::min) > 1e-3);
    }
}

#[test]
fn metadata_rebuilds_the_truth() {
    let options = small();
    let metadata = describe(SceneName::Tabletop, &options, 60);
    let rebuilt = GroundTruth::from_metadata(&metadata).unwrap();
    for (point, normal) in TABLETOP.sample_points(200, 9) {
        assert_eq!(
            rebuilt.true_srgb(&point, &normal, 0.003),
            TABLETOP.true_srgb(&point, &normal, 0.003)
        );
    }
    for (field, value) in [
        ("scene", "garage"),
        ("seed", "minus one"),
        ("scene_version", "0"),
    ] {
        let mut bad = metadata.clone();
        bad.insert(field.to_owned(), value.to_owned());
        let error = GroundTruth::from_metadata(&bad).unwrap_err().to_string();
        assert!(error.contains(value), "{error}");
    }
    assert!(GroundTruth::from_metadata(&BTreeMap::new()).is_err());
    let settings: SynthOptions = serde_json::from_str(&metadata["options"]).unwrap();
    assert_eq!(settings, options);
}

#[test]
fn the_truth_scores_itself_without_error() {
    let (mesh, layout, mut texture) = TABLETOP.atlas(250.0).unwrap();
    let own = score(&mesh, &layout, &texture, &TABLETOP, &[]);
    // Bytes are rounded: 0.25 on average. Facets of round things differ a little.
    assert!(own.mean_abs_error_255 < 0.6, "{own:?}");
    assert!(own.percentiles_255.p50 <= 0.5, "{:?}", own.percentiles_255);
    assert!(own.seen_area_share > 0.98, "{}", own.seen_area_share);
    assert!(own.num_unmatched_texels == 0 && own.num_seen_texels > 100_000);
    for page in &mut texture.pages {
        for srgb in &mut page.to_mut().srgb {
            *srgb = srgb.map(|c| c.saturating_add(10));
        }
    }
    let brighter = score(&mesh, &layout, &texture, &TABLETOP, &[]);
    let gained = brighter.mean_abs_error_255 - own.mean_abs_error_255;
    assert!((8.5..=10.0).contains(&gained), "{gained}");
}

#[test]
fn options_out_of_range_are_named() {
    let bad = [
        (
            SynthOptions {
                supersampling: 0,
                ..small()
            },
            "supersampling",
        ),
        (
            SynthOptions {
                fps: f64::NAN,
                ..small()
            },
            "fps",
        ),
        (
            SynthOptions {
                color: SynthColorFormat::Jpeg(0),
                ..small()
            },
            "JPEG quality",
        ),
        (
            SynthOptions {
                mesh_edge_m: Some(0.0),
                ..small()
            },
            "mesh_edge_m",
        ),
    ];
    for (options, name) in bad {
        let error = synthesize(
            SceneName::Tabletop,
            &options,
            Path::new("/nowhere/x.mcap"),
            &mut |_, _| {},
        );
        assert!(error.unwrap_err().to_string().contains(name));
    }
    assert!("garage".parse::<SceneName>().is_err());
    assert_eq!("room".parse::<SceneName>().unwrap(), SceneName::Room);
}

#[test]
fn faults_of_the_sensor_are_as_asked() {
    let options = SynthOptions {
        noise: SynthNoise {
            depth_quadratic_per_m: 0.004,
            pose_translation_m: 0.01,
            pose_rotation_rad: 0.02,
            image_255: 3.0,
            ..SynthNoise::default()
        },
        ..small()
    };
    let film = Film::new(&TABLETOP.scene, &options, 60).unwrap();
    let clean_options = small();
    let clean_film = Film::new(&TABLETOP.scene, &clean_options, 60).unwrap();
    let (mut depth_square, mut color_square, mut num) = (0.0, 0.0, 0.0);
    let (mut move_square, mut turn_square) = (0.0, 0.0);
    for index in 0..60 {
        let pose = film.path.world_from_camera(film.time_s(index));
        let (turn_rad, move_m) = film.published(&pose, index).distance_to(&pose);
        move_square += move_m * move_m / (3.0 * 60.0);
        turn_square += turn_rad * turn_rad / (3.0 * 60.0);
        if index % 20 == 0 {
            let (noisy, clean) = (film.frame(index).unwrap(), clean_film.frame(index).unwrap());
            let depth = noisy.depth.decode().unwrap();
            for (read, exact) in depth.depths_m().iter().zip(&clean.true_depth_m) {
                let error = f64::from(read - exact) / f64::from(exact * exact);
                depth_square += error * error;
                num += 1.0;
            }
            let (noisy, clean) = (noisy.color.decode().unwrap(), clean.color.decode().unwrap());
            for (a, b) in noisy.pixels().iter().zip(clean.pixels()) {
                let error = f64::from(a[1]) - f64::from(b[1]);
                color_square += error * error;
            }
        }
    }
    let deviation = |square: f64| square.sqrt();
    assert!((deviation(move_square) - 0.01).abs() < 0.0015);
    assert!((deviation(turn_square) - 0.02).abs() < 0.003);
    assert!((deviation(depth_square / num) - 0.004).abs() < 2e-4);
    assert!((deviation(color_square / num) - 3.0).abs() < 0.15);
}
