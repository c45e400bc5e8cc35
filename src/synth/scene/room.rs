//! A furnished living room of 5 × 4 × 2.5 m, z up, the floor's south-west corner at the origin.

use std::f64::consts::{FRAC_PI_2, PI};

use nalgebra::{Point3, Vector3};

use crate::geom::RigidTransform;
use crate::synth::hash::Stream;
use crate::synth::light::Lighting;
use crate::synth::texture::{Pattern, Texture, srgb};

use super::furniture::{bookshelf, chair, floor_lamp, plant, sofa, table, wooden};
use super::still_life::{carton, lying_book, mug, plain, tin};
use super::{Scene, SceneBuilder, all_faces, art, print, standing, tilted};

const SIZE_M: [f64; 3] = [5.0, 4.0, 2.5];
const PIXEL_M: f64 = 0.0015;

/// Builds the room; the seed chooses books and the salt of every texture stays fixed.
pub(in crate::synth) fn build(seed: u64) -> Scene {
    let mut scene = SceneBuilder::new(Stream::new(seed, "room"));
    shell(&mut scene);
    dining(&mut scene);
    let random = scene.random;
    let shelf = standing([0.16, 2.05, 0.0], FRAC_PI_2);
    bookshelf(&mut scene, &shelf, [1.5, 0.30, 1.95], 6, random);
    let globe = standing([0.18, 1.75, 1.95], 0.4);
    let map = art::globe_map(0.14, PIXEL_M);
    scene.ball("globe", &globe, 0.14, Pattern::Picture(map).into());
    sofa(&mut scene, &standing([3.35, 3.555, 0.0], 0.0), 2.0);
    floor_lamp(&mut scene, &standing([4.68, 3.65, 0.0], 0.0));
    plant(&mut scene, &standing([0.45, 3.55, 0.0], 0.3), 1.0);
    coffee_table(&mut scene);
    sideboard(&mut scene);
    scene.finish(&lighting(), 0.05, waypoints())
}

fn lighting() -> Lighting {
    Lighting {
        ambient: [0.62, 0.64, 0.68],
        ambient_reach_m: 0.9,
        bounce: [0.26, 0.24, 0.20],
        lamp: [0.62, 0.58, 0.52],
        lamp_center_m: Point3::new(2.7, 1.9, 2.38),
        lamp_axes_m: [Vector3::x() * 1.1, Vector3::y() * 0.9],
        cell_m: 0.06,
    }
}

/// Two turns around the middle of the room, the first looking a little down, the second up, then
/// a closer look at the dining table and the sofa's corner.
fn waypoints() -> Vec<[[f64; 3]; 2]> {
    let mut points = Vec::new();
    let centre = [2.45, 2.05];
    let rings = [
        // (number of looks, height of eye and target, reach of the target)
        (14, 1.50, 0.55, 1.9),
        (14, 1.45, 1.75, 2.2),
    ];
    for (num, eye_z, target_z, reach) in rings {
        for k in 0..num {
            let angle = 2.0 * PI * f64::from(k) / f64::from(num) + 0.3;
            let (sin, cos) = angle.sin_cos();
            // The eye is on the far side of the middle from what it looks at: more is in view.
            let eye = [centre[0] - 0.95 * cos, centre[1] - 0.55 * sin, eye_z];
            points.push([
                eye,
                [centre[0] + reach * cos, centre[1] + reach * sin, target_z],
            ]);
        }
    }
    points.push([[2.4, 1.9, 1.55], [1.9, 0.9, 0.75]]);
    points.push([[2.3, 1.7, 1.65], [1.5, 1.0, 0.75]]);
    points.push([[2.5, 2.0, 1.55], [2.6, 2.9, 2.45]]);
    points.push([[2.7, 2.1, 1.35], [3.6, 3.4, 0.6]]);
    points.push([[3.0, 2.0, 1.45], [2.6, 2.2, 0.1]]);
    points
}

