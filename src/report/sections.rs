//! The parts of the page that are pictures.

use rayon::prelude::*;

use crate::export::{TexturedMesh, page_path};
use crate::geom::ColorImage;

use super::data::{KeyframeRow, Report, ViewScore};
use super::html::{escape, img, push, section};
use super::plan::Plan;
use super::{ReportError, ReportView, colors, page_pictures, pictures, tables};

const MAX_VIEW_SIDE_PX: u32 = 960;
const MAX_DIAGRAM_SIDE_PX: u32 = 480;
const MAX_ATLAS_SIDE_PX: u32 = 1280;
const MAX_PAGE_DIAGRAM_SIDE_PX: u32 = 768;
const PLAN_SIDE_PX: u32 = 900;
/// Beyond these many pages the file would be too large to mail; the rest is named.
const MAX_PAGES_SHOWN: usize = 8;

/// Photo and rendering under one slider, their difference and the charts, per view.
pub(super) fn views(
    report: &Report,
    textured: Option<&TexturedMesh<'_>>,
    views: &[ReportView],
) -> Result<String, ReportError> {
    if views.is_empty() {
        return Ok(String::new());
    }
    let cards: Vec<Result<String, ReportError>> = views
        .par_iter()
        .enumerate()
        .map(|(index, view)| card(view, report.views.get(index), textured))
        .collect();
    let cards = cards.into_iter().collect::<Result<Vec<_>, _>>()?.concat();
    let lead = if views.iter().all(|view| view.held_out) {
        "None of these photos was used for the texture. Drag across a picture: photo on the left, \
         rendering on the right."
    } else {
        "Drag across a picture: photo on the left, rendering on the right. Views not marked as \
         held out were used for the texture."
    };
    let scale = format!(
        "<p class=\"legend\"><i class=\"ramp\" style=\"background:{}\"></i> difference 0 to {} of \
         255 (largest channel) <i class=\"hatch\"></i> no mesh there</p>",
        colors::difference_gradient(),
        colors::MAX_DIFFERENCE
    );
    Ok(section(
        "Renderings beside photos",
        lead,
        &format!("<div class=\"views\">{cards}</div>{scale}"),
    ))
}

fn card(
    view: &ReportView,
    score: Option<&ViewScore>,
    textured: Option<&TexturedMesh<'_>>,
) -> Result<String, ReportError> {
    let photo = img(
        &pictures::downscale(&view.photo, MAX_VIEW_SIDE_PX),
        &format!("photo of {}", view.name),
    )?;
    let render = img(
        &pictures::downscale(&pictures::masked_render(view), MAX_VIEW_SIDE_PX),
        &format!("rendering of {}", view.name),
    )?;
    let mut side = String::new();
    let mut small = |image: &ColorImage, caption: &str| -> Result<(), ReportError> {
        let picture = img(&pictures::downscale(image, MAX_DIAGRAM_SIDE_PX), caption)?;
        push(
            &mut side,
            format_args!("<figure>{picture}<figcaption>{caption}</figcaption></figure>"),
        );
        Ok(())
    };
    small(&pictures::difference(view), "difference")?;
    if let Some(textured) = textured {
        if let Some(image) = pictures::charts(view, textured) {
            small(&image, "charts and seams")?;
        }
        if let Some(image) = pictures::provenance(view, textured) {
            small(&image, "which keyframe")?;
        }
    }
    let mut facts = vec![format!("<b>{}</b>", escape(&view.name))];
    if !view.held_out {
        facts.push("used for the texture".to_owned());
    }
    if let Some(score) = score {
        facts.extend(score.psnr_db.map(|v| format!("PSNR {v:.1} dB")));
        facts.extend(score.ssim.map(|v| format!("SSIM {v:.3}")));
        facts.push(format!("{:.0} % covered", score.covered_share * 100.0));
    }
    let aspect = f64::from(view.photo.width()) / f64::from(view.photo.height());
    Ok(format!(
        "<article class=\"view\" style=\"--aspect:{aspect:.4}\">\
         <div class=\"pair\"><div class=\"swipe\">{photo}{render}\
         <input type=\"range\" min=\"0\" max=\"100\" value=\"50\" step=\"0.1\" \
         aria-label=\"photo or rendering\" \
         oninput=\"this.parentNode.style.setProperty('--x',this.value+'%')\">\
         <span class=\"tag left\">photo</span><span class=\"tag right\">rendering</span></div>\
         <div class=\"side\">{side}</div></div>\
         <p class=\"facts\">{}</p></article>\n",
        facts.join(" · ")
    ))
}

