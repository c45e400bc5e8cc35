//! Which views show the charts that may change, where not all may.
//!
//! A view is drawn as often as it shows pixels of them, so that each such pixel of each view has the
//! same chance, as it has where all charts may change. How many there are is known only once a
//! view is drawn, and that takes as long as a step. So there is a guess at first, from points spread
//! over the charts, which knows nothing of what hides them; a view that is drawn puts its own number
//! in the guess's place. A view in whose image no point lies is none of these.

use std::sync::Arc;

use nalgebra::{Point3, Vector3};
use rayon::prelude::*;

use super::random::{Purpose, StepDraws};
use crate::atlas::AtlasLayout;
use crate::keyframe::Keyframe;
use crate::mesh::{TriMesh, TriangleId};

/// Points on all charts together; each has at least one besides.
const NUM_POINTS: f64 = 4096.0;

/// Pixels of each view that show what may change.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Focus {
    num_px: Vec<usize>,
}

impl Focus {
    pub(super) fn guess(
        mesh: &TriMesh,
        layout: &AtlasLayout,
        may_change: &[bool],
        frames: &[Arc<Keyframe>],
    ) -> Self {
        let points = spread(mesh, layout, may_change);
        let num_px = frames
            .par_iter()
            .map(|frame| num_px(frame, &points))
            .collect();
        Self { num_px }
    }

    /// A view, as likely as it has pixels; none where no view has any.
    pub(super) fn draw(&self, draws: StepDraws) -> Option<usize> {
        let mut number = draws.below(Purpose::View, self.num_px.iter().sum());
        for (index, &num) in self.num_px.iter().enumerate() {
            if number < num {
                return Some(index);
            }
            number -= num;
        }
        None
    }

    /// How many pixels a view has is known.
    pub(super) fn set(&mut self, index: usize, num_px: usize) {
        self.num_px[index] = num_px;
    }

    /// Views that may have any.
    pub(super) fn num_views(&self) -> usize {
        self.num_px.iter().filter(|num| **num > 0).count()
    }
}

/// A piece of surface.
struct Piece {
    position_m: Point3<f64>,
    /// As long as its area, square metres.
    normal: Vector3<f64>,
}

/// Points that stand for about the same area each.
fn spread(mesh: &TriMesh, layout: &AtlasLayout, may_change: &[bool]) -> Vec<Piece> {
    let charts = || {
        let charts = layout.charts.iter().zip(may_change);
        charts.filter_map(|(chart, may_change)| may_change.then_some(&*chart.triangles))
    };
    let area_m2 = |triangles: &[TriangleId]| -> f64 {
        let areas = triangles.iter().map(|&triangle| mesh.area_m2(triangle));
        areas.sum()
    };
    let all_m2: f64 = charts().map(area_m2).sum();
    let mut pieces = Vec::new();
    for triangles in charts() {
        let chart_m2 = area_m2(triangles);
        let num_pieces = (NUM_POINTS * chart_m2 / all_m2).ceil();
        let piece_m2 = chart_m2 / num_pieces;
        if piece_m2.is_nan() || piece_m2 <= 0.0 {
            continue;
        }
        let (mut passed_m2, mut next_m2) = (0.0, 0.5 * piece_m2);
        for &triangle in triangles {
            passed_m2 += mesh.area_m2(triangle);
            while next_m2 < passed_m2 {
                next_m2 += piece_m2;
                let normal = mesh.scaled_normal(triangle).normalize() * piece_m2;
                let position_m = point_on(mesh.corners_m(triangle), pieces.len());
                pieces.push(Piece { position_m, normal });
            }
        }
    }
    pieces
}

/// A point of a triangle: one of a sequence that covers it evenly (R2: Roberts, "The unreasonable
/// effectiveness of quasirandom sequences", 2018).
fn point_on([a, b, c]: [Point3<f64>; 3], number: usize) -> Point3<f64> {
    let along = |step: f64| (0.5 + number as f64 * step).fract();
    let (u, v) = (
        along(0.754_877_666_246_692_7),
        along(0.569_840_290_998_053_2),
    );
    let (u, v) = if u + v > 1.0 {
        (1.0 - u, 1.0 - v)
    } else {
        (u, v)
    };
    a + (b - a) * u + (c - a) * v
}

/// Pixels that the pieces take in a view, where nothing hides them; at least one where a piece is in
/// the image.
fn num_px(frame: &Keyframe, pieces: &[Piece]) -> usize {
    let camera = &frame.color_camera.pinhole;
    let [fx, fy, ..] = camera.intrinsics_px();
    let camera_from_world = frame.world_from_camera.inverse();
    let sum_px: f64 = pieces
        .iter()
        .filter_map(|piece| {
            let point = camera_from_world.transform_point(&piece.position_m);
            let pixel = camera.project(&point)?;
            let normal = camera_from_world.transform_vector(&piece.normal);
            let seen = fx * fy * normal.dot(&point.coords).abs() / point.z.powi(3);
            camera.contains(pixel).then_some(seen)
        })
        .sum();
    let image_px = f64::from(camera.width()) * f64::from(camera.height());
    #[expect(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "between 0 and the pixels of an image"
    )]
    let num_px = sum_px.ceil().clamp(0.0, image_px) as usize;
    num_px
}

#[cfg(test)]
mod tests;
