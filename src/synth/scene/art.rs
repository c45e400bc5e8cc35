//! What hangs on walls and lies on floors: posters, paintings, window, door, rug, globe.

use std::f64::consts::TAU;
use std::sync::Arc;

use crate::synth::hash::lattice_noise;
use crate::synth::picture::{Canvas, Picture};
use crate::synth::texture::{Linear, srgb};

const INK: u32 = 0x1d1d22;

/// Geometric poster with a large title.
pub(super) fn geometric_poster(size_m: [f64; 2], pixel_m: f64) -> Arc<Picture> {
    let [w, h] = size_m;
    let mut canvas = Canvas::new(size_m, pixel_m, srgb(0xefe3c8));
    canvas.disc([0.62 * w, 0.30 * h], 0.26 * w, srgb(0xc93a2b));
    canvas.rect([0.10 * w, 0.34 * h, 0.36 * w, 0.36 * w], srgb(0x244f8f));
    canvas.ring(
        [0.28 * w, 0.34 * h + 0.18 * w],
        0.11 * w,
        0.03 * w,
        srgb(0xefe3c8),
    );
    for k in 0..7 {
        let y = (0.60 + 0.022 * f64::from(k)) * h;
        canvas.line([0.1 * w, y], [0.9 * w, y - 0.12 * h], 0.008 * w, srgb(INK));
    }
    canvas.disc([0.80 * w, 0.58 * h], 0.10 * w, srgb(0xe8b02a));
    canvas.text_centred([0.5 * w, 0.75 * h], 0.075 * h, 1.6, srgb(INK), "FORM");
    canvas.text_centred(
        [0.5 * w, 0.87 * h],
        0.028 * h,
        1.2,
        srgb(INK),
        "colour & surface",
    );
    canvas.text_centred(
        [0.5 * w, 0.92 * h],
        0.022 * h,
        1.0,
        srgb(0x7a3024),
        "1 - 28 February",
    );
    frame(&mut canvas, 0.02 * w, srgb(0x221c18));
    canvas.finish()
}

/// Mountains at dusk.
pub(super) fn landscape(size_m: [f64; 2], pixel_m: f64) -> Arc<Picture> {
    let [w, h] = size_m;
    let mut canvas = Canvas::new(size_m, pixel_m, [0.0; 3]);
    canvas.gradient([0.0, 0.45 * h], srgb(0x2c4a7c), srgb(0xf09a5a));
    canvas.gradient([0.45 * h, h], srgb(0xf3b470), srgb(0x4a3a5c));
    canvas.disc([0.66 * w, 0.40 * h], 0.09 * w, srgb(0xffeec4));
    let ridges = [
        (0.50, 0.20, 0x8a6a8e),
        (0.62, 0.16, 0x554a78),
        (0.76, 0.12, 0x2d3055),
    ];
    for (salt, (level, height, color)) in (11..).zip(ridges) {
        canvas.shape([0.0, 0.0, w, h], srgb(color), |x, y| {
            let rough = f64::from(lattice_noise([x / (0.22 * w), 0.5], salt))
                + 0.45 * f64::from(lattice_noise([x / (0.07 * w), 7.5], salt))
                + 0.15 * f64::from(lattice_noise([x / (0.02 * w), 3.5], salt));
            (level - 0.5 * height * rough) * h - y
        });
    }
    for k in 0..9 {
        let x = (0.06 + 0.11 * f64::from(k)) * w;
        let foot = (0.93 + 0.02 * f64::from(k % 3)) * h;
        for tier in 0..4 {
            let y = foot - (0.03 + 0.028 * f64::from(tier)) * h;
            let half = (0.035 - 0.007 * f64::from(tier)) * w;
            canvas.line([x - half, y], [x + half, y], 0.02 * h, srgb(0x142624));
        }
    }
    frame(&mut canvas, 0.03 * w, srgb(0x6e4a2a));
    canvas.finish()
}

