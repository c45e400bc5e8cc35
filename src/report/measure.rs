//! Numbers that follow from the mesh, its atlas and the views alone.

use std::collections::BTreeMap;

use nalgebra::Vector3;
use rayon::prelude::*;

use crate::atlas::{DensitySpread, PlacedChart, SharedPage, TexelSource};
use crate::export::TexturedMesh;
use crate::mesh::{TriMesh, TriangleId};
use crate::metrics::{PixelError, SsimChannels, ssim};

use super::data::{
    AtlasSummary, ChartSummary, CoverageSummary, DensitySummary, MeshSummary, Note, Report,
    Severity, ViewScore,
};
use super::{ReportError, ReportView};

/// Texels of one source, and the sum of their confidences.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
struct Tally {
    num_texels: u64,
    sum_confidence: u64,
}

/// Texels by source; the sums are exact, so their order does not matter.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct SourceTally {
    by_source: BTreeMap<TexelSource, Tally>,
}

impl SourceTally {
    /// Counts every texel of every page.
    pub fn of(pages: &[SharedPage]) -> Self {
        let mut tally = Self::default();
        for page in pages {
            let width = (page.width as usize).max(1);
            let rows: Vec<Vec<(TexelSource, Tally)>> = page
                .source
                .par_chunks(width)
                .zip(page.confidence.par_chunks(width))
                .map(|(sources, confidences)| tally_row(sources, confidences))
                .collect();
            for (source, row) in rows.into_iter().flatten() {
                let total = tally.by_source.entry(source).or_default();
                total.num_texels += row.num_texels;
                total.sum_confidence += row.sum_confidence;
            }
        }
        tally
    }

    fn get(&self, source: TexelSource) -> Tally {
        self.by_source.get(&source).copied().unwrap_or_default()
    }

    /// Texels that were painted from each keyframe.
    pub fn texels_of_keyframes(&self) -> BTreeMap<u32, u64> {
        self.by_source
            .iter()
            .filter_map(|(source, tally)| Some((source.as_keyframe()?, tally.num_texels)))
            .collect()
    }

    fn all_keyframes(&self) -> Tally {
        let mut total = Tally::default();
        for (_, tally) in self
            .by_source
            .iter()
            .filter(|(s, _)| s.as_keyframe().is_some())
        {
            total.num_texels += tally.num_texels;
            total.sum_confidence += tally.sum_confidence;
        }
        total
    }
}

/// Neighbours mostly have one source: runs keep the map out of the inner loop.
fn tally_row(sources: &[TexelSource], confidences: &[u8]) -> Vec<(TexelSource, Tally)> {
    let mut runs = Vec::new();
    let mut start = 0;
    for run in sources.chunk_by(|a, b| a == b) {
        let confidence = &confidences[start..start + run.len()];
        let tally = Tally {
            num_texels: run.len() as u64,
            sum_confidence: confidence.iter().map(|&c| u64::from(c)).sum(),
        };
        runs.push((run[0], tally));
        start += run.len();
    }
    runs
}

impl Report {
    /// Fills in what follows from the result: mesh, charts (their distortion excepted), atlas,
    /// coverage, each keyframe's texels, the views' scores, and notes on what these say.
    ///
    /// # Errors
    /// [`ReportError::View`] for a view whose pictures do not fit each other.
    pub fn measure(
        &mut self,
        textured: &TexturedMesh<'_>,
        views: &[ReportView],
    ) -> Result<(), ReportError> {
        let tally = SourceTally::of(&textured.texture().pages);
        let details = std::mem::take(&mut self.mesh.details);
        let repairs = std::mem::take(&mut self.mesh.repairs);
        self.mesh = MeshSummary {
            details,
            repairs,
            ..mesh_summary(textured.mesh())
        };
        fill_chart_sizes(&mut self.charts, textured);
        self.atlas = atlas_summary(textured, &tally);
        self.coverage = coverage_summary(textured, &tally);
        let texels = tally.texels_of_keyframes();
        for keyframe in &mut self.keyframes {
            keyframe.num_texels = texels.get(&keyframe.id).copied().unwrap_or(0);
        }
        self.views = views.iter().map(score).collect::<Result<_, _>>()?;
        let notes = notes_on(self);
        self.notes.extend(notes);
        Ok(())
    }
}

