//! Which cells of which page each chart has, and where each triangle lies in them.

use super::cells::CellMask;
use crate::mesh::TriangleId;

/// Index of a chart in its [`AtlasLayout`].
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct ChartId(pub u32);

impl ChartId {
    /// For indexing a slice.
    pub const fn index(self) -> usize {
        self.0 as usize
    }
}

/// A rectangle of whole texels on a page.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct TexelRect {
    /// Left column.
    pub x: u32,
    /// Top row.
    pub y: u32,
    /// Columns.
    pub width: u32,
    /// Rows.
    pub height: u32,
}

/// A chart and the texels that are its own, gutter included.
///
/// Ownership goes by cells: the chart's rectangle is divided evenly into the columns and rows of
/// [`Self::cells`], and the chart owns the texels of the cells in that set. No texel is owned by two
/// charts, but rectangles may overlap: a small chart may lie in a hole or a bay of a large one. Who
/// writes texels for a chart keeps to those it owns.
#[derive(Clone, Debug, PartialEq)]
pub struct PlacedChart {
    /// Which page.
    pub page: u32,
    /// The smallest rectangle of whole cells around its own texels.
    pub rect: TexelRect,
    /// Which cells of the rectangle are its own.
    pub cells: CellMask,
    /// Texels per metre of its surface; where charts are drawn to different scales, not all have the
    /// layout's.
    pub texels_per_m: f64,
    /// Its triangles.
    pub triangles: Vec<TriangleId>,
}

impl PlacedChart {
    /// A chart that owns a whole rectangle.
    pub fn whole_rect(
        page: u32,
        rect: TexelRect,
        texels_per_m: f64,
        triangles: Vec<TriangleId>,
    ) -> Self {
        Self {
            page,
            rect,
            cells: CellMask::full([1, 1]),
            texels_per_m,
            triangles,
        }
    }

    /// Width and height of a cell.
    pub fn cell_size_texel(&self) -> [u32; 2] {
        let [columns, rows] = self.cells.size();
        let side = |texels: u32, cells: u32| texels.checked_div(cells).unwrap_or(0).max(1);
        [side(self.rect.width, columns), side(self.rect.height, rows)]
    }

    /// Whether the texel of its page is the chart's own.
    pub fn owns(&self, x: u32, y: u32) -> bool {
        let [width, height] = self.cell_size_texel();
        match (x.checked_sub(self.rect.x), y.checked_sub(self.rect.y)) {
            (Some(x), Some(y)) => self.cells.contains(x / width, y / height),
            _ => false,
        }
    }

    /// Stretches of the chart's own texels: (row, first column, columns) on the page.
    pub fn own_spans(&self) -> impl Iterator<Item = (u32, u32, u32)> + '_ {
        let [width, height] = self.cell_size_texel();
        self.cells.runs().flat_map(move |(row, first, len)| {
            let first_row = self.rect.y + row * height;
            (first_row..first_row + height)
                .map(move |y| (y, self.rect.x + first * width, len * width))
        })
    }
}

/// The placement of every triangle of one mesh. All pages have one size.
#[derive(Clone, Debug, PartialEq)]
pub struct AtlasLayout {
    /// Width and height of each page in texels.
    pub page_size_texel: [u32; 2],
    /// How many pages there are.
    pub num_pages: u32,
    /// Texels per metre that the charts were scaled by; where their own differ, the mean by area.
    pub texels_per_m: f64,
    /// All charts.
    pub charts: Vec<PlacedChart>,
    /// Per triangle of the mesh: its chart.
    pub chart_of_triangle: Vec<ChartId>,
    /// Per triangle of the mesh: its corners on the page, in texels.
    pub corners_texel: Vec<[[f32; 2]; 3]>,
}

impl AtlasLayout {
    /// The page a triangle lies on.
    pub fn page_of(&self, triangle: TriangleId) -> u32 {
        self.charts[self.chart_of_triangle[triangle.index()].index()].page
    }

    /// The triangles of each chart, ascending, by [`Self::chart_of_triangle`].
    pub fn triangles_by_chart(&self) -> Vec<Vec<TriangleId>> {
        let mut by_chart = vec![Vec::new(); self.charts.len()];
        for (triangle, chart) in (0_u32..).map(TriangleId).zip(&self.chart_of_triangle) {
            by_chart[chart.index()].push(triangle);
        }
        by_chart
    }

    /// A triangle's corners in [0, 1] of its page, v down.
    pub fn corners_uv(&self, triangle: TriangleId) -> [[f32; 2]; 3] {
        let [width, height] = self.page_size_texel.map(|side| side as f32);
        self.corners_texel[triangle.index()].map(|[x, y]| [x / width, y / height])
    }
}