/// Letters from large to small.
pub(super) fn eye_chart(size_m: [f64; 2], pixel_m: f64) -> Arc<Picture> {
    let [w, h] = size_m;
    let mut canvas = Canvas::new(size_m, pixel_m, srgb(0xf7f6f0));
    let rows = [
        "E",
        "F P",
        "T O Z",
        "L P E D",
        "P E C F D",
        "E D F C Z P",
        "F E L O P Z D",
        "D E F P O T E C",
    ];
    let mut y = 0.05 * h;
    let mut height = 0.16 * h;
    for (number, row) in (1..).zip(rows) {
        canvas.text_centred([0.5 * w, y], height, 1.25, srgb(INK), row);
        canvas.text(
            [0.93 * w, y + 0.3 * height],
            0.018 * h,
            1.0,
            srgb(0xb02a2a),
            &format!("{number}"),
        );
        y += height + 0.028 * h;
        height *= 0.76;
    }
    canvas.rect([0.08 * w, 0.92 * h, 0.84 * w, 0.012 * h], srgb(0x2a8a3a));
    canvas.rect([0.08 * w, 0.945 * h, 0.84 * w, 0.012 * h], srgb(0xc02a2a));
    frame(&mut canvas, 0.012 * w, srgb(0x9a9a9a));
    canvas.finish()
}

/// Twenty-four colour patches over a grey ramp.
pub(super) fn color_chart(size_m: [f64; 2], pixel_m: f64) -> Arc<Picture> {
    const PATCHES: [u32; 24] = [
        0x735244, 0xc29682, 0x627a9d, 0x576c43, 0x8580b1, 0x67bdaa, 0xd67e2c, 0x505ba6, 0xc15a63,
        0x5e3c6c, 0x9dbc40, 0xe0a32e, 0x383d96, 0x469449, 0xaf363c, 0xe7c71f, 0xbb5695, 0x0885a1,
        0xf3f3f2, 0xc8c8c8, 0xa0a0a0, 0x7a7a79, 0x555555, 0x343434,
    ];
    let [w, h] = size_m;
    let mut canvas = Canvas::new(size_m, pixel_m, srgb(0x202020));
    let pitch = (w / 6.3).min(h / 4.4);
    let [left, top] = [(w - 6.0 * pitch) / 2.0, (h - 4.0 * pitch) / 2.0];
    for (index, patch) in PATCHES.into_iter().enumerate() {
        let x = left + (index % 6) as f64 * pitch;
        let y = top + (index / 6) as f64 * pitch;
        canvas.rect(
            [
                x + 0.06 * pitch,
                y + 0.06 * pitch,
                0.88 * pitch,
                0.88 * pitch,
            ],
            srgb(patch),
        );
    }
    canvas.finish()
}

/// A plan of transit lines with named stops.
pub(super) fn transit_map(size_m: [f64; 2], pixel_m: f64) -> Arc<Picture> {
    let [w, h] = size_m;
    let mut canvas = Canvas::new(size_m, pixel_m, srgb(0xf6f8f8));
    canvas.line(
        [0.0, 0.72 * h],
        [0.35 * w, 0.62 * h],
        0.09 * h,
        srgb(0xbfddec),
    );
    canvas.line(
        [0.35 * w, 0.62 * h],
        [w, 0.80 * h],
        0.09 * h,
        srgb(0xbfddec),
    );
    let lines: [(u32, &[[f64; 2]]); 4] = [
        (
            0xd82a2a,
            &[[0.08, 0.30], [0.35, 0.30], [0.55, 0.50], [0.92, 0.50]],
        ),
        (
            0x1f6fc0,
            &[[0.20, 0.90], [0.20, 0.60], [0.50, 0.30], [0.85, 0.30]],
        ),
        (
            0x2f9a4a,
            &[[0.10, 0.50], [0.40, 0.50], [0.70, 0.80], [0.92, 0.80]],
        ),
        (
            0xe8a020,
            &[[0.70, 0.16], [0.70, 0.62], [0.50, 0.86], [0.36, 0.92]],
        ),
    ];
    let at = |[x, y]: [f64; 2]| [x * w, y * h];
    for (color, stops) in lines {
        for pair in stops.windows(2) {
            canvas.line(at(pair[0]), at(pair[1]), 0.018 * w, srgb(color));
        }
    }
    let names = [
        "Mill", "Quay", "Opera", "North", "Docks", "Park", "Tower", "Field", "Zoo", "Abbey",
        "Weir", "Hill", "Gate", "Lock", "Cross", "Yard",
    ];
    for (name, stop) in names
        .iter()
        .zip(lines.iter().flat_map(|(_, stops)| stops.iter()))
    {
        let [x, y] = at(*stop);
        canvas.disc([x, y], 0.018 * w, srgb(INK));
        canvas.disc([x, y], 0.011 * w, srgb(0xffffff));
        canvas.text(
            [x + 0.02 * w, y - 0.04 * h],
            0.024 * h,
            1.2,
            srgb(INK),
            name,
        );
    }
    canvas.rect([0.0, 0.0, w, 0.09 * h], srgb(0x1d3a6a));
    canvas.text(
        [0.05 * w, 0.022 * h],
        0.045 * h,
        1.4,
        srgb(0xffffff),
        "CITY LINES",
    );
    frame(&mut canvas, 0.012 * w, srgb(0x1d3a6a));
    canvas.finish()
}

