//! Procedural albedo in a surface's own 2D coordinates, averaged over a box.
//!
//! Every pattern answers "the mean linear-light colour over a box of this width around this
//! point". Checks, stripes, grout and pictures are box averages in closed form; noise fades as the
//! box outgrows its features. So the sensor, the ground truth and the exported truth can each ask
//! at their own scale and mean the same texture.

use std::f64::consts::PI;
use std::sync::Arc;

use super::hash::{lattice_noise, lattice_value};
use super::picture::Picture;

/// Red, green and blue in linear light, 1 = a white diffuser.
pub(super) type Linear = [f32; 3];

/// Linear colour of an sRGB value written as 0xRRGGBB.
pub(super) fn srgb(hex: u32) -> Linear {
    let [_, r, g, b] = hex.to_be_bytes();
    [r, g, b].map(crate::geom::color::linear_from_srgb)
}

/// What a surface is painted with.
#[derive(Clone, Debug)]
pub(super) enum Pattern {
    /// One colour.
    Plain(Linear),
    /// From one colour at v = 0 to another at v = `height_m`.
    Gradient {
        from: Linear,
        to: Linear,
        height_m: f64,
    },
    /// A checkerboard.
    Checks { colors: [Linear; 2], size_m: f64 },
    /// Bands of the palette's colours in turn, across u (or across v).
    Stripes {
        palette: Vec<Linear>,
        width_m: f64,
        across_v: bool,
    },
    /// Tiles or bricks with grout; each takes a colour of the palette and varies around it.
    Tiles {
        palette: Vec<Linear>,
        grout: Linear,
        size_m: [f64; 2],
        grout_m: f64,
        /// Shift of each row against the one above, in tiles.
        stagger: f64,
        /// Relative brightness change from tile to tile.
        variation: f32,
    },
    /// Wood with its grain along u (or v), in one piece or in staggered planks.
    Wood {
        light: Linear,
        dark: Linear,
        ring_m: f64,
        along_v: bool,
        plank_m: Option<[f64; 2]>,
    },
    /// A grid of dots on a ground.
    Dots {
        ground: Linear,
        dot: Linear,
        pitch_m: f64,
        radius_m: f64,
    },
    /// Soft flecks on a ground (terrazzo, foliage, granite).
    Flecks {
        ground: Linear,
        fleck: Linear,
        cell_m: f64,
    },
    /// A painted picture with its top-left corner at the origin.
    Picture(Arc<Picture>),
}

/// Fine grain: relative brightness noise in two octaves.
#[derive(Clone, Copy, Debug)]
pub(super) struct Mottle {
    /// Relative amplitude.
    pub(super) amplitude: f32,
    /// Size of the larger features.
    pub(super) cell_m: f64,
}

/// A rectangle of another texture laid onto a surface without thickness.
#[derive(Clone, Debug)]
pub(super) struct Decal {
    /// Left, top, width, height on the surface.
    pub(super) rect_m: [f64; 4],
    /// What is laid there, in coordinates from the rectangle's corner.
    pub(super) texture: Texture,
}

/// A pattern, its grain and what is laid on it.
#[derive(Clone, Debug)]
pub(super) struct Texture {
    pattern: Pattern,
    mottle: Option<Mottle>,
    decals: Vec<Decal>,
    is_luminous: bool,
    salt: u32,
}

impl From<Pattern> for Texture {
    fn from(pattern: Pattern) -> Self {
        Self {
            pattern,
            mottle: None,
            decals: Vec::new(),
            is_luminous: false,
            salt: 0,
        }
    }
}

impl Texture {
    /// With grain.
    pub(super) fn mottled(mut self, amplitude: f32, cell_m: f64) -> Self {
        self.mottle = Some(Mottle { amplitude, cell_m });
        self
    }

    /// With its own random choices.
    pub(super) fn salted(mut self, salt: u32) -> Self {
        self.salt = salt;
        self
    }

    /// Seen as painted, whatever light falls on it (a lamp, a window).
    pub(super) fn luminous(mut self) -> Self {
        self.is_luminous = true;
        self
    }

    /// With another texture laid onto the rectangle (left, top, width, height).
    pub(super) fn with_decal(mut self, rect_m: [f64; 4], texture: impl Into<Texture>) -> Self {
        self.decals.push(Decal {
            rect_m,
            texture: texture.into(),
        });
        self
    }

