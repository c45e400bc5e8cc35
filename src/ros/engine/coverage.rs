//! How much of the texture keyframes painted, counted anew only on pages that were written.

use crate::atlas::{AtlasTexture, PageTrace, SharedPage, TexelSource};

/// What was counted last.
#[derive(Debug, Default)]
pub(super) struct Coverage(Vec<CountedPage>);

#[derive(Debug)]
struct CountedPage {
    trace: PageTrace,
    /// Texels that a keyframe painted, and all that a triangle covers.
    counts: [u64; 2],
}

impl Coverage {
    /// The share of the texels that triangles cover which a keyframe painted, 0 to 1; 0 without any.
    pub(super) fn of(&mut self, texture: &AtlasTexture) -> f32 {
        let before = std::mem::take(&mut self.0);
        let pages = texture.pages.iter().enumerate();
        let counted = pages.map(|(number, page)| {
            let known = before.get(number).filter(|known| known.trace.is_of(page));
            CountedPage {
                trace: page.trace(),
                counts: known.map_or_else(|| counts(page), |known| known.counts),
            }
        });
        self.0 = counted.collect();
        let sum = |of: usize| self.0.iter().map(|page| page.counts[of]).sum::<u64>();
        let [num_painted, num_covered] = [0, 1].map(sum);
        if num_covered == 0 {
            return 0.0;
        }
        num_painted as f32 / num_covered as f32
    }
}

fn counts(page: &SharedPage) -> [u64; 2] {
    let (mut num_painted, mut num_covered) = (0, 0);
    for source in &page.source {
        let is_covered = *source != TexelSource::NONE && *source != TexelSource::GUTTER;
        num_covered += u64::from(is_covered);
        num_painted += u64::from(source.as_keyframe().is_some());
    }
    [num_painted, num_covered]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::atlas::TexturePage;

    #[test]
    fn what_is_painted_counts_against_what_is_covered() {
        let mut texture = AtlasTexture::default();
        let mut coverage = Coverage::default();
        assert_eq!(coverage.of(&texture), 0.0);
        texture = (0..2).map(|_| TexturePage::blank(2, 2)).collect();
        assert_eq!(coverage.of(&texture), 0.0);
        let sources = [
            TexelSource::keyframe(3),
            TexelSource::DIFFUSED,
            TexelSource::GUTTER,
            TexelSource::NONE,
        ];
        texture.pages[0].to_mut().source = sources.to_vec();
        assert_eq!(coverage.of(&texture), 0.5);
        texture.pages[1].to_mut().source[2] = TexelSource::keyframe(0);
        assert_eq!(coverage.of(&texture), 2.0 / 3.0);
        texture.pages.remove(0);
        assert_eq!(coverage.of(&texture), 1.0);
    }
}
