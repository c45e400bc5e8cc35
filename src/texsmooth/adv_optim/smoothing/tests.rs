//! A wall of three charts before cameras that see it as it is; the texture of the middle one is grey,
//! those of the others are too bright. Another wall stands behind it.

use nalgebra::{Point3, UnitQuaternion, Vector3};

use super::*;
use crate::atlas::{ChartId, PlacedChart, TexelRect, TexelSource, TexturePage};
use crate::geom::{
    CameraModel, ColorEncoding, ColorImage, EncodedColor, PinholeCamera, RigidTransform, Stamp,
};
use crate::keyframe::{DecodedFrame, FrameQuality};
use crate::mesh::TriangleId;
use crate::texsmooth::{NoObserver, smooth};

const SIDE_PX: u32 = 96;
/// Of a chart, metres; three stand side by side, 1 m from the cameras.
const SIDE_M: f64 = 0.5;
const TEXELS_PER_M: f64 = 96.0;
/// Of a chart's place on the page; around its 48 texels there are gutters of 6.
const PLACE_TEXEL: u32 = 60;
const GUTTER_TEXEL: f64 = 6.0;
const MIDDLE: usize = 1;
const BEHIND: usize = 3;
const NUM_CHARTS: usize = 4;

/// What the wall looks like.
fn truth(x_m: f64, y_m: f64) -> [u8; 3] {
    let wave = |phase: f64| (2.0 * std::f64::consts::PI * phase).sin();
    let stripes = wave(5.0 * x_m + 2.0 * y_m) + wave(4.0 * y_m - 3.0 * x_m);
    [128.0 + 50.0 * stripes, 128.0 - 40.0 * stripes, 120.0].map(|value| value as u8)
}

/// Left edge and depth of a chart's square.
fn place_m(chart: usize) -> [f64; 2] {
    match chart {
        BEHIND => [-0.5 * SIDE_M, 1.5],
        _ => [(chart as f64 - 1.5) * SIDE_M, 1.0],
    }
}

struct Wall {
    mesh: TriMesh,
    layout: AtlasLayout,
    texture: AtlasTexture,
    frames: Vec<Arc<Keyframe>>,
}

impl Wall {
    fn new() -> Self {
        let (mut positions, mut triangles) = (Vec::new(), Vec::new());
        for chart in 0..NUM_CHARTS {
            let [left, depth_m] = place_m(chart);
            let first = 4 * chart as u32;
            for (column, row) in [(0.0, 0.0), (1.0, 0.0), (1.0, 1.0), (0.0, 1.0)] {
                let (x, y) = (left + column * SIDE_M, (row - 0.5) * SIDE_M);
                positions.push(Point3::new(x, y, depth_m));
            }
            triangles.push([first, first + 1, first + 2]);
            triangles.push([first, first + 2, first + 3]);
        }
        let (mesh, _) = TriMesh::from_soup(positions, triangles).unwrap();
        let layout = layout(&mesh);
        let page = painted(&layout);
        Self {
            mesh,
            layout,
            texture: AtlasTexture::from_iter([page]),
            frames: (0..7).map(keyframe).collect(),
        }
    }

    fn scene(&self) -> SmoothScene<'_> {
        SmoothScene {
            mesh: &self.mesh,
            layout: &self.layout,
            frames: &self.frames,
            decode: &photo,
        }
    }

    fn begin(&self, charts: &[usize], params: &TexSmoothParams) -> Smoothing {
        let may_change = flags(charts);
        let from = SmoothFrom::Nothing;
        Smoothing::of_charts(&self.scene(), &self.texture, &may_change, params, from).unwrap()
    }

    /// Refines some charts in pieces of so many steps.
    fn refined(
        &self,
        charts: &[usize],
        params: &TexSmoothParams,
        num_steps: usize,
    ) -> (AtlasTexture, SmoothReport) {
        let mut texture = self.texture.clone();
        let mut smoothing = self.begin(charts, params);
        while !smoothing.is_done() {
            smoothing
                .advance(&self.scene(), &mut texture, num_steps, &NoObserver)
                .unwrap();
        }
        (texture, smoothing.finish(&NoObserver).unwrap())
    }

    /// The whole form.
    fn all_refined(&self, params: &TexSmoothParams) -> (AtlasTexture, SmoothReport) {
        let mut texture = self.texture.clone();
        let report = smooth(
            &self.mesh,
            &self.layout,
            &mut texture,
            &self.frames,
            &photo,
            params,
            SmoothFrom::Nothing,
            &NoObserver,
        );
        (texture, report.unwrap())
    }

    /// Mean difference from the truth inside of a chart, in bytes.
    fn error(&self, texture: &AtlasTexture, chart: usize) -> f64 {
        let TexelRect { x, y, .. } = self.layout.charts[chart].rect;
        let (mut sum, mut num) = (0.0, 0);
        for row in 0..PLACE_TEXEL {
            for column in 0..PLACE_TEXEL {
                let at = [column, row].map(|t| f64::from(t) + 0.5 - GUTTER_TEXEL);
                let is_inside = at.iter().all(|t| (2.0..46.0).contains(t));
                if !is_inside {
                    continue;
                }
                let index = (y + row) * self.layout.page_size_texel[0] + x + column;
                let found = texture.pages[0].srgb[index as usize];
                let expected = truth_at(chart, at);
                for (found, expected) in found.into_iter().zip(expected) {
                    sum += f64::from(found.abs_diff(expected));
                    num += 1;
                }
            }
        }
        sum / f64::from(num)
    }
}

