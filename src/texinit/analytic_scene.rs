//! Scenes for tests whose every colour and depth is known: panels facing the camera, painted by a
//! function of the point, photographed by an independent ray caster.

#![expect(
    clippy::cast_possible_truncation,
    reason = "the numbers of a test are small"
)]

use std::sync::Arc;

use nalgebra::{Point3, UnitQuaternion, Vector3};

use crate::atlas::{AtlasLayout, ChartId, PlacedChart, TexelRect};
use crate::geom::{ColorImage, DepthImage, PinholeCamera, RigidTransform};
use crate::keyframe::{DecodedDepth, DecodedFrame, FrameQuality};
use crate::mesh::TriMesh;

use super::assign::FramePose;

/// An axis-aligned rectangle at one z.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Panel {
    pub(crate) min: [f64; 2],
    pub(crate) max: [f64; 2],
    pub(crate) z: f64,
    /// Quads along x and y.
    pub(crate) cells: [u32; 2],
    pub(crate) paint: fn(f64, f64) -> [f64; 3],
}

impl Panel {
    /// Whether it cuts the segment, and at which share of it.
    pub(crate) fn cut(&self, from: &Point3<f64>, to: &Point3<f64>) -> Option<f64> {
        let t = (self.z - from.z) / (to.z - from.z);
        let hit = from + (to - from) * t;
        let inside = (0..2).all(|axis| hit[axis] >= self.min[axis] && hit[axis] <= self.max[axis]);
        (inside && t > 0.0).then_some(t)
    }
}

#[derive(Clone, Debug, Default)]
pub(crate) struct Scene {
    pub(crate) panels: Vec<Panel>,
    pub(crate) poses: Vec<FramePose>,
    pub(crate) frames: Vec<Arc<DecodedFrame>>,
}

pub(crate) fn camera() -> PinholeCamera {
    PinholeCamera::new([150.0, 150.0, 79.5, 59.5], 160, 120).unwrap()
}

/// Smooth colours in sRGB bytes' scale, different everywhere.
pub(crate) fn waves(x: f64, y: f64) -> [f64; 3] {
    [
        128.0 + 50.0 * (4.0 * x).sin() + 40.0 * (5.0 * y).cos(),
        120.0 + 60.0 * (3.0 * x - 4.0 * y).sin(),
        90.0 + 30.0 * x + 20.0 * y,
    ]
}

pub(crate) fn grey(_: f64, _: f64) -> [f64; 3] {
    [120.0; 3]
}

pub(crate) fn red(_: f64, _: f64) -> [f64; 3] {
    [250.0, 0.0, 0.0]
}

impl Scene {
    pub(crate) fn mesh(&self) -> TriMesh {
        let mut positions = vec![];
        let mut triangles = vec![];
        for panel in &self.panels {
            let first = positions.len() as u32;
            let [columns, rows] = panel.cells;
            for j in 0..=rows {
                for i in 0..=columns {
                    let at = |axis: usize, share: f64| {
                        panel.min[axis] + (panel.max[axis] - panel.min[axis]) * share
                    };
                    let x = at(0, f64::from(i) / f64::from(columns));
                    let y = at(1, f64::from(j) / f64::from(rows));
                    positions.push(Point3::new(x, y, panel.z));
                }
            }
            for j in 0..rows {
                for i in 0..columns {
                    let a = first + j * (columns + 1) + i;
                    let (b, c, d) = (a + 1, a + columns + 1, a + columns + 2);
                    // Seen from −z, which is where the cameras are.
                    triangles.push([a, c, b]);
                    triangles.push([b, c, d]);
                }
            }
        }
        TriMesh::from_soup(positions, triangles).unwrap().0
    }

    /// Photographs the panels and `extra` ones that the mesh does not have.
    pub(crate) fn photograph(
        &mut self,
        position: [f64; 3],
        yaw_rad: f64,
        extra: &[Panel],
        has_depth: bool,
    ) {
        let world_from_camera = RigidTransform::from_parts(
            UnitQuaternion::from_axis_angle(&Vector3::y_axis(), yaw_rad),
            Vector3::from(position),
        );
        let camera = camera();
        let origin = Point3::from(position);
        let (mut pixels, mut depths) = (vec![], vec![]);
        for y in 0..camera.height() {
            for x in 0..camera.width() {
                let ray =
                    world_from_camera.transform_vector(&camera.ray(f64::from(x), f64::from(y)));
                let target = origin + ray;
                let hit = self
                    .panels
                    .iter()
                    .chain(extra)
                    .filter_map(|panel| Some((panel.cut(&origin, &target)?, panel)))
                    .min_by(|a, b| a.0.total_cmp(&b.0));
                let color = hit.map_or([0.0; 3], |(t, panel)| {
                    let point = origin + ray * t;
                    (panel.paint)(point.x, point.y)
                });
                pixels.push(color.map(|value| value.round() as u8));
                // The ray has z = 1 in the camera, so its share is the depth.
                depths.push(hit.map_or(0.0, |(t, _)| t as f32));
            }
        }
        let depth = has_depth.then(|| DecodedDepth {
            image: DepthImage::new(camera.width(), camera.height(), depths).unwrap(),
            camera,
            depth_from_color: RigidTransform::identity(),
        });
        let id = 100 + self.poses.len() as u32;
        self.poses.push(FramePose {
            id,
            world_from_camera,
            quality: FrameQuality::default(),
        });
        self.frames.push(Arc::new(DecodedFrame {
            color: ColorImage::new(camera.width(), camera.height(), pixels).unwrap(),
            color_camera: camera,
            depth,
        }));
    }

    /// Each panel is one chart, laid out side by side on one page.
    pub(crate) fn layout(&self, texels_per_m: f64) -> AtlasLayout {
        let mesh = self.mesh();
        let (mut charts, mut chart_of_triangle, mut corners_texel) = (vec![], vec![], vec![]);
        let mut x = 2.0;
        let mut height = 0.0f64;
        let mut next = mesh.triangle_ids();
        for (index, panel) in self.panels.iter().enumerate() {
            let size = [0, 1].map(|axis| (panel.max[axis] - panel.min[axis]) * texels_per_m);
            let count = panel.cells[0] as usize * panel.cells[1] as usize * 2;
            let triangles: Vec<_> = next.by_ref().take(count).collect();
            for &triangle in &triangles {
                chart_of_triangle.push(ChartId(index as u32));
                corners_texel.push(mesh.corners_m(triangle).map(|p| {
                    [
                        (x + (p.x - panel.min[0]) * texels_per_m) as f32,
                        (2.0 + (p.y - panel.min[1]) * texels_per_m) as f32,
                    ]
                }));
            }
            charts.push(PlacedChart::whole_rect(
                0,
                TexelRect {
                    x: x as u32,
                    y: 0,
                    width: size[0] as u32 + 4,
                    height: size[1] as u32 + 4,
                },
                texels_per_m,
                triangles,
            ));
            x += size[0].ceil() + 4.0;
            height = height.max(size[1]);
        }
        AtlasLayout {
            page_size_texel: [x as u32 + 2, height as u32 + 6],
            num_pages: 1,
            texels_per_m,
            charts,
            chart_of_triangle,
            corners_texel,
        }
    }
}
