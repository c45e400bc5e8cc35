//! A scene: painted surfaces grouped into bodies, the light, and the solids that hide them.

pub(super) mod art;
pub(super) mod furniture;
pub(super) mod print;
pub(super) mod room;
pub(super) mod still_life;
pub(super) mod tabletop;

use nalgebra::{Matrix3, Point3, Rotation3, UnitQuaternion, Vector3};

use crate::geom::RigidTransform;

use super::hash::Stream;
use super::light::{self, LightMap, Lighting};
use super::surface::{Shape, Surface};
use super::texture::Texture;

/// Everything that is there to be scanned.
#[derive(Clone, Debug)]
pub(super) struct Scene {
    pub(super) surfaces: Vec<Surface>,
    pub(super) solids: Vec<Solid>,
    /// Edge length that the scene's mesh has unless told otherwise, metres.
    pub(super) edge_m: f64,
    /// Where the hand leads the camera: eye and target, world frame (z up), metres.
    pub(super) waypoints_m: Vec<[[f64; 3]; 2]>,
}

/// The inside of a body: surfaces in there cannot be seen and are not meshed.
#[derive(Clone, Debug)]
pub(super) struct Solid {
    solid_from_world: RigidTransform,
    shape: SolidShape,
}

#[derive(Clone, Copy, Debug)]
enum SolidShape {
    /// |x| < w/2, |y| < d/2, 0 < z < h.
    Box([f64; 3]),
    /// x² + y² < r², 0 < z < h.
    Cylinder { radius_m: f64, height_m: f64 },
    /// Of this radius, standing on the origin.
    Ball(f64),
}

impl Solid {
    /// Whether a point lies inside.
    pub(super) fn contains(&self, point_in_world: &Point3<f64>) -> bool {
        let p = self.solid_from_world.transform_point(point_in_world);
        match self.shape {
            SolidShape::Box([w, d, h]) => {
                2.0 * p.x.abs() < w && 2.0 * p.y.abs() < d && p.z > 0.0 && p.z < h
            }
            SolidShape::Ball(radius_m) => {
                p.x * p.x + p.y * p.y + (p.z - radius_m).powi(2) < radius_m * radius_m
            }
            SolidShape::Cylinder { radius_m, height_m } => {
                p.x * p.x + p.y * p.y < radius_m * radius_m && p.z > 0.0 && p.z < height_m
            }
        }
    }
}

/// The six textures of a box: front (−y), back, left (−x), right, top, bottom.
pub(super) type Faces = [Texture; 6];

/// All faces alike, each with its own random choices.
pub(super) fn all_faces(texture: &Texture, salt: u32) -> Faces {
    std::array::from_fn(|face| {
        #[expect(clippy::cast_possible_truncation, reason = "six faces")]
        let face = face as u32;
        texture
            .clone()
            .salted(salt.wrapping_mul(8).wrapping_add(face))
    })
}

/// Collects surfaces while a scene is described.
#[derive(Debug)]
pub(super) struct SceneBuilder {
    surfaces: Vec<Surface>,
    solids: Vec<Solid>,
    num_bodies: u32,
    edge_scale: f64,
    /// Random choices of the description.
    pub(super) random: Stream,
}

impl SceneBuilder {
    pub(super) fn new(random: Stream) -> Self {
        Self {
            surfaces: Vec::new(),
            solids: Vec::new(),
            num_bodies: 0,
            edge_scale: 1.0,
            random,
        }
    }

    /// Factor on the mesh's edge length for the bodies that follow.
    pub(super) fn set_edge_scale(&mut self, edge_scale: f64) {
        self.edge_scale = edge_scale;
    }

    /// Starts a body: surfaces added until the next one share vertices where they meet.
    pub(super) fn begin_body(&mut self) {
        self.num_bodies += 1;
    }

    fn push(
        &mut self,
        name: String,
        world_from_local: RigidTransform,
        shape: Shape,
        texture: Texture,
    ) {
        self.surfaces.push(Surface {
            name,
            body: self.num_bodies,
            world_from_local,
            shape,
            texture,
            light: LightMap::default(),
            edge_scale: self.edge_scale,
        });
    }

