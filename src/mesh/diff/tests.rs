#![expect(
    clippy::cast_possible_truncation,
    reason = "the numbers of a test are small"
)]

use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;

use proptest::prelude::*;

use super::*;

fn mesh(positions: &[[f64; 3]], triangles: &[[u32; 3]]) -> TriMesh {
    let positions = positions.iter().map(|&p| Point3::from(p)).collect();
    TriMesh::from_soup(positions, triangles.to_vec()).unwrap().0
}

/// A sheet of 2·n² triangles, vertices 0.1 m apart, moved by `offset`.
fn sheet(n: u32, offset: [f64; 3]) -> TriMesh {
    let side = n + 1;
    let position = |k: u32| {
        let (x, y) = (f64::from(k % side), f64::from(k / side));
        [0.1 * x + offset[0], 0.1 * y + offset[1], offset[2]]
    };
    let positions: Vec<[f64; 3]> = (0..side * side).map(position).collect();
    let quads = (0..n * n).map(|q| q / n * side + q % n);
    let triangles: Vec<[u32; 3]> = quads
        .flat_map(|a| [[a, a + 1, a + side], [a + 1, a + side + 1, a + side]])
        .collect();
    mesh(&positions, &triangles)
}

fn joined(a: &TriMesh, b: &TriMesh) -> TriMesh {
    let first = a.num_vertices() as u32;
    let positions = [a.positions_m(), b.positions_m()].concat();
    let others = b.triangles().iter().map(|t| t.map(|v| v + first));
    let triangles = a.triangles().iter().copied().chain(others).collect();
    TriMesh::from_soup(positions, triangles).unwrap().0
}

/// The same surface with vertices and triangles in another order and other first corners.
fn shuffled(mesh: &TriMesh, seed: u64) -> TriMesh {
    let key = |k: usize| (k as u64 ^ seed).wrapping_mul(0x9e37_79b9_7f4a_7c15);
    let mut vertex_order: Vec<usize> = (0..mesh.num_vertices()).collect();
    vertex_order.sort_by_key(|&k| key(k));
    let mut new_from_old = vec![0; mesh.num_vertices()];
    for (new, &old) in vertex_order.iter().enumerate() {
        new_from_old[old] = new as u32;
    }
    let positions = vertex_order
        .iter()
        .map(|&k| mesh.positions_m()[k])
        .collect();
    let mut triangle_order: Vec<usize> = (0..mesh.num_triangles()).collect();
    triangle_order.sort_by_key(|&k| key(k + 77));
    let triangles = triangle_order.iter().map(|&k| {
        let mut corners = mesh.triangles()[k].map(|v| new_from_old[v as usize]);
        corners.rotate_left(key(k) as usize % 3);
        corners
    });
    TriMesh::from_soup(positions, triangles.collect())
        .unwrap()
        .0
}

/// Corners in steps of the grid, turned to the smallest first.
fn geometry(mesh: &TriMesh, triangle: TriangleId) -> [GridPoint; 3] {
    let corners = mesh
        .corners_m(triangle)
        .map(|p| grid_point(&p, DiffParams::default().quantum_m).unwrap());
    let [a, b, c] = corners;
    [[a, b, c], [b, c, a], [c, a, b]].into_iter().min().unwrap()
}

/// Per triangle of the new mesh.
fn origins(diff: &MeshDiff) -> Vec<Origin> {
    let in_place = ids_from(0).take(diff.num_in_place).map(|triangle| {
        Origin::Kept(OldTriangle {
            triangle,
            first_corner: 0,
        })
    });
    in_place.chain(diff.origins.iter().copied()).collect()
}

/// By geometry: how many triangles there are of each class (0 kept, 1 moved, 2 changed, 3 new).
fn classes(mesh: &TriMesh, diff: &MeshDiff) -> BTreeMap<([GridPoint; 3], u8), usize> {
    let mut classes = BTreeMap::new();
    for (triangle, origin) in mesh.triangle_ids().zip(origins(diff)) {
        let class = match origin {
            Origin::Kept(_) => 0,
            Origin::Moved(_) => 1,
            Origin::Changed => 2,
            Origin::New => 3,
        };
        *classes
            .entry((geometry(mesh, triangle), class))
            .or_default() += 1;
    }
    classes
}

