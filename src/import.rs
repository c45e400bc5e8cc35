//! Data sets and phone captures to bags (L7).
//!
//! A format module lists what a folder holds (`scan::Scan`: files, poses, cameras); the rest is the
//! same for all: images are loaded a few frames at a time, written with their camera, pose and
//! transform by [`ScanWriter`], and the mesh goes with them, in one piece at the first frame's stamp or
//! growing. Photos keep their bytes; depth becomes 16-bit millimetres. Poses are camera-to-world of
//! the colour camera's optical frame; the world is the data set's own, turned to z up when
//! [`ImportOptions::up`] says so. A frame that cannot be used is left out and named in the summary. The bag appears under its name when it is whole.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use rayon::prelude::*;

use crate::bag::scan_writer::ScanWriter;
use crate::bag::{BagError, BagSummary};
use crate::geom::Stamp;
use crate::ingest::MeshUpdate;
use crate::mesh::{MeshError, TriMesh};

mod capture;
mod grow;
mod level;
mod load;
pub mod mesh_file;
pub mod model;
pub mod obj;
mod options;
pub mod ply;
mod scan;
mod seven_scenes;
mod three_d_scanner;
mod tum;

pub use options::{
    DepthOutput, ImportFormat, ImportFormatError, ImportOptions, SignedAxis, WorldUp,
};

use grow::Growth;
use load::{LoadError, LoadedFrame};
use mesh_file::{MeshFileError, MeshFileReport};
use scan::{Scan, ScanFrame};