    /// A rectangle by its top-left corner, its rightward and its downward direction as seen from
    /// its visible side (unit vectors, orthogonal), in the frame `world_from_frame`.
    pub(super) fn rect(
        &mut self,
        name: impl Into<String>,
        world_from_frame: &RigidTransform,
        [corner, right, down]: [[f64; 3]; 3],
        size_m: [f64; 2],
        texture: Texture,
    ) {
        let frame_from_local = local_frame(corner.into(), right.into(), down.into());
        let shape = Shape::Rect { size_m };
        self.push(
            name.into(),
            *world_from_frame * frame_from_local,
            shape,
            texture,
        );
    }

    /// A box standing on its frame's origin, z up: the frame is at the middle of its bottom.
    pub(super) fn cuboid(
        &mut self,
        name: &str,
        world_from_box: &RigidTransform,
        size_m: [f64; 3],
        faces: Faces,
    ) {
        self.begin_body();
        let [w, d, h] = size_m;
        let (x, y) = (w / 2.0, d / 2.0);
        let frames = [
            (
                "front",
                [[-x, -y, h], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]],
                [w, h],
            ),
            (
                "back",
                [[x, y, h], [-1.0, 0.0, 0.0], [0.0, 0.0, -1.0]],
                [w, h],
            ),
            (
                "left",
                [[-x, y, h], [0.0, -1.0, 0.0], [0.0, 0.0, -1.0]],
                [d, h],
            ),
            (
                "right",
                [[x, -y, h], [0.0, 1.0, 0.0], [0.0, 0.0, -1.0]],
                [d, h],
            ),
            (
                "top",
                [[-x, y, h], [1.0, 0.0, 0.0], [0.0, -1.0, 0.0]],
                [w, d],
            ),
            (
                "bottom",
                [[-x, -y, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]],
                [w, d],
            ),
        ];
        for ((face, frame, size), texture) in frames.into_iter().zip(faces) {
            self.rect(
                format!("{name} {face}"),
                world_from_box,
                frame,
                size,
                texture,
            );
        }
        self.solids.push(Solid {
            solid_from_world: world_from_box.inverse(),
            shape: SolidShape::Box(size_m),
        });
    }

    /// A standing (truncated) cone or cylinder with a closed top and bottom; z up, origin at the
    /// middle of its bottom. Radii: bottom, top.
    pub(super) fn cylinder(
        &mut self,
        name: &str,
        world_from_cylinder: &RigidTransform,
        [bottom_radius_m, top_radius_m]: [f64; 2],
        height_m: f64,
        [mantle, top, bottom]: [Texture; 3],
    ) {
        self.begin_body();
        self.mantle(
            name,
            world_from_cylinder,
            [bottom_radius_m, top_radius_m],
            [0.0, height_m],
            false,
            mantle,
        );
        self.disc(
            format!("{name} top"),
            world_from_cylinder,
            height_m,
            [top_radius_m, 0.0],
            top,
        );
        self.underside(name, world_from_cylinder, bottom_radius_m, bottom);
        self.solid_cylinder(
            world_from_cylinder,
            bottom_radius_m.min(top_radius_m),
            height_m,
        );
    }

    /// Declares the inside of a standing cylinder as filled.
    pub(super) fn solid_cylinder(
        &mut self,
        world_from_cylinder: &RigidTransform,
        radius_m: f64,
        height_m: f64,
    ) {
        self.solids.push(Solid {
            solid_from_world: world_from_cylinder.inverse(),
            shape: SolidShape::Cylinder { radius_m, height_m },
        });
    }

    /// The mantle of a standing cone between two heights, seen from outside or from inside.
    pub(super) fn mantle(
        &mut self,
        name: &str,
        world_from_cylinder: &RigidTransform,
        [bottom_radius_m, top_radius_m]: [f64; 2],
        [z0, z1]: [f64; 2],
        is_inward: bool,
        texture: Texture,
    ) {
        // Local y is down and local −z, where u starts, is towards −y.
        let frame_from_local = local_frame(Vector3::new(0.0, 0.0, z1), Vector3::x(), -Vector3::z());
        let shape = Shape::Mantle {
            top_radius_m,
            bottom_radius_m,
            height_m: z1 - z0,
            is_inward,
        };
        let side = if is_inward { "inside" } else { "side" };
        self.push(
            format!("{name} {side}"),
            *world_from_cylinder * frame_from_local,
            shape,
            texture,
        );
    }

    /// A disc or ring that faces up at height `z`. Radii: outer, inner.
    pub(super) fn disc(
        &mut self,
        name: impl Into<String>,
        world_from_frame: &RigidTransform,
        z: f64,
        [radius_m, inner_radius_m]: [f64; 2],
        texture: Texture,
    ) {
        let frame_from_local = local_frame(Vector3::new(0.0, 0.0, z), Vector3::x(), -Vector3::y());
        let shape = Shape::Disc {
            radius_m,
            inner_radius_m,
        };
        self.push(
            name.into(),
            *world_from_frame * frame_from_local,
            shape,
            texture,
        );
    }

    /// A disc that faces down at the frame's origin.
    pub(super) fn underside(
        &mut self,
        name: &str,
        world_from_frame: &RigidTransform,
        radius_m: f64,
        texture: Texture,
    ) {
        let frame_from_local = local_frame(Vector3::zeros(), Vector3::x(), Vector3::y());
        let shape = Shape::Disc {
            radius_m,
            inner_radius_m: 0.0,
        };
        self.push(
            format!("{name} underside"),
            *world_from_frame * frame_from_local,
            shape,
            texture,
        );
    }

    /// A ball whose lowest point is the frame's origin.
    pub(super) fn ball(
        &mut self,
        name: &str,
        world_from_ball: &RigidTransform,
        radius_m: f64,
        texture: Texture,
    ) {
        self.begin_body();
        let frame_from_local = local_frame(
            Vector3::new(0.0, 0.0, radius_m),
            Vector3::x(),
            -Vector3::z(),
        );
        self.push(
            name.to_owned(),
            *world_from_ball * frame_from_local,
            Shape::Sphere { radius_m },
            texture,
        );
        self.solids.push(Solid {
            solid_from_world: world_from_ball.inverse(),
            shape: SolidShape::Ball(radius_m),
        });
    }

    /// Lights the scene and closes the description.
    pub(super) fn finish(
        mut self,
        lighting: &Lighting,
        edge_m: f64,
        waypoints_m: Vec<[[f64; 3]; 2]>,
    ) -> Scene {
        light::bake(&mut self.surfaces, lighting);
        Scene {
            surfaces: self.surfaces,
            solids: self.solids,
            edge_m,
            waypoints_m,
        }
    }
}

/// The surface frame with its origin at `corner`, x right, y down, z into the body.
fn local_frame(corner: Vector3<f64>, right: Vector3<f64>, down: Vector3<f64>) -> RigidTransform {
    let columns = Matrix3::from_columns(&[right, down, right.cross(&down)]);
    let rotation = Rotation3::from_matrix_unchecked(columns);
    RigidTransform::from_parts(UnitQuaternion::from_rotation_matrix(&rotation), corner)
}

/// A frame at `position_m`, z up, turned by `yaw_rad` around z.
pub(super) fn standing(position_m: [f64; 3], yaw_rad: f64) -> RigidTransform {
    RigidTransform::from_parts(
        UnitQuaternion::from_axis_angle(&Vector3::z_axis(), yaw_rad),
        position_m.into(),
    )
}

/// A frame at `position_m` turned by `yaw_rad` around z, then pitched by `pitch_rad` around its
/// own x.
pub(super) fn tilted(position_m: [f64; 3], yaw_rad: f64, pitch_rad: f64) -> RigidTransform {
    standing(position_m, yaw_rad)
        * RigidTransform::from_parts(
            UnitQuaternion::from_axis_angle(&Vector3::x_axis(), pitch_rad),
            Vector3::zeros(),
        )
}