fn shell(scene: &mut SceneBuilder) {
    let [w, d, h] = SIZE_M;
    let world = RigidTransform::identity();
    scene.begin_body();
    let floor = Texture::from(Pattern::Wood {
        light: srgb(0xd2a870),
        dark: srgb(0x986a3a),
        ring_m: 0.045,
        along_v: false,
        plank_m: Some([1.15, 0.14]),
    })
    .salted(5)
    .with_decal(
        [1.55, 1.15, 2.0, 1.4],
        Pattern::Picture(art::rug([2.0, 1.4], PIXEL_M)),
    );
    scene.rect(
        "floor",
        &world,
        [[0.0, d, 0.0], [1.0, 0.0, 0.0], [0.0, -1.0, 0.0]],
        [w, d],
        floor,
    );
    let ceiling = Texture::from(Pattern::Plain(srgb(0xf2f0ea)))
        .mottled(0.025, 0.03)
        .with_decal([1.6, 1.0, 2.2, 1.8], ceiling_light());
    scene.rect(
        "ceiling",
        &world,
        [[0.0, 0.0, h], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]],
        [w, d],
        ceiling,
    );
    let down = [0.0, 0.0, -1.0];
    scene.rect(
        "north wall",
        &world,
        [[0.0, d, h], [1.0, 0.0, 0.0], down],
        [w, h],
        north_wall(w, h),
    );
    scene.rect(
        "south wall",
        &world,
        [[w, 0.0, h], [-1.0, 0.0, 0.0], down],
        [w, h],
        south_wall(w, h),
    );
    scene.rect(
        "east wall",
        &world,
        [[w, d, h], [0.0, -1.0, 0.0], down],
        [d, h],
        east_wall(d, h),
    );
    scene.rect(
        "west wall",
        &world,
        [[0.0, 0.0, h], [0.0, 1.0, 0.0], down],
        [d, h],
        west_wall(d, h),
    );
}

fn ceiling_light() -> Texture {
    Texture::from(Pattern::Tiles {
        palette: vec![srgb(0xfdfbf4)],
        grout: srgb(0xc8c8c4),
        size_m: [0.55, 0.45],
        grout_m: 0.02,
        stagger: 0.0,
        variation: 0.0,
    })
    .luminous()
}

fn skirting(wall: Texture, width_m: f64, height_m: f64) -> Texture {
    let board = Texture::from(Pattern::Gradient {
        from: srgb(0xf2eee6),
        to: srgb(0xc8c2b6),
        height_m: 0.09,
    });
    wall.with_decal([0.0, height_m - 0.09, width_m, 0.09], board)
}

fn hung(
    wall: Texture,
    [x, y, w, h]: [f64; 4],
    picture: std::sync::Arc<super::super::picture::Picture>,
) -> Texture {
    // A soft shadow below and beside, then the picture.
    wall.with_decal([x + 0.01, y + 0.015, w, h], plain(0x9a9488))
        .with_decal([x, y, w, h], Pattern::Picture(picture))
}

fn north_wall(w: f64, h: f64) -> Texture {
    let wall = skirting(
        Texture::from(Pattern::Plain(srgb(0xd6cfbd))).mottled(0.03, 0.025),
        w,
        h,
    );
    let wall = hung(
        wall,
        [2.1, 0.62, 0.60, 0.80],
        art::geometric_poster([0.60, 0.80], PIXEL_M),
    );
    let wall = hung(
        wall,
        [2.85, 0.62, 1.10, 0.75],
        art::landscape([1.10, 0.75], PIXEL_M),
    );
    let wall = hung(
        wall,
        [4.1, 0.62, 0.55, 0.75],
        art::grid_painting([0.55, 0.75], PIXEL_M),
    );
    hung(
        wall,
        [1.0, 0.55, 0.75, 1.05],
        art::eye_chart([0.75, 1.05], PIXEL_M),
    )
}

fn south_wall(w: f64, h: f64) -> Texture {
    let paper = Texture::from(Pattern::Stripes {
        palette: vec![srgb(0x9cb4b0), srgb(0x8ca6a4)],
        width_m: 0.10,
        across_v: false,
    })
    .mottled(0.025, 0.02);
    let wall = skirting(paper, w, h);
    let wall = wall.with_decal(
        [0.35, h - 2.05, 0.90, 2.05],
        Pattern::Picture(art::door([0.90, 2.05], PIXEL_M)),
    );
    let wall = hung(
        wall,
        [1.55, 0.62, 0.95, 0.68],
        art::transit_map([0.95, 0.68], PIXEL_M),
    );
    let wall = hung(
        wall,
        [2.85, 0.60, 0.50, 0.60],
        art::calendar([0.50, 0.60], PIXEL_M),
    );
    hung(
        wall,
        [3.75, 0.70, 0.75, 0.52],
        art::color_chart([0.75, 0.52], PIXEL_M),
    )
}

