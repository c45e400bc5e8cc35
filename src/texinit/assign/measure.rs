//! Timings and pictures on real captures: `cargo test --release --lib measure -- --ignored
//! --nocapture`. Pictures go to `target/pictures`.

#![expect(
    clippy::cast_possible_truncation,
    reason = "the numbers of a test are small"
)]
use super::capture::Capture;
use super::*;
use crate::geom::ColorImage;
use crate::mesh::TriangleId;
use crate::render::{NO_TRIANGLE, RasterWorkspace, ViewBuffer, rasterize};
use std::time::Instant;

struct Quality {
    psnr_db: f64,
    ssim: f64,
    grad: f64,
    coverage: f64,
}

/// Each pixel of a held-out view takes its colour from the frame that paints its triangle.
fn project(
    capture: &Capture,
    frames: &[Arc<DecodedFrame>],
    assignment: &Assignment,
    held_out: &Capture,
    view_index: usize,
) -> (ColorImage, Vec<bool>) {
    let camera = held_out.cameras[view_index][0];
    let camera = camera.resized(640, 480).unwrap();
    let world_from_camera = held_out.poses[view_index].world_from_camera;
    let mut view = ViewBuffer::default();
    rasterize(
        &capture.mesh,
        &camera,
        &world_from_camera.inverse(),
        &mut RasterWorkspace::default(),
        &mut view,
    );
    let mut mask = vec![];
    let mut pixels = vec![];
    for (index, &id) in view.triangle.iter().enumerate() {
        let color = (|| {
            if id == NO_TRIANGLE {
                return None;
            }
            let frame = assignment.label[TriangleId(id).index()]? as usize;
            let (x, y) = ((index % 640) as f64, (index / 640) as f64);
            let point = camera.unproject([x, y], f64::from(view.depth_m[index]));
            let point = world_from_camera.transform_point(&point);
            let point = capture.poses[frame]
                .world_from_camera
                .inverse()
                .transform_point(&point);
            let px = capture.cameras[frame][0].project(&point)?;
            Some(
                frames[frame]
                    .color
                    .sample_bilinear(px.map(|v| v as f32))
                    .map(|v| v.round() as u8),
            )
        })();
        mask.push(color.is_some());
        pixels.push(color.unwrap_or_default());
    }
    (ColorImage::new(640, 480, pixels).unwrap(), mask)
}

fn shrink(image: &ColorImage) -> ColorImage {
    let step = image.width() / 640;
    let pixels = (0..480 * 640u32)
        .map(|i| {
            let (x, y) = (i % 640 * step, i / 640 * step);
            std::array::from_fn(|c| {
                let mut sum = 0u32;
                for dy in 0..step {
                    for dx in 0..step {
                        sum += u32::from(image.pixel_clamped(x + dx, y + dy)[c]);
                    }
                }
                (sum / (step * step)) as u8
            })
        })
        .collect();
    ColorImage::new(640, 480, pixels).unwrap()
}

