//! The stages of TexInit: triangles (or texels, or pixels) per second.
//!
//! A small synthetic scan, made once, goes through all of them; the apartment's mesh, where it
//! lies beside the checkout, through those that need no frames.

use std::hint::black_box;
use std::path::Path;
use std::sync::Arc;
use std::time::Duration;

use criterion::measurement::WallTime;
use criterion::{BatchSize, BenchmarkGroup, Criterion, SamplingMode, Throughput};
use veneer::atlas::{AtlasLayout, AtlasTexture, PackParams, dilate_gutters, pack};
use veneer::bag::{BagReader, TopicRoles};
use veneer::import::mesh_file;
use veneer::ingest::{Assembled, Assembler, EventSource, IngestParams};
use veneer::keyframe::{Keyframe, KeyframeParams, KeyframeStore};
use veneer::mesh::{TriMesh, weld};
use veneer::render::{RasterWorkspace, ViewBuffer, rasterize};
use veneer::synth::{SceneName, SynthOptions, synthesize};
use veneer::texinit::assign::{AssignParams, Assignment, FrameTable, assign};
use veneer::texinit::density::{DensityParams, wanted_texels_per_m};
use veneer::texinit::fill::{FillParams, fill_unseen};
use veneer::texinit::flatten::{FlatChart, FlattenParams, absorb, flatten};
use veneer::texinit::overlap::{OverlapParams, separate};
use veneer::texinit::transfer::{TransferParams, transfer};

/// Texels per metre of the apartment: a texel to 5 mm.
const APARTMENT_TEXELS_PER_M: f64 = 200.0;

/// `texinit_tabletop/*` and `texinit_apartment/*`: one bench per stage.
pub(crate) fn bench(criterion: &mut Criterion) {
    bench_tabletop(criterion);
    bench_apartment(criterion);
}

fn bench_tabletop(criterion: &mut Criterion) {
    let scan = Scan::tabletop();
    let assignment = scan.assign();
    let density = DensityParams::default();
    let texels_per_m = wanted_texels_per_m(&scan.mesh, &assignment.best_texels_per_m, &density);
    let mut group = group(criterion, "texinit_tabletop");
    let layout = bench_charts(&mut group, &scan.mesh, texels_per_m);
    bench_frames(&mut group, &scan);
    bench_texels(&mut group, &scan, &layout, &assignment);
    group.finish();
}

#[expect(clippy::print_stderr, reason = "a bench that cannot run says SKIPPED")]
fn bench_apartment(criterion: &mut Criterion) {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../shared/data/apt0_structure/mesh.ply");
    if !path.is_file() {
        eprintln!("SKIPPED: no capture at ../shared/data/apt0_structure");
        return;
    }
    let (mesh, _) = mesh_file::read(&path).expect("a mesh");
    let mut group = group(criterion, "texinit_apartment");
    bench_charts(&mut group, &mesh, APARTMENT_TEXELS_PER_M);
    group.finish();
}

fn group<'a>(criterion: &'a mut Criterion, name: &str) -> BenchmarkGroup<'a, WallTime> {
    let mut group = criterion.benchmark_group(name);
    group
        .sample_size(10)
        .sampling_mode(SamplingMode::Flat)
        .warm_up_time(Duration::from_millis(200))
        .measurement_time(Duration::from_secs(1));
    group
}

/// A recording, read back as a live run would: a mesh and keyframes that decode on demand.
struct Scan {
    mesh: TriMesh,
    store: KeyframeStore,
    keyframes: Vec<Arc<Keyframe>>,
}

impl Scan {
    fn tabletop() -> Self {
        let folder = tempfile::tempdir().expect("a temporary folder");
        let path = folder.path().join("tabletop.mcap");
        let options = SynthOptions {
            num_frames: Some(20),
            width: 320,
            height: 240,
            ..SynthOptions::default()
        };
        synthesize(SceneName::Tabletop, &options, &path, &mut |_, _| {}).expect("a recording");
        Self::read(&path)
    }

    fn read(path: &Path) -> Self {
        let mut bag = BagReader::open(path, &TopicRoles::default()).expect("a bag");
        let mut assembler = Assembler::new(&IngestParams::default(), bag.topics());
        let mut assembled = Vec::new();
        while let Some(event) = bag.next_event() {
            assembler.push(event, &mut assembled);
        }
        assembler.finish(&mut assembled);
        let mut store = KeyframeStore::new(&KeyframeParams::default());
        let mut mesh = None;
        for item in assembled {
            match item {
                Assembled::Frame(frame) => drop(store.offer(frame)),
                Assembled::Mesh(update) => mesh = Some(update),
                Assembled::Corrections(_) => panic!("the recording corrects no poses"),
            }
        }
        let welded = weld(&mesh.expect("the recording has a mesh"), 0.0).expect("a small mesh");
        let keyframes: Vec<_> = store.keyframes().cloned().collect();
        assert!(!keyframes.is_empty(), "the recording has usable frames");
        Self {
            mesh: welded.mesh,
            store,
            keyframes,
        }
    }

