//! The kept frames, encoded, within a budget of bytes.
//!
//! Images that arrive raw are compressed without loss before they are stored. When the budget is
//! exceeded, the frame goes whose view the others show best (see [`super::overlap`]): each point
//! of its view counts by how many other views show it, so that the last view of a place stays.
//! The same frames in the same order give the same store.

use std::collections::BTreeMap;
use std::sync::Arc;

use super::cache::{CacheReport, DecodeCache};
use super::decoded::DecodedFrame;
use super::frame::{FrameQuality, Keyframe, KeyframeId};
use super::overlap::{NUM_SAMPLES, View, covered_share};
use super::quality;
use super::select::{Choice, KeyframeParams, Selector};
use crate::geom::{DepthImage, EncodedColor, FrameDepth, ImageError, PosedFrame};

/// Examples kept of depth images that were refused.
const MAX_EXAMPLES: usize = 3;

/// Why a frame was not kept.
#[derive(Clone, Debug, PartialEq)]
pub enum RejectReason {
    /// The colour image does not decode, or its size is not the camera's.
    BadImage(ImageError),
    /// Nearly black, nearly white or mostly clipped.
    BadExposure,
    /// Blurred, and kept frames show what it shows.
    Blurred,
    /// A kept frame has nearly the same view.
    SameView,
    /// The budget is full, and the other views show this one best.
    Redundant,
    /// It alone exceeds the budget.
    LargerThanBudget,
}

impl RejectReason {
    /// The reason in words.
    pub fn as_str(&self) -> &'static str {
        match self {
            Self::BadImage(_) => "image does not decode",
            Self::BadExposure => "badly exposed",
            Self::Blurred => "blurred",
            Self::SameView => "same view as a kept frame",
            Self::Redundant => "budget full, view shown by kept frames",
            Self::LargerThanBudget => "larger than the budget",
        }
    }
}

/// What became of an offered frame.
#[derive(Clone, Debug, PartialEq)]
pub enum Admission {
    /// It is a keyframe now.
    Kept(KeyframeId),
    /// It is a keyframe now, in place of a less sharp one of nearly the same view.
    Replaced {
        /// The new keyframe.
        id: KeyframeId,
        /// The one that is gone.
        replaced: KeyframeId,
    },
    /// It was not kept.
    Rejected(RejectReason),
}

/// What the store did, and what it holds.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct KeyframeReport {
    /// Frames offered.
    pub num_offered: u64,
    /// Frames kept, replacements among them.
    pub num_admitted: u64,
    /// Keyframes that a sharper one replaced.
    pub num_replaced: u64,
    /// Keyframes dropped for room.
    pub num_evicted: u64,
    /// Frames not kept, by reason.
    pub rejected_by_reason: BTreeMap<&'static str, u64>,
    /// Depth images left out because they do not decode or have the wrong size.
    pub num_depth_refused: u64,
    /// The first few of them: stamp and reason.
    pub depth_refused_examples: Vec<String>,
    /// Bytes of encoded images held.
    pub num_bytes: usize,
    /// Most bytes ever held; a frame is counted before others make room for it.
    pub peak_bytes: usize,
}

#[derive(Debug)]
struct Stored {
    keyframe: Arc<Keyframe>,
    view: View,
    /// For each sample of the view, how many other kept views show it.
    num_shown_by: [u32; NUM_SAMPLES],
    num_bytes: usize,
}

/// The kept frames. Decoding is `&self` and safe from many threads; everything else is one
/// writer's.
#[derive(Debug)]
pub struct KeyframeStore {
    budget_bytes: usize,
    selector: Selector,
    stored: BTreeMap<KeyframeId, Stored>,
    next_id: u32,
    cache: DecodeCache,
    report: KeyframeReport,
}

