//! What is levelled: all of a surface, or part of it with what lies around.

use crate::atlas::{AtlasLayout, TexelSource};
use crate::mesh::{TriMesh, TriangleId};

use super::nodes::{NO_NODE, Nodes};

/// What levelling added to a triangle, linear light.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Levelled {
    /// At its corners, over whole regions.
    pub corners: [[f32; 3]; 3],
    /// Along its sides from corner k to the next, at (i + ½) / n of the way, fading out within the
    /// band; empty where nothing was added.
    pub sides: [Box<[[f32; 3]]>; 3],
}

impl Levelled {
    /// Whether nothing was added.
    pub fn is_nothing(&self) -> bool {
        let corners = self.corners.iter().flatten();
        let sides = self.sides.iter().flat_map(|side| side.iter().flatten());
        corners.chain(sides).all(|added| *added == 0.0)
    }

    /// Bytes beyond the size of the type.
    pub fn num_bytes(&self) -> usize {
        self.sides.iter().map(|side| size_of_val(&**side)).sum()
    }

    /// What was added along the side between two corners, in the triangle's own direction.
    pub(super) fn along(&self, corners: [usize; 2]) -> &[[f32; 3]] {
        &self.sides[first_corner(corners)]
    }

    /// Keeps what is added from the first of two corners to the second.
    pub(super) fn keep_along(&mut self, corners: [usize; 2], added: &[[f32; 3]]) {
        let first = first_corner(corners);
        let mut side: Box<[[f32; 3]]> = added.into();
        if first != corners[0] {
            side.reverse();
        }
        self.sides[first] = side;
    }
}

/// Of a side's two corners, the one that the other comes after.
fn first_corner([a, b]: [usize; 2]) -> usize {
    if b == (a + 1) % 3 { a } else { b }
}

/// How a triangle takes part.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Standing<'a> {
    /// It is levelled now: it shows what its frame shows.
    Levelled,
    /// It will be: its texels stay, and its neighbours are levelled as if it were.
    Waiting,
    /// Its texels stay, with what was added to them before, if anything was.
    Fixed(Option<&'a Levelled>),
}

/// Part of a layout's triangles.
pub(super) struct Part<'a> {
    /// Per triangle of the mesh: its number in the layout.
    pub(super) in_layout: &'a [TriangleId],
    /// How each takes part.
    pub(super) standing: Vec<Standing<'a>>,
}

/// What is levelled.
pub(super) struct Surface<'a> {
    pub(super) mesh: &'a TriMesh,
    /// Of the whole mesh, of which this may be a part.
    pub(super) layout: &'a AtlasLayout,
    pub(super) labels: &'a [Option<u32>],
    /// The texels' source by triangle.
    pub(super) sources: Vec<Option<TexelSource>>,
    /// `None` where all is levelled.
    pub(super) part: Option<Part<'a>>,
}

impl<'a> Surface<'a> {
    fn in_layout(&self, triangle: u32) -> TriangleId {
        match &self.part {
            Some(part) => part.in_layout[triangle as usize],
            None => TriangleId(triangle),
        }
    }

    pub(super) fn corners_texel(&self, triangle: u32) -> &[[f32; 2]; 3] {
        &self.layout.corners_texel[self.in_layout(triangle).index()]
    }

    pub(super) fn page_of(&self, triangle: u32) -> u32 {
        self.layout.page_of(self.in_layout(triangle))
    }

    /// Whether the triangle's texels may change.
    pub(super) fn is_levelled(&self, triangle: u32) -> bool {
        match &self.part {
            Some(part) => matches!(part.standing[triangle as usize], Standing::Levelled),
            None => true,
        }
    }

    /// What was added to a triangle that stands; `None` for one that does not.
    pub(super) fn standing(&self, triangle: u32) -> Option<Option<&'a Levelled>> {
        match self.part.as_ref()?.standing[triangle as usize] {
            Standing::Fixed(added) => Some(added),
            Standing::Levelled | Standing::Waiting => None,
        }
    }
}

/// The texel source of each triangle's label.
pub(super) fn sources_of(
    labels: &[Option<u32>],
    sources: &[TexelSource],
) -> Vec<Option<TexelSource>> {
    let source_of = |label: u32| sources.get(label as usize).copied();
    labels
        .iter()
        .map(|label| label.and_then(source_of))
        .collect()
}

/// Notes the corrections at the corners of each triangle.
pub(super) fn keep_corners(levelled: &mut [Levelled], nodes: &Nodes, corrections: &[[f32; 3]]) {
    for (levelled, corners) in levelled.iter_mut().zip(nodes.all()) {
        if !corners.contains(&NO_NODE) {
            levelled.corners = corners.map(|node| corrections[node as usize]);
        }
    }
}
