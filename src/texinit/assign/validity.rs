//! Which triangles a frame may paint: inside the image, in front of the camera, not hidden.

use nalgebra::{Point3, Vector3};

use crate::geom::{ColorImage, PinholeCamera, RigidTransform};
use crate::keyframe::{DecodedDepth, DecodedFrame};
use crate::mesh::TriMesh;
use crate::render::visibility::depth_slope_m;
use crate::render::{MeshPart, SurfacePoint, VisibilityBuffer};

use super::{AssignParams, DepthCue};

/// Triangles that cover more pixels of the visibility buffer than this are probed inside too.
const PROBE_AREA_PX2: f64 = 64.0;
/// Probes are about this far apart, pixels of the visibility buffer.
const PROBE_SPACING_PX: f64 = 6.0;
/// Rows of probes in a triangle, at most.
const MAX_PROBE_ROWS: u32 = 16;

/// A vertex as a frame sees it.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct VertexView {
    pub(crate) point_in_camera: Point3<f64>,
    /// Pixel of the colour image; only meaningful when `is_inside`.
    pub(crate) position_px: [f64; 2],
    /// Whether it lies in the image, off the border and in front of the camera.
    pub(crate) is_inside: bool,
    /// Colour of the nearest pixel.
    pub(crate) srgb: [u8; 3],
    /// |measured − predicted| distance, metres; infinite where nothing was measured; `None` until
    /// a triangle at the vertex needs it.
    pub(crate) depth_difference_m: Option<f32>,
}

impl VertexView {
    /// |measured − predicted| distance, looked up once.
    pub(crate) fn depth_difference_m(
        &mut self,
        depth: Option<&DepthProbe<'_>>,
        cue: DepthCue,
    ) -> f32 {
        *self
            .depth_difference_m
            .get_or_insert_with(|| depth_difference_m(depth, &self.point_in_camera, cue))
    }
}

/// Looks at the vertices of a part of the mesh through the frame.
pub(crate) fn view_vertices(
    mesh: &TriMesh,
    part: &MeshPart,
    camera_from_world: &RigidTransform,
    frame: &DecodedFrame,
    params: &AssignParams,
    out: &mut Vec<VertexView>,
) {
    let camera = &frame.color_camera;
    let rotation = camera_from_world.rotation().to_rotation_matrix();
    let translation = camera_from_world.translation();
    let border_px = f64::from(params.border_margin) * f64::from(camera.width());
    let far_m = params.far_m();
    part.map_vertices(mesh, out, |position| {
        let point_in_camera = Point3::from(rotation * position.coords + translation);
        let mut view = VertexView {
            point_in_camera,
            ..VertexView::default()
        };
        let Some(position_px) = camera
            .project(&point_in_camera)
            .filter(|px| point_in_camera.z <= far_m && is_inside(camera, *px, border_px))
        else {
            return view;
        };
        view.is_inside = true;
        view.position_px = position_px;
        view.srgb = nearest_pixel(&frame.color, position_px);
        view
    });
}

fn is_inside(camera: &PinholeCamera, [x_px, y_px]: [f64; 2], border_px: f64) -> bool {
    camera.contains([x_px - border_px, y_px - border_px])
        && camera.contains([x_px + border_px, y_px + border_px])
}

#[expect(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "float to int casts saturate, and the lookup is clamped"
)]
fn nearest_pixel(image: &ColorImage, [x_px, y_px]: [f64; 2]) -> [u8; 3] {
    image.pixel_clamped((x_px + 0.5) as u32, (y_px + 0.5) as u32)
}

/// The depth image of a frame, for points in the colour camera.
pub(crate) struct DepthProbe<'a> {
    depth: &'a DecodedDepth,
    is_registered: bool,
}

impl<'a> DepthProbe<'a> {
    pub(crate) fn new(depth: &'a DecodedDepth) -> Self {
        Self {
            depth,
            is_registered: depth.depth_from_color == RigidTransform::identity(),
        }
    }
}

/// |measured − predicted| distance from the depth camera, or depth along its axis, in metres: 0
/// without a depth image, infinite where the depth image measured nothing or does not reach.
#[expect(clippy::cast_possible_truncation, reason = "rounding to f32 is meant")]
pub(crate) fn depth_difference_m(
    depth: Option<&DepthProbe<'_>>,
    point_in_color: &Point3<f64>,
    cue: DepthCue,
) -> f32 {
    let Some(DepthProbe {
        depth,
        is_registered,
    }) = depth
    else {
        return 0.0;
    };
    let point = if *is_registered {
        *point_in_color
    } else {
        depth.depth_from_color.transform_point(point_in_color)
    };
    let measured_m = depth
        .camera
        .project(&point)
        .and_then(|px| depth.image.nearest(px))
        .map(f64::from)
        .filter(|&measured_m| measured_m >= 1e-3);
    measured_m.map_or(f32::INFINITY, |measured_m| match cue {
        DepthCue::LargestRange => {
            let measured_range_m = Vector3::new(point.x, point.y, measured_m).norm();
            (point.coords.norm() - measured_range_m).abs() as f32
        }
        DepthCue::DepthSum => (point.z - measured_m).abs() as f32,
    })
}

