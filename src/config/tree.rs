//! All parameters: one row each.

use super::Config;
use super::parameter::{Access, Parameter};
use super::{node, publish, smooth};
use crate::export::NormalMode;
use crate::export::pages::PageFormat;
use crate::ingest::PoseSource;
use crate::texinit::assign::{ColorCue, DepthCue};
use crate::texinit::density::SizeRule;
use crate::texinit::flatten::{ChartBoundary, ChartMode};
use crate::texinit::overlap::OverlapForm;
use crate::texinit::transfer::{Lookup, MeanForm, TransferMode};
use crate::texinit::{Coupling, TexInitParams};

use Access::{Bool, Choice, Count, Float, Float32, Int, Text};

const fn row(
    name: &'static str,
    unit: &'static str,
    description: &'static str,
    access: Access,
) -> Parameter {
    Parameter {
        name,
        unit,
        description,
        access,
    }
}

/// JPEG quality where none was chosen.
const JPEG_QUALITY: u8 = 92;

/// All parameters, by family.
#[rustfmt::skip]
pub const PARAMETERS: &[Parameter] = &[
    row("approx_sync", "", "Pair colour and depth of nearly equal stamps; otherwise only of equal ones.",
        Bool(|c| &mut c.pipeline.ingest.approx_sync)),
    row("approx_sync_max_interval", "s", "Largest difference of the stamps of a pair.",
        Float(|c| &mut c.pipeline.ingest.approx_sync_max_interval_s, 0.0, 10.0)),
    row("topic_queue_size", "", "Messages of one topic that wait to be read.",
        Count(|c| &mut c.pipeline.ingest.topic_queue_size, 1, 1000)),
    row("sync_queue_size", "", "Images of one kind that wait for a partner; the oldest is dropped.",
        Count(|c| &mut c.pipeline.ingest.sync_queue_size, 1, 1000)),
    row("wait_for_transform", "s", "How long a frame waits for its pose, in the time of the stream.",
        Float(|c| &mut c.pipeline.ingest.wait_for_transform_s, 0.0, 60.0)),
    row("pose_queue_size", "", "Frames that wait for a pose; the oldest must then do with what is known.",
        Count(|c| &mut c.pipeline.ingest.pose_queue_size, 1, 10_000)),
    row("pose_source", "", "Where the camera's pose comes from.",
        Choice { words: &["auto", "tf", "pose", "odom"], set: set_pose_source, get: pose_source }),
    row("frame_id", "", "Optical frame of the colour camera; empty takes it from the images.",
        Text(|c| &mut c.pipeline.ingest.camera_frame_id)),
    row("map_frame_id", "", "The world frame; empty takes the mesh's.",
        Text(|c| &mut c.pipeline.ingest.map_frame_id)),
    row("pose_frame_id", "", "The frame whose pose the pose topic gives; empty means the colour camera's.",
        Text(|c| &mut c.pipeline.ingest.pose_frame_id)),
    row("mesh_frame", "", "The frame of shape_msgs/Mesh, which does not say it.",
        Text(|c| &mut c.topics.mesh_frame)),
    row("tf.buffer", "s", "How long transforms are kept.",
        Float(|c| &mut c.pipeline.ingest.tf_buffer_s, 0.1, 3600.0)),
    row("tf.max_extrapolation", "s", "How far outside the known transforms a stamp may lie.",
        Float(|c| &mut c.pipeline.ingest.max_extrapolation_s, 0.0, 10.0)),
    row("tf.max_interpolation_gap", "s", "Longest gap between two transforms of a moving camera that is bridged.",
        Float(|c| &mut c.pipeline.ingest.max_interpolation_gap_s, 0.001, 3600.0)),
    row("clock_jump_back", "s", "Stamps that fall back by more than this, twice, mean that the clock was set back.",
        Float(|c| &mut c.pipeline.ingest.clock_jump_back_s, 0.001, 3600.0)),

    row("keyframe.budget_mb", "MB", "Encoded images that are kept; beyond it the most redundant keyframe goes.",
        Float(|c| &mut c.pipeline.keyframe.budget_mb, 1.0, 1e6)),
    row("keyframe.decode_cache_mb", "MB", "Decoded images kept for reuse.",
        Float(|c| &mut c.pipeline.keyframe.decode_cache_mb, 0.0, 1e6)),
    row("keyframe.min_translation_m", "m", "Distance from every kept frame that makes a new view.",
        Float(|c| &mut c.pipeline.keyframe.min_translation_m, 0.0, 100.0)),
    row("keyframe.min_rotation_rad", "rad", "Angle to every kept frame that makes a new view.",
        Float(|c| &mut c.pipeline.keyframe.min_rotation_rad, 0.0, 3.2)),
    row("keyframe.sparse_interval_s", "s", "Time since the last keyframe after which less motion suffices.",
        Float(|c| &mut c.pipeline.keyframe.sparse_interval_s, 0.0, 3600.0)),
    row("keyframe.sparse_motion_share", "", "The share of the motion that then suffices.",
        Float(|c| &mut c.pipeline.keyframe.sparse_motion_share, 0.0, 1.0)),
    row("keyframe.min_relative_sharpness", "", "Least sharpness as a share of the running median; 0 keeps blurred frames.",
        Float(|c| &mut c.pipeline.keyframe.min_relative_sharpness, 0.0, 10.0)),
    row("keyframe.sharpness_window", "", "Recent frames that the median runs over.",
        Count(|c| &mut c.pipeline.keyframe.sharpness_window, 1, 10_000)),
    row("keyframe.replace_sharpness_ratio", "", "How many times as sharp a frame must be to replace one of nearly the same view.",
        Float(|c| &mut c.pipeline.keyframe.replace_sharpness_ratio, 1.0, 100.0)),
    row("keyframe.min_mean_luma", "", "Darker frames are refused.",
        Float(|c| &mut c.pipeline.keyframe.min_mean_luma, 0.0, 1.0)),
    row("keyframe.max_mean_luma", "", "Brighter frames are refused.",
        Float(|c| &mut c.pipeline.keyframe.max_mean_luma, 0.0, 1.0)),
    row("keyframe.max_clipped", "", "Frames with a larger share of clipped pixels are refused.",
        Float(|c| &mut c.pipeline.keyframe.max_clipped, 0.0, 1.0)),
    row("keyframe.journal_path", "", "File (.mcap) from which the node goes on after it has ended, however it ended; empty keeps none.",
        Text(|c| &mut c.node.journal_path)),
    row("keyframe.journal_mesh_period", "s", "Least time between two meshes in the journal.",
        Float(|c| &mut c.node.journal_mesh_period_s, 0.0, 3600.0)),

    row("memory.budget_mb", "MB", "All that a scan keeps in memory: images, decoded images, score tables, mesh, atlas; lowers the limits of each. 0: each has its own limit alone.",
        Access::Custom { range: "0, 128 ..= 1000000", set: set_memory_budget, get: memory_budget }),

    row("mesh.weld_tolerance_m", "m", "Vertices closer than this are one; 0 joins only those of equal position.",
        Float(|c| &mut c.pipeline.weld_tolerance_m, 0.0, 1.0)),
    row("mesh.loop_subdivisions", "", "Rounds of Loop subdivision: four triangles for one, corners rounded. The paper's program does one.",
        Int(|c| &mut c.pipeline.num_subdivisions, 0, 3)),

    row("texinit.mode", "", "Resets all of texinit to ours (streaming) or to the paper's form (paper); comes before other texinit settings.",
        Choice { words: &["streaming", "paper"], set: set_mode, get: mode }),
    row("texinit.init", "", "Colour of the chosen frame (assigned), or the mean over all frames (l2avg).",
        Choice { words: &["assigned", "l2avg"], set: set_init, get: init }),
    row("texinit.coupling", "", "What the frame of a triangle depends on besides its own scores: all of the scan, or its chart alone, as stream.enabled has it.",
        Choice { words: &["scan", "chart"], set: set_coupling, get: coupling }),
    row("texinit.chart.boundary", "", "Boundary of each chart: lengths kept (isometric), or a circle (disk), where charts are split until that distorts little enough.",
        Choice { words: &["isometric", "disk"], set: set_chart_boundary, get: chart_boundary }),
    row("texinit.chart.max_normal_deviation_rad", "rad", "Largest angle between a triangle's smoothed normal and its chart's.",
        Float(|c| &mut c.pipeline.texinit.flatten.max_normal_deviation_rad, 0.01, 1.5)),
    row("texinit.chart.max_triangles", "", "Most triangles in a chart.",
        Count(|c| &mut c.pipeline.texinit.flatten.max_chart_triangles, 1, 1_000_000)),
    row("texinit.chart.min_triangles", "", "Smaller charts are merged into neighbours where the limits allow.",
        Count(|c| &mut c.pipeline.texinit.flatten.min_chart_triangles, 0, 1_000_000)),
    row("texinit.chart.max_roughness", "", "Largest perimeter² / (4π area) that merging may make; 1 is a disk.",
        Float(|c| &mut c.pipeline.texinit.flatten.max_boundary_roughness, 1.0, 1000.0)),
    row("texinit.chart.max_quasi_conformal", "", "Charts of a larger mean quasi-conformal error are split; 1 is conformal.",
        Float(|c| &mut c.pipeline.texinit.flatten.max_quasi_conformal_mean, 1.0, 100.0)),
    row("texinit.chart.max_stretch", "", "Charts in which lengths grow or shrink by more are split.",
        Float(|c| &mut c.pipeline.texinit.flatten.max_stretch, 1.0, 100.0)),
    row("texinit.chart.absorb_below_triangles", "", "Charts of fewer triangles join neighbours after flattening where both flatten together; 0 joins none.",
        Count(|c| &mut c.pipeline.texinit.flatten.absorb_below_triangles, 0, 1_000_000)),
    row("texinit.chart.max_cones", "", "Most cones in a whole component (mode paper).",
        Count(|c| &mut c.pipeline.texinit.flatten.max_cones, 0, 10_000)),
    row("texinit.overlap.form", "", "Eq. MRFPlane as the paper prints it, or with the planes, rewards and adjacency of the authors' program.",
        Choice { words: &["printed", "reference"], set: set_overlap_form, get: overlap_form }),
    row("texinit.overlap.max_sweeps", "", "Sweeps of dual coordinate descent that separate overlaps.",
        Count(|c| &mut c.pipeline.texinit.overlap.max_sweeps, 0, 1000)),
    row("texinit.area_weight", "1/px²", "ω1: weight of the projected area (cue C1).",
        Float32(|c| &mut c.pipeline.texinit.assign.area_weight, 0.0, 1.0)),
    row("texinit.depth_weight", "1/m", "ω2: weight of the depth discrepancy (cue C2).",
        Float32(|c| &mut c.pipeline.texinit.assign.depth_weight, -1e4, 0.0)),
    row("texinit.color_weight", "", "ω3: weight of the colour discrepancy (cue C3).",
        Float32(|c| &mut c.pipeline.texinit.assign.color_weight, -1e4, 0.0)),
    row("texinit.empty_score", "", "Score of painting nothing: frames below it are not used.",
        Float32(|c| &mut c.pipeline.texinit.assign.empty_score, -1e4, 0.0)),
    row("texinit.max_depth_difference_m", "m", "A larger depth discrepancy rejects the frame.",
        Float32(|c| &mut c.pipeline.texinit.assign.max_depth_difference_m, 0.001, 10.0)),
    row("texinit.unmeasured_depth_difference_m", "m", "Depth discrepancy where nothing was measured.",
        Float32(|c| &mut c.pipeline.texinit.assign.unmeasured_depth_difference_m, 0.0, 10.0)),
    row("texinit.depth_cue", "", "Depth discrepancy: the largest of four, in range and cut off (largest), or their sum in depth (sum).",
        Choice { words: &["largest", "sum"], set: set_depth_cue, get: depth_cue }),
    row("texinit.color_cue", "", "Colours are compared with the mean over the frames that see the triangle (seeing), or that are valid at its vertices (vertex) or for it (triangle).",
        Choice { words: &["seeing", "vertex", "triangle"], set: set_color_cue, get: color_cue }),
    row("texinit.occlusion_tolerance_m", "m", "The mesh hides what lies this far behind it, and a share of depth more.",
        Access::Custom { range: "0 ..= 1", set: set_occlusion_tolerance, get: occlusion_tolerance }),
    row("texinit.occlusion_relative_tolerance", "", "The share of depth that is added to it.",
        Access::Custom { range: "0 ..= 1", set: set_relative_tolerance, get: relative_tolerance }),
    row("texinit.depth_edge_penalty", "", "Taken off for a depth edge nearby.",
        Float32(|c| &mut c.pipeline.texinit.assign.depth_edge_penalty, 0.0, 100.0)),
    row("texinit.border_margin", "", "Vertices keep this share of the image's width from its border.",
        Float32(|c| &mut c.pipeline.texinit.assign.border_margin, 0.0, 0.2)),
    row("texinit.min_elevation_rad", "rad", "Views flatter than this to the surface are penalised as grazing.",
        Float32(|c| &mut c.pipeline.texinit.assign.min_elevation_rad, 0.0, 1.57)),
    row("texinit.grazing_penalty", "", "Taken off grazing views.",
        Float32(|c| &mut c.pipeline.texinit.assign.grazing_penalty, 0.0, 100.0)),
    row("texinit.resolution_weight", "", "Per doubling of the pixels per metre.",
        Float32(|c| &mut c.pipeline.texinit.assign.resolution_weight, 0.0, 100.0)),
    row("texinit.sharpness_weight", "", "Taken off per halving of the sharpness against the median frame.",
        Float32(|c| &mut c.pipeline.texinit.assign.sharpness_weight, 0.0, 100.0)),
    row("texinit.exposure_weight", "", "Taken off per unit of mean luma away from the median frame.",
        Float32(|c| &mut c.pipeline.texinit.assign.exposure_weight, 0.0, 100.0)),
    row("texinit.pairwise_weight", "", "ω4: reward for equal frames on adjacent triangles (cue C4); 0 decides each alone.",
        Access::Custom { range: "0 ..= 100", set: set_pairwise_weight, get: pairwise_weight }),
    row("texinit.size_rule", "", "One density for all charts (density), or square plates of fixed size, each filled by itself (paper).",
        Choice { words: &["density", "paper"], set: set_size_rule, get: size_rule }),
    row("texinit.lookup", "", "A texel's colour: perspective-correct over its footprint (footprint), or the nearest pixel, affine in the image (nearest).",
        Choice { words: &["footprint", "nearest"], set: set_lookup, get: lookup }),
    row("texinit.mean", "", "Means run over the frames that see a texel (seeing), or over all that it projects into (projecting).",
        Choice { words: &["seeing", "projecting"], set: set_mean, get: mean }),
    row("texinit.gutters", "", "Pad the charts with their own colours.",
        Bool(|c| &mut c.pipeline.texinit.has_gutters)),
    row("texinit.texels_per_m", "1/m", "Density of the texture; 0 takes it from the images.",
        Float(|c| &mut c.pipeline.texinit.density.texels_per_m, 0.0, 1e5)),
    row("texinit.density_quantile", "", "Share of the seen area whose best pixels are no smaller than a texel.",
        Float(|c| &mut c.pipeline.texinit.density.area_quantile, 0.0, 1.0)),
    row("texinit.max_texels_per_m", "1/m", "Upper bound of the density taken from the images.",
        Float(|c| &mut c.pipeline.texinit.density.max_texels_per_m, 1.0, 1e5)),
    row("texinit.max_texels", "", "Texels of all pages together; the density is lowered to fit. A texel takes 8 bytes.",
        Access::Custom { range: "4096 ..= 17179869184", set: set_max_texels, get: max_texels }),
    row("texinit.page_size_texel", "", "Largest side of a page, a power of two.",
        Choice { words: &["256", "512", "1024", "2048", "4096", "8192", "16384"], set: set_page_size, get: page_size }),
    row("texinit.gutter_texel", "", "Texels around each chart that repeat its border: 1, 2, 4 or 8 keep charts apart in mipmaps up to level 1, 2, 3 or 4.",
        Int(|c| &mut c.pipeline.texinit.pack.gutter_texel, 1, 8)),
    row("texinit.max_samples", "", "Samples along each side of a texel where the image is finer.",
        Int(|c| &mut c.pipeline.texinit.transfer.max_samples, 1, 16)),

    row("texsmooth.mode", "", "Resets all of texsmooth to ours (crops) or to the paper's form (paper: whole images, aligned at each step); comes before other texsmooth settings.",
        Choice { words: &["crops", "paper"], set: smooth::set_mode, get: smooth::mode }),
    row("texsmooth.iterations", "", "Steps of the optimisation that refines the texture; 0 leaves it out.",
        Count(|c| &mut c.pipeline.texsmooth.num_steps, 0, 10_000_000)),
    row("texsmooth.backend", "", "Where views are drawn and the discriminator runs: a graphics card where there is one (auto).",
        Choice { words: &["cpu", "gpu", "auto"], set: smooth::set_backend, get: smooth::backend }),
    row("texsmooth.seed", "", "Seed of all that is drawn at random.",
        Access::Custom { range: "0 ..= 18446744073709551615", set: smooth::set_seed, get: smooth::seed }),
    row("texsmooth.start", "", "What the optimisation starts from: the texture, or mid grey (blank).",
        Choice { words: &["texture", "blank"], set: smooth::set_start, get: smooth::start }),
    row("texsmooth.crop_px", "px", "Side of the crop of a photo that a step looks at; 0 takes the whole photo.",
        Count(|c| &mut c.pipeline.texsmooth.crop_px, 0, 16_384)),
    row("texsmooth.jitter_px", "px", "Most columns and rows that a whole photo is cut by at random.",
        Count(|c| &mut c.pipeline.texsmooth.max_jitter_px, 0, 1000)),
    row("texsmooth.learning_rate", "", "Adam's step for texels on the scale of [-1, 1].",
        Float32(|c| &mut c.pipeline.texsmooth.learning_rate, 0.0, 1.0)),
    row("texsmooth.final_learning_rate_share", "", "Share of it that is left at the last step.",
        Float32(|c| &mut c.pipeline.texsmooth.final_learning_rate_share, 1e-6, 1.0)),
    row("texsmooth.beta1", "", "Adam's decay of the first moment for texels.",
        Float32(|c| &mut c.pipeline.texsmooth.betas[0], 0.0, 0.999_999)),
    row("texsmooth.beta2", "", "Adam's decay of the second moment for texels.",
        Float32(|c| &mut c.pipeline.texsmooth.betas[1], 0.0, 0.999_999)),
    row("texsmooth.lambda", "", "Weight of the L1 term at first.",
        Float32(|c| &mut c.pipeline.texsmooth.lambda, 0.0, 1e6)),
    row("texsmooth.lambda_decay", "", "What it is multiplied by each period.",
        Float32(|c| &mut c.pipeline.texsmooth.lambda_decay, 0.0, 1.0)),
    row("texsmooth.lambda_period", "", "Steps in a period.",
        Count(|c| &mut c.pipeline.texsmooth.lambda_period, 1, 10_000_000)),
    row("texsmooth.l1_target", "", "What the L1 term compares the rendering with: the view's photo (the paper's equation), or its partner's (the authors' program).",
        Choice { words: &["photo", "partner"], set: smooth::set_l1_target, get: smooth::l1_target }),
    row("texsmooth.resolution_exponent", "", "A pixel that covers more than one texel counts by their number to minus this; 0: all alike (the paper).",
        Float32(|c| &mut c.pipeline.texsmooth.resolution_exponent, 0.0, 16.0)),
    row("texsmooth.own_weight", "", "How many times a pixel counts at texels that were painted from its photo; 1: all alike (the paper).",
        Float32(|c| &mut c.pipeline.texsmooth.own_weight, 0.0, 1e6)),
    row("texsmooth.discriminator.enabled", "", "Whether a discriminator judges the rendering; without one the L1 term is all.",
        Bool(|c| &mut c.pipeline.texsmooth.has_discriminator)),
    row("texsmooth.discriminator.learning_rate", "", "Adam's step for the discriminator.",
        Float32(|c| &mut c.pipeline.texsmooth.discriminator.learning_rate, 0.0, 1.0)),
    row("texsmooth.discriminator.padding", "", "Convolutions without padding (valid, the paper), or with a pixel of it (one, the authors' program).",
        Choice { words: &["valid", "one"], set: smooth::set_padding, get: smooth::padding }),
    row("texsmooth.discriminator.gate", "", "The discriminator learns at every step (always), or where its loss is the larger one (when_behind, the authors' program).",
        Choice { words: &["always", "when_behind"], set: smooth::set_gate, get: smooth::gate }),
    row("texsmooth.partner_rule", "", "Partners look the same way (viewing_axis), or see the world's z axis the same way (world_axis, the authors' program).",
        Choice { words: &["viewing_axis", "world_axis"], set: smooth::set_partner_rule, get: smooth::partner_rule }),
    row("texsmooth.max_partner_angle_rad", "rad", "Largest angle between partners.",
        Float(|c| &mut c.pipeline.texsmooth.max_partner_angle_rad, 0.0, 3.2)),
    row("texsmooth.max_depth_difference_m", "m", "Where a partner's depth differs by more it sees another surface.",
        Float32(|c| &mut c.pipeline.texsmooth.max_depth_difference_m, 0.0, 10.0)),
    row("texsmooth.align", "", "Whether photo and rendering are aligned.",
        Bool(|c| &mut c.pipeline.texsmooth.has_alignment)),
    row("texsmooth.align_form", "", "Ours, to a part of a pixel (refined); the same by phase (phase); the authors' program's, to whole pixels (reference).",
        Choice { words: &["refined", "phase", "reference"], set: smooth::set_align_form, get: smooth::align_form }),
    row("texsmooth.align_grid", "", "Patches along each side of a photo that are aligned apart.",
        Count(|c| &mut c.pipeline.texsmooth.align_grid, 1, 16)),
    row("texsmooth.max_offset_share", "", "Longest offset as a share of a patch's side.",
        Float32(|c| &mut c.pipeline.texsmooth.align.max_offset_share, 0.001, 0.5)),
    row("texsmooth.min_align_confidence", "", "Offsets of less confidence are not used.",
        Float32(|c| &mut c.pipeline.texsmooth.align.min_confidence, 0.0, 1.0)),
    row("texsmooth.align_interval", "", "Visits of a view after which it is aligned anew.",
        Count(|c| &mut c.pipeline.texsmooth.align_interval, 1, 1_000_000)),
    row("texsmooth.partner_offset", "", "A partner's photo is taken at its own offset (own), or shifted with the view's (view, the authors' program).",
        Choice { words: &["own", "view"], set: smooth::set_partner_offset, get: smooth::partner_offset }),
    row("texsmooth.time_budget_s", "s", "No step begins later; 0 sets no bound. The bytes then depend on the machine.",
        Float(|c| &mut c.pipeline.texsmooth.time_budget_s, 0.0, 1e7)),
    row("texsmooth.view_cache_mb", "MB", "Memory for what the views see of the mesh.",
        Float(|c| &mut c.pipeline.texsmooth.view_cache_mb, 0.0, 1e6)),
    row("texsmooth.preview_interval", "", "Steps between preview pictures; 0 for none.",
        Count(|c| &mut c.pipeline.texsmooth.preview_interval, 0, 1_000_000)),
    row("texsmooth.checkpoint_interval", "", "Steps between checkpoints; 0 for none.",
        Count(|c| &mut c.pipeline.texsmooth.checkpoint_interval, 0, 1_000_000)),

    row("stream.enabled", "", "Whether the node paints only what changed since the last painting: charts, labels and texels stay as long as mesh and keyframes do. Not with settings that work on the whole texture (photometric, texsmooth).",
        Bool(|c| &mut c.pipeline.follows_changes)),
    row("stream.quantum_m", "m", "Vertices are compared on a grid of this pitch.",
        Float(|c| &mut c.pipeline.stream.diff.quantum_m, 1e-6, 0.01)),
    row("stream.max_move_m", "m", "How far a vertex may move and keep its place in the atlas.",
        Float(|c| &mut c.pipeline.stream.diff.max_move_m, 0.0, 1.0)),
    row("stream.max_drift_m", "m", "A chart whose vertices may have moved this far in all is flattened anew.",
        Float(|c| &mut c.pipeline.stream.max_drift_m, 0.0, 10.0)),
    row("stream.remake_below_triangles", "", "Charts of fewer triangles beside changed surface are made anew with it.",
        Count(|c| &mut c.pipeline.stream.remake_below_triangles, 0, 1_000_000)),
    row("stream.page_size_texel", "texel", "Side of the pages, at most that of the atlas.",
        Choice { words: &["256", "512", "1024", "2048", "4096", "8192", "16384"], set: set_stream_page_size, get: stream_page_size }),
    row("stream.min_used_share", "", "Pages are emptied into others while charts hold less than this share of them.",
        Float(|c| &mut c.pipeline.stream.min_used_share, 0.0, 1.0)),

    row("photometric.gain", "", "Whether each keyframe gets a gain per channel, so that all show the surface in the same colours.",
        Bool(|c| &mut c.pipeline.refine.has_gain)),
    row("photometric.gain_points", "", "Points of the surface at which keyframes are compared.",
        Count(|c| &mut c.pipeline.refine.gain.num_points, 1, 10_000_000)),
    row("photometric.gain_robust_scale", "", "Differences of log light beyond this hardly count.",
        Float(|c| &mut c.pipeline.refine.gain.robust_scale, 1e-6, 1e3)),
    row("photometric.max_log_gain", "", "Largest natural logarithm of a gain, either way.",
        Float(|c| &mut c.pipeline.refine.gain.max_log_gain, 0.0, 10.0)),
    row("photometric.cache_mb", "MB", "Memory for keyframes with their gain.",
        Float(|c| &mut c.pipeline.refine.cache_mb, 0.0, 1e6)),
    row("photometric.pose", "", "Whether keyframes are turned by the offset between photo and rendering, and all is painted again.",
        Bool(|c| &mut c.pipeline.refine.has_pose)),
    row("photometric.pose_rounds", "", "Rounds of that at most.",
        Count(|c| &mut c.pipeline.refine.pose.max_rounds, 1, 100)),
    row("photometric.pose_damping", "", "Share of an offset that a round takes out.",
        Float(|c| &mut c.pipeline.refine.pose.damping, 0.05, 1.0)),
    row("photometric.max_turn_rad", "rad", "A keyframe is turned by no more in all.",
        Float(|c| &mut c.pipeline.refine.pose.max_turn_rad, 0.0, 0.5)),
    row("photometric.pose_width_px", "px", "Photos wider than this are compared at a whole fraction of their size.",
        Int(|c| &mut c.pipeline.refine.pose.max_width_px, 64, 8192)),
    row("photometric.global_seams", "", "Whether steps of colour between keyframes are levelled over whole regions.",
        Bool(|c| &mut c.pipeline.refine.seams.has_global)),
    row("photometric.local_seams", "", "Whether what is left of them is levelled within a narrow band.",
        Bool(|c| &mut c.pipeline.refine.seams.has_local)),
    row("photometric.seam_reach_m", "m", "How far from a seam levelling over regions reaches.",
        Float(|c| &mut c.pipeline.refine.seams.reach_m, 1e-6, 1e6)),
    row("photometric.seam_band_texel", "texel", "Width of the narrow band on either side of a seam.",
        Float(|c| &mut c.pipeline.refine.seams.band_texel, 1e-3, 1e4)),
    row("photometric.max_seam_step", "", "Larger steps of linear light are left as they are.",
        Float(|c| &mut c.pipeline.refine.seams.max_step, 1e-6, 2.0)),

    row("use_sim_time", "", "Take the time from /clock (node).",
        Bool(|c| &mut c.node.use_sim_time)),
    row("autostart", "", "Configure and activate at start; otherwise a lifecycle manager does (node).",
        Bool(|c| &mut c.node.autostart)),
    row("image_transport", "", "How colour images come: as published, the compressed one of two (auto); raw; compressed (node).",
        Choice { words: node::TRANSPORT_WORDS, set: node::set_image_transport, get: node::image_transport }),
    row("depth_transport", "", "The same for depth images (node).",
        Choice { words: node::TRANSPORT_WORDS, set: node::set_depth_transport, get: node::depth_transport }),
    row("mesh_type", "", "Type of the mesh topic; auto takes it from who publishes (node).",
        Choice { words: node::MESH_TYPE_WORDS, set: node::set_mesh_type, get: node::mesh_type }),
    row("memory.queue_mb", "MB", "Messages that wait to be decoded; beyond it the oldest of the topic goes (node).",
        Float(|c| &mut c.node.queue_mb, 1.0, 1e5)),
    row("idle_flush", "s", "Silence after which images that wait for a partner or a pose are given up on (node).",
        Float(|c| &mut c.node.idle_flush_s, 0.1, 3600.0)),
    row("paint_period", "s", "Least time between the starts of two paintings (node).",
        Float(|c| &mut c.node.paint_period_s, 0.0, 3600.0)),
    row("publish.rate_mb", "MB/s", "What is published in a second at most, all topics together (node).",
        Float(|c| &mut c.node.publish_rate_mb, 0.1, 1e4)),
    row("publish.depth", "", "Messages that each output keeps for late joiners and for readers that lag (node).",
        Count(|c| &mut c.node.publish_depth, 1, 10_000)),
    row("diagnostics.period", "s", "Time between two diagnostics (node).",
        Float(|c| &mut c.node.diagnostics_period_s, 0.1, 3600.0)),
    row("save.folder", "", "Folder that ~/save and ~/load are confined to; empty refuses both (node).",
        Text(|c| &mut c.node.save_folder)),
    row("save.on_shutdown", "", "File in that folder that is written when the node is told to stop; empty writes none (node).",
        Text(|c| &mut c.node.save_on_shutdown)),
    row("http.port", "", "Port on which the scan is served as GLB; 0 serves nothing (node).",
        Int(|c| &mut c.node.http_port, 0, 65535)),
    row("http.address", "", "Address to serve on; empty means this host only (node).",
        Text(|c| &mut c.node.http_address)),

    row("eval.held_out_views", "", "Keyframes kept from the texture to judge it by; at most a tenth of all.",
        Count(|c| &mut c.pipeline.held_out.num_views, 0, 1000)),

    row("export.glb", "", "Write scan.glb.", Bool(|c| &mut c.export.glb)),
    row("export.obj", "", "Write scan.obj and scan.mtl.", Bool(|c| &mut c.export.obj)),
    row("export.ply", "", "Write scan.ply.", Bool(|c| &mut c.export.ply)),
    row("export.provenance", "", "Write provenance/: which frame painted each texel, and how far to trust it.",
        Bool(|c| &mut c.export.provenance)),
    row("export.glb_images", "", "How the GLB carries its pages.",
        Choice { words: &["png", "jpeg"], set: set_glb_images, get: glb_images }),
    row("export.jpeg_quality", "", "Quality of the GLB's pages as JPEG; setting it chooses JPEG.",
        Access::Custom { range: "1 ..= 100", set: set_jpeg_quality, get: jpeg_quality }),
    row("export.normals", "", "Normals in the GLB: one per vertex, or one per triangle.",
        Choice { words: &["smooth", "flat"], set: set_normals, get: normals }),

    row("publish.block_bytes", "B", "No message published is longer: longer ones do not arrive.",
        Count(|c| &mut c.publish.max_message_bytes, 8192, 190_000)),
    row("publish.tile_texel", "texel", "Side of the tiles in which texels are compared and published.",
        Int(|c| &mut c.publish.tile_texel, 16, 16_384)),
    row("publish.tiles", "", "How textured_mesh carries texels; png is exact.",
        Choice { words: &["png", "jpeg"], set: publish::set_tiles, get: publish::tiles }),
    row("publish.viewer_textures", "", "How markers and scene carry their textures.",
        Choice { words: &["png", "jpeg"], set: publish::set_viewer_textures, get: publish::viewer_textures }),
    row("publish.jpeg_quality", "", "Quality of what is published as JPEG; comes after the choice of it.",
        Access::Custom { range: "1 ..= 100", set: publish::set_jpeg_quality, get: publish::jpeg_quality }),
];

