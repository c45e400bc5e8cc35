//! Scores of what is new, of what moved, and of what others may hide or uncover; then labels.

use std::collections::BTreeMap;
use std::ops::Range;
use std::sync::Arc;

use rayon::prelude::*;

use super::charts::StreamChart;
use super::cover::{Cover, Shown, TouchedSurface};
use super::keyframes::Turnover;
use super::surface::SurfaceChange;
use super::view::KnownView;
use super::views::ViewSlot;
use super::{StreamInit, StreamUpdate};
use crate::geom::camera::CameraError;
use crate::geom::{Distortion, PinholeCamera};
use crate::keyframe::Keyframe;
use crate::render::{
    BoundingBox, DepthBound, Frustum, KeptView, MeshPart, ViewPoint, ViewScratch, WindowFinder,
};
use crate::texinit::assign::Assignment;
use crate::texinit::assign::chart_table::split_by_chart;
use crate::texinit::assign::cues::{
    FrameCandidates, FrameWorkspace, Occluders, PartSight, score_part,
};
use crate::texinit::{Decode, Observer};

/// Blocks of a visibility buffer, each way, that are kept as one.
const BOUND_FACTOR: usize = 2;

/// Charts that are looked at together: those of one time lie near each other, and a keyframe sees few of a
/// large scan.
const GROUP_SIZE: usize = 64;

/// What a keyframe was found to see.
struct Sighting {
    camera: PinholeCamera,
    /// What was looked at, ascending by chart.
    charts: Vec<Looked>,
    /// What it says of that, by chart; nothing of what it may not paint.
    parts: BTreeMap<u32, FrameCandidates>,
    /// Where what it sees may have changed, in the image of a keyframe that stayed.
    cover: Option<Cover>,
    /// How far it sees at most, where that is known.
    bound: Option<DepthBound>,
}

/// Triangles of a chart that were looked at.
struct Looked {
    chart: usize,
    /// Their numbers in the chart, ascending; what the keyframe said of others stays.
    triangles: Vec<u32>,
}

/// What all keyframes look at.
struct Scoring<'a> {
    state: &'a StreamInit,
    turnover: &'a Turnover,
    change: &'a SurfaceChange,
    touched: TouchedSurface<'a>,
    /// Around all surface that came, went or moved; `None` where there is none.
    changed_bounds: Option<BoundingBox>,
    /// Around [`GROUP_SIZE`] charts each.
    group_bounds: Vec<BoundingBox>,
    decode: &'a Decode<'a>,
}

