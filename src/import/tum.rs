//! TUM RGB-D (Sturm et al., IROS 2012): `rgb.txt`, `depth.txt`, `groundtruth.txt`.
//!
//! Lines are `stamp file` and `stamp tx ty tz qx qy qz qw` (camera-to-world of the optical frame,
//! metres). Depth has 5000 counts a metre and is registered to colour, lens included. A depth image
//! goes with a colour image when each is the other's nearest in time and they are close enough.
//! The pose at the colour stamp is interpolated between its neighbours in the ground truth.

use std::path::Path;

use crate::geom::{Distortion, RigidTransform, Stamp};

use super::scan::{Intrinsics, Scan, ScanDepth, ScanFrame, read_text};
use super::{ImportError, ImportOptions};

/// 5000 counts a metre (the data set's file format page).
const MM_PER_COUNT: f64 = 0.2;

/// Ground truth is taken a hundred times a second; over a longer hole nothing is interpolated.
const MAX_POSE_GAP_S: f64 = 0.2;

/// Stamps of the three files, exactly: decimal seconds, more digits than an `f64` holds.
fn parse_stamp(word: &str) -> Option<Stamp> {
    let (whole, fraction) = word.split_once('.').unwrap_or((word, ""));
    let is_decimal = |digits: &str| digits.bytes().all(|b| b.is_ascii_digit());
    if whole.is_empty() || !is_decimal(whole) || !is_decimal(fraction) {
        return None;
    }
    let nanos: i64 = format!("{:0<9.9}", fraction).parse().ok()?;
    let seconds: i64 = whole.parse().ok()?;
    Some(Stamp::from_nanos(
        seconds.checked_mul(1_000_000_000)?.checked_add(nanos)?,
    ))
}

struct Lines {
    path: String,
    text: String,
}

impl Lines {
    fn read(folder: &Path, name: &str) -> Result<Self, ImportError> {
        Ok(Self {
            path: name.to_owned(),
            text: read_text(&folder.join(name))?,
        })
    }

    /// What `parse` makes of the words of each line; other lines are refused one by one.
    fn parse<T>(
        &self,
        refusals: &mut Vec<String>,
        parse: impl Fn(Stamp, &[&str]) -> Result<T, String>,
    ) -> Vec<(Stamp, T)> {
        let mut rows = Vec::new();
        for (index, line) in self.text.lines().enumerate() {
            let words: Vec<&str> = line.split_ascii_whitespace().collect();
            let Some((&stamp, rest)) = words.split_first().filter(|(w, _)| !w.starts_with('#'))
            else {
                continue;
            };
            let row = parse_stamp(stamp)
                .ok_or_else(|| format!("'{stamp}' is no stamp in seconds"))
                .and_then(|stamp| Ok((stamp, parse(stamp, rest)?)));
            match row {
                Ok(row) => rows.push(row),
                Err(reason) => refusals.push(format!("{} line {}: {reason}", self.path, index + 1)),
            }
        }
        rows.sort_by_key(|(stamp, _)| *stamp);
        rows
    }
}

fn parse_file(_: Stamp, words: &[&str]) -> Result<String, String> {
    match words {
        [file] => Ok((*file).to_owned()),
        _ => Err("a line is 'stamp file'".to_owned()),
    }
}

fn parse_pose(_: Stamp, words: &[&str]) -> Result<RigidTransform, String> {
    let numbers: Vec<f64> = words
        .iter()
        .map(|word| word.parse().map_err(|_| format!("'{word}' is no number")))
        .collect::<Result<_, _>>()?;
    let &[tx, ty, tz, qx, qy, qz, qw] = numbers.as_slice() else {
        return Err(format!(
            "a pose has 7 numbers behind its stamp, not {}",
            numbers.len()
        ));
    };
    RigidTransform::try_from_quaternion([qx, qy, qz, qw], [tx, ty, tz])
        .map_err(|error| error.to_string())
}

/// Index of the row nearest in time (the earlier of two equally near).
fn nearest<T>(rows: &[(Stamp, T)], stamp: Stamp) -> Option<usize> {
    let after = rows.partition_point(|(s, _)| *s < stamp);
    let before = after.checked_sub(1);
    let distance = |index: usize| rows.get(index).map(|(s, _)| s.abs_diff_nanos(stamp));
    match (before.and_then(distance), distance(after)) {
        (Some(d_before), Some(d_after)) if d_after < d_before => Some(after),
        (Some(_), _) => before,
        (None, Some(_)) => Some(after),
        (None, None) => None,
    }
}

/// The pose at a stamp: between its two neighbours, or the nearest one at the trajectory's ends.
fn pose_at(
    poses: &[(Stamp, RigidTransform)],
    stamp: Stamp,
    max_difference_s: f64,
) -> Option<RigidTransform> {
    let after = poses.partition_point(|(s, _)| *s < stamp);
    if let (Some(&(s1, pose1)), Some(&(s0, pose0))) = (
        poses.get(after),
        after.checked_sub(1).and_then(|before| poses.get(before)),
    ) {
        let gap_s = s1.seconds_since(s0);
        if gap_s <= MAX_POSE_GAP_S {
            return Some(pose0.interpolate(&pose1, stamp.seconds_since(s0) / gap_s));
        }
    }
    let &(nearest_stamp, pose) = poses.get(nearest(poses, stamp)?)?;
    let difference_s = stamp.seconds_since(nearest_stamp).abs();
    (difference_s <= max_difference_s).then_some(pose)
}

