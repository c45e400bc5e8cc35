//! The report's numbers that only the run knows.

use std::path::Path;

use crate::bag::BagReader;
use crate::config::{Config, listing};
use crate::ingest::EventSource;
use crate::keyframe::Keyframe;
use crate::pipeline::{RefineReport, Run};
use crate::report::{
    ChartSummary, Count, DensitySummary, Drop, GainSummary, KeyframeRow, LossRow, MeshSummary,
    Note, PoseSummary, RefineSummary, Report, SeamSummary, Severity, SmoothSummary, SourceSummary,
    Stage, TopicRow, repairs,
};
use crate::texsmooth::SmoothReport;

/// What a run did, as far as the run itself knows; [`Report::measure`] adds what the result shows.
pub(super) fn of_run(run: &Run, path: &Path, bag: &BagReader, config: &Config) -> Report {
    let stages = run.stages.iter().map(|stage| Stage {
        name: stage.name.to_owned(),
        seconds: stage.seconds,
    });
    Report {
        generator: format!("veneer {}", env!("CARGO_PKG_VERSION")),
        title: path
            .file_stem()
            .map_or_else(|| "scan".to_owned(), |s| s.to_string_lossy().into_owned()),
        notes: notes(run, bag),
        source: source(run, path, bag),
        counts: counts(run),
        drops: drops(run),
        stages: stages.collect(),
        num_threads: rayon::current_num_threads(),
        mesh: MeshSummary {
            details: mesh_details(run),
            // Of updates it is not kept what was mended.
            repairs: match run.updates {
                Some(_) => Vec::new(),
                None => repairs(&run.texinit.report.flatten.manifold),
            },
            ..MeshSummary::default()
        },
        charts: charts(run),
        density: DensitySummary::from_best_views(
            &run.mesh,
            &run.texinit.assignment.best_texels_per_m,
        ),
        keyframes: keyframe_rows(&run.keyframes),
        refine: refine_summary(&run.refine),
        texsmooth: run.texsmooth.as_ref().map(smooth_summary),
        parameters: listing::to_json(&mut config.clone()),
        ..Report::default()
    }
}

fn refine_summary(report: &RefineReport) -> Option<RefineSummary> {
    let gain = report.gain.as_ref().map(|(table, gain)| GainSummary {
        num_points: gain.num_points,
        num_samples: gain.num_samples,
        num_unlinked: gain.num_unlinked,
        median_before: gain.median_before,
        median_after: gain.median_after,
        factor_range: gain.factor_range,
        factors: table.iter().map(|(id, factors)| (id.0, factors)).collect(),
        seconds: report.seconds[0],
    });
    let seams = report.seams.as_ref().map(|seams| SeamSummary {
        num_seams: seams.num_seams,
        num_unknowns: seams.num_unknowns,
        num_solver_steps: seams.num_solver_steps,
        step_before: seams.step_before,
        step_after_global: seams.step_after_global,
        step_after: seams.step_after,
        num_changed_texels: seams.num_changed_texels,
        seconds: report.seconds[1],
    });
    let pose = report.pose.as_ref().map(|pose| PoseSummary {
        residual_255: pose.residual_255.clone(),
        offset_px: pose.offset_px.clone(),
        num_turned: pose.num_turned,
        num_unknown: pose.num_unknown,
        num_put_back: pose.num_put_back,
        max_turn_rad: pose.max_turn_rad,
        seconds: pose.seconds,
    });
    let is_any = gain.is_some() || pose.is_some() || seams.is_some();
    is_any.then_some(RefineSummary { gain, pose, seams })
}

fn smooth_summary(report: &SmoothReport) -> SmoothSummary {
    SmoothSummary {
        num_steps: report.num_steps,
        num_empty: report.num_empty,
        num_self_partnered: report.num_self_partnered,
        num_critic_steps: report.num_critic_steps,
        is_cut_short: report.is_cut_short,
        backend: report.backend.clone(),
        seconds: report.seconds,
        num_texels: report.num_texels,
        num_steps_per_texel: report.num_steps_per_texel,
        aligned_share: report.offsets.trusted_share,
        mean_offset_px: report.offsets.mean_px,
        max_offset_px: report.offsets.max_px,
        losses: report
            .curve
            .iter()
            .map(|(step, losses)| LossRow {
                step: *step,
                l1: losses.l1,
                adversarial: losses.adversarial,
                real: losses.real,
                fake: losses.fake,
            })
            .collect(),
    }
}

