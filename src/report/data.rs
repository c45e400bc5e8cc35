//! The numbers of a run, as `report.json` has them.
//!
//! Lengths in metres, times in seconds, shares in [0, 1]. What was not measured is `null`.

use serde::Serialize;

use super::repairs::Repair;

/// Everything that is said of one run.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct Report {
    /// Program and version.
    pub generator: String,
    /// What to call the scan: the bag's name.
    pub title: String,
    /// Sentences for a person: what went wrong, what to look at.
    pub notes: Vec<Note>,
    /// What was read.
    pub source: SourceSummary,
    /// Messages and frames on their way through, in the order of the way.
    pub counts: Vec<Count>,
    /// What was left out, and why.
    pub drops: Vec<Drop>,
    /// Wall time per stage, in order.
    pub stages: Vec<Stage>,
    /// Wall time of the whole run.
    pub total_s: f64,
    /// Threads that the compute stages had.
    pub num_threads: usize,
    /// Largest resident size of the process.
    pub peak_memory_bytes: Option<u64>,
    /// The mesh that was painted.
    pub mesh: MeshSummary,
    /// Its charts.
    pub charts: ChartSummary,
    /// The atlas.
    pub atlas: AtlasSummary,
    /// How much of the surface was painted, and from what.
    pub coverage: CoverageSummary,
    /// How fine the photos were on the surface.
    pub density: Option<DensitySummary>,
    /// The frames that were kept.
    pub keyframes: Vec<KeyframeRow>,
    /// Views of the result beside photos.
    pub views: Vec<ViewScore>,
    /// Gains and seams; `None` where neither was asked for.
    pub refine: Option<RefineSummary>,
    /// How the optimisation went, where there was one.
    pub texsmooth: Option<SmoothSummary>,
    /// Against a known texture, where there is one.
    pub synthetic: Option<SyntheticScore>,
    /// Every parameter as it was used.
    pub parameters: serde_json::Value,
}

/// What gains and seam levelling did; numbers are of linear light.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct RefineSummary {
    /// Gains of keyframes, where they were asked for.
    pub gain: Option<GainSummary>,
    /// Poses of keyframes, where they were corrected.
    pub pose: Option<PoseSummary>,
    /// Seams, where they were levelled.
    pub seams: Option<SeamSummary>,
}

/// Poses of keyframes, round by round.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct PoseSummary {
    /// Mean difference of photos and renderings before the first round and after each, 0-255.
    pub residual_255: Vec<f64>,
    /// Mean offset then, pixels.
    pub offset_px: Vec<f64>,
    /// Keyframes that were turned.
    pub num_turned: usize,
    /// Keyframes whose offset could not be told at first.
    pub num_unknown: usize,
    /// Keyframes that were put back.
    pub num_put_back: usize,
    /// The largest turn.
    pub max_turn_rad: f64,
    /// Wall time.
    pub seconds: f64,
}

/// Gains of keyframes.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct GainSummary {
    /// Points of the surface that two keyframes or more see.
    pub num_points: usize,
    /// Their colours that were compared.
    pub num_samples: usize,
    /// Keyframes that share no point with another.
    pub num_unlinked: usize,
    /// Median absolute difference of log light between keyframes before.
    pub median_before: f64,
    /// The same after.
    pub median_after: f64,
    /// Smallest and largest factor.
    pub factor_range: [f32; 2],
    /// Keyframe, and its factors for red, green and blue.
    pub factors: Vec<(u32, [f32; 3])>,
    /// Wall time, seconds.
    pub seconds: f64,
}

/// Levelled seams.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct SeamSummary {
    /// Edges between two keyframes.
    pub num_seams: usize,
    /// Corrections that were solved for.
    pub num_unknowns: usize,
    /// Steps of the solver.
    pub num_solver_steps: usize,
    /// Mean absolute step at them before.
    pub step_before: f64,
    /// After levelling over regions.
    pub step_after_global: f64,
    /// After all.
    pub step_after: f64,
    /// Texels that changed.
    pub num_changed_texels: usize,
    /// Wall time, seconds.
    pub seconds: f64,
}

