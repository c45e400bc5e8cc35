//! Texels of triangles that are painted otherwise than before, the unseen regions beside them, and
//! the gutters around them.

use std::collections::BTreeMap;
use std::sync::Arc;

use rayon::prelude::*;

use super::charts::{Dirt, StreamChart};
use super::cover::Cover;
use super::keyframes::Turnover;
use super::surface::SurfaceChange;
use super::unseen::UnseenRegions;
use super::view::KnownView;
use super::views::ViewSlot;
use super::{StreamInit, StreamUpdate};
use crate::atlas::gutter::Gutter;
use crate::atlas::{TexelSource, for_each_texel_within};
use crate::keyframe::Keyframe;
use crate::mesh::{TriMesh, TriangleId};
use crate::render::{BoundingBox, DepthBound};
use crate::texinit::assign::{Assignment, FramePose};
use crate::texinit::fill::{Coverage, FillPart, Surface, fill_triangles};
use crate::texinit::transfer::{
    KnownSight, MeanJob, MeanTexels, PaintJob, Painter, TexelSum, TransferMode,
};
use crate::texinit::{Decode, Observer};

/// What was painted.
pub(super) struct Repainted {
    /// Per chart: whether any of its texels may be another.
    pub(super) is_chart: Vec<bool>,
    /// Triangles whose own may be, ascending.
    triangles: Vec<TriangleId>,
}

/// What has to be painted.
#[derive(Default)]
struct Plan {
    /// Triangles none of whose texels stay, with the number of the keyframe that paints them.
    assigned: Vec<(u32, TriangleId)>,
    /// Triangles whose mean is taken anew over all keyframes.
    summed: Vec<TriangleId>,
    /// Triangles to whose sums new keyframes add.
    grown: Vec<(TriangleId, Vec<TexelSum>)>,
    /// Triangles that no keyframe paints by itself, none of whose texels stay.
    wiped: Vec<TriangleId>,
    /// The same where texels are blank already.
    blank: Vec<TriangleId>,
}

/// Triangles with texels that may be others than before.
struct Touched {
    /// With the number of their texels, all of which one keyframe painted.
    complete: Vec<(TriangleId, u32)>,
    others: Vec<TriangleId>,
}

