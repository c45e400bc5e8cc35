//! Local perceived sharpness S3 (Vu, Phan, Chandler 2012, "S3: A Spectral and Spatial Measure of
//! Local Perceived Sharpness in Natural Images", IEEE Transactions on Image Processing 21(3)).
//!
//! Of the luma, in whole steps 0–255:
//!
//! - **S1**, spectral: every 8 pixels a block of 32×32 under a Hanning window. The magnitude of its
//!   spectrum is averaged over 360 directions at the radii 1…16 cycles per block (bilinear between
//!   frequencies; the mean at the origin is replaced by its neighbours'). −α is the slope of the
//!   line through log magnitude against log frequency; S1 = 1 − 1 / (1 + exp(−3 (α − 2))). It is 0
//!   where no 8×8 sub-block has contrast: a mean luminance above 2 with more than 5 between its
//!   darkest and brightest, luminance being (0.7656 + 0.0364 luma)^2.2, turned over (255 − it) where
//!   the mean is above 127.5.
//! - **S2**, spatial: in blocks of 8×8 the largest total variation of 2×2 neighbours, the sum of
//!   the absolute differences of their six pairs over 255 · 4; the larger of two grids of blocks
//!   that lie 4 pixels apart along both axes.
//! - **S3** = √(S1 · S2), in [0, 1] at every pixel; the pixel takes S1 of the nearest block.
//!
//! The image is mirrored at its borders, border pixels repeated. The paper's program differs in two
//! slips: it swaps the weights of the interpolation in directions with a negative component, and
//! gives nothing to the last rows of a height that is 5, 6 or 7 over a multiple of 8 (so for
//! columns).

use rayon::prelude::*;
use realfft::num_complex::Complex;
use realfft::{RealFftPlanner, RealToComplex};
use std::sync::{Arc, LazyLock};

use crate::geom::ColorImage;

use super::luma_byte;

const BLOCK_PX: usize = 32;
/// Distance of blocks.
const STEP_PX: usize = 8;
const HALF_SPECTRUM: usize = BLOCK_PX / 2 + 1;
const NUM_RADII: usize = BLOCK_PX / 2;
const NUM_DIRECTIONS: usize = 360;

const CONTRAST_BLOCK_PX: usize = 8;
const CONTRAST_STEP_PX: usize = 4;
const MIN_MEAN_LUMINANCE: f64 = 2.0;
const MIN_LUMINANCE_RANGE: f64 = 5.0;

const SPATIAL_BLOCK_PX: usize = 8;

/// What the logarithm sees of a frequency that is not there at all.
const MIN_MAGNITUDE: f64 = 1e-12;

/// Sharpness at every pixel, row-major.
#[derive(Clone, Debug, PartialEq)]
pub struct SharpnessMap {
    /// Columns.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// S3, in [0, 1].
    pub s3: Vec<f32>,
}

impl SharpnessMap {
    /// The value at a pixel.
    pub fn at(&self, x: usize, y: usize) -> f32 {
        self.s3[y * self.width + x]
    }
}

/// The map of an image.
#[expect(clippy::cast_possible_truncation, reason = "rounding to f32 is meant")]
pub fn sharpness_map(image: &ColorImage) -> SharpnessMap {
    let luma = Mirrored::of(image);
    let (width, height) = (luma.width, luma.height);
    let spectral = spectral_sharpness(&luma);
    let num_columns = blocks_along(width);
    let spatial = [0, SPATIAL_BLOCK_PX / 2].map(|shift| SpatialGrid::new(&luma, shift));
    let rows: Vec<Vec<f32>> = (0..height)
        .into_par_iter()
        .map(|y| {
            let nearest = |at: usize| (at + STEP_PX / 2) / STEP_PX;
            (0..width)
                .map(|x| {
                    let s1 = spectral[nearest(y) * num_columns + nearest(x)];
                    let s2 = spatial[0].at(x, y).max(spatial[1].at(x, y));
                    (s1 * s2).sqrt() as f32
                })
                .collect()
        })
        .collect();
    SharpnessMap {
        width,
        height,
        s3: rows.concat(),
    }
}

