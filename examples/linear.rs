//! How flattening's time and memory grow with a mesh: makes a mesh of any size, sound or badly
//! broken, flattens it and prints one row of JSON. `scripts/linear.sh` makes the table and the fit.
//!
//! ```text
//! cargo run --release --example linear -- blob|terrain|room NUM_TRIANGLES
//!     [--broken] [--paper] [--cones N] [--threads N] [--repeat N] [--write OUT.ply]
//! ```
//!
//! - `blob`: a closed bumpy surface; `terrain`: a rough height field; `room`: walls with furniture
//!   standing on the floor, as boxes that share no vertex with it. All have noise of a tenth of an
//!   edge on every vertex, as scans have.
//! - `--broken`: of every ten triangles one has a fin on an edge (three faces there) and of every
//!   twenty one is there twice, alternately turned round; at every fiftieth a further triangle hangs
//!   on by a vertex alone.

#![expect(
    clippy::print_stdout,
    reason = "an example is there to be read at the console"
)]

use std::io::Write as _;
use std::path::PathBuf;
use std::time::Instant;

use anyhow::{Context as _, bail};
use nalgebra::{Point3, Vector3};
use serde_json::json;
use veneer::mesh::TriMesh;
use veneer::texinit::flatten::{ChartMode, FlattenParams, FlattenResult, flatten};

const USAGE: &str = "linear blob|terrain|room NUM_TRIANGLES [--broken] [--paper] [--cones N] \
                     [--threads N] [--repeat N] [--write OUT.ply]";

struct Options {
    shape: String,
    num_triangles: usize,
    is_broken: bool,
    params: FlattenParams,
    num_repeats: usize,
    out: Option<PathBuf>,
}

fn main() -> anyhow::Result<()> {
    let options = options()?;
    let mesh = make(&options)?;
    if let Some(path) = &options.out {
        std::fs::write(path, ply(&mesh)?)
            .with_context(|| format!("cannot write {}", path.display()))?;
    }
    let (mut seconds, mut cpu_s) = (f64::MAX, None);
    let mut stages = [0.0; 3];
    let mut result = None;
    for _ in 0..options.num_repeats {
        let (start, cpu_start) = (Instant::now(), cpu_seconds());
        let flat = flatten(&mesh, &options.params)?;
        let passed = start.elapsed().as_secs_f64();
        if passed < seconds {
            seconds = passed;
            cpu_s = cpu_seconds().zip(cpu_start).map(|(end, start)| end - start);
            let report = &flat.report;
            stages = [report.manifold_time, report.charts_time, report.solve_time]
                .map(|time| time.as_secs_f64());
        }
        result = Some(flat);
    }
    let result = result.context(USAGE)?;
    let report = &result.report;
    let row = json!({
        "shape": options.shape,
        "broken": options.is_broken,
        "triangles": mesh.num_triangles(),
        "threads": rayon::current_num_threads(),
        "seconds": seconds,
        "cpu_s": cpu_s,
        "manifold_s": stages[0],
        "charts_s": stages[1],
        "solve_s": stages[2],
        "peak_mib": peak_mib(),
        "charts": report.num_charts,
        "seam_m": report.seam_length_m,
        "quasi_conformal": report.distortion.quasi_conformal_mean,
        "non_manifold_edges": report.manifold.num_non_manifold_edges,
        "solve": format!("{:?}", report.solve),
        "digest": format!("{:016x}", digest(&result)),
    });
    println!("{row}");
    Ok(())
}

fn options() -> anyhow::Result<Options> {
    let mut plain = Vec::new();
    let mut options = Options {
        shape: String::new(),
        num_triangles: 0,
        is_broken: false,
        params: FlattenParams::default(),
        num_repeats: 1,
        out: None,
    };
    let mut words = std::env::args().skip(1);
    while let Some(word) = words.next() {
        let mut value = || words.next().context(USAGE);
        match word.as_str() {
            "--broken" => options.is_broken = true,
            "--paper" => options.params.mode = ChartMode::Paper,
            "--cones" => options.params.max_cones = value()?.parse()?,
            "--repeat" => options.num_repeats = value()?.parse()?,
            "--write" => options.out = Some(value()?.into()),
            "--threads" => rayon::ThreadPoolBuilder::new()
                .num_threads(value()?.parse()?)
                .build_global()?,
            flag if flag.starts_with('-') => bail!("unknown option {flag}; {USAGE}"),
            _ => plain.push(word),
        }
    }
    let mut plain = plain.into_iter();
    options.shape = plain.next().context(USAGE)?;
    options.num_triangles = plain.next().context(USAGE)?.parse()?;
    Ok(options)
}

/// Positions and triangles as they are made.
#[derive(Default)]
struct Soup {
    positions_m: Vec<Point3<f64>>,
    triangles: Vec<[u32; 3]>,
}

