//! The meshes of the corpus, each made by a formula: what scanners get wrong, what topology allows,
//! and what numbers can hold.

use std::f64::consts::TAU;

use nalgebra::{Point3, Vector3};

/// Triangles as they come: positions of any kind, indices in range.
#[derive(Clone, Debug, Default)]
pub(crate) struct Soup {
    pub(crate) positions: Vec<Point3<f64>>,
    pub(crate) triangles: Vec<[u32; 3]>,
}

/// Numbers in 0..1 (Knuth's linear congruential generator).
struct Random(u64);

impl Random {
    fn next(&mut self) -> f64 {
        self.0 = self
            .0
            .wrapping_mul(6_364_136_223_846_793_005)
            .wrapping_add(1_442_695_040_888_963_407);
        (self.0 >> 40) as f64 / f64::from(1 << 24)
    }

    fn below(&mut self, end: usize) -> u32 {
        (self.next() * end as f64) as u32
    }

    fn signed(&mut self) -> f64 {
        2.0 * self.next() - 1.0
    }

    fn point(&mut self) -> Point3<f64> {
        Point3::new(self.signed(), self.signed(), self.signed())
    }
}

impl Soup {
    fn add_vertex(&mut self, at: Point3<f64>) -> u32 {
        self.positions.push(at);
        self.positions.len() as u32 - 1
    }

    fn add_corners(&mut self, corners: [Point3<f64>; 3]) {
        let triangle = corners.map(|p| self.add_vertex(p));
        self.triangles.push(triangle);
    }

    /// Two triangles per cell of a grid of vertices; `at` says where the vertices are.
    fn add_grid(&mut self, [columns, rows]: [u32; 2], at: impl Fn(u32, u32) -> Point3<f64>) {
        let first = self.positions.len() as u32;
        for j in 0..=rows {
            self.positions.extend((0..=columns).map(|i| at(i, j)));
        }
        for (i, j) in (0..rows).flat_map(|j| (0..columns).map(move |i| (i, j))) {
            let corner = |di, dj| first + (j + dj) * (columns + 1) + i + di;
            self.triangles
                .push([corner(0, 0), corner(1, 0), corner(1, 1)]);
            self.triangles
                .push([corner(0, 0), corner(1, 1), corner(0, 1)]);
        }
    }

    /// Each triangle in four; edges' middles at the middle of their ends, moved by `onto`.
    fn subdivided(self, onto: impl Fn(Point3<f64>) -> Point3<f64>) -> Self {
        let mut middles = std::collections::BTreeMap::new();
        let mut finer = Self {
            positions: self.positions,
            triangles: Vec::new(),
        };
        for [a, b, c] in self.triangles {
            let [ab, bc, ca] = [(a, b), (b, c), (c, a)].map(|(p, q)| {
                *middles.entry((p.min(q), p.max(q))).or_insert_with(|| {
                    let ends = [p, q].map(|v| finer.positions[v as usize]);
                    finer.add_vertex(onto(nalgebra::center(&ends[0], &ends[1])))
                })
            });
            finer
                .triangles
                .extend([[a, ab, ca], [ab, b, bc], [ca, bc, c], [ab, bc, ca]]);
        }
        finer
    }

    fn mapped(mut self, to: impl Fn(Point3<f64>) -> Point3<f64>) -> Self {
        for p in &mut self.positions {
            *p = to(*p);
        }
        self
    }

    fn joined(mut self, other: Self) -> Self {
        let first = self.positions.len() as u32;
        self.positions.extend(other.positions);
        let moved = other.triangles.iter().map(|t| t.map(|v| v + first));
        self.triangles.extend(moved);
        self
    }
}

fn sheet(cells: [u32; 2], height_m: impl Fn(f64, f64) -> f64) -> Soup {
    let mut soup = Soup::default();
    soup.add_grid(cells, |i, j| {
        let [x, y] = [i, j].map(|k| 0.1 * f64::from(k));
        Point3::new(x, y, height_m(x, y))
    });
    soup
}

fn rolling_sheet() -> Soup {
    sheet([24, 24], |x, y| 0.2 * (3.0 * x).sin() * (2.0 * y).cos())
}