impl KeyframeStore {
    /// An empty store.
    pub fn new(params: &KeyframeParams) -> Self {
        Self {
            budget_bytes: bytes_from_mb(params.budget_mb),
            selector: Selector::new(params),
            stored: BTreeMap::new(),
            next_id: 0,
            cache: DecodeCache::new(bytes_from_mb(params.decode_cache_mb)),
            report: KeyframeReport::default(),
        }
    }

    /// Offers a frame; its image is judged first, see [`quality::measure`].
    pub fn offer(&mut self, frame: PosedFrame) -> Admission {
        let quality = quality::measure(&frame.color);
        self.offer_measured(frame, quality)
    }

    /// Offers a frame whose image was judged already, for instance many at once on all cores.
    pub fn offer_measured(
        &mut self,
        frame: PosedFrame,
        quality: Result<FrameQuality, ImageError>,
    ) -> Admission {
        self.report.num_offered += 1;
        let admission = match self.try_admit(frame, quality) {
            Ok(admission) => admission,
            Err(reason) => Admission::Rejected(reason),
        };
        match &admission {
            Admission::Kept(_) => self.report.num_admitted += 1,
            Admission::Replaced { .. } => {
                self.report.num_admitted += 1;
                self.report.num_replaced += 1;
            }
            Admission::Rejected(reason) => {
                let count = self.report.rejected_by_reason.entry(reason.as_str());
                *count.or_default() += 1;
            }
        }
        admission
    }

    /// The keyframes, by id.
    pub fn keyframes(&self) -> impl Iterator<Item = &Arc<Keyframe>> {
        self.stored.values().map(|stored| &stored.keyframe)
    }

    /// How many keyframes there are.
    pub fn len(&self) -> usize {
        self.stored.len()
    }

    /// Whether there is none.
    pub fn is_empty(&self) -> bool {
        self.stored.is_empty()
    }

    /// A keyframe's images, decoded and undistorted, from the cache where it has them.
    ///
    /// # Errors
    /// [`ImageError`] when an image does not decode.
    pub fn decode(&self, keyframe: &Keyframe) -> Result<Arc<DecodedFrame>, ImageError> {
        self.cache.get_or_decode(keyframe)
    }

    /// Bytes of encoded images held.
    pub fn num_bytes(&self) -> usize {
        self.report.num_bytes
    }

    /// What the store did.
    pub fn report(&self) -> &KeyframeReport {
        &self.report
    }

    /// What the cache of decoded frames did.
    pub fn cache_report(&self) -> CacheReport {
        self.cache.report()
    }

    fn try_admit(
        &mut self,
        mut frame: PosedFrame,
        quality: Result<FrameQuality, ImageError>,
    ) -> Result<Admission, RejectReason> {
        let quality = quality.map_err(RejectReason::BadImage)?;
        check_size(&frame).map_err(RejectReason::BadImage)?;
        let stored = &self.stored;
        let choice = self.selector.choose(
            frame.stamp,
            &frame.world_from_camera,
            &quality,
            stored.values().map(|stored| &*stored.keyframe),
            || {
                let depth = frame
                    .depth
                    .as_ref()
                    .and_then(|half| half.image.decode().ok());
                let view = View::new(&frame, depth.as_ref());
                covered_share(&view, stored.values().map(|stored| &stored.view))
            },
        );
        let replaced = match choice {
            Choice::Keep => None,
            Choice::Replace(id) => Some(id),
            Choice::BadExposure => return Err(RejectReason::BadExposure),
            Choice::Blurred => return Err(RejectReason::Blurred),
            Choice::SameView => return Err(RejectReason::SameView),
        };
        let depth = self.checked_depth(&mut frame);
        let view = View::new(&frame, depth.as_ref());
        frame.color = frame
            .color
            .compressed_lossless()
            .map_err(RejectReason::BadImage)?;
        self.insert(frame, quality, view, replaced)
    }

