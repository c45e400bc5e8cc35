//! A cluttered table-top, 1.2 × 0.8 m, in a plain studio; z up, the origin on the floor under the
//! table's middle.

use std::f64::consts::PI;

use nalgebra::{Point3, Vector3};

use crate::geom::RigidTransform;
use crate::synth::hash::Stream;
use crate::synth::light::Lighting;
use crate::synth::texture::{Pattern, Texture, srgb};

use super::furniture::wooden;
use super::still_life::{carton, lying_book, mug, plain, tin};
use super::{Scene, SceneBuilder, art, print, standing};

const TOP_M: f64 = 0.74;
const PIXEL_M: f64 = 0.0005;

pub(in crate::synth) fn build(seed: u64) -> Scene {
    let mut scene = SceneBuilder::new(Stream::new(seed, "tabletop"));
    studio(&mut scene);
    table(&mut scene);
    boxes_and_tins(&mut scene);
    books(&mut scene);
    crockery(&mut scene);
    toys(&mut scene);
    scene.finish(&lighting(), 0.01, waypoints())
}

fn lighting() -> Lighting {
    Lighting {
        ambient: [0.60, 0.62, 0.66],
        ambient_reach_m: 0.30,
        bounce: [0.08, 0.07, 0.05],
        lamp: [0.62, 0.58, 0.52],
        lamp_center_m: Point3::new(-0.9, -0.5, 2.1),
        lamp_axes_m: [Vector3::x() * 0.35, Vector3::y() * 0.35],
        cell_m: 0.018,
    }
}

/// Once around at arm's length, then over the table from one side to the other, near.
fn waypoints() -> Vec<[[f64; 3]; 2]> {
    let mut points = Vec::new();
    let num = 12;
    for k in 0..num {
        let angle = 2.0 * PI * f64::from(k) / f64::from(num) - 0.5 * PI;
        let (sin, cos) = angle.sin_cos();
        let eye = [
            0.95 * cos,
            0.80 * sin,
            TOP_M + 0.52 + 0.06 * (3.0 * angle).sin(),
        ];
        points.push([eye, [0.14 * cos, 0.08 * sin, TOP_M + 0.02]]);
    }
    for [x, y, tx, ty] in [
        [0.05, -0.62, 0.0, -0.1],
        [0.40, -0.42, 0.30, 0.0],
        [0.20, -0.30, 0.05, 0.02],
        [-0.30, -0.35, -0.30, 0.0],
        [-0.20, 0.45, -0.2, 0.05],
        [0.35, 0.40, 0.25, 0.05],
    ] {
        points.push([[x, y, TOP_M + 0.62], [tx, ty, TOP_M]]);
    }
    points
}

fn studio(scene: &mut SceneBuilder) {
    let half = 1.6;
    let h = 1.45;
    let world = RigidTransform::identity();
    scene.set_edge_scale(8.0);
    scene.begin_body();
    let tiles = Texture::from(Pattern::Tiles {
        palette: [0xa8a49c, 0xb4b0a6, 0x9c9892].map(srgb).to_vec(),
        grout: srgb(0x74706a),
        size_m: [0.30, 0.30],
        grout_m: 0.012,
        stagger: 0.0,
        variation: 0.04,
    })
    .mottled(0.06, 0.03);
    let side = 2.0 * half;
    scene.rect(
        "floor",
        &world,
        [[-half, half, 0.0], [1.0, 0.0, 0.0], [0.0, -1.0, 0.0]],
        [side; 2],
        tiles,
    );
    let wall = || {
        Texture::from(Pattern::Gradient {
            from: srgb(0xd8dce0),
            to: srgb(0x9aa8b4),
            height_m: h,
        })
        .mottled(0.02, 0.04)
    };
    let down = [0.0, 0.0, -1.0];
    scene.rect(
        "north wall",
        &world,
        [[-half, half, h], [1.0, 0.0, 0.0], down],
        [side, h],
        wall(),
    );
    scene.rect(
        "south wall",
        &world,
        [[half, -half, h], [-1.0, 0.0, 0.0], down],
        [side, h],
        wall(),
    );
    scene.rect(
        "east wall",
        &world,
        [[half, half, h], [0.0, -1.0, 0.0], down],
        [side, h],
        wall(),
    );
    scene.rect(
        "west wall",
        &world,
        [[-half, -half, h], [0.0, 1.0, 0.0], down],
        [side, h],
        wall(),
    );
    scene.set_edge_scale(1.0);
}

