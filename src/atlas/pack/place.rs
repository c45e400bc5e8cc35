//! Rectangles onto pages: guillotiere's best-fit free lists, fed from the largest to the smallest.
//!
//! By perimeter the charts of whole rooms fill 0.98 of a page, whatever its shape, and by area
//! nearly always as much; by height or width it can be as little as 0.4.

use guillotiere::{AtlasAllocator, Size};

/// Where a rectangle went.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Spot {
    pub(super) page: u32,
    pub(super) x: u32,
    pub(super) y: u32,
}

/// All rectangles on pages of one size.
#[derive(Debug, PartialEq, Eq)]
pub(super) struct Placement {
    pub(super) page_size_texel: [u32; 2],
    pub(super) num_pages: u32,
    /// In the order of the rectangles given.
    pub(super) spots: Vec<Spot>,
}

impl Placement {
    fn num_texels(&self) -> u64 {
        num_texels(self.page_size_texel) * u64::from(self.num_pages)
    }
}

fn num_texels(size: [u32; 2]) -> u64 {
    u64::from(size[0]) * u64::from(size[1])
}

/// Sides of a single page are multiples of this.
const SIDE_STEP_TEXEL: u32 = 64;

/// The smallest placement found: one page, nearly square, where that holds everything, else as
/// many pages of full width as it takes. Nothing when
/// `max_texels` do not hold it. Each rectangle is at most `max_side_texel` wide and high.
pub(super) fn place(rects: &[[u32; 2]], max_side_texel: u32, max_texels: u64) -> Option<Placement> {
    let area: u64 = rects.iter().map(|&rect| num_texels(rect)).sum();
    if area > max_texels {
        return None;
    }
    let orders = [perimeter, num_texels].map(|size_of| from_the_largest(rects, size_of));
    let largest: [u32; 2] = [0, 1].map(|axis| rects.iter().map(|r| r[axis]).max().unwrap_or(0));
    for size in single_page_sizes(area, max_side_texel) {
        let is_worth_trying = num_texels(size) >= area && (0..2).all(|k| size[k] >= largest[k]);
        if !is_worth_trying {
            continue;
        }
        if num_texels(size) > max_texels {
            return None;
        }
        let mut tries = orders.iter();
        if let Some(placement) = tries.find_map(|order| place_on_pages(rects, order, size, 1)) {
            return Some(placement);
        }
    }
    several_page_sizes(area, max_side_texel)
        .into_iter()
        .filter(|size| size[1] >= largest[1])
        .flat_map(|size| orders.iter().map(move |order| (size, order)))
        .filter_map(|(size, order)| {
            let max_pages = u32::try_from(max_texels / num_texels(size)).unwrap_or(u32::MAX);
            place_on_pages(rects, order, size, max_pages)
        })
        .min_by_key(|placement| (placement.num_texels(), placement.num_pages))
}

/// From the smallest that could hold `area` up to the largest page, nearly square, in steps of
/// about a thirtieth of the side: fine enough that little is left empty, coarse enough that few
/// are tried. Sides are whole multiples of [`SIDE_STEP_TEXEL`], which keeps the blocks of texture
/// compression and the first mipmaps whole; no viewer of today needs powers of two.
#[expect(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "the root of an area below max_side² fits; others are cut off by the range"
)]
fn single_page_sizes(area: u64, max_side_texel: u32) -> impl Iterator<Item = [u32; 2]> {
    let first_side = (area as f64).sqrt() as u32 / SIDE_STEP_TEXEL * SIDE_STEP_TEXEL;
    let step = (first_side / 32)
        .next_multiple_of(SIDE_STEP_TEXEL)
        .max(SIDE_STEP_TEXEL);
    let sides = (first_side.max(SIDE_STEP_TEXEL)..max_side_texel)
        .step_by(step as usize)
        .chain([max_side_texel]);
    sides.flat_map(move |side| {
        let wide = [side, side.saturating_sub(step).max(SIDE_STEP_TEXEL)];
        [wide, [side, side]]
    })
}

/// Heights at which two, three or four pages of full width would hold `area` with little to
/// spare, and the full page.
fn several_page_sizes(area: u64, max_side_texel: u32) -> Vec<[u32; 2]> {
    /// Shares of a page that placement fills.
    const FILLS: [f64; 3] = [0.97, 0.94, 0.9];
    let width = max_side_texel;
    let mut heights: Vec<u32> = (2..=4u32)
        .flat_map(|num_pages| FILLS.map(|fill| (num_pages, fill)))
        .filter_map(|(num_pages, fill)| {
            let height = area as f64 / (f64::from(num_pages) * fill * f64::from(width));
            #[expect(
                clippy::cast_possible_truncation,
                clippy::cast_sign_loss,
                reason = "saturates, and is filtered"
            )]
            let height = (height.ceil() as u32).checked_next_multiple_of(SIDE_STEP_TEXEL)?;
            (height < max_side_texel).then_some(height)
        })
        .collect();
    heights.push(max_side_texel);
    heights.into_iter().map(|height| [width, height]).collect()
}

fn from_the_largest(rects: &[[u32; 2]], size_of: fn([u32; 2]) -> u64) -> Vec<usize> {
    let mut order: Vec<usize> = (0..rects.len()).collect();
    order.sort_by_key(|&k| (std::cmp::Reverse((size_of(rects[k]), rects[k])), k));
    order
}

fn perimeter(size: [u32; 2]) -> u64 {
    2 * (u64::from(size[0]) + u64::from(size[1]))
}

fn place_on_pages(
    rects: &[[u32; 2]],
    order: &[usize],
    page_size_texel: [u32; 2],
    max_pages: u32,
) -> Option<Placement> {
    let as_size = |[width, height]: [u32; 2]| {
        let side = |v: u32| i32::try_from(v).unwrap_or(i32::MAX);
        Size::new(side(width), side(height))
    };
    let mut pages: Vec<AtlasAllocator> = Vec::new();
    let mut spots = vec![
        Spot {
            page: 0,
            x: 0,
            y: 0
        };
        rects.len()
    ];
    for &k in order {
        let size = as_size(rects[k]);
        let found = (0u32..)
            .zip(pages.iter_mut())
            .find_map(|(page, allocator)| Some((page, allocator.allocate(size)?)));
        let (page, allocation) = match found {
            Some(found) => found,
            None => {
                let page = u32::try_from(pages.len()).ok().filter(|p| *p < max_pages)?;
                pages.push(AtlasAllocator::new(as_size(page_size_texel)));
                (page, pages.last_mut()?.allocate(size)?)
            }
        };
        let corner = allocation.rectangle.min;
        spots[k] = Spot {
            page,
            x: u32::try_from(corner.x).ok()?,
            y: u32::try_from(corner.y).ok()?,
        };
    }
    Some(Placement {
        page_size_texel,
        num_pages: u32::try_from(pages.len()).ok()?.max(1),
        spots,
    })
}
