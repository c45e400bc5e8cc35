//! The unseen regions of the surface: what must be filled anew where it, or what lies beside it, changed.
//!
//! Two triangles that are not completely painted are of one region where they share a vertex. Regions
//! reach over charts; each chart knows the pieces of them that lie in it, so that a region is found by
//! the charts around it, and not by all triangles.

use super::StreamInit;
use super::charts::StreamChart;
use crate::mesh::TriMesh;
use crate::render::BoundingBox;
use crate::texinit::fill::ChartPart;
use crate::texinit::flatten::cut::find;

/// What lies in one chart of a region.
#[derive(Debug)]
pub(super) struct UnseenPiece {
    /// Triangles by their number in the chart, ascending.
    numbers: Vec<u32>,
    /// Their vertices in the mesh, ascending.
    vertices: Vec<u32>,
    bounds: BoundingBox,
}

/// Regions, and where they get their colours from.
#[derive(Debug, Default)]
pub(super) struct UnseenRegions {
    /// Ascending by chart.
    pub(super) parts: Vec<ChartPart>,
    /// Charts that may lie at them, ascending.
    pub(super) lenders: Vec<usize>,
}

/// Vertices that are of one region, by number in the mesh; each stands for itself where nothing is searched.
#[derive(Debug, Default)]
pub(super) struct JoinedVertices(Vec<u32>);

impl JoinedVertices {
    fn reserve(&mut self, num_vertices: usize) {
        #[expect(clippy::cast_possible_truncation, reason = "vertices of a mesh")]
        let known = self.0.len() as u32;
        self.0
            .extend((known..).take(num_vertices.saturating_sub(known as usize)));
    }

    #[cfg(test)]
    pub(super) fn is_at_rest(&self) -> bool {
        (0_u32..)
            .zip(&self.0)
            .all(|(vertex, stands_for)| vertex == *stands_for)
    }

    fn join(&mut self, vertices: &[u32]) {
        for pair in vertices.windows(2) {
            let [one, other] = [pair[0], pair[1]].map(|vertex| find(&mut self.0, vertex));
            self.0[one.max(other) as usize] = one.min(other);
        }
    }

    fn part(&mut self, vertices: &[u32]) {
        for &vertex in vertices {
            self.0[vertex as usize] = vertex;
        }
    }
}

/// A piece that may be of a region that is searched for.
struct Candidate<'a> {
    chart: usize,
    piece: &'a UnseenPiece,
    is_found: bool,
}

impl StreamInit {
    /// The regions with one of some vertices, ascending.
    pub(super) fn unseen_at(&mut self, vertices: &[u32]) -> UnseenRegions {
        let mut joined = std::mem::take(&mut self.joined_vertices);
        joined.reserve(self.mesh.num_vertices());
        for chart in &mut self.charts {
            chart.know_unseen(&self.mesh, &mut joined);
        }
        let charts = self.charts.iter().enumerate();
        let mut left: Vec<(usize, &UnseenPiece)> = charts
            .flat_map(|(index, chart)| {
                chart
                    .unseen
                    .iter()
                    .flatten()
                    .map(move |piece| (index, piece))
            })
            .collect();
        let positions_m = self.mesh.positions_m();
        let points_m = vertices.iter().map(|&vertex| positions_m[vertex as usize]);
        let mut bounds = BoundingBox::around(points_m);
        let mut candidates: Vec<Candidate<'_>> = Vec::new();
        // Whatever a region reaches lies within its bounds: pieces are joined as these grow.
        loop {
            for (chart, piece) in left.extract_if(.., |(_, piece)| piece.bounds.meets(&bounds)) {
                joined.join(&piece.vertices);
                candidates.push(Candidate {
                    chart,
                    piece,
                    is_found: false,
                });
            }
            let found = find_regions(vertices, &mut candidates, &mut joined);
            if found.is_empty() {
                break;
            }
            bounds = BoundingBox::around_all(found.iter().chain([&bounds]));
        }
        for candidate in &candidates {
            joined.part(&candidate.piece.vertices);
        }
        let found = candidates.iter().filter(|candidate| candidate.is_found);
        let regions = self.regions(found);
        self.joined_vertices = joined;
        regions
    }

