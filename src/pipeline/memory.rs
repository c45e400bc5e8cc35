//! One budget of bytes over all that a scan keeps in memory.
//!
//! | part | how it keeps to the budget |
//! |---|---|
//! | the process itself | reserved |
//! | encoded images | a share of the budget: the most redundant keyframe goes |
//! | atlas | a share of the budget, less what the optimisation works on: the density of texels is lowered |
//! | mesh, score tables | as large as mesh and frames make them; reserved |
//! | images with their gain | 3 % of the budget |
//! | what the optimisation works on | reserved, while painting follows changes; texels and views of the mesh are 3 % of the budget each at most |
//! | depths that keyframes see | a third of what the others leave, while painting follows changes |
//! | decoded images | the rest |
//!
//! The shares of images, atlas and optimisation depend on the settings alone, so that what is painted depends
//! on the events and the settings alone; depths and decoded images, whose number changes nothing, give way.

use super::run::PipelineParams;

/// The budget.
#[derive(Clone, Copy, Debug, PartialEq, Default)]
pub struct MemoryParams {
    /// Bytes for all parts together, MB (10⁶ bytes), ≥ 0; 0 leaves each part to its own limit.
    pub budget_mb: f64,
}

/// How the budget is divided, bytes.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default)]
pub struct MemoryPlan {
    /// All parts together; 0: no budget.
    pub budget: u64,
    /// The process without a scan.
    pub process: u64,
    /// Encoded images of keyframes.
    pub keyframes: u64,
    /// Texels of all pages, and what painting and exporting them takes.
    pub atlas: u64,
    /// Mesh, charts and score tables.
    pub tables: u64,
    /// Images with their gain.
    pub corrected: u64,
    /// Charts that the optimisation works on, what it looks at, and the discriminator, while painting
    /// follows changes.
    pub smoothing: u64,
    /// Depths that keyframes see, kept from update to update.
    pub kept_views: u64,
    /// Decoded images kept for reuse.
    pub decode_cache: u64,
}

impl MemoryPlan {
    /// All parts together.
    pub fn total(&self) -> u64 {
        let fixed = self.process + self.keyframes + self.atlas + self.tables + self.corrected;
        fixed + self.smoothing + self.kept_views + self.decode_cache
    }
}

/// Program, threads and libraries, with one frame in work on each of a few threads.
const PROCESS_BYTES: u64 = 60_000_000;
/// Encoded images may have this share of the budget.
const KEYFRAME_SHARE: f64 = 0.25;
/// The atlas may have this share of it.
const ATLAS_SHARE: f64 = 0.5;
/// It has at least this share, whatever else there is.
const LEAST_ATLAS_SHARE: f64 = 0.15;
/// Images with their gain may have this share of it.
const CORRECTED_SHARE: f64 = 0.03;
/// Scratch memory of those who paint what changed, kept from update to update.
const STREAM_BYTES: u64 = 80_000_000;
/// Reduced photos that idle steps keep.
const IDLE_BYTES: u64 = 16_000_000;
/// What the optimisation of some charts may have of the budget, once for their texels and once for what
/// views see of the mesh.
const SMOOTH_SHARE: f64 = 0.03;
/// The discriminator with its moments and scratch memory, and what a step looks at.
const SMOOTH_BYTES: u64 = 130_000_000;
/// A texel that the optimisation works on, in tiles that other charts share.
const SMOOTH_TEXEL_BYTES: f64 = 90.0;
/// A texel of the atlas, and the copy that an export or a change of its page makes.
const TEXEL_BYTES: f64 = 14.0;
/// The same texel as TexInit left it, where what is shown of changes is refined.
const BASE_TEXEL_BYTES: f64 = 8.0;
/// A triangle in mesh, adjacency, charts and per-triangle results.
const TRIANGLE_BYTES: u64 = 400;
/// A pair of frame and triangle in the score tables, times the share of such pairs there are.
const SCORED_PAIR_BYTES: f64 = 1.5;

impl MemoryParams {
    fn budget_bytes(&self) -> f64 {
        self.budget_mb * 1e6
    }

    /// What the atlas may have: the optimisation of what changed takes its part off that.
    fn atlas_bytes(&self, params: &PipelineParams) -> f64 {
        let share = ATLAS_SHARE * self.budget_bytes() - smoothing_bytes(params) as f64;
        share.max(LEAST_ATLAS_SHARE * self.budget_bytes())
    }

