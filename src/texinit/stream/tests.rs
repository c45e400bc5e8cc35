#![expect(
    clippy::cast_possible_truncation,
    reason = "the numbers of a test are small"
)]

mod scan;

use nalgebra::{UnitQuaternion, Vector3};
use rayon::prelude::*;

use super::*;
use crate::atlas::{
    AtlasTexture, ChartKey, PackParams, TexelSource, TexturePage, num_shared_texels,
};
use crate::geom::{ImageError, RigidTransform};
use crate::keyframe::KeyframeId;
use crate::render::VisibilityParams;
use crate::texinit::assign::AssignParams;
use crate::texinit::density::DensityParams;
use crate::texinit::flatten::FlattenParams;
use crate::texinit::transfer::{TransferMode, TransferParams};
use crate::texinit::{Repainted, repaint};
use scan::{Draw, Scan, Silent};

fn texinit_params() -> TexInitParams {
    TexInitParams {
        flatten: FlattenParams {
            max_chart_triangles: 40,
            min_chart_triangles: 4,
            absorb_below_triangles: 6,
            ..FlattenParams::default()
        },
        pack: PackParams {
            page_size_texel: 64,
            gutter_texel: 1,
            max_texels: 64 * 64 * 64,
        },
        density: DensityParams {
            texels_per_m: 24.0,
            ..DensityParams::default()
        },
        // Frames differ in sharpness enough to lose triangles to others for it.
        assign: AssignParams {
            sharpness_weight: 1.0,
            ..AssignParams::default()
        },
        ..TexInitParams::default()
    }
}

fn stream_params() -> StreamParams {
    StreamParams {
        remake_below_triangles: 8,
        page_size_texel: 64,
        hysteresis: 0.0,
        batch_frames: 1,
        ..StreamParams::default()
    }
}

fn batch(
    state: &StreamInit,
    scan: &Scan,
    frames: &[Arc<Keyframe>],
    params: &TexInitParams,
) -> Repainted {
    let params = TexInitParams {
        coupling: Coupling::Chart,
        ..params.clone()
    };
    let decode = |keyframe: &Keyframe| scan.decode(keyframe);
    let (mesh, layout) = (state.mesh(), state.layout());
    repaint(mesh, layout, frames, &decode, &params, &Silent).unwrap()
}

fn update(state: &mut StreamInit, scan: &Scan) -> StreamUpdate {
    let decode = |keyframe: &Keyframe| scan.decode(keyframe);
    state
        .update(&scan.mesh(), &scan.frames(), &decode, &Silent)
        .unwrap()
}

/// Labels and texels are those of the whole at once; no two triangles own a texel.
fn check_equality(state: &StreamInit, scan: &Scan, params: &TexInitParams) {
    check_equality_over(state, scan, &scan.frames(), params);
}

/// The same where not all keyframes are taken in.
fn check_equality_over(
    state: &StreamInit,
    scan: &Scan,
    frames: &[Arc<Keyframe>],
    params: &TexInitParams,
) {
    assert_eq!(state.mesh().num_triangles(), scan.mesh().num_triangles());
    assert_eq!(num_shared_texels(state.layout()), 0);
    assert!(state.joined_vertices.is_at_rest());
    let keys = ChartKey::of_all(state.mesh(), state.layout());
    assert_eq!(state.chart_keys(), keys);
    let batch = batch(state, scan, frames, params);
    let number = |frame: &Option<u32>| frame.map(|frame| frames[frame as usize].id.0);
    let expected: Vec<Option<u32>> = batch.assignment.label.iter().map(number).collect();
    let assignment = state.assignment();
    assert_eq!(assignment.label, expected);
    assert_eq!(
        assignment.is_partly_hidden,
        batch.assignment.is_partly_hidden
    );
    assert_eq!(assignment.num_views, batch.assignment.num_views);
    let pages = state.texture().pages.iter().zip(&batch.texture.pages);
    assert_eq!(state.texture().pages.len(), batch.texture.pages.len());
    for (page, (ours, theirs)) in pages.enumerate() {
        for index in 0..ours.srgb.len() {
            let texel =
                |page: &TexturePage| (page.srgb[index], page.source[index], page.confidence[index]);
            let (x, y) = (index % 64, index / 64);
            assert_eq!(texel(ours), texel(theirs), "page {page}, texel ({x}, {y})");
        }
    }
}