    fn regions<'a>(&self, found: impl Iterator<Item = &'a Candidate<'a>>) -> UnseenRegions {
        let mut pieces: Vec<(usize, &UnseenPiece)> =
            found.map(|found| (found.chart, found.piece)).collect();
        pieces.sort_by_key(|(chart, _)| *chart);
        let part = |pieces: &[(usize, &UnseenPiece)]| {
            let mut numbers: Vec<u32> = pieces
                .iter()
                .flat_map(|(_, piece)| &piece.numbers)
                .copied()
                .collect();
            numbers.sort_unstable();
            ChartPart {
                chart: pieces[0].0,
                numbers,
            }
        };
        let parts: Vec<ChartPart> = pieces.chunk_by(|a, b| a.0 == b.0).map(part).collect();
        let bounds = BoundingBox::around_all(pieces.iter().map(|(_, piece)| &piece.bounds));
        let charts = self.charts.iter().enumerate();
        let lenders = charts.filter(|(_, chart)| chart.bounds.meets(&bounds));
        UnseenRegions {
            lenders: lenders.map(|(index, _)| index).collect(),
            parts,
        }
    }
}

/// Marks candidates that are of a region with one of the vertices, and returns the bounds of those that were
/// not marked before.
fn find_regions(
    vertices: &[u32],
    candidates: &mut [Candidate<'_>],
    joined: &mut JoinedVertices,
) -> Vec<BoundingBox> {
    let mut wanted: Vec<u32> = vertices
        .iter()
        .map(|&vertex| find(&mut joined.0, vertex))
        .collect();
    wanted.sort_unstable();
    wanted.dedup();
    let mut found = Vec::new();
    for candidate in candidates
        .iter_mut()
        .filter(|candidate| !candidate.is_found)
    {
        let first = candidate.piece.vertices.first();
        let region = first.map(|&vertex| find(&mut joined.0, vertex));
        candidate.is_found = region.is_some_and(|region| wanted.binary_search(&region).is_ok());
        if candidate.is_found {
            found.push(candidate.piece.bounds);
        }
    }
    found
}

impl StreamChart {
    /// Finds its pieces of unseen regions, where they are not known.
    fn know_unseen(&mut self, mesh: &TriMesh, joined: &mut JoinedVertices) {
        if self.unseen.is_some() {
            return;
        }
        let triangles = &self.piece.chart.triangles;
        let open = (0_u32..)
            .zip(&self.coverage)
            .filter(|(_, coverage)| !coverage.is_complete());
        let open: Vec<u32> = open.map(|(number, _)| number).collect();
        let corners = |number: u32| mesh.triangles()[triangles[number as usize].index()];
        for &number in &open {
            joined.join(&corners(number));
        }
        let mut by_piece: Vec<(u32, u32)> = open
            .iter()
            .map(|&number| (find(&mut joined.0, corners(number)[0]), number))
            .collect();
        by_piece.sort_unstable();
        for &number in &open {
            joined.part(&corners(number));
        }
        let piece = |members: &[(u32, u32)]| {
            let numbers: Vec<u32> = members.iter().map(|(_, number)| *number).collect();
            let mut vertices: Vec<u32> =
                numbers.iter().flat_map(|&number| corners(number)).collect();
            vertices.sort_unstable();
            vertices.dedup();
            UnseenPiece {
                bounds: BoundingBox::around(
                    vertices
                        .iter()
                        .map(|&vertex| mesh.positions_m()[vertex as usize]),
                ),
                numbers,
                vertices,
            }
        };
        self.unseen = Some(by_piece.chunk_by(|a, b| a.0 == b.0).map(piece).collect());
    }
}

impl UnseenPiece {
    pub(super) fn num_bytes(&self) -> usize {
        size_of::<Self>() + size_of_val(&*self.numbers) + size_of_val(&*self.vertices)
    }
}
