//! Atlas pages as image files: encoded once, in parallel, and shared by every writer.

use rayon::prelude::*;

use crate::atlas::{AtlasTexture, TexturePage};

use super::ExportError;

/// How a page is encoded.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum PageFormat {
    /// Lossless, at the fast level: 4096² in a fifth of a second.
    Png,
    /// Lossy, 4:2:0 below quality 90 and 4:4:4 from there on.
    Jpeg {
        /// 1 (small) to 100 (good).
        quality: u8,
    },
}

impl PageFormat {
    /// The MIME type.
    pub const fn mime_type(self) -> &'static str {
        match self {
            Self::Png => "image/png",
            Self::Jpeg { .. } => "image/jpeg",
        }
    }
}

/// All pages of an atlas as files in memory, in order.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct EncodedPages {
    format: PageFormat,
    pages: Vec<Vec<u8>>,
}

impl EncodedPages {
    /// Encodes every page.
    ///
    /// # Errors
    /// [`ExportError::Encode`] for a page that the encoder refuses, such as an empty one.
    pub fn encode(texture: &AtlasTexture, format: PageFormat) -> Result<Self, ExportError> {
        let pages: Vec<Result<Vec<u8>, ExportError>> = texture
            .pages
            .par_iter()
            .enumerate()
            .map(|(index, page)| encode_page(index, page, format))
            .collect();
        Ok(Self {
            format,
            pages: pages.into_iter().collect::<Result<_, _>>()?,
        })
    }

    /// How they are encoded.
    pub fn format(&self) -> PageFormat {
        self.format
    }

    /// The files, one per page.
    pub fn pages(&self) -> &[Vec<u8>] {
        &self.pages
    }
}

fn encode_page(
    index: usize,
    page: &TexturePage,
    format: PageFormat,
) -> Result<Vec<u8>, ExportError> {
    let bytes = page.srgb.as_flattened();
    let (encoded, name) = match format {
        PageFormat::Png => (png_rgb8(page.width, page.height, bytes), "png"),
        PageFormat::Jpeg { quality } => {
            (jpeg_rgb8(page.width, page.height, bytes, quality), "jpeg")
        }
    };
    encoded.map_err(|reason| ExportError::Encode {
        page: index,
        width: page.width,
        height: page.height,
        format: name,
        reason,
    })
}

/// A PNG file of 8-bit sRGB pixels; the error is the encoder's words.
pub(crate) fn png_rgb8(width: u32, height: u32, rgb: &[u8]) -> Result<Vec<u8>, String> {
    png(
        width,
        height,
        png::ColorType::Rgb,
        png::BitDepth::Eight,
        rgb,
    )
}

/// A PNG file of 8-bit grey pixels.
pub(crate) fn png_grey8(width: u32, height: u32, grey: &[u8]) -> Result<Vec<u8>, String> {
    png(
        width,
        height,
        png::ColorType::Grayscale,
        png::BitDepth::Eight,
        grey,
    )
}

/// A PNG file of 16-bit grey pixels, given in big-endian byte order.
pub(crate) fn png_grey16(width: u32, height: u32, grey_be: &[u8]) -> Result<Vec<u8>, String> {
    png(
        width,
        height,
        png::ColorType::Grayscale,
        png::BitDepth::Sixteen,
        grey_be,
    )
}

fn png(
    width: u32,
    height: u32,
    color: png::ColorType,
    depth: png::BitDepth,
    bytes: &[u8],
) -> Result<Vec<u8>, String> {
    let mut out = Vec::with_capacity(bytes.len() / 2 + 1024);
    let mut encoder = png::Encoder::new(&mut out, width, height);
    encoder.set_color(color);
    encoder.set_depth(depth);
    encoder.set_compression(png::Compression::Fast);
    // One fixed filter: choosing per row costs more than the deflate pass itself, and the fast
    // level finds runs of zeros only, which areas of one value become under this one.
    encoder.set_filter(png::Filter::Up);
    if color == png::ColorType::Rgb {
        encoder.set_source_srgb(png::SrgbRenderingIntent::Perceptual);
    }
    let mut writer = encoder.write_header().map_err(|e| e.to_string())?;
    writer.write_image_data(bytes).map_err(|e| e.to_string())?;
    writer.finish().map_err(|e| e.to_string())?;
    Ok(out)
}

/// A JPEG file of 8-bit sRGB pixels; the error is the encoder's words.
pub(crate) fn jpeg_rgb8(
    width: u32,
    height: u32,
    rgb: &[u8],
    quality: u8,
) -> Result<Vec<u8>, String> {
    let side = |side: u32| u16::try_from(side).map_err(|_| format!("side {side} is over 65535"));
    let mut out = Vec::with_capacity(rgb.len() / 8 + 1024);
    let mut encoder = jpeg_encoder::Encoder::new(&mut out, quality.clamp(1, 100));
    encoder.set_sampling_factor(if quality < 90 {
        jpeg_encoder::SamplingFactor::R_4_2_0
    } else {
        jpeg_encoder::SamplingFactor::R_4_4_4
    });
    encoder
        .encode(
            rgb,
            side(width)?,
            side(height)?,
            jpeg_encoder::ColorType::Rgb,
        )
        .map_err(|e| e.to_string())?;
    Ok(out)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Two pages of 64×64 whose colour follows the column and the row.
    fn ramp() -> AtlasTexture {
        let mut page = TexturePage::blank(64, 64);
        for (row, y) in page.srgb.chunks_mut(64).zip(0u8..) {
            for (texel, x) in row.iter_mut().zip(0u8..) {
                *texel = [x * 3, y * 3, 90];
            }
        }
        AtlasTexture::from_iter([page.clone(), page])
    }

    #[test]
    fn png_pages_decode_to_the_same_texels() {
        let texture = ramp();
        let encoded = EncodedPages::encode(&texture, PageFormat::Png).unwrap();
        assert_eq!(encoded.pages().len(), 2);
        let decoded = image::load_from_memory(&encoded.pages()[1])
            .unwrap()
            .into_rgb8();
        assert_eq!(decoded.dimensions(), (64, 64));
        assert_eq!(decoded.as_raw(), texture.pages[1].srgb.as_flattened());
    }

    #[test]
    fn jpeg_pages_are_close() {
        let texture = ramp();
        let encoded = EncodedPages::encode(&texture, PageFormat::Jpeg { quality: 92 }).unwrap();
        let decoded = image::load_from_memory(&encoded.pages()[0])
            .unwrap()
            .into_rgb8();
        let worst = decoded
            .as_raw()
            .iter()
            .zip(texture.pages[0].srgb.as_flattened())
            .map(|(a, b)| a.abs_diff(*b))
            .max();
        assert!(worst.unwrap() <= 8, "{worst:?}");
    }

    #[test]
    fn sixteen_bit_grey_survives() {
        let values: Vec<u16> = (0..12).map(|i| i * 5000).collect();
        let bytes: Vec<u8> = values.iter().flat_map(|v| v.to_be_bytes()).collect();
        let file = png_grey16(4, 3, &bytes).unwrap();
        let decoded = image::load_from_memory(&file).unwrap().into_luma16();
        assert_eq!(decoded.as_raw(), &values);
    }

    #[test]
    fn an_empty_page_is_an_error_with_its_number() {
        let texture = AtlasTexture::from_iter([TexturePage::blank(0, 0)]);
        for format in [PageFormat::Png, PageFormat::Jpeg { quality: 80 }] {
            let error = EncodedPages::encode(&texture, format).unwrap_err();
            assert!(error.to_string().starts_with("page 0 of 0x0"), "{error}");
        }
    }
}