fn flags(charts: &[usize]) -> [bool; NUM_CHARTS] {
    std::array::from_fn(|chart| charts.contains(&chart))
}

fn layout(mesh: &TriMesh) -> AtlasLayout {
    let charts = (0..NUM_CHARTS as u32).map(|chart| {
        let rect = TexelRect {
            x: chart * PLACE_TEXEL,
            y: 0,
            width: PLACE_TEXEL,
            height: PLACE_TEXEL,
        };
        let triangles = [2 * chart, 2 * chart + 1].map(TriangleId).to_vec();
        PlacedChart::whole_rect(0, rect, TEXELS_PER_M, triangles)
    });
    let chart_of = |t: TriangleId| t.index() / 2;
    let corners = |t: TriangleId| {
        let chart = chart_of(t);
        let left = place_m(chart)[0];
        mesh.corners_m(t).map(|point| {
            let column = (point.x - left) * TEXELS_PER_M + GUTTER_TEXEL;
            let row = (point.y + 0.5 * SIDE_M) * TEXELS_PER_M + GUTTER_TEXEL;
            [column + chart as f64 * f64::from(PLACE_TEXEL), row].map(|texel| texel as f32)
        })
    };
    AtlasLayout {
        page_size_texel: [NUM_CHARTS as u32 * PLACE_TEXEL, PLACE_TEXEL],
        num_pages: 1,
        texels_per_m: TEXELS_PER_M,
        charts: charts.collect(),
        chart_of_triangle: mesh
            .triangle_ids()
            .map(|t| ChartId(chart_of(t) as u32))
            .collect(),
        corners_texel: mesh.triangle_ids().map(corners).collect(),
    }
}

/// The truth at a place of a chart, in texels from its upper left.
fn truth_at(chart: usize, [column, row]: [f64; 2]) -> [u8; 3] {
    let x_m = place_m(chart)[0] + column / TEXELS_PER_M;
    truth(x_m, row / TEXELS_PER_M - 0.5 * SIDE_M)
}

fn painted(layout: &AtlasLayout) -> TexturePage {
    let [width, height] = layout.page_size_texel;
    let mut page = TexturePage::blank(width, height);
    for (index, texel) in page.srgb.iter_mut().enumerate() {
        let (x, y) = (index as u32 % width, index as u32 / width);
        let chart = (x / PLACE_TEXEL) as usize;
        let at = [x % PLACE_TEXEL, y].map(|t| f64::from(t) + 0.5 - GUTTER_TEXEL);
        *texel = match chart {
            MIDDLE => [128; 3],
            _ => truth_at(chart, at).map(|value| value + 9),
        };
    }
    page.source.fill(TexelSource::MEAN);
    page
}

/// Cameras side by side that look at the wall straight on.
fn keyframe(id: u32) -> Arc<Keyframe> {
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
    let x_m = (f64::from(id) - 3.0) * 0.33;
    Arc::new(Keyframe {
        id: KeyframeId(id),
        stamp: Stamp::from_nanos(0),
        world_from_camera: RigidTransform::from_parts(
            UnitQuaternion::identity(),
            Vector3::new(x_m, 0.01 * f64::from(id), 0.0),
        ),
        color: color.unwrap(),
        color_camera: CameraModel::ideal(camera),
        depth: None,
        quality: FrameQuality::default(),
    })
}

