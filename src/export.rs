//! Mesh and atlas → files that any viewer opens: GLB, OBJ, PLY, and where each texel came from
//! (L7).
//!
//! What [`write_all`] leaves in its folder (names as [`ExportParams`] says):
//!
//! | file | what |
//! |---|---|
//! | `scan.glb` | glTF 2.0 in one file: one primitive and one image per page |
//! | `scan.obj`, `scan.mtl` | text, refers to `atlas/page_K.png` |
//! | `scan.ply` | binary, coordinates per face corner, colours per vertex, refers to the same |
//! | `atlas/page_K.png` | the pages, sRGB |
//! | `provenance/` | which frame painted each texel, and how far to trust it |
//!
//! Positions are metres in the frame of the mesh, z up as in ROS (REP-103); the GLB turns to
//! glTF's y up in its root node. Every file appears under its name only when it is complete. The
//! bytes depend on the input only: not on the thread count, the clock or the machine's name.

use std::path::{Path, PathBuf};

use rayon::prelude::*;

use crate::atlas::{AtlasLayout, AtlasTexture};
use crate::mesh::{TriMesh, TriangleId};

pub mod atomic;
mod decimal;
pub mod glb;
#[cfg(feature = "bag")]
pub mod hashes;
pub mod normals;
pub mod obj;
pub mod pages;
pub mod ply;
pub mod provenance;
pub mod split;

pub use atomic::{FileError, write_atomic};
pub use normals::NormalMode;
pub use pages::{EncodedPages, PageFormat};

/// Why an export failed.
#[derive(Debug, thiserror::Error)]
pub enum ExportError {
    /// Mesh, layout and texture do not belong together.
    #[error("{what}: the mesh or layout asks for {expected}, there are {actual}")]
    Mismatch {
        /// What is counted.
        what: &'static str,
        /// How many there should be.
        expected: usize,
        /// How many there are.
        actual: usize,
    },
    /// A chart or page index points nowhere.
    #[error("triangle {triangle} lies on {what} {index}, but there are {count}")]
    DanglingIndex {
        /// Which triangle.
        triangle: usize,
        /// `chart` or `page`.
        what: &'static str,
        /// The index as given.
        index: usize,
        /// How many there are.
        count: usize,
    },
    /// A triangle lies outside its page, or nowhere.
    #[error(
        "triangle {triangle} has a corner at texel ({x}, {y}), outside its {width}x{height} page"
    )]
    OutsidePage {
        /// Which triangle.
        triangle: usize,
        /// Column.
        x: f32,
        /// Row.
        y: f32,
        /// Page width in texels.
        width: u32,
        /// Page height in texels.
        height: u32,
    },
    /// An image encoder refused a page.
    #[error("page {page} of {width}x{height} texels does not encode as {format}: {reason}")]
    Encode {
        /// Which page.
        page: usize,
        /// Columns.
        width: u32,
        /// Rows.
        height: u32,
        /// `png` or `jpeg`.
        format: &'static str,
        /// The encoder's words.
        reason: String,
    },
    /// A file could not be written.
    #[error(transparent)]
    File(#[from] FileError),
}

/// A mesh, the place of each of its triangles in the atlas, and the atlas: consistent by
/// construction.
#[derive(Clone, Copy, Debug)]
pub struct TexturedMesh<'a> {
    mesh: &'a TriMesh,
    layout: &'a AtlasLayout,
    texture: &'a AtlasTexture,
}

impl<'a> TexturedMesh<'a> {
    /// Checks that the three belong together: equal counts, pages of the layout's size, and every
    /// corner within its page.
    ///
    /// # Errors
    /// [`ExportError`] with the first disagreement.
    pub fn new(
        mesh: &'a TriMesh,
        layout: &'a AtlasLayout,
        texture: &'a AtlasTexture,
    ) -> Result<Self, ExportError> {
        let textured = Self::vouched(mesh, layout, texture)?;
        check_triangles(layout)?;
        Ok(textured)
    }

    /// The same without a look at each triangle, from someone who keeps the three together: only pages and
    /// counts are compared.
    ///
    /// # Errors
    /// [`ExportError`] with the first disagreement.
    pub(crate) fn vouched(
        mesh: &'a TriMesh,
        layout: &'a AtlasLayout,
        texture: &'a AtlasTexture,
    ) -> Result<Self, ExportError> {
        check_pages(layout, texture)?;
        check_counts(mesh, layout)?;
        Ok(Self {
            mesh,
            layout,
            texture,
        })
    }

