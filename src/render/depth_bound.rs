//! How far a camera sees at most, block by block of its image.

use super::VisibilityParams;
use super::raster::ViewBuffer;
use super::window::PixelWindow;

/// Triangles over more blocks than this are not looked at.
const MAX_BLOCKS: usize = 256;

/// The greatest depth within each block of a view; infinite where a pixel of it is empty. It bounds the
/// depth of the view from above, and goes on doing so while surface is added to the mesh.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct DepthBound {
    /// What of the view it is of.
    window: PixelWindow,
    /// Pixels of the view per pixel of the full-size camera, across and down.
    scale: [f64; 2],
    /// Side of a block, pixels of the view.
    block_px: usize,
    /// Row by row, metres.
    farthest_m: Vec<f32>,
}

/// Where the corners of a triangle lie in blocks: columns and rows, first and last.
enum Reach {
    /// Outside of the window.
    Outside,
    Blocks([[usize; 2]; 2]),
    /// Not to be told, or too many blocks.
    Unknown,
}

impl DepthBound {
    /// Takes over what a window of a camera's view shows; `scale` is the whole view's size over the
    /// camera's. The window begins at a multiple of the blocks' side.
    pub(super) fn update(
        &mut self,
        view: &ViewBuffer,
        window: PixelWindow,
        scale: [f64; 2],
        block_px: usize,
    ) {
        self.window = window;
        self.scale = scale;
        self.block_px = block_px;
        self.farthest_m.clear();
        let width = view.width as usize;
        if width == 0 {
            return;
        }
        let columns = self.num_columns();
        for rows in view.depth_m.chunks(block_px * width) {
            let start = self.farthest_m.len();
            self.farthest_m.resize(start + columns, 0.0);
            let blocks = &mut self.farthest_m[start..];
            for row in rows.chunks_exact(width) {
                for (block, pixels) in blocks.iter_mut().zip(row.chunks(block_px)) {
                    for &depth_m in pixels {
                        let is_empty = depth_m <= 0.0;
                        *block = block.max(if is_empty { f32::INFINITY } else { depth_m });
                    }
                }
            }
        }
    }

    /// The same by blocks of `factor` times the side.
    #[must_use]
    pub fn coarser(&self, factor: usize) -> Self {
        let columns = self.num_columns();
        let mut coarse = Self {
            block_px: self.block_px * factor,
            farthest_m: Vec::new(),
            ..*self
        };
        let coarse_columns = coarse.num_columns();
        for rows in self.farthest_m.chunks((columns * factor).max(1)) {
            let start = coarse.farthest_m.len();
            coarse.farthest_m.resize(start + coarse_columns, 0.0);
            for row in rows.chunks_exact(columns) {
                let blocks = coarse.farthest_m[start..].iter_mut();
                for (block, fine) in blocks.zip(row.chunks(factor)) {
                    *block = fine.iter().copied().fold(*block, f32::max);
                }
            }
        }
        coarse
    }

    /// Takes over what is newer in a part of the same view, in blocks of the same size.
    pub fn renew(&mut self, part: &Self) {
        let is_like = self.block_px == part.block_px && self.scale == part.scale;
        let block_px = self.block_px.max(1);
        let begins = |axis: usize| {
            let pixels = part.window.start[axis].checked_sub(self.window.start[axis])?;
            (pixels as usize)
                .is_multiple_of(block_px)
                .then_some(pixels as usize / block_px)
        };
        let (Some(column), Some(row)) = (begins(0), begins(1)) else {
            return;
        };
        let (columns, part_columns) = (self.num_columns(), part.num_columns());
        if !is_like || part_columns == 0 || column + part_columns > columns {
            return;
        }
        let rows = self.farthest_m.chunks_exact_mut(columns).skip(row);
        for (row, newer) in rows.zip(part.farthest_m.chunks_exact(part_columns)) {
            row[column..column + part_columns].copy_from_slice(newer);
        }
    }

    /// Bytes that it takes.
    pub fn num_bytes(&self) -> usize {
        size_of_val(&*self.farthest_m)
    }

    /// Pixels of the view per pixel of the full-size camera, the lesser of the two ways.
    pub(super) fn least_scale(&self) -> f64 {
        self.scale[0].min(self.scale[1]).max(1e-9)
    }

    /// Whether every point of a triangle is hidden, or outside of the window: then
    /// [`super::VisibilityBuffer::is_visible`] is false for all of them, and it does not show in the
    /// view. A quick test that says no when in doubt. Corners are in pixels of the full-size camera, all
    /// in front of it; `slope_m` as in [`super::SurfacePoint`].
    pub fn hides(
        &self,
        corners_px: &[[f64; 2]; 3],
        nearest_m: f64,
        slope_m: f64,
        params: &VisibilityParams,
    ) -> bool {
        let [columns, [top, bottom]] = match self.reach(corners_px) {
            Reach::Outside => return true,
            Reach::Unknown => return false,
            Reach::Blocks(blocks) => blocks,
        };
        // The tolerance grows more slowly than depth (a share below 1), so the nearest point is the
        // last to be hidden.
        let tolerance_m = params.tolerance_m(nearest_m, slope_m * 1.5 / self.least_scale());
        let bound_m = nearest_m - tolerance_m;
        params.relative_tolerance < 1.0
            && (top..=bottom).all(|row| {
                let start = row * self.num_columns();
                self.farthest_m[start + columns[0]..=start + columns[1]]
                    .iter()
                    .all(|&farthest_m| f64::from(farthest_m) < bound_m)
            })
    }

