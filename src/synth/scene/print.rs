//! Printed matter: pages, labels, spines, a keyboard and a screen.

use std::sync::Arc;

use crate::synth::hash::{Stream, lattice_noise};
use crate::synth::picture::{Canvas, Picture};
use crate::synth::texture::{Linear, srgb};

const INK: u32 = 0x1d1d22;
const PAPER: u32 = 0xf4f0e6;

const SENTENCES: [&str; 12] = [
    "A texture is a promise that the",
    "surface keeps. Each texel asks one",
    "question: which of the many frames",
    "that saw me saw me best? Near ones",
    "are sharp, far ones are calm, and",
    "those at a slant tell half of it.",
    "The scanner walks, the mesh grows,",
    "and the answer changes. What was",
    "painted well is left alone; what",
    "was guessed is painted again. In",
    "the end every wall has its grain,",
    "and every page can be read. 0123456789",
];

/// A printed page: a headline, two columns' worth of text, a figure.
pub(super) fn printed_page(size_m: [f64; 2], pixel_m: f64, title: &str) -> Arc<Picture> {
    let [w, h] = size_m;
    let mut canvas = Canvas::new(size_m, pixel_m, srgb(PAPER));
    canvas.text([0.08 * w, 0.05 * h], 0.04 * h, 1.5, srgb(INK), title);
    canvas.rect([0.08 * w, 0.115 * h, 0.84 * w, 0.006 * h], srgb(0xa03028));
    let cap = 0.0175 * h;
    for (line, sentence) in SENTENCES.iter().enumerate() {
        let y = (0.145 + 0.034 * line as f64) * h;
        canvas.text([0.08 * w, y], cap, 1.15, srgb(INK), sentence);
    }
    let y0 = 0.58 * h;
    canvas.rect([0.08 * w, y0, 0.40 * w, 0.24 * h], srgb(0xdfe7ec));
    for k in 0..8 {
        let height =
            (0.05 + 0.15 * (0.5 + 0.5 * f64::from(lattice_noise([f64::from(k), 0.0], 5)))) * h;
        let x = (0.10 + 0.046 * f64::from(k)) * w;
        let color = if k % 2 == 0 { 0x2a6a9a } else { 0xd07a2a };
        canvas.rect([x, y0 + 0.23 * h - height, 0.034 * w, height], srgb(color));
    }
    for (line, sentence) in SENTENCES.iter().take(7).enumerate() {
        let y = y0 + 0.034 * line as f64 * h;
        let words = sentence.get(..18).unwrap_or(sentence);
        canvas.text([0.52 * w, y], cap, 1.15, srgb(INK), words);
    }
    for line in 0..3 {
        let sentence = SENTENCES[line + 4];
        canvas.text(
            [0.08 * w, (0.855 + 0.034 * line as f64) * h],
            cap,
            1.15,
            srgb(INK),
            sentence,
        );
    }
    canvas.finish()
}

/// A band of paper with a title, for boxes and cans.
pub(super) fn label(
    size_m: [f64; 2],
    pixel_m: f64,
    [ground, accent, ink]: [u32; 3],
    [title, line]: [&str; 2],
) -> Canvas {
    let [w, h] = size_m;
    let mut canvas = Canvas::new(size_m, pixel_m, srgb(ground));
    canvas.rect([0.0, 0.10 * h, w, 0.03 * h], srgb(accent));
    canvas.rect([0.0, 0.87 * h, w, 0.03 * h], srgb(accent));
    let cap = (0.16 * h).min(0.8 * w / (title.len().max(1) as f64 * 6.0) * 7.0);
    canvas.disc([0.5 * w, 0.60 * h], 0.17 * h.min(w), srgb(accent));
    canvas.disc(
        [0.5 * w + 0.05 * w, 0.60 * h - 0.03 * h],
        0.08 * h.min(w),
        srgb(ground),
    );
    canvas.text_centred([0.5 * w, 0.20 * h], cap, 1.5, srgb(ink), title);
    let small = (0.055 * h).min(0.84 * w / (line.len().max(1) as f64 * 6.0) * 7.0);
    canvas.text_centred([0.5 * w, 0.79 * h], small, 1.2, srgb(ink), line);
    canvas
}

