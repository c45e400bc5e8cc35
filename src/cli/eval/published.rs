//! What the paper prints: ECCV 2022, tables 1 and 2, and of its supplement the tables on views and
//! patches, on pose noise. Means over its eleven scenes.

use crate::report::PublishedRow;

const SCENES: &str = "11 iPad scenes";

/// Our name, the paper's, SSIM, LPIPS, S3, Grad.
const ROWS: &[(&str, &str, [f64; 4])] = &[
    ("l2avg", "L2Avg", [0.610, 0.386, 0.173, 7.066]),
    ("", "ColorMap", [0.553, 0.581, 0.234, 7.969]),
    ("", "TexMap", [0.376, 0.488, 0.179, 8.918]),
    ("", "MVSTex", [0.476, 0.335, 0.139, 8.198]),
    ("advtex-b", "AdvTex-B", [0.495, 0.369, 0.148, 8.229]),
    ("advtex-c", "AdvTex-C", [0.563, 0.365, 0.135, 7.171]),
    ("unary", "T only", [0.510, 0.342, 0.141, 8.092]),
    ("no-t", "without T", [0.592, 0.332, 0.130, 6.864]),
    (
        "no-align",
        "without alignment",
        [0.559, 0.346, 0.125, 7.244],
    ),
    ("smooth", "full", [0.602, 0.309, 0.120, 6.871]),
    ("patch2", "full, 2×2 patches", [0.556, 0.330, 0.123, 7.122]),
    ("patch4", "full, 4×4 patches", [0.545, 0.338, 0.122, 7.163]),
    (
        "smooth-pairwise",
        "full, pairwise cues",
        [0.601, 0.305, 0.120, 6.872],
    ),
    (
        "smooth-every-2",
        "full, every 2nd view",
        [0.604, 0.304, 0.120, 6.859],
    ),
    (
        "smooth-every-3",
        "full, every 3rd view",
        [0.593, 0.308, 0.123, 6.959],
    ),
    (
        "smooth-every-4",
        "full, every 4th view",
        [0.580, 0.316, 0.127, 7.026],
    ),
    (
        "smooth-every-5",
        "full, every 5th view",
        [0.583, 0.303, 0.123, 6.983],
    ),
    (
        "advtex-b-noise",
        "AdvTex-B, pose noise",
        [0.378, 0.503, 0.160, 9.193],
    ),
    (
        "advtex-c-noise",
        "AdvTex-C, pose noise",
        [0.452, 0.490, 0.153, 7.949],
    ),
    (
        "smooth-noise",
        "full, pose noise",
        [0.456, 0.472, 0.142, 8.177],
    ),
];

/// The paper's rows.
pub(super) fn rows() -> Vec<PublishedRow> {
    ROWS.iter()
        .map(|&(method, name, ssim_lpips_s3_grad)| PublishedRow {
            method: method.to_owned(),
            name: name.to_owned(),
            scenes: SCENES.to_owned(),
            ssim_lpips_s3_grad,
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cli::eval::methods::Method;

    #[test]
    fn every_name_of_ours_is_a_method_of_the_suite() {
        for (ours, paper, _) in ROWS.iter().filter(|(ours, ..)| !ours.is_empty()) {
            let method = Method::find(ours).unwrap_or_else(|| panic!("{paper}: {ours}"));
            assert!(method.in_paper, "{ours}");
        }
    }
}
