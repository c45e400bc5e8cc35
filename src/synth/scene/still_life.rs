//! Small things that stand on tables and shelves.

use std::f64::consts::TAU;

use crate::geom::RigidTransform;
use crate::synth::texture::{Pattern, Texture, srgb};

use super::{SceneBuilder, all_faces, print, standing};

/// Colours and words of a label: ground, accent, ink; title, line.
pub(super) type LabelText<'a> = ([u32; 3], [&'a str; 2]);

/// Cover and ink colours of books.
const BOOK_COLORS: [[u32; 2]; 10] = [
    [0x8c2a2a, 0xf0dca0],
    [0x1f3c64, 0xe8e8e8],
    [0x2e5c3e, 0xf0e6b0],
    [0xd88a24, 0x2a1c10],
    [0xe6decc, 0x6a1c1c],
    [0x4a2e5e, 0xe8d8f0],
    [0x202024, 0xe0b040],
    [0x2f7f86, 0xf4f4ea],
    [0xb84c5a, 0xfff4e0],
    [0x6a4a2c, 0xf0e0b8],
];

const BOOK_TITLES: [&str; 31] = [
    "ATLAS",
    "OPTICS",
    "Meshes",
    "Gardens",
    "ROME",
    "Rivers II",
    "COLOUR",
    "Light",
    "Birds",
    "GEOMETRY",
    "Tea",
    "Signals",
    "The Quay",
    "POEMS",
    "Maps",
    "Stone",
    "Winter",
    "ALGEBRA",
    "On Walking",
    "Bridges",
    "SEA",
    "Clocks",
    "A Short Hill",
    "PAPER",
    "Moths",
    "Letters",
    "ORCHARD",
    "Tides",
    "The Lamp",
    "MUSIC",
    "Bread",
];

pub(super) fn plain(color: u32) -> Texture {
    Pattern::Plain(srgb(color)).into()
}

/// A printed carton.
pub(super) fn carton(
    scene: &mut SceneBuilder,
    name: &str,
    world_from_box: &RigidTransform,
    [w, d, h]: [f64; 3],
    (colors, words): LabelText<'_>,
    pixel_m: f64,
) {
    let front = |width: f64| {
        Texture::from(Pattern::Picture(
            print::label([width, h], pixel_m, colors, words).finish(),
        ))
    };
    let stripes = Texture::from(Pattern::Stripes {
        palette: vec![srgb(colors[0]), srgb(colors[1])],
        width_m: d / 5.0,
        across_v: false,
    });
    let faces = [
        front(w),
        front(w),
        front(d),
        front(d),
        stripes,
        plain(colors[0]),
    ];
    scene.cuboid(name, world_from_box, [w, d, h], faces);
}

/// A tin with a wrapped label.
pub(super) fn tin(
    scene: &mut SceneBuilder,
    name: &str,
    world_from_tin: &RigidTransform,
    [radius_m, height_m]: [f64; 2],
    (colors, words): LabelText<'_>,
    pixel_m: f64,
) {
    let label = print::wrapped_label([TAU * radius_m, height_m], pixel_m, colors, words);
    let lid = Texture::from(Pattern::Plain(srgb(0xb8babc))).mottled(0.08, 0.012);
    let ring = lid.clone().with_decal(
        [
            0.6 * radius_m,
            0.6 * radius_m,
            0.8 * radius_m,
            0.8 * radius_m,
        ],
        Pattern::Stripes {
            palette: vec![srgb(0xa4a6aa), srgb(0xc8cacc)],
            width_m: 0.2 * radius_m,
            across_v: true,
        },
    );
    scene.cylinder(
        name,
        world_from_tin,
        [radius_m, radius_m],
        height_m,
        [Pattern::Picture(label).into(), ring, lid],
    );
}