/// What was not announced is as it was, but for what gone charts left blank.
fn check_announced(before: &AtlasTexture, state: &StreamInit, update: &StreamUpdate) {
    if update.has_new_pages {
        return;
    }
    for (number, (old, new)) in before.pages.iter().zip(&state.texture().pages).enumerate() {
        for index in 0..old.srgb.len() {
            let is_same = old.srgb[index] == new.srgb[index]
                && old.source[index] == new.source[index]
                && old.confidence[index] == new.confidence[index];
            let (x, y) = ((index % 64) as u32, (index / 64) as u32);
            let is_told = update.dirty_rects.iter().any(|(page, rect)| {
                *page as usize == number
                    && (rect.x..rect.x + rect.width).contains(&x)
                    && (rect.y..rect.y + rect.height).contains(&y)
            });
            let is_blank = new.source[index] == TexelSource::NONE && new.srgb[index] == [0; 3];
            assert!(is_same || is_told || is_blank, "page {number}, ({x}, {y})");
        }
    }
}

/// A random sequence of changes, compared with the whole after each.
fn run(seed: u64, num_steps: usize, params: &TexInitParams, stream: &StreamParams) -> [usize; 4] {
    let mut scan = Scan::new(seed);
    let mut draw = Draw(seed);
    let mut state = StreamInit::new(params, stream).unwrap();
    let mut num_seen = [0; 4];
    for _ in 0..num_steps {
        scan.change(&mut draw);
        let before = state.texture().clone();
        let update = update(&mut state, &scan);
        check_equality(&state, &scan, params);
        check_announced(&before, &state, &update);
        num_seen[0] += update.mesh.num_moved;
        num_seen[1] += update.mesh.num_gone;
        num_seen[2] += update.num_frames_removed + update.num_frames_moved;
        num_seen[3] += state.charts.len() - update.new_charts.len() - update.changed_charts.len();
    }
    num_seen
}

#[test]
fn any_sequence_of_changes_gives_the_batch() {
    let (params, stream) = (texinit_params(), stream_params());
    let seen: Vec<[usize; 4]> = (0..200_u64)
        .into_par_iter()
        .map(|seed| run(seed, 5, &params, &stream))
        .collect();
    // Of every kind there was some.
    for kind in 0..4 {
        assert!(seen.iter().map(|seen| seen[kind]).sum::<usize>() > 100);
    }
}

/// Texels are those that the state's own labels give.
fn check_texels(state: &StreamInit, scan: &Scan, params: &TexInitParams) {
    let frames = scan.frames();
    let mut assignment = state.assignment();
    for label in &mut assignment.label {
        *label = label.map(|number| {
            let index = frames.binary_search_by_key(&number, |frame| frame.id.0);
            index.unwrap() as u32
        });
    }
    let decode = |keyframe: &Keyframe| scan.decode(keyframe);
    let (mesh, layout) = (state.mesh(), state.layout());
    let painted =
        crate::texinit::paint(mesh, layout, &assignment, &frames, &decode, params, &Silent);
    assert_eq!(painted.unwrap().texture, *state.texture());
}