/// Why nothing was imported.
#[derive(Debug, thiserror::Error)]
pub enum ImportError {
    /// An option is out of range, or not for this format.
    #[error("{reason}")]
    Option {
        /// Which, and why.
        reason: String,
    },
    /// A file or folder that every data set of the format has cannot be read.
    #[error("cannot read {path}: {source}")]
    Read {
        /// The file or folder.
        path: PathBuf,
        /// What the system says.
        source: std::io::Error,
    },
    /// A file is not what its format promises.
    #[error("{path}: {reason}")]
    Malformed {
        /// The file.
        path: PathBuf,
        /// What is wrong.
        reason: String,
    },
    /// The mesh that was asked for is not there.
    #[error("there is no mesh '{name}', neither in {folder} nor as a path of its own")]
    NoSuchMesh {
        /// As asked for.
        name: PathBuf,
        /// The data set.
        folder: PathBuf,
    },
    /// `grow` was asked for without a mesh.
    #[error("a growing mesh was asked for, but {folder} has no mesh; name one")]
    NothingToGrow {
        /// The data set.
        folder: PathBuf,
    },
    /// No frame can be used.
    #[error("{folder} has no usable {format} frame ({num_refused} refused{first_reason})")]
    NoFrames {
        /// The data set.
        folder: PathBuf,
        /// The format's name.
        format: &'static str,
        /// How many frames are there but cannot be used.
        num_refused: usize,
        /// The first refusal, behind a colon.
        first_reason: String,
    },
    /// The mesh file is refused.
    #[error(transparent)]
    MeshFile(#[from] MeshFileError),
    /// The mesh cannot be cut into blocks.
    #[error("the mesh does not divide: {0}")]
    Mesh(#[from] MeshError),
    /// The bag cannot be written.
    #[error(transparent)]
    Bag(#[from] BagError),
}

/// What was imported.
#[derive(Clone, Debug)]
pub struct ImportSummary {
    /// Frames in the bag: each has a photo, a camera and a pose.
    pub num_frames: usize,
    /// Frames that have a depth image too.
    pub num_depth_images: usize,
    /// Stamps of the first and the last frame.
    pub first: Stamp,
    /// See `first`.
    pub last: Stamp,
    /// The mesh, where there is one.
    pub mesh: Option<ImportedMesh>,
    /// Frames and depth images that were left out, with file and reason.
    pub refusals: Vec<String>,
    /// Choices that were made for the user, and what is missing.
    pub notes: Vec<String>,
    /// The bag.
    pub bag: BagSummary,
}

/// The mesh of an import.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ImportedMesh {
    /// Its file name.
    pub name: String,
    /// Vertices of the file.
    pub num_vertices: usize,
    /// Triangles of the file that are in the bag.
    pub num_triangles: usize,
    /// What was left out or cut.
    pub report: MeshFileReport,
    /// Messages that it is spread over.
    pub num_updates: usize,
    /// Triangles that no frame sees, where the mesh grows: they came with the last update.
    pub num_unseen_triangles: Option<usize>,
}

/// Frames that are in memory at once: enough to keep the cores busy, few enough to be small.
const NUM_FRAMES_PER_BATCH: usize = 16;

/// Writes the data set in the folder `src` as the bag `out`. `progress` is called with the number
/// of frames done and their total.
///
/// # Errors
/// [`ImportError`] when the folder is not of this format, has no usable frame, or the bag cannot
/// be written. Single bad frames are no error; see [`ImportSummary::refusals`].
pub fn import(
    format: ImportFormat,
    src: &Path,
    out: &Path,
    options: &ImportOptions,
    progress: &mut dyn FnMut(u64, u64),
) -> Result<ImportSummary, ImportError> {
    options.check(format)?;
    let mut scan = list(format, src, options)?;
    let mut mesh = read_mesh(&scan, src, options)?;
    let up = turn_up(&mut scan, mesh.as_mut().map(|(mesh, _)| mesh), options.up);
    let writer = ScanWriter::create(out, &options.topics, options.compression)?;
    let mut run = ImportRun::new(
        src,
        &scan,
        mesh.as_ref().map(|(mesh, _)| mesh),
        options,
        writer,
    );
    run.write_whole_mesh()?;
    run.write_frames(progress)?;
    let num_unseen_triangles = run.finish_growth()?;
    run.writer
        .metadata("veneer.import", describe(format, src, &scan, up, options))?;
    let ImportRun { counts, writer, .. } = run;
    let (Some(first), Some(last)) = (counts.first, counts.last) else {
        return Err(no_frames(format, src, &counts.refusals));
    };
    let imported_mesh = mesh.map(|(mesh, report)| ImportedMesh {
        name: scan.mesh.as_deref().map(file_name).unwrap_or_default(),
        num_vertices: mesh.num_vertices(),
        num_triangles: mesh.num_triangles(),
        report,
        num_updates: counts.num_mesh_updates,
        num_unseen_triangles,
    });
    Ok(ImportSummary {
        num_frames: counts.num_frames,
        num_depth_images: counts.num_depth_images,
        first,
        last,
        mesh: imported_mesh,
        refusals: counts.refusals,
        notes: scan.notes,
        bag: writer.finish()?,
    })
}

fn list(format: ImportFormat, src: &Path, options: &ImportOptions) -> Result<Scan, ImportError> {
    let scan = match format {
        ImportFormat::Capture => capture::list(src, options)?,
        ImportFormat::Tum => tum::list(src, options)?,
        ImportFormat::SevenScenes => seven_scenes::list(src, options)?,
        ImportFormat::ThreeDScanner => three_d_scanner::list(src, options)?,
    };
    if scan.frames.is_empty() {
        return Err(no_frames(format, src, &scan.refusals));
    }
    Ok(scan)
}

fn no_frames(format: ImportFormat, src: &Path, refusals: &[String]) -> ImportError {
    ImportError::NoFrames {
        folder: src.to_owned(),
        format: format.name(),
        num_refused: refusals.len(),
        first_reason: refusals
            .first()
            .map(|reason| format!(": {reason}"))
            .unwrap_or_default(),
    }
}

fn read_mesh(
    scan: &Scan,
    src: &Path,
    options: &ImportOptions,
) -> Result<Option<(TriMesh, MeshFileReport)>, ImportError> {
    match &scan.mesh {
        Some(path) => Ok(Some(mesh_file::read(path)?)),
        None if options.grow.is_some() => Err(ImportError::NothingToGrow {
            folder: src.to_owned(),
        }),
        None => Ok(None),
    }
}

/// Turns poses and mesh so that z is up; the up of the data set's world, where they were turned.
fn turn_up(scan: &mut Scan, mesh: Option<&mut TriMesh>, option: WorldUp) -> Option<[f64; 3]> {
    let Some(up) = level::up_in_world(option, scan, mesh.as_deref()) else {
        if option == WorldUp::Level {
            scan.notes.push(
                "which way is up cannot be told; the world is as recorded (--up says it)"
                    .to_owned(),
            );
        }
        return None;
    };
    let level_from_world = level::turn(&up);
    for frame in &mut scan.frames {
        frame.world_from_camera = level_from_world * frame.world_from_camera;
    }
    if let Some(mesh) = mesh {
        *mesh = mesh.transformed(&level_from_world);
    }
    let [x, y, z] = <[f64; 3]>::from(up.into_inner());
    if option == WorldUp::Level {
        scan.notes.push(format!(
            "z is up now; in the data set ({x:.3}, {y:.3}, {z:.3}) is (--up keep leaves it)"
        ));
    }
    Some([x, y, z])
}

fn file_name(path: &Path) -> String {
    path.file_name()
        .map(|name| name.to_string_lossy().into_owned())
        .unwrap_or_default()
}

/// Where the bag comes from, for `veneer info`; no path of the machine.
fn describe(
    format: ImportFormat,
    src: &Path,
    scan: &Scan,
    up: Option<[f64; 3]>,
    options: &ImportOptions,
) -> BTreeMap<String, String> {
    let up = up.map(|[x, y, z]| format!("{x} {y} {z}"));
    let mesh = scan.mesh.as_deref().map(file_name);
    [
        ("format", format.name().to_owned()),
        ("source", file_name(src)),
        ("refined", options.refined.to_string()),
        ("min_confidence", options.min_confidence.to_string()),
        ("mesh", mesh.unwrap_or_else(|| "none".to_owned())),
        ("up", up.unwrap_or_else(|| "as recorded".to_owned())),
    ]
    .map(|(key, value)| (key.to_owned(), value))
    .into()
}

#[derive(Default)]
struct ImportCounts {
    num_frames: usize,
    num_depth_images: usize,
    num_mesh_updates: usize,
    first: Option<Stamp>,
    last: Option<Stamp>,
    refusals: Vec<String>,
}

struct ImportRun<'a> {
    src: &'a Path,
    frames: &'a [ScanFrame],
    whole_mesh: Option<&'a TriMesh>,
    growth: Option<Growth<'a>>,
    options: &'a ImportOptions,
    writer: ScanWriter,
    counts: ImportCounts,
}

impl<'a> ImportRun<'a> {
    fn new(
        src: &'a Path,
        scan: &'a Scan,
        mesh: Option<&'a TriMesh>,
        options: &'a ImportOptions,
        writer: ScanWriter,
    ) -> Self {
        let first = scan.frames.first().map(|frame| frame.stamp);
        let last = scan.frames.last().map(|frame| frame.stamp);
        let growth = match (options.grow, mesh, first, last) {
            (Some(num_slices), Some(mesh), Some(first), Some(last)) => {
                Some(Growth::new(mesh, num_slices, first, last))
            }
            _ => None,
        };
        Self {
            src,
            frames: &scan.frames,
            whole_mesh: mesh.filter(|_| growth.is_none()),
            growth,
            options,
            writer,
            counts: ImportCounts {
                refusals: scan.refusals.clone(),
                ..ImportCounts::default()
            },
        }
    }