/// The pages, and what is known of their texels.
pub(super) fn atlas(textured: &TexturedMesh<'_>) -> Result<String, ReportError> {
    let num_pages = textured.texture().pages.len();
    if num_pages == 0 {
        return Ok(String::new());
    }
    let shown = num_pages.min(MAX_PAGES_SHOWN);
    let pages: Vec<Result<String, ReportError>> = (0..shown)
        .into_par_iter()
        .map(|page| page_figures(textured, page))
        .collect();
    let mut body = pages.into_iter().collect::<Result<Vec<_>, _>>()?.concat();
    if shown < num_pages {
        push(
            &mut body,
            format_args!(
                "<p class=\"lead\">{} more pages are in the folder atlas/.</p>",
                num_pages - shown
            ),
        );
    }
    let swatch = |color, text: &str| {
        format!(
            "<i class=\"swatch\" style=\"background:{}\"></i> {text} ",
            colors::css(color)
        )
    };
    push(
        &mut body,
        format_args!(
            "<p class=\"legend\">{}{}{}{}<i class=\"ramp\" style=\"background:{}\"></i> \
             confidence, low to high</p>",
            swatch(colors::KEYFRAME, "one keyframe"),
            swatch(colors::MEAN, "mean of frames"),
            swatch(colors::DIFFUSED, "never seen, filled"),
            swatch(colors::GUTTER, "gutter"),
            colors::confidence_gradient()
        ),
    );
    let lead = "What the files carry. Click a page for the full image beside this file.";
    Ok(section("Atlas", lead, &body))
}

fn page_figures(textured: &TexturedMesh<'_>, index: usize) -> Result<String, ReportError> {
    let page = &textured.texture().pages[index];
    let side = MAX_PAGE_DIAGRAM_SIDE_PX;
    let diagrams = [
        (
            "charts and seams",
            page_pictures::charts(textured, index, side),
        ),
        ("coverage", page_pictures::coverage(page, side)),
        ("which keyframe", page_pictures::provenance(page, side)),
        ("confidence", page_pictures::confidence(page, side)),
    ];
    let mut out = String::from("<div class=\"page\">");
    if let Some(image) = page_pictures::texels(page, MAX_ATLAS_SIDE_PX) {
        push(
            &mut out,
            format_args!(
                "<figure class=\"large\"><a href=\"{}\">{}</a><figcaption>page {index}, {} × {} \
                 texels</figcaption></figure>",
                page_path(index),
                img(&image, &format!("atlas page {index}"))?,
                page.width,
                page.height
            ),
        );
    }
    for (caption, image) in diagrams {
        if let Some(image) = image {
            push(
                &mut out,
                format_args!(
                    "<figure>{}<figcaption>{caption}</figcaption></figure>",
                    img(&image, caption)?
                ),
            );
        }
    }
    out.push_str("</div>\n");
    Ok(out)
}

