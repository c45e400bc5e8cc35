//! Painting one region of a scan, for several programs that share it.
//!
//! A mesh is cut to the region and its halo as it arrives. Charts, hidden surface and the choice of
//! frames then go by all that is left; frames that see nothing of it are not kept; what is given out is
//! the region's own triangles. Programs with
//! regions that tile space share nothing, and their outputs put together are the mesh, every triangle
//! once.

use std::sync::Arc;

use crate::atlas::{AtlasLayout, AtlasTexture, restrict};
use crate::ingest::MeshBlocks;
use crate::keyframe::{KeyframeParams, SightBox};
use crate::mesh::{Region, TriMesh, TriangleId};
use crate::texinit::TexInit;

/// Which part of the world is painted.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RegionParams {
    /// The part, in the world frame; `None` is all.
    pub region: Option<Region>,
    /// Surface around it that is painted for its sake and left to others, metres (≥ 0).
    pub halo_m: f64,
}

impl Default for RegionParams {
    fn default() -> Self {
        Self {
            region: None,
            halo_m: 0.5,
        }
    }
}

impl RegionParams {
    /// The choice of keyframes, with the region and its halo as what they must see.
    pub(super) fn applied_to(&self, keyframe: &KeyframeParams) -> KeyframeParams {
        let part = self.region.as_ref().map(|region| {
            SightBox::new(
                region.min_m().map(|bound_m| bound_m - self.halo_m),
                region.max_m().map(|bound_m| bound_m + self.halo_m),
            )
        });
        KeyframeParams {
            must_see: part.or(keyframe.must_see),
            ..keyframe.clone()
        }
    }

    /// What is painted of a mesh that arrived.
    pub(super) fn cut(&self, mesh: Arc<TriMesh>) -> Arc<TriMesh> {
        match &self.region {
            Some(region) => Arc::new(region.with_halo(&mesh, self.halo_m)),
            None => mesh,
        }
    }

    /// The same of a mesh in blocks.
    pub(super) fn cut_blocks(
        &self,
        mesh: Arc<TriMesh>,
        blocks: &Arc<MeshBlocks>,
    ) -> (Arc<TriMesh>, Arc<MeshBlocks>) {
        let blocks = match &self.region {
            Some(region) => {
                let keep = |triangle| region.is_near(&mesh, triangle, self.halo_m);
                Arc::new(blocks.filtered(&mesh, keep))
            }
            None => Arc::clone(blocks),
        };
        (self.cut(mesh), blocks)
    }

    /// Takes away what is not the region's own; its texels become blank.
    pub(super) fn keep_own(
        &self,
        mesh: &mut TriMesh,
        layout: &mut AtlasLayout,
        texture: &mut AtlasTexture,
    ) {
        let Some(region) = &self.region else { return };
        let is_own = |triangle: TriangleId| region.owns(mesh, triangle);
        for chart in &layout.charts {
            if chart.triangles.iter().any(|&triangle| is_own(triangle)) {
                continue;
            }
            texture.pages[chart.page as usize]
                .to_mut()
                .blank_chart(chart);
        }
        (*mesh, *layout) = restrict(mesh, layout, is_own);
    }

    /// The same for TexInit's result, whose assignment goes by triangles, too.
    pub(super) fn keep_own_of(&self, mesh: &mut TriMesh, made: &mut TexInit) {
        if let Some(region) = &self.region {
            made.assignment.retain(|index| {
                let index = u32::try_from(index).unwrap_or(u32::MAX);
                region.owns(mesh, TriangleId(index))
            });
        }
        self.keep_own(mesh, &mut made.layout, &mut made.texture);
    }
}
