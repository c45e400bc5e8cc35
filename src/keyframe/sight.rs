//! Whether a frame may see anything of a part of the world, from pose and depth alone.
//!
//! The image is divided into cells. A cell sees as far as the farthest depth measured in it and
//! beside it, and somewhat farther; without end where much of it was not measured, since what is
//! beyond the sensor's range can be painted all the same, and where the depth camera has a lens.
//! The answer is no only where every cell's pyramid misses the part.

use nalgebra::{Point3, Vector3};

use crate::geom::{DepthImage, Distortion, FrameDepth, PinholeCamera, PosedFrame, RigidTransform};

const NUM_COLUMNS: usize = 16;
const NUM_ROWS: usize = 12;
const NUM_CELLS: usize = NUM_COLUMNS * NUM_ROWS;
/// Depth pixels that are looked at, about.
const MAX_SAMPLES: usize = 20_000;
/// A cell counts as measured from this share of its area on.
const MIN_MEASURED_SHARE: f64 = 0.75;
/// Surface this far behind the measured depth may be painted from it, metres: twice the difference
/// from which on a frame is taken not to see a surface.
const BEHIND_M: f64 = 0.5;
/// Cells reach this far past their border, pixels.
const MARGIN_PX: f64 = 2.0;
/// Nothing is seen from farther, metres.
const HORIZON_M: f64 = 1e4;

/// A box of the world of which a keyframe must see something.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SightBox {
    min_m: [f64; 3],
    max_m: [f64; 3],
}

impl SightBox {
    /// From `min_m` to `max_m`, metres in the world frame; bounds may be infinite. Without room
    /// between them nothing is seen of it.
    pub fn new(min_m: [f64; 3], max_m: [f64; 3]) -> Self {
        Self { min_m, max_m }
    }

    /// False only where the frame sees nothing of the box; `depth` is its depth image, decoded.
    pub(super) fn may_be_seen_by(&self, frame: &PosedFrame, depth: Option<&DepthImage>) -> bool {
        let camera = &frame.color_camera.pinhole;
        let reach_m = reach_m(camera, frame.depth.as_ref().zip(depth));
        let eye = Point3::from(*frame.world_from_camera.translation());
        let horizon = |axis: usize| eye[axis] - HORIZON_M..=eye[axis] + HORIZON_M;
        let clamped =
            |bound: f64, axis: usize| bound.clamp(*horizon(axis).start(), *horizon(axis).end());
        let min = Point3::from([0, 1, 2].map(|axis| clamped(self.min_m[axis], axis)));
        let max = Point3::from([0, 1, 2].map(|axis| clamped(self.max_m[axis], axis)));
        (0..NUM_CELLS).any(|cell| {
            Pyramid::new(camera, cell, reach_m[cell]).may_meet(&frame.world_from_camera, &min, &max)
        })
    }
}

/// How far each cell sees along the camera's axis, metres.
fn reach_m(camera: &PinholeCamera, depth: Option<(&FrameDepth, &DepthImage)>) -> [f64; NUM_CELLS] {
    let Some((half, image)) = depth.filter(|(half, _)| half.camera.distortion == Distortion::None)
    else {
        return [f64::INFINITY; NUM_CELLS];
    };
    let (width, height) = (image.width() as usize, image.height() as usize);
    let stride = (1..).find(|s| (width / s) * (height / s) <= MAX_SAMPLES);
    let stride = stride.unwrap_or(1);
    let color_from_depth = half.depth_from_color.inverse();
    let mut num_measured = [0_u32; NUM_CELLS];
    let mut farthest_m = [0.0_f64; NUM_CELLS];
    for y in (0..height).step_by(stride) {
        for x in (0..width).step_by(stride) {
            let pixel = [x as f64, y as f64];
            let Some(depth_m) = image.nearest(pixel) else {
                continue;
            };
            let point = half.camera.pinhole.unproject(pixel, f64::from(depth_m));
            let point = color_from_depth.transform_point(&point);
            if let Some(cell) = camera.project(&point).and_then(|px| cell_at(camera, px)) {
                num_measured[cell] += 1;
                farthest_m[cell] = farthest_m[cell].max(point.z);
            }
        }
    }
    let num_wanted = MIN_MEASURED_SHARE * samples_in_cell(camera, &half.camera.pinhole, stride);
    std::array::from_fn(|cell| {
        if f64::from(num_measured[cell]) < num_wanted {
            return f64::INFINITY;
        }
        let beside = neighbours(cell).map(|beside| farthest_m[beside]);
        beside.fold(0.0, f64::max) + BEHIND_M
    })
}

