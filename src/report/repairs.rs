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
        max_faces_on_edge,
        num_unpaired_faces,
        num_orientation_cuts,
        num_merged_vertices,
        num_split_vertices,
        num_duplicated_vertices,
        num_isolated_vertices,
        num_reversed_triangles,
        num_duplicate_triangles,
        num_opposite_triangles,
        num_collapsed_triangles,
        num_zero_area_triangles,
        num_components,
        num_single_triangle_components,
    } = *manifold;
    let rows = [
        (
            "edges of three or more faces",
            num_non_manifold_edges,
            "the flattest pairs stay joined, the rest is cut there",
        ),
        (
            "the most faces on one edge (two where all is well)",
            max_faces_on_edge,
            "",
        ),
        (
            "faces on edges of three or more that find no partner there",
            num_unpaired_faces,
            "the edge is a border to them",
        ),
        (
            "edges where inside meets outside (as on a Möbius strip)",
            num_orientation_cuts,
            "cut",
        ),
        (
            "vertices at the place of an earlier one",
            num_merged_vertices,
            "count as one for the charts; kept as they are in the mesh",
        ),
        (
            "vertices whose faces form more than one fan",
            num_split_vertices,
            "one copy per fan",
        ),
        (
            "copies of vertices made for that",
            num_duplicated_vertices,
            "",
        ),
        (
            "vertices that no triangle uses",
            num_isolated_vertices,
            "kept in the mesh, nothing to texture",
        ),
        (
            "triangles that face against their neighbours",
            num_reversed_triangles,
            "turned round for the charts, mirrored there; kept as they are in the mesh",
        ),
        (
            "triangles on the corners of an earlier one, the same way round",
            num_duplicate_triangles,
            "kept, each with texels of its own",
        ),
        (
            "triangles on the corners of an earlier one, the other way round",
            num_opposite_triangles,
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
        ("connected pieces after the repair", num_components, ""),
        (
            "pieces of a single triangle",
            num_single_triangle_components,
            "kept, a chart each",
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
            ("the most faces on one edge (two where all is well)", 3),
            (
                "faces on edges of three or more that find no partner there",
                1,
            ),
            ("vertices whose faces form more than one fan", 2),
            ("copies of vertices made for that", 2),
            ("connected pieces after the repair", 2),
            ("pieces of a single triangle", 1),
        ];
        assert_eq!(found, expected);
    }
}
