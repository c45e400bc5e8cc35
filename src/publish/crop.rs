//! Rectangles of pages: their texels, and as image files.

use crate::atlas::{TexelRect, TexturePage};
use crate::export::ExportError;
use crate::export::pages::{self, PageFormat};

/// Texels of a rectangle, row by row. The rectangle must lie on the page.
pub(super) fn texels(page: &TexturePage, rect: &TexelRect) -> Vec<[u8; 3]> {
    let mut texels = Vec::with_capacity(rect.width as usize * rect.height as usize);
    for row in rows(page, rect) {
        texels.extend_from_slice(row);
    }
    texels
}

/// Rows of a rectangle.
pub(super) fn rows<'a>(
    page: &'a TexturePage,
    rect: &TexelRect,
) -> impl Iterator<Item = &'a [[u8; 3]]> + use<'a> {
    let TexelRect {
        x,
        y,
        width,
        height,
    } = *rect;
    (y..y + height).map(move |row| {
        let start = row as usize * page.width as usize + x as usize;
        &page.srgb[start..start + width as usize]
    })
}

/// The rectangle as an image file.
pub(super) fn encode(
    page_index: usize,
    page: &TexturePage,
    rect: &TexelRect,
    format: PageFormat,
) -> Result<Vec<u8>, ExportError> {
    let texels = texels(page, rect);
    let (width, height) = (rect.width, rect.height);
    let bytes = texels.as_flattened();
    let (file, name) = match format {
        PageFormat::Png => (pages::png_rgb8(width, height, bytes), "png"),
        PageFormat::Jpeg { quality } => (pages::jpeg_rgb8(width, height, bytes, quality), "jpeg"),
    };
    file.map_err(|reason| ExportError::Encode {
        page: page_index,
        width,
        height,
        format: name,
        reason,
    })
}