/// Largest resident size of this process so far; `None` where the system does not tell.
pub(super) fn peak_memory_bytes() -> Option<u64> {
    let status = std::fs::read_to_string("/proc/self/status").ok()?;
    let line = status.lines().find(|line| line.starts_with("VmHWM:"))?;
    let kib: u64 = line.split_whitespace().nth(1)?.parse().ok()?;
    Some(kib * 1024)
}

fn notes(run: &Run, bag: &BagReader) -> Vec<Note> {
    let mut notes = Vec::new();
    let mut note = |severity, text: String| notes.push(Note { severity, text });
    for loss in bag.losses() {
        note(Severity::Problem, loss.clone());
    }
    for assumption in &run.ingest.assumptions {
        note(Severity::Info, assumption.clone());
    }
    if run
        .keyframes
        .iter()
        .all(|keyframe| keyframe.depth.is_none())
    {
        note(
            Severity::Warning,
            "No depth image was used: what hides what was decided by the mesh alone.".to_owned(),
        );
    }
    for failed in &run.texinit.assignment.report.failed_frames {
        note(
            Severity::Warning,
            format!("Keyframe {} was not used: {}", failed.frame, failed.reason),
        );
    }
    let (wanted, used) = (
        run.texinit.report.wanted_texels_per_m,
        run.texinit.layout.texels_per_m,
    );
    if used < 0.99 * wanted {
        note(
            Severity::Warning,
            format!(
                "The photos hold {wanted:.0} texels per metre; the size of the texture \
                 (texinit.max_texels, texinit.size_rule) allows {used:.0}."
            ),
        );
    }
    notes
}

fn source(run: &Run, path: &Path, bag: &BagReader) -> SourceSummary {
    let topics = bag.plan().assignments.iter().map(|assignment| {
        let received = run.ingest.topics.get(&assignment.topic);
        let num_messages = received.map_or(0, |report| report.num_received);
        TopicRow {
            topic: assignment.topic.clone(),
            type_name: assignment.message_type.name().to_owned(),
            role: Some(assignment.role.name().to_owned()),
            num_messages,
            rate_hz: (num_messages > 1 && run.duration_s > 0.0)
                .then(|| num_messages as f64 / run.duration_s),
        }
    });
    SourceSummary {
        path: path.display().to_string(),
        num_bytes: bag.num_bytes() as u64,
        duration_s: run.duration_s,
        topics: topics.collect(),
        losses: bag.losses().to_vec(),
    }
}

fn counts(run: &Run) -> Vec<Count> {
    let received = run.ingest.topics.values().map(|t| t.num_received).sum();
    let assignment = &run.texinit.assignment.report;
    vec![
        Count::new("messages received", received),
        Count::new("colour and depth pairs", run.ingest.sync.num_pairs),
        Count::new(
            "colour images without depth",
            run.ingest.sync.num_without_depth,
        ),
        Count::new("frames with a pose", run.ingest.num_frames),
        Count::new("mesh updates", run.num_mesh_updates as u64),
        Count::new("keyframes that paint", run.keyframes.len() as u64),
        Count::new("keyframes held out", run.held_out.len() as u64),
        Count::new(
            "keyframes chosen by a triangle",
            assignment.num_frames_used as u64,
        ),
        Count::new(
            "triangle and frame pairs scored",
            assignment.num_candidates as u64,
        ),
        Count::new("triangles with a frame", assignment.num_labelled as u64),
        Count::new(
            "triangles without a frame",
            assignment.num_unlabelled as u64,
        ),
        Count::new("label seams (edges)", assignment.num_seams as u64),
    ]
}

