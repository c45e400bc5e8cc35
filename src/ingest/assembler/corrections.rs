//! Better poses of frames that were given out before.

use std::sync::Arc;

use super::super::event::{CorrectedBody, Header, PoseCorrection};
use super::super::pose_buffer::normalized_frame;
use super::super::report::reason_class;
use super::Assembler;

impl Assembler {
    /// Corrections are about the past: they do not wait for transforms, which would not come.
    pub(super) fn take_corrections(
        &mut self,
        topic: usize,
        header: &Header,
        body: CorrectedBody,
        corrections: &[PoseCorrection],
    ) {
        if corrections.len() > self.limits.corrections {
            let (num, limit) = (corrections.len(), self.limits.corrections);
            let words = format!("corrections of {num} poses, limits.corrections is {limit}");
            self.topic_report(topic)
                .refuse(&reason_class(&words), header.stamp, &words);
            return;
        }
        let camera_frame = self.camera_frame.clone();
        let camera = camera_frame.or_else(|| self.seen_camera_frame.clone());
        let camera = camera.unwrap_or_else(|| Arc::from(""));
        let frame = normalized_frame(&header.frame_id);
        self.poses.settle_world(frame);
        let tolerance_s = self.max_extrapolation_s;
        let num_before = self.corrections.len();
        let mut first_error = None;
        for correction in corrections {
            let (stamp, pose) = (correction.stamp, correction.pose);
            let corrected =
                self.poses
                    .world_from_corrected(frame, body, &camera, stamp, pose, tolerance_s);
            match corrected {
                Ok(pose) => self.corrections.push(PoseCorrection { stamp, pose }),
                Err(error) => first_error = first_error.or(Some((stamp, error))),
            }
        }
        match first_error {
            Some((stamp, error)) if self.corrections.len() == num_before => {
                self.topic_report(topic)
                    .refuse(error.class(), stamp, &error.to_string());
            }
            _ => self.topic_report(topic).num_used += 1,
        }
    }
}
