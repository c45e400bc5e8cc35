//! One frame's column of scores: every cue but C3, and the colours that C3 will compare.

use crate::geom::camera::CameraError;
use crate::keyframe::DecodedFrame;
use crate::mesh::TriMesh;
use crate::render::{
    DepthBound, KeptView, MeshPart, MeshRuns, PixelWindow, ViewScratch, VisibilityBuffer,
    WindowFinder,
};

use super::validity::{
    DepthProbe, TriangleView, TriangleVisibility, VertexView, depth_difference_m, view_vertices,
};
use super::{AssignParams, ColorCue, DepthCue, FramePose};

/// The resolution cue is 0 at this many pixels per metre.
const REFERENCE_PX_PER_M: f64 = 100.0;

/// Corners and centroid are tested for depth edges.
const EDGE_TESTS_PER_TRIANGLE: usize = 4;

/// The sum of three sRGB colours, ten bits a channel; the top bit is free for a mark.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct TripleColor(u32);

impl TripleColor {
    fn new(colors: [[u8; 3]; 3], is_marked: bool) -> Self {
        let sums: [u32; 3] =
            std::array::from_fn(|c| colors.iter().map(|color| u32::from(color[c])).sum());
        Self(u32::from(is_marked) << 31 | sums[0] << 20 | sums[1] << 10 | sums[2])
    }

    /// Sums of three bytes.
    pub(crate) fn sums(self) -> [u32; 3] {
        [
            (self.0 >> 20) & 0x3ff,
            (self.0 >> 10) & 0x3ff,
            self.0 & 0x3ff,
        ]
    }
}

/// One triangle in one frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Candidate {
    pub(crate) triangle: u32,
    /// All cues but C3 and the frame's own.
    pub(crate) score: f32,
    /// Projected area in px² of the image.
    pub(crate) area_px2: f32,
    /// Colours at the three vertices, marked where part of the triangle is hidden.
    pub(crate) colors: TripleColor,
}

impl Candidate {
    /// Whether part of the triangle is hidden in the frame.
    pub(crate) fn is_partly_hidden(&self) -> bool {
        self.colors.0 >> 31 != 0
    }
}

/// What one frame says of all triangles.
#[derive(Clone, Debug, PartialEq, Default)]
pub(crate) struct FrameCandidates {
    /// By triangle, ascending; those that the empty label beats are left out.
    pub(crate) candidates: Vec<Candidate>,
    /// Colours at the vertices of valid triangles, for [`ColorCue::ValidAtVertex`].
    pub(crate) vertex_colors: Vec<(u32, [u8; 3])>,
    /// Colours of valid triangles, for [`ColorCue::ValidForTriangle`].
    pub(crate) valid_colors: Vec<(u32, TripleColor)>,
}

impl FrameCandidates {
    /// The same with what a newer column says of some triangles, ascending.
    pub(crate) fn renewed(&self, triangles: &[u32], newer: Self) -> Self {
        let is_old = |triangle: u32| triangles.binary_search(&triangle).is_err();
        let kept = self.candidates.iter().filter(|c| is_old(c.triangle));
        let mut candidates: Vec<Candidate> = kept.copied().chain(newer.candidates).collect();
        candidates.sort_unstable_by_key(|candidate| candidate.triangle);
        candidates.shrink_to_fit();
        let kept = self.valid_colors.iter().filter(|(t, _)| is_old(*t));
        let mut valid_colors: Vec<_> = kept.copied().chain(newer.valid_colors).collect();
        valid_colors.sort_unstable_by_key(|(triangle, _)| *triangle);
        Self {
            candidates,
            valid_colors,
            // Those couple charts, and are not kept up.
            vertex_colors: newer.vertex_colors,
        }
    }

    /// Names the triangles of which another column says something else; some of them twice.
    pub(crate) fn each_difference(&self, other: &Self, mut each: impl FnMut(u32)) {
        let [here, there] = [&self.candidates, &other.candidates];
        each_unequal(here, there, |candidate| candidate.triangle, &mut each);
        let [here, there] = [&self.valid_colors, &other.valid_colors];
        each_unequal(here, there, |(triangle, _)| *triangle, &mut each);
    }

    /// What it says of the triangles that have another number, by these. What it says of vertices is
    /// left out.
    pub(crate) fn renumbered(&self, number: impl Fn(u32) -> Option<u32>) -> Self {
        let candidates = self.candidates.iter().filter_map(|candidate| {
            number(candidate.triangle).map(|triangle| Candidate {
                triangle,
                ..*candidate
            })
        });
        let mut candidates: Vec<Candidate> = candidates.collect();
        candidates.sort_unstable_by_key(|candidate| candidate.triangle);
        let valid_colors = self.valid_colors.iter();
        let mut valid_colors: Vec<_> = valid_colors
            .filter_map(|(triangle, colors)| Some((number(*triangle)?, *colors)))
            .collect();
        valid_colors.sort_unstable_by_key(|(triangle, _)| *triangle);
        Self {
            candidates,
            vertex_colors: Vec::new(),
            valid_colors,
        }
    }

