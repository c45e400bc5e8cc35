//! Settings of what is written that are words, or not plain numbers.

use super::Config;
use crate::export::NormalMode;
use crate::export::pages::PageFormat;

/// JPEG quality where none was chosen.
const JPEG_QUALITY: u8 = 92;

pub(super) fn set_glb_images(config: &mut Config, word: &str) {
    config.export.glb_pages = match (word, config.export.glb_pages) {
        ("jpeg", PageFormat::Png) => PageFormat::Jpeg {
            quality: JPEG_QUALITY,
        },
        ("jpeg", jpeg) => jpeg,
        _ => PageFormat::Png,
    };
}

pub(super) fn glb_images(config: &Config) -> &'static str {
    match config.export.glb_pages {
        PageFormat::Png => "png",
        PageFormat::Jpeg { .. } => "jpeg",
    }
}

pub(super) fn set_jpeg_quality(config: &mut Config, text: &str) -> Option<()> {
    let wanted: u8 = text.parse().ok()?;
    if !(1..=100).contains(&wanted) {
        return None;
    }
    if let PageFormat::Jpeg { quality } = &mut config.export.glb_pages {
        *quality = wanted;
    } else if wanted != JPEG_QUALITY {
        config.export.glb_pages = PageFormat::Jpeg { quality: wanted };
    }
    Some(())
}

pub(super) fn jpeg_quality(config: &Config) -> String {
    match config.export.glb_pages {
        PageFormat::Png => JPEG_QUALITY.to_string(),
        PageFormat::Jpeg { quality } => quality.to_string(),
    }
}

pub(super) fn set_normals(config: &mut Config, word: &str) {
    config.export.normals = match word {
        "flat" => NormalMode::Flat,
        _ => NormalMode::Smooth,
    };
}

pub(super) fn normals(config: &Config) -> &'static str {
    match config.export.normals {
        NormalMode::Smooth => "smooth",
        NormalMode::Flat => "flat",
    }
}
