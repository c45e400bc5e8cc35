//! The optimisation in idle time: what it changes, and that it is the one of the whole.

use std::collections::BTreeMap;
use std::path::Path;
use std::sync::atomic::{AtomicUsize, Ordering};

use veneer::atlas::{AtlasTexture, PlacedChart};
use veneer::bag::BagReader;
use veneer::config::Config;
use veneer::ingest::EventSource;
use veneer::keyframe::{Keyframe, KeyframeStore};
use veneer::pipeline::{
    Capture, LiveScan, NoProgress, PipelineParams, Progress, StreamPainter, Streamed, run_streamed,
    stream,
};
use veneer::texinit::stream::StreamChartId;
use veneer::texinit::{Coupling, TexInitParams, repaint};
use veneer::texsmooth::{NoObserver, SmoothFrom, StepProgress, smooth};

use super::{Silent, grown_tabletop, is_same_beyond, whole};
use crate::command::small_tabletop;

/// Counts the steps of the optimisation.
#[derive(Default)]
struct Steps(AtomicUsize);

impl Steps {
    fn take(&self) -> usize {
        self.0.swap(0, Ordering::Relaxed)
    }
}

impl Progress for Steps {
    fn begin(&self, _: &str, _: u64) {}

    fn advance(&self, _: u64) {}

    fn losses(&self, _: &StepProgress) {
        self.0.fetch_add(1, Ordering::Relaxed);
    }
}

/// Crops that fit the small photos; all charts in one group.
fn params(num_steps: usize) -> PipelineParams {
    let mut params = super::exact();
    params.texsmooth.num_steps = num_steps;
    params.texsmooth.crop_px = 96;
    params.idle.max_texels = 1_000_000_000;
    params.idle.max_steps = 5;
    params
}

/// The scan of a bag as far as some tenths of its events.
fn capture(bag: &Path, params: &PipelineParams, num_tenths: usize) -> Capture {
    let mut source = BagReader::open(bag, &Config::default().topics).unwrap();
    let mut scan = LiveScan::new(params, source.topics(), 0);
    let mut events: Vec<_> = std::iter::from_fn(|| source.next_event()).collect();
    events.truncate(num_tenths * events.len() / 10);
    for event in events {
        scan.push(event);
    }
    scan.flush();
    scan.capture()
}

/// The optimisation of the whole texture at once.
fn whole_smoothed(
    painter: &StreamPainter,
    streamed: &Streamed,
    before: &AtlasTexture,
    params: &PipelineParams,
) -> AtlasTexture {
    let (state, mut texture) = (painter.state().unwrap(), before.clone());
    let decode = |keyframe: &Keyframe| painter.decode(keyframe);
    let (mesh, layout) = (state.mesh(), state.layout());
    let report = smooth(
        mesh,
        layout,
        &mut texture,
        &streamed.keyframes,
        &decode,
        &params.texsmooth,
        SmoothFrom::Nothing,
        &NoObserver,
    );
    assert!(report.unwrap().num_texels > 1000);
    texture
}

/// The texels that a chart owns.
fn texels(texture: &AtlasTexture, placed: &PlacedChart) -> Vec<[u8; 3]> {
    let page = &texture.pages[placed.page as usize];
    let spans = placed.own_spans().flat_map(|(row, first, len)| {
        let start = (row * page.width + first) as usize;
        page.srgb[start..start + len as usize].to_vec()
    });
    spans.collect()
}

fn places(painter: &StreamPainter) -> BTreeMap<StreamChartId, PlacedChart> {
    let state = painter.state().unwrap();
    let places = state.layout().charts.iter().cloned();
    state.chart_ids().zip(places).collect()
}

