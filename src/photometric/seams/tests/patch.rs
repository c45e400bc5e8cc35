//! Parts of a surface levelled beside others that stay.

use nalgebra::Vector3;

use super::*;
use crate::geom::{ColorImage, PinholeCamera, RigidTransform};

/// Linear light of the two frames' photos, and of what they paint.
const LIGHT: [f32; 2] = [0.3, 0.36];

/// The sheet as its two frames see it from above: each in one colour.
fn photos() -> Vec<Option<SeamPhoto>> {
    let photo = |light: f32| {
        let pixels = vec![[srgb_from_linear(light); 3]; 160 * 160];
        Some(SeamPhoto {
            color: ColorImage::new(160, 160, pixels).unwrap(),
            camera: PinholeCamera::new([100.0, 100.0, 79.5, 79.5], 160, 160).unwrap(),
            camera_from_world: RigidTransform::from_parts(
                nalgebra::UnitQuaternion::identity(),
                Vector3::new(-0.6, -0.6, 1.0),
            ),
        })
    };
    LIGHT.map(photo).to_vec()
}

fn painted(sheet: &Sheet) -> AtlasTexture {
    sheet.paint(|label, x, y| LIGHT[label as usize] + 0.02 * (0.9 * x).sin() * (0.7 * y).cos())
}

fn params() -> SeamParams {
    SeamParams {
        reach_m: 0.2,
        ..SeamParams::default()
    }
}

/// Where the middle of a triangle lies, metres from the left.
fn x_m(sheet: &Sheet, triangle: TriangleId) -> f64 {
    let corners = sheet.mesh.corners_m(triangle);
    corners.iter().map(|corner| corner.x).sum::<f64>() / 3.0
}

fn level_part<'a>(
    sheet: &Sheet,
    standing_of: impl Fn(TriangleId) -> Standing<'a>,
    texture: &mut AtlasTexture,
) -> (SeamReport, Vec<(TriangleId, Levelled)>) {
    let is_part = |triangle: &TriangleId| standing_of(*triangle) == Standing::Levelled;
    let part = sheet.mesh.triangle_ids().filter(is_part);
    let label_of = |triangle: TriangleId| sheet.labels[triangle.index()];
    let patch = SeamPatch::around(&sheet.mesh, &sheet.layout, part, label_of).unwrap();
    let frames = patch.frames().iter().map(|frame| *frame as usize);
    let sources: Vec<TexelSource> = frames.clone().map(|frame| sheet.sources[frame]).collect();
    let all = photos();
    let photos: Vec<_> = frames.map(|frame| all[frame].clone()).collect();
    patch
        .level(&standing_of, &sources, &photos, &params(), texture)
        .unwrap()
}

/// Whether a texel may be one of the triangles' that `is_part` says.
fn texels_of(sheet: &Sheet, is_part: impl Fn(TriangleId) -> bool) -> Vec<bool> {
    let mut is_texel = vec![false; (SIDE * SIDE) as usize];
    for triangle in sheet.mesh.triangle_ids().filter(|t| is_part(*t)) {
        let corners = &sheet.layout.corners_texel[triangle.index()];
        for_each_texel_within(corners, [SIDE; 2], |x, y, _| {
            is_texel[(y * SIDE + x) as usize] = true;
        });
    }
    is_texel
}

#[test]
fn all_triangles_are_the_whole_to_the_byte() {
    let sheet = Sheet::new();
    let mut whole = painted(&sheet);
    let photos = photos();
    let whole_report = level_seams(
        &sheet.mesh,
        &sheet.layout,
        &sheet.labels,
        &sheet.sources,
        Some(&photos),
        &params(),
        &mut whole,
    )
    .unwrap();
    assert!(whole_report.step_after < 0.05 * whole_report.step_before);
    let mut parts = painted(&sheet);
    let (report, levelled) = level_part(&sheet, |_| Standing::Levelled, &mut parts);
    assert_eq!(report, whole_report);
    assert_eq!(parts, whole);
    assert!(levelled.len() > sheet.labels.len() / 2);
}