/// Samples of the depth image that lie in a cell of the colour image where all is measured.
fn samples_in_cell(color: &PinholeCamera, depth: &PinholeCamera, stride: usize) -> f64 {
    let px2 = f64::from(color.width()) * f64::from(color.height()) / NUM_CELLS as f64;
    let ([color_fx, color_fy, ..], [depth_fx, depth_fy, ..]) =
        (color.intrinsics_px(), depth.intrinsics_px());
    px2 * (depth_fx * depth_fy) / (color_fx * color_fy) / (stride * stride) as f64
}

fn cell_at(camera: &PinholeCamera, [x_px, y_px]: [f64; 2]) -> Option<usize> {
    let at = |px: f64, side: u32, num: usize| {
        let share = (px + 0.5) / f64::from(side);
        if !(0.0..1.0).contains(&share) {
            return None;
        }
        #[expect(
            clippy::cast_possible_truncation,
            clippy::cast_sign_loss,
            reason = "a share of the image, at least 0 and below 1"
        )]
        Some((share * num as f64) as usize)
    };
    let column = at(x_px, camera.width(), NUM_COLUMNS)?;
    let row = at(y_px, camera.height(), NUM_ROWS)?;
    Some((row * NUM_COLUMNS + column).min(NUM_CELLS - 1))
}

/// A cell and those around it.
fn neighbours(cell: usize) -> impl Iterator<Item = usize> {
    let (row, column) = (cell / NUM_COLUMNS, cell % NUM_COLUMNS);
    let around = |at: usize, num: usize| at.saturating_sub(1)..(at + 2).min(num);
    around(row, NUM_ROWS).flat_map(move |row| {
        around(column, NUM_COLUMNS).map(move |column| row * NUM_COLUMNS + column)
    })
}

/// What a cell sees, in the camera's frame.
struct Pyramid {
    /// Bounds of x/z and y/z: low and high.
    slopes: [[f64; 2]; 2],
    far_m: f64,
}

impl Pyramid {
    fn new(camera: &PinholeCamera, cell: usize, far_m: f64) -> Self {
        let [fx, fy, cx, cy] = camera.intrinsics_px();
        let along = |at: usize, num: usize, side: u32, focal_px: f64, center_px: f64| {
            let cell_px = f64::from(side) / num as f64;
            let low_px = at as f64 * cell_px - 0.5 - MARGIN_PX;
            let high_px = (at + 1) as f64 * cell_px - 0.5 + MARGIN_PX;
            [low_px, high_px].map(|px| (px - center_px) / focal_px)
        };
        let (row, column) = (cell / NUM_COLUMNS, cell % NUM_COLUMNS);
        Self {
            slopes: [
                along(column, NUM_COLUMNS, camera.width(), fx, cx),
                along(row, NUM_ROWS, camera.height(), fy, cy),
            ],
            far_m: far_m.min(HORIZON_M),
        }
    }