    /// Decodes the depth image; one that cannot be used is taken out of the frame and counted.
    fn checked_depth(&mut self, frame: &mut PosedFrame) -> Option<DepthImage> {
        let half = frame.depth.as_mut()?;
        match checked_depth_half(half) {
            Ok(image) => Some(image),
            Err(error) => {
                self.report.num_depth_refused += 1;
                if self.report.depth_refused_examples.len() < MAX_EXAMPLES {
                    let example = format!("{}: {error}", frame.stamp);
                    self.report.depth_refused_examples.push(example);
                }
                frame.depth = None;
                None
            }
        }
    }

    fn insert(
        &mut self,
        frame: PosedFrame,
        quality: FrameQuality,
        view: View,
        replaced: Option<KeyframeId>,
    ) -> Result<Admission, RejectReason> {
        let num_bytes = encoded_bytes(&frame.color, frame.depth.as_ref());
        if num_bytes > self.budget_bytes {
            return Err(RejectReason::LargerThanBudget);
        }
        if let Some(replaced) = replaced {
            self.remove(replaced);
        }
        let id = KeyframeId(self.next_id);
        let stamp = frame.stamp;
        self.link(&view);
        let num_shown_by = self.num_shown_by(&view);
        self.stored.insert(
            id,
            Stored {
                keyframe: Arc::new(Keyframe {
                    id,
                    stamp,
                    world_from_camera: frame.world_from_camera,
                    color: frame.color,
                    color_camera: frame.color_camera,
                    depth: frame.depth,
                    quality,
                }),
                view,
                num_shown_by,
                num_bytes,
            },
        );
        self.report.num_bytes += num_bytes;
        self.report.peak_bytes = self.report.peak_bytes.max(self.report.num_bytes);
        // A sharper image of a view that was worth keeping stays.
        let spared = replaced.map(|_| id);
        while self.report.num_bytes > self.budget_bytes {
            let Some(evicted) = self.most_redundant(spared) else {
                break;
            };
            self.remove(evicted);
            if evicted == id {
                return Err(RejectReason::Redundant);
            }
            self.report.num_evicted += 1;
        }
        self.next_id += 1;
        self.selector.note_kept(stamp);
        Ok(match replaced {
            Some(replaced) => Admission::Replaced { id, replaced },
            None => Admission::Kept(id),
        })
    }

    /// Counts a new view at the views that it shows.
    fn link(&mut self, view: &View) {
        for other in self.stored.values_mut() {
            let shown = other.view.shown_by(view);
            for (i, count) in other.num_shown_by.iter_mut().enumerate() {
                *count += shown >> i & 1;
            }
        }
    }

    fn num_shown_by(&self, view: &View) -> [u32; NUM_SAMPLES] {
        let mut counts = [0; NUM_SAMPLES];
        for other in self.stored.values() {
            let shown = view.shown_by(&other.view);
            for (i, count) in counts.iter_mut().enumerate() {
                *count += shown >> i & 1;
            }
        }
        counts
    }

    fn remove(&mut self, id: KeyframeId) {
        let Some(removed) = self.stored.remove(&id) else {
            return;
        };
        self.report.num_bytes -= removed.num_bytes;
        self.cache.remove(id);
        for other in self.stored.values_mut() {
            let shown = other.view.shown_by(&removed.view);
            for (i, count) in other.num_shown_by.iter_mut().enumerate() {
                *count -= shown >> i & 1;
            }
        }
    }

    /// The keyframe that the others show best; of equals the least sharp, then the oldest.
    fn most_redundant(&self, spared: Option<KeyframeId>) -> Option<KeyframeId> {
        self.stored
            .values()
            .filter(|stored| Some(stored.keyframe.id) != spared)
            .max_by(|a, b| {
                redundancy(&a.num_shown_by)
                    .cmp(&redundancy(&b.num_shown_by))
                    .then(
                        b.keyframe
                            .quality
                            .sharpness
                            .total_cmp(&a.keyframe.quality.sharpness),
                    )
                    .then(b.keyframe.id.cmp(&a.keyframe.id))
            })
            .map(|stored| stored.keyframe.id)
    }
}

