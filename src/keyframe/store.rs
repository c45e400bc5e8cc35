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
use super::sight::SightBox;
use crate::geom::{
    DepthImage, EncodedColor, FrameDepth, ImageError, PosedFrame, RigidTransform, Stamp,
};

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
    /// It sees nothing of [`KeyframeParams::must_see`].
    OutsideRegion,
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
            Self::OutsideRegion => "sees nothing of region.box",
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
    /// Keyframes of an earlier run that were taken up again.
    pub num_restored: u64,
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
    /// Keyframes that were moved to a corrected pose, each time counted.
    pub num_poses_corrected: u64,
    /// Corrections of a stamp at which no keyframe was taken.
    pub num_corrections_unmatched: u64,
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
    max_correction_interval_ns: u64,
    must_see: Option<SightBox>,
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
            max_correction_interval_ns: nanos_from_seconds(params.max_correction_interval_s),
            must_see: params.must_see,
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

    /// Takes a keyframe of an earlier run as it is, its number included; the most redundant go
    /// where the budget is smaller than it was.
    pub fn restore(&mut self, keyframe: Arc<Keyframe>) {
        self.remove(keyframe.id);
        let half = keyframe.depth.as_ref();
        let depth = half.and_then(|half| half.image.decode().ok());
        let frame = PosedFrame {
            stamp: keyframe.stamp,
            world_from_camera: keyframe.world_from_camera,
            color: keyframe.color.clone(),
            color_camera: keyframe.color_camera,
            depth: keyframe.depth.clone(),
        };
        let view = View::new(&frame, depth.as_ref());
        let num_bytes = keyframe.num_bytes();
        self.reserve_ids(KeyframeId(keyframe.id.0.saturating_add(1)));
        self.selector.note_kept(keyframe.stamp);
        self.report.num_restored += 1;
        self.place(keyframe, view, num_bytes);
        while self.report.num_bytes > self.budget_bytes
            && let Some(evicted) = self.most_redundant(None)
        {
            self.remove(evicted);
            self.report.num_evicted += 1;
        }
    }

    /// No later keyframe has a number below `next_id`.
    pub fn reserve_ids(&mut self, next_id: KeyframeId) {
        self.next_id = self.next_id.max(next_id.0);
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

    /// Puts each keyframe that has a new pose for its stamp there; how many moved. A stamp may differ
    /// from the keyframe's by [`KeyframeParams::max_correction_interval_s`]; of several poses for one
    /// keyframe the last holds.
    pub fn correct_poses(&mut self, poses: &[(Stamp, RigidTransform)]) -> usize {
        let mut ids: Vec<(Stamp, KeyframeId)> = self
            .stored
            .values()
            .map(|stored| (stored.keyframe.stamp, stored.keyframe.id))
            .collect();
        ids.sort_unstable();
        let mut corrected = BTreeMap::new();
        for (stamp, pose) in poses {
            match nearest(&ids, *stamp, self.max_correction_interval_ns) {
                Some(id) => drop(corrected.insert(id, *pose)),
                None => self.report.num_corrections_unmatched += 1,
            }
        }
        let mut num_moved = 0;
        for (id, pose) in corrected {
            num_moved += usize::from(self.move_to(id, pose));
        }
        self.report.num_poses_corrected += num_moved as u64;
        num_moved
    }

    /// Whether the keyframe was elsewhere.
    fn move_to(&mut self, id: KeyframeId, world_from_camera: RigidTransform) -> bool {
        let Some(mut moved) = self.stored.remove(&id) else {
            return false;
        };
        let is_moved = moved.keyframe.world_from_camera != world_from_camera;
        if is_moved {
            self.unlink(&moved.view);
            moved.view = moved.view.moved_to(&world_from_camera);
            self.link(&moved.view);
            moved.num_shown_by = self.num_shown_by(&moved.view);
            moved.keyframe = Arc::new(Keyframe {
                world_from_camera,
                ..(*moved.keyframe).clone()
            });
        }
        self.stored.insert(id, moved);
        is_moved
    }

    /// A keyframe's images, decoded and undistorted, from the cache where it has them.
    ///
    /// # Errors
    /// [`ImageError`] when an image does not decode.
    pub fn decode(&self, keyframe: &Keyframe) -> Result<Arc<DecodedFrame>, ImageError> {
        self.cache.get_or_decode(keyframe)
    }

    /// Keeps at most this many bytes of decoded frames from now on.
    pub fn set_decode_cache_bytes(&mut self, max_bytes: usize) {
        self.cache.set_max_bytes(max_bytes);
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
        let depth = self.decoded_depth(&mut frame);
        if let Some(part) = &self.must_see
            && !part.may_be_seen_by(&frame, depth.as_ref())
        {
            // The recording is no sparser for it.
            self.selector.note_kept(frame.stamp);
            return Err(RejectReason::OutsideRegion);
        }
        let depth = depth.filter(|_| self.compress_depth(&mut frame));
        let view = View::new(&frame, depth.as_ref());
        frame.color = frame
            .color
            .compressed_lossless()
            .map_err(RejectReason::BadImage)?;
        let admission = self.insert(frame, quality, view, replaced)?;
        if let (Admission::Kept(id) | Admission::Replaced { id, .. }, Some(depth)) =
            (&admission, depth)
            && let Some(stored) = self.stored.get(id)
        {
            self.cache.offer_depth(&stored.keyframe, depth);
        }
        Ok(admission)
    }

    /// Decodes the depth image; one that cannot be used is taken out of the frame and counted.
    fn decoded_depth(&mut self, frame: &mut PosedFrame) -> Option<DepthImage> {
        let half = frame.depth.as_ref()?;
        let decoded = decoded_half(half);
        self.usable_depth(frame, decoded)
    }

    /// Whether the depth image, if there is one, could be compressed; else it is taken out too.
    fn compress_depth(&mut self, frame: &mut PosedFrame) -> bool {
        let Some(half) = &mut frame.depth else {
            return true;
        };
        let compressed = half.image.compressed_lossless();
        let compressed = compressed.map(|image| half.image = image);
        self.usable_depth(frame, compressed).is_some()
    }

    fn usable_depth<T>(
        &mut self,
        frame: &mut PosedFrame,
        result: Result<T, ImageError>,
    ) -> Option<T> {
        match result {
            Ok(usable) => Some(usable),
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
        let keyframe = Keyframe {
            id,
            stamp,
            world_from_camera: frame.world_from_camera,
            color: frame.color,
            color_camera: frame.color_camera,
            depth: frame.depth,
            quality,
        };
        self.place(Arc::new(keyframe), view, num_bytes);
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

    fn place(&mut self, keyframe: Arc<Keyframe>, view: View, num_bytes: usize) {
        self.link(&view);
        let num_shown_by = self.num_shown_by(&view);
        let stored = Stored {
            keyframe: Arc::clone(&keyframe),
            view,
            num_shown_by,
            num_bytes,
        };
        self.stored.insert(keyframe.id, stored);
        self.report.num_bytes += num_bytes;
        self.report.peak_bytes = self.report.peak_bytes.max(self.report.num_bytes);
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
        self.unlink(&removed.view);
    }

    /// Counts a view no longer at the views that it showed.
    fn unlink(&mut self, view: &View) {
        for other in self.stored.values_mut() {
            let shown = other.view.shown_by(view);
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

/// The keyframe whose stamp is nearest, of two the earlier one; `ids` ascend.
fn nearest(ids: &[(Stamp, KeyframeId)], stamp: Stamp, max_interval_ns: u64) -> Option<KeyframeId> {
    let after = ids.partition_point(|(other, _)| *other < stamp);
    let candidates = ids.get(after.saturating_sub(1)..ids.len().min(after + 1))?;
    let interval_ns = |(other, _): &&(Stamp, KeyframeId)| other.abs_diff_nanos(stamp);
    let found = candidates.iter().min_by_key(interval_ns)?;
    (interval_ns(&found) <= max_interval_ns).then_some(found.1)
}

fn check_size(frame: &PosedFrame) -> Result<(), ImageError> {
    let camera = &frame.color_camera.pinhole;
    same_size(
        [camera.width(), camera.height()],
        [frame.color.width(), frame.color.height()],
    )
}

fn decoded_half(half: &FrameDepth) -> Result<DepthImage, ImageError> {
    let camera = &half.camera.pinhole;
    same_size(
        [camera.width(), camera.height()],
        [half.image.width(), half.image.height()],
    )?;
    half.image.decode()
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
fn nanos_from_seconds(seconds: f64) -> u64 {
    (seconds * 1e9).round() as u64
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
mod tests;