fn set_pose_source(config: &mut Config, word: &str) {
    let source = match word {
        "tf" => PoseSource::Tf,
        "pose" => PoseSource::Pose,
        "odom" => PoseSource::Odom,
        _ => PoseSource::Auto,
    };
    config.pipeline.ingest.pose_source = source;
    config.topics.pose_source = source;
}

fn pose_source(config: &Config) -> &'static str {
    match config.pipeline.ingest.pose_source {
        PoseSource::Auto => "auto",
        PoseSource::Tf => "tf",
        PoseSource::Pose => "pose",
        PoseSource::Odom => "odom",
    }
}

fn set_mode(config: &mut Config, word: &str) {
    config.pipeline.texinit = match word {
        "paper" => TexInitParams::paper(),
        _ => TexInitParams::default(),
    };
}

fn mode(config: &Config) -> &'static str {
    match config.pipeline.texinit.flatten.mode {
        ChartMode::Streaming => "streaming",
        ChartMode::Paper => "paper",
    }
}

fn set_coupling(config: &mut Config, word: &str) {
    config.pipeline.texinit.coupling = match word {
        "chart" => Coupling::Chart,
        _ => Coupling::Scan,
    };
}

fn coupling(config: &Config) -> &'static str {
    match config.pipeline.texinit.coupling {
        Coupling::Scan => "scan",
        Coupling::Chart => "chart",
    }
}

