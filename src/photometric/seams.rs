//! Seam levelling: no step where the frame that paints changes.
//!
//! After Waechter, Moehrle, Goesele, "Let there be color!", ECCV 2014, with steps in linear light.
//! Steps are the difference of the two photos at points of the seam, where a change of the surface's
//! own colour is in both; without photos they are read from the texture just inside either triangle,
//! which takes such a change for a step. Where the photos' colours change within a pixel a step may come of a
//! pose or a mesh that is not exact: it is believed as far as it is larger than that would make it. The report's steps are the texture's. Globally: every vertex has a correction
//! per label around it, such that corrections make up for the step at seams and vary little
//! within a label; a weak pull to 0 keeps what lies farther than [`SeamParams::reach_m`] from a
//! seam as it is. Corrections are interpolated over triangles and added. Locally: what step is left
//! is halved onto both sides, and fades out within a few texels.
//!
//! Only texels that show the frame of their triangle's label change. Steps above
//! [`SeamParams::max_step`] are taken for different things, not for light, and stay.
//!
//! [`level_seams`] does all of a surface, [`SeamPatch`] some of its triangles beside others that stay
//! as they are: what was added to those stands, and what is levelled now makes up for the rest.

mod apply;
mod global;
mod local;
mod nodes;
mod patch;
mod samples;
mod surface;

use crate::atlas::{AtlasLayout, AtlasTexture, TexelSource};
use crate::mesh::TriMesh;

use super::{PhotometricError, check};
use nodes::Nodes;
pub use patch::SeamPatch;
pub use samples::SeamPhoto;
use samples::{find_seams, mean_step};
use surface::Surface;
pub use surface::{Levelled, Standing};

/// How seams are levelled.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SeamParams {
    /// Whether whole regions are levelled.
    pub has_global: bool,
    /// Whether narrow bands are.
    pub has_local: bool,
    /// How far from a seam the global correction reaches, metres (> 0).
    pub reach_m: f64,
    /// Weight of steps against the stiffness of corrections (> 0): 1 / (2 × weight) of a step is left.
    pub step_weight: f64,
    /// Width of the band on either side of a seam, texels (> 0).
    pub band_texel: f64,
    /// Larger steps of linear light stay as they are (> 0).
    pub max_step: f64,
    /// How far apart two photos are taken to show a point, pixels of the reduced photo (≥ 0): steps are
    /// doubted as far as the photos' own colours change over it.
    pub misplaced_px: f64,
}

impl Default for SeamParams {
    fn default() -> Self {
        Self {
            has_global: true,
            has_local: true,
            reach_m: 0.5,
            step_weight: 50.0,
            band_texel: 6.0,
            max_step: 0.25,
            misplaced_px: 1.0,
        }
    }
}

/// What levelling did.
#[derive(Clone, Copy, Debug, PartialEq, Default)]
pub struct SeamReport {
    /// Edges of the mesh between two labels.
    pub num_seams: usize,
    /// Corrections that were solved for.
    pub num_unknowns: usize,
    /// Steps of conjugate gradients.
    pub num_solver_steps: usize,
    /// Mean absolute step of linear light at seams, by length, before; without those left alone.
    pub step_before: f64,
    /// After the global correction.
    pub step_after_global: f64,
    /// After both.
    pub step_after: f64,
    /// Texels that changed; those of both passes count twice.
    pub num_changed_texels: usize,
}

/// Levels the seams of `texture`. `labels` has the frame of each triangle as an index into
/// `sources`, the texel sources of the frames, and into `photos`, where steps are taken from these
/// and not from the texture. Gutters are left for the caller to paint again.
///
/// # Errors
/// [`PhotometricError`] for a parameter out of range, or inputs that do not belong together.
pub fn level_seams(
    mesh: &TriMesh,
    layout: &AtlasLayout,
    labels: &[Option<u32>],
    sources: &[TexelSource],
    photos: Option<&[Option<SeamPhoto>]>,
    params: &SeamParams,
    texture: &mut AtlasTexture,
) -> Result<SeamReport, PhotometricError> {
    params.check()?;
    let num_triangles = mesh.num_triangles();
    let num_in_layout = layout
        .corners_texel
        .len()
        .min(layout.chart_of_triangle.len());
    if labels.len() != num_triangles || num_in_layout != num_triangles {
        return Err(PhotometricError::Mismatch {
            num_triangles,
            num_in_layout,
            num_labels: labels.len(),
        });
    }
    texture.check_fits(layout)?;
    let surface = Surface {
        mesh,
        layout,
        labels,
        sources: surface::sources_of(labels, sources),
        part: None,
    };
    level(&surface, photos, params, &mut Vec::new(), texture)
}

impl SeamParams {
    fn check(&self) -> Result<(), PhotometricError> {
        check("reach of seam levelling", self.reach_m, 1e-6..=1e6)?;
        check("weight of seam steps", self.step_weight, 1e-6..=1e6)?;
        check("band of seam levelling", self.band_texel, 1e-3..=1e4)?;
        check("largest seam step", self.max_step, 1e-6..=2.0)?;
        check("misplacement at seams", self.misplaced_px, 0.0..=100.0)
    }
}

/// Levels a surface or part of one. `levelled`, as long as the mesh has triangles or empty, gets what
/// is added to each triangle.
fn level(
    surface: &Surface<'_>,
    photos: Option<&[Option<SeamPhoto>]>,
    params: &SeamParams,
    levelled: &mut [Levelled],
    texture: &mut AtlasTexture,
) -> Result<SeamReport, PhotometricError> {
    let nodes = Nodes::new(surface);
    let standing = nodes.standing(surface);
    let mut seams = find_seams(surface)?;
    let mut report = SeamReport {
        num_seams: seams.len(),
        num_unknowns: nodes.len() - standing.iter().flatten().count(),
        ..SeamReport::default()
    };
    let sample = |seams: &mut Vec<samples::Seam>, texture: &AtlasTexture| {
        samples::sample(seams, surface, texture, params.max_step);
        mean_step(seams, surface)
    };
    report.step_before = sample(&mut seams, texture);
    report.step_after_global = report.step_before;
    if let Some(photos) = photos {
        samples::sample_photos(&mut seams, surface, photos, params);
    }
    // What stands beside may show a correction where there is no seam.
    if params.has_global && !(seams.is_empty() && standing.is_empty()) {
        let (corrections, num_steps) =
            global::solve(surface.mesh, &nodes, &standing, &seams, params);
        report.num_solver_steps = num_steps;
        report.num_changed_texels += global::paint(surface, &nodes, &corrections, texture);
        surface::keep_corners(levelled, &nodes, &corrections);
        let mut seen = seams.clone();
        report.step_after_global = sample(&mut seen, texture);
        match photos {
            Some(_) => samples::add_corrections(&mut seams, &nodes, &corrections),
            None => seams = seen,
        }
    }
    report.step_after = report.step_after_global;
    if params.has_local && !seams.is_empty() {
        samples::shrink(&mut seams);
        let mut keep = |side: &samples::Side, added: &[[f32; 3]]| {
            if let Some(levelled) = levelled.get_mut(side.triangle as usize) {
                levelled.keep_along(side.corners, added);
            }
        };
        report.num_changed_texels +=
            local::level(surface, &nodes, &seams, params, &mut keep, texture);
        report.step_after = sample(&mut seams, texture);
    }
    Ok(report)
}

#[cfg(test)]
mod tests;
