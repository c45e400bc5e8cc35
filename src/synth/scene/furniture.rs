//! Tables, chairs, a shelf, a sofa, a lamp, plants.

use crate::geom::RigidTransform;
use crate::synth::hash::Stream;
use crate::synth::texture::{Pattern, Texture, srgb};

use super::still_life::{plain, standing_book};
use super::{Faces, SceneBuilder, all_faces, standing, tilted};

/// Wood with its grain along u; `tone` is its light and its dark colour.
pub(super) fn wood(tone: [u32; 2], ring_m: f64, along_v: bool) -> Texture {
    Pattern::Wood {
        light: srgb(tone[0]),
        dark: srgb(tone[1]),
        ring_m,
        along_v,
        plank_m: None,
    }
    .into()
}

/// A board whose grain runs along its longest side; the short sides show the same grain.
fn board(tone: [u32; 2], [w, d, h]: [f64; 3], salt: u32) -> Faces {
    let ring_m = 0.03;
    let along = |u: f64, v: f64, face: u32| wood(tone, ring_m, v > u).salted(salt * 8 + face);
    [
        along(w, h, 0),
        along(w, h, 1),
        along(d, h, 2),
        along(d, h, 3),
        along(w, d, 4),
        along(w, d, 5),
    ]
}

/// A wooden box, its grain along its longest side.
pub(super) fn wooden(
    scene: &mut SceneBuilder,
    name: &str,
    world_from_box: &RigidTransform,
    size_m: [f64; 3],
    tone: [u32; 2],
    salt: u32,
) {
    scene.cuboid(name, world_from_box, size_m, board(tone, size_m, salt));
}

/// A table with four legs, its frame on the floor under its middle.
pub(super) fn table(
    scene: &mut SceneBuilder,
    world_from_table: &RigidTransform,
    [w, d, h]: [f64; 3],
    tone: [u32; 2],
) {
    let top_m = 0.04;
    let at = |x: f64, y: f64, z: f64| *world_from_table * standing([x, y, z], 0.0);
    wooden(
        scene,
        "table top",
        &at(0.0, 0.0, h - top_m),
        [w, d, top_m],
        tone,
        40,
    );
    let leg = 0.06;
    for (salt, [sx, sy]) in (41..).zip([[-1.0, -1.0], [1.0, -1.0], [-1.0, 1.0], [1.0, 1.0]]) {
        let foot = at(sx * (w / 2.0 - 0.08), sy * (d / 2.0 - 0.08), 0.0);
        wooden(scene, "table leg", &foot, [leg, leg, h - top_m], tone, salt);
    }
}

/// A chair that faces −y, its frame on the floor under its seat.
pub(super) fn chair(
    scene: &mut SceneBuilder,
    world_from_chair: &RigidTransform,
    salt: u32,
    seat: u32,
) {
    let tone = [0xb88650, 0x7a522c];
    let at = |x: f64, y: f64, z: f64| *world_from_chair * standing([x, y, z], 0.0);
    let (w, d, h) = (0.42, 0.42, 0.45);
    let cloth = Texture::from(Pattern::Checks {
        colors: [srgb(seat), srgb(seat).map(|c| 0.62 * c)],
        size_m: 0.03,
    })
    .mottled(0.1, 0.012);
    let frame = plain(0x9a6e40);
    scene.cuboid(
        "chair seat",
        &at(0.0, 0.0, h - 0.05),
        [w, d, 0.05],
        [
            frame.clone(),
            frame.clone(),
            frame.clone(),
            frame.clone(),
            cloth.salted(salt),
            frame,
        ],
    );
    for (index, [sx, sy]) in (0..).zip([[-1.0, -1.0], [1.0, -1.0], [-1.0, 1.0], [1.0, 1.0]]) {
        let foot = at(sx * (w / 2.0 - 0.03), sy * (d / 2.0 - 0.03), 0.0);
        wooden(
            scene,
            "chair leg",
            &foot,
            [0.045, 0.045, h - 0.05],
            tone,
            salt * 16 + index,
        );
    }
    let back_y = d / 2.0 - 0.025;
    for (index, x) in (4..).zip([-w / 2.0 + 0.025, w / 2.0 - 0.025]) {
        let post = at(x, back_y, h);
        wooden(
            scene,
            "chair post",
            &post,
            [0.045, 0.045, 0.45],
            tone,
            salt * 16 + index,
        );
    }
    for (index, z) in (6..).zip([0.16, 0.32]) {
        let slat = at(0.0, back_y, h + z);
        wooden(
            scene,
            "chair slat",
            &slat,
            [w - 0.095, 0.03, 0.10],
            tone,
            salt * 16 + index,
        );
    }
}

