//! Lenses end to end: a recording seen through one is painted as well as without.

use std::path::Path;

use veneer::geom::{ColorImage, DepthImage, EncodedColor, EncodedDepth};
use veneer::wire::Message;
use veneer::wire::camera_info::CameraInfo;
use veneer::wire::compressed_image::CompressedImage;

use crate::bad_input::rewrite;
use crate::command::{small_tabletop, veneer_ok};

/// Focal length of the lens's camera in units of the recorded one: what it sees beyond the
/// recorded image's border would be unknown.
const ZOOM: f64 = 1.5;

/// A lens by its names in `sensor_msgs/CameraInfo`; what it does is told here once more, after
/// OpenCV's documentation.
struct Lens {
    model: &'static str,
    d: &'static [f64],
}

const IDEAL: Lens = Lens {
    model: "plumb_bob",
    d: &[0.0; 5],
};
const PLUMB_BOB: Lens = Lens {
    model: "plumb_bob",
    d: &[-0.25, 0.09, 0.002, -0.003, -0.01],
};
const RATIONAL: Lens = Lens {
    model: "rational_polynomial",
    d: &[0.35, 0.08, -0.002, 0.001, 0.01, 0.75, 0.1, 0.02],
};
const EQUIDISTANT: Lens = Lens {
    model: "equidistant",
    d: &[-0.04, 0.01, -0.004, 0.001],
};

impl Lens {
    fn distort(&self, [x, y]: [f64; 2]) -> [f64; 2] {
        let r2 = x * x + y * y;
        let k = |i: usize| self.d.get(i).copied().unwrap_or(0.0);
        if self.model == "equidistant" {
            let r = r2.sqrt().max(1e-12);
            let t = r.atan();
            let series: f64 = (1i32..=4).zip(self.d).map(|(n, k)| k * t.powi(2 * n)).sum();
            return [x, y].map(|v| v * t * (1.0 + series) / r);
        }
        let radial = (1.0 + k(0) * r2 + k(1) * r2.powi(2) + k(4) * r2.powi(3))
            / (1.0 + k(5) * r2 + k(6) * r2.powi(2) + k(7) * r2.powi(3));
        [
            x * radial + 2.0 * k(2) * x * y + k(3) * (r2 + 2.0 * x * x),
            y * radial + k(2) * (r2 + 2.0 * y * y) + 2.0 * k(3) * x * y,
        ]
    }

    /// By fixed point.
    fn undistort(&self, seen: [f64; 2]) -> [f64; 2] {
        let mut ideal = seen;
        for _ in 0..100 {
            let [x, y] = self.distort(ideal);
            ideal = [ideal[0] + seen[0] - x, ideal[1] + seen[1] - y];
        }
        ideal
    }
}

/// fx, fy, cx, cy of the recorded images.
fn intrinsics(bag: &Path) -> [f64; 4] {
    let bytes = std::fs::read(bag).unwrap();
    let info = mcap::MessageStream::new(&bytes)
        .unwrap()
        .map(Result::unwrap)
        .find(|message| message.channel.topic.ends_with("color/camera_info"))
        .unwrap();
    let k = CameraInfo::decode(&info.data).unwrap().k;
    [k[0], k[4], k[2], k[5]]
}

/// Where the recorded image shows what the lens shows at each pixel.
fn sources(lens: &Lens, [fx, fy, cx, cy]: [f64; 4], [width, height]: [u32; 2]) -> Vec<[f64; 2]> {
    let pixels = (0..height).flat_map(|y| (0..width).map(move |x| [f64::from(x), f64::from(y)]));
    pixels
        .map(|[x, y]| {
            let [x, y] = lens.undistort([(x - cx) / (ZOOM * fx), (y - cy) / (ZOOM * fy)]);
            [fx * x + cx, fy * y + cy]
        })
        .collect()
}

#[expect(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "pixels, colours and millimetres within their types"
)]
mod resample {
    use super::*;

