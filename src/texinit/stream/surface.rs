//! What a new mesh does to the charts: which stay, and which triangles need one.

use std::collections::BTreeMap;
use std::sync::Arc;

use nalgebra::Point3;
use rayon::prelude::*;

use super::charts::{Dirt, Member, StreamChart, lay_out, triangles_from};
use super::cover::Cover;
use super::inherit::Orphans;
use super::labels::KeptLabels;
use super::{StreamError, StreamInit, StreamUpdate};
use crate::atlas::{ChartKey, ChartPlacer};
use crate::mesh::{MeshDiff, OldTriangle, Origin, TriMesh, TriangleId};
use crate::render::BoundingBox;
use crate::texinit::assign::chart_table::chart_mesh;
use crate::texinit::flatten::{self, FlatChart};
use crate::texinit::overlap;

/// What an update does to the surface and to the charts on it.
#[derive(Debug, Default)]
pub(super) struct SurfaceChange {
    /// The mesh, its triangles in the caller's order.
    mesh: Arc<TriMesh>,
    /// Triangles of `mesh` that have no chart, ascending.
    loose: Vec<TriangleId>,
    /// What is known of these.
    orphans: Orphans,
    /// Leading charts that are the leading ones from before.
    num_leading_charts: usize,
    /// Surface that went, or moved away, as triangles in space.
    pub(super) gone: Vec<[Point3<f64>; 3]>,
    /// Surface that came, or moved there.
    pub(super) came: Vec<[Point3<f64>; 3]>,
    /// Vertices of `mesh` at which a triangle came, went or moved; ascending, each once.
    pub(super) touched: Vec<u32>,
    /// Per chart, new ones included once they are placed.
    pub(super) dirt: Vec<Dirt>,
    /// Where surface that came or went lies in the images of keyframes that stayed, by number.
    pub(super) covers: BTreeMap<u32, Cover>,
}

/// What became of an old triangle.
#[derive(Clone, Copy)]
struct Successor {
    member: Member,
    is_moved: bool,
}

impl Successor {
    /// What became of a member, whose corners are listed from another one on.
    fn from(self, before: Member) -> Self {
        Self {
            member: Member {
                first_corner: (self.member.first_corner + before.first_corner) % 3,
                ..self.member
            },
            ..self
        }
    }

    /// The triangle, where nothing of it is another, not even which corner comes first.
    fn as_it_was(self) -> Option<TriangleId> {
        let is_same = !self.is_moved && self.member.first_corner == 0;
        is_same.then_some(self.member.triangle)
    }
}

/// What became of old triangles, of which the first are in place.
struct Successors {
    num_in_place: usize,
    others: Vec<Option<Successor>>,
}

impl Successors {
    fn in_place(num_in_place: usize, num_before: usize) -> Self {
        Self {
            num_in_place,
            others: vec![None; num_before.saturating_sub(num_in_place)],
        }
    }

    fn set(&mut self, old: TriangleId, successor: Successor) {
        self.others[old.index() - self.num_in_place] = Some(successor);
    }

    /// What became of a member.
    fn of(&self, member: &Member) -> Option<Successor> {
        match member.triangle.index().checked_sub(self.num_in_place) {
            Some(index) => Some(self.others[index]?.from(*member)),
            None => Some(Successor {
                member: *member,
                is_moved: false,
            }),
        }
    }
}

/// Vertices of triangles that are new or changed.
struct BesideChange {
    /// Ascending, each once.
    vertices: Vec<u32>,
    bounds: BoundingBox,
}

impl BesideChange {
    fn of(mesh: &TriMesh, triangles: &[TriangleId]) -> Self {
        let corners = triangles.iter().map(|t| mesh.triangles()[t.index()]);
        let mut vertices: Vec<u32> = corners.flatten().collect();
        vertices.par_sort_unstable();
        vertices.dedup();
        Self {
            vertices,
            bounds: BoundingBox::of(mesh, triangles.iter().copied()),
        }
    }

    fn meets(&self, mesh: &TriMesh, triangle: TriangleId) -> bool {
        let mut corners = mesh.triangles()[triangle.index()].into_iter();
        corners.any(|vertex| self.vertices.binary_search(&vertex).is_ok())
    }
}