/// Points shown by one other view count half, by two others two thirds, and so on; points that no
/// other view shows count nothing. In whole numbers, so that the order of sums does not matter.
fn redundancy(num_shown_by: &[u32; NUM_SAMPLES]) -> u64 {
    num_shown_by
        .iter()
        .map(|&num| 1_000_000 * u64::from(num) / (1 + u64::from(num)))
        .sum()
}

fn check_size(frame: &PosedFrame) -> Result<(), ImageError> {
    let camera = &frame.color_camera.pinhole;
    same_size(
        [camera.width(), camera.height()],
        [frame.color.width(), frame.color.height()],
    )
}

fn checked_depth_half(half: &mut FrameDepth) -> Result<DepthImage, ImageError> {
    let camera = &half.camera.pinhole;
    same_size(
        [camera.width(), camera.height()],
        [half.image.width(), half.image.height()],
    )?;
    let image = half.image.decode()?;
    half.image = half.image.compressed_lossless()?;
    Ok(image)
}

fn same_size(camera: [u32; 2], image: [u32; 2]) -> Result<(), ImageError> {
    if camera == image {
        return Ok(());
    }
    let num_pixels = |[width, height]: [u32; 2]| width as usize * height as usize;
    Err(ImageError::Length {
        width: camera[0],
        height: camera[1],
        unit: "pixels",
        expected: num_pixels(camera),
        actual: num_pixels(image),
    })
}

fn encoded_bytes(color: &EncodedColor, depth: Option<&FrameDepth>) -> usize {
    color.bytes().len() + depth.map_or(0, |half| half.image.bytes().len())
}

#[expect(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "float to int casts saturate, as meant for a limit"
)]
fn bytes_from_mb(mb: f64) -> usize {
    (mb * 1e6) as usize
}

#[cfg(test)]
mod tests {
    use std::f64::consts::TAU;

    use nalgebra::{UnitQuaternion, Vector3};
    use proptest::prelude::*;
    use rayon::prelude::*;

    use super::*;
    use crate::geom::{
        CameraModel, ColorImage, Distortion, EncodedDepth, PinholeCamera, RigidTransform, Stamp,
    };

    const WIDTH: u32 = 64;
    const HEIGHT: u32 = 48;

    fn camera(distortion: Distortion) -> CameraModel {
        CameraModel {
            pinhole: PinholeCamera::new([60.0, 60.0, 31.5, 23.5], WIDTH, HEIGHT).unwrap(),
            distortion,
        }
    }

    /// Cells of random brightness; `blur` averages over that many pixels to the right.
    fn image(seed: u32, blur: u32) -> EncodedColor {
        let cell = |x: u32, y: u32| {
            ((x / 5 * 7919 + y / 4 * 104_729 + seed).wrapping_mul(2_654_435_761)) >> 24
        };
        let pixels = (0..WIDTH * HEIGHT)
            .map(|i| {
                let (x, y) = (i % WIDTH, i / WIDTH);
                let sum: u32 = (0..=blur).map(|k| cell(x + k, y)).sum();
                [u8::try_from(sum / (blur + 1)).unwrap(); 3]
            })
            .collect();
        EncodedColor::png_from_image(&ColorImage::new(WIDTH, HEIGHT, pixels).unwrap()).unwrap()
    }

    fn depth() -> FrameDepth {
        let depth_mm = vec![1500u16; (WIDTH * HEIGHT) as usize];
        FrameDepth {
            image: EncodedDepth::png_from_u16_mm(WIDTH, HEIGHT, &depth_mm).unwrap(),
            camera: camera(Distortion::None),
            depth_from_color: RigidTransform::identity(),
        }
    }

