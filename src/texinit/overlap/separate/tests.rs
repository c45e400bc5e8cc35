//! The fields of real and random charts, the guarantee, and merging.

use proptest::prelude::*;

use super::super::detect::overlapping_pairs;
use super::super::field::OverlapForm;
use super::super::mplp::Mplp;
use super::*;

type Corners = [[f64; 2]; 3];

const FORMS: [OverlapForm; 2] = [OverlapForm::Printed, OverlapForm::Reference];

/// The field of a chart in either form; nothing where no triangles overlap. Edges of the surface
/// are those given.
fn field_in(
    form: OverlapForm,
    corners_m: &[Corners],
    surface_edges: &SharedEdges,
) -> Option<PottsField> {
    let layer = PlaneTriangles::new(corners_m);
    let pairs = overlapping_pairs(&layer, 1 << 20)?;
    if pairs.is_empty() {
        return None;
    }
    let plane_edges = SharedEdges::in_plane(corners_m);
    let chart = FoldedChart {
        layer: &layer,
        plane_edges: &plane_edges,
        field_edges: match form {
            OverlapForm::Printed => &plane_edges,
            OverlapForm::Reference => surface_edges,
        },
        pairs: Some(&pairs),
    };
    let adjacency = Neighbours::new(layer.len(), &plane_edges.adjacent_pairs(&layer));
    let order = adjacency.breadth_first();
    let overlaps = Neighbours::new(layer.len(), &pairs);
    let preferred = Preferred::new(form, &layer, &order, &overlaps, &pairs);
    field_of(&chart, &pairs, preferred, &OverlapParams::paper())
}

/// Sweeps, and checks that the dual never rises and stays above what any labelling earned.
fn check_dual(field: &PottsField, num_sweeps: usize) {
    let mut mplp = Mplp::new(field);
    let mut dual = mplp.dual();
    let scale = 1.0 + dual.abs();
    let mut best = f64::NEG_INFINITY;
    for _ in 0..num_sweeps {
        mplp.sweep();
        best = best.max(field.value(&mplp.decode()));
        let next = mplp.dual();
        assert!(next <= dual + 1e-12 * scale, "{dual} rose to {next}");
        assert!(next >= best - 1e-9 * scale, "{next} is under {best}");
        dual = next;
    }
}

fn best_by_enumeration(field: &PottsField) -> f64 {
    let num_nodes = field.unary.len() / field.num_labels;
    let mut labels = vec![0; num_nodes];
    let mut best = f64::NEG_INFINITY;
    loop {
        best = best.max(field.value(&labels));
        let Some(node) = labels.iter().position(|&l| l + 1 < field.num_labels) else {
            return best;
        };
        labels[node] += 1;
        labels[..node].fill(0);
    }
}

/// Each new triangle stands on an edge of an earlier one, its tip anywhere.
fn small_chart(tips: &[(usize, [i32; 2])]) -> Vec<Corners> {
    let mut triangles: Vec<Corners> = vec![[[0.0, 0.0], [4.0, 0.0], [0.0, 4.0]]];
    for (k, tip) in tips {
        let base = triangles[k / 3 % triangles.len()];
        let (a, b) = (base[k % 3], base[(k + 1) % 3]);
        triangles.push([b, a, tip.map(f64::from)]);
    }
    triangles
}

#[test]
fn small_charts_are_solved_as_well_as_by_trying_all_labellings() {
    let mut state = 1u64;
    let mut random = move |below: u64| {
        state = state
            .wrapping_mul(6_364_136_223_846_793_005)
            .wrapping_add(1_442_695_040_888_963_407);
        (state >> 33) % below
    };
    let (mut num_fields, mut num_optimal) = (0, [0; 2]);
    while num_fields < 150 {
        let tips: Vec<_> = (0..6)
            .map(|_| {
                let tip = [random(9) as i32, random(9) as i32];
                (random(1 << 20) as usize, tip)
            })
            .collect();
        let corners_m = small_chart(&tips);
        let edges = SharedEdges::in_plane(&corners_m);
        let fields = FORMS.map(|form| field_in(form, &corners_m, &edges));
        let [Some(printed), Some(reference)] = fields else {
            continue;
        };
        num_fields += 1;
        for (form, field) in [printed, reference].iter().enumerate() {
            let params = OverlapParams {
                form: FORMS[form],
                ..OverlapParams::default()
            };
            let labels: Vec<usize> = solve(field, &params).iter().map(|p| *p as usize).collect();
            let (value, best) = (field.value(&labels), best_by_enumeration(field));
            assert!(value <= best + 1e-9, "{value} of {best}");
            num_optimal[form] += usize::from(value > best - 1e-9);
        }
    }
    // 136 and 79. The relaxation is not tight where odd rings of triangles overlap each other, and
    // ten sweeps do not reach its bound at rewards twenty times the triangles' own.
    assert!(
        num_optimal[0] > 120 && num_optimal[1] > 60,
        "{num_optimal:?}"
    );
}

