//! Lookup, its transpose and Adam, against other ways to the same numbers.

use super::*;
use crate::atlas::{PlacedChart, TexelRect, TexturePage};
use crate::render::textured::sample_page;

fn random(index: u64) -> f32 {
    let mut z = index.wrapping_add(1).wrapping_mul(0x9e37_79b9_7f4a_7c15);
    z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    ((z >> 40) as f32) / (1u64 << 24) as f32
}

/// Two pages that no tile divides evenly, with holes.
fn texture() -> AtlasTexture {
    let page = |seed: u64| {
        let mut page = TexturePage::blank(150, 90);
        for i in 0..150 * 90 {
            let at = seed * 1_000_000 + i as u64;
            page.srgb[i] = [0, 1, 2].map(|c| (256.0 * random(3 * at + c)) as u8);
            if random(at + 77_777_777) > 0.1 {
                page.source[i] = TexelSource::keyframe(0);
            }
        }
        page
    };
    AtlasTexture::from_iter([page(1), page(2)])
}

fn positions(num: u64) -> impl Iterator<Item = (usize, [f32; 2])> {
    (0..num).map(|i| {
        let at = [154.0 * random(2 * i) - 2.0, 94.0 * random(2 * i + 1) - 2.0];
        ((i % 2) as usize, at)
    })
}

#[test]
fn lookups_are_those_of_the_renderer() {
    let texture = texture();
    let texels = Texels::from_texture(&texture).unwrap();
    let mut num_none = 0;
    for (page, at) in positions(5000) {
        let footprint = texels.footprint(&texture, page, at);
        let expected = sample_page(&texture.pages[page], at);
        assert_eq!(footprint.is_some(), expected.is_some(), "{at:?}");
        let found = texels.lookup(&texture, &footprint);
        match expected {
            Some(expected) => {
                for (found, expected) in found.iter().zip(expected) {
                    let found = (found + 1.0) * 127.5;
                    assert!(
                        (found - expected).abs() < 1e-3,
                        "{at:?}: {found} {expected}"
                    );
                }
            }
            None => num_none += 1,
        }
    }
    assert!(num_none > 100, "{num_none}");
    assert!(!texels.footprint(&texture, 2, [1.0, 1.0]).is_some());
    assert!(!texels.footprint(&texture, 0, [f32::NAN, 1.0]).is_some());
}

#[test]
fn the_gradient_is_the_finite_difference() {
    let texture = texture();
    let mut texels = Texels::from_texture(&texture).unwrap();
    let footprints: Vec<Footprint> = positions(400)
        .map(|(page, at)| texels.footprint(&texture, page, at))
        .collect();
    let slope: Vec<f32> = (0..1200).map(|i| random(i + 9_999) - 0.5).collect();
    let loss = |texels: &Texels| {
        let mut values = vec![0.0; 1200];
        texels.gather(&texture, &footprints, &mut values);
        let products = values
            .iter()
            .zip(&slope)
            .map(|(v, s)| f64::from(*v) * f64::from(*s));
        products.sum::<f64>()
    };
    texels.bins.fill(&footprints, |_, _| true);
    let bins = texels.bins.clone();
    let (mut num_checked, mut sum, mut is_read) =
        (0, vec![[0.0; 3]; TILE_AREA], vec![false; TILE_AREA]);
    for (slot, &(tile, _)) in bins.touched.iter().enumerate() {
        scatter(
            bins.entries(slot),
            &footprints,
            &slope,
            &mut sum,
            &mut is_read,
        );
        for place in (0..TILE_AREA).filter(|place| is_read[*place]).step_by(7) {
            for (channel, &found) in sum[place].iter().enumerate() {
                let old = texels.tiles[tile].value[place][channel];
                let mut at = |value: f32| {
                    texels.tiles[tile].value[place][channel] = value;
                    loss(&texels)
                };
                let difference = (at(old + 0.25) - at(old - 0.25)) / 0.5;
                at(old);
                let found = f64::from(found);
                assert!(
                    (found - difference).abs() < 1e-5,
                    "{found} for {difference}"
                );
                num_checked += 1;
            }
        }
    }
    assert!(num_checked > 300, "{num_checked}");
}

/// Adam as the paper of that name prints it, on one number.
fn textbook(gradients: &[f64], rate: f64, [b1, b2]: [f64; 2]) -> f64 {
    let (mut x, mut m, mut v) = (0.0, 0.0, 0.0);
    for (t, g) in gradients.iter().enumerate() {
        m = b1 * m + (1.0 - b1) * g;
        v = b2 * v + (1.0 - b2) * g * g;
        let t = t as i32 + 1;
        x -= rate * (m / (1.0 - b1.powi(t))) / ((v / (1.0 - b2.powi(t))).sqrt() + 1e-8);
    }
    x
}

