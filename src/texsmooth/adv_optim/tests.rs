//! A wall before three cameras whose photos are each of one grey.

use nalgebra::{Point3, UnitQuaternion, Vector3};

use super::*;
use crate::atlas::{ChartId, PlacedChart, TexelRect, TexelSource, TexturePage};
use crate::geom::{
    CameraModel, ColorEncoding, ColorImage, EncodedColor, PinholeCamera, RigidTransform, Stamp,
};
use crate::keyframe::{DecodedFrame, FrameQuality, KeyframeId};

const SIDE_PX: u32 = 48;
const SIDE_TEXEL: u32 = 64;
/// The wall is a metre wide and 1 m before a camera that is not moved back.
const TEXELS_PER_M: f32 = 48.0;

fn wall(source: TexelSource, grey: u8) -> (TriMesh, AtlasLayout, AtlasTexture) {
    let corners = [[-0.5, -0.5], [0.5, -0.5], [0.5, 0.5], [-0.5, 0.5]];
    let positions = corners.map(|[x, y]| Point3::new(x, y, 1.0)).to_vec();
    let (mesh, _) = TriMesh::from_soup(positions, vec![[0, 1, 2], [0, 2, 3]]).unwrap();
    let rect = TexelRect {
        x: 0,
        y: 0,
        width: SIDE_TEXEL,
        height: SIDE_TEXEL,
    };
    let texel = |m: f64| (m as f32 + 0.5) * TEXELS_PER_M + 8.0;
    let layout = AtlasLayout {
        page_size_texel: [SIDE_TEXEL; 2],
        num_pages: 1,
        texels_per_m: f64::from(TEXELS_PER_M),
        charts: vec![PlacedChart::whole_rect(
            0,
            rect,
            f64::from(TEXELS_PER_M),
            mesh.triangle_ids().collect(),
        )],
        chart_of_triangle: vec![ChartId(0); 2],
        corners_texel: mesh
            .triangle_ids()
            .map(|t| mesh.corners_m(t).map(|p| [texel(p.x), texel(p.y)]))
            .collect(),
    };
    let mut page = TexturePage::blank(SIDE_TEXEL, SIDE_TEXEL);
    page.srgb.fill([grey; 3]);
    page.source.fill(source);
    (mesh, layout, AtlasTexture::from_iter([page]))
}

/// A camera that looks at the wall straight on, so many metres behind the origin.
fn keyframe(id: u32, back_m: f64) -> Arc<Keyframe> {
    let focal_px = f64::from(SIDE_PX);
    let middle_px = 0.5 * f64::from(SIDE_PX - 1);
    let intrinsics_px = [focal_px, focal_px, middle_px, middle_px];
    let camera = PinholeCamera::new(intrinsics_px, SIDE_PX, SIDE_PX).unwrap();
    let bytes = vec![0; (SIDE_PX * SIDE_PX) as usize];
    let color = EncodedColor::from_raw(
        ColorEncoding::Mono8,
        SIDE_PX,
        SIDE_PX,
        SIDE_PX,
        bytes.into(),
    );
    Arc::new(Keyframe {
        id: KeyframeId(id),
        stamp: Stamp::from_nanos(0),
        world_from_camera: RigidTransform::from_parts(
            UnitQuaternion::identity(),
            Vector3::new(0.0, 0.0, -back_m),
        ),
        color: color.unwrap(),
        color_camera: CameraModel::ideal(camera),
        depth: None,
        quality: FrameQuality::default(),
    })
}

/// The mean grey in the middle of the wall after a while of the L1 term alone, unaligned: frame i shows
/// `greys[i]` from `backs_m[i]`.
fn settled(
    source: TexelSource,
    greys: [u8; 3],
    backs_m: [f64; 3],
    params: &TexSmoothParams,
) -> f64 {
    let (mesh, layout, mut texture) = wall(source, greys[0]);
    let frames: Vec<_> = (0..).zip(backs_m).map(|(id, m)| keyframe(id, m)).collect();
    let decode = |frame: &Keyframe| {
        let grey = greys[frame.id.0 as usize];
        let num_pixels = (SIDE_PX * SIDE_PX) as usize;
        Ok(Arc::new(DecodedFrame {
            color: ColorImage::new(SIDE_PX, SIDE_PX, vec![[grey; 3]; num_pixels])?,
            color_camera: frame.color_camera.pinhole,
            depth: None,
        }))
    };
    let params = TexSmoothParams {
        num_steps: 400,
        crop_px: SIDE_PX as usize,
        learning_rate: 2e-2,
        has_discriminator: false,
        has_alignment: false,
        ..params.clone()
    };
    let report = smooth(
        &mesh,
        &layout,
        &mut texture,
        &frames,
        &decode,
        &params,
        SmoothFrom::Nothing,
        &NoObserver,
    )
    .unwrap();
    assert_eq!(report.num_steps, 400);
    let middle = SIDE_TEXEL / 4..3 * SIDE_TEXEL / 4;
    let rows = middle
        .clone()
        .flat_map(|y| middle.clone().map(move |x| y * SIDE_TEXEL + x));
    let greys: Vec<f64> = rows
        .map(|texel| f64::from(texture.pages[0].srgb[texel as usize][0]))
        .collect();
    greys.iter().sum::<f64>() / greys.len() as f64
}

fn near(grey: f64, expected: f64) -> bool {
    (grey - expected).abs() <= 3.0
}

#[test]
fn a_texels_own_photo_outweighs_the_others() {
    let own = TexelSource::keyframe(0);
    let greys = [100, 160, 160];
    let with_weight = |own_weight: f32| {
        let params = TexSmoothParams {
            own_weight,
            ..TexSmoothParams::default()
        };
        settled(own, greys, [0.0; 3], &params)
    };
    let alike = with_weight(1.0);
    assert!(near(alike, 160.0), "the median of three: {alike}");
    let owned = with_weight(10.0);
    assert!(near(owned, 100.0), "its own: {owned}");
}

#[test]
fn a_photo_from_afar_outweighs_none_that_is_near() {
    // From 3 m farther a pixel covers four texels a side.
    let greys = [100, 160, 160];
    let backs_m = [0.0, 3.0, 3.0];
    let with_exponent = |resolution_exponent: f32| {
        let params = TexSmoothParams {
            resolution_exponent,
            own_weight: 1.0,
            ..TexSmoothParams::default()
        };
        settled(TexelSource::MEAN, greys, backs_m, &params)
    };
    let weighted = with_exponent(2.0);
    assert!(near(weighted, 100.0), "the near photo: {weighted}");
    let alike = with_exponent(0.0);
    // Their pixels reach every fourth texel alone.
    assert!(alike > 108.0, "the far ones pull: {alike}");
}