/// Each origin names an old triangle once, gone are the others, and corners fit.
fn check(old: &TriMesh, new: &TriMesh, diff: &MeshDiff, params: &DiffParams) {
    let mut is_named = vec![false; old.num_triangles()];
    let reach_m = params.max_move_m + 2.0 * params.quantum_m;
    let origins = origins(diff);
    assert_eq!(origins.len(), new.num_triangles());
    for (triangle, origin) in new.triangle_ids().zip(&origins) {
        let (from, reach_m) = match origin {
            Origin::Kept(from) => (from, 2.0 * params.quantum_m),
            Origin::Moved(from) => (from, reach_m),
            Origin::Changed | Origin::New => continue,
        };
        assert!(!std::mem::replace(
            &mut is_named[from.triangle.index()],
            true
        ));
        let after = new.corners_m(triangle);
        for (k, before) in old.corners_m(from.triangle).iter().enumerate() {
            let moved = (after[(k + from.first_corner as usize) % 3] - before).norm();
            assert!(moved <= reach_m, "{moved} m");
        }
    }
    let unnamed = old.triangle_ids().filter(|t| !is_named[t.index()]);
    assert_eq!(unnamed.collect::<Vec<_>>(), diff.gone);
    assert!(diff.touched.is_sorted_by(|a, b| a < b), "each once");
    let last = diff.touched.last();
    assert!(last.is_none_or(|&last| (last as usize) < new.num_vertices()));
    // As many are in place as there are.
    let next = diff.others().next();
    let is_in_place = next.is_some_and(|(triangle, origin)| {
        let first_corner = 0;
        origin
            == Origin::Kept(OldTriangle {
                triangle,
                first_corner,
            })
    });
    assert!(!is_in_place, "{next:?}");
}

fn counts_of(old: &TriMesh, new: &TriMesh) -> DiffCounts {
    let params = DiffParams::default();
    let found = diff(old, new, &params).unwrap();
    check(old, new, &found, &params);
    found.counts()
}

#[test]
fn a_sheet_that_stays_is_kept_in_any_order() {
    let old = sheet(6, [0.0; 3]);
    for seed in 0..5 {
        let counts = counts_of(&old, &shuffled(&old, seed));
        let all_kept = DiffCounts {
            num_kept: 72,
            ..DiffCounts::default()
        };
        assert_eq!(counts, all_kept);
    }
}

#[test]
fn a_sheet_that_grows_keeps_what_it_had() {
    let old = sheet(4, [0.0; 3]);
    let far = sheet(2, [9.0, 0.0, 0.0]);
    let counts = counts_of(&old, &joined(&far, &old));
    assert_eq!((counts.num_kept, counts.num_new), (32, 8));
    let counts = counts_of(&joined(&old, &far), &old);
    assert_eq!((counts.num_kept, counts.num_gone), (32, 8));
    assert_eq!(counts.num_new + counts.num_changed + counts.num_moved, 0);
}

#[test]
fn a_sheet_that_is_refined_has_moved_and_one_that_jumps_has_not() {
    let old = sheet(5, [0.0; 3]);
    let near = counts_of(&old, &shuffled(&sheet(5, [0.004, -0.003, 0.006]), 3));
    assert_eq!((near.num_moved, near.num_gone), (50, 0));
    let far = counts_of(&old, &sheet(5, [0.0, 0.0, 0.02]));
    assert_eq!((far.num_moved, far.num_gone, far.num_new), (0, 50, 50));
}

#[test]
fn a_moved_vertex_moves_its_triangles_alone() {
    let old = sheet(4, [0.0; 3]);
    let mut positions = old.positions_m().to_vec();
    positions[12].z += 0.005;
    let new = TriMesh::from_soup(positions, old.triangles().to_vec())
        .unwrap()
        .0;
    let counts = counts_of(&old, &new);
    assert_eq!((counts.num_moved, counts.num_kept), (6, 26));
}

