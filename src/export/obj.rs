//! Wavefront OBJ and its materials: text that everything reads.
//!
//! Metres in the mesh's frame (z up), six decimals; texture coordinates v up, as OBJ has them,
//! seven decimals (0.0004 texel on a page of 4096). One `vt` per (vertex, uv), one material per
//! page. Vertices keep the mesh's numbering; `usemtl` groups keep its triangle order per page.

use std::io::{self, Write};

use super::decimal::{push_fixed, push_integer};
use super::split::{Sharing, split_by_page};
use super::{TexturedMesh, page_path};

/// Text is handed on in pieces of about this size.
const PIECE_BYTES: usize = 1 << 20;
/// No line written here is longer: three f64 of up to 317 characters each.
const MAX_LINE_BYTES: usize = 1024;

/// Writes the OBJ; `material_file` is the name of its MTL, in the same folder.
///
/// # Errors
/// Those of `out`.
pub fn write(
    textured: &TexturedMesh<'_>,
    material_file: &str,
    out: &mut dyn Write,
) -> io::Result<()> {
    let parts = split_by_page(textured, Sharing::ByUv);
    let mut text = Pieces::new(out);
    text.line(|line| {
        line.extend_from_slice(b"# veneer; metres, z up\nmtllib ");
        line.extend_from_slice(material_file.as_bytes());
    })?;
    for position in textured.mesh().positions_m() {
        text.line(|line| {
            line.push(b'v');
            for coordinate in [position.x, position.y, position.z] {
                line.push(b' ');
                push_fixed::<6>(line, coordinate);
            }
        })?;
    }
    for [u, v] in parts.iter().flat_map(|part| &part.uv) {
        text.line(|line| {
            line.extend_from_slice(b"vt ");
            push_fixed::<7>(line, f64::from(*u));
            line.push(b' ');
            push_fixed::<7>(line, 1.0 - f64::from(*v));
        })?;
    }
    // OBJ counts from one, over all pages.
    let mut first_uv = 1u64;
    for (page, part) in parts.iter().enumerate() {
        if !part.triangles.is_empty() {
            text.line(|line| {
                line.extend_from_slice(format!("usemtl page_{page}").as_bytes());
            })?;
        }
        for corners in &part.triangles {
            text.line(|line| {
                line.push(b'f');
                for &split in corners {
                    line.push(b' ');
                    push_integer(line, u64::from(part.vertex[split as usize]) + 1);
                    line.push(b'/');
                    push_integer(line, u64::from(split) + first_uv);
                }
            })?;
        }
        first_uv += part.uv.len() as u64;
    }
    text.flush()
}

/// Writes the MTL of an atlas of `num_pages`.
///
/// # Errors
/// Those of `out`.
pub fn write_materials(num_pages: usize, out: &mut dyn Write) -> io::Result<()> {
    for page in 0..num_pages {
        // The photographs hold the light: all of it ambient, none specular.
        write!(
            out,
            "newmtl page_{page}\nKa 1 1 1\nKd 1 1 1\nKs 0 0 0\nillum 0\nmap_Kd {}\n",
            page_path(page)
        )?;
    }
    Ok(())
}

struct Pieces<'a> {
    buffer: Vec<u8>,
    out: &'a mut dyn Write,
}

impl<'a> Pieces<'a> {
    fn new(out: &'a mut dyn Write) -> Self {
        Self {
            buffer: Vec::with_capacity(PIECE_BYTES + MAX_LINE_BYTES),
            out,
        }
    }

    fn line(&mut self, push: impl FnOnce(&mut Vec<u8>)) -> io::Result<()> {
        push(&mut self.buffer);
        self.buffer.push(b'\n');
        if self.buffer.len() >= PIECE_BYTES {
            self.flush()?;
        }
        Ok(())
    }

    fn flush(&mut self) -> io::Result<()> {
        self.out.write_all(&self.buffer)?;
        self.buffer.clear();
        Ok(())
    }
}
