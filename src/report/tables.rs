//! The parts of the page that are numbers.

use serde_json::Value;

use super::data::{Count, KeyframeRow, RefineSummary, Report, SmoothSummary};
use super::html::{escape, push, section};
use super::repairs::Repair;

/// Rows of losses in a table.
const NUM_LOSS_ROWS: usize = 8;

/// A number with thin spaces between its thousands.
pub(super) fn grouped(value: u64) -> String {
    let digits = value.to_string();
    let mut out = String::new();
    for (index, digit) in digits.chars().enumerate() {
        if index > 0 && (digits.len() - index).is_multiple_of(3) {
            out.push('\u{202F}');
        }
        out.push(digit);
    }
    out
}

/// A size in bytes as a number and its unit.
pub(super) fn bytes(value: u64) -> [String; 2] {
    let value = value as f64;
    let (scaled, unit) = match value {
        v if v >= 1e9 => (v / 1e9, "GB"),
        v if v >= 1e6 => (v / 1e6, "MB"),
        v if v >= 1e3 => (v / 1e3, "kB"),
        v => return [format!("{v:.0}"), "B".to_owned()],
    };
    let decimals = if scaled < 10.0 { 2 } else { 0 };
    [format!("{scaled:.decimals$}"), unit.to_owned()]
}

fn percent(share: f64) -> String {
    format!("{:.1} %", share * 100.0)
}

/// Column heads ending in `#` are numbers, and stand to the right.
fn table(heads: &[&str], rows: &[Vec<String>]) -> String {
    if rows.is_empty() {
        return String::new();
    }
    let is_number: Vec<bool> = heads.iter().map(|head| head.ends_with('#')).collect();
    let class = |column: usize| {
        if is_number.get(column).is_some_and(|is| *is) {
            " class=\"n\""
        } else {
            ""
        }
    };
    let mut out = String::from("<div class=\"scroll\"><table>");
    if heads
        .iter()
        .any(|head| !head.trim_end_matches('#').is_empty())
    {
        out.push_str("<tr>");
        for (column, head) in heads.iter().enumerate() {
            let text = escape(head.trim_end_matches('#'));
            push(&mut out, format_args!("<th{}>{text}</th>", class(column)));
        }
        out.push_str("</tr>");
    }
    for row in rows {
        out.push_str("<tr>");
        for (column, cell) in row.iter().enumerate() {
            push(
                &mut out,
                format_args!("<td{}>{}</td>", class(column), escape(cell)),
            );
        }
        out.push_str("</tr>");
    }
    out.push_str("</table></div>");
    out
}

fn card(heading: &str, body: &str) -> String {
    card_of("card", heading, body)
}

/// A card with a row to itself, for long names side by side.
fn wide_card(heading: &str, body: &str) -> String {
    card_of("card wide", heading, body)
}

fn card_of(class: &str, heading: &str, body: &str) -> String {
    if body.is_empty() {
        return String::new();
    }
    format!(
        "<div class=\"{class}\"><h3>{}</h3>{body}</div>",
        escape(heading)
    )
}

/// Stage times with bars.
pub(super) fn time(report: &Report) -> String {
    if report.stages.is_empty() {
        return String::new();
    }
    let longest = report.stages.iter().map(|s| s.seconds).fold(0.0, f64::max);
    let total = report.total_s.max(f64::MIN_POSITIVE);
    let mut rows = String::new();
    let mut row = |name: &str, seconds: f64, class: &str| {
        let width = if longest > 0.0 {
            (100.0 * seconds / longest).clamp(0.0, 100.0)
        } else {
            0.0
        };
        push(
            &mut rows,
            format_args!(
                "<tr class=\"{class}\"><td>{}</td><td class=\"n\">{seconds:.2} s</td>\
                 <td class=\"n\">{}</td><td class=\"bar\"><i style=\"width:{width:.1}%\"></i></td>\
                 </tr>",
                escape(name),
                percent(seconds / total)
            ),
        );
    };
    for stage in &report.stages {
        row(&stage.name, stage.seconds, "");
    }
    let rest = report.total_s - report.stages.iter().map(|s| s.seconds).sum::<f64>();
    if rest > 0.005 * total {
        row("everything else", rest, "rest");
    }
    let threads = report.num_threads;
    let memory = report.peak_memory_bytes.map_or(String::new(), |peak| {
        format!(", {} at the peak of memory", bytes(peak).join(" "))
    });
    let lead = format!(
        "{:.2} s in all on {threads} thread{}{memory}.",
        report.total_s,
        if threads == 1 { "" } else { "s" }
    );
    section(
        "Time",
        &lead,
        &format!("<table class=\"times\">{rows}</table>"),
    )
}