#[test]
fn with_hysteresis_labels_change_less_and_are_worth_nearly_as_much() {
    let params = texinit_params();
    let num_changed_labels = |hysteresis: f32| -> (usize, f64) {
        let by_seed: Vec<(usize, f64)> = (500..530_u64)
            .into_par_iter()
            .map(|seed| {
                let (mut scan, mut draw) = (Scan::new(seed), Draw(seed));
                let stream = StreamParams {
                    hysteresis,
                    ..stream_params()
                };
                let mut state = StreamInit::new(&params, &stream).unwrap();
                let (mut num_changed, mut most) = (0, 0.0_f64);
                for _ in 0..6 {
                    scan.change(&mut draw);
                    let before: std::collections::BTreeMap<_, _> = state
                        .charts
                        .iter()
                        .map(|chart| (chart.id, chart.labels.assignment().label.clone()))
                        .collect();
                    update(&mut state, &scan);
                    check_texels(&state, &scan, &params);
                    for chart in &state.charts {
                        let shortfall = chart.labels.shortfall(&params.assign);
                        let bound = f64::from(hysteresis) * chart.len() as f64;
                        assert!(shortfall <= bound + 1e-3, "{shortfall} of {bound}");
                        most = most.max(shortfall);
                        let label = &chart.labels.assignment().label;
                        let before = before.get(&chart.id).into_iter().flatten();
                        num_changed += before.zip(label).filter(|(b, a)| b != a).count();
                    }
                }
                (num_changed, most)
            })
            .collect();
        let all = by_seed.into_iter();
        all.fold((0, 0.0_f64), |sum, (num, most)| {
            (sum.0 + num, sum.1.max(most))
        })
    };
    let [(none, exact), (some, near)] = [0.0, 0.5].map(num_changed_labels);
    assert!(some < none, "{some} labels changed, {none} without");
    assert!(exact == 0.0 && near > 0.0, "{exact}, {near}");
}

#[test]
fn how_many_views_are_kept_changes_nothing() {
    let base = texinit_params();
    // All is seen as far as this by scores and means alike, and some of the scene is farther.
    let near = VisibilityParams {
        far_m: 2.4,
        ..VisibilityParams::default()
    };
    let near = TexInitParams {
        assign: AssignParams {
            visibility: Some(near.clone()),
            ..base.assign.clone()
        },
        transfer: TransferParams {
            visibility: near,
            ..base.transfer.clone()
        },
        ..base.clone()
    };
    let num_view_bytes = {
        let mut state = StreamInit::new(&base, &stream_params()).unwrap();
        let scan = Scan::new(0);
        update(&mut state, &scan);
        state.views.num_bytes() / scan.frames().len()
    };
    assert!(num_view_bytes > 0);
    let budgets = [0.0, 2.5, 1e6].map(|num_views| num_views * num_view_bytes as f64 / 1e6);
    let cases = [&base, &near].map(|params| budgets.map(|budget_mb| (params, budget_mb)));
    cases
        .as_flattened()
        .par_iter()
        .for_each(|(params, budget_mb)| {
            let stream = StreamParams {
                view_cache_mb: *budget_mb,
                ..stream_params()
            };
            for seed in 400..406 {
                run(seed, 5, params, &stream);
            }
        });
}

#[test]
fn other_forms_give_their_batch_too() {
    let base = texinit_params();
    let forms = [
        TexInitParams {
            assign: AssignParams {
                pairwise: None,
                color_cue: ColorCue::ValidForTriangle,
                ..AssignParams::default()
            },
            has_gutters: false,
            ..base.clone()
        },
        TexInitParams {
            transfer: TransferParams {
                mode: TransferMode::L2Avg,
                ..TransferParams::default()
            },
            ..base.clone()
        },
        // Some of the scene is too far, for means farther than for scores.
        TexInitParams {
            assign: AssignParams {
                visibility: Some(VisibilityParams {
                    far_m: 2.2,
                    ..VisibilityParams::default()
                }),
                ..base.assign.clone()
            },
            transfer: TransferParams {
                visibility: VisibilityParams {
                    far_m: 2.6,
                    ..base.transfer.visibility.clone()
                },
                ..base.transfer.clone()
            },
            ..base.clone()
        },
        // The density is taken from the images.
        TexInitParams {
            density: DensityParams {
                max_texels_per_m: 40.0,
                ..DensityParams::default()
            },
            ..base
        },
    ];
    forms.par_iter().for_each(|params| {
        for seed in 300..306 {
            run(seed, 5, params, &stream_params());
        }
    });
}

