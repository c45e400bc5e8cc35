//! Learned perceptual image patch similarity (Zhang, Isola, Efros, Shechtman, Wang 2018, "The
//! Unreasonable Effectiveness of Deep Features as a Perceptual Metric"), version 0.1, AlexNet.
//!
//! The weights are not part of the program. They are read from one safetensors file of `f32`
//! tensors: torchvision's `features.{0,3,6,8,10}.{weight,bias}` (output, input, row, column) and
//! the heads `lin{0..4}.weight` (1, C, 1, 1).
//!
//! sRGB bytes become [−1, 1], then (x − shift) / scale per channel. After each of five
//! convolutions with ReLU the activations are divided by their norm over channels; the squared
//! differences are weighted by the heads, averaged over space and added up. Smaller is more alike;
//! 0 for equal images. The value is the same for any number of threads.

mod layers;

use std::path::{Path, PathBuf};

use rayon::prelude::*;
use safetensors::{Dtype, SafeTensors};

use crate::geom::ColorImage;
use layers::{Conv, ConvShape, Planes, max_pool};

/// Why there is no distance.
#[derive(Debug, thiserror::Error)]
pub enum LpipsError {
    /// The weights' file cannot be read.
    #[error("cannot read the LPIPS weights {}", path.display())]
    Read {
        /// The file.
        path: PathBuf,
        /// The system's words.
        source: std::io::Error,
    },
    /// The file is not safetensors.
    #[error("the LPIPS weights are not a safetensors file: {0}")]
    Format(String),
    /// A tensor is missing or is not what AlexNet and its heads need.
    #[error("the LPIPS weights' tensor '{name}' {problem}")]
    Tensor {
        /// Which tensor.
        name: String,
        /// What is wrong.
        problem: String,
    },
    /// The image is smaller than the network's kernels.
    #[error("an image of {width}x{height} pixels is too small for LPIPS")]
    TooSmall {
        /// Columns.
        width: usize,
        /// Rows.
        height: usize,
    },
    /// The images differ in size.
    #[error("LPIPS compares images of equal size")]
    Size,
}

const NUM_LAYERS: usize = 5;

/// The convolutions by the number that torchvision gives them, and whether pooling comes first.
const CONVS: [(usize, ConvShape, bool); NUM_LAYERS] = [
    (0, conv(3, 64, 11, 4, 2), false),
    (3, conv(64, 192, 5, 1, 2), true),
    (6, conv(192, 384, 3, 1, 1), true),
    (8, conv(384, 256, 3, 1, 1), false),
    (10, conv(256, 256, 3, 1, 1), false),
];

const fn conv(
    num_inputs: usize,
    num_outputs: usize,
    kernel: usize,
    stride: usize,
    padding: usize,
) -> ConvShape {
    ConvShape {
        num_inputs,
        num_outputs,
        kernel,
        stride,
        padding,
    }
}

/// What the authors' program takes off each channel of [−1, 1] and divides it by.
const SHIFT: [f32; 3] = [-0.030, -0.088, -0.188];
const SCALE: [f32; 3] = [0.458, 0.448, 0.450];
/// Keeps the division by the norm from failing where nothing is active.
const NORM_EPSILON: f64 = 1e-10;
/// Positions whose terms are added up as one piece.
const CHUNK_POSITIONS: usize = 4096;

/// The network.
#[derive(Clone, Debug)]
pub struct Lpips {
    convs: Vec<Conv>,
    /// Per layer: the weight of each channel.
    heads: Vec<Vec<f32>>,
}

/// An image as the network sees it; comparing one image with many needs its activations once.
#[derive(Clone, Debug)]
pub struct LpipsFeatures {
    /// Per layer: activations, and 1 / norm over channels at each position.
    layers: Vec<(Planes, Vec<f32>)>,
}

/// A distance, and the layers that it is the sum of.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LpipsDistance {
    /// What each layer adds, from fine to coarse.
    pub per_layer: [f64; NUM_LAYERS],
}

impl LpipsDistance {
    /// The distance.
    pub fn total(&self) -> f64 {
        self.per_layer.iter().sum()
    }
}

impl Lpips {
    /// Reads the weights from a file.
    ///
    /// # Errors
    /// [`LpipsError`] when the file cannot be read or does not hold the weights.
    pub fn load(path: &Path) -> Result<Self, LpipsError> {
        let bytes = std::fs::read(path).map_err(|source| LpipsError::Read {
            path: path.to_owned(),
            source,
        })?;
        Self::from_bytes(&bytes)
    }

    /// Reads the weights from the bytes of a safetensors file.
    ///
    /// # Errors
    /// [`LpipsError`] when the bytes do not hold the weights.
    pub fn from_bytes(bytes: &[u8]) -> Result<Self, LpipsError> {
        let tensors =
            SafeTensors::deserialize(bytes).map_err(|e| LpipsError::Format(e.to_string()))?;
        let mut convs = Vec::with_capacity(NUM_LAYERS);
        let mut heads = Vec::with_capacity(NUM_LAYERS);
        for (layer, (number, shape, _)) in CONVS.into_iter().enumerate() {
            let ConvShape {
                num_inputs,
                num_outputs,
                kernel,
                ..
            } = shape;
            let name = |part: &str| format!("features.{number}.{part}");
            convs.push(Conv {
                shape,
                weights: values(
                    &tensors,
                    &name("weight"),
                    &[num_outputs, num_inputs, kernel, kernel],
                )?,
                biases: values(&tensors, &name("bias"), &[num_outputs])?,
            });
            let head = format!("lin{layer}.weight");
            heads.push(values(&tensors, &head, &[1, num_outputs, 1, 1])?);
        }
        Ok(Self { convs, heads })
    }

