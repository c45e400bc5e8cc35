//! The robustness corpus: whatever the mesh, TexInit makes a texture, every finite face has its
//! place, no texel has two owners, the time is bounded and the thread count changes nothing.
//!
//! Each mesh ([`meshes`]) goes through all of `texinit()` in both modes, with frames from three
//! sides. Who owns a texel is judged twice: by the product's own check and by point-in-triangle
//! tests in f64 that share nothing with it ([`crate::claims`]). Beyond the fixed meshes, random
//! soups ([`any_soup`]).

#![expect(
    clippy::cast_possible_truncation,
    reason = "the numbers of a test are small"
)]

mod any_soup;
mod meshes;

use std::fmt::Write as _;
use std::sync::Arc;
use std::time::Instant;

use nalgebra::{Matrix3, Point3, Rotation3, UnitQuaternion, Vector3};
use veneer::atlas::{AtlasLayout, PackParams, TexelSource, num_shared_texels};
use veneer::geom::{
    CameraModel, ColorEncoding, DepthEncoding, EncodedColor, EncodedDepth, FrameDepth,
    PinholeCamera, RigidTransform, Stamp,
};
use veneer::keyframe::decoded::LensCache;
use veneer::keyframe::{DecodedFrame, FrameQuality, Keyframe, KeyframeId};
use veneer::mesh::{MeshError, TriMesh};
use veneer::texinit::flatten::{ChartMode, flatten};
use veneer::texinit::overlap::separate;
use veneer::texinit::{Observer, Stage, TexInit, TexInitParams, texinit};

use crate::claims::{claimed_twice_in_plane, claims_by_page};
use meshes::Soup;

/// What all of TexInit may take on one thread of a busy machine, in the test profile (optimised
/// little): so much for pages and frames, so much more per triangle.
const MAX_SECONDS: f64 = 10.0;
const MAX_SECONDS_PER_TRIANGLE: f64 = 1e-3;

macro_rules! corpus {
    ($($name:ident),* $(,)?) => {
        /// Every mesh, by name.
        const CORPUS: &[(&str, fn() -> Soup)] = &[$((stringify!($name), meshes::$name)),*];

        $(
            #[test]
            fn $name() {
                for mode in [ChartMode::Streaming, ChartMode::Paper] {
                    check_soup(&meshes::$name(), &params(mode));
                }
            }
        )*
    };
}

corpus!(
    empty,
    vertices_alone,
    isolated_vertices,
    vertices_not_finite,
    slivers,
    needles,
    books,
    moebius_strip,
    klein_bottle,
    projective_plane,
    roman_surface,
    hourglasses,
    flat_fan,
    ruffled_fan,
    duplicates,
    opposite_faces,
    all_at_one_point,
    all_on_one_line,
    vertices_named_twice,
    far_from_the_origin,
    beyond_precision,
    micrometres,
    mixed_scales,
    astronomic,
    components_of_one_face,
    sphere,
    torus,
    genus_two,
    spiral_ramp,
    crumpled_paper,
    folded_flat,
    random_soup,
    complete_complex,
    tangled_block,
    wrong_unit,
);

fn params(mode: ChartMode) -> TexInitParams {
    let params = match mode {
        ChartMode::Streaming => TexInitParams::default(),
        ChartMode::Paper => TexInitParams::paper(),
    };
    TexInitParams {
        pack: PackParams {
            page_size_texel: 1024,
            max_texels: 1 << 22,
            ..params.pack
        },
        ..params
    }
}

struct Silent;

impl Observer for Silent {
    fn begin(&self, _: Stage, _: usize) {}

    fn advance(&self, _: usize) {}
}

/// Poses beyond this are no poses.
const MAX_CAMERA_M: f64 = 1e9;

