//! Nearest hit of any ray against the scene: a bounding volume hierarchy with median splits.

use nalgebra::{Point3, Vector3};

use super::surface::{Hit, Surface};

/// The hierarchy over the surfaces of one scene.
#[derive(Clone, Debug, Default)]
pub(super) struct Bvh {
    nodes: Vec<Node>,
    /// Surface indices; leaves name ranges of it.
    order: Vec<u32>,
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

impl Bvh {
    pub(super) fn new(surfaces: &[Surface]) -> Self {
        let bounds: Vec<[Point3<f64>; 2]> = surfaces.iter().map(Surface::world_bounds).collect();
        let mut bvh = Self {
            nodes: Vec::new(),
            order: (0..).take(surfaces.len()).collect(),
        };
        if !surfaces.is_empty() {
            bvh.build(&bounds, 0, surfaces.len());
        }
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
        surfaces: &[Surface],
        origin: &Point3<f64>,
        direction: &Vector3<f64>,
        [t_min, t_max]: [f64; 2],
    ) -> Option<(usize, Hit)> {
        let inverse = direction.map(|d| 1.0 / d);
        let mut best: Option<(usize, Hit)> = None;
        let mut t_end = t_max;
        let mut stack = vec![0];
        while let Some(node) = stack.pop().and_then(|id: usize| self.nodes.get(id)) {
            if !node.is_crossed(origin, &inverse, t_end) {
                continue;
            }
            match node.content {
                Content::Children(children) => stack.extend(children),
                Content::Leaf { start, end } => {
                    for &index in &self.order[start..end] {
                        let surface = &surfaces[index as usize];
                        let local = surface.world_from_local.inverse();
                        let hit = surface.shape.intersect(
                            &local.transform_point(origin).coords,
                            &local.transform_vector(direction),
                            [t_min, t_end],
                        );
                        if let Some(hit) = hit {
                            t_end = hit.t;
                            best = Some((index as usize, hit));
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
