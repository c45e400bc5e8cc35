//! Scans made up of patches, each a chart in a slot of a page, that change at random.

use std::cell::RefCell;
use std::sync::Arc;

use nalgebra::{Point3, UnitQuaternion, Vector3};

use crate::atlas::{
    AtlasLayout, AtlasTexture, ChartId, PlacedChart, SharedPage, TexelRect, TexturePage,
};
use crate::geom::{CameraModel, ColorImage, EncodedColor, PinholeCamera, RigidTransform, Stamp};
use crate::keyframe::{FrameQuality, Keyframe, KeyframeId};
use crate::mesh::{TriMesh, TriangleId};
use crate::publish::Snapshot;

/// Side of a slot, texels.
const SLOT_TEXEL: u32 = 48;

#[derive(Clone, Debug)]
struct Patch {
    page: u32,
    slot: [u32; 2],
    /// Squares along a side.
    num_squares: u32,
    height_m: f64,
    seed: u64,
}

#[derive(Clone, Debug)]
pub(super) struct Scan {
    random: u64,
    patches: Vec<Patch>,
    pub(super) num_pages: u32,
    pub(super) page_size_texel: [u32; 2],
    pub(super) frame_id: String,
    /// Far from the origin, where f32 has no millimetres.
    pub(super) origin_m: f64,
    /// Pages made last: those that stay are shared from state to state, as painters do.
    pages: RefCell<Vec<SharedPage>>,
}

pub(super) struct Made {
    pub(super) frame_id: String,
    pub(super) mesh: TriMesh,
    pub(super) layout: AtlasLayout,
    pub(super) texture: AtlasTexture,
    pub(super) keyframes: Vec<Arc<Keyframe>>,
}

/// SplitMix64.
fn mixed(mut z: u64) -> u64 {
    z = z.wrapping_add(0x9e37_79b9_7f4a_7c15);
    z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    z ^ (z >> 31)
}

impl Scan {
    pub(super) fn new(seed: u64) -> Self {
        let mut scan = Self {
            random: seed,
            patches: Vec::new(),
            num_pages: 2,
            // A height that is no power of two: shares of it are rounded.
            page_size_texel: [192, 144],
            frame_id: "map".to_owned(),
            origin_m: 0.0,
            pages: RefCell::default(),
        };
        for _ in 0..6 {
            scan.add();
        }
        scan
    }

    fn draw(&mut self, below: u64) -> u64 {
        self.random = mixed(self.random);
        self.random % below
    }

    fn free_slots(&self) -> Vec<(u32, [u32; 2])> {
        let [columns, rows] = self.page_size_texel.map(|side| side / SLOT_TEXEL);
        let slots = (0..self.num_pages).flat_map(|page| {
            (0..rows).flat_map(move |y| (0..columns).map(move |x| (page, [x, y])))
        });
        slots
            .filter(|slot| !self.patches.iter().any(|p| (p.page, p.slot) == *slot))
            .collect()
    }

    pub(super) fn add(&mut self) {
        let free = self.free_slots();
        if free.is_empty() {
            return;
        }
        let chosen = self.draw(free.len() as u64) as usize;
        let (page, slot) = free[chosen];
        let patch = Patch {
            page,
            slot,
            num_squares: 1 + self.draw(9) as u32,
            height_m: self.draw(1000) as f64 * 0.001,
            seed: self.draw(u64::MAX),
        };
        let place = self.draw(self.patches.len() as u64 + 1) as usize;
        self.patches.insert(place, patch);
    }

    /// Other colours on one patch.
    pub(super) fn paint(&mut self, seed: u64) {
        let chosen = self.draw(self.patches.len().max(1) as u64) as usize;
        if let Some(patch) = self.patches.get_mut(chosen) {
            patch.seed = seed;
        }
    }

    /// A random change.
    pub(super) fn change(&mut self, seed: u64) {
        self.random ^= mixed(seed);
        for _ in 0..self.draw(4) {
            let chosen = self.draw(self.patches.len().max(1) as u64) as usize;
            match self.draw(7) {
                0 | 1 => self.add(),
                2 => drop(
                    self.patches
                        .get(chosen)
                        .is_some()
                        .then(|| self.patches.remove(chosen)),
                ),
                3 => {
                    let height_m = self.draw(1000) as f64 * 0.002;
                    if let Some(patch) = self.patches.get_mut(chosen) {
                        patch.height_m = height_m;
                    }
                }
                4 => {
                    // Chart numbers and triangle numbers all change, what is there does not.
                    self.patches.reverse();
                }
                5 => {
                    self.num_pages = 1 + self.draw(3) as u32;
                    let num_pages = self.num_pages;
                    self.patches.retain(|patch| patch.page < num_pages);
                }
                _ => {
                    let seed = self.draw(u64::MAX);
                    self.paint(seed);
                }
            }
        }
    }

    /// Pages of another size; what lies outside of them goes.
    pub(super) fn resize(&mut self) {
        let chosen = self.draw(3) as usize;
        self.page_size_texel = [[192, 144], [96, 240], [240, 96]][chosen];
        let [columns, rows] = self.page_size_texel.map(|side| side / SLOT_TEXEL);
        self.patches
            .retain(|patch| patch.slot[0] < columns && patch.slot[1] < rows);
    }

    pub(super) fn made(&self) -> Made {
        self.made_with_keyframes(3)
    }