/// The camera of a sequence by its folder's name (calibrations of the data set's page; with the
/// names of the sequences), or else the ROS default that the page gives.
fn camera(folder: &Path, options: &ImportOptions, notes: &mut Vec<String>) -> Intrinsics {
    let full = std::fs::canonicalize(folder).unwrap_or_else(|_| folder.to_owned());
    let name = full
        .file_name()
        .map(|name| name.to_string_lossy().to_ascii_lowercase())
        .unwrap_or_default();
    let kinect = |intrinsics_px, distortion| Intrinsics {
        intrinsics_px,
        size_px: Some([640, 480]),
        distortion,
    };
    let (which, intrinsics) = if let Some(intrinsics_px) = options.intrinsics_px {
        return Intrinsics::pinhole(intrinsics_px);
    } else if name.contains("freiburg1") {
        let lens = Distortion::PlumbBob([0.2624, -0.9531, -0.0054, 0.0026, 1.1633]);
        ("Freiburg 1", kinect([517.3, 516.5, 318.6, 255.3], lens))
    } else if name.contains("freiburg2") {
        let lens = Distortion::PlumbBob([0.2312, -0.7849, -0.0033, -0.0001, 0.9172]);
        ("Freiburg 2", kinect([520.9, 521.0, 325.1, 249.7], lens))
    } else if name.contains("freiburg3") {
        let camera = kinect([535.4, 539.2, 320.1, 247.6], Distortion::None);
        ("Freiburg 3", camera)
    } else {
        let camera = kinect([525.0, 525.0, 319.5, 239.5], Distortion::None);
        ("the ROS default, 525 525 319.5 239.5", camera)
    };
    notes.push(format!(
        "the camera is {which}, by the folder's name '{name}'"
    ));
    intrinsics
}

pub(super) fn list(folder: &Path, options: &ImportOptions) -> Result<Scan, ImportError> {
    let mut scan = Scan::default();
    let colors = Lines::read(folder, "rgb.txt")?.parse(&mut scan.refusals, parse_file);
    let depths = Lines::read(folder, "depth.txt")?.parse(&mut scan.refusals, parse_file);
    let poses = Lines::read(folder, "groundtruth.txt")?.parse(&mut scan.refusals, parse_pose);
    let intrinsics = camera(folder, options, &mut scan.notes);
    let max_difference_s = options.max_time_difference_s;
    for (index, &(stamp, ref file)) in colors.iter().enumerate() {
        let Some(world_from_camera) = pose_at(&poses, stamp, max_difference_s) else {
            scan.refusals
                .push(format!("{file}: groundtruth.txt has no pose near {stamp}"));
            continue;
        };
        let depth = nearest(&depths, stamp)
            .and_then(|depth| depths.get(depth))
            .filter(|(depth_stamp, _)| {
                nearest(&colors, *depth_stamp) == Some(index)
                    && stamp.seconds_since(*depth_stamp).abs() <= max_difference_s
            });
        scan.frames.push(ScanFrame {
            stamp,
            world_from_camera,
            color: folder.join(file),
            color_intrinsics: intrinsics,
            depth: depth.map(|(depth_stamp, file)| ScanDepth {
                stamp: *depth_stamp,
                path: folder.join(file),
                intrinsics: Some(intrinsics),
                confidence: None,
                mm_per_count: MM_PER_COUNT,
                invalid_count: None,
            }),
        });
    }
    let num_without_depth = scan.frames.iter().filter(|f| f.depth.is_none()).count();
    if num_without_depth > 0 {
        scan.notes.push(format!(
            "{num_without_depth} colour images have no depth image of their own within {max_difference_s} s"
        ));
    }
    scan.choose_mesh(folder, options.mesh.as_deref(), &["mesh.ply", "mesh.obj"])?;
    scan.sort_by_time();
    Ok(scan)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn stamps_are_exact() {
        assert_eq!(
            parse_stamp("1305031102.175304"),
            Some(Stamp::from_nanos(1_305_031_102_175_304_000))
        );
        assert_eq!(
            parse_stamp("1305031102.1753041234567"),
            Some(Stamp::from_nanos(1_305_031_102_175_304_123))
        );
        assert_eq!(parse_stamp("7"), Some(Stamp::from_nanos(7_000_000_000)));
        for bad in ["", ".5", "-1.0", "1e9", "nan", "9999999999999", "1.2.3"] {
            assert_eq!(parse_stamp(bad), None, "{bad}");
        }
    }

    #[test]
    fn poses_are_interpolated_but_not_over_a_hole() {
        let at = |x: f64| {
            RigidTransform::from_parts(
                nalgebra::UnitQuaternion::identity(),
                nalgebra::Vector3::new(x, 0.0, 0.0),
            )
        };
        let ms = |ms: i64| Stamp::from_nanos(ms * 1_000_000);
        let poses = [
            (ms(1000), at(1.0)),
            (ms(1010), at(2.0)),
            (ms(2000), at(9.0)),
        ];
        let x_at = |ms_: i64| pose_at(&poses, ms(ms_), 0.02).map(|p| p.translation().x);
        assert!((x_at(1005).unwrap() - 1.5).abs() < 1e-12);
        assert_eq!(x_at(1000), Some(1.0));
        assert_eq!(x_at(985), Some(1.0));
        assert_eq!(x_at(975), None);
        assert_eq!(x_at(1025), Some(2.0));
        assert_eq!(x_at(1500), None);
        assert_eq!(x_at(2021), None);
        assert_eq!(pose_at(&[], ms(0), 0.02), None);
    }
}
