//! Settings of TexInit that are words, or not plain numbers.

use super::Config;
use crate::texinit::assign::{ColorCue, DepthCue};
use crate::texinit::density::SizeRule;
use crate::texinit::flatten::{ChartBoundary, ChartMode};
use crate::texinit::overlap::OverlapForm;
use crate::texinit::transfer::{Lookup, MeanForm, TransferMode};
use crate::texinit::{Coupling, TexInitParams};

pub(super) fn set_mode(config: &mut Config, word: &str) {
    config.pipeline.texinit = match word {
        "paper" => TexInitParams::paper(),
        _ => TexInitParams::default(),
    };
}

pub(super) fn mode(config: &Config) -> &'static str {
    match config.pipeline.texinit.flatten.mode {
        ChartMode::Streaming => "streaming",
        ChartMode::Paper => "paper",
    }
}

pub(super) fn set_coupling(config: &mut Config, word: &str) {
    config.pipeline.texinit.coupling = match word {
        "chart" => Coupling::Chart,
        _ => Coupling::Scan,
    };
}

pub(super) fn coupling(config: &Config) -> &'static str {
    match config.pipeline.texinit.coupling {
        Coupling::Scan => "scan",
        Coupling::Chart => "chart",
    }
}

pub(super) fn set_overlap_form(config: &mut Config, word: &str) {
    config.pipeline.texinit.overlap.form = match word {
        "reference" => OverlapForm::Reference,
        _ => OverlapForm::Printed,
    };
}

pub(super) fn overlap_form(config: &Config) -> &'static str {
    match config.pipeline.texinit.overlap.form {
        OverlapForm::Printed => "printed",
        OverlapForm::Reference => "reference",
    }
}

pub(super) fn set_chart_boundary(config: &mut Config, word: &str) {
    config.pipeline.texinit.flatten.boundary = match word {
        "disk" => ChartBoundary::Disk,
        _ => ChartBoundary::Isometric,
    };
}

pub(super) fn chart_boundary(config: &Config) -> &'static str {
    match config.pipeline.texinit.flatten.boundary {
        ChartBoundary::Isometric => "isometric",
        ChartBoundary::Disk => "disk",
    }
}

pub(super) fn set_init(config: &mut Config, word: &str) {
    config.pipeline.texinit.transfer.mode = match word {
        "l2avg" => TransferMode::L2Avg,
        _ => TransferMode::Assigned,
    };
}

pub(super) fn init(config: &Config) -> &'static str {
    match config.pipeline.texinit.transfer.mode {
        TransferMode::Assigned => "assigned",
        TransferMode::L2Avg => "l2avg",
    }
}

pub(super) fn set_size_rule(config: &mut Config, word: &str) {
    config.pipeline.texinit.size_rule = match word {
        "paper" => SizeRule::Paper,
        _ => SizeRule::Density,
    };
}

pub(super) fn size_rule(config: &Config) -> &'static str {
    match config.pipeline.texinit.size_rule {
        SizeRule::Density => "density",
        SizeRule::Paper => "paper",
    }
}

pub(super) fn set_depth_cue(config: &mut Config, word: &str) {
    config.pipeline.texinit.assign.depth_cue = match word {
        "sum" => DepthCue::DepthSum,
        _ => DepthCue::LargestRange,
    };
}

pub(super) fn depth_cue(config: &Config) -> &'static str {
    match config.pipeline.texinit.assign.depth_cue {
        DepthCue::LargestRange => "largest",
        DepthCue::DepthSum => "sum",
    }
}

pub(super) fn set_color_cue(config: &mut Config, word: &str) {
    config.pipeline.texinit.assign.color_cue = match word {
        "vertex" => ColorCue::ValidAtVertex,
        "triangle" => ColorCue::ValidForTriangle,
        _ => ColorCue::SeeingFrames,
    };
}

pub(super) fn color_cue(config: &Config) -> &'static str {
    match config.pipeline.texinit.assign.color_cue {
        ColorCue::SeeingFrames => "seeing",
        ColorCue::ValidAtVertex => "vertex",
        ColorCue::ValidForTriangle => "triangle",
    }
}

pub(super) fn set_lookup(config: &mut Config, word: &str) {
    config.pipeline.texinit.transfer.lookup = match word {
        "nearest" => Lookup::NearestAffine,
        _ => Lookup::Footprint,
    };
}

pub(super) fn lookup(config: &Config) -> &'static str {
    match config.pipeline.texinit.transfer.lookup {
        Lookup::Footprint => "footprint",
        Lookup::NearestAffine => "nearest",
    }
}