#[test]
fn a_scan_that_outgrows_its_budget_is_made_sparser() {
    let mut params = texinit_params();
    params.pack.max_texels = 64 * 64;
    let mut scan = Scan::new(5);
    scan.show_all();
    scan.hide_right_of(0.0);
    let mut state = StreamInit::new(&params, &stream_params()).unwrap();
    update(&mut state, &scan);
    assert_eq!(state.layout().texels_per_m, 24.0);
    let before: Vec<StreamChartId> = state.chart_ids().collect();
    scan.show_all();
    let grown = update(&mut state, &scan);
    assert!(state.layout().texels_per_m < 24.0);
    assert_eq!(state.layout().num_pages, 1);
    assert!(grown.has_new_pages);
    // Charts stay with what is known of them, and are laid anew.
    let stay: Vec<_> = before
        .iter()
        .filter(|id| !grown.gone_charts.contains(id))
        .collect();
    assert!(!stay.is_empty());
    assert!(stay.iter().all(|id| grown.changed_charts.contains(id)));
    check_equality(&state, &scan, &params);
}

#[test]
fn scans_that_outgrow_their_budget_give_the_batch() {
    let mut params = texinit_params();
    params.pack.max_texels = 64 * 64;
    let num_falls: Vec<usize> = (600..630_u64)
        .into_par_iter()
        .map(|seed| {
            let (mut scan, mut draw) = (Scan::new(seed), Draw(seed));
            let mut state = StreamInit::new(&params, &stream_params()).unwrap();
            let mut densities = std::collections::BTreeSet::new();
            for _ in 0..5 {
                scan.change(&mut draw);
                update(&mut state, &scan);
                check_equality(&state, &scan, &params);
                densities.insert(state.layout().texels_per_m.to_bits());
            }
            densities.len() - 1
        })
        .collect();
    assert!(num_falls.iter().sum::<usize>() > 5, "{num_falls:?}");
}

#[test]
fn keyframes_wait_their_turn_and_leave_no_trace() {
    let (params, mut stream) = (texinit_params(), stream_params());
    stream.max_new_frames = 1;
    let mut num_waited = 0;
    for seed in 400..420 {
        let mut scan = Scan::new(seed);
        let mut draw = Draw(seed);
        let mut state = StreamInit::new(&params, &stream).unwrap();
        for _ in 0..4 {
            scan.change(&mut draw);
            let mut waiting = update(&mut state, &scan).num_frames_waiting;
            while waiting > 0 {
                num_waited += 1;
                let again = update(&mut state, &scan);
                assert_eq!(
                    (again.num_frames_added, again.num_frames_waiting),
                    (1, waiting - 1)
                );
                waiting = again.num_frames_waiting;
            }
            check_equality(&state, &scan, &params);
        }
    }
    assert!(num_waited > 20);
}

#[test]
fn keyframes_that_see_little_unpainted_surface_wait_for_others() {
    let (params, mut stream) = (texinit_params(), stream_params());
    (stream.batch_frames, stream.urgent_share) = (3, 0.6);
    let num_waited: Vec<usize> = (600..640_u64)
        .into_par_iter()
        .map(|seed| {
            let (mut scan, mut draw) = (Scan::new(seed), Draw(seed));
            let mut state = StreamInit::new(&params, &stream).unwrap();
            let (mut num_waited, mut num_in_a_row) = (0, 0);
            for step in 0..8 {
                scan.change(&mut draw);
                let waiting = update(&mut state, &scan).num_frames_waiting;
                let is_taken = |f: &Arc<Keyframe>| state.frames.get(f.id.0).is_some();
                let frames = scan.frames();
                let taken: Vec<_> = frames.iter().filter(|f| is_taken(f)).cloned().collect();
                assert_eq!(taken.len() + waiting, frames.len());
                assert!(waiting < 3);
                check_equality_over(&state, &scan, &taken, &params);
                num_in_a_row = if waiting > 0 { num_in_a_row + 1 } else { 0 };
                assert!(num_in_a_row <= 3, "they wait for at most as many updates");
                num_waited += waiting;
                // Where nothing else comes they are taken in.
                if step == 7 {
                    let again = update(&mut state, &scan);
                    assert_eq!(
                        (again.num_frames_added, again.num_frames_waiting),
                        (waiting, 0)
                    );
                    check_equality(&state, &scan, &params);
                }
            }
            num_waited
        })
        .collect();
    let num_waited: usize = num_waited.iter().sum();
    assert!(num_waited > 40, "{num_waited}");
}