impl StreamInit {
    /// Compares the mesh with the one before, and takes charts apart that lost triangles.
    pub(super) fn take_mesh(
        &mut self,
        given: &Arc<TriMesh>,
        update: &mut StreamUpdate,
    ) -> Result<SurfaceChange, StreamError> {
        let before = Arc::clone(self.tracked.mesh());
        let found = self.tracked.follow(given)?;
        let mesh = Arc::clone(self.tracked.mesh());
        let Some(found) = found.or_else(|| self.all_kept()) else {
            update.mesh.num_kept = mesh.num_triangles();
            return Ok(SurfaceChange {
                dirt: vec![Dirt::default(); self.charts.len()],
                num_leading_charts: self.charts.len(),
                mesh,
                ..SurfaceChange::default()
            });
        };
        update.mesh = found.counts();
        let mut change = SurfaceChange {
            gone: gone(&before, &found),
            came: came(&mesh, &found),
            mesh,
            ..SurfaceChange::default()
        };
        self.part_charts(&found, &mut change, update);
        change.touched = found.touched;
        Ok(change)
    }

    /// The same mesh as before, where it must be gone through nonetheless: charts have no density yet.
    fn all_kept(&self) -> Option<MeshDiff> {
        (!self.has_density).then(|| MeshDiff {
            num_in_place: self.tracked.mesh().num_triangles(),
            ..MeshDiff::default()
        })
    }

    /// Keeps the charts that can stay, and takes the others off their pages.
    fn part_charts(
        &mut self,
        found: &MeshDiff,
        change: &mut SurfaceChange,
        update: &mut StreamUpdate,
    ) {
        let num_before: usize = self.charts.iter().map(StreamChart::len).sum();
        let mut successors = Successors::in_place(found.num_in_place, num_before);
        for (triangle, origin) in found.others() {
            match origin {
                Origin::Kept(old) => successors.set(old.triangle, after(triangle, old, false)),
                Origin::Moved(old) => successors.set(old.triangle, after(triangle, old, true)),
                Origin::Changed | Origin::New => change.loose.push(triangle),
            }
        }
        let beside = BesideChange::of(&change.mesh, &change.loose);
        let others = self.other_charts(found.num_in_place, change, &beside);
        let mut are_all_there = true;
        for mut chart in others {
            let is_in_place = chart.last_member.index() < found.num_in_place;
            let after: Option<Vec<Successor>> = match is_in_place {
                true => Some(Vec::new()),
                false => chart.members.iter().map(|m| successors.of(m)).collect(),
            };
            let stays = after.filter(|after| {
                self.has_density && self.may_stay(&mut chart, after, change, &beside)
            });
            match stays {
                Some(after) => {
                    change.num_leading_charts += usize::from(are_all_there);
                    change.adopt(&mut chart, &after);
                    self.charts.push(chart);
                }
                None => {
                    are_all_there = false;
                    update.gone_charts.push(chart.id);
                    self.take_off(&chart);
                    let after = (0_u32..).zip(chart.members.iter().map(|m| successors.of(m)));
                    let left = after.clone().filter_map(|(_, after)| after);
                    change.loose.extend(left.map(|after| after.member.triangle));
                    let staying =
                        after.filter_map(|(number, after)| Some((number, after?.as_it_was()?)));
                    change.orphans.take(staying, chart.labels.into_table());
                }
            }
        }
        change.orphans.settle();
        change.loose.sort_unstable();
    }

    /// Keeps leading charts that stay as they are, and takes the others out: where a scan grows, hardly one is
    /// looked at.
    fn other_charts(
        &mut self,
        num_in_place: usize,
        change: &mut SurfaceChange,
        beside: &BesideChange,
    ) -> Vec<StreamChart> {
        let mut charts = std::mem::take(&mut self.charts);
        let stays = |chart: &&StreamChart| {
            self.has_density
                && chart.last_member.index() < num_in_place
                && !self.is_remade(chart, &[], change, beside)
        };
        let num_leading = charts.iter().take_while(stays).count();
        let others = charts.split_off(num_leading);
        self.charts = charts;
        change.num_leading_charts = num_leading;
        change.dirt.resize_with(num_leading, Dirt::default);
        others
    }

