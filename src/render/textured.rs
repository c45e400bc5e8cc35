//! A view of the textured mesh, as a viewer would show it.
//!
//! Texture coordinates are perspective-correct (barycentrics of the pixel's ray on the triangle's
//! plane); texels are looked up bilinearly with their centres at halves, in sRGB as most viewers
//! do. With supersampling n, n×n samples a pixel are averaged in linear light.
//!
//! A pixel is in the mask when at least half of its samples hit a triangle at a texel that was
//! painted; its colour is the mean over those samples. All other pixels are black.

use nalgebra::Point3;
use rayon::prelude::*;

use crate::atlas::{AtlasLayout, AtlasTexture, TexelSource, TexturePage};
use crate::geom::color::{linear_from_srgb, srgb_from_linear};
use crate::geom::{ColorImage, ImageError, PinholeCamera, RigidTransform};
use crate::mesh::{TriMesh, TriangleId};

use super::raster::{NO_TRIANGLE, RasterWorkspace, ViewBuffer, barycentric, rasterize};

/// How views are rendered.
#[derive(Clone, Debug, PartialEq)]
pub struct RenderParams {
    /// Samples along each side of a pixel, 1..=4.
    pub supersampling: u32,
}

impl Default for RenderParams {
    fn default() -> Self {
        Self { supersampling: 2 }
    }
}

/// A rendered picture.
#[derive(Clone, Debug, PartialEq)]
pub struct RenderedView {
    /// The picture, black where `mask` is false.
    pub color: ColorImage,
    /// Per pixel, row-major: whether the textured mesh was seen there.
    pub mask: Vec<bool>,
}

/// Renders `mesh` with its atlas. A triangle that the layout does not know, or whose page is
/// missing, is left out of the picture and still hides what is behind it.
///
/// # Errors
/// [`ImageError::Size`] when the supersampled view is too large.
pub fn render_textured(
    mesh: &TriMesh,
    layout: &AtlasLayout,
    texture: &AtlasTexture,
    camera: &PinholeCamera,
    camera_from_world: &RigidTransform,
    params: &RenderParams,
) -> Result<RenderedView, ImageError> {
    let surface =
        |triangle: TriangleId, weights: [f64; 3]| sample_atlas(layout, texture, triangle, weights);
    render_surface(mesh, &surface, camera, camera_from_world, params)
}

/// The same from what [`rasterize`] found for this mesh and camera, a sample a pixel.
///
/// # Errors
/// [`ImageError::Size`] when the buffer is not of the camera's size.
pub fn shade_textured(
    mesh: &TriMesh,
    layout: &AtlasLayout,
    texture: &AtlasTexture,
    camera: &PinholeCamera,
    camera_from_world: &RigidTransform,
    view: &ViewBuffer,
) -> Result<RenderedView, ImageError> {
    let (width, height) = (camera.width(), camera.height());
    if (view.width, view.height) != (width, height) {
        return Err(ImageError::Size {
            width: view.width,
            height: view.height,
        });
    }
    let surface =
        |triangle: TriangleId, weights: [f64; 3]| sample_atlas(layout, texture, triangle, weights);
    let shader = Shader {
        mesh,
        surface: &surface,
        camera: *camera,
        points_in_camera: camera_from_world.transform_points(mesh.positions_m()),
    };
    shader.picture(view, [width, height], 1)
}

/// sRGB in 0–255 of the atlas at a point of a triangle; nothing where it is not painted.
fn sample_atlas(
    layout: &AtlasLayout,
    texture: &AtlasTexture,
    triangle: TriangleId,
    weights: [f64; 3],
) -> Option<[f32; 3]> {
    let corners_texel = layout.corners_texel.get(triangle.index())?;
    let chart = layout.chart_of_triangle.get(triangle.index())?;
    let page_index = layout.charts.get(chart.index())?.page;
    let page = texture.pages.get(page_index as usize)?;
    sample_page(page, interpolate(corners_texel, weights))
}

