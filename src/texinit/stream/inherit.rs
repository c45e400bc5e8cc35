//! Scores that outlive their chart: where a chart is taken apart beside changed surface, most of its
//! triangles are the same as before, and so is what keyframes say of them.

use std::collections::BTreeMap;

use crate::keyframe::FrameQuality;
use crate::mesh::TriangleId;
use crate::texinit::assign::cues::FrameCandidates;
use crate::texinit::assign::label::CandidateTable;

/// What is known of triangles that have no chart.
#[derive(Debug, Default)]
pub(super) struct Orphans {
    /// Of the charts that are no more.
    tables: Vec<CandidateTable>,
    /// Triangle of the caller's mesh, its table, and its number there; ascending once
    /// [`Self::settle`]d.
    places: Vec<(TriangleId, u32, u32)>,
}

impl Orphans {
    /// Keeps what a chart that goes knows of triangles that stay: by their number in it, where they are
    /// now.
    #[expect(
        clippy::cast_possible_truncation,
        reason = "fewer charts than triangles"
    )]
    pub(super) fn take(
        &mut self,
        staying: impl Iterator<Item = (u32, TriangleId)>,
        table: CandidateTable,
    ) {
        let index = self.tables.len() as u32;
        let places = staying.map(|(number, triangle)| (triangle, index, number));
        self.places.extend(places);
        self.tables.push(table);
    }

    /// All charts that go have gone.
    pub(super) fn settle(&mut self) {
        self.places.sort_unstable();
    }

    /// What is known of a new chart's triangles, and per triangle whether it is not.
    #[expect(
        clippy::cast_possible_truncation,
        reason = "a mesh has 32 bits of triangles"
    )]
    pub(super) fn adopted(
        &self,
        triangles: impl ExactSizeIterator<Item = TriangleId>,
    ) -> (CandidateTable, Vec<bool>) {
        let mut adopted = CandidateTable::new(triangles.len(), 0);
        let mut is_unscored = vec![true; triangles.len()];
        let mut by_table: BTreeMap<u32, BTreeMap<u32, u32>> = BTreeMap::new();
        for (number, triangle) in triangles.enumerate() {
            let found = self.places.binary_search_by_key(&triangle, |place| place.0);
            if let Ok(found) = found {
                let (_, table, before) = self.places[found];
                by_table
                    .entry(table)
                    .or_default()
                    .insert(before, number as u32);
                is_unscored[number] = false;
            }
        }
        let mut columns: BTreeMap<u32, (FrameQuality, FrameCandidates)> = BTreeMap::new();
        for (table, number_of) in by_table {
            for (frame, quality, scored) in self.tables[table as usize].columns() {
                let part = scored.renumbered(|number| number_of.get(&number).copied());
                if !part.is_empty() {
                    let column = columns.entry(frame);
                    let (_, all) = column.or_insert_with(|| (quality, FrameCandidates::default()));
                    *all = std::mem::take(all).renewed(&[], part);
                }
            }
        }
        for (frame, (quality, scored)) in columns {
            adopted.add(frame, quality, scored);
        }
        (adopted, is_unscored)
    }
}