fn east_wall(d: f64, h: f64) -> Texture {
    let wall = skirting(
        Texture::from(Pattern::Plain(srgb(0xe0d8c6))).mottled(0.03, 0.025),
        d,
        h,
    );
    let view = Texture::from(Pattern::Picture(art::window_view([1.6, 1.35], 0.002))).luminous();
    let curtain = || {
        Texture::from(Pattern::Stripes {
            palette: vec![
                srgb(0xa84838),
                srgb(0xba5c48),
                srgb(0xc87058),
                srgb(0xb25040),
            ],
            width_m: 0.035,
            across_v: false,
        })
    };
    wall.with_decal([1.2, 0.38, 1.6, 1.35], view)
        .with_decal([0.85, 0.30, 0.35, 1.75], curtain())
        .with_decal([2.80, 0.30, 0.35, 1.75], curtain())
        .with_decal([0.75, 0.25, 2.5, 0.05], plain(0x5a422a))
}

fn west_wall(d: f64, h: f64) -> Texture {
    let brick = Texture::from(Pattern::Tiles {
        palette: [0xa85842, 0x9a4c3a, 0xb4684e, 0x8c483a].map(srgb).to_vec(),
        grout: srgb(0xc8bca8),
        size_m: [0.22, 0.075],
        grout_m: 0.012,
        stagger: 0.5,
        variation: 0.10,
    })
    .mottled(0.12, 0.02);
    let clock = Pattern::Picture(art::clock_face(0.36, PIXEL_M));
    skirting(brick, d, h).with_decal([0.62, 0.5, 0.36, 0.36], clock)
}

fn dining(scene: &mut SceneBuilder) {
    let oak = [0xc89458, 0x8a5c30];
    let place = standing([1.55, 0.85, 0.0], 0.0);
    table(scene, &place, [1.4, 0.8, 0.74], oak);
    chair(scene, &standing([1.15, 1.45, 0.0], 0.12), 1, 0x30588a);
    chair(scene, &standing([2.00, 1.50, 0.0], -0.2), 2, 0x8a3038);
    chair(
        scene,
        &standing([2.55, 0.80, 0.0], -FRAC_PI_2 + 0.1),
        3,
        0x307a50,
    );
    let on_table = |x: f64, y: f64, yaw: f64| place * standing([x, y, 0.74], yaw);
    let glaze = Texture::from(Pattern::Stripes {
        palette: [0xf4f0e8, 0x2a6a9a].map(srgb).to_vec(),
        width_m: 0.016,
        across_v: true,
    });
    mug(
        scene,
        "mug",
        &on_table(-0.35, 0.15, 0.5),
        [0.042, 0.10],
        glaze,
        0xf4f0e8,
    );
    lying_book(
        scene,
        "atlas",
        &on_table(0.05, -0.05, 0.3),
        [0.24, 0.31, 0.035],
        1,
        PIXEL_M,
    );
    lying_book(
        scene,
        "novel",
        &(on_table(0.05, -0.05, -0.2) * standing([0.0, 0.0, 0.035], 0.0)),
        [0.15, 0.21, 0.03],
        3,
        0.001,
    );
    let cereal = ([0xf0b428, 0xc03828, 0x401c10], ["OATS", "with honey 500 g"]);
    carton(
        scene,
        "carton",
        &on_table(0.45, 0.15, -0.35),
        [0.19, 0.07, 0.28],
        cereal,
        0.001,
    );
    tin(
        scene,
        "tin",
        &on_table(-0.1, 0.22, 1.0),
        [0.05, 0.12],
        ([0xf2ecda, 0xc83830, 0x284028], ["TOMATO", "peeled"]),
        0.001,
    );
    let orange = Texture::from(Pattern::Plain(srgb(0xe88820))).mottled(0.10, 0.008);
    for (index, [x, y]) in [[-0.52, -0.1], [-0.44, -0.16], [-0.45, -0.05]]
        .into_iter()
        .enumerate()
    {
        scene.ball(
            &format!("orange {index}"),
            &on_table(x, y, 0.0),
            0.04,
            orange.clone(),
        );
    }
}