fn icosahedron() -> Soup {
    let long = 0.5 * (1.0 + 5.0_f64.sqrt());
    let mut positions = Vec::new();
    for (a, b) in [(1.0, long), (-1.0, long), (1.0, -long), (-1.0, -long)] {
        positions.extend([[0.0, a, b], [a, b, 0.0], [b, 0.0, a]].map(Point3::from));
    }
    // The faces of a convex body: three corners that are all at one edge's length.
    let near = |p: usize, q: usize| (positions[p] - positions[q]).norm() < 2.1;
    let mut triangles = Vec::new();
    for a in 0..12 {
        for b in a + 1..12 {
            for c in b + 1..12 {
                if near(a, b) && near(b, c) && near(c, a) {
                    let [p, q, r] = [a, b, c].map(|v| positions[v].coords);
                    let is_outward = (q - p).cross(&(r - p)).dot(&p) > 0.0;
                    let [b, c] = if is_outward { [b, c] } else { [c, b] };
                    triangles.push([a, b, c].map(|v| v as u32));
                }
            }
        }
    }
    Soup {
        positions,
        triangles,
    }
}

fn icosphere(num_subdivisions: usize) -> Soup {
    let onto = |p: Point3<f64>| Point3::from(p.coords.normalize());
    let unit = icosahedron().mapped(onto);
    (0..num_subdivisions).fold(unit, |soup, _| soup.subdivided(onto))
}

/// The faces of a set of unit cubes that touch no other cube of it, two triangles each.
fn cubes_surface(size: [i32; 3], is_full: impl Fn([i32; 3]) -> bool) -> Soup {
    let full = |c: [i32; 3]| (0..3).all(|k| (0..size[k]).contains(&c[k])) && is_full(c);
    let mut soup = Soup::default();
    let mut vertices = std::collections::BTreeMap::new();
    for x in 0..size[0] {
        for y in 0..size[1] {
            for z in 0..size[2] {
                let cell = [x, y, z];
                if !full(cell) {
                    continue;
                }
                for (axis, step) in (0..3).flat_map(|axis| [(axis, 0), (axis, 1)]) {
                    let mut beside = cell;
                    beside[axis] += 2 * step - 1;
                    if full(beside) {
                        continue;
                    }
                    let quad = [[0, 0], [1, 0], [1, 1], [0, 1]].map(|[u, v]| {
                        let mut corner = cell;
                        corner[axis] += step;
                        corner[(axis + 1) % 3] += u;
                        corner[(axis + 2) % 3] += v;
                        *vertices.entry(corner).or_insert_with(|| {
                            soup.add_vertex(Point3::from(corner.map(|c| 0.1 * f64::from(c))))
                        })
                    });
                    let [a, b, c, d] = quad;
                    if step == 1 {
                        soup.triangles.extend([[a, b, c], [a, c, d]]);
                    } else {
                        soup.triangles.extend([[a, c, b], [a, d, c]]);
                    }
                }
            }
        }
    }
    soup
}

pub(crate) fn empty() -> Soup {
    Soup::default()
}

pub(crate) fn vertices_alone() -> Soup {
    let mut random = Random(1);
    Soup {
        positions: (0..100).map(|_| random.point()).collect(),
        triangles: Vec::new(),
    }
}

pub(crate) fn isolated_vertices() -> Soup {
    let mut random = Random(2);
    let mut soup = rolling_sheet();
    soup.positions.extend((0..500).map(|_| random.point()));
    soup
}

pub(crate) fn vertices_not_finite() -> Soup {
    let mut soup = rolling_sheet();
    let bad = [f64::NAN, f64::INFINITY, f64::NEG_INFINITY];
    for (k, p) in soup.positions.iter_mut().enumerate().step_by(17) {
        p[k % 3] = bad[k / 17 % 3];
    }
    soup
}

/// Ever thinner rows, down to a billionth of their length.
pub(crate) fn slivers() -> Soup {
    let mut soup = Soup::default();
    soup.add_grid([8, 30], |i, j| {
        Point3::new(0.3 * f64::from(i), 1.0 - 0.5_f64.powi(j as i32), 0.0)
    });
    soup
}

