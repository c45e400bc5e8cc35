//! Looking at scenes (run with `--ignored`) and properties of recordings.

use super::*;

fn film<'a>(scene: &'a Scene, options: &'a SynthOptions, num_frames: u32) -> Film<'a> {
    let duration_s = f64::from(num_frames - 1) / options.fps;
    Film {
        path: HandHeldPath::new(&scene.waypoints_m, duration_s, options.seed),
        scene,
        camera: options.camera().unwrap(),
        options,
    }
}

#[test]
#[ignore = "writes pictures for a person to look at, into the folder SYNTH_LOOK"]
#[expect(
    clippy::disallowed_methods,
    clippy::print_stderr,
    reason = "a tool, not a test"
)]
fn look() {
    let folder = std::path::PathBuf::from(std::env::var("SYNTH_LOOK").unwrap());
    for name in SceneName::ALL {
        let start = std::time::Instant::now();
        let scene = name.build(1);
        eprintln!(
            "{name}: {} surfaces, built in {:?}",
            scene.surfaces.len(),
            start.elapsed()
        );
        let options = SynthOptions {
            color: SynthColorFormat::Png,
            ..SynthOptions::default()
        };
        let num_frames = name.default_num_frames();
        let film = film(&scene, &options, num_frames);
        let start = std::time::Instant::now();
        let mesh = tessellate::scene_mesh(&scene, scene.edge_m, &options.noise, 1).unwrap();
        eprintln!(
            "{} triangles, {} vertices in {:?}",
            mesh.num_triangles(),
            mesh.num_vertices(),
            start.elapsed()
        );
        for index in (0..num_frames).step_by(num_frames as usize / 20) {
            let start = std::time::Instant::now();
            let frame = film.frame(index).unwrap();
            let elapsed = start.elapsed();
            let nearest = frame
                .true_depth_m
                .iter()
                .copied()
                .fold(f32::INFINITY, f32::min);
            eprintln!("{name} {index}: {elapsed:?}, nearest {nearest} m");
            std::fs::write(
                folder.join(format!("{name}_{index:03}.png")),
                frame.color.bytes(),
            )
            .unwrap();
        }
    }
}

#[test]
#[ignore = "measures; run optimised"]
#[expect(clippy::print_stderr, reason = "a tool, not a test")]
fn speed() {
    for name in SceneName::ALL {
        let start = std::time::Instant::now();
        let scene = name.build(1);
        eprintln!(
            "{name}: {} surfaces, built in {:?}",
            scene.surfaces.len(),
            start.elapsed()
        );
        let options = SynthOptions::default();
        let num_frames = name.default_num_frames();
        let film = film(&scene, &options, num_frames);
        let start = std::time::Instant::now();
        let num = 20;
        for k in 0..num {
            let pose = film
                .path
                .world_from_camera(film.time_s(k * num_frames / num));
            let image = film.expose(&pose, 0.0);
            assert!(image.depth_m.iter().all(|&depth| depth > 0.0));
        }
        eprintln!("cast alone {:?} a frame", start.elapsed() / num);
        let start = std::time::Instant::now();
        let frames: Vec<_> = (0..num)
            .into_par_iter()
            .map(|k| film.frame(k * num_frames / num).unwrap())
            .collect();
        let num_bytes: usize = frames.iter().map(|f| f.color.bytes().len()).sum();
        let num_depth_bytes: usize = frames.iter().map(|f| f.depth.bytes().len()).sum();
        eprintln!(
            "{:?} a frame, {} + {} bytes a frame",
            start.elapsed() / num,
            num_bytes / 20,
            num_depth_bytes / 20
        );
    }
}