/// Three frames that look at the middle of the mesh from three sides, the first with depth.
fn frames(mesh: &TriMesh) -> Vec<Arc<Keyframe>> {
    let used = || {
        let corners = mesh.triangles().iter().flatten();
        corners.map(|&v| mesh.positions_m()[v as usize])
    };
    let mut middle = Point3::origin();
    for axis in 0..3 {
        let low = used().map(|p| p[axis]).fold(f64::INFINITY, f64::min);
        let high = used().map(|p| p[axis]).fold(f64::NEG_INFINITY, f64::max);
        if low <= high {
            middle[axis] = (0.5 * low + 0.5 * high).clamp(-MAX_CAMERA_M, MAX_CAMERA_M);
        }
    }
    let radius = used().map(|p| (p - middle).norm()).fold(0.0, f64::max);
    let distance = 2.0 * radius.clamp(1e-6, MAX_CAMERA_M);
    let sides = [[0.3, 0.2, -1.0], [1.0, -0.4, 0.5], [-0.6, 1.0, 0.7]];
    (0u32..)
        .zip(sides)
        .map(|(id, side)| {
            let eye = middle + distance * Vector3::from(side).normalize();
            Arc::new(frame(id, eye, middle, distance))
        })
        .collect()
}

fn frame(id: u32, eye: Point3<f64>, target: Point3<f64>, distance: f64) -> Keyframe {
    let (width, height) = (120u32, 90u32);
    let forward = (target - eye).normalize();
    let right = forward.cross(&Vector3::new(0.1, 0.2, 1.0)).normalize();
    let axes = Matrix3::from_columns(&[right, forward.cross(&right), forward]);
    let rotation = UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(axes));
    let pinhole = PinholeCamera::new([110.0, 110.0, 59.5, 44.5], width, height).unwrap();
    let pixels = (0..height).flat_map(|y| (0..width).map(move |x| (x, y)));
    let bytes: Vec<u8> = pixels
        .flat_map(|(x, y)| [(2 * x) as u8, (2 * y) as u8, (40 * id + (x ^ y)) as u8])
        .collect();
    let color = EncodedColor::from_raw(
        ColorEncoding::Rgb8,
        width,
        height,
        3 * width,
        Arc::from(bytes),
    );
    let depth = (id == 0).then(|| {
        let depths = vec![distance as f32; (width * height) as usize];
        let bytes: Vec<u8> = depths.iter().flat_map(|d| d.to_le_bytes()).collect();
        let encoding = DepthEncoding::F32M { big_endian: false };
        let image =
            EncodedDepth::from_raw(encoding, width, height, 4 * width, Arc::from(bytes)).unwrap();
        FrameDepth {
            image,
            camera: CameraModel::ideal(pinhole),
            depth_from_color: RigidTransform::identity(),
        }
    });
    Keyframe {
        id: KeyframeId(id),
        stamp: Stamp::from_seconds(f64::from(id)),
        world_from_camera: RigidTransform::from_parts(rotation, eye.coords),
        color: color.unwrap(),
        color_camera: CameraModel::ideal(pinhole),
        depth,
        quality: FrameQuality {
            sharpness: 1.0,
            mean_luma: 0.5,
            clipped: 0.0,
        },
    }
}

fn textured(mesh: &TriMesh, params: &TexInitParams, num_threads: usize) -> TexInit {
    let pool = rayon::ThreadPoolBuilder::new()
        .num_threads(num_threads)
        .build()
        .unwrap();
    let lenses = LensCache::default();
    let decode = |keyframe: &Keyframe| DecodedFrame::decode(keyframe, &lenses).map(Arc::new);
    let frames = frames(mesh);
    let made = pool.install(|| texinit(mesh, &frames, &decode, params, &Silent));
    made.unwrap_or_else(|error| panic!("no texture: {error}"))
}

