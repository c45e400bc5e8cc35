//! Levelling some triangles of a surface.

use crate::atlas::{AtlasLayout, AtlasTexture, TexelSource};
use crate::mesh::{TriMesh, TriangleId};

use super::super::PhotometricError;
use super::samples::SeamPhoto;
use super::surface::{Levelled, Part, Standing, Surface, sources_of};
use super::{SeamParams, SeamReport, level};

/// Triangles that are to be levelled, and those that have a vertex with one of them in common. What it
/// costs follows them; the rest of the mesh is looked at once, for its vertices.
#[derive(Debug)]
pub struct SeamPatch<'a> {
    layout: &'a AtlasLayout,
    /// Ascending.
    triangles: Vec<TriangleId>,
    mesh: TriMesh,
    /// Indices into `frames`.
    labels: Vec<Option<u32>>,
    frames: Vec<u32>,
}

impl<'a> SeamPatch<'a> {
    /// The patch around `part` of the triangles of `mesh`; `label_of` names the frame that paints a
    /// triangle, by any number.
    ///
    /// # Errors
    /// [`PhotometricError::Mismatch`] where the layout is that of another mesh.
    pub fn around(
        mesh: &TriMesh,
        layout: &'a AtlasLayout,
        part: impl Iterator<Item = TriangleId>,
        label_of: impl Fn(TriangleId) -> Option<u32>,
    ) -> Result<Self, PhotometricError> {
        let num_triangles = mesh.num_triangles();
        let num_in_layout = layout
            .corners_texel
            .len()
            .min(layout.chart_of_triangle.len());
        if num_in_layout != num_triangles {
            return Err(PhotometricError::Mismatch {
                num_triangles,
                num_in_layout,
                num_labels: num_triangles,
            });
        }
        let mut is_vertex = vec![false; mesh.num_vertices()];
        for triangle in part.filter(|triangle| triangle.index() < num_triangles) {
            for vertex in mesh.triangles()[triangle.index()] {
                is_vertex[vertex as usize] = true;
            }
        }
        let is_near = |triangle: TriangleId| {
            let corners = mesh.triangles()[triangle.index()];
            corners.iter().any(|vertex| is_vertex[*vertex as usize])
        };
        let triangles: Vec<TriangleId> = mesh.triangle_ids().filter(|t| is_near(*t)).collect();
        let named: Vec<Option<u32>> = triangles.iter().map(|t| label_of(*t)).collect();
        let mut frames: Vec<u32> = named.iter().copied().flatten().collect();
        frames.sort_unstable();
        frames.dedup();
        let index_of = |frame: u32| frames.binary_search(&frame).ok();
        let labels = named
            .into_iter()
            .map(|frame| frame.and_then(index_of))
            .map(|index| index.and_then(|index| u32::try_from(index).ok()))
            .collect();
        Ok(Self {
            layout,
            mesh: mesh.filtered(is_near),
            triangles,
            labels,
            frames,
        })
    }

    /// The frames that paint its triangles, ascending.
    pub fn frames(&self) -> &[u32] {
        &self.frames
    }

    /// Levels what `standing_of` says is levelled now. `sources` are the texel sources of
    /// [`Self::frames`], `photos` what they show. Returns what was added to each of these triangles
    /// that got anything, ascending. Gutters are left for the caller to paint again.
    ///
    /// Where all triangles of a mesh are levelled the texture is, to the byte, that of
    /// [`super::level_seams`].
    ///
    /// # Errors
    /// [`PhotometricError`] for a parameter out of range, or a texture of another layout.
    pub fn level<'b>(
        &self,
        standing_of: impl Fn(TriangleId) -> Standing<'b>,
        sources: &[TexelSource],
        photos: &[Option<SeamPhoto>],
        params: &SeamParams,
        texture: &mut AtlasTexture,
    ) -> Result<(SeamReport, Vec<(TriangleId, Levelled)>), PhotometricError> {
        params.check()?;
        texture.check_fits(self.layout)?;
        let surface = Surface {
            mesh: &self.mesh,
            layout: self.layout,
            labels: &self.labels,
            sources: sources_of(&self.labels, sources),
            part: Some(Part {
                in_layout: &self.triangles,
                standing: self.triangles.iter().map(|t| standing_of(*t)).collect(),
            }),
        };
        let mut levelled = vec![Levelled::default(); self.triangles.len()];
        let report = level(&surface, Some(photos), params, &mut levelled, texture)?;
        let added = (0_u32..)
            .zip(self.triangles.iter().zip(levelled))
            .filter(|(index, (_, added))| surface.is_levelled(*index) && !added.is_nothing())
            .map(|(_, (triangle, added))| (*triangle, added))
            .collect();
        Ok((report, added))
    }
}
