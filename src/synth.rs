//! Recordings of scenes whose every texel is known (L7).
//!
//! A scene is made of analytic primitives (rectangles, discs, cone mantles, spheres), each with a
//! procedural texture under fixed baked light. An analytic ray caster films it along a hand-held
//! path; faults of sensor, pose and mesh are added on request, each by its own switch, all off by
//! default. The bag holds what a real scanner would publish, and a metadata record from which
//! [`GroundTruth`] can be rebuilt, so that any result made from the bag can be scored exactly.
//!
//! World frame: metres, z up. Same options, same bytes: every random choice is a hash of (seed,
//! name, index), whatever the number of threads.
//!
//! Without noise the depth image is the true depth rounded to millimetres, poses and mesh are
//! exact, and a colour pixel is the scene's radiance averaged over the pixel, rounded to a byte
//! (JPEG then adds its own loss; PNG does not).

mod bvh;
mod caster;
mod font;
mod growth;
mod hash;
mod light;
mod options;
mod path;
mod picture;
mod record;
mod scene;
mod score;
mod sensor;
mod sight;
mod surface;
mod tessellate;
mod texture;
mod truth;
mod truth_atlas;

pub(crate) use font::dot_columns;
pub use options::{
    SceneName, SynthColorFormat, SynthDepthFormat, SynthError, SynthNoise, SynthOptions,
};
pub use record::{SynthSummary, synthesize};
pub use score::{Percentiles, Score, SurfaceScore, score};
pub use sight::PaintingView;
pub use truth::{GroundTruth, METADATA_NAME, TOLERANCE_M};
