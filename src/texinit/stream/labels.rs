//! What the keyframes say of a chart, and the labels that follow; only triangles of which something
//! else is said are compared anew.

use crate::keyframe::FrameQuality;
use crate::mesh::{TriMesh, TriangleId};
use crate::texinit::assign::adjacency::Adjacency;
use crate::texinit::assign::comparison::Comparison;
use crate::texinit::assign::cues::FrameCandidates;
use crate::texinit::assign::label::CandidateTable;
use crate::texinit::assign::quality::TypicalQuality;
use crate::texinit::assign::{AssignParams, Assignment};

/// Triangles are named by their number in the chart.
#[derive(Debug)]
pub(super) struct KeptLabels {
    /// Columns by the numbers of keyframes.
    table: CandidateTable,
    /// Per triangle: whether something else is said of it than when it was compared.
    is_stale: Vec<bool>,
    /// What its frames were held against.
    typical: TypicalQuality,
    /// `None` before the first labels.
    compared: Option<Compared>,
    assignment: Assignment,
}

#[derive(Debug)]
struct Compared {
    comparison: Comparison,
    adjacency: Adjacency,
}

impl KeptLabels {
    pub(super) fn new(num_triangles: usize) -> Self {
        Self::of(CandidateTable::new(num_triangles, 0), num_triangles)
    }

    /// What is said of a new chart.
    pub(super) fn of(table: CandidateTable, num_triangles: usize) -> Self {
        Self {
            table,
            is_stale: vec![true; num_triangles],
            typical: TypicalQuality::default(),
            compared: None,
            assignment: Assignment {
                label: vec![None; num_triangles],
                best_texels_per_m: vec![0.0; num_triangles],
                mean_srgb: vec![[0; 3]; num_triangles],
                num_views: vec![0; num_triangles],
                is_partly_hidden: vec![false; num_triangles],
                ..Assignment::default()
            },
        }
    }

    pub(super) fn into_table(self) -> CandidateTable {
        self.table
    }

    pub(super) fn assignment(&self) -> &Assignment {
        &self.assignment
    }

    pub(super) fn num_bytes(&self) -> usize {
        self.table.num_bytes()
    }

    /// Forgets what is said of some triangles.
    pub(super) fn retain(&mut self, is_kept: impl Fn(u32) -> bool) {
        self.table.retain(&is_kept);
        for (triangle, is_stale) in (0_u32..).zip(&mut self.is_stale) {
            *is_stale |= !is_kept(triangle);
        }
    }

    /// Forgets what a keyframe says; whether it said anything.
    pub(super) fn remove(&mut self, frame: u32) -> bool {
        if let Some(scored) = self.table.column(frame) {
            mark(&mut self.is_stale, scored);
        }
        self.table.remove(frame)
    }

    /// Takes what a keyframe says of some of the triangles, ascending; what it said of others stays.
    /// Whether it says something else than before.
    pub(super) fn renew(
        &mut self,
        frame: u32,
        quality: FrameQuality,
        triangles: &[u32],
        newer: FrameCandidates,
    ) -> bool {
        let nothing = FrameCandidates::default();
        let before = self.table.column(frame).unwrap_or(&nothing);
        let now = before.renewed(triangles, newer);
        if now == *before {
            return false;
        }
        now.each_difference(before, |triangle| {
            self.is_stale[triangle as usize] = true;
        });
        if now.is_empty() {
            self.table.remove(frame);
        } else {
            self.table.add(frame, quality, now);
        }
        true
    }

    /// Labels anew what has to be; what was assigned before, where something else is now. Triangles
    /// are those of `mesh`, from `first` on. A label is given up for others only where they score more
    /// than `hysteresis` better.
    pub(super) fn assign(
        &mut self,
        mesh: &TriMesh,
        first: TriangleId,
        params: &AssignParams,
        hysteresis: f32,
    ) -> Option<Assignment> {
        if !self.is_stale.contains(&true) {
            return None;
        }
        let typical = self.table.typical_quality().in_steps();
        if std::mem::replace(&mut self.typical, typical) != typical {
            self.is_stale.fill(true);
        }
        let num_triangles = self.is_stale.len();
        let of_mesh = |number: u32| TriangleId(first.0 + number);
        let is_new = self.compared.is_none();
        let compared = self.compared.get_or_insert_with(|| Compared {
            comparison: Comparison::empty(num_triangles, params),
            adjacency: Adjacency::of(&mesh.triangles()[first.index()..][..num_triangles]),
        });
        let Compared {
            comparison,
            adjacency,
        } = compared;
        let has_others = comparison.renew(&self.table, &self.is_stale, params, typical);
        let before = &self.assignment.label;
        let label = if !has_others && !is_new {
            before.clone()
        } else if hysteresis > 0.0 && !is_new {
            comparison.solve_steadily(before, hysteresis, adjacency, params)
        } else {
            comparison.solve(adjacency, params)
        };
        let area_m2 = |triangle: TriangleId| mesh.area_m2(of_mesh(triangle.0));
        let now = self.table.assignment(comparison, label, adjacency, area_m2);
        self.is_stale.fill(false);
        let before = std::mem::replace(&mut self.assignment, now);
        let is_same = before.label == self.assignment.label
            && before.is_partly_hidden == self.assignment.is_partly_hidden;
        (!is_same).then_some(before)
    }

    /// By how much the labels are worth less than the best that are found; 0 before the first.
    #[cfg(test)]
    pub(super) fn shortfall(&self, params: &AssignParams) -> f64 {
        self.compared.as_ref().map_or(0.0, |compared| {
            let Compared {
                comparison,
                adjacency,
            } = compared;
            let value = |label: &[Option<u32>]| comparison.value_of(label, adjacency, params);
            value(&comparison.solve(adjacency, params)) - value(&self.assignment.label)
        })
    }
}

fn mark(is_stale: &mut [bool], scored: &FrameCandidates) {
    scored.each_difference(&FrameCandidates::default(), |triangle| {
        is_stale[triangle as usize] = true;
    });
}
