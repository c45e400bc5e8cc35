//! Every encoding against its definition; broken files and wrong sizes are refused.

use super::*;

fn raw(
    encoding: ColorEncoding,
    size: [u32; 2],
    step: u32,
    bytes: &[u8],
) -> Result<Vec<[u8; 3]>, ImageError> {
    let image = EncodedColor::from_raw(encoding, size[0], size[1], step, bytes.into())?;
    Ok(image.decode()?.pixels().to_vec())
}

#[test]
fn channel_orders_and_row_padding() {
    let rgb = [[1, 2, 3], [4, 5, 6]];
    let cases: [(ColorEncoding, &[u8]); 4] = [
        (ColorEncoding::Rgb8, &[1, 2, 3, 99, 4, 5, 6, 99]),
        (ColorEncoding::Bgr8, &[3, 2, 1, 99, 6, 5, 4, 99]),
        (ColorEncoding::Rgba8, &[1, 2, 3, 77, 4, 5, 6, 77]),
        (ColorEncoding::Bgra8, &[3, 2, 1, 77, 6, 5, 4, 77]),
    ];
    for (encoding, bytes) in cases {
        assert_eq!(
            raw(encoding, [1, 2], 4, bytes).unwrap(),
            rgb,
            "{encoding:?}"
        );
    }
    // The last row may lack its padding.
    let unpadded = [1, 2, 3, 99, 4, 5, 6];
    assert_eq!(raw(ColorEncoding::Rgb8, [1, 2], 4, &unpadded).unwrap(), rgb);
    assert_eq!(
        raw(ColorEncoding::Mono8, [2, 1], 2, &[9, 8]).unwrap(),
        [[9; 3], [8; 3]]
    );
}

/// References from OpenCV 4's `cvtColor` formula evaluated in floating point.
#[test]
fn yuv_is_bt601_limited_range() {
    let reference = |y: f64, u: f64, v: f64| -> [f64; 3] {
        let y = 1.164 * (y - 16.0).max(0.0);
        [
            y + 1.596 * (v - 128.0),
            y - 0.813 * (v - 128.0) - 0.391 * (u - 128.0),
            y + 2.018 * (u - 128.0),
        ]
        .map(|c| c.clamp(0.0, 255.0))
    };
    for [y0, u, y1, v] in [[16, 128, 235, 128], [81, 90, 145, 240], [0, 255, 255, 0]] {
        let yuy2 = raw(ColorEncoding::Yuv422Yuy2, [2, 1], 4, &[y0, u, y1, v]).unwrap();
        let nv12 = raw(ColorEncoding::Nv12, [2, 2], 2, &[y0, y1, y0, y1, u, v]).unwrap();
        assert_eq!(nv12, [yuy2[0], yuy2[1], yuy2[0], yuy2[1]]);
        for (y, pixel) in [y0, y1].into_iter().zip(yuy2) {
            let expected = reference(f64::from(y), f64::from(u), f64::from(v));
            for c in 0..3 {
                assert!((f64::from(pixel[c]) - expected[c]).abs() < 1.0);
            }
        }
    }
}

#[test]
fn refuses_what_does_not_fit() {
    let rgb8 = ColorEncoding::Rgb8;
    assert!(matches!(
        raw(rgb8, [0, 1], 3, &[]),
        Err(ImageError::Size { .. })
    ));
    assert!(matches!(
        raw(rgb8, [1, 1], 2, &[0; 2]),
        Err(ImageError::Row { .. })
    ));
    assert!(matches!(
        raw(rgb8, [1, 2], 3, &[0; 5]),
        Err(ImageError::Length { .. })
    ));
    assert!(matches!(
        raw(rgb8, [1, 2], 3, &[0; 7]),
        Err(ImageError::Length { .. })
    ));
    assert!(matches!(
        raw(ColorEncoding::Nv12, [3, 2], 3, &[0; 9]),
        Err(ImageError::Size { .. })
    ));
    assert!(matches!(
        raw(rgb8, [u32::MAX, u32::MAX], u32::MAX, &[0; 7]),
        Err(ImageError::Size { .. })
    ));
    assert!(matches!(
        raw(ColorEncoding::Jpeg, [1, 1], 3, &[0; 3]),
        Err(ImageError::Encoding(_))
    ));
    assert!(EncodedColor::from_file((*b"BM").into()).is_err());
}

fn gradient() -> ColorImage {
    let pixels = (0..48u32 * 32).map(|i| {
        let (x, y) = (i % 48, i / 48);
        [x * 5, y * 7, (x + y) * 3].map(|c| u8::try_from(c).unwrap())
    });
    ColorImage::new(48, 32, pixels.collect()).unwrap()
}

#[test]
fn lossless_compression_keeps_every_pixel() {
    let image = gradient();
    let bytes = image.pixels().as_flattened().into();
    let raw = EncodedColor::from_raw(ColorEncoding::Rgb8, 48, 32, 144, bytes).unwrap();
    let png = raw.compressed_lossless().unwrap();
    assert_eq!(png.encoding(), ColorEncoding::Png);
    assert_eq!(png.decode().unwrap(), image);
    assert_eq!(png.compressed_lossless().unwrap(), png);

    let rgb = image.pixels();
    let padded: Vec<u8> = rgb
        .chunks(48)
        .flat_map(|row| [row.as_flattened(), &[7; 5]].concat())
        .collect();
    let bgr: Vec<u8> = rgb.iter().flat_map(|&[r, g, b]| [b, g, r]).collect();
    for (encoding, row_bytes, bytes) in [
        (ColorEncoding::Rgb8, 149, padded),
        (ColorEncoding::Bgr8, 144, bgr),
    ] {
        let raw = EncodedColor::from_raw(encoding, 48, 32, row_bytes, bytes.into()).unwrap();
        assert_eq!(raw.compressed_lossless().unwrap(), png);
    }
}