    /// Mean linear radiance over a box of `width_m` around `uv_m` under `light` (relative
    /// irradiance per channel).
    pub(super) fn radiance(&self, uv_m: [f64; 2], width_m: [f64; 2], light: Linear) -> Linear {
        let mut color = self.pattern.average(uv_m, width_m, self.salt);
        if let Some(mottle) = self.mottle {
            let gain = mottle.gain(uv_m, width_m, self.salt);
            color = color.map(|c| c * gain);
        }
        if !self.is_luminous {
            color = [0, 1, 2].map(|c: usize| color[c] * light[c]);
        }
        for decal in &self.decals {
            let [x, y, w, h] = decal.rect_m;
            let coverage = overlap_share(uv_m[0], width_m[0], x, x + w)
                * overlap_share(uv_m[1], width_m[1], y, y + h);
            if coverage > 0.0 {
                // The box's middle may lie outside by half a box: read what is just inside.
                let inside = [(uv_m[0] - x).clamp(0.0, w), (uv_m[1] - y).clamp(0.0, h)];
                let over = decal.texture.radiance(inside, width_m, light);
                color = mix(color, over, coverage);
            }
        }
        color
    }
}

impl Pattern {
    fn average(&self, uv: [f64; 2], width: [f64; 2], salt: u32) -> Linear {
        match self {
            Self::Plain(color) => *color,
            Self::Gradient { from, to, height_m } => mix(*from, *to, unit(uv[1] / height_m)),
            Self::Checks { colors, size_m } => {
                let product =
                    square_wave(uv[0], width[0], *size_m) * square_wave(uv[1], width[1], *size_m);
                mix(colors[0], colors[1], unit(0.5 - 0.5 * product))
            }
            Self::Stripes {
                palette,
                width_m,
                across_v,
            } => {
                let axis = usize::from(*across_v);
                bands(palette, uv[axis] / width_m, width[axis] / width_m)
            }
            Self::Tiles {
                palette,
                grout,
                size_m,
                grout_m,
                stagger,
                variation,
            } => {
                let tile = tile_at(uv, *size_m, *stagger);
                let joint = joint_share(&tile, width, *size_m, *grout_m);
                let [i, j] = tile.index;
                let fade = attenuation([width[0] / size_m[0], width[1] / size_m[1]]);
                let gain = 1.0 + variation * fade * lattice_value(i, j, salt);
                let color = pick(palette, i, j, salt).map(|c| c * gain);
                mix(color, *grout, joint)
            }
            Self::Wood {
                light,
                dark,
                ring_m,
                along_v,
                plank_m,
            } => {
                let turn = |p: [f64; 2]| if *along_v { [p[1], p[0]] } else { p };
                wood(
                    [*light, *dark],
                    *ring_m,
                    *plank_m,
                    turn(uv),
                    turn(width),
                    salt,
                )
            }
            Self::Dots {
                ground,
                dot,
                pitch_m,
                radius_m,
            } => {
                let to_centre = |x: f64| (x / pitch_m - (x / pitch_m).floor() - 0.5) * pitch_m;
                let distance = to_centre(uv[0]).hypot(to_centre(uv[1])) - radius_m;
                let blur = 0.5 * (width[0] + width[1]).max(1e-6);
                mix(*ground, *dot, unit(0.5 - distance / blur))
            }
            Self::Flecks {
                ground,
                fleck,
                cell_m,
            } => {
                let fade = attenuation([width[0] / cell_m, width[1] / cell_m]);
                let n = lattice_noise([uv[0] / cell_m, uv[1] / cell_m], salt)
                    + 0.5 * lattice_noise([uv[0] / cell_m * 2.3, uv[1] / cell_m * 2.3], salt ^ 77);
                mix(*ground, *fleck, (0.3 + 0.9 * fade * n).clamp(0.0, 1.0))
            }
            Self::Picture(picture) => picture.average(uv, width),
        }
    }
}

impl Mottle {
    fn gain(self, uv: [f64; 2], width: [f64; 2], salt: u32) -> f32 {
        let octave = |cell_m: f64, salt: u32| {
            let fade = attenuation([width[0] / cell_m, width[1] / cell_m]);
            if fade < 0.02 {
                return 0.0;
            }
            fade * lattice_noise([uv[0] / cell_m, uv[1] / cell_m], salt)
        };
        let noise =
            octave(self.cell_m, salt ^ 0x51) + 0.6 * octave(self.cell_m * 0.43, salt ^ 0xa7);
        1.0 + self.amplitude * noise
    }
}

struct Tile {
    index: [u32; 2],
    /// Position along the staggered row, and down the rows, from the first tile's corner.
    position_m: [f64; 2],
}

