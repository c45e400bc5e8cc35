//! One picture of a held-out view: per method a row with the photo, the rendering, and how they
//! differ before and after alignment.

use std::path::Path;

use anyhow::Context;

use crate::export::pages::jpeg_rgb8;
use crate::export::write_atomic;
use crate::geom::ColorImage;
use crate::metrics::protocol::MethodView;
use crate::report::colors::of_difference;
use crate::report::pictures::{downscale, hatch};
use crate::synth::dot_columns;

/// Longer side of each picture.
const PANEL_PX: u32 = 480;
const GAP_PX: u32 = 8;
/// Side of a dot of the labels' letters.
const DOT_PX: u32 = 2;
const LABEL_PX: u32 = 7 * DOT_PX + 8;
const BACKGROUND: [u8; 3] = [24, 25, 28];
const INK: [u8; 3] = [235, 235, 235];
const QUALITY: u8 = 90;

/// A picture that is drawn on.
struct Canvas {
    width: u32,
    height: u32,
    pixels: Vec<[u8; 3]>,
}

impl Canvas {
    fn new(width: u32, height: u32) -> Self {
        Self {
            width,
            height,
            pixels: vec![BACKGROUND; width as usize * height as usize],
        }
    }

    fn set(&mut self, x: u32, y: u32, rgb: [u8; 3]) {
        if x < self.width && y < self.height {
            self.pixels[y as usize * self.width as usize + x as usize] = rgb;
        }
    }

    fn draw(&mut self, image: &ColorImage, [left, top]: [u32; 2]) {
        for y in 0..image.height() {
            for x in 0..image.width() {
                self.set(left + x, top + y, image.pixel_clamped(x, y));
            }
        }
    }

    fn write(&mut self, text: &str, [left, top]: [u32; 2]) {
        for (at, character) in (0u32..).zip(text.chars()) {
            for (column, bits) in (0u32..).zip(dot_columns(character)) {
                for row in (0..7).filter(|row| bits >> row & 1 == 1) {
                    for dot in 0..DOT_PX * DOT_PX {
                        let x = left + (at * 6 + column) * DOT_PX + dot % DOT_PX;
                        self.set(x, top + row * DOT_PX + dot / DOT_PX, INK);
                    }
                }
            }
        }
    }
}

/// The largest difference of a channel where `is_there`, hatched elsewhere.
fn difference(a: &ColorImage, b: &ColorImage, is_there: impl Fn(usize) -> bool) -> ColorImage {
    let width = a.width() as usize;
    let pixels = a.pixels().iter().zip(b.pixels()).enumerate();
    let pixels = pixels.map(|(i, (pa, pb))| {
        if !is_there(i) {
            return hatch(i % width, i / width);
        }
        let channels = pa.iter().zip(pb).map(|(ca, cb)| ca.abs_diff(*cb));
        of_difference(channels.max().unwrap_or(0))
    });
    // Both come from one view, so that the size is right.
    ColorImage::new(a.width(), a.height(), pixels.collect()).unwrap_or_else(|_| a.clone())
}

fn hatched(view: &MethodView) -> ColorImage {
    let width = view.render.width() as usize;
    let pixels = view.render.pixels().iter().zip(&view.mask).enumerate();
    let pixels = pixels.map(|(i, (rgb, &is_there))| {
        if is_there {
            *rgb
        } else {
            hatch(i % width, i / width)
        }
    });
    ColorImage::new(view.render.width(), view.render.height(), pixels.collect())
        .unwrap_or_else(|_| view.render.clone())
}

/// What a method shows of the view.
pub(super) struct Row {
    pub(super) label: String,
    pub(super) view: MethodView,
    /// The photo's part that was compared, masked.
    pub(super) aligned_photo: ColorImage,
    /// The same part of the aligned rendering.
    pub(super) aligned_render: ColorImage,
}

/// Writes the sheet as JPEG.
pub(super) fn write(
    path: &Path,
    title: &str,
    photo: &ColorImage,
    rows: &[Row],
) -> anyhow::Result<()> {
    let small_photo = downscale(photo, PANEL_PX);
    let [panel_width, panel_height] = [small_photo.width(), small_photo.height()];
    let row_px = panel_height + LABEL_PX + GAP_PX;
    let num_rows = u32::try_from(rows.len()).context("too many methods")?;
    let mut canvas = Canvas::new(
        4 * (panel_width + GAP_PX) + GAP_PX,
        LABEL_PX + GAP_PX + num_rows * row_px,
    );
    let legend = "photo | rendering | difference before | and after alignment (black 0, bright 64)";
    canvas.write(&format!("{title}: {legend}"), [GAP_PX, GAP_PX]);
    for (index, row) in (0u32..).zip(rows) {
        let top = LABEL_PX + GAP_PX + index * row_px;
        canvas.write(&row.label, [GAP_PX, top + 4]);
        let (before, after) = (&row.aligned_photo, &row.aligned_render);
        let is_common = |i: usize| before.pixels()[i] != [0; 3] || after.pixels()[i] != [0; 3];
        let panels = [
            photo.clone(),
            hatched(&row.view),
            difference(photo, &row.view.render, |i| row.view.mask[i]),
            difference(before, after, is_common),
        ];
        for (column, panel) in (0u32..).zip(&panels) {
            let left = GAP_PX + column * (panel_width + GAP_PX);
            canvas.draw(&downscale(panel, PANEL_PX), [left, top + LABEL_PX]);
        }
    }
    let jpeg = jpeg_rgb8(
        canvas.width,
        canvas.height,
        canvas.pixels.as_flattened(),
        QUALITY,
    )
    .map_err(anyhow::Error::msg)
    .with_context(|| format!("{} does not encode", path.display()))?;
    write_atomic(path, |out| out.write_all(&jpeg))?;
    Ok(())
}