    /// False only where the pyramid and the box have no point in common: no side of either, as a
    /// plane, may part them.
    fn may_meet(
        &self,
        world_from_camera: &RigidTransform,
        min: &Point3<f64>,
        max: &Point3<f64>,
    ) -> bool {
        if (0..3).any(|axis| min[axis] > max[axis]) {
            return false;
        }
        let [[left, right], [top, bottom]] = self.slopes;
        let sides = [
            (Vector3::new(1.0, 0.0, -left), 0.0),
            (Vector3::new(-1.0, 0.0, right), 0.0),
            (Vector3::new(0.0, 1.0, -top), 0.0),
            (Vector3::new(0.0, -1.0, bottom), 0.0),
            (Vector3::new(0.0, 0.0, 1.0), 0.0),
            (Vector3::new(0.0, 0.0, -1.0), self.far_m),
        ];
        let (center, half_size) = (nalgebra::center(min, max), (max - min) / 2.0);
        let from_eye = center.coords - world_from_camera.translation();
        let is_beyond = sides.iter().any(|(inward, offset)| {
            let inward = world_from_camera.transform_vector(inward);
            inward.dot(&from_eye) + inward.abs().dot(&half_size) + offset < 0.0
        });
        if is_beyond {
            return false;
        }
        let far = |x: f64, y: f64| Point3::new(x, y, 1.0) * self.far_m;
        let corners = [
            Point3::origin(),
            far(left, top),
            far(right, top),
            far(left, bottom),
            far(right, bottom),
        ]
        .map(|corner| world_from_camera.transform_point(&corner));
        (0..3).all(|axis| {
            let along = corners.map(|corner| corner[axis]);
            let low = along.iter().copied().fold(f64::INFINITY, f64::min);
            let high = along.iter().copied().fold(f64::NEG_INFINITY, f64::max);
            low <= max[axis] && high >= min[axis]
        })
    }
}

#[cfg(test)]
mod tests {
    use nalgebra::UnitQuaternion;

    use super::*;
    use crate::geom::{CameraModel, ColorImage, EncodedColor, EncodedDepth, Stamp};

    const WIDTH: u32 = 160;
    const HEIGHT: u32 = 120;
    const DEPTH: [u32; 2] = [80, 60];

    fn camera(width: u32, height: u32) -> CameraModel {
        let [w, h] = [f64::from(width), f64::from(height)];
        let intrinsics_px = [0.8 * w, 0.8 * w, (w - 1.0) / 2.0, (h - 1.0) / 2.0];
        CameraModel::ideal(PinholeCamera::new(intrinsics_px, width, height).unwrap())
    }

    /// A frame at the origin that looks along z, turned about y; depths by pixel, millimetres.
    fn frame(turn_rad: f64, depth_mm: impl Fn(u32, u32) -> u16) -> (PosedFrame, DepthImage) {
        let [width, height] = DEPTH;
        let pixels = (0..width * height).map(|i| depth_mm(i % width, i / width));
        let pixels: Vec<u16> = pixels.collect();
        let gray = ColorImage::new(WIDTH, HEIGHT, vec![[9; 3]; (WIDTH * HEIGHT) as usize]).unwrap();
        let rotation = UnitQuaternion::from_axis_angle(&Vector3::y_axis(), turn_rad);
        let frame = PosedFrame {
            stamp: Stamp::default(),
            world_from_camera: RigidTransform::from_parts(rotation, Vector3::zeros()),
            color: EncodedColor::png_from_image(&gray).unwrap(),
            color_camera: camera(WIDTH, HEIGHT),
            depth: Some(FrameDepth {
                image: EncodedDepth::png_from_u16_mm(width, height, &pixels).unwrap(),
                camera: camera(width, height),
                depth_from_color: RigidTransform::identity(),
            }),
        };
        (frame, DepthImage::from_mm(width, height, pixels).unwrap())
    }

    fn sees(seen: &SightBox, (frame, depth): &(PosedFrame, DepthImage)) -> bool {
        seen.may_be_seen_by(frame, Some(depth))
    }

    fn cube(center: [f64; 3], half_m: f64) -> SightBox {
        SightBox::new(center.map(|c| c - half_m), center.map(|c| c + half_m))
    }