pub(super) fn set_mean(config: &mut Config, word: &str) {
    config.pipeline.texinit.transfer.mean_form = match word {
        "projecting" => MeanForm::Projecting,
        _ => MeanForm::Seeing,
    };
}

pub(super) fn mean(config: &Config) -> &'static str {
    match config.pipeline.texinit.transfer.mean_form {
        MeanForm::Seeing => "seeing",
        MeanForm::Projecting => "projecting",
    }
}

pub(super) fn set_pairwise_weight(config: &mut Config, text: &str) -> Option<()> {
    let weight: f32 = text.parse().ok()?;
    if !(0.0..=100.0).contains(&weight) {
        return None;
    }
    let pairwise = &mut config.pipeline.texinit.assign.pairwise;
    if weight > 0.0 {
        pairwise.get_or_insert_default().weight = weight;
    } else {
        *pairwise = None;
    }
    Some(())
}

pub(super) fn pairwise_weight(config: &Config) -> String {
    let pairwise = &config.pipeline.texinit.assign.pairwise;
    pairwise.as_ref().map_or(0.0, |p| p.weight).to_string()
}

fn unit_interval(text: &str) -> Option<f64> {
    let value: f64 = text.parse().ok()?;
    (0.0..=1.0).contains(&value).then_some(value)
}

pub(super) fn set_occlusion_tolerance(config: &mut Config, text: &str) -> Option<()> {
    let assign = &mut config.pipeline.texinit.assign;
    assign.visibility.get_or_insert_default().tolerance_m = unit_interval(text)?;
    Some(())
}

pub(super) fn occlusion_tolerance(config: &Config) -> String {
    let visibility = config.pipeline.texinit.assign.visibility.clone();
    visibility.unwrap_or_default().tolerance_m.to_string()
}

/// 0 stands for no limit.
pub(super) fn set_far(config: &mut Config, text: &str) -> Option<()> {
    let far_m: f64 = text.parse().ok()?;
    if !(0.0..=1000.0).contains(&far_m) {
        return None;
    }
    let far_m = if far_m > 0.0 { far_m } else { f64::INFINITY };
    let texinit = &mut config.pipeline.texinit;
    if let Some(visibility) = &mut texinit.assign.visibility {
        visibility.far_m = far_m;
    }
    texinit.transfer.visibility.far_m = far_m;
    Some(())
}

pub(super) fn far(config: &Config) -> String {
    let far_m = config.pipeline.texinit.transfer.visibility.far_m;
    if far_m.is_finite() { far_m } else { 0.0 }.to_string()
}

pub(super) fn set_relative_tolerance(config: &mut Config, text: &str) -> Option<()> {
    let assign = &mut config.pipeline.texinit.assign;
    assign.visibility.get_or_insert_default().relative_tolerance = unit_interval(text)?;
    Some(())
}

pub(super) fn relative_tolerance(config: &Config) -> String {
    let visibility = config.pipeline.texinit.assign.visibility.clone();
    visibility
        .unwrap_or_default()
        .relative_tolerance
        .to_string()
}

pub(super) fn set_max_texels(config: &mut Config, text: &str) -> Option<()> {
    let num_texels: u64 = text.parse().ok()?;
    if !(4096..=1 << 34).contains(&num_texels) {
        return None;
    }
    config.pipeline.texinit.pack.max_texels = num_texels;
    Some(())
}

pub(super) fn max_texels(config: &Config) -> String {
    config.pipeline.texinit.pack.max_texels.to_string()
}

const PAGE_SIZES: [(&str, u32); 7] = [
    ("256", 256),
    ("512", 512),
    ("1024", 1024),
    ("2048", 2048),
    ("4096", 4096),
    ("8192", 8192),
    ("16384", 16384),
];

pub(super) fn set_page_size(config: &mut Config, word: &str) {
    if let Some((_, size)) = PAGE_SIZES.iter().find(|(name, _)| *name == word) {
        config.pipeline.texinit.pack.page_size_texel = *size;
    }
}

pub(super) fn page_size(config: &Config) -> &'static str {
    page_size_word(config.pipeline.texinit.pack.page_size_texel)
}

pub(super) fn set_stream_page_size(config: &mut Config, word: &str) {
    if let Some((_, size)) = PAGE_SIZES.iter().find(|(name, _)| *name == word) {
        config.pipeline.stream.page_size_texel = *size;
    }
}

pub(super) fn stream_page_size(config: &Config) -> &'static str {
    page_size_word(config.pipeline.stream.page_size_texel)
}

fn page_size_word(current: u32) -> &'static str {
    PAGE_SIZES
        .iter()
        .find(|(_, size)| *size == current)
        .map_or("4096", |(name, _)| name)
}