    /// Whether it says nothing.
    pub(crate) fn is_empty(&self) -> bool {
        self.candidates.is_empty() && self.vertex_colors.is_empty() && self.valid_colors.is_empty()
    }

    /// Bytes that it takes.
    pub(crate) fn num_bytes(&self) -> usize {
        size_of_val(&*self.candidates)
            + size_of_val(&*self.vertex_colors)
            + size_of_val(&*self.valid_colors)
    }
}

/// Names what is in one of two lists, or different in them; both ascend by name, each once.
fn each_unequal<T: PartialEq>(
    here: &[T],
    there: &[T],
    name: impl Fn(&T) -> u32,
    each: &mut impl FnMut(u32),
) {
    let (mut here, mut there) = (here.iter().peekable(), there.iter().peekable());
    loop {
        match (here.peek(), there.peek()) {
            (Some(a), Some(b)) if name(a) == name(b) => {
                if a != b {
                    each(name(a));
                }
                here.next();
                there.next();
            }
            (Some(a), b) if b.is_none_or(|b| name(a) < name(b)) => {
                each(name(a));
                here.next();
            }
            (_, Some(b)) => {
                each(name(b));
                there.next();
            }
            (_, None) => break,
        }
    }
}

/// Scratch memory of [`score_frame`].
#[derive(Debug, Default)]
pub(crate) struct FrameWorkspace {
    vertices: Vec<VertexView>,
    visibility: VisibilityBuffer,
    /// For views that are kept.
    pub(crate) view: ViewScratch,
}

impl FrameWorkspace {
    /// How far the frame sees at most that was scored last, with visibility.
    pub(crate) fn depth_bound(&self) -> &DepthBound {
        self.visibility.depth_bound()
    }
}

/// Scores every triangle that the frame may paint.
pub(crate) fn score_frame(
    mesh: &TriMesh,
    runs: &MeshRuns,
    pose: &FramePose,
    frame: &DecodedFrame,
    params: &AssignParams,
    workspace: &mut FrameWorkspace,
) -> Result<FrameCandidates, CameraError> {
    let camera_from_world = pose.world_from_camera.inverse();
    let in_view = runs.in_view(&frame.color_camera, &camera_from_world, params.far_m());
    let whole = params
        .visibility
        .as_ref()
        .map(|visibility| WindowFinder::new(&frame.color_camera, visibility).whole());
    let sight = PartSight {
        part: &in_view,
        occluders: Occluders::Drawn(&in_view),
        window: whole.unwrap_or_default(),
    };
    score_part(mesh, &sight, pose, frame, params, workspace)
}

/// A part of the mesh, and what may hide it.
pub(crate) struct PartSight<'a> {
    pub(crate) part: &'a MeshPart,
    pub(crate) occluders: Occluders<'a>,
    /// Where in the visibility buffer the part lies.
    pub(crate) window: PixelWindow,
}

/// What may hide a part of the mesh.
#[derive(Clone, Copy)]
pub(crate) enum Occluders<'a> {
    /// All that may show in the window, to be drawn.
    Drawn(&'a MeshPart),
    /// Depths of all that shows.
    Kept(&'a KeptView),
}

/// Scores those of the triangles of a part that the frame may paint.
pub(crate) fn score_part(
    mesh: &TriMesh,
    sight: &PartSight<'_>,
    pose: &FramePose,
    frame: &DecodedFrame,
    params: &AssignParams,
    workspace: &mut FrameWorkspace,
) -> Result<FrameCandidates, CameraError> {
    let camera_from_world = pose.world_from_camera.inverse();
    let FrameWorkspace {
        vertices,
        visibility,
        ..
    } = workspace;
    let part = sight.part;
    view_vertices(mesh, part, &camera_from_world, frame, params, vertices);
    if let Some(visibility_params) = &params.visibility {
        let camera = &frame.color_camera;
        match sight.occluders {
            Occluders::Drawn(part) => visibility.update_window(
                mesh,
                part,
                camera,
                &camera_from_world,
                visibility_params,
                sight.window,
            )?,
            Occluders::Kept(view) => {
                let num_edge_tests = EDGE_TESTS_PER_TRIANGLE * part.num_triangles();
                let window = sight.window;
                visibility.load(view, camera, visibility_params, window, num_edge_tests)?;
            }
        }
    }
    let scorer = Scorer::new(frame, params);
    let mut out = FrameCandidates::default();
    let mut is_valid_vertex = match params.color_cue {
        ColorCue::ValidAtVertex => vec![false; vertices.len()],
        ColorCue::SeeingFrames | ColorCue::ValidForTriangle => vec![],
    };
    for (triangle, indices) in part.triangles(mesh) {
        let corners = indices.map(|v| vertices[v as usize]);
        let Some(view) = TriangleView::new(corners, &frame.color_camera) else {
            continue;
        };
        for &vertex in indices {
            if let Some(is_valid) = is_valid_vertex.get_mut(vertex as usize) {
                *is_valid = true;
            }
        }
        if params.color_cue == ColorCue::ValidForTriangle {
            let colors = TripleColor::new(corners.map(|corner| corner.srgb), false);
            out.valid_colors.push((triangle, colors));
        }
        let seen = match &params.visibility {
            Some(_) => view.visibility(&frame.color_camera, visibility),
            None => Some(TriangleVisibility::default()),
        };
        let Some(seen) = seen else { continue };
        let differences_m = indices.map(|v| scorer.depth_difference_at(&mut vertices[v as usize]));
        let score = scorer.score(&view, &seen, differences_m);
        if score > params.empty_score {
            #[expect(clippy::cast_possible_truncation, reason = "rounding to f32 is meant")]
            let area_px2 = view.area_px2 as f32;
            out.candidates.push(Candidate {
                triangle,
                score,
                area_px2,
                colors: TripleColor::new(
                    corners.map(|corner| corner.srgb),
                    seen.hidden_share > 0.0,
                ),
            });
        }
    }
    out.candidates.shrink_to_fit();
    out.vertex_colors = (0u32..)
        .zip(&is_valid_vertex)
        .filter(|(_, is_valid)| **is_valid)
        .map(|(vertex, _)| (vertex, vertices[vertex as usize].srgb))
        .collect();
    Ok(out)
}

struct Scorer<'a> {
    params: &'a AssignParams,
    frame: &'a DecodedFrame,
    depth: Option<DepthProbe<'a>>,
    area_scale: f64,
    min_sin_elevation: f64,
}

