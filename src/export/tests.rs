//! What the writers promise, checked by parsing their bytes.

use nalgebra::Point3;
use proptest::prelude::*;

use super::*;
use crate::atlas::{ChartId, PlacedChart, TexelRect, TexturePage};

/// Two unit squares meeting at a right angle, one per page; the shared edge is a seam.
pub(super) fn two_pages() -> (TriMesh, AtlasLayout, AtlasTexture) {
    let positions = [
        [0.0, 0.0, 0.0],
        [1.0, 0.0, 0.0],
        [1.0, 1.0, 0.0],
        [0.0, 1.0, 0.0],
        [1.0, 0.0, 1.0],
        [1.0, 1.0, 1.0],
    ];
    let positions = positions.map(|[x, y, z]| Point3::new(x, y, z)).to_vec();
    let triangles = vec![[0, 1, 2], [0, 2, 3], [1, 4, 5], [1, 5, 2]];
    let (mesh, _) = TriMesh::from_soup(positions, triangles).unwrap();
    let lower = [[2.0, 14.0], [14.0, 14.0], [14.0, 2.0]];
    let upper = [[2.0, 14.0], [14.0, 2.0], [2.0, 2.0]];
    let chart = |page, triangles: [u32; 2]| {
        PlacedChart::whole_rect(
            page,
            TexelRect {
                x: 0,
                y: 0,
                width: 16,
                height: 16,
            },
            12.0,
            triangles.map(TriangleId).to_vec(),
        )
    };
    let layout = AtlasLayout {
        page_size_texel: [16, 16],
        num_pages: 2,
        texels_per_m: 12.0,
        charts: vec![chart(0, [0, 1]), chart(1, [2, 3])],
        chart_of_triangle: [0, 0, 1, 1].map(ChartId).to_vec(),
        corners_texel: vec![lower, upper, lower, upper],
    };
    let page = |srgb| {
        let mut page = TexturePage::blank(16, 16);
        page.srgb.fill(srgb);
        page
    };
    let texture = AtlasTexture::from_iter([page([200, 10, 10]), page([10, 10, 200])]);
    (mesh, layout, texture)
}

fn glb_json(glb: &[u8]) -> serde_json::Value {
    assert_eq!(&glb[..4], b"glTF");
    let word = |at: usize| u32::from_le_bytes(glb[at..at + 4].try_into().unwrap()) as usize;
    assert_eq!(word(8), glb.len());
    serde_json::from_slice(&glb[20..20 + word(12)]).unwrap()
}

fn glb_of(textured: &TexturedMesh<'_>, normals: NormalMode) -> Vec<u8> {
    let pages = EncodedPages::encode(textured.texture(), PageFormat::Png).unwrap();
    let mut out = Vec::new();
    glb::write(textured, &pages, "scan", normals, &mut out).unwrap();
    out
}

#[test]
fn glb_has_a_primitive_and_an_image_per_page() {
    let (mesh, layout, texture) = two_pages();
    let textured = TexturedMesh::new(&mesh, &layout, &texture).unwrap();
    let json = glb_json(&glb_of(&textured, NormalMode::Smooth));
    assert_eq!(json["meshes"][0]["primitives"].as_array().unwrap().len(), 2);
    assert_eq!(json["images"].as_array().unwrap().len(), 2);
    assert_eq!(json["accessors"][1]["count"], 4);
    assert_eq!(
        json["accessors"][5]["min"],
        serde_json::json!([1.0, 0.0, 0.0])
    );
    assert_eq!(
        json["accessors"][5]["max"],
        serde_json::json!([1.0, 1.0, 1.0])
    );
    let flat = glb_json(&glb_of(&textured, NormalMode::Flat));
    assert_eq!(flat["accessors"][1]["count"], 6);
}

