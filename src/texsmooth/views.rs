//! The views that the optimisation draws from, and who can partner whom.

use std::collections::VecDeque;
use std::sync::Arc;

use nalgebra::Vector3;

use super::view::View;
use super::{Decode, PartnerRule};
use crate::geom::ImageError;
use crate::keyframe::{DecodedFrame, Keyframe};
use crate::render::{GpuError, MeshViews, ViewBuffer};

/// A view with its photo.
#[derive(Clone)]
pub(super) struct Seen {
    pub(super) view: Arc<View>,
    pub(super) photo: Arc<DecodedFrame>,
}

/// Why there is no view.
#[derive(Debug, thiserror::Error)]
pub(super) enum UnseenError {
    /// Its photo does not decode.
    #[error(transparent)]
    Photo(#[from] ImageError),
    /// It could not be drawn.
    #[error(transparent)]
    Device(#[from] GpuError),
}

/// Views by index; those used last stay in memory, up to a number of bytes.
pub(super) struct Views<'a> {
    mesh: MeshViews<'a>,
    frames: &'a [Arc<Keyframe>],
    decode: &'a Decode<'a>,
    budget_bytes: usize,
    kept: Vec<Option<Arc<View>>>,
    /// The one used last comes last.
    order: VecDeque<usize>,
    num_bytes: usize,
}

impl<'a> Views<'a> {
    pub(super) fn new(
        mesh: MeshViews<'a>,
        frames: &'a [Arc<Keyframe>],
        decode: &'a Decode<'a>,
        budget_bytes: usize,
    ) -> Self {
        Self {
            mesh,
            frames,
            decode,
            budget_bytes,
            kept: vec![None; frames.len()],
            order: VecDeque::new(),
            num_bytes: 0,
        }
    }

    pub(super) fn len(&self) -> usize {
        self.frames.len()
    }

    pub(super) fn frame(&self, index: usize) -> &Keyframe {
        &self.frames[index]
    }

    /// A view and its photo.
    pub(super) fn get(&mut self, index: usize) -> Result<Seen, UnseenError> {
        let photo = (self.decode)(&self.frames[index])?;
        if let Some(view) = self.kept[index].clone() {
            self.order.retain(|&other| other != index);
            self.order.push_back(index);
            return Ok(Seen { view, photo });
        }
        let keyframe = &self.frames[index];
        let camera_from_world = keyframe.world_from_camera.inverse();
        let mut buffer = ViewBuffer::default();
        self.mesh
            .rasterize(&photo.color_camera, &camera_from_world, &mut buffer)?;
        let view = Arc::new(View {
            camera: photo.color_camera,
            camera_from_world,
            triangle: buffer.triangle,
        });
        self.keep(index, &view);
        Ok(Seen { view, photo })
    }

    fn keep(&mut self, index: usize, view: &Arc<View>) {
        let size = |view: &View| size_of_val(view.triangle.as_slice());
        self.num_bytes += size(view);
        self.kept[index] = Some(Arc::clone(view));
        self.order.push_back(index);
        while self.num_bytes > self.budget_bytes && self.order.len() > 1 {
            if let Some(oldest) = self.order.pop_front()
                && let Some(dropped) = self.kept[oldest].take()
            {
                self.num_bytes -= size(&dropped);
            }
        }
    }
}

/// Per view, in order: the views whose axes differ from its own by less than an angle, itself
/// among them (ECCV 2022, section 3.2).
pub(super) fn partners(
    frames: &[Arc<Keyframe>],
    max_angle_rad: f64,
    rule: PartnerRule,
) -> Vec<Vec<usize>> {
    let axes: Vec<Vector3<f64>> = frames
        .iter()
        .map(|frame| match rule {
            PartnerRule::ViewingAxis => frame.world_from_camera.transform_vector(&Vector3::z()),
            PartnerRule::WorldAxis => {
                let camera_from_world = frame.world_from_camera.inverse();
                camera_from_world.transform_vector(&Vector3::z())
            }
        })
        .collect();
    axes.iter()
        .enumerate()
        .map(|(index, axis)| {
            let is_partner =
                |other: &usize| *other == index || axis.angle(&axes[*other]) < max_angle_rad;
            (0..axes.len()).filter(is_partner).collect()
        })
        .collect()
}