/// A triangle as a frame sees it, whole and inside the image.
#[derive(Clone, Copy, Debug)]
pub(crate) struct TriangleView {
    pub(crate) corners: [VertexView; 3],
    pub(crate) centroid_in_camera: Point3<f64>,
    /// Projected area in px² of the colour image.
    pub(crate) area_px2: f64,
    /// Sine of the angle between the view ray and the surface, positive when seen from the front.
    pub(crate) sin_elevation: f64,
    /// Change of depth per pixel, metres.
    pub(crate) slope_m: f64,
}

impl TriangleView {
    /// `None` unless all three vertices are inside.
    pub(crate) fn new(corners: [VertexView; 3], camera: &PinholeCamera) -> Option<Self> {
        if !corners.iter().all(|corner| corner.is_inside) {
            return None;
        }
        let [a, b, c] = corners.map(|corner| corner.point_in_camera);
        let [p, q, r] = corners.map(|corner| corner.position_px);
        let area_px2 = 0.5 * ((q[0] - p[0]) * (r[1] - p[1]) - (q[1] - p[1]) * (r[0] - p[0])).abs();
        let normal = (b - a).cross(&(c - a));
        let centroid_in_camera = Point3::from((a.coords + b.coords + c.coords) / 3.0);
        let sin_elevation = -normal.dot(&centroid_in_camera.coords)
            / (normal.norm() * centroid_in_camera.coords.norm());
        Some(Self {
            corners,
            centroid_in_camera,
            area_px2,
            sin_elevation: if sin_elevation.is_finite() {
                sin_elevation
            } else {
                0.0
            },
            slope_m: depth_slope_m(camera, &centroid_in_camera, &normal),
        })
    }

    fn surface_point(&self, camera: &PinholeCamera, weights: [f64; 3]) -> Option<SurfacePoint> {
        let [a, b, c] = self.corners.map(|corner| corner.point_in_camera.coords);
        let point = Point3::from(a * weights[0] + b * weights[1] + c * weights[2]);
        Some(SurfacePoint {
            position_px: camera.project(&point)?,
            depth_m: point.z,
            slope_m: self.slope_m,
        })
    }

    /// How the mesh itself hides the triangle, or `None` when it does.
    pub(crate) fn visibility(
        &self,
        camera: &PinholeCamera,
        buffer: &VisibilityBuffer,
    ) -> Option<TriangleVisibility> {
        let corners = self.corners.map(|corner| SurfacePoint {
            position_px: corner.position_px,
            depth_m: corner.point_in_camera.z,
            slope_m: self.slope_m,
        });
        let centroid = self.surface_point(camera, [1.0 / 3.0; 3])?;
        let buffer_area_px2 = self.area_px2 * buffer.area_scale();
        let hidden_share = if buffer_area_px2 > PROBE_AREA_PX2 {
            self.hidden_share(camera, buffer, buffer_area_px2)
        } else if corners
            .iter()
            .chain([&centroid])
            .all(|p| buffer.is_visible(p))
        {
            0.0
        } else {
            1.0
        };
        let is_near_depth_edge = corners
            .iter()
            .chain([&centroid])
            .any(|p| buffer.is_near_depth_edge(p));
        (hidden_share < 0.5).then_some(TriangleVisibility {
            hidden_share,
            is_near_depth_edge,
        })
    }

    /// Share of evenly spread points of a large triangle that are hidden.
    #[expect(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "float to int casts saturate, and the value is clamped"
    )]
    fn hidden_share(
        &self,
        camera: &PinholeCamera,
        buffer: &VisibilityBuffer,
        buffer_area_px2: f64,
    ) -> f32 {
        let rows = (buffer_area_px2.sqrt() / PROBE_SPACING_PX).ceil() as u32;
        let rows = rows.clamp(2, MAX_PROBE_ROWS);
        let (mut num_hidden, mut num_probes) = (0u16, 0u16);
        for i in 0..rows {
            for j in 0..rows - i {
                let step = f64::from(rows);
                let u = (f64::from(i) + 1.0 / 3.0) / step;
                let v = (f64::from(j) + 1.0 / 3.0) / step;
                let is_visible = self
                    .surface_point(camera, [1.0 - u - v, u, v])
                    .is_some_and(|point| buffer.is_visible(&point));
                num_hidden += u16::from(!is_visible);
                num_probes += 1;
            }
        }
        f32::from(num_hidden) / f32::from(num_probes)
    }
}

/// How the mesh itself hides a triangle.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct TriangleVisibility {
    /// Hidden share of its area, below one half.
    pub(crate) hidden_share: f32,
    /// Whether its picture lies close to a step in depth.
    pub(crate) is_near_depth_edge: bool,
}
