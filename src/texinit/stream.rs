//! TexInit kept up while a scan changes: the cost follows the change.
//!
//! [`StreamInit::update`] is told what there is now, mesh and keyframes, finds what changed since
//! the last time, and redoes what depends on it:
//!
//! 1. [`mod@crate::mesh::diff`]: triangles kept, moved, changed, new and gone. A chart that lost one is
//!    taken apart, a small one beside changed surface too; what has no chart then is flattened, separated,
//!    absorbed and packed among itself. Other charts keep their place in the atlas, and their triangles
//!    and vertices what is known of them; where vertices moved they are scored and painted anew.
//! 2. Scores: a new keyframe is scored against the triangles that it may see, a new or moved triangle
//!    against the keyframes that may see it, and where changed surface may hide or uncover others in a
//!    keyframe, these are scored in it anew; triangles whose chart is made anew keep their scores. A
//!    keyframe whose pose was corrected goes and comes. The depths that keyframes see are kept as far as
//!    there is memory ([`StreamParams::view_cache_mb`]), and changed surface is drawn into them.
//! 3. Labels of charts with new scores, each by itself ([`super::Coupling::Chart`]).
//! 4. Texels of triangles whose frame, place or visibility changed. Means over frames are kept as exact
//!    sums, to which a new keyframe adds; where it adds nothing nothing is written.
//! 5. Unseen regions ([`super::fill`]) beside changed texels, and the gutters of charts with any.
//!
//! **Equality**: without [`StreamParams::hysteresis`] labels and texels are, to the last byte, what
//! [`super::repaint`] makes of [`StreamInit::mesh`], [`StreamInit::layout`] and the keyframes that are taken in, with
//! [`super::Coupling::Chart`]; the way there leaves its trace in the layout alone. With hysteresis it does in the
//! labels too, which are then worth less by at most that times the triangles; texels are what the labels say.
//!
//! The mesh is that of the caller with its vertices on a fine grid ([`DiffParams::quantum_m`]) and its
//! triangles in the order of the charts. The density is fixed when the first triangle is seen, in
//! steps of a quarter octave; it falls only when the scan outgrows the budget of texels: then all
//! charts are laid and painted anew, with the scores and labels that they have.
//!
//! Memory, [`StreamInit::num_bytes`]: 8 bytes per texel of the pages, 16 per triangle and keyframe that
//! may paint it, 16 per texel that shows a mean, 8 per texel of a gutter, some 400 per triangle, 20 kB per
//! keyframe, and the depths that are kept.

mod budget;
mod charts;
mod cover;
mod inherit;
mod keyframes;
mod labels;
mod placing;
mod repaint;
mod scores;
mod surface;
mod unseen;
mod view;
mod views;
mod workspaces;

use std::sync::Arc;

use crate::atlas::{AtlasLayout, AtlasTexture, ChartKey, ChartPlacer, PackError, TexelRect};
use crate::keyframe::Keyframe;
use crate::mesh::{DiffCounts, DiffError, DiffParams, TrackedMesh, TriMesh, TriangleId};
use crate::render::{MeshRuns, VisibilityParams};

use super::assign::cues::FrameWorkspace;
use super::assign::{AssignError, Assignment, ColorCue, FailedFrame, chart_table};
use super::density::SizeRule;
use super::fill::LentColours;
use super::flatten::FlattenError;
use super::transfer::{MAX_FRAMES_IN_ANY_ORDER, MeanForm, PaintBuffers};
use super::{Coupling, Decode, Observer, Stage, TexInitParams};
use budget::Held;
use charts::StreamChart;
use keyframes::KnownFrames;
use unseen::JoinedVertices;
use views::{Drawing, KeptViews};
use workspaces::Workspaces;

pub use charts::StreamChartId;

