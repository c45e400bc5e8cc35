//! The mesh as it grows: which triangle the camera saw first in which frame, in cubic blocks.

use std::collections::BTreeMap;

use nalgebra::Point3;

use crate::geom::{PinholeCamera, RigidTransform};
use crate::ingest::event::MeshBlockKey;
use crate::mesh::{TriMesh, TriangleId};

/// A mesh that is revealed as frames go by.
#[derive(Debug)]
pub(super) struct Growth {
    mesh: TriMesh,
    block_of_triangle: Vec<i64>,
    is_seen: Vec<bool>,
    /// Blocks that changed since the last update.
    is_changed: BTreeMap<i64, bool>,
}

impl Growth {
    pub(super) fn new(mesh: TriMesh, block_m: f64) -> Self {
        let block_of_triangle: Vec<i64> = mesh
            .triangle_ids()
            .map(|triangle| block_key(&middle(&mesh, triangle), block_m))
            .collect();
        let is_changed = block_of_triangle.iter().map(|&key| (key, false)).collect();
        Self {
            is_seen: vec![false; mesh.num_triangles()],
            mesh,
            block_of_triangle,
            is_changed,
        }
    }

    /// Marks the triangles whose middle this frame shows, nothing being in front of it.
    pub(super) fn see(
        &mut self,
        camera: &PinholeCamera,
        world_from_camera: &RigidTransform,
        depth_m: &[f32],
    ) {
        let camera_from_world = world_from_camera.inverse();
        for triangle in self.mesh.triangle_ids() {
            if self.is_seen[triangle.index()] {
                continue;
            }
            let point = camera_from_world.transform_point(&middle(&self.mesh, triangle));
            if is_shown(&point, camera, depth_m) {
                self.is_seen[triangle.index()] = true;
                self.is_changed
                    .insert(self.block_of_triangle[triangle.index()], true);
            }
        }
    }

    /// Counts what no frame showed as seen, so that the last update completes the mesh.
    pub(super) fn see_rest(&mut self) {
        for (is_seen, block) in self.is_seen.iter_mut().zip(&self.block_of_triangle) {
            if !*is_seen {
                *is_seen = true;
                self.is_changed.insert(*block, true);
            }
        }
    }

    /// The changed blocks, each whole, in order of their keys.
    pub(super) fn take_changed(&mut self) -> Vec<(MeshBlockKey, TriMesh)> {
        let mut triangles_of_block: BTreeMap<i64, Vec<[u32; 3]>> = BTreeMap::new();
        for (index, corners) in self.mesh.triangles().iter().enumerate() {
            let block = self.block_of_triangle[index];
            if self.is_seen[index] && self.is_changed.get(&block) == Some(&true) {
                triangles_of_block.entry(block).or_default().push(*corners);
            }
        }
        for is_changed in self.is_changed.values_mut() {
            *is_changed = false;
        }
        triangles_of_block
            .into_iter()
            .map(|(key, triangles)| (MeshBlockKey([key, 0, 0]), self.submesh(&triangles)))
            .collect()
    }

    /// Share of the area of the triangles with their middle in a region that was seen.
    #[cfg(test)]
    pub(super) fn seen_area_share(&self, is_inside: impl Fn(&Point3<f64>) -> bool) -> f64 {
        let (mut seen_m2, mut all_m2) = (0.0, 0.0);
        for triangle in self.mesh.triangle_ids() {
            if is_inside(&middle(&self.mesh, triangle)) {
                let area_m2 = self.mesh.area_m2(triangle);
                all_m2 += area_m2;
                seen_m2 += area_m2 * f64::from(u8::from(self.is_seen[triangle.index()]));
            }
        }
        seen_m2 / all_m2
    }