/// A shelf that faces −y, with books on each board; its frame on the floor under its middle.
pub(super) fn bookshelf(
    scene: &mut SceneBuilder,
    world_from_shelf: &RigidTransform,
    [w, d, h]: [f64; 3],
    num_boards: u32,
    random: Stream,
) {
    let tone = [0xd8b480, 0xa8804c];
    let at = |x: f64, y: f64, z: f64| *world_from_shelf * standing([x, y, z], 0.0);
    let side = 0.03;
    for (salt, x) in (60..).zip([-(w - side) / 2.0, (w - side) / 2.0]) {
        wooden(
            scene,
            "shelf side",
            &at(x, 0.0, 0.0),
            [side, d, h],
            tone,
            salt,
        );
    }
    let inner = w - 2.0 * side;
    let back = at(0.0, d / 2.0 - 0.01, 0.0);
    wooden(scene, "shelf back", &back, [inner, 0.02, h], tone, 62);
    let pitch = (h - side) / f64::from(num_boards - 1);
    for row in 0..num_boards {
        let z = f64::from(row) * pitch;
        let shelf = at(0.0, -0.01, z);
        wooden(
            scene,
            "shelf board",
            &shelf,
            [inner, d - 0.02, side],
            tone,
            64 + row,
        );
        if row + 1 < num_boards {
            let from_left = at(-inner / 2.0, -0.01, z + side);
            row_of_books(
                scene,
                &from_left,
                [inner, d - 0.02, pitch - side],
                random.sub(u64::from(row)),
            );
        }
    }
}

/// Books from left to right until the row is nearly full; origin at the row's left end.
fn row_of_books(
    scene: &mut SceneBuilder,
    world_from_row: &RigidTransform,
    [length_m, depth_m, height_m]: [f64; 3],
    random: Stream,
) {
    let end_m = length_m * random.range(1, 0.72, 0.97);
    let mut x = 0.01;
    let mut number = 10;
    loop {
        let w = random.range(number, 0.03, 0.062);
        if x + w > end_m {
            break;
        }
        let d = random.range(number + 1, 0.55, 0.75) * depth_m;
        let h = random.range(number + 2, 0.62, 0.92) * height_m;
        let at =
            *world_from_row * standing([x + w / 2.0, -depth_m / 2.0 + 0.02 + d / 2.0, 0.0], 0.0);
        let index = (random.bits(number + 3) % 100_000) as usize;
        standing_book(
            scene,
            &format!("book {index}"),
            &at,
            [w, d, h],
            index,
            0.0012,
        );
        x += w + 0.001;
        number += 4;
    }
}

/// A sofa that faces −y with three cushions; its frame on the floor under its middle.
pub(super) fn sofa(scene: &mut SceneBuilder, world_from_sofa: &RigidTransform, w: f64) {
    let at = |x: f64, y: f64, z: f64| *world_from_sofa * standing([x, y, z], 0.0);
    let cloth = Texture::from(Pattern::Checks {
        colors: [srgb(0x466872), srgb(0x587c84)],
        size_m: 0.012,
    })
    .mottled(0.10, 0.035);
    let (depth, arm) = (0.85, 0.18);
    scene.cuboid(
        "sofa base",
        &at(0.0, 0.0, 0.0),
        [w, depth, 0.24],
        all_faces(&cloth, 1),
    );
    for (salt, x) in (2..).zip([-(w - arm) / 2.0, (w - arm) / 2.0]) {
        scene.cuboid(
            "sofa arm",
            &at(x, 0.0, 0.24),
            [arm, depth, 0.34],
            all_faces(&cloth, salt),
        );
    }
    let inner = w - 2.0 * arm;
    let back = at(0.0, depth / 2.0 - 0.11, 0.24);
    scene.cuboid(
        "sofa back",
        &back,
        [inner, 0.22, 0.56],
        all_faces(&cloth, 4),
    );
    let seat_depth = depth - 0.22;
    for (salt, sx) in (5..).zip([-0.25, 0.25]) {
        let seat = at(sx * inner, -0.11, 0.24);
        scene.cuboid(
            "sofa seat",
            &seat,
            [inner / 2.0 - 0.01, seat_depth, 0.16],
            all_faces(&cloth, salt),
        );
    }
    let cushions = [
        Texture::from(Pattern::Stripes {
            palette: vec![
                srgb(0xe8d8b0),
                srgb(0xb84a30),
                srgb(0xe8d8b0),
                srgb(0x2a4a6a),
            ],
            width_m: 0.03,
            across_v: false,
        }),
        Pattern::Dots {
            ground: srgb(0xe0a830),
            dot: srgb(0xfaf0d8),
            pitch_m: 0.06,
            radius_m: 0.018,
        }
        .into(),
        Pattern::Checks {
            colors: [srgb(0x7a2a40), srgb(0xe8c8c0)],
            size_m: 0.045,
        }
        .into(),
    ];
    for (index, (cushion, x)) in (0u32..).zip(cushions.into_iter().zip([-0.36, 0.02, 0.34])) {
        let place = *world_from_sofa
            * tilted(
                [x * inner, 0.13, 0.415],
                0.12 * (f64::from(index) - 1.0),
                -0.30,
            );
        let cushion = cushion.mottled(0.08, 0.015);
        scene.cuboid(
            "cushion",
            &place,
            [0.42, 0.10, 0.36],
            all_faces(&cushion, 20 + index),
        );
    }
}

