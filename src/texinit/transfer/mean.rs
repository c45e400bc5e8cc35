//! Texels that show a mean over frames: exact sums, in linear light or of sRGB values
//! ([`MeanForm`]).

use nalgebra::Point3;
use rayon::prelude::*;

use crate::atlas::texels::for_each_texel_within;
use crate::atlas::{AtlasLayout, SharedPage, TexelSource};
use crate::geom::PinholeCamera;
use crate::geom::color::srgb_from_linear;
use crate::mesh::{TriMesh, TriangleId};
use crate::render::{BoundingBox, DepthBound, Frustum, VisibilityBuffer};
use crate::texinit::assign::DepthCue;
use crate::texinit::assign::validity::{DepthProbe, depth_difference_m};

use super::painter::{CameraPose, FrameLook};
use super::sampler::{TriangleSampler, slope_m};
use super::{MEAN_CONFIDENCE, MeanForm, TransferParams};

/// Triangles that one task works on.
const TASK_SIZE: usize = 256;

/// Values in [0, 1] are summed in steps of 1/65535.
const STEPS: f32 = 65535.0;

/// Views of a point away from depth edges weigh this much more than views beside one.
const CLEAR_WEIGHT: u32 = 8;

/// Weights that a sum of 32 bits has room for; what comes after leaves the mean as it is.
const MAX_WEIGHT: u32 = 65_537;

/// As many frames always have room, so that the order in which they are added leaves no trace.
pub(crate) const MAX_FRAMES_IN_ANY_ORDER: usize = (MAX_WEIGHT / CLEAR_WEIGHT) as usize;

/// Sum over frames.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct TexelSum {
    sum: [u32; 3],
    weight: u32,
}

impl TexelSum {
    #[expect(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "values are in [0, 1]; float to int casts saturate"
    )]
    fn add(&mut self, values: [f32; 3], weight: u32) {
        if self.weight + weight <= MAX_WEIGHT {
            self.weight += weight;
            for (sum, value) in self.sum.iter_mut().zip(values) {
                *sum += weight * (value.clamp(0.0, 1.0) * STEPS + 0.5) as u32;
            }
        }
    }

    #[expect(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "rounding to f32 is meant; a mean of bytes is a byte"
    )]
    fn srgb(&self, form: MeanForm) -> Option<[u8; 3]> {
        let mean = |sum: u32| f64::from(sum) / f64::from(self.weight) / f64::from(STEPS);
        let byte = |sum: u32| match form {
            MeanForm::Seeing => srgb_from_linear(mean(sum) as f32),
            MeanForm::Projecting => (mean(sum) * 255.0).round() as u8,
        };
        (self.weight > 0).then(|| self.sum.map(byte))
    }
}

/// Some triangles.
struct MeanTask<'a> {
    triangles: &'a [TriangleId],
    /// The box around them.
    bounds: &'a BoundingBox,
    /// First sum of each, and one behind the last.
    firsts: &'a [usize],
    sums: &'a mut [TexelSum],
    has_grown: &'a mut [bool],
}

/// The sums of all texels of some triangles.
pub(crate) struct MeanTexels {
    triangles: Vec<TriangleId>,
    /// Per task's triangles: the box around them.
    bounds: Vec<BoundingBox>,
    /// Per triangle: its first sum; and the number of sums.
    first: Vec<usize>,
    sums: Vec<TexelSum>,
    /// Per triangle: whether a frame added to one of its sums.
    has_grown: Vec<bool>,
}

impl MeanTexels {
    pub(crate) fn new(
        mesh: &TriMesh,
        layout: &AtlasLayout,
        triangles: impl Iterator<Item = TriangleId>,
    ) -> Self {
        Self::with_sums(
            mesh,
            layout,
            triangles.map(|triangle| (triangle, Vec::new())).collect(),
        )
    }