fn mesh_summary(mesh: &TriMesh) -> MeshSummary {
    let mut min = Vector3::repeat(f64::INFINITY);
    let mut max = Vector3::repeat(f64::NEG_INFINITY);
    let mut area_m2 = 0.0;
    for triangle in mesh.triangle_ids() {
        area_m2 += mesh.area_m2(triangle);
        for corner in mesh.corners_m(triangle) {
            min = min.inf(&corner.coords);
            max = max.sup(&corner.coords);
        }
    }
    let size_m = if mesh.num_triangles() == 0 {
        [0.0; 3]
    } else {
        (max - min).into()
    };
    MeshSummary {
        num_vertices: mesh.num_vertices(),
        num_triangles: mesh.num_triangles(),
        area_m2,
        size_m,
        ..MeshSummary::default()
    }
}

fn fill_chart_sizes(charts: &mut ChartSummary, textured: &TexturedMesh<'_>) {
    let mut sizes = vec![0usize; textured.layout().charts.len()];
    for chart in &textured.layout().chart_of_triangle {
        sizes[chart.index()] += 1;
    }
    sizes.sort_unstable();
    charts.num_charts = sizes.len();
    charts.median_triangles = sizes.get(sizes.len() / 2).copied().unwrap_or(0);
    charts.max_triangles = sizes.last().copied().unwrap_or(0);
}

fn share(part: u64, whole: u64) -> f64 {
    if whole == 0 {
        0.0
    } else {
        part as f64 / whole as f64
    }
}

fn atlas_summary(textured: &TexturedMesh<'_>, tally: &SourceTally) -> AtlasSummary {
    let layout = textured.layout();
    let [width, height] = layout.page_size_texel.map(u64::from);
    let num_texels = width * height * u64::from(layout.num_pages);
    let num_in_charts = layout
        .charts
        .iter()
        .flat_map(PlacedChart::own_spans)
        .map(|(_, _, len)| u64::from(len))
        .sum();
    let spread = DensitySpread::of(textured.mesh(), layout);
    AtlasSummary {
        num_pages: layout.num_pages as usize,
        page_size_texel: layout.page_size_texel,
        texels_per_m: layout.texels_per_m,
        used_share: share(num_covered(tally), num_texels),
        gutter_share: share(tally.get(TexelSource::GUTTER).num_texels, num_texels),
        footprint_share: share(num_in_charts, num_texels),
        texels_per_m2_by_triangle: spread.texels_per_m2_by_triangle,
        texels_per_m2_by_area: spread.texels_per_m2_by_area,
        subtexel_share: spread.subtexel_share,
    }
}

fn num_covered(tally: &SourceTally) -> u64 {
    tally.all_keyframes().num_texels
        + tally.get(TexelSource::MEAN).num_texels
        + tally.get(TexelSource::DIFFUSED).num_texels
}

fn coverage_summary(textured: &TexturedMesh<'_>, tally: &SourceTally) -> CoverageSummary {
    let sources = [
        tally.all_keyframes(),
        tally.get(TexelSource::MEAN),
        tally.get(TexelSource::DIFFUSED),
    ];
    let num_texels: u64 = sources.iter().map(|s| s.num_texels).sum();
    let sum_confidence: u64 = sources.iter().map(|s| s.sum_confidence).sum();
    let [keyframe_share, mean_share, diffused_share] =
        sources.map(|s| share(s.num_texels, num_texels));
    let mesh = textured.mesh();
    let (mut area_m2, mut unpainted_m2) = (0.0, 0.0);
    for triangle in mesh.triangle_ids() {
        let triangle_m2 = mesh.area_m2(triangle);
        area_m2 += triangle_m2;
        if !is_painted(textured, triangle) {
            unpainted_m2 += triangle_m2;
        }
    }
    CoverageSummary {
        num_texels,
        keyframe_share,
        mean_share,
        diffused_share,
        unpainted_area_share: if area_m2 > 0.0 {
            unpainted_m2 / area_m2
        } else {
            0.0
        },
        mean_confidence: share(sum_confidence, num_texels) / 255.0,
    }
}

/// The texel that holds a triangle's middle, as an index into its page.
#[expect(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "corners lie within the page, and the casts saturate"
)]
pub fn middle_texel(textured: &TexturedMesh<'_>, triangle: TriangleId) -> [u32; 2] {
    let corners = textured.layout().corners_texel[triangle.index()];
    let size = textured.layout().page_size_texel;
    std::array::from_fn(|axis| {
        let middle = (corners[0][axis] + corners[1][axis] + corners[2][axis]) / 3.0;
        (middle as u32).min(size[axis] - 1)
    })
}

