//! Brightness alone, at a fraction of the cost of a full decode: what image quality is judged by.

use zune_jpeg::JpegDecoder;
use zune_jpeg::zune_core::bytestream::ZCursor;
use zune_jpeg::zune_core::colorspace::ColorSpace;
use zune_jpeg::zune_core::options::DecoderOptions;

use super::encoded::{ColorEncoding, EncodedColor};
use super::image::ImageError;

/// Luma (BT.601, of sRGB values) of an image, row-major from the top left, one byte a pixel.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct LumaImage {
    width: u32,
    height: u32,
    luma: Vec<u8>,
}

impl LumaImage {
    /// Width in pixels.
    pub fn width(&self) -> u32 {
        self.width
    }

    /// Height in pixels.
    pub fn height(&self) -> u32 {
        self.height
    }

    /// All pixels, row-major.
    pub fn luma(&self) -> &[u8] {
        &self.luma
    }
}

impl EncodedColor {
    /// The luma of the image. A JPEG's own luma channel is taken as it is, without decoding its
    /// colour.
    ///
    /// # Errors
    /// [`ImageError::Codec`] when the file does not decode.
    pub fn decode_luma(&self) -> Result<LumaImage, ImageError> {
        let luma = match self.encoding() {
            ColorEncoding::Jpeg => jpeg_luma(self)?,
            _ => None,
        };
        let luma = match luma {
            Some(luma) => luma,
            None => {
                let image = self.decode()?;
                image.pixels().iter().map(|&rgb| luma_of(rgb)).collect()
            }
        };
        Ok(LumaImage {
            width: self.width(),
            height: self.height(),
            luma,
        })
    }
}

/// `None` for a JPEG without a luma channel of its own.
fn jpeg_luma(image: &EncodedColor) -> Result<Option<Vec<u8>>, ImageError> {
    let error = |reason: String| ImageError::Codec {
        codec: "jpeg",
        reason,
    };
    let options = DecoderOptions::default()
        .set_strict_mode(false)
        .set_max_width(image.width() as usize)
        .set_max_height(image.height() as usize)
        .jpeg_set_out_colorspace(ColorSpace::Luma);
    let mut decoder = JpegDecoder::new_with_options(ZCursor::new(&image.bytes()[..]), options);
    decoder.decode_headers().map_err(|e| error(e.to_string()))?;
    let has_luma = matches!(
        decoder.input_colorspace(),
        Some(ColorSpace::YCbCr | ColorSpace::Luma)
    );
    if !has_luma {
        return Ok(None);
    }
    let luma = decoder.decode().map_err(|e| error(e.to_string()))?;
    let expected = image.width() as usize * image.height() as usize;
    if luma.len() != expected {
        return Err(ImageError::Length {
            width: image.width(),
            height: image.height(),
            unit: "pixels",
            expected,
            actual: luma.len(),
        });
    }
    Ok(Some(luma))
}

#[expect(
    clippy::cast_possible_truncation,
    reason = "a mean of bytes, weighted to 256, is a byte"
)]
fn luma_of([r, g, b]: [u8; 3]) -> u8 {
    ((77 * u32::from(r) + 150 * u32::from(g) + 29 * u32::from(b) + 128) >> 8) as u8
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn jpeg_luma_is_the_luma_of_the_decoded_image() {
        let (width, height) = (48u16, 40u16);
        let rgb: Vec<u8> = (0..u32::from(height))
            .flat_map(|y| {
                (0..u32::from(width))
                    .flat_map(move |x| [x * 5, y * 6, x + y].map(|v| u8::try_from(v).unwrap()))
            })
            .collect();
        let mut bytes = Vec::new();
        jpeg_encoder::Encoder::new(&mut bytes, 95)
            .encode(&rgb, width, height, jpeg_encoder::ColorType::Rgb)
            .unwrap();
        let image = EncodedColor::from_file(bytes.into()).unwrap();
        let luma = image.decode_luma().unwrap();
        let decoded = image.decode().unwrap();
        for (a, &rgb) in luma.luma().iter().zip(decoded.pixels()) {
            assert!(a.abs_diff(luma_of(rgb)) <= 2);
        }
        assert_eq!(luma.luma().len(), 48 * 40);
        assert_eq!((luma_of([0; 3]), luma_of([255; 3])), (0, 255));
    }
}
