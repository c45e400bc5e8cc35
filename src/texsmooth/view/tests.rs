//! A slanted square before two cameras, against the renderer and closed forms.

use nalgebra::{UnitQuaternion, Vector3};

use super::*;
use crate::atlas::{AtlasTexture, ChartId, PlacedChart, TexelRect, TexelSource, TexturePage};
use crate::render::raster::{RasterWorkspace, ViewBuffer, rasterize};
use crate::render::textured::{RenderParams, render_textured};
use crate::texsmooth::texels::to_byte;

const SLOPE: f64 = 0.4;

fn square() -> (TriMesh, AtlasLayout, AtlasTexture) {
    let corners = [[-0.5, -0.5], [0.5, -0.5], [0.5, 0.5], [-0.5, 0.5]];
    let positions = corners
        .map(|[x, y]| Point3::new(x, y, 2.0 + SLOPE * x))
        .to_vec();
    let (mesh, _) = TriMesh::from_soup(positions, vec![[0, 1, 2], [0, 2, 3]]).unwrap();
    let corners_texel = mesh
        .triangle_ids()
        .map(|t| {
            let texel = |v: f64| ((v + 0.5) * 100.0 + 2.0) as f32;
            mesh.corners_m(t).map(|p| [texel(p.x), texel(p.y)])
        })
        .collect();
    let rect = TexelRect {
        x: 0,
        y: 0,
        width: 104,
        height: 104,
    };
    let layout = AtlasLayout {
        page_size_texel: [104, 104],
        num_pages: 1,
        texels_per_m: 100.0,
        charts: vec![PlacedChart::whole_rect(
            0,
            rect,
            100.0,
            mesh.triangle_ids().collect(),
        )],
        chart_of_triangle: vec![ChartId(0); 2],
        corners_texel,
    };
    let mut page = TexturePage::blank(104, 104);
    for (index, texel) in page.srgb.iter_mut().enumerate() {
        *texel = [(2 * (index % 104)) as u8, (2 * (index / 104)) as u8, 9];
    }
    page.source.fill(TexelSource::keyframe(0));
    (mesh, layout, AtlasTexture::from_iter([page]))
}

fn camera() -> PinholeCamera {
    PinholeCamera::new([100.0, 100.0, 31.5, 23.5], 64, 48).unwrap()
}

fn view(mesh: &TriMesh, camera_from_world: RigidTransform) -> View {
    let mut buffer = ViewBuffer::default();
    let mut workspace = RasterWorkspace::default();
    rasterize(
        mesh,
        &camera(),
        &camera_from_world,
        &mut workspace,
        &mut buffer,
    );
    View {
        camera: camera(),
        camera_from_world,
        triangle: buffer.triangle,
        num_changing_in_row: Vec::new(),
    }
}

const WHOLE: PixelRect = PixelRect {
    x: 0,
    y: 0,
    width: 64,
    height: 48,
};

#[test]
fn a_crop_is_the_rendering_s() {
    let (mesh, layout, texture) = square();
    let texels = Texels::from_texture(&texture).unwrap();
    let pose = RigidTransform::from_parts(
        UnitQuaternion::from_euler_angles(0.1, -0.05, 0.2),
        Vector3::new(0.05, -0.02, 0.1),
    );
    let view = view(&mesh, pose);
    let params = RenderParams { supersampling: 1 };
    let expected = render_textured(&mesh, &layout, &texture, &camera(), &pose, &params).unwrap();
    let on = Surface {
        mesh: &mesh,
        layout: &layout,
        texture: &texture,
        may_change: None,
    };
    let rect = PixelRect {
        x: 5,
        y: 3,
        width: 50,
        height: 40,
    };
    let found = view.surface(on, &texels, rect, 1, [0.0; 2]);
    let mut render = vec![0.0; 3 * rect.num_pixels()];
    texels.gather(&texture, &found.footprint, &mut render);
    let mut num_seen = 0;
    for i in 0..rect.num_pixels() {
        let (x, y) = (rect.x + i % rect.width, rect.y + i / rect.width);
        let at = y * 64 + x;
        assert_eq!(found.footprint[i].is_some(), expected.mask[at], "{x} {y}");
        if expected.mask[at] {
            let pixel = [0, 1, 2].map(|c| to_byte(render[c * rect.num_pixels() + i]));
            let near = |(a, b): (&u8, &u8)| a.abs_diff(*b) <= 1;
            let truth = expected.color.pixels()[at];
            assert!(pixel.iter().zip(&truth).all(near), "{pixel:?} {truth:?}");
            num_seen += 1;
        }
    }
    assert!(num_seen > 900, "{num_seen}");
}