fn compare(photo: &ColorImage, render: &ColorImage, mask: &[bool]) -> Quality {
    let mut error = 0.0;
    let mut num = 0.0;
    for ((p, r), _) in photo
        .pixels()
        .iter()
        .zip(render.pixels())
        .zip(mask)
        .filter(|(_, m)| **m)
    {
        for c in 0..3 {
            error += (f64::from(p[c]) - f64::from(r[c])).powi(2);
        }
        num += 3.0;
    }
    let luma = |image: &ColorImage| -> Vec<f64> {
        image
            .pixels()
            .iter()
            .map(|p| 0.299 * f64::from(p[0]) + 0.587 * f64::from(p[1]) + 0.114 * f64::from(p[2]))
            .collect()
    };
    let (a, b) = (luma(photo), luma(render));
    let (mut ssim, mut windows) = (0.0, 0.0);
    for y in (0..472).step_by(4) {
        for x in (0..632).step_by(4) {
            let cells: Vec<usize> = (0..64).map(|i| (y + i / 8) * 640 + x + i % 8).collect();
            if !cells.iter().all(|&i| mask[i]) {
                continue;
            }
            let mean = |v: &[f64]| cells.iter().map(|&i| v[i]).sum::<f64>() / 64.0;
            let (ma, mb) = (mean(&a), mean(&b));
            let cov = |u: &[f64], mu: f64, v: &[f64], mv: f64| {
                cells
                    .iter()
                    .map(|&i| (u[i] - mu) * (v[i] - mv))
                    .sum::<f64>()
                    / 63.0
            };
            let (va, vb, vab) = (
                cov(&a, ma, &a, ma),
                cov(&b, mb, &b, mb),
                cov(&a, ma, &b, mb),
            );
            let (c1, c2) = (6.5025, 58.5225);
            ssim += (2.0 * ma * mb + c1) * (2.0 * vab + c2)
                / ((ma * ma + mb * mb + c1) * (va + vb + c2));
            windows += 1.0;
        }
    }
    let (mut grad, mut pixels) = (0.0, 0.0);
    for i in (0..640 * 479).filter(|&i| i % 640 != 639 && mask[i] && mask[i + 1] && mask[i + 640]) {
        let norm = |v: &[f64]| (v[i + 1] - v[i]).hypot(v[i + 640] - v[i]);
        grad += (norm(&a) - norm(&b)).abs();
        pixels += 1.0;
    }
    Quality {
        grad: grad / pixels,
        psnr_db: 10.0 * (255.0f64 * 255.0 * num / error).log10(),
        ssim: ssim / windows,
        coverage: num / 3.0 / (640.0 * 480.0),
    }
}

fn save(name: &str, image: &ColorImage) {
    let folder = concat!(env!("CARGO_MANIFEST_DIR"), "/target/pictures");
    std::fs::create_dir_all(folder).unwrap();
    let bytes: Vec<u8> = image.pixels().iter().flatten().copied().collect();
    image::save_buffer(
        format!("{folder}/{name}.png"),
        &bytes,
        image.width(),
        image.height(),
        image::ColorType::Rgb8,
    )
    .unwrap();
}