/// How the state is kept up.
#[derive(Clone, Debug, PartialEq)]
pub struct StreamParams {
    /// When triangles are the same.
    pub diff: DiffParams,
    /// A chart whose vertices may have moved this far since it was flattened is made anew, metres.
    pub max_drift_m: f64,
    /// Charts of fewer triangles beside changed surface are made anew with it.
    pub remake_below_triangles: usize,
    /// How much better others must score, per triangle, before a patch's frame is given up for them (≥ 0).
    /// More than 0 makes labels depend on those before: those of a chart are then worth less than the best by
    /// at most this times its triangles.
    pub hysteresis: f32,
    /// Side of the pages, at most that of [`crate::atlas::PackParams`].
    pub page_size_texel: u32,
    /// Pages are compacted while charts hold less than this share of them, [0, 1].
    pub min_used_share: f64,
    /// Memory for the depths that keyframes see, MB (10⁶ bytes, ≥ 0).
    pub view_cache_mb: f64,
    /// New keyframes that an update takes in at most; the others wait for the next. 0 for no limit.
    pub max_new_frames: usize,
    /// New keyframes that see little unpainted surface wait until there are so many, for at most as many
    /// updates; 1 for none to wait.
    pub batch_frames: usize,
    /// A keyframe does not wait where more than this share of the triangles in its view is unpainted, [0, 1];
    /// but for those that several keyframes looked for in vain.
    pub urgent_share: f64,
}

impl Default for StreamParams {
    fn default() -> Self {
        Self {
            diff: DiffParams::default(),
            max_drift_m: 0.05,
            remake_below_triangles: 100,
            hysteresis: 0.1,
            page_size_texel: 2048,
            min_used_share: 0.5,
            max_new_frames: 32,
            batch_frames: 6,
            urgent_share: 0.1,
            view_cache_mb: 256.0,
        }
    }
}

