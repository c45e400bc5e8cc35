//! A z-buffer of triangle ids on the CPU.
//!
//! Input: a mesh, a pinhole camera (pixel centres at integers) and its pose. Output: per pixel the
//! nearest triangle's id and its depth along z in metres. Both faces of a triangle are drawn.
//!
//! Method: vertices are snapped to 1/256 px and the edge functions are exact in integers, with a
//! half-open fill rule, so that triangles that share an edge neither overlap nor leave a gap.
//! 1/z is affine in the image; it is interpolated in f64 and kept within the triangle's own range,
//! which keeps slivers sane. Triangles are clipped at [`NEAR_M`] and, far outside the image, at a
//! guard band that keeps the integers in range (Sutherland–Hodgman, from the inner to the outer
//! end of each edge, so that neighbours are cut at the same points).
//!
//! Ties: the nearest depth wins, then the lowest id; the outcome depends neither on the order of
//! the triangles nor on that of a triangle's corners. Triangles that cover no pixel centre leave no trace.

use nalgebra::{Matrix3, Point3, Vector3};

use crate::geom::{PinholeCamera, RigidTransform};
use crate::mesh::TriMesh;

use super::part::MeshPart;
use super::window::PixelWindow;

/// Id of pixels that no triangle covers.
pub const NO_TRIANGLE: u32 = u32::MAX;

/// Surfaces nearer than this along z are clipped, metres.
pub const NEAR_M: f64 = 0.01;

const SUBPIXEL: f64 = 256.0;
const SUBPIXEL_BITS: u32 = 8;
/// Vertices farther than this outside the image's origin are clipped away: with it edge functions
/// stay under 2⁵⁶.
const GUARD_PX: f64 = 131_072.0;
/// Wider boxes than this are cut to the triangle's span row by row.
const SPAN_WIDTH_PX: i64 = 12;

const LEFT: u8 = 1;
const RIGHT: u8 = 2;
const ABOVE: u8 = 4;
const BELOW: u8 = 8;
const NEAR: u8 = 16;
const OUTSIDE: u8 = LEFT | RIGHT | ABOVE | BELOW | NEAR;
const GUARD: u8 = 32;
const NOT_FINITE: u8 = 64;
/// Nothing is drawn of a triangle whose corners are all outside of one of these.
pub(super) const DROPPED_BY_ALL: u8 = OUTSIDE;
/// A triangle with a corner outside of one of these is not drawn as it is.
pub(super) const NOT_WHOLE_BY_ANY: u8 = NEAR | GUARD | NOT_FINITE;

/// What a camera sees, row-major from the top left.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ViewBuffer {
    /// Columns.
    pub width: u32,
    /// Rows.
    pub height: u32,
    /// Per pixel: index of the nearest triangle, or [`NO_TRIANGLE`].
    pub triangle: Vec<u32>,
    /// Per pixel: depth along z in metres, 0 where there is no triangle.
    pub depth_m: Vec<f32>,
}

impl ViewBuffer {
    pub(super) fn clear(&mut self, width: u32, height: u32) {
        let num_pixels = width as usize * height as usize;
        self.width = width;
        self.height = height;
        self.triangle.clear();
        self.triangle.resize(num_pixels, NO_TRIANGLE);
        self.depth_m.clear();
        self.depth_m.resize(num_pixels, 0.0);
    }
}

/// Scratch memory of [`rasterize`], worth keeping from view to view.
#[derive(Clone, Debug, Default)]
pub struct RasterWorkspace {
    vertices: Vec<ScreenVertex>,
}

/// A projected vertex, snapped to the sub-pixel grid.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct ScreenVertex {
    /// Column and row of 1/256 px.
    pub(super) x: i32,
    pub(super) y: i32,
    /// 1/depth, 1/m.
    pub(super) inv_z: f32,
    /// Which half-spaces it is outside of.
    pub(super) outcode: u8,
}

/// What becomes of a triangle whose corners have these outcodes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Fate {
    /// Nothing of it is in the image.
    Dropped,
    /// It is drawn as it is.
    Drawn,
    /// [`clip_to_pieces`] says what of it is drawn.
    Clipped,
}

impl Fate {
    pub(super) fn of(outcodes: [u8; 3]) -> Self {
        let [a, b, c] = outcodes;
        let any = a | b | c;
        if a & b & c & DROPPED_BY_ALL != 0 || any & NOT_FINITE != 0 {
            Self::Dropped
        } else if any & NOT_WHOLE_BY_ANY == 0 {
            Self::Drawn
        } else {
            Self::Clipped
        }
    }
}