#[expect(clippy::print_stdout, reason = "a measurement is there to be read")]
fn run(name: &str, mesh: &str) {
    let Some(capture) = Capture::load(name, mesh, |i| i % 10 != 5) else {
        return;
    };
    let held_out = Capture::load(name, mesh, |i| i % 10 == 5).unwrap();
    let frames: Vec<_> = (0..capture.poses.len())
        .map(|i| capture.decode(i).unwrap())
        .collect();
    let photos: Vec<_> = (0..held_out.poses.len())
        .map(|i| shrink(&held_out.decode(i).unwrap().color))
        .collect();
    let base = AssignParams::default();
    let pair = |weight| {
        Some(PairwiseParams {
            weight,
            ..PairwiseParams::default()
        })
    };
    let colored = |color_weight, weight, resolution_weight| AssignParams {
        color_weight,
        resolution_weight,
        pairwise: pair(weight),
        ..base.clone()
    };
    let variants = [
        ("paper", AssignParams::paper()),
        (
            "paper+C4=1",
            AssignParams {
                pairwise: pair(1.0),
                ..AssignParams::paper()
            },
        ),
        ("default", base.clone()),
        (
            "unary",
            AssignParams {
                pairwise: None,
                ..base.clone()
            },
        ),
        (
            "pair .5",
            AssignParams {
                pairwise: pair(0.5),
                ..base.clone()
            },
        ),
        (
            "pair 2",
            AssignParams {
                pairwise: pair(2.0),
                ..base.clone()
            },
        ),
        (
            "no quality",
            AssignParams {
                sharpness_weight: 0.0,
                exposure_weight: 0.0,
                ..base.clone()
            },
        ),
        (
            "quality x3",
            AssignParams {
                sharpness_weight: 0.6,
                exposure_weight: 3.0,
                ..base.clone()
            },
        ),
        (
            "no edge",
            AssignParams {
                depth_edge_penalty: 0.0,
                ..base.clone()
            },
        ),
        (
            "no visibility",
            AssignParams {
                visibility: None,
                ..base.clone()
            },
        ),
        ("-1 .5 0", colored(-1.0, 0.5, 0.0)),
        ("-1 .5 1", colored(-1.0, 0.5, 1.0)),
        ("-4 .5 .3", colored(-4.0, 0.5, 0.3)),
        ("-4 .5 1", colored(-4.0, 0.5, 1.0)),
        ("-10 .5 .3", colored(-10.0, 0.5, 0.3)),
        ("-10 1 1", colored(-10.0, 1.0, 1.0)),
        (
            "depth -3 -4 .5",
            AssignParams {
                depth_weight: -3.0,
                ..colored(-4.0, 0.5, 0.3)
            },
        ),
    ];
    for (variant, params) in variants {
        let start = Instant::now();
        let assignment = assign_poses(
            &capture.mesh,
            &capture.poses,
            &|i| Ok(frames[i].clone()),
            &params,
            &|_| (),
        )
        .unwrap();
        let seconds = start.elapsed().as_secs_f64();
        let mut sums = [0.0; 4];
        for view in 0..photos.len() {
            let (render, mask) = project(&capture, &frames, &assignment, &held_out, view);
            let q = compare(&photos[view], &render, &mask);
            for (sum, value) in sums.iter_mut().zip([q.psnr_db, q.ssim, q.coverage, q.grad]) {
                *sum += value / photos.len() as f64;
            }
            if view % 7 == 2 {
                save(&format!("{name}-{view}-{variant}"), &render);
                save(&format!("{name}-{view}-photo"), &photos[view]);
            }
        }
        let report = &assignment.report;
        println!(
            "{variant:14} {seconds:5.2} s  PSNR {:.3}  SSIM {:.4}  coverage {:.4}  grad {:.3}  labelled {}  used {}  candidates {}  seams {} -> {} of {}",
            sums[0],
            sums[1],
            sums[2],
            sums[3],
            report.num_labelled,
            report.num_frames_used,
            report.num_candidates,
            report.num_seams_unary,
            report.num_seams,
            report.num_inner_edges
        );
    }
}

#[test]
#[ignore = "a measurement"]
fn apt0() {
    run("apt0_structure", "mesh.ply");
}