/// Triangles a metre long and a micrometre wide, in all directions.
pub(crate) fn needles() -> Soup {
    let mut random = Random(3);
    let mut soup = Soup::default();
    for _ in 0..500 {
        let at = random.point();
        let along = random.point().coords.normalize();
        let beside = at + 1e-6 * random.point().coords;
        soup.add_corners([at, beside, at + along]);
    }
    soup
}

/// Pages on one edge, three to eight.
pub(crate) fn books() -> Soup {
    let mut soup = Soup::default();
    for num_pages in 3..=8u32 {
        let foot = Point3::new(f64::from(num_pages) * 3.0, 0.0, 0.0);
        let spine: Vec<u32> = (0..6)
            .map(|k| soup.add_vertex(foot + Vector3::z() * (0.2 * f64::from(k))))
            .collect();
        for page in 0..num_pages {
            let angle = f64::from(page) / f64::from(num_pages) * TAU;
            let out = Vector3::new(angle.cos(), angle.sin(), 0.0);
            let edge: Vec<u32> = (0..6)
                .map(|k| soup.add_vertex(foot + out + Vector3::z() * (0.2 * f64::from(k))))
                .collect();
            for k in 0..5 {
                soup.triangles.push([spine[k], edge[k], edge[k + 1]]);
                soup.triangles.push([spine[k], edge[k + 1], spine[k + 1]]);
            }
        }
    }
    soup
}

/// A strip whose ends meet upside down, vertices shared.
pub(crate) fn moebius_strip() -> Soup {
    let mut soup = Soup::default();
    let (num_around, num_across) = (60u32, 5u32);
    for i in 0..num_around {
        let angle = f64::from(i) / f64::from(num_around) * TAU;
        let out = Vector3::new(angle.cos(), angle.sin(), 0.0);
        let side = out * (0.5 * angle).cos() + Vector3::z() * (0.5 * angle).sin();
        soup.positions.extend((0..num_across).map(|j| {
            Point3::from(out + side * (0.1 * (f64::from(j) - 0.5 * f64::from(num_across - 1))))
        }));
    }
    let vertex = |i: u32, j: u32| {
        if i < num_around {
            i * num_across + j
        } else {
            num_across - 1 - j
        }
    };
    for (i, j) in (0..num_around).flat_map(|i| (0..num_across - 1).map(move |j| (i, j))) {
        let [a, b, c, d] = [(0, 0), (1, 0), (1, 1), (0, 1)].map(|(di, dj)| vertex(i + di, j + dj));
        soup.triangles.extend([[a, b, c], [a, c, d]]);
    }
    soup
}

/// The figure-eight immersion; closed, with one side.
pub(crate) fn klein_bottle() -> Soup {
    let mut soup = Soup::default();
    let (num_u, num_v) = (48u32, 24u32);
    for (i, j) in (0..num_u).flat_map(|i| (0..num_v).map(move |j| (i, j))) {
        let u = f64::from(i) / f64::from(num_u) * TAU;
        // Half a step off: no vertex lies where the surface runs through itself.
        let v = (f64::from(j) + 0.5) / f64::from(num_v) * TAU;
        let radius = 2.0 + (0.5 * u).cos() * v.sin() - (0.5 * u).sin() * (2.0 * v).sin();
        let height = (0.5 * u).sin() * v.sin() + (0.5 * u).cos() * (2.0 * v).sin();
        soup.add_vertex(Point3::new(radius * u.cos(), radius * u.sin(), height));
    }
    let vertex = |i: u32, j: u32| {
        if i < num_u {
            i * num_v + j % num_v
        } else {
            // Once around, v has become −v.
            num_v - 1 - j % num_v
        }
    };
    for (i, j) in (0..num_u).flat_map(|i| (0..num_v).map(move |j| (i, j))) {
        let [a, b, c, d] = [(0, 0), (1, 0), (1, 1), (0, 1)].map(|(di, dj)| vertex(i + di, j + dj));
        soup.triangles.extend([[a, b, c], [a, c, d]]);
    }
    soup
}

