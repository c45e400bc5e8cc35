//! The cues against a plain evaluation of their definitions, written without any of the code under
//! test, in both of the paper's forms.

use super::*;

/// ψ of every triangle in every frame; `None` where the frame is not valid.
fn plain_scores(scene: &Scene, params: &AssignParams) -> Vec<Vec<Option<f64>>> {
    let mesh = scene.mesh();
    let views: Vec<Vec<PlainView>> = (0..scene.frames.len())
        .map(|frame| {
            let look = |p: &Point3<f64>| PlainView::new(scene, frame, p);
            mesh.positions_m().iter().map(look).collect()
        })
        .collect();
    let is_valid = |frame: usize, corners: &[u32; 3]| {
        let centroid = PlainView::new(scene, frame, &centroid_of(&mesh, corners));
        let corners = corners.map(|v| views[frame][v as usize].is_inside);
        corners == [true; 3] && centroid.is_inside
    };
    let frames = 0..scene.frames.len();
    mesh.triangles()
        .iter()
        .map(|corners| {
            let valid: Vec<usize> = frames.clone().filter(|&f| is_valid(f, corners)).collect();
            let color = |frame: usize, v: u32| views[frame][v as usize].rgb;
            let triangle_color = |frame: usize| mean(corners.map(|v| color(frame, v)));
            let global = match params.color_cue {
                ColorCue::ValidForTriangle => mean(valid.iter().map(|&f| triangle_color(f))),
                _ => mean(corners.map(|v| {
                    let valid_at_vertex = frames.clone().filter(|&f| {
                        let mut at_vertex = mesh.triangles().iter().filter(|c| c.contains(&v));
                        at_vertex.any(|c| is_valid(f, c))
                    });
                    mean(valid_at_vertex.map(|f| color(f, v)))
                })),
            };
            frames
                .clone()
                .map(|frame| {
                    let [p, q, r] = corners.map(|v| views[frame][v as usize].px);
                    let area =
                        ((q[0] - p[0]) * (r[1] - p[1]) - (q[1] - p[1]) * (r[0] - p[0])).abs() / 2.0;
                    let centroid = PlainView::new(scene, frame, &centroid_of(&mesh, corners));
                    let mut looks = corners.map(|v| views[frame][v as usize]).to_vec();
                    looks.push(centroid);
                    let depth = plain_depth_cue(&looks, params.depth_cue);
                    let local = triangle_color(frame);
                    let delta: [f64; 3] = std::array::from_fn(|c| local[c] - global[c]);
                    let color = match params.color_cue {
                        ColorCue::ValidForTriangle => delta.iter().map(|d| d.abs()).sum::<f64>(),
                        _ => delta.iter().map(|d| d * d).sum::<f64>().sqrt(),
                    };
                    valid
                        .contains(&frame)
                        .then_some(1e-3 * area - 10.0 * depth - color)
                })
                .collect()
        })
        .collect()
}

fn plain_depth_cue(looks: &[PlainView], cue: DepthCue) -> f64 {
    let range = |look: &PlainView, z: f64| {
        (look.point[0] * look.point[0] + look.point[1] * look.point[1] + z * z).sqrt()
    };
    match cue {
        DepthCue::DepthSum => looks
            .iter()
            .map(|look| look.measured_m.map_or(5.0, |z| (z - look.point[2]).abs()))
            .sum(),
        DepthCue::LargestRange => looks
            .iter()
            .map(|look| match look.measured_m {
                Some(z) => (range(look, z) - range(look, look.point[2])).abs(),
                None => 5.0,
            })
            .map(|difference_m| {
                if difference_m > 0.25 {
                    5.0
                } else {
                    difference_m
                }
            })
            .fold(0.0, f64::max),
    }
}

/// A point as a frame of the analytic scenes sees it.
#[derive(Clone, Copy)]
struct PlainView {
    point: [f64; 3],
    px: [f64; 2],
    is_inside: bool,
    rgb: [f64; 3],
    measured_m: Option<f64>,
}

impl PlainView {
    fn new(scene: &Scene, frame: usize, point: &Point3<f64>) -> Self {
        let matrix = scene.poses[frame].world_from_camera.inverse();
        let p = matrix.transform_point(point);
        let px = [150.0 * p.x / p.z + 79.5, 150.0 * p.y / p.z + 59.5];
        let nearest = px.map(|v| (v + 0.5).floor());
        let is_inside =
            p.z > 0.0 && (0.0..160.0).contains(&nearest[0]) && (0.0..120.0).contains(&nearest[1]);
        let index = if is_inside {
            nearest[1] as usize * 160 + nearest[0] as usize
        } else {
            0
        };
        let images = &scene.frames[frame];
        let measured_m = images.depth.as_ref().unwrap().image.depths_m()[index];
        Self {
            point: [p.x, p.y, p.z],
            px,
            is_inside,
            rgb: images.color.pixels()[index].map(|v| f64::from(v) / 255.0),
            measured_m: (is_inside && measured_m >= 0.001).then_some(f64::from(measured_m)),
        }
    }
}

fn centroid_of(mesh: &TriMesh, corners: &[u32; 3]) -> Point3<f64> {
    let [a, b, c] = corners.map(|v| mesh.positions_m()[v as usize].coords);
    Point3::from((a + b + c) / 3.0)
}

fn mean(colors: impl IntoIterator<Item = [f64; 3]>) -> [f64; 3] {
    let (mut sum, mut num) = ([0.0; 3], 0.0);
    for color in colors {
        num += 1.0;
        for (sum, value) in sum.iter_mut().zip(color) {
            *sum += value;
        }
    }
    sum.map(|sum| sum / num)
}

