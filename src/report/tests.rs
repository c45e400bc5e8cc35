//! The report on a small made-up run.

use nalgebra::Point3;

use super::*;
use crate::atlas::{
    AtlasLayout, AtlasTexture, ChartId, PlacedChart, TexelRect, TexelSource, TexturePage,
};
use crate::mesh::{TriMesh, TriangleId};

fn square() -> (TriMesh, AtlasLayout, AtlasTexture) {
    let positions = [[0.0, 0.0], [2.0, 0.0], [2.0, 1.0], [0.0, 1.0]];
    let positions = positions.map(|[x, y]| Point3::new(x, y, 0.0)).to_vec();
    let (mesh, _) = TriMesh::from_soup(positions, vec![[0, 1, 2], [0, 2, 3]]).unwrap();
    let layout = AtlasLayout {
        page_size_texel: [32, 16],
        num_pages: 1,
        texels_per_m: 8.0,
        charts: vec![PlacedChart::whole_rect(
            0,
            TexelRect {
                x: 0,
                y: 0,
                width: 20,
                height: 12,
            },
            100.0,
            vec![TriangleId(0), TriangleId(1)],
        )],
        chart_of_triangle: vec![ChartId(0); 2],
        corners_texel: vec![
            [[2.0, 10.0], [18.0, 10.0], [18.0, 2.0]],
            [[2.0, 10.0], [18.0, 2.0], [2.0, 2.0]],
        ],
    };
    let mut page = TexturePage::blank(32, 16);
    for y in 0..12 {
        for x in 0..20 {
            let i = y * 32 + x;
            page.srgb[i] = [100, 150, 200];
            page.confidence[i] = 51;
            page.source[i] = match x {
                _ if !(2..18).contains(&x) || !(2..10).contains(&y) => TexelSource::GUTTER,
                2..10 => TexelSource::keyframe(0),
                10..14 => TexelSource::keyframe(1),
                14..16 => TexelSource::MEAN,
                _ => TexelSource::DIFFUSED,
            };
        }
    }
    (mesh, layout, AtlasTexture::from_iter([page]))
}

fn view() -> ReportView {
    let image = |srgb| ColorImage::new(16, 12, vec![srgb; 192]).unwrap();
    ReportView {
        name: "frame <7> & \"more\"".to_owned(),
        stamp: Stamp::from_nanos(7),
        held_out: true,
        photo: image([100, 150, 200]),
        render: image([100, 150, 210]),
        mask: (0..192).map(|i| i % 16 < 12).collect(),
        triangle: (0..192)
            .map(|i| if i % 16 < 12 { 1 } else { u32::MAX })
            .collect(),
    }
}

fn report() -> Report {
    Report {
        title: "<script>alert(1)</script>".to_owned(),
        keyframes: (0..2)
            .map(|id| KeyframeRow {
                id,
                position_m: [0.5 + f64::from(id), 0.5, 1.0],
                direction: [0.0, 0.0, -1.0],
                ..KeyframeRow::default()
            })
            .collect(),
        stages: vec![Stage {
            name: "texinit".to_owned(),
            seconds: 1.5,
        }],
        total_s: 2.0,
        mesh: MeshSummary {
            repairs: [("edges <found>", 3), ("a fault of none", 0)]
                .map(|(found, count)| Repair {
                    found: found.to_owned(),
                    count,
                    done: "cut".to_owned(),
                })
                .to_vec(),
            ..MeshSummary::default()
        },
        parameters: serde_json::json!({"texinit": {"mode": "streaming"}}),
        ..Report::default()
    }
}

#[test]
fn measures_what_was_painted() {
    let (mesh, layout, texture) = square();
    let textured = TexturedMesh::new(&mesh, &layout, &texture).unwrap();
    let mut report = report();
    report.measure(&textured, &[view()]).unwrap();
    let coverage = &report.coverage;
    assert_eq!(coverage.num_texels, 16 * 8);
    assert_eq!(
        [
            coverage.keyframe_share,
            coverage.mean_share,
            coverage.diffused_share
        ],
        [0.75, 0.125, 0.125]
    );
    assert_eq!(coverage.mean_confidence, 0.2);
    assert_eq!(coverage.unpainted_area_share, 0.0);
    assert_eq!(report.atlas.used_share, 0.25);
    assert_eq!(report.atlas.gutter_share, (240.0 - 128.0) / 512.0);
    assert_eq!(report.atlas.footprint_share, 240.0 / 512.0);
    // Two triangles of 64 texels on a square metre each.
    assert_eq!(report.atlas.texels_per_m2_by_triangle, [64.0; 2]);
    assert_eq!(report.atlas.texels_per_m2_by_area, [64.0; 2]);
    assert_eq!(report.atlas.subtexel_share, 0.0);
    assert_eq!(
        (report.mesh.area_m2, report.mesh.size_m),
        (2.0, [2.0, 1.0, 0.0])
    );
    let texels: Vec<u64> = report.keyframes.iter().map(|k| k.num_texels).collect();
    assert_eq!(texels, [64, 32]);
    let score = &report.views[0];
    // One channel of three is off by 10: 10 log10(255² · 3 / 100).
    assert!((score.psnr_db.unwrap() - 32.902_016_155_876).abs() < 1e-9);
    assert_eq!(score.covered_share, 0.75);
    assert!(report.notes.is_empty(), "{:?}", report.notes);
}

