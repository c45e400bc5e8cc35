//! Real captures for tests: the layout of `shared/data`, read directly.

#![expect(
    clippy::cast_possible_truncation,
    reason = "the numbers of a test are small"
)]

use std::path::PathBuf;
use std::sync::Arc;

use nalgebra::Point3;

use crate::geom::{
    ColorImage, DepthImage, EncodedColor, ImageError, PinholeCamera, RigidTransform,
};
use crate::keyframe::{DecodedDepth, DecodedFrame};
use crate::mesh::TriMesh;

use super::FramePose;

pub(crate) struct Capture {
    pub(crate) mesh: TriMesh,
    pub(crate) poses: Vec<FramePose>,
    pub(crate) cameras: Vec<[PinholeCamera; 2]>,
    ids: Vec<u64>,
    folder: PathBuf,
}

impl Capture {
    /// `None`, said aloud, where the data is not there.
    pub(crate) fn load(name: &str, mesh: &str, is_wanted: impl Fn(usize) -> bool) -> Option<Self> {
        let folder =
            PathBuf::from(concat!(env!("CARGO_MANIFEST_DIR"), "/../shared/data")).join(name);
        if !folder.exists() {
            #[expect(clippy::print_stderr, reason = "a skipped test says so")]
            {
                eprintln!("skipped: {} is not there", folder.display());
            }
            return None;
        }
        let json = |file: &str| -> serde_json::Value {
            serde_json::from_slice(&std::fs::read(folder.join(file)).unwrap()).unwrap()
        };
        let intrinsics = json("intrinsics.json");
        let list =
            |v: &serde_json::Value| -> [f64; 4] { std::array::from_fn(|i| v[i].as_f64().unwrap()) };
        let (mut poses, mut cameras, mut ids) = (vec![], vec![], vec![]);
        let entries = json("cameras.json");
        for (index, entry) in entries.as_array().unwrap().iter().enumerate() {
            if !is_wanted(index) {
                continue;
            }
            let rows: [[f64; 4]; 4] = std::array::from_fn(|r| list(&entry["c2w"][r]));
            let id = entry["id"].as_u64().unwrap();
            let photo = std::fs::read(folder.join(format!("frames/{id:06}.jpg"))).unwrap();
            let photo = EncodedColor::from_file(photo.into()).unwrap();
            poses.push(FramePose {
                id: id as u32,
                world_from_camera: RigidTransform::try_from_matrix(&rows).unwrap(),
                quality: crate::keyframe::quality::measure(&photo).unwrap(),
            });
            let camera = |kind: &str| {
                let shared = &intrinsics[kind];
                let side = |key: &str| shared[key].as_u64().unwrap() as u32;
                let own = [
                    format!("{kind}_intrinsics_refined"),
                    format!("{kind}_intrinsics"),
                ]
                .into_iter()
                .find(|key| entry.get(key).is_some());
                let px = own.map_or_else(
                    || ["fx", "fy", "cx", "cy"].map(|key| shared[key].as_f64().unwrap()),
                    |key| list(&entry[key]),
                );
                PinholeCamera::new(px, side("width"), side("height")).unwrap()
            };
            cameras.push([camera("color"), camera("depth")]);
            ids.push(id);
        }
        Some(Self {
            mesh: load_ply(&std::fs::read(folder.join(mesh)).unwrap()),
            poses,
            cameras,
            ids,
            folder,
        })
    }

    pub(crate) fn decode(&self, frame: usize) -> Result<Arc<DecodedFrame>, ImageError> {
        let read = |ending: &str| {
            let path = self
                .folder
                .join(format!("frames/{:06}.{ending}", self.ids[frame]));
            image::load_from_memory(&std::fs::read(path).unwrap()).unwrap()
        };
        let color = read("jpg").into_rgb8();
        let depth = read("png").into_luma16();
        let [color_camera, depth_camera] = self.cameras[frame];
        let pixels = color.pixels().map(|p| p.0).collect();
        let depth_m = depth.pixels().map(|p| f32::from(p.0[0]) * 1e-3).collect();
        Ok(Arc::new(DecodedFrame {
            color: ColorImage::new(color.width(), color.height(), pixels)?,
            color_camera,
            depth: Some(DecodedDepth {
                image: DepthImage::new(depth.width(), depth.height(), depth_m)?,
                camera: depth_camera,
                depth_from_color: RigidTransform::identity(),
            }),
        }))
    }
}

fn load_ply(bytes: &[u8]) -> TriMesh {
    let end = b"end_header\n";
    let body = bytes.windows(end.len()).position(|w| w == end).unwrap() + end.len();
    let header = std::str::from_utf8(&bytes[..body]).unwrap();
    let count = |element: &str| -> usize {
        let line = header
            .lines()
            .find(|line| line.starts_with(element))
            .unwrap();
        line.rsplit(' ').next().unwrap().parse().unwrap()
    };
    let (num_vertices, num_faces) = (count("element vertex"), count("element face"));
    let vertex_bytes = if header.contains("property uchar red") {
        15
    } else {
        12
    };
    let (vertices, faces) = bytes[body..].split_at(num_vertices * vertex_bytes);
    let positions = vertices
        .chunks_exact(vertex_bytes)
        .map(|v| {
            let [x, y, z] = [0, 4, 8].map(|i| f32::from_le_bytes(v[i..i + 4].try_into().unwrap()));
            Point3::new(f64::from(x), f64::from(y), f64::from(z))
        })
        .collect();
    let triangles = faces[..num_faces * 13]
        .chunks_exact(13)
        .map(|f| {
            assert_eq!(f[0], 3);
            [1, 5, 9].map(|i| u32::from_le_bytes(f[i..i + 4].try_into().unwrap()))
        })
        .collect();
    TriMesh::from_soup(positions, triangles).unwrap().0
}
