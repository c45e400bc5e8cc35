//! The scan from above, and where the camera was.
//!
//! An orthographic picture down the z axis, opened below a height so that one looks into a room,
//! and the keyframes drawn over it as SVG.

use nalgebra::Point3;

use crate::export::TexturedMesh;
use crate::geom::ColorImage;
use crate::mesh::TriangleId;

use super::colors;
use super::data::KeyframeRow;

/// Space around the scan, as a share of its longer side.
const MARGIN: f64 = 0.04;

/// A picture from above and the frame it is in.
#[derive(Clone, Debug, PartialEq)]
pub struct Plan {
    /// The picture; +x to the right, +y up.
    pub image: ColorImage,
    min_m: [f64; 2],
    max_y_m: f64,
    px_per_m: f64,
}

impl Plan {
    /// Draws the mesh with its longer side at `side_px`; `None` without area. The cut is at the
    /// keyframes' median height when that is inside the mesh (a camera in a room), else above all.
    pub fn draw(
        textured: &TexturedMesh<'_>,
        keyframes: &[KeyframeRow],
        side_px: u32,
    ) -> Option<Self> {
        let (min_m, max_m) = extent(textured, keyframes)?;
        let size_m = [max_m[0] - min_m[0], max_m[1] - min_m[1]];
        let px_per_m = f64::from(side_px) / size_m[0].max(size_m[1]);
        if !px_per_m.is_finite() {
            return None;
        }
        let [width, height] = size_m.map(|m| to_px(m * px_per_m).clamp(1, side_px));
        let mut canvas = Canvas::new(width, height);
        let cut_m = cut_height(textured, keyframes);
        for triangle in textured.mesh().triangle_ids() {
            let corners = textured.mesh().corners_m(triangle);
            let project = |p: Point3<f64>| {
                let x = (p.x - min_m[0]) * px_per_m;
                let y = (max_m[1] - p.y) * px_per_m;
                [x, y, p.z]
            };
            if corners.iter().all(|p| p.z <= cut_m) {
                canvas.fill(corners.map(project), |weights| {
                    srgb_at(textured, triangle, weights)
                });
            }
        }
        Some(Self {
            image: ColorImage::new(width, height, canvas.srgb).ok()?,
            min_m,
            max_y_m: max_m[1],
            px_per_m,
        })
    }

    /// Pixel of a point.
    pub fn px(&self, [x_m, y_m]: [f64; 2]) -> [f64; 2] {
        [
            (x_m - self.min_m[0]) * self.px_per_m,
            (self.max_y_m - y_m) * self.px_per_m,
        ]
    }

    /// Pixels per metre of the picture.
    pub fn px_per_m(&self) -> f64 {
        self.px_per_m
    }
}

#[expect(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "the cast saturates, and the result is clamped"
)]
fn to_px(value: f64) -> u32 {
    value.round() as u32
}

fn extent(textured: &TexturedMesh<'_>, keyframes: &[KeyframeRow]) -> Option<([f64; 2], [f64; 2])> {
    let mesh = textured.mesh();
    let corners = mesh.triangles().iter().flatten();
    let points = corners.map(|&vertex| mesh.positions_m()[vertex as usize]);
    let (mut min, mut max) = bounds(points.map(|p| [p.x, p.y]));
    let cameras = keyframes.iter().map(|k| [k.position_m[0], k.position_m[1]]);
    let (camera_min, camera_max) = bounds(cameras);
    // A camera may stand beside what it looks at; one that was lost must not shrink the picture.
    let reach = (max[0] - min[0]).max(max[1] - min[1]);
    for axis in 0..2 {
        min[axis] = min[axis].min(camera_min[axis].max(min[axis] - reach));
        max[axis] = max[axis].max(camera_max[axis].min(max[axis] + reach));
    }
    let longest = (max[0] - min[0]).max(max[1] - min[1]);
    let is_usable = longest.is_finite() && longest > 0.0;
    is_usable.then(|| {
        let margin = longest * MARGIN;
        (min.map(|m| m - margin), max.map(|m| m + margin))
    })
}

