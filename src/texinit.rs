//! TexInit: from a mesh and posed frames to an initial texture (ECCV 2022, section 3.1) (L3).
//!
//! In: a triangle mesh in the world frame, and keyframes with poses in that frame. Out: a place
//! in the atlas for every triangle, and a colour for every texel, with its source. Stages:
//!
//! 1. [`flatten`]: charts, each flattened by boundary first flattening.
//! 2. [`overlap`]: triangles of a chart that cover each other are put on different pieces; then
//!    small charts join neighbours where both flatten together ([`flatten::absorb()`]).
//! 3. [`assign`]: which frame paints which triangle, by three cues (Eq. MRFTex).
//! 4. [`crate::atlas::pack_to_budget`]: charts on pages, at one texel density taken from the images
//!    ([`density`]); or the paper's plates of fixed size ([`crate::atlas::pack_plates`]).
//! 5. [`transfer`]: colour copied from the chosen frame.
//! 6. [`fill`]: colours for what no frame sees; then [`crate::atlas::gutter`].
//!
//! [`stream`] keeps the result up while mesh and keyframes change.

pub mod assign;
pub mod density;
pub mod fill;
pub mod flatten;
pub mod overlap;
pub mod stream;
pub mod transfer;

#[cfg(test)]
pub(crate) mod analytic_scene;

use std::sync::Arc;

use crate::atlas::gutter::GutterReport;
use crate::atlas::texture::TextureMismatch;
use crate::atlas::{
    self, AtlasLayout, AtlasTexture, DensitySpread, PackError, PackParams, PackReport,
};
use crate::geom::ImageError;
use crate::keyframe::{DecodedFrame, Keyframe};
use crate::mesh::TriMesh;

use assign::{AssignError, AssignParams, Assignment};
use density::{DensityParams, SizeRule};
use fill::{FillError, FillParams, FillReport};
use flatten::{AbsorbReport, ChartMode, FlatChart, FlattenError, FlattenParams, FlattenReport};
use overlap::{OverlapParams, OverlapReport};
use transfer::{TransferError, TransferParams, TransferReport};

/// Settings of all stages.
#[derive(Clone, Debug, PartialEq)]
pub struct TexInitParams {
    /// Charts and flattening.
    pub flatten: FlattenParams,
    /// Separation of overlaps.
    pub overlap: OverlapParams,
    /// Choice of frames.
    pub assign: AssignParams,
    /// What the choice for one triangle depends on.
    pub coupling: Coupling,
    /// What decides how many texels there are.
    pub size_rule: SizeRule,
    /// Texels per metre, where these decide.
    pub density: DensityParams,
    /// Pages.
    pub pack: PackParams,
    /// Colour transfer.
    pub transfer: TransferParams,
    /// What no frame sees.
    pub fill: FillParams,
    /// Whether charts are padded with their own colours.
    pub has_gutters: bool,
}

impl Default for TexInitParams {
    fn default() -> Self {
        Self {
            flatten: FlattenParams::default(),
            overlap: OverlapParams::default(),
            assign: AssignParams::default(),
            coupling: Coupling::default(),
            size_rule: SizeRule::default(),
            density: DensityParams::default(),
            pack: PackParams::default(),
            transfer: TransferParams::default(),
            fill: FillParams::default(),
            has_gutters: true,
        }
    }
}

impl TexInitParams {
    /// The paper's form, with the published program's choices where its text is silent: one chart
    /// per connected component, its field of planes, plates of fixed size, its cues and weights
    /// alone, every triangle by itself, colours of the nearest pixel, nothing around the charts.
    pub fn paper() -> Self {
        Self {
            flatten: FlattenParams {
                mode: ChartMode::Paper,
                ..FlattenParams::default()
            },
            overlap: OverlapParams::paper(),
            size_rule: SizeRule::Paper,
            assign: AssignParams::paper(),
            transfer: TransferParams::paper(),
            has_gutters: false,
            ..Self::default()
        }
    }
}

/// What the frame that paints a triangle depends on, besides its own scores.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default)]
pub enum Coupling {
    /// All of the scan: adjacent triangles of different charts go together too.
    #[default]
    Scan,
    /// Its chart: the form that can be kept up while the scan changes ([`stream`]).
    Chart,
}

