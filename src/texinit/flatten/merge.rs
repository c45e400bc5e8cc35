//! Merging of neighbouring charts while the bounds hold.

use std::collections::{BTreeMap, BinaryHeap};

use nalgebra::Vector3;

use super::FlattenParams;
use super::charts::UNASSIGNED;
use super::cut::find;
use super::faces::Faces;
use crate::mesh::adjacency::NO_HALF_EDGE;

/// Least share of the smaller perimeter that a common border must have.
const MIN_COMMON_BORDER: f64 = 0.12;

/// Cosine of the largest angle between a tiny chart's normals and those of the chart it joins; how
/// well it then flattens is for the flattening to say.
const MIN_COS_TINY: f64 = 0.0;

/// Mean unit normal of each chart; zero where there is none.
pub(crate) fn mean_normals(faces: &Faces, label: &[u32]) -> Vec<Vector3<f64>> {
    let num_charts = label
        .iter()
        .filter(|l| **l != UNASSIGNED)
        .max()
        .map_or(0, |max| *max as usize + 1);
    let mut sums = vec![Vector3::zeros(); num_charts];
    for (triangle, &chart) in label.iter().enumerate() {
        if chart != UNASSIGNED {
            sums[chart as usize] += faces.areas_m2[triangle] * faces.normals[triangle];
        }
    }
    sums.iter()
        .map(|n| n.try_normalize(0.0).unwrap_or_default())
        .collect()
}

struct Chart {
    triangles: Vec<u32>,
    normal_sum: Vector3<f64>,
    area_m2: f64,
    perimeter_m: f64,
    /// Common border with each neighbour, metres.
    borders_m: BTreeMap<u32, f64>,
    /// Counts changes, so that stale candidates are known.
    version: u32,
}

/// A possible merge; the largest comes first.
#[derive(PartialEq, Eq, PartialOrd, Ord)]
struct Candidate {
    /// Bits of the share of the smaller perimeter that is common.
    share_bits: u64,
    charts: [u32; 2],
    versions: [u32; 2],
}

/// Relabels `label` by merging charts: longest common border (as a share of the smaller perimeter)
/// first, while normals, size and roundness stay within bounds.
pub(crate) fn merge_charts(
    mates: &[u32],
    faces: &Faces,
    params: &FlattenParams,
    label: &mut [u32],
) {
    let mut charts = gather(mates, faces, label);
    let mut heap = BinaryHeap::new();
    for (id, chart) in (0_u32..).zip(&charts) {
        for &other in chart.borders_m.keys().filter(|other| **other > id) {
            heap.extend(candidate(&charts, id, other));
        }
    }
    let mut owner: Vec<u32> = (0_u32..).take(charts.len()).collect();
    while let Some(Candidate {
        charts: [a, b],
        versions,
        ..
    }) = heap.pop()
    {
        let current = [a, b].map(|c| charts[c as usize].version);
        if current != versions || !may_merge(faces, params, &charts, a, b) {
            continue;
        }
        let (kept, gone) =
            if charts[a as usize].triangles.len() >= charts[b as usize].triangles.len() {
                (a, b)
            } else {
                (b, a)
            };
        absorb(&mut charts, kept, gone);
        owner[gone as usize] = kept;
        let neighbors: Vec<u32> = charts[kept as usize].borders_m.keys().copied().collect();
        for other in neighbors {
            heap.extend(candidate(&charts, kept, other));
        }
    }
    for chart in label.iter_mut().filter(|chart| **chart != UNASSIGNED) {
        *chart = find(&mut owner, *chart);
    }
}

