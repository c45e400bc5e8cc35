//! Which surface points a camera sees, by the depth of the mesh itself.
//!
//! The mesh is drawn into a [`ViewBuffer`] at the camera's resolution or below
//! ([`VisibilityParams::max_width_px`]). A point is visible when no drawn surface lies in front of
//! it by more than a tolerance, which grows with depth and with the slope of the point's own
//! surface: a buffer pixel's depth is that of its centre, up to 0.71 px away. Surfaces that are
//! closer to one another than the tolerance do not hide each other.
//!
//! Depth edges: the nearest and farthest depth within a window say whether the picture of a point
//! lies close to the outline of something in front of it, or to the outline of its own object.
//! There, small errors of pose or mesh paint the one surface with the other's colour.

use nalgebra::{Point3, Vector3};

use crate::geom::camera::CameraError;
use crate::geom::{PinholeCamera, RigidTransform};
use crate::mesh::TriMesh;

use super::depth_bound::DepthBound;
use super::kept_view::KeptView;
use super::part::MeshPart;
use super::raster::{NO_TRIANGLE, RasterWorkspace, ViewBuffer, rasterize_window};
use super::window::{PixelWindow, WindowFinder};

/// How visibility is decided.
#[derive(Clone, Debug, PartialEq)]
pub struct VisibilityParams {
    /// The longer side of the buffer is at most this, pixels (≥ 16).
    pub max_width_px: u32,
    /// A surface hides a point from this distance on, metres (≥ 0).
    pub tolerance_m: f64,
    /// The same as a share of depth (≥ 0); both are added.
    pub relative_tolerance: f64,
    /// Depth steps above this share of depth (and three times the tolerance) are edges.
    pub edge_step: f64,
    /// Half-width of the window in which depth edges are looked for, in pixels of a buffer of 640
    /// columns; 0 looks for none.
    pub edge_margin_px: u32,
    /// Surface deeper than this along the camera's axis is as if it were not there: nothing of it is
    /// visible, and it is no background; metres (> 0, infinite for no limit).
    pub far_m: f64,
}

impl Default for VisibilityParams {
    fn default() -> Self {
        Self {
            max_width_px: 640,
            tolerance_m: 0.01,
            relative_tolerance: 0.01,
            edge_step: 0.04,
            edge_margin_px: 3,
            far_m: 8.0,
        }
    }
}

impl VisibilityParams {
    /// Half-width of the window in which depth edges are looked for, pixels of a buffer of that many
    /// columns.
    pub(super) fn margin_px(&self, num_columns: u32) -> u32 {
        let reference = u64::from(self.edge_margin_px) * u64::from(num_columns);
        u32::try_from(reference.div_ceil(640))
            .unwrap_or(u32::MAX)
            .clamp(1, 64)
    }

    /// How far behind the surface drawn a point at a depth may lie and still be visible, metres, where
    /// its own surface's depth changes by `slope_m` metres within what rounding to pixels does.
    pub(super) fn tolerance_m(&self, depth_m: f64, slope_m: f64) -> f64 {
        self.tolerance_m + self.relative_tolerance * depth_m + slope_m
    }

    /// How far from its outline a surface shows in what the tests say of others, pixels of the
    /// full-size camera.
    pub fn reach_px(&self, camera: &PinholeCamera) -> f64 {
        let [columns, rows] = buffer_size(camera, self.max_width_px);
        let scale = (f64::from(columns) / f64::from(camera.width()))
            .min(f64::from(rows) / f64::from(camera.height()));
        // Two more for rounding outlines and points to pixels.
        (f64::from(self.margin_px(columns)) + 2.0) / scale
    }
}

/// A point of a surface as a camera sees it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SurfacePoint {
    /// Pixel of the full-size camera.
    pub position_px: [f64; 2],
    /// Depth along z, metres.
    pub depth_m: f64,
    /// Change of depth per pixel of the full-size camera, metres (≥ 0).
    pub slope_m: f64,
}

/// Depth of the mesh from one camera, with what visibility tests need.
#[derive(Clone, Debug, Default)]
pub struct VisibilityBuffer {
    raster: RasterWorkspace,
    view: ViewBuffer,
    /// Lowest depth within the window; infinite where it is empty.
    nearest_m: Vec<f32>,
    /// Greatest depth within the window; 0 where it is empty.
    farthest_m: Vec<f32>,
    scratch_m: Vec<f32>,
    /// Whether the two are made for the window; else each test looks at the depths around its point.
    has_extremes: bool,
    bound: DepthBound,
    /// Columns of the whole buffer.
    num_columns: u32,
    /// What of it is drawn.
    window: PixelWindow,
    scale: [f64; 2],
    params: VisibilityParams,
}