/// Whether one of the 3×3 texels about the middle was painted: a triangle below a texel's size
/// covers no texel centre of its own.
fn is_painted(textured: &TexturedMesh<'_>, triangle: TriangleId) -> bool {
    let page = &textured.texture().pages[textured.layout().page_of(triangle) as usize];
    let [x, y] = middle_texel(textured, triangle);
    let columns = x.saturating_sub(1)..=(x + 1).min(page.width - 1);
    (y.saturating_sub(1)..=(y + 1).min(page.height - 1)).any(|y| {
        columns.clone().any(|x| {
            page.source[y as usize * page.width as usize + x as usize] != TexelSource::NONE
        })
    })
}

impl DensitySummary {
    /// From the best view's pixels per metre of each triangle (0 or NaN where none sees it);
    /// `None` when nothing was seen.
    pub fn from_best_views(mesh: &TriMesh, best_px_per_m: &[f32]) -> Option<Self> {
        let mut seen: Vec<(f64, f64)> = mesh
            .triangle_ids()
            .zip(best_px_per_m)
            .filter(|(_, density)| density.is_finite() && **density > 0.0)
            .map(|(triangle, &density)| (f64::from(density), mesh.area_m2(triangle)))
            .collect();
        seen.sort_by(|a, b| a.0.total_cmp(&b.0));
        let total_m2: f64 = seen.iter().map(|(_, area_m2)| area_m2).sum();
        let at = |wanted: f64| {
            let mut sum_m2 = 0.0;
            seen.iter()
                .find(|(_, area_m2)| {
                    sum_m2 += area_m2;
                    sum_m2 >= wanted * total_m2
                })
                .or(seen.last())
                .map(|(density, _)| *density)
        };
        Some(Self {
            p10_px_per_m: at(0.1)?,
            p50_px_per_m: at(0.5)?,
            p90_px_per_m: at(0.9)?,
        })
    }
}

fn score(view: &ReportView) -> Result<ViewScore, ReportError> {
    view.check()?;
    // Sizes and mask fit, which is all that the metrics refuse.
    let error = PixelError::between(&view.photo, &view.render, Some(&view.mask)).ok();
    let similarity = ssim(
        &view.photo,
        &view.render,
        Some(&view.mask),
        SsimChannels::Rgb,
    );
    let num_covered = view.mask.iter().filter(|covered| **covered).count() as u64;
    Ok(ViewScore {
        name: view.name.clone(),
        stamp_ns: view.stamp.as_nanos(),
        held_out: view.held_out,
        psnr_db: error.and_then(|e| e.psnr_db()).filter(|db| db.is_finite()),
        ssim: similarity.ok().flatten(),
        mean_abs: error.and_then(|e| e.mean_abs()),
        covered_share: share(num_covered, view.mask.len() as u64),
    })
}

/// Shares beyond which a note is due.
const MUCH_DIFFUSED: f64 = 0.15;
const SOME_UNPAINTED: f64 = 0.001;
const COARSE_ATLAS: f64 = 0.7;

fn notes_on(report: &Report) -> Vec<Note> {
    let mut notes = Vec::new();
    let mut add = |severity, text| notes.push(Note { severity, text });
    let coverage = &report.coverage;
    if coverage.num_texels == 0 {
        add(
            Severity::Problem,
            "No texel was painted: no keyframe sees the mesh. Check that poses and mesh are in \
             the same frame, and that their times overlap."
                .to_owned(),
        );
    } else if coverage.keyframe_share + coverage.mean_share == 0.0 {
        add(
            Severity::Problem,
            "No keyframe sees the mesh; every colour is a guess.".to_owned(),
        );
    } else if coverage.diffused_share > MUCH_DIFFUSED {
        add(
            Severity::Warning,
            format!(
                "{:.0} % of the surface was seen by no keyframe; its colour is spread from \
                 neighbours (orange in the coverage picture). Scanning there again fills it.",
                coverage.diffused_share * 100.0
            ),
        );
    }
    if coverage.num_texels > 0 && coverage.unpainted_area_share > SOME_UNPAINTED {
        add(
            Severity::Warning,
            format!(
                "{:.1} % of the surface has no colour at all.",
                coverage.unpainted_area_share * 100.0
            ),
        );
    }
    if let Some(density) = &report.density
        && report.atlas.texels_per_m < COARSE_ATLAS * density.p50_px_per_m
    {
        add(
            Severity::Info,
            format!(
                "The photos resolve {:.0} pixels per metre on half of the surface, the atlas {:.0} \
                 texels: more pages or a larger memory budget would show more.",
                density.p50_px_per_m, report.atlas.texels_per_m
            ),
        );
    }
    for loss in &report.source.losses {
        add(Severity::Problem, loss.clone());
    }
    notes
}
