//! All events of a bag, sorted by kind.

#![expect(clippy::unwrap_used, reason = "a test fails by panicking")]

use std::path::{Path, PathBuf};

use nalgebra::Point3;
use veneer::bag::{BagReader, TopicRoles, metadata};
use veneer::geom::{CameraModel, EncodedColor, EncodedDepth, RigidTransform, Stamp};
use veneer::ingest::{Event, EventSource, MeshUpdate};
use veneer::mesh::TriMesh;

#[derive(Default)]
pub(crate) struct ReadBack {
    path: PathBuf,
    pub(crate) colors: Vec<(Stamp, EncodedColor)>,
    pub(crate) depths: Vec<(Stamp, EncodedDepth)>,
    pub(crate) color_infos: Vec<(Stamp, CameraModel)>,
    pub(crate) depth_infos: Vec<(Stamp, CameraModel)>,
    pub(crate) transforms: Vec<(Stamp, RigidTransform)>,
    pub(crate) meshes: Vec<(Stamp, MeshUpdate)>,
    pub(crate) rejections: Vec<String>,
    pub(crate) losses: Vec<String>,
}

impl ReadBack {
    pub(crate) fn open(path: &Path) -> Self {
        let mut reader = BagReader::open(path, &TopicRoles::default()).unwrap();
        let mut back = Self {
            path: path.to_owned(),
            ..Self::default()
        };
        let mut received = Stamp::from_nanos(i64::MIN);
        while let Some(event) = reader.next_event() {
            assert!(event.received >= received, "the bag is in time order");
            received = event.received;
            match event.event {
                Ok(event) => back.take(event),
                Err(rejection) => back.rejections.push(rejection.to_string()),
            }
        }
        back.losses = reader.losses().to_vec();
        back
    }

    fn take(&mut self, event: Event) {
        match event {
            Event::Color(header, image) => {
                assert_eq!(&*header.frame_id, "camera_color_optical_frame");
                self.colors.push((header.stamp, image));
            }
            Event::Depth(header, image) => {
                assert_eq!(&*header.frame_id, "camera_depth_optical_frame");
                self.depths.push((header.stamp, image));
            }
            Event::ColorInfo(header, camera) => self.color_infos.push((header.stamp, camera)),
            Event::DepthInfo(header, camera) => self.depth_infos.push((header.stamp, camera)),
            Event::Transforms(transforms) => {
                for transform in transforms {
                    assert_eq!(&*transform.header.frame_id, "map");
                    assert_eq!(&*transform.child_frame_id, "camera_color_optical_frame");
                    self.transforms
                        .push((transform.header.stamp, transform.parent_from_child));
                }
            }
            Event::StaticTransforms(transforms) => {
                for transform in transforms {
                    assert_eq!(transform.parent_from_child, RigidTransform::identity());
                }
            }
            Event::Pose(header, _) => assert_eq!(&*header.frame_id, "map"),
            Event::Odometry(_) | Event::Corrections(..) => {
                panic!("an import writes neither odometry nor corrections")
            }
            Event::Mesh(header, update, soup) => {
                assert_eq!(&*header.frame_id, "map");
                assert_eq!(soup, veneer::mesh::SoupReport::default());
                self.meshes.push((header.stamp, update));
            }
        }
    }

    pub(crate) fn whole_mesh(&self) -> &TriMesh {
        match self.meshes.as_slice() {
            [(_, MeshUpdate::Whole(mesh))] => mesh,
            other => panic!("{} mesh messages, or one in blocks", other.len()),
        }
    }

    /// Corners of the triangles of all blocks, sorted.
    pub(crate) fn block_corners(&self) -> Vec<[Point3<f64>; 3]> {
        let mut corners = Vec::new();
        let mut keys = Vec::new();
        for (_, update) in &self.meshes {
            let MeshUpdate::Blocks { blocks, .. } = update else {
                panic!("a whole mesh among blocks");
            };
            for (key, block) in blocks {
                keys.push(*key);
                corners.extend(corners_of(block));
            }
        }
        assert!(keys.is_sorted_by(|a, b| a < b), "{keys:?}");
        sort(&mut corners);
        corners
    }

    pub(crate) fn metadata(&self, name: &str, key: &str) -> String {
        metadata(&self.path, name).unwrap().unwrap()[key].clone()
    }
}

fn sort(corners: &mut [[Point3<f64>; 3]]) {
    let bits = |point: Point3<f64>| [point.x, point.y, point.z].map(f64::to_bits);
    corners.sort_by_key(|triangle| triangle.map(bits));
}

/// Corners of all triangles, sorted.
pub(crate) fn corners_of(mesh: &TriMesh) -> Vec<[Point3<f64>; 3]> {
    let mut corners: Vec<_> = mesh.triangle_ids().map(|t| mesh.corners_m(t)).collect();
    sort(&mut corners);
    corners
}
