//! What a run did, for a person (`report.html`) and for a program (`report.json`) (L7).
//!
//! [`Report`] holds the numbers, [`ReportView`] the pictures that only a renderer can make;
//! everything else that is shown is drawn from the mesh and its atlas. The HTML is one file that
//! opens offline: style, script (one line, for the slider) and pictures are inside; only the link
//! behind each atlas page leads to the full image beside it.

use std::io::Write;
use std::path::{Path, PathBuf};

use crate::export::{ExportError, FileError, TexturedMesh, write_atomic};
use crate::geom::{ColorImage, Stamp};

pub mod colors;
pub mod data;
pub mod eval;
mod html;
pub mod measure;
pub mod page_pictures;
pub mod pictures;
pub mod plan;
pub mod repairs;
mod sections;
mod tables;

pub use eval::{EvalMeasures, EvalMethod, EvalReport, EvalScore, EvalView, PublishedRow};
pub use repairs::{Repair, repairs};

pub use data::{
    AtlasSummary, ChartSummary, Count, CoverageSummary, DensitySummary, Drop, GainSummary,
    KeyframeRow, LossRow, MeshSummary, Note, PoseSummary, RefineSummary, Report, SeamSummary,
    Severity, SmoothSummary, SourceSummary, Stage, SyntheticScore, TopicRow, ViewScore,
};

/// Why a report could not be made.
#[derive(Debug, thiserror::Error)]
pub enum ReportError {
    /// A view's pictures differ in size, or its mask or triangles do not fit them.
    #[error(
        "view '{name}': photo {photo_width}x{photo_height}, rendering \
         {render_width}x{render_height}, {num_mask} mask values, {num_triangles} triangle ids"
    )]
    View {
        /// The view's name.
        name: String,
        /// Width of the photo.
        photo_width: u32,
        /// Height of the photo.
        photo_height: u32,
        /// Width of the rendering.
        render_width: u32,
        /// Height of the rendering.
        render_height: u32,
        /// Length of the mask.
        num_mask: usize,
        /// Length of the triangle list.
        num_triangles: usize,
    },
    /// A picture could not be encoded.
    #[error("a {width}x{height} picture of the report does not encode: {reason}")]
    Encode {
        /// Columns.
        width: u32,
        /// Rows.
        height: u32,
        /// The encoder's words.
        reason: String,
    },
    /// The numbers could not be written as JSON.
    #[error("report.json: {0}")]
    Json(#[from] serde_json::Error),
    /// A file could not be written.
    #[error(transparent)]
    File(#[from] FileError),
    /// The mesh could not be drawn.
    #[error(transparent)]
    Export(#[from] ExportError),
}

/// A photo, and the textured mesh rendered from where it was taken.
#[derive(Clone, Debug, PartialEq)]
pub struct ReportView {
    /// What to call it, such as "frame 120".
    pub name: String,
    /// When the photo was taken.
    pub stamp: Stamp,
    /// Whether the photo was kept from the texture, so that the comparison means something.
    pub held_out: bool,
    /// The photo, undistorted.
    pub photo: ColorImage,
    /// The rendering, of the same size.
    pub render: ColorImage,
    /// Per pixel: whether the mesh is there.
    pub mask: Vec<bool>,
    /// Per pixel: the triangle that is there, `u32::MAX` for none; empty when not known.
    pub triangle: Vec<u32>,
}

impl ReportView {
    /// Checks that the pictures fit each other.
    ///
    /// # Errors
    /// [`ReportError::View`] with all sizes.
    pub fn check(&self) -> Result<(), ReportError> {
        let num_pixels = self.photo.pixels().len();
        let same_size = (self.photo.width(), self.photo.height())
            == (self.render.width(), self.render.height());
        let triangles_fit = self.triangle.is_empty() || self.triangle.len() == num_pixels;
        if same_size && self.mask.len() == num_pixels && triangles_fit {
            return Ok(());
        }
        Err(ReportError::View {
            name: self.name.clone(),
            photo_width: self.photo.width(),
            photo_height: self.photo.height(),
            render_width: self.render.width(),
            render_height: self.render.height(),
            num_mask: self.mask.len(),
            num_triangles: self.triangle.len(),
        })
    }
}

/// File name of the numbers.
pub const JSON_NAME: &str = "report.json";
/// File name of the page.
pub const HTML_NAME: &str = "report.html";

/// Writes `report.json` and `report.html` into `out_dir`; without `textured` (when the run ended
/// before there was a texture) the report has no pictures of it. Returns the files' names.
///
/// # Errors
/// [`ReportError`] when a view is inconsistent or a file cannot be written.
pub fn write(
    report: &Report,
    textured: Option<&TexturedMesh<'_>>,
    views: &[ReportView],
    out_dir: &Path,
) -> Result<Vec<PathBuf>, ReportError> {
    for view in views {
        view.check()?;
    }
    let json = serde_json::to_vec_pretty(report)?;
    write_atomic(&out_dir.join(JSON_NAME), |out: &mut dyn Write| {
        out.write_all(&json)?;
        out.write_all(b"\n")
    })?;
    let page = html::render(report, textured, views)?;
    write_atomic(&out_dir.join(HTML_NAME), |out| {
        out.write_all(page.as_bytes())
    })?;
    Ok(vec![JSON_NAME.into(), HTML_NAME.into()])
}

#[cfg(test)]
mod tests;
