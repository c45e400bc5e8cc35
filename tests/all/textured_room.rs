//! A furnished room whose texture is a formula: mesh, layout, painted pages and views of it, all
//! in closed form, so that whatever is made from them can be checked without the code under test.

#![expect(
    clippy::unwrap_used,
    reason = "a test fails by panicking, its helpers included"
)]
#![expect(
    clippy::cast_possible_truncation,
    reason = "a room of a few metres, colours below 256"
)]

use nalgebra::{Point3, Vector3};
use veneer::atlas::{
    AtlasLayout, AtlasTexture, ChartId, PlacedChart, TexelRect, TexelSource, TexturePage,
};
use veneer::geom::{ColorImage, PinholeCamera, RigidTransform};
use veneer::mesh::{TriMesh, TriangleId};

/// Texels per metre.
pub(crate) const DENSITY: f64 = 200.0;
/// Width and height of the two pages in texels.
pub(crate) const PAGE: [u32; 2] = [2048, 1024];
const GUTTER: u32 = 4;
const CELL_M: f64 = 0.1;

/// A rectangle in space: `origin + s·along + t·up` for s in 0..size[0], t in 0..size[1] metres.
struct Panel {
    origin: Point3<f64>,
    along: Vector3<f64>,
    up: Vector3<f64>,
    size: [f64; 2],
    page: u32,
    at_texel: [u32; 2],
}

/// The room and everything painted on it.
pub(crate) struct Room {
    panels: Vec<Panel>,
    /// Per panel and cell (row by row from t = 0): the first of its two triangles.
    first_triangle: Vec<Vec<u32>>,
    pub(crate) mesh: TriMesh,
    pub(crate) layout: AtlasLayout,
    pub(crate) texture: AtlasTexture,
}

/// One picture of the room.
pub(crate) struct View {
    /// What a camera would have taken.
    pub(crate) photo: ColorImage,
    /// The atlas seen from there.
    pub(crate) render: ColorImage,
    /// Triangle under each pixel; `u32::MAX` where there is none.
    pub(crate) triangle: Vec<u32>,
}

impl Room {
    pub(crate) fn new() -> Self {
        let panels = panels();
        let (mesh, chart_of_triangle, corners_texel, first_triangle) = triangulate(&panels);
        let charts = (0..panels.len())
            .map(|index| {
                PlacedChart::whole_rect(
                    panels[index].page,
                    rect(&panels[index]),
                    DENSITY,
                    mesh.triangle_ids()
                        .filter(|t| chart_of_triangle[t.index()].index() == index)
                        .collect(),
                )
            })
            .collect();
        let layout = AtlasLayout {
            page_size_texel: PAGE,
            num_pages: 2,
            texels_per_m: DENSITY,
            charts,
            chart_of_triangle,
            corners_texel,
        };
        let texture = paint(&panels);
        Self {
            panels,
            first_triangle,
            mesh,
            layout,
            texture,
        }
    }

    /// The formula's colour at the middle of a triangle.
    pub(crate) fn srgb_at_centroid(&self, triangle: TriangleId) -> [u8; 3] {
        let panel_index = self.layout.chart_of_triangle[triangle.index()].index();
        let panel = &self.panels[panel_index];
        let corners = self.mesh.corners_m(triangle);
        let middle = (corners[0].coords + corners[1].coords + corners[2].coords) / 3.0;
        let offset = middle - panel.origin.coords;
        pattern(panel_index, offset.dot(&panel.along), offset.dot(&panel.up))
    }

