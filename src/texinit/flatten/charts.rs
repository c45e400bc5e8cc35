//! Charts of bounded normal deviation and size, round and few.
//!
//! In the manner of variational shape approximation (Cohen-Steiner, Alliez, Desbrun 2004):
//! 1. seeds in the order of flatness grow one after the other, nearest triangle first;
//! 2. all charts grow again together from their centres, which straightens their borders; those
//!    that stayed tiny give up their place, what no chart reaches is seeded anew;
//! 3. neighbours merge where the bounds allow it, longest common border first;
//! 4. single triangles at a border change sides where that shortens it.
//!
//! Charts grow across mates only, so what is not manifold is a border. Ties go to smaller indices;
//! the result does not depend on the thread count. A chart is connected; it may enclose holes.

use std::cmp::Reverse;
use std::collections::BinaryHeap;

use nalgebra::{Point3, Vector3};

use super::FlattenParams;
use super::faces::Faces;
use super::merge;
use crate::mesh::adjacency::NO_HALF_EDGE;
use crate::mesh::components::components_within;
use crate::mesh::{Manifold, TriangleId};

/// In no chart.
pub(crate) const UNASSIGNED: u32 = u32::MAX;

/// Charts first grow to this share of the largest size, so that relaxing finds room.
const FIRST_SIZE_SHARE: f64 = 0.7;

/// A normal that is off by 90° counts as far as this many chart radii (squared).
const NORMAL_WEIGHT: f64 = 4.0;

/// What a growing chart is measured against.
#[derive(Clone, Copy)]
struct Proxy {
    center_m: Point3<f64>,
    normal: Vector3<f64>,
    num_triangles: usize,
}

/// Labels each triangle by its chart, and gives the number of charts. Collapsed triangles are
/// [`UNASSIGNED`].
pub(crate) fn grow_charts(
    manifold: &Manifold,
    faces: &Faces,
    params: &FlattenParams,
) -> (Vec<u32>, usize) {
    let is_open = open_triangles(manifold, faces.areas_m2.len());
    let mut growth = Growth::new(manifold.mates(), faces, &is_open, params);
    growth.seed_unreached();
    for _ in 0..params.num_relaxation_rounds {
        growth.relax();
    }
    let mut label = growth.labels();
    merge::merge_charts(manifold.mates(), faces, params, &mut label);
    smooth_borders(manifold.mates(), faces, params, &mut label);
    merge::merge_charts(manifold.mates(), faces, params, &mut label);
    let (pieces, _) = components_within(manifold.mates(), |a, b| label[a] == label[b]);
    compact(&pieces, &is_open)
}

/// One label per connected component; collapsed triangles are [`UNASSIGNED`].
pub(crate) fn whole_components(manifold: &Manifold, num_triangles: usize) -> (Vec<u32>, usize) {
    let (pieces, _) = components_within(manifold.mates(), |_, _| true);
    compact(&pieces, &open_triangles(manifold, num_triangles))
}

fn open_triangles(manifold: &Manifold, num_triangles: usize) -> Vec<bool> {
    (0_u32..)
        .take(num_triangles)
        .map(|t| !manifold.is_collapsed(TriangleId(t)))
        .collect()
}

/// Renumbers labels by first occurrence.
fn compact(label: &[u32], is_open: &[bool]) -> (Vec<u32>, usize) {
    let mut number = vec![UNASSIGNED; label.len()];
    let mut count = 0;
    let compacted = label
        .iter()
        .zip(is_open)
        .map(|(&old, &is_open)| {
            if !is_open {
                return UNASSIGNED;
            }
            let slot = &mut number[old as usize];
            if *slot == UNASSIGNED {
                *slot = count;
                count += 1;
            }
            *slot
        })
        .collect();
    (compacted, count as usize)
}

/// A collapsed triangle, while charts grow: never in one.
const CLOSED: u32 = u32::MAX - 1;

/// What growing asks of a triangle, in one cache line: charts grow all over the mesh at once, so
/// that each look at a triangle is a miss.
#[repr(align(64))]
struct Cell {
    center_m: Point3<f64>,
    normal: Vector3<f64>,
    mates: [u32; 3],
    /// Its chart, [`UNASSIGNED`] or [`CLOSED`].
    label: u32,
}