#[test]
fn a_flipped_edge_is_a_change() {
    let old = sheet(3, [0.0; 3]);
    let mut triangles = old.triangles().to_vec();
    let ([a, b, c], [_, d, _]) = (triangles[8], triangles[9]);
    (triangles[8], triangles[9]) = ([a, b, d], [a, d, c]);
    let new = TriMesh::from_soup(old.positions_m().to_vec(), triangles)
        .unwrap()
        .0;
    let counts = counts_of(&old, &new);
    assert_eq!(
        (counts.num_changed, counts.num_gone, counts.num_kept),
        (2, 2, 16)
    );
    let found = diff(&old, &new, &DiffParams::default()).unwrap();
    assert_eq!(found.touched.len(), 4);
}

#[test]
fn a_turned_over_triangle_is_another() {
    let old = mesh(&[[0.0; 3], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]], &[[0, 1, 2]]);
    let new = mesh(&[[0.0; 3], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]], &[[0, 2, 1]]);
    let counts = counts_of(&old, &new);
    assert_eq!((counts.num_changed, counts.num_gone), (1, 1));
}

#[test]
fn copies_and_degenerate_triangles_are_counted() {
    let points = [[0.0; 3], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0; 3]];
    let old = mesh(
        &points,
        &[[0, 1, 2], [1, 2, 3], [2, 0, 1], [0, 3, 1], [0, 0, 3]],
    );
    let new = mesh(&points, &[[1, 2, 0], [3, 1, 2], [3, 1, 0], [0, 0, 0]]);
    let counts = counts_of(&old, &new);
    // Two of the three copies, the triangle of two places and that of one.
    assert_eq!((counts.num_kept, counts.num_gone), (4, 1));
    let counts = counts_of(&new, &old);
    assert_eq!(
        (counts.num_kept, counts.num_changed + counts.num_new),
        (4, 1)
    );
}

#[test]
fn empty_meshes_and_bad_parameters() {
    let empty = TriMesh::default();
    let some = sheet(1, [0.0; 3]);
    assert_eq!(counts_of(&empty, &empty), DiffCounts::default());
    assert_eq!(counts_of(&empty, &some).num_new, 2);
    assert_eq!(counts_of(&some, &empty).num_gone, 2);
    for (quantum_m, max_move_m) in [(0.0, 0.1), (f64::NAN, 0.1), (1e-4, -1.0), (1e-4, f64::NAN)] {
        let params = DiffParams {
            quantum_m,
            max_move_m,
        };
        let refused = diff(&some, &some, &params);
        assert!(matches!(refused, Err(DiffError::Params { .. })));
    }
    let far = mesh(&[[1e13, 0.0, 0.0]; 3], &[[0, 1, 2]]);
    let refused = diff(&some, &far, &DiffParams::default());
    assert!(matches!(refused, Err(DiffError::OffGrid { .. })));
}

#[test]
fn on_the_grid_equal_vertices_are_one() {
    let soup = mesh(
        &[
            [0.0; 3],
            [1.0, 0.0, 0.0],
            [5.0; 3],
            [1.0, 1e-9, 0.0],
            [0.0, 1.0, 0.0],
            [1.0; 3],
        ],
        &[[0, 1, 4], [3, 5, 4]],
    );
    let welded = on_grid(&soup, 1.0 / 1024.0).unwrap();
    assert_eq!(welded.triangles(), [[0, 1, 2], [1, 3, 2]]);
    assert_eq!(on_grid(&welded, 1.0 / 1024.0).unwrap(), welded);
}