fn counts(counts: &[Count]) -> Vec<Vec<String>> {
    counts
        .iter()
        .map(|count| vec![count.name.clone(), grouped(count.value)])
        .collect()
}

fn pair(name: &str, value: impl Into<String>) -> Vec<String> {
    vec![name.to_owned(), value.into()]
}

fn smooth_rows(smooth: &SmoothSummary) -> Vec<Vec<String>> {
    let per_step_ms = 1e3 * smooth.seconds / smooth.num_steps.max(1) as f64;
    let mut rows = vec![
        pair("steps", grouped(smooth.num_steps as u64)),
        pair("discriminator on", smooth.backend.clone()),
        pair(
            "discriminator learnt at",
            grouped(smooth.num_critic_steps as u64),
        ),
        pair(
            "view was its own partner at",
            grouped(smooth.num_self_partnered as u64),
        ),
        pair("crop showed nothing at", grouped(smooth.num_empty as u64)),
        pair("time per step", format!("{per_step_ms:.0} ms")),
        pair("texels changed", grouped(smooth.num_texels)),
        pair(
            "steps of each",
            format!("{:.1}", smooth.num_steps_per_texel),
        ),
        pair("photos aligned", percent(smooth.aligned_share)),
        pair(
            "their offsets, mean / longest",
            format!(
                "{:.2} / {:.2} px",
                smooth.mean_offset_px, smooth.max_offset_px
            ),
        ),
    ];
    if smooth.is_cut_short {
        rows.push(pair("ended by", "the time budget"));
    }
    let stride = smooth.losses.len().div_ceil(NUM_LOSS_ROWS).max(1);
    for row in smooth.losses.iter().rev().step_by(stride).rev() {
        rows.push(pair(
            &format!("losses to step {}", row.step),
            format!(
                "L1 {:.4} · −log D {:.3} · D real {:.3}, fake {:.3}",
                row.l1, row.adversarial, row.real, row.fake
            ),
        ));
    }
    rows
}

/// Mesh, charts, atlas, coverage, scores.
pub(super) fn result(report: &Report) -> String {
    let plain = ["", "#"];
    let mut cards = String::new();
    cards.push_str(&card("Mesh", &table(&plain, &mesh_rows(report))));
    cards.push_str(&repairs_card(&report.mesh.repairs));
    cards.push_str(&card("Charts", &table(&plain, &chart_rows(report))));
    cards.push_str(&card(
        "Atlas and coverage",
        &table(&plain, &atlas_rows(report)),
    ));
    if let Some(refine) = &report.refine {
        cards.push_str(&card(
            "Exposure, poses and seams",
            &table(&plain, &refine_rows(refine)),
        ));
    }
    if let Some(smooth) = &report.texsmooth {
        cards.push_str(&card("TexSmooth", &table(&plain, &smooth_rows(smooth))));
    }
    if let Some(score) = &report.synthetic {
        let rows = [
            pair("texels compared", grouped(score.num_texels)),
            pair("painted, truly hidden", grouped(score.num_hidden_texels)),
            pair(
                "mean absolute error",
                format!("{:.2} / 255", score.mean_abs),
            ),
            pair("90 % are within", format!("{:.1} / 255", score.p90_abs)),
            pair("true surface painted", percent(score.covered_share)),
        ];
        cards.push_str(&card("Against the known texture", &table(&plain, &rows)));
    }
    let number = |value: Option<f64>, decimals: usize| {
        value.map_or_else(|| "–".to_owned(), |v| format!("{v:.decimals$}"))
    };
    let views: Vec<Vec<String>> = report
        .views
        .iter()
        .map(|view| {
            vec![
                view.name.clone(),
                if view.held_out { "held out" } else { "used" }.to_owned(),
                number(view.psnr_db, 2),
                number(view.ssim, 4),
                number(view.mean_abs, 2),
                percent(view.covered_share),
            ]
        })
        .collect();
    let heads = ["view", "", "PSNR dB#", "SSIM#", "mean |Δ|#", "covered#"];
    cards.push_str(&card("Views", &table(&heads, &views)));
    section(
        "Result",
        "Lengths in metres, colours as sRGB bytes.",
        &format!("<div class=\"cards\">{cards}</div>"),
    )
}

