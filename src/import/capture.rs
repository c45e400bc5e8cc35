//! The capture layout: `cameras.json`, `intrinsics.json`, `meta.json`, `frames/NNNNNN.{jpg,png}`.
//!
//! `cameras.json` lists frames with `id`, `timestamp_s` and `c2w` (row-major, optical axes,
//! metres); intrinsics are per frame there, or one for all in `intrinsics.json`. Depth is 16-bit
//! millimetres; `NNNNNN.conf.png` is ARKit's confidence. With `refined`, the colour camera is
//! `color_intrinsics_refined`, the depth is multiplied by `refined.depth_scale` of `meta.json` and
//! the depth camera is the colour camera at the depth's size; the mesh made with these is
//! `mesh_tsdf_refined.ply`.

use std::path::Path;

use serde::Deserialize;

use crate::geom::{Distortion, RigidTransform, Stamp};

use super::scan::{Intrinsics, Scan, ScanDepth, ScanFrame, read_json};
use super::{ImportError, ImportOptions};

#[derive(Deserialize)]
struct CaptureFrame {
    id: u32,
    timestamp_s: f64,
    c2w: [[f64; 4]; 4],
    color_intrinsics: Option<[f64; 4]>,
    depth_intrinsics: Option<[f64; 4]>,
    color_intrinsics_refined: Option<[f64; 4]>,
}

#[derive(Deserialize)]
struct CaptureCamera {
    fx: f64,
    fy: f64,
    cx: f64,
    cy: f64,
    width: u32,
    height: u32,
}

#[derive(Deserialize)]
struct CaptureCameras {
    color: CaptureCamera,
    depth: CaptureCamera,
    distortion: Option<String>,
}

#[derive(Deserialize, Default)]
struct CaptureMeta {
    refined: Option<CaptureRefinement>,
}

#[derive(Deserialize)]
struct CaptureRefinement {
    depth_scale: Option<f64>,
}

impl CaptureCamera {
    /// These intrinsics, or a frame's own, for images of this camera's size.
    fn intrinsics(&self, of_frame_px: Option<[f64; 4]>) -> Intrinsics {
        Intrinsics {
            intrinsics_px: of_frame_px.unwrap_or([self.fx, self.fy, self.cx, self.cy]),
            size_px: Some([self.width, self.height]),
            distortion: Distortion::None,
        }
    }
}

/// How to read the frames, beside what each says of itself.
struct CaptureLayout<'a> {
    folder: &'a Path,
    cameras: CaptureCameras,
    /// Scale of the depth, when the refined calibration is asked for.
    refined_depth_scale: Option<f64>,
}

impl CaptureLayout<'_> {
    fn frame(&self, entry: serde_json::Value) -> Result<ScanFrame, String> {
        let frame: CaptureFrame =
            serde_json::from_value(entry).map_err(|error| error.to_string())?;
        if !frame.timestamp_s.is_finite() {
            return Err(format!("timestamp_s is {}", frame.timestamp_s));
        }
        let color_px = match self.refined_depth_scale {
            Some(_) => Some(
                frame
                    .color_intrinsics_refined
                    .ok_or("there are no color_intrinsics_refined")?,
            ),
            None => frame.color_intrinsics,
        };
        let stamp = Stamp::from_seconds(frame.timestamp_s);
        let frames = self.folder.join("frames");
        let depth_path = frames.join(format!("{:06}.png", frame.id));
        let confidence_path = frames.join(format!("{:06}.conf.png", frame.id));
        let depth = depth_path.is_file().then(|| ScanDepth {
            stamp,
            path: depth_path,
            intrinsics: match self.refined_depth_scale {
                Some(_) => None,
                None => Some(self.cameras.depth.intrinsics(frame.depth_intrinsics)),
            },
            confidence: confidence_path.is_file().then_some(confidence_path),
            mm_per_count: self.refined_depth_scale.unwrap_or(1.0),
            invalid_count: None,
        });
        Ok(ScanFrame {
            stamp,
            world_from_camera: RigidTransform::try_from_matrix(&frame.c2w)
                .map_err(|error| error.to_string())?,
            color: frames.join(format!("{:06}.jpg", frame.id)),
            color_intrinsics: self.cameras.color.intrinsics(color_px),
            depth,
        })
    }
}

fn refined_depth_scale(folder: &Path) -> Result<f64, ImportError> {
    let path = folder.join("meta.json");
    let meta: CaptureMeta = read_json(&path)?;
    let scale = meta
        .refined
        .and_then(|refined| refined.depth_scale)
        .unwrap_or(1.0);
    if (0.5..=2.0).contains(&scale) {
        Ok(scale)
    } else {
        Err(ImportError::Malformed {
            path,
            reason: format!("refined.depth_scale is {scale}, not within 0.5..=2"),
        })
    }
}

pub(super) fn list(folder: &Path, options: &ImportOptions) -> Result<Scan, ImportError> {
    let intrinsics_path = folder.join("intrinsics.json");
    let cameras: CaptureCameras = read_json(&intrinsics_path)?;
    if let Some(distortion) = &cameras.distortion
        && !distortion.starts_with("none")
    {
        return Err(ImportError::Malformed {
            path: intrinsics_path,
            reason: format!("the distortion '{distortion}' is not one that is understood"),
        });
    }
    let layout = CaptureLayout {
        folder,
        cameras,
        refined_depth_scale: match options.refined {
            true => Some(refined_depth_scale(folder)?),
            false => None,
        },
    };
    let entries: Vec<serde_json::Value> = read_json(&folder.join("cameras.json"))?;
    let mut scan = Scan::default();
    for (index, entry) in entries.into_iter().enumerate() {
        match layout.frame(entry) {
            Ok(frame) => scan.frames.push(frame),
            Err(reason) => scan
                .refusals
                .push(format!("cameras.json, frame {index}: {reason}")),
        }
    }
    let default_mesh = if options.refined {
        "mesh_tsdf_refined.ply"
    } else {
        "mesh.ply"
    };
    scan.choose_mesh(folder, options.mesh.as_deref(), &[default_mesh])?;
    scan.sort_by_time();
    scan.rebase_relative_clock();
    Ok(scan)
}
