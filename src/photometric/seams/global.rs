//! A correction per vertex and label.

use crate::atlas::AtlasTexture;
use crate::mesh::TriMesh;

use super::super::conjugate::{self, Stop};
use super::SeamParams;
use super::nodes::{NO_NODE, Nodes};
use super::samples::{Seam, belief};
use super::surface::Surface;

/// Corrections below this are nothing that a byte could show.
const MIN_CORRECTION: f32 = 1e-4;

/// Steps whose doubt is smaller count alike, linear light squared.
const MIN_VARIANCE: f64 = 1e-6;
/// So many samples along a seam are wrong together.
const SAMPLES_ALIKE: f64 = 4.0;

/// Two nodes, the weight of their difference, and what it should be.
struct Link {
    from: u32,
    to: u32,
    weight: f64,
    /// What the second should have more than the first.
    wanted: [f64; 3],
}

/// Solves for the corrections beside those that stand ([`Nodes::standing`]); the second is the number
/// of solver steps.
pub(super) fn solve(
    mesh: &TriMesh,
    nodes: &Nodes,
    standing: &[Option<[f32; 3]>],
    seams: &[Seam],
    params: &SeamParams,
) -> (Vec<[f32; 3]>, usize) {
    let mut links = smoothness(nodes);
    // Edges of a regular mesh: each node has half of six, along which a unit gradient shows by half.
    let pull = 1.5 * (mean_edge_m(mesh) / params.reach_m).powi(2);
    // Against the stiffness of a correction that dies away on both sides of a straight seam: of its
    // step, 1 / (2 step_weight) is left, whatever the size of the triangles.
    let step_weight = params.step_weight * pull.sqrt();
    for seam in seams {
        links.extend(steps(nodes, seam, step_weight));
    }
    let laplacian = Laplacian::new(nodes.len(), &links, pull);
    let mut rhs = vec![[0.0; 3]; nodes.len()];
    for link in &links {
        for (c, wanted) in link.wanted.iter().enumerate() {
            rhs[link.from as usize][c] -= link.weight * wanted;
            rhs[link.to as usize][c] += link.weight * wanted;
        }
    }
    if !standing.is_empty() {
        laplacian.hold(standing, &mut rhs);
    }
    let mut x = vec![[0.0; 3]; nodes.len()];
    let stop = Stop {
        tolerance: 1e-4,
        max_steps: 1000,
    };
    let num_steps = conjugate::solve(
        |x, out| {
            laplacian.apply(x, out);
            release(standing, out);
        },
        &laplacian.diagonal,
        &rhs,
        &mut x,
        &stop,
    );
    #[expect(clippy::cast_possible_truncation, reason = "rounding to f32 is meant")]
    let mut corrections: Vec<[f32; 3]> = x.iter().map(|g| g.map(|value| value as f32)).collect();
    for (correction, standing) in corrections.iter_mut().zip(standing) {
        *correction = standing.unwrap_or(*correction);
    }
    (corrections, num_steps)
}

/// Takes the equations of nodes that stand out.
fn release(standing: &[Option<[f32; 3]>], rows: &mut [[f64; 3]]) {
    for (row, standing) in rows.iter_mut().zip(standing) {
        if standing.is_some() {
            *row = [0.0; 3];
        }
    }
}

/// Adds the corrections; returns how many texels changed.
pub(super) fn paint(
    surface: &Surface<'_>,
    nodes: &Nodes,
    corrections: &[[f32; 3]],
    texture: &mut AtlasTexture,
) -> usize {
    surface.paint(texture, |triangle| {
        let corners = nodes.of(triangle);
        if corners.contains(&NO_NODE) {
            return None;
        }
        let corners = corners.map(|node| corrections[node as usize]);
        let is_seen = corners.iter().flatten().any(|g| g.abs() > MIN_CORRECTION);
        is_seen.then_some(move |weights: [f32; 3]| {
            let mix = |c: usize| (0..3).map(|k| weights[k] * corners[k][c]).sum();
            Some(std::array::from_fn(mix))
        })
    })
}

/// Sides of triangles, each once.
fn smoothness(nodes: &Nodes) -> Vec<Link> {
    let mut pairs: Vec<(u32, u32)> = nodes
        .all()
        .iter()
        .filter(|corners| !corners.contains(&NO_NODE))
        .flat_map(|&[a, b, c]| [(a, b), (b, c), (c, a)])
        .filter(|(a, b)| a != b)
        .map(|(a, b)| (a.min(b), a.max(b)))
        .collect();
    pairs.sort_unstable();
    pairs.dedup();
    let link = |(from, to)| Link {
        from,
        to,
        weight: 1.0,
        wanted: [0.0; 3],
    };
    pairs.into_iter().map(link).collect()
}