/// How TexSmooth went.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct SmoothSummary {
    /// Steps done.
    pub num_steps: usize,
    /// Steps whose crop showed nothing.
    pub num_empty: usize,
    /// Steps whose view was its own partner.
    pub num_self_partnered: usize,
    /// Steps at which the discriminator learnt.
    pub num_critic_steps: usize,
    /// Whether the time budget ended it.
    pub is_cut_short: bool,
    /// What the discriminator ran on.
    pub backend: String,
    /// Wall time.
    pub seconds: f64,
    /// Texels that changed.
    pub num_texels: u64,
    /// Steps that each of them made, on average.
    pub num_steps_per_texel: f64,
    /// Share of the photos' patches whose offset from the rendering is trusted.
    pub aligned_share: f64,
    /// Mean length of those offsets, pixels.
    pub mean_offset_px: f64,
    /// The longest of them, pixels.
    pub max_offset_px: f64,
    /// Losses by stretches of the run.
    pub losses: Vec<LossRow>,
}

/// Mean losses over a stretch of the optimisation.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct LossRow {
    /// Its last step.
    pub step: usize,
    /// Mean absolute difference of rendering and target on the scale of [-1, 1].
    pub l1: f32,
    /// -log D of the rendering.
    pub adversarial: f32,
    /// -log D of the partner's projection.
    pub real: f32,
    /// -log(1 - D) of the rendering.
    pub fake: f32,
}

/// How much a note matters.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Severity {
    /// Good to know.
    Info,
    /// The result is worse for it.
    Warning,
    /// Something is missing for it.
    Problem,
}

/// A sentence for a person.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct Note {
    /// How much it matters.
    pub severity: Severity,
    /// The sentence, in plain words.
    pub text: String,
}

/// What was read.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct SourceSummary {
    /// The bag, as it was named.
    pub path: String,
    /// Its size.
    pub num_bytes: u64,
    /// From its first message to its last.
    pub duration_s: f64,
    /// The topics, used or not.
    pub topics: Vec<TopicRow>,
    /// What could not be read, in sentences.
    pub losses: Vec<String>,
}

/// One topic of the recording.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct TopicRow {
    /// Its name.
    pub topic: String,
    /// Its message type.
    pub type_name: String,
    /// What it was used as; `None` when it was not.
    pub role: Option<String>,
    /// Messages read.
    pub num_messages: u64,
    /// Messages per second of recording.
    pub rate_hz: Option<f64>,
}

/// A named number.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize)]
pub struct Count {
    /// What was counted.
    pub name: String,
    /// How many.
    pub value: u64,
}

impl Count {
    /// `value` of `name`.
    pub fn new(name: impl Into<String>, value: u64) -> Self {
        Self {
            name: name.into(),
            value,
        }
    }
}

/// Things that were left out for one reason.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize)]
pub struct Drop {
    /// Where: a topic or a stage.
    pub at: String,
    /// Why.
    pub reason: String,
    /// How many.
    pub count: u64,
}

/// Wall time of one stage.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct Stage {
    /// Its name.
    pub name: String,
    /// Wall time.
    pub seconds: f64,
}

/// The mesh that was painted.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct MeshSummary {
    /// Vertices.
    pub num_vertices: usize,
    /// Triangles.
    pub num_triangles: usize,
    /// Surface, in m².
    pub area_m2: f64,
    /// Extent along x, y and z.
    pub size_m: [f64; 3],
    /// What else is known of it: components, boundary edges …
    pub details: Vec<Count>,
    /// What was wrong with it, by kind, and what was done about it.
    pub repairs: Vec<Repair>,
}