#[expect(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "a wrapped index is as good as any"
)]
fn tile_at(uv: [f64; 2], size: [f64; 2], stagger: f64) -> Tile {
    let row = (uv[1] / size[1]).floor();
    let along = uv[0] + row * stagger * size[0];
    let column = (along / size[0]).floor();
    Tile {
        index: [column as i64 as u32, row as i64 as u32],
        position_m: [along, uv[1]],
    }
}

fn joint_share(tile: &Tile, width: [f64; 2], size: [f64; 2], joint_m: f64) -> f32 {
    let across = |axis: usize| line_share(tile.position_m[axis], width[axis], size[axis], joint_m);
    1.0 - (1.0 - across(0)) * (1.0 - across(1))
}

fn wood(
    [light, dark]: [Linear; 2],
    ring_m: f64,
    plank_m: Option<[f64; 2]>,
    uv: [f64; 2],
    width: [f64; 2],
    salt: u32,
) -> Linear {
    let mut joint = 0.0;
    let mut plank_salt = salt;
    let mut plank_tone = 0.0;
    if let Some(plank_m) = plank_m {
        // An irrational stagger keeps the plank ends from lining up.
        let tile = tile_at(uv, plank_m, 0.381_966);
        joint = joint_share(&tile, width, plank_m, 0.003);
        let [i, j] = tile.index;
        plank_tone = 0.22 * lattice_value(i, j, salt);
        plank_salt = salt ^ i.wrapping_mul(31) ^ j.wrapping_mul(1009);
    }
    let rings = wood_rings(uv, width, ring_m, plank_salt);
    let fibre_cell = [ring_m * 2.0, ring_m * 0.22];
    let fibre = attenuation([width[0] / fibre_cell[0], width[1] / fibre_cell[1]])
        * lattice_noise(
            [uv[0] / fibre_cell[0], uv[1] / fibre_cell[1]],
            plank_salt ^ 3,
        );
    let tone = (0.42 + 0.26 * rings + 0.2 * fibre + plank_tone).clamp(0.0, 1.0);
    mix(mix(light, dark, tone), dark.map(|c| 0.35 * c), joint)
}

/// Growth rings as a sine across the grain, bent by slow noise, in [-1, 1].
fn wood_rings(uv: [f64; 2], width: [f64; 2], ring_m: f64, salt: u32) -> f32 {
    let bend = lattice_noise([uv[0] / (ring_m * 9.0), uv[1] / (ring_m * 2.0)], salt ^ 1);
    let phase = uv[1] / ring_m + 1.1 * f64::from(bend);
    let fade = attenuation([0.0, 2.0 * width[1] / ring_m]);
    #[expect(clippy::cast_possible_truncation, reason = "a sine")]
    let wave = (2.0 * PI * phase).sin() as f32;
    fade * wave
}

/// What is left of a feature of unit size after a box of this width: the Gaussian of the box's
/// variance at the feature's half-wave, by its first terms.
fn attenuation([x, y]: [f64; 2]) -> f32 {
    #[expect(clippy::cast_possible_truncation, reason = "a ratio")]
    let e = (PI * PI / 24.0 * (x * x + y * y)) as f32;
    1.0 / (1.0 + e * (1.0 + 0.5 * e * (1.0 + e / 3.0)))
}

/// Mean of a ±1 square wave (+1 on [0, half)) over a box.
fn square_wave(x: f64, width: f64, half: f64) -> f64 {
    let width = width.max(1e-7);
    let antiderivative = |x: f64| {
        let phase = x.rem_euclid(2.0 * half);
        phase.min(2.0 * half - phase)
    };
    (antiderivative(x + 0.5 * width) - antiderivative(x - 0.5 * width)) / width
}

/// Share of a box covered by lines of `line_m` centred on the multiples of `pitch_m`.
fn line_share(x: f64, width: f64, pitch_m: f64, line_m: f64) -> f32 {
    let width = width.max(1e-7);
    let antiderivative = |x: f64| {
        let cell = (x / pitch_m).floor();
        cell * line_m + (x - cell * pitch_m).min(line_m)
    };
    let x = x + 0.5 * line_m;
    unit((antiderivative(x + 0.5 * width) - antiderivative(x - 0.5 * width)) / width)
}