    /// The mesh.
    pub fn mesh(&self) -> &'a TriMesh {
        self.mesh
    }

    /// Where its triangles lie.
    pub fn layout(&self) -> &'a AtlasLayout {
        self.layout
    }

    /// The pages.
    pub fn texture(&self) -> &'a AtlasTexture {
        self.texture
    }

    /// The corners of a triangle in [0, 1] of its page, v down; never outside.
    pub fn corners_uv(&self, triangle: TriangleId) -> [[f32; 2]; 3] {
        // Adding 0.0 turns -0.0 into 0.0, so that equal coordinates have equal bits.
        self.layout
            .corners_uv(triangle)
            .map(|uv| uv.map(|c| c.clamp(0.0, 1.0) + 0.0))
    }

    /// The texel that holds each corner of a triangle.
    #[expect(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "corners lie within the page, and the casts saturate"
    )]
    pub fn corner_texels(&self, triangle: TriangleId) -> [[u32; 2]; 3] {
        let [width, height] = self.layout.page_size_texel;
        self.layout.corners_texel[triangle.index()]
            .map(|[x, y]| [(x as u32).min(width - 1), (y as u32).min(height - 1)])
    }
}

fn check_pages(layout: &AtlasLayout, texture: &AtlasTexture) -> Result<(), ExportError> {
    let mismatch = |what, expected, actual| ExportError::Mismatch {
        what,
        expected,
        actual,
    };
    let num_pages = layout.num_pages as usize;
    if texture.pages.len() != num_pages {
        return Err(mismatch("texture pages", num_pages, texture.pages.len()));
    }
    let [width, height] = layout.page_size_texel;
    if num_pages > 0 && (width == 0 || height == 0) {
        return Err(mismatch("texels on a page side", 1, 0));
    }
    let num_texels = width as usize * height as usize;
    for page in &texture.pages {
        let checks = [
            ("columns of a page", width as usize, page.width as usize),
            ("rows of a page", height as usize, page.height as usize),
            ("colours of a page", num_texels, page.srgb.len()),
            ("sources of a page", num_texels, page.source.len()),
            ("confidences of a page", num_texels, page.confidence.len()),
        ];
        for (what, expected, actual) in checks {
            if expected != actual {
                return Err(mismatch(what, expected, actual));
            }
        }
    }
    Ok(())
}

fn check_counts(mesh: &TriMesh, layout: &AtlasLayout) -> Result<(), ExportError> {
    let num_triangles = mesh.num_triangles();
    for (what, actual) in [
        ("charts of triangles", layout.chart_of_triangle.len()),
        ("corners of triangles", layout.corners_texel.len()),
    ] {
        if actual != num_triangles {
            return Err(ExportError::Mismatch {
                what,
                expected: num_triangles,
                actual,
            });
        }
    }
    Ok(())
}

/// Checks where each triangle lies.
fn check_triangles(layout: &AtlasLayout) -> Result<(), ExportError> {
    let [width, height] = layout.page_size_texel;
    let dangling = |triangle, what, index, count| ExportError::DanglingIndex {
        triangle,
        what,
        index,
        count,
    };
    for (triangle, chart) in layout.chart_of_triangle.iter().enumerate() {
        let placed = layout
            .charts
            .get(chart.index())
            .ok_or_else(|| dangling(triangle, "chart", chart.index(), layout.charts.len()))?;
        if placed.page >= layout.num_pages {
            let (page, count) = (placed.page as usize, layout.num_pages as usize);
            return Err(dangling(triangle, "page", page, count));
        }
        for [x, y] in layout.corners_texel[triangle] {
            let inside = (0.0..=width as f32).contains(&x) && (0.0..=height as f32).contains(&y);
            if !inside {
                return Err(ExportError::OutsidePage {
                    triangle,
                    x,
                    y,
                    width,
                    height,
                });
            }
        }
    }
    Ok(())
}

/// What [`write_all`] writes.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ExportParams {
    /// Stem of the mesh files' names.
    pub name: String,
    /// How the GLB carries its pages; `atlas/`, OBJ and PLY use PNG always.
    pub glb_pages: PageFormat,
    /// Normals in the GLB.
    pub normals: NormalMode,
    /// Whether to write the GLB.
    pub glb: bool,
    /// Whether to write OBJ and MTL.
    pub obj: bool,
    /// Whether to write the PLY.
    pub ply: bool,
    /// Whether to write `provenance/`.
    pub provenance: bool,
}