    /// An image's activations.
    ///
    /// # Errors
    /// [`LpipsError::TooSmall`] for an image of less than 31 pixels a side.
    pub fn features(&self, image: &ColorImage) -> Result<LpipsFeatures, LpipsError> {
        let planes = (0..3).flat_map(|c| {
            image
                .pixels()
                .iter()
                .map(move |pixel| f32::from(pixel[c]) / 127.5 - 1.0)
        });
        self.features_of(
            planes.collect(),
            image.height() as usize,
            image.width() as usize,
        )
    }

    /// The same of `[channel][row][column]` in [−1, 1].
    fn features_of(
        &self,
        mut data: Vec<f32>,
        height: usize,
        width: usize,
    ) -> Result<LpipsFeatures, LpipsError> {
        let too_small = || LpipsError::TooSmall { width, height };
        for ((plane, shift), scale) in data
            .chunks_exact_mut((height * width).max(1))
            .zip(SHIFT)
            .zip(SCALE)
        {
            for value in plane {
                *value = (*value - shift) / scale;
            }
        }
        let mut current = Planes {
            num_channels: 3,
            height,
            width,
            data,
        };
        let mut layers: Vec<(Planes, Vec<f32>)> = Vec::with_capacity(NUM_LAYERS);
        for (conv, (_, _, is_pooled)) in self.convs.iter().zip(CONVS) {
            if is_pooled {
                current = max_pool(&current).ok_or_else(too_small)?;
            }
            current = conv.apply(&current).ok_or_else(too_small)?;
            layers.push((current.clone(), inverse_norms(&current)));
        }
        Ok(LpipsFeatures { layers })
    }

    /// The distance of two images.
    ///
    /// # Errors
    /// [`LpipsError::Size`] when they differ in size.
    pub fn distance(
        &self,
        a: &LpipsFeatures,
        b: &LpipsFeatures,
    ) -> Result<LpipsDistance, LpipsError> {
        let mut per_layer = [0.0; NUM_LAYERS];
        for (layer, mean) in per_layer.iter_mut().enumerate() {
            let ((a, a_norm), (b, b_norm)) = (&a.layers[layer], &b.layers[layer]);
            if [a.height, a.width] != [b.height, b.width] {
                return Err(LpipsError::Size);
            }
            let head = &self.heads[layer];
            let num_positions = a.num_positions();
            let starts: Vec<usize> = (0..num_positions).step_by(CHUNK_POSITIONS).collect();
            let sums: Vec<f64> = starts
                .into_par_iter()
                .map(|start| {
                    let range = start..(start + CHUNK_POSITIONS).min(num_positions);
                    let mut sum = 0.0;
                    for (channel, &weight) in head.iter().enumerate() {
                        let (va, vb) = (a.channel(channel), b.channel(channel));
                        let mut of_channel = 0.0f64;
                        for i in range.clone() {
                            let difference = f64::from(va[i] * a_norm[i] - vb[i] * b_norm[i]);
                            of_channel += difference * difference;
                        }
                        sum += f64::from(weight) * of_channel;
                    }
                    sum
                })
                .collect();
            *mean = sums.iter().sum::<f64>() / num_positions as f64;
        }
        Ok(LpipsDistance { per_layer })
    }
}

/// 1 / (norm over channels + ε), per position.
#[expect(clippy::cast_possible_truncation, reason = "rounding to f32 is meant")]
fn inverse_norms(planes: &Planes) -> Vec<f32> {
    let mut squares = vec![0.0f64; planes.num_positions()];
    for channel in 0..planes.num_channels {
        for (sum, &value) in squares.iter_mut().zip(planes.channel(channel)) {
            *sum += f64::from(value) * f64::from(value);
        }
    }
    squares
        .into_iter()
        .map(|sum| (1.0 / (sum.sqrt() + NORM_EPSILON)) as f32)
        .collect()
}

fn values(
    tensors: &SafeTensors<'_>,
    name: &str,
    expected: &[usize],
) -> Result<Vec<f32>, LpipsError> {
    let problem = |problem: String| LpipsError::Tensor {
        name: name.to_owned(),
        problem,
    };
    let tensor = tensors
        .tensor(name)
        .map_err(|e| problem(format!("is missing: {e}")))?;
    if tensor.shape() != expected || tensor.dtype() != Dtype::F32 {
        return Err(problem(format!(
            "is {:?} of {:?}, not F32 of {expected:?}",
            tensor.dtype(),
            tensor.shape()
        )));
    }
    let values: Vec<f32> = tensor
        .data()
        .chunks_exact(4)
        .map(|b| f32::from_le_bytes([b[0], b[1], b[2], b[3]]))
        .collect();
    if values.iter().all(|v| v.is_finite()) {
        Ok(values)
    } else {
        Err(problem("has values that are not finite".to_owned()))
    }
}

#[cfg(test)]
mod tests;