/// The value at a point of a triangle, from its corners' values and the point's weights.
pub(super) fn interpolate(corners: &[[f32; 2]; 3], weights: [f64; 3]) -> [f32; 2] {
    std::array::from_fn(|axis| {
        let terms: [f64; 3] = std::array::from_fn(|i| weights[i] * f64::from(corners[i][axis]));
        #[expect(clippy::cast_possible_truncation, reason = "rounding to f32 is meant")]
        let sum = (terms[0] + terms[1] + terms[2]) as f32;
        sum
    })
}

/// The colour of a mesh at a point of a triangle, by barycentric weights: sRGB in 0–255, or nothing
/// where it has none.
pub(super) type Surface<'a> = dyn Fn(TriangleId, [f64; 3]) -> Option<[f32; 3]> + Sync + 'a;

/// Renders `mesh` with the colours of `surface`.
pub(super) fn render_surface(
    mesh: &TriMesh,
    surface: &Surface<'_>,
    camera: &PinholeCamera,
    camera_from_world: &RigidTransform,
    params: &RenderParams,
) -> Result<RenderedView, ImageError> {
    let samples = params.supersampling.clamp(1, 4);
    let (width, height) = (camera.width(), camera.height());
    let fine = camera
        .resized(width * samples, height * samples)
        .map_err(|_| ImageError::Size {
            width: width * samples,
            height: height * samples,
        })?;
    let mut view = ViewBuffer::default();
    rasterize(
        mesh,
        &fine,
        camera_from_world,
        &mut RasterWorkspace::default(),
        &mut view,
    );

    let shader = Shader {
        mesh,
        surface,
        camera: fine,
        points_in_camera: camera_from_world.transform_points(mesh.positions_m()),
    };
    shader.picture(&view, [width, height], samples)
}

struct Shader<'a> {
    mesh: &'a TriMesh,
    surface: &'a Surface<'a>,
    /// The camera of the samples.
    camera: PinholeCamera,
    points_in_camera: Vec<Point3<f64>>,
}

impl Shader<'_> {
    fn picture(
        &self,
        view: &ViewBuffer,
        [width, height]: [u32; 2],
        samples: u32,
    ) -> Result<RenderedView, ImageError> {
        let rows: Vec<Vec<Option<[u8; 3]>>> = (0..height)
            .into_par_iter()
            .map(|y| {
                (0..width)
                    .map(|x| self.pixel(view, [x, y], samples))
                    .collect()
            })
            .collect();
        let pixels: Vec<Option<[u8; 3]>> = rows.into_iter().flatten().collect();
        let mask = pixels.iter().map(Option::is_some).collect();
        let colors = pixels.into_iter().map(Option::unwrap_or_default).collect();
        Ok(RenderedView {
            color: ColorImage::new(width, height, colors)?,
            mask,
        })
    }

    fn pixel(&self, view: &ViewBuffer, [x, y]: [u32; 2], samples: u32) -> Option<[u8; 3]> {
        let mut sum = [0.0f32; 3];
        let mut last = [0.0f32; 3];
        let mut num_hits = 0u16;
        for sample in 0..samples * samples {
            let [sx, sy] = [
                x * samples + sample % samples,
                y * samples + sample / samples,
            ];
            let index = sy as usize * view.width as usize + sx as usize;
            let triangle = view.triangle[index];
            if triangle == NO_TRIANGLE {
                continue;
            }
            if let Some(srgb) = self.sample(TriangleId(triangle), [sx, sy]) {
                num_hits += 1;
                last = srgb;
                for (sum, value) in sum.iter_mut().zip(srgb) {
                    *sum += linear_from_srgb(round_byte(value));
                }
            }
        }
        if num_hits == 0 || 2 * u32::from(num_hits) < samples * samples {
            return None;
        }
        Some(if num_hits == 1 {
            last.map(round_byte)
        } else {
            sum.map(|sum| srgb_from_linear(sum / f32::from(num_hits)))
        })
    }

    /// sRGB in 0–255 of the surface at a sample.
    fn sample(&self, triangle: TriangleId, [x, y]: [u32; 2]) -> Option<[f32; 3]> {
        let [a, b, c] = self.mesh.triangles()[triangle.index()].map(|v| v as usize);
        let points = &self.points_in_camera;
        let corners = [points[a], points[b], points[c]];
        let ray = self.camera.ray(f64::from(x), f64::from(y));
        let weights = inside(barycentric(&corners, &ray).unwrap_or([1.0 / 3.0; 3]));
        (self.surface)(triangle, weights)
    }
}

