//! Charts and layout of a mesh file, without frames: what the geometry half of TexInit makes of it.
//!
//! ```text
//! cargo run --release --example unwrap -- MESH.ply|.obj [OUT.obj] [--paper] [--page N]
//!     [--texels-per-m N] [--threads N] [-p NAME:=VALUE]...
//! ```
//!
//! `--page N` fills one page of N × N texels as densely as it can. Prints times, counts and
//! distortion as JSON; `OUT.obj` gets the mesh with its texture coordinates in [0, 1] of its page (v
//! up, as OBJ has it), one group per page.

#![expect(
    clippy::print_stdout,
    reason = "an example is there to be read at the console"
)]

use std::fmt::Write as _;
use std::path::PathBuf;
use std::time::Instant;

use anyhow::{Context as _, bail};
use serde_json::json;
use veneer::atlas::{self, AtlasLayout, DensitySpread, num_shared_texels};
use veneer::config::Config;
use veneer::import::mesh_file;
use veneer::mesh::TriMesh;
use veneer::texinit::density::SizeRule;
use veneer::texinit::{TexInitParams, flatten, overlap};

/// The paper's plates for images whose longer side has up to 960 pixels.
const PLATE_TEXEL: u32 = 1024;

/// Texels that are enough to judge a layout by.
const DEFAULT_TEXELS: f64 = 8e6;

struct Options {
    mesh: PathBuf,
    out: Option<PathBuf>,
    params: TexInitParams,
    texels_per_m: Option<f64>,
}

fn main() -> anyhow::Result<()> {
    let options = options()?;
    let (mesh, _) = mesh_file::read(&options.mesh)?;
    let params = &options.params;

    let start = Instant::now();
    let flat = flatten::flatten(&mesh, &params.flatten)?;
    let flatten_s = start.elapsed().as_secs_f64();

    let start = Instant::now();
    let (charts, overlaps) = overlap::separate(&mesh, flat.charts, &params.overlap);
    let overlap_s = start.elapsed().as_secs_f64();

    let start = Instant::now();
    let num_separated = charts.len();
    let (charts, absorbed) = flatten::absorb(&mesh, &flat.manifold, charts, &params.flatten);
    let absorb_s = start.elapsed().as_secs_f64();

    // Charts of 1, 2–3, 4–7, 8–15, ... triangles.
    let mut chart_sizes = Vec::new();
    for chart in &charts {
        let class = chart.triangles.len().ilog2() as usize;
        chart_sizes.resize(chart_sizes.len().max(class + 1), 0);
        chart_sizes[class] += 1;
    }

    let area_m2: f64 = mesh.triangle_ids().map(|t| mesh.area_m2(t)).sum();
    let wanted = options
        .texels_per_m
        .unwrap_or_else(|| (DEFAULT_TEXELS / area_m2).sqrt());
    let start = Instant::now();
    let num_triangles = mesh.num_triangles();
    let (layout, pack) = match params.size_rule {
        SizeRule::Density => atlas::pack_to_budget(&charts, num_triangles, wanted, &params.pack)?,
        SizeRule::Paper => atlas::pack_plates(&charts, num_triangles, PLATE_TEXEL, &params.pack)?,
    };
    let pack_s = start.elapsed().as_secs_f64();

    if let Some(path) = &options.out {
        std::fs::write(path, obj(&mesh, &layout)?)
            .with_context(|| format!("cannot write {}", path.display()))?;
    }
    let report = &flat.report;
    let summary = json!({
        "num_triangles": mesh.num_triangles(),
        "num_threads": rayon::current_num_threads(),
        "seconds": { "flatten": flatten_s, "overlap": overlap_s, "absorb": absorb_s, "pack": pack_s },
        "num_grown_charts": report.num_grown_charts,
        "num_charts": report.num_charts,
        "num_charts_by_size": chart_sizes,
        "num_separated_charts": num_separated,
        "num_pieces": charts.len(),
        "seam_length_m": absorbed.seam_length_m,
        "manifold": format!("{:?}", report.manifold),
        "solve": format!("{:?}", report.solve),
        "distortion": format!("{:?}", absorbed.distortion),
        "absorb": format!("{absorbed:?}"),
        "overlap": format!("{overlaps:?}"),
        "pack": format!("{pack:?}"),
        "pages": [layout.page_size_texel[0], layout.page_size_texel[1], layout.num_pages],
        "texels_per_m": layout.texels_per_m,
        "density_spread": format!("{:?}", DensitySpread::of(&mesh, &layout)),
        "num_shared_texels": num_shared_texels(&layout),
    });
    println!("{}", serde_json::to_string_pretty(&summary)?);
    Ok(())
}

fn options() -> anyhow::Result<Options> {
    const USAGE: &str = "unwrap MESH.ply|.obj [OUT.obj] [--paper] [--page N] [--texels-per-m N] \
                         [--threads N] [-p NAME:=VALUE]...";
    let mut paths = Vec::new();
    let mut config = Config::default();
    let mut texels_per_m = None;
    let mut page_size_texel: Option<u32> = None;
    let mut words = std::env::args().skip(1);
    while let Some(word) = words.next() {
        let mut value = || words.next().context(USAGE);
        match word.as_str() {
            "--page" => page_size_texel = Some(value()?.parse()?),
            "--paper" => config.set("texinit.mode", "paper")?,
            "-p" => {
                let assignment = value()?;
                let (name, value) = assignment.split_once(":=").context(USAGE)?;
                config.set(name, value)?;
            }
            "--texels-per-m" => texels_per_m = Some(value()?.parse()?),
            "--threads" => rayon::ThreadPoolBuilder::new()
                .num_threads(value()?.parse()?)
                .build_global()?,
            flag if flag.starts_with('-') => bail!("unknown option {flag}; {USAGE}"),
            path => paths.push(PathBuf::from(path)),
        }
    }
    if let Some(side) = page_size_texel {
        let pack = &mut config.pipeline.texinit.pack;
        pack.page_size_texel = side;
        pack.max_texels = u64::from(side).pow(2);
        // More than fits: the budget decides.
        texels_per_m = texels_per_m.or(Some(1e6));
    }
    let mut paths = paths.into_iter();
    Ok(Options {
        mesh: paths.next().context(USAGE)?,
        out: paths.next(),
        params: config.pipeline.texinit,
        texels_per_m,
    })
}

fn obj(mesh: &TriMesh, layout: &AtlasLayout) -> Result<String, std::fmt::Error> {
    let mut text = String::new();
    for p in mesh.positions_m() {
        writeln!(text, "v {} {} {}", p.x, p.y, p.z)?;
    }
    for triangle in mesh.triangle_ids() {
        for [u, v] in layout.corners_uv(triangle) {
            writeln!(text, "vt {u} {}", 1.0 - v)?;
        }
    }
    for page in 0..layout.num_pages {
        writeln!(text, "g page_{page}")?;
        for triangle in mesh.triangle_ids().filter(|&t| layout.page_of(t) == page) {
            let [a, b, c] = mesh.triangles()[triangle.index()].map(|v| v + 1);
            let first = 3 * triangle.index() + 1;
            writeln!(text, "f {a}/{first} {b}/{} {c}/{}", first + 1, first + 2)?;
        }
    }
    Ok(text)
}
