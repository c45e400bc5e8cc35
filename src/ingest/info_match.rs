//! Finds the intrinsics that belong to an image.
//!
//! Camera infos are states, not measurements: some drivers send one with every image, others one
//! at the start. An image takes the info of its own stamp. While infos keep coming with the
//! images, an image whose info is not there yet waits for it until a later info or the next image
//! shows that it will not come; then, and whenever infos do not come with the images, the info
//! nearest in time serves. Images that come before any info wait in a bounded queue.

use std::collections::VecDeque;

use super::sync::Stamped;
use crate::geom::{CameraModel, Stamp};

/// An image with its intrinsics, or one that must go without.
#[derive(Debug)]
pub(super) enum Matched<I> {
    /// Intrinsics were found.
    Known {
        image: Stamped<I>,
        camera: CameraModel,
        /// Whether the info has the image's stamp.
        is_exact: bool,
    },
    /// No info ever came.
    Unknown(Stamped<I>),
}

/// Pairs the images of one stream with its camera infos.
#[derive(Debug)]
pub(super) struct InfoMatcher<I> {
    /// By stamp, ascending.
    infos: VecDeque<(Stamp, CameraModel)>,
    /// In the order of arrival; more than one only while no info was ever seen.
    waiting: VecDeque<Stamped<I>>,
    queue_size: usize,
    comes_with_images: bool,
}

impl<I> InfoMatcher<I> {
    pub(super) fn new(queue_size: usize) -> Self {
        Self {
            infos: VecDeque::new(),
            waiting: VecDeque::new(),
            queue_size: queue_size.max(1),
            comes_with_images: true,
        }
    }

    pub(super) fn num_pending(&self) -> usize {
        self.waiting.len()
    }

    pub(super) fn has_info(&self) -> bool {
        !self.infos.is_empty()
    }

    pub(super) fn push_info(
        &mut self,
        stamp: Stamp,
        camera: CameraModel,
        out: &mut Vec<Matched<I>>,
    ) {
        let at = self.infos.partition_point(|(other, _)| *other < stamp);
        match self.infos.get_mut(at) {
            Some(known) if known.0 == stamp => known.1 = camera,
            _ => self.infos.insert(at, (stamp, camera)),
        }
        if self.infos.len() > self.queue_size {
            // Older than all that are kept: the clock was set back, and they are of another time.
            if at == 0 {
                self.infos.truncate(1);
            } else {
                self.infos.pop_front();
            }
        }
        while let Some(image) = self.waiting.front() {
            let is_last = self.waiting.len() == 1;
            if is_last && image.stamp > stamp && self.comes_with_images {
                break;
            }
            self.release_first(out);
        }
    }

    pub(super) fn push_image(&mut self, image: Stamped<I>, out: &mut Vec<Matched<I>>) {
        if self.has_info() {
            while !self.waiting.is_empty() {
                self.release_first(out);
            }
        }
        let has_exact = self
            .infos
            .binary_search_by_key(&image.stamp, |(stamp, _)| *stamp)
            .is_ok();
        let has_later = self
            .infos
            .back()
            .is_some_and(|(stamp, _)| *stamp > image.stamp);
        let may_still_come = self.comes_with_images && !has_later;
        self.waiting.push_back(image);
        if has_exact || (self.has_info() && !may_still_come) || self.waiting.len() > self.queue_size
        {
            self.release_first(out);
        }
    }

    /// Releases every waiting image.
    pub(super) fn flush(&mut self, out: &mut Vec<Matched<I>>) {
        while !self.waiting.is_empty() {
            self.release_first(out);
        }
    }

    fn release_first(&mut self, out: &mut Vec<Matched<I>>) {
        let Some(image) = self.waiting.pop_front() else {
            return;
        };
        let nearest = self
            .infos
            .iter()
            .min_by_key(|(stamp, _)| stamp.abs_diff_nanos(image.stamp));
        out.push(match nearest {
            Some(&(stamp, camera)) => {
                let is_exact = stamp == image.stamp;
                self.comes_with_images = is_exact;
                Matched::Known {
                    image,
                    camera,
                    is_exact,
                }
            }
            None => Matched::Unknown(image),
        });
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geom::PinholeCamera;

    fn camera(fx: f64) -> CameraModel {
        CameraModel::ideal(PinholeCamera::new([fx, fx, 1.0, 1.0], 4, 4).unwrap())
    }

    fn image(ms: i64) -> Stamped<i64> {
        Stamped {
            stamp: Stamp::from_nanos(ms),
            payload: ms,
        }
    }

    fn known(out: &[Matched<i64>]) -> Vec<(i64, f64, bool)> {
        out.iter()
            .map(|m| match m {
                Matched::Known {
                    image,
                    camera,
                    is_exact,
                } => (image.payload, camera.pinhole.intrinsics_px()[0], *is_exact),
                Matched::Unknown(image) => (image.payload, 0.0, false),
            })
            .collect()
    }

    #[test]
    fn infos_with_every_image_match_exactly_in_either_order() {
        let mut matcher = InfoMatcher::new(5);
        let mut out = Vec::new();
        for i in 0..6 {
            let stamp = Stamp::from_nanos(i);
            let camera = camera(100.0 + i as f64);
            if i % 2 == 0 {
                matcher.push_info(stamp, camera, &mut out);
                matcher.push_image(image(i), &mut out);
            } else {
                matcher.push_image(image(i), &mut out);
                matcher.push_info(stamp, camera, &mut out);
            }
        }
        let expected: Vec<_> = (0..6).map(|i| (i, 100.0 + i as f64, true)).collect();
        assert_eq!(known(&out), expected);
    }

    #[test]
    fn one_info_at_the_start_serves_all_with_one_image_of_delay_at_most() {
        let mut matcher = InfoMatcher::new(5);
        let mut out = Vec::new();
        matcher.push_info(Stamp::from_nanos(0), camera(7.0), &mut out);
        for i in 0..5 {
            matcher.push_image(image(i), &mut out);
        }
        assert_eq!(matcher.num_pending(), 0);
        assert_eq!(known(&out).len(), 5);
        assert!(known(&out).iter().all(|k| k.1 == 7.0));
    }

    #[test]
    fn an_info_from_before_all_others_leaves_none_of_them() {
        let mut matcher = InfoMatcher::new(3);
        let mut out = Vec::new();
        for ns in [100, 101, 102] {
            matcher.push_info(Stamp::from_nanos(ns), camera(7.0), &mut out);
        }
        matcher.push_info(Stamp::from_nanos(5), camera(9.0), &mut out);
        matcher.push_image(image(90), &mut out);
        matcher.flush(&mut out);
        assert_eq!(known(&out), [(90, 9.0, false)]);
    }

    #[test]
    fn without_info_the_queue_is_bounded_and_the_oldest_goes_without() {
        let mut matcher = InfoMatcher::new(3);
        let mut out = Vec::new();
        for i in 0..5 {
            matcher.push_image(image(i), &mut out);
        }
        assert_eq!(known(&out), [(0, 0.0, false), (1, 0.0, false)]);
        matcher.push_info(Stamp::from_nanos(4), camera(7.0), &mut out);
        assert_eq!(
            known(&out)[2..],
            [(2, 7.0, false), (3, 7.0, false), (4, 7.0, true)]
        );
    }
}
