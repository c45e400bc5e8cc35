//! A view of the mesh, crop by crop: which texels each pixel shows, and where its surface is.
//!
//! The triangle of each pixel is found once per view and mesh by the z-buffer ([`crate::render`]).
//! Everything else — barycentrics, position on the page, point in space — is worked out for the
//! pixels of a crop when they are wanted: four bytes a pixel are kept of a view instead of twenty.
//!
//! An offset d between photo and rendering (see [`super::align`]) is taken out here: pixel z of the
//! photo shows what the mesh shows at z − d, so that the ray through z − d gives its texels. That
//! holds for parts of a pixel, and no photo is resampled for it.

use nalgebra::{Matrix3, Point3, Vector3};
use rayon::prelude::*;

use super::texels::{Footprint, Texels};
use crate::atlas::{AtlasLayout, AtlasTexture};
use crate::geom::{PinholeCamera, RigidTransform};
use crate::mesh::{TriMesh, TriangleId};
use crate::render::raster::{NO_TRIANGLE, barycentric};
use crate::render::textured::inside;

/// What is textured, and where.
#[derive(Clone, Copy)]
pub(super) struct Surface<'a> {
    pub(super) mesh: &'a TriMesh,
    pub(super) layout: &'a AtlasLayout,
    /// As it was before the steps that are not written back yet.
    pub(super) texture: &'a AtlasTexture,
    /// Per chart, whether it may change; `None` where all may.
    pub(super) may_change: Option<&'a [bool]>,
}

impl Surface<'_> {
    /// Whether what shows this triangle is no reason for a change.
    fn is_fixed(&self, triangle: TriangleId) -> bool {
        self.may_change.is_some_and(|may_change| {
            let chart = self.layout.chart_of_triangle.get(triangle.index());
            let may = chart.and_then(|chart| may_change.get(chart.index()));
            !may.copied().unwrap_or(false)
        })
    }
}

/// A photo's camera, and the triangle at each of its pixels.
pub(super) struct View {
    /// Of the undistorted photo.
    pub(super) camera: PinholeCamera,
    pub(super) camera_from_world: RigidTransform,
    /// Per pixel, row-major: index of the triangle, or [`NO_TRIANGLE`].
    pub(super) triangle: Vec<u32>,
    /// Per row: pixels that show a chart that may change; empty where all charts may.
    pub(super) num_changing_in_row: Vec<u32>,
}

/// A rectangle of whole pixels.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct PixelRect {
    pub(super) x: usize,
    pub(super) y: usize,
    pub(super) width: usize,
    pub(super) height: usize,
}

impl PixelRect {
    pub(super) fn num_pixels(&self) -> usize {
        self.width * self.height
    }
}

/// What the pixels of a crop show, row-major.
pub(super) struct CropSurface {
    /// Which texels; none where the mesh is not seen or not painted.
    pub(super) footprint: Vec<Footprint>,
    /// Where, in the view's camera, metres; NaN where the mesh is not seen.
    pub(super) point_in_camera: Vec<[f32; 3]>,
    /// Texels that a pixel covers in the direction in which it covers most; 0 where the mesh is not
    /// seen.
    pub(super) texels_per_px: Vec<f32>,
    /// Whether it is no reason for a change: it shows a chart that must stay, or none. Empty where all
    /// charts may change.
    pub(super) is_fixed: Vec<bool>,
}

impl CropSurface {
    /// Whether the pixel shows texels that may change.
    pub(super) fn may_change(&self, pixel: usize) -> bool {
        self.footprint[pixel].is_some() && self.is_fixed.get(pixel) != Some(&true)
    }
}

/// What one pixel shows.
struct PixelSurface {
    footprint: Footprint,
    point_in_camera: [f32; 3],
    texels_per_px: f32,
    is_fixed: bool,
}

impl PixelSurface {
    const NONE: Self = Self {
        footprint: Footprint::NONE,
        point_in_camera: [f32::NAN; 3],
        texels_per_px: 0.0,
        is_fixed: true,
    };
}

impl View {
    pub(super) fn new(
        on: Surface<'_>,
        camera: PinholeCamera,
        camera_from_world: RigidTransform,
        triangle: Vec<u32>,
    ) -> Self {
        let num_changing_in_row = match on.may_change {
            None => Vec::new(),
            Some(_) => triangle
                .par_chunks(camera.width() as usize)
                .map(|row| {
                    let changing = row
                        .iter()
                        .filter(|id| **id != NO_TRIANGLE && !on.is_fixed(TriangleId(**id)));
                    u32::try_from(changing.count()).unwrap_or(u32::MAX)
                })
                .collect(),
        };
        Self {
            camera,
            camera_from_world,
            triangle,
            num_changing_in_row,
        }
    }