fn set_overlap_form(config: &mut Config, word: &str) {
    config.pipeline.texinit.overlap.form = match word {
        "reference" => OverlapForm::Reference,
        _ => OverlapForm::Printed,
    };
}

fn overlap_form(config: &Config) -> &'static str {
    match config.pipeline.texinit.overlap.form {
        OverlapForm::Printed => "printed",
        OverlapForm::Reference => "reference",
    }
}

fn set_chart_boundary(config: &mut Config, word: &str) {
    config.pipeline.texinit.flatten.boundary = match word {
        "disk" => ChartBoundary::Disk,
        _ => ChartBoundary::Isometric,
    };
}

fn chart_boundary(config: &Config) -> &'static str {
    match config.pipeline.texinit.flatten.boundary {
        ChartBoundary::Isometric => "isometric",
        ChartBoundary::Disk => "disk",
    }
}

fn set_init(config: &mut Config, word: &str) {
    config.pipeline.texinit.transfer.mode = match word {
        "l2avg" => TransferMode::L2Avg,
        _ => TransferMode::Assigned,
    };
}

fn init(config: &Config) -> &'static str {
    match config.pipeline.texinit.transfer.mode {
        TransferMode::Assigned => "assigned",
        TransferMode::L2Avg => "l2avg",
    }
}