    pub(super) fn color(image: &ColorImage, sources: &[[f64; 2]]) -> ColorImage {
        let sample = |at: &[f64; 2]| {
            let color = image.sample_bilinear(at.map(|v| v as f32));
            color.map(|c| c.round().clamp(0.0, 255.0) as u8)
        };
        let pixels = sources.iter().map(sample).collect();
        ColorImage::new(image.width(), image.height(), pixels).unwrap()
    }

    pub(super) fn depth_mm(image: &DepthImage, sources: &[[f64; 2]]) -> Vec<u16> {
        let nearest = |at: &[f64; 2]| image.nearest(*at).unwrap_or(0.0);
        let depths = sources.iter().map(nearest);
        depths.map(|m| (m * 1000.0).round() as u16).collect()
    }
}

/// Error against the scene's true texture in 1/255, and the share of texels that a frame painted:
/// images through `lens`, camera infos that say it is `said`.
fn paint(bag: &Path, lens: &Lens, said: &Lens) -> (f64, f64) {
    let k_px = intrinsics(bag);
    let name = format!("{}_{}.mcap", lens.model, said.model);
    let through = rewrite(bag, &name, &|topic, _, data| {
        if topic.ends_with("/camera_info") {
            let mut info = CameraInfo::decode(data).unwrap();
            [info.k[0], info.k[4]] = [ZOOM * k_px[0], ZOOM * k_px[1]];
            [info.p[0], info.p[5]] = [info.k[0], info.k[4]];
            (info.distortion_model, info.d) = (said.model, said.d.to_vec());
            return Some(info.encode());
        }
        let message = || CompressedImage::decode(data).unwrap();
        if topic.ends_with("/compressed") {
            let image = message().to_color().unwrap().decode().unwrap();
            let sources = sources(lens, k_px, [image.width(), image.height()]);
            let image = resample::color(&image, &sources);
            let image = EncodedColor::png_from_image(&image).unwrap();
            return Some(CompressedImage::from_color(message().header, &image)?.encode());
        }
        if topic.ends_with("/compressedDepth") {
            let image = message().to_depth().unwrap().decode().unwrap();
            let size = [image.width(), image.height()];
            let depth_mm = resample::depth_mm(&image, &sources(lens, k_px, size));
            let image = EncodedDepth::png_from_u16_mm(size[0], size[1], &depth_mm).unwrap();
            return Some(CompressedImage::from_depth(message().header, &image)?.encode());
        }
        Some(data.to_vec())
    });
    let out = through.with_extension("out");
    let args = [
        "replay",
        through.to_str().unwrap(),
        "--out",
        out.to_str().unwrap(),
    ];
    veneer_ok(&args);
    let text = std::fs::read_to_string(out.join("report.json")).unwrap();
    let report: serde_json::Value = serde_json::from_str(&text).unwrap();
    let number = |section: &str, name: &str| report[section][name].as_f64().unwrap();
    (
        number("synthetic", "mean_abs"),
        number("coverage", "keyframe_share"),
    )
}

#[track_caller]
fn assert_undistorted(lens: &Lens) {
    let dir = tempfile::tempdir().unwrap();
    let bag = small_tabletop(dir.path(), &[]);
    let (ideal, ideal_share) = paint(&bag, &IDEAL, &IDEAL);
    let (through, share) = paint(&bag, lens, lens);
    let (ignored, _) = paint(&bag, lens, &IDEAL);
    let figures = format!("ideal {ideal}, through the lens {through}, lens ignored {ignored}");
    // The lens's images are resampled once more, and at another scale.
    assert!(through < ideal + 1.0, "{figures}");
    assert!(ignored > through + 3.0, "{figures}");
    assert!(share > 0.7 * ideal_share, "{share} of {ideal_share}");
}

#[test]
fn plumb_bob() {
    assert_undistorted(&PLUMB_BOB);
}

#[test]
fn rational_polynomial() {
    assert_undistorted(&RATIONAL);
}

#[test]
fn equidistant() {
    assert_undistorted(&EQUIDISTANT);
}