    fn write_whole_mesh(&mut self) -> Result<(), ImportError> {
        if let (Some(mesh), Some(first)) = (self.whole_mesh, self.frames.first()) {
            // A clone of one mesh, once: the update owns what a subscriber would receive.
            let update = MeshUpdate::Whole(mesh.clone());
            self.write_mesh_updates(vec![(first.stamp, update)])?;
        }
        Ok(())
    }

    fn write_frames(&mut self, progress: &mut dyn FnMut(u64, u64)) -> Result<(), ImportError> {
        let num_frames = self.frames.len() as u64;
        let mut num_done = 0;
        progress(num_done, num_frames);
        for batch in self.frames.chunks(NUM_FRAMES_PER_BATCH) {
            let loaded: Vec<Result<LoadedFrame, LoadError>> = batch
                .par_iter()
                .map(|frame| load::load(frame, self.options))
                .collect();
            for (frame, loaded) in batch.iter().zip(loaded) {
                match loaded {
                    Ok(loaded) => self.write_frame(loaded)?,
                    Err(error) => self.refuse(&frame.color, &error),
                }
                num_done += 1;
                progress(num_done, num_frames);
            }
        }
        Ok(())
    }

    fn refuse(&mut self, path: &Path, error: &LoadError) {
        let name = path.strip_prefix(self.src).unwrap_or(path).display();
        self.counts.refusals.push(format!("{name}: {error}"));
    }

    fn write_frame(&mut self, frame: LoadedFrame) -> Result<(), ImportError> {
        if let Some(growth) = &mut self.growth {
            let due = growth.due_before(frame.stamp)?;
            growth.see(&frame);
            self.write_mesh_updates(due)?;
        }
        let stamp = frame.stamp;
        self.writer.pose(stamp, &frame.world_from_camera)?;
        self.writer.color_info(stamp, &frame.color_camera)?;
        self.writer.color(stamp, &frame.color)?;
        if let Some(depth) = &frame.depth {
            self.writer.depth_info(depth.stamp, &depth.camera)?;
            self.writer.depth(depth.stamp, &depth.image)?;
            self.counts.num_depth_images += 1;
        }
        if let Some((path, error)) = &frame.refused_depth {
            self.refuse(path, error);
        }
        self.counts.num_frames += 1;
        self.counts.first.get_or_insert(stamp);
        self.counts.last = Some(stamp);
        Ok(())
    }

    fn write_mesh_updates(&mut self, due: Vec<(Stamp, MeshUpdate)>) -> Result<(), ImportError> {
        for (stamp, update) in due {
            self.writer.mesh(stamp, &update)?;
            self.counts.num_mesh_updates += 1;
        }
        Ok(())
    }

    /// Writes what of the growing mesh is left; how many triangles no frame saw.
    fn finish_growth(&mut self) -> Result<Option<usize>, ImportError> {
        let Some(growth) = self.growth.take() else {
            return Ok(None);
        };
        let (due, num_unseen) = growth.finish()?;
        self.write_mesh_updates(due)?;
        Ok(Some(num_unseen))
    }
}