/// At each end of the seam: the mean step as far as it is believed, samples counting the less the
/// farther they are from it and the more doubtful they are.
fn steps(nodes: &Nodes, seam: &Seam, step_weight: f64) -> impl Iterator<Item = Link> {
    let corners = seam
        .sides
        .map(|side| (nodes.of(side.triangle), side.corners));
    [0, 1].into_iter().filter_map(move |end| {
        let [from, to] = corners.map(|(nodes, corners)| nodes[corners[end]]);
        let mut near = 0.0;
        let mut total = 0.0;
        let mut sum = [0.0; 3];
        let mut doubt = 0.0;
        for (k, step) in seam.steps.iter().enumerate() {
            let Some(step) = step else { continue };
            let share = seam.share_of(k);
            let nearness = if end == 0 { 1.0 - share } else { share };
            let variance = f64::from(seam.doubts[k]).powi(2);
            let weight = nearness / variance.max(MIN_VARIANCE);
            near += nearness;
            total += weight;
            doubt += weight * weight * variance;
            for c in 0..3 {
                sum[c] -= weight * f64::from(step[c]);
            }
        }
        let usable = near / seam.steps.len() as f64;
        let mean = sum.map(|sum| sum / total);
        let believed = belief(&mean, SAMPLES_ALIKE * doubt / (total * total));
        (usable > 0.0 && from != NO_NODE && to != NO_NODE && from != to).then(|| Link {
            from,
            to,
            weight: step_weight * usable,
            wanted: mean.map(|step| believed * step),
        })
    })
}

fn mean_edge_m(mesh: &TriMesh) -> f64 {
    let (mut sum_m, mut num_sides) = (0.0, 0.0);
    for triangle in mesh.triangle_ids() {
        let [a, b, c] = mesh.corners_m(triangle);
        sum_m += (b - a).norm() + (c - b).norm() + (a - c).norm();
        num_sides += 3.0;
    }
    if num_sides > 0.0 {
        sum_m / num_sides
    } else {
        0.0
    }
}

/// Links as compressed rows.
struct Laplacian {
    diagonal: Vec<f64>,
    row_starts: Vec<usize>,
    columns: Vec<u32>,
    weights: Vec<f64>,
}

impl Laplacian {
    fn new(size: usize, links: &[Link], pull: f64) -> Self {
        let ends = || {
            links
                .iter()
                .flat_map(|l| [(l.from, l.to, l.weight), (l.to, l.from, l.weight)])
        };
        // Above zero whatever the mesh's size, so that a node without links has something to divide by.
        let mut diagonal = vec![pull.max(1e-9); size];
        let mut row_starts = vec![0; size + 1];
        for (row, _, weight) in ends() {
            diagonal[row as usize] += weight;
            row_starts[row as usize + 1] += 1;
        }
        for row in 0..size {
            row_starts[row + 1] += row_starts[row];
        }
        let mut cursor = row_starts.clone();
        let mut columns = vec![0; 2 * links.len()];
        let mut weights = vec![0.0; 2 * links.len()];
        for (row, column, weight) in ends() {
            let slot = &mut cursor[row as usize];
            columns[*slot] = column;
            weights[*slot] = weight;
            *slot += 1;
        }
        Self {
            diagonal,
            row_starts,
            columns,
            weights,
        }
    }

    /// Takes what stands to the right-hand side: what is left to solve for is 0 there.
    fn hold(&self, standing: &[Option<[f32; 3]>], rhs: &mut [[f64; 3]]) {
        let held: Vec<[f64; 3]> = standing
            .iter()
            .map(|standing| standing.unwrap_or_default().map(f64::from))
            .collect();
        let mut product = vec![[0.0; 3]; held.len()];
        self.apply(&held, &mut product);
        for (row, product) in rhs.iter_mut().zip(product) {
            for (row, product) in row.iter_mut().zip(product) {
                *row -= product;
            }
        }
        release(standing, rhs);
    }

    fn apply(&self, x: &[[f64; 3]], out: &mut [[f64; 3]]) {
        for (row, out) in out.iter_mut().enumerate() {
            let mut sum = x[row].map(|value| value * self.diagonal[row]);
            for k in self.row_starts[row]..self.row_starts[row + 1] {
                let other = &x[self.columns[k] as usize];
                for c in 0..3 {
                    sum[c] -= self.weights[k] * other[c];
                }
            }
            *out = sum;
        }
    }
}