#[test]
fn a_step_beside_what_stays_is_taken_up_on_one_side() {
    let sheet = Sheet::new();
    for is_right in [false, true] {
        let is_part = |t: TriangleId| (sheet.labels[t.index()] == Some(1)) == is_right;
        let standing_of = |t| match is_part(t) {
            true => Standing::Levelled,
            false => Standing::Fixed(None),
        };
        let before = painted(&sheet);
        let mut texture = before.clone();
        let (report, _) = level_part(&sheet, standing_of, &mut texture);
        // On the finest the step is found to a byte.
        assert!((report.step_before - 0.06).abs() < 0.003, "{report:?}");
        assert!(report.step_after < 0.06 * report.step_before, "{report:?}");
        let flat = sheet.paint(|_, x, y| LIGHT[0] + 0.02 * (0.9 * x).sin() * (0.7 * y).cos());
        let step = difference(&texture, LEFT, RIGHT) - difference(&flat, LEFT, RIGHT);
        assert!(step.abs() < 0.06 * 0.06, "{step}");
        for (index, is_texel) in texels_of(&sheet, is_part).into_iter().enumerate() {
            let [now, then] = [&texture, &before].map(|t| t.pages[0].srgb[index]);
            assert!(is_texel || now == then, "texel {index} was to stay");
        }
        assert_eq!(texture.pages[0].source, before.pages[0].source);
    }
}

#[test]
fn a_part_levelled_again_is_as_it_was() {
    let sheet = Sheet::new();
    let before = painted(&sheet);
    let mut whole = before.clone();
    let (_, levelled) = level_part(&sheet, |_| Standing::Levelled, &mut whole);
    let added = |triangle: TriangleId| {
        let index = levelled.binary_search_by_key(&triangle, |(t, _)| *t).ok()?;
        Some(&levelled[index].1)
    };
    // Beyond the seam, up to the seam, and across it.
    for range_m in [0.75..2.0, 0.6..2.0, 0.45..0.9] {
        let is_part = |t: TriangleId| range_m.contains(&x_m(&sheet, t));
        let standing_of = |t| match is_part(t) {
            true => Standing::Levelled,
            false => Standing::Fixed(added(t)),
        };
        let mut again = whole.clone();
        for (index, is_texel) in texels_of(&sheet, is_part).into_iter().enumerate() {
            if is_texel {
                again.pages[0].to_mut().srgb[index] = before.pages[0].srgb[index];
            }
        }
        let num_reset = again.pages[0].srgb.iter().zip(&whole.pages[0].srgb);
        assert!(num_reset.filter(|(a, b)| a != b).count() > 500);
        level_part(&sheet, standing_of, &mut again);
        for (again, whole) in again.pages[0].srgb.iter().zip(&whole.pages[0].srgb) {
            let apart = again[0].abs_diff(whole[0]);
            assert!(apart <= 1, "{range_m:?}: {again:?} for {whole:?}");
        }
    }
}

#[test]
fn what_waits_stays_and_is_left_its_part() {
    let sheet = Sheet::new();
    let is_first = |t: TriangleId| sheet.labels[t.index()] == Some(1);
    let before = painted(&sheet);
    let mut texture = before.clone();
    let (_, levelled) = level_part(
        &sheet,
        |t| match is_first(t) {
            true => Standing::Levelled,
            false => Standing::Waiting,
        },
        &mut texture,
    );
    let change = |texture: &AtlasTexture, x: u32| {
        let rows = 30..210;
        let changes = rows.clone().map(|y| at(texture, x, y) - at(&before, x, y));
        changes.sum::<f32>() / rows.len() as f32
    };
    assert_eq!(change(&texture, LEFT), 0.0);
    let first = -change(&texture, RIGHT);
    assert!((0.01..0.04).contains(&first), "{first}");

    let added = |triangle: TriangleId| {
        let index = levelled.binary_search_by_key(&triangle, |(t, _)| *t).ok()?;
        Some(&levelled[index].1)
    };
    let standing_of = |t| match is_first(t) {
        true => Standing::Fixed(added(t)),
        false => Standing::Levelled,
    };
    level_part(&sheet, standing_of, &mut texture);
    assert_eq!(-change(&texture, RIGHT), first);
    let both = change(&texture, LEFT) + first;
    assert!((both - 0.06).abs() < 0.06 * 0.06, "{both}");
}