/// What such a camera sees of a wall without end.
fn photo(frame: &Keyframe) -> Result<Arc<DecodedFrame>, crate::geom::ImageError> {
    let camera = frame.color_camera.pinhole;
    let at = frame.world_from_camera.translation();
    let pixels = (0..SIDE_PX * SIDE_PX).map(|i| {
        let ray = camera.ray(f64::from(i % SIDE_PX), f64::from(i / SIDE_PX));
        truth(at.x + ray.x, at.y + ray.y)
    });
    Ok(Arc::new(DecodedFrame {
        color: ColorImage::new(SIDE_PX, SIDE_PX, pixels.collect())?,
        color_camera: camera,
        depth: None,
    }))
}

/// The L1 term alone, on crops that are smaller than a chart's picture.
fn plain(num_steps: usize) -> TexSmoothParams {
    TexSmoothParams {
        num_steps,
        crop_px: 24,
        learning_rate: 3e-2,
        has_discriminator: false,
        has_alignment: false,
        ..TexSmoothParams::default()
    }
}

fn with_discriminator(num_steps: usize) -> TexSmoothParams {
    TexSmoothParams {
        crop_px: 80,
        has_discriminator: true,
        has_alignment: true,
        ..plain(num_steps)
    }
}

/// Whether only texels that the charts own differ, and some do.
fn is_changed_in(wall: &Wall, texture: &AtlasTexture, charts: &[usize]) -> bool {
    let (old, new) = (&wall.texture.pages[0], &texture.pages[0]);
    let width = wall.layout.page_size_texel[0];
    let changed: Vec<u32> = (0..old.srgb.len() as u32)
        .filter(|&i| old.srgb[i as usize] != new.srgb[i as usize])
        .collect();
    let is_own = |index: &u32| {
        let owns = |chart: &usize| wall.layout.charts[*chart].owns(index % width, index / width);
        charts.iter().any(owns)
    };
    !changed.is_empty()
        && changed.iter().all(is_own)
        && old.source == new.source
        && old.confidence == new.confidence
}

#[test]
fn a_chart_is_refined_as_far_as_in_the_whole_form_and_nothing_else_changes() {
    let wall = Wall::new();
    let before = wall.error(&wall.texture, MIDDLE);
    let (all, of_all) = wall.all_refined(&plain(900));
    let (part, report) = wall.refined(&[MIDDLE], &plain(300), 300);
    assert!(is_changed_in(&wall, &part, &[MIDDLE]));
    assert!(!is_changed_in(&wall, &all, &[MIDDLE]));
    let [whole, found] = [&all, &part].map(|texture| wall.error(texture, MIDDLE));
    assert!(before > 25.0, "{before}");
    assert!(whole < 0.25 * before, "{whole} of {before}");
    assert!(found < 1.2 * whole, "{found}, in the whole form {whole}");

    assert_eq!((report.num_steps, report.num_empty), (300, 0));
    assert!(report.num_views < 7, "{}", report.num_views);
    let l1 = |report: &SmoothReport| {
        let curve = &report.curve;
        [curve[0].1.l1, curve[curve.len() - 1].1.l1]
    };
    let [first, last] = l1(&report);
    assert!(last < 0.2 * first, "{first} to {last}");
    // A third of the steps reach each texel as often.
    let ratio = report.num_steps_per_texel / of_all.num_steps_per_texel;
    assert!((0.8..1.6).contains(&ratio), "{ratio}");
}

#[test]
fn with_the_discriminator_too_nothing_else_changes() {
    let wall = Wall::new();
    for charts in [&[MIDDLE][..], &[0, 2]] {
        let (part, report) = wall.refined(charts, &with_discriminator(6), 6);
        assert!(is_changed_in(&wall, &part, charts));
        assert!(!report.critic.is_empty());
    }
}

#[test]
fn with_all_charts_it_is_the_whole_form() {
    let wall = Wall::new();
    let params = with_discriminator(6);
    let (all, expected) = wall.all_refined(&params);
    let (pieces, report) = wall.refined(&[0, 1, 2, 3], &params, 4);
    assert_eq!(all, pieces);
    assert_ne!(all, wall.texture);
    assert_eq!(report.curve, expected.curve);
    assert_eq!(report.critic, expected.critic);
}