/// Coloured rectangles between black bars.
pub(super) fn grid_painting(size_m: [f64; 2], pixel_m: f64) -> Arc<Picture> {
    let [w, h] = size_m;
    let mut canvas = Canvas::new(size_m, pixel_m, srgb(0xf2efe4));
    let fields = [
        ([0.0, 0.0, 0.30, 0.42], 0xd02222),
        ([0.70, 0.60, 0.30, 0.40], 0x1c3f94),
        ([0.30, 0.82, 0.40, 0.18], 0xf2c820),
        ([0.86, 0.0, 0.14, 0.24], 0xf2c820),
        ([0.0, 0.74, 0.14, 0.26], 0x1a1a1a),
    ];
    for ([x, y, fw, fh], color) in fields {
        canvas.rect([x * w, y * h, fw * w, fh * h], srgb(color));
    }
    let bar = 0.022 * w;
    for x in [0.14, 0.30, 0.70, 0.86] {
        let (from, to) = if x == 0.14 {
            (0.42, 1.0)
        } else if x == 0.86 {
            (0.0, 0.6)
        } else {
            (0.0, 1.0)
        };
        canvas.rect(
            [x * w - bar / 2.0, from * h, bar, (to - from) * h],
            srgb(INK),
        );
    }
    for y in [0.24, 0.42, 0.60, 0.74, 0.82] {
        let (from, to) = if y == 0.24 {
            (0.3, 1.0)
        } else if y == 0.74 {
            (0.0, 0.3)
        } else {
            (0.0, 1.0)
        };
        canvas.rect(
            [from * w, y * h - bar / 2.0, (to - from) * w, bar],
            srgb(INK),
        );
    }
    frame(&mut canvas, 0.02 * w, srgb(0xd8d2c4));
    canvas.finish()
}

/// A month of numbered days.
pub(super) fn calendar(size_m: [f64; 2], pixel_m: f64) -> Arc<Picture> {
    let [w, h] = size_m;
    let mut canvas = Canvas::new(size_m, pixel_m, srgb(0xfbfaf6));
    canvas.rect([0.0, 0.0, w, 0.16 * h], srgb(0xa83232));
    canvas.text_centred(
        [0.5 * w, 0.045 * h],
        0.07 * h,
        1.4,
        srgb(0xffffff),
        "OCTOBER",
    );
    for column in 0..7usize {
        let x = (column as f64 + 0.5) * w / 7.0;
        canvas.text_centred(
            [x, 0.19 * h],
            0.032 * h,
            1.3,
            srgb(0x606068),
            &"MTWTFSS"[column..=column],
        );
    }
    for day in 1..=31u32 {
        let cell = day + 2;
        let x = (f64::from(cell % 7) + 0.5) * w / 7.0;
        let y = 0.26 * h + f64::from(cell / 7) * 0.145 * h;
        let ink = if cell % 7 >= 5 {
            srgb(0xc03030)
        } else {
            srgb(INK)
        };
        canvas.text_centred([x, y + 0.035 * h], 0.055 * h, 1.2, ink, &day.to_string());
        canvas.rect(
            [
                x - w / 14.0 + 0.004 * w,
                y + 0.125 * h,
                w / 7.0 - 0.008 * w,
                0.005 * h,
            ],
            srgb(0xc8c8cc),
        );
    }
    canvas.ring(
        [
            0.5 / 7.0 * w + 3.0 * w / 7.0,
            0.26 * h + 0.145 * h * 2.0 + 0.06 * h,
        ],
        0.055 * w,
        0.008 * w,
        srgb(0x2a60c0),
    );
    canvas.finish()
}

/// A round dial at ten past ten.
pub(super) fn clock_face(diameter_m: f64, pixel_m: f64) -> Arc<Picture> {
    let r = diameter_m / 2.0;
    let mut canvas = Canvas::new([diameter_m; 2], pixel_m, srgb(0x2a2a2e));
    canvas.disc([r, r], 0.90 * r, srgb(0xf8f6ee));
    for minute in 0..60 {
        let (sin, cos) = (TAU * f64::from(minute) / 60.0).sin_cos();
        let (from, pen) = if minute % 5 == 0 {
            (0.72, 0.035)
        } else {
            (0.80, 0.012)
        };
        let at = |k: f64| [r + k * r * sin, r - k * r * cos];
        canvas.line(at(from), at(0.85), pen * r, srgb(INK));
    }
    for (angle, length, pen) in [(-0.168, 0.45, 0.06), (0.173, 0.66, 0.04)] {
        let (sin, cos) = (TAU * angle).sin_cos();
        canvas.line(
            [r, r],
            [r + length * r * sin, r - length * r * cos],
            pen * r,
            srgb(INK),
        );
    }
    canvas.disc([r, r], 0.05 * r, srgb(0xc03030));
    canvas.finish()
}