fn make(options: &Options) -> anyhow::Result<TriMesh> {
    // Each ten sound triangles bring 1 fin, 1/2 double and 1/5 hanging one.
    let share = if options.is_broken { 1.17 } else { 1.0 };
    let num_sound = options.num_triangles as f64 / share;
    let mut soup = Soup::default();
    match options.shape.as_str() {
        "blob" => soup.blob(num_sound),
        "terrain" => soup.terrain(num_sound),
        "room" => soup.room(num_sound),
        shape => bail!("unknown shape {shape}; {USAGE}"),
    }
    if options.is_broken {
        soup.spoil();
    }
    Ok(TriMesh::from_soup(soup.positions_m, soup.triangles)?.0)
}

/// Numbers in [-1, 1) that look random and are the same everywhere.
fn noise(seed: u32) -> f64 {
    let mut x = seed.wrapping_mul(0x9e37_79b9).wrapping_add(0x85eb_ca6b);
    x ^= x >> 16;
    x = x.wrapping_mul(0x7feb_352d);
    x ^= x >> 15;
    x = x.wrapping_mul(0x846c_a68b);
    x ^= x >> 16;
    f64::from(x) / f64::from(u32::MAX) * 2.0 - 1.0
}

#[expect(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "a count of cells, well below 2^32"
)]
fn cells(count: f64) -> u32 {
    count.round().max(1.0) as u32
}

#[expect(clippy::cast_possible_truncation, reason = "well below 2^32")]
fn index(count: usize) -> u32 {
    count as u32
}

impl Soup {
    /// A sheet of `columns` × `rows` cells, two triangles each.
    fn sheet(&mut self, [columns, rows]: [u32; 2], place: impl Fn(f64, f64) -> Point3<f64>) {
        let first = index(self.positions_m.len());
        for j in 0..=rows {
            for i in 0..=columns {
                let (u, v) = (
                    f64::from(i) / f64::from(columns),
                    f64::from(j) / f64::from(rows),
                );
                self.positions_m.push(place(u, v));
            }
        }
        for j in 0..rows {
            for i in 0..columns {
                let a = first + j * (columns + 1) + i;
                let [b, c, d] = [a + 1, a + columns + 2, a + columns + 1];
                // Diagonals alternate.
                if (i + j) % 2 == 0 {
                    self.triangles.extend([[a, b, c], [a, c, d]]);
                } else {
                    self.triangles.extend([[a, b, d], [b, c, d]]);
                }
            }
        }
    }

    /// The six sides of a box, welded by position; outside faces out where `is_solid`.
    fn cuboid(&mut self, low: [f64; 3], high: [f64; 3], pitch_m: f64, is_solid: bool) {
        let at = |axis: usize, t: f64| low[axis] + t * (high[axis] - low[axis]);
        for axis in 0..3 {
            let (u_axis, v_axis) = ((axis + 1) % 3, (axis + 2) % 3);
            let size = |axis: usize| cells((high[axis] - low[axis]) / pitch_m);
            for is_high in [false, true] {
                let swaps = is_high != is_solid;
                let counts = if swaps {
                    [size(v_axis), size(u_axis)]
                } else {
                    [size(u_axis), size(v_axis)]
                };
                self.sheet(counts, |u, v| {
                    let (u, v) = if swaps { (v, u) } else { (u, v) };
                    let mut point = [0.0; 3];
                    point[axis] = if is_high { high[axis] } else { low[axis] };
                    point[u_axis] = at(u_axis, u);
                    point[v_axis] = at(v_axis, v);
                    Point3::from(point)
                });
            }
        }
    }

    /// Equal positions move alike, so that what touches stays together.
    fn shake(&mut self, reach_m: f64) {
        for p in &mut self.positions_m {
            let key = [p.x, p.y, p.z].map(|c| cells(1e5 * (c + 1e3)));
            let seed = key[0]
                .wrapping_mul(31)
                .wrapping_add(key[1])
                .wrapping_mul(1009)
                ^ key[2];
            *p += reach_m * Vector3::new(noise(seed), noise(seed ^ 0x5555), noise(seed ^ 0xaaaa));
        }
    }

    fn blob(&mut self, num_triangles: f64) {
        let side = cells((num_triangles / 12.0).sqrt());
        let pitch_m = 2.0 / f64::from(side);
        self.cuboid([-1.0; 3], [1.0; 3], pitch_m, true);
        for p in &mut self.positions_m {
            let direction = p.coords.normalize();
            let [x, y, z] = [direction.x, direction.y, direction.z];
            let bumps = 0.15 * (3.0 * x).sin() * (4.0 * y).cos()
                + 0.08 * (9.0 * z + 2.0 * x).sin() * (7.0 * y).sin()
                + 0.03 * (23.0 * x).sin() * (19.0 * y + 11.0 * z).cos();
            *p = Point3::from((1.0 + bumps) * direction);
        }
        self.shake(0.1 * pitch_m);
    }

    fn terrain(&mut self, num_triangles: f64) {
        let side = cells((num_triangles / 2.0).sqrt());
        let pitch_m = 4.0 / f64::from(side);
        self.sheet([side, side], |u, v| {
            let (x, y) = (4.0 * u, 4.0 * v);
            let height = 0.3 * (1.7 * x).sin() * (1.3 * y).cos()
                + 0.12 * (5.0 * x + 1.0).sin() * (4.3 * y).sin()
                + 0.05 * (13.0 * x).sin() * (11.0 * y + 3.0 * x).cos();
            Point3::new(x, y, height)
        });
        self.shake(0.1 * pitch_m);
    }

