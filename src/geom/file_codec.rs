//! JPEG and PNG by the `image` and `png` crates, with sizes checked against the header that was
//! accepted and memory bounded by them.

use std::io::Cursor;

use image::codecs::{jpeg::JpegDecoder, png::PngDecoder};
use image::{ColorType, DynamicImage, ImageDecoder, Limits};

use super::image::ImageError;

fn codec_error(codec: &'static str, error: impl std::fmt::Display) -> ImageError {
    ImageError::Codec {
        codec,
        reason: error.to_string(),
    }
}

fn check_decoder_size(
    codec: &'static str,
    decoder: &impl ImageDecoder,
    size: [u32; 2],
) -> Result<(), ImageError> {
    let [width, height] = size;
    if decoder.dimensions() == (width, height) {
        return Ok(());
    }
    let (w, h) = decoder.dimensions();
    Err(codec_error(
        codec,
        format_args!("size {w}x{h} in the stream, {width}x{height} in the header"),
    ))
}

pub(crate) fn decode_jpeg(bytes: &[u8], size: [u32; 2]) -> Result<Vec<[u8; 3]>, ImageError> {
    let decoder = JpegDecoder::new(Cursor::new(bytes)).map_err(|e| codec_error("jpeg", e))?;
    check_decoder_size("jpeg", &decoder, size)?;
    let num_pixels = size[0] as usize * size[1] as usize;
    match decoder.color_type() {
        ColorType::Rgb8 => {
            let mut pixels = vec![[0u8; 3]; num_pixels];
            let read = decoder.read_image(pixels.as_flattened_mut());
            read.map_err(|e| codec_error("jpeg", e))?;
            Ok(pixels)
        }
        ColorType::L8 => {
            let mut luma = vec![0u8; num_pixels];
            let read = decoder.read_image(&mut luma);
            read.map_err(|e| codec_error("jpeg", e))?;
            Ok(luma.into_iter().map(|y| [y; 3]).collect())
        }
        other => Err(codec_error("jpeg", format_args!("pixels are {other:?}"))),
    }
}

fn decode_png(bytes: &[u8], size: [u32; 2]) -> Result<DynamicImage, ImageError> {
    let num_pixels = u64::from(size[0]) * u64::from(size[1]);
    let mut limits = Limits::default();
    limits.max_image_width = Some(size[0]);
    limits.max_image_height = Some(size[1]);
    // 16-bit RGBA is the widest pixel; twice that, for the decoder's own rows and buffers.
    limits.max_alloc = Some(num_pixels * 16 + (1 << 20));
    let decoder = PngDecoder::with_limits(Cursor::new(bytes), limits)
        .map_err(|error| codec_error("png", error))?;
    check_decoder_size("png", &decoder, size)?;
    DynamicImage::from_decoder(decoder).map_err(|error| codec_error("png", error))
}

pub(crate) fn decode_png_rgb(bytes: &[u8], size: [u32; 2]) -> Result<Vec<[u8; 3]>, ImageError> {
    let image = decode_png(bytes, size)?.into_rgb8();
    Ok(image.as_raw().as_chunks::<3>().0.to_vec())
}

pub(crate) fn decode_png_grey16(bytes: &[u8], size: [u32; 2]) -> Result<Vec<u16>, ImageError> {
    let [width, height] = size;
    let num_pixels = width as usize * height as usize;
    // Twice the pixels, for the decoder's own rows and buffers.
    let limits = png::Limits {
        bytes: num_pixels * 4 + (1 << 20),
    };
    let mut reader = png::Decoder::new_with_limits(Cursor::new(bytes), limits)
        .read_info()
        .map_err(|e| codec_error("png", e))?;
    let info = reader.info();
    if (info.width, info.height) != (width, height) {
        return Err(codec_error(
            "png",
            format_args!(
                "size {}x{} in the stream, {width}x{height} in the header",
                info.width, info.height
            ),
        ));
    }
    if reader.output_color_type() != (png::ColorType::Grayscale, png::BitDepth::Sixteen) {
        return Err(codec_error(
            "png",
            format_args!(
                "depth needs 16-bit grey, pixels are {:?}",
                reader.output_color_type()
            ),
        ));
    }
    let mut big_endian = vec![0u8; num_pixels * 2];
    reader
        .next_frame(&mut big_endian)
        .map_err(|e| codec_error("png", e))?;
    let samples = big_endian.as_chunks::<2>().0;
    Ok(samples.iter().map(|&s| u16::from_be_bytes(s)).collect())
}

/// A PNG at the fast level (the slower ones take seconds for an atlas page).
pub(crate) fn encode_png(
    size: [u32; 2],
    samples: &[u8],
    color: png::ColorType,
    depth: png::BitDepth,
) -> Result<Vec<u8>, ImageError> {
    encode_png_filtered(size, samples, color, depth, png::Filter::Adaptive)
}

/// The same of a photo's RGB, each row filtered by Paeth's predictor: trying all filters on each row
/// chooses it nearly always, and takes an eighth more time.
pub(crate) fn encode_photo_png(size: [u32; 2], rgb: &[u8]) -> Result<Vec<u8>, ImageError> {
    let (color, depth) = (png::ColorType::Rgb, png::BitDepth::Eight);
    encode_png_filtered(size, rgb, color, depth, png::Filter::Paeth)
}

fn encode_png_filtered(
    [width, height]: [u32; 2],
    samples: &[u8],
    color: png::ColorType,
    depth: png::BitDepth,
    filter: png::Filter,
) -> Result<Vec<u8>, ImageError> {
    let mut bytes = Vec::new();
    let mut encoder = png::Encoder::new(&mut bytes, width, height);
    encoder.set_color(color);
    encoder.set_depth(depth);
    encoder.set_compression(png::Compression::Fast);
    encoder.set_filter(filter);
    let mut writer = encoder.write_header().map_err(|e| codec_error("png", e))?;
    writer
        .write_image_data(samples)
        .map_err(|e| codec_error("png", e))?;
    writer.finish().map_err(|e| codec_error("png", e))?;
    Ok(bytes)
}
