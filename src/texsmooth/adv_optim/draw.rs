//! What a step looks at: a view, and a crop of it.

use super::SmoothError;
use super::step::Optimisation;
use crate::geom::ColorImage;
use crate::texsmooth::random::{Purpose, StepDraws};
use crate::texsmooth::view::PixelRect;
use crate::texsmooth::views::{Seen, UnseenError};

/// Views that a step looks at, at most, for one that shows a chart that may change; bounds its time.
const MAX_LOOKS: u64 = 4;

/// A view with its photo, and the crop.
pub(super) struct Drawn {
    pub(super) index: usize,
    pub(super) seen: Seen,
    pub(super) rect: PixelRect,
}

impl Optimisation<'_> {
    /// Any view and any crop where all charts may change; else a view that shows some that may, and a
    /// crop around a pixel that does. Nothing, and counted, where the photo does not decode or none of a
    /// few views shows any.
    pub(super) fn draw(&mut self, draws: StepDraws) -> Result<Option<Drawn>, SmoothError> {
        for attempt in 0..MAX_LOOKS {
            let draws = draws.again(attempt);
            let index = match self.focus {
                None => draws.below(Purpose::View, self.views.len()),
                Some(focus) => match focus.draw(draws) {
                    Some(index) => index,
                    None => break,
                },
            };
            let seen = match self.views.get(index) {
                Ok(seen) => seen,
                Err(UnseenError::Photo(_)) => {
                    self.report.num_undecodable += 1;
                    if let Some(focus) = self.focus {
                        focus.set(index, 0);
                    }
                    return Ok(None);
                }
                Err(UnseenError::Device(error)) => return Err(error.into()),
            };
            let Some(focus) = self.focus else {
                let rect = self.any_crop(draws, &seen.photo.color);
                return Ok(Some(Drawn { index, seen, rect }));
            };
            let num_px = seen.view.num_changing();
            focus.set(index, num_px);
            let number = draws.below(Purpose::Pixel, num_px);
            if let Some(pixel) = seen.view.changing(self.on, number) {
                let rect = self.crop_around(draws, &seen.photo.color, pixel);
                return Ok(Some(Drawn { index, seen, rect }));
            }
        }
        self.report.num_empty += 1;
        Ok(None)
    }

    fn any_crop(&self, draws: StepDraws, photo: &ColorImage) -> PixelRect {
        let [width, height] = size_px(photo);
        if self.params.crop_px == 0 {
            return self.jittered(draws, photo);
        }
        let side = |size: usize| self.params.crop_px.min(size);
        PixelRect {
            x: draws.below(Purpose::CropX, width - side(width) + 1),
            y: draws.below(Purpose::CropY, height - side(height) + 1),
            width: side(width),
            height: side(height),
        }
    }

    /// Any of the crops that a pixel is in.
    fn crop_around(&self, draws: StepDraws, photo: &ColorImage, [x, y]: [usize; 2]) -> PixelRect {
        if self.params.crop_px == 0 {
            return self.jittered(draws, photo);
        }
        let along = |purpose, at: usize, size: usize| {
            let side = self.params.crop_px.min(size);
            let (first, last) = ((at + 1).saturating_sub(side), at.min(size - side));
            (first + draws.below(purpose, last - first + 1), side)
        };
        let [width, height] = size_px(photo);
        let (x, width) = along(Purpose::CropX, x, width);
        let (y, height) = along(Purpose::CropY, y, height);
        PixelRect {
            x,
            y,
            width,
            height,
        }
    }

    /// The whole photo but for a few columns and rows.
    fn jittered(&self, draws: StepDraws, photo: &ColorImage) -> PixelRect {
        let [width, height] = size_px(photo);
        let jitter = |purpose, size: usize| {
            draws.below(purpose, (self.params.max_jitter_px + 1).min(size.max(1)))
        };
        let (x, y) = (
            jitter(Purpose::CropX, width),
            jitter(Purpose::CropY, height),
        );
        PixelRect {
            x,
            y,
            width: width - x,
            height: height - y,
        }
    }
}

fn size_px(photo: &ColorImage) -> [usize; 2] {
    [photo.width() as usize, photo.height() as usize]
}