/// Mean over bands of unit width; exact while the box is narrower than two bands.
fn bands(palette: &[Linear], x: f64, width: f64) -> Linear {
    let at = |cell: f64| {
        #[expect(
            clippy::cast_possible_truncation,
            clippy::cast_sign_loss,
            reason = "a remainder in 0..len"
        )]
        let index = cell.rem_euclid(palette.len() as f64) as usize;
        palette.get(index).copied().unwrap_or([0.0; 3])
    };
    let cell = x.floor();
    let half = 0.5 * width.clamp(1e-7, 1.0);
    let (low, high) = (x - half, x + half);
    if low < cell {
        mix(at(cell), at(cell - 1.0), unit((cell - low) / (2.0 * half)))
    } else {
        mix(
            at(cell),
            at(cell + 1.0),
            unit((high - cell - 1.0) / (2.0 * half)),
        )
    }
}

/// Share of a box that lies in [low, high].
fn overlap_share(x: f64, width: f64, low: f64, high: f64) -> f32 {
    let width = width.max(1e-7);
    let overlap = (x + 0.5 * width).min(high) - (x - 0.5 * width).max(low);
    unit(overlap / width)
}

fn pick(palette: &[Linear], i: u32, j: u32, salt: u32) -> Linear {
    let r = 0.5 * (lattice_value(i, j, salt ^ 0x0bad_cafe) + 1.0);
    #[expect(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "a random index in 0..=len"
    )]
    let index = (r * palette.len() as f32) as usize;
    palette
        .get(index)
        .or_else(|| palette.last())
        .copied()
        .unwrap_or([0.0; 3])
}

pub(super) fn mix(a: Linear, b: Linear, t: f32) -> Linear {
    std::array::from_fn(|c| a[c] + t * (b[c] - a[c]))
}

fn unit(x: f64) -> f32 {
    #[expect(clippy::cast_possible_truncation, reason = "in [0, 1]")]
    let x = x.clamp(0.0, 1.0) as f32;
    x
}

#[cfg(test)]
mod tests {
    use super::*;

    const BLACK: Linear = [0.0; 3];
    const WHITE: Linear = [1.0; 3];

    /// Mean over `n × n` points of the box, with no filter of their own.
    fn brute_force(texture: &Texture, uv: [f64; 2], width: [f64; 2]) -> Linear {
        let n = 64;
        let mut sum = [0.0f32; 3];
        for j in 0..n {
            for i in 0..n {
                let at = |k: i32, axis: usize| {
                    uv[axis] + width[axis] * ((f64::from(k) + 0.5) / f64::from(n) - 0.5)
                };
                let color = texture.radiance([at(i, 0), at(j, 1)], [1e-6; 2], WHITE);
                for c in 0..3 {
                    sum[c] += color[c] / (n * n) as f32;
                }
            }
        }
        sum
    }

    #[test]
    fn closed_forms_equal_brute_force_averages() {
        let textures: Vec<Texture> = vec![
            Pattern::Checks {
                colors: [BLACK, WHITE],
                size_m: 0.03,
            }
            .into(),
            Pattern::Tiles {
                palette: vec![WHITE],
                grout: BLACK,
                size_m: [0.1, 0.06],
                grout_m: 0.01,
                stagger: 0.0,
                variation: 0.0,
            }
            .into(),
            Pattern::Stripes {
                palette: vec![BLACK, WHITE, srgb(0xff8000)],
                width_m: 0.02,
                across_v: false,
            }
            .into(),
            Texture::from(Pattern::Plain(WHITE))
                .with_decal([0.02, 0.01, 0.03, 0.02], Pattern::Plain(srgb(0x204080))),
        ];
        for (index, texture) in textures.iter().enumerate() {
            for k in 0..40 {
                let t = f64::from(k);
                let uv = [0.005 + 0.0037 * t, 0.013 + 0.0019 * t];
                let width = [0.004 + 0.0002 * t, 0.007];
                let exact = texture.radiance(uv, width, WHITE);
                let brute = brute_force(texture, uv, width);
                for c in 0..3 {
                    assert!(
                        (exact[c] - brute[c]).abs() < 0.02,
                        "texture {index} at {uv:?}: {exact:?} against {brute:?}"
                    );
                }
            }
        }
    }

    #[test]
    fn grain_fades_about_as_its_average_does() {
        let texture = Texture::from(Pattern::Plain([0.5; 3])).mottled(0.2, 0.02);
        let mut worst = 0.0f32;
        for k in 0..60 {
            let uv = [0.0071 * f64::from(k), 0.0113 * f64::from(k)];
            let width = [0.006; 2];
            let fast = texture.radiance(uv, width, WHITE)[0];
            worst = worst.max((fast - brute_force(&texture, uv, width)[0]).abs());
        }
        // The grain swings by 0.16; its shape under a narrow box must be kept to a fraction.
        assert!(worst < 0.02, "worst deviation {worst}");
    }
}
