//! The part of a view that is drawn.

use crate::geom::PinholeCamera;
use crate::geom::camera::CameraError;

use super::VisibilityParams;
use super::visibility::buffer_size;

/// Windows begin and end at multiples of this, pixels of the view, or at its border.
pub(super) const GRID_PX: u32 = 16;

/// A rectangle of a view's pixels, half-open.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct PixelWindow {
    /// First column and row.
    pub(super) start: [u32; 2],
    /// Columns and rows behind the last ones.
    pub(super) end: [u32; 2],
}

impl PixelWindow {
    /// All of a view.
    pub fn whole(width: u32, height: u32) -> Self {
        Self {
            start: [0; 2],
            end: [width, height],
        }
    }

    pub(super) fn size(&self) -> [u32; 2] {
        [0, 1].map(|axis| self.end[axis].saturating_sub(self.start[axis]))
    }

    /// The least window around both.
    #[must_use]
    pub fn around(self, other: Self) -> Self {
        if self.is_empty() {
            return other;
        }
        if other.is_empty() {
            return self;
        }
        Self {
            start: [0, 1].map(|axis| self.start[axis].min(other.start[axis])),
            end: [0, 1].map(|axis| self.end[axis].max(other.end[axis])),
        }
    }

    /// Whether there is no pixel in it.
    pub fn is_empty(&self) -> bool {
        self.size().contains(&0)
    }
}

/// What of a camera's visibility buffer has to be drawn to judge some triangles.
#[derive(Clone, Copy, Debug)]
pub struct WindowFinder {
    /// The buffer's, pixels.
    size: [u32; 2],
    /// Pixels of the buffer per pixel of the camera.
    scale: [f64; 2],
    /// What is looked at beside a point, pixels of the buffer.
    reach_px: f64,
    /// In pixels of the buffer, first and last.
    bounds: Option<[[f64; 2]; 2]>,
}

impl WindowFinder {
    /// Nothing has to be drawn yet.
    pub fn new(camera: &PinholeCamera, params: &VisibilityParams) -> Self {
        let size = buffer_size(camera, params.max_width_px);
        let scale = [
            f64::from(size[0]) / f64::from(camera.width()),
            f64::from(size[1]) / f64::from(camera.height()),
        ];
        Self {
            size,
            scale,
            // Two more for rounding.
            reach_px: f64::from(params.margin_px(size[0])) + 2.0,
            bounds: None,
        }
    }

    /// A triangle is to be judged. Corners in pixels of the camera; `None` where they are not all in
    /// front of it.
    pub fn include(&mut self, corners_px: Option<[[f64; 2]; 3]>) {
        let everything = [[0.0; 2], self.size.map(f64::from)];
        let [mut low, mut high] = self
            .bounds
            .unwrap_or([[f64::INFINITY; 2], [f64::NEG_INFINITY; 2]]);
        match corners_px {
            Some(corners_px) if corners_px.as_flattened().iter().all(|px| px.is_finite()) => {
                for corner in corners_px {
                    for axis in 0..2 {
                        let px = (corner[axis] + 0.5) * self.scale[axis];
                        low[axis] = low[axis].min(px);
                        high[axis] = high[axis].max(px);
                    }
                }
            }
            _ => [low, high] = everything,
        }
        self.bounds = Some([low, high]);
    }

    /// The window; empty where no triangle was included, or none that lies in the image.
    #[expect(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "clamped to the view before the casts"
    )]
    pub fn window(&self) -> PixelWindow {
        let Some([low, high]) = self.bounds else {
            return PixelWindow::default();
        };
        let mut window = PixelWindow::default();
        for axis in 0..2 {
            let size = f64::from(self.size[axis]);
            let first = (low[axis] - self.reach_px).floor().clamp(0.0, size) as u32;
            let behind = (high[axis] + self.reach_px + 1.0).ceil().clamp(0.0, size) as u32;
            window.start[axis] = first / GRID_PX * GRID_PX;
            window.end[axis] = behind.next_multiple_of(GRID_PX).min(self.size[axis]);
        }
        window
    }

    /// All of the buffer.
    pub fn whole(&self) -> PixelWindow {
        PixelWindow::whole(self.size[0], self.size[1])
    }

    /// The camera of the buffer.
    ///
    /// # Errors
    /// [`CameraError`] when the camera cannot be scaled to it.
    pub fn buffer_camera(&self, camera: &PinholeCamera) -> Result<PinholeCamera, CameraError> {
        camera.resized(self.size[0], self.size[1])
    }
}