impl<'a> Scorer<'a> {
    fn new(frame: &'a DecodedFrame, params: &'a AssignParams) -> Self {
        let width_px = f64::from(frame.color_camera.width());
        let area_scale = params
            .reference_width_px
            .map_or(1.0, |reference| (f64::from(reference) / width_px).powi(2));
        Self {
            params,
            frame,
            depth: frame.depth.as_ref().map(DepthProbe::new),
            area_scale,
            min_sin_elevation: f64::from(params.min_elevation_rad).sin(),
        }
    }

    #[expect(clippy::cast_possible_truncation, reason = "rounding to f32 is meant")]
    fn score(
        &self,
        view: &TriangleView,
        seen: &TriangleVisibility,
        differences_m: [f32; 3],
    ) -> f32 {
        let params = self.params;
        let mut score = params.area_weight * (view.area_px2 * self.area_scale) as f32
            + params.depth_weight * self.depth_difference_m(view, differences_m);
        if params.resolution_weight > 0.0 {
            score += params.resolution_weight * self.log2_resolution(view) as f32;
        }
        score -= params.hidden_penalty * seen.hidden_share;
        if seen.is_near_depth_edge {
            score -= params.depth_edge_penalty;
        }
        if view.sin_elevation.abs() < self.min_sin_elevation {
            score -= params.grazing_penalty;
        }
        if view.sin_elevation < 0.0 {
            score -= params.back_face_penalty;
        }
        score
    }

    fn depth_difference_at(&self, vertex: &mut VertexView) -> f32 {
        vertex.depth_difference_m(self.depth.as_ref(), self.params.depth_cue)
    }

    /// C2, from the differences at the corners.
    fn depth_difference_m(&self, view: &TriangleView, at_corners_m: [f32; 3]) -> f32 {
        let params = self.params;
        let centroid = &view.centroid_in_camera;
        let at_centroid = depth_difference_m(self.depth.as_ref(), centroid, params.depth_cue);
        let differences = at_corners_m.into_iter().chain([at_centroid]);
        let or_unmeasured = |difference_m: f32| {
            if difference_m.is_infinite() {
                params.unmeasured_depth_difference_m
            } else {
                difference_m
            }
        };
        let is_rejection = |difference_m: f32| {
            difference_m.is_finite() && difference_m > params.max_depth_difference_m
        };
        match params.depth_cue {
            DepthCue::LargestRange => differences
                .map(|difference_m| {
                    if is_rejection(difference_m) {
                        params.rejected_depth_difference_m
                    } else {
                        or_unmeasured(difference_m)
                    }
                })
                .fold(0.0, f32::max),
            DepthCue::DepthSum => differences.map(or_unmeasured).sum(),
        }
    }

    /// Pixels per metre across the foreshortened surface, as doublings of the reference. It is
    /// taken from the geometry and not from the projected area, which rounding spoils for slivers.
    fn log2_resolution(&self, view: &TriangleView) -> f64 {
        let [fx, fy, _, _] = self.frame.color_camera.intrinsics_px();
        let depth_m = view.centroid_in_camera.z;
        let px2_per_m2 = fx * fy / (depth_m * depth_m) * view.sin_elevation.abs().max(1e-3);
        let doublings = 0.5 * (px2_per_m2 / (REFERENCE_PX_PER_M * REFERENCE_PX_PER_M)).log2();
        doublings.clamp(-10.0, 10.0)
    }
}