/// All that the corpus promises of one soup; the seconds that one thread took.
fn check_soup(soup: &Soup, params: &TexInitParams) -> f64 {
    let (mesh, _) = TriMesh::from_soup(soup.positions.clone(), soup.triangles.clone()).unwrap();
    let is_finite = |v: &u32| soup.positions[*v as usize].iter().all(|c| c.is_finite());
    let num_finite = soup.triangles.iter().filter(|t| t.iter().all(is_finite));
    assert_eq!(mesh.num_triangles(), num_finite.count(), "faces were lost");

    let start = Instant::now();
    let made = textured(&mesh, params, 1);
    let seconds = start.elapsed().as_secs_f64();
    let limit = MAX_SECONDS + MAX_SECONDS_PER_TRIANGLE * mesh.num_triangles() as f64;
    assert!(seconds < limit, "{seconds} s of {limit} s");

    let again = textured(&mesh, params, 4);
    assert!(made.layout == again.layout, "layouts of 1 and 4 threads");
    assert!(made.texture == again.texture, "textures of 1 and 4 threads");

    check_every_face_has_its_place(&mesh, &made.layout);
    check_texels(&made);
    let flat = flatten(&mesh, &params.flatten).unwrap().charts;
    let (separated, _) = separate(&mesh, flat, &params.overlap);
    assert_eq!(claimed_twice_in_plane(&separated), 0, "points of a plane");
    seconds
}

fn check_every_face_has_its_place(mesh: &TriMesh, layout: &AtlasLayout) {
    assert_eq!(layout.corners_texel.len(), mesh.num_triangles());
    assert_eq!(layout.chart_of_triangle.len(), mesh.num_triangles());
    let mut is_placed = vec![false; mesh.num_triangles()];
    for (index, chart) in layout.charts.iter().enumerate() {
        assert!(chart.page < layout.num_pages);
        for triangle in &chart.triangles {
            let was_placed = std::mem::replace(&mut is_placed[triangle.index()], true);
            assert!(!was_placed, "{triangle:?} is in two charts");
            assert_eq!(layout.chart_of_triangle[triangle.index()].index(), index);
        }
    }
    assert!(is_placed.iter().all(|p| *p), "a triangle is in no chart");
    for triangle in mesh.triangle_ids() {
        for uv in layout.corners_uv(triangle) {
            let is_on_page = uv.iter().all(|v| (0.0..=1.0).contains(v));
            assert!(is_on_page, "{triangle:?} has a corner at {uv:?}");
        }
    }
}

/// No texel of two triangles, and colour on each that a triangle covers.
fn check_texels(made: &TexInit) {
    made.texture.check_fits(&made.layout).unwrap();
    assert_eq!(num_shared_texels(&made.layout), 0);
    for (claims, page) in claims_by_page(&made.layout).iter().zip(&made.texture.pages) {
        assert_eq!(claims.count(2), 0, "texels that several triangles claim");
        let is_bare =
            |source: &TexelSource| [TexelSource::NONE, TexelSource::GUTTER].contains(source);
        let covered = claims.num_owners.iter().zip(&page.source);
        let num_bare = covered.filter(|(num, source)| **num > 0 && is_bare(source));
        assert_eq!(num_bare.count(), 0, "covered texels without colour");
    }
}

#[test]
fn indices_out_of_range_are_refused() {
    let positions = meshes::sphere().positions;
    for index in [positions.len() as u32, u32::MAX - 1, u32::MAX] {
        let refused = TriMesh::from_soup(positions.clone(), vec![[0, 1, 2], [3, index, 4]]);
        let expected = MeshError::IndexOutOfRange {
            triangle: 1,
            index: i64::from(index),
            num_vertices: positions.len(),
        };
        assert_eq!(refused.unwrap_err(), expected);
    }
}