fn set_size_rule(config: &mut Config, word: &str) {
    config.pipeline.texinit.size_rule = match word {
        "paper" => SizeRule::Paper,
        _ => SizeRule::Density,
    };
}

fn size_rule(config: &Config) -> &'static str {
    match config.pipeline.texinit.size_rule {
        SizeRule::Density => "density",
        SizeRule::Paper => "paper",
    }
}

fn set_depth_cue(config: &mut Config, word: &str) {
    config.pipeline.texinit.assign.depth_cue = match word {
        "sum" => DepthCue::DepthSum,
        _ => DepthCue::LargestRange,
    };
}

fn depth_cue(config: &Config) -> &'static str {
    match config.pipeline.texinit.assign.depth_cue {
        DepthCue::LargestRange => "largest",
        DepthCue::DepthSum => "sum",
    }
}

fn set_color_cue(config: &mut Config, word: &str) {
    config.pipeline.texinit.assign.color_cue = match word {
        "vertex" => ColorCue::ValidAtVertex,
        "triangle" => ColorCue::ValidForTriangle,
        _ => ColorCue::SeeingFrames,
    };
}

fn color_cue(config: &Config) -> &'static str {
    match config.pipeline.texinit.assign.color_cue {
        ColorCue::SeeingFrames => "seeing",
        ColorCue::ValidAtVertex => "vertex",
        ColorCue::ValidForTriangle => "triangle",
    }
}

