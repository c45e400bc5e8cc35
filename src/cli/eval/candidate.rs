//! What is compared: a method of ours, or a mesh made elsewhere; and its renderings.

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Instant;

use anyhow::Context;
use rayon::prelude::*;

use super::methods::{METHODS, Method};
use super::{HeldOut, usage};
use crate::config::Config;
use crate::export::{self, ExportParams, TexturedMesh};
use crate::geom::{ColorImage, EncodedColor, RigidTransform};
use crate::import::model;
use crate::keyframe::Keyframe;
use crate::mesh::TexturedModel;
use crate::metrics::protocol::MethodView;
use crate::pipeline::{Scan, StageClock, texture_scan, with_pose_noise};
use crate::render::{RenderParams, RenderedView, render_model, render_textured};

/// One of what is compared.
pub(super) struct Candidate {
    pub(super) name: String,
    kind: Kind,
    views: Vec<StoredView>,
}

enum Kind {
    Method(&'static Method),
    Model {
        path: PathBuf,
        model: Box<TexturedModel>,
    },
}

/// A rendering, compressed: there are as many as methods times views.
struct StoredView {
    render: EncodedColor,
    /// A bit per pixel.
    mask: Vec<u64>,
}

/// What methods of ours make their textures from.
pub(super) struct Textures<'a> {
    pub(super) scan: &'a Scan,
    pub(super) training: &'a [Arc<Keyframe>],
    pub(super) seed: u64,
    /// Steps of the methods that optimise, where they are not the usual ones.
    pub(super) num_steps: Option<usize>,
    /// Where textures go, when they are wanted.
    pub(super) out: Option<PathBuf>,
}

/// How a candidate's texture came about.
#[derive(Debug, Default)]
pub(super) struct Made {
    pub(super) num_views: Option<usize>,
    pub(super) seconds: Option<f64>,
    /// Density that the layout was made for.
    pub(super) texels_per_m: Option<f64>,
}

/// What is compared when nothing is said.
const DEFAULT_METHODS: [&str; 2] = ["t-only", "l2avg"];

/// The candidates that the arguments name, meshes read.
pub(super) fn parse(
    is_suite: bool,
    methods: &[String],
    places: &[String],
) -> anyhow::Result<Vec<Candidate>> {
    let of_suite = METHODS.iter().filter(|method| is_suite && method.in_paper);
    let mut names: Vec<String> = of_suite.map(|method| method.name.to_owned()).collect();
    names.extend_from_slice(methods);
    if names.is_empty() {
        names = DEFAULT_METHODS.map(str::to_owned).to_vec();
    }
    let places = places
        .iter()
        .map(|place| read_place(place))
        .collect::<anyhow::Result<Vec<(String, RigidTransform)>>>()?;
    let mut candidates: Vec<Candidate> = Vec::with_capacity(names.len());
    for text in &names {
        let candidate = match text.split_once('=') {
            Some((name, path)) => read_model(name, Path::new(path), &places)?,
            None => Candidate {
                name: text.clone(),
                kind: Kind::Method(Method::find(text).ok_or_else(|| unknown(text))?),
                views: Vec::new(),
            },
        };
        if candidates.iter().any(|c| c.name == candidate.name) {
            // A suite's method that is named once more.
            if matches!(candidate.kind, Kind::Method(_)) {
                continue;
            }
            return Err(usage(format!(
                "two methods are called '{}'",
                candidate.name
            )));
        }
        candidates.push(candidate);
    }
    let is_model = |name: &str| {
        let mut models = candidates
            .iter()
            .filter(|c| matches!(c.kind, Kind::Model { .. }));
        models.any(|candidate| candidate.name == name)
    };
    match places.iter().find(|(name, _)| !is_model(name)) {
        Some((name, _)) => Err(usage(format!(
            "--place {name}: no mesh of that name is among the methods"
        ))),
        None => Ok(candidates),
    }
}

fn unknown(name: &str) -> anyhow::Error {
    let known: Vec<&str> = METHODS.iter().map(|method| method.name).collect();
    usage(format!(
        "unknown method '{name}'; known are {}, or NAME=FILE for a mesh",
        known.join(", ")
    ))
}

fn read_place(text: &str) -> anyhow::Result<(String, RigidTransform)> {
    let (name, path) = text
        .split_once('=')
        .ok_or_else(|| usage(format!("--place '{text}' is not NAME=FILE")))?;
    let json = std::fs::read_to_string(path).with_context(|| format!("cannot read {path}"))?;
    let rows: [[f64; 4]; 4] = serde_json::from_str(&json)
        .with_context(|| format!("{path} is not a 4x4 matrix as JSON"))?;
    let placed = RigidTransform::try_from_matrix(&rows)
        .with_context(|| format!("{path} is not a rigid transform"))?;
    Ok((name.to_owned(), placed))
}