/// The six-vertex triangulation (any two vertices share an edge) at six places of space, thrice
/// subdivided.
pub(crate) fn projective_plane() -> Soup {
    let mut random = Random(4);
    let coarse = Soup {
        positions: (0..6).map(|_| random.point()).collect(),
        triangles: vec![
            [0, 1, 2],
            [0, 2, 3],
            [0, 3, 4],
            [0, 4, 5],
            [0, 5, 1],
            [1, 2, 4],
            [2, 3, 5],
            [3, 4, 1],
            [4, 5, 2],
            [5, 1, 3],
        ],
    };
    (0..3).fold(coarse, |soup, _| soup.subdivided(|p| p))
}

/// Steiner's Roman surface: the projective plane with three double lines, where vertices of two
/// sheets coincide.
pub(crate) fn roman_surface() -> Soup {
    let octahedron = Soup {
        positions: [
            [1, 0, 0],
            [0, 1, 0],
            [0, 0, 1],
            [-1, 0, 0],
            [0, -1, 0],
            [0, 0, -1],
        ]
        .map(|p| Point3::from(p.map(f64::from)))
        .to_vec(),
        triangles: (0..8u32)
            .map(|signs| [0, 1, 2].map(|axis| axis + 3 * (signs >> axis & 1)))
            .collect(),
    };
    let onto = |p: Point3<f64>| Point3::from(p.coords.normalize());
    let mut sphere = (0..4).fold(octahedron, |soup, _| soup.subdivided(onto));
    let is_first_half = |t: &[u32; 3]| {
        let sum: Vector3<f64> = t.iter().map(|&v| sphere.positions[v as usize].coords).sum();
        sum.iter()
            .find(|c| c.abs() > 1e-9)
            .is_some_and(|c| *c > 0.0)
    };
    let half: Vec<_> = sphere
        .triangles
        .iter()
        .copied()
        .filter(is_first_half)
        .collect();
    sphere.triangles = half;
    sphere.mapped(|p| Point3::new(p.y * p.z, p.z * p.x, p.x * p.y))
}

/// Cones tip to tip, and a chain of squares that meet at corners.
pub(crate) fn hourglasses() -> Soup {
    let mut soup = Soup::default();
    for k in 0..10 {
        let tip = soup.add_vertex(Point3::new(3.0 * f64::from(k), 0.0, 0.0));
        for end in [-1.0, 1.0] {
            let rim: Vec<u32> = (0..24)
                .map(|i| {
                    let angle = f64::from(i) / 24.0 * TAU;
                    let out = Vector3::new(angle.cos(), angle.sin(), end);
                    soup.add_vertex(soup.positions[tip as usize] + out)
                })
                .collect();
            for i in 0..24 {
                soup.triangles.push([tip, rim[i], rim[(i + 1) % 24]]);
            }
        }
    }
    let mut corner = soup.add_vertex(Point3::new(0.0, 4.0, 0.0));
    for k in 0..50 {
        let foot = Point3::new(f64::from(k), 4.0 + f64::from(k), 0.0);
        let [b, c, d] = [[1.0, 0.0], [1.0, 1.0], [0.0, 1.0]]
            .map(|[x, y]| soup.add_vertex(foot + Vector3::new(x, y, 0.0)));
        soup.triangles.extend([[corner, b, c], [corner, c, d]]);
        corner = c;
    }
    soup
}

fn fan(num_triangles: u32, at: impl Fn(f64) -> Point3<f64>) -> Soup {
    let mut soup = Soup::default();
    let hub = soup.add_vertex(Point3::origin());
    let rim: Vec<u32> = (0..num_triangles)
        .map(|k| soup.add_vertex(at(f64::from(k) / f64::from(num_triangles))))
        .collect();
    for (k, &start) in rim.iter().enumerate() {
        soup.triangles.push([hub, start, rim[(k + 1) % rim.len()]]);
    }
    soup
}

/// Thousands of triangles round one vertex of a plane.
pub(crate) fn flat_fan() -> Soup {
    fan(4000, |share| {
        let angle = share * TAU;
        Point3::new(angle.cos(), angle.sin(), 0.0)
    })
}

/// The same round a vertex with several times a full turn of surface.
pub(crate) fn ruffled_fan() -> Soup {
    fan(4000, |share| {
        let angle = share * TAU;
        Point3::new(angle.cos(), angle.sin(), 1.5 * (20.0 * angle).sin())
    })
}

