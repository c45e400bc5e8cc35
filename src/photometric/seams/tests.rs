mod patch;

use nalgebra::Point3;

use super::*;
use crate::atlas::texels::for_each_texel_within;
use crate::atlas::{ChartId, PlacedChart, TexelRect};
use crate::geom::color::{linear_from_srgb, srgb_from_linear};
use crate::mesh::TriangleId;

const TEXELS_PER_M: f32 = 200.0;
const CELL_M: f64 = 0.05;
const NUM_CELLS: u32 = 24;
const SIDE: u32 = 244;

/// A square of 1.2 m; the label is whether x is beyond the middle.
struct Sheet {
    mesh: TriMesh,
    layout: AtlasLayout,
    labels: Vec<Option<u32>>,
    sources: [TexelSource; 2],
}

impl Sheet {
    fn new() -> Self {
        let mut positions = vec![];
        let mut triangles = vec![];
        for y in 0..=NUM_CELLS {
            for x in 0..=NUM_CELLS {
                positions.push(Point3::new(
                    f64::from(x) * CELL_M,
                    f64::from(y) * CELL_M,
                    0.0,
                ));
                if x < NUM_CELLS && y < NUM_CELLS {
                    let a = y * (NUM_CELLS + 1) + x;
                    let (b, c, d) = (a + 1, a + NUM_CELLS + 1, a + NUM_CELLS + 2);
                    triangles.extend([[a, b, c], [b, d, c]]);
                }
            }
        }
        let (mesh, _) = TriMesh::from_soup(positions, triangles).unwrap();
        let corners_texel: Vec<[[f32; 2]; 3]> = mesh
            .triangle_ids()
            .map(|t| {
                mesh.corners_m(t).map(|p| {
                    [
                        2.0 + p.x as f32 * TEXELS_PER_M,
                        2.0 + p.y as f32 * TEXELS_PER_M,
                    ]
                })
            })
            .collect();
        let middle = f64::from(NUM_CELLS) * CELL_M / 2.0;
        let labels = mesh
            .triangle_ids()
            .map(|t| {
                Some(u32::from(
                    mesh.corners_m(t).iter().any(|p| p.x > middle + 1e-6),
                ))
            })
            .collect();
        let rect = TexelRect {
            x: 0,
            y: 0,
            width: SIDE,
            height: SIDE,
        };
        Self {
            layout: AtlasLayout {
                page_size_texel: [SIDE; 2],
                num_pages: 1,
                texels_per_m: f64::from(TEXELS_PER_M),
                charts: vec![PlacedChart::whole_rect(
                    0,
                    rect,
                    f64::from(TEXELS_PER_M),
                    mesh.triangle_ids().collect(),
                )],
                chart_of_triangle: vec![ChartId(0); mesh.num_triangles()],
                corners_texel,
            },
            labels,
            sources: [TexelSource::keyframe(7), TexelSource::keyframe(3)],
            mesh,
        }
    }

    fn paint(&self, linear: impl Fn(u32, f32, f32) -> f32) -> AtlasTexture {
        let mut page = crate::atlas::TexturePage::blank(SIDE, SIDE);
        for triangle in self.mesh.triangle_ids() {
            let Some(label) = self.labels[triangle.index()] else {
                continue;
            };
            let corners = &self.layout.corners_texel[triangle.index()];
            for_each_texel_within(corners, [SIDE; 2], |x, y, _| {
                let index = (y * SIDE + x) as usize;
                let value = srgb_from_linear(linear(label, x as f32, y as f32));
                page.srgb[index] = [value; 3];
                page.source[index] = self.sources[label as usize];
            });
        }
        AtlasTexture::from_iter([page])
    }

    fn level(&self, params: &SeamParams, texture: &mut AtlasTexture) -> SeamReport {
        level_seams(
            &self.mesh,
            &self.layout,
            &self.labels,
            &self.sources,
            None,
            params,
            texture,
        )
        .unwrap()
    }
}

fn at(texture: &AtlasTexture, x: u32, y: u32) -> f32 {
    linear_from_srgb(texture.pages[0].srgb[(y * SIDE + x) as usize][0])
}

/// Mean over rows of the difference of two columns.
fn difference(texture: &AtlasTexture, left: u32, right: u32) -> f32 {
    let rows = 30..210;
    let sum: f32 = rows
        .clone()
        .map(|y| at(texture, right, y) - at(texture, left, y))
        .sum();
    sum / rows.len() as f32
}

/// A gradient along the seam and detail, and an offset of the second label.
fn stepped(label: u32, x: f32, y: f32) -> f32 {
    let detail = 0.02 * (0.9 * x).sin() * (0.7 * y).cos();
    0.3 + 0.0005 * y + detail + if label == 1 { 0.06 } else { 0.0 }
}

/// The seam lies between these columns.
const LEFT: u32 = 121;
const RIGHT: u32 = 122;

