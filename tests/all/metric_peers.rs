//! The metrics beside scikit-image, numpy and Pillow, on the same images.

use std::path::{Path, PathBuf};
use std::process::Command;

use serde_json::Value;
use veneer::geom::{ColorImage, EncodedColor};
use veneer::metrics::{
    PixelError, SsimChannels, SsimWindow, gradient_difference, sharpness_map, ssim_windowed,
};

use crate::python;

/// Bytes that look random and are the same everywhere.
fn noise(x: u32, y: u32, seed: u32) -> u32 {
    let mut h = x.wrapping_mul(0x9E37_79B1) ^ y.wrapping_mul(0x85EB_CA77) ^ seed;
    h = (h ^ (h >> 15)).wrapping_mul(0x2C1B_3C6D);
    (h ^ (h >> 13)) & 0xFF
}

/// Tiles, a ramp, a bright and a black corner, and fine noise of `amount` in 256.
fn picture(width: u32, height: u32, seed: u32, amount: u32) -> ColorImage {
    let pixels = (0..width * height).map(|i| {
        let (x, y) = (i % width, i / width);
        if x < width / 4 && y < height / 3 {
            return [0; 3];
        }
        std::array::from_fn(|c| {
            let c = u32::try_from(c).unwrap();
            let tile = noise(x / 13, y / 9, c) / 2;
            let fine = noise(x, y, seed + c) * amount / 256;
            let bright = if x > 2 * width / 3 && y > height / 2 {
                90
            } else {
                0
            };
            u8::try_from((tile + x * 40 / width + fine + bright).min(255)).unwrap()
        })
    });
    ColorImage::new(width, height, pixels.collect()).unwrap()
}

fn write(folder: &Path, name: &str, image: &ColorImage) -> PathBuf {
    let path = folder.join(name);
    let png = EncodedColor::png_from_image(image).unwrap();
    std::fs::write(&path, png.bytes()).unwrap();
    path
}

#[test]
fn metrics_are_those_of_independent_programs() {
    let packages = ["scikit-image==0.25.2", "numpy==2.2.6", "pillow==11.3.0"];
    let Some(python) = python::venv("metrics", &packages) else {
        return;
    };
    let folder = tempfile::tempdir().unwrap();
    // Sizes that are 0, 5 and 7 over a multiple of the blocks.
    for (width, height, amount) in [(120, 80, 40), (93, 69, 90), (71, 64, 8)] {
        let a = picture(width, height, 5, 30);
        let b = picture(width, height, 99, amount);
        let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/all/metric_peers.py");
        let said = python::run(
            Command::new(&python)
                .arg(&script)
                .arg(write(folder.path(), "a.png", &a))
                .arg(write(folder.path(), "b.png", &b)),
        );
        let theirs: Value = serde_json::from_str(&said.unwrap()).unwrap();
        let number = |key: &str| theirs[key].as_f64().unwrap();
        let near = |what: &str, ours: f64, theirs: f64, tolerance: f64| {
            assert!((ours - theirs).abs() < tolerance, "{what}: {ours} {theirs}");
        };
        let similarity = |window| {
            ssim_windowed(&a, &b, None, SsimChannels::Rgb, window)
                .unwrap()
                .unwrap()
        };
        near(
            "SSIM",
            similarity(SsimWindow::Gaussian),
            number("ssim_gaussian"),
            1e-9,
        );
        near(
            "SSIM 7×7",
            similarity(SsimWindow::Uniform),
            number("ssim_uniform"),
            1e-9,
        );
        let error = PixelError::between(&a, &b, None).unwrap();
        near("PSNR", error.psnr_db().unwrap(), number("psnr"), 1e-9);
        near(
            "Grad",
            gradient_difference(&a, &b).unwrap(),
            number("grad"),
            1e-9,
        );
        let map = sharpness_map(&a);
        let expected = theirs["s3"].as_array().unwrap();
        assert_eq!(map.s3.len(), expected.len());
        let mut largest = 0.0f64;
        for (i, (ours, theirs)) in map.s3.iter().zip(expected).enumerate() {
            let theirs = theirs.as_f64().unwrap();
            largest = largest.max(theirs);
            near(&format!("S3 at {i}"), f64::from(*ours), theirs, 1e-6);
        }
        assert!(largest > 0.3);
    }
}
