//! The words that stand for settings of painting what changed.

use super::Config;
use crate::pipeline::StreamMode;

pub(super) fn set_mode(config: &mut Config, word: &str) {
    config.pipeline.stream_mode = match word {
        "changes" => StreamMode::Changes,
        "whole" => StreamMode::Whole,
        _ => StreamMode::Auto,
    };
}

pub(super) fn mode(config: &Config) -> &'static str {
    match config.pipeline.stream_mode {
        StreamMode::Auto => "auto",
        StreamMode::Changes => "changes",
        StreamMode::Whole => "whole",
    }
}