fn refine_rows(refine: &RefineSummary) -> Vec<Vec<String>> {
    let mut rows = vec![];
    if let Some(gain) = &refine.gain {
        let [low, high] = gain.factor_range;
        rows.extend([
            pair("surface points compared", gain.num_points.to_string()),
            pair("colours of them", gain.num_samples.to_string()),
            pair("gains of keyframes", format!("{low:.3} to {high:.3}")),
            pair(
                "median difference between keyframes",
                format!(
                    "{:.1} %, was {:.1} %",
                    100.0 * gain.median_after,
                    100.0 * gain.median_before
                ),
            ),
            pair("time for gains", format!("{:.1} s", gain.seconds)),
        ]);
    }
    if let Some(pose) = &refine.pose {
        let arrows = |values: &[f64]| {
            let texts: Vec<String> = values.iter().map(|v| format!("{v:.2}")).collect();
            texts.join(" → ")
        };
        rows.extend([
            pair(
                "mean offset of photos, px, by round",
                arrows(&pose.offset_px),
            ),
            pair(
                "their difference from renderings, of 255",
                arrows(&pose.residual_255),
            ),
            pair(
                "keyframes turned / put back / unknown",
                format!(
                    "{} / {} / {}",
                    pose.num_turned, pose.num_put_back, pose.num_unknown
                ),
            ),
            pair(
                "largest turn",
                format!("{:.2}°", pose.max_turn_rad.to_degrees()),
            ),
            pair("time for poses", format!("{:.1} s", pose.seconds)),
        ]);
    }
    if let Some(seams) = &refine.seams {
        rows.extend([
            pair("edges between keyframes", seams.num_seams.to_string()),
            pair(
                "mean step at them, linear",
                format!("{:.4}, was {:.4}", seams.step_after, seams.step_before),
            ),
            pair("time for seams", format!("{:.1} s", seams.seconds)),
        ]);
    }
    rows
}

fn repairs_card(repairs: &[Repair]) -> String {
    if repairs.is_empty() {
        return String::new();
    }
    let rows: Vec<Vec<String>> = repairs
        .iter()
        .filter(|repair| repair.count > 0)
        .map(|repair| {
            vec![
                repair.found.clone(),
                grouped(repair.count as u64),
                repair.done.clone(),
            ]
        })
        .collect();
    let nothing = "<p class=\"lead\">The mesh needed none.</p>";
    let found = table(&["found", "how many#", "what was done"], &rows);
    let body = if rows.is_empty() { nothing } else { &found };
    wide_card("Mesh repairs", body)
}

fn mesh_rows(report: &Report) -> Vec<Vec<String>> {
    let mesh = &report.mesh;
    let [x, y, z] = mesh.size_m;
    let mut rows = vec![
        pair("triangles", grouped(mesh.num_triangles as u64)),
        pair("vertices", grouped(mesh.num_vertices as u64)),
        pair("surface", format!("{:.2} m²", mesh.area_m2)),
        pair("extent", format!("{x:.2} × {y:.2} × {z:.2} m")),
    ];
    rows.extend(counts(&mesh.details));
    rows
}

fn chart_rows(report: &Report) -> Vec<Vec<String>> {
    let charts = &report.charts;
    let mut rows = vec![
        pair("charts", grouped(charts.num_charts as u64)),
        pair(
            "triangles in the middle one",
            grouped(charts.median_triangles as u64),
        ),
        pair(
            "triangles in the largest",
            grouped(charts.max_triangles as u64),
        ),
    ];
    let mut optional = |name: &str, value: Option<f64>| {
        if let Some(value) = value {
            rows.push(pair(name, format!("{value:.3}")));
        }
    };
    optional("quasi-conformal error, mean", charts.quasi_conformal_mean);
    optional("quasi-conformal error, worst", charts.quasi_conformal_max);
    optional("smallest area kept", charts.area_ratio_min);
    optional("largest area kept", charts.area_ratio_max);
    optional("stretch, L²", charts.stretch_l2);
    optional("stretch, L∞", charts.stretch_linf);
    optional("seams, m", charts.seam_length_m);
    rows.extend(counts(&charts.details));
    rows
}

