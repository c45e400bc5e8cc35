//! Random soups: positions of every size, on a coarse grid so that they meet, or not numbers at
//! all; any three of them a triangle.

use nalgebra::Point3;
use proptest::prelude::*;
use veneer::atlas::PackParams;
use veneer::texinit::TexInitParams;
use veneer::texinit::flatten::ChartMode;

use super::meshes::Soup;
use super::{check_soup, params};

fn coordinate() -> impl Strategy<Value = f64> {
    prop_oneof![
        6 => (-3i32..=3).prop_map(f64::from),
        3 => -1.0..1.0f64,
        1 => (-18i32..18, -1.0..1.0f64).prop_map(|(power, v)| v * 10f64.powi(power)),
    ]
}

fn wild_coordinate() -> impl Strategy<Value = f64> {
    prop_oneof![
        12 => coordinate(),
        1 => any::<f64>(),
        1 => Just(f64::NAN),
        1 => Just(f64::INFINITY),
        1 => Just(f64::MAX),
        1 => Just(-f64::MAX),
        1 => Just(f64::MIN_POSITIVE),
    ]
}

fn soup<S: Strategy<Value = f64>>(
    coordinate: impl Fn() -> S,
    max_triangles: usize,
) -> impl Strategy<Value = Soup> {
    let point = [coordinate(), coordinate(), coordinate()];
    let positions = proptest::collection::vec(point.prop_map(Point3::from), 1..24);
    let triangles = proptest::collection::vec(any::<[prop::sample::Index; 3]>(), 0..max_triangles);
    (positions, triangles).prop_map(|(positions, triangles)| {
        let num = positions.len();
        let in_range = |corners: [prop::sample::Index; 3]| corners.map(|v| v.index(num) as u32);
        Soup {
            positions,
            triangles: triangles.into_iter().map(in_range).collect(),
        }
    })
}

/// A heap of patches: grids whose vertices are moved at random by up to several cells.
fn patches() -> impl Strategy<Value = Soup> {
    let moved = proptest::collection::vec([-1.0..1.0f64, -1.0..1.0f64, -1.0..1.0f64], 64);
    (1usize..8, 1usize..8, 0.0..3.0f64, moved).prop_map(|(columns, rows, by, moved)| {
        let mut soup = Soup::default();
        for (k, [x, y, z]) in moved
            .into_iter()
            .take((columns + 1) * (rows + 1))
            .enumerate()
        {
            let at = [k % (columns + 1), k / (columns + 1)].map(|c| c as f64);
            soup.positions
                .push(Point3::new(at[0] + by * x, at[1] + by * y, by * z));
        }
        for (i, j) in (0..rows).flat_map(|j| (0..columns).map(move |i| (i, j))) {
            let corner = |di: usize, dj: usize| ((j + dj) * (columns + 1) + i + di) as u32;
            soup.triangles
                .push([corner(0, 0), corner(1, 0), corner(1, 1)]);
            soup.triangles
                .push([corner(0, 0), corner(1, 1), corner(0, 1)]);
        }
        soup
    })
}

fn check(soup: &Soup) {
    for mode in [ChartMode::Streaming, ChartMode::Paper] {
        let params = params(mode);
        let small = TexInitParams {
            pack: PackParams {
                page_size_texel: 256,
                max_texels: 1 << 17,
                ..params.pack
            },
            ..params
        };
        check_soup(soup, &small);
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(128))]

    #[test]
    fn any_soup_gets_its_texture(soup in soup(coordinate, 80)) {
        check(&soup);
    }

    #[test]
    fn any_soup_of_wild_numbers_gets_its_texture(soup in soup(wild_coordinate, 80)) {
        check(&soup);
    }

    #[test]
    fn any_heap_of_patches_gets_its_texture(soup in patches()) {
        check(&soup);
    }
}