fn coffee_table(scene: &mut SceneBuilder) {
    let place = standing([3.3, 2.45, 0.0], 0.05);
    let walnut = [0x8a5e3a, 0x5a3820];
    wooden(
        scene,
        "coffee table top",
        &(place * standing([0.0, 0.0, 0.36], 0.0)),
        [0.9, 0.5, 0.04],
        walnut,
        90,
    );
    for (salt, x) in (91..).zip([-0.38, 0.38]) {
        wooden(
            scene,
            "coffee table side",
            &(place * standing([x, 0.0, 0.0], 0.0)),
            [0.04, 0.46, 0.36],
            walnut,
            salt,
        );
    }
    let page = Pattern::Picture(print::printed_page([0.30, 0.42], 0.0012, "THE DAILY ATLAS"));
    let sheet = Texture::from(Pattern::Plain(srgb(0xf4f0e6)));
    let faces = [
        sheet.clone(),
        sheet.clone(),
        sheet.clone(),
        sheet.clone(),
        page.into(),
        sheet,
    ];
    scene.cuboid(
        "newspaper",
        &(place * standing([-0.2, 0.0, 0.40], 0.25)),
        [0.30, 0.42, 0.012],
        faces,
    );
    let bowl = Texture::from(Pattern::Dots {
        ground: srgb(0xe8e4da),
        dot: srgb(0x2a588a),
        pitch_m: 0.035,
        radius_m: 0.010,
    });
    scene.cylinder(
        "bowl",
        &(place * standing([0.2, 0.05, 0.40], 0.0)),
        [0.06, 0.13],
        0.08,
        [bowl, plain(0xd8d2c2), plain(0xe8e4da)],
    );
}

fn sideboard(scene: &mut SceneBuilder) {
    let place = standing([4.77, 1.3, 0.0], -FRAC_PI_2);
    let ash = [0xe0cca8, 0xb89868];
    wooden(scene, "sideboard", &place, [1.5, 0.42, 0.62], ash, 110);
    let screen = Pattern::Picture(print::screen([0.34, 0.23], 0.001, scene.random));
    let keys = Pattern::Picture(print::keyboard([0.34, 0.23], 0.001));
    let grey = plain(0xb9bcc2);
    let sides = || all_faces(&grey, 0);
    let mut deck = sides();
    deck[4] = keys.into();
    let laptop = place * standing([-0.35, -0.04, 0.62], -0.15);
    scene.cuboid("laptop", &laptop, [0.34, 0.23, 0.018], deck);
    let mut lid = sides();
    lid[0] = Texture::from(screen).luminous();
    let hinge = laptop * tilted([0.0, 0.12, 0.018], 0.0, -0.28);
    scene.cuboid("laptop lid", &hinge, [0.34, 0.012, 0.23], lid);
    let parcel = ([0xb88e5a, 0x8a6438, 0x3a2818], ["FRAGILE", "this side up"]);
    carton(
        scene,
        "parcel",
        &(place * standing([0.25, 0.0, 0.62], 0.2)),
        [0.32, 0.24, 0.22],
        parcel,
        PIXEL_M,
    );
    let tea = ([0x2a5a48, 0xe8d080, 0xf4eac8], ["TEA", "first flush"]);
    tin(
        scene,
        "caddy",
        &(place * standing([0.56, 0.02, 0.62], 0.0)),
        [0.06, 0.16],
        tea,
        0.001,
    );
    let pouf = Texture::from(Pattern::Checks {
        colors: [srgb(0xd8c8a8), srgb(0x5a788a)],
        size_m: 0.05,
    })
    .mottled(0.08, 0.02);
    scene.cylinder(
        "pouf",
        &standing([4.1, 0.55, 0.0], 0.0),
        [0.26, 0.26],
        0.40,
        [pouf.clone(), pouf.clone(), pouf],
    );
}