impl Default for ExportParams {
    fn default() -> Self {
        Self {
            name: "scan".to_owned(),
            glb_pages: PageFormat::Png,
            normals: NormalMode::Smooth,
            glb: true,
            obj: true,
            ply: true,
            provenance: true,
        }
    }
}

/// What was written.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct ExportSummary {
    /// Every file, relative to the output folder, in a fixed order.
    pub files: Vec<PathBuf>,
    /// Sentences about what a reader of the files should know.
    pub notes: Vec<String>,
}

/// Path of a page relative to the output folder, with `/` as files refer to it.
pub fn page_path(page: usize) -> String {
    format!("atlas/page_{page}.png")
}

type Job<'a> = Box<dyn Fn() -> Result<PathBuf, ExportError> + Send + Sync + 'a>;

/// Writes everything that `params` asks for into `out_dir`, which is made if it is not there.
/// Pages are encoded once; files are written in parallel.
///
/// # Errors
/// [`ExportError`] of the first file (in the order of [`ExportSummary::files`]) that failed;
/// files that were complete stay, an incomplete one never appears.
pub fn write_all(
    textured: &TexturedMesh<'_>,
    out_dir: &Path,
    params: &ExportParams,
) -> Result<ExportSummary, ExportError> {
    let pages = EncodedPages::encode(textured.texture(), PageFormat::Png)?;
    write_all_with_pages(textured, &pages, out_dir, params)
}

/// [`write_all`] with pages that the caller has encoded as PNG already.
///
/// # Errors
/// As [`write_all`].
pub fn write_all_with_pages(
    textured: &TexturedMesh<'_>,
    pages: &EncodedPages,
    out_dir: &Path,
    params: &ExportParams,
) -> Result<ExportSummary, ExportError> {
    let glb_pages = match params.glb_pages {
        PageFormat::Png => None,
        jpeg @ PageFormat::Jpeg { .. } if params.glb => {
            Some(EncodedPages::encode(textured.texture(), jpeg)?)
        }
        PageFormat::Jpeg { .. } => None,
    };
    let mut jobs: Vec<Job<'_>> = Vec::new();
    push_mesh_jobs(
        &mut jobs,
        textured,
        glb_pages.as_ref().unwrap_or(pages),
        out_dir,
        params,
    );
    for (page, encoded) in pages.pages().iter().enumerate() {
        let path = PathBuf::from(page_path(page));
        jobs.push(Box::new(move || {
            write_atomic(&out_dir.join(&path), |out| out.write_all(encoded))?;
            Ok(path.clone())
        }));
    }
    if params.provenance {
        provenance::push_jobs(&mut jobs, textured.texture(), out_dir);
    }
    let files: Vec<Result<PathBuf, ExportError>> = jobs.par_iter().map(|job| job()).collect();
    let notes = if params.provenance {
        provenance::notes(textured.texture())
    } else {
        Vec::new()
    };
    Ok(ExportSummary {
        files: files.into_iter().collect::<Result<_, _>>()?,
        notes,
    })
}

fn push_mesh_jobs<'a>(
    jobs: &mut Vec<Job<'a>>,
    textured: &'a TexturedMesh<'a>,
    glb_pages: &'a EncodedPages,
    out_dir: &'a Path,
    params: &'a ExportParams,
) {
    let file = |ending: &str| PathBuf::from(format!("{}.{ending}", params.name));
    if params.glb {
        let path = file("glb");
        jobs.push(Box::new(move || {
            write_atomic(&out_dir.join(&path), |out| {
                glb::write(textured, glb_pages, &params.name, params.normals, out)
            })?;
            Ok(path.clone())
        }));
    }
    if params.obj {
        let (obj_path, mtl_path) = (file("obj"), file("mtl"));
        let mtl_name = mtl_path.display().to_string();
        jobs.push(Box::new(move || {
            write_atomic(&out_dir.join(&obj_path), |out| {
                obj::write(textured, &mtl_name, out)
            })?;
            Ok(obj_path.clone())
        }));
        jobs.push(Box::new(move || {
            write_atomic(&out_dir.join(&mtl_path), |out| {
                obj::write_materials(textured.layout().num_pages as usize, out)
            })?;
            Ok(mtl_path.clone())
        }));
    }
    if params.ply {
        let path = file("ply");
        jobs.push(Box::new(move || {
            write_atomic(&out_dir.join(&path), |out| ply::write(textured, out))?;
            Ok(path.clone())
        }));
    }
}

#[cfg(test)]
mod tests;