/// The camera's way over the scan from above, and what each keyframe painted.
pub(super) fn keyframes(
    report: &Report,
    textured: &TexturedMesh<'_>,
) -> Result<String, ReportError> {
    if report.keyframes.is_empty() {
        return Ok(String::new());
    }
    let mut body = String::new();
    if let Some(plan) = Plan::draw(textured, &report.keyframes, PLAN_SIDE_PX) {
        push(
            &mut body,
            format_args!(
                "<figure class=\"plan\" style=\"max-width:{}px\">{}{}<figcaption>from above, \
                 opened at the camera's height; grid of 1 m</figcaption></figure>",
                plan.image.width(),
                img(&plan.image, "the scan from above")?,
                path_svg(&plan, &report.keyframes)
            ),
        );
    }
    body.push_str(&bars_svg(&report.keyframes));
    body.push_str(&tables::keyframe_details(&report.keyframes));
    let lead = "Where the kept frames were taken, and how much of the texture each one painted. \
                Colours are those of the keyframe pictures.";
    Ok(section(
        "Keyframes",
        lead,
        &format!("<div class=\"keyframes\">{body}</div>"),
    ))
}

fn path_svg(plan: &Plan, keyframes: &[KeyframeRow]) -> String {
    let (width, height) = (plan.image.width(), plan.image.height());
    let place = |k: &KeyframeRow| plan.px([k.position_m[0], k.position_m[1]]);
    let mut svg = format!(
        "<svg viewBox=\"0 0 {width} {height}\" aria-hidden=\"true\"><path class=\"grid\" d=\""
    );
    let step = plan.px_per_m();
    let [zero_x, zero_y] = plan.px([0.0, 0.0]);
    // Kilometres of grid lines would be a grey field.
    if step > 12.0 {
        let mut x = zero_x.rem_euclid(step);
        while x < f64::from(width) {
            push(&mut svg, format_args!("M{x:.1} 0V{height}"));
            x += step;
        }
        let mut y = zero_y.rem_euclid(step);
        while y < f64::from(height) {
            push(&mut svg, format_args!("M0 {y:.1}H{width}"));
            y += step;
        }
    }
    svg.push_str("\"/><polyline class=\"path\" points=\"");
    for keyframe in keyframes {
        let [x, y] = place(keyframe);
        push(&mut svg, format_args!("{x:.1},{y:.1} "));
    }
    svg.push_str("\"/>");
    for keyframe in keyframes {
        let [x, y] = place(keyframe);
        let [dx, dy, _] = keyframe.direction;
        push(
            &mut svg,
            format_args!(
                "<line x1=\"{x:.1}\" y1=\"{y:.1}\" x2=\"{:.1}\" y2=\"{:.1}\"/>\
                 <circle cx=\"{x:.1}\" cy=\"{y:.1}\" r=\"5\" fill=\"{}\"><title>keyframe {} at \
                 {:.2} s</title></circle>",
                x + dx * 16.0,
                y - dy * 16.0,
                colors::css(colors::of_label(keyframe.id)),
                keyframe.id,
                keyframe.time_s
            ),
        );
    }
    svg.push_str("</svg>");
    svg
}

fn bars_svg(keyframes: &[KeyframeRow]) -> String {
    const HEIGHT: f64 = 120.0;
    let most = keyframes
        .iter()
        .map(|k| k.num_texels)
        .max()
        .unwrap_or(0)
        .max(1);
    let step = 1000.0 / keyframes.len() as f64;
    let mut svg = format!(
        "<figure class=\"bars\"><svg viewBox=\"0 0 1000 {HEIGHT}\" preserveAspectRatio=\"none\" \
         role=\"img\" aria-label=\"texels painted by each keyframe\">"
    );
    for (index, keyframe) in keyframes.iter().enumerate() {
        let height = (HEIGHT - 4.0) * keyframe.num_texels as f64 / most as f64 + 1.0;
        push(
            &mut svg,
            format_args!(
                "<rect x=\"{:.2}\" y=\"{:.2}\" width=\"{:.2}\" height=\"{height:.2}\" \
                 fill=\"{}\"><title>keyframe {}: {} texels</title></rect>",
                index as f64 * step,
                HEIGHT - height,
                (step * 0.86).max(0.2),
                colors::css(colors::of_label(keyframe.id)),
                keyframe.id,
                tables::grouped(keyframe.num_texels)
            ),
        );
    }
    svg.push_str(
        "</svg><figcaption>texels painted by each keyframe, in order</figcaption></figure>",
    );
    svg
}
