//! Real two-dimensional FFTs of f32, rows and columns in parallel.

use rayon::prelude::*;
use realfft::num_complex::Complex32;
use realfft::{ComplexToReal, RealFftPlanner, RealToComplex};
use rustfft::{Fft, FftPlanner};
use std::sync::Arc;

/// Rows or columns to a parallel piece.
const CHUNK: usize = 16;

/// The transforms of one size.
pub(super) struct Fft2 {
    width: usize,
    height: usize,
    rows: Arc<dyn RealToComplex<f32>>,
    rows_back: Arc<dyn ComplexToReal<f32>>,
    columns: Arc<dyn Fft<f32>>,
    columns_back: Arc<dyn Fft<f32>>,
}

/// The half spectrum, column by column: entry (kx, ky) at `kx · height + ky`.
pub(super) type Spectrum = Vec<Complex32>;

impl Fft2 {
    pub(super) fn new(width: usize, height: usize) -> Self {
        let mut real = RealFftPlanner::new();
        let mut complex = FftPlanner::new();
        Self {
            width,
            height,
            rows: real.plan_fft_forward(width),
            rows_back: real.plan_fft_inverse(width),
            columns: complex.plan_fft_forward(height),
            columns_back: complex.plan_fft_inverse(height),
        }
    }

    fn num_columns(&self) -> usize {
        self.width / 2 + 1
    }

    /// The spectrum of a row-major plane of `width · height` values.
    pub(super) fn forward(&self, plane: &[f32]) -> Spectrum {
        let num_columns = self.num_columns();
        let zero = Complex32::new(0.0, 0.0);
        let mut by_row = vec![zero; num_columns * self.height];
        by_row
            .par_chunks_mut(CHUNK * num_columns)
            .zip(plane.par_chunks(CHUNK * self.width))
            .for_each(|(spectra, rows)| {
                let mut input = self.rows.make_input_vec();
                let mut scratch = self.rows.make_scratch_vec();
                let pairs = spectra.chunks_mut(num_columns).zip(rows.chunks(self.width));
                for (spectrum, row) in pairs {
                    input.copy_from_slice(row);
                    // All lengths are the plan's own, so that it cannot refuse.
                    let done = self
                        .rows
                        .process_with_scratch(&mut input, spectrum, &mut scratch);
                    debug_assert!(done.is_ok());
                }
            });
        let mut by_column = transposed(&by_row, num_columns, self.height);
        self.each_column(&mut by_column, &*self.columns);
        by_column
    }

    /// The plane of a spectrum, times `width · height`.
    pub(super) fn inverse(&self, mut spectrum: Spectrum) -> Vec<f32> {
        let num_columns = self.num_columns();
        self.each_column(&mut spectrum, &*self.columns_back);
        let mut by_row = transposed(&spectrum, self.height, num_columns);
        let mut plane = vec![0.0f32; self.width * self.height];
        plane
            .par_chunks_mut(CHUNK * self.width)
            .zip(by_row.par_chunks_mut(CHUNK * num_columns))
            .for_each(|(rows, spectra)| {
                let mut scratch = self.rows_back.make_scratch_vec();
                let pairs = rows
                    .chunks_mut(self.width)
                    .zip(spectra.chunks_mut(num_columns));
                for (row, spectrum) in pairs {
                    // A real plane's first and, of an even width, last column are real up to
                    // rounding; the transform asks for exactly that.
                    spectrum[0].im = 0.0;
                    if self.width.is_multiple_of(2) {
                        spectrum[num_columns - 1].im = 0.0;
                    }
                    let done = self
                        .rows_back
                        .process_with_scratch(spectrum, row, &mut scratch);
                    debug_assert!(done.is_ok());
                }
            });
        plane
    }

    fn each_column(&self, spectrum: &mut [Complex32], plan: &dyn Fft<f32>) {
        spectrum
            .par_chunks_mut(CHUNK * self.height)
            .for_each(|columns| {
                let zero = Complex32::new(0.0, 0.0);
                let mut scratch = vec![zero; plan.get_inplace_scratch_len()];
                plan.process_with_scratch(columns, &mut scratch);
            });
    }
}

/// A matrix of `width` columns and `height` rows, column by column.
fn transposed(matrix: &[Complex32], width: usize, height: usize) -> Vec<Complex32> {
    let mut out = vec![Complex32::new(0.0, 0.0); matrix.len()];
    out.par_chunks_mut(CHUNK * height)
        .enumerate()
        .for_each(|(chunk, columns)| {
            let first = chunk * CHUNK;
            for (y, row) in matrix.chunks(width).enumerate() {
                for (column, &value) in columns.chunks_mut(height).zip(&row[first..]) {
                    column[y] = value;
                }
            }
        });
    out
}

/// The product a · conj(b), entry by entry, into `a`.
pub(super) fn multiply_conjugate(a: &mut [Complex32], b: &[Complex32]) {
    a.par_iter_mut()
        .zip(b)
        .with_min_len(4096)
        .for_each(|(a, b)| *a *= b.conj());
}

/// The next size without prime factors above 5, which transforms fast.
pub(super) fn good_size(at_least: usize) -> usize {
    let is_smooth = |mut n: usize| {
        for p in [2, 3, 5] {
            while n.is_multiple_of(p) {
                n /= p;
            }
        }
        n == 1
    };
    (at_least.max(1)..)
        .find(|&n| is_smooth(n))
        .unwrap_or(at_least)
}