fn set_lookup(config: &mut Config, word: &str) {
    config.pipeline.texinit.transfer.lookup = match word {
        "nearest" => Lookup::NearestAffine,
        _ => Lookup::Footprint,
    };
}

fn lookup(config: &Config) -> &'static str {
    match config.pipeline.texinit.transfer.lookup {
        Lookup::Footprint => "footprint",
        Lookup::NearestAffine => "nearest",
    }
}

fn set_mean(config: &mut Config, word: &str) {
    config.pipeline.texinit.transfer.mean_form = match word {
        "projecting" => MeanForm::Projecting,
        _ => MeanForm::Seeing,
    };
}

fn mean(config: &Config) -> &'static str {
    match config.pipeline.texinit.transfer.mean_form {
        MeanForm::Seeing => "seeing",
        MeanForm::Projecting => "projecting",
    }
}

fn set_pairwise_weight(config: &mut Config, text: &str) -> Option<()> {
    let weight: f32 = text.parse().ok()?;
    if !(0.0..=100.0).contains(&weight) {
        return None;
    }
    let pairwise = &mut config.pipeline.texinit.assign.pairwise;
    if weight > 0.0 {
        pairwise.get_or_insert_default().weight = weight;
    } else {
        *pairwise = None;
    }
    Some(())
}