#[test]
fn a_constant_step_goes_and_the_detail_stays() {
    let sheet = Sheet::new();
    for (has_global, has_local) in [(true, false), (false, true), (true, true)] {
        let mut texture = sheet.paint(stepped);
        let before = texture.clone();
        assert!((difference(&before, LEFT, RIGHT) - 0.06).abs() < 0.004);
        let params = SeamParams {
            has_global,
            has_local,
            reach_m: 0.2,
            ..SeamParams::default()
        };
        let report = sheet.level(&params, &mut texture);
        assert_eq!(report.num_seams, NUM_CELLS as usize);
        assert!((report.step_before - 0.06).abs() < 0.003, "{report:?}");
        // Where it is already fading a little, the local correction reads as too much at the edge.
        let left = if has_global { 0.05 } else { 0.1 };
        assert!(report.step_after < left * report.step_before, "{report:?}");
        // The local correction is not at its full height half a texel from the seam.
        let most = if has_global { 0.05 } else { 0.12 };
        let step = difference(&texture, LEFT, RIGHT)
            - difference(&sheet.paint(|_, x, y| stepped(0, x, y)), LEFT, RIGHT);
        assert!(step.abs() < most * 0.06, "{step}");
        // Far from the seam, and in its gradient along it, nothing has happened.
        for (x, y) in (4..24)
            .chain(220..240)
            .flat_map(|x| (2..242).map(move |y| (x, y)))
        {
            let change = (at(&texture, x, y) - at(&before, x, y)).abs();
            assert!(change < 0.006, "{x} {y} {change}");
        }
        for y in 40..200 {
            let slope = |texture: &AtlasTexture| at(texture, 110, y + 4) - at(texture, 110, y);
            assert!((slope(&texture) - slope(&before)).abs() < 0.008);
        }
        assert_eq!(texture.pages[0].source, before.pages[0].source);
    }
}

#[test]
fn a_gradient_across_the_seam_is_no_step() {
    let sheet = Sheet::new();
    let mut texture = sheet.paint(|_, x, y| 0.1 + 0.002 * x + 0.0007 * y);
    let before = texture.clone();
    let report = sheet.level(&SeamParams::default(), &mut texture);
    assert!(report.step_before < 0.002, "{report:?}");
    for (x, y) in (2..242).flat_map(|x| (2..242).map(move |y| (x, y))) {
        assert!((at(&texture, x, y) - at(&before, x, y)).abs() < 0.01);
    }
}

#[test]
fn other_things_and_other_sources_stay() {
    let sheet = Sheet::new();
    let mut texture = sheet.paint(|label, _, _| if label == 1 { 0.8 } else { 0.2 });
    for (index, source) in texture.pages[0].to_mut().source.iter_mut().enumerate() {
        if index % 7 == 0 && *source != TexelSource::NONE {
            *source = TexelSource::MEAN;
        }
    }
    let before = texture.clone();
    sheet.level(&SeamParams::default(), &mut texture);
    assert_eq!(texture, before);
    let allowed = SeamParams {
        max_step: 1.0,
        ..SeamParams::default()
    };
    let report = sheet.level(&allowed, &mut texture);
    assert!(report.num_changed_texels > 1000);
    for (index, source) in texture.pages[0].source.iter().enumerate() {
        if *source == TexelSource::MEAN {
            assert_eq!(texture.pages[0].srgb[index], before.pages[0].srgb[index]);
        }
    }
}

#[test]
fn threads_do_not_change_the_bytes() {
    let sheet = Sheet::new();
    let with = |num_threads| {
        let pool = rayon::ThreadPoolBuilder::new()
            .num_threads(num_threads)
            .build()
            .unwrap();
        pool.install(|| {
            let mut texture = sheet.paint(stepped);
            let report = sheet.level(&SeamParams::default(), &mut texture);
            (texture, report)
        })
    };
    assert_eq!(with(1), with(3));
}

#[test]
fn nothing_to_level_is_no_error_and_misfits_are() {
    let mut sheet = Sheet::new();
    let mut texture = sheet.paint(stepped);
    let before = texture.clone();
    let params = SeamParams::default();
    let level =
        |sheet: &Sheet, labels: &[Option<u32>], params: &SeamParams, texture: &mut AtlasTexture| {
            level_seams(
                &sheet.mesh,
                &sheet.layout,
                labels,
                &sheet.sources,
                None,
                params,
                texture,
            )
        };
    let none = vec![None; sheet.labels.len()];
    assert_eq!(
        level(&sheet, &none, &params, &mut texture).unwrap(),
        SeamReport::default()
    );
    // A label that no frame belongs to.
    let unknown = vec![Some(9); sheet.labels.len()];
    assert_eq!(
        level(&sheet, &unknown, &params, &mut texture)
            .unwrap()
            .num_seams,
        0
    );
    assert_eq!(texture, before);
    assert!(level(&sheet, &none[1..], &params, &mut texture).is_err());
    assert!(
        level(
            &sheet,
            &none,
            &SeamParams {
                reach_m: f64::NAN,
                ..params
            },
            &mut texture
        )
        .is_err()
    );
    assert!(level(&sheet, &none, &params, &mut AtlasTexture::default()).is_err());
    let corners = &mut sheet.layout.corners_texel[TriangleId(40).index()];
    corners[0] = [f32::NAN; 2];
    level(&sheet, &sheet.labels, &params, &mut texture).unwrap();
}