/// Meadows behind a window with a cross.
pub(super) fn window_view(size_m: [f64; 2], pixel_m: f64) -> Arc<Picture> {
    let [w, h] = size_m;
    let mut canvas = Canvas::new(size_m, pixel_m, [0.0; 3]);
    canvas.gradient([0.0, 0.62 * h], srgb(0x7ab0e4), srgb(0xdfecf2));
    canvas.gradient([0.62 * h, h], srgb(0x9abb62), srgb(0x568838));
    for (salt, [x, y, size]) in (0u32..).zip([
        [0.2, 0.2, 0.1],
        [0.32, 0.17, 0.08],
        [0.74, 0.3, 0.11],
        [0.86, 0.26, 0.07],
    ]) {
        for k in 0..4 {
            let shift = f64::from(lattice_noise([f64::from(k) + 0.5, 0.5], salt));
            let centre = [(x + 0.05 * f64::from(k) - 0.07) * w, (y + 0.03 * shift) * h];
            canvas.disc(
                centre,
                size * w * (0.55 + 0.3 * shift.abs()),
                srgb(0xf6f8fa),
            );
        }
    }
    canvas.shape([0.0, 0.5 * h, w, h], srgb(0x6f9858), |x, y| {
        0.66 * h - 0.05 * h * f64::from(lattice_noise([3.0 * x / w, 0.5], 3)) - y
    });
    for [x, y, size] in [[0.16, 0.70, 0.09], [0.60, 0.66, 0.06], [0.84, 0.76, 0.12]] {
        canvas.line(
            [x * w, y * h],
            [x * w, (y + size) * h],
            0.018 * w,
            srgb(0x5a422c),
        );
        canvas.disc([x * w, y * h], size * 0.75 * w, srgb(0x3a6c30));
        canvas.disc(
            [(x - 0.02) * w, (y - 0.02) * h],
            size * 0.45 * w,
            srgb(0x558a42),
        );
    }
    let bar = 0.05 * w;
    let white = srgb(0xf2f0ea);
    frame(&mut canvas, bar, white);
    canvas.rect([0.5 * w - bar / 2.0, 0.0, bar, h], white);
    canvas.rect([0.0, 0.40 * h - bar / 2.0, w, bar], white);
    canvas.line(
        [0.53 * w, 0.52 * h],
        [0.53 * w, 0.58 * h],
        0.012 * w,
        srgb(0x8a8a8a),
    );
    canvas.finish()
}

/// A panelled door.
pub(super) fn door([w, h]: [f64; 2], pixel_m: f64) -> Arc<Picture> {
    let mut canvas = Canvas::new([w, h], pixel_m, srgb(0xe4ded0));
    for (y, height) in [(0.07, 0.36), (0.50, 0.42)] {
        for x in [0.12, 0.55] {
            let panel = [x * w, y * h, 0.33 * w, height * h];
            canvas.rect(panel, srgb(0xbdb5a4));
            let inset = 0.02 * w;
            canvas.rect(
                [
                    panel[0] + inset,
                    panel[1] + inset,
                    panel[2] - 2.0 * inset,
                    panel[3] - 2.0 * inset,
                ],
                srgb(0xdad3c4),
            );
        }
    }
    canvas.disc([0.90 * w, 0.48 * h], 0.035 * w, srgb(0x8a7840));
    canvas.line(
        [0.90 * w, 0.48 * h],
        [0.79 * w, 0.48 * h],
        0.025 * w,
        srgb(0xa89250),
    );
    frame(&mut canvas, 0.03 * w, srgb(0xa8a090));
    canvas.finish()
}

