//! Pieces grown triangle by triangle, each as far as it does not overlap itself.
//!
//! A piece first takes what overlaps nothing. Triangles that overlap others lie in zones; it then
//! takes zone by zone, each to its end: of two zones that cover each other one comes whole to the
//! piece and the other stays whole for the next one, where in turns both would be torn. Each
//! triangle is tried once per piece that it borders, so the time does not depend on how many
//! layers there are.

use std::collections::VecDeque;

use super::detect::PlaneTriangles;
use super::graph::Neighbours;

const FREE: usize = usize::MAX;

/// A piece number per triangle, seeds taken in the order given. Where overlaps are not known, every
/// triangle counts as one that overlaps nothing, until it is tried.
pub(super) fn grow(
    order: &[usize],
    adjacency: &Neighbours,
    overlaps: Option<&Neighbours>,
    layer: &PlaneTriangles,
) -> Vec<usize> {
    let is_in_zone: Vec<bool> = (0..layer.len())
        .map(|triangle| overlaps.is_some_and(|o| o.of(triangle).next().is_some()))
        .collect();
    let mut piece_of = vec![FREE; layer.len()];
    let mut tried_by = vec![FREE; layer.len()];
    let mut area = Area::new(layer);
    let mut front = Front::default();
    for (piece, &seed) in order.iter().enumerate() {
        if piece_of[seed] != FREE {
            continue;
        }
        area.clear();
        front.plain.push_back(seed);
        tried_by[seed] = piece;
        while let Some(triangle) = front.pop() {
            if !area.insert(triangle) {
                continue;
            }
            piece_of[triangle] = piece;
            for other in adjacency.of(triangle) {
                if piece_of[other] == FREE && tried_by[other] != piece {
                    tried_by[other] = piece;
                    front.push(other, is_in_zone[triangle], is_in_zone[other]);
                }
            }
        }
    }
    piece_of
}

/// Triangles that border the piece.
#[derive(Default)]
struct Front {
    plain: VecDeque<usize>,
    this_zone: VecDeque<usize>,
    other_zones: VecDeque<usize>,
}

impl Front {
    fn push(&mut self, triangle: usize, from_zone: bool, is_in_zone: bool) {
        let queue = match (from_zone, is_in_zone) {
            (_, false) => &mut self.plain,
            (true, true) => &mut self.this_zone,
            (false, true) => &mut self.other_zones,
        };
        queue.push_back(triangle);
    }

    fn pop(&mut self) -> Option<usize> {
        let next = self.plain.pop_front();
        next.or_else(|| self.this_zone.pop_front())
            .or_else(|| self.other_zones.pop_front())
    }
}

/// What a piece covers.
struct Area<'a> {
    layer: &'a PlaneTriangles,
    cells: Vec<Vec<usize>>,
    used_cells: Vec<usize>,
}

impl<'a> Area<'a> {
    fn new(layer: &'a PlaneTriangles) -> Self {
        Self {
            layer,
            cells: vec![Vec::new(); layer.num_cells()],
            used_cells: Vec::new(),
        }
    }

    fn clear(&mut self) {
        for cell in self.used_cells.drain(..) {
            self.cells[cell].clear();
        }
    }

    /// Adds a triangle unless it overlaps one that is there.
    fn insert(&mut self, triangle: usize) -> bool {
        let layer = self.layer;
        let mut is_free = true;
        layer.for_each_cell(triangle, |cell| {
            let there = &self.cells[cell];
            is_free = is_free && there.iter().all(|&t| !layer.overlap(t, triangle));
        });
        if is_free {
            layer.for_each_cell(triangle, |cell| {
                self.cells[cell].push(triangle);
                self.used_cells.push(cell);
            });
        }
        is_free
    }
}