    #[test]
    fn a_wall_ends_the_view_and_a_hole_in_it_does_not() {
        let behind = cube([0.0, 0.0, 4.0], 0.3);
        let wall = |_, _| 2000;
        assert!(!sees(&behind, &frame(0.0, wall)));
        assert!(sees(&cube([0.0, 0.0, 2.0], 0.1), &frame(0.0, wall)));
        // A little behind the wall may be the wall.
        assert!(sees(&cube([0.0, 0.0, 2.7], 0.3), &frame(0.0, wall)));
        // Where nothing was measured the view goes on, in that direction only.
        let hole = |x, y| if x < 20 && y < 20 { 0 } else { 2000 };
        assert!(!sees(&behind, &frame(0.0, hole)));
        let behind_hole = cube([-2.0, -1.4, 4.0], 0.3);
        assert!(sees(&behind_hole, &frame(0.0, hole)));
        assert!(!sees(&behind_hole, &frame(0.0, wall)));
        // Single missing pixels are no hole.
        let speckled = |x, y| if (x * 7 + y * 13) % 11 == 0 { 0 } else { 2000 };
        assert!(!sees(&behind, &frame(0.0, speckled)));
        // A thing farther than the wall shows in the cells beside it too.
        let narrow = cube([0.0, 0.0, 4.0], 0.2);
        let window = |x, y| if (x, y) == (47, 30) { 6000 } else { 2000 };
        assert!(!sees(&narrow, &frame(0.0, wall)));
        assert!(sees(&narrow, &frame(0.0, window)));
    }

    #[test]
    fn only_what_lies_in_the_view_is_seen() {
        let wall = |_, _| 4000;
        let front = cube([0.0, 0.0, 3.0], 0.2);
        for (turn_rad, is_seen) in [(0.0, true), (0.4, true), (0.8, false), (3.0, false)] {
            assert_eq!(sees(&front, &frame(turn_rad, wall)), is_seen, "{turn_rad}");
        }
        let (mut frame, _) = frame(0.8, wall);
        frame.depth = None;
        assert!(!front.may_be_seen_by(&frame, None));
        frame.world_from_camera = RigidTransform::identity();
        assert!(cube([0.0, 0.0, 500.0], 1.0).may_be_seen_by(&frame, None));
    }

    #[test]
    fn bounds_may_be_infinite_and_the_camera_inside() {
        let wall = |_, _| 2000;
        let (low, high) = (f64::NEG_INFINITY, f64::INFINITY);
        let ahead = SightBox::new([low, low, 1.0], [high; 3]);
        let beyond = SightBox::new([low, low, 3.0], [high; 3]);
        let back = SightBox::new([low; 3], [high, high, -0.1]);
        assert!(sees(&ahead, &frame(0.0, wall)));
        assert!(!sees(&beyond, &frame(0.0, wall)));
        assert!(!sees(&back, &frame(0.0, wall)));
        // No side of the view parts it from a half of the world that it turns away from.
        let left = SightBox::new([low; 3], [-0.5, high, high]);
        assert!(sees(&left, &frame(0.0, wall)));
        assert!(!sees(&left, &frame(0.8, wall)));
        assert!(sees(&cube([0.0; 3], 1.0), &frame(0.3, wall)));
        assert!(sees(&SightBox::new([low; 3], [high; 3]), &frame(0.3, wall)));
    }

    /// Against rays: whatever a pixel of the depth image measures is seen.
    #[test]
    fn what_is_measured_is_seen() {
        for turn in 0..12 {
            let turn_rad = 0.5 * f64::from(turn);
            let uneven = |x: u32, y: u32| u16::try_from(800 + 60 * (x % 9) + 15 * y).unwrap();
            let made = frame(turn_rad, uneven);
            let (posed, depth) = &made;
            let pinhole = camera(DEPTH[0], DEPTH[1]).pinhole;
            for (x, y) in [
                (0, 0),
                (79, 0),
                (0, 59),
                (79, 59),
                (40, 30),
                (17, 44),
                (63, 9),
            ] {
                let pixel = [f64::from(x), f64::from(y)];
                let depth_m = f64::from(depth.nearest(pixel).unwrap());
                let point = pinhole.unproject(pixel, depth_m);
                let point = posed.world_from_camera.transform_point(&point);
                assert!(
                    sees(&cube([point.x, point.y, point.z], 1e-3), &made),
                    "{x} {y}"
                );
            }
        }
    }
}
