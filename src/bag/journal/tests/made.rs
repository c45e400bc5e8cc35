//! Scans at random: frames come, go and move, the mesh changes, with awkward numbers.

use std::sync::Arc;

use nalgebra::{Point3, UnitQuaternion, Vector3};

use super::super::ScanState;
use crate::geom::{
    CameraModel, ColorImage, DepthEncoding, Distortion, EncodedColor, EncodedDepth, FrameDepth,
    PinholeCamera, RigidTransform, Stamp,
};
use crate::ingest::event::MeshBlockKey;
use crate::ingest::{MeshBlockSpan, MeshBlocks};
use crate::keyframe::{FrameQuality, Keyframe, KeyframeId};
use crate::mesh::TriMesh;

/// SplitMix64 (Steele, Lea, Flood 2014).
#[derive(Clone, Debug)]
pub(super) struct Random(pub(super) u64);

impl Random {
    pub(super) fn next(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let z = (self.0 ^ (self.0 >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        let z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        z ^ (z >> 31)
    }

    pub(super) fn below(&mut self, end: u64) -> u64 {
        self.next() % end.max(1)
    }

    /// In −1..1, with all bits in use.
    pub(super) fn signed(&mut self) -> f64 {
        (self.next() >> 11) as f64 / (1u64 << 52) as f64 - 1.0
    }
}

/// A scan that changes.
#[derive(Clone, Debug)]
pub(super) struct MadeScan {
    pub(super) scan: ScanState,
    pub(super) random: Random,
    /// Bytes of a colour image, about.
    pub(super) image_bytes: usize,
    /// Frames, poses, removals, meshes.
    pub(super) num_by_kind: [usize; 4],
    next_id: u32,
}

impl MadeScan {
    pub(super) fn new(seed: u64) -> Self {
        Self {
            scan: ScanState {
                world_frame: Some("map".to_owned()),
                ..ScanState::default()
            },
            random: Random(seed),
            image_bytes: 600,
            num_by_kind: [0; 4],
            next_id: 0,
        }
    }

    pub(super) fn next_id(&self) -> KeyframeId {
        KeyframeId(self.next_id)
    }

    pub(super) fn has_had_everything(&self) -> bool {
        self.num_by_kind.iter().all(|&num| num > 0)
    }

    /// One change, at random: one step of a journal. Most are new frames.
    pub(super) fn change(&mut self) {
        match self.random.below(8) {
            _ if self.scan.mesh.is_none() => self.grow(),
            0 if self.scan.keyframes.len() > 2 => self.remove(),
            1 if !self.scan.keyframes.is_empty() => self.turn(),
            2 | 3 => self.grow(),
            _ => self.add(),
        }
    }

    fn pose(&mut self) -> RigidTransform {
        let [x, y, z, a, b, c] = std::array::from_fn(|_| self.random.signed());
        let rotation = UnitQuaternion::from_scaled_axis(Vector3::new(a, b, c) * 3.0);
        RigidTransform::from_parts(rotation, Vector3::new(x, y, z) * 5.0)
    }

    fn camera(&mut self, width: u32, height: u32) -> CameraModel {
        let [a, b, c, d] = std::array::from_fn(|_| self.random.signed());
        let side = f64::from(width);
        let center = |share: f64| side / 2.0 + share;
        let intrinsics_px = [side + a, side + b, center(c), center(d)];
        let mut coefficients = [0.0; 8];
        coefficients.fill_with(|| self.random.signed() * 0.01);
        let [d0, d1, d2, d3, d4, ..] = coefficients;
        CameraModel {
            pinhole: PinholeCamera::new(intrinsics_px, width, height).unwrap(),
            distortion: match self.random.below(4) {
                0 => Distortion::None,
                1 => Distortion::PlumbBob([d0, d1, d2, d3, d4]),
                2 => Distortion::RationalPolynomial(coefficients),
                _ => Distortion::Equidistant([d0, d1, d2, d3]),
            },
        }
    }

    fn depth(&mut self) -> FrameDepth {
        let mm: Vec<u16> = (0..12).map(|i| 500 + 7 * i).collect();
        let image = match self.random.below(3) {
            0 => EncodedDepth::png_from_u16_mm(4, 3, &mm).unwrap(),
            1 => EncodedDepth::rvl_from_u16_mm(4, 3, &mm).unwrap(),
            _ => {
                let encoding = DepthEncoding::F32M { big_endian: true };
                let metres = (0..12).map(|i| 0.1 * i as f32);
                let bytes: Vec<u8> = metres.flat_map(f32::to_be_bytes).collect();
                EncodedDepth::from_raw(encoding, 4, 3, 16, bytes.into()).unwrap()
            }
        };
        FrameDepth {
            image,
            camera: self.camera(4, 3),
            depth_from_color: self.pose(),
        }
    }

    fn add(&mut self) {
        self.num_by_kind[0] += 1;
        let height = 1 + u32::try_from(self.image_bytes / 96).unwrap();
        let mut color = || (self.random.next() & 0xff_ffff) as u32;
        let pixels = (0..32 * height).map(|_| {
            let [r, g, b, _] = color().to_le_bytes();
            [r, g, b]
        });
        let image = ColorImage::new(32, height, pixels.collect()).unwrap();
        let has_depth = self.random.below(3) > 0;
        let keyframe = Keyframe {
            id: KeyframeId(self.next_id),
            stamp: Stamp::from_nanos(1_000_000_007 * i64::from(self.next_id)),
            world_from_camera: self.pose(),
            color: EncodedColor::png_from_image(&image).unwrap(),
            color_camera: self.camera(32, height),
            depth: has_depth.then(|| self.depth()),
            quality: FrameQuality {
                sharpness: self.random.signed() as f32,
                mean_luma: 0.5,
                clipped: 0.1,
            },
        };
        self.scan.keyframes.insert(keyframe.id, Arc::new(keyframe));
        // The store gives no number twice, and may give none out.
        self.next_id += 1;
    }

    fn any_id(&mut self) -> KeyframeId {
        let num = self.scan.keyframes.len() as u64;
        let at = usize::try_from(self.random.below(num)).unwrap();
        *self.scan.keyframes.keys().nth(at).unwrap()
    }

    fn turn(&mut self) {
        self.num_by_kind[1] += 1;
        let (id, pose) = (self.any_id(), self.pose());
        let keyframe = self.scan.keyframes.get_mut(&id).unwrap();
        Arc::make_mut(keyframe).world_from_camera = pose;
    }

    pub(super) fn remove(&mut self) {
        self.num_by_kind[2] += 1;
        let id = self.any_id();
        self.scan.keyframes.remove(&id);
    }

    fn grow(&mut self) {
        self.num_by_kind[3] += 1;
        let num_triangles = 1 + u32::try_from(self.random.below(20)).unwrap();
        let positions_m = (0..3 * num_triangles).map(|_| {
            let [x, y, z] = std::array::from_fn(|_| self.random.signed());
            Point3::new(x, y, z)
        });
        let positions_m = positions_m.collect();
        let triangles = (0..num_triangles).map(|t| [3 * t, 3 * t + 1, 3 * t + 2]);
        let (mesh, _) = TriMesh::from_soup(positions_m, triangles.collect()).unwrap();
        let spans = if self.random.below(2) == 0 {
            Vec::new()
        } else {
            self.spans(num_triangles)
        };
        self.scan.mesh_blocks = Arc::new(MeshBlocks::new(spans, &mesh).unwrap());
        self.scan.mesh = Some(Arc::new(mesh));
        self.scan.num_mesh_updates += 1;
    }
    /// Blocks of triangles that share no vertex.
    fn spans(&mut self, num_triangles: u32) -> Vec<MeshBlockSpan> {
        let mut num_left = num_triangles;
        let mut spans = Vec::new();
        let mut key = i64::MIN;
        while num_left > 0 {
            let num = 1 + u32::try_from(self.random.below(num_left.into())).unwrap();
            key += 1 + i64::try_from(self.random.below(1 << 60)).unwrap();
            spans.push(MeshBlockSpan {
                key: MeshBlockKey([key, -1, i64::MAX]),
                num_vertices: 3 * num,
                num_triangles: num,
            });
            num_left -= num;
        }
        spans
    }
}
