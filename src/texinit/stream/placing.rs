//! New charts onto pages: at which density, and what happens where there is no room.

use std::sync::Arc;

use super::charts::{StreamChart, StreamChartId};
use super::surface::SurfaceChange;
use super::{StreamError, StreamInit, StreamUpdate};
use crate::atlas::{ChartPlacer, PackError, PackParams, PlacedPiece, PlaneChart, TexturePage};
use crate::keyframe::Keyframe;
use crate::mesh::TriangleId;
use crate::texinit::assign::AssignParams;
use crate::texinit::flatten::FlatChart;
use crate::texinit::{Decode, assign, density};

/// Steps of density in an octave.
const DENSITY_STEPS: f64 = 4.0;
/// Steps that the density falls at most, 16 octaves: then not even the gutters fit.
const MAX_FALLS: usize = 64;

/// A chart in the plane.
struct Shape {
    triangles: Vec<TriangleId>,
    /// Per triangle, metres, y up.
    corners_m: Vec<[[f64; 2]; 3]>,
}

impl Shape {
    /// That of a chart that lies on a page, from there.
    fn of(piece: &PlacedPiece, texels_per_m: f64) -> Self {
        let in_m = |[x, y]: [f32; 2]| [f64::from(x) / texels_per_m, -f64::from(y) / texels_per_m];
        Self {
            triangles: piece.chart.triangles.clone(),
            corners_m: piece
                .corners_texel
                .iter()
                .map(|corners| corners.map(in_m))
                .collect(),
        }
    }
}

impl PlaneChart for Shape {
    fn triangles(&self) -> &[TriangleId] {
        &self.triangles
    }

    fn corners_m(&self) -> &[[[f64; 2]; 3]] {
        &self.corners_m
    }
}

impl StreamInit {
    /// Gives every new chart a place.
    pub(super) fn place_loose(
        &mut self,
        loose: Vec<FlatChart>,
        change: &mut SurfaceChange,
        frames: &[Arc<Keyframe>],
        decode: &Decode<'_>,
        update: &mut StreamUpdate,
    ) -> Result<(), StreamError> {
        if loose.is_empty() {
            return Ok(());
        }
        if !self.has_density {
            // All charts are new.
            self.texture.pages.clear();
            self.placer = None;
        }
        let mut placer = match self.placer.take() {
            Some(placer) => placer,
            None => {
                let texels_per_m = self.density(change, frames, decode)?;
                ChartPlacer::new(texels_per_m, &self.pack_params())?
            }
        };
        let (placer, pieces) = match placer.place(&loose) {
            Ok(pieces) => (placer, pieces),
            Err(PackError::OverBudget { .. }) => {
                update.has_new_pages |= !self.charts.is_empty();
                self.place_all_sparser(loose, placer.texels_per_m(), change, update)?
            }
            Err(error) => return Err(error.into()),
        };
        self.placer = Some(placer);
        for piece in pieces {
            change.add_fresh();
            let id = StreamChartId(self.next_chart);
            self.next_chart += 1;
            self.charts.push(StreamChart::new(id, piece));
        }
        self.open_pages();
        Ok(())
    }

    /// New charts and all others at a lower density, on pages of their own. What is known of those others
    /// stays true: they are painted anew and no more. Returns where the new ones lie.
    fn place_all_sparser(
        &mut self,
        loose: Vec<FlatChart>,
        texels_per_m: f64,
        change: &mut SurfaceChange,
        update: &mut StreamUpdate,
    ) -> Result<(ChartPlacer, Vec<PlacedPiece>), StreamError> {
        let standing = self
            .charts
            .iter()
            .map(|chart| Shape::of(&chart.piece, texels_per_m));
        let new = loose.into_iter().map(|chart| Shape {
            triangles: chart.triangles,
            corners_m: chart.corners_m,
        });
        let shapes: Vec<Shape> = standing.chain(new).collect();
        let (placer, mut pieces) = self.place_sparser(&shapes, texels_per_m)?;
        let is_of =
            |(piece, shape): (&PlacedPiece, &Shape)| piece.chart.triangles == shape.triangles;
        if !pieces.iter().zip(&shapes[..self.charts.len()]).all(is_of) {
            // One was placed in parts.
            self.part_all(change, update);
            let charts = self.flatten_loose(change)?;
            return self.place_sparser(&charts, texels_per_m);
        }
        let new = pieces.split_off(self.charts.len());
        let charts = self.charts.iter_mut().zip(&mut change.dirt);
        for ((chart, dirt), piece) in charts.zip(pieces) {
            chart.piece = piece;
            // Of texels that are no more.
            chart.means.clear();
            chart.gutter = None;
            dirt.is_relaid = true;
        }
        self.texture.pages.clear();
        Ok((placer, new))
    }