fn bounds(points: impl Iterator<Item = [f64; 2]>) -> ([f64; 2], [f64; 2]) {
    let mut min = [f64::INFINITY; 2];
    let mut max = [f64::NEG_INFINITY; 2];
    for point in points {
        for axis in 0..2 {
            min[axis] = min[axis].min(point[axis]);
            max[axis] = max[axis].max(point[axis]);
        }
    }
    (min, max)
}

fn cut_height(textured: &TexturedMesh<'_>, keyframes: &[KeyframeRow]) -> f64 {
    let mut heights: Vec<f64> = keyframes.iter().map(|k| k.position_m[2]).collect();
    heights.sort_by(f64::total_cmp);
    let highest = textured
        .mesh()
        .positions_m()
        .iter()
        .fold(f64::NEG_INFINITY, |highest, p| highest.max(p.z));
    match heights.get(heights.len() / 2) {
        Some(&height) if height < highest => height,
        _ => f64::INFINITY,
    }
}

#[expect(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "corners lie within the page, and the casts saturate"
)]
fn srgb_at(textured: &TexturedMesh<'_>, triangle: TriangleId, weights: [f64; 3]) -> [u8; 3] {
    let page = &textured.texture().pages[textured.layout().page_of(triangle) as usize];
    let corners = textured.layout().corners_texel[triangle.index()];
    let [x, y] = [0, 1].map(|axis| {
        let weighted = weights.iter().zip(&corners);
        weighted
            .map(|(w, corner)| w * f64::from(corner[axis]))
            .sum::<f64>() as u32
    });
    let (x, y) = (x.min(page.width - 1), y.min(page.height - 1));
    page.srgb[y as usize * page.width as usize + x as usize]
}

struct Canvas {
    width: u32,
    height: u32,
    srgb: Vec<[u8; 3]>,
    z_m: Vec<f64>,
}

impl Canvas {
    fn new(width: u32, height: u32) -> Self {
        let num_pixels = width as usize * height as usize;
        Self {
            width,
            height,
            srgb: vec![colors::BACKGROUND; num_pixels],
            z_m: vec![f64::NEG_INFINITY; num_pixels],
        }
    }

    /// Fills the pixels whose middle is in the triangle, or the one that holds its middle when
    /// there are none, by the corners' weights there; the highest wins.
    fn fill(&mut self, [a, b, c]: [[f64; 3]; 3], srgb: impl Fn([f64; 3]) -> [u8; 3]) {
        let range = |axis: usize, limit: u32| {
            let low = a[axis].min(b[axis]).min(c[axis]);
            let high = a[axis].max(b[axis]).max(c[axis]);
            to_px(low.floor()).min(limit)..to_px(high.ceil()).min(limit)
        };
        let side = |p: [f64; 3], q: [f64; 3], x: f64, y: f64| {
            (q[0] - p[0]) * (y - p[1]) - (q[1] - p[1]) * (x - p[0])
        };
        let area = side(a, b, c[0], c[1]);
        let mut is_empty = true;
        // A wall seen edge-on has no area: its middle stands for it.
        for y in range(1, if area == 0.0 { 0 } else { self.height }) {
            for x in range(0, self.width) {
                let (px, py) = (f64::from(x) + 0.5, f64::from(y) + 0.5);
                let sides = [side(b, c, px, py), side(c, a, px, py), side(a, b, px, py)];
                let weights = sides.map(|side| side / area);
                if weights.iter().all(|w| *w >= 0.0) {
                    let z_m = weights[0] * a[2] + weights[1] * b[2] + weights[2] * c[2];
                    self.put(x, y, z_m, srgb(weights));
                    is_empty = false;
                }
            }
        }
        if is_empty {
            let middle = |axis: usize| (a[axis] + b[axis] + c[axis]) / 3.0;
            let px = |axis: usize, limit: u32| to_px(middle(axis).floor()).min(limit - 1);
            let (x, y) = (px(0, self.width), px(1, self.height));
            self.put(x, y, middle(2), srgb([1.0 / 3.0; 3]));
        }
    }

    fn put(&mut self, x: u32, y: u32, z_m: f64, srgb: [u8; 3]) {
        let index = y as usize * self.width as usize + x as usize;
        if z_m > self.z_m[index] {
            self.z_m[index] = z_m;
            self.srgb[index] = srgb;
        }
    }
}
