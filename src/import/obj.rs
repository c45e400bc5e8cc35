//! Wavefront OBJ files: the triangle mesh in them.
//!
//! Reads `v` (metres; a fourth weight or colours behind the position are walked over) and `f` with
//! corners `v`, `v/vt`, `v//vn` or `v/vt/vn`, counted from 1, or from the last vertex so far when
//! negative. Polygons are cut into a fan around their first corner; faces of fewer than three
//! corners are counted and left out. A backslash at a line's end continues it. All other
//! statements (texture coordinates, normals, materials, groups, curves) are ignored.

use nalgebra::Point3;

use super::mesh_file::Polygons;

/// Why an OBJ file was refused.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum ObjError {
    /// A `v` statement has no three numbers.
    #[error("OBJ line {line}: a vertex needs three numbers, found '{text}'")]
    Vertex {
        /// Line number from 1.
        line: usize,
        /// The statement, shortened.
        text: String,
    },
    /// A corner of an `f` statement is not an index, or names no vertex.
    #[error("OBJ line {line}: face corner '{corner}' names no vertex ({num_vertices} so far)")]
    Corner {
        /// Line number from 1.
        line: usize,
        /// The corner, shortened.
        corner: String,
        /// How many vertices precede the face.
        num_vertices: usize,
    },
    /// There is no `v` statement at all.
    #[error("the file has no OBJ vertex")]
    Empty,
}

fn shortened(bytes: &[u8]) -> String {
    String::from_utf8_lossy(&bytes[..bytes.len().min(60)]).into_owned()
}

/// The words of a statement; a backslash that ends a line is no word of its own.
fn words(statement: &[u8]) -> impl Iterator<Item = &[u8]> {
    statement
        .split(|b| b.is_ascii_whitespace() || *b == b'\\')
        .filter(|word| !word.is_empty())
}

fn parse_number<T: std::str::FromStr>(word: &[u8]) -> Option<T> {
    std::str::from_utf8(word).ok()?.parse().ok()
}

fn parse_vertex(statement: &[u8]) -> Option<Point3<f64>> {
    let mut numbers = words(statement).skip(1).map(parse_number::<f64>);
    Some(Point3::new(
        numbers.next()??,
        numbers.next()??,
        numbers.next()??,
    ))
}

/// Index from 0 of a corner such as `7/3/2` or `-1`. An index past the vertices so far is left to
/// the mesh's own check, because some writers put faces first.
fn parse_corner(corner: &[u8], num_vertices: usize) -> Option<u32> {
    let index: i64 = parse_number(corner.split(|&b| b == b'/').next()?)?;
    let from_zero = match index {
        0 => return None,
        1.. => index - 1,
        _ => i64::try_from(num_vertices).ok()?.checked_add(index)?,
    };
    u32::try_from(from_zero).ok()
}

/// Statements with the number of their first line; continued lines are joined.
fn statements(bytes: &[u8]) -> impl Iterator<Item = (usize, &[u8])> {
    let mut rest = bytes;
    let mut next_line = 1;
    std::iter::from_fn(move || {
        if rest.is_empty() {
            return None;
        }
        let line = next_line;
        let mut end = 0;
        loop {
            let line_end = rest[end..]
                .iter()
                .position(|&b| b == b'\n')
                .map_or(rest.len(), |at| end + at);
            next_line += 1;
            end = (line_end + 1).min(rest.len());
            let is_continued = rest[..line_end].trim_ascii_end().ends_with(b"\\");
            if !is_continued || end == rest.len() {
                break;
            }
        }
        let (statement, tail) = rest.split_at(end);
        rest = tail;
        Some((line, statement.trim_ascii()))
    })
}

/// The polygons of an OBJ file.
///
/// # Errors
/// [`ObjError`] when a vertex or face statement cannot be read, or there are none.
pub fn parse(bytes: &[u8]) -> Result<Polygons, ObjError> {
    let mut polygons = Polygons::default();
    let mut corners = Vec::new();
    for (line, statement) in statements(bytes) {
        match words(statement).next() {
            Some(b"v") => {
                let position_m = parse_vertex(statement).ok_or_else(|| ObjError::Vertex {
                    line,
                    text: shortened(statement),
                })?;
                polygons.positions_m.push(position_m);
            }
            Some(b"f") => {
                let num_vertices = polygons.positions_m.len();
                corners.clear();
                for corner in words(statement).skip(1) {
                    if corner.starts_with(b"#") {
                        break;
                    }
                    let index = parse_corner(corner, num_vertices);
                    corners.push(index.ok_or_else(|| ObjError::Corner {
                        line,
                        corner: shortened(corner),
                        num_vertices,
                    })?);
                }
                polygons.push(&corners);
            }
            _ => {}
        }
    }
    if polygons.positions_m.is_empty() {
        return Err(ObjError::Empty);
    }
    Ok(polygons)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    const SAMPLE: &[u8] = b"# caf\xe9\nmtllib a.mtl\r\no room\nv 0 0 0\r\nv 1 0 0 1.0\n\
        v 1 1 0 0.5 0.5 0.5\nvt 0 0\nvn 0 0 1\nv 0 1 -2.5e-1\nusemtl m\ns off\n\
        f 1 2 3\nf 1/1 3/1 4/1 # no corner\nf 1/1/1 2/1/1 3/1/1 4/1/1\nf -4//1 -3//1 \\\n -1//1\nf 1 2\n";

    #[test]
    fn reads_every_form_of_corner() {
        let polygons = parse(SAMPLE).unwrap();
        assert_eq!(polygons.positions_m.len(), 4);
        assert_eq!(polygons.positions_m[3], Point3::new(0.0, 1.0, -0.25));
        assert_eq!(
            polygons.triangles,
            vec![[0, 1, 2], [0, 2, 3], [0, 1, 2], [0, 2, 3], [0, 1, 3]]
        );
        assert_eq!(polygons.num_cut_polygons, 1);
        assert_eq!(polygons.num_incomplete_faces, 1);
    }

    #[test]
    fn a_bad_statement_is_named_by_its_line() {
        assert_eq!(
            parse(b"v 0 0 0\n\nf 1 0 1\n").unwrap_err(),
            ObjError::Corner {
                line: 3,
                corner: "0".to_owned(),
                num_vertices: 1
            }
        );
        assert!(matches!(
            parse(b"v 0 0 0\nf 1 -2 1\n"),
            Err(ObjError::Corner { line: 2, .. })
        ));
        assert!(matches!(
            parse(b"v 1 2\n"),
            Err(ObjError::Vertex { line: 1, .. })
        ));
        assert_eq!(parse(b"# empty\n").unwrap_err(), ObjError::Empty);
        // Past the last vertex: the mesh's own check refuses it.
        assert!(parse(b"v 0 0 0\nf 1 1 2\n").unwrap().into_mesh().is_err());
    }

    proptest! {
        #![proptest_config(ProptestConfig { cases: 400, ..ProptestConfig::default() })]
        #[test]
        fn mutated_files_never_panic(
            edits in prop::collection::vec((any::<prop::sample::Index>(), any::<u8>(), 0..3u8), 1..12),
        ) {
            let mut file = SAMPLE.to_vec();
            for (at, byte, kind) in edits {
                let at = at.index(file.len());
                match kind {
                    0 => file[at] = byte,
                    1 => file.insert(at, byte),
                    _ => { file.remove(at); }
                }
            }
            if let Ok(polygons) = parse(&file) {
                drop(polygons.into_mesh());
            }
        }
    }
}
