#![expect(
    clippy::cast_possible_truncation,
    reason = "the numbers of a test are small"
)]

use std::collections::BTreeMap;

use super::*;
use crate::atlas::texels::for_each_texel_within;
use crate::mesh::TriangleId;

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

/// A fan of twelve triangles, wider than high.
fn fan(radius_m: f64, phase: f64) -> Chart {
    let at = |k: usize| {
        let angle = phase + k as f64 / 12.0 * std::f64::consts::TAU;
        [1.6 * radius_m * angle.cos(), radius_m * angle.sin()]
    };
    Chart {
        triangles: (0..12).map(TriangleId).collect(),
        corners_m: (0..12).map(|k| [[0.0; 2], at(k), at(k + 1)]).collect(),
    }
}

/// The texels that each triangle of a piece owns, from the piece's corner.
fn owned(piece: &PlacedPiece, placer: &ChartPlacer) -> Vec<Vec<[u32; 2]>> {
    let rect = piece.chart.rect;
    let of_triangle = |corners: &[[f32; 2]; 3]| {
        let mut texels = Vec::new();
        for_each_texel_within(corners, placer.page_size_texel(), |x, y, _| {
            assert!(piece.chart.owns(x, y));
            texels.push([x - rect.x, y - rect.y]);
        });
        texels
    };
    piece.corners_texel.iter().map(of_triangle).collect()
}

/// No texel is owned twice, whatever the cells say.
fn check_apart(pieces: &BTreeMap<u32, PlacedPiece>, placer: &ChartPlacer) {
    let [width, height] = placer.page_size_texel();
    let mut is_owned = vec![vec![false; (width * height) as usize]; placer.num_pages() as usize];
    for piece in pieces.values() {
        let rect = piece.chart.rect;
        for [x, y] in owned(piece, placer).into_iter().flatten() {
            let index = ((rect.y + y) * width + rect.x + x) as usize;
            let page = &mut is_owned[piece.chart.page as usize];
            assert!(!std::mem::replace(&mut page[index], true));
        }
    }
}

fn params() -> PackParams {
    PackParams {
        page_size_texel: 128,
        gutter_texel: 2,
        max_texels: 64 * 128 * 128,
    }
}

/// Numbers that look random.
struct Draw(u64);

impl Draw {
    fn next(&mut self) -> u64 {
        self.0 = self
            .0
            .wrapping_mul(6_364_136_223_846_793_005)
            .wrapping_add(1);
        self.0 >> 33
    }

    fn share(&mut self) -> f64 {
        (self.next() % 1000) as f64 / 1000.0
    }
}

/// Charts come and go for long; where less than half of the pages is used, pages are compacted.
#[test]
fn pages_stay_full_while_charts_come_and_go() {
    let mut placer = ChartPlacer::new(100.0, &params()).unwrap();
    let mut pieces: BTreeMap<u32, PlacedPiece> = BTreeMap::new();
    let mut draw = Draw(7);
    let (mut num_placed, mut num_compactions, mut least_use) = (0, 0, 1.0_f64);
    for step in 0..1500_u32 {
        // The scan grows and shrinks by turns.
        let is_growing = draw.share() < if step / 500 % 2 == 0 { 0.65 } else { 0.35 };
        if is_growing {
            let chart = fan(0.02 + 0.25 * draw.share().powi(3), draw.share());
            for piece in placer.place(&[chart]).unwrap() {
                pieces.insert(num_placed, piece);
                num_placed += 1;
            }
        } else if !pieces.is_empty() {
            let at = draw.next() as usize % pieces.len();
            let key = *pieces.keys().nth(at).unwrap();
            placer.remove(pieces.remove(&key).unwrap().slot);
        }
        while placer.used_share() < 0.5 {
            let before = pieces.clone();
            let mut all: Vec<&mut PlacedPiece> = pieces.values_mut().collect();
            let Some(done) = placer.compact(&mut all) else {
                break;
            };
            num_compactions += 1;
            let moved_keys: Vec<u32> = done
                .moved
                .iter()
                .map(|&k| *before.keys().nth(k).unwrap())
                .collect();
            for (key, piece) in &pieces {
                let old = &before[key];
                assert_eq!(owned(piece, &placer), owned(old, &placer));
                assert_eq!(piece.slot != old.slot, moved_keys.contains(key));
                assert_eq!(old.chart.page == done.closed_page, moved_keys.contains(key));
            }
        }
        if placer.num_pages() > 2 {
            least_use = least_use.min(placer.used_share());
        }
        if step % 100 == 0 {
            check_apart(&pieces, &placer);
        }
    }
    assert!(num_compactions > 3, "{num_compactions}");
    assert!(least_use > 0.3, "{least_use}");
    for piece in pieces.values() {
        placer.remove(piece.slot);
    }
    assert_eq!(placer.used_share(), 0.0);
}

#[test]
fn what_does_not_fit_leaves_the_pages_as_they_were() {
    let small = PackParams {
        max_texels: 128 * 128,
        ..params()
    };
    let mut placer = ChartPlacer::new(100.0, &small).unwrap();
    let first = placer.place(&[fan(0.3, 0.0)]).unwrap();
    let used = placer.used_share();
    let many: Vec<Chart> = (0..12).map(|k| fan(0.3, f64::from(k))).collect();
    let refused = placer.place(&many);
    assert!(matches!(refused, Err(PackError::OverBudget { .. })));
    assert_eq!(placer.used_share(), used);
    placer.remove(first[0].slot);
    let again = placer.place(&[fan(0.3, 0.0)]).unwrap();
    assert_eq!(again[0].chart, first[0].chart);
}
