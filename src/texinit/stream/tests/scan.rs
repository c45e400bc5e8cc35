//! A small scan that changes at random: parts of a known scene come, go and move, and so do the
//! keyframes that photograph it.

use std::sync::Arc;

use nalgebra::{Point3, Vector3};

use crate::geom::{
    CameraModel, ColorImage, Distortion, EncodedColor, ImageError, RigidTransform, Stamp,
};
use crate::keyframe::{DecodedFrame, FrameQuality, Keyframe, KeyframeId};
use crate::mesh::TriMesh;
use crate::texinit::analytic_scene::{Panel, Scene, camera, red, waves};
use crate::texinit::{Observer, Stage};

/// Numbers that look random.
pub(super) struct Draw(pub(super) u64);

impl Draw {
    pub(super) fn below(&mut self, end: usize) -> usize {
        self.0 = self
            .0
            .wrapping_mul(6_364_136_223_846_793_005)
            .wrapping_add(1_442_695_040_888_963_407);
        (self.0 >> 33) as usize % end
    }

    /// In [low, high].
    fn within(&mut self, low: f64, high: f64) -> f64 {
        low + (high - low) * self.below(10_001) as f64 / 10_000.0
    }
}

/// Is told and does nothing.
pub(super) struct Silent;

impl Observer for Silent {
    fn begin(&self, _stage: Stage, _num_steps: usize) {}
    fn advance(&self, _num_steps: usize) {}
}

pub(super) struct Scan {
    scene: Scene,
    /// Where vertices are now.
    positions_m: Vec<Point3<f64>>,
    triangles: Vec<[u32; 3]>,
    is_shown: Vec<bool>,
    /// Which photographs are keyframes, with what was added to the camera's position.
    kept: Vec<(usize, Vector3<f64>)>,
    is_reversed: bool,
    color: EncodedColor,
}

const WALL: Panel = Panel {
    min: [-1.4, -1.0],
    max: [1.4, 1.0],
    z: 3.0,
    cells: [14, 10],
    paint: waves,
};
const BOARD: Panel = Panel {
    min: [-0.4, -0.3],
    max: [0.3, 0.3],
    z: 2.0,
    cells: [3, 2],
    paint: red,
};
const TILE: Panel = Panel {
    min: [0.4, -0.6],
    max: [1.0, 0.5],
    z: 2.5,
    cells: [4, 8],
    paint: waves,
};

/// The last photograph does not decode.
const NUM_PHOTOS: usize = 7;

impl Scan {
    pub(super) fn new(seed: u64) -> Self {
        let mut draw = Draw(seed ^ 0x5eed);
        let mut scene = Scene {
            panels: vec![WALL, BOARD, TILE],
            ..Scene::default()
        };
        for photo in 0..NUM_PHOTOS {
            let position = [
                draw.within(-0.9, 0.9),
                draw.within(-0.4, 0.4),
                draw.within(-0.3, 1.3),
            ];
            let yaw_rad = draw.within(-0.35, 0.35);
            scene.photograph(position, yaw_rad, &[], photo % 3 != 1);
            let sharpness = draw.within(0.4, 2.5) as f32;
            scene.poses[photo].quality = FrameQuality {
                sharpness,
                mean_luma: sharpness / 4.0,
                clipped: 0.01,
            };
        }
        let mesh = scene.mesh();
        let pixel = ColorImage::new(1, 1, vec![[0; 3]]).unwrap();
        let mut scan = Self {
            scene,
            positions_m: mesh.positions_m().to_vec(),
            is_shown: vec![false; mesh.num_triangles()],
            triangles: mesh.triangles().to_vec(),
            kept: vec![(0, Vector3::zeros()), (1, Vector3::zeros())],
            is_reversed: false,
            color: EncodedColor::png_from_image(&pixel).unwrap(),
        };
        scan.show_around(&mut draw, true);
        scan
    }

    pub(super) fn mesh(&self) -> Arc<TriMesh> {
        let shown = self.triangles.iter().zip(&self.is_shown);
        let mut shown: Vec<[u32; 3]> = shown
            .filter(|(_, shown)| **shown)
            .map(|(t, _)| *t)
            .collect();
        if self.is_reversed {
            shown.reverse();
            for corners in &mut shown {
                corners.rotate_left(1);
            }
        }
        let mesh = TriMesh::from_soup(self.positions_m.clone(), shown);
        Arc::new(mesh.unwrap().0)
    }