    /// The settings with the limits of images and atlas lowered to their shares.
    pub fn applied_to(&self, params: &PipelineParams) -> PipelineParams {
        let mut params = params.clone();
        if self.budget_mb > 0.0 {
            let keyframe = &mut params.keyframe;
            keyframe.budget_mb = keyframe.budget_mb.min(KEYFRAME_SHARE * self.budget_mb);
            if params.follows_changes() {
                let share_bytes = SMOOTH_SHARE * self.budget_bytes();
                let view_cache_mb = &mut params.texsmooth.view_cache_mb;
                *view_cache_mb = view_cache_mb.min(1e-6 * share_bytes);
                let most = bytes(share_bytes / SMOOTH_TEXEL_BYTES);
                let max_texels = &mut params.idle.max_texels;
                *max_texels = usize::try_from(most).map_or(*max_texels, |n| n.min(*max_texels));
            }
            let max_texels = bytes(self.atlas_bytes(&params) / texel_bytes(&params));
            let pack = &mut params.texinit.pack;
            pack.max_texels = pack.max_texels.min(max_texels);
            let corrected_mb = CORRECTED_SHARE * self.budget_mb;
            params.refine.cache_mb = params.refine.cache_mb.min(corrected_mb);
        }
        params
    }

    /// How the budget is divided while a scan's size is not known.
    pub fn first_plan(&self, params: &PipelineParams) -> MemoryPlan {
        let keyframe = self.applied_to(params).keyframe;
        let num_bytes = usize::try_from(bytes(keyframe.budget_mb * 1e6)).unwrap_or(usize::MAX);
        self.plan(params, num_bytes, 0, 0)
    }

    /// How the budget is divided for a scan of this size.
    pub fn plan(
        &self,
        params: &PipelineParams,
        num_keyframe_bytes: usize,
        num_keyframes: usize,
        num_triangles: usize,
    ) -> MemoryPlan {
        let applied = self.applied_to(params);
        let atlas = bytes(applied.texinit.pack.max_texels as f64 * texel_bytes(params));
        let pairs = num_keyframes as f64 * num_triangles as f64;
        let refine = &applied.refine;
        let seams = &refine.seams;
        let is_idle_of_use = refine.has_pose || seams.has_global || seams.has_local;
        let process = PROCESS_BYTES
            + if params.follows_changes() {
                STREAM_BYTES
            } else {
                0
            }
            + if params.follows_changes() && is_idle_of_use {
                IDLE_BYTES
            } else {
                0
            };
        let mut plan = MemoryPlan {
            budget: bytes(self.budget_bytes()),
            process,
            corrected: if refine.has_gain {
                bytes(refine.cache_mb * 1e6)
            } else {
                0
            },
            keyframes: num_keyframe_bytes as u64,
            atlas,
            tables: num_triangles as u64 * TRIANGLE_BYTES + bytes(pairs * SCORED_PAIR_BYTES),
            smoothing: smoothing_bytes(&applied),
            kept_views: 0,
            decode_cache: 0,
        };
        plan.share_rest(params);
        plan
    }
}

impl MemoryPlan {
    /// The same once it is known how many texels the pages have, which may be far fewer than they may
    /// have.
    #[must_use]
    pub(super) fn with_pages(mut self, num_texels: usize, params: &PipelineParams) -> Self {
        let atlas = bytes(num_texels as f64 * texel_bytes(params));
        if num_texels > 0 {
            self.atlas = self.atlas.min(atlas);
        }
        self.share_rest(params);
        self
    }

    /// Divides what the fixed parts leave.
    fn share_rest(&mut self, params: &PipelineParams) {
        (self.kept_views, self.decode_cache) = (0, 0);
        let left = match self.budget {
            0 => u64::MAX,
            budget => budget.saturating_sub(self.total()),
        };
        if params.follows_changes() {
            self.kept_views = bytes(params.stream.view_cache_mb * 1e6).min(left / 3);
        }
        let wanted = bytes(params.keyframe.decode_cache_mb * 1e6);
        self.decode_cache = wanted.min(left - self.kept_views);
    }
}