impl StreamInit {
    /// Paints what is painted otherwise than before.
    #[expect(
        clippy::too_many_arguments,
        reason = "what a step of an update is given"
    )]
    pub(super) fn repaint(
        &mut self,
        frames: &[Arc<Keyframe>],
        turnover: &Turnover,
        change: &SurfaceChange,
        before: &[Option<Assignment>],
        views: &mut [ViewSlot],
        decode: &Decode<'_>,
        observer: &dyn Observer,
        update: &mut StreamUpdate,
    ) -> Repainted {
        let is_assigned = self.params.transfer.mode == TransferMode::Assigned;
        let may_grow = self.may_grow(change, turnover);
        let mesh = &self.mesh;
        let charts = self.charts.par_iter_mut().zip(&change.dirt);
        let plans = charts.zip(before).zip(&may_grow);
        let plans: Vec<Plan> = plans
            .map(|(((chart, dirt), before), may_grow)| {
                let sight = Sight {
                    mesh,
                    dirt,
                    covers: &change.covers,
                    may_grow,
                };
                Plan::of_chart(chart, &sight, before.as_ref(), turnover, is_assigned)
            })
            .collect();
        let plan = Plan::joined(plans);
        self.wipe(&plan.wiped, &|_| true);
        let blank = [plan.wiped.clone(), plan.blank.clone()].concat();
        let mut touched = self.paint(plan, frames, turnover, views, decode, observer);
        touched.others.extend(blank);
        update.num_triangles_painted = touched.complete.len() + touched.others.len();
        self.repainted(&touched)
    }

    /// Per chart, the triangles with a mean that a keyframe which came may add to, ascending.
    fn may_grow(&self, change: &SurfaceChange, turnover: &Turnover) -> Vec<Vec<u32>> {
        let params = self.view_params();
        let known = turnover.added.iter().filter_map(|&number| {
            let known = self.frames.get(number)?;
            let camera = known.camera.filter(|_| known.failure.is_none())?;
            let camera_from_world = known.pose.world_from_camera.inverse();
            Some((number, camera, camera_from_world, known.bound.as_deref()))
        });
        let known: Vec<_> = known.collect();
        let views = known.iter().map(|(number, camera, pose, bound)| {
            (*number, (KnownView::new(camera, pose, &params), *bound))
        });
        let views: BTreeMap<u32, (KnownView<'_>, Option<&DepthBound>)> = views.collect();
        let charts = self.charts.par_iter().zip(&change.dirt);
        let of_chart = |(chart, dirt): (&StreamChart, &Dirt)| -> Vec<u32> {
            let added: Vec<_> = (dirt.added.iter())
                .filter_map(|number| views.get(number))
                .collect();
            if added.is_empty() {
                return Vec::new();
            }
            let first = chart.first_triangle();
            let may_add = |number: &u32| {
                #[expect(clippy::cast_possible_truncation, reason = "a number in a mesh")]
                let triangle = TriangleId(first as u32 + number);
                let corners_m = self.mesh.corners_m(triangle);
                let bounds = BoundingBox::around(corners_m);
                added.iter().any(|(view, bound)| {
                    view.may_see(&bounds) && !view.hides(&view.in_camera(&corners_m), *bound)
                })
            };
            let with_means = chart.means.keys().copied();
            with_means.filter(may_add).collect()
        };
        charts.map(of_chart).collect()
    }

    /// Resets texels of some triangles, of some sources, to as if nobody had painted them.
    fn wipe(&mut self, triangles: &[TriangleId], is_wiped: &(dyn Fn(TexelSource) -> bool + Sync)) {
        let layout = &self.layout;
        let pages = self.texture.pages.par_iter_mut();
        pages.enumerate().for_each(|(number, page)| {
            let on_page = |triangle: &&TriangleId| layout.page_of(**triangle) as usize == number;
            let mut triangles = triangles.iter().filter(on_page).peekable();
            if triangles.peek().is_none() {
                return;
            }
            let page = page.to_mut();
            for triangle in triangles {
                let corners = &layout.corners_texel[triangle.index()];
                for_each_texel_within(corners, layout.page_size_texel, |x, y, _| {
                    let index = (y * page.width + x) as usize;
                    if is_wiped(page.source[index]) {
                        page.srgb[index] = [0; 3];
                        page.source[index] = TexelSource::NONE;
                        page.confidence[index] = 0;
                    }
                });
            }
        });
    }

    /// Paints; returns the triangles that were assigned to a keyframe, and those of [`Plan::grown`] to whose
    /// sums one added. Texels of triangles whose keyframe does not paint, because it no longer decodes,
    /// become blank.
    fn paint(
        &mut self,
        plan: Plan,
        frames: &[Arc<Keyframe>],
        turnover: &Turnover,
        views: &mut [ViewSlot],
        decode: &Decode<'_>,
        observer: &dyn Observer,
    ) -> Touched {
        let known = |frame: &Arc<Keyframe>| self.frames.get(frame.id.0);
        let is_usable: Vec<bool> = frames
            .iter()
            .map(|frame| known(frame).is_some_and(|known| known.failure.is_none()))
            .collect();
        let sight = |frame| {
            let known = known(frame);
            KnownSight {
                camera: known.and_then(|known| known.camera),
                bound: known.and_then(|known| known.bound.clone()),
            }
        };
        let sights: Vec<KnownSight> = frames.iter().map(sight).collect();
        let is_added = frames.iter().zip(&is_usable);
        let is_added: Vec<bool> = is_added
            .map(|(frame, is_usable)| *is_usable && turnover.added.contains(&frame.id.0))
            .collect();
        let mut by_frame = vec![Vec::new(); frames.len()];
        for &(number, triangle) in &plan.assigned {
            if let Ok(index) = frames.binary_search_by_key(&number, |frame| frame.id.0) {
                by_frame[index].push(triangle);
            }
        }
        let is_partly_hidden = |triangle: TriangleId| {
            let chart = &self.charts[self.layout.chart_of_triangle[triangle.index()].index()];
            let number = triangle.index() - chart.first_triangle();
            chart.labels.assignment().is_partly_hidden[number]
        };
        let (mesh, layout) = (&self.mesh, &self.layout);
        let job = PaintJob {
            by_frame,
            is_anew: true,
            means: vec![
                MeanJob {
                    texels: MeanTexels::new(mesh, layout, plan.summed.into_iter()),
                    counts: is_usable,
                },
                MeanJob {
                    texels: MeanTexels::with_sums(mesh, layout, plan.grown),
                    counts: is_added,
                },
            ],
            known: Some(&sights),
        };
        let painter = Painter {
            mesh,
            runs: &self.runs,
            layout,
            params: &self.params.transfer,
            is_partly_hidden: &is_partly_hidden,
        };
        let poses: Vec<FramePose> = frames.iter().map(|frame| (&**frame).into()).collect();
        let decode_at = |frame: usize| decode(&frames[frame]);
        let advance = |num_steps: usize| observer.advance(num_steps);
        let (pages, buffers) = (&mut self.texture.pages, &mut self.buffers);
        buffers.views = views.iter_mut().map(|slot| slot.view.take()).collect();
        let done = painter.paint_all(job, &poses, buffers, &decode_at, &advance, pages);
        for (slot, view) in views.iter_mut().zip(buffers.views.drain(..)) {
            slot.view = view;
        }
        let failed = done.report.failed_frames.iter();
        let failed: Vec<u32> = failed
            .map(|failed| frames[failed.frame as usize].id.0)
            .collect();
        let is_there = |number: &u32| frames.binary_search_by_key(number, |f| f.id.0).is_ok();
        let is_left = |number: &u32| !is_there(number) || failed.contains(number);
        let left = plan.assigned.iter().filter(|(number, _)| is_left(number));
        let left: Vec<TriangleId> = left.map(|(_, triangle)| *triangle).collect();
        self.wipe(&left, &|_| true);
        let [anew, grown] = [0, 1].map(|index: usize| &done.means[index].texels);
        let has_grown: Vec<TriangleId> = grown.grown().collect();
        // Until now these showed the means before.
        self.wipe(&has_grown, &|source| source.as_keyframe().is_none());
        let form = self.params.transfer.mean_form;
        let pages = &mut self.texture.pages;
        for means in [anew, grown] {
            means.write(&self.layout, form, pages, |has_grown| has_grown);
        }
        for (triangle, sums) in done
            .means
            .into_iter()
            .flat_map(|means| means.texels.into_sums())
        {
            let chart = &mut self.charts[self.layout.chart_of_triangle[triangle.index()].index()];
            let number = triangle.index() - chart.first_triangle();
            #[expect(clippy::cast_possible_truncation, reason = "a number in a mesh")]
            chart.means.insert(number as u32, sums);
        }
        Touched {
            complete: done.complete,
            others: [done.partly, left, has_grown].concat(),
        }
    }

    /// Counts the texels of what was painted anew, and marks the charts.
    fn repainted(&mut self, touched: &Touched) -> Repainted {
        let mut repainted = Repainted {
            is_chart: vec![false; self.charts.len()],
            triangles: Vec::new(),
        };
        let others: Vec<Coverage> = touched
            .others
            .par_iter()
            .map(|triangle| {
                let page = &self.texture.pages[self.layout.page_of(*triangle) as usize];
                Coverage::of(&self.layout.corners_texel[triangle.index()], page)
            })
            .collect();
        let complete = touched.complete.iter();
        let complete = complete.map(|&(triangle, num)| (triangle, Coverage::complete(num)));
        let others = touched.others.iter().copied().zip(others);
        for (triangle, coverage) in complete.chain(others) {
            let index = self.layout.chart_of_triangle[triangle.index()].index();
            repainted.is_chart[index] = true;
            repainted.triangles.push(triangle);
            let chart = &mut self.charts[index];
            let number = triangle.index() - chart.first_triangle();
            let before = std::mem::replace(&mut chart.coverage[number], coverage);
            if before.is_complete() != coverage.is_complete() {
                chart.unseen = None;
            }
        }
        repainted.triangles.sort_unstable();
        repainted.triangles.dedup();
        repainted
    }

    /// Fills the unseen regions at vertices where the surface or its texels changed.
    pub(super) fn fill_beside(&mut self, change: &SurfaceChange, repainted: &mut Repainted) {
        let corners = |triangle: &TriangleId| self.mesh.triangles()[triangle.index()];
        let of_painted = repainted.triangles.iter().flat_map(corners);
        let mut seeds: Vec<u32> = change.touched.iter().copied().chain(of_painted).collect();
        seeds.sort_unstable();
        seeds.dedup();
        if seeds.is_empty() {
            return;
        }
        let UnseenRegions { parts, lenders } = self.unseen_at(&seeds);
        if parts.is_empty() {
            return;
        }
        let coverage: Vec<&[Coverage]> = self.charts.iter().map(|chart| &*chart.coverage).collect();
        let surface = Surface {
            mesh: &self.mesh,
            // On the grid no two vertices have one position.
            representative: None,
        };
        let is_stale = |triangle: TriangleId| repainted.triangles.binary_search(&triangle).is_ok();
        let part = FillPart {
            coverage: &coverage,
            wanted: &parts,
            lenders: &lenders,
            is_stale: &is_stale,
        };
        let (layout, lent, params) = (&self.layout, &mut self.lent, &self.params.fill);
        let (_, charts) = fill_triangles(&surface, layout, &mut self.texture, &part, lent, params);
        for chart in charts {
            repainted.is_chart[chart] = true;
        }
    }

    /// Paints the gutters of the charts with other texels. All texels of a chart's triangles are painted
    /// by now, so that its gutter stays the same while the chart is where it is.
    pub(super) fn dilate(&mut self, change: &SurfaceChange, repainted: &Repainted) {
        if !self.params.has_gutters {
            return;
        }
        let pages = &mut self.texture.pages;
        let is_repainted = self.charts.par_iter_mut().zip(&repainted.is_chart);
        is_repainted
            .zip(&change.dirt)
            .filter(|((_, is_repainted), _)| **is_repainted)
            .for_each(|((chart, _), dirt)| {
                let placed = &chart.piece.chart;
                if dirt.is_relaid || chart.gutter.is_none() {
                    let page = pages.get(placed.page as usize);
                    chart.gutter = page.and_then(|page| Gutter::of(placed, page));
                }
            });
        let charts = self.charts.iter().zip(&repainted.is_chart);
        for (chart, _) in charts.filter(|(_, is_repainted)| **is_repainted) {
            let page = pages.get_mut(chart.piece.chart.page as usize);
            if let (Some(gutter), Some(page)) = (&chart.gutter, page) {
                gutter.paint(page.to_mut());
            }
        }
    }
}