/// Camera and pose with the products that every vertex needs.
pub(super) struct Projector {
    /// Rows: homogeneous column, homogeneous row, depth.
    pixels_from_world: Matrix3<f64>,
    offset: Vector3<f64>,
    max_x_px: f64,
    max_y_px: f64,
}

impl Projector {
    pub(super) fn new(camera: &PinholeCamera, camera_from_world: &RigidTransform) -> Self {
        let [fx, fy, cx, cy] = camera.intrinsics_px();
        let intrinsics = Matrix3::new(fx, 0.0, cx, 0.0, fy, cy, 0.0, 0.0, 1.0);
        let rotation = camera_from_world.rotation().to_rotation_matrix();
        Self {
            pixels_from_world: intrinsics * rotation.matrix(),
            offset: intrinsics * camera_from_world.translation(),
            max_x_px: f64::from(camera.width()),
            max_y_px: f64::from(camera.height()),
        }
    }

    /// (column · z, row · z, z).
    pub(super) fn homogeneous(&self, point_in_world: &Point3<f64>) -> Vector3<f64> {
        self.pixels_from_world * point_in_world.coords + self.offset
    }

    /// Which half-spaces the point is outside of. They are linear in homogeneous coordinates, so
    /// they hold behind the camera too.
    fn outcode(&self, h: &Vector3<f64>) -> u8 {
        if !(h.x.is_finite() && h.y.is_finite() && h.z.is_finite()) {
            return NOT_FINITE;
        }
        let bit = |is_set: bool, bit: u8| if is_set { bit } else { 0 };
        // One pixel of margin covers the snapping.
        bit(h.x + h.z < 0.0, LEFT)
            | bit(h.x - self.max_x_px * h.z > 0.0, RIGHT)
            | bit(h.y + h.z < 0.0, ABOVE)
            | bit(h.y - self.max_y_px * h.z > 0.0, BELOW)
            | bit(h.z < NEAR_M, NEAR)
            | bit(
                h.x.abs() > GUARD_PX * h.z || h.y.abs() > GUARD_PX * h.z,
                GUARD,
            )
    }

    #[expect(clippy::cast_possible_truncation, reason = "rounding to f32 is meant")]
    fn snap(h: &Vector3<f64>, outcode: u8) -> ScreenVertex {
        let inv_z = 1.0 / h.z;
        ScreenVertex {
            x: round_to_int(h.x * inv_z * SUBPIXEL),
            y: round_to_int(h.y * inv_z * SUBPIXEL),
            inv_z: inv_z as f32,
            outcode,
        }
    }

    pub(super) fn project(&self, point_in_world: &Point3<f64>) -> ScreenVertex {
        let h = self.homogeneous(point_in_world);
        Self::snap(&h, self.outcode(&h))
    }
}

/// The nearest integer; `f64::round` is a library call on baseline x86-64.
#[expect(
    clippy::cast_possible_truncation,
    reason = "float to int casts saturate, and vertices out of range are clipped"
)]
fn round_to_int(value: f64) -> i32 {
    (value + 0.5f64.copysign(value)) as i32
}

/// Draws every triangle of `mesh` into `out`, which takes the camera's size.
pub fn rasterize(
    mesh: &TriMesh,
    camera: &PinholeCamera,
    camera_from_world: &RigidTransform,
    workspace: &mut RasterWorkspace,
    out: &mut ViewBuffer,
) {
    let whole = MeshPart::whole(mesh);
    rasterize_part(mesh, &whole, camera, camera_from_world, workspace, out);
}

/// Draws a part of `mesh`; of a part that has all that the camera may see
/// ([`super::MeshRuns::in_view`]), the picture is that of the whole.
pub fn rasterize_part(
    mesh: &TriMesh,
    part: &MeshPart,
    camera: &PinholeCamera,
    camera_from_world: &RigidTransform,
    workspace: &mut RasterWorkspace,
    out: &mut ViewBuffer,
) {
    let window = PixelWindow::whole(camera.width(), camera.height());
    rasterize_window(
        mesh,
        part,
        camera,
        camera_from_world,
        window,
        workspace,
        out,
    );
}