/// Triangles of a handful of vertices, some of which are close to others.
fn soups() -> impl Strategy<Value = (TriMesh, TriMesh)> {
    let point = [0_i32..4, 0_i32..4, 0_i32..2];
    let nudge = prop_oneof![4 => Just(0_i32), 1 => 1_i32..12];
    let triangle = [0_u32..14, 0_u32..14, 0_u32..14];
    let one = (
        proptest::collection::vec((point, nudge), 14),
        proptest::collection::vec(triangle, 0..30),
        proptest::collection::vec(prop_oneof![4 => Just(0_i32), 1 => 1_i32..12], 14),
        proptest::collection::vec((0_usize..30, [0_u32..14, 0_u32..14, 0_u32..14]), 0..6),
    );
    one.prop_map(|(points, triangles, nudges, edits)| {
        let at = |([x, y, z], nudge): &([i32; 3], i32), more: i32| {
            let [x, y, z] = [x, y, z].map(|c| 0.05 * f64::from(*c));
            [x + 0.001 * f64::from(nudge + more), y, z]
        };
        let old: Vec<_> = points.iter().map(|p| at(p, 0)).collect();
        let new: Vec<_> = points.iter().zip(&nudges).map(|(p, &n)| at(p, n)).collect();
        let mut edited = triangles.clone();
        for (index, corners) in edits {
            match edited.get_mut(index) {
                Some(triangle) => *triangle = corners,
                None => edited.push(corners),
            }
        }
        (mesh(&old, &triangles), mesh(&new, &edited))
    })
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(256))]
    #[test]
    fn order_does_not_matter_and_what_is_equal_is_kept(
        (old, new) in soups(),
        seeds in [any::<u64>(), any::<u64>()],
    ) {
        let params = DiffParams::default();
        let found = diff(&old, &new, &params).unwrap();
        check(&old, &new, &found, &params);
        let (old_too, new_too) = (shuffled(&old, seeds[0]), shuffled(&new, seeds[1]));
        let again = diff(&old_too, &new_too, &params).unwrap();
        check(&old_too, &new_too, &again, &params);
        prop_assert_eq!(classes(&new, &found), classes(&new_too, &again));
        // Kept are as many of each geometry as both meshes have.
        let mut num_of: BTreeMap<_, [usize; 2]> = BTreeMap::new();
        for (side, mesh) in [&old, &new].into_iter().enumerate() {
            for triangle in mesh.triangle_ids() {
                num_of.entry(geometry(mesh, triangle)).or_default()[side] += 1;
            }
        }
        let num_common: usize = num_of.values().map(|[a, b]| a.min(b)).sum();
        prop_assert_eq!(found.counts().num_kept, num_common);
    }
}

/// Places of named vertices that are touched, in steps of the grid.
fn touched(mesh: &TriMesh, diff: &MeshDiff) -> Vec<GridPoint> {
    let corners = mesh.triangles().as_flattened().iter();
    let touched = corners.filter(|vertex| diff.touched.binary_search(vertex).is_ok());
    let mut points: Vec<GridPoint> = touched
        .map(|&vertex| {
            let position_m = &mesh.positions_m()[vertex as usize];
            grid_point(position_m, DiffParams::default().quantum_m).unwrap()
        })
        .collect();
    points.sort_unstable();
    points.dedup();
    points
}

/// The points that triangles name, by the number of their vertex.
fn named_points(mesh: &TriMesh) -> BTreeMap<GridPoint, u32> {
    let corners = mesh.triangles().as_flattened().iter();
    let points = corners.map(|&vertex| {
        let position_m = &mesh.positions_m()[vertex as usize];
        let point = grid_point(position_m, DiffParams::default().quantum_m);
        (point.unwrap(), vertex)
    });
    points.collect()
}

