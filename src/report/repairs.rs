//! What was wrong with the mesh, and what was done about it, in words.

use serde::Serialize;

use crate::mesh::ManifoldReport;

/// One kind of fault. No fault costs a triangle.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize)]
pub struct Repair {
    /// What was found.
    pub found: String,
    /// How many.
    pub count: usize,
    /// What was done.
    pub done: String,
}

/// A row for every kind of fault, found or not.
pub fn repairs(manifold: &ManifoldReport) -> Vec<Repair> {
    // All fields by name: a new one must find its row.
    let ManifoldReport {
        num_edges: _,
        num_boundary_edges: _,
        num_non_manifold_edges,
        num_orientation_cuts,
        num_duplicated_vertices,
        num_reversed_triangles,
        num_duplicate_triangles,
        num_collapsed_triangles,
        num_zero_area_triangles,
    } = *manifold;
    let rows = [
        (
            "edges of three or more faces",
            num_non_manifold_edges,
            "the flattest pairs stay joined, the rest is cut there",
        ),
        (
            "edges where inside meets outside (as on a Möbius strip)",
            num_orientation_cuts,
            "cut",
        ),
        (
            "extra vertices where faces meet in more than one fan",
            num_duplicated_vertices,
            "one copy per fan",
        ),
        (
            "triangles that face against their neighbours",
            num_reversed_triangles,
            "turned round for the charts, mirrored there; kept as they are in the mesh",
        ),
        (
            "triangles on the same corners as another, either way round",
            num_duplicate_triangles,
            "kept, each with texels of its own",
        ),
        (
            "triangles with two corners at one place",
            num_collapsed_triangles,
            "kept, laid along the edge of a neighbour or on a texel of their own",
        ),
        (
            "other triangles without area",
            num_zero_area_triangles,
            "kept, on a texel of their own where their chart gives them none",
        ),
    ];
    rows.map(|(found, count, done)| Repair {
        found: found.to_owned(),
        count,
        done: done.to_owned(),
    })
    .to_vec()
}

#[cfg(test)]
mod tests {
    use nalgebra::Point3;

    use super::*;
    use crate::mesh::{Manifold, TriMesh};

    #[test]
    fn three_pages_on_one_edge_are_one_repair() {
        let positions = [[0, 0, 0], [0, 0, 1], [1, 0, 0], [-1, 1, 0], [-1, -1, 0]];
        let positions = positions.map(|p| Point3::from(p.map(f64::from))).to_vec();
        let triangles = vec![[0, 1, 2], [1, 0, 3], [0, 1, 4]];
        let (mesh, _) = TriMesh::from_soup(positions, triangles).unwrap();
        let rows = repairs(Manifold::new(&mesh).unwrap().report());
        let found: Vec<_> = rows
            .iter()
            .filter(|row| row.count > 0)
            .map(|row| (row.found.as_str(), row.count))
            .collect();
        let expected = [
            ("edges of three or more faces", 1),
            ("extra vertices where faces meet in more than one fan", 2),
        ];
        assert_eq!(found, expected);
    }
}
