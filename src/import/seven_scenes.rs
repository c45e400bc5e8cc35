//! 7-Scenes (Shotton et al., CVPR 2013): one sequence folder of
//! `frame-NNNNNN.{color.png,depth.png,pose.txt}`.
//!
//! Poses are camera-to-world 4×4 matrices of the optical frame in metres; depth is in millimetres
//! with 65535 for no measurement. The authors give one approximate camera for colour and depth
//! alike, which are not registered to each other: 585, 585, 320, 240 at 640×480. There are no
//! stamps: frames are taken as 30 a second by their number.

use std::path::Path;

use crate::geom::{Distortion, RigidTransform, Stamp};

use super::scan::{Intrinsics, Scan, ScanDepth, ScanFrame, file_names, number_in_name, read_text};
use super::{ImportError, ImportOptions};

const FRAMES_PER_S: i64 = 30;

/// The camera of the data set's page, for images of 640×480.
const CAMERA: Intrinsics = Intrinsics {
    intrinsics_px: [585.0, 585.0, 320.0, 240.0],
    size_px: Some([640, 480]),
    distortion: Distortion::None,
};

fn read_pose(path: &Path) -> Result<RigidTransform, String> {
    let text = read_text(path).map_err(|error| error.to_string())?;
    let values: Vec<f64> = text
        .split_ascii_whitespace()
        .map(|word| word.parse().map_err(|_| format!("'{word}' is no number")))
        .collect::<Result<_, _>>()?;
    let (rows, rest) = values.as_chunks::<4>();
    let rows: &[[f64; 4]; 4] = rows
        .try_into()
        .ok()
        .filter(|_| rest.is_empty())
        .ok_or_else(|| format!("a pose has 16 numbers, not {}", values.len()))?;
    RigidTransform::try_from_matrix(rows).map_err(|error| error.to_string())
}

pub(super) fn list(folder: &Path, options: &ImportOptions) -> Result<Scan, ImportError> {
    let mut scan = Scan::default();
    let intrinsics = options.intrinsics_px.map_or(CAMERA, Intrinsics::pinhole);
    let names = file_names(folder)?;
    let is_scene = |name: &String| name.starts_with("seq-") && folder.join(name).is_dir();
    if let Some(sequence) = names.iter().find(|name| is_scene(name)) {
        return Err(ImportError::Malformed {
            path: folder.to_owned(),
            reason: format!("this is a scene; name one of its sequences, such as {sequence}"),
        });
    }
    for name in names {
        let Some(number) = number_in_name(&name, "frame-", ".color.png") else {
            continue;
        };
        let stem = name.trim_end_matches(".color.png");
        let world_from_camera = match read_pose(&folder.join(format!("{stem}.pose.txt"))) {
            Ok(pose) => pose,
            Err(reason) => {
                scan.refusals.push(format!("{stem}.pose.txt: {reason}"));
                continue;
            }
        };
        let stamp = Stamp::from_nanos(i64::from(number) * 1_000_000_000 / FRAMES_PER_S);
        let depth_path = folder.join(format!("{stem}.depth.png"));
        scan.frames.push(ScanFrame {
            stamp,
            world_from_camera,
            color: folder.join(&name),
            color_intrinsics: intrinsics,
            depth: depth_path.is_file().then_some(ScanDepth {
                stamp,
                path: depth_path,
                intrinsics: Some(intrinsics),
                confidence: None,
                mm_per_count: 1.0,
                invalid_count: Some(u16::MAX),
            }),
        });
    }
    scan.notes.push(format!(
        "7-Scenes has no stamps: frames are {FRAMES_PER_S} a second; its depth is not registered to its colour"
    ));
    scan.choose_mesh(folder, options.mesh.as_deref(), &["mesh.ply", "mesh.obj"])?;
    scan.sort_by_time();
    scan.rebase_relative_clock();
    Ok(scan)
}