#[test]
fn changed_charts_are_smoothed_group_by_group_and_no_others() {
    let dir = tempfile::tempdir().unwrap();
    let mut params = params(60);
    params.stream.page_size_texel = 256;
    params.refine.seams.has_global = true;
    params.idle.max_texels = 15_000;
    params.idle.max_steps = 3;
    let steps = Steps::default();
    let mut shown: Option<AtlasTexture> = None;
    let (mut num_smoothed, mut num_between, mut num_handed_on, mut num_steps) = (0, 0, 0, 0);
    let mut see = |painter: &StreamPainter, streamed: &Streamed| {
        let (state, texture) = (painter.state().unwrap(), painter.texture().unwrap());
        let update = &streamed.update;
        let num_made = steps.take();
        if streamed.is_idle_step {
            assert!(num_made <= 3, "{num_made}");
            assert!(is_same_beyond(
                shown.as_ref().unwrap(),
                texture,
                &update.dirty_rects
            ));
            let (before, places) = (shown.as_ref().unwrap(), places(painter));
            for (id, placed) in &places {
                let is_told = update.changed_charts.binary_search(id).is_ok();
                assert!(is_told || texels(before, placed) == texels(texture, placed));
            }
            num_smoothed += usize::from(num_made > 0);
            num_handed_on += usize::from(num_made > 0 && update.has_changes());
        } else {
            assert_eq!(num_made, 0);
            num_between = num_smoothed;
            let whole = whole(painter, streamed, &params.texinit);
            assert!(whole.texture == state.texture().clone());
        }
        num_steps += num_made;
        let sources = texture.pages.iter().map(|page| &page.source);
        assert!(sources.eq(state.texture().pages.iter().map(|page| &page.source)));
        shown = Some(texture.clone());
    };
    let mut source = grown_tabletop(dir.path());
    let painter = stream(&mut source, &params, 0.0, &steps, &mut see).unwrap();
    assert!(
        num_between > 0 && num_smoothed > num_between,
        "{num_between}"
    );
    assert!(num_handed_on > 2 && num_handed_on < num_smoothed);
    assert!(num_steps >= 60, "{num_steps}");
    assert!((painter.num_charts_waiting(), painter.has_idle_work()) == (0, false));
}

#[test]
fn one_group_of_all_charts_is_the_optimisation_of_the_whole() {
    let dir = tempfile::tempdir().unwrap();
    let bag = small_tabletop(dir.path(), &["--exposure-noise", "0.3"]);
    let mut params = params(12);
    params.refine.seams.has_global = true;
    let capture = capture(&bag, &params, 10);
    let mut painter = StreamPainter::new(&params.keyframe);
    let streamed = painter.paint(capture, &params, &NoProgress).unwrap();
    let steps = Steps::default();
    let mut levelled = painter.texture().unwrap().clone();
    let mut num_made = vec![];
    while let Some(step) = painter.refine_some(&params, &steps).unwrap() {
        let made = steps.take();
        if made == 0 {
            levelled = painter.texture().unwrap().clone();
        } else {
            num_made.push((made, step.update.has_changes()));
        }
    }
    assert_eq!(num_made, [(5, false), (5, false), (2, true)]);
    assert!(painter.state().unwrap().texture() != &levelled);
    let expected = whole_smoothed(&painter, &streamed, &levelled, &params);
    assert!(&expected == painter.texture().unwrap());
}

#[test]
fn an_update_ends_a_group_and_what_it_made_is_kept() {
    let dir = tempfile::tempdir().unwrap();
    let bag = small_tabletop(dir.path(), &[]);
    let params = params(40);
    let all = capture(&bag, &params, 10);
    let mut painter = StreamPainter::new(&params.keyframe);
    let steps = Steps::default();
    painter.paint(all.clone(), &params, &steps).unwrap();
    let num_charts = painter.state().unwrap().layout().charts.len();
    for _ in 0..6 {
        painter.refine_some(&params, &steps).unwrap();
        assert_eq!(painter.num_charts_waiting(), num_charts);
    }
    let base = painter.state().unwrap().texture().clone();
    assert!(painter.texture() == Some(&base));

    // What was made is shown and told; the rest comes later.
    let again = painter.paint(all.clone(), &params, &steps).unwrap();
    assert_eq!(again.update.changed_charts.len(), num_charts);
    let half = painter.texture().unwrap().clone();
    assert!(half != base && painter.state().unwrap().texture() == &base);
    assert_eq!(steps.take(), 30);
    painter.refine_some(&params, &steps).unwrap();
    assert_eq!(painter.num_charts_waiting(), num_charts);

    // Charts that an update changes begin anew, others keep their texels.
    let mut fewer = all.clone();
    fewer.keyframes.pop();
    let before = places(&painter);
    let update = painter.paint(fewer, &params, &steps).unwrap().update;
    let (shown, state) = (painter.texture().unwrap(), painter.state().unwrap());
    let (mut num_standing, mut num_further, mut num_anew) = (0, 0, 0);
    for (id, placed) in places(&painter) {
        let own = texels(shown, &placed);
        let is_base = own == texels(state.texture(), &placed);
        let is_told = update.changed_charts.binary_search(&id).is_ok()
            || update.new_charts.binary_search(&id).is_ok();
        assert!(is_told);
        let is_same_place = before.get(&id).is_some_and(|old| old.rect == placed.rect);
        if is_same_place && texels(state.texture(), &placed) != texels(&base, &placed) {
            num_anew += 1;
            assert!(is_base);
        }
        if before.contains_key(&id) && !is_base {
            num_standing += 1;
            num_further += usize::from(own != texels(&half, &placed));
        }
    }
    assert!(num_standing > 0 && num_anew > 0);
    assert!(num_further > 0, "five steps more are shown");
    assert_eq!(steps.take(), 5);
    while painter.refine_some(&params, &steps).unwrap().is_some() {}
    let num_left = steps.take();
    assert!((6..=40).contains(&num_left), "{num_left}");
    assert_eq!(painter.num_charts_waiting(), 0);

    // Without a change in between, as many steps as without the interruption.
    let mut painter = StreamPainter::new(&params.keyframe);
    painter.paint(all.clone(), &params, &steps).unwrap();
    painter.refine_some(&params, &steps).unwrap();
    painter.paint(all, &params, &steps).unwrap();
    while painter.refine_some(&params, &steps).unwrap().is_some() {}
    assert_eq!(steps.take(), 40);
}