fn jpeg(image: &ColorImage) -> Vec<u8> {
    let mut bytes = Vec::new();
    let width = u16::try_from(image.width()).unwrap();
    let height = u16::try_from(image.height()).unwrap();
    jpeg_encoder::Encoder::new(&mut bytes, 95)
        .encode(
            image.pixels().as_flattened(),
            width,
            height,
            jpeg_encoder::ColorType::Rgb,
        )
        .unwrap();
    bytes
}

#[test]
fn jpeg_decodes_and_a_cut_one_is_refused() {
    let image = gradient();
    let bytes = jpeg(&image);
    let decoded = EncodedColor::from_file(bytes.as_slice().into())
        .unwrap()
        .decode()
        .unwrap();
    for (a, b) in image.pixels().iter().zip(decoded.pixels()) {
        assert!(
            a.iter().zip(b).all(|(a, b)| a.abs_diff(*b) < 24),
            "{a:?} {b:?}"
        );
    }
    for length in 0..bytes.len() - 1 {
        assert!(
            EncodedColor::from_file(bytes[..length].into()).is_err(),
            "{length}"
        );
    }
}

#[test]
fn a_cut_or_corrupt_png_is_refused_never_a_panic() {
    let png = EncodedColor::png_from_image(&gradient()).unwrap();
    for length in 0..png.bytes().len() {
        assert!(EncodedColor::from_file(png.bytes()[..length].into()).is_err());
    }
    for at in 0..png.bytes().len() {
        let mut bytes = png.bytes().to_vec();
        bytes[at] ^= 0x55;
        if let Ok(image) = EncodedColor::from_file(bytes.into()) {
            // Decoding may fail or succeed; either way the process lives.
            drop(image.decode());
        }
    }
}

#[test]
fn depth_in_every_encoding() {
    let mm = [0u16, 1, 500, 1000, 40_000, 65_535];
    let metres = [0.0f32, 0.001, 0.5, 1.0, 40.0, 65.535];
    let depths = |image: EncodedDepth| image.decode().unwrap().depths_m().to_vec();
    for big_endian in [false, true] {
        let order = |mm: &u16| {
            if big_endian {
                mm.to_be_bytes()
            } else {
                mm.to_le_bytes()
            }
        };
        // 3 × 2 with two bytes of row padding.
        let rows = mm.chunks(3).flat_map(|row| {
            let pixels = row.iter().flat_map(order);
            pixels.chain([9, 9]).collect::<Vec<u8>>()
        });
        let bytes: Vec<u8> = rows.collect();
        let encoding = DepthEncoding::U16Mm { big_endian };
        let raw = EncodedDepth::from_raw(encoding, 3, 2, 8, bytes.into()).unwrap();
        let rvl = raw.compressed_lossless().unwrap();
        assert_eq!(rvl.encoding(), DepthEncoding::RvlMm);
        assert_eq!(depths(raw), metres);
        assert_eq!(depths(rvl), metres);
        let floats = [0.5f32, f32::NAN, -1.0];
        let order = |m: &f32| {
            if big_endian {
                m.to_be_bytes()
            } else {
                m.to_le_bytes()
            }
        };
        let bytes: Vec<u8> = floats.iter().flat_map(order).collect();
        let encoding = DepthEncoding::F32M { big_endian };
        let raw = EncodedDepth::from_raw(encoding, 3, 1, 12, bytes.into()).unwrap();
        assert_eq!(depths(raw), [0.5, 0.0, 0.0]);
    }
    assert_eq!(
        depths(EncodedDepth::png_from_u16_mm(3, 2, &mm).unwrap()),
        metres
    );
}

/// `compressed_depth_image_transport`: A = z0 (z0 + 1), B = 1 − A / max, q = A / z + B.
#[test]
fn inverse_depth_follows_the_transport() {
    let (z0, max_m) = (100.0f32, 10.0f32);
    let a = z0 * (z0 + 1.0);
    let b = 1.0 - a / max_m;
    let depths_m = [0.0f32, 0.4, 1.0, 3.0, 9.0];
    #[expect(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "quantises as the transport does"
    )]
    let quantised = depths_m.map(|z| if z > 0.0 { (a / z + b) as u16 } else { 0 });
    let png = EncodedDepth::png_from_u16_mm(5, 1, &quantised).unwrap();
    let rvl = EncodedDepth::rvl_from_u16_mm(5, 1, &quantised).unwrap();
    for (encoding, bytes) in [
        (DepthEncoding::Png16Inverse { a, b }, png.bytes()),
        (DepthEncoding::RvlInverse { a, b }, rvl.bytes()),
    ] {
        let decoded = EncodedDepth::from_compressed(encoding, bytes.clone()).unwrap();
        for (&z, back) in depths_m.iter().zip(decoded.decode().unwrap().depths_m()) {
            // One quantisation step: dz = z² / A.
            assert!((z - back).abs() <= z * z / a * 1.01, "{z} {back}");
        }
    }
}
