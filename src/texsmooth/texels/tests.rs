//! Lookup, its transpose and Adam, against other ways to the same numbers.

use super::*;
use crate::atlas::TexturePage;
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
    AtlasTexture {
        pages: vec![page(1), page(2)],
    }
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
        let footprint = texels.footprint(page, at);
        let expected = sample_page(&texture.pages[page], at);
        assert_eq!(footprint.is_some(), expected.is_some(), "{at:?}");
        let found = texels.lookup(&footprint);
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
    assert!(!texels.footprint(2, [1.0, 1.0]).is_some());
    assert!(!texels.footprint(0, [f32::NAN, 1.0]).is_some());
}

#[test]
fn the_gradient_is_the_finite_difference() {
    let mut texels = Texels::from_texture(&texture()).unwrap();
    let footprints: Vec<Footprint> = positions(400)
        .map(|(page, at)| texels.footprint(page, at))
        .collect();
    let slope: Vec<f32> = (0..1200).map(|i| random(i + 9_999) - 0.5).collect();
    let loss = |texels: &Texels| {
        let mut values = vec![0.0; 1200];
        texels.gather(&footprints, &mut values);
        let products = values
            .iter()
            .zip(&slope)
            .map(|(v, s)| f64::from(*v) * f64::from(*s));
        products.sum::<f64>()
    };
    texels.bins.fill(&footprints);
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
    original.pages[0].source[20 * 150 + 70] = TexelSource::keyframe(0);
    let mut texels = Texels::from_texture(&original).unwrap();
    texels.fill(0.0);
    let footprint = texels.footprint(0, [70.5, 20.5]);
    let adam = AdamStep {
        learning_rate: 0.1,
        betas: [0.5, 0.999],
    };
    let gradients: [f32; 6] = [0.3, -0.1, 0.02, 0.0, 1.5, -0.7];
    for g in gradients {
        // Two pixels that read one texel: their gradients add up.
        let gradient = [0.5 * g, 0.5 * g, -g, 0.0, 0.0, 0.0];
        texels.step(&[footprint, footprint], &gradient, &adam);
    }
    let expected = textbook(&gradients.map(f64::from), 0.1, [0.5, 0.999]);
    let [red, green, blue] = texels.lookup(&footprint);
    assert!((f64::from(red) - expected).abs() < 1e-5, "{red} {expected}");
    assert!((f64::from(green) + expected).abs() < 1e-5, "{green}");
    assert_eq!(blue, 0.0);

    let mut written = original.clone();
    assert_eq!(texels.write_back(&mut written).num_texels, 1);
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
            let mut texels = Texels::from_texture(&texture()).unwrap();
            let footprints: Vec<Footprint> = positions(20_000)
                .map(|(page, at)| texels.footprint(page, at))
                .collect();
            let gradient: Vec<f32> = (0..60_000).map(|i| random(i) - 0.5).collect();
            let adam = AdamStep {
                learning_rate: 0.01,
                betas: [0.5, 0.999],
            };
            for _ in 0..3 {
                texels.step(&footprints, &gradient, &adam);
            }
            let mut out = texture();
            texels.write_back(&mut out);
            let mut values = vec![0.0; 60_000];
            texels.gather(&footprints, &mut values);
            (out, values)
        })
    };
    let one = run(1);
    assert!(one == run(2) && one == run(5));
    assert_ne!(one.0, texture());
}