impl StreamInit {
    /// Scores charts in keyframes wherever one of the two, or what lies between them, is another than
    /// before.
    #[expect(
        clippy::too_many_arguments,
        reason = "what a step of an update is given"
    )]
    pub(super) fn score(
        &mut self,
        frames: &[Arc<Keyframe>],
        turnover: &Turnover,
        change: &mut SurfaceChange,
        views: &mut [ViewSlot],
        decode: &Decode<'_>,
        observer: &dyn Observer,
        update: &mut StreamUpdate,
    ) {
        let scoring = Scoring {
            state: self,
            turnover,
            change,
            touched: TouchedSurface::new(&change.gone, &change.came),
            changed_bounds: self.changed_bounds(change),
            group_bounds: self.charts.chunks(GROUP_SIZE).map(around_charts).collect(),
            decode,
        };
        let sightings: Vec<Result<Option<Sighting>, String>> = frames
            .par_iter()
            .zip(views)
            .map(|(keyframe, view)| {
                let sighting = self
                    .workspaces
                    .with(|workspace| scoring.look(keyframe, view, workspace));
                observer.advance(1);
                sighting
            })
            .collect();
        for (keyframe, sighting) in frames.iter().zip(sightings) {
            let number = keyframe.id.0;
            match sighting {
                Ok(Some(sighting)) => {
                    update.num_pairs_scored += sighting.charts.len();
                    self.take_sighting(number, keyframe, sighting, turnover, change);
                }
                Ok(None) => {}
                Err(reason) => self.fail(number, reason, change),
            }
        }
    }

    /// Around charts that have to be scored and surface that may hide others.
    fn changed_bounds(&self, change: &SurfaceChange) -> Option<BoundingBox> {
        let charts = self.charts.iter().zip(&change.dirt);
        let to_score = charts.filter(|(_, dirt)| dirt.has_unscored());
        let corners = to_score.flat_map(|(chart, _)| chart.bounds.corners_m());
        let touched = change.gone.iter().chain(&change.came).flatten();
        let mut points = corners.chain(touched.copied());
        let first = points.next()?;
        Some(BoundingBox::around(std::iter::once(first).chain(points)))
    }

    fn take_sighting(
        &mut self,
        number: u32,
        keyframe: &Keyframe,
        mut sighting: Sighting,
        turnover: &Turnover,
        change: &mut SurfaceChange,
    ) {
        if let Some(known) = self.frames.get_mut(number) {
            known.camera = Some(sighting.camera);
            known.bound = sighting.bound.take().map(Arc::new);
        }
        let is_resighted = turnover.moved.contains(&number) || sighting.cover.is_some();
        if let Some(cover) = sighting.cover.take() {
            change.covers.insert(number, cover);
        }
        for Looked {
            chart: index,
            triangles,
        } in sighting.charts
        {
            let (chart, dirt) = (&mut self.charts[index], &mut change.dirt[index]);
            #[expect(clippy::cast_possible_truncation, reason = "fewer than triangles")]
            let newer = sighting.parts.remove(&(index as u32));
            let newer = newer.unwrap_or_default();
            let labels = &mut chart.labels;
            labels.renew(number, keyframe.quality, &triangles, newer);
            if turnover.added.contains(&number) {
                chart.num_looks += 1;
                dirt.added.insert(number);
            } else if is_resighted {
                dirt.resighted.insert(number);
            }
        }
    }

    /// A keyframe does not decode: it paints nothing.
    fn fail(&mut self, number: u32, reason: String, change: &mut SurfaceChange) {
        let Some(known) = self.frames.get(number).cloned() else {
            return;
        };
        self.forget(number, &known, change);
        if let Some(known) = self.frames.get_mut(number) {
            known.failure = Some(reason);
        }
    }

    /// Labels every chart with other scores; returns, per chart, what it was assigned before where that
    /// is another.
    pub(super) fn label(&mut self) -> Vec<Option<Assignment>> {
        let (mesh, params) = (&self.mesh, &self.params.assign);
        let hysteresis = self.stream.hysteresis;
        self.charts
            .par_iter_mut()
            .map(|chart| {
                let first = *chart.piece.chart.triangles.first()?;
                chart.labels.assign(mesh, first, params, hysteresis)
            })
            .collect()
    }
}