/// Follows a mesh one step, and holds what is found against the comparison of the two alone.
fn check_step(tracked: &mut TrackedMesh, before: &TriMesh, now: &TriMesh) {
    let params = DiffParams::default();
    let old = Arc::clone(tracked.mesh());
    let num_renumberings = tracked.num_renumberings();
    let found = tracked.follow(&Arc::new(now.clone())).unwrap().unwrap();
    let mesh = tracked.mesh();
    check(&old, mesh, &found, &params);
    let alone = diff(before, now, &params).unwrap();
    assert_eq!(classes(mesh, &found), classes(now, &alone));
    assert_eq!(touched(mesh, &found), touched(now, &alone));
    if tracked.num_renumberings() == num_renumberings {
        let (old_points, points) = (named_points(&old), named_points(mesh));
        for (point, vertex) in &points {
            assert!(old_points.get(point).is_none_or(|before| before == vertex));
        }
    }
    // The same mesh on the grid, its triangles in the same order; no two vertices at one place.
    let on_grid = on_grid(now, params.quantum_m).unwrap();
    let corners_of = |mesh: &TriMesh| mesh.triangle_ids().map(|t| mesh.corners_m(t)).collect();
    let [ours, theirs]: [Vec<_>; 2] = [corners_of(mesh), corners_of(&on_grid)];
    assert_eq!(ours, theirs);
    let named = |mesh: &TriMesh| {
        let vertices: BTreeSet<u32> = mesh.triangles().as_flattened().iter().copied().collect();
        vertices.len()
    };
    assert_eq!(named(mesh), named(&on_grid));
    assert!(mesh.num_vertices() <= 2 * named(mesh) + old.num_vertices());
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(256))]
    #[test]
    fn what_is_followed_differs_as_the_two_meshes_do(
        (first, second) in soups(),
        (third, fourth) in soups(),
        seed in any::<u64>(),
    ) {
        let mut tracked = TrackedMesh::new(&DiffParams::default()).unwrap();
        let grown = joined(&second, &third);
        let steps = [
            &first, &second, &shuffled(&second, seed), &grown, &shuffled(&grown, !seed), &fourth,
            &joined(&third, &second), &TriMesh::default(), &first, &first,
        ];
        let mut before = &TriMesh::default();
        for now in steps {
            check_step(&mut tracked, before, now);
            before = now;
        }
    }
}

/// What happens to a mesh; numbers are taken modulo what is there.
#[derive(Clone, Debug)]
enum Edit {
    /// Vertices and triangles come after the others.
    Grow(Vec<[f64; 3]>, Vec<[u32; 3]>),
    /// Some of the last triangles go, and vertices behind those that are named then.
    Shrink(usize),
    /// A triangle has other corners.
    Change(usize, [u32; 3]),
    /// A vertex lies elsewhere.
    Move(usize, [f64; 3]),
    /// A triangle comes before others.
    Insert(usize, [u32; 3]),
    /// Vertices have other numbers; triangles stay in order.
    Renumber,
    /// Triangles and vertices come in another order.
    Shuffle(u64),
    /// A triangle has a corner that the grid cannot number: the mesh is refused.
    Lose(usize),
}

impl Edit {
    fn of(&self, mesh: &TriMesh) -> TriMesh {
        let mut positions = mesh.positions_m().to_vec();
        let mut triangles = mesh.triangles().to_vec();
        let (num_vertices, num_triangles) = (positions.len().max(1), triangles.len().max(1));
        let named = |corners: [u32; 3]| corners.map(|v| v % num_vertices as u32);
        match *self {
            Self::Grow(ref more_positions, ref more) => {
                positions.extend(more_positions.iter().map(|&p| Point3::from(p)));
                let num_vertices = positions.len() as u32;
                let more = more.iter().filter(|_| num_vertices > 0);
                triangles.extend(more.map(|corners| corners.map(|v| v % num_vertices)));
            }
            Self::Shrink(num) => {
                triangles.truncate(triangles.len() - num % num_triangles);
                let last = triangles.as_flattened().iter().max();
                positions.truncate(last.map_or(0, |&last| last as usize + 1));
            }
            Self::Change(triangle, corners) if !triangles.is_empty() => {
                triangles[triangle % num_triangles] = named(corners);
            }
            Self::Move(vertex, to) if !positions.is_empty() => {
                positions[vertex % num_vertices] = Point3::from(to);
            }
            Self::Insert(at, corners) if !positions.is_empty() => {
                triangles.insert(at % num_triangles, named(corners));
            }
            Self::Renumber => {
                positions.reverse();
                let reversed = |vertex: &mut u32| *vertex = num_vertices as u32 - 1 - *vertex;
                triangles.as_flattened_mut().iter_mut().for_each(reversed);
            }
            Self::Shuffle(seed) => return shuffled(mesh, seed),
            Self::Lose(at) => {
                triangles.insert(at % num_triangles, [0, 0, positions.len() as u32]);
                positions.push(Point3::new(1.0, -1e13, 0.0));
            }
            _ => {}
        }
        TriMesh::from_soup(positions, triangles).unwrap().0
    }
}