/// Every triangle thrice, and again turned over, and copies of copies slightly larger around it.
pub(crate) fn duplicates() -> Soup {
    let mut soup = rolling_sheet();
    let original = soup.triangles.clone();
    soup.triangles.extend_from_slice(&original);
    soup.triangles.extend_from_slice(&original);
    let opposite = original.iter().step_by(2).map(|[a, b, c]| [*a, *c, *b]);
    soup.triangles.extend(opposite);
    let base = [[0.0, 0.0], [0.3, 0.0], [0.0, 0.3]];
    for k in 0..200 {
        let size = 1.0 + 0.01 * f64::from(k);
        soup.add_corners(base.map(|[x, y]| Point3::new(5.0 + size * x, size * y, 0.0)));
    }
    soup
}

pub(crate) fn opposite_faces() -> Soup {
    let mut soup = sheet([30, 30], |x, _| 0.1 * (4.0 * x).sin());
    let opposite: Vec<_> = soup
        .triangles
        .iter()
        .map(|[a, b, c]| [*a, *c, *b])
        .collect();
    soup.triangles.extend(opposite);
    soup
}

/// Everything at one place, under different vertices.
pub(crate) fn all_at_one_point() -> Soup {
    let mut soup = rolling_sheet();
    for p in &mut soup.positions {
        *p = Point3::new(0.3, 0.2, 0.1);
    }
    soup
}

pub(crate) fn all_on_one_line() -> Soup {
    rolling_sheet().mapped(|p| Point3::new(p.x + 0.37 * p.y, 0.0, 0.0))
}

pub(crate) fn vertices_named_twice() -> Soup {
    let mut soup = rolling_sheet();
    for (k, triangle) in soup.triangles.iter_mut().enumerate().step_by(5) {
        triangle[k % 3] = triangle[(k + 1) % 3];
    }
    soup
}

/// A small sphere and sheet, a thousand kilometres from the origin.
pub(crate) fn far_from_the_origin() -> Soup {
    let far = Vector3::new(1e6, -1e6, 1e6);
    let sphere = icosphere(3).mapped(|p| Point3::from(0.2 * p.coords + far));
    sphere.joined(rolling_sheet().mapped(|p| Point3::from(0.1 * p.coords + far)))
}

/// So far that corners of a triangle fall onto few representable places.
pub(crate) fn beyond_precision() -> Soup {
    icosphere(3).mapped(|p| Point3::from(p.coords + Vector3::repeat(1e15)))
}

pub(crate) fn micrometres() -> Soup {
    let sphere = icosphere(3).mapped(|p| Point3::from(1e-5 * p.coords));
    sphere.joined(rolling_sheet().mapped(|p| Point3::from(1e-5 * p.coords)))
}

/// One surface whose triangles measure from a micrometre to a kilometre.
pub(crate) fn mixed_scales() -> Soup {
    let mut soup = Soup::default();
    soup.add_grid([90, 24], |i, j| {
        let radius = 10f64.powf(-6.0 + 0.1 * f64::from(i));
        let angle = f64::from(j) / 24.0 * 1.5;
        Point3::new(radius * angle.cos(), radius * angle.sin(), 0.1 * radius)
    });
    soup
}

/// Near the ends of what numbers hold: squares of these lengths overflow or vanish.
pub(crate) fn astronomic() -> Soup {
    let sizes = [1e-320, 1e-200, 1e-100, 1e60, 1e155, 1e300];
    sizes.iter().fold(Soup::default(), |soup, size| {
        soup.joined(rolling_sheet().mapped(|p| Point3::from(*size * p.coords)))
    })
}

/// Charts of 1e15 m, each as large as a page whatever the density, but for densities next to none.
pub(crate) fn wrong_unit() -> Soup {
    let mut random = Random(10);
    let mut soup = Soup {
        positions: vec![
            Point3::new(-7e14, 0.0, 0.0),
            Point3::new(0.0, 0.0, -5e11),
            Point3::new(0.0, 1e15, 0.0),
        ],
        triangles: Vec::new(),
    };
    soup.positions.extend((0..8).map(|_| random.point()));
    soup.triangles
        .extend((0..200).map(|_| [0; 3].map(|_| random.below(11))));
    soup
}

