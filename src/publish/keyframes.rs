//! `~/keyframes`: where the kept frames were taken.

use crate::wire::geometry::WirePose;
use crate::wire::{Message, PoseArray};

use super::{PublishError, PublishParams, Snapshot};

/// What went out last.
#[derive(Debug, Default)]
pub(super) struct Keyframes {
    sent: Option<(u64, String, Vec<WirePose>)>,
}

/// Bytes of a pose.
const POSE_BYTES: usize = 56;

impl Keyframes {
    pub(super) fn forget(&mut self) {
        self.sent = None;
    }

    /// All poses of the colour camera in the world, oldest first; where a message cannot hold all,
    /// the newest.
    pub(super) fn publish(
        &mut self,
        snapshot: &Snapshot<'_>,
        params: &PublishParams,
    ) -> Result<Vec<Vec<u8>>, PublishError> {
        let mut array = PoseArray {
            header: snapshot.header(),
            poses: Vec::new(),
        };
        // The first pose is aligned to 8 bytes.
        let num_fixed = array.encode().len() + 8;
        let most = params.max_message_bytes.saturating_sub(num_fixed) / POSE_BYTES;
        let first = snapshot.keyframes.len().saturating_sub(most);
        array.poses = snapshot.keyframes[first..]
            .iter()
            .map(|keyframe| WirePose::from(&keyframe.world_from_camera))
            .collect();
        let now = (
            snapshot.session,
            snapshot.frame_id.to_owned(),
            array.poses.clone(),
        );
        if self.sent.as_ref() == Some(&now) {
            return Ok(Vec::new());
        }
        let message = params.checked("keyframes", array.encode())?;
        self.sent = Some(now);
        Ok(vec![message])
    }
}