    fn room(&mut self, num_triangles: f64) {
        let furniture = [
            ([0.3, 0.3, 0.0], [2.3, 1.2, 0.5]),
            ([3.0, 2.0, 0.0], [4.2, 2.8, 0.75]),
            ([4.9, 0.1, 0.0], [5.9, 0.6, 2.0]),
            ([0.1, 2.9, 0.0], [0.6, 3.9, 1.4]),
            ([2.2, 3.2, 0.9], [3.0, 3.3, 1.5]),
        ];
        let area = |low: [f64; 3], high: [f64; 3]| {
            let [x, y, z] = [0, 1, 2].map(|axis| high[axis] - low[axis]);
            2.0 * (x * y + y * z + z * x)
        };
        let (low, high) = ([0.0; 3], [6.0, 4.0, 2.7]);
        let mut total_m2 = area(low, high);
        for (low, high) in furniture {
            total_m2 += area(low, high);
        }
        let pitch_m = (2.0 * total_m2 / num_triangles).sqrt();
        self.cuboid(low, high, pitch_m, false);
        for (low, high) in furniture {
            // Just above the floor, so that nothing is shared with it.
            let low = [low[0], low[1], low[2] + 0.001];
            self.cuboid(low, high, pitch_m, true);
        }
        self.shake(0.1 * pitch_m);
    }

    /// Fins, doubles and hanging triangles.
    fn spoil(&mut self) {
        for t in 0..self.triangles.len() {
            let [a, b, c] = self.triangles[t];
            let [p, q, r] = [a, b, c].map(|v| self.positions_m[v as usize]);
            let normal = (q - p).cross(&(r - p));
            let up = normal.try_normalize(0.0).unwrap_or_default() * (q - p).norm();
            if t % 10 == 0 {
                let tip = index(self.positions_m.len());
                self.positions_m.push(nalgebra::center(&p, &q) + up);
                self.triangles.push([a, b, tip]);
            }
            match t % 40 {
                5 => self.triangles.push([a, b, c]),
                25 => self.triangles.push([a, c, b]),
                _ => {}
            }
            if t % 50 == 7 {
                let tip = index(self.positions_m.len());
                self.positions_m.extend([p + up, p + up + 0.5 * (r - p)]);
                self.triangles.push([a, tip, tip + 1]);
            }
        }
    }
}

/// FNV-1a over the bits of every chart: equal only where all charts are, bit for bit.
fn digest(result: &FlattenResult) -> u64 {
    let mut hash = 0xcbf2_9ce4_8422_2325_u64;
    let mut mix = |word: u64| {
        for byte in word.to_le_bytes() {
            hash = (hash ^ u64::from(byte)).wrapping_mul(0x0100_0000_01b3);
        }
    };
    for chart in &result.charts {
        mix(chart.triangles.len() as u64);
        for (triangle, corners) in chart.triangles.iter().zip(&chart.corners_m) {
            mix(u64::from(triangle.0));
            corners.iter().flatten().for_each(|c| mix(c.to_bits()));
        }
    }
    hash
}

/// Processor time of all threads so far, where the system says it: unlike the clock, it tells little
/// of what else the machine does.
fn cpu_seconds() -> Option<f64> {
    const TICKS_PER_S: f64 = 100.0;
    let stat = std::fs::read_to_string("/proc/self/stat").ok()?;
    // Fields after the name in brackets; user and system time are the 12th and 13th of them.
    let mut fields = stat.rsplit(')').next()?.split_whitespace().skip(11);
    let mut ticks = || fields.next()?.parse::<f64>().ok();
    Some((ticks()? + ticks()?) / TICKS_PER_S)
}

/// Most memory this process has held, where the system says it.
fn peak_mib() -> Option<f64> {
    let status = std::fs::read_to_string("/proc/self/status").ok()?;
    let line = status.lines().find(|line| line.starts_with("VmHWM:"))?;
    let kib: f64 = line.split_whitespace().nth(1)?.parse().ok()?;
    Some(kib / 1024.0)
}

fn ply(mesh: &TriMesh) -> std::io::Result<Vec<u8>> {
    let mut bytes = Vec::new();
    write!(
        bytes,
        "ply\nformat binary_little_endian 1.0\nelement vertex {}\nproperty double x\n\
         property double y\nproperty double z\nelement face {}\n\
         property list uchar int vertex_indices\nend_header\n",
        mesh.num_vertices(),
        mesh.num_triangles()
    )?;
    for p in mesh.positions_m() {
        for c in p.iter() {
            bytes.extend(c.to_le_bytes());
        }
    }
    for corners in mesh.triangles() {
        bytes.push(3);
        for v in corners {
            bytes.extend(v.to_le_bytes());
        }
    }
    Ok(bytes)
}
