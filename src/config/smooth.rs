//! The words that stand for settings of TexSmooth.

use super::Config;
use crate::texsmooth::align::AlignForm;
use crate::texsmooth::discriminator::{Gate, Padding};
use crate::texsmooth::{
    Backend, L1Target, PartnerOffset, PartnerRule, SmoothStart, TexSmoothParams,
};

pub(super) fn set_mode(config: &mut Config, word: &str) {
    config.pipeline.texsmooth = match word {
        "paper" => TexSmoothParams::paper(),
        _ => TexSmoothParams::default(),
    };
}

pub(super) fn mode(config: &Config) -> &'static str {
    if config.pipeline.texsmooth.crop_px == 0 {
        "paper"
    } else {
        "crops"
    }
}

pub(super) fn set_seed(config: &mut Config, text: &str) -> Option<()> {
    config.pipeline.texsmooth.seed = text.parse().ok()?;
    Some(())
}

pub(super) fn seed(config: &Config) -> String {
    config.pipeline.texsmooth.seed.to_string()
}

pub(super) fn set_backend(config: &mut Config, word: &str) {
    config.pipeline.texsmooth.backend = match word {
        "gpu" => Backend::Gpu,
        "auto" => Backend::Auto,
        _ => Backend::Cpu,
    };
}

pub(super) fn backend(config: &Config) -> &'static str {
    match config.pipeline.texsmooth.backend {
        Backend::Cpu => "cpu",
        Backend::Gpu => "gpu",
        Backend::Auto => "auto",
    }
}

pub(super) fn set_start(config: &mut Config, word: &str) {
    config.pipeline.texsmooth.start = match word {
        "blank" => SmoothStart::Blank,
        _ => SmoothStart::Texture,
    };
}

pub(super) fn start(config: &Config) -> &'static str {
    match config.pipeline.texsmooth.start {
        SmoothStart::Texture => "texture",
        SmoothStart::Blank => "blank",
    }
}

pub(super) fn set_l1_target(config: &mut Config, word: &str) {
    config.pipeline.texsmooth.l1_target = match word {
        "partner" => L1Target::Partner,
        _ => L1Target::Photo,
    };
}

pub(super) fn l1_target(config: &Config) -> &'static str {
    match config.pipeline.texsmooth.l1_target {
        L1Target::Photo => "photo",
        L1Target::Partner => "partner",
    }
}

pub(super) fn set_padding(config: &mut Config, word: &str) {
    config.pipeline.texsmooth.discriminator.padding = match word {
        "one" => Padding::One,
        _ => Padding::Valid,
    };
}

pub(super) fn padding(config: &Config) -> &'static str {
    match config.pipeline.texsmooth.discriminator.padding {
        Padding::Valid => "valid",
        Padding::One => "one",
    }
}

pub(super) fn set_gate(config: &mut Config, word: &str) {
    config.pipeline.texsmooth.gate = match word {
        "always" => Gate::Always,
        _ => Gate::WhenBehind,
    };
}

pub(super) fn gate(config: &Config) -> &'static str {
    match config.pipeline.texsmooth.gate {
        Gate::WhenBehind => "when_behind",
        Gate::Always => "always",
    }
}

pub(super) fn set_partner_rule(config: &mut Config, word: &str) {
    config.pipeline.texsmooth.partner_rule = match word {
        "world_axis" => PartnerRule::WorldAxis,
        _ => PartnerRule::ViewingAxis,
    };
}

pub(super) fn partner_rule(config: &Config) -> &'static str {
    match config.pipeline.texsmooth.partner_rule {
        PartnerRule::ViewingAxis => "viewing_axis",
        PartnerRule::WorldAxis => "world_axis",
    }
}

pub(super) fn set_align_form(config: &mut Config, word: &str) {
    config.pipeline.texsmooth.align.form = match word {
        "phase" => AlignForm::Phase,
        "reference" => AlignForm::Reference,
        _ => AlignForm::Refined,
    };
}

pub(super) fn align_form(config: &Config) -> &'static str {
    match config.pipeline.texsmooth.align.form {
        AlignForm::Refined => "refined",
        AlignForm::Phase => "phase",
        AlignForm::Reference => "reference",
    }
}

pub(super) fn set_partner_offset(config: &mut Config, word: &str) {
    config.pipeline.texsmooth.partner_offset = match word {
        "view" => PartnerOffset::View,
        _ => PartnerOffset::Own,
    };
}

pub(super) fn partner_offset(config: &Config) -> &'static str {
    match config.pipeline.texsmooth.partner_offset {
        PartnerOffset::Own => "own",
        PartnerOffset::View => "view",
    }
}