/// Side of the blocks of the bound, pixels of the buffer.
const BLOCK_PX: usize = 4;

/// To look around one point takes as long as to make the extremes of so many pixels.
const PIXELS_PER_EDGE_TEST: usize = 10;

impl VisibilityBuffer {
    /// Draws the mesh as `camera` sees it.
    ///
    /// # Errors
    /// [`CameraError`] when the camera cannot be scaled to the buffer's size.
    pub fn update(
        &mut self,
        mesh: &TriMesh,
        camera: &PinholeCamera,
        camera_from_world: &RigidTransform,
        params: &VisibilityParams,
    ) -> Result<(), CameraError> {
        let whole = MeshPart::whole(mesh);
        self.update_part(mesh, &whole, camera, camera_from_world, params)
    }

    /// The same from the part of the mesh that `camera` may see
    /// ([`super::MeshRuns::in_view`]).
    ///
    /// # Errors
    /// [`CameraError`] when the camera cannot be scaled to the buffer's size.
    pub fn update_part(
        &mut self,
        mesh: &TriMesh,
        part: &MeshPart,
        camera: &PinholeCamera,
        camera_from_world: &RigidTransform,
        params: &VisibilityParams,
    ) -> Result<(), CameraError> {
        let whole = WindowFinder::new(camera, params).whole();
        self.update_window(mesh, part, camera, camera_from_world, params, whole)
    }

    /// The same in a window alone ([`WindowFinder`]); what lies outside of it is taken for hidden.
    ///
    /// # Errors
    /// [`CameraError`] when the camera cannot be scaled to the buffer's size.
    pub fn update_window(
        &mut self,
        mesh: &TriMesh,
        part: &MeshPart,
        camera: &PinholeCamera,
        camera_from_world: &RigidTransform,
        params: &VisibilityParams,
        window: PixelWindow,
    ) -> Result<(), CameraError> {
        let [width, height] = buffer_size(camera, params.max_width_px);
        let scaled = camera.resized(width, height)?;
        rasterize_window(
            mesh,
            part,
            &scaled,
            camera_from_world,
            window,
            &mut self.raster,
            &mut self.view,
        );
        self.judge(camera, params, window);
        self.expect_edge_tests(usize::MAX);
        Ok(())
    }

    /// What [`Self::update_window`] draws, from depths that are kept of the view, none of them stale in
    /// the window. Ids of triangles are not kept. About as many points as `num_edge_tests` will be tested
    /// for depth edges; what the tests say does not depend on it, how long they take does.
    ///
    /// # Errors
    /// [`CameraError`] when the camera cannot be scaled to the buffer's size.
    pub fn load(
        &mut self,
        kept: &KeptView,
        camera: &PinholeCamera,
        params: &VisibilityParams,
        window: PixelWindow,
        num_edge_tests: usize,
    ) -> Result<(), CameraError> {
        let [width, height] = buffer_size(camera, params.max_width_px);
        camera.resized(width, height)?;
        let [width, height] = window.size();
        self.view.clear(width, height);
        let rows = self.view.depth_m.chunks_exact_mut(width.max(1) as usize);
        for (row, inverse) in rows.zip(kept.rows(window)) {
            for (depth_m, inverse) in row.iter_mut().zip(inverse) {
                *depth_m = if *inverse > 0.0 { 1.0 / *inverse } else { 0.0 };
            }
        }
        self.judge(camera, params, window);
        self.expect_edge_tests(num_edge_tests);
        Ok(())
    }

    /// Makes what the tests read from the depths of a window.
    fn judge(&mut self, camera: &PinholeCamera, params: &VisibilityParams, window: PixelWindow) {
        let [width, height] = buffer_size(camera, params.max_width_px);
        self.num_columns = width;
        self.window = window;
        self.scale = [
            f64::from(width) / f64::from(camera.width()),
            f64::from(height) / f64::from(camera.height()),
        ];
        self.params = params.clone();
        self.drop_far();
        self.bound.update(&self.view, window, self.scale, BLOCK_PX);
        self.has_extremes = false;
    }