    /// Whether a chart that has all its triangles still is as good as a new one; `after` is empty where they
    /// are in place.
    fn may_stay(
        &self,
        chart: &mut StreamChart,
        after: &[Successor],
        change: &SurfaceChange,
        beside: &BesideChange,
    ) -> bool {
        if self.is_remade(chart, after, change, beside) {
            return false;
        }
        let mut farthest_m = 0.0_f64;
        let before = chart.piece.chart.triangles.iter();
        for (&old, successor) in before.zip(after).filter(|(_, after)| after.is_moved) {
            let now = change.corners_m(successor.member);
            for (before, now) in self.mesh.corners_m(old).iter().zip(now) {
                farthest_m = farthest_m.max((now - before).norm());
            }
        }
        chart.drift_m += farthest_m;
        chart.drift_m <= self.stream.max_drift_m
    }

    /// Whether a chart is so small that it is made anew with the surface beside it.
    fn is_remade(
        &self,
        chart: &StreamChart,
        after: &[Successor],
        change: &SurfaceChange,
        beside: &BesideChange,
    ) -> bool {
        let is_beside = |member: &Member| beside.meets(&change.mesh, member.triangle);
        chart.len() < self.stream.remake_below_triangles
            && match after.is_empty() {
                true => beside.bounds.meets(&chart.bounds) && chart.members.iter().any(is_beside),
                false => after.iter().any(|successor| is_beside(&successor.member)),
            }
    }

    /// Blanks a chart's texels and frees its cells.
    fn take_off(&mut self, chart: &StreamChart) {
        if let Some(page) = self.texture.pages.get_mut(chart.piece.chart.page as usize) {
            page.to_mut().blank_chart(&chart.piece.chart);
        }
        if let Some(placer) = &mut self.placer {
            placer.remove(chart.piece.slot);
        }
    }

    /// Takes all charts apart and forgets the pages.
    pub(super) fn part_all(&mut self, change: &mut SurfaceChange, update: &mut StreamUpdate) {
        update
            .gone_charts
            .extend(self.charts.iter().map(|chart| chart.id));
        update.gone_charts.sort_unstable();
        self.charts.clear();
        self.texture.pages.clear();
        self.placer = None;
        change.num_leading_charts = 0;
        change.dirt.clear();
        change.loose = change.mesh.triangle_ids().collect();
    }

    /// Flat charts of the triangles that have none, named as in the caller's mesh.
    pub(super) fn flatten_loose(
        &self,
        change: &SurfaceChange,
    ) -> Result<Vec<FlatChart>, StreamError> {
        if change.loose.is_empty() {
            return Ok(Vec::new());
        }
        let part = chart_mesh(&change.mesh, &change.loose);
        let params = &self.params;
        let flat = flatten::flatten(&part, &params.flatten)?;
        let (charts, _) = overlap::separate(&part, flat.charts, &params.overlap);
        let (mut charts, _) = flatten::absorb(&part, &flat.manifold, charts, &params.flatten);
        for triangle in charts.iter_mut().flat_map(|chart| &mut chart.triangles) {
            *triangle = change.loose[triangle.index()];
        }
        Ok(charts)
    }