    /// All charts at the first lower density at which they fit.
    fn place_sparser<C: PlaneChart>(
        &self,
        charts: &[C],
        mut texels_per_m: f64,
    ) -> Result<(ChartPlacer, Vec<PlacedPiece>), StreamError> {
        let mut num_falls = 0;
        loop {
            texels_per_m *= (-1.0 / DENSITY_STEPS).exp2();
            num_falls += 1;
            let mut placer = ChartPlacer::new(texels_per_m, &self.pack_params())?;
            match placer.place(charts) {
                Ok(pieces) => return Ok((placer, pieces)),
                Err(PackError::OverBudget { .. }) if num_falls < MAX_FALLS => {}
                Err(error) => return Err(error.into()),
            }
        }
    }

    fn pack_params(&self) -> PackParams {
        let pack = &self.params.pack;
        PackParams {
            page_size_texel: self.stream.page_size_texel.min(pack.page_size_texel),
            ..*pack
        }
    }

    /// Texels per metre that the images ask for, in steps; it stays from when they see something.
    fn density(
        &mut self,
        change: &SurfaceChange,
        frames: &[Arc<Keyframe>],
        decode: &Decode<'_>,
    ) -> Result<f64, StreamError> {
        let mesh = change.mesh();
        let alone = AssignParams {
            pairwise: None,
            ..self.params.assign.clone()
        };
        let seen = assign::assign(mesh, frames, decode, &alone, &|_| ())?;
        let params = &self.params.density;
        let wanted = density::wanted_texels_per_m(mesh, &seen.best_texels_per_m, params);
        if params.texels_per_m > 0.0 {
            self.has_density = true;
            return Ok(wanted);
        }
        self.has_density = seen.best_texels_per_m.iter().any(|&density| density > 0.0);
        Ok(((DENSITY_STEPS * wanted.log2()).floor() / DENSITY_STEPS).exp2())
    }

    fn open_pages(&mut self) {
        let Some(placer) = &self.placer else { return };
        let [width, height] = placer.page_size_texel();
        self.texture
            .pages
            .resize_with(placer.num_pages() as usize, || {
                TexturePage::blank(width, height).into()
            });
    }

    /// Empties a page where charts hold too little of the pages; at most one, so that an update stays
    /// small.
    pub(super) fn compact(&mut self, change: &mut SurfaceChange, update: &mut StreamUpdate) {
        let Some(placer) = &mut self.placer else {
            return;
        };
        if placer.used_share() >= self.stream.min_used_share {
            return;
        }
        let mut pieces: Vec<&mut PlacedPiece> = self
            .charts
            .iter_mut()
            .map(|chart| &mut chart.piece)
            .collect();
        let Some(done) = placer.compact(&mut pieces) else {
            return;
        };
        for &chart in &done.moved {
            change.dirt[chart].is_relaid = true;
        }
        for (chart, dirt) in self.charts.iter().zip(&mut change.dirt) {
            let is_on_it = chart.piece.chart.page == done.closed_page;
            dirt.is_renumbered = is_on_it && done.renumbered_page != done.closed_page;
        }
        self.texture.pages.swap_remove(done.closed_page as usize);
        update.has_new_pages = true;
    }
}