fn table(scene: &mut SceneBuilder) {
    let [w, d, h] = [1.2, 0.8, 0.035];
    let top = Texture::from(Pattern::Wood {
        light: srgb(0xd8ae74),
        dark: srgb(0x9c6e3c),
        ring_m: 0.022,
        along_v: false,
        plank_m: Some([1.3, 0.16]),
    })
    .salted(9)
    .with_decal(
        [0.70, 0.42, 0.21, 0.297],
        Pattern::Picture(print::printed_page([0.21, 0.297], PIXEL_M, "ON TEXTURE")),
    )
    .with_decal([0.06, 0.48, 0.24, 0.24], checkerboard())
    .with_decal(
        [0.93, 0.60, 0.148, 0.105],
        Pattern::Picture(art::landscape([0.148, 0.105], PIXEL_M)),
    )
    .with_decal(
        [0.34, 0.60, 0.148, 0.105],
        Pattern::Picture(art::color_chart([0.148, 0.105], PIXEL_M)),
    );
    let edge = |along_v: bool| {
        Texture::from(Pattern::Wood {
            light: srgb(0xc89c62),
            dark: srgb(0x8c6032),
            ring_m: 0.012,
            along_v,
            plank_m: None,
        })
    };
    let faces = [
        edge(false),
        edge(false),
        edge(false),
        edge(false),
        top,
        edge(false),
    ];
    scene.cuboid(
        "table top",
        &standing([0.0, 0.0, TOP_M - h], 0.0),
        [w, d, h],
        faces,
    );
    scene.set_edge_scale(4.0);
    for (salt, [sx, sy]) in (10..).zip([[-1.0, -1.0], [1.0, -1.0], [-1.0, 1.0], [1.0, 1.0]]) {
        let foot = standing([sx * 0.52, sy * 0.32, 0.0], 0.0);
        wooden(
            scene,
            "table leg",
            &foot,
            [0.06, 0.06, TOP_M - h],
            [0xb88a54, 0x80562c],
            salt,
        );
    }
    scene.set_edge_scale(1.0);
}

fn checkerboard() -> Texture {
    let squares = Pattern::Checks {
        colors: [srgb(0x18181a), srgb(0xf4f4f0)],
        size_m: 0.025,
    };
    Texture::from(Pattern::Plain(srgb(0xf4f4f0))).with_decal([0.02, 0.02, 0.20, 0.20], squares)
}

fn on_table(x: f64, y: f64, yaw_rad: f64) -> RigidTransform {
    standing([x, y, TOP_M], yaw_rad)
}

fn boxes_and_tins(scene: &mut SceneBuilder) {
    let cereal = (
        [0xf2c23a, 0xc83428, 0x381a10],
        ["CRUNCH", "golden flakes 375 g"],
    );
    carton(
        scene,
        "cereal",
        &on_table(-0.38, 0.24, 0.25),
        [0.19, 0.07, 0.27],
        cereal,
        PIXEL_M,
    );
    let tea = (
        [0x1e5048, 0xe0c068, 0xf6eccc],
        ["JASMIN", "green tea 40 bags"],
    );
    carton(
        scene,
        "tea",
        &on_table(-0.13, 0.29, -0.15),
        [0.13, 0.08, 0.09],
        tea,
        PIXEL_M,
    );
    let matches = ([0xc84030, 0xf0d890, 0xfff4d8], ["SPARK", "50"]);
    carton(
        scene,
        "matches",
        &on_table(0.02, -0.30, 0.6),
        [0.055, 0.036, 0.016],
        matches,
        PIXEL_M,
    );
    let soup = ([0xf4eedc, 0xb83028, 0x2a2a2a], ["TOMATO", "condensed soup"]);
    tin(
        scene,
        "soup tin",
        &on_table(0.06, 0.24, 0.9),
        [0.037, 0.11],
        soup,
        PIXEL_M,
    );
    let beans = ([0x2a588a, 0xf0c848, 0xfffff0], ["BEANS", "in brine"]);
    tin(
        scene,
        "bean tin",
        &on_table(0.155, 0.30, 2.0),
        [0.042, 0.085],
        beans,
        PIXEL_M,
    );
    let fish = ([0xe8a030, 0x20405a, 0x142030], ["TUNA", "line caught"]);
    tin(
        scene,
        "flat tin",
        &(on_table(0.155, 0.30, 0.5) * standing([0.0, 0.0, 0.085], 0.0)),
        [0.040, 0.035],
        fish,
        PIXEL_M,
    );
}