/// A wall, a board before it, and frames that disagree in colour, with holes in their depth,
/// readings below a millimetre, and a board that the mesh does not have.
fn scene() -> Scene {
    let wall = Panel {
        cells: [9, 7],
        paint: waves,
        ..WALL
    };
    let mut scene = Scene {
        panels: vec![wall, BOARD],
        ..Scene::default()
    };
    let unknown = Panel {
        min: [-1.0, -0.7],
        max: [-0.5, 0.1],
        z: 2.6,
        ..BOARD
    };
    scene.photograph([0.0, 0.0, 0.0], 0.0, &[], true);
    scene.photograph([0.4, 0.1, 0.5], -0.2, &[unknown], true);
    scene.photograph([-0.5, 0.0, 0.3], 0.25, &[], true);
    scene.panels[0].paint = grey;
    scene.photograph([-0.5, 0.0, 0.3], 0.25, &[], true);
    scene.photograph([0.1, -0.2, 1.6], 0.1, &[unknown], true);
    for (frame, reading_m) in [(0, 0.0), (2, 0.0005), (4, 0.001)] {
        let mut images = (*scene.frames[frame]).clone();
        let depth = images.depth.as_mut().unwrap();
        let mut depths_m = depth.image.depths_m();
        for (index, depth_m) in depths_m.iter_mut().enumerate() {
            if (40..75).contains(&(index % 160)) && index / 160 > 50 {
                *depth_m = reading_m;
            }
        }
        depth.image = crate::geom::DepthImage::new(160, 120, depths_m).unwrap();
        scene.frames[frame] = Arc::new(images);
    }
    // The last two frames are one view twice: all cues are equal.
    scene.poses.push(scene.poses[4]);
    scene.frames.push(scene.frames[4].clone());
    scene
}

#[test]
fn labels_are_those_of_the_definitions_in_both_forms() {
    let scene = scene();
    for params in [AssignParams::paper(), AssignParams::paper_as_printed()] {
        let assignment = assign_scene(&scene, &params);
        let (mut num_empty, mut num_by_frame) = (0, [0; 6]);
        for (triangle, scores) in plain_scores(&scene, &params).iter().enumerate() {
            // Ties go to the last frame; an invalid frame has −30, nothing has −15.
            let mut best = (None, -15.0);
            for (frame, score) in (0u32..).zip(scores) {
                let score = score.unwrap_or(-30.0);
                if score >= best.1 && score > -15.0 {
                    best = (Some(frame), score);
                }
            }
            let label = assignment.label[triangle];
            match best.0 {
                None => num_empty += 1,
                Some(frame) => num_by_frame[frame as usize] += 1,
            }
            // f32 may decide otherwise where two scores are equal but for rounding.
            let found = label.map_or(-15.0, |frame| scores[frame as usize].unwrap());
            assert!(
                label == best.0 || (found - best.1).abs() < 1e-5,
                "{:?}: triangle {triangle} has {label:?}, expected {best:?} of {scores:?}",
                params.depth_cue
            );
        }
        assert!(
            num_by_frame[0] > 5 && num_by_frame[2] > 5,
            "{num_empty} {num_by_frame:?}"
        );
        // Equal views: the later one takes all.
        assert!(
            num_by_frame[4] == 0 && num_by_frame[5] > 5,
            "{num_by_frame:?}"
        );
        assert!(num_empty > 5, "{num_empty}");
    }
}

#[test]
fn scores_are_the_sums_of_weighted_cues() {
    let scene = scene();
    let mesh = scene.mesh();
    let runs = MeshRuns::new(&mesh);
    for params in [AssignParams::paper(), AssignParams::paper_as_printed()] {
        // Without the colour cue, and with nothing cut off, a column is the sum of C1 and C2.
        let params = AssignParams {
            empty_score: -1e6,
            color_weight: 0.0,
            ..params
        };
        let expected = plain_scores(&scene, &params);
        let without_color = |triangle: usize, frame: usize| {
            let views: Vec<PlainView> = mesh.triangles()[triangle]
                .iter()
                .map(|&v| PlainView::new(&scene, frame, &mesh.positions_m()[v as usize]))
                .chain([PlainView::new(
                    &scene,
                    frame,
                    &centroid_of(&mesh, &mesh.triangles()[triangle]),
                )])
                .collect();
            let [p, q, r] = [views[0].px, views[1].px, views[2].px];
            let area = ((q[0] - p[0]) * (r[1] - p[1]) - (q[1] - p[1]) * (r[0] - p[0])).abs() / 2.0;
            1e-3 * area - 10.0 * plain_depth_cue(&views, params.depth_cue)
        };
        let mut workspace = cues::FrameWorkspace::default();
        for (frame, images) in scene.frames.iter().enumerate() {
            let pose = &scene.poses[frame];
            let column =
                cues::score_frame(&mesh, &runs, pose, images, &params, &mut workspace).unwrap();
            let valid: Vec<usize> = (0..mesh.num_triangles())
                .filter(|&t| expected[t][frame].is_some())
                .collect();
            let scored: Vec<usize> = column
                .candidates
                .iter()
                .map(|c| c.triangle as usize)
                .collect();
            assert_eq!(scored, valid);
            for candidate in &column.candidates {
                let expected = without_color(candidate.triangle as usize, frame);
                assert!((f64::from(candidate.score) - expected).abs() < 1e-4);
            }
        }
    }
}