#[test]
fn steps_are_those_of_adam_and_touch_nothing_else() {
    let mut original = texture();
    original.pages[0].to_mut().source[20 * 150 + 70] = TexelSource::keyframe(0);
    let mut texels = Texels::from_texture(&original).unwrap();
    texels.fill(0.0);
    let footprint = texels.footprint(&original, 0, [70.5, 20.5]);
    let adam = AdamStep {
        learning_rate: 0.1,
        betas: [0.5, 0.999],
    };
    let gradients: [f32; 6] = [0.3, -0.1, 0.02, 0.0, 1.5, -0.7];
    for g in gradients {
        // Two pixels that read one texel: their gradients add up.
        let gradient = [0.5 * g, 0.5 * g, -g, 0.0, 0.0, 0.0];
        texels.step(&[footprint, footprint], &[], &gradient, &adam);
    }
    let expected = textbook(&gradients.map(f64::from), 0.1, [0.5, 0.999]);
    let [red, green, blue] = texels.lookup(&original, &footprint);
    assert!((f64::from(red) - expected).abs() < 1e-5, "{red} {expected}");
    assert!((f64::from(green) + expected).abs() < 1e-5, "{green}");
    assert_eq!(blue, 0.0);

    let mut written = original.clone();
    texels.write_back(&mut written);
    let made = texels.steps_made();
    assert_eq!((made.num_texels, made.num_steps), (1, 6));
    let changed: Vec<usize> = (0..150 * 90)
        .filter(|&i| written.pages[0].srgb[i] != original.pages[0].srgb[i])
        .collect();
    assert_eq!(changed, [20 * 150 + 70]);
    assert_eq!(written.pages[1], original.pages[1]);
    assert_eq!(written.pages[0].source, original.pages[0].source);
}

#[test]
fn any_thread_count_steps_to_the_same_bits() {
    let run = |num_threads| {
        let pool = rayon::ThreadPoolBuilder::new()
            .num_threads(num_threads)
            .build()
            .unwrap();
        pool.install(|| {
            let texture = texture();
            let mut texels = Texels::from_texture(&texture).unwrap();
            let footprints: Vec<Footprint> = positions(20_000)
                .map(|(page, at)| texels.footprint(&texture, page, at))
                .collect();
            let gradient: Vec<f32> = (0..60_000).map(|i| random(i) - 0.5).collect();
            let adam = AdamStep {
                learning_rate: 0.01,
                betas: [0.5, 0.999],
            };
            for _ in 0..3 {
                texels.step(&footprints, &[], &gradient, &adam);
            }
            let mut out = texture.clone();
            texels.write_back(&mut out);
            let mut values = vec![0.0; 60_000];
            texels.gather(&texture, &footprints, &mut values);
            (out, values)
        })
    };
    let one = run(1);
    assert!(one == run(2) && one == run(5));
    assert_ne!(one.0, texture());
}

/// Two charts on the first page, one of which may change.
fn part() -> (AtlasLayout, [bool; 2]) {
    let chart = |x, y, width, height| {
        let rect = TexelRect {
            x,
            y,
            width,
            height,
        };
        PlacedChart::whole_rect(0, rect, 100.0, Vec::new())
    };
    let layout = AtlasLayout {
        page_size_texel: [150, 90],
        num_pages: 2,
        texels_per_m: 100.0,
        charts: vec![chart(0, 0, 64, 90), chart(64, 0, 20, 60)],
        chart_of_triangle: Vec::new(),
        corners_texel: Vec::new(),
    };
    (layout, [false, true])
}

#[test]
fn of_some_charts_lookups_are_the_same_and_the_rest_has_no_memory() {
    let texture = texture();
    let (layout, may_change) = part();
    let whole = Texels::from_texture(&texture).unwrap();
    let part = Texels::of_charts(&texture, &layout, &may_change).unwrap();
    let with_memory: Vec<usize> = (0..part.tiles.len())
        .filter(|&tile| !part.tiles[tile].value.is_empty())
        .collect();
    assert_eq!(with_memory, [1]);
    for (page, at) in positions(5000) {
        let [expected, found] = [&whole, &part].map(|texels| {
            let footprint = texels.footprint(&texture, page, at);
            (footprint, texels.lookup(&texture, &footprint))
        });
        assert_eq!(found, expected, "{at:?}");
    }
}

#[test]
fn of_some_charts_only_their_texels_step_and_only_for_their_pixels() {
    let texture = texture();
    let (layout, may_change) = part();
    let footprints = |texels: &Texels| -> Vec<Footprint> {
        let at = positions(20_000).map(|(page, at)| texels.footprint(&texture, page, at));
        at.collect()
    };
    let gradient: Vec<f32> = (0..60_000).map(|i| random(i) - 0.5).collect();
    let adam = AdamStep {
        learning_rate: 0.1,
        betas: [0.5, 0.999],
    };
    let stepped = |mut texels: Texels, is_fixed: &[bool]| {
        let footprints = footprints(&texels);
        texels.step(&footprints, is_fixed, &gradient, &adam);
        let mut out = texture.clone();
        texels.write_back(&mut out);
        out
    };
    let part = || Texels::of_charts(&texture, &layout, &may_change).unwrap();
    let whole = stepped(Texels::from_texture(&texture).unwrap(), &[]);
    let found = stepped(part(), &[]);
    let mut expected = texture.clone();
    for y in 0..60 {
        let own = y * 150 + 64..y * 150 + 84;
        expected.pages[0].to_mut().srgb[own.clone()].copy_from_slice(&whole.pages[0].srgb[own]);
    }
    assert_ne!(expected, texture);
    assert!(found == expected);
    assert!(stepped(part(), &vec![true; 20_000]) == texture);

    let mut blank = part();
    blank.fill(0.0);
    let value = |x: usize, y: usize| blank.tiles[1].value[place_of(x, y)][0];
    let is_painted = |x: usize, y: usize| texture.pages[0].source[y * 150 + x] != TexelSource::NONE;
    for (x, y) in [(70, 9), (83, 59), (84, 59), (70, 60), (100, 9)] {
        let is_own = x < 84 && y < 60;
        assert!(
            !is_painted(x, y) || (value(x, y) == 0.0) == is_own,
            "{x} {y}"
        );
    }
}
