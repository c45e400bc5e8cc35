use nalgebra::Point3;
use proptest::prelude::*;

use super::*;
use crate::atlas::{PackParams, PlaneChart, pack};

const CELLS: usize = 24;
const CELL_M: f64 = 0.05;

struct Chart {
    triangles: Vec<TriangleId>,
    corners_m: Vec<[[f64; 2]; 3]>,
}

impl PlaneChart for Chart {
    fn triangles(&self) -> &[TriangleId] {
        &self.triangles
    }

    fn corners_m(&self) -> &[[[f64; 2]; 3]] {
        &self.corners_m
    }
}

/// Triangles of a square of cells in the plane z = `z_m`, each with its own vertices, so that only
/// positions connect them.
fn square_soup(z_m: f64) -> Vec<[Point3<f64>; 3]> {
    let at = |x: usize, y: usize| Point3::new(x as f64 * CELL_M, y as f64 * CELL_M, z_m);
    let mut triangles = Vec::new();
    for y in 0..CELLS {
        for x in 0..CELLS {
            let corners = [at(x, y), at(x + 1, y), at(x + 1, y + 1), at(x, y + 1)];
            let [a, b, c, d] = corners;
            triangles.extend([[a, b, c], [a, c, d]]);
        }
    }
    triangles
}

/// The mesh, and a layout with `num_charts` charts of consecutive triangles.
fn laid_out(soup: &[[Point3<f64>; 3]], num_charts: usize) -> (TriMesh, AtlasLayout) {
    let positions: Vec<_> = soup.iter().flatten().copied().collect();
    let indices = (0u32..).step_by(3).take(soup.len());
    let (mesh, _) =
        TriMesh::from_soup(positions, indices.map(|k| [k, k + 1, k + 2]).collect()).unwrap();
    let ids: Vec<TriangleId> = mesh.triangle_ids().collect();
    let charts: Vec<Chart> = ids
        .chunks(soup.len().div_ceil(num_charts))
        .map(|ids| Chart {
            triangles: ids.to_vec(),
            corners_m: ids
                .iter()
                .map(|t| mesh.corners_m(*t).map(|p| [p.x, p.y]))
                .collect(),
        })
        .collect();
    let (layout, _) = pack(&charts, soup.len(), 80.0, &PackParams::default()).unwrap();
    (mesh, layout)
}

/// Paints the texels of the triangles chosen with a colour by position.
fn painted(
    mesh: &TriMesh,
    layout: &AtlasLayout,
    is_seen: impl Fn(TriangleId) -> bool,
    linear_at: impl Fn(Point3<f64>) -> [f32; 3],
) -> AtlasTexture {
    let [width, height] = layout.page_size_texel;
    let blank = crate::atlas::TexturePage::blank(width, height);
    let mut texture = AtlasTexture::from_iter(vec![blank; layout.num_pages as usize]);
    for triangle in mesh.triangle_ids().filter(|t| is_seen(*t)) {
        let page = texture.pages[layout.page_of(triangle) as usize].to_mut();
        let corners = mesh.corners_m(triangle);
        for_each_index(layout, triangle, |index, weights| {
            let point = corners
                .iter()
                .zip(weights)
                .map(|(p, w)| p.coords * f64::from(w))
                .sum::<nalgebra::Vector3<f64>>();
            page.srgb[index] = linear_at(point.into()).map(srgb_from_linear);
            page.source[index] = TexelSource::keyframe(1);
            page.confidence[index] = 99;
        });
    }
    texture
}

fn for_each_owned_texel(
    mesh: &TriMesh,
    layout: &AtlasLayout,
    mut visit: impl FnMut(TriangleId, usize, usize, Point3<f64>),
) {
    for triangle in mesh.triangle_ids() {
        let page = layout.page_of(triangle) as usize;
        let corners = mesh.corners_m(triangle);
        for_each_index(layout, triangle, |index, weights| {
            let point = corners
                .iter()
                .zip(weights)
                .map(|(p, w)| p.coords * f64::from(w))
                .sum::<nalgebra::Vector3<f64>>();
            visit(triangle, page, index, point.into());
        });
    }
}

#[expect(clippy::cast_possible_truncation, reason = "test colours")]
fn ramp(point: Point3<f64>) -> [f32; 3] {
    let side_m = CELLS as f64 * CELL_M;
    let (u, v) = (point.x / side_m, point.y / side_m);
    [0.1 + 0.8 * u, 0.9 - 0.7 * v, 0.2 + 0.3 * (u + v)].map(|c| c as f32)
}

fn cell_of(triangle: TriangleId) -> (usize, usize) {
    let cell = triangle.index() / 2 % (CELLS * CELLS);
    (cell % CELLS, cell / CELLS)
}

