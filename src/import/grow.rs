//! A finished mesh told as it would have grown: what the camera saw first comes first.
//!
//! A triangle is seen by a frame when its centroid projects into the depth image and the measured
//! depth there agrees with the centroid's (within 5 cm and 3 % of the depth: the mesh's voxels and
//! the sensor's noise); by a frame without depth, when it projects into the photo. It belongs to
//! the first frame that sees it. The time from first to last frame is cut into equal slices; at
//! the end of each, one block with its triangles is published, keyed by the slice's number. What
//! no frame ever sees comes with the last, so that all blocks together are the whole mesh; the
//! vertices on a border between blocks are in each of them, those that no triangle uses in none.

use std::num::NonZeroU32;

use nalgebra::Point3;
use rayon::prelude::*;

use crate::geom::{CameraModel, DepthImage, Stamp};
use crate::ingest::MeshUpdate;
use crate::ingest::event::MeshBlockKey;
use crate::mesh::{MeshError, TriMesh};

use super::load::LoadedFrame;

const MAX_DIFFERENCE_M: f64 = 0.05;
const MAX_RELATIVE_DIFFERENCE: f64 = 0.03;

const NO_VERTEX: u32 = u32::MAX;

pub(super) struct Growth<'a> {
    mesh: &'a TriMesh,
    /// By triangle, in the world.
    centroids_m: Vec<Point3<f64>>,
    /// Triangles that no frame has seen, ascending.
    unseen: Vec<u32>,
    /// Triangles first seen in the slice at hand.
    fresh: Vec<u32>,
    /// Scratch for [`Self::block`]: index in the block by vertex of the mesh.
    index_in_block: Vec<u32>,
    slice_ends: Vec<Stamp>,
    /// The slice at hand.
    slice: usize,
}

impl<'a> Growth<'a> {
    /// Slices of equal length from the first frame to the last.
    pub(super) fn new(
        mesh: &'a TriMesh,
        num_slices: NonZeroU32,
        first: Stamp,
        last: Stamp,
    ) -> Self {
        let third = 1.0 / 3.0;
        let centroids_m = mesh
            .triangle_ids()
            .map(|triangle| {
                let [a, b, c] = mesh.corners_m(triangle);
                Point3::from((a.coords + b.coords + c.coords) * third)
            })
            .collect();
        let span_nanos = i128::from(last.as_nanos()) - i128::from(first.as_nanos());
        let slice_ends = (1..=num_slices.get())
            .map(|k| {
                let nanos = i128::from(first.as_nanos())
                    + span_nanos * i128::from(k) / i128::from(num_slices.get());
                Stamp::from_nanos(i64::try_from(nanos).unwrap_or(last.as_nanos()))
            })
            .collect();
        Self {
            mesh,
            centroids_m,
            unseen: mesh.triangle_ids().map(|triangle| triangle.0).collect(),
            fresh: Vec::new(),
            index_in_block: vec![NO_VERTEX; mesh.num_vertices()],
            slice_ends,
            slice: 0,
        }
    }

    /// The updates that are due before a frame of this stamp is seen.
    pub(super) fn due_before(
        &mut self,
        stamp: Stamp,
    ) -> Result<Vec<(Stamp, MeshUpdate)>, MeshError> {
        let mut due = Vec::new();
        while self.slice + 1 < self.slice_ends.len() && stamp > self.slice_ends[self.slice] {
            due.push(self.end_slice()?);
        }
        Ok(due)
    }

    /// The updates behind the last frame, and how many triangles no frame has seen.
    pub(super) fn finish(mut self) -> Result<(Vec<(Stamp, MeshUpdate)>, usize), MeshError> {
        let mut due = Vec::new();
        while self.slice + 1 < self.slice_ends.len() {
            due.push(self.end_slice()?);
        }
        let unseen = std::mem::take(&mut self.unseen);
        self.fresh.extend(&unseen);
        due.push(self.end_slice()?);
        Ok((due, unseen.len()))
    }

    /// Takes what the frame is the first to see.
    pub(super) fn see(&mut self, frame: &LoadedFrame) {
        let camera_from_world = frame.world_from_camera.inverse();
        let (camera, depth) = match &frame.depth {
            Some(depth) => (&depth.camera, depth.decoded.as_ref()),
            None => (&frame.color_camera, None),
        };
        let centroids_m = &self.centroids_m;
        let is_seen: Vec<bool> = self
            .unseen
            .par_iter()
            .with_min_len(1024)
            .map(|&triangle| {
                let centroid = camera_from_world.transform_point(&centroids_m[triangle as usize]);
                sees(camera, depth, &centroid)
            })
            .collect();
        let mut flags = is_seen.iter();
        let fresh = &mut self.fresh;
        self.unseen.retain(|&triangle| {
            let is_seen = flags.next() == Some(&true);
            if is_seen {
                fresh.push(triangle);
            }
            !is_seen
        });
    }