/// Charts to pictures, as a run does it.
#[expect(clippy::print_stdout, reason = "a measurement is there to be read")]
fn bake(name: &str, mesh: &str) {
    use crate::atlas::{gutter::dilate_gutters, pack};
    use crate::render::{RenderParams, render_textured};
    use crate::texinit::transfer::{TransferMode, TransferParams, transfer_poses};
    use crate::texinit::{fill, flatten, overlap};

    let Some(capture) = Capture::load(name, mesh, |i| i % 10 != 5) else {
        return;
    };
    let held_out = Capture::load(name, mesh, |i| i % 10 == 5).unwrap();
    let decode = |frame| capture.decode(frame);
    let mut start = Instant::now();
    let mut lap = |what: &str| {
        println!("{what}: {:.2} s", start.elapsed().as_secs_f64());
        start = Instant::now();
    };
    let flat = flatten::flatten(&capture.mesh, &flatten::FlattenParams::default()).unwrap();
    let (charts, _) = overlap::separate(
        &capture.mesh,
        flat.charts,
        &overlap::OverlapParams::default(),
    );
    lap("flatten and separate");
    let assignment = assign_poses(
        &capture.mesh,
        &capture.poses,
        &decode,
        &AssignParams::default(),
        &|_| (),
    )
    .unwrap();
    println!("{:?}", assignment.report);
    lap("assign");
    let mut densities: Vec<f32> = assignment
        .best_texels_per_m
        .iter()
        .copied()
        .filter(|d| *d > 0.0)
        .collect();
    densities.sort_by(f32::total_cmp);
    let wanted = f64::from(densities[densities.len() / 2]);
    let packing = pack::PackParams::default();
    let (layout, packed) =
        pack::pack_to_budget(&charts, capture.mesh.num_triangles(), wanted, &packing).unwrap();
    let density = layout.texels_per_m;
    println!(
        "{wanted:.0} texels/m wanted, {density:.0} taken; {} pages of {:?}; {packed:?}",
        layout.num_pages, layout.page_size_texel
    );
    lap("pack");
    for mode in [TransferMode::Assigned, TransferMode::L2Avg] {
        let params = TransferParams {
            mode,
            ..TransferParams::default()
        };
        let (mut texture, report) = transfer_poses(
            &capture.mesh,
            &layout,
            &assignment,
            &capture.poses,
            &decode,
            &params,
            &|_| (),
        )
        .unwrap();
        println!("{report:?}");
        lap("transfer");
        fill::fill_unseen(
            &capture.mesh,
            &layout,
            &mut texture,
            &fill::FillParams::default(),
        )
        .unwrap();
        dilate_gutters(&layout, &mut texture).unwrap();
        lap("fill and gutter");
        let mut sums = [0.0; 4];
        for view in 0..held_out.poses.len() {
            let photo = shrink(&held_out.decode(view).unwrap().color);
            let camera = held_out.cameras[view][0].resized(640, 480).unwrap();
            let pose = held_out.poses[view].world_from_camera.inverse();
            let rendered = render_textured(
                &capture.mesh,
                &layout,
                &texture,
                &camera,
                &pose,
                &RenderParams::default(),
            )
            .unwrap();
            let q = compare(&photo, &rendered.color, &rendered.mask);
            for (sum, value) in sums.iter_mut().zip([q.psnr_db, q.ssim, q.coverage, q.grad]) {
                *sum += value / held_out.poses.len() as f64;
            }
            if view % 7 == 2 {
                save(&format!("{name}-{view}-bake-{mode:?}"), &rendered.color);
                save(&format!("{name}-{view}-photo"), &photo);
            }
        }
        println!("{mode:?}: PSNR, SSIM, coverage, grad {sums:?}");
        lap("render");
    }
}

#[test]
#[ignore = "a measurement"]
fn bake_apt0() {
    bake("apt0_structure", "mesh.ply");
}

#[test]
#[ignore = "a measurement"]
fn bake_charuco() {
    bake("charuco_lidar", "mesh_tsdf_refined.ply");
}

/// Assignment with decoding, as a run does it; `perf` and `time` say where the time goes.
#[test]
#[ignore = "a measurement"]
#[expect(clippy::print_stdout, reason = "a measurement is there to be read")]
fn apt0_alone() {
    let Some(capture) = Capture::load("apt0_structure", "mesh.ply", |_| true) else {
        return;
    };
    let start = Instant::now();
    let decode = |frame| capture.decode(frame);
    let params = AssignParams::default();
    let assignment =
        assign_poses(&capture.mesh, &capture.poses, &decode, &params, &|_| ()).unwrap();
    let mut workspace = RasterWorkspace::default();
    let mut view = ViewBuffer::default();
    let raster_start = Instant::now();
    for (pose, cameras) in capture.poses.iter().zip(&capture.cameras) {
        let pose = pose.world_from_camera.inverse();
        rasterize(&capture.mesh, &cameras[0], &pose, &mut workspace, &mut view);
    }
    let raster_s = raster_start.elapsed().as_secs_f64();
    println!(
        "raster alone: {:.2} ms a frame",
        1e3 * raster_s / capture.poses.len() as f64
    );
    println!(
        "{:.2} s {:?}",
        start.elapsed().as_secs_f64(),
        assignment.report
    );
}

#[test]
#[ignore = "a measurement"]
fn charuco() {
    run("charuco_lidar", "mesh_tsdf_refined.ply");
}