/// The nearest weights of a point of the triangle: coverage was decided on a sub-pixel grid, so
/// the ray may miss the triangle by a hair, and by more when the triangle is seen edge-on.
pub(crate) fn inside(weights: [f64; 3]) -> [f64; 3] {
    let clamped = weights.map(|w| w.clamp(0.0, 1.0));
    let sum = clamped[0] + clamped[1] + clamped[2];
    clamped.map(|w| w / sum)
}

#[expect(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "clamped; float to int casts saturate"
)]
pub(super) fn round_byte(value: f32) -> u8 {
    (value + 0.5) as u8
}

/// Bilinear lookup in sRGB bytes' scale (0–255) at a position in texels, clamped to the page;
/// nothing where the nearest texel was never painted.
#[expect(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "clamped to the page before the casts"
)]
pub fn sample_page(page: &TexturePage, [x_texel, y_texel]: [f32; 2]) -> Option<[f32; 3]> {
    let (max_x, max_y) = (page.width.checked_sub(1)?, page.height.checked_sub(1)?);
    let x = (x_texel - 0.5).clamp(0.0, max_x as f32);
    let y = (y_texel - 0.5).clamp(0.0, max_y as f32);
    let (x0, y0) = (x as u32, y as u32);
    let (fx, fy) = (x - x0 as f32, y - y0 as f32);
    let index =
        |x: u32, y: u32| y.min(max_y) as usize * page.width as usize + x.min(max_x) as usize;
    let nearest = index(x0 + u32::from(fx >= 0.5), y0 + u32::from(fy >= 0.5));
    if *page.source.get(nearest)? == TexelSource::NONE {
        return None;
    }
    let texels = [
        (index(x0, y0), (1.0 - fx) * (1.0 - fy)),
        (index(x0 + 1, y0), fx * (1.0 - fy)),
        (index(x0, y0 + 1), (1.0 - fx) * fy),
        (index(x0 + 1, y0 + 1), fx * fy),
    ];
    let mut sum = [0.0f32; 3];
    let mut total = 0.0f32;
    for (index, weight) in texels {
        // Texels that nothing was painted on have no colour to give.
        if *page.source.get(index)? != TexelSource::NONE {
            total += weight;
            for (sum, &byte) in sum.iter_mut().zip(page.srgb.get(index)?) {
                *sum += weight * f32::from(byte);
            }
        }
    }
    Some(sum.map(|sum| sum / total))
}

#[cfg(test)]
#[expect(
    clippy::cast_possible_truncation,
    reason = "the numbers of a test are small"
)]
mod tests {
    use super::*;
    use crate::atlas::{ChartId, PlacedChart, TexelRect};

    /// A square of 1 m in the plane z = 2 + slope·x, on a page whose texels are 1 cm of x and y;
    /// red is the column, green the row.
    fn square(slope: f64) -> (TriMesh, AtlasLayout, AtlasTexture) {
        let corners = [[-0.5, -0.5], [0.5, -0.5], [0.5, 0.5], [-0.5, 0.5]];
        let positions = corners
            .map(|[x, y]| Point3::new(x, y, 2.0 + slope * x))
            .to_vec();
        let (mesh, _) = TriMesh::from_soup(positions, vec![[0, 1, 2], [0, 2, 3]]).unwrap();
        let corners_texel = mesh
            .triangle_ids()
            .map(|t| {
                let texel = |v: f64| ((v + 0.5) * 100.0 + 2.0) as f32;
                mesh.corners_m(t).map(|p| [texel(p.x), texel(p.y)])
            })
            .collect();
        let rect = TexelRect {
            x: 0,
            y: 0,
            width: 104,
            height: 104,
        };
        let layout = AtlasLayout {
            page_size_texel: [104, 104],
            num_pages: 1,
            texels_per_m: 100.0,
            charts: vec![PlacedChart::whole_rect(
                0,
                rect,
                100.0,
                mesh.triangle_ids().collect(),
            )],
            chart_of_triangle: vec![ChartId(0); 2],
            corners_texel,
        };
        let mut page = TexturePage::blank(104, 104);
        for (index, texel) in page.srgb.iter_mut().enumerate() {
            *texel = [(2 * (index % 104)) as u8, (2 * (index / 104)) as u8, 9];
        }
        page.source.fill(TexelSource::keyframe(0));
        (mesh, layout, AtlasTexture::from_iter([page]))
    }