#[test]
fn far_meshes_keep_their_detail() {
    let (mesh, layout, texture) = two_pages();
    let far: Vec<Point3<f64>> = mesh
        .positions_m()
        .iter()
        .map(|p| Point3::new(p.x + 448_000.0, p.y + 5_411_000.25, p.z))
        .collect();
    let (mesh, _) = TriMesh::from_soup(far, mesh.triangles().to_vec()).unwrap();
    let textured = TexturedMesh::new(&mesh, &layout, &texture).unwrap();
    let json = glb_json(&glb_of(&textured, NormalMode::Smooth));
    let translation: Vec<f64> =
        serde_json::from_value(json["nodes"][1]["translation"].clone()).unwrap();
    for axis in 0..3 {
        let min = json["accessors"][1]["min"][axis].as_f64().unwrap() + translation[axis];
        let expected = [448_000.0, 5_411_000.25, 0.0][axis];
        assert!((min - expected).abs() < 1e-6, "axis {axis}: {min}");
    }
    let mut ply = Vec::new();
    ply::write(&textured, &mut ply).unwrap();
    let header = String::from_utf8_lossy(&ply[..300]).into_owned();
    assert!(header.contains("property double x"), "{header}");
}

#[test]
fn a_mesh_without_triangles_is_still_a_file() {
    let mesh = TriMesh::default();
    let layout = AtlasLayout {
        page_size_texel: [16, 16],
        num_pages: 0,
        texels_per_m: 1.0,
        charts: vec![],
        chart_of_triangle: vec![],
        corners_texel: vec![],
    };
    let texture = AtlasTexture::default();
    let textured = TexturedMesh::new(&mesh, &layout, &texture).unwrap();
    let json = glb_json(&glb_of(&textured, NormalMode::Smooth));
    assert!(json.get("meshes").is_none());
}

#[test]
fn obj_flips_v_and_keeps_order() {
    let (mesh, layout, texture) = two_pages();
    let textured = TexturedMesh::new(&mesh, &layout, &texture).unwrap();
    let mut out = Vec::new();
    obj::write(&textured, "scan.mtl", &mut out).unwrap();
    let text = String::from_utf8(out).unwrap();
    let lines = |prefix: &str| text.lines().filter(|l| l.starts_with(prefix)).count();
    assert_eq!((lines("v "), lines("vt "), lines("f ")), (6, 8, 4));
    // Vertex 0 is at texel (2, 14) of 16.
    assert!(text.contains("\nvt 0.1250000 0.1250000\n"), "{text}");
    assert!(text.contains("usemtl page_1\nf 2/"), "{text}");
}

#[test]
fn ply_has_the_size_its_header_says() {
    let (mesh, layout, texture) = two_pages();
    let textured = TexturedMesh::new(&mesh, &layout, &texture).unwrap();
    let mut out = Vec::new();
    ply::write(&textured, &mut out).unwrap();
    let end = b"end_header\n";
    let header = out.windows(end.len()).position(|w| w == end).unwrap() + end.len();
    assert_eq!(out.len() - header, 6 * 15 + 4 * 42);
    // Vertex 1 has one red corner and two blue ones, vertex 2 the reverse. In linear light the
    // sRGB bytes 200 and 10 are 0.5776 and 0.0030; a third and two thirds of them mix to
    // 0.1946 and 0.3861, which are 122 and 167.
    let colors = ply::vertex_srgb(&textured);
    assert_eq!(colors[0], [200, 10, 10]);
    assert_eq!(colors[1], [122, 10, 167]);
    assert_eq!(colors[2], [167, 10, 122]);
}

#[test]
fn what_does_not_belong_together_is_refused() {
    let (mesh, layout, texture) = two_pages();
    let refuse = |layout: &AtlasLayout, texture: &AtlasTexture| {
        TexturedMesh::new(&mesh, layout, texture)
            .unwrap_err()
            .to_string()
    };
    let mut short = layout.clone();
    short.corners_texel.pop();
    assert!(refuse(&short, &texture).contains("asks for 4, there are 3"));
    let mut dangling = layout.clone();
    dangling.chart_of_triangle[2] = ChartId(9);
    assert!(refuse(&dangling, &texture).contains("triangle 2 lies on chart 9"));
    let mut outside = layout.clone();
    outside.corners_texel[3][1] = [f32::NAN, 1.0];
    assert!(refuse(&outside, &texture).contains("triangle 3"));
    let mut fewer = texture.clone();
    fewer.pages.pop();
    assert!(refuse(&layout, &fewer).contains("texture pages"));
}