fn pairwise_weight(config: &Config) -> String {
    let pairwise = &config.pipeline.texinit.assign.pairwise;
    pairwise.as_ref().map_or(0.0, |p| p.weight).to_string()
}

fn unit_interval(text: &str) -> Option<f64> {
    let value: f64 = text.parse().ok()?;
    (0.0..=1.0).contains(&value).then_some(value)
}

fn set_occlusion_tolerance(config: &mut Config, text: &str) -> Option<()> {
    let assign = &mut config.pipeline.texinit.assign;
    assign.visibility.get_or_insert_default().tolerance_m = unit_interval(text)?;
    Some(())
}

fn occlusion_tolerance(config: &Config) -> String {
    let visibility = config.pipeline.texinit.assign.visibility.clone();
    visibility.unwrap_or_default().tolerance_m.to_string()
}

fn set_relative_tolerance(config: &mut Config, text: &str) -> Option<()> {
    let assign = &mut config.pipeline.texinit.assign;
    assign.visibility.get_or_insert_default().relative_tolerance = unit_interval(text)?;
    Some(())
}

fn relative_tolerance(config: &Config) -> String {
    let visibility = config.pipeline.texinit.assign.visibility.clone();
    visibility
        .unwrap_or_default()
        .relative_tolerance
        .to_string()
}