fn edits() -> impl Strategy<Value = Edit> {
    let nudge = prop_oneof![4 => Just(0_i32), 1 => 1_i32..12];
    // So few that several vertices are at one.
    let point = || {
        let at = ([0_i32..3, 0_i32..3, 0_i32..2], nudge.clone());
        at.prop_map(|([x, y, z], nudge)| {
            let [x, y, z] = [x, y, z].map(|c| 0.05 * f64::from(c));
            [x + 0.001 * f64::from(nudge), y, z]
        })
    };
    let corners = || [0_u32..200, 0_u32..200, 0_u32..200];
    let more_points = proptest::collection::vec(point(), 0..8);
    let more = proptest::collection::vec(corners(), 0..12);
    prop_oneof![
        4 => (more_points, more).prop_map(|(points, more)| Edit::Grow(points, more)),
        2 => (0_usize..12).prop_map(Edit::Shrink),
        2 => (any::<usize>(), corners()).prop_map(|(at, corners)| Edit::Change(at, corners)),
        2 => (any::<usize>(), point()).prop_map(|(at, to)| Edit::Move(at, to)),
        1 => (any::<usize>(), corners()).prop_map(|(at, corners)| Edit::Insert(at, corners)),
        1 => Just(Edit::Renumber),
        1 => any::<u64>().prop_map(Edit::Shuffle),
        1 => any::<usize>().prop_map(Edit::Lose),
    ]
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(256))]
    #[test]
    fn what_is_followed_edit_by_edit_differs_as_each_two_meshes_do(
        (_, first) in soups(),
        edits in proptest::collection::vec(edits(), 1..16),
    ) {
        let mut tracked = TrackedMesh::new(&DiffParams::default()).unwrap();
        check_step(&mut tracked, &TriMesh::default(), &first);
        let mut before = first;
        for edit in edits {
            let now = edit.of(&before);
            if matches!(edit, Edit::Lose(_)) {
                let mesh = Arc::clone(tracked.mesh());
                let refused = tracked.follow(&Arc::new(now));
                prop_assert!(
                    matches!(refused, Err(DiffError::OffGrid { coordinate_m: -1e13, .. })),
                    "{:?}", refused
                );
                prop_assert!(Arc::ptr_eq(tracked.mesh(), &mesh));
            } else {
                check_step(&mut tracked, &before, &now);
                before = now;
            }
        }
    }
}

#[test]
fn triangles_in_place_are_not_listed() {
    let mut tracked = TrackedMesh::new(&DiffParams::default()).unwrap();
    let first = sheet(20, [0.0; 3]);
    tracked.follow(&Arc::new(first.clone())).unwrap();
    // Of the sheet that comes some vertices lie on those of the first.
    let grown = joined(&first, &sheet(20, [1.9, 0.0, 0.0]));
    check_step(&mut tracked, &first, &grown);
    let edited = |edit: Edit, mesh: &TriMesh, tracked: &mut TrackedMesh| {
        let edited = edit.of(mesh);
        let found = tracked.follow(&Arc::new(edited.clone())).unwrap().unwrap();
        (edited, found)
    };
    let again = joined(&grown, &sheet(1, [0.0, 9.0, 0.0]));
    let found = tracked.follow(&Arc::new(again.clone())).unwrap().unwrap();
    assert_eq!((found.num_in_place, found.origins.len()), (1600, 2));
    assert_eq!(found.touched.len(), 4);
    let (shrunk, found) = edited(Edit::Shrink(2), &again, &mut tracked);
    assert_eq!((found.num_in_place, found.origins.len()), (1600, 0));
    assert_eq!((found.gone.len(), found.touched.len()), (2, 4));
    // Other numbers of vertices make no other triangles.
    let (same, found) = edited(Edit::Renumber, &shrunk, &mut tracked);
    assert_eq!((found.num_in_place, found.origins.len()), (1600, 0));
    assert!(found.counts().is_same() && found.touched.is_empty());
    let (_, found) = edited(Edit::Change(700, [0, 1, 2]), &same, &mut tracked);
    assert_eq!((found.num_in_place, found.origins.len()), (700, 900));
    assert_eq!(found.counts().num_kept, 1599);
}