    /// Goes on from the sums of each triangle, one per texel that it owns; none at all where nothing was
    /// added yet.
    pub(crate) fn with_sums(
        mesh: &TriMesh,
        layout: &AtlasLayout,
        triangles: Vec<(TriangleId, Vec<TexelSum>)>,
    ) -> Self {
        let num_texels = |triangle: TriangleId| {
            let corners = &layout.corners_texel[triangle.index()];
            let mut num_texels = 0;
            for_each_texel_within(corners, layout.page_size_texel, |_, _, _| num_texels += 1);
            num_texels
        };
        let num_sums: Vec<usize> = triangles
            .par_iter()
            .map(|(triangle, sums)| match sums.len() {
                0 => num_texels(*triangle),
                num_sums => num_sums,
            })
            .collect();
        let mut means = Self {
            triangles: triangles.iter().map(|(triangle, _)| *triangle).collect(),
            bounds: vec![],
            first: vec![0],
            sums: Vec::with_capacity(num_sums.iter().sum()),
            has_grown: vec![false; triangles.len()],
        };
        for ((_, mut sums), num_sums) in triangles.into_iter().zip(num_sums) {
            sums.resize(num_sums, TexelSum::default());
            means.sums.append(&mut sums);
            means.first.push(means.sums.len());
        }
        let chunks = means.triangles.chunks(TASK_SIZE);
        means.bounds = chunks
            .map(|chunk| BoundingBox::of(mesh, chunk.iter().copied()))
            .collect();
        means
    }

    /// The sums of each triangle; none at all of one of whose texels none was seen.
    pub(crate) fn into_sums(self) -> impl Iterator<Item = (TriangleId, Vec<TexelSum>)> {
        let Self {
            triangles,
            first,
            sums,
            ..
        } = self;
        let of_triangle = move |(index, triangle)| {
            let sums = &sums[first[index]..first[index + 1]];
            let is_seen = sums.iter().any(|sum| sum.weight > 0);
            (triangle, if is_seen { sums.to_vec() } else { Vec::new() })
        };
        triangles.into_iter().enumerate().map(of_triangle)
    }

    /// The triangles to whose sums a frame added.
    pub(crate) fn grown(&self) -> impl Iterator<Item = TriangleId> {
        let triangles = self.triangles.iter().zip(&self.has_grown);
        triangles.filter_map(|(triangle, has_grown)| has_grown.then_some(*triangle))
    }

    pub(super) fn is_empty(&self) -> bool {
        self.sums.is_empty()
    }

    /// Whether a camera may see one of the triangles past what is known to
    /// hide them.
    pub(super) fn any_visible(&self, mesh: &TriMesh, sight: &CameraSight<'_>) -> bool {
        let frustum = sight.frustum();
        let is_visible = |&triangle: &TriangleId| sight.corners(mesh, triangle).is_some();
        let mut chunks = self.triangles.chunks(TASK_SIZE).zip(&self.bounds);
        chunks
            .any(|(triangles, bounds)| frustum.may_see(bounds) && triangles.iter().any(is_visible))
    }

    /// Gives `each` the corners, in the camera, of the triangles that it may see past what is known to
    /// hide them.
    pub(super) fn each_visible(
        &self,
        mesh: &TriMesh,
        sight: &CameraSight<'_>,
        mut each: impl FnMut(&[Point3<f64>; 3]),
    ) {
        let frustum = sight.frustum();
        let chunks = self.triangles.chunks(TASK_SIZE).zip(&self.bounds);
        for (triangles, _) in chunks.filter(|(_, bounds)| frustum.may_see(bounds)) {
            let corners = triangles
                .iter()
                .filter_map(|&triangle| sight.corners(mesh, triangle));
            corners.for_each(|corners| each(&corners));
        }
    }

    /// How many texels have the triangles that a camera may see past what is known to hide them.
    pub(super) fn num_visible(&self, mesh: &TriMesh, sight: &CameraSight<'_>) -> usize {
        let frustum = sight.frustum();
        let mut num_texels = 0;
        for (task, bounds) in self.bounds.iter().enumerate() {
            let start = task * TASK_SIZE;
            let end = (start + TASK_SIZE).min(self.triangles.len());
            for index in (start..end).filter(|_| frustum.may_see(bounds)) {
                if sight.corners(mesh, self.triangles[index]).is_some() {
                    num_texels += self.first[index + 1] - self.first[index];
                }
            }
        }
        num_texels
    }

