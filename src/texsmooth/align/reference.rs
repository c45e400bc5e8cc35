//! The published program's alignment: plain circular correlation of whole images.

use super::Alignment;
use super::fft2::{Fft2, multiply_conjugate};
use crate::geom::ColorImage;

/// The offset in whole pixels; `None` when no channel's is within bounds.
pub(super) fn align(
    photo: &ColorImage,
    render: &ColorImage,
    mask: Option<&[bool]>,
    max_offset_px: [f32; 2],
) -> Option<Alignment> {
    let size = [photo.width() as usize, photo.height() as usize];
    let fft = Fft2::new(size[0], size[1]);
    let within: Vec<[f32; 2]> = (0..3)
        .filter_map(|channel| {
            let photo = plane(photo, channel, None);
            let render = plane(render, channel, mask);
            let mut spectrum = fft.forward(&photo);
            multiply_conjugate(&mut spectrum, &fft.forward(&render));
            let offset = signed(arg_max(&fft.inverse(spectrum)), size);
            let is_within = offset
                .iter()
                .zip(max_offset_px)
                .all(|(o, max)| o.abs() <= max);
            is_within.then_some(offset)
        })
        .collect();
    if within.is_empty() {
        return None;
    }
    let mean = |axis: usize| within.iter().map(|o| o[axis]).sum::<f32>() / within.len() as f32;
    Some(Alignment {
        offset_px: [mean(0).trunc(), mean(1).trunc()],
        confidence: 1.0,
        is_trusted: true,
    })
}

/// One channel in [−1, 1]; −1 where the mask is off.
fn plane(image: &ColorImage, channel: usize, mask: Option<&[bool]>) -> Vec<f32> {
    let value = |pixel: &[u8; 3]| f32::from(pixel[channel]) / 127.5 - 1.0;
    let values = image.pixels().iter().map(value);
    match mask {
        None => values.collect(),
        Some(mask) => values
            .zip(mask)
            .map(|(value, &counts)| if counts { value } else { -1.0 })
            .collect(),
    }
}

/// The first of the largest.
fn arg_max(values: &[f32]) -> usize {
    let mut best = 0;
    for (index, value) in values.iter().enumerate() {
        if *value > values[best] {
            best = index;
        }
    }
    best
}

/// Circular positions past the middle are negative offsets.
fn signed(index: usize, [width, height]: [usize; 2]) -> [f32; 2] {
    let wrap = |at: usize, size: usize| {
        if 2 * at > size {
            at as f32 - size as f32
        } else {
            at as f32
        }
    };
    [wrap(index % width, width), wrap(index / width, height)]
}