/// The zeros above say something: the meshes have the faults that they are named for, frames see
/// them, and texels are claimed.
#[test]
fn the_corpus_is_as_bad_as_it_says() {
    let mesh = |soup: Soup| TriMesh::from_soup(soup.positions, soup.triangles).unwrap();
    let repairs = |soup: Soup| {
        let flat = flatten(&mesh(soup).0, &params(ChartMode::Streaming).flatten);
        flat.unwrap().report.manifold
    };
    assert!(mesh(meshes::vertices_not_finite()).1.num_dropped_triangles > 100);
    assert_eq!(repairs(meshes::books()).num_non_manifold_edges, 6 * 5);
    for one_sided in [
        meshes::moebius_strip,
        meshes::klein_bottle,
        meshes::projective_plane,
    ] {
        let report = repairs(one_sided());
        assert!(report.num_orientation_cuts > 0);
        assert_eq!(report.num_non_manifold_edges, 0);
    }
    assert!(repairs(meshes::roman_surface()).num_non_manifold_edges > 10);
    assert_eq!(
        repairs(meshes::hourglasses()).num_duplicated_vertices,
        10 + 49
    );
    assert!(repairs(meshes::duplicates()).num_duplicate_triangles > 2000);
    assert!(repairs(meshes::opposite_faces()).num_opposite_triangles == 1800);
    assert!(repairs(meshes::all_at_one_point()).num_collapsed_triangles == 1152);
    assert!(repairs(meshes::all_on_one_line()).num_zero_area_triangles == 1152);
    assert!(repairs(meshes::vertices_named_twice()).num_collapsed_triangles > 200);
    for closed in [meshes::sphere, meshes::torus, meshes::genus_two] {
        assert_eq!(repairs(closed()).num_boundary_edges, 0);
    }
    let block = meshes::tangled_block();
    assert!(block.triangles.len() > 20_000);
    let report = repairs(block);
    assert!(report.num_non_manifold_edges > 3000 && report.num_duplicated_vertices > 1000);

    let made = textured(&mesh(meshes::sphere()).0, &params(ChartMode::Streaming), 1);
    assert!(made.assignment.report.num_frames_used >= 2);
    assert!(claims_by_page(&made.layout)[0].count(1) > 10_000);
    let made = textured(&mesh(meshes::spiral_ramp()).0, &params(ChartMode::Paper), 1);
    assert!(made.report.overlap.num_overlapping_charts > 0);
    assert!(made.report.overlap.num_pieces > 20);
}

/// The corpus as a table: `cargo test --release --test all corpus::table -- --ignored --nocapture`.
#[test]
#[ignore = "prints a table for people"]
#[expect(clippy::print_stdout, reason = "it is there to be read")]
fn table() {
    let mut text = String::from(
        "| mesh | mode | triangles | repairs | charts | pieces | quasi-conformal mean | shared texels \
         | seconds |\n|---|---|--:|---|--:|--:|--:|--:|--:|\n",
    );
    for (name, soup) in CORPUS {
        for (mode, mode_name) in [
            (ChartMode::Streaming, "streaming"),
            (ChartMode::Paper, "paper"),
        ] {
            let soup = soup();
            let params = params(mode);
            let seconds = check_soup(&soup, &params);
            let (mesh, dropped) = TriMesh::from_soup(soup.positions, soup.triangles).unwrap();
            let made = textured(&mesh, &params, 2);
            let report = &made.report;
            let manifold = &report.flatten.manifold;
            let counts = [
                ("not finite", dropped.num_dropped_triangles),
                ("edges split", manifold.num_non_manifold_edges),
                ("edges cut", manifold.num_orientation_cuts),
                ("vertices doubled", manifold.num_duplicated_vertices),
                ("reversed", manifold.num_reversed_triangles),
                ("duplicate", manifold.num_duplicate_triangles),
                ("opposite", manifold.num_opposite_triangles),
                ("collapsed", manifold.num_collapsed_triangles),
                ("no area", manifold.num_zero_area_triangles),
            ];
            let repairs: Vec<String> = counts
                .iter()
                .filter(|(_, count)| *count > 0)
                .map(|(what, count)| format!("{count} {what}"))
                .collect();
            let overlap = &report.overlap;
            writeln!(
                text,
                "| {} | {mode_name} | {} | {} | {} | {} | {:.3} | {} | {seconds:.2} |",
                name.replace('_', " "),
                mesh.num_triangles(),
                repairs.join(", "),
                report.flatten.num_charts,
                report.flatten.num_charts - overlap.num_overlapping_charts + overlap.num_pieces,
                report.flatten.distortion.quasi_conformal_mean,
                num_shared_texels(&made.layout),
            )
            .unwrap();
        }
    }
    println!("{text}");
}