    /// Makes the extremes around every pixel at once, where that is faster than around each point.
    fn expect_edge_tests(&mut self, num_tests: usize) {
        let num_pixels = self.view.depth_m.len();
        if self.params.edge_margin_px > 0 && num_tests >= num_pixels / PIXELS_PER_EDGE_TEST {
            self.spread_extremes();
            self.has_extremes = true;
        }
    }

    /// The view that the tests read.
    pub fn view(&self) -> &ViewBuffer {
        &self.view
    }

    /// Pixels of the buffer per pixel of the full-size camera, in area.
    pub fn area_scale(&self) -> f64 {
        self.scale[0] * self.scale[1]
    }

    /// Whether nothing hides the point. Points too far, or whose pixel is outside of the image, are
    /// hidden.
    pub fn is_visible(&self, point: &SurfacePoint) -> bool {
        if point.depth_m > self.params.far_m {
            return false;
        }
        self.pixel_index(point.position_px).is_some_and(|index| {
            let surface_m = f64::from(self.view.depth_m[index]);
            surface_m <= 0.0 || point.depth_m <= surface_m + self.tolerance_m(point, 1.5)
        })
    }

    /// Whether the point's picture lies close to a step in depth.
    pub fn is_near_depth_edge(&self, point: &SurfacePoint) -> bool {
        if self.params.edge_margin_px == 0 {
            return false;
        }
        self.pixel_index(point.position_px).is_some_and(|index| {
            let reach_px = f64::from(self.margin_px()) + 1.5;
            let step_m = self.params.edge_step * point.depth_m
                + 2.0 * self.params.tolerance_m
                + self.tolerance_m(point, reach_px);
            let [nearest_m, farthest_m] = self.extremes_m(index).map(f64::from);
            nearest_m + step_m < point.depth_m || farthest_m > point.depth_m + step_m
        })
    }

    /// Lowest and greatest depth around a pixel, infinite and 0 where nothing is drawn.
    fn extremes_m(&self, index: usize) -> [f32; 2] {
        if self.has_extremes {
            return [self.nearest_m[index], self.farthest_m[index]];
        }
        let [width, height] = [self.view.width, self.view.height].map(|side| side as usize);
        let margin = self.margin_px() as usize;
        let (x, y) = (index % width, index / width);
        let columns = x.saturating_sub(margin)..(x + margin + 1).min(width);
        let (mut nearest_m, mut farthest_m) = (f32::INFINITY, 0.0_f32);
        for row in y.saturating_sub(margin)..(y + margin + 1).min(height) {
            let start = row * width;
            for &depth_m in &self.view.depth_m[start + columns.start..start + columns.end] {
                let is_nearer = depth_m > 0.0 && depth_m < nearest_m;
                nearest_m = if is_nearer { depth_m } else { nearest_m };
                farthest_m = if depth_m > farthest_m {
                    depth_m
                } else {
                    farthest_m
                };
            }
        }
        [nearest_m, farthest_m]
    }

    /// How far it sees at most.
    pub fn depth_bound(&self) -> &DepthBound {
        &self.bound
    }

    /// Leaves pixels empty that show what is too far: which of it was drawn depends on how the mesh
    /// is divided into runs, and must not show.
    fn drop_far(&mut self) {
        let far_m = self.params.far_m;
        let pixels = self.view.triangle.iter_mut().zip(&mut self.view.depth_m);
        for (triangle, depth_m) in pixels.filter(|(_, depth_m)| f64::from(**depth_m) > far_m) {
            *triangle = NO_TRIANGLE;
            *depth_m = 0.0;
        }
    }

    fn tolerance_m(&self, point: &SurfacePoint, reach_px: f64) -> f64 {
        let slope_m = point.slope_m * reach_px / self.bound.least_scale();
        self.params.tolerance_m(point.depth_m, slope_m)
    }