    /// Casts a ray per pixel.
    pub(crate) fn view(&self, camera: &PinholeCamera, world_from_camera: &RigidTransform) -> View {
        let (width, height) = (camera.width(), camera.height());
        let mut photo = Vec::new();
        let mut render = Vec::new();
        let mut triangle = Vec::new();
        for y in 0..height {
            for x in 0..width {
                let ray = world_from_camera.rotation() * camera.ray(x.into(), y.into());
                let eye = world_from_camera.translation();
                let (index, s, t) = self.hit(&Point3::from(*eye), &ray);
                let vignette = 1.0 - 0.25 * (x as f64 / f64::from(width) - 0.5).powi(2);
                let grain = f64::from(hash(x, y, 99) % 9) - 4.0;
                photo.push(pattern(index, s, t).map(|c| (f64::from(c) * vignette + grain) as u8));
                let [u, v] = texel(&self.panels[index], s, t);
                let page = &self.texture.pages[self.panels[index].page as usize];
                render.push(page.srgb[v as usize * PAGE[0] as usize + u as usize]);
                triangle.push(self.triangle_at(index, s, t));
            }
        }
        for (color, id) in render.iter_mut().zip(&triangle) {
            if *id == u32::MAX {
                *color = [0; 3];
            }
        }
        View {
            photo: ColorImage::new(width, height, photo).unwrap(),
            render: ColorImage::new(width, height, render).unwrap(),
            triangle,
        }
    }

    fn hit(&self, eye: &Point3<f64>, ray: &Vector3<f64>) -> (usize, f64, f64) {
        let mut nearest = (f64::INFINITY, 0, 0.0, 0.0);
        for (index, panel) in self.panels.iter().enumerate() {
            let normal = panel.along.cross(&panel.up);
            let distance = (panel.origin - eye).dot(&normal) / ray.dot(&normal);
            let offset = eye + ray * distance - panel.origin;
            let (s, t) = (offset.dot(&panel.along), offset.dot(&panel.up));
            let inside = (0.0..panel.size[0]).contains(&s) && (0.0..panel.size[1]).contains(&t);
            if distance > 0.0 && distance < nearest.0 && inside {
                nearest = (distance, index, s, t);
            }
        }
        (nearest.1, nearest.2, nearest.3)
    }

    fn triangle_at(&self, panel: usize, s: f64, t: f64) -> u32 {
        if is_hole(panel, s, t) {
            return u32::MAX;
        }
        let panel_size = self.panels[panel].size;
        let num_columns = (panel_size[0] / CELL_M).round() as usize;
        let cell = |m: f64, size: f64| ((m / CELL_M) as usize).min((size / CELL_M) as usize - 1);
        let (i, j) = (cell(s, panel_size[0]), cell(t, panel_size[1]));
        // The cell's first triangle is the one below its rising diagonal.
        let is_upper = t - j as f64 * CELL_M > s - i as f64 * CELL_M;
        self.first_triangle[panel][j * num_columns + i] + u32::from(is_upper)
    }
}

fn panels() -> Vec<Panel> {
    let v = Vector3::new;
    let mut panels = Vec::new();
    let mut push = |origin: [f64; 3], along, up, size, page, at_texel| {
        panels.push(Panel {
            origin: Point3::from(origin),
            along,
            up,
            size,
            page,
            at_texel,
        });
    };
    let (x, y, z) = (v(1., 0., 0.), v(0., 1., 0.), v(0., 0., 1.));
    push([0., 0., 0.], x, y, [4., 3.], 0, [8, 8]);
    push([4., 0., 2.5], -x, y, [4., 3.], 0, [824, 8]);
    push([4., 0., 0.], -x, z, [4., 2.5], 1, [8, 8]);
    push([0., 3., 0.], x, z, [4., 2.5], 1, [824, 8]);
    push([0., 0., 0.], y, z, [3., 2.5], 1, [8, 516]);
    push([4., 3., 0.], -y, z, [3., 2.5], 1, [624, 516]);
    // A box on the floor.
    push([1.5, 1.2, 0.7], x, y, [1.2, 0.8], 0, [8, 616]);
    push([1.5, 1.2, 0.], x, z, [1.2, 0.7], 0, [264, 616]);
    push([2.7, 2.0, 0.], -x, z, [1.2, 0.7], 0, [520, 616]);
    push([2.7, 1.2, 0.], y, z, [0.8, 0.7], 0, [776, 616]);
    push([1.5, 2.0, 0.], -y, z, [0.8, 0.7], 0, [952, 616]);
    panels
}

fn texel(panel: &Panel, s: f64, t: f64) -> [f64; 2] {
    let [x, y] = panel.at_texel.map(f64::from);
    [x + s * DENSITY, y + (panel.size[1] - t) * DENSITY]
}

