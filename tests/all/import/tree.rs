//! Small data sets in a temporary folder, written with other code than the importer's.

#![expect(clippy::unwrap_used, reason = "a test fails by panicking")]

use std::path::PathBuf;

use nalgebra::Point3;
use veneer::geom::{EncodedDepth, RigidTransform, Stamp};
use veneer::mesh::TriMesh;

const DEPTH_SIZE: [u32; 2] = [16, 12];
/// Formats with a fixed camera insist on its image size.
const PHOTO_SIZE: [u16; 2] = [640, 480];

/// The camera that [`Tree::write_tum`] leaves to the importer: the ROS default.
pub(crate) const TREE_PX: [f64; 4] = [525.0, 525.0, 319.5, 239.5];

#[derive(Clone)]
pub(crate) struct Frame {
    pub(crate) stamp: Stamp,
    pub(crate) world_from_camera: RigidTransform,
    pub(crate) photo: Vec<u8>,
    pub(crate) depth_mm: Vec<u16>,
    pub(crate) depth_png: Vec<u8>,
    pub(crate) color_px: [f64; 4],
    pub(crate) depth_px: [f64; 4],
}

fn depth_png([width, height]: [u32; 2], depth_mm: &[u16]) -> Vec<u8> {
    let image = EncodedDepth::png_from_u16_mm(width, height, depth_mm).unwrap();
    image.bytes().to_vec()
}

fn jpeg(shade: u8) -> Vec<u8> {
    let [width, height] = PHOTO_SIZE;
    let pixels: Vec<u8> = (0..usize::from(width) * usize::from(height))
        .map(|i| u8::try_from(i % 251).unwrap().wrapping_add(shade))
        .collect();
    let mut file = Vec::new();
    jpeg_encoder::Encoder::new(&mut file, 50)
        .encode(&pixels, width, height, jpeg_encoder::ColorType::Luma)
        .unwrap();
    file
}

pub(crate) fn photo_png(shade: u8) -> Vec<u8> {
    let [width, height] = PHOTO_SIZE;
    let pixels = vec![shade; usize::from(width) * usize::from(height) * 3];
    let mut file = Vec::new();
    let mut encoder = png::Encoder::new(&mut file, u32::from(width), u32::from(height));
    encoder.set_color(png::ColorType::Rgb);
    let mut writer = encoder.write_header().unwrap();
    writer.write_image_data(&pixels).unwrap();
    writer.finish().unwrap();
    file
}

impl Frame {
    /// A frame unlike its neighbours in every part.
    pub(crate) fn new(number: u32, stamp: Stamp) -> Self {
        let t = f64::from(number);
        let axis = [0.6, 0.0, 0.8].map(|v: f64| v * (0.05 * t).sin());
        let quaternion = [axis[0], axis[1], axis[2], (0.05 * t).cos()];
        let num_pixels = DEPTH_SIZE[0] * DEPTH_SIZE[1];
        let depth_mm: Vec<u16> = (0..num_pixels)
            .map(|i| u16::try_from(1000 + (i * 7 + number * 13) % 500).unwrap())
            .collect();
        Self {
            stamp,
            world_from_camera: RigidTransform::try_from_quaternion(
                quaternion,
                [0.1 * t, -0.2, 0.3 + t],
            )
            .unwrap(),
            photo: jpeg(u8::try_from(number).unwrap()),
            depth_png: depth_png(DEPTH_SIZE, &depth_mm),
            depth_mm,
            color_px: [500.0 + t, 501.0 + t, 320.0 - t, 240.0 + t],
            depth_px: [12.5 + t, 12.25, 7.5, 5.5],
        }
    }

    /// What the capture's `color_intrinsics_refined` are.
    pub(crate) fn refined_px(&self) -> [f64; 4] {
        self.color_px.map(|v| v * 1.01)
    }

    /// Depth of the photo's size, for formats that register it.
    pub(crate) fn full_depth(&self) -> Vec<u16> {
        let num_pixels = usize::from(PHOTO_SIZE[0]) * usize::from(PHOTO_SIZE[1]);
        self.depth_mm
            .iter()
            .copied()
            .cycle()
            .take(num_pixels)
            .collect()
    }