    #[expect(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "range-checked before the casts"
    )]
    fn pixel_index(&self, [x_px, y_px]: [f64; 2]) -> Option<usize> {
        let [x_start, y_start] = self.window.start.map(f64::from);
        let x = (x_px + 0.5) * self.scale[0] - x_start;
        let y = (y_px + 0.5) * self.scale[1] - y_start;
        let (width, height) = (f64::from(self.view.width), f64::from(self.view.height));
        (x >= 0.0 && y >= 0.0 && x < width && y < height)
            .then(|| y as usize * self.view.width as usize + x as usize)
    }

    fn margin_px(&self) -> u32 {
        self.params.margin_px(self.num_columns)
    }

    fn spread_extremes(&mut self) {
        let [width, height] = [self.view.width, self.view.height].map(|side| side as usize);
        let margin = self.margin_px() as usize;
        let depth_m = &self.view.depth_m;
        self.farthest_m.clone_from(depth_m);
        spread(
            &mut self.farthest_m,
            &mut self.scratch_m,
            [width, height],
            margin,
            0.0,
            |a, b| if a > b { a } else { b },
        );
        self.nearest_m.clear();
        self.nearest_m.extend(
            depth_m
                .iter()
                .map(|&d| if d > 0.0 { d } else { f32::INFINITY }),
        );
        spread(
            &mut self.nearest_m,
            &mut self.scratch_m,
            [width, height],
            margin,
            f32::INFINITY,
            |a, b| if a < b { a } else { b },
        );
    }
}

/// Replaces each value by the extreme over the square window of half-width `margin`; `nothing` is what
/// every value is taken before. Extremes over 2, 4, 8… are taken first, and two of these make the
/// window.
fn spread(
    values: &mut [f32],
    scratch: &mut Vec<f32>,
    [width, height]: [usize; 2],
    margin: usize,
    nothing: f32,
    extreme: impl Fn(f32, f32) -> f32,
) {
    let wanted = 2 * margin + 1;
    let into = |out: &mut [f32], other: &[f32]| {
        for (out, &other) in out.iter_mut().zip(other) {
            *out = extreme(*out, other);
        }
    };
    // Down the columns, between rows of nothing.
    scratch.clear();
    scratch.resize((height + 2 * margin) * width, nothing);
    scratch[margin * width..(margin + height) * width].copy_from_slice(values);
    let mut reach = 1;
    while 2 * reach <= wanted {
        for y in 0..height + 2 * margin - reach {
            let (above, below) = scratch.split_at_mut((y + reach) * width);
            into(&mut above[y * width..(y + 1) * width], &below[..width]);
        }
        reach *= 2;
    }
    // Then along the rows.
    let mut line = vec![nothing; width + 2 * margin];
    let mut next = line.clone();
    for (y, row) in values.chunks_exact_mut(width.max(1)).enumerate() {
        let column = &mut line[margin..margin + width];
        column.copy_from_slice(&scratch[y * width..(y + 1) * width]);
        into(column, &scratch[(y + wanted - reach) * width..][..width]);
        let mut along = 1;
        while 2 * along <= wanted {
            next.copy_from_slice(&line);
            into(&mut next, &line[along..]);
            std::mem::swap(&mut line, &mut next);
            along *= 2;
        }
        row.copy_from_slice(&line[..width]);
        into(row, &line[wanted - along..]);
        line[..margin].fill(nothing);
        line[margin + width..].fill(nothing);
    }
}

pub(super) fn buffer_size(camera: &PinholeCamera, max_side_px: u32) -> [u32; 2] {
    let (width, height) = (camera.width(), camera.height());
    let longer = width.max(height);
    let limit = max_side_px.max(16);
    if longer <= limit {
        return [width, height];
    }
    [width, height].map(|side| {
        let scaled = u64::from(side) * u64::from(limit) / u64::from(longer);
        u32::try_from(scaled).unwrap_or(limit).max(1)
    })
}

