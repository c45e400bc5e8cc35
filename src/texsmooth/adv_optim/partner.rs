//! The partner of a step: another photo, projected into the crop.

use rayon::prelude::*;

use super::SmoothError;
use super::step::Optimisation;
use crate::texsmooth::random::{Purpose, StepDraws};
use crate::texsmooth::view::{CropSurface, PixelRect};
use crate::texsmooth::views::{Seen, partners};
use crate::texsmooth::{PartnerOffset, PartnerRule};

/// A partner that sees less of the crop than this share is none.
const MIN_PARTNER_SHARE: usize = 10;
/// Rows of points, along each side of a crop, that a partner is looked for by.
const PARTNER_PROBES: usize = 3;

impl Optimisation<'_> {
    /// A partner's photo, projected into the crop: planar, NaN where it does not see the same surface.
    #[expect(
        clippy::too_many_arguments,
        reason = "all that a step has drawn so far"
    )]
    pub(super) fn partner(
        &mut self,
        draws: StepDraws,
        index: usize,
        seen: &Seen,
        rect: PixelRect,
        surface: &CropSurface,
        num_seen: usize,
        photo: &[f32],
    ) -> Result<Vec<f32>, SmoothError> {
        let candidates = match self.params.partner_rule {
            PartnerRule::WorldAxis => self.partners(index).collect(),
            PartnerRule::ViewingAxis => self.partners_before(index, seen, rect, surface),
        };
        let drawn = candidates
            .get(draws.below(Purpose::Partner, candidates.len()))
            .copied()
            .unwrap_or(index);
        if drawn != index
            && let Ok(partner) = self.views.get(drawn)
        {
            let projected = match self.params.partner_offset {
                PartnerOffset::Own => {
                    let whole = PixelRect {
                        x: 0,
                        y: 0,
                        width: partner.photo.color.width() as usize,
                        height: partner.photo.color.height() as usize,
                    };
                    let offset_px = self.offset(drawn, &partner, whole)?;
                    self.project(&partner, seen, &surface.point_in_camera, offset_px)
                }
                PartnerOffset::View => {
                    let unshifted = seen.view.surface(self.on, self.texels, rect, 1, [0.0; 2]);
                    self.project(&partner, seen, &unshifted.point_in_camera, [0.0; 2])
                }
            };
            let num_common = projected[..rect.num_pixels()]
                .iter()
                .zip(&surface.footprint)
                .filter(|(value, footprint)| footprint.is_some() && !value.is_nan())
                .count();
            if num_common * MIN_PARTNER_SHARE >= num_seen {
                return Ok(projected);
            }
        }
        self.report.num_self_partnered += 1;
        Ok(photo.to_vec())
    }

    /// Partners that may see the crop: some of a few points of it lie in their image.
    fn partners_before(
        &self,
        index: usize,
        seen: &Seen,
        rect: PixelRect,
        surface: &CropSurface,
    ) -> Vec<usize> {
        let world_from_camera = seen.view.camera_from_world.inverse();
        let probe = |at: usize, size: usize| (2 * at + 1) * size / (2 * PARTNER_PROBES);
        let points: Vec<_> = (0..PARTNER_PROBES * PARTNER_PROBES)
            .filter_map(|i| {
                let x = probe(i % PARTNER_PROBES, rect.width);
                let y = probe(i / PARTNER_PROBES, rect.height);
                let point = surface.point_in_camera.get(y * rect.width + x)?;
                (!point[0].is_nan())
                    .then(|| world_from_camera.transform_point(&point.map(f64::from).into()))
            })
            .collect();
        let sees_most = |other: &usize| {
            let frame = self.views.frame(*other);
            let camera = &frame.color_camera.pinhole;
            let camera_from_world = frame.world_from_camera.inverse();
            let num_inside = points
                .iter()
                .filter(|point| {
                    camera
                        .project(&camera_from_world.transform_point(point))
                        .is_some_and(|pixel| camera.contains(pixel))
                })
                .count();
            *other == index || 2 * num_inside > points.len()
        };
        self.partners(index).filter(sees_most).collect()
    }

    fn partners(&self, index: usize) -> impl Iterator<Item = usize> {
        partners(self.axes, index, self.params.max_partner_angle_rad)
    }

    fn project(
        &self,
        partner: &Seen,
        seen: &Seen,
        points_in_camera: &[[f32; 3]],
        offset_px: [f32; 2],
    ) -> Vec<f32> {
        let positions = partner.view.project_from(
            &seen.view,
            self.on.mesh,
            points_in_camera,
            self.params.max_depth_difference_m,
        );
        let num = positions.len();
        let mut out = vec![f32::NAN; 3 * num];
        let colors: Vec<Option<[f32; 3]>> = positions
            .par_iter()
            .map(|position| {
                let [x, y] = (*position)?;
                let at = [x + offset_px[0], y + offset_px[1]];
                let sampled = partner.photo.color.sample_bilinear(at);
                Some(sampled.map(|value| value / 127.5 - 1.0))
            })
            .collect();
        for (i, color) in colors.iter().enumerate() {
            if let Some(color) = color {
                for (channel, &value) in color.iter().enumerate() {
                    out[channel * num + i] = value;
                }
            }
        }
        out
    }
}