#[test]
fn an_offset_shows_the_surface_beside_the_pixel() {
    let (mesh, layout, texture) = square();
    let texels = Texels::from_texture(&texture).unwrap();
    let view = view(&mesh, RigidTransform::identity());
    let on = Surface {
        mesh: &mesh,
        layout: &layout,
        texture: &texture,
        may_change: None,
    };
    let offset_px = [2.3f32, -1.6];
    let found = view.surface(on, &texels, WHOLE, 1, offset_px);
    let mut num_seen = 0;
    for (i, point) in found.point_in_camera.iter().enumerate() {
        if point[0].is_nan() {
            continue;
        }
        let x = [
            (i % 64) as f64 - f64::from(offset_px[0]),
            (i / 64) as f64 - f64::from(offset_px[1]),
        ];
        let ray = camera().ray(x[0], x[1]);
        let depth_m = 2.0 / (1.0 - SLOPE * ray.x);
        let outline = (ray.x * depth_m).abs().max((ray.y * depth_m).abs()) - 0.5;
        if outline > -0.02 {
            continue;
        }
        for (found, expected) in point
            .iter()
            .zip([ray.x * depth_m, ray.y * depth_m, depth_m])
        {
            assert!((f64::from(*found) - expected).abs() < 1e-6, "pixel {i}");
        }
        num_seen += 1;
    }
    assert!(num_seen > 900, "{num_seen}");
}

#[test]
fn another_camera_sees_points_where_they_are_and_not_what_is_hidden() {
    let (mesh, layout, texture) = square();
    let texels = Texels::from_texture(&texture).unwrap();
    let on = Surface {
        mesh: &mesh,
        layout: &layout,
        texture: &texture,
        may_change: None,
    };
    let first = view(&mesh, RigidTransform::identity());
    let pose = RigidTransform::from_parts(
        UnitQuaternion::from_euler_angles(0.02, 0.1, -0.1),
        Vector3::new(-0.1, 0.05, 0.0),
    );
    let other = view(&mesh, pose);
    let surface = first.surface(on, &texels, WHOLE, 1, [0.0; 2]);
    let found = other.project_from(&first, &mesh, &surface.point_in_camera, 0.05);
    let mut num_common = 0;
    for (point, found) in surface.point_in_camera.iter().zip(&found) {
        let Some(found) = found else { continue };
        let expected = camera()
            .project(&pose.transform_point(&Point3::from(point.map(f64::from))))
            .unwrap();
        for (found, expected) in found.iter().zip(expected) {
            assert!((f64::from(*found) - expected).abs() < 1e-3);
        }
        num_common += 1;
    }
    assert!(num_common > 500, "{num_common}");

    // A wall before the other camera hides it all: depths differ by more than is allowed.
    let mut positions = mesh.positions_m().to_vec();
    let mut triangles = mesh.triangles().to_vec();
    positions.extend([[-9.0, -9.0], [9.0, -9.0], [0.0, 9.0]].map(|[x, y]| Point3::new(x, y, 1.0)));
    triangles.push([4, 5, 6]);
    let (walled, _) = TriMesh::from_soup(positions, triangles).unwrap();
    let blocked = view(&walled, RigidTransform::identity());
    let found = blocked.project_from(&first, &walled, &surface.point_in_camera, 0.05);
    assert!(found.iter().all(Option::is_none));
}

#[test]
fn a_pixel_covers_as_many_texels_as_the_jacobian_says() {
    let (mesh, mut layout, texture) = square();
    // Flattened without distortion: the slope is unrolled.
    for (corners, triangle) in layout.corners_texel.iter_mut().zip(mesh.triangle_ids()) {
        for (texel, point) in corners.iter_mut().zip(mesh.corners_m(triangle)) {
            let along = point.x * 1.0f64.hypot(SLOPE);
            *texel = [along, point.y].map(|m| (m * 100.0 + 50.0) as f32);
        }
    }
    let texels = Texels::from_texture(&texture).unwrap();
    let view = view(&mesh, RigidTransform::identity());
    let on = Surface {
        mesh: &mesh,
        layout: &layout,
        texture: &texture,
        may_change: None,
    };
    let found = view.surface(on, &texels, WHOLE, 1, [0.0; 2]);
    let place = |x: f64, y: f64| {
        let ray = camera().ray(x, y);
        let depth_m = 2.0 / (1.0 - SLOPE * ray.x);
        [ray.x * depth_m * 1.0f64.hypot(SLOPE), ray.y * depth_m].map(|m| m * 100.0)
    };
    let mut num_seen = 0;
    for (i, &covered) in found.texels_per_px.iter().enumerate() {
        if found.point_in_camera[i][0].is_nan() {
            assert_eq!(covered, 0.0);
            continue;
        }
        let (x, y) = ((i % 64) as f64, (i / 64) as f64);
        let columns = [
            [place(x + 0.5, y), place(x - 0.5, y)],
            [place(x, y + 0.5), place(x, y - 0.5)],
        ]
        .map(|[after, before]| nalgebra::Vector2::new(after[0] - before[0], after[1] - before[1]));
        let largest = nalgebra::Matrix2::from_columns(&columns).singular_values()[0];
        // Off the axis a pixel is a little narrower than z/f.
        let ratio = f64::from(covered) / largest;
        assert!(
            (0.93..1.07).contains(&ratio),
            "pixel {i}: {covered} {largest}"
        );
        num_seen += 1;
    }
    assert!(num_seen > 900, "{num_seen}");
}