/// Luma that goes on past the borders.
struct Mirrored {
    width: usize,
    height: usize,
    luma: Vec<u8>,
}

/// How far the reflection reaches.
const MARGIN_PX: usize = BLOCK_PX;

impl Mirrored {
    fn of(image: &ColorImage) -> Self {
        Self {
            width: image.width() as usize,
            height: image.height() as usize,
            luma: image.pixels().iter().map(|&rgb| luma_byte(rgb)).collect(),
        }
    }

    /// Columns or rows of the image at `start`, `start` + 1, … counted from [`MARGIN_PX`] before
    /// the image.
    fn reflected(start: usize, len: usize, size: usize) -> impl Iterator<Item = usize> {
        (start..start + len).map(move |at| {
            let period = 2 * size;
            let at = (at + period * MARGIN_PX.div_ceil(period) - MARGIN_PX) % period;
            at.min(period - 1 - at)
        })
    }

    /// The pixels of a rectangle whose corner is counted from [`MARGIN_PX`] before the image.
    fn block<const N: usize>(&self, [x, y]: [usize; 2], out: &mut [[f64; N]]) {
        let columns: Vec<usize> = Self::reflected(x, N, self.width).collect();
        for (row, source) in out.iter_mut().zip(Self::reflected(y, N, self.height)) {
            for (value, column) in row.iter_mut().zip(&columns) {
                *value = f64::from(self.luma[source * self.width + column]);
            }
        }
    }
}

/// Blocks are centred at 0, 8, 16, …, so that every pixel has one within half a step.
fn blocks_along(size: usize) -> usize {
    (size - 1 + STEP_PX / 2) / STEP_PX + 1
}

/// S1 of every block, row-major.
fn spectral_sharpness(luma: &Mirrored) -> Vec<f64> {
    let (num_columns, num_rows) = (blocks_along(luma.width), blocks_along(luma.height));
    let spectrum = BlockSpectrum::new();
    let rows: Vec<Vec<f64>> = (0..num_rows)
        .into_par_iter()
        .map_init(
            || spectrum.workspace(),
            |workspace, row| {
                (0..num_columns)
                    .map(|column| {
                        let corner = [column, row].map(|i| i * STEP_PX + MARGIN_PX - BLOCK_PX / 2);
                        let mut block = [[0.0; BLOCK_PX]; BLOCK_PX];
                        luma.block(corner, &mut block);
                        if !has_contrast(&block) {
                            return 0.0;
                        }
                        let alpha = spectrum.slope(&block, workspace);
                        1.0 - 1.0 / (1.0 + (-3.0 * (alpha - 2.0)).exp())
                    })
                    .collect()
            },
        )
        .collect();
    rows.concat()
}

static LUMINANCE: LazyLock<[f64; 256]> =
    LazyLock::new(|| std::array::from_fn(|luma| (0.7656 + 0.0364 * luma as f64).powf(2.2)));

/// Whether some sub-block is neither dark nor flat.
fn has_contrast(block: &[[f64; BLOCK_PX]; BLOCK_PX]) -> bool {
    #[expect(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "lumas are bytes"
    )]
    let luminance = |luma: f64| LUMINANCE[luma as usize];
    let last = BLOCK_PX - CONTRAST_BLOCK_PX;
    (0..=last).step_by(CONTRAST_STEP_PX).any(|y| {
        (0..=last).step_by(CONTRAST_STEP_PX).any(|x| {
            let (mut min, mut max, mut sum) = (f64::INFINITY, f64::NEG_INFINITY, 0.0);
            for row in &block[y..y + CONTRAST_BLOCK_PX] {
                for &luma in &row[x..x + CONTRAST_BLOCK_PX] {
                    let value = luminance(luma);
                    min = value.min(min);
                    max = value.max(max);
                    sum += value;
                }
            }
            let mean = sum / (CONTRAST_BLOCK_PX * CONTRAST_BLOCK_PX) as f64;
            let mean = if mean > 127.5 { 255.0 - mean } else { mean };
            mean > MIN_MEAN_LUMINANCE && max - min > MIN_LUMINANCE_RANGE
        })
    })
}