    /// Looks outwards at an angle from the middle of a round room.
    fn frame(i: i64, angle_rad: f64, color: EncodedColor) -> PosedFrame {
        let rotation = UnitQuaternion::from_axis_angle(&Vector3::y_axis(), angle_rad);
        PosedFrame {
            stamp: Stamp::from_nanos(i * 100_000_000),
            world_from_camera: RigidTransform::from_parts(
                rotation,
                rotation * Vector3::new(0.0, 0.0, 0.2),
            ),
            color,
            color_camera: camera(Distortion::None),
            depth: Some(depth()),
        }
    }

    fn ids(store: &KeyframeStore) -> Vec<u32> {
        store.keyframes().map(|k| k.id.0).collect()
    }

    /// Largest angle between neighbouring kept views of the ring.
    fn largest_gap_rad(store: &KeyframeStore) -> f64 {
        let mut angles: Vec<f64> = store
            .keyframes()
            .map(|k| {
                let axis = k.world_from_camera.rotation() * Vector3::z();
                axis.x.atan2(axis.z)
            })
            .collect();
        angles.sort_by(f64::total_cmp);
        let wrapped = angles[0] + TAU;
        angles
            .iter()
            .skip(1)
            .chain([&wrapped])
            .zip(&angles)
            .map(|(b, a)| b - a)
            .fold(0.0, f64::max)
    }

    fn ring(budget_mb: f64) -> KeyframeStore {
        let mut store = KeyframeStore::new(&KeyframeParams {
            budget_mb,
            ..KeyframeParams::default()
        });
        for i in 0..108u32 {
            // Three rounds, each a little off the last.
            let angle = (f64::from(i) / 36.0 + f64::from(i / 36) * 0.01) * TAU;
            store.offer(frame(i64::from(i), angle, image(i, 0)));
        }
        store
    }

    #[test]
    fn eviction_keeps_the_budget_and_the_ring() {
        let one = encoded_bytes(&image(0, 0), Some(&depth()));
        let unbounded = ring(512.0);
        assert!(unbounded.len() >= 36, "{:?}", unbounded.report());
        let budget_mb = 14.5 * one as f64 * 1e-6;
        let store = ring(budget_mb);
        assert!(store.num_bytes() as f64 <= budget_mb * 1e6);
        assert!(store.len() >= 12, "{:?}", store.report());
        assert!(store.report().num_evicted > 0);
        // Even spacing of 12 would be 30°; a view is 56° wide.
        let gap_rad = largest_gap_rad(&store);
        assert!(gap_rad.to_degrees() < 56.0, "{}", gap_rad.to_degrees());
        assert_eq!(ids(&store), ids(&ring(budget_mb)));
    }

    #[test]
    fn the_last_view_of_a_place_stays() {
        let one = encoded_bytes(&image(0, 0), Some(&depth()));
        let mut store = KeyframeStore::new(&KeyframeParams {
            budget_mb: 6.5 * one as f64 * 1e-6,
            ..KeyframeParams::default()
        });
        let Admission::Kept(lonely) = store.offer(frame(0, TAU / 2.0, image(0, 0))) else {
            panic!("the first frame is kept");
        };
        for i in 1..40u32 {
            let angle = f64::from(i % 8) * 0.18 + f64::from(i / 8) * 0.05;
            store.offer(frame(i64::from(i) * 10, angle, image(i, 0)));
        }
        assert!(store.report().num_evicted + store.report().rejected_by_reason.len() as u64 > 0);
        assert!(store.keyframes().any(|k| k.id == lonely));
    }

    #[test]
    fn a_sharper_frame_of_the_same_view_replaces_a_dull_one() {
        let mut store = KeyframeStore::new(&KeyframeParams::default());
        assert_eq!(
            store.offer(frame(0, 0.0, image(1, 4))),
            Admission::Kept(KeyframeId(0))
        );
        assert_eq!(
            store.offer(frame(1, 0.001, image(1, 4))),
            Admission::Rejected(RejectReason::SameView)
        );
        assert_eq!(
            store.offer(frame(2, 0.002, image(1, 0))),
            Admission::Replaced {
                id: KeyframeId(1),
                replaced: KeyframeId(0)
            }
        );
        assert_eq!(ids(&store), [1]);
    }

