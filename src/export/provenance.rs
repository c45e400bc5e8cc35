//! Where each texel's colour came from, as images beside the atlas.
//!
//! `page_K_source.png` (16-bit grey) and `page_K_confidence.png` (8-bit grey) have the size of
//! `atlas/page_K.png`; the coding is in [`CODING`], which is written beside them.

use std::io::Write;
use std::path::{Path, PathBuf};

use crate::atlas::{AtlasTexture, TexelSource, TexturePage};

use super::pages::{png_grey8, png_grey16};
use super::{ExportError, Job, write_atomic};

/// Source value of keyframe 0; below it are the sources that are no single keyframe.
pub const FIRST_KEYFRAME_VALUE: u16 = 16;

/// Text of `provenance/README.txt`.
pub const CODING: &str = "\
Where each texel of atlas/page_K.png came from. Same size, same rows and columns.

page_K_source.png (16-bit grey)
  0       nothing: no triangle covers the texel
  1       mean: no single frame was chosen; the mean over all frames that see the point
  2       diffused: no frame sees the point; spread from painted neighbours
  3       gutter: copied from the border of its chart, for filtering and mipmaps
  4..15   not used
  k + 16  keyframe k, as numbered in report.json; 65535 stands for every k from 65519 on

page_K_confidence.png (8-bit grey)
  0 (a guess) to 255 (seen sharp, near and head-on)
";

/// The 16-bit value that stands for a source.
pub fn source_value(source: TexelSource) -> u16 {
    match source {
        TexelSource::NONE => 0,
        TexelSource::MEAN => 1,
        TexelSource::DIFFUSED => 2,
        TexelSource::GUTTER => 3,
        _ => source.as_keyframe().map_or(0, |keyframe| {
            u16::try_from(keyframe)
                .unwrap_or(u16::MAX)
                .saturating_add(FIRST_KEYFRAME_VALUE)
        }),
    }
}

/// What a reader of the images should know beyond [`CODING`].
pub(super) fn notes(texture: &AtlasTexture) -> Vec<String> {
    let first_saturated = u32::from(u16::MAX - FIRST_KEYFRAME_VALUE) + 1;
    let last = texture
        .pages
        .iter()
        .flat_map(|page| &page.source)
        .filter_map(|source| source.as_keyframe())
        .max();
    match last {
        Some(last) if last >= first_saturated => vec![format!(
            "The provenance images hold keyframe numbers below {first_saturated}; numbers up to \
             {last} are in use, and the larger ones are all written as 65535."
        )],
        _ => Vec::new(),
    }
}

pub(super) fn push_jobs<'a>(jobs: &mut Vec<Job<'a>>, texture: &'a AtlasTexture, out_dir: &'a Path) {
    let mut push =
        |name: String, encode: Box<dyn Fn() -> Result<Vec<u8>, ExportError> + Send + Sync + 'a>| {
            let path = Path::new("provenance").join(name);
            jobs.push(Box::new(move || -> Result<PathBuf, ExportError> {
                let bytes = encode()?;
                write_atomic(&out_dir.join(&path), |out: &mut dyn Write| {
                    out.write_all(&bytes)
                })?;
                Ok(path.clone())
            }));
        };
    for (index, page) in texture.pages.iter().enumerate() {
        let refused = move |reason| ExportError::Encode {
            page: index,
            width: page.width,
            height: page.height,
            format: "png",
            reason,
        };
        push(
            format!("page_{index}_source.png"),
            Box::new(move || encode_source(page).map_err(refused)),
        );
        push(
            format!("page_{index}_confidence.png"),
            Box::new(move || png_grey8(page.width, page.height, &page.confidence).map_err(refused)),
        );
    }
    push(
        "README.txt".to_owned(),
        Box::new(|| Ok(CODING.as_bytes().to_vec())),
    );
}

fn encode_source(page: &TexturePage) -> Result<Vec<u8>, String> {
    let mut bytes = Vec::with_capacity(page.source.len() * 2);
    for &source in &page.source {
        bytes.extend_from_slice(&source_value(source).to_be_bytes());
    }
    png_grey16(page.width, page.height, &bytes)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn values_are_as_the_readme_says() {
        let keyframe = |k| source_value(TexelSource::keyframe(k));
        assert_eq!(source_value(TexelSource::NONE), 0);
        assert_eq!(source_value(TexelSource::MEAN), 1);
        assert_eq!(source_value(TexelSource::DIFFUSED), 2);
        assert_eq!(source_value(TexelSource::GUTTER), 3);
        assert_eq!([keyframe(0), keyframe(219)], [16, 235]);
        assert_eq!([keyframe(65518), keyframe(65519)], [65534, 65535]);
        assert_eq!([keyframe(65520), keyframe(1 << 30)], [65535, 65535]);
    }

    #[test]
    fn saturation_is_noted() {
        let mut texture = AtlasTexture::from_iter([TexturePage::blank(2, 1)]);
        texture.pages[0].to_mut().source[0] = TexelSource::keyframe(65519);
        assert!(notes(&texture).is_empty());
        texture.pages[0].to_mut().source[1] = TexelSource::keyframe(70_000);
        assert!(notes(&texture)[0].contains("70000"));
    }
}