/// The slope of a block's magnitude spectrum.
struct BlockSpectrum {
    window: [f64; BLOCK_PX],
    fft: Arc<dyn RealToComplex<f64>>,
    column_fft: Arc<dyn rustfft::Fft<f64>>,
    /// Per radius: weights of entries of the half spectrum, `[column frequency][row frequency]`.
    rings: Vec<Vec<(usize, f64)>>,
    /// The fitted slope is the sum of these times the logarithms of the rings' means.
    slope_weights: [f64; NUM_RADII],
}

struct Workspace {
    row: Vec<f64>,
    row_spectrum: Vec<Complex<f64>>,
    /// `[column frequency][row]`.
    columns: Vec<Complex<f64>>,
    scratch: Vec<Complex<f64>>,
    magnitudes: Vec<f64>,
}

impl BlockSpectrum {
    fn new() -> Self {
        // Matlab's hanning: without the zeros at its ends.
        let window = std::array::from_fn(|i| {
            let phase = (i + 1) as f64 / (BLOCK_PX + 1) as f64;
            0.5 * (1.0 - (std::f64::consts::TAU * phase).cos())
        });
        let logs: [f64; NUM_RADII] =
            std::array::from_fn(|i| ((i + 1) as f64 / BLOCK_PX as f64).ln());
        let mean = logs.iter().sum::<f64>() / NUM_RADII as f64;
        let spread: f64 = logs.iter().map(|log| (log - mean).powi(2)).sum();
        Self {
            window,
            fft: RealFftPlanner::new().plan_fft_forward(BLOCK_PX),
            column_fft: rustfft::FftPlanner::new().plan_fft_forward(BLOCK_PX),
            rings: (1..=NUM_RADII).map(ring).collect(),
            slope_weights: logs.map(|log| (log - mean) / spread),
        }
    }

    fn workspace(&self) -> Workspace {
        let zero = Complex::new(0.0, 0.0);
        let num_scratch = self
            .fft
            .get_scratch_len()
            .max(self.column_fft.get_inplace_scratch_len());
        Workspace {
            row: vec![0.0; BLOCK_PX],
            row_spectrum: vec![zero; HALF_SPECTRUM],
            columns: vec![zero; HALF_SPECTRUM * BLOCK_PX],
            scratch: vec![zero; num_scratch],
            magnitudes: vec![0.0; HALF_SPECTRUM * BLOCK_PX],
        }
    }

    /// α: how fast the spectrum falls.
    fn slope(&self, block: &[[f64; BLOCK_PX]; BLOCK_PX], workspace: &mut Workspace) -> f64 {
        let Workspace {
            row,
            row_spectrum,
            columns,
            scratch,
            magnitudes,
        } = workspace;
        for (y, values) in block.iter().enumerate() {
            for ((out, value), weight) in row.iter_mut().zip(values).zip(&self.window) {
                *out = value * weight * self.window[y];
            }
            let num_scratch = self.fft.get_scratch_len();
            let done =
                self.fft
                    .process_with_scratch(row, row_spectrum, &mut scratch[..num_scratch]);
            debug_assert!(done.is_ok(), "the buffers have the planned sizes");
            for (column, value) in row_spectrum.iter().enumerate() {
                columns[column * BLOCK_PX + y] = *value;
            }
        }
        self.column_fft.process_with_scratch(columns, scratch);
        for (magnitude, value) in magnitudes.iter_mut().zip(columns.iter()) {
            *magnitude = value.norm();
        }
        let mut slope = 0.0;
        for (ring, weight) in self.rings.iter().zip(&self.slope_weights) {
            let mean: f64 = ring.iter().map(|&(at, share)| share * magnitudes[at]).sum();
            slope += weight * mean.max(MIN_MAGNITUDE).ln();
        }
        -slope
    }
}