    /// How many pixels show a chart that may change; for views of some charts.
    pub(super) fn num_changing(&self) -> usize {
        let rows = self.num_changing_in_row.iter();
        rows.map(|&num| num as usize).sum()
    }

    /// Column and row of one of these pixels, numbered row by row.
    pub(super) fn changing(&self, on: Surface<'_>, mut number: usize) -> Option<[usize; 2]> {
        let width = self.camera.width() as usize;
        for (y, &num) in self.num_changing_in_row.iter().enumerate() {
            let num = num as usize;
            if number < num {
                let row = self.triangle.get(y * width..(y + 1) * width)?;
                let mut columns = row
                    .iter()
                    .enumerate()
                    .filter(|(_, id)| **id != NO_TRIANGLE && !on.is_fixed(TriangleId(**id)));
                return columns.nth(number).map(|(x, _)| [x, y]);
            }
            number -= num;
        }
        None
    }

    pub(super) fn num_bytes(&self) -> usize {
        size_of_val(&*self.triangle) + size_of_val(&*self.num_changing_in_row)
    }

    fn triangle_at(&self, [x, y]: [f64; 2]) -> Option<TriangleId> {
        let (width, height) = (self.camera.width(), self.camera.height());
        let (x, y) = (x.round(), y.round());
        if !(x >= 0.0 && y >= 0.0 && x < f64::from(width) && y < f64::from(height)) {
            return None;
        }
        #[expect(
            clippy::cast_possible_truncation,
            clippy::cast_sign_loss,
            reason = "within the image"
        )]
        let index = y as usize * width as usize + x as usize;
        let triangle = *self.triangle.get(index)?;
        (triangle != NO_TRIANGLE).then_some(TriangleId(triangle))
    }

    /// The surface at pixels `rect.x + stride · i` (and so on), seen through `offset_px`.
    pub(super) fn surface(
        &self,
        on: Surface<'_>,
        texels: &Texels,
        rect: PixelRect,
        stride: usize,
        offset_px: [f32; 2],
    ) -> CropSurface {
        let rows: Vec<Vec<PixelSurface>> = (0..rect.height)
            .into_par_iter()
            .map(|row| {
                let mut triangle = NearTriangle::default();
                (0..rect.width)
                    .map(|column| {
                        // The middle of a block of `stride` pixels.
                        let middle = 0.5 * (stride - 1) as f64;
                        let at = [rect.x + stride * column, rect.y + stride * row];
                        let z = [at[0] as f64 + middle, at[1] as f64 + middle];
                        let x = [0, 1].map(|axis| z[axis] - f64::from(offset_px[axis]));
                        self.at(on, texels, &mut triangle, x)
                            .unwrap_or(PixelSurface::NONE)
                    })
                    .collect()
            })
            .collect();
        let mut footprint = Vec::with_capacity(rect.num_pixels());
        let mut point_in_camera = Vec::with_capacity(rect.num_pixels());
        let mut texels_per_px = Vec::with_capacity(rect.num_pixels());
        let mut is_fixed = Vec::new();
        for pixel in rows.into_iter().flatten() {
            footprint.push(pixel.footprint);
            point_in_camera.push(pixel.point_in_camera);
            texels_per_px.push(pixel.texels_per_px);
            if on.may_change.is_some() {
                is_fixed.push(pixel.is_fixed);
            }
        }
        CropSurface {
            footprint,
            point_in_camera,
            texels_per_px,
            is_fixed,
        }
    }

    fn at(
        &self,
        on: Surface<'_>,
        texels: &Texels,
        near: &mut NearTriangle,
        x_px: [f64; 2],
    ) -> Option<PixelSurface> {
        let triangle = self.triangle_at(x_px)?;
        let place = on.layout.corners_texel.get(triangle.index())?;
        let page = on.layout.page_of(triangle) as usize;
        let PlacedTriangle {
            corners,
            normal,
            texels_per_m,
            ..
        } = near.of(self, on.mesh, triangle, place);
        let ray = self.camera.ray(x_px[0], x_px[1]);
        let weights = inside(barycentric(corners, &ray).unwrap_or([1.0 / 3.0; 3]));
        #[expect(clippy::cast_possible_truncation, reason = "rounding to f32 is meant")]
        let position_texel: [f32; 2] = std::array::from_fn(|axis| {
            let terms: [f64; 3] = std::array::from_fn(|i| weights[i] * f64::from(place[i][axis]));
            (terms[0] + terms[1] + terms[2]) as f32
        });
        let point_m: [f64; 3] = std::array::from_fn(|axis| {
            let terms: [f64; 3] = std::array::from_fn(|i| weights[i] * corners[i][axis]);
            terms[0] + terms[1] + terms[2]
        });
        // A pixel is z/f wide across the ray, and longer along the slope of the surface.
        let cosine = normal.dot(&ray.normalize()).abs().max(1e-3);
        let px_m = point_m[2] / self.camera.intrinsics_px()[0] / cosine;
        #[expect(clippy::cast_possible_truncation, reason = "rounding to f32 is meant")]
        Some(PixelSurface {
            footprint: texels.footprint(on.texture, page, position_texel),
            point_in_camera: point_m.map(|value| value as f32),
            texels_per_px: (px_m * texels_per_m) as f32,
            is_fixed: on.is_fixed(triangle),
        })
    }

    /// Depth along z of the mesh at a pixel, metres.
    fn depth_m(&self, mesh: &TriMesh, pixel: [f64; 2]) -> Option<f64> {
        let triangle = self.triangle_at(pixel)?;
        let corners = self.corners_in_camera(mesh, triangle);
        let ray = self.camera.ray(pixel[0], pixel[1]);
        let weights = inside(barycentric(&corners, &ray)?);
        Some((0..3).map(|i| weights[i] * corners[i].z).sum())
    }

    fn corners_in_camera(&self, mesh: &TriMesh, triangle: TriangleId) -> [Point3<f64>; 3] {
        mesh.corners_m(triangle)
            .map(|corner| self.camera_from_world.transform_point(&corner))
    }

    /// Where pixels of another view's crop are in this photo: positions in pixels, or none where this
    /// view does not see the same surface, by the depth of the mesh at the four pixels around.
    pub(super) fn project_from(
        &self,
        other: &Self,
        mesh: &TriMesh,
        points_in_other: &[[f32; 3]],
        max_depth_difference_m: f32,
    ) -> Vec<Option<[f32; 2]>> {
        let other_from_world = other.camera_from_world.inverse();
        let rotation: Matrix3<f64> = (self.camera_from_world.rotation()
            * other_from_world.rotation())
        .to_rotation_matrix()
        .into_inner();
        let origin = self
            .camera_from_world
            .transform_point(&Point3::from(*other_from_world.translation()));
        let tolerance_m = f64::from(max_depth_difference_m);
        points_in_other
            .par_iter()
            .map(|point| {
                if point[0].is_nan() {
                    return None;
                }
                let point = origin + rotation * Vector3::from(point.map(f64::from));
                let [x, y] = self.camera.project(&point)?;
                let (max_x, max_y) = (
                    f64::from(self.camera.width()) - 1.0,
                    f64::from(self.camera.height()) - 1.0,
                );
                if !(x >= 0.0 && y >= 0.0 && x <= max_x && y <= max_y) {
                    return None;
                }
                let (x0, y0) = (x.floor(), y.floor());
                let is_same_surface = (0..4).any(|corner| {
                    let pixel = [x0 + f64::from(corner % 2), y0 + f64::from(corner / 2)];
                    self.depth_m(mesh, pixel)
                        .is_some_and(|depth_m| (depth_m - point.z).abs() <= tolerance_m)
                });
                #[expect(clippy::cast_possible_truncation, reason = "rounding to f32 is meant")]
                let position = [x as f32, y as f32];
                is_same_surface.then_some(position)
            })
            .collect()
    }
}