    #[test]
    fn blurred_frames_go_unless_they_show_something_new() {
        let mut store = KeyframeStore::new(&KeyframeParams::default());
        for i in 0..8 {
            store.offer(frame(i, i as f64 * 0.5, image(1, 0)));
        }
        let blurred = Admission::Rejected(RejectReason::Blurred);
        assert_eq!(store.offer(frame(8, 1.75, image(1, 8))), blurred);
        let far = store.offer(frame(9, 5.0, image(1, 8)));
        assert!(matches!(far, Admission::Kept(_)), "{far:?}");
    }

    #[test]
    fn sparse_frames_need_less_motion_and_a_camera_at_rest_gives_one() {
        let mut store = KeyframeStore::new(&KeyframeParams::default());
        for i in 0..20 {
            let _kept = store.offer(frame(i * 10, i as f64 * 0.03, image(1, 0)));
        }
        assert_eq!(store.len(), 20);
        for i in 0..20 {
            let _kept = store.offer(frame(1_000 + i * 10, 1.5, image(1, 0)));
        }
        assert_eq!(store.len(), 21);
    }

    #[test]
    fn bad_images_are_refused_and_bad_depth_costs_only_itself() {
        let mut store = KeyframeStore::new(&KeyframeParams::default());
        let black = ColorImage::new(WIDTH, HEIGHT, vec![[0; 3]; (WIDTH * HEIGHT) as usize]);
        let black = EncodedColor::png_from_image(&black.unwrap()).unwrap();
        assert_eq!(
            store.offer(frame(0, 0.0, black)),
            Admission::Rejected(RejectReason::BadExposure)
        );
        let mut wrong_size = frame(0, 0.0, image(1, 0));
        wrong_size.color_camera.pinhole = wrong_size.color_camera.pinhole.resized(9, 9).unwrap();
        assert!(matches!(
            store.offer(wrong_size),
            Admission::Rejected(RejectReason::BadImage(ImageError::Length { .. }))
        ));
        let mut bytes = image(1, 0).bytes().to_vec();
        let middle = bytes.len() / 2;
        bytes[middle..].fill(0xff);
        if let Ok(broken) = EncodedColor::from_file(bytes.into()) {
            assert!(matches!(
                store.offer(frame(0, 0.0, broken)),
                Admission::Rejected(RejectReason::BadImage(_))
            ));
        }
        let mut bad_depth = frame(0, 0.0, image(1, 0));
        if let Some(half) = &mut bad_depth.depth {
            half.camera.pinhole = half.camera.pinhole.resized(9, 9).unwrap();
        }
        assert!(matches!(store.offer(bad_depth), Admission::Kept(_)));
        assert!(store.keyframes().all(|k| k.depth.is_none()));
        assert_eq!(store.report().num_depth_refused, 1);
        let mut store = KeyframeStore::new(&KeyframeParams {
            budget_mb: 1e-5,
            ..KeyframeParams::default()
        });
        assert_eq!(
            store.offer(frame(0, 0.0, image(1, 0))),
            Admission::Rejected(RejectReason::LargerThanBudget)
        );
    }

    #[test]
    fn raw_images_are_stored_compressed_and_decode_to_the_same_pixels() {
        let recorded = image(3, 2).decode().unwrap();
        let raw = EncodedColor::from_raw(
            crate::geom::ColorEncoding::Rgb8,
            WIDTH,
            HEIGHT,
            WIDTH * 3,
            recorded.pixels().as_flattened().into(),
        )
        .unwrap();
        let mut store = KeyframeStore::new(&KeyframeParams::default());
        store.offer(frame(0, 0.0, raw.clone()));
        let keyframe = store.keyframes().next().unwrap().clone();
        assert!(keyframe.color.bytes().len() < raw.bytes().len());
        assert_eq!(store.decode(&keyframe).unwrap().color, recorded);
    }