#[test]
fn a_point_keeps_its_number_while_it_is_named_and_frees_it_for_others() {
    let mut tracked = TrackedMesh::new(&DiffParams::default()).unwrap();
    let (near, far) = (sheet(8, [0.0; 3]), sheet(8, [9.0, 0.0, 0.0]));
    let mut follow = |mesh: &TriMesh| {
        let found = tracked.follow(&Arc::new(mesh.clone())).unwrap();
        let corners = tracked.mesh().triangles().to_vec();
        (
            found.unwrap().counts(),
            corners,
            tracked.mesh().num_vertices(),
        )
    };
    let (_, both, num_vertices) = follow(&joined(&near, &far));
    assert_eq!(num_vertices, 162);
    // Half of them go: the numbers of the others stay.
    let (counts, left, num_vertices) = follow(&far);
    assert_eq!((counts.num_kept, counts.num_gone), (128, 128));
    assert_eq!((left.as_slice(), num_vertices), (&both[128..], 162));
    // Others come: they get the numbers that are free.
    let (counts, _, num_vertices) = follow(&joined(&sheet(8, [0.0, 9.0, 0.0]), &far));
    assert_eq!((counts.num_new, num_vertices), (128, 162));
    // Where most are free all are numbered anew.
    let (_, corners, num_vertices) = follow(&sheet(2, [9.0, 0.0, 0.0]));
    assert_eq!((corners[0], num_vertices), ([0, 1, 2], 9));
}

#[test]
fn what_is_off_the_grid_is_refused_and_leaves_the_mesh_as_it_was() {
    let mut tracked = TrackedMesh::new(&DiffParams::default()).unwrap();
    let given = Arc::new(sheet(3, [0.0; 3]));
    tracked.follow(&given).unwrap();
    let before = Arc::clone(tracked.mesh());
    let far = mesh(
        &[[0.0; 3], [1e13, 0.0, 0.0], [0.0, 1.0, 0.0]],
        &[[0, 1, 2], [1, 2, 0]],
    );
    for refused in [&far, &joined(&given, &far)] {
        let refused = tracked.follow(&Arc::new(refused.clone()));
        assert!(matches!(refused, Err(DiffError::OffGrid { .. })));
        assert_eq!(*tracked.mesh(), before);
    }
    check_step(&mut tracked, &given, &sheet(4, [0.0; 3]));
    assert_eq!(
        tracked.follow(&given).unwrap().unwrap().counts().num_gone,
        14
    );
    assert!(tracked.follow(&given).unwrap().is_none());
    let none = DiffParams {
        quantum_m: 0.0,
        ..DiffParams::default()
    };
    assert!(matches!(
        TrackedMesh::new(&none),
        Err(DiffError::Params { .. })
    ));
}

/// `cargo test --release --lib mesh::diff -- --ignored --nocapture`.
#[test]
#[ignore = "a measurement"]
#[expect(clippy::print_stdout, reason = "a measurement is there to be read")]
fn two_million_triangles() {
    let old = sheet(1000, [0.0; 3]);
    let new = joined(&sheet(20, [0.0, 0.0, 1.0]), &old);
    let start = std::time::Instant::now();
    let found = diff(&old, &new, &DiffParams::default()).unwrap();
    println!(
        "{:?} in {:.3} s",
        found.counts(),
        start.elapsed().as_secs_f64()
    );
    let mut tracked = TrackedMesh::new(&DiffParams::default()).unwrap();
    tracked.follow(&Arc::new(old)).unwrap();
    let grown = joined(&new, &sheet(20, [0.0, 0.0, 2.0]));
    let changed = Edit::Change(1_000_000, [0, 1, 2]).of(&grown);
    let steps = [
        ("in order", new.clone()),
        ("grown", grown),
        ("changed in the middle", changed),
        ("shuffled", shuffled(&new, 5)),
    ];
    for (order, new) in steps {
        let new = Arc::new(new);
        let start = std::time::Instant::now();
        let found = tracked.follow(&new).unwrap().unwrap();
        let seconds = start.elapsed().as_secs_f64();
        println!("followed, {order}: {:?} in {seconds:.3} s", found.counts());
    }
}
