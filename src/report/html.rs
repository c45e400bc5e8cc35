//! The page: what is shown, in which order.

use std::fmt::Write;

use base64::Engine;
use base64::engine::general_purpose::STANDARD;

use crate::export::TexturedMesh;
use crate::export::pages::jpeg_rgb8;
use crate::geom::ColorImage;

use super::data::{Report, Severity};
use super::{ReportError, ReportView, sections, tables};

const STYLE: &str = include_str!("style.css");

/// JPEG quality of photos and renderings; diagrams get the same, at full colour resolution.
const QUALITY: u8 = 90;

/// Renders the whole page.
pub(super) fn render(
    report: &Report,
    textured: Option<&TexturedMesh<'_>>,
    views: &[ReportView],
) -> Result<String, ReportError> {
    let mut body = String::new();
    body.push_str(&header(report));
    body.push_str(&notes(report));
    body.push_str(&sections::views(report, textured, views)?);
    if let Some(textured) = textured {
        body.push_str(&sections::atlas(textured)?);
        body.push_str(&sections::keyframes(report, textured)?);
    }
    body.push_str(&tables::time(report));
    body.push_str(&tables::result(report));
    body.push_str(&tables::recording(report));
    body.push_str(&tables::parameters(report));
    let title = escape(&report.title);
    let generator = escape(&report.generator);
    Ok(format!(
        "<!doctype html>\n<html lang=\"en\"><head><meta charset=\"utf-8\">\n\
         <meta name=\"viewport\" content=\"width=device-width,initial-scale=1\">\n\
         <title>{title} · veneer</title>\n<style>{STYLE}</style></head>\n<body><main>\n{body}\
         <footer>{generator}</footer>\n</main></body></html>\n"
    ))
}

fn header(report: &Report) -> String {
    let mut figures = String::new();
    let mut figure = |value: String, unit: &str, label: &str| {
        push(
            &mut figures,
            format_args!(
                "<div class=\"figure\"><b>{}<small>{}</small></b><span>{}</span></div>",
                escape(&value),
                escape(unit),
                escape(label)
            ),
        );
    };
    let coverage = &report.coverage;
    if coverage.num_texels > 0 {
        let painted = 1.0 - coverage.unpainted_area_share;
        let seen = (coverage.keyframe_share + coverage.mean_share) * painted;
        figure(format!("{:.1}", seen * 100.0), " %", "of the surface seen");
    }
    let psnr_of = |held_out: bool| -> Vec<f64> {
        let views = report.views.iter().filter(|view| view.held_out == held_out);
        views.filter_map(|view| view.psnr_db).collect()
    };
    let (psnrs, label) = match psnr_of(true) {
        psnrs if psnrs.is_empty() => (psnr_of(false), "PSNR, views that were used"),
        psnrs => (psnrs, "PSNR, held-out views"),
    };
    if !psnrs.is_empty() {
        let mean = psnrs.iter().sum::<f64>() / psnrs.len() as f64;
        figure(format!("{mean:.1}"), " dB", label);
    }
    if report.atlas.texels_per_m > 0.0 {
        let texel_mm = 1000.0 / report.atlas.texels_per_m;
        figure(format!("{texel_mm:.1}"), " mm", "per texel");
    }
    figure(format!("{:.1}", report.total_s), " s", "from bag to files");
    if let Some(bytes) = report.peak_memory_bytes {
        let [value, unit] = tables::bytes(bytes);
        figure(value, &format!(" {unit}"), "peak memory");
    }
    let mut facts = vec![
        format!(
            "{} triangles",
            tables::grouped(report.mesh.num_triangles as u64)
        ),
        format!(
            "{} charts",
            tables::grouped(report.charts.num_charts as u64)
        ),
        format!(
            "{} keyframes",
            tables::grouped(report.keyframes.len() as u64)
        ),
        format!(
            "{} page{}",
            report.atlas.num_pages,
            plural(report.atlas.num_pages)
        ),
    ];
    if report.source.duration_s > 0.0 {
        facts.push(format!("{:.0} s of recording", report.source.duration_s));
    }
    format!(
        "<header><h1>{}</h1><p class=\"facts\">{}</p><div class=\"figures\">{figures}</div></header>\n",
        escape(&report.title),
        escape(&facts.join(" · "))
    )
}

fn plural(count: usize) -> &'static str {
    if count == 1 { "" } else { "s" }
}

fn notes(report: &Report) -> String {
    if report.notes.is_empty() {
        return String::new();
    }
    let mut sorted: Vec<_> = report.notes.iter().collect();
    sorted.sort_by_key(|note| std::cmp::Reverse(note.severity));
    let mut items = String::new();
    for note in sorted {
        let (class, mark) = match note.severity {
            Severity::Problem => ("problem", "Problem"),
            Severity::Warning => ("warning", "Note"),
            Severity::Info => ("info", "Hint"),
        };
        push(
            &mut items,
            format_args!(
                "<li class=\"{class}\"><b>{mark}</b> {}</li>",
                escape(&note.text)
            ),
        );
    }
    format!("<ul class=\"notes\">{items}</ul>\n")
}

/// A section with a heading and a sentence under it.
pub(super) fn section(heading: &str, lead: &str, body: &str) -> String {
    format!(
        "<section><h2>{}</h2><p class=\"lead\">{}</p>\n{body}</section>\n",
        escape(heading),
        escape(lead)
    )
}

/// An `<img>` with the picture inside.
pub(super) fn img(image: &ColorImage, alt: &str) -> Result<String, ReportError> {
    let (width, height) = (image.width(), image.height());
    let jpeg =
        jpeg_rgb8(width, height, image.pixels().as_flattened(), QUALITY).map_err(|reason| {
            ReportError::Encode {
                width,
                height,
                reason,
            }
        })?;
    Ok(format!(
        "<img width=\"{width}\" height=\"{height}\" alt=\"{}\" src=\"data:image/jpeg;base64,{}\">",
        escape(alt),
        STANDARD.encode(jpeg)
    ))
}

/// Appends formatted text; writing to a string does not fail.
pub(super) fn push(out: &mut String, text: std::fmt::Arguments<'_>) {
    if out.write_fmt(text).is_err() {
        out.push('…');
    }
}

/// Text as HTML shows it, in elements and in quoted attributes.
pub(super) fn escape(text: &str) -> String {
    let mut out = String::with_capacity(text.len());
    for c in text.chars() {
        match c {
            '&' => out.push_str("&amp;"),
            '<' => out.push_str("&lt;"),
            '>' => out.push_str("&gt;"),
            '"' => out.push_str("&quot;"),
            '\'' => out.push_str("&#39;"),
            // Neither HTML nor a reader knows what to do with the others below space.
            '\n' | '\t' => out.push(c),
            c if c.is_control() => out.push('\u{FFFD}'),
            c => out.push(c),
        }
    }
    out
}