    fn rows(&self) -> [[f64; 4]; 4] {
        let rotation = self.world_from_camera.rotation().to_rotation_matrix();
        let translation = self.world_from_camera.translation();
        std::array::from_fn(|r| {
            std::array::from_fn(|c| match (r, c) {
                (3, 3) => 1.0,
                (3, _) => 0.0,
                (_, 3) => translation[r],
                _ => rotation[(r, c)],
            })
        })
    }
}

/// A folded square; its coordinates are exact in 32-bit floats, as the files have them.
pub(crate) fn mesh() -> TriMesh {
    let positions_m = [
        [0.0, 0.0, 2.0],
        [1.0, 0.0, 2.0],
        [0.0, 1.0, 2.25],
        [1.0, 1.0, 1.5],
    ];
    let positions_m = positions_m.map(Point3::from).to_vec();
    TriMesh::from_soup(positions_m, vec![[0, 1, 2], [2, 1, 3]])
        .unwrap()
        .0
}

pub(crate) fn mesh_ply() -> String {
    let mut file = "ply\nformat ascii 1.0\nelement vertex 4\nproperty float x\n\
        property float y\nproperty float z\nelement face 2\n\
        property list uchar int vertex_indices\nend_header\n"
        .to_owned();
    for p in mesh().positions_m() {
        file.push_str(&format!("{} {} {}\n", p.x, p.y, p.z));
    }
    for [a, b, c] in mesh().triangles() {
        file.push_str(&format!("3 {a} {b} {c}\n"));
    }
    file
}

fn mesh_obj() -> String {
    let mut file = "# exported\no scan\n".to_owned();
    for p in mesh().positions_m() {
        file.push_str(&format!("v {} {} {}\n", p.x, p.y, p.z));
    }
    for [a, b, c] in mesh().triangles() {
        file.push_str(&format!("f {0}/{0} {1}/{1} {2}/{2}\n", a + 1, b + 1, c + 1));
    }
    file
}

fn confidence_png() -> Vec<u8> {
    let [width, height] = DEPTH_SIZE;
    let mut file = Vec::new();
    let mut encoder = png::Encoder::new(&mut file, width, height);
    encoder.set_color(png::ColorType::Grayscale);
    let mut writer = encoder.write_header().unwrap();
    let values: Vec<u8> = (0..width * height)
        .map(|i| u8::try_from((i / width).min(2)).unwrap())
        .collect();
    writer.write_image_data(&values).unwrap();
    writer.finish().unwrap();
    file
}

pub(crate) struct Tree {
    folder: tempfile::TempDir,
}

impl Tree {
    pub(crate) fn new() -> Self {
        Self {
            folder: tempfile::tempdir().unwrap(),
        }
    }

    pub(crate) fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    fn write(&self, name: &str, bytes: impl AsRef<[u8]>) {
        let path = self.path("scan").join(name);
        std::fs::create_dir_all(path.parent().unwrap()).unwrap();
        std::fs::write(path, bytes).unwrap();
    }

    pub(crate) fn write_capture(&self, frames: &[Frame]) {
        let mut cameras = Vec::new();
        for (id, frame) in frames.iter().enumerate() {
            self.write(&format!("frames/{id:06}.jpg"), &frame.photo);
            self.write(&format!("frames/{id:06}.png"), &frame.depth_png);
            self.write(&format!("frames/{id:06}.conf.png"), confidence_png());
            cameras.push(serde_json::json!({
                "id": id, "source_id": 3 * id, "c2w": frame.rows(),
                "timestamp_s": frame.stamp.as_nanos() as f64 * 1e-9,
                "color_intrinsics": frame.color_px, "depth_intrinsics": frame.depth_px,
                "color_intrinsics_refined": frame.refined_px(),
            }));
        }
        self.write("cameras.json", serde_json::json!(cameras).to_string());
        let camera = |[width, height]: [u32; 2]| {
            serde_json::json!({"fx": 1.0, "fy": 1.0, "cx": 0.0, "cy": 0.0,
                "width": width, "height": height})
        };
        let intrinsics = serde_json::json!({
            "color": camera(PHOTO_SIZE.map(u32::from)), "depth": camera(DEPTH_SIZE),
            "distortion": "none given by the source", "per_frame_in_cameras_json": true,
        });
        self.write("intrinsics.json", intrinsics.to_string());
        self.write(
            "meta.json",
            r#"{"name": "x", "refined": {"depth_scale": 0.5}}"#,
        );
        self.write("mesh.ply", mesh_ply());
        self.write("mesh_tsdf_refined.ply", mesh_ply());
    }