/// Change of depth per pixel of a plane, at a point on it, metres; infinite when seen edge-on.
pub fn depth_slope_m(
    camera: &PinholeCamera,
    point_in_camera: &Point3<f64>,
    normal_in_camera: &Vector3<f64>,
) -> f64 {
    let [fx, fy, _, _] = camera.intrinsics_px();
    let along_ray = normal_in_camera.dot(&point_in_camera.coords);
    let steepness = nalgebra::Vector2::new(normal_in_camera.x / fx, normal_in_camera.y / fy).norm();
    let slope_m = point_in_camera.z * point_in_camera.z * steepness / along_ray.abs();
    if slope_m.is_nan() {
        f64::INFINITY
    } else {
        slope_m
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// A wall at z = 3 and a board of 0.4 m in front of it at z = 2.
    fn scene() -> TriMesh {
        let quad = |half: f64, z: f64| {
            [[-half, -half], [half, -half], [half, half], [-half, half]]
                .map(|[x, y]| Point3::new(x, y, z))
        };
        let positions = quad(4.0, 3.0).into_iter().chain(quad(0.2, 2.0)).collect();
        let triangles = vec![[0, 1, 2], [0, 2, 3], [4, 5, 6], [4, 6, 7]];
        TriMesh::from_soup(positions, triangles).unwrap().0
    }

    fn buffer(camera: &PinholeCamera) -> VisibilityBuffer {
        let mut buffer = VisibilityBuffer::default();
        let params = VisibilityParams::default();
        buffer
            .update(&scene(), camera, &RigidTransform::identity(), &params)
            .unwrap();
        buffer
    }

    fn seen(camera: &PinholeCamera, point: [f64; 3]) -> SurfacePoint {
        SurfacePoint {
            position_px: camera.project(&Point3::from(point)).unwrap(),
            depth_m: point[2],
            slope_m: 0.0,
        }
    }

    #[test]
    fn the_board_hides_the_wall_behind_it_at_any_image_size() {
        for (width, height) in [(640, 480), (1920, 1440), (320, 240)] {
            let (width_px, height_px) = (f64::from(width), f64::from(height));
            let intrinsics = [width_px, width_px, width_px / 2.0, height_px / 2.0];
            let camera = PinholeCamera::new(intrinsics, width, height).unwrap();
            let buffer = buffer(&camera);
            // The board's shadow on the wall ends at 0.3 m.
            for (x, is_visible, is_edge) in [
                (0.0, false, true),
                (0.27, false, true),
                (0.31, true, true),
                (0.5, true, false),
            ] {
                let point = seen(&camera, [x, 0.0, 3.0]);
                assert_eq!(buffer.is_visible(&point), is_visible, "{x} at {width} px");
                assert_eq!(
                    buffer.is_near_depth_edge(&point),
                    is_edge,
                    "{x} at {width} px"
                );
            }
            let on_board = seen(&camera, [0.0, 0.0, 2.0]);
            assert!(buffer.is_visible(&on_board) && !buffer.is_near_depth_edge(&on_board));
            let rim = seen(&camera, [0.197, 0.0, 2.0]);
            assert!(buffer.is_visible(&rim) && buffer.is_near_depth_edge(&rim));
            let outside = SurfacePoint {
                position_px: [-3.0, 5.0],
                depth_m: 1.0,
                slope_m: 0.0,
            };
            assert!(!buffer.is_visible(&outside));
        }
    }

    proptest! {
        /// The quick test never contradicts the exact one, and finds what lies well behind.
        #[test]
        fn what_is_hidden_as_a_whole_is_hidden_everywhere(
            center in [-1.5..1.5f64, -1.5..1.5f64],
            depth_m in 1.5..4.0f64,
            size_m in 0.01..0.6f64,
            slope_m in 0.0..0.01f64,
        ) {
            let camera = PinholeCamera::new([300.0, 300.0, 160.0, 120.0], 320, 240).unwrap();
            let buffer = buffer(&camera);
            let corners = [[0.0, 0.0], [size_m, 0.0], [0.0, size_m]]
                .map(|[x, y]| Point3::new(center[0] + x, center[1] + y, depth_m));
            let px = corners.map(|p| camera.project(&p).unwrap());
            let (bound, params) = (buffer.depth_bound(), VisibilityParams::default());
            let is_hidden = bound.hides(&px, depth_m, slope_m, &params);
            prop_assert!(is_hidden || !bound.coarser(2).hides(&px, depth_m, slope_m, &params));
            if is_hidden {
                for i in 0..=10 {
                    for j in 0..=10 - i {
                        let (u, v) = (f64::from(i) / 10.0, f64::from(j) / 10.0);
                        let at = corners[0] + (corners[1] - corners[0]) * u
                            + (corners[2] - corners[0]) * v;
                        let point = SurfacePoint {
                            slope_m,
                            ..seen(&camera, [at.x, at.y, at.z])
                        };
                        prop_assert!(!buffer.is_visible(&point));
                    }
                }
            }
        }
    }

    #[test]
    fn a_triangle_behind_the_wall_is_hidden_as_a_whole() {
        let camera = PinholeCamera::new([300.0, 300.0, 160.0, 120.0], 320, 240).unwrap();
        let buffer = buffer(&camera);
        let corners_px = [[100.0, 100.0], [120.0, 100.0], [100.0, 120.0]];
        let params = VisibilityParams::default();
        let hides = |depth_m, slope_m| {
            let bound = buffer.depth_bound();
            bound.hides(&corners_px, depth_m, slope_m, &params)
        };
        assert!(hides(3.5, 0.001));
        assert!(!hides(3.0, 0.001));
        assert!(!hides(3.5, f64::INFINITY));
    }

    #[test]
    fn what_is_too_far_is_as_if_it_were_not_there() {
        let camera = PinholeCamera::new([300.0, 300.0, 160.0, 120.0], 320, 240).unwrap();
        let mut buffer = buffer(&camera);
        let point = seen(&camera, [0.9, 0.0, 3.0]);
        assert!(buffer.is_visible(&point));
        let params = VisibilityParams {
            far_m: 2.5,
            ..VisibilityParams::default()
        };
        buffer
            .update(&scene(), &camera, &RigidTransform::identity(), &params)
            .unwrap();
        assert!(!buffer.is_visible(&point));
        assert!(buffer.view().depth_m.iter().all(|depth_m| *depth_m < 2.5));
        let rim = seen(&camera, [0.197, 0.0, 2.0]);
        assert!(buffer.is_visible(&rim) && !buffer.is_near_depth_edge(&rim));
    }

    proptest! {
        /// In the window of a triangle the tests say of it what they say in the whole view.
        #[test]
        fn a_window_tells_of_its_triangle_what_the_whole_tells(
            corner_m in [-0.24..0.24f64, -0.24..0.24f64],
            size_m in 0.002..0.1f64,
            depth_m in 1.5..3.2f64,
            center_px in [300.0..340.0f64, 220.0..260.0f64],
        ) {
            let [cx, cy] = center_px;
            let camera = PinholeCamera::new([600.0, 600.0, cx, cy], 640, 480).unwrap();
            let (params, mesh) = (VisibilityParams::default(), scene());
            let identity = RigidTransform::identity();
            let whole = buffer(&camera);
            let corners = [[0.0, 0.0], [size_m, 0.0], [0.0, size_m]]
                .map(|[x, y]| [corner_m[0] + x, corner_m[1] + y, depth_m]);
            let seen = corners.map(|corner| seen(&camera, corner));
            let mut finder = WindowFinder::new(&camera, &params);
            finder.include(Some(seen.map(|point| point.position_px)));
            let window = finder.window();
            if window.is_empty() {
                prop_assert!(seen.iter().all(|point| !whole.is_visible(point)));
            } else {
                let mut narrow = VisibilityBuffer::default();
                let part = MeshPart::whole(&mesh);
                narrow
                    .update_window(&mesh, &part, &camera, &identity, &params, window)
                    .unwrap();
                for point in &seen {
                    prop_assert_eq!(narrow.is_visible(point), whole.is_visible(point));
                    let is_near = whole.is_near_depth_edge(point);
                    prop_assert_eq!(narrow.is_near_depth_edge(point), is_near);
                }
            }
        }
    }

    #[test]
    fn slope_is_the_change_of_depth_per_pixel() {
        let camera = PinholeCamera::new([200.0, 200.0, 80.0, 60.0], 160, 120).unwrap();
        // z = 2 + 0.5 x: depth along a row is 2 / (1 − 0.5 ray_x).
        let depth_m = |x_px: f64| 2.0 / (1.0 - 0.5 * camera.ray(x_px, 60.0).x);
        let point = camera.unproject([90.0, 60.0], depth_m(90.0));
        let slope_m = depth_slope_m(&camera, &point, &Vector3::new(0.5, 0.0, -1.0));
        let expected = (depth_m(90.5) - depth_m(89.5)).abs();
        assert!((slope_m - expected).abs() < 1e-6 * expected.max(1.0));
        assert!(depth_slope_m(&camera, &point, &Vector3::zeros()).is_infinite());
    }

    proptest! {
        #[test]
        fn spreading_takes_the_extreme_over_the_window(
            values in prop::collection::vec(0.0..9.0f32, 35),
            margin in 0usize..9,
        ) {
            let (width, height) = (7usize, 5usize);
            for (extreme, start) in [(f32::max as fn(f32, f32) -> f32, 0.0f32), (f32::min, 99.0)] {
                let mut spread_values = values.clone();
                spread(&mut spread_values, &mut vec![], [width, height], margin, start, extreme);
                for y in 0..height {
                    for x in 0..width {
                        let mut expected = start;
                        for (index, &value) in values.iter().enumerate() {
                            let (dx, dy) = ((index % width).abs_diff(x), (index / width).abs_diff(y));
                            if dx <= margin && dy <= margin {
                                expected = extreme(expected, value);
                            }
                        }
                        prop_assert_eq!(spread_values[y * width + x], expected);
                    }
                }
            }
        }
    }
}
