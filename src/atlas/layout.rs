//! Which rectangle of which page each chart has, and where each triangle lies in it.

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

/// A rectangle of whole texels on a page, gutter included.
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

/// A chart and the rectangle that is its own.
#[derive(Clone, Debug, PartialEq)]
pub struct PlacedChart {
    /// Which page.
    pub page: u32,
    /// Its rectangle there, gutter included; no two charts' rectangles intersect.
    pub rect: TexelRect,
    /// Its triangles.
    pub triangles: Vec<TriangleId>,
}

/// The placement of every triangle of one mesh. All pages have one size.
#[derive(Clone, Debug, PartialEq)]
pub struct AtlasLayout {
    /// Width and height of each page in texels.
    pub page_size_texel: [u32; 2],
    /// How many pages there are.
    pub num_pages: u32,
    /// Texels per metre that the charts were scaled by.
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

    /// A triangle's corners in [0, 1] of its page, v down.
    pub fn corners_uv(&self, triangle: TriangleId) -> [[f32; 2]; 3] {
        let [width, height] = self.page_size_texel.map(|side| side as f32);
        self.corners_texel[triangle.index()].map(|[x, y]| [x / width, y / height])
    }
}
