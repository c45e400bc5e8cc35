//! Nearest hit of any ray against the scene: a bounding volume hierarchy with median splits.

use nalgebra::{Matrix3, Point3, Vector3};

use super::surface::{Hit, Shape, Surface};

/// The hierarchy over the surfaces of one scene.
#[derive(Clone, Debug, Default)]
pub(super) struct Bvh {
    nodes: Vec<Node>,
    /// Surface indices; leaves name ranges of it.
    order: Vec<u32>,
    /// In the order of `order`.
    primitives: Vec<Primitive>,
}

#[derive(Clone, Debug)]
struct Primitive {
    shape: Shape,
    local_from_world: Matrix3<f64>,
    world_in_local: Vector3<f64>,
}

#[derive(Clone, Debug)]
struct Node {
    low: Point3<f64>,
    high: Point3<f64>,
    content: Content,
}

#[derive(Clone, Debug)]
enum Content {
    Leaf { start: usize, end: usize },
    Children([usize; 2]),
}

const LEAF_SIZE: usize = 3;
/// Median splits halve: 2³² surfaces would need 32 levels, and each level keeps one node waiting.
const MAX_DEPTH: usize = 48;

impl Bvh {
    pub(super) fn new(surfaces: &[Surface]) -> Self {
        let bounds: Vec<[Point3<f64>; 2]> = surfaces.iter().map(Surface::world_bounds).collect();
        let mut bvh = Self {
            nodes: Vec::new(),
            order: (0..).take(surfaces.len()).collect(),
            primitives: Vec::new(),
        };
        if !surfaces.is_empty() {
            bvh.build(&bounds, 0, surfaces.len());
        }
        let primitive = |&index: &u32| {
            let surface = &surfaces[index as usize];
            let local_from_world = surface.world_from_local.inverse();
            Primitive {
                shape: surface.shape,
                local_from_world: local_from_world
                    .rotation()
                    .to_rotation_matrix()
                    .into_inner(),
                world_in_local: *local_from_world.translation(),
            }
        };
        bvh.primitives = bvh.order.iter().map(primitive).collect();
        bvh
    }

    fn build(&mut self, bounds: &[[Point3<f64>; 2]], start: usize, end: usize) -> usize {
        let boxes = |order: &[u32]| {
            let mut low = Point3::from(Vector3::repeat(f64::INFINITY));
            let mut high = Point3::from(Vector3::repeat(f64::NEG_INFINITY));
            for &index in order {
                low = low.inf(&bounds[index as usize][0]);
                high = high.sup(&bounds[index as usize][1]);
            }
            (low, high)
        };
        let (low, high) = boxes(&self.order[start..end]);
        let id = self.nodes.len();
        self.nodes.push(Node {
            low,
            high,
            content: Content::Leaf { start, end },
        });
        if end - start > LEAF_SIZE {
            let axis = (high - low).imax();
            let centre = |&index: &u32| {
                let [low, high] = bounds[index as usize];
                low[axis] + high[axis]
            };
            self.order[start..end].sort_by(|a, b| centre(a).total_cmp(&centre(b)).then(a.cmp(b)));
            let middle = usize::midpoint(start, end);
            let left = self.build(bounds, start, middle);
            let right = self.build(bounds, middle, end);
            self.nodes[id].content = Content::Children([left, right]);
        }
        id
    }

    /// Nearest front-facing hit with the ray parameter in (`t_min`, `t_max`), and its surface.
    pub(super) fn nearest_hit(
        &self,
        origin: &Point3<f64>,
        direction: &Vector3<f64>,
        [t_min, t_max]: [f64; 2],
    ) -> Option<(usize, Hit)> {
        let inverse = direction.map(|d| 1.0 / d);
        let mut best: Option<(usize, Hit)> = None;
        let mut t_end = t_max;
        let mut stack = [0usize; MAX_DEPTH];
        let mut num_waiting = usize::from(!self.nodes.is_empty());
        while num_waiting > 0 {
            num_waiting -= 1;
            let node = &self.nodes[stack[num_waiting]];
            if !node.is_crossed(origin, &inverse, t_end) {
                continue;
            }
            match node.content {
                Content::Children(children) => {
                    for child in children {
                        stack[num_waiting] = child;
                        num_waiting += 1;
                    }
                }
                Content::Leaf { start, end } => {
                    for at in start..end {
                        let primitive = &self.primitives[at];
                        let local_origin =
                            primitive.local_from_world * origin.coords + primitive.world_in_local;
                        let local_direction = primitive.local_from_world * direction;
                        let range = [t_min, t_end];
                        let shape = &primitive.shape;
                        if let Some(hit) = shape.intersect(&local_origin, &local_direction, range) {
                            t_end = hit.t;
                            best = Some((self.order[at] as usize, hit));
                        }
                    }
                }
            }
        }
        best
    }
}

impl Node {
    fn is_crossed(&self, origin: &Point3<f64>, inverse: &Vector3<f64>, t_max: f64) -> bool {
        // Widened so that flat boxes survive rounding.
        const SLACK_M: f64 = 1e-9;
        let (mut near, mut far) = (0.0f64, t_max);
        for axis in 0..3 {
            let a = (self.low[axis] - SLACK_M - origin[axis]) * inverse[axis];
            let b = (self.high[axis] + SLACK_M - origin[axis]) * inverse[axis];
            near = near.max(a.min(b));
            far = far.min(a.max(b));
        }
        near <= far
    }
}