struct Growth<'a> {
    faces: &'a Faces,
    params: &'a FlattenParams,
    cells: Vec<Cell>,
    proxies: Vec<Proxy>,
    /// Triangles by falling flatness.
    seed_order: Vec<u32>,
    radius2_m2: f64,
    min_cos: f64,
    heap: BinaryHeap<Reverse<(u64, u32, u32)>>,
}

impl<'a> Growth<'a> {
    fn new(mates: &[u32], faces: &'a Faces, is_open: &[bool], params: &'a FlattenParams) -> Self {
        let num_open = is_open.iter().filter(|open| **open).count().max(1);
        let mean_area = faces.areas_m2.iter().sum::<f64>() / num_open as f64;
        let radius2_m2 = mean_area * params.max_chart_triangles as f64 / std::f64::consts::PI;
        let cell = |triangle: usize| Cell {
            center_m: faces.centroids_m[triangle],
            normal: faces.normals[triangle],
            mates: [0, 1, 2].map(|k| mates[3 * triangle + k]),
            label: if is_open[triangle] {
                UNASSIGNED
            } else {
                CLOSED
            },
        };
        Self {
            faces,
            params,
            cells: (0..is_open.len()).map(cell).collect(),
            proxies: Vec::new(),
            seed_order: flatness_order(mates, faces),
            radius2_m2,
            min_cos: params.max_normal_deviation_rad.cos(),
            heap: BinaryHeap::new(),
        }
    }

    /// Per triangle its chart, or [`UNASSIGNED`].
    fn labels(&self) -> Vec<u32> {
        let label = |cell: &Cell| match cell.label {
            CLOSED => UNASSIGNED,
            label => label,
        };
        self.cells.iter().map(label).collect()
    }

    /// Squared distance to the chart's centre plus a share for the normal; none beyond the bound.
    fn cost(&self, triangle: usize, proxy: &Proxy) -> Option<u64> {
        let Cell {
            center_m, normal, ..
        } = self.cells[triangle];
        let cosine = normal.dot(&proxy.normal);
        if cosine < self.min_cos && normal != Vector3::zeros() && proxy.normal != Vector3::zeros() {
            return None;
        }
        let distance2 = (center_m - proxy.center_m).norm_squared();
        let cost = distance2 + NORMAL_WEIGHT * self.radius2_m2 * (1.0 - cosine).max(0.0);
        // Bits of non-negative numbers are ordered as the numbers are.
        Some(cost.max(0.0).to_bits())
    }

    fn offer(&mut self, triangle: u32, chart: u32) {
        let index = triangle as usize;
        if self.cells[index].label == UNASSIGNED
            && let Some(cost) = self.cost(index, &self.proxies[chart as usize])
        {
            self.heap.push(Reverse((cost, triangle, chart)));
        }
    }

    /// Gives the nearest offered triangles to their charts until nothing is offered.
    fn flood(&mut self, max_triangles: usize) {
        while let Some(Reverse((_, triangle, chart))) = self.heap.pop() {
            let proxy = &mut self.proxies[chart as usize];
            let cell = &mut self.cells[triangle as usize];
            if cell.label != UNASSIGNED || proxy.num_triangles >= max_triangles {
                continue;
            }
            proxy.num_triangles += 1;
            cell.label = chart;
            for mate in cell.mates {
                if mate != NO_HALF_EDGE {
                    self.offer(mate / 3, chart);
                }
            }
        }
    }