    fn end_slice(&mut self) -> Result<(Stamp, MeshUpdate), MeshError> {
        let triangles = std::mem::take(&mut self.fresh);
        let key = MeshBlockKey([i64::try_from(self.slice).unwrap_or(i64::MAX), 0, 0]);
        let blocks = if triangles.is_empty() {
            Vec::new()
        } else {
            vec![(key, self.block(&triangles)?)]
        };
        let update = MeshUpdate::Blocks {
            clear: false,
            blocks,
        };
        let end = self.slice_ends[self.slice];
        self.slice += 1;
        Ok((end, update))
    }

    /// These triangles with the vertices that they use, in the order of their first use.
    fn block(&mut self, triangles: &[u32]) -> Result<TriMesh, MeshError> {
        let mut vertices = Vec::new();
        let mut positions_m = Vec::new();
        let mut indices = Vec::with_capacity(triangles.len());
        for &triangle in triangles {
            indices.push(self.mesh.triangles()[triangle as usize].map(|vertex| {
                let index = &mut self.index_in_block[vertex as usize];
                if *index == NO_VERTEX {
                    #[expect(
                        clippy::cast_possible_truncation,
                        reason = "a mesh has fewer than 2³² vertices"
                    )]
                    let next = vertices.len() as u32;
                    *index = next;
                    vertices.push(vertex);
                    positions_m.push(self.mesh.positions_m()[vertex as usize]);
                }
                *index
            }));
        }
        for vertex in vertices {
            self.index_in_block[vertex as usize] = NO_VERTEX;
        }
        TriMesh::from_soup(positions_m, indices).map(|(block, _)| block)
    }
}

