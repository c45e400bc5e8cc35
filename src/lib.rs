//! veneer paints a scan while it is being made.
//!
//! ```text
//! ROS topics ┐
//!            ├─ wire ─→ ingest ─→ keyframe ─→ texinit ─→ atlas ─→ export, report
//! MCAP bag ──┘  (CDR ↔ our types)  (sync, pose)  (store)
//! ```
//!
//! Data flows one way. Pure compute ([`geom`], [`mesh`], [`render`], [`atlas`], [`keyframe`],
//! [`texinit`]) knows neither ROS nor files. The method is that of Zhao, Zhao, Schwing,
//! "Initialization and Alignment for Adversarial Texture Optimization", ECCV 2022.
//!
//! Conventions: metres, radians, integer nanoseconds; optical frames (x right, y down, z
//! forward); transforms are named `dst_from_src`; image pixel centres are at integers, texel
//! centres at halves. See `ARCHITECTURE.md` for who may import whom.

#![cfg_attr(
    test,
    allow(
        clippy::cast_possible_truncation,
        reason = "tests make their data of small numbers; the product is checked without cfg(test)"
    )
)]

pub mod atlas;
#[cfg(feature = "bag")]
pub mod bag;
#[cfg(feature = "cli")]
pub mod cli;
#[cfg(feature = "bag")]
pub mod config;
pub mod export;
pub mod geom;
#[cfg(feature = "bag")]
pub mod import;
pub mod ingest;
pub mod keyframe;
pub mod mesh;
pub mod metrics;
pub mod photometric;
pub mod pipeline;
pub mod publish;
pub mod render;
pub mod report;
#[cfg(feature = "ros")]
pub mod ros;
#[cfg(feature = "bag")]
pub mod synth;
pub mod texinit;
pub mod texsmooth;
pub mod wire;