    /// Depth is taken 7 ms after colour; two poses a frame, 50 ms before and after, that
    /// meet the frame's own in the middle.
    pub(crate) fn write_tum(&self, frames: &[Frame]) {
        let mut rgb = "# color images\n".to_owned();
        let mut depth = "# depth maps\n".to_owned();
        let mut poses = "# ground truth trajectory\n# timestamp tx ty tz qx qy qz qw\n".to_owned();
        let seconds =
            |nanos: i64| format!("{}.{:06}", nanos / 1_000_000_000, nanos / 1000 % 1_000_000);
        for frame in frames {
            let nanos = frame.stamp.as_nanos();
            let [color_s, depth_s] = [nanos, nanos + 7_000_000].map(seconds);
            rgb.push_str(&format!("{color_s} rgb/{color_s}.jpg\n"));
            depth.push_str(&format!("{depth_s} depth/{depth_s}.png\n"));
            self.write(&format!("rgb/{color_s}.jpg"), &frame.photo);
            let [width, height] = PHOTO_SIZE.map(u32::from);
            let counts: Vec<u16> = frame.full_depth().iter().map(|mm| mm * 5).collect();
            self.write(
                &format!("depth/{depth_s}.png"),
                depth_png([width, height], &counts),
            );
            let [qx, qy, qz, qw] = frame.world_from_camera.quaternion_xyzw();
            let t = frame.world_from_camera.translation();
            for sign in [-1, 1] {
                let x = t.x + 0.25 * f64::from(sign);
                let pose_s = seconds(nanos + 50_000_000 * i64::from(sign));
                poses.push_str(&format!(
                    "{pose_s} {x} {} {} {qx} {qy} {qz} {qw}\n",
                    t.y, t.z
                ));
            }
        }
        self.write("rgb.txt", rgb);
        self.write("depth.txt", depth);
        self.write("groundtruth.txt", poses);
    }

    pub(crate) fn write_seven_scenes(&self, frames: &[Frame]) {
        for (number, frame) in frames.iter().enumerate() {
            let mut depth_mm = frame.full_depth();
            depth_mm[0] = 65535;
            let [width, height] = PHOTO_SIZE.map(u32::from);
            self.write(&format!("frame-{number:06}.color.png"), &frame.photo);
            self.write(
                &format!("frame-{number:06}.depth.png"),
                depth_png([width, height], &depth_mm),
            );
            let pose: String = frame
                .rows()
                .iter()
                .map(|row| row.map(|v| format!("{v:e}\t ")).concat() + "\r\n")
                .collect();
            self.write(&format!("frame-{number:06}.pose.txt"), pose);
        }
    }

    /// Every second frame of the app has no photo.
    pub(crate) fn write_three_d_scanner(&self, frames: &[Frame]) {
        for (index, frame) in frames.iter().enumerate() {
            let number = 2 * index;
            let [fx, fy, cx, cy] = frame.color_px;
            // ARKit's camera has y up and z backwards: those columns change sign.
            let pose: Vec<f64> = frame
                .rows()
                .iter()
                .flat_map(|&[x, y, z, t]| [x, -y, -z, t])
                .collect();
            let json = |time_s: f64| {
                serde_json::json!({
                    "cameraPoseARFrame": pose, "time": time_s, "frame_index": number,
                    "intrinsics": [fx, 0.0, cx, 0.0, fy, cy, 0.0, 0.0, 1.0],
                    "projectionMatrix": vec![0.0; 16], "motionQuality": 1,
                })
                .to_string()
            };
            let time_s = frame.stamp.as_nanos() as f64 * 1e-9;
            self.write(&format!("frame_{number:05}.json"), json(time_s));
            self.write(&format!("frame_{number:05}.jpg"), &frame.photo);
            self.write(&format!("depth_{number:05}.png"), &frame.depth_png);
            self.write(&format!("conf_{number:05}.png"), confidence_png());
            if index % 2 == 0 {
                self.write(
                    &format!("frame_{:05}.json", number + 1),
                    json(time_s + 0.01),
                );
            }
        }
        self.write("export.obj", mesh_obj());
        self.write("info.json", "{}");
    }
}