/// Draws what lies in a window of the view; `out` takes the window's size. Its pixels are those of the
/// whole view.
pub fn rasterize_window(
    mesh: &TriMesh,
    part: &MeshPart,
    camera: &PinholeCamera,
    camera_from_world: &RigidTransform,
    window: PixelWindow,
    workspace: &mut RasterWorkspace,
    out: &mut ViewBuffer,
) {
    draw_inverse(
        mesh,
        part,
        camera,
        camera_from_world,
        window,
        workspace,
        out,
    );
    for depth_m in &mut out.depth_m {
        // The buffer holds 1/z while triangles are drawn.
        *depth_m = if *depth_m > 0.0 { 1.0 / *depth_m } else { 0.0 };
    }
}

/// Draws what lies in a window of the view; where [`ViewBuffer`] has depths, `out` gets 1/depth.
pub(super) fn draw_inverse(
    mesh: &TriMesh,
    part: &MeshPart,
    camera: &PinholeCamera,
    camera_from_world: &RigidTransform,
    window: PixelWindow,
    workspace: &mut RasterWorkspace,
    out: &mut ViewBuffer,
) {
    let [width, height] = window.size();
    out.clear(width, height);
    let first_px = window.start;
    let projector = Projector::new(camera, camera_from_world);
    let vertices = &mut workspace.vertices;
    part.map_vertices(mesh, vertices, |p| projector.project(p));

    for (triangle, corners) in part.front_to_back(mesh) {
        let on_screen = corners.map(|v| vertices[v as usize]);
        match Fate::of(on_screen.map(|v| v.outcode)) {
            Fate::Dropped => {}
            Fate::Drawn => draw(on_screen, triangle, first_px, out),
            Fate::Clipped => {
                let points =
                    corners.map(|v| projector.homogeneous(&mesh.positions_m()[v as usize]));
                clip_to_pieces(points, |piece| draw(piece, triangle, first_px, out));
            }
        }
    }
}

/// Draws triangles in space into a window of the view, which has 1/depth of what is there; ids are not
/// theirs.
pub(super) fn draw_triangles_inverse(
    triangles_m: &[[Point3<f64>; 3]],
    camera: &PinholeCamera,
    camera_from_world: &RigidTransform,
    window: PixelWindow,
    out: &mut ViewBuffer,
) {
    let projector = Projector::new(camera, camera_from_world);
    for corners_m in triangles_m {
        let on_screen = corners_m.each_ref().map(|corner| projector.project(corner));
        match Fate::of(on_screen.map(|v| v.outcode)) {
            Fate::Dropped => {}
            Fate::Drawn => draw(on_screen, 0, window.start, out),
            Fate::Clipped => {
                let points = corners_m
                    .each_ref()
                    .map(|corner| projector.homogeneous(corner));
                clip_to_pieces(points, |piece| draw(piece, 0, window.start, out));
            }
        }
    }
}

/// Cuts a triangle, given in homogeneous coordinates, at the near plane and the guard band; gives
/// `each` the triangles that are left.
pub(super) fn clip_to_pieces(corners: [Vector3<f64>; 3], mut each: impl FnMut([ScreenVertex; 3])) {
    let half_spaces: [fn(&Vector3<f64>) -> f64; 5] = [
        |h| h.z - NEAR_M,
        |h| GUARD_PX * h.z + h.x,
        |h| GUARD_PX * h.z - h.x,
        |h| GUARD_PX * h.z + h.y,
        |h| GUARD_PX * h.z - h.y,
    ];
    let mut polygon = corners.to_vec();
    let mut clipped = Vec::with_capacity(8);
    for distance in half_spaces {
        clip(&polygon, distance, &mut clipped);
        std::mem::swap(&mut polygon, &mut clipped);
    }
    let Some((first, rest)) = polygon.split_first() else {
        return;
    };
    // Rounding may leave a cut point a hair outside of the plane it was cut at.
    let guarded = |h: &Vector3<f64>| {
        let z = h.z.max(NEAR_M);
        let reach = GUARD_PX * z;
        let inside = Vector3::new(h.x.clamp(-reach, reach), h.y.clamp(-reach, reach), z);
        Projector::snap(&inside, 0)
    };
    for pair in rest.windows(2) {
        each([guarded(first), guarded(&pair[0]), guarded(&pair[1])]);
    }
}