pub(crate) fn components_of_one_face() -> Soup {
    let mut random = Random(5);
    let mut soup = Soup::default();
    for _ in 0..3000 {
        let at = 5.0 * random.point().coords;
        let corners = [0; 3].map(|_| Point3::from(at + 0.1 * random.point().coords));
        soup.add_corners(corners);
    }
    soup
}

pub(crate) fn sphere() -> Soup {
    icosphere(4)
}

pub(crate) fn torus() -> Soup {
    let mut soup = Soup::default();
    soup.add_grid([48, 24], |i, j| {
        let around = f64::from(i % 48) / 48.0 * TAU;
        let tube = f64::from(j % 24) / 24.0 * TAU;
        let radius = 1.0 + 0.4 * tube.cos();
        Point3::new(
            radius * around.cos(),
            radius * around.sin(),
            0.4 * tube.sin(),
        )
    });
    soup
}

/// A slab with two holes through it.
pub(crate) fn genus_two() -> Soup {
    cubes_surface([11, 5, 3], |[x, y, _]| {
        !((2..4).contains(&y) && [2, 3, 7, 8].contains(&x))
    })
}

/// Nearly flat, so one chart, over itself forty times.
pub(crate) fn spiral_ramp() -> Soup {
    let mut soup = Soup::default();
    soup.add_grid([40 * 40, 3], |i, j| {
        let angle = f64::from(i) / 40.0 * TAU;
        let radius = 1.5 - 0.2 * f64::from(j);
        Point3::new(radius * angle.cos(), radius * angle.sin(), 0.02 * angle)
    });
    soup
}

/// Paper pressed into a ball: no fold lies flat, sheets run through each other.
pub(crate) fn crumpled_paper() -> Soup {
    let mut random = Random(6);
    sheet([40, 40], |_, _| 0.0)
        .mapped(|p| {
            let bend = Vector3::new(
                (9.0 * p.y).sin(),
                (7.0 * p.x).cos(),
                (11.0 * (p.x + p.y)).sin(),
            );
            Point3::from(0.4 * bend + 0.1 * p.coords)
        })
        .joined(Soup {
            positions: vec![random.point()],
            triangles: Vec::new(),
        })
}

/// A strip folded back onto itself exactly, so that layers coincide vertex by vertex.
pub(crate) fn folded_flat() -> Soup {
    let mut soup = Soup::default();
    soup.add_grid([240, 4], |i, j| {
        let phase = i % 24;
        Point3::new(
            0.1 * f64::from(phase.min(24 - phase)),
            0.1 * f64::from(j),
            0.0,
        )
    });
    soup
}

pub(crate) fn random_soup() -> Soup {
    let mut random = Random(7);
    let mut soup = Soup {
        positions: (0..600).map(|_| random.point()).collect(),
        triangles: Vec::new(),
    };
    let corner = |random: &mut Random| random.below(600);
    soup.triangles
        .extend((0..2000).map(|_| [0; 3].map(|_| corner(&mut random))));
    soup
}

/// All triangles of some twenty vertices: every edge has eighteen faces.
pub(crate) fn complete_complex() -> Soup {
    let mut random = Random(8);
    let num = 20u32;
    let mut soup = Soup {
        positions: (0..num).map(|_| random.point()).collect(),
        triangles: Vec::new(),
    };
    for a in 0..num {
        for b in a + 1..num {
            soup.triangles.extend((b + 1..num).map(|c| [a, b, c]));
        }
    }
    soup
}

/// A random half of the cubes of a block: edges of four faces and vertices of many fans all over,
/// every ninth face twice, every eleventh turned over.
pub(crate) fn tangled_block() -> Soup {
    let mut random = Random(9);
    let is_full: Vec<bool> = (0..19 * 19 * 19).map(|_| random.next() < 0.5).collect();
    let mut soup = cubes_surface([19, 19, 19], |[x, y, z]| {
        is_full[((x * 19 + y) * 19 + z) as usize]
    });
    let copies: Vec<_> = soup.triangles.iter().copied().step_by(9).collect();
    soup.triangles.extend(copies);
    for triangle in soup.triangles.iter_mut().step_by(11) {
        triangle.swap(1, 2);
    }
    soup
}
