//! A view of a textured mesh that was made elsewhere, drawn as [`super::render_textured`] draws
//! ours: same raster, same bilinear lookup in sRGB, same supersampling.

use crate::geom::color::{linear_from_srgb, srgb_from_linear};
use crate::geom::{ColorImage, ImageError, PinholeCamera, RigidTransform};
use crate::mesh::{Material, TexturedModel, TriangleId, Wrap};

use super::textured::{RenderParams, RenderedView, interpolate, render_surface, round_byte};

/// Renders `model`; what has neither image nor colour is not in the mask, and still hides what is
/// behind it.
///
/// # Errors
/// [`ImageError::Size`] when the supersampled view is too large.
pub fn render_model(
    model: &TexturedModel,
    camera: &PinholeCamera,
    camera_from_world: &RigidTransform,
    params: &RenderParams,
) -> Result<RenderedView, ImageError> {
    let surface = |triangle: TriangleId, weights: [f64; 3]| color_at(model, triangle, weights);
    render_surface(model.mesh(), &surface, camera, camera_from_world, params)
}

/// sRGB in 0–255 at a point of a triangle.
fn color_at(model: &TexturedModel, triangle: TriangleId, weights: [f64; 3]) -> Option<[f32; 3]> {
    let material = model.material_of(triangle.index());
    let srgb = match (&material.image, model.vertex_srgb()) {
        (Some(image), _) => {
            let uv = interpolate(model.corners_uv(triangle.index()), weights);
            sample(image, uv, material.wrap)?
        }
        (None, Some(colors)) => {
            let corners = model.mesh().triangles()[triangle.index()];
            let corner_srgb = corners.map(|v| colors[v as usize].map(f64::from));
            std::array::from_fn(|c| {
                let sum: f64 = (0..3).map(|i| weights[i] * corner_srgb[i][c]).sum();
                #[expect(clippy::cast_possible_truncation, reason = "rounding to f32 is meant")]
                let value = sum as f32;
                value
            })
        }
        (None, None) => [255.0; 3],
    };
    Some(multiplied(srgb, material))
}

fn multiplied(srgb: [f32; 3], material: &Material) -> [f32; 3] {
    if material.factor == [1.0; 3] {
        return srgb;
    }
    std::array::from_fn(|c| {
        let linear = linear_from_srgb(round_byte(srgb[c])) * material.factor[c];
        f32::from(srgb_from_linear(linear))
    })
}

/// Bilinear lookup; nothing where the coordinates are not finite.
fn sample(image: &ColorImage, uv: [f32; 2], wrap: [Wrap; 2]) -> Option<[f32; 3]> {
    if !uv.iter().all(|c| c.is_finite()) {
        return None;
    }
    let (columns, fx) = neighbours(uv[0], image.width(), wrap[0]);
    let (rows, fy) = neighbours(uv[1], image.height(), wrap[1]);
    let texel = |i: usize, j: usize| image.pixel_clamped(columns[i], rows[j]).map(f32::from);
    let [p00, p10, p01, p11] = [texel(0, 0), texel(1, 0), texel(0, 1), texel(1, 1)];
    Some(std::array::from_fn(|c| {
        (1.0 - fy) * ((1.0 - fx) * p00[c] + fx * p10[c]) + fy * ((1.0 - fx) * p01[c] + fx * p11[c])
    }))
}