/// What keyframes see otherwise than before in a chart.
struct Sight<'a> {
    mesh: &'a TriMesh,
    dirt: &'a Dirt,
    covers: &'a BTreeMap<u32, Cover>,
    /// Triangles with a mean that a keyframe which came may add to, ascending.
    may_grow: &'a [u32],
}

impl Sight<'_> {
    /// Whether a keyframe may see other parts of the triangle than before.
    fn is_resighted(&self, triangle: TriangleId) -> bool {
        let mut frames = self.dirt.resighted.iter();
        frames.any(|&frame| self.may_differ(triangle, frame))
    }

    fn may_differ(&self, triangle: TriangleId, frame: u32) -> bool {
        let cover = self.covers.get(&frame);
        cover.is_none_or(|cover| cover.meets(&self.mesh.corners_m(triangle)))
    }
}

impl Plan {
    fn joined(plans: Vec<Self>) -> Self {
        let mut all = Self::default();
        for plan in plans {
            all.assigned.extend(plan.assigned);
            all.summed.extend(plan.summed);
            all.grown.extend(plan.grown);
            all.wiped.extend(plan.wiped);
            all.blank.extend(plan.blank);
        }
        all
    }

    /// What is painted otherwise in a chart; takes the sums out that do not stay as they are.
    fn of_chart(
        chart: &mut StreamChart,
        sight: &Sight<'_>,
        before: Option<&Assignment>,
        turnover: &Turnover,
        is_assigned: bool,
    ) -> Self {
        let mut plan = Self::default();
        let dirt = sight.dirt;
        let is_same = before.is_none() && dirt.resighted.is_empty() && dirt.added.is_empty();
        let is_elsewhere = dirt.is_fresh || dirt.is_relaid;
        if is_same && !is_elsewhere && !dirt.is_moved() {
            return plan;
        }
        let first = chart.first_triangle();
        for number in 0..chart.len() {
            #[expect(clippy::cast_possible_truncation, reason = "numbers in a mesh")]
            let (triangle, number_u32) = (TriangleId((first + number) as u32), number as u32);
            let now = of_triangle(chart.labels.assignment(), number);
            let is_new = is_elsewhere
                || dirt.is_triangle_moved(number)
                || before.is_some_and(|before| of_triangle(before, number) != now);
            let (label, is_hidden) = now;
            let label = label.filter(|_| is_assigned);
            let needs_mean = label.is_none() || is_hidden;
            let keeps_sums = needs_mean && !is_new && !sight.is_resighted(triangle);
            if keeps_sums && chart.means.contains_key(&number_u32) {
                if sight.may_grow.binary_search(&number_u32).is_ok() {
                    let sums = chart.means.remove(&number_u32);
                    plan.grown.extend(sums.map(|sums| (triangle, sums)));
                }
                continue;
            }
            chart.means.remove(&number_u32);
            // What is partly hidden shows a mean too, and is painted with that.
            let is_other = |frame: u32| turnover.moved.contains(&frame);
            let paints = is_new || label.is_some_and(is_other);
            match label {
                Some(frame) if needs_mean || paints => plan.assigned.push((frame, triangle)),
                None if dirt.is_fresh => plan.blank.push(triangle),
                None => plan.wiped.push(triangle),
                Some(_) => {}
            }
            if needs_mean {
                plan.summed.push(triangle);
            }
        }
        plan
    }
}

/// Which keyframe paints a triangle, and whether part of it is hidden there.
fn of_triangle(assignment: &Assignment, number: usize) -> (Option<u32>, bool) {
    (
        assignment.label[number],
        assignment.is_partly_hidden[number],
    )
}