/// A label that goes round: the front one, a table of contents and a bar code beside it.
pub(super) fn wrapped_label(
    size_m: [f64; 2],
    pixel_m: f64,
    colors: [u32; 3],
    words: [&str; 2],
) -> Arc<Picture> {
    let [w, h] = size_m;
    let [ground, accent, ink] = colors.map(srgb);
    let mut canvas = Canvas::new(size_m, pixel_m, ground);
    canvas.rect([0.0, 0.05 * h, w, 0.05 * h], accent);
    canvas.rect([0.0, 0.90 * h, w, 0.05 * h], accent);
    for quarter in 0..2 {
        // u starts at the front, so that a title there would be cut by the seam.
        let x = (0.25 + 0.5 * f64::from(quarter)) * w;
        let cap = (0.26 * h).min(0.40 * w / (words[0].len().max(1) as f64 * 6.0) * 7.0);
        canvas.text_centred([x, 0.26 * h], cap, 1.5, ink, words[0]);
        canvas.text_centred([x, 0.66 * h], 0.09 * h, 1.2, ink, words[1]);
    }
    for seam in [0.0, 0.5, 1.0] {
        canvas.disc([seam * w, 0.5 * h], 0.24 * h, accent);
        canvas.disc([seam * w, 0.5 * h], 0.15 * h, ground);
    }
    canvas.finish()
}

/// The back of a book, read with the head tilted: title along the height.
pub(super) fn spine(
    [w, h]: [f64; 2],
    pixel_m: f64,
    ground: Linear,
    ink: Linear,
    title: &str,
) -> Arc<Picture> {
    // Painted lying, then turned: text runs downwards on the standing book.
    let mut canvas = Canvas::new([h, w], pixel_m, ground);
    for x in [0.05, 0.09, 0.91] {
        canvas.rect([x * h, 0.0, 0.012 * h, w], ink);
    }
    let cap = (0.52 * w).min(0.74 * h / (title.len().max(1) as f64 * 6.0) * 7.0);
    canvas.text([0.14 * h, 0.5 * (w - cap)], cap, 1.4, ink, title);
    canvas.turned().finish()
}

/// Keys in rows.
pub(super) fn keyboard([w, h]: [f64; 2], pixel_m: f64) -> Arc<Picture> {
    let mut canvas = Canvas::new([w, h], pixel_m, srgb(0xb9bcc2));
    let rows = [
        "1234567890-=",
        "QWERTYUIOP[]",
        "ASDFGHJKL;'#",
        "ZXCVBNM,./@!",
    ];
    let key = 0.94 * w / 12.0;
    for (j, row) in rows.iter().enumerate() {
        for (i, letter) in row.char_indices() {
            let x = 0.03 * w + i as f64 * key;
            let y = 0.06 * h + j as f64 * key;
            canvas.rect(
                [x + 0.06 * key, y + 0.06 * key, 0.88 * key, 0.88 * key],
                srgb(0x2c2e34),
            );
            canvas.text(
                [x + 0.32 * key, y + 0.26 * key],
                0.45 * key,
                1.2,
                srgb(0xf0f0f0),
                &letter.to_string(),
            );
        }
    }
    canvas.rect([0.32 * w, 0.62 * h, 0.36 * w, 0.30 * h], srgb(0x9a9da4));
    canvas.finish()
}

/// A screen with lines of a program.
pub(super) fn screen([w, h]: [f64; 2], pixel_m: f64, random: Stream) -> Arc<Picture> {
    let mut canvas = Canvas::new([w, h], pixel_m, srgb(0x14161a));
    canvas.rect([0.03 * w, 0.04 * h, 0.94 * w, 0.92 * h], srgb(0x1c2638));
    canvas.rect([0.03 * w, 0.04 * h, 0.94 * w, 0.08 * h], srgb(0x3a4a6a));
    canvas.text(
        [0.06 * w, 0.06 * h],
        0.04 * h,
        1.2,
        srgb(0xe8eef8),
        "atlas.rs",
    );
    let words = [
        "fn", "let", "mesh", "texel", "= 0;", "for", "chart", "+=", "uv", "{ }", "pub", "pose",
    ];
    let inks = [0xe07070, 0x80c0f0, 0xe8d880, 0x90d090, 0xd0a0e0];
    for line in 0..10u64 {
        let mut x = (0.06 + 0.04 * (line % 3) as f64) * w;
        for word in 0..4u64 {
            let pick = random.bits(line * 16 + word);
            let text = words[(pick % 12) as usize];
            canvas.text(
                [x, (0.17 + 0.077 * line as f64) * h],
                0.036 * h,
                1.2,
                srgb(inks[(pick / 12 % 5) as usize]),
                text,
            );
            x += (text.len() as f64 + 1.0) * 6.0 / 7.0 * 0.036 * h;
        }
    }
    canvas.finish()
}