/// A triangle before the camera and on its page.
#[derive(Clone, Copy)]
struct PlacedTriangle {
    id: TriangleId,
    /// In the camera, metres.
    corners: [Point3<f64>; 3],
    /// Of length one, in the camera; zero for a triangle without area.
    normal: Vector3<f64>,
    /// By the two areas: charts are nearly conformal, so that it is the same in all directions.
    texels_per_m: f64,
}

/// The triangle asked for last: neighbours along a row mostly share it.
#[derive(Default)]
struct NearTriangle {
    known: Option<PlacedTriangle>,
}

impl NearTriangle {
    fn of(
        &mut self,
        view: &View,
        mesh: &TriMesh,
        id: TriangleId,
        place: &[[f32; 2]; 3],
    ) -> &PlacedTriangle {
        let placed = self.known.filter(|known| known.id == id);
        let placed = placed.unwrap_or_else(|| {
            let corners = view.corners_in_camera(mesh, id);
            let across = (corners[1] - corners[0]).cross(&(corners[2] - corners[0]));
            let [a, b, c] = place.map(|corner| corner.map(f64::from));
            let area_texel = (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0]);
            PlacedTriangle {
                id,
                corners,
                normal: across.try_normalize(0.0).unwrap_or_default(),
                texels_per_m: (area_texel.abs() / across.norm().max(f64::MIN_POSITIVE)).sqrt(),
            }
        });
        self.known.insert(placed)
    }
}

#[cfg(test)]
mod tests;
