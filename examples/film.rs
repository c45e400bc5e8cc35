//! A film strip of a scan that grows: paints a bag as it comes, by the bag's time, and draws the mesh from
//! above and the first page of the atlas after some of the updates, side by side.
//!
//! ```text
//! cargo run --release --example film -- BAG PERIOD_S OUT.png [NUM_FRAMES] [PARAMETER:=VALUE …]
//! ```

use std::path::Path;
use std::sync::Arc;

use anyhow::{Context as _, bail, ensure};
use nalgebra::{Matrix3, Point3, Rotation3, UnitQuaternion, Vector3};
use veneer::atlas::{AtlasLayout, AtlasTexture, TexturePage};
use veneer::bag::BagReader;
use veneer::config::Config;
use veneer::geom::{ColorImage, PinholeCamera, RigidTransform};
use veneer::mesh::TriMesh;
use veneer::pipeline::{NoProgress, StreamPainter, Streamed, stream};
use veneer::render::textured::{RenderParams, render_textured};

const USAGE: &str = "film BAG PERIOD_S OUT.png [NUM_FRAMES] [PARAMETER:=VALUE …]";
/// Width and height of a picture, pixels.
const PICTURE_PX: [u32; 2] = [480, 360];
const FOCAL_PX: f64 = 520.0;

/// A painted state.
struct State {
    mesh: Arc<TriMesh>,
    layout: Arc<AtlasLayout>,
    texture: AtlasTexture,
}

fn main() -> anyhow::Result<()> {
    let mut args = std::env::args().skip(1);
    let (Some(bag), Some(period_s), Some(out)) = (args.next(), args.next(), args.next()) else {
        bail!(USAGE);
    };
    let (mut config, mut num_frames) = (Config::default(), 6);
    for arg in args {
        match arg.split_once(":=") {
            Some((name, value)) => config.set(name, value)?,
            None => num_frames = arg.parse().context(USAGE)?,
        }
    }
    ensure!(num_frames >= 1, USAGE);
    let states = states(Path::new(&bag), period_s.parse().context(USAGE)?, &config)?;
    let last = states.last().context("nothing is painted")?;
    let (camera, camera_from_world) = from_above(&last.mesh)?;

    let size = PICTURE_PX.map(|side| side as usize);
    let mut strip = vec![[0u8; 3]; num_frames * size[0] * 2 * size[1]];
    for frame in 0..num_frames {
        let index = ((frame + 1) * states.len()).div_ceil(num_frames) - 1;
        let state = &states[index];
        let view = render_textured(
            &state.mesh,
            &state.layout,
            &state.texture,
            &camera,
            &camera_from_world,
            &RenderParams::default(),
        )?;
        let page = state.texture.pages.first().context("an atlas has pages")?;
        let mut put = |row_px: usize, picture: &ColorImage| {
            for (row, pixels) in picture.pixels().chunks_exact(size[0]).enumerate() {
                let at = (row_px + row) * num_frames * size[0] + frame * size[0];
                strip[at..at + size[0]].copy_from_slice(pixels);
            }
        };
        put(0, &view.color);
        put(size[1], &thumbnail(page)?);
    }
    let width = u32::try_from(num_frames)? * PICTURE_PX[0];
    let bytes: Vec<u8> = strip.into_flattened();
    let height = 2 * PICTURE_PX[1];
    image::save_buffer(&out, &bytes, width, height, image::ColorType::Rgb8)?;
    Ok(())
}

/// The state after every update.
fn states(bag: &Path, period_s: f64, config: &Config) -> anyhow::Result<Vec<State>> {
    let mut source = BagReader::open(bag, &config.topics)?;
    let mut states = Vec::new();
    let mut see = |painter: &StreamPainter, _: &Streamed| {
        if let Some(state) = painter.state() {
            states.push(State {
                mesh: state.mesh().clone(),
                layout: state.layout().clone(),
                texture: state.texture().clone(),
            });
        }
    };
    stream(
        &mut source,
        &config.pipeline,
        period_s,
        &NoProgress,
        &mut see,
    )?;
    Ok(states)
}

/// A camera above the mesh that sees all of it, z being up.
fn from_above(mesh: &TriMesh) -> anyhow::Result<(PinholeCamera, RigidTransform)> {
    let mut low = Point3::from([f64::INFINITY; 3]);
    let mut high = Point3::from([f64::NEG_INFINITY; 3]);
    for point in mesh.positions_m() {
        low = low.inf(point);
        high = high.sup(point);
    }
    let [width, height] = PICTURE_PX;
    let center_px = [width, height].map(|side| f64::from(side - 1) / 2.0);
    let camera = PinholeCamera::new(
        [FOCAL_PX, FOCAL_PX, center_px[0], center_px[1]],
        width,
        height,
    )?;
    let radius_m = 0.5 * (high - low).norm();
    let distance_m = radius_m * FOCAL_PX / (0.5 * f64::from(height));
    // Looks down 55° below the horizon, along x.
    let (sine, cosine) = 55f64.to_radians().sin_cos();
    let forward = Vector3::new(cosine, 0.0, -sine);
    let right = Vector3::new(0.0, -1.0, 0.0);
    let down = forward.cross(&right);
    let axes = Rotation3::from_matrix_unchecked(Matrix3::from_columns(&[right, down, forward]));
    let eye = nalgebra::center(&low, &high) - forward * distance_m;
    let world_from_camera =
        RigidTransform::from_parts(UnitQuaternion::from_rotation_matrix(&axes), eye.coords);
    Ok((camera, world_from_camera.inverse()))
}

/// The whole page, as high as a picture.
fn thumbnail(page: &TexturePage) -> anyhow::Result<ColorImage> {
    let [width, height] = PICTURE_PX;
    let side = page.width.max(page.height);
    let mut pixels = Vec::with_capacity((width * height) as usize);
    for y in 0..height {
        for x in 0..width {
            let [column, row] =
                [x, y].map(|at| u64::from(at) * u64::from(side) / u64::from(height));
            let is_on_page = column < u64::from(page.width) && row < u64::from(page.height);
            let at = usize::try_from(row * u64::from(page.width) + column)?;
            pixels.push(if is_on_page { page.srgb[at] } else { [32; 3] });
        }
    }
    Ok(ColorImage::new(width, height, pixels)?)
}