fn books(scene: &mut SceneBuilder) {
    let sizes = [
        [0.19, 0.25, 0.032],
        [0.16, 0.23, 0.026],
        [0.13, 0.19, 0.022],
    ];
    let mut z = 0.0;
    for (index, (size, yaw)) in sizes.into_iter().zip([0.15, -0.22, 0.5]).enumerate() {
        let at = on_table(0.42, 0.17, yaw) * standing([0.0, 0.0, z], 0.0);
        lying_book(
            scene,
            &format!("book {index}"),
            &at,
            size,
            [1, 3, 7][index],
            PIXEL_M,
        );
        z += size[2];
    }
}

fn crockery(scene: &mut SceneBuilder) {
    let rings = Texture::from(Pattern::Stripes {
        palette: [0xf6f2ea, 0xf6f2ea, 0x286098, 0xf6f2ea, 0xc84838]
            .map(srgb)
            .to_vec(),
        width_m: 0.012,
        across_v: true,
    });
    mug(
        scene,
        "mug",
        &on_table(0.03, 0.06, -0.6),
        [0.042, 0.095],
        rings,
        0xf6f2ea,
    );
    let dots = Texture::from(Pattern::Dots {
        ground: srgb(0x2c7060),
        dot: srgb(0xf0e8d0),
        pitch_m: 0.022,
        radius_m: 0.006,
    });
    mug(
        scene,
        "dotted mug",
        &on_table(-0.20, 0.10, 2.4),
        [0.038, 0.088],
        dots,
        0x2c7060,
    );
    let vase = Texture::from(Pattern::Flecks {
        ground: srgb(0xd8ccb4),
        fleck: srgb(0x5a6a7a),
        cell_m: 0.010,
    });
    scene.cylinder(
        "vase",
        &on_table(0.27, 0.03, 0.0),
        [0.030, 0.052],
        0.17,
        [vase, plain(0x302822), plain(0x8a8070)],
    );
}

fn toys(scene: &mut SceneBuilder) {
    let ball = Texture::from(Pattern::Stripes {
        palette: [0xd83430, 0xf8f4ea, 0x2a6cb8, 0xf8f4ea, 0xe8b428, 0xf8f4ea]
            .map(srgb)
            .to_vec(),
        width_m: PI * 0.065 / 6.0,
        across_v: false,
    })
    .mottled(0.03, 0.01);
    scene.ball("ball", &on_table(-0.47, 0.02, 0.3), 0.065, ball);
    let globe = Pattern::Picture(art::globe_map(0.055, PIXEL_M));
    scene.ball("globe", &on_table(0.50, -0.05, 1.0), 0.055, globe.into());
    let cube: super::Faces = std::array::from_fn(|face| {
        #[expect(clippy::cast_possible_truncation, reason = "six faces")]
        let salt = face as u32 + 3;
        Texture::from(Pattern::Tiles {
            palette: [0xd02828, 0x2050b0, 0x288a40, 0xf0d020, 0xf4f4f0, 0xe87820]
                .map(srgb)
                .to_vec(),
            grout: srgb(0x141414),
            size_m: [0.019, 0.019],
            grout_m: 0.003,
            stagger: 0.0,
            variation: 0.0,
        })
        .salted(salt)
    });
    scene.cuboid(
        "puzzle cube",
        &on_table(-0.09, -0.07, 0.5),
        [0.057; 3],
        cube,
    );
    let rule = Texture::from(Pattern::Tiles {
        palette: vec![srgb(0xe8c850)],
        grout: srgb(0x3a2a10),
        size_m: [0.010, 0.05],
        grout_m: 0.002,
        stagger: 0.0,
        variation: 0.0,
    });
    let side = plain(0xd8b840);
    let faces = [
        side.clone(),
        side.clone(),
        side.clone(),
        side.clone(),
        rule,
        side,
    ];
    scene.cuboid(
        "ruler",
        &on_table(-0.12, -0.22, -0.25),
        [0.20, 0.03, 0.006],
        faces,
    );
    for (index, (y, color)) in [(-0.13, 0xd04038), (-0.16, 0x3070b0), (-0.19, 0x3a8a48)]
        .into_iter()
        .enumerate()
    {
        let at = on_table(0.42, y, 0.2 - 0.15 * index as f64);
        let faces = super::all_faces(&plain(color), 0);
        scene.cuboid("pencil", &at, [0.16, 0.009, 0.009], faces);
    }
}