impl Scoring<'_> {
    /// Scores what has to be scored in a keyframe; `None` for one that is known to be unusable.
    fn look(
        &self,
        keyframe: &Keyframe,
        slot: &mut ViewSlot,
        workspace: &mut FrameWorkspace,
    ) -> Result<Option<Sighting>, String> {
        let Some(known) = self.state.frames.get(keyframe.id.0) else {
            return Ok(None);
        };
        if known.failure.is_some() {
            return Ok(None);
        }
        let decode = || (self.decode)(keyframe).map_err(|error| error.to_string());
        let mut decoded = None;
        let model = &keyframe.color_camera;
        let is_as_decoded = model.distortion == Distortion::None;
        let camera = match known.camera.or(is_as_decoded.then_some(model.pinhole)) {
            Some(camera) => camera,
            None => decoded.insert(decode()?).color_camera,
        };
        let camera_from_world = known.pose.world_from_camera.inverse();
        let params = self.state.view_params();
        let view = KnownView::new(&camera, &camera_from_world, &params);
        let mut bound = known.bound.as_deref().cloned();
        let mut finder = WindowFinder::new(&camera, &params);
        let to_string = |error: CameraError| error.to_string();
        let own_camera = finder.buffer_camera(&camera).map_err(to_string)?;
        let mut cover = None;
        if let Some((found, shown)) = self.cover(keyframe.id.0, &view, &mut bound) {
            cover = Some(found).filter(|cover| !cover.is_empty());
            if let Some(kept) = &mut slot.view {
                let from = ViewPoint {
                    camera: &own_camera,
                    camera_from_world: &camera_from_world,
                };
                change_view(kept, &shown, &view, from, finder, &mut workspace.view);
            }
        }
        let charts = self.charts_to_score(
            keyframe.id.0,
            &view,
            cover.as_ref(),
            bound.as_ref(),
            &mut finder,
        );
        let mut sighting = Sighting {
            camera,
            charts,
            parts: BTreeMap::new(),
            cover,
            bound,
        };
        let is_unseen = self.turnover.is_unseen(keyframe.id.0);
        let window = match is_unseen {
            true => finder.whole(),
            false => finder.window(),
        };
        if sighting.charts.is_empty() || window.is_empty() {
            // Whether it decodes has to be known of every keyframe.
            if known.camera.is_none() && decoded.is_none() {
                decode()?;
            }
            return Ok(Some(sighting));
        }
        let (mesh, params) = (&self.state.mesh, &self.state.params.assign);
        let (drawing, scratch) = (self.state.drawing(), &mut workspace.view);
        // Few keyframes come at a time, and the other cores would wait for the last of them.
        let (frame, drawn) = rayon::join(
            || decoded.map_or_else(decode, Ok),
            || slot.bring_up(&drawing, &camera, &camera_from_world, &finder, scratch),
        );
        let frame = frame.inspect_err(|_| slot.view = None)?;
        drawn.map_err(to_string)?;
        let drawn = match &slot.view {
            Some(_) => MeshPart::default(),
            None => self.state.runs.in_frustum(&Frustum::of_window(
                &own_camera,
                &camera_from_world,
                params.far_m(),
                window,
            )),
        };
        let sight = PartSight {
            part: &MeshPart::of_runs(mesh, self.runs(&sighting.charts)),
            occluders: match &slot.view {
                Some(view) => Occluders::Kept(view),
                None => Occluders::Drawn(&drawn),
            },
            window,
        };
        let scored = score_part(mesh, &sight, &known.pose, &frame, params, workspace)
            .map_err(|error| error.to_string())?;
        sighting.parts = split_by_chart(scored, |triangle| self.place_of(triangle));
        if self.state.has_bounds() {
            let newer = workspace.depth_bound().coarser(BOUND_FACTOR);
            match &mut sighting.bound {
                Some(bound) => bound.renew(&newer),
                None => sighting.bound = Some(newer).filter(|_| is_unseen),
            }
        }
        Ok(Some(sighting))
    }

    /// Where surface came or went in the image of a keyframe that stayed.
    fn cover(
        &self,
        number: u32,
        view: &KnownView<'_>,
        bound: &mut Option<DepthBound>,
    ) -> Option<(Cover, Shown)> {
        if self.turnover.is_unseen(number) {
            return None;
        }
        self.touched.cover(view, self.reach_px(view.camera), bound)
    }

    fn charts_to_score(
        &self,
        number: u32,
        view: &KnownView<'_>,
        cover: Option<&Cover>,
        bound: Option<&DepthBound>,
        window: &mut WindowFinder,
    ) -> Vec<Looked> {
        let may_matter = |bounds: &BoundingBox| view.may_see(bounds);
        let is_unseen = self.turnover.is_unseen(number);
        if !is_unseen && !self.changed_bounds.as_ref().is_some_and(may_matter) {
            return Vec::new();
        }
        let mut looked = Vec::new();
        for (index, chart) in self.charts_in(view) {
            let dirt = &self.change.dirt[index];
            let cover = cover.filter(|cover| cover.meets(&chart.bounds.corners_m()));
            if !is_unseen && !dirt.has_unscored() && cover.is_none() {
                continue;
            }
            let mut triangles = Vec::new();
            if is_unseen && bound.is_none() {
                triangles.extend((0_u32..).take(chart.len()));
            }
            for (triangle, of_chart) in (0_u32..).zip(&*chart.piece.chart.triangles) {
                let is_unscored = is_unseen || dirt.is_unscored(triangle as usize);
                if (is_unseen && bound.is_none()) || !(is_unscored || cover.is_some()) {
                    continue;
                }
                let corners_m = self.state.mesh.corners_m(*of_chart);
                let in_camera = view.in_camera(&corners_m);
                let may_differ = || cover.is_some_and(|cover| cover.meets_in_camera(&in_camera));
                if (is_unscored || may_differ()) && !view.hides(&in_camera, bound) {
                    triangles.push(triangle);
                    if !is_unseen {
                        window.include(view.corners_px(&in_camera));
                    }
                }
            }
            if !triangles.is_empty() {
                looked.push(Looked {
                    chart: index,
                    triangles,
                });
            }
        }
        looked
    }

    /// The charts that a view may see, ascending.
    fn charts_in<'a>(
        &'a self,
        view: &'a KnownView<'_>,
    ) -> impl Iterator<Item = (usize, &'a StreamChart)> + 'a {
        let groups = self.state.charts.chunks(GROUP_SIZE).zip(&self.group_bounds);
        let seen = groups
            .enumerate()
            .filter(|(_, (_, bounds))| view.may_see(bounds));
        let charts = seen.flat_map(|(group, (charts, _))| (group * GROUP_SIZE..).zip(charts));
        charts.filter(|(_, chart)| view.may_see(&chart.bounds))
    }

    /// Triangles of the mesh that were looked at, in runs.
    #[expect(
        clippy::cast_possible_truncation,
        reason = "a mesh has 32 bits of triangles"
    )]
    fn runs(&self, looked: &[Looked]) -> Vec<Range<u32>> {
        let mut runs: Vec<Range<u32>> = Vec::new();
        for Looked { chart, triangles } in looked {
            let first = self.state.charts[*chart].first_triangle() as u32;
            for triangle in triangles.iter().map(|number| first + number) {
                match runs.last_mut() {
                    Some(run) if run.end == triangle => run.end += 1,
                    _ => runs.push(triangle..triangle + 1),
                }
            }
        }
        runs
    }

    /// The chart of a triangle, and its number there: charts have their triangles in a row.
    #[expect(clippy::cast_possible_truncation, reason = "numbers in a mesh")]
    fn place_of(&self, triangle: u32) -> [u32; 2] {
        let chart = self.state.layout.chart_of_triangle[triangle as usize];
        let first = self.state.charts[chart.index()].first_triangle() as u32;
        [chart.0, triangle - first]
    }

    /// How far from its outline surface may matter to others, for scores and for means.
    fn reach_px(&self, camera: &PinholeCamera) -> f64 {
        let params = &self.state.params;
        let of_means = params.transfer.visibility.reach_px(camera);
        let of_scores = params.assign.visibility.as_ref();
        of_scores.map_or(of_means, |scores| of_means.max(scores.reach_px(camera)))
    }
}

fn around_charts(charts: &[StreamChart]) -> BoundingBox {
    BoundingBox::around_all(charts.iter().map(|chart| &chart.bounds))
}

/// Brings a view that is kept up to surface that came or went.
fn change_view(
    kept: &mut KeptView,
    shown: &Shown,
    view: &KnownView<'_>,
    from: ViewPoint<'_>,
    nothing: WindowFinder,
    scratch: &mut ViewScratch,
) {
    let mut gone = nothing;
    for &corners_px in &shown.gone_px {
        gone.include(corners_px);
    }
    kept.forget(gone.window());
    let mut came = nothing;
    for corners_m in &shown.came {
        came.include(view.corners_px(&view.in_camera(corners_m)));
    }
    kept.add(&shown.came, came.window(), from, scratch);
}