    /// Builds mesh and layout from the charts, in their order, where one of them is another than
    /// before.
    pub(super) fn lay_out(&mut self, change: &mut SurfaceChange) {
        let is_relaid = |dirt: &Dirt| dirt.is_fresh || dirt.is_relaid || dirt.is_renumbered;
        let is_other = |dirt: &Dirt| is_relaid(dirt) || dirt.is_moved();
        let num_renumberings = self.tracked.num_renumberings();
        let is_renumbered =
            std::mem::replace(&mut self.num_renumberings, num_renumberings) != num_renumberings;
        if is_renumbered {
            self.lent.forget();
            for chart in &mut self.charts {
                chart.unseen = None;
            }
        }
        let num_staying = match is_renumbered {
            true => 0,
            false => change.num_leading_charts,
        };
        let in_place = change.dirt[..num_staying].iter();
        let num_staying = in_place.take_while(|dirt| !is_other(dirt)).count();
        let num_pages = self.placer.as_ref().map_or(0, ChartPlacer::num_pages);
        let num_charts = [self.layout.charts.len(), self.charts.len()];
        if num_charts == [num_staying; 2] && self.layout.num_pages == num_pages {
            return;
        }
        let (staying, others) = self.charts.split_at_mut(num_staying);
        let first = staying.last().map_or(0, StreamChart::end_triangle);
        let mut end = first;
        for chart in &mut *others {
            chart.piece.chart.triangles = triangles_from(end, chart.members.len());
            end += chart.members.len();
        }
        let members = others.iter().flat_map(|chart| &chart.members);
        let corners = members.map(|&member| change.corners(member));
        // What was shown keeps its own.
        let mesh = Arc::make_mut(&mut self.mesh);
        mesh.relist(&change.mesh, first, corners);
        self.runs.renew(mesh, first);
        for (chart, dirt) in self.charts.iter_mut().zip(&mut change.dirt) {
            if dirt.is_fresh {
                let triangles = chart.members.iter().map(|member| member.triangle);
                let (table, unscored) = change.orphans.adopted(triangles);
                dirt.unscored = unscored;
                chart.labels = KeptLabels::of(table, chart.len());
            } else if dirt.is_moved() {
                dirt.unscored.clone_from(&dirt.moved);
                let moved = &dirt.moved;
                chart.labels.retain(|number| !moved[number as usize]);
                chart.unseen = None;
            }
            if dirt.is_fresh || dirt.is_moved() {
                let triangles = chart.piece.chart.triangles.iter().copied();
                chart.bounds = BoundingBox::of(&self.mesh, triangles);
            }
        }
        change.orphans = Orphans::default();
        let layout = Arc::make_mut(&mut self.layout);
        lay_out(layout, &self.charts, num_staying, self.placer.as_ref());
        let (mesh, layout) = (&self.mesh, &self.layout);
        let charts = self.charts.par_iter_mut().zip(&change.dirt);
        charts.for_each(|(chart, dirt)| {
            if chart.key.is_none() || is_other(dirt) {
                let placed = &chart.piece.chart;
                let triangles = placed.triangles.iter().copied();
                chart.key = Some(ChartKey::of(mesh, layout, placed, triangles));
            }
        });
    }
}

/// Where surface is no more.
fn gone(before: &TriMesh, found: &MeshDiff) -> Vec<[Point3<f64>; 3]> {
    let moved = found.origins.iter().filter_map(|origin| match origin {
        Origin::Moved(old) => Some(old.triangle),
        _ => None,
    });
    let gone = found.gone.iter().copied().chain(moved);
    gone.map(|triangle| before.corners_m(triangle)).collect()
}

/// Where surface is that was not there.
fn came(mesh: &TriMesh, found: &MeshDiff) -> Vec<[Point3<f64>; 3]> {
    let came = found.others();
    came.filter(|(_, origin)| !matches!(origin, Origin::Kept(_)))
        .map(|(triangle, _)| mesh.corners_m(triangle))
        .collect()
}

fn after(triangle: TriangleId, old: OldTriangle, is_moved: bool) -> Successor {
    Successor {
        member: Member {
            triangle,
            first_corner: old.first_corner,
        },
        is_moved,
    }
}

impl SurfaceChange {
    /// Vertices of a member, from its first corner on.
    fn corners(&self, member: Member) -> [u32; 3] {
        let mut corners = self.mesh.triangles()[member.triangle.index()];
        corners.rotate_left(member.first_corner as usize);
        corners
    }

    fn corners_m(&self, member: Member) -> [Point3<f64>; 3] {
        self.corners(member)
            .map(|vertex| self.mesh.positions_m()[vertex as usize])
    }

    /// Adds a chart that stays; `after` is empty where its triangles are in place.
    fn adopt(&mut self, chart: &mut StreamChart, after: &[Successor]) {
        let mut dirt = Dirt::default();
        if after.is_empty() {
            self.dirt.push(dirt);
            return;
        }
        if after.iter().any(|successor| successor.is_moved) {
            dirt.moved = after.iter().map(|successor| successor.is_moved).collect();
        }
        debug_assert_eq!(chart.len(), after.len(), "a successor per triangle");
        chart.set_members(after.iter().map(|successor| successor.member).collect());
        self.dirt.push(dirt);
    }

    /// Notes that there is another chart, which is new.
    pub(super) fn add_fresh(&mut self) {
        self.dirt.push(Dirt {
            is_fresh: true,
            ..Dirt::default()
        });
    }

    /// The mesh as it is now.
    pub(super) fn mesh(&self) -> &TriMesh {
        &self.mesh
    }
}