    /// Grows a new chart from each triangle that has none, flattest first.
    #[expect(
        clippy::cast_possible_truncation,
        reason = "fewer charts than triangles; a share of a size"
    )]
    fn seed_unreached(&mut self) {
        let max_first = FIRST_SIZE_SHARE * self.params.max_chart_triangles as f64;
        for i in 0..self.seed_order.len() {
            let seed = self.seed_order[i];
            if self.cells[seed as usize].label != UNASSIGNED {
                continue;
            }
            let chart = self.proxies.len() as u32;
            self.proxies.push(Proxy {
                center_m: self.cells[seed as usize].center_m,
                normal: self.cells[seed as usize].normal,
                num_triangles: 0,
            });
            self.offer(seed, chart);
            self.flood((max_first as usize).max(1));
        }
    }

    /// Grows all charts together from their centres.
    fn relax(&mut self) {
        let centers = self.recenter();
        for cell in self.cells.iter_mut().filter(|cell| cell.label != CLOSED) {
            cell.label = UNASSIGNED;
        }
        for (chart, seed) in (0_u32..).zip(centers) {
            self.offer(seed, chart);
        }
        self.flood(self.params.max_chart_triangles);
        self.seed_unreached();
    }

    /// New proxies from the charts as they are; returns the triangle nearest to each one's
    /// centre. Tiny charts are left out.
    fn recenter(&mut self) -> Vec<u32> {
        let mut sums = vec![(Vector3::zeros(), Vector3::zeros(), 0.0, 0_usize); self.proxies.len()];
        for (triangle, cell) in self.cells.iter().enumerate() {
            if let Some((normal, center, area, count)) = sums.get_mut(cell.label as usize) {
                // Triangles of no area count a little, so that a chart of them has a centre.
                let weight = self.faces.areas_m2[triangle].max(f64::MIN_POSITIVE);
                *normal += weight * cell.normal;
                *center += weight * cell.center_m.coords;
                *area += weight;
                *count += 1;
            }
        }
        let proxies: Vec<Proxy> = sums
            .iter()
            .map(|(normal, center, area, count)| Proxy {
                center_m: Point3::from(center / *area),
                normal: normal.try_normalize(0.0).unwrap_or_default(),
                num_triangles: *count,
            })
            .collect();
        let mut nearest = vec![(u64::MAX, UNASSIGNED); proxies.len()];
        for (triangle, cell) in (0_u32..).zip(&self.cells) {
            if let Some(proxy) = proxies.get(cell.label as usize)
                && let Some(cost) = self.cost(triangle as usize, proxy)
            {
                let nearest = &mut nearest[cell.label as usize];
                *nearest = (*nearest).min((cost, triangle));
            }
        }
        let kept: Vec<usize> = (0..proxies.len())
            .filter(|&c| {
                proxies[c].num_triangles >= self.params.min_chart_triangles
                    && nearest[c].1 != UNASSIGNED
            })
            .collect();
        self.proxies = kept
            .iter()
            .map(|&c| Proxy {
                num_triangles: 0,
                ..proxies[c]
            })
            .collect();
        kept.iter().map(|&c| nearest[c].1).collect()
    }
}

/// Triangles by how well the smoothed normals of their neighbours agree, in coarse steps, ties by
/// index.
fn flatness_order(mates: &[u32], faces: &Faces) -> Vec<u32> {
    let mut keyed: Vec<(u32, u32)> = (0_u32..)
        .take(faces.normals.len())
        .map(|triangle| {
            let first = 3 * triangle as usize;
            let own = faces.normals[triangle as usize];
            let worst = mates[first..first + 3]
                .iter()
                .filter(|mate| **mate != NO_HALF_EDGE)
                .map(|&mate| own.dot(&faces.normals[mate as usize / 3]))
                .fold(1.0_f64, f64::min);
            #[expect(clippy::cast_possible_truncation, reason = "clamped")]
            #[expect(clippy::cast_sign_loss, reason = "clamped")]
            let step = (64.0 * (1.0 - worst).clamp(0.0, 2.0).sqrt()) as u32;
            (step, triangle)
        })
        .collect();
    keyed.sort_unstable();
    keyed.into_iter().map(|(_, triangle)| triangle).collect()
}

/// Moves a triangle to the chart that holds two of its three neighbours, where its normal allows.
fn smooth_borders(mates: &[u32], faces: &Faces, params: &FlattenParams, label: &mut [u32]) {
    const NUM_SWEEPS: usize = 3;
    let normals = merge::mean_normals(faces, label);
    let min_cos = params.max_normal_deviation_rad.cos();
    for _ in 0..NUM_SWEEPS {
        for triangle in 0..label.len() {
            let own = label[triangle];
            let neighbors = [0, 1, 2].map(|k| match mates[3 * triangle + k] {
                NO_HALF_EDGE => UNASSIGNED,
                mate => label[mate as usize / 3],
            });
            let [a, b, c] = neighbors;
            let other = if a == b || a == c { a } else { b };
            let num_other = neighbors.iter().filter(|n| **n == other).count();
            if other == own || other == UNASSIGNED || num_other < 2 {
                continue;
            }
            if faces.normals[triangle].dot(&normals[other as usize]) >= min_cos {
                label[triangle] = other;
            }
        }
    }
}