#[test]
fn all_files_are_written_and_repeat_for_any_thread_count() {
    let (mesh, layout, texture) = two_pages();
    let textured = TexturedMesh::new(&mesh, &layout, &texture).unwrap();
    let run = |num_threads| {
        let folder = tempfile::tempdir().unwrap();
        let pool = rayon::ThreadPoolBuilder::new()
            .num_threads(num_threads)
            .build()
            .unwrap();
        let params = ExportParams {
            glb_pages: PageFormat::Jpeg { quality: 90 },
            ..ExportParams::default()
        };
        let summary = pool
            .install(|| write_all(&textured, &folder.path().join("out"), &params))
            .unwrap();
        let read = |file: &PathBuf| std::fs::read(folder.path().join("out").join(file)).unwrap();
        let bytes: Vec<Vec<u8>> = summary.files.iter().map(read).collect();
        (summary.files, bytes)
    };
    let (files, bytes) = run(1);
    assert_eq!(files.len(), 4 + 2 + 5);
    assert_eq!((files, bytes), run(4));
}

#[test]
fn an_unwritable_folder_is_one_clear_error() {
    let (mesh, layout, texture) = two_pages();
    let textured = TexturedMesh::new(&mesh, &layout, &texture).unwrap();
    let folder = tempfile::tempdir().unwrap();
    let blocker = folder.path().join("file");
    std::fs::write(&blocker, b"").unwrap();
    let error = write_all(&textured, &blocker.join("out"), &ExportParams::default()).unwrap_err();
    assert!(error.to_string().contains("file/out"), "{error}");
}

proptest! {
    #[test]
    fn splitting_loses_nothing(
        triangles in prop::collection::vec([0..7u32, 0..7, 0..7], 1..40),
        corners in prop::collection::vec(prop::array::uniform2(0..4u8), 120),
        pages in prop::collection::vec(0..3u32, 40),
    ) {
        let positions = (0..7).map(|i| Point3::new(f64::from(i), 0.0, 0.0)).collect();
        let num_triangles = triangles.len();
        let (mesh, _) = TriMesh::from_soup(positions, triangles).unwrap();
        let corner = |i: usize| corners[i].map(|c| f32::from(c) * 4.0);
        let layout = AtlasLayout {
            page_size_texel: [16, 16],
            num_pages: 3,
            texels_per_m: 1.0,
            charts: (0..3)
                .map(|page| PlacedChart::whole_rect(page, TexelRect { x: 0, y: 0, width: 16, height: 16 }, 12.0, vec![]))
                .collect(),
            chart_of_triangle: pages[..num_triangles].iter().map(|&p| ChartId(p)).collect(),
            corners_texel: (0..num_triangles)
                .map(|t| [corner(3 * t), corner(3 * t + 1), corner(3 * t + 2)])
                .collect(),
        };
        let texture = AtlasTexture::from_iter(vec![TexturePage::blank(16, 16); 3]);
        let textured = TexturedMesh::new(&mesh, &layout, &texture).unwrap();
        let parts = split::split_by_page(&textured, split::Sharing::ByUv);
        let mut seen = 0;
        for (page, part) in (0..).zip(&parts) {
            let mut keys: Vec<_> = part
                .vertex
                .iter()
                .zip(&part.uv)
                .map(|(&v, uv)| (v, uv.map(f32::to_bits)))
                .collect();
            keys.dedup();
            prop_assert_eq!(keys.len(), part.vertex.len());
            for (corners, &triangle) in part.triangles.iter().zip(&part.triangle_ids) {
                prop_assert_eq!(layout.page_of(triangle), page);
                let vertices = corners.map(|c| part.vertex[c as usize]);
                prop_assert_eq!(vertices, mesh.triangles()[triangle.index()]);
                let uvs = corners.map(|c| part.uv[c as usize]);
                prop_assert_eq!(uvs, textured.corners_uv(triangle));
                seen += 1;
            }
        }
        prop_assert_eq!(seen, num_triangles);
    }
}