fn set_memory_budget(config: &mut Config, text: &str) -> Option<()> {
    let budget_mb: f64 = text.parse().ok()?;
    if budget_mb != 0.0 && !(128.0..=1e6).contains(&budget_mb) {
        return None;
    }
    config.pipeline.memory.budget_mb = budget_mb;
    Some(())
}

fn memory_budget(config: &Config) -> String {
    config.pipeline.memory.budget_mb.to_string()
}

fn set_max_texels(config: &mut Config, text: &str) -> Option<()> {
    let num_texels: u64 = text.parse().ok()?;
    if !(4096..=1 << 34).contains(&num_texels) {
        return None;
    }
    config.pipeline.texinit.pack.max_texels = num_texels;
    Some(())
}

fn max_texels(config: &Config) -> String {
    config.pipeline.texinit.pack.max_texels.to_string()
}

const PAGE_SIZES: [(&str, u32); 7] = [
    ("256", 256),
    ("512", 512),
    ("1024", 1024),
    ("2048", 2048),
    ("4096", 4096),
    ("8192", 8192),
    ("16384", 16384),
];

fn set_page_size(config: &mut Config, word: &str) {
    if let Some((_, size)) = PAGE_SIZES.iter().find(|(name, _)| *name == word) {
        config.pipeline.texinit.pack.page_size_texel = *size;
    }
}

