//! The charts of a scan that is kept up, and what is known of each.

use std::collections::{BTreeMap, BTreeSet};

use super::labels::KeptLabels;
use super::unseen::UnseenPiece;
use crate::atlas::gutter::Gutter;
use crate::atlas::{AtlasLayout, ChartId, ChartKey, ChartPlacer, PlacedPiece};
use crate::mesh::TriangleId;
use crate::render::BoundingBox;
use crate::texinit::fill::Coverage;
use crate::texinit::transfer::TexelSum;

/// Names a chart for as long as it is there; never given twice by one [`super::StreamInit`].
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct StreamChartId(pub u64);

/// A triangle of the mesh that is tracked, listed from one of its corners on.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Member {
    pub(super) triangle: TriangleId,
    pub(super) first_corner: u8,
}

/// A chart, as the layout has it, and what the keyframes say of it. Triangles are named by their
/// number in the chart.
#[derive(Debug)]
pub(super) struct StreamChart {
    pub(super) id: StreamChartId,
    /// Its triangles are those of the mesh, in a row.
    pub(super) piece: PlacedPiece,
    /// What stands for its place and shape, once it is laid out.
    pub(super) key: Option<ChartKey>,
    /// The same triangles in the mesh that is tracked.
    pub(super) members: Vec<Member>,
    /// The last of them there.
    pub(super) last_member: TriangleId,
    pub(super) bounds: BoundingBox,
    /// How far a vertex may have moved since the chart was flattened, metres.
    pub(super) drift_m: f64,
    pub(super) labels: KeptLabels,
    /// Keyframes that were new when they looked at it.
    pub(super) num_looks: usize,
    /// Sums over the keyframes of triangles that show a mean.
    pub(super) means: BTreeMap<u32, Vec<TexelSum>>,
    /// How many texels of each triangle are painted.
    pub(super) coverage: Vec<Coverage>,
    /// Those of which not all are, in pieces that hang together; `None` where that has to be found out.
    pub(super) unseen: Option<Vec<UnseenPiece>>,
    /// `None` before it is painted first.
    pub(super) gutter: Option<Gutter>,
}

impl StreamChart {
    /// A chart that was just placed, its triangles still those of the tracked mesh.
    pub(super) fn new(id: StreamChartId, piece: PlacedPiece) -> Self {
        let num_triangles = piece.chart.triangles.len();
        let members = piece.chart.triangles.iter().map(|&triangle| Member {
            triangle,
            first_corner: 0,
        });
        let members = members.collect();
        let mut chart = Self {
            id,
            bounds: BoundingBox::around([]),
            drift_m: 0.0,
            labels: KeptLabels::new(num_triangles),
            num_looks: 0,
            members: Vec::new(),
            last_member: TriangleId(0),
            means: BTreeMap::new(),
            coverage: vec![Coverage::default(); num_triangles],
            unseen: None,
            gutter: None,
            key: None,
            piece,
        };
        chart.set_members(members);
        chart
    }

    /// Its triangles are these in the mesh that is tracked.
    pub(super) fn set_members(&mut self, members: Vec<Member>) {
        let last = members.iter().map(|member| member.triangle).max();
        self.last_member = last.unwrap_or(TriangleId(0));
        self.members = members;
    }

    pub(super) fn len(&self) -> usize {
        self.piece.chart.triangles.len()
    }

    /// Its first triangle in the mesh.
    pub(super) fn first_triangle(&self) -> usize {
        self.piece.chart.triangles.first().map_or(0, |t| t.index())
    }

    /// The triangle after its last.
    pub(super) fn end_triangle(&self) -> usize {
        self.first_triangle() + self.len()
    }

    pub(super) fn num_bytes(&self) -> usize {
        let sums = self.means.values().map(|sums| size_of_val(&**sums));
        // Per triangle: three sums of colours, the best frames, corners, label and the like.
        const PER_TRIANGLE: usize = 400;
        let gutter = self.gutter.as_ref().map_or(0, Gutter::num_bytes);
        let unseen = self.unseen.iter().flatten().map(UnseenPiece::num_bytes);
        unseen.sum::<usize>()
            + gutter
            + self.labels.num_bytes()
            + sums.sum::<usize>()
            + PER_TRIANGLE * self.len()
    }
}

/// What changed about a chart.
#[derive(Clone, Debug, Default)]
pub(super) struct Dirt {
    /// It was not there before.
    pub(super) is_fresh: bool,
    /// It lies elsewhere in the atlas.
    pub(super) is_relaid: bool,
    /// Its page has another number.
    pub(super) is_renumbered: bool,
    /// Per triangle, whether a corner moved; empty where none did.
    pub(super) moved: Vec<bool>,
    /// Per triangle, whether keyframes that stayed say nothing of it yet; empty where they all do.
    pub(super) unscored: Vec<bool>,
    /// Keyframes that may see other parts of it than they did, or are gone.
    pub(super) resighted: BTreeSet<u32>,
    /// Keyframes that came and may see it.
    pub(super) added: BTreeSet<u32>,
}

impl Dirt {
    pub(super) fn is_moved(&self) -> bool {
        !self.moved.is_empty()
    }

    pub(super) fn has_unscored(&self) -> bool {
        self.unscored.contains(&true)
    }

    pub(super) fn is_unscored(&self, number: usize) -> bool {
        self.unscored.get(number).copied().unwrap_or(false)
    }

    pub(super) fn is_triangle_moved(&self, number: usize) -> bool {
        self.moved.get(number).copied().unwrap_or(false)
    }
}

/// The layout of nothing.
pub(super) fn empty_layout() -> AtlasLayout {
    AtlasLayout {
        page_size_texel: [64; 2],
        num_pages: 0,
        texels_per_m: 1.0,
        charts: Vec::new(),
        chart_of_triangle: Vec::new(),
        corners_texel: Vec::new(),
    }
}

/// Makes a layout that of some charts, whose triangles are numbered in their order; the first
/// `num_staying` lie in it as they are.
pub(super) fn lay_out(
    layout: &mut AtlasLayout,
    charts: &[StreamChart],
    num_staying: usize,
    placer: Option<&ChartPlacer>,
) {
    if let Some(placer) = placer {
        layout.page_size_texel = placer.page_size_texel();
        layout.num_pages = placer.num_pages();
        layout.texels_per_m = placer.texels_per_m();
    }
    let (staying, others) = charts.split_at(num_staying);
    let num_triangles = staying.last().map_or(0, StreamChart::end_triangle);
    layout.charts.truncate(num_staying);
    layout.chart_of_triangle.truncate(num_triangles);
    layout.corners_texel.truncate(num_triangles);
    for chart in others {
        #[expect(clippy::cast_possible_truncation, reason = "fewer than triangles")]
        let id = ChartId(layout.charts.len() as u32);
        layout.charts.push(chart.piece.chart.clone());
        let ids = std::iter::repeat_n(id, chart.len());
        layout.chart_of_triangle.extend(ids);
        layout.corners_texel.extend(&chart.piece.corners_texel);
    }
}

/// Triangles from `first` on.
#[expect(
    clippy::cast_possible_truncation,
    reason = "a mesh has 32 bits of triangles"
)]
pub(super) fn triangles_from(first: usize, num: usize) -> Vec<TriangleId> {
    (first as u32..).map(TriangleId).take(num).collect()
}