    #[test]
    fn decoding_does_not_depend_on_the_cache_nor_on_threads() {
        let distortion = Distortion::PlumbBob([-0.2, 0.05, 0.001, 0.0, 0.0]);
        let fill = |decode_cache_mb| {
            let mut store = KeyframeStore::new(&KeyframeParams {
                decode_cache_mb,
                ..KeyframeParams::default()
            });
            for i in 0..30u32 {
                let mut frame = frame(i64::from(i), f64::from(i) * 0.2, image(i, 0));
                frame.color_camera = camera(distortion);
                store.offer(frame);
            }
            store
        };
        let one_mb = 64.0 * 48.0 * 7.0 * 1e-6;
        let (none, some, all) = (fill(0.0), fill(7.5 * one_mb), fill(100.0));
        for _ in 0..3 {
            let decoded = |store: &KeyframeStore| -> Vec<Arc<DecodedFrame>> {
                let keyframes: Vec<_> = store.keyframes().cloned().collect();
                keyframes
                    .par_iter()
                    .map(|k| store.decode(k).unwrap())
                    .collect()
            };
            let expected = decoded(&none);
            assert_eq!(decoded(&some), expected);
            assert_eq!(decoded(&all), expected);
        }
        assert_eq!(none.cache_report().num_decoded, 90);
        let some = some.cache_report();
        assert!(some.peak_bytes as f64 <= 7.5 * one_mb * 1e6 && some.num_decoded < 90);
        assert!(all.cache_report().num_decoded < 60);
    }

    #[test]
    fn a_stale_cache_takes_newcomers() {
        let mut store = KeyframeStore::new(&KeyframeParams {
            decode_cache_mb: 1.5 * 64.0 * 48.0 * 7.0 * 1e-6,
            ..KeyframeParams::default()
        });
        store.offer(frame(0, 0.0, image(0, 0)));
        store.offer(frame(1, 1.0, image(1, 0)));
        let keyframes: Vec<_> = store.keyframes().cloned().collect();
        store.decode(&keyframes[0]).unwrap();
        for _ in 0..200 {
            store.decode(&keyframes[1]).unwrap();
        }
        assert!(store.cache_report().num_decoded < 100);
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(24))]
        #[test]
        fn any_sequence_keeps_the_budget_and_the_counts(
            poses in prop::collection::vec((-3.2f64..3.2, 0i64..400, 0u32..6), 1..40),
            num_frames in 1.2f64..8.0,
        ) {
            let one = encoded_bytes(&image(0, 0), Some(&depth()));
            let budget_mb = num_frames * one as f64 * 1e-6;
            let mut store = KeyframeStore::new(&KeyframeParams {
                budget_mb,
                ..KeyframeParams::default()
            });
            for (angle, time, blur) in poses {
                store.offer(frame(time, angle, image(7, blur)));
                prop_assert!(store.num_bytes() as f64 <= budget_mb * 1e6);
                let held: usize = store
                    .keyframes()
                    .map(|k| encoded_bytes(&k.color, k.depth.as_ref()))
                    .sum();
                prop_assert_eq!(held, store.num_bytes());
            }
            // The counts kept up to date equal the counts made anew.
            for stored in store.stored.values() {
                let mut counts = [0; NUM_SAMPLES];
                for other in store.stored.values().filter(|o| o.keyframe.id != stored.keyframe.id) {
                    let shown = stored.view.shown_by(&other.view);
                    for (i, count) in counts.iter_mut().enumerate() {
                        *count += shown >> i & 1;
                    }
                }
                prop_assert_eq!(counts, stored.num_shown_by);
            }
            let report = store.report();
            let num_rejected: u64 = report.rejected_by_reason.values().sum();
            prop_assert_eq!(report.num_admitted + num_rejected, report.num_offered);
        }
    }
}