    fn assign(&self) -> Assignment {
        let decode = |keyframe: &Keyframe| self.store.decode(keyframe);
        let params = AssignParams::default();
        assign(&self.mesh, &self.keyframes, &decode, &params, &|_| {}).expect("an assignment")
    }

    fn transfer(&self, layout: &AtlasLayout, assignment: &Assignment) -> AtlasTexture {
        let decode = |keyframe: &Keyframe| self.store.decode(keyframe);
        let (texture, _) = transfer(
            &self.mesh,
            layout,
            assignment,
            &self.keyframes,
            &decode,
            &TransferParams::default(),
            &|_| {},
        )
        .expect("a texture");
        texture
    }
}

/// `flatten`, `separate`, `absorb`, `pack`: triangles per second.
fn bench_charts(
    group: &mut BenchmarkGroup<'_, WallTime>,
    mesh: &TriMesh,
    texels_per_m: f64,
) -> AtlasLayout {
    let flattened = || flatten(mesh, &FlattenParams::default()).expect("charts");
    let separated = |charts: Vec<FlatChart>| separate(mesh, charts, &OverlapParams::default());
    let flat = flattened();
    let (charts, manifold) = (flat.charts, flat.manifold);
    let (apart, _) = separated(charts.clone());
    let num_triangles = mesh.num_triangles();
    let packed = || pack(&apart, num_triangles, texels_per_m, &PackParams::default());

    group.throughput(Throughput::Elements(num_triangles as u64));
    group.bench_function("flatten", |bencher| bencher.iter(|| black_box(flattened())));
    group.bench_function("separate", |bencher| {
        bencher.iter_batched(|| charts.clone(), separated, BatchSize::PerIteration);
    });
    group.bench_function("absorb", |bencher| {
        bencher.iter_batched(
            || apart.clone(),
            |charts| absorb(mesh, &manifold, charts, &FlattenParams::default()),
            BatchSize::PerIteration,
        );
    });
    group.bench_function("pack", |bencher| {
        bencher.iter(|| black_box(packed().expect("a layout")));
    });
    packed().expect("a layout").0
}

/// `rasterize`: triangles per second over one view; `add_frame`: the same for one frame more in a
/// table; `assign`: triangles times frames per second, decoding included.
fn bench_frames(group: &mut BenchmarkGroup<'_, WallTime>, scan: &Scan) {
    let num_triangles = scan.mesh.num_triangles() as u64;
    let keyframe = &scan.keyframes[scan.keyframes.len() / 2];
    let camera = keyframe.color_camera.pinhole;
    let camera_from_world = keyframe.world_from_camera.inverse();
    let mut workspace = RasterWorkspace::default();
    let mut view = ViewBuffer::default();

    group.throughput(Throughput::Elements(num_triangles));
    group.bench_function("rasterize", |bencher| {
        bencher.iter(|| {
            rasterize(
                &scan.mesh,
                &camera,
                &camera_from_world,
                &mut workspace,
                &mut view,
            );
            black_box(&view);
        });
    });
    let mesh = Arc::new(scan.mesh.clone());
    let mut table = FrameTable::new(mesh, AssignParams::default()).expect("a table");
    let decoded = scan.store.decode(keyframe).expect("a frame");
    group.bench_function("add_frame", |bencher| {
        bencher.iter(|| table.add(0, keyframe, &decoded));
    });
    let num_pairs = num_triangles * scan.keyframes.len() as u64;
    group.throughput(Throughput::Elements(num_pairs));
    group.bench_function("assign", |bencher| {
        bencher.iter(|| black_box(scan.assign()))
    });
}

/// `transfer`, `fill_and_gutter`: texels of all pages per second.
fn bench_texels(
    group: &mut BenchmarkGroup<'_, WallTime>,
    scan: &Scan,
    layout: &AtlasLayout,
    assignment: &Assignment,
) {
    let painted = scan.transfer(layout, assignment);
    let [width, height] = layout.page_size_texel.map(u64::from);
    let num_texels = width * height * u64::from(layout.num_pages);

    group.throughput(Throughput::Elements(num_texels));
    group.bench_function("transfer", |bencher| {
        bencher.iter(|| black_box(scan.transfer(layout, assignment)));
    });
    group.bench_function("fill_and_gutter", |bencher| {
        bencher.iter_batched(
            || painted.clone(),
            |mut texture| {
                let params = FillParams::default();
                fill_unseen(&scan.mesh, layout, &mut texture, &params).expect("a filled texture");
                dilate_gutters(layout, &mut texture).expect("a texture with gutters");
                texture
            },
            BatchSize::PerIteration,
        );
    });
}