fn texel_bytes(params: &PipelineParams) -> f64 {
    let seams = &params.refine.seams;
    let is_refined = seams.has_global || seams.has_local || params.texsmooth.num_steps > 0;
    let has_base = params.follows_changes() && is_refined;
    TEXEL_BYTES + if has_base { BASE_TEXEL_BYTES } else { 0.0 }
}

fn smoothing_bytes(params: &PipelineParams) -> u64 {
    let smooth = &params.texsmooth;
    if !params.follows_changes() || smooth.num_steps == 0 {
        return 0;
    }
    let texels = params.idle.max_texels as f64 * SMOOTH_TEXEL_BYTES;
    SMOOTH_BYTES + bytes(texels + smooth.view_cache_mb * 1e6)
}

#[expect(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "float to int casts saturate, as meant for a limit"
)]
fn bytes(number: f64) -> u64 {
    number as u64
}

#[cfg(test)]
mod tests {
    use super::super::StreamMode;
    use super::*;

    #[test]
    fn no_budget_changes_nothing() {
        let params = PipelineParams::default();
        let memory = MemoryParams { budget_mb: 0.0 };
        let applied = memory.applied_to(&params);
        assert_eq!(applied.keyframe, params.keyframe);
        assert_eq!(
            applied.texinit.pack.max_texels,
            params.texinit.pack.max_texels
        );
        let plan = memory.plan(&params, 1000, 3, 500);
        assert_eq!(plan.decode_cache, 700_000_000);
    }

    #[test]
    fn the_optimisation_has_its_part_where_painting_follows_changes() {
        let mut params = PipelineParams {
            stream_mode: StreamMode::Changes,
            ..PipelineParams::default()
        };
        let memory = MemoryParams { budget_mb: 1000.0 };
        let applied = memory.applied_to(&params);
        assert_eq!(applied.texsmooth.view_cache_mb, 30.0);
        let group_bytes = applied.idle.max_texels as f64 * SMOOTH_TEXEL_BYTES;
        assert!(group_bytes <= 30e6);
        let none = memory.plan(&params, 0, 0, 0);
        assert_eq!(none.smoothing, 0);
        params.texsmooth.num_steps = 1;
        let plan = memory.plan(&params, 0, 0, 0);
        assert_eq!(
            plan.smoothing,
            SMOOTH_BYTES + 30_000_000 + bytes(group_bytes)
        );
        assert_eq!(plan.total(), plan.budget);
        assert_eq!(texel_bytes(&params), TEXEL_BYTES + BASE_TEXEL_BYTES);
        params.stream_mode = StreamMode::Whole;
        assert_eq!(memory.plan(&params, 0, 0, 0).smoothing, 0);
        let whole = memory.applied_to(&params).texsmooth;
        assert_eq!(whole.view_cache_mb, params.texsmooth.view_cache_mb);
    }

    #[test]
    fn the_parts_keep_to_the_budget_while_mesh_and_images_leave_room() {
        for (budget_mb, follows_changes) in [200.0, 512.0, 1000.0, 4000.0]
            .into_iter()
            .flat_map(|budget_mb| [(budget_mb, false), (budget_mb, true)])
        {
            let params = PipelineParams {
                stream_mode: if follows_changes {
                    StreamMode::Changes
                } else {
                    StreamMode::Whole
                },
                ..PipelineParams::default()
            };
            let memory = MemoryParams { budget_mb };
            let applied = memory.applied_to(&params);
            assert!(applied.keyframe.budget_mb <= budget_mb / 4.0);
            let most = (applied.keyframe.budget_mb * 1e6) as usize;
            for (num_bytes, num_keyframes, num_triangles) in
                [(0, 0, 0), (most / 2, 50, 50_000), (most, 100, 20_000)]
            {
                let plan = memory.plan(&params, num_bytes, num_keyframes, num_triangles);
                let fixed = plan.total() - plan.decode_cache - plan.kept_views;
                assert!(plan.total() <= plan.budget.max(fixed), "{plan:?}");
                assert_eq!(
                    plan.kept_views > 0,
                    follows_changes && fixed + 3 <= plan.budget
                );
                assert!(plan.decode_cache <= 700_000_000);
                if fixed < plan.budget && plan.decode_cache < 700_000_000 {
                    assert_eq!(plan.total(), plan.budget, "all of it is used");
                }
            }
        }
    }
}