/// The two texels around a coordinate, and how far it is from the first to the second.
#[expect(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "wrapped into the image; floats outside i64 saturate"
)]
fn neighbours(coordinate: f32, size: u32, wrap: Wrap) -> ([u32; 2], f32) {
    let at = f64::from(coordinate) * f64::from(size) - 0.5;
    let first = at.floor();
    let fraction = (at - first) as f32;
    let size = i64::from(size);
    let wrapped = |index: i64| -> u32 {
        let inside = match wrap {
            Wrap::Repeat => index.rem_euclid(size),
            Wrap::Clamp => index.clamp(0, size - 1),
            Wrap::Mirror => {
                let at = index.rem_euclid(2 * size);
                at.min(2 * size - 1 - at)
            }
        };
        inside as u32
    };
    let first = first as i64;
    ([wrapped(first), wrapped(first.saturating_add(1))], fraction)
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use nalgebra::Point3;

    use super::*;
    use crate::mesh::ModelParts;

    fn image() -> ColorImage {
        let pixels = (0..16).map(|i| [(i % 4) as u8 * 60, (i / 4) as u8 * 60, 9]);
        ColorImage::new(4, 4, pixels.collect()).unwrap()
    }

    #[test]
    fn coordinates_go_on_as_the_wrap_says() {
        let red = |u: f32, wrap| sample(&image(), [u, 0.125], [wrap; 2]).unwrap()[0];
        // The middle of the second texel, in all three and their periods.
        for (u, wrap) in [
            (0.375, Wrap::Clamp),
            (1.375, Wrap::Repeat),
            (-0.625, Wrap::Repeat),
            (-0.375, Wrap::Mirror),
            (1.625, Wrap::Mirror),
        ] {
            assert!((red(u, wrap) - 60.0).abs() < 1e-3, "{u} {wrap:?}");
        }
        assert_eq!(red(7.0, Wrap::Clamp), 180.0);
        assert_eq!(red(-7.0, Wrap::Clamp), 0.0);
        // Between the last texel and the first.
        assert!((red(0.0, Wrap::Repeat) - 90.0).abs() < 1e-3);
        assert_eq!(sample(&image(), [f32::NAN, 0.0], [Wrap::Repeat; 2]), None);
    }

    fn render(change: impl Fn(&mut ModelParts)) -> RenderedView {
        let corners = [[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]];
        let uv = |v: u32| corners[v as usize].map(|c| (c as f32 + 1.0) / 2.0);
        let triangles = vec![[0, 1, 2], [0, 2, 3]];
        let mut parts = ModelParts {
            positions_m: corners.map(|[x, y]| Point3::new(x, y, 2.0)).to_vec(),
            corners_uv: triangles.iter().map(|t: &[u32; 3]| t.map(uv)).collect(),
            triangles,
            materials_of_triangles: vec![0, 0],
            materials: vec![Material {
                image: Some(Arc::new(image())),
                ..Material::default()
            }],
            vertex_srgb: Vec::new(),
        };
        change(&mut parts);
        let model = TexturedModel::new(parts).unwrap();
        // A pixel is an eighth of a metre; the square covers 16×16 of them.
        let camera = PinholeCamera::new([16.0, 16.0, 11.5, 11.5], 24, 24).unwrap();
        let params = RenderParams { supersampling: 1 };
        render_model(&model, &camera, &RigidTransform::identity(), &params).unwrap()
    }

    #[test]
    fn the_picture_is_the_image_or_the_colours() {
        let view = render(|_| {});
        assert_eq!(view.mask.iter().filter(|&&m| m).count(), 256);
        // Four pixels to a texel: away from its border the pixel has its colour nearly.
        assert_eq!(view.color.pixel_clamped(4 + 2, 4 + 6)[2], 9);
        let [r, g, _] = view.color.pixel_clamped(4 + 9, 4 + 6);
        assert!(r.abs_diff(113) <= 1 && g.abs_diff(68) <= 1, "{r} {g}");

        let plain = render(|parts| {
            parts.materials[0].image = None;
            parts.materials[0].factor = [1.0, 0.0, 0.21586];
        });
        assert_eq!(plain.color.pixel_clamped(12, 12), [255, 0, 128]);
        let by_vertex = render(|parts| {
            parts.materials[0].image = None;
            parts.vertex_srgb = vec![[40, 80, 120]; 4];
        });
        assert_eq!(by_vertex.color.pixel_clamped(12, 12), [40, 80, 120]);
        let half = render(|parts| parts.corners_uv[0] = [[f32::NAN; 2]; 3]);
        let num_seen = half.mask.iter().filter(|&&m| m).count();
        assert!((100..156).contains(&num_seen), "{num_seen}");
    }
}
