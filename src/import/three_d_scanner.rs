//! 3D Scanner App (iOS, LiDAR), "all data" export: `frame_NNNNN.{jpg,json}`, `depth_NNNNN.png`,
//! `conf_NNNNN.png`, `export.obj`.
//!
//! The app writes a JSON for every ARKit frame but a photo only now and then; frames without a
//! photo are not imported. `cameraPoseARFrame` is camera-to-world, 16 numbers row-major, metres,
//! with ARKit's camera axes (x right, y up, z backwards; Apple, `ARCamera.transform`), turned here
//! into the optical frame. `intrinsics` are 9 numbers row-major for the photo; `depth` is in
//! millimetres and registered to the photo. The world stays ARKit's (y up), as `export.obj` has it.

use std::path::Path;

use nalgebra::{UnitQuaternion, Vector3};
use serde::Deserialize;

use crate::geom::{RigidTransform, Stamp};

use super::scan::{Intrinsics, Scan, ScanDepth, ScanFrame, file_names, number_in_name, read_json};
use super::{ImportError, ImportOptions};

#[derive(Deserialize)]
#[serde(rename_all = "camelCase")]
struct AppFrame {
    #[serde(rename = "cameraPoseARFrame")]
    camera_pose: [f64; 16],
    intrinsics: [f64; 9],
    time: f64,
}

/// ARKit's camera looks along −z with y up, the optical frame along z with y down: half a turn
/// about x.
fn arkit_from_optical() -> RigidTransform {
    RigidTransform::from_parts(
        UnitQuaternion::from_axis_angle(&Vector3::x_axis(), std::f64::consts::PI),
        Vector3::zeros(),
    )
}

impl AppFrame {
    fn world_from_camera(&self) -> Result<RigidTransform, String> {
        let rows: [[f64; 4]; 4] =
            std::array::from_fn(|r| std::array::from_fn(|c| self.camera_pose[4 * r + c]));
        let world_from_arkit =
            RigidTransform::try_from_matrix(&rows).map_err(|error| error.to_string())?;
        Ok(world_from_arkit * arkit_from_optical())
    }

    fn color_intrinsics(&self) -> Intrinsics {
        let [fx, _, cx, _, fy, cy, ..] = self.intrinsics;
        Intrinsics::pinhole([fx, fy, cx, cy])
    }
}

fn list_frame(folder: &Path, number: &str) -> Result<ScanFrame, String> {
    let app: AppFrame = read_json(&folder.join(format!("frame_{number}.json")))
        .map_err(|error| error.to_string())?;
    if !app.time.is_finite() {
        return Err(format!("time is {}", app.time));
    }
    let stamp = Stamp::from_seconds(app.time);
    let depth_path = folder.join(format!("depth_{number}.png"));
    let confidence_path = folder.join(format!("conf_{number}.png"));
    Ok(ScanFrame {
        stamp,
        world_from_camera: app.world_from_camera()?,
        color: folder.join(format!("frame_{number}.jpg")),
        color_intrinsics: app.color_intrinsics(),
        depth: depth_path.is_file().then(|| ScanDepth {
            stamp,
            path: depth_path,
            intrinsics: None,
            confidence: confidence_path.is_file().then_some(confidence_path),
            mm_per_count: 1.0,
            invalid_count: None,
        }),
    })
}

pub(super) fn list(folder: &Path, options: &ImportOptions) -> Result<Scan, ImportError> {
    let mut scan = Scan::default();
    let mut num_without_photo = 0usize;
    let names = file_names(folder)?;
    for name in &names {
        if number_in_name(name, "frame_", ".json").is_none() {
            continue;
        }
        let number = name.trim_start_matches("frame_").trim_end_matches(".json");
        if names.binary_search(&format!("frame_{number}.jpg")).is_err() {
            num_without_photo += 1;
            continue;
        }
        match list_frame(folder, number) {
            Ok(frame) => scan.frames.push(frame),
            Err(reason) => scan.refusals.push(format!("frame {number}: {reason}")),
        }
    }
    if num_without_photo > 0 {
        scan.notes.push(format!(
            "{num_without_photo} of the app's frames have a pose but no photo: not imported"
        ));
    }
    scan.choose_mesh(folder, options.mesh.as_deref(), &["export.obj"])?;
    scan.sort_by_time();
    scan.rebase_relative_clock();
    Ok(scan)
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Point3;

    #[test]
    fn the_camera_looks_along_minus_z_of_arkit() {
        // Phone at (1, 2, 3), world axes: the point half a metre ahead, a little right and up.
        let app = AppFrame {
            camera_pose: [
                1.0, 0.0, 0.0, 1.0, 0.0, 1.0, 0.0, 2.0, 0.0, 0.0, 1.0, 3.0, 0.0, 0.0, 0.0, 1.0,
            ],
            intrinsics: [1400.0, 0.0, 960.0, 0.0, 1401.0, 720.0, 0.0, 0.0, 1.0],
            time: 0.0,
        };
        let camera_from_world = app.world_from_camera().unwrap().inverse();
        let point_in_camera = camera_from_world.transform_point(&Point3::new(1.1, 2.2, 2.5));
        assert!((point_in_camera - Point3::new(0.1, -0.2, 0.5)).norm() < 1e-12);
        assert_eq!(
            app.color_intrinsics().intrinsics_px,
            [1400.0, 1401.0, 960.0, 720.0]
        );
    }
}
