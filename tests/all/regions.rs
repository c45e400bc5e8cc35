//! Programs that each paint a region of one scan make of it, together, what one makes alone.

use std::collections::BTreeMap;
use std::path::Path;

use veneer::atlas::TexelSource;
use veneer::bag::{BagReader, TopicRoles};
use veneer::geom::Stamp;
use veneer::mesh::{Region, TriangleId};
use veneer::pipeline::{NoProgress, PipelineParams, RegionParams, Run, run};
use veneer::render::textured::sample_page;

use crate::command::{said, small_tabletop, veneer, veneer_ok};

fn painted(bag: &Path, region: Option<Region>) -> Run {
    let params = PipelineParams {
        region: RegionParams {
            region,
            ..RegionParams::default()
        },
        ..PipelineParams::default()
    };
    let mut reader = BagReader::open(bag, &TopicRoles::default()).unwrap();
    run(&mut reader, &params, &NoProgress).unwrap()
}

/// Tiles of the plane that meet in the middle of the table.
fn quarters() -> Vec<Region> {
    let halves = [[f64::NEG_INFINITY, 0.03], [0.03, f64::INFINITY]];
    let (low, high) = (f64::NEG_INFINITY, f64::INFINITY);
    let of_x = halves.iter().flat_map(|x| halves.map(|y| (x, y)));
    of_x.map(|(x, y)| Region::new([x[0], y[0], low], [x[1], y[1], high]).unwrap())
        .collect()
}

/// The corners of a triangle, to the bit.
type Corners = [[u64; 3]; 3];

/// What the atlas shows in the middle of each triangle, by its corners: a colour, and when the photo
/// was taken that it is from, if one was.
fn shown(run: &Run) -> BTreeMap<Corners, ([f32; 3], Option<Stamp>)> {
    // Keyframes have numbers of their own in each program.
    let stamps: BTreeMap<u32, Stamp> = run.keyframes.iter().map(|k| (k.id.0, k.stamp)).collect();
    let stamp_of = |source: TexelSource| stamps.get(&source.as_keyframe()?).copied();
    let layout = &run.texinit.layout;
    let of_triangle = |triangle: TriangleId| {
        let corners = run.mesh.corners_m(triangle);
        let key = corners.map(|corner| [0, 1, 2].map(|axis| corner[axis].to_bits()));
        let [a, b, c] = layout.corners_texel[triangle.index()];
        let middle = [0, 1].map(|axis| (a[axis] + b[axis] + c[axis]) / 3.0);
        let page = &run.texinit.texture.pages[layout.page_of(triangle) as usize];
        #[expect(
            clippy::cast_possible_truncation,
            clippy::cast_sign_loss,
            reason = "a place on the page, rounded down"
        )]
        let [column, row] = middle.map(|side| side as usize);
        let at = row * page.width as usize + column;
        let color = sample_page(page, middle).unwrap_or_default();
        (key, (color, stamp_of(page.source[at])))
    };
    run.mesh.triangle_ids().map(of_triangle).collect()
}

#[test]
fn quarters_make_the_whole_every_triangle_once_and_in_the_same_colours() {
    let dir = tempfile::tempdir().unwrap();
    let bag = small_tabletop(dir.path(), &[]);
    let whole = shown(&painted(&bag, None));
    let mut joined = BTreeMap::new();
    let mut num_triangles = 0;
    for region in quarters() {
        let part = painted(&bag, Some(region));
        assert_eq!(
            part.texinit.assignment.label.len(),
            part.mesh.num_triangles()
        );
        assert!(part.mesh.num_triangles() > 50);
        num_triangles += part.mesh.num_triangles();
        joined.extend(shown(&part));
    }
    assert_eq!(num_triangles, whole.len());
    assert!(joined.keys().eq(whole.keys()));

    let pairs = || whole.values().zip(joined.values());
    let num_same = pairs().filter(|(a, b)| a.1 == b.1).count();
    let same_share = num_same as f64 / whole.len() as f64;
    assert!(
        same_share > 0.9,
        "{same_share} of triangles show the same frame"
    );
    // The parts have densities of their own.
    let difference = |(a, b): (&([f32; 3], _), &([f32; 3], _))| {
        let channels = a.0.iter().zip(&b.0);
        channels.map(|(a, b)| (a - b).abs()).sum::<f32>() / 3.0
    };
    let mut differences: Vec<f32> = pairs().map(difference).collect();
    differences.sort_by(f32::total_cmp);
    let median = differences[differences.len() / 2];
    assert!(
        median < 2.5,
        "half of the colours differ by more than {median}/255"
    );
}

#[test]
fn a_region_is_given_on_the_command_line() {
    let dir = tempfile::tempdir().unwrap();
    let bag = small_tabletop(dir.path(), &[]);
    let out = dir.path().join("out");
    let (bag, out) = (bag.to_str().unwrap(), out.to_str().unwrap());
    let args = ["replay", bag, "--out", out, "--json", "--quiet", "-p"];
    let mut num_triangles = Vec::new();
    for bounds in [
        "",
        "-inf -inf -inf 0.03 inf inf",
        "0.03 -inf -inf inf inf inf",
    ] {
        let bounds = format!("region.box:={bounds}");
        let mut all = args.to_vec();
        all.push(&bounds);
        let output = veneer(&all);
        assert!(output.status.success(), "{}", said(&output));
        let report: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
        num_triangles.push(report["mesh"]["num_triangles"].as_u64().unwrap());
    }
    assert_eq!(num_triangles[0], num_triangles[1] + num_triangles[2]);
    assert!(num_triangles[1] > 0 && num_triangles[2] > 0);
}

#[test]
fn a_tile_keeps_no_frame_that_sees_nothing_of_it_and_shows_what_it_would() {
    let dir = tempfile::tempdir().unwrap();
    let bag = dir.path().join("room.mcap");
    let path = bag.to_str().unwrap();
    let size = ["--frames", "40", "--width", "160", "--height", "120"];
    let args = [
        "--quiet",
        "synth",
        "room",
        "-o",
        path,
        "--edge-length-m",
        "0.15",
    ];
    veneer_ok(&[&args[..], &size].concat());

    let run_of = painted(&bag, None);
    let whole = shown(&run_of);
    let (low, high) = (f64::NEG_INFINITY, f64::INFINITY);
    let (mut joined, mut num_refused) = (BTreeMap::new(), 0);
    for [from, to] in [[low, 1.0], [1.0, high]] {
        let part = painted(&bag, Region::new([from, low, low], [to, high, high]).ok());
        let rejected = &part.store.rejected_by_reason;
        let num_rejected: u64 = rejected.values().sum();
        let (num_offered, num_admitted) = (part.store.num_offered, part.store.num_admitted);
        assert_eq!(num_offered, num_admitted + num_rejected);
        assert_eq!(num_offered, run_of.store.num_offered);
        num_refused += rejected.get("sees nothing of region.box").unwrap_or(&0);
        joined.extend(shown(&part));
    }
    assert!(joined.keys().eq(whole.keys()));
    let num_same = whole
        .values()
        .zip(joined.values())
        .filter(|(a, b)| a.1 == b.1);
    let same_share = num_same.count() as f64 / whole.len() as f64;
    // Which frames are near enough to others, and what is typical, each tile says of its own.
    assert!(
        same_share > 0.8,
        "{same_share} of triangles show the same frame"
    );
    let num_frames = run_of.store.num_offered;
    assert!(
        num_refused > num_frames / 8,
        "{num_refused} of {num_frames}"
    );
}
