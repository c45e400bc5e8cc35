//! The methods by name: each is the same program with other settings, other keyframes, or noise on
//! their poses. One row each; a new one needs nothing else.

use crate::config::{Config, ParameterError};

/// Which of the training keyframes paint.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Views {
    /// All of them.
    All,
    /// Every so-many-th.
    Every(usize),
}

/// Steps of the optimisation: those of the paper. `--steps` sets others.
const NUM_STEPS: &str = "4000";

/// A method.
#[derive(Clone, Copy, Debug)]
pub(super) struct Method {
    pub(super) name: &'static str,
    pub(super) description: &'static str,
    /// Parameters that make it, over what the user has set.
    pub(super) settings: &'static [(&'static str, &'static str)],
    pub(super) views: Views,
    /// Each Euler angle and translation component of a training pose is changed by up to this
    /// share of itself.
    pub(super) pose_noise: f64,
    /// Whether `--suite paper` has it.
    pub(super) in_paper: bool,
}

const T_ONLY: &[(&str, &str)] = &[("texinit.init", "assigned")];
const L2_AVG: &[(&str, &str)] = &[("texinit.init", "l2avg")];

const fn method(
    name: &'static str,
    description: &'static str,
    settings: &'static [(&'static str, &'static str)],
) -> Method {
    Method {
        name,
        description,
        settings,
        views: Views::All,
        pose_noise: 0.0,
        in_paper: true,
    }
}

const fn every(
    num: usize,
    name: &'static str,
    description: &'static str,
    settings: &'static [(&'static str, &'static str)],
) -> Method {
    Method {
        views: Views::Every(num),
        ..method(name, description, settings)
    }
}

const fn noisy(
    name: &'static str,
    description: &'static str,
    settings: &'static [(&'static str, &'static str)],
) -> Method {
    Method {
        pose_noise: 0.05,
        ..method(name, description, settings)
    }
}

const SMOOTH: &[(&str, &str)] = &[
    ("texinit.init", "assigned"),
    ("texsmooth.iterations", NUM_STEPS),
];
const NO_ALIGN: &[(&str, &str)] = &[
    ("texinit.init", "assigned"),
    ("texsmooth.iterations", NUM_STEPS),
    ("texsmooth.align", "false"),
];

const ADVTEX_C: &[(&str, &str)] = &[
    ("texinit.init", "l2avg"),
    ("texsmooth.iterations", NUM_STEPS),
    ("texsmooth.align", "false"),
];
/// From grey there is far to go, and no photo is a texel's own.
const ADVTEX_B: &[(&str, &str)] = &[
    ("texsmooth.start", "blank"),
    ("texsmooth.iterations", NUM_STEPS),
    ("texsmooth.align", "false"),
    ("texsmooth.learning_rate", "0.05"),
    ("texsmooth.own_weight", "1"),
];

const FAST: &[(&str, &str)] = &[
    ("texinit.init", "assigned"),
    ("photometric.gain", "true"),
    ("photometric.pose", "true"),
    ("photometric.global_seams", "true"),
    ("photometric.local_seams", "true"),
];
const FULL: &[(&str, &str)] = &[
    ("texinit.init", "assigned"),
    ("photometric.gain", "true"),
    ("photometric.pose", "true"),
    ("photometric.global_seams", "true"),
    ("photometric.local_seams", "true"),
    ("texsmooth.iterations", NUM_STEPS),
];