fn page_size(config: &Config) -> &'static str {
    page_size_word(config.pipeline.texinit.pack.page_size_texel)
}

fn set_stream_page_size(config: &mut Config, word: &str) {
    if let Some((_, size)) = PAGE_SIZES.iter().find(|(name, _)| *name == word) {
        config.pipeline.stream.page_size_texel = *size;
    }
}

fn stream_page_size(config: &Config) -> &'static str {
    page_size_word(config.pipeline.stream.page_size_texel)
}

fn page_size_word(current: u32) -> &'static str {
    PAGE_SIZES
        .iter()
        .find(|(_, size)| *size == current)
        .map_or("4096", |(name, _)| name)
}

fn set_glb_images(config: &mut Config, word: &str) {
    config.export.glb_pages = match (word, config.export.glb_pages) {
        ("jpeg", PageFormat::Png) => PageFormat::Jpeg {
            quality: JPEG_QUALITY,
        },
        ("jpeg", jpeg) => jpeg,
        _ => PageFormat::Png,
    };
}

fn glb_images(config: &Config) -> &'static str {
    match config.export.glb_pages {
        PageFormat::Png => "png",
        PageFormat::Jpeg { .. } => "jpeg",
    }
}

fn set_jpeg_quality(config: &mut Config, text: &str) -> Option<()> {
    let wanted: u8 = text.parse().ok()?;
    if !(1..=100).contains(&wanted) {
        return None;
    }
    if let PageFormat::Jpeg { quality } = &mut config.export.glb_pages {
        *quality = wanted;
    } else if wanted != JPEG_QUALITY {
        config.export.glb_pages = PageFormat::Jpeg { quality: wanted };
    }
    Some(())
}

fn jpeg_quality(config: &Config) -> String {
    match config.export.glb_pages {
        PageFormat::Png => JPEG_QUALITY.to_string(),
        PageFormat::Jpeg { quality } => quality.to_string(),
    }
}

fn set_normals(config: &mut Config, word: &str) {
    config.export.normals = match word {
        "flat" => NormalMode::Flat,
        _ => NormalMode::Smooth,
    };
}

fn normals(config: &Config) -> &'static str {
    match config.export.normals {
        NormalMode::Smooth => "smooth",
        NormalMode::Flat => "flat",
    }
}

/// Values of `config` as a ROS 2 parameter file.
pub fn to_yaml(config: &mut Config) -> String {
    let mut text = "/**:\n  ros__parameters:\n".to_owned();
    for parameter in PARAMETERS {
        let value = parameter.get(config);
        let quoted = match parameter.access {
            Text(_) | Choice { .. } => format!("\"{value}\""),
            _ => value,
        };
        text += &format!(
            "    # {} ({})\n    {}: {quoted}\n",
            parameter.description,
            parameter.range(),
            parameter.name
        );
    }
    text
}

/// Values of `config` as `docs/parameters.md`.
pub fn to_markdown(config: &mut Config) -> String {
    let mut text = "\
# Parameters

Written by `veneer params --markdown`. Set them with `--param NAME:=VALUE` or in a ROS 2 parameter
file with `--params-file FILE` (`veneer params --yaml` writes one with the defaults). An unknown name
or a value outside its range is refused.

| name | default | range | what it does |
|---|---|---|---|
"
    .to_owned();
    for parameter in PARAMETERS {
        let value = parameter.get(config);
        let shown = if value.is_empty() { "(empty)" } else { &value };
        text += &format!(
            "| `{}` | {shown} | {} | {} |\n",
            parameter.name,
            parameter.range().replace('|', "\\|"),
            parameter.description
        );
    }
    text
}

/// Values of `config` as a table for a terminal.
pub fn to_table(config: &mut Config) -> String {
    let mut text = String::new();
    for parameter in PARAMETERS {
        let value = parameter.get(config);
        text += &format!(
            "{} = {value}  ({})\n    {}\n",
            parameter.name,
            parameter.range(),
            parameter.description
        );
    }
    text
}

/// Values of `config` as a JSON object of strings.
pub fn to_json(config: &mut Config) -> serde_json::Value {
    let entries = PARAMETERS.iter().map(|parameter| {
        let value = parameter.get(config);
        (parameter.name.to_owned(), serde_json::Value::String(value))
    });
    serde_json::Value::Object(entries.collect())
}