/// Weights of the half spectrum whose sum is the mean over all directions at one radius.
#[expect(
    clippy::cast_possible_truncation,
    reason = "frequencies are at most half a block, and wrapped before they are indices"
)]
fn ring(radius: usize) -> Vec<(usize, f64)> {
    let mut weights = vec![0.0; HALF_SPECTRUM * BLOCK_PX];
    let mut add = |column: i64, row: i64, weight: f64| {
        let wrap = |frequency: i64| frequency.rem_euclid(BLOCK_PX as i64) as usize;
        let (mut column, mut row) = (wrap(column), wrap(row));
        // The other half of a real image's spectrum mirrors this one.
        if column >= HALF_SPECTRUM {
            column = BLOCK_PX - column;
            row = (BLOCK_PX - row) % BLOCK_PX;
        }
        weights[column * BLOCK_PX + row] += weight;
    };
    for direction in 0..NUM_DIRECTIONS {
        let angle = std::f64::consts::TAU * direction as f64 / NUM_DIRECTIONS as f64;
        let (x, y) = (radius as f64 * angle.cos(), radius as f64 * angle.sin());
        let (x0, y0) = (x.floor(), y.floor());
        let (fx, fy) = (x - x0, y - y0);
        let (x0, y0) = (x0 as i64, y0 as i64);
        for (dx, dy, weight) in [
            (0, 0, (1.0 - fx) * (1.0 - fy)),
            (1, 0, fx * (1.0 - fy)),
            (0, 1, (1.0 - fx) * fy),
            (1, 1, fx * fy),
        ] {
            let weight = weight / NUM_DIRECTIONS as f64;
            if (x0 + dx, y0 + dy) == (0, 0) {
                add(1, 0, 0.5 * weight);
                add(0, 1, 0.5 * weight);
            } else {
                add(x0 + dx, y0 + dy, weight);
            }
        }
    }
    let is_used = |(_, weight): &(usize, f64)| *weight != 0.0;
    weights.into_iter().enumerate().filter(is_used).collect()
}

/// S2 of blocks that begin `shift_px` before the image.
struct SpatialGrid {
    shift_px: usize,
    num_columns: usize,
    blocks: Vec<f64>,
}

impl SpatialGrid {
    fn new(luma: &Mirrored, shift_px: usize) -> Self {
        let along = |size: usize| (size + shift_px).div_ceil(SPATIAL_BLOCK_PX);
        let (num_columns, num_rows) = (along(luma.width), along(luma.height));
        let rows: Vec<Vec<f64>> = (0..num_rows)
            .into_par_iter()
            .map(|row| {
                (0..num_columns)
                    .map(|column| {
                        let corner =
                            [column, row].map(|i| i * SPATIAL_BLOCK_PX + MARGIN_PX - shift_px);
                        let mut block = [[0.0; SPATIAL_BLOCK_PX]; SPATIAL_BLOCK_PX];
                        luma.block(corner, &mut block);
                        largest_variation(&block)
                    })
                    .collect()
            })
            .collect();
        Self {
            shift_px,
            num_columns,
            blocks: rows.concat(),
        }
    }

    fn at(&self, x: usize, y: usize) -> f64 {
        let [column, row] = [x, y].map(|at| (at + self.shift_px) / SPATIAL_BLOCK_PX);
        self.blocks[row * self.num_columns + column]
    }
}

/// The largest total variation of 2×2 neighbours; 1 is a checkerboard of black and white.
fn largest_variation(block: &[[f64; SPATIAL_BLOCK_PX]; SPATIAL_BLOCK_PX]) -> f64 {
    let mut largest = 0.0f64;
    for rows in block.windows(2) {
        for x in 0..SPATIAL_BLOCK_PX - 1 {
            let [a, b, c, d] = [rows[0][x], rows[0][x + 1], rows[1][x], rows[1][x + 1]];
            let variation = (a - b).abs()
                + (a - c).abs()
                + (a - d).abs()
                + (b - c).abs()
                + (b - d).abs()
                + (c - d).abs();
            largest = largest.max(variation);
        }
    }
    largest / (255.0 * 4.0)
}

#[cfg(test)]
mod tests;