/// All methods, in the order of `--suite paper`.
pub(super) const METHODS: &[Method] = &[
    method(
        "l2avg",
        "the mean of every frame that sees the point",
        L2_AVG,
    ),
    method(
        "t-only",
        "TexInit alone: each triangle from its best frame",
        T_ONLY,
    ),
    method(
        "unary",
        "TexInit alone, every triangle by itself (ω4 = 0)",
        &[
            ("texinit.init", "assigned"),
            ("texinit.pairwise_weight", "0"),
        ],
    ),
    method(
        "pairwise",
        "TexInit alone, with the paper's reward for equal frames on adjacent triangles (ω4 = 1)",
        &[
            ("texinit.init", "assigned"),
            ("texinit.pairwise_weight", "1"),
        ],
    ),
    method(
        "gain",
        "TexInit with a gain for each keyframe",
        &[("texinit.init", "assigned"), ("photometric.gain", "true")],
    ),
    method(
        "pose",
        "TexInit with poses corrected by the offsets of photos",
        &[("texinit.init", "assigned"), ("photometric.pose", "true")],
    ),
    method(
        "seams",
        "TexInit with seams levelled, over regions and in a band",
        &[
            ("texinit.init", "assigned"),
            ("photometric.global_seams", "true"),
            ("photometric.local_seams", "true"),
        ],
    ),
    method("fast", "gain, pose and seams together", FAST),
    method("full", "fast, then TexSmooth: what veneer bake does", FULL),
    method(
        "smooth",
        "TexInit and TexSmooth: the paper's method",
        SMOOTH,
    ),
    method("no-align", "smooth without alignment", NO_ALIGN),
    method(
        "no-t",
        "smooth from l2avg",
        &[
            ("texinit.init", "l2avg"),
            ("texsmooth.iterations", NUM_STEPS),
        ],
    ),
    method("advtex-c", "smooth from l2avg without alignment", ADVTEX_C),
    method(
        "advtex-b",
        "smooth from a grey texture without alignment",
        ADVTEX_B,
    ),
    method(
        "patch2",
        "smooth, aligned in 2x2 patches",
        &[
            ("texinit.init", "assigned"),
            ("texsmooth.iterations", NUM_STEPS),
            ("texsmooth.align_grid", "2"),
            ("texsmooth.max_offset_share", "0.1"),
        ],
    ),
    method(
        "patch4",
        "smooth, aligned in 4x4 patches",
        &[
            ("texinit.init", "assigned"),
            ("texsmooth.iterations", NUM_STEPS),
            ("texsmooth.align_grid", "4"),
            ("texsmooth.max_offset_share", "0.2"),
        ],
    ),
    method(
        "smooth-pairwise",
        "smooth from pairwise",
        &[
            ("texinit.init", "assigned"),
            ("texinit.pairwise_weight", "1"),
            ("texsmooth.iterations", NUM_STEPS),
        ],
    ),
    method(
        "l1-only",
        "smooth without a discriminator",
        &[
            ("texinit.init", "assigned"),
            ("texsmooth.iterations", NUM_STEPS),
            ("texsmooth.discriminator.enabled", "false"),
        ],
    ),
    every(2, "every-2", "t-only from every second view", T_ONLY),
    every(3, "every-3", "t-only from every third view", T_ONLY),
    every(4, "every-4", "t-only from every fourth view", T_ONLY),
    every(5, "every-5", "t-only from every fifth view", T_ONLY),
    every(2, "smooth-every-2", "smooth from every second view", SMOOTH),
    every(3, "smooth-every-3", "smooth from every third view", SMOOTH),
    every(4, "smooth-every-4", "smooth from every fourth view", SMOOTH),
    every(5, "smooth-every-5", "smooth from every fifth view", SMOOTH),
    noisy(
        "l2avg-noise",
        "l2avg with ±5 % on each Euler angle and translation component of the training poses",
        L2_AVG,
    ),
    noisy(
        "t-only-noise",
        "t-only with ±5 % on each Euler angle and translation component of the training poses",
        T_ONLY,
    ),
    noisy("fast-noise", "fast with the same noise", FAST),
    noisy("full-noise", "full with the same noise", FULL),
    noisy("smooth-noise", "smooth with the same noise", SMOOTH),
    noisy("no-align-noise", "no-align with the same noise", NO_ALIGN),
    noisy("advtex-c-noise", "advtex-c with the same noise", ADVTEX_C),
    noisy("advtex-b-noise", "advtex-b with the same noise", ADVTEX_B),
];

impl Method {
    /// The method of that name.
    pub(super) fn find(name: &str) -> Option<&'static Self> {
        METHODS.iter().find(|method| method.name == name)
    }

    /// What the user has set, changed as the method asks.
    /// `num_steps` stands for the number of steps of those that optimise.
    pub(super) fn configure(
        &self,
        base: &Config,
        num_steps: Option<usize>,
    ) -> Result<Config, ParameterError> {
        let mut config = base.clone();
        for (name, value) in self.settings {
            config.set(name, value)?;
        }
        let steps = &mut config.pipeline.texsmooth.num_steps;
        if let Some(num_steps) = num_steps
            && *steps > 0
        {
            *steps = num_steps;
        }
        Ok(config)
    }

    /// The training keyframes that paint, of `num` in order.
    pub(super) fn is_painting(&self, index: usize) -> bool {
        match self.views {
            Views::All => true,
            Views::Every(num) => index.is_multiple_of(num.max(1)),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_row_can_be_configured_and_has_its_own_name() {
        for method in METHODS {
            method.configure(&Config::default(), None).unwrap();
            assert_eq!(
                Method::find(method.name).unwrap().description,
                method.description
            );
        }
        let mut names: Vec<_> = METHODS.iter().map(|method| method.name).collect();
        names.sort_unstable();
        names.dedup();
        assert_eq!(names.len(), METHODS.len());
    }

    #[test]
    fn settings_go_over_what_was_set() {
        let mut base = Config::default();
        base.set("texinit.init", "l2avg").unwrap();
        base.set("texinit.texels_per_m", "321").unwrap();
        let config = Method::find("unary")
            .unwrap()
            .configure(&base, None)
            .unwrap();
        let value = |name: &str| {
            let row = crate::config::tree::PARAMETERS
                .iter()
                .find(|p| p.name == name);
            row.unwrap().get(&mut config.clone())
        };
        assert_eq!(value("texinit.init"), "assigned");
        assert_eq!(value("texinit.pairwise_weight"), "0");
        assert_eq!(value("texinit.texels_per_m"), "321");
    }

    #[test]
    fn every_third_view_is_one_of_three() {
        let method = Method::find("every-3").unwrap();
        let painting: Vec<usize> = (0..8).filter(|&i| method.is_painting(i)).collect();
        assert_eq!(painting, [0, 3, 6]);
    }
}