    /// Adds what a group of frames sees, frame by frame.
    pub(super) fn accumulate(
        &mut self,
        mesh: &TriMesh,
        layout: &AtlasLayout,
        looks: &[&FrameLook<'_>],
        params: &TransferParams,
    ) {
        let frustums: Vec<Frustum> = looks
            .iter()
            .map(|look| {
                let camera = &look.frame.color_camera;
                Frustum::new(camera, &look.pose.camera_from_world, params.far_m())
            })
            .collect();
        let mut tasks = vec![];
        let mut rest = self.sums.as_mut_slice();
        let chunks = self.triangles.chunks(TASK_SIZE).zip(&self.bounds);
        let chunks = chunks.zip(self.has_grown.chunks_mut(TASK_SIZE));
        for (task, ((triangles, bounds), has_grown)) in chunks.enumerate() {
            let start = task * TASK_SIZE;
            let firsts = &self.first[start..=start + triangles.len()];
            let (sums, tail) = rest.split_at_mut(firsts[triangles.len()] - firsts[0]);
            rest = tail;
            tasks.push(MeanTask {
                triangles,
                bounds,
                firsts,
                sums,
                has_grown,
            });
        }
        tasks.into_par_iter().for_each(|mut task| {
            let looks = looks.iter().zip(&frustums);
            for (look, _) in looks.filter(|(_, frustum)| frustum.may_see(task.bounds)) {
                task.add(mesh, layout, look, params);
            }
        });
    }

    /// Writes the means of the triangles that `is_written` picks, by whether a frame added to them, to
    /// the texels that no frame painted; returns how many got a colour and how many did not.
    pub(crate) fn write(
        &self,
        layout: &AtlasLayout,
        form: MeanForm,
        pages: &mut [SharedPage],
        is_written: impl Fn(bool) -> bool,
    ) -> (usize, usize) {
        let (mut num_mean, mut num_unseen) = (0, 0);
        let triangles = self.triangles.iter().zip(&self.first).zip(&self.has_grown);
        for ((&triangle, &first), _) in triangles.filter(|(_, grown)| is_written(**grown)) {
            let page = pages[layout.page_of(triangle) as usize].to_mut();
            let width = page.width as usize;
            let mut sums = self.sums[first..].iter();
            let corners = &layout.corners_texel[triangle.index()];
            for_each_texel_within(corners, layout.page_size_texel, |x, y, _| {
                let sum = sums.next();
                let index = y as usize * width + x as usize;
                if page.source[index] != TexelSource::NONE {
                    return;
                }
                if let Some(srgb) = sum.and_then(|sum| sum.srgb(form)) {
                    page.srgb[index] = srgb;
                    page.source[index] = TexelSource::MEAN;
                    page.confidence[index] = MEAN_CONFIDENCE;
                    num_mean += 1;
                } else {
                    num_unseen += 1;
                }
            });
        }
        (num_mean, num_unseen)
    }
}

impl MeanTask<'_> {
    fn add(
        &mut self,
        mesh: &TriMesh,
        layout: &AtlasLayout,
        look: &FrameLook<'_>,
        params: &TransferParams,
    ) {
        let ranges = self.firsts.windows(2).zip(&mut *self.has_grown);
        for (&triangle, (range, has_grown)) in self.triangles.iter().zip(ranges) {
            let range = range[0] - self.firsts[0]..range[1] - self.firsts[0];
            let sums = &mut self.sums[range];
            *has_grown |= add_triangle(mesh, layout, look, params, triangle, sums);
        }
    }
}

/// Whether some of the triangle may be in the image: its corners are not all outside of one side
/// of the view. The half-spaces go through the camera, so they hold behind it too.
fn may_see(camera: &PinholeCamera, corners_in_camera: &[Point3<f64>; 3]) -> bool {
    let [fx, fy, cx, cy] = camera.intrinsics_px();
    let (max_x, max_y) = (
        f64::from(camera.width() - 1),
        f64::from(camera.height() - 1),
    );
    let all = |is_outside: &dyn Fn(&Point3<f64>) -> bool| corners_in_camera.iter().all(is_outside);
    !all(&|p| p.z <= 0.0)
        && !all(&|p| fx * p.x + cx * p.z < 0.0)
        && !all(&|p| fx * p.x + (cx - max_x) * p.z > 0.0)
        && !all(&|p| fy * p.y + cy * p.z < 0.0)
        && !all(&|p| fy * p.y + (cy - max_y) * p.z > 0.0)
}