fn read_model(
    name: &str,
    path: &Path,
    places: &[(String, RigidTransform)],
) -> anyhow::Result<Candidate> {
    if name.is_empty() {
        return Err(usage(format!("the mesh {} has no name", path.display())));
    }
    let mut model = model::read(path)?;
    if let Some((_, place)) = places.iter().find(|(placed, _)| placed == name) {
        model = model.transformed(place);
    }
    Ok(Candidate {
        name: name.to_owned(),
        kind: Kind::Model {
            path: path.to_owned(),
            model: Box::new(model),
        },
        views: Vec::new(),
    })
}

impl Candidate {
    /// What it is, in words.
    pub(super) fn description(&self) -> String {
        match &self.kind {
            Kind::Method(method) => method.description.to_owned(),
            Kind::Model { path, model } => format!(
                "{}, {} triangles",
                path.file_name().unwrap_or_default().to_string_lossy(),
                model.mesh().num_triangles()
            ),
        }
    }

    /// Whether it was made from wrong poses on purpose. Such are compared among themselves: they
    /// are displaced so far that they would cut the others' views down.
    pub(super) fn is_disturbed(&self) -> bool {
        matches!(&self.kind, Kind::Method(method) if method.pose_noise != 0.0)
    }

    /// Makes the texture, where it is not there yet, and renders every held-out view.
    pub(super) fn render(
        &mut self,
        textures: &Textures<'_>,
        held_out: &[HeldOut],
        config: &Config,
        progress: &dyn crate::pipeline::Progress,
    ) -> anyhow::Result<Made> {
        let params = RenderParams::default();
        match &self.kind {
            Kind::Method(method) => {
                let config = method.configure(config, textures.num_steps)?;
                let painting: Vec<Arc<Keyframe>> = textures
                    .training
                    .iter()
                    .enumerate()
                    .filter(|(index, _)| method.is_painting(*index))
                    .map(|(_, keyframe)| match method.pose_noise {
                        0.0 => Arc::clone(keyframe),
                        share => Arc::new(with_pose_noise(keyframe, share, textures.seed)),
                    })
                    .collect();
                let begun = Instant::now();
                let clock = StageClock::new(progress);
                let texinit =
                    texture_scan(textures.scan, &painting, &config.pipeline, &clock)?.texinit;
                let seconds = begun.elapsed().as_secs_f64();
                let mesh = &textures.scan.mesh;
                if let Some(out) = &textures.out {
                    let textured = TexturedMesh::new(mesh, &texinit.layout, &texinit.texture)?;
                    let glb_alone = ExportParams {
                        obj: false,
                        ply: false,
                        provenance: false,
                        ..config.export.clone()
                    };
                    export::write_all(&textured, &out.join(&self.name), &glb_alone)?;
                }
                self.views = render_all(held_out, |view| {
                    let pose = view.keyframe.world_from_camera.inverse();
                    render_textured(
                        mesh,
                        &texinit.layout,
                        &texinit.texture,
                        &view.camera,
                        &pose,
                        &params,
                    )
                })?;
                Ok(Made {
                    num_views: Some(painting.len()),
                    seconds: Some(seconds),
                    texels_per_m: Some(texinit.report.wanted_texels_per_m),
                })
            }
            Kind::Model { model, .. } => {
                self.views = render_all(held_out, |view| {
                    let pose = view.keyframe.world_from_camera.inverse();
                    render_model(model, &view.camera, &pose, &params)
                })?;
                Ok(Made::default())
            }
        }
    }

    /// What it shows of a held-out view.
    pub(super) fn view(&self, index: usize) -> anyhow::Result<MethodView> {
        let stored = self.views.get(index).context("the view was not rendered")?;
        let render: ColorImage = stored.render.decode()?;
        let mask = (0..render.pixels().len())
            .map(|i| stored.mask[i / 64] >> (i % 64) & 1 == 1)
            .collect();
        Ok(MethodView { render, mask })
    }
}

fn render_all(
    held_out: &[HeldOut],
    render: impl Fn(&HeldOut) -> Result<RenderedView, crate::geom::ImageError> + Sync,
) -> anyhow::Result<Vec<StoredView>> {
    held_out
        .par_iter()
        .map(|view| {
            let RenderedView { color, mask } = render(view)?;
            let bits = |pixels: &[bool]| {
                let set = pixels.iter().enumerate().filter(|(_, is_set)| **is_set);
                set.map(|(bit, _)| 1u64 << bit).sum()
            };
            Ok(StoredView {
                render: EncodedColor::png_from_image(&color)?,
                mask: mask.chunks(64).map(bits).collect(),
            })
        })
        .collect()
}