    fn submesh(&self, triangles: &[[u32; 3]]) -> TriMesh {
        let mut new_id: BTreeMap<u32, u32> = BTreeMap::new();
        let mut points = Vec::new();
        let mut renumbered = Vec::with_capacity(triangles.len());
        for corners in triangles {
            renumbered.push(corners.map(|vertex| {
                *new_id.entry(vertex).or_insert_with(|| {
                    points.push(self.mesh.positions_m()[vertex as usize]);
                    #[expect(clippy::cast_possible_truncation, reason = "fewer than the mesh has")]
                    let id = (points.len() - 1) as u32;
                    id
                })
            }));
        }
        // Indices are in range and positions finite by construction.
        TriMesh::from_soup(points, renumbered).map_or_else(|_| TriMesh::default(), |(mesh, _)| mesh)
    }
}

fn middle(mesh: &TriMesh, triangle: TriangleId) -> Point3<f64> {
    let [a, b, c] = mesh.corners_m(triangle);
    Point3::from((a.coords + b.coords + c.coords) / 3.0)
}

fn is_shown(point_in_camera: &Point3<f64>, camera: &PinholeCamera, depth_m: &[f32]) -> bool {
    let Some([x, y]) = camera
        .project(point_in_camera)
        .filter(|px| camera.contains(*px))
    else {
        return false;
    };
    #[expect(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "inside the image"
    )]
    let at = y.round() as usize * camera.width() as usize + x.round() as usize;
    let tolerance_m = 0.02 + 0.02 * point_in_camera.z;
    depth_m.get(at).is_some_and(|&depth| {
        depth > 0.0 && (f64::from(depth) - point_in_camera.z).abs() < tolerance_m
    })
}

/// Blocks count along x, then y, then z, 2²⁰ to an axis.
fn block_key(point: &Point3<f64>, block_m: f64) -> i64 {
    #[expect(clippy::cast_possible_truncation, reason = "clamped to ±2¹⁹")]
    let cell = |v: f64| (v / block_m).floor().clamp(-524_288.0, 524_287.0) as i64 + 524_288;
    (cell(point.z) << 40) | (cell(point.y) << 20) | cell(point.x)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_last_blocks_of_each_key_are_the_whole_mesh() {
        let mut points = Vec::new();
        let mut triangles = Vec::new();
        for k in 0..40u32 {
            let x = f64::from(k) * 0.1 - 2.0;
            points.extend([[x, 0.0, 2.0], [x + 0.1, 0.0, 2.0], [x, 0.1, 2.0]].map(Point3::from));
            triangles.push([3 * k, 3 * k + 1, 3 * k + 2]);
        }
        let (mesh, _) = TriMesh::from_soup(points, triangles).unwrap();
        let camera = PinholeCamera::new([60.0, 60.0, 31.5, 23.5], 64, 48).unwrap();
        let depth_m = vec![2.0f32; 64 * 48];
        let mut growth = Growth::new(mesh.clone(), 0.5);
        growth.see(&camera, &RigidTransform::identity(), &depth_m);
        let first = growth.take_changed();
        let num_first: usize = first.iter().map(|(_, block)| block.num_triangles()).sum();
        assert!(num_first > 10 && num_first < 40, "{num_first}");
        growth.see(&camera, &RigidTransform::identity(), &depth_m);
        assert!(growth.take_changed().is_empty(), "nothing new was seen");
        growth.see_rest();
        let mut blocks: BTreeMap<MeshBlockKey, TriMesh> = first.into_iter().collect();
        blocks.extend(growth.take_changed());
        let mut areas: Vec<[u64; 9]> = Vec::new();
        let mut expected: Vec<[u64; 9]> = Vec::new();
        let bits = |mesh: &TriMesh, triangle| {
            let corners = mesh.corners_m(triangle);
            std::array::from_fn(|k| corners[k / 3][k % 3].to_bits())
        };
        for block in blocks.values() {
            areas.extend(block.triangle_ids().map(|triangle| bits(block, triangle)));
        }
        expected.extend(mesh.triangle_ids().map(|triangle| bits(&mesh, triangle)));
        areas.sort_unstable();
        expected.sort_unstable();
        assert_eq!(areas, expected);
    }
}