#[test]
fn what_is_wrong_is_said() {
    let (mesh, layout, mut texture) = square();
    for source in &mut texture.pages[0].to_mut().source {
        *source = TexelSource::NONE;
    }
    let textured = TexturedMesh::new(&mesh, &layout, &texture).unwrap();
    let mut report = report();
    report
        .source
        .losses
        .push("the last 3 MB are damaged".to_owned());
    report.measure(&textured, &[]).unwrap();
    assert_eq!(report.coverage.unpainted_area_share, 1.0);
    let texts: Vec<&str> = report.notes.iter().map(|n| n.text.as_str()).collect();
    assert!(texts[0].starts_with("No texel was painted"), "{texts:?}");
    assert_eq!(texts[1], "the last 3 MB are damaged");
}

#[test]
fn the_page_is_one_file_and_text_stays_text() {
    let (mesh, layout, texture) = square();
    let textured = TexturedMesh::new(&mesh, &layout, &texture).unwrap();
    let mut report = report();
    report.measure(&textured, &[view()]).unwrap();
    let folder = tempfile::tempdir().unwrap();
    let files = write(&report, Some(&textured), &[view()], folder.path()).unwrap();
    assert_eq!(files, [PathBuf::from(JSON_NAME), PathBuf::from(HTML_NAME)]);
    let html = std::fs::read_to_string(folder.path().join(HTML_NAME)).unwrap();
    assert!(!html.contains("<script") && html.contains("&lt;script&gt;"));
    assert!(html.contains("frame &lt;7&gt; &amp; &quot;more&quot;"));
    assert!(!html.contains("http://") && !html.contains("https://"));
    let num_outside = html.matches("src=\"").count() - html.matches("src=\"data:").count();
    assert_eq!(num_outside, 0);
    assert_eq!(html.matches("href=\"").count(), 1);
    assert!(html.contains("texinit.mode"));
    let json: serde_json::Value =
        serde_json::from_slice(&std::fs::read(folder.path().join(JSON_NAME)).unwrap()).unwrap();
    assert_eq!(json["coverage"]["num_texels"], 128);
    assert_eq!(json["mesh"]["repairs"][0]["count"], 3);
    assert_eq!(json["mesh"]["repairs"][1]["found"], "a fault of none");
    assert!(html.contains("edges &lt;found&gt;") && !html.contains("a fault of none"));
}

#[test]
fn a_run_that_ended_early_still_has_a_report() {
    let folder = tempfile::tempdir().unwrap();
    write(&Report::default(), None, &[], folder.path()).unwrap();
    let (mesh, texture) = (TriMesh::default(), AtlasTexture::default());
    let layout = AtlasLayout {
        page_size_texel: [1, 1],
        num_pages: 0,
        texels_per_m: 1.0,
        charts: vec![],
        chart_of_triangle: vec![],
        corners_texel: vec![],
    };
    let textured = TexturedMesh::new(&mesh, &layout, &texture).unwrap();
    let mut report = report();
    report.measure(&textured, &[]).unwrap();
    write(&report, Some(&textured), &[], folder.path()).unwrap();
}

#[test]
fn views_that_do_not_fit_are_refused() {
    let mut bad = view();
    bad.mask.pop();
    let folder = tempfile::tempdir().unwrap();
    let error = write(&Report::default(), None, &[bad], folder.path()).unwrap_err();
    assert!(error.to_string().contains("191 mask values"), "{error}");
}

#[test]
fn charts_and_coverage_are_drawn_where_they_lie() {
    let (mesh, layout, texture) = square();
    let textured = TexturedMesh::new(&mesh, &layout, &texture).unwrap();
    let charts = page_pictures::charts(&textured, 0, 16).unwrap();
    assert_eq!((charts.width(), charts.height()), (16, 8));
    assert_eq!(charts.pixel_clamped(4, 3), colors::of_chart(0));
    assert_eq!(charts.pixel_clamped(12, 3), colors::BACKGROUND);
    let coverage = page_pictures::coverage(&texture.pages[0], 32).unwrap();
    assert_eq!(coverage.pixel_clamped(5, 5), colors::KEYFRAME);
    assert_eq!(coverage.pixel_clamped(15, 5), colors::MEAN);
    assert_eq!(coverage.pixel_clamped(17, 5), colors::DIFFUSED);
    assert_eq!(coverage.pixel_clamped(0, 0), colors::GUTTER);
    assert_eq!(coverage.pixel_clamped(31, 15), colors::BACKGROUND);
}

#[test]
fn downscaling_averages_light() {
    let checker = (0..64)
        .map(|i| [if (i + i / 8) % 2 == 0 { 255 } else { 0 }; 3])
        .collect();
    let image = ColorImage::new(8, 8, checker).unwrap();
    let small = pictures::downscale(&image, 4);
    // Half of all light is sRGB 188.
    assert!(small.pixels().iter().all(|p| *p == [188; 3]));
    assert_eq!(pictures::fitted_size(4096, 1, 100), [100, 1]);
}

#[test]
fn density_is_weighted_by_area() {
    let positions = [[0.0, 0.0], [1.0, 0.0], [0.0, 2.0], [10.0, 0.0], [0.0, 20.0]];
    let positions = positions.map(|[x, y]| Point3::new(x, y, 0.0)).to_vec();
    let triangles = vec![[0, 1, 2], [0, 3, 4], [0, 1, 2]];
    let (mesh, _) = TriMesh::from_soup(positions, triangles).unwrap();
    let density = DensitySummary::from_best_views(&mesh, &[50.0, 200.0, f32::NAN]).unwrap();
    assert_eq!(density.p10_px_per_m, 200.0);
    assert_eq!(density.p50_px_per_m, 200.0);
    assert_eq!(DensitySummary::from_best_views(&mesh, &[0.0; 3]), None);
}