/// A mug: outside, inside, rim, what is in it, and a handle.
pub(super) fn mug(
    scene: &mut SceneBuilder,
    name: &str,
    world_from_mug: &RigidTransform,
    [radius_m, height_m]: [f64; 2],
    outside: Texture,
    glaze: u32,
) {
    let inner_m = radius_m * 0.9;
    let level_m = height_m * 0.78;
    scene.begin_body();
    scene.mantle(
        name,
        world_from_mug,
        [radius_m; 2],
        [0.0, height_m],
        false,
        outside,
    );
    scene.underside(name, world_from_mug, radius_m, plain(glaze));
    scene.mantle(
        name,
        world_from_mug,
        [inner_m; 2],
        [level_m, height_m],
        true,
        plain(glaze),
    );
    let rim = format!("{name} rim");
    scene.disc(
        rim,
        world_from_mug,
        height_m,
        [radius_m, inner_m],
        plain(glaze),
    );
    let content = format!("{name} content");
    scene.disc(
        content,
        world_from_mug,
        level_m,
        [inner_m, 0.0],
        plain(0x3a1e10),
    );
    scene.solid_cylinder(world_from_mug, radius_m, level_m);
    let grip = all_faces(&plain(glaze), 3);
    let reach = radius_m * 0.62;
    let bar = radius_m * 0.24;
    for (index, z) in [0.25 * height_m, 0.75 * height_m].into_iter().enumerate() {
        let at = *world_from_mug * standing([radius_m + reach / 2.0 - 0.001, 0.0, z], 0.0);
        scene.cuboid(
            &format!("{name} handle {index}"),
            &at,
            [reach, bar, bar],
            grip.clone(),
        );
    }
    let at = *world_from_mug
        * standing(
            [radius_m + reach - bar / 2.0, 0.0, 0.25 * height_m + bar],
            0.0,
        );
    scene.cuboid(
        &format!("{name} handle"),
        &at,
        [bar, bar, 0.5 * height_m - bar],
        grip,
    );
}

/// A closed book lying on its back cover: width (spine to edge), depth (along the spine),
/// thickness.
pub(super) fn lying_book(
    scene: &mut SceneBuilder,
    name: &str,
    world_from_book: &RigidTransform,
    [w, d, h]: [f64; 3],
    index: usize,
    pixel_m: f64,
) {
    let [ground, ink] = BOOK_COLORS[index % BOOK_COLORS.len()];
    let title = BOOK_TITLES[index % BOOK_TITLES.len()];
    let cover = print::label(
        [w, d],
        pixel_m,
        [ground, ink, ink],
        [title, "a veneer book"],
    )
    .finish();
    let pages = pages_texture(false);
    // Seen from the left, right is −y: the spine's picture lies on its side there.
    let back = print::label([d, h], pixel_m, [ground, ink, ink], ["", ""]).finish();
    let faces = [
        pages.clone(),
        pages.clone(),
        Pattern::Picture(back).into(),
        pages,
        Pattern::Picture(cover).into(),
        plain(ground),
    ];
    scene.cuboid(name, world_from_book, [w, d, h], faces);
}

/// A book standing on its foot with its spine to the front (−y): thickness, depth, height.
pub(super) fn standing_book(
    scene: &mut SceneBuilder,
    name: &str,
    world_from_book: &RigidTransform,
    [w, d, h]: [f64; 3],
    index: usize,
    pixel_m: f64,
) {
    let [ground, ink] = BOOK_COLORS[index % BOOK_COLORS.len()];
    let title = BOOK_TITLES[index / 7 % BOOK_TITLES.len()];
    let spine = print::spine([w, h], pixel_m, srgb(ground), srgb(ink), title);
    let cover = Texture::from(Pattern::Plain(srgb(ground))).mottled(0.06, 0.01);
    let faces = [
        Pattern::Picture(spine).into(),
        pages_texture(true),
        cover.clone(),
        cover.clone(),
        pages_texture(true),
        cover,
    ];
    scene.cuboid(name, world_from_book, [w, d, h], faces);
}

/// The edges of the pages.
fn pages_texture(is_standing: bool) -> Texture {
    Texture::from(Pattern::Stripes {
        palette: vec![srgb(0xf0ead8), srgb(0xdcd2b8)],
        width_m: 0.004,
        across_v: !is_standing,
    })
}