/// The part of a convex polygon where `distance` ≥ 0.
fn clip(
    polygon: &[Vector3<f64>],
    distance: impl Fn(&Vector3<f64>) -> f64,
    out: &mut Vec<Vector3<f64>>,
) {
    out.clear();
    let Some(last) = polygon.last() else { return };
    let mut previous = (last, distance(last));
    for point in polygon {
        let current = (point, distance(point));
        if (previous.1 >= 0.0) != (current.1 >= 0.0) {
            let (inner, outer) = if previous.1 >= 0.0 {
                (previous, current)
            } else {
                (current, previous)
            };
            let t = inner.1 / (inner.1 - outer.1);
            let cut = inner.0.lerp(outer.0, t);
            if cut.iter().all(|v| v.is_finite()) {
                out.push(cut);
            }
        }
        if current.1 >= 0.0 {
            out.push(*point);
        }
        previous = current;
    }
}

/// One edge's function along the raster.
#[derive(Clone, Copy)]
struct Edge {
    /// At the first pixel of the current row; ≥ 0 inside.
    row: i64,
    step_x: i64,
    step_y: i64,
}

/// Value of an edge's function at a pixel, without the fill rule's bias.
fn edge_value(a: ScreenVertex, b: ScreenVertex, x_px: i64, y_px: i64) -> i64 {
    let [ax, ay, bx, by] = [a.x, a.y, b.x, b.y].map(i64::from);
    (bx - ax) * ((y_px << SUBPIXEL_BITS) - ay) - (by - ay) * ((x_px << SUBPIXEL_BITS) - ax)
}

impl Edge {
    fn new(a: ScreenVertex, b: ScreenVertex, x_px: i64, y_px: i64) -> Self {
        let (dx, dy) = (
            i64::from(b.x) - i64::from(a.x),
            i64::from(b.y) - i64::from(a.y),
        );
        // An edge owns the pixel centres on it in one of its two directions only.
        let owns_ties = dy < 0 || (dy == 0 && dx > 0);
        Self {
            row: edge_value(a, b, x_px, y_px) - i64::from(!owns_ties),
            step_x: -dy << SUBPIXEL_BITS,
            step_y: dx << SUBPIXEL_BITS,
        }
    }
}

/// The same corners whatever order they came in: positive area, starting at the top-left one.
fn canonical(mut corners: [ScreenVertex; 3]) -> Option<([ScreenVertex; 3], i64)> {
    let [a, b, c] = corners;
    let delta = |from: i32, to: i32| i64::from(to) - i64::from(from);
    let area2 = delta(a.x, b.x) * delta(a.y, c.y) - delta(a.x, c.x) * delta(a.y, b.y);
    if area2 < 0 {
        corners.swap(1, 2);
    }
    let key = |v: &ScreenVertex| (v.y, v.x);
    let first = (0..3).min_by_key(|&i| key(&corners[i])).unwrap_or(0);
    corners.rotate_left(first);
    (area2 != 0).then_some((corners, area2.abs()))
}