    pub(super) fn frames(&self) -> Vec<Arc<Keyframe>> {
        let keyframe = |&(photo, offset): &(usize, Vector3<f64>)| {
            let pose = &self.scene.poses[photo];
            let world_from_camera = RigidTransform::from_parts(
                *pose.world_from_camera.rotation(),
                pose.world_from_camera.translation() + offset,
            );
            Arc::new(Keyframe {
                id: KeyframeId(pose.id),
                stamp: Stamp::default(),
                world_from_camera,
                color: self.color.clone(),
                color_camera: CameraModel {
                    pinhole: camera(),
                    distortion: Distortion::None,
                },
                depth: None,
                quality: pose.quality,
            })
        };
        self.kept.iter().map(keyframe).collect()
    }

    pub(super) fn decode(&self, keyframe: &Keyframe) -> Result<Arc<DecodedFrame>, ImageError> {
        let photo = self
            .scene
            .poses
            .iter()
            .position(|pose| pose.id == keyframe.id.0);
        match photo {
            Some(photo) if photo + 1 < NUM_PHOTOS => Ok(self.scene.frames[photo].clone()),
            _ => Err(ImageError::Encoding("broken".to_owned())),
        }
    }

    /// One to three changes at random.
    pub(super) fn change(&mut self, draw: &mut Draw) {
        for _ in 0..=draw.below(3) {
            match draw.below(9) {
                0 | 1 => self.show_around(draw, true),
                2 => self.show_around(draw, false),
                3 => self.move_around(draw, 0.003),
                4 => self.move_around(draw, 0.03),
                5 | 6 => self.add_frame(draw),
                7 => self.correct_or_remove_frame(draw),
                _ => self.flip_or_reverse(draw),
            }
        }
    }

    pub(super) fn show_all(&mut self) {
        self.is_shown.fill(true);
    }

    pub(super) fn hide_right_of(&mut self, x_m: f64) {
        for (triangle, is_shown) in self.is_shown.iter_mut().enumerate() {
            let corners = self.triangles[triangle];
            *is_shown &= corners
                .iter()
                .all(|&v| self.positions_m[v as usize].x < x_m);
        }
    }

    fn blob(draw: &mut Draw) -> (Point3<f64>, f64) {
        let center = Point3::new(
            draw.within(-1.4, 1.4),
            draw.within(-1.0, 1.0),
            draw.within(2.0, 3.0),
        );
        (center, draw.within(0.2, 1.0))
    }

    fn show_around(&mut self, draw: &mut Draw, is_shown: bool) {
        let (center, radius_m) = Self::blob(draw);
        for (triangle, shown) in self.is_shown.iter_mut().enumerate() {
            let first = self.positions_m[self.triangles[triangle][0] as usize];
            if (first - center).norm() < radius_m {
                *shown = is_shown;
            }
        }
    }

    fn move_around(&mut self, draw: &mut Draw, most_m: f64) {
        let (center, radius_m) = Self::blob(draw);
        for position in &mut self.positions_m {
            if (*position - center).norm() < radius_m {
                *position += Vector3::from_fn(|_, _| draw.within(-most_m, most_m));
            }
        }
    }

    fn add_frame(&mut self, draw: &mut Draw) {
        let photo = draw.below(NUM_PHOTOS);
        if self.kept.iter().all(|(kept, _)| *kept != photo) {
            self.kept.push((photo, Vector3::zeros()));
            self.kept.sort_by_key(|(kept, _)| *kept);
        }
    }

    fn correct_or_remove_frame(&mut self, draw: &mut Draw) {
        if self.kept.is_empty() {
            return;
        }
        let at = draw.below(self.kept.len());
        if draw.below(2) == 0 {
            self.kept.remove(at);
        } else {
            self.kept[at].1 = Vector3::from_fn(|_, _| draw.within(-0.1, 0.1));
        }
    }

    /// Turns an edge between two triangles of a cell, or lists everything the other way round.
    fn flip_or_reverse(&mut self, draw: &mut Draw) {
        self.is_reversed ^= draw.below(2) == 0;
        let cell = 2 * draw.below(self.triangles.len() / 2);
        let ([a, c, b], [b_too, c_too, d]) = (self.triangles[cell], self.triangles[cell + 1]);
        if (b, c) == (b_too, c_too) {
            self.triangles[cell] = [a, c, d];
            self.triangles[cell + 1] = [a, d, b];
        }
    }
}