fn rect(panel: &Panel) -> TexelRect {
    let side = |m: f64| (m * DENSITY).round() as u32 + 2 * GUTTER;
    TexelRect {
        x: panel.at_texel[0] - GUTTER,
        y: panel.at_texel[1] - GUTTER,
        width: side(panel.size[0]),
        height: side(panel.size[1]),
    }
}

/// The scanner missed a piece of one wall.
fn is_hole(panel: usize, s: f64, t: f64) -> bool {
    panel == 3 && (2.6..3.2).contains(&s) && (0.9..1.5).contains(&t)
}

type Triangulation = (TriMesh, Vec<ChartId>, Vec<[[f32; 2]; 3]>, Vec<Vec<u32>>);

fn triangulate(panels: &[Panel]) -> Triangulation {
    let mut positions = Vec::new();
    let mut triangles = Vec::new();
    let mut charts = Vec::new();
    let mut corners_texel = Vec::new();
    let mut first_triangle = vec![Vec::new(); panels.len()];
    for (index, panel) in panels.iter().enumerate() {
        let cells = panel.size.map(|m| (m / CELL_M).round() as u32);
        let first = positions.len() as u32;
        let st = |i: u32, j: u32| (f64::from(i) * CELL_M, f64::from(j) * CELL_M);
        for j in 0..=cells[1] {
            for i in 0..=cells[0] {
                let (s, t) = st(i, j);
                positions.push(panel.origin + panel.along * s + panel.up * t);
            }
        }
        for j in 0..cells[1] {
            for i in 0..cells[0] {
                let (s, t) = st(i, j);
                first_triangle[index].push(triangles.len() as u32);
                if is_hole(index, s + 0.05, t + 0.05) {
                    continue;
                }
                let corners = [(i, j), (i + 1, j), (i + 1, j + 1), (i, j + 1)];
                for [a, b, c] in [[0, 1, 2], [0, 2, 3]] {
                    let triangle = [corners[a], corners[b], corners[c]];
                    triangles.push(triangle.map(|(i, j)| first + j * (cells[0] + 1) + i));
                    charts.push(ChartId(index as u32));
                    corners_texel.push(triangle.map(|(i, j)| {
                        let (s, t) = st(i, j);
                        texel(panel, s, t).map(|c| c as f32)
                    }));
                }
            }
        }
    }
    let (mesh, _) = TriMesh::from_soup(positions, triangles).unwrap();
    (mesh, charts, corners_texel, first_triangle)
}

fn paint(panels: &[Panel]) -> AtlasTexture {
    let mut pages = vec![TexturePage::blank(PAGE[0], PAGE[1]); 2];
    for (index, panel) in panels.iter().enumerate() {
        let page = &mut pages[panel.page as usize];
        let r = rect(panel);
        for y in r.y..r.y + r.height {
            for x in r.x..r.x + r.width {
                let s = (f64::from(x) + 0.5 - f64::from(panel.at_texel[0])) / DENSITY;
                let t =
                    panel.size[1] - (f64::from(y) + 0.5 - f64::from(panel.at_texel[1])) / DENSITY;
                let i = y as usize * PAGE[0] as usize + x as usize;
                let inside = (0.0..panel.size[0]).contains(&s) && (0.0..panel.size[1]).contains(&t);
                let (s, t) = (
                    s.clamp(0.0, panel.size[0] - 1e-9),
                    t.clamp(0.0, panel.size[1] - 1e-9),
                );
                if is_hole(index, s, t) {
                    continue;
                }
                page.srgb[i] = pattern(index, s, t);
                page.source[i] = if inside {
                    source(index, s, t)
                } else {
                    TexelSource::GUTTER
                };
                page.confidence[i] = confidence(index, s, t);
            }
        }
    }
    AtlasTexture::from_iter(pages)
}

/// Patches of about half a metre, some of them without a frame of their own.
fn source(panel: usize, s: f64, t: f64) -> TexelSource {
    let wobble = 0.15 * (5.0 * t).sin();
    let cell = hash(
        ((s + wobble) / 0.55) as u32,
        ((t + 0.15 * (4.0 * s).sin()) / 0.6).max(0.0) as u32,
        panel as u32,
    ) % 53;
    match cell {
        0..=2 => TexelSource::MEAN,
        3 => TexelSource::DIFFUSED,
        k => TexelSource::keyframe(k - 4),
    }
}