#[test]
fn a_keyframe_that_sees_unpainted_surface_does_not_wait() {
    let (params, mut stream) = (texinit_params(), stream_params());
    (stream.batch_frames, stream.urgent_share) = (100, 0.6);
    let mut scan = Scan::new(3);
    scan.show_all();
    let mut state = StreamInit::new(&params, &stream).unwrap();
    assert_eq!(update(&mut state, &scan).num_frames_waiting, 0);
    let decode = |keyframe: &Keyframe| scan.decode(keyframe);
    let mut frames = scan.frames();
    let mut another = Keyframe::clone(&frames[0]);
    another.id = KeyframeId(1000);
    frames.push(Arc::new(another));
    let is_waiting = |state: &mut StreamInit| {
        let update = state.update(&scan.mesh(), &frames, &decode, &Silent);
        update.unwrap().num_frames_waiting
    };
    assert_eq!(is_waiting(&mut state), 1, "most that it sees is painted");
    let mut state = StreamInit::new(&params, &stream).unwrap();
    assert_eq!(is_waiting(&mut state), 0, "nothing is painted");
}

#[test]
fn a_keyframe_waits_for_at_most_as_many_updates() {
    let (params, mut stream) = (texinit_params(), stream_params());
    (stream.batch_frames, stream.urgent_share) = (3, 0.6);
    let mut scan = Scan::new(3);
    scan.show_all();
    let mut state = StreamInit::new(&params, &stream).unwrap();
    assert_eq!(update(&mut state, &scan).num_frames_waiting, 0);
    let mut frames = scan.frames();
    frames.push(Arc::new(Keyframe {
        id: KeyframeId(1000),
        ..Keyframe::clone(&frames[0])
    }));
    let waiting = [1.2, 1.0, 0.8, 0.6, 0.4].map(|x_m| {
        // There is less surface each time, of which nothing is unpainted.
        scan.hide_right_of(x_m);
        let decode = |keyframe: &Keyframe| scan.decode(keyframe);
        let update = state
            .update(&scan.mesh(), &frames, &decode, &Silent)
            .unwrap();
        assert!(update.mesh.num_gone > 0);
        update.num_frames_waiting
    });
    assert_eq!(waiting, [1, 1, 1, 0, 0]);
}

#[test]
fn what_several_keyframes_looked_for_in_vain_is_no_reason_not_to_wait() {
    let (params, mut stream) = (texinit_params(), stream_params());
    (stream.batch_frames, stream.urgent_share) = (100, 0.0);
    let mut scan = Scan::new(3);
    scan.show_all();
    let decode = |keyframe: &Keyframe| scan.decode(keyframe);
    let template = scan.frames()[0].clone();
    let numbered = |number: u32| {
        let mut keyframe = Keyframe::clone(&template);
        keyframe.id = KeyframeId(number);
        Arc::new(keyframe)
    };
    // They decode as numbers below a photo's only.
    let decode_any = |keyframe: &Keyframe| {
        let as_first = Keyframe {
            id: template.id,
            ..keyframe.clone()
        };
        decode(&as_first)
    };
    let mut state = StreamInit::new(&params, &stream).unwrap();
    let mut waiting = Vec::new();
    for num_frames in 1..=6 {
        let frames: Vec<_> = (0..num_frames).map(numbered).collect();
        let update = state.update(&scan.mesh(), &frames, &decode_any, &Silent);
        waiting.push(update.unwrap().num_frames_waiting);
    }
    assert!(state.labels().contains(&None), "something is hidden");
    assert_eq!(waiting, [0, 0, 0, 0, 1, 2]);
}