/// Linear functions are harmonic: a hole in a ramp is filled with the ramp.
#[test]
fn a_hole_in_a_ramp_is_filled_with_the_ramp() {
    let (mesh, layout) = laid_out(&square_soup(0.0), 7);
    let in_hole = |t: TriangleId| {
        let (x, y) = cell_of(t);
        (6..18).contains(&x) && (5..20).contains(&y)
    };
    let before = painted(&mesh, &layout, |t| !in_hole(t), ramp);
    let mut after = before.clone();
    let report = fill_unseen(&mesh, &layout, &mut after, &FillParams::default()).unwrap();
    assert_eq!(report.num_neutral_texels, 0);
    assert_eq!(report.num_unpainted_triangles, 2 * 12 * 15);
    let (mut num_painted, mut num_filled) = (0, 0);
    for_each_owned_texel(&mesh, &layout, |triangle, page, index, point| {
        let [old, new] = [&before.pages[page], &after.pages[page]];
        if in_hole(triangle) {
            num_filled += 1;
            assert_eq!(new.source[index], TexelSource::DIFFUSED);
            for (found, expected) in new.srgb[index].iter().zip(ramp(point)) {
                let error = linear_from_srgb(*found) - expected;
                assert!(error.abs() < 0.02, "{error} at {point}");
            }
        } else {
            num_painted += 1;
            assert_eq!(
                (old.srgb[index], old.source[index]),
                (new.srgb[index], new.source[index])
            );
            assert_eq!(new.confidence[index], 99);
        }
    });
    assert_eq!(report.num_diffused_texels, num_filled);
    assert_eq!(report.num_painted_texels, num_painted);
}

#[test]
fn what_nothing_painted_is_connected_to_is_neutral() {
    let mut soup = square_soup(0.0);
    soup.extend(square_soup(1.0));
    let (mesh, layout) = laid_out(&soup, 5);
    let is_lower = |t: TriangleId| t.index() < soup.len() / 2;
    let mut texture = painted(&mesh, &layout, |t| is_lower(t) && t.index() % 5 == 0, ramp);
    let params = FillParams {
        neutral_srgb: [1, 2, 3],
        ..FillParams::default()
    };
    let report = fill_unseen(&mesh, &layout, &mut texture, &params).unwrap();
    let mut num_neutral = 0;
    for_each_owned_texel(&mesh, &layout, |triangle, page, index, _| {
        assert_ne!(texture.pages[page].source[index], TexelSource::NONE);
        if !is_lower(triangle) {
            num_neutral += 1;
            assert_eq!(texture.pages[page].srgb[index], [1, 2, 3]);
        }
    });
    assert_eq!(report.num_neutral_texels, num_neutral);
}

#[test]
fn filling_again_and_on_more_threads_gives_the_same() {
    let (mesh, layout) = laid_out(&square_soup(0.0), 7);
    let before = painted(&mesh, &layout, |t| t.index() % 11 == 3, ramp);
    let run = |num_threads: usize, texture: &AtlasTexture| {
        let mut texture = texture.clone();
        let pool = rayon::ThreadPoolBuilder::new()
            .num_threads(num_threads)
            .build();
        pool.unwrap()
            .install(|| fill_unseen(&mesh, &layout, &mut texture, &FillParams::default()).unwrap());
        texture
    };
    let once = run(1, &before);
    assert!(once == run(4, &before));
    assert!(once == run(2, &once));
}

#[test]
fn a_mesh_or_texture_of_another_layout_is_refused() {
    let (mesh, layout) = laid_out(&square_soup(0.0), 1);
    let mut texture = painted(&mesh, &layout, |_| true, ramp);
    let params = FillParams::default();
    let other = fill_unseen(&TriMesh::default(), &layout, &mut texture, &params);
    assert!(matches!(other, Err(FillError::Layout { .. })));
    let wild = FillParams {
        over_relaxation: 2.0,
        ..params
    };
    let wild = fill_unseen(&mesh, &layout, &mut texture, &wild);
    assert!(matches!(wild, Err(FillError::OverRelaxation { .. })));
    texture.pages[0].to_mut().srgb.pop();
    let short = fill_unseen(&mesh, &layout, &mut texture, &params);
    assert!(matches!(short, Err(FillError::Texture(_))));
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(24))]
    #[test]
    fn no_colour_leaves_the_range_of_the_painted_ones(
        seen in proptest::collection::vec(any::<bool>(), 97),
        seed in any::<u32>(),
    ) {
        let (mesh, layout) = laid_out(&square_soup(0.0), 3);
        let is_seen = |t: TriangleId| t.index() == 0 || (seen[t.index() % 97] && t.index() % 13 > 9);
        let noise = |p: Point3<f64>| {
            let wave = (p.x * 91.0 + p.y * 57.0 + f64::from(seed % 1000)).sin();
            #[expect(clippy::cast_possible_truncation, reason = "test colours")]
            let value = (0.4 + 0.2 * wave) as f32;
            [value, 1.0 - value, 0.5]
        };
        let mut texture = painted(&mesh, &layout, is_seen, noise);
        let mut low = [255u8; 3];
        let mut high = [0u8; 3];
        for page in &texture.pages {
            for (colour, source) in page.srgb.iter().zip(&page.source) {
                if *source != TexelSource::NONE {
                    for k in 0..3 {
                        low[k] = low[k].min(colour[k]);
                        high[k] = high[k].max(colour[k]);
                    }
                }
            }
        }
        fill_unseen(&mesh, &layout, &mut texture, &FillParams::default()).unwrap();
        // Rounding, and the steps far from what is painted.
        let slack = 1 + FAR_STEP / 2;
        for_each_owned_texel(&mesh, &layout, |_, page, index, _| {
            for k in 0..3 {
                let value = texture.pages[page].srgb[index][k];
                assert!(
                    value >= low[k].saturating_sub(slack) && value <= high[k].saturating_add(slack),
                    "{value} is not in {}..={}", low[k], high[k]
                );
            }
        });
    }
}
