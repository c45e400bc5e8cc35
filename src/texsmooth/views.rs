//! The views that the optimisation draws from, and who can partner whom.

use std::collections::VecDeque;
use std::sync::Arc;

use nalgebra::Vector3;

use super::view::{Surface, View};
use super::{Decode, PartnerRule};
use crate::geom::ImageError;
use crate::keyframe::{DecodedFrame, Keyframe};
use crate::render::{GpuError, MeshViews, ViewBuffer, ViewRasterizer};

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

/// What the views show; those used last stay in memory, up to a number of bytes.
pub(super) struct ViewCache {
    budget_bytes: usize,
    kept: Vec<Option<Arc<View>>>,
    /// The one used last comes last.
    order: VecDeque<usize>,
    num_bytes: usize,
}

impl ViewCache {
    pub(super) fn new(num_views: usize, budget_bytes: usize) -> Self {
        Self {
            budget_bytes,
            kept: vec![None; num_views],
            order: VecDeque::new(),
            num_bytes: 0,
        }
    }

    fn get(&mut self, index: usize) -> Option<Arc<View>> {
        let view = self.kept[index].clone()?;
        self.order.retain(|&other| other != index);
        self.order.push_back(index);
        Some(view)
    }

    fn keep(&mut self, index: usize, view: &Arc<View>) {
        self.num_bytes += view.num_bytes();
        self.kept[index] = Some(Arc::clone(view));
        self.order.push_back(index);
        while self.num_bytes > self.budget_bytes && self.order.len() > 1 {
            if let Some(oldest) = self.order.pop_front()
                && let Some(dropped) = self.kept[oldest].take()
            {
                self.num_bytes -= dropped.num_bytes();
            }
        }
    }
}

/// Views by index.
pub(super) struct Views<'a> {
    pub(super) on: Surface<'a>,
    pub(super) rasterizer: &'a ViewRasterizer,
    /// Loaded when the first view is drawn.
    pub(super) mesh: Option<MeshViews<'a>>,
    pub(super) frames: &'a [Arc<Keyframe>],
    pub(super) decode: &'a Decode<'a>,
    pub(super) cache: &'a mut ViewCache,
}

impl Views<'_> {
    pub(super) fn len(&self) -> usize {
        self.frames.len()
    }

    pub(super) fn frame(&self, index: usize) -> &Keyframe {
        &self.frames[index]
    }

    /// A view and its photo.
    pub(super) fn get(&mut self, index: usize) -> Result<Seen, UnseenError> {
        let photo = (self.decode)(&self.frames[index])?;
        if let Some(view) = self.cache.get(index) {
            return Ok(Seen { view, photo });
        }
        let mesh = match &mut self.mesh {
            Some(mesh) => mesh,
            none => none.insert(self.rasterizer.load(self.on.mesh)?),
        };
        let camera_from_world = self.frames[index].world_from_camera.inverse();
        let mut buffer = ViewBuffer::default();
        mesh.rasterize(&photo.color_camera, &camera_from_world, &mut buffer)?;
        let camera = photo.color_camera;
        let view = Arc::new(View::new(
            self.on,
            camera,
            camera_from_world,
            buffer.triangle,
        ));
        self.cache.keep(index, &view);
        Ok(Seen { view, photo })
    }
}

/// Per view: the axis that says who may be its partner.
pub(super) fn partner_axes(frames: &[Arc<Keyframe>], rule: PartnerRule) -> Vec<Vector3<f64>> {
    let axes = frames.iter().map(|frame| match rule {
        PartnerRule::ViewingAxis => frame.world_from_camera.transform_vector(&Vector3::z()),
        PartnerRule::WorldAxis => {
            let camera_from_world = frame.world_from_camera.inverse();
            camera_from_world.transform_vector(&Vector3::z())
        }
    });
    axes.collect()
}

/// The views whose axes differ from that of `index` by less than an angle, in order, itself among
/// them (ECCV 2022, section 3.2).
pub(super) fn partners(
    axes: &[Vector3<f64>],
    index: usize,
    max_angle_rad: f64,
) -> impl Iterator<Item = usize> {
    (0..axes.len())
        .filter(move |&other| other == index || axes[index].angle(&axes[other]) < max_angle_rad)
}