#[test]
fn the_keyframe_that_sees_most_of_what_is_unpainted_comes_first() {
    let (params, mut stream) = (texinit_params(), stream_params());
    stream.max_new_frames = 1;
    let mut scan = Scan::new(11);
    scan.show_all();
    let mut state = StreamInit::new(&params, &stream).unwrap();
    let decode = |keyframe: &Keyframe| scan.decode(keyframe);
    state.update(&scan.mesh(), &[], &decode, &Silent).unwrap();
    let at = |number: u32, x_m: f64| {
        let frame = &scan.frames()[0];
        let translation = Vector3::new(x_m, 0.0, 0.0);
        Arc::new(Keyframe {
            id: KeyframeId(number),
            world_from_camera: RigidTransform::from_parts(UnitQuaternion::identity(), translation),
            ..(**frame).clone()
        })
    };
    let mut taken = |frames: &[Arc<Keyframe>]| {
        let dirt = vec![charts::Dirt::default(); state.charts.len()];
        let (taken, num_waiting) = state.taken_in(frames, &dirt, true);
        assert_eq!(num_waiting, frames.len() - taken.len());
        taken.iter().map(|frame| frame.id.0).collect::<Vec<_>>()
    };
    assert_eq!(taken(&[at(3, 0.0)]), [3]);
    // The last sees nothing, the one before less than the others, of which the newer goes first.
    assert_eq!(
        taken(&[at(3, 0.0), at(4, 0.0), at(5, 3.0), at(6, 50.0)]),
        [4]
    );
}

#[test]
fn pages_are_compacted_when_the_scan_shrinks() {
    let (params, stream) = (texinit_params(), stream_params());
    let mut scan = Scan::new(9);
    scan.show_all();
    let mut state = StreamInit::new(&params, &stream).unwrap();
    update(&mut state, &scan);
    let num_pages = state.layout().num_pages;
    let mut num_closed = 0;
    for step in 0..12 {
        scan.hide_right_of(1.3 - 0.2 * f64::from(step));
        let update = update(&mut state, &scan);
        num_closed += usize::from(update.has_new_pages);
        check_equality(&state, &scan, &params);
        assert!(state.layout().num_pages <= 1 || state.used_share() > 0.3);
    }
    assert!(num_closed > 0 && state.layout().num_pages < num_pages);
}

#[test]
fn small_charts_beside_new_surface_are_made_anew() {
    let num_gone = |remake_below_triangles: usize| {
        let stream = StreamParams {
            remake_below_triangles,
            ..stream_params()
        };
        let mut scan = Scan::new(2);
        scan.show_all();
        scan.hide_right_of(0.5);
        let mut state = StreamInit::new(&texinit_params(), &stream).unwrap();
        update(&mut state, &scan);
        scan.show_all();
        let update = update(&mut state, &scan);
        check_equality(&state, &scan, &texinit_params());
        update.gone_charts.len()
    };
    assert_eq!(num_gone(0), 0);
    assert!(num_gone(10_000) > 0);
}

#[test]
fn nothing_new_changes_nothing() {
    let (params, stream) = (texinit_params(), stream_params());
    let mut scan = Scan::new(3);
    let mut draw = Draw(3);
    for _ in 0..4 {
        scan.change(&mut draw);
    }
    let mut state = StreamInit::new(&params, &stream).unwrap();
    update(&mut state, &scan);
    let before = state.texture().clone();
    let again = update(&mut state, &scan);
    assert_eq!(*state.texture(), before);
    let nothing = StreamUpdate {
        mesh: DiffCounts {
            num_kept: state.mesh().num_triangles(),
            ..DiffCounts::default()
        },
        ..StreamUpdate::default()
    };
    assert_eq!(again, nothing);
}

#[test]
fn an_empty_scan_and_bad_settings() {
    let (params, stream) = (texinit_params(), stream_params());
    let mut state = StreamInit::new(&params, &stream).unwrap();
    let decode = |_: &Keyframe| Err(ImageError::Encoding("none".to_owned()));
    let empty = Arc::new(TriMesh::default());
    let update = state.update(&empty, &[], &decode, &Silent).unwrap();
    assert_eq!(update, StreamUpdate::default());
    let refused = StreamInit::new(&TexInitParams::paper(), &stream);
    assert!(matches!(refused, Err(StreamError::Unsupported(_))));
    let scan = Scan::new(1);
    let mut frames = scan.frames();
    frames.extend(scan.frames());
    let refused = state.update(&scan.mesh(), &frames, &decode, &Silent);
    assert!(matches!(refused, Err(StreamError::FrameOrder(_))));
}