    pub(super) fn made_with_keyframes(&self, num_keyframes: u32) -> Made {
        let [width, height] = self.page_size_texel;
        let mut positions_m = Vec::new();
        let mut triangles = Vec::new();
        let mut layout = AtlasLayout {
            page_size_texel: self.page_size_texel,
            num_pages: self.num_pages,
            texels_per_m: 100.0,
            charts: Vec::new(),
            chart_of_triangle: Vec::new(),
            corners_texel: Vec::new(),
        };
        let mut pages = vec![TexturePage::blank(width, height); self.num_pages as usize];
        for (chart, patch) in (0u32..).zip(&self.patches) {
            let [x, y] = patch.slot.map(|s| s * SLOT_TEXEL);
            let first_vertex = positions_m.len() as u32;
            let first_triangle = triangles.len() as u32;
            let n = patch.num_squares;
            let step = (SLOT_TEXEL - 5) as f32 / n as f32;
            let mut texels = Vec::new();
            for row in 0..=n {
                for column in 0..=n {
                    let bump = mixed(u64::from(row * 31 + column)) % 100;
                    positions_m.push(Point3::new(
                        self.origin_m + f64::from(chart) + f64::from(column) * 0.01,
                        f64::from(row) * 0.01,
                        patch.height_m + bump as f64 * 1e-4,
                    ));
                    let along = |start: u32, i: u32| start as f32 + 2.3 + i as f32 * step;
                    texels.push([along(x, column), along(y, row)]);
                }
            }
            for row in 0..n {
                for column in 0..n {
                    let corner = |r: u32, c: u32| (row + r) * (n + 1) + column + c;
                    let (a, b, c, d) = (corner(0, 0), corner(0, 1), corner(1, 1), corner(1, 0));
                    for corners in [[a, b, c], [a, c, d]] {
                        triangles.push(corners.map(|v| first_vertex + v));
                        layout
                            .corners_texel
                            .push(corners.map(|v| texels[v as usize]));
                        layout.chart_of_triangle.push(ChartId(chart));
                    }
                }
            }
            let rect = TexelRect {
                x,
                y,
                width: SLOT_TEXEL,
                height: SLOT_TEXEL,
            };
            layout.charts.push(PlacedChart::whole_rect(
                patch.page,
                rect,
                100.0,
                (first_triangle..triangles.len() as u32)
                    .map(TriangleId)
                    .collect(),
            ));
            let page = &mut pages[patch.page as usize];
            for row in y..y + SLOT_TEXEL {
                for column in x..x + SLOT_TEXEL {
                    let noise = mixed(patch.seed ^ u64::from(row * width + column)).to_le_bytes();
                    page.srgb[(row * width + column) as usize] = [noise[0], noise[1], noise[2]];
                }
            }
        }
        let (mesh, _) = TriMesh::from_soup(positions_m, triangles).unwrap();
        let mut before = self.pages.borrow_mut();
        let shared = pages.into_iter().enumerate().map(|(number, page)| {
            let same = before.get(number).filter(|before| ***before == page);
            same.cloned().unwrap_or_else(|| page.into())
        });
        let pages: Vec<SharedPage> = shared.collect();
        before.clone_from(&pages);
        Made {
            frame_id: self.frame_id.clone(),
            mesh,
            layout,
            texture: AtlasTexture { pages },
            keyframes: (0..num_keyframes).map(keyframe).collect(),
        }
    }
}

fn keyframe(id: u32) -> Arc<Keyframe> {
    let image = ColorImage::new(1, 1, vec![[1, 2, 3]]).unwrap();
    let pinhole = PinholeCamera::new([1.0, 1.0, 0.0, 0.0], 1, 1).unwrap();
    Arc::new(Keyframe {
        id: KeyframeId(id),
        stamp: Stamp::from_nanos(i64::from(id)),
        world_from_camera: RigidTransform::from_parts(
            UnitQuaternion::identity(),
            Vector3::new(f64::from(id), 0.0, 0.0),
        ),
        color: EncodedColor::png_from_image(&image).unwrap(),
        color_camera: CameraModel::ideal(pinhole),
        depth: None,
        quality: FrameQuality::default(),
    })
}

/// A corner in space (bits), its coordinate (bits) and page.
pub(super) type CornerBits = ([u64; 3], [u32; 2], u32);

impl Made {
    pub(super) fn snapshot(&self, revision: u64) -> Snapshot<'_> {
        Snapshot {
            stamp: Stamp::from_nanos(revision as i64 * 1_000_000),
            frame_id: &self.frame_id,
            session: 0xfeed,
            revision,
            mesh: &self.mesh,
            layout: &self.layout,
            texture: &self.texture,
            keyframes: &self.keyframes,
            chart_keys: None,
        }
    }

    /// Every triangle to the bit, in an order of its own.
    pub(super) fn triangle_bits(&self) -> Vec<[CornerBits; 3]> {
        let textured =
            crate::export::TexturedMesh::new(&self.mesh, &self.layout, &self.texture).unwrap();
        let mut bits: Vec<_> = self
            .mesh
            .triangle_ids()
            .map(|t| {
                let (corners, uvs) = (self.mesh.corners_m(t), textured.corners_uv(t));
                [0, 1, 2].map(|i| {
                    let position: [f64; 3] = corners[i].into();
                    (
                        position.map(f64::to_bits),
                        uvs[i].map(f32::to_bits),
                        self.layout.page_of(t),
                    )
                })
            })
            .collect();
        bits.sort_unstable();
        bits
    }

    pub(super) fn area_m2(&self) -> f64 {
        let areas = self.mesh.triangle_ids().map(|t| self.mesh.area_m2(t));
        areas.sum()
    }
}