fn gather(mates: &[u32], faces: &Faces, label: &[u32]) -> Vec<Chart> {
    let num_charts = mean_normals(faces, label).len();
    let mut charts: Vec<Chart> = (0..num_charts)
        .map(|_| Chart {
            triangles: Vec::new(),
            normal_sum: Vector3::zeros(),
            area_m2: 0.0,
            perimeter_m: 0.0,
            borders_m: BTreeMap::new(),
            version: 0,
        })
        .collect();
    for (triangle, &own) in (0_u32..).zip(label) {
        let Some(chart) = charts.get_mut(own as usize) else {
            continue;
        };
        let index = triangle as usize;
        chart.triangles.push(triangle);
        chart.normal_sum += faces.areas_m2[index] * faces.normals[index];
        chart.area_m2 += faces.areas_m2[index];
        for k in 0..3 {
            let mate = mates[3 * index + k];
            let length = faces.side_lengths_m[index][k];
            if mate == NO_HALF_EDGE {
                chart.perimeter_m += length;
                continue;
            }
            let other = label[mate as usize / 3];
            if other != own {
                chart.perimeter_m += length;
                *chart.borders_m.entry(other).or_default() += length;
            }
        }
    }
    charts
}

fn candidate(charts: &[Chart], a: u32, b: u32) -> Option<Candidate> {
    let [first, second] = [a, b].map(|c| &charts[c as usize]);
    let common = first.borders_m.get(&b)?;
    let share = common / first.perimeter_m.min(second.perimeter_m);
    (share >= 0.0).then(|| Candidate {
        share_bits: share.to_bits(),
        charts: [a, b],
        versions: [first.version, second.version],
    })
}

fn may_merge(faces: &Faces, params: &FlattenParams, charts: &[Chart], a: u32, b: u32) -> bool {
    let mut pair = [a, b].map(|c| &charts[c as usize]);
    pair.sort_by_key(|chart| chart.triangles.len());
    let [small, large] = pair;
    let normal = (small.normal_sum + large.normal_sum)
        .try_normalize(0.0)
        .unwrap_or_default();
    let is_within = |chart: &Chart, min_cos: f64| {
        chart.triangles.iter().all(|&t| {
            let own = faces.normals[t as usize];
            own.dot(&normal) >= min_cos || own == Vector3::zeros()
        })
    };
    let num_triangles = small.triangles.len() + large.triangles.len();
    if small.triangles.len() < params.min_chart_triangles {
        return num_triangles <= params.max_chart_triangles + params.min_chart_triangles
            && is_within(small, MIN_COS_TINY);
    }
    let common = charts[a as usize].borders_m.get(&b).copied().unwrap_or(0.0);
    let perimeter = small.perimeter_m + large.perimeter_m - 2.0 * common;
    let area = small.area_m2 + large.area_m2;
    let roughness = perimeter * perimeter / (4.0 * std::f64::consts::PI * area);
    let share = common / small.perimeter_m.min(large.perimeter_m);
    let min_cos = params.max_normal_deviation_rad.cos();
    num_triangles <= params.max_chart_triangles
        && roughness <= params.max_boundary_roughness
        && share >= MIN_COMMON_BORDER
        && is_within(small, min_cos)
        && is_within(large, min_cos)
}

fn absorb(charts: &mut [Chart], kept: u32, gone: u32) {
    let taken = std::mem::replace(
        &mut charts[gone as usize],
        Chart {
            triangles: Vec::new(),
            normal_sum: Vector3::zeros(),
            area_m2: 0.0,
            perimeter_m: 0.0,
            borders_m: BTreeMap::new(),
            version: u32::MAX,
        },
    );
    for (&other, &length) in taken.borders_m.iter().filter(|(other, _)| **other != kept) {
        let borders = &mut charts[other as usize].borders_m;
        borders.remove(&gone);
        *borders.entry(kept).or_default() += length;
        *charts[kept as usize].borders_m.entry(other).or_default() += length;
    }
    let chart = &mut charts[kept as usize];
    let common = chart.borders_m.remove(&gone).unwrap_or(0.0);
    chart.triangles.extend(taken.triangles);
    chart.normal_sum += taken.normal_sum;
    chart.area_m2 += taken.area_m2;
    chart.perimeter_m += taken.perimeter_m - 2.0 * common;
    chart.version += 1;
}