/// Why the state was not kept up. It is empty afterwards; the next update makes all anew.
#[derive(Debug, thiserror::Error)]
pub enum StreamError {
    /// A setting that only the whole scan at once can have.
    #[error("{0} cannot be kept up while a scan changes")]
    Unsupported(&'static str),
    /// The mesh could not be compared.
    #[error(transparent)]
    Diff(#[from] DiffError),
    /// Flattening refused.
    #[error(transparent)]
    Flatten(#[from] FlattenError),
    /// Assignment refused.
    #[error(transparent)]
    Assign(#[from] AssignError),
    /// Packing refused.
    #[error(transparent)]
    Pack(#[from] PackError),
    /// Keyframes are not in the order of their numbers.
    #[error("keyframe {0} does not come after the one before it")]
    FrameOrder(u32),
    /// More keyframes than sums have room for.
    #[error("{0} keyframes are more than {MAX_FRAMES_IN_ANY_ORDER}")]
    TooManyFrames(usize),
}

/// What an update changed.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct StreamUpdate {
    /// Triangles of the mesh.
    pub mesh: DiffCounts,
    /// Keyframes that came.
    pub num_frames_added: usize,
    /// New keyframes that wait for another update.
    pub num_frames_waiting: usize,
    /// Keyframes that went.
    pub num_frames_removed: usize,
    /// Keyframes whose pose was corrected.
    pub num_frames_moved: usize,
    /// Charts that were not there before, ascending.
    pub new_charts: Vec<StreamChartId>,
    /// Charts with other texels, vertices or place than before, ascending.
    pub changed_charts: Vec<StreamChartId>,
    /// Charts that are no more, ascending.
    pub gone_charts: Vec<StreamChartId>,
    /// Where texels changed: page and rectangle, by chart. What gone charts left is blank and not among
    /// them.
    pub dirty_rects: Vec<(u32, TexelRect)>,
    /// Whether a page was emptied and closed, or all charts were made anew at a lower density.
    pub has_new_pages: bool,
    /// (chart, keyframe) pairs that were scored.
    pub num_pairs_scored: usize,
    /// Triangles whose texels were painted.
    pub num_triangles_painted: usize,
}

impl StreamUpdate {
    /// Whether charts or texels are others than before.
    pub fn has_changes(&self) -> bool {
        let lists = [&self.new_charts, &self.changed_charts, &self.gone_charts];
        let has_charts = lists.iter().any(|list| !list.is_empty());
        has_charts || !self.dirty_rects.is_empty() || self.has_new_pages
    }
}

/// A textured scan that is kept up.
#[derive(Debug)]
pub struct StreamInit {
    params: TexInitParams,
    stream: StreamParams,
    /// The mesh as it is given.
    tracked: TrackedMesh,
    mesh: Arc<TriMesh>,
    runs: MeshRuns,
    /// Of [`TrackedMesh::num_renumberings`], when the mesh was listed.
    num_renumberings: usize,
    /// What unseen regions were filled with.
    lent: LentColours,
    /// Of those who look for unseen regions.
    joined_vertices: JoinedVertices,
    layout: Arc<AtlasLayout>,
    texture: AtlasTexture,
    /// Ascending by id, in the order of the layout.
    charts: Vec<StreamChart>,
    next_chart: u64,
    /// None until there are charts.
    placer: Option<ChartPlacer>,
    /// Whether the density comes from the images and stays.
    has_density: bool,
    frames: KnownFrames,
    held: Held,
    views: KeptViews,
    /// Of these, at most.
    max_view_bytes: usize,
    /// Of those who score.
    workspaces: Workspaces<FrameWorkspace>,
    /// Of those who paint.
    buffers: PaintBuffers,
}

impl StreamInit {
    /// An empty scan.
    ///
    /// # Errors
    /// [`StreamError`] for settings that cannot be kept up, or are out of range.
    pub fn new(params: &TexInitParams, stream: &StreamParams) -> Result<Self, StreamError> {
        if params.size_rule != SizeRule::Density {
            return Err(StreamError::Unsupported("the paper's plates"));
        }
        if params.transfer.mean_form != MeanForm::Seeing {
            return Err(StreamError::Unsupported("a mean over all frames"));
        }
        if params.assign.color_cue == ColorCue::ValidAtVertex {
            return Err(AssignError::CoupledAtVertices.into());
        }
        params.assign.check()?;
        let mesh = TriMesh::default();
        Ok(Self {
            runs: MeshRuns::new(&mesh),
            num_renumberings: 0,
            lent: LentColours::default(),
            joined_vertices: JoinedVertices::default(),
            layout: Arc::new(charts::empty_layout()),
            tracked: TrackedMesh::new(&stream.diff)?,
            mesh: Arc::new(mesh),
            texture: AtlasTexture::default(),
            charts: Vec::new(),
            next_chart: 0,
            placer: None,
            has_density: false,
            frames: KnownFrames::default(),
            held: Held::default(),
            views: KeptViews::default(),
            max_view_bytes: whole_bytes(stream.view_cache_mb),
            workspaces: Workspaces::default(),
            buffers: PaintBuffers::default(),
            params: TexInitParams {
                coupling: Coupling::Chart,
                ..params.clone()
            },
            stream: stream.clone(),
        })
    }

    /// Brings the state up to a mesh and keyframes, ascending by id. The images of a keyframe
    /// never change; its pose may. Where some wait ([`StreamParams::batch_frames`],
    /// [`StreamParams::max_new_frames`]), the same call once more takes in others, until
    /// [`StreamUpdate::num_frames_waiting`] is 0.
    ///
    /// # Errors
    /// [`StreamError`]. A frame that does not decode is no error: it paints nothing
    /// ([`Self::failed_frames`]).
    pub fn update(
        &mut self,
        mesh: &Arc<TriMesh>,
        frames: &[Arc<Keyframe>],
        decode: &Decode<'_>,
        observer: &dyn Observer,
    ) -> Result<StreamUpdate, StreamError> {
        let updated = self.try_update(mesh, frames, decode, observer);
        if updated.is_err() {
            self.clear();
        }
        updated
    }

    fn try_update(
        &mut self,
        mesh: &Arc<TriMesh>,
        frames: &[Arc<Keyframe>],
        decode: &Decode<'_>,
        observer: &dyn Observer,
    ) -> Result<StreamUpdate, StreamError> {
        check_frames(frames)?;
        let mut update = StreamUpdate::default();

        observer.begin(Stage::Flatten, 0);
        let mut change = self.take_mesh(mesh, &mut update)?;
        let loose = self.flatten_loose(&change)?;

        observer.begin(Stage::Pack, 0);
        self.place_loose(loose, &mut change, frames, decode, &mut update)?;
        self.compact(&mut change, &mut update);
        self.lay_out(&mut change);

        let (frames, num_waiting) = self.taken_in(frames, &change.dirt, !update.mesh.is_same());
        let frames = &*frames;
        update.num_frames_waiting = num_waiting;
        observer.begin(Stage::Assign, frames.len());
        let turnover = self.take_frames(frames, &mut change, &mut update);
        let mut views = self.views.take(
            frames,
            &turnover,
            &self.params.transfer.visibility,
            self.usable_view_bytes(),
        );
        self.score(
            frames,
            &turnover,
            &mut change,
            &mut views,
            decode,
            observer,
            &mut update,
        );
        let relabelled = self.label();

        observer.begin(Stage::Transfer, frames.len());
        let mut repainted = self.repaint(
            frames,
            &turnover,
            &change,
            &relabelled,
            &mut views,
            decode,
            observer,
            &mut update,
        );

        self.views.put_back(frames, views);

        observer.begin(Stage::Fill, 0);
        self.fill_beside(&change, &mut repainted);
        self.dilate(&change, &repainted);
        self.tell(&change, &repainted.is_chart, &mut update);
        Ok(update)
    }

    /// How deep a keyframe looks, for scores or for means, metres.
    fn far_m(&self) -> f64 {
        let params = &self.params;
        params.assign.far_m().max(params.transfer.far_m())
    }

    /// Whether how far keyframes see is kept: one drawing must tell it for scores and for means.
    fn has_bounds(&self) -> bool {
        let means = &self.params.transfer.visibility;
        let scores = self.params.assign.visibility.as_ref();
        scores.is_some_and(|scores| scores.max_width_px == means.max_width_px)
    }

    /// Bytes for views that are kept: one must do for scores and for means.
    fn usable_view_bytes(&self) -> usize {
        let is_same_depth = self.params.assign.far_m() == self.params.transfer.far_m();
        if self.has_bounds() && is_same_depth {
            self.max_view_bytes
        } else {
            0
        }
    }

    /// What views are drawn from.
    fn drawing(&self) -> Drawing<'_> {
        Drawing {
            mesh: &self.mesh,
            runs: &self.runs,
            far_m: self.far_m(),
        }
    }

    /// Visibility for scores or for means, whichever sees more.
    fn view_params(&self) -> VisibilityParams {
        let means = &self.params.transfer.visibility;
        let Some(scores) = self.params.assign.visibility.clone() else {
            return VisibilityParams {
                far_m: self.far_m(),
                ..means.clone()
            };
        };
        VisibilityParams {
            tolerance_m: scores.tolerance_m.max(means.tolerance_m),
            relative_tolerance: scores.relative_tolerance.max(means.relative_tolerance),
            edge_margin_px: scores.edge_margin_px.max(means.edge_margin_px),
            far_m: self.far_m(),
            ..scores
        }
    }

    /// Forgets all.
    fn clear(&mut self) {
        self.tracked.clear();
        self.mesh = Arc::default();
        self.runs = MeshRuns::new(&self.mesh);
        self.charts.clear();
        self.layout = Arc::new(charts::empty_layout());
        self.texture = AtlasTexture::default();
        self.placer = None;
        self.has_density = false;
        self.frames = KnownFrames::default();
        self.held = Held::default();
        self.views = KeptViews::default();
        self.lent.forget();
    }

    /// The mesh, in the order of the charts.
    pub fn mesh(&self) -> &Arc<TriMesh> {
        &self.mesh
    }

    /// The mesh, where its triangles lie, and the pages; all else is forgotten.
    pub fn into_parts(self) -> (TriMesh, AtlasLayout, AtlasTexture) {
        (
            Arc::unwrap_or_clone(self.mesh),
            Arc::unwrap_or_clone(self.layout),
            self.texture,
        )
    }

    /// Where its triangles lie.
    pub fn layout(&self) -> &Arc<AtlasLayout> {
        &self.layout
    }

    /// The pages.
    pub fn texture(&self) -> &AtlasTexture {
        &self.texture
    }

    /// The charts of the layout, by their lasting names.
    pub fn chart_ids(&self) -> impl Iterator<Item = StreamChartId> {
        self.charts.iter().map(|chart| chart.id)
    }

    /// What stands for the charts of the layout.
    pub fn chart_keys(&self) -> Vec<ChartKey> {
        self.charts.iter().filter_map(|chart| chart.key).collect()
    }

    /// Which keyframe paints each triangle; labels are the numbers of keyframes
    /// ([`crate::keyframe::KeyframeId`]), not indices.
    pub fn assignment(&self) -> Assignment {
        let charts = self.charts.iter();
        let parts = charts.map(|chart| (&*chart.piece.chart.triangles, chart.labels.assignment()));
        let mut all = chart_table::joined(&self.mesh, parts, self.failed_frames());
        all.report.num_frames = self.frames.num_usable();
        all
    }

    /// Which keyframe paints a triangle, by number.
    pub fn label_of(&self, triangle: TriangleId) -> Option<u32> {
        let chart = self.layout.chart_of_triangle.get(triangle.index())?;
        let chart = &self.charts[chart.index()];
        chart.labels.assignment().label[triangle.index() - chart.first_triangle()]
    }

    /// [`Self::label_of`] for all triangles.
    pub fn labels(&self) -> Vec<Option<u32>> {
        let charts = self.charts.iter();
        let labels = charts.flat_map(|chart| chart.labels.assignment().label.iter().copied());
        labels.collect()
    }

    /// Keyframes that could not be used, by number.
    pub fn failed_frames(&self) -> Vec<FailedFrame> {
        self.frames.failed()
    }

    /// Share of the pages that charts hold; 1 without a page.
    pub fn used_share(&self) -> f64 {
        self.placer.as_ref().map_or(1.0, ChartPlacer::used_share)
    }

    /// Keeps at most so many bytes of depths; what is painted does not depend on it.
    pub fn set_view_bytes(&mut self, max_bytes: usize) {
        self.max_view_bytes = max_bytes;
    }

    /// Bytes that pages, scores and sums take.
    pub fn num_bytes(&self) -> usize {
        let pages = self.texture.pages.iter().map(|page| 8 * page.srgb.len());
        let charts = self.charts.iter().map(StreamChart::num_bytes);
        pages.sum::<usize>()
            + charts.sum::<usize>()
            + self.frames.num_bytes()
            + self.views.num_bytes()
    }

    /// Names what the update changed, for those who publish it.
    fn tell(&self, change: &surface::SurfaceChange, repainted: &[bool], update: &mut StreamUpdate) {
        for ((chart, dirt), is_repainted) in self.charts.iter().zip(&change.dirt).zip(repainted) {
            if dirt.is_fresh {
                update.new_charts.push(chart.id);
            } else if *is_repainted || dirt.is_moved() || dirt.is_relaid || dirt.is_renumbered {
                update.changed_charts.push(chart.id);
            }
            if *is_repainted || dirt.is_renumbered {
                let placed = &chart.piece.chart;
                update.dirty_rects.push((placed.page, placed.rect));
            }
        }
    }
}

#[expect(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "float to int casts saturate, as meant for a limit"
)]
fn whole_bytes(megabytes: f64) -> usize {
    (1e6 * megabytes) as usize
}

fn check_frames(frames: &[Arc<Keyframe>]) -> Result<(), StreamError> {
    if frames.len() > MAX_FRAMES_IN_ANY_ORDER {
        return Err(StreamError::TooManyFrames(frames.len()));
    }
    match frames.windows(2).find(|pair| pair[0].id >= pair[1].id) {
        Some(pair) => Err(StreamError::FrameOrder(pair[1].id.0)),
        None => Ok(()),
    }
}

#[cfg(test)]
mod tests;