#[test]
fn all_charts_are_smoothed_where_that_is_asked_for_once() {
    let dir = tempfile::tempdir().unwrap();
    let bag = small_tabletop(dir.path(), &["--grow", "2"]);
    let settings = params(0);
    let [first, second] = [7, 10].map(|num_tenths| capture(&bag, &settings, num_tenths));
    let mut painter = StreamPainter::new(&settings.keyframe);
    let painted = painter
        .paint(first.clone(), &settings, &NoProgress)
        .unwrap();
    assert!(!painter.has_idle_work());
    let base = painter.texture().unwrap().clone();
    painter.smooth_all(12, &settings);
    let num_charts = painter.state().unwrap().layout().charts.len();
    assert_eq!(painter.num_charts_waiting(), num_charts);
    assert!(painter.texture() == Some(&base));
    while painter
        .refine_some(&settings, &NoProgress)
        .unwrap()
        .is_some()
    {}
    let smoothed = painter.texture().unwrap().clone();
    assert!(smoothed == whole_smoothed(&painter, &painted, &base, &params(12)));

    // It stays, but what changes goes by the settings.
    painter
        .paint(second.clone(), &settings, &NoProgress)
        .unwrap();
    assert!(!painter.has_idle_work());
    let base = painter.state().unwrap().texture().clone();
    let shown = painter.texture().unwrap().clone();
    assert!(shown != base);

    painter.take_back_smooth_all();
    let back = painter.paint(second, &settings, &NoProgress).unwrap();
    assert!(painter.texture() == Some(&base) && !painter.has_idle_work());
    assert!(is_same_beyond(&shown, &base, &back.update.dirty_rects));
}

#[test]
fn a_streamed_run_learns_nothing_from_photos_that_judge() {
    let dir = tempfile::tempdir().unwrap();
    let mut params = params(12);
    params.held_out.num_views = 1;
    let mut source = grown_tabletop(dir.path());
    let run = run_streamed(&mut source, &params, 0.1, &NoProgress).unwrap();
    assert_eq!(run.held_out.len(), 1);
    assert!(run.updates.unwrap().num_idle_steps > 3);
    let store = KeyframeStore::new(&params.keyframe);
    let decode = |keyframe: &Keyframe| store.decode(keyframe);
    let chartwise = TexInitParams {
        coupling: Coupling::Chart,
        ..params.texinit.clone()
    };
    let (mesh, layout) = (&run.mesh, &run.texinit.layout);
    let painted = repaint(mesh, layout, &run.keyframes, &decode, &chartwise, &Silent);
    let mut expected = painted.unwrap().texture;
    assert!(expected != run.texinit.texture);
    smooth(
        mesh,
        layout,
        &mut expected,
        &run.keyframes,
        &decode,
        &params.texsmooth,
        SmoothFrom::Nothing,
        &NoObserver,
    )
    .unwrap();
    assert!(expected == run.texinit.texture);
}