/// A camera, and what hides the mesh from it.
pub(super) struct CameraSight<'a> {
    pub(super) camera: &'a PinholeCamera,
    pub(super) pose: &'a CameraPose,
    /// How far it sees at most, where that is known.
    pub(super) bound: Option<&'a DepthBound>,
    pub(super) params: &'a TransferParams,
}

impl CameraSight<'_> {
    fn frustum(&self) -> Frustum {
        Frustum::new(
            self.camera,
            &self.pose.camera_from_world,
            self.params.far_m(),
        )
    }

    /// Corners of a triangle in the camera; `None` where none of it is seen.
    fn corners(&self, mesh: &TriMesh, triangle: TriangleId) -> Option<[Point3<f64>; 3]> {
        let corners = self.pose.corners_in_camera(mesh, triangle);
        if !may_see(self.camera, &corners) {
            return None;
        }
        let bound = self
            .bound
            .filter(|_| self.params.mean_form == MeanForm::Seeing);
        let projected = corners.map(|p| self.camera.project(&p));
        let is_hidden = match (bound, projected) {
            (Some(bound), [Some(a), Some(b), Some(c)]) => {
                let nearest_m = corners.iter().map(|p| p.z).fold(f64::INFINITY, f64::min);
                let slope_m = slope_m(self.camera, &corners);
                let params = &self.params.visibility;
                nearest_m > params.far_m || bound.hides(&[a, b, c], nearest_m, slope_m, params)
            }
            _ => false,
        };
        (!is_hidden).then_some(corners)
    }
}

/// Whether the frame adds to one of the triangle's sums.
fn add_triangle(
    mesh: &TriMesh,
    layout: &AtlasLayout,
    look: &FrameLook<'_>,
    params: &TransferParams,
    triangle: TriangleId,
    sums: &mut [TexelSum],
) -> bool {
    let camera = &look.frame.color_camera;
    let sight = CameraSight {
        camera,
        pose: &look.pose,
        bound: look.visibility.map(VisibilityBuffer::depth_bound),
        params,
    };
    let Some(corners) = sight.corners(mesh, triangle) else {
        return false;
    };
    let corners_texel = &layout.corners_texel[triangle.index()];
    let Some(sampler) = TriangleSampler::new(corners, corners_texel, camera, params) else {
        return false;
    };
    let visibility = match (params.mean_form, look.visibility) {
        (MeanForm::Projecting, _) => {
            add_projecting(layout, look, &sampler, corners_texel, sums);
            return true;
        }
        (MeanForm::Seeing, Some(visibility)) => visibility,
        (MeanForm::Seeing, None) => return false,
    };
    let mut has_grown = false;
    let depth = look.frame.depth.as_ref().map(DepthProbe::new);
    let mut sums = sums.iter_mut();
    for_each_texel_within(corners_texel, layout.page_size_texel, |_, _, weights| {
        let Some(sum) = sums.next() else { return };
        let texel = sampler.at(weights);
        let Some(point) = texel.point_inside() else {
            return;
        };
        if !visibility.is_visible(&point) {
            return;
        }
        let position = camera.unproject(point.position_px, point.depth_m);
        let difference_m = depth_difference_m(depth.as_ref(), &position, DepthCue::LargestRange);
        // Where nothing was measured the mesh decides.
        let is_measured_elsewhere =
            difference_m.is_finite() && difference_m > params.max_depth_difference_m;
        if !is_measured_elsewhere && let Some(linear) = texel.linear_color(&look.frame.color) {
            let is_clear = !visibility.is_near_depth_edge(&point);
            sum.add(linear, if is_clear { CLEAR_WEIGHT } else { 1 });
            has_grown = true;
        }
    });
    has_grown
}

/// Adds every texel that lies in the image, as it is.
fn add_projecting(
    layout: &AtlasLayout,
    look: &FrameLook<'_>,
    sampler: &TriangleSampler,
    corners_texel: &[[f32; 2]; 3],
    sums: &mut [TexelSum],
) {
    let mut sums = sums.iter_mut();
    for_each_texel_within(corners_texel, layout.page_size_texel, |_, _, weights| {
        let Some(sum) = sums.next() else { return };
        let texel = sampler.at(weights);
        if texel.point_inside().is_some()
            && let Some(srgb) = texel.color(&look.frame.color)
        {
            sum.add(srgb.map(|byte| f32::from(byte) / 255.0), 1);
        }
    });
}