#[test]
fn neither_pieces_nor_threads_change_a_byte() {
    let wall = Wall::new();
    let run = |num_threads: usize, num_steps: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(num_threads);
        let pool = pool.build().unwrap();
        let params = with_discriminator(9);
        let (texture, report) = pool.install(|| wall.refined(&[MIDDLE], &params, num_steps));
        (texture, report.critic, report.curve, report.num_texels)
    };
    let one = run(1, 9);
    assert!(is_changed_in(&wall, &one.0, &[MIDDLE]));
    assert!(one == run(4, 9), "threads");
    assert!(one == run(2, 2), "pieces");
}

#[test]
fn what_no_photo_shows_is_done_at_once() {
    let wall = Wall::new();
    let params = plain(50);
    let mut smoothing = wall.begin(&[BEHIND], &params);
    assert!(
        !smoothing.is_done(),
        "only a drawn view tells that it is hidden"
    );
    let mut texture = wall.texture.clone();
    smoothing
        .advance(&wall.scene(), &mut texture, 50, &NoObserver)
        .unwrap();
    assert!(smoothing.is_done());
    let report = smoothing.finish(&NoObserver).unwrap();
    assert!(report.num_steps < 5, "{}", report.num_steps);
    assert_eq!((report.num_texels, report.num_views), (0, 0));
    assert_eq!(texture, wall.texture);

    assert!(wall.begin(&[], &params).is_done());
}

#[test]
fn another_scene_is_refused() {
    let wall = Wall::new();
    let params = plain(4);
    let begin = |may_change: &[bool]| {
        let from = SmoothFrom::Nothing;
        Smoothing::of_charts(&wall.scene(), &wall.texture, may_change, &params, from)
    };
    let charts = begin(&[true; 3]).err().unwrap();
    assert!(matches!(charts, SmoothError::Charts { num_flags: 3, .. }));

    let mut smoothing = begin(&flags(&[MIDDLE])).unwrap();
    let mut texture = wall.texture.clone();
    let fewer = SmoothScene {
        frames: &wall.frames[1..],
        ..wall.scene()
    };
    let changed = smoothing.advance(&fewer, &mut texture, 1, &NoObserver);
    assert!(matches!(changed, Err(SmoothError::Changed { .. })));
    texture.pages.clear();
    let changed = smoothing.advance(&wall.scene(), &mut texture, 1, &NoObserver);
    assert!(matches!(changed, Err(SmoothError::Texture(_))));
}

#[test]
fn a_checkpoint_is_gone_on_with_for_the_same_charts_alone() {
    struct Keep(std::sync::Mutex<Vec<u8>>);
    impl Observer for Keep {
        fn step(&self, _: &StepProgress) {}
        fn preview(&self, _: usize, _: &ColorImage) {}
        fn checkpoint(&self, _: usize, bytes: &[u8]) {
            *self.0.lock().unwrap() = bytes.to_vec();
        }
    }
    let wall = Wall::new();
    let params = TexSmoothParams {
        checkpoint_interval: 5,
        ..plain(12)
    };
    let (expected, _) = wall.refined(&[MIDDLE], &params, 12);
    let kept = Keep(std::sync::Mutex::default());
    let mut smoothing = wall.begin(&[MIDDLE], &params);
    let mut texture = wall.texture.clone();
    smoothing
        .advance(&wall.scene(), &mut texture, 5, &kept)
        .unwrap();
    let bytes = kept.0.into_inner().unwrap();

    let resume = |charts: &[usize]| {
        let from = SmoothFrom::Checkpoint(&bytes);
        Smoothing::of_charts(&wall.scene(), &wall.texture, &flags(charts), &params, from)
    };
    for charts in [&[0][..], &[0, MIDDLE]] {
        let refused = resume(charts).err().unwrap();
        assert!(matches!(refused, SmoothError::Checkpoint(_)), "{refused}");
    }
    let mut texture = wall.texture.clone();
    resume(&[MIDDLE])
        .unwrap()
        .advance(&wall.scene(), &mut texture, 12, &NoObserver)
        .unwrap();
    // Offsets are known to no checkpoint, the numbers of pixels neither: views are drawn anew.
    assert!(is_changed_in(&wall, &texture, &[MIDDLE]));
    assert_eq!(texture.pages[0].source, expected.pages[0].source);
}

#[test]
fn it_may_go_to_another_thread() {
    fn check<T: Send>() {}
    check::<Smoothing>();
}