/// A floor lamp: foot, pole, shade that glows.
pub(super) fn floor_lamp(scene: &mut SceneBuilder, world_from_lamp: &RigidTransform) {
    let metal = Texture::from(Pattern::Plain(srgb(0x4a443c))).mottled(0.1, 0.02);
    let foot = [metal.clone(), metal.clone(), metal.clone()];
    scene.cylinder(
        "lamp foot",
        world_from_lamp,
        [0.16, 0.15],
        0.03,
        foot.clone(),
    );
    let pole = *world_from_lamp * standing([0.0, 0.0, 0.03], 0.0);
    scene.cylinder("lamp pole", &pole, [0.015, 0.015], 1.42, foot);
    let shade = Texture::from(Pattern::Stripes {
        palette: vec![srgb(0xf6e4b8), srgb(0xeed49c)],
        width_m: 0.04,
        across_v: false,
    })
    .mottled(0.03, 0.02)
    .luminous();
    let place = *world_from_lamp * standing([0.0, 0.0, 1.42], 0.0);
    let glow = plain(0xfff4d8).luminous();
    scene.cylinder(
        "lamp shade",
        &place,
        [0.24, 0.15],
        0.30,
        [shade, glow.clone(), glow],
    );
}

/// A plant: pot, stem and three leafy balls.
pub(super) fn plant(scene: &mut SceneBuilder, world_from_plant: &RigidTransform, size: f64) {
    let pot = Texture::from(Pattern::Stripes {
        palette: vec![srgb(0xb85c38), srgb(0xb85c38), srgb(0xe0b890)],
        width_m: 0.05 * size,
        across_v: true,
    })
    .mottled(0.1, 0.02);
    let soil = Texture::from(Pattern::Plain(srgb(0x3a2a1c))).mottled(0.4, 0.02);
    let pot_m = 0.30 * size;
    scene.cylinder(
        "pot",
        world_from_plant,
        [0.11 * size, 0.15 * size],
        pot_m,
        [pot, soil, plain(0x804028)],
    );
    let at =
        |x: f64, y: f64, z: f64| *world_from_plant * standing([x * size, y * size, z * size], 0.4);
    let bark = wood([0x7a5a38, 0x4a321c], 0.02, true);
    let stem = at(0.0, 0.0, 0.30);
    scene.cylinder(
        "stem",
        &stem,
        [0.025 * size, 0.02 * size],
        0.35 * size,
        [bark.clone(), bark.clone(), bark],
    );
    let balls = [
        ([0.0, 0.0, 0.55], 0.24),
        ([0.14, 0.06, 0.82], 0.17),
        ([-0.13, -0.08, 0.78], 0.19),
    ];
    for (salt, ([x, y, z], radius)) in (0..).zip(balls) {
        let leaves = Texture::from(Pattern::Flecks {
            ground: srgb(0x2a582a),
            fleck: srgb(0x8ab84a),
            cell_m: 0.03,
        })
        .mottled(0.2, 0.012)
        .salted(salt);
        scene.ball("leaves", &at(x, y, z), radius * size, leaves);
    }
}