#[cfg(test)]
mod tests {
    use nalgebra::Point3;

    use super::*;
    use crate::geom::RigidTransform;
    use crate::mesh::TriMesh;
    use crate::render::part::MeshPart;
    use crate::render::visibility::{SurfacePoint, VisibilityBuffer};

    fn finder() -> WindowFinder {
        // The buffer has half the camera's size and a margin of 3 px.
        let camera = PinholeCamera::new([900.0, 900.0, 640.0, 480.0], 1280, 960).unwrap();
        WindowFinder::new(&camera, &VisibilityParams::default())
    }

    #[test]
    fn a_window_holds_what_is_included_and_what_lies_beside_it() {
        let mut finder = finder();
        assert!(finder.window().is_empty());
        finder.include(Some([[200.0, 300.0], [260.0, 300.0], [200.0, 340.0]]));
        let window = finder.window();
        assert_eq!((window.start, window.end), ([80, 144], [144, 192]));
        finder.include(Some([[-90.0, 300.0], [260.0, 300.0], [200.0, 340.0]]));
        assert_eq!(finder.window().start, [0, 144]);
        finder.include(None);
        assert_eq!(finder.window(), finder.whole());
    }

    #[test]
    fn what_lies_outside_of_the_image_needs_no_window() {
        let mut finder = finder();
        finder.include(Some([[-90.0, 300.0], [-60.0, 300.0], [-90.0, 340.0]]));
        assert!(finder.window().is_empty());
        finder.include(Some([[f64::NAN, 0.0], [0.0, 0.0], [0.0, 0.0]]));
        assert_eq!(finder.window(), finder.whole());
    }

    /// A board of 20 px of the view before a wall, and points of the wall beside each of its edges: as
    /// far as the margin reaches, an edge is drawn wherever windows happen to begin and end.
    #[test]
    fn the_edge_beside_a_point_is_in_its_window() {
        let quad = |half: f64, z: f64| {
            [[-half, -half], [half, -half], [half, half], [-half, half]]
                .map(|[x, y]| Point3::new(x, y, z))
        };
        let positions = quad(9.0, 3.0).into_iter().chain(quad(0.2, 2.0)).collect();
        let triangles = vec![[0, 1, 2], [0, 2, 3], [4, 5, 6], [4, 6, 7]];
        let (mesh, _) = TriMesh::from_soup(positions, triangles).unwrap();
        let (params, here) = (VisibilityParams::default(), RigidTransform::identity());
        let part = MeshPart::whole(&mesh);
        let [mut whole, mut narrow] = [(); 2].map(|()| VisibilityBuffer::default());
        let mut num_near = 0;
        for shift in 0..GRID_PX {
            let center_px = [312.0, 28.0].map(|px| px + f64::from(shift));
            let [cx, cy] = center_px;
            let camera = PinholeCamera::new([100.0, 100.0, cx, cy], 640, 72).unwrap();
            whole.update(&mesh, &camera, &here, &params).unwrap();
            for gap_px in [0.6, 1.6, 2.6, 3.4, 4.4, 5.4] {
                for [x, y] in [[1.0, 0.0], [-1.0, 0.0], [0.0, 1.0], [0.0, -1.0]] {
                    let out_px = 10.0 + gap_px;
                    let at = [cx + x * out_px, cy + y * out_px];
                    let corners_px = [[0.0, 0.0], [x, y], [x + y, y + x]]
                        .map(|step: [f64; 2]| [0, 1].map(|axis| at[axis] + 0.2 * step[axis]));
                    let mut finder = WindowFinder::new(&camera, &params);
                    finder.include(Some(corners_px));
                    let window = finder.window();
                    narrow
                        .update_window(&mesh, &part, &camera, &here, &params, window)
                        .unwrap();
                    for position_px in corners_px {
                        let point = SurfacePoint {
                            position_px,
                            depth_m: 3.0,
                            slope_m: 0.0,
                        };
                        let is_near = whole.is_near_depth_edge(&point);
                        let found = narrow.is_near_depth_edge(&point);
                        assert_eq!(found, is_near, "{gap_px} px beside the edge, {window:?}");
                        num_near += u32::from(is_near);
                    }
                }
            }
        }
        assert!(num_near > 400, "{num_near}");
    }
}