/// A woven rug with a border, lozenges and a field.
pub(super) fn rug([w, h]: [f64; 2], pixel_m: f64) -> Arc<Picture> {
    let mut canvas = Canvas::new([w, h], pixel_m, srgb(0x7c2026));
    let bands = [
        (0.02, 0xe6d4ae),
        (0.05, 0x1e2e52),
        (0.17, 0xe6d4ae),
        (0.19, 0x8e2a2c),
    ];
    for (inset, color) in bands {
        canvas.rect(
            [inset, inset, w - 2.0 * inset, h - 2.0 * inset],
            srgb(color),
        );
    }
    for (length, is_top) in [(w, true), (h, false)] {
        let num = ((length - 0.22) / 0.11).floor().max(1.0);
        let pitch = (length - 0.22) / num;
        let mut along = 0.11 + pitch / 2.0;
        let mut odd = false;
        while along < length - 0.11 {
            let color = if odd { srgb(0xd89a3a) } else { srgb(0xc84a3a) };
            for side in [0.11, if is_top { h - 0.11 } else { w - 0.11 }] {
                let centre = if is_top { [along, side] } else { [side, along] };
                lozenge(&mut canvas, centre, [0.04, 0.04], color);
                lozenge(&mut canvas, centre, [0.018, 0.018], srgb(0xe6d4ae));
            }
            along += pitch;
            odd = !odd;
        }
    }
    let centre = [w / 2.0, h / 2.0];
    let medallion = [
        (0.34, 0x1e2e52),
        (0.29, 0xe6d4ae),
        (0.26, 0xb84034),
        (0.16, 0x2e5a60),
        (0.08, 0xe8c060),
    ];
    for (scale, color) in medallion {
        lozenge(
            &mut canvas,
            centre,
            [scale * (w - 0.3), scale * (h - 0.3) * 1.2],
            srgb(color),
        );
    }
    for k in 0..4 {
        let x = if k % 2 == 0 { 0.36 } else { w - 0.36 };
        let y = if k < 2 { 0.33 } else { h - 0.33 };
        lozenge(&mut canvas, [x, y], [0.10, 0.08], srgb(0x1e2e52));
        lozenge(&mut canvas, [x, y], [0.06, 0.05], srgb(0xd89a3a));
    }
    canvas.finish()
}

/// A map of the world for a globe: oceans, invented continents, ice and a graticule.
pub(super) fn globe_map(radius_m: f64, pixel_m: f64) -> Arc<Picture> {
    let [w, h] = [TAU * radius_m, TAU / 2.0 * radius_m];
    let mut canvas = Canvas::new([w, h], pixel_m, srgb(0x2a629c));
    let land = |x: f64, y: f64| {
        // Read on a cylinder in noise space, so that the seam closes.
        let (sin, cos) = (x / radius_m).sin_cos();
        let v = y / radius_m;
        let at = |scale: f64, salt: u32| {
            f64::from(lattice_noise([scale * cos + 40.0, scale * v], salt))
                + f64::from(lattice_noise([scale * sin + 80.0, scale * v], salt ^ 1))
        };
        at(1.6, 2) + 0.5 * at(3.7, 4) - 0.25
    };
    let slope_m = 0.35 * radius_m;
    canvas.shape([0.0, 0.0, w, h], srgb(0x6a9a4a), |x, y| {
        -land(x, y) * slope_m
    });
    canvas.shape([0.0, 0.0, w, h], srgb(0xc8a862), |x, y| {
        (0.45 - land(x, y)) * slope_m
    });
    canvas.shape([0.0, 0.0, w, h], srgb(0xf2f4f6), |_, y| {
        y.min(h - y) - 0.09 * h
    });
    for k in 0..12 {
        canvas.rect(
            [f64::from(k) * w / 12.0 - 0.0006, 0.0, 0.0012, h],
            srgb(0x1a3a5a),
        );
    }
    for k in 1..6 {
        canvas.rect(
            [0.0, f64::from(k) * h / 6.0 - 0.0006, w, 0.0012],
            srgb(0x1a3a5a),
        );
    }
    canvas.finish()
}

fn lozenge(canvas: &mut Canvas, [x, y]: [f64; 2], [a, b]: [f64; 2], color: Linear) {
    canvas.shape([x - a, y - b, x + a, y + b], color, |px, py| {
        ((px - x).abs() / a + (py - y).abs() / b - 1.0) * a.min(b) * 0.7
    });
}

fn frame(canvas: &mut Canvas, width_m: f64, color: Linear) {
    let [w, h] = canvas.size_m();
    canvas.rect([0.0, 0.0, w, width_m], color);
    canvas.rect([0.0, h - width_m, w, width_m], color);
    canvas.rect([0.0, 0.0, width_m, h], color);
    canvas.rect([w - width_m, 0.0, width_m, h], color);
}