/// Draws a triangle into a window of the view whose first column and row are given.
#[expect(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "pixel indices are clamped to the window; depth is rounded to f32 on purpose"
)]
fn draw(corners: [ScreenVertex; 3], triangle: u32, first_px: [u32; 2], out: &mut ViewBuffer) {
    let extent = |along: fn(&ScreenVertex) -> i32, start: u32, size: u32| {
        let [p, q, r] = corners.each_ref().map(along).map(i64::from);
        let first = p.min(q).min(r);
        let first = first.div_euclid(256) + i64::from(first.rem_euclid(256) != 0);
        let last = p.max(q).max(r).div_euclid(256);
        let (start, size) = (i64::from(start), i64::from(size));
        (first.max(start), last.min(start + size - 1))
    };
    let (x_first, x_last) = extent(|v| v.x, first_px[0], out.width);
    let (y_first, y_last) = extent(|v| v.y, first_px[1], out.height);
    if x_first > x_last || y_first > y_last {
        return;
    }
    let inv_z = corners.map(|corner| corner.inv_z);
    let nearest = inv_z[0].max(inv_z[1]).max(inv_z[2]);
    let farthest = inv_z[0].min(inv_z[1]).min(inv_z[2]);
    let width = out.width as usize;
    let [x_start, y_start] = first_px.map(i64::from);
    let columns = (x_first - x_start) as usize..(x_last - x_start) as usize + 1;
    let rows = (y_first - y_start) as usize..(y_last - y_start) as usize + 1;
    // Nothing of it can win where all of its box shows nearer surfaces, which in a building, drawn
    // from front to back, is the lot of most triangles.
    let is_hidden = out.depth_m[rows.start * width..rows.end * width]
        .chunks_exact(width)
        .all(|row| row[columns.clone()].iter().all(|&inv_z| inv_z > nearest));
    if is_hidden {
        return;
    }

    let Some(([a, b, c], area2)) = canonical(corners) else {
        return;
    };
    let sides = [(b, c), (c, a), (a, b)];
    let mut edges = sides.map(|(p, q)| Edge::new(p, q, x_first, y_first));
    let inv_z = [a.inv_z, b.inv_z, c.inv_z];
    let inv_area2 = 1.0 / area2 as f64;
    let weigh = |values: [i64; 3]| {
        let terms: [f64; 3] = std::array::from_fn(|i| values[i] as f64 * f64::from(inv_z[i]));
        (terms[0] + terms[1] + terms[2]) * inv_area2
    };
    let (step_x, step_y) = (
        weigh(edges.map(|edge| edge.step_x)),
        weigh(edges.map(|edge| edge.step_y)),
    );
    // From a corner's pixel on, so that the value at a pixel is the same in every window.
    let [x_origin, y_origin] = [a.x, a.y].map(|at| i64::from(at >> SUBPIXEL_BITS));
    let origin_inv_z = weigh(sides.map(|(p, q)| edge_value(p, q, x_origin, y_origin)));

    let box_width = x_last - x_first + 1;
    for y in y_first..=y_last {
        let (skip, end) = if box_width > SPAN_WIDTH_PX {
            span(&edges, box_width)
        } else {
            (0, box_width)
        };
        if skip < end {
            let start = (y - y_start) as usize * width + (x_first + skip - x_start) as usize;
            let range = start..start + (end - skip) as usize;
            let mut e = edges.map(|edge| edge.row + skip * edge.step_x);
            let row_inv_z = origin_inv_z + (y - y_origin) as f64 * step_y;
            let mut x = (x_first + skip - x_origin) as f64;
            let mut has_entered = false;
            let pixels = out.depth_m[range.clone()]
                .iter_mut()
                .zip(&mut out.triangle[range]);
            for (stored, id) in pixels {
                let is_inside = (e[0] | e[1] | e[2]) >= 0;
                if is_inside {
                    has_entered = true;
                    let pixel_inv_z = row_inv_z + x * step_x;
                    let candidate = (pixel_inv_z as f32).clamp(farthest, nearest);
                    let is_tie = candidate == *stored && candidate > 0.0;
                    let is_nearer = candidate > *stored || (is_tie && triangle < *id);
                    if is_nearer {
                        *stored = candidate;
                        *id = triangle;
                    }
                } else if has_entered {
                    // A row of a triangle is one run.
                    break;
                }
                for (value, edge) in e.iter_mut().zip(&edges) {
                    *value += edge.step_x;
                }
                x += 1.0;
            }
        }
        for edge in &mut edges {
            edge.row += edge.step_y;
        }
    }
}

/// Columns of the current row that may be inside, as a half-open range from the first column of
/// the box; one pixel too many on each side covers the rounding.
#[expect(
    clippy::cast_possible_truncation,
    reason = "clamped to the box; float to int casts saturate"
)]
fn span(edges: &[Edge; 3], box_width: i64) -> (i64, i64) {
    let (mut first, mut end) = (0i64, box_width);
    for edge in edges {
        let crossing = -(edge.row as f64) / edge.step_x as f64;
        match edge.step_x.cmp(&0) {
            std::cmp::Ordering::Greater => first = first.max(crossing.floor() as i64 - 1),
            std::cmp::Ordering::Less => end = end.min((crossing.ceil() as i64).saturating_add(2)),
            std::cmp::Ordering::Equal if edge.row < 0 => return (0, 0),
            std::cmp::Ordering::Equal => {}
        }
    }
    (first.clamp(0, box_width), end.clamp(0, box_width))
}

/// Barycentric coordinates of where a ray from the camera meets the plane of a triangle; `None`
/// where it runs along the plane.
pub fn barycentric(corners_in_camera: &[Point3<f64>; 3], ray: &Vector3<f64>) -> Option<[f64; 3]> {
    let [a, b, c] = corners_in_camera.map(|p| p.coords);
    let volumes = [
        ray.dot(&b.cross(&c)),
        ray.dot(&c.cross(&a)),
        ray.dot(&a.cross(&b)),
    ];
    let sum = volumes[0] + volumes[1] + volumes[2];
    let weights = volumes.map(|v| v / sum);
    weights.iter().all(|w| w.is_finite()).then_some(weights)
}

#[cfg(test)]
pub(super) mod tests;