#[test]
fn the_dual_never_rises_on_the_apartment() {
    use crate::mesh::weld::equal_representatives;
    use crate::texinit::assign::capture::Capture;
    use crate::texinit::flatten::{FlattenParams, flatten};

    let Some(capture) = Capture::load("apt0_structure", "mesh.ply", |_| false) else {
        return;
    };
    let mesh = capture.mesh;
    let vertex_of = equal_representatives(mesh.positions_m());
    let charts = flatten(&mesh, &FlattenParams::default()).unwrap().charts;
    let mut num_fields = 0;
    for chart in &charts {
        let triangles = chart.triangles.iter().map(|t| mesh.triangles()[t.index()]);
        let surface = SharedEdges::of(triangles.map(|t| t.map(|v| vertex_of[v as usize])));
        for form in FORMS {
            if let Some(field) = field_in(form, &chart.corners_m, &surface) {
                check_dual(&field, 10);
                num_fields += 1;
            }
        }
    }
    assert!(num_fields > 20, "{num_fields} fields");
}

#[test]
fn pieces_in_a_row_come_together_but_for_those_that_overlap() {
    let mut piece_of = [0, 1, 2, 3];
    merge(&mut piece_of, &[[0, 1], [1, 2], [2, 3]], &[[0, 2]]);
    assert!(piece_of[0] != piece_of[2]);
    assert_eq!(members_by_piece(&piece_of).len(), 2);
}

proptest! {
    #[test]
    fn the_dual_never_rises_on_any_chart(
        tips in proptest::collection::vec((any::<usize>(), [0i32..9, 0i32..9]), 0..60),
    ) {
        let corners_m = small_chart(&tips);
        for form in FORMS {
            if let Some(field) = field_in(form, &corners_m, &SharedEdges::in_plane(&corners_m)) {
                check_dual(&field, 10);
            }
        }
    }

    /// Whatever the field left, no overlapping pair shares a plane, only such pairs moved, and
    /// merging keeps it so and leaves nothing to merge.
    #[test]
    fn the_guarantee_holds_for_any_planes(
        planes in proptest::collection::vec(0u32..4, 20),
        pairs in proptest::collection::btree_set((0u32..20, 1u32..20), 0..60),
        adjacent in proptest::collection::btree_set((0u32..20, 1u32..20), 0..40),
    ) {
        let pair = |(a, step): &(u32, u32)| {
            let b = (a + step) % 20;
            [*a.min(&b), *a.max(&b)]
        };
        let sorted = |set: BTreeSet<[u32; 2]>| -> Vec<[u32; 2]> { set.into_iter().collect() };
        let pairs = sorted(pairs.iter().map(pair).collect());
        let adjacent: Vec<[u32; 2]> = sorted(adjacent.iter().map(pair).collect())
            .into_iter()
            .filter(|pair| !pairs.contains(pair))
            .collect();
        let mut separated = planes.clone();
        let num_moved = move_to_free_planes(
            &mut separated,
            &Neighbours::new(20, &adjacent),
            &Neighbours::new(20, &pairs),
            &pairs,
        );
        let together = |of: &[u32]| {
            let same = |p: &&[u32; 2]| of[p[0] as usize] == of[p[1] as usize];
            pairs.iter().filter(same).count()
        };
        prop_assert_eq!(together(&separated), 0);
        prop_assert!(num_moved <= together(&planes));
        let num_changed = planes.iter().zip(&separated).filter(|(a, b)| a != b).count();
        prop_assert_eq!(num_changed, num_moved);

        let mut piece_of: Vec<usize> = (0..20).collect();
        merge(&mut piece_of, &adjacent, &pairs);
        let overlap = |a: usize, b: usize| {
            pairs.iter().any(|p| {
                let found = p.map(|t| piece_of[t as usize]);
                found == [a, b] || found == [b, a]
            })
        };
        for piece in &piece_of {
            prop_assert!(!overlap(*piece, *piece));
        }
        for [a, b] in adjacent.iter().map(|p| p.map(|t| piece_of[t as usize])) {
            prop_assert!(a == b || overlap(a, b));
        }
    }
}