/// Why no texture was made.
#[derive(Debug, thiserror::Error)]
pub enum TexInitError {
    /// Flattening refused.
    #[error(transparent)]
    Flatten(#[from] FlattenError),
    /// Assignment refused.
    #[error(transparent)]
    Assign(#[from] AssignError),
    /// Packing refused.
    #[error(transparent)]
    Pack(#[from] PackError),
    /// Transfer refused.
    #[error(transparent)]
    Transfer(#[from] TransferError),
    /// Filling refused.
    #[error(transparent)]
    Fill(#[from] FillError),
    /// The gutter could not be painted.
    #[error(transparent)]
    Gutter(#[from] TextureMismatch),
}

/// A textured mesh's layout and texture, and how they came about.
#[derive(Debug)]
pub struct TexInit {
    /// Where each triangle lies.
    pub layout: AtlasLayout,
    /// The pages. Sources name keyframes by [`crate::keyframe::KeyframeId`].
    pub texture: AtlasTexture,
    /// Which frame paints each triangle, as an index into the frames given.
    pub assignment: Assignment,
    /// How each stage went.
    pub report: TexInitReport,
}

/// How each stage went.
#[derive(Debug, Default)]
pub struct TexInitReport {
    /// Flattening.
    pub flatten: FlattenReport,
    /// Separation of overlaps.
    pub overlap: OverlapReport,
    /// Small charts joined to neighbours, and the charts that are left.
    pub absorb: AbsorbReport,
    /// Packing.
    pub pack: PackReport,
    /// Density that the images asked for, texels per metre; the layout has the one that fitted, or
    /// that of the paper's plates.
    pub wanted_texels_per_m: f64,
    /// How evenly texels lie on the surface.
    pub density_spread: DensitySpread,
    /// Colour transfer.
    pub transfer: TransferReport,
    /// Filling.
    pub fill: FillReport,
    /// Gutter.
    pub gutter: GutterReport,
}

/// The stages, in order; told to the observer as each begins, with its number of steps.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Stage {
    /// Charts and flattening.
    Flatten,
    /// Separation of overlaps.
    Overlap,
    /// Choice of frames: a step is a frame.
    Assign,
    /// Density and packing.
    Pack,
    /// Colour transfer: a step is a frame.
    Transfer,
    /// Filling and gutter.
    Fill,
}

impl Stage {
    /// Its name for people.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Flatten => "flatten charts",
            Self::Overlap => "separate overlaps",
            Self::Assign => "choose frames",
            Self::Pack => "pack pages",
            Self::Transfer => "transfer colour",
            Self::Fill => "fill and gutter",
        }
    }
}

/// Is told where TexInit is; must not influence it.
pub trait Observer: Sync {
    /// A stage begins, and the one before it has ended.
    fn begin(&self, stage: Stage, num_steps: usize);
    /// Some steps are done.
    fn advance(&self, num_steps: usize);
}

/// Decodes a keyframe; called from many threads.
pub type Decode<'a> = dyn Fn(&Keyframe) -> Result<Arc<DecodedFrame>, ImageError> + Sync + 'a;

/// Textures `mesh` from `frames`.
///
/// # Errors
/// [`TexInitError`] for a parameter out of range or a mesh too large for its texel budget. A frame
/// that does not decode is no error: it is counted in the report.
pub fn texinit(
    mesh: &TriMesh,
    frames: &[Arc<Keyframe>],
    decode: &Decode<'_>,
    params: &TexInitParams,
    observer: &dyn Observer,
) -> Result<TexInit, TexInitError> {
    let advance = |num_steps: usize| observer.advance(num_steps);

    observer.begin(Stage::Flatten, 0);
    let flat = flatten::flatten(mesh, &params.flatten)?;

    observer.begin(Stage::Overlap, 0);
    let (charts, overlap_report) = overlap::separate(mesh, flat.charts, &params.overlap);
    let (charts, absorb_report) = flatten::absorb(mesh, &flat.manifold, charts, &params.flatten);

    observer.begin(Stage::Assign, frames.len());
    let mut assignment = assign::assign(mesh, frames, decode, &params.assign, &advance)?;

    observer.begin(Stage::Pack, 0);
    let wanted_texels_per_m =
        density::wanted_texels_per_m(mesh, &assignment.best_texels_per_m, &params.density);
    let (layout, pack_report) = place(mesh, &charts, frames, wanted_texels_per_m, params)?;
    let density_spread = DensitySpread::of(mesh, &layout);
    drop(charts);
    if params.coupling == Coupling::Chart {
        assignment = assigned(mesh, &layout, frames, decode, params, observer)?;
    }

    let painted = paint(mesh, &layout, &assignment, frames, decode, params, observer)?;

    Ok(TexInit {
        layout,
        texture: painted.texture,
        assignment,
        report: TexInitReport {
            flatten: flat.report,
            overlap: overlap_report,
            absorb: absorb_report,
            pack: pack_report,
            wanted_texels_per_m,
            density_spread,
            transfer: painted.transfer,
            fill: painted.fill,
            gutter: painted.gutter,
        },
    })
}

/// A texture on a layout that was there before, and how it came about.
#[derive(Debug)]
pub struct Repainted {
    /// The pages. Sources name keyframes by [`crate::keyframe::KeyframeId`].
    pub texture: AtlasTexture,
    /// Which frame paints each triangle, as an index into the frames given.
    pub assignment: Assignment,
    /// Colour transfer.
    pub transfer: TransferReport,
    /// Filling.
    pub fill: FillReport,
    /// Gutter.
    pub gutter: GutterReport,
}

/// Textures `mesh` anew on a layout made before: for other poses or colours of its frames.
///
/// # Errors
/// [`TexInitError`] for a parameter out of range or a layout of another mesh. A frame that does not
/// decode is no error: it is counted in the report.
pub fn repaint(
    mesh: &TriMesh,
    layout: &AtlasLayout,
    frames: &[Arc<Keyframe>],
    decode: &Decode<'_>,
    params: &TexInitParams,
    observer: &dyn Observer,
) -> Result<Repainted, TexInitError> {
    let assignment = assigned(mesh, layout, frames, decode, params, observer)?;
    let painted = paint(mesh, layout, &assignment, frames, decode, params, observer)?;
    Ok(Repainted {
        texture: painted.texture,
        assignment,
        transfer: painted.transfer,
        fill: painted.fill,
        gutter: painted.gutter,
    })
}

/// Which frame paints which triangle of a layout.
fn assigned(
    mesh: &TriMesh,
    layout: &AtlasLayout,
    frames: &[Arc<Keyframe>],
    decode: &Decode<'_>,
    params: &TexInitParams,
    observer: &dyn Observer,
) -> Result<Assignment, AssignError> {
    observer.begin(Stage::Assign, frames.len());
    let advance = |num_steps: usize| observer.advance(num_steps);
    match params.coupling {
        Coupling::Scan => assign::assign(mesh, frames, decode, &params.assign, &advance),
        Coupling::Chart => {
            assign::assign_in_charts(mesh, layout, frames, decode, &params.assign, &advance)
        }
    }
}

struct Painted {
    texture: AtlasTexture,
    transfer: TransferReport,
    fill: FillReport,
    gutter: GutterReport,
}

/// Transfer, fill and gutter.
fn paint(
    mesh: &TriMesh,
    layout: &AtlasLayout,
    assignment: &Assignment,
    frames: &[Arc<Keyframe>],
    decode: &Decode<'_>,
    params: &TexInitParams,
    observer: &dyn Observer,
) -> Result<Painted, TexInitError> {
    let advance = |num_steps: usize| observer.advance(num_steps);
    observer.begin(Stage::Transfer, assignment.report.num_frames_used);
    let (mut texture, transfer) = transfer::transfer(
        mesh,
        layout,
        assignment,
        frames,
        decode,
        &params.transfer,
        &advance,
    )?;

    observer.begin(Stage::Fill, 0);
    let fill = fill::fill_unseen(mesh, layout, &mut texture, &params.fill)?;
    let gutter = if params.has_gutters {
        atlas::gutter::dilate_gutters(layout, &mut texture)?
    } else {
        GutterReport::default()
    };
    Ok(Painted {
        texture,
        transfer,
        fill,
        gutter,
    })
}

fn place(
    mesh: &TriMesh,
    charts: &[FlatChart],
    frames: &[Arc<Keyframe>],
    wanted_texels_per_m: f64,
    params: &TexInitParams,
) -> Result<(AtlasLayout, PackReport), PackError> {
    let num_triangles = mesh.num_triangles();
    match params.size_rule {
        SizeRule::Density => {
            atlas::pack_to_budget(charts, num_triangles, wanted_texels_per_m, &params.pack)
        }
        SizeRule::Paper => {
            let sizes = frames.iter().map(|frame| {
                let pinhole = &frame.color_camera.pinhole;
                pinhole.width().max(pinhole.height())
            });
            let side_texel = density::paper_plate_texel(sizes.max().unwrap_or(0));
            atlas::pack_plates(charts, num_triangles, side_texel, &params.pack)
        }
    }
}