fn sees(camera: &CameraModel, depth: Option<&DepthImage>, point_in_camera: &Point3<f64>) -> bool {
    let Some(pixel) = camera.pinhole.project(point_in_camera) else {
        return false;
    };
    // Far outside the view a lens polynomial can fold a ray back into the image.
    let [width, height] = [camera.pinhole.width(), camera.pinhole.height()].map(f64::from);
    let is_near_view = |px: f64, side: f64| (-0.5 * side..=1.5 * side).contains(&px);
    if !is_near_view(pixel[0], width) || !is_near_view(pixel[1], height) {
        return false;
    }
    let pixel = camera.distort_px(pixel);
    let Some(depth) = depth else {
        return camera.pinhole.contains(pixel);
    };
    let max_difference_m = MAX_DIFFERENCE_M + MAX_RELATIVE_DIFFERENCE * point_in_camera.z;
    depth
        .nearest(pixel)
        .is_some_and(|depth_m| (f64::from(depth_m) - point_in_camera.z).abs() <= max_difference_m)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geom::{
        ColorImage, DepthEncoding, EncodedColor, EncodedDepth, PinholeCamera, RigidTransform,
    };
    use crate::import::load::LoadedDepth;
    use nalgebra::{UnitQuaternion, Vector3};

    const DEPTH_M: f64 = 2.0;
    const NUM_FRAMES: i64 = 9;

    /// A strip of squares along x at z = 2, seen from z = 0; each square has two triangles.
    fn strip(num_squares: u32) -> TriMesh {
        let positions_m = (0..=num_squares)
            .flat_map(|i| [-0.05, 0.05].map(|y| Point3::new(f64::from(i) * 0.1, y, DEPTH_M)))
            .collect();
        let triangles = (0..num_squares)
            .flat_map(|i| {
                let v = 2 * i;
                [[v, v + 1, v + 2], [v + 2, v + 1, v + 3]]
            })
            .collect();
        TriMesh::from_soup(positions_m, triangles).unwrap().0
    }

    fn camera() -> CameraModel {
        let pinhole = PinholeCamera::new([40.0, 40.0, 15.5, 11.5], 32, 24).unwrap();
        CameraModel::ideal(pinhole)
    }

    /// Frame `i` at x = i m; the depth image shows a wall at `wall_m`.
    fn frame(i: i64, wall_m: Option<f32>) -> LoadedFrame {
        let stamp = Stamp::from_nanos(1_000_000_000 + i * 100_000_000);
        let black = ColorImage::new(32, 24, vec![[0; 3]; 32 * 24]).unwrap();
        LoadedFrame {
            stamp,
            world_from_camera: RigidTransform::from_parts(
                UnitQuaternion::identity(),
                Vector3::new(i as f64, 0.0, 0.0),
            ),
            color: EncodedColor::png_from_image(&black).unwrap(),
            color_camera: camera(),
            depth: wall_m.map(|wall_m| LoadedDepth {
                stamp,
                image: EncodedDepth::from_raw(
                    DepthEncoding::U16Mm { big_endian: false },
                    32,
                    24,
                    64,
                    vec![0; 64 * 24].into(),
                )
                .unwrap(),
                camera: camera(),
                decoded: Some(DepthImage::new(32, 24, vec![wall_m; 32 * 24]).unwrap()),
            }),
            refused_depth: None,
        }
    }

    fn grown(
        mesh: &TriMesh,
        num_slices: u32,
        frames: &[LoadedFrame],
    ) -> (Vec<(Stamp, MeshUpdate)>, usize) {
        let (first, last) = (frames[0].stamp, frames[frames.len() - 1].stamp);
        let num_slices = NonZeroU32::new(num_slices).unwrap();
        let mut growth = Growth::new(mesh, num_slices, first, last);
        let mut updates = Vec::new();
        for frame in frames {
            updates.extend(growth.due_before(frame.stamp).unwrap());
            growth.see(frame);
        }
        let (rest, num_unseen) = growth.finish().unwrap();
        updates.extend(rest);
        (updates, num_unseen)
    }

    fn corners_of(mesh: &TriMesh) -> Vec<[Point3<f64>; 3]> {
        mesh.triangle_ids().map(|t| mesh.corners_m(t)).collect()
    }

    fn blocks(update: &MeshUpdate) -> &[(MeshBlockKey, TriMesh)] {
        match update {
            MeshUpdate::Blocks {
                clear: false,
                blocks,
            } => blocks,
            other => panic!("not a growing update: {other:?}"),
        }
    }

    /// The camera's view at the wall is [x − 0.8, x + 0.8] (half a pixel wider than the image's
    /// centres), so the first frame that sees a centroid is known in closed form.
    #[test]
    fn each_triangle_comes_in_the_slice_of_the_first_frame_that_sees_it() {
        let mesh = strip(80);
        for wall_m in [Some(2.0), Some(2.05), None] {
            let frames: Vec<_> = (0..NUM_FRAMES).map(|i| frame(i, wall_m)).collect();
            let (updates, num_unseen) = grown(&mesh, 3, &frames);
            assert_eq!(num_unseen, 0, "{wall_m:?}");
            assert_eq!(updates.len(), 3);
            let half_width_m = if wall_m.is_some() { 0.8 } else { 15.5 / 20.0 };
            let mut num_triangles = 0;
            for (slice, (stamp, update)) in updates.iter().enumerate() {
                let slice = i64::try_from(slice).unwrap();
                // 8 intervals of 0.1 s cut in 3: frames 0–2, 3–5 and 6–8.
                let span_nanos = 100_000_000 * (NUM_FRAMES - 1);
                assert_eq!(
                    stamp.as_nanos(),
                    1_000_000_000 + span_nanos * (slice + 1) / 3
                );
                for (key, block) in blocks(update) {
                    assert_eq!(key.0, [slice, 0, 0]);
                    for corners in corners_of(block) {
                        let x = corners.iter().map(|c| c.x).sum::<f64>() / 3.0;
                        let first_frame = (x - half_width_m).ceil().max(0.0);
                        assert_eq!(
                            (first_frame / 3.0).floor(),
                            slice as f64,
                            "x {x}, first frame {first_frame}"
                        );
                    }
                    num_triangles += block.num_triangles();
                }
            }
            assert_eq!(num_triangles, mesh.num_triangles());
        }
    }

    #[test]
    fn what_the_sensor_does_not_confirm_comes_last_and_nothing_is_lost() {
        let mesh = strip(80);
        // A wall half a metre before the strip hides it, but for the last frame.
        let frames: Vec<_> = (0..NUM_FRAMES)
            .map(|i| frame(i, Some(if i + 1 < NUM_FRAMES { 1.5 } else { 2.0 })))
            .collect();
        let (updates, num_unseen) = grown(&mesh, 4, &frames);
        assert_eq!(updates.len(), 4);
        assert!(updates[..3].iter().all(|(_, u)| blocks(u).is_empty()));
        // The last frame, at x = 8, sees the centroids from 7.2 on: 8 of 80 squares.
        assert_eq!(num_unseen, mesh.num_triangles() - 16);
        let [(_, block)] = blocks(&updates[3].1) else {
            panic!("one block expected");
        };
        let key = |c: &[Point3<f64>; 3]| c.map(|p| (p.x.to_bits(), p.y.to_bits()));
        let mut expected = corners_of(&mesh);
        let mut actual = corners_of(block);
        expected.sort_by_key(key);
        actual.sort_by_key(key);
        assert_eq!(actual, expected);
    }

    #[test]
    fn one_frame_and_many_slices_still_make_the_mesh() {
        let mesh = strip(3);
        let (updates, _) = grown(&mesh, 5, &[frame(0, Some(2.0))]);
        assert_eq!(updates.len(), 5);
        let num_triangles: usize = updates
            .iter()
            .flat_map(|(_, update)| blocks(update))
            .map(|(_, block)| block.num_triangles())
            .sum();
        assert_eq!(num_triangles, mesh.num_triangles());
    }
}