fn atlas_rows(report: &Report) -> Vec<Vec<String>> {
    let (atlas, coverage) = (&report.atlas, &report.coverage);
    let [width, height] = atlas.page_size_texel;
    let mut rows = vec![
        pair(
            "pages",
            format!("{} of {width} × {height}", atlas.num_pages),
        ),
        pair("texels per metre", format!("{:.0}", atlas.texels_per_m)),
        pair(
            "texels covered",
            format!(
                "{} ({})",
                grouped(coverage.num_texels),
                percent(atlas.used_share)
            ),
        ),
        pair("gutter", percent(atlas.gutter_share)),
        pair("of charts, gutter included", percent(atlas.footprint_share)),
        pair("texels per m², 5–95 % of triangles", {
            let [low, high] = atlas.texels_per_m2_by_triangle;
            format!("{low:.0}–{high:.0}")
        }),
        pair("texels per m², 5–95 % of area", {
            let [low, high] = atlas.texels_per_m2_by_area;
            format!("{low:.0}–{high:.0}")
        }),
        pair("triangles below a texel", percent(atlas.subtexel_share)),
        pair("from one keyframe", percent(coverage.keyframe_share)),
        pair("mean of frames", percent(coverage.mean_share)),
        pair("never seen, filled", percent(coverage.diffused_share)),
        pair(
            "surface without colour",
            percent(coverage.unpainted_area_share),
        ),
        pair("mean confidence", percent(coverage.mean_confidence)),
    ];
    if let Some(density) = &report.density {
        rows.push(pair(
            "best photo, median",
            format!("{:.0} px/m", density.p50_px_per_m),
        ));
        rows.push(pair(
            "best photo, 10–90 %",
            format!(
                "{:.0}–{:.0} px/m",
                density.p10_px_per_m, density.p90_px_per_m
            ),
        ));
    }
    rows
}

/// Topics, the way of the messages, and what was left out.
pub(super) fn recording(report: &Report) -> String {
    let source = &report.source;
    let topics: Vec<Vec<String>> = source
        .topics
        .iter()
        .map(|topic| {
            vec![
                topic.topic.clone(),
                topic.type_name.clone(),
                topic.role.clone().unwrap_or_else(|| "not used".to_owned()),
                grouped(topic.num_messages),
                topic
                    .rate_hz
                    .map_or_else(|| "–".to_owned(), |hz| format!("{hz:.1}")),
            ]
        })
        .collect();
    let drops: Vec<Vec<String>> = report
        .drops
        .iter()
        .map(|drop| vec![drop.at.clone(), drop.reason.clone(), grouped(drop.count)])
        .collect();
    let mut cards = String::new();
    let heads = ["topic", "type", "used as", "messages#", "Hz#"];
    cards.push_str(&wide_card("Topics", &table(&heads, &topics)));
    cards.push_str(&card(
        "On the way",
        &table(&["", "#"], &counts(&report.counts)),
    ));
    let dropped = table(&["where", "why", "how many#"], &drops);
    let nothing = "<p class=\"lead\">Nothing was left out.</p>";
    cards.push_str(&card(
        "Left out",
        if drops.is_empty() { nothing } else { &dropped },
    ));
    let lead = format!(
        "{}, {}, {:.1} s.",
        source.path,
        bytes(source.num_bytes).join(" "),
        source.duration_s
    );
    section(
        "Recording",
        &lead,
        &format!("<div class=\"cards\">{cards}</div>"),
    )
}

/// Every parameter, folded away.
pub(super) fn parameters(report: &Report) -> String {
    let mut rows = Vec::new();
    flatten("", &report.parameters, &mut rows);
    if rows.is_empty() {
        return String::new();
    }
    format!(
        "<section><details><summary>Parameters ({})</summary>{}</details></section>\n",
        rows.len(),
        table(&["parameter", "value"], &rows)
    )
}

fn flatten(path: &str, value: &Value, rows: &mut Vec<Vec<String>>) {
    match value {
        Value::Object(fields) => {
            for (name, value) in fields {
                let path = if path.is_empty() {
                    name.clone()
                } else {
                    format!("{path}.{name}")
                };
                flatten(&path, value, rows);
            }
        }
        Value::Null if path.is_empty() => {}
        Value::String(text) => rows.push(pair(path, text.clone())),
        other => rows.push(pair(path, other.to_string())),
    }
}

/// One row per keyframe, folded away.
pub(super) fn keyframe_details(keyframes: &[KeyframeRow]) -> String {
    let rows: Vec<Vec<String>> = keyframes
        .iter()
        .map(|k| {
            let [x, y, z] = k.position_m;
            vec![
                k.id.to_string(),
                format!("{:.2}", k.time_s),
                format!("{x:.2}, {y:.2}, {z:.2}"),
                format!("{:.3}", k.sharpness),
                format!("{:.2}", k.mean_luma),
                grouped(k.num_texels),
            ]
        })
        .collect();
    format!(
        "<details><summary>All {} keyframes</summary>{}</details>",
        keyframes.len(),
        table(
            &[
                "id#",
                "time s#",
                "position m",
                "sharpness#",
                "luma#",
                "texels#"
            ],
            &rows
        )
    )
}