    /// Surface may have gone from before the camera: where it was nothing is known any more. `None`
    /// stands for corners that are not all in front of the camera.
    pub fn lift(&mut self, corners_px: Option<&[[f64; 2]; 3]>) {
        match corners_px.map_or(Reach::Unknown, |corners_px| self.reach(corners_px)) {
            Reach::Outside => {}
            Reach::Unknown => self.farthest_m.fill(f32::INFINITY),
            Reach::Blocks([columns, [top, bottom]]) => {
                for row in top..=bottom {
                    let start = row * self.num_columns();
                    self.farthest_m[start + columns[0]..=start + columns[1]].fill(f32::INFINITY);
                }
            }
        }
    }

    fn num_columns(&self) -> usize {
        (self.window.size()[0] as usize).div_ceil(self.block_px.max(1))
    }

    #[expect(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "clamped to the view before the casts"
    )]
    fn reach(&self, corners_px: &[[f64; 2]; 3]) -> Reach {
        let sides = self.window.size().map(f64::from);
        let mut blocks = [[0; 2]; 2];
        for axis in 0..2 {
            let start = f64::from(self.window.start[axis]);
            let values = corners_px.map(|corner| (corner[axis] + 0.5) * self.scale[axis] - start);
            let low = values.into_iter().fold(f64::INFINITY, f64::min) - 1.0;
            let high = values.into_iter().fold(f64::NEG_INFINITY, f64::max) + 1.0;
            if !(low.is_finite() && high.is_finite()) {
                return Reach::Unknown;
            }
            if high < 0.0 || low >= sides[axis] {
                return Reach::Outside;
            }
            let block = |v: f64| v.clamp(0.0, sides[axis] - 1.0) as usize / self.block_px.max(1);
            blocks[axis] = [block(low), block(high)];
        }
        let [[left, right], [top, bottom]] = blocks;
        if (right - left + 1) * (bottom - top + 1) > MAX_BLOCKS {
            return Reach::Unknown;
        }
        Reach::Blocks(blocks)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A view of 32×16 at half the camera's size, 2 m deep, 4 m in its right half, with an empty pixel.
    fn bound() -> DepthBound {
        let mut view = ViewBuffer {
            width: 32,
            height: 16,
            triangle: vec![0; 512],
            depth_m: (0..512)
                .map(|i| if i % 32 < 16 { 2.0 } else { 4.0 })
                .collect(),
        };
        view.depth_m[15 * 32 + 31] = 0.0;
        let mut bound = DepthBound::default();
        bound.update(&view, PixelWindow::whole(32, 16), [0.5, 0.5], 4);
        bound
    }

    fn at(x_px: f64, y_px: f64) -> [[f64; 2]; 3] {
        [[x_px, y_px], [x_px + 2.0, y_px], [x_px, y_px + 2.0]]
    }

    #[test]
    fn what_lies_behind_all_of_its_blocks_is_hidden() {
        let params = VisibilityParams::default();
        for bound in [bound(), bound().coarser(2)] {
            let hides = |x_px, y_px, depth_m| bound.hides(&at(x_px, y_px), depth_m, 0.0, &params);
            assert!(hides(4.0, 4.0, 3.0));
            assert!(!hides(4.0, 4.0, 2.02), "within the tolerance");
            assert!(!hides(44.0, 4.0, 3.0));
            assert!(hides(44.0, 4.0, 5.0));
            assert!(!hides(60.0, 28.0, 99.0), "an empty pixel hides nothing");
            assert!(hides(-9.0, 4.0, 1.0), "outside of the image");
            assert!(!bound.hides(&at(4.0, 4.0), 3.0, 1.0, &params), "steep");
            assert!(!bound.hides(&at(f64::NAN, 4.0), 3.0, 0.0, &params));
        }
    }

    #[test]
    fn a_part_that_is_drawn_again_renews_its_blocks() {
        let view = ViewBuffer {
            width: 16,
            height: 8,
            triangle: vec![0; 128],
            depth_m: vec![1.0; 128],
        };
        let window = PixelWindow {
            start: [16, 8],
            end: [32, 16],
        };
        let mut part = DepthBound::default();
        part.update(&view, window, [0.5, 0.5], 4);
        let params = VisibilityParams::default();
        assert!(part.hides(&at(40.0, 24.0), 2.0, 0.0, &params));
        assert!(!part.hides(&at(40.0, 24.0), 1.0, 0.0, &params));
        assert!(
            part.hides(&at(4.0, 4.0), 1.0, 0.0, &params),
            "outside of it"
        );
        let mut whole = bound().coarser(2);
        whole.renew(&part.coarser(2));
        assert!(whole.hides(&at(40.0, 24.0), 2.0, 0.0, &params));
        assert!(whole.hides(&at(60.0, 28.0), 2.0, 0.0, &params));
        assert!(!whole.hides(&at(44.0, 4.0), 3.0, 0.0, &params), "above it");
        assert!(
            !whole.hides(&at(4.0, 24.0), 1.5, 0.0, &params),
            "left of it"
        );
    }

    #[test]
    fn where_surface_went_nothing_is_hidden() {
        let params = VisibilityParams::default();
        let mut lifted = bound();
        lifted.lift(Some(&at(4.0, 4.0)));
        assert!(!lifted.hides(&at(4.0, 4.0), 3.0, 0.0, &params));
        assert!(lifted.hides(&at(20.0, 4.0), 3.0, 0.0, &params));
        lifted.lift(Some(&at(200.0, 4.0)));
        assert!(lifted.hides(&at(20.0, 4.0), 3.0, 0.0, &params));
        lifted.lift(None);
        assert!(!lifted.hides(&at(20.0, 4.0), 3.0, 0.0, &params));
    }
}