/// The charts.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct ChartSummary {
    /// How many.
    pub num_charts: usize,
    /// Triangles in the middle one, by count.
    pub median_triangles: usize,
    /// Triangles in the largest.
    pub max_triangles: usize,
    /// Quasi-conformal error (ratio of singular values, 1 is conformal), mean over area.
    pub quasi_conformal_mean: Option<f64>,
    /// Quasi-conformal error, worst triangle.
    pub quasi_conformal_max: Option<f64>,
    /// Smallest area in the atlas by area in space, 1 is none lost.
    pub area_ratio_min: Option<f64>,
    /// Largest area in the atlas by area in space.
    pub area_ratio_max: Option<f64>,
    /// L² stretch (Sander et al. 2001): root mean square over the surface, 1 is isometric.
    pub stretch_l2: Option<f64>,
    /// L∞ stretch: the most that the texture is pulled apart anywhere.
    pub stretch_linf: Option<f64>,
    /// Length of edges whose two triangles lie apart in the atlas.
    pub seam_length_m: Option<f64>,
    /// What else is known of them: cut, split, fallen back …
    pub details: Vec<Count>,
}

/// The atlas.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct AtlasSummary {
    /// Pages.
    pub num_pages: usize,
    /// Width and height of each in texels.
    pub page_size_texel: [u32; 2],
    /// Texels per metre of surface.
    pub texels_per_m: f64,
    /// Share of all texels that a triangle covers.
    pub used_share: f64,
    /// Share of all texels that are gutter.
    pub gutter_share: f64,
    /// Share of all texels that belong to a chart, its gutter included: no other may use them.
    pub footprint_share: f64,
    /// Texels per square metre of surface: a twentieth of the triangles has less, a twentieth has
    /// more.
    pub texels_per_m2_by_triangle: [f64; 2],
    /// The same of the surface's area.
    pub texels_per_m2_by_area: [f64; 2],
    /// Share of the triangles that are smaller than a texel.
    pub subtexel_share: f64,
}

/// Where the covered texels' colours came from; the first four add up to the used texels.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct CoverageSummary {
    /// Covered texels.
    pub num_texels: u64,
    /// Share copied from a keyframe.
    pub keyframe_share: f64,
    /// Share from the mean of the frames that see the point.
    pub mean_share: f64,
    /// Share spread from neighbours, seen by no frame.
    pub diffused_share: f64,
    /// Share of the surface without a painted texel.
    pub unpainted_area_share: f64,
    /// Mean confidence of covered texels, in [0, 1].
    pub mean_confidence: f64,
}

/// Resolution of the best photo of each triangle, weighted by area, in pixels per metre.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct DensitySummary {
    /// A tenth of the seen surface is coarser.
    pub p10_px_per_m: f64,
    /// Half of it is coarser.
    pub p50_px_per_m: f64,
    /// A tenth of it is finer.
    pub p90_px_per_m: f64,
}

/// One kept frame.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct KeyframeRow {
    /// Its number, as in `provenance/`.
    pub id: u32,
    /// When it was taken, seconds since the recording's first message.
    pub time_s: f64,
    /// Where the camera was.
    pub position_m: [f64; 3],
    /// Where it looked, a unit vector.
    pub direction: [f64; 3],
    /// Sharpness, as the keyframe selection measures it.
    pub sharpness: f32,
    /// Mean luma in [0, 1].
    pub mean_luma: f32,
    /// Texels that it painted.
    pub num_texels: u64,
}

/// A rendering against its photo, over the pixels where the mesh is.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct ViewScore {
    /// Its name.
    pub name: String,
    /// When the photo was taken, nanoseconds.
    pub stamp_ns: i64,
    /// Whether the photo was kept from the texture.
    pub held_out: bool,
    /// Peak signal-to-noise ratio in dB; `null` when infinite or without pixels.
    pub psnr_db: Option<f64>,
    /// Structural similarity on RGB.
    pub ssim: Option<f64>,
    /// Mean absolute difference of a channel, 0–255.
    pub mean_abs: Option<f64>,
    /// Share of the picture where the mesh is.
    pub covered_share: f64,
}

/// The texture against the one that the scene was made with.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct SyntheticScore {
    /// Texels compared: those that some frame saw.
    pub num_texels: u64,
    /// Texels painted although no camera truly sees the surface there; not compared.
    pub num_hidden_texels: u64,
    /// Mean absolute difference of a channel, 0–255.
    pub mean_abs: f64,
    /// A tenth of the texels is further off than this, 0–255.
    pub p90_abs: f64,
    /// Share of the true surface that was painted.
    pub covered_share: f64,
}
