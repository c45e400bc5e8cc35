//! The words that stand for settings of what is published.

use super::Config;
use crate::export::PageFormat;
use crate::publish::PublishParams;

/// Quality of JPEG where none was chosen.
const JPEG_QUALITY: u8 = 90;

fn set_format(format: &mut PageFormat, other: PageFormat, word: &str) {
    *format = match (word, *format, other) {
        ("jpeg", PageFormat::Png, PageFormat::Jpeg { quality }) => PageFormat::Jpeg { quality },
        ("jpeg", PageFormat::Png, PageFormat::Png) => PageFormat::Jpeg {
            quality: JPEG_QUALITY,
        },
        ("jpeg", jpeg, _) => jpeg,
        _ => PageFormat::Png,
    };
}

fn word(format: PageFormat) -> &'static str {
    match format {
        PageFormat::Png => "png",
        PageFormat::Jpeg { .. } => "jpeg",
    }
}

pub(super) fn set_tiles(config: &mut Config, word: &str) {
    let PublishParams {
        format,
        viewer_format,
        ..
    } = &mut config.publish;
    set_format(format, *viewer_format, word);
}

pub(super) fn tiles(config: &Config) -> &'static str {
    word(config.publish.format)
}

pub(super) fn set_viewer_textures(config: &mut Config, word: &str) {
    let PublishParams {
        format,
        viewer_format,
        ..
    } = &mut config.publish;
    set_format(viewer_format, *format, word);
}

pub(super) fn viewer_textures(config: &Config) -> &'static str {
    word(config.publish.viewer_format)
}

pub(super) fn set_jpeg_quality(config: &mut Config, text: &str) -> Option<()> {
    let wanted: u8 = text.parse().ok().filter(|q| (1..=100).contains(q))?;
    let PublishParams {
        format,
        viewer_format,
        ..
    } = &mut config.publish;
    for format in [format, viewer_format] {
        if let PageFormat::Jpeg { quality } = format {
            *quality = wanted;
        }
    }
    Some(())
}

pub(super) fn jpeg_quality(config: &Config) -> String {
    let formats = [config.publish.viewer_format, config.publish.format];
    let quality = formats.into_iter().find_map(|format| match format {
        PageFormat::Jpeg { quality } => Some(quality),
        PageFormat::Png => None,
    });
    quality.unwrap_or(JPEG_QUALITY).to_string()
}