fn confidence(panel: usize, s: f64, t: f64) -> u8 {
    let shade = 0.55 + 0.45 * ((1.3 * s + panel as f64).sin() * (1.7 * t + 0.5).cos());
    match source(panel, s, t) {
        TexelSource::DIFFUSED => 0,
        TexelSource::MEAN => 60,
        _ => (255.0 * shade) as u8,
    }
}

fn hash(x: u32, y: u32, seed: u32) -> u32 {
    let mut h = x.wrapping_mul(0x9E37_79B1) ^ y.wrapping_mul(0x85EB_CA77);
    h = (h ^ seed.wrapping_mul(0xC2B2_AE3D) ^ (h >> 15)).wrapping_mul(0x2C1B_3C6D);
    h ^ (h >> 13)
}

/// The texture: planks, a rug, plaster, bricks, posters and a chequered box.
fn pattern(panel: usize, s: f64, t: f64) -> [u8; 3] {
    let shade = |[r, g, b]: [f64; 3], k: f64| [r, g, b].map(|c| (c * k).clamp(0.0, 255.0) as u8);
    let step = |v: f64, width: f64| (v / width).floor().max(0.0) as u32;
    match panel {
        0 if (1.0..3.2).contains(&s) && (0.5..2.5).contains(&t) => {
            let ring = (0.5 + 0.5 * (28.0 * (s - 2.1).hypot(1.1 * (t - 1.5))).sin()).round();
            shade([150.0, 40.0, 52.0], 0.7 + 0.5 * ring)
        }
        0 => {
            let row = step(t, 0.15);
            let plank = hash(step(s + f64::from(row % 3) * 0.4, 1.2), row, 1) % 40;
            let grain = 6.0 * (60.0 * t + 4.0 * (3.0 * s).sin()).sin();
            shade(
                [176.0 + grain, 128.0 + grain, 84.0],
                0.8 + f64::from(plank) / 160.0,
            )
        }
        1 => shade([236.0, 234.0, 228.0], 0.9 + 0.1 * (t / 3.0)),
        2 => {
            let row = step(t, 0.08);
            let shifted = s + f64::from(row % 2) * 0.12;
            let mortar = (t % 0.08) < 0.01 || (shifted % 0.24) < 0.01;
            if mortar {
                [205, 200, 190]
            } else {
                let tone = hash(step(shifted, 0.24), row, 2) % 50;
                shade([168.0, 82.0, 62.0], 0.75 + f64::from(tone) / 110.0)
            }
        }
        3 | 4 if (0.6..1.8).contains(&s) && (1.0..1.9).contains(&t) => {
            let (u, v) = ((s - 0.6) / 1.2, (t - 1.0) / 0.9);
            let hill = 0.35 + 0.15 * (7.0 * u).sin() + 0.05 * (19.0 * u).cos();
            if !(0.03..0.97).contains(&u) || !(0.04..0.96).contains(&v) {
                [40, 34, 30]
            } else if v < hill {
                shade([52.0, 96.0, 70.0], 0.8 + v)
            } else if (u - 0.7).hypot(v - 0.75) < 0.08 {
                [255, 226, 150]
            } else {
                [
                    (120.0 + 110.0 * u) as u8,
                    (150.0 + 40.0 * v) as u8,
                    (210.0 - 60.0 * u) as u8,
                ]
            }
        }
        3..=5 => {
            let cloud = 5.0 * ((7.0 * s).sin() * (9.0 * t).cos());
            let base = [
                [196.0, 205.0, 200.0],
                [222.0, 214.0, 196.0],
                [150.0, 170.0, 186.0],
            ];
            shade(
                base[panel - 3].map(|c| c + cloud),
                if t < 0.1 { 1.18 } else { 1.0 },
            )
        }
        _ => {
            let dark = (step(s, 0.1) + step(t, 0.1)) % 2 == 0;
            if dark { [44, 62, 80] } else { [236, 200, 110] }
        }
    }
}
