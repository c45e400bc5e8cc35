//! Depths that keyframes see, kept between updates within a budget of bytes. Whether a keyframe's
//! are kept changes what an update costs, and nothing else.

use std::collections::BTreeMap;
use std::sync::Arc;

use super::keyframes::Turnover;
use crate::geom::camera::CameraError;
use crate::geom::{PinholeCamera, RigidTransform};
use crate::keyframe::Keyframe;
use crate::mesh::TriMesh;
use crate::render::{
    Frustum, KeptView, MeshRuns, PixelWindow, ViewPoint, ViewScratch, VisibilityParams,
    WindowFinder,
};

/// Views by the number of their keyframe.
#[derive(Debug, Default)]
pub(super) struct KeptViews {
    by_frame: BTreeMap<u32, Kept>,
    num_updates: u64,
}

#[derive(Debug)]
struct Kept {
    view: KeptView,
    /// The update that looked at it last.
    last_used: u64,
}

/// What an update has of a keyframe's view.
#[derive(Debug, Default)]
pub(super) struct ViewSlot {
    pub(super) view: Option<KeptView>,
    /// Whether there is room to keep it, where it is not yet.
    pub(super) may_be_kept: bool,
    /// Whether it was looked at.
    pub(super) is_used: bool,
    last_used: u64,
}

impl KeptViews {
    pub(super) fn num_bytes(&self) -> usize {
        let views = self.by_frame.values();
        views.map(|kept| kept.view.num_bytes()).sum()
    }

    /// Takes out the views of all keyframes. Those that are new come first where room is scarce, then
    /// those that were looked at last.
    pub(super) fn take(
        &mut self,
        frames: &[Arc<Keyframe>],
        turnover: &Turnover,
        params: &VisibilityParams,
        max_bytes: usize,
    ) -> Vec<ViewSlot> {
        let mut before = std::mem::take(&mut self.by_frame);
        let num_bytes = |frame: &Keyframe| {
            let camera = &frame.color_camera.pinhole;
            let buffer = WindowFinder::new(camera, params).buffer_camera(camera);
            buffer.map_or(usize::MAX, |camera| KeptView::num_bytes_of(&camera))
        };
        let mut slots: Vec<ViewSlot> = Vec::with_capacity(frames.len());
        let mut by_need: Vec<(u64, u32, usize)> = Vec::with_capacity(frames.len());
        for (index, frame) in frames.iter().enumerate() {
            let number = frame.id.0;
            let is_unseen = turnover.is_unseen(number);
            let kept = before.remove(&number).filter(|_| !is_unseen);
            let last_used = match &kept {
                Some(kept) => kept.last_used,
                None if is_unseen => u64::MAX,
                None => 0,
            };
            by_need.push((last_used, number, index));
            slots.push(ViewSlot {
                last_used: kept.as_ref().map_or(0, |kept| kept.last_used),
                view: kept.map(|kept| kept.view),
                ..ViewSlot::default()
            });
        }
        by_need.sort_unstable_by(|a, b| b.cmp(a));
        let mut left = max_bytes;
        for (_, _, index) in by_need {
            let room = left.checked_sub(num_bytes(&frames[index]));
            slots[index].may_be_kept = room.is_some();
            match room {
                Some(room) => left = room,
                None => slots[index].view = None,
            }
        }
        slots
    }

    /// Puts back what is kept.
    pub(super) fn put_back(&mut self, frames: &[Arc<Keyframe>], slots: Vec<ViewSlot>) {
        self.num_updates += 1;
        for (frame, slot) in frames.iter().zip(slots) {
            let last_used = if slot.is_used {
                self.num_updates
            } else {
                slot.last_used
            };
            if let Some(view) = slot.view {
                self.by_frame.insert(frame.id.0, Kept { view, last_used });
            }
        }
    }
}

/// What a keyframe's view is drawn from.
pub(super) struct Drawing<'a> {
    pub(super) mesh: &'a TriMesh,
    pub(super) runs: &'a MeshRuns,
    pub(super) far_m: f64,
}

impl ViewSlot {
    /// Has the view drawn as far as it is not, where it may be kept.
    pub(super) fn bring_up(
        &mut self,
        drawing: &Drawing<'_>,
        camera: &PinholeCamera,
        camera_from_world: &RigidTransform,
        finder: &WindowFinder,
        scratch: &mut ViewScratch,
    ) -> Result<(), CameraError> {
        if !self.may_be_kept {
            return Ok(());
        }
        self.is_used = true;
        let camera = finder.buffer_camera(camera)?;
        let from = ViewPoint {
            camera: &camera,
            camera_from_world,
        };
        let Drawing { mesh, runs, far_m } = drawing;
        let part = |window: PixelWindow| {
            runs.in_frustum(&Frustum::of_window(
                &camera,
                camera_from_world,
                *far_m,
                window,
            ))
        };
        match &mut self.view {
            Some(view) if view.stale().is_empty() => {}
            Some(view) => view.redraw(mesh, &part(view.stale()), from, scratch),
            None => self.view = Some(KeptView::of(mesh, &part(finder.whole()), from, scratch)),
        }
        Ok(())
    }
}