    fn camera() -> PinholeCamera {
        PinholeCamera::new([100.0, 100.0, 31.5, 23.5], 64, 48).unwrap()
    }

    #[test]
    fn colours_are_those_of_the_point_that_the_ray_meets() {
        for slope in [0.0, 1.2, -1.5] {
            let (mesh, layout, texture) = square(slope);
            for supersampling in [1, 2, 3] {
                let params = RenderParams { supersampling };
                let pose = RigidTransform::identity();
                let view =
                    render_textured(&mesh, &layout, &texture, &camera(), &pose, &params).unwrap();
                let mut num_seen = 0;
                for (index, &is_seen) in view.mask.iter().enumerate() {
                    let ray = camera().ray((index % 64) as f64, (index / 64) as f64);
                    let depth_m = 2.0 / (1.0 - slope * ray.x);
                    let (x, y) = (ray.x * depth_m, ray.y * depth_m);
                    let outline = x.abs().max(y.abs()) - 0.5;
                    if outline.abs() < 0.03 {
                        continue;
                    }
                    assert_eq!(is_seen, outline < 0.0, "pixel {index}");
                    let pixel = view.color.pixels()[index];
                    if !is_seen {
                        assert_eq!(pixel, [0; 3]);
                        continue;
                    }
                    num_seen += 1;
                    // Texel centres are at halves: the texel at column c has red 2c.
                    let expected = [x, y].map(|v| 2.0 * ((v + 0.5) * 100.0 + 2.0 - 0.5));
                    // Averaging in linear light brightens a ramp a little.
                    let tolerance = if supersampling == 1 { 0.8 } else { 2.0 };
                    for (byte, expected) in pixel.iter().zip(expected) {
                        let error = (f64::from(*byte) - expected).abs();
                        assert!(error < tolerance, "{pixel:?} for {expected:?} at {index}");
                    }
                }
                assert!(num_seen > 900, "{num_seen}");
            }
        }
    }

    #[test]
    fn unpainted_texels_are_not_in_the_mask() {
        let (mesh, layout, mut texture) = square(0.0);
        for (index, source) in texture.pages[0].to_mut().source.iter_mut().enumerate() {
            if index % 104 < 52 {
                *source = TexelSource::NONE;
            }
        }
        let pose = RigidTransform::identity();
        let view = render_textured(
            &mesh,
            &layout,
            &texture,
            &camera(),
            &pose,
            &RenderParams::default(),
        )
        .unwrap();
        for (index, &is_seen) in view.mask.iter().enumerate() {
            let (x, y) = (index % 64, index / 64);
            let is_inside = (8..56).contains(&x) && (1..47).contains(&y);
            if is_inside && x != 31 && x != 32 {
                assert_eq!(is_seen, x > 32, "column {x}, row {y}");
            }
        }
    }

    #[test]
    fn a_layout_without_pages_shows_nothing() {
        let (mesh, layout, _) = square(0.0);
        let view = render_textured(
            &mesh,
            &layout,
            &AtlasTexture::default(),
            &camera(),
            &RigidTransform::identity(),
            &RenderParams::default(),
        )
        .unwrap();
        assert!(view.mask.iter().all(|seen| !seen));
    }
}