fn drops(run: &Run) -> Vec<Drop> {
    let by_topic = run.ingest.topics.iter().flat_map(|(topic, report)| {
        report.refused_by_reason.iter().map(|(reason, count)| Drop {
            at: topic.clone(),
            reason: count.examples.first().unwrap_or(reason).clone(),
            count: count.num,
        })
    });
    let by_store = run
        .store
        .rejected_by_reason
        .iter()
        .map(|(reason, &count)| Drop {
            at: "keyframe selection".to_owned(),
            reason: (*reason).to_owned(),
            count,
        });
    let soup = [
        ("vertex is not finite", run.ingest.num_non_finite_vertices),
        (
            "triangle at such a vertex",
            run.ingest.num_dropped_triangles,
        ),
    ]
    .into_iter()
    .filter(|(_, count)| *count > 0)
    .map(|(reason, count)| Drop {
        at: "mesh".to_owned(),
        reason: reason.to_owned(),
        count,
    });
    by_topic.chain(by_store).chain(soup).collect()
}

fn mesh_details(run: &Run) -> Vec<Count> {
    if run.updates.is_some() {
        return Vec::new();
    }
    let manifold = &run.texinit.report.flatten.manifold;
    vec![
        Count::new("vertices merged by welding", run.num_welded_vertices as u64),
        Count::new("boundary edges", manifold.num_boundary_edges as u64),
    ]
}

fn charts(run: &Run) -> ChartSummary {
    if let Some(updates) = &run.updates {
        return ChartSummary {
            details: vec![
                Count::new("updates", updates.num_updates as u64),
                Count::new(
                    "chart and keyframe pairs scored in all",
                    updates.num_pairs_scored as u64,
                ),
                Count::new(
                    "triangles painted in all",
                    updates.num_triangles_painted as u64,
                ),
                Count::new("idle steps", updates.num_idle_steps as u64),
            ],
            ..ChartSummary::default()
        };
    }
    let report = &run.texinit.report;
    let distortion = &report.absorb.distortion;
    ChartSummary {
        quasi_conformal_mean: Some(distortion.quasi_conformal_mean),
        quasi_conformal_max: Some(distortion.quasi_conformal_max),
        area_ratio_min: Some(distortion.area_ratio_min),
        area_ratio_max: Some(distortion.area_ratio_max),
        stretch_l2: Some(distortion.stretch_l2),
        stretch_linf: Some(distortion.stretch_linf),
        seam_length_m: Some(report.absorb.seam_length_m),
        details: vec![
            Count::new(
                "of a single triangle",
                report.absorb.num_single_triangle_charts as u64,
            ),
            Count::new("grown", report.flatten.num_grown_charts as u64),
            Count::new("cones", report.flatten.solve.num_cones as u64),
            Count::new(
                "that overlapped themselves",
                report.overlap.num_overlapping_charts as u64,
            ),
            Count::new("pieces after separation", report.overlap.num_pieces as u64),
            Count::new("that joined a neighbour", report.absorb.num_absorbed as u64),
            Count::new(
                "split for the solver",
                report.flatten.solve.num_split_for_solver as u64,
            ),
            Count::new(
                "scaled down to fit a page",
                report.pack.num_scaled_charts as u64,
            ),
            Count::new(
                "triangles below a texel",
                report.pack.num_subtexel_triangles as u64,
            ),
        ],
        ..ChartSummary::default()
    }
}

fn keyframe_rows(keyframes: &[std::sync::Arc<Keyframe>]) -> Vec<KeyframeRow> {
    let Some(first) = keyframes.first() else {
        return Vec::new();
    };
    keyframes
        .iter()
        .map(|keyframe| {
            let pose = &keyframe.world_from_camera;
            let forward = pose.transform_vector(&nalgebra::Vector3::z());
            KeyframeRow {
                id: keyframe.id.0,
                time_s: keyframe.stamp.seconds_since(first.stamp),
                position_m: (*pose.translation()).into(),
                direction: forward.into(),
                sharpness: keyframe.quality.sharpness,
                mean_luma: keyframe.quality.mean_luma,
                num_texels: 0,
            }
        })
        .collect()
}
