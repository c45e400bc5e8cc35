//! The texels of the pages: colour, where it came from, and how far to trust it.

use std::ops::Deref;
use std::sync::{Arc, Weak};

use super::layout::PlacedChart;

/// Where a texel's colour came from.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct TexelSource(u32);

impl TexelSource {
    /// No triangle covers the texel and no gutter reaches it.
    pub const NONE: Self = Self(u32::MAX);
    /// The mean over all frames that see the point (L2Avg), where no single frame was chosen.
    pub const MEAN: Self = Self(u32::MAX - 1);
    /// Spread from painted neighbours: no frame sees the point.
    pub const DIFFUSED: Self = Self(u32::MAX - 2);
    /// Copied from the border of its chart, for filtering and mipmaps.
    pub const GUTTER: Self = Self(u32::MAX - 3);

    /// Copied from a keyframe.
    pub const fn keyframe(id: u32) -> Self {
        Self(id)
    }

    /// The keyframe, where it was one.
    pub const fn as_keyframe(self) -> Option<u32> {
        if self.0 < Self::GUTTER.0 {
            Some(self.0)
        } else {
            None
        }
    }
}

/// One page, row-major from the top left.
#[derive(Clone, Debug, PartialEq)]
pub struct TexturePage {
    /// Columns.
    pub width: u32,
    /// Rows.
    pub height: u32,
    /// sRGB bytes.
    pub srgb: Vec<[u8; 3]>,
    /// Per texel: where its colour came from.
    pub source: Vec<TexelSource>,
    /// Per texel: 0 (a guess) to 255 (sharp, near, head-on).
    pub confidence: Vec<u8>,
}

impl TexturePage {
    /// A page that nothing was painted on.
    pub fn blank(width: u32, height: u32) -> Self {
        let num_texels = width as usize * height as usize;
        Self {
            width,
            height,
            srgb: vec![[0; 3]; num_texels],
            source: vec![TexelSource::NONE; num_texels],
            confidence: vec![0; num_texels],
        }
    }

    /// Makes a chart's own texels as if nothing had been painted on them.
    pub(crate) fn blank_chart(&mut self, placed: &PlacedChart) {
        for (row, first, len) in placed.own_spans() {
            let start = (row * self.width + first) as usize;
            let span = start..start + len as usize;
            self.srgb[span.clone()].fill([0; 3]);
            self.source[span.clone()].fill(TexelSource::NONE);
            self.confidence[span].fill(0);
        }
    }
}

/// A page that others may hold, too. Holding one costs nothing; who writes it while others hold it writes a
/// copy, and they keep what they have.
#[derive(Clone, Debug, PartialEq)]
pub struct SharedPage(Arc<TexturePage>);

impl SharedPage {
    /// The page to be written; a copy where others hold it.
    pub fn to_mut(&mut self) -> &mut TexturePage {
        Arc::make_mut(&mut self.0)
    }

    /// Tells later whether it was written since.
    pub fn trace(&self) -> PageTrace {
        PageTrace(Arc::downgrade(&self.0))
    }
}

impl From<TexturePage> for SharedPage {
    fn from(page: TexturePage) -> Self {
        Self(Arc::new(page))
    }
}

impl Deref for SharedPage {
    type Target = TexturePage;

    fn deref(&self) -> &TexturePage {
        &self.0
    }
}

/// What a page was at some moment, without its texels: writing a page takes it away from its traces.
#[derive(Clone, Debug)]
pub struct PageTrace(Weak<TexturePage>);

impl PageTrace {
    /// Whether a page is the very one, not written since. Of equal pages only one is.
    pub fn is_of(&self, page: &SharedPage) -> bool {
        std::ptr::eq(self.0.as_ptr(), Arc::as_ptr(&page.0))
    }
}

/// All pages of an atlas, in the order of [`super::AtlasLayout`]. A clone shares them.
#[derive(Clone, Debug, PartialEq, Default)]
pub struct AtlasTexture {
    /// The pages.
    pub pages: Vec<SharedPage>,
}

impl FromIterator<TexturePage> for AtlasTexture {
    fn from_iter<I: IntoIterator<Item = TexturePage>>(pages: I) -> Self {
        Self {
            pages: pages.into_iter().map(SharedPage::from).collect(),
        }
    }
}

/// A texture that was not made for the layout it came with.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error(
    "texture has {num_pages} pages, the first wrong one {found_texel:?} texels, but the layout has \
     {expected_pages} of {expected_texel:?}"
)]
pub struct TextureMismatch {
    /// Pages of the texture.
    pub num_pages: usize,
    /// Pages of the layout.
    pub expected_pages: u32,
    /// Size of the first page that is not the layout's, by width and height.
    pub found_texel: Option<[u32; 2]>,
    /// Page size of the layout.
    pub expected_texel: [u32; 2],
}

impl AtlasTexture {
    /// Checks that there is a page of the right size for each page of the layout.
    ///
    /// # Errors
    /// [`TextureMismatch`] when the number or the size of pages differs.
    pub fn check_fits(&self, layout: &super::AtlasLayout) -> Result<(), TextureMismatch> {
        let expected_texel = layout.page_size_texel;
        let num_texels = expected_texel[0] as usize * expected_texel[1] as usize;
        let wrong = self.pages.iter().find(|page| {
            [page.width, page.height] != expected_texel
                || page.srgb.len() != num_texels
                || page.source.len() != num_texels
                || page.confidence.len() != num_texels
        });
        if wrong.is_none() && self.pages.len() == layout.num_pages as usize {
            return Ok(());
        }
        Err(TextureMismatch {
            num_pages: self.pages.len(),
            expected_pages: layout.num_pages,
            found_texel: wrong.map(|page| [page.width, page.height]),
            expected_texel,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_written_page_is_another_and_who_holds_it_keeps_what_it_was() {
        let mut texture: AtlasTexture = [TexturePage::blank(2, 1), TexturePage::blank(2, 1)]
            .into_iter()
            .collect();
        let traces: Vec<PageTrace> = texture.pages.iter().map(SharedPage::trace).collect();
        assert!(traces[0].is_of(&texture.pages[0]));
        assert!(!traces[0].is_of(&texture.pages[1]), "equal, but another");
        let held = texture.clone();
        texture.pages[0].to_mut().srgb[1] = [7; 3];
        assert_eq!(held.pages[0].srgb, [[0; 3]; 2]);
        assert_eq!(texture.pages[0].srgb, [[0; 3], [7; 3]]);
        assert!(traces[0].is_of(&held.pages[0]) && !traces[0].is_of(&texture.pages[0]));
        assert!(traces[1].is_of(&held.pages[1]) && traces[1].is_of(&texture.pages[1]));
        // Nobody else holds it: it is written in place, and no longer what was traced.
        let trace = texture.pages[0].trace();
        let place = texture.pages[0].srgb.as_ptr();
        texture.pages[0].to_mut().srgb[0] = [8; 3];
        assert_eq!(texture.pages[0].srgb.as_ptr(), place);
        assert!(!trace.is_of(&texture.pages[0]));
    }
}
