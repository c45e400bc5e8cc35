//! Against the values that the `lpips` Python package gives with the same weights.

use std::sync::Arc;

use serde_json::Value;

use super::*;
use crate::geom::EncodedColor;

/// The folder with the weights; says so aloud where it is not there.
#[expect(clippy::print_stderr, reason = "a skipped test must be seen")]
fn folder() -> Option<PathBuf> {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../shared/lpips");
    if path.is_dir() {
        return Some(path);
    }
    eprintln!("SKIPPED: no LPIPS weights at ../shared/lpips");
    None
}

fn picture(folder: &Path, name: &str) -> ColorImage {
    let bytes: Arc<[u8]> = std::fs::read(folder.join(format!("{name}.png")))
        .unwrap()
        .into();
    EncodedColor::from_file(bytes).unwrap().decode().unwrap()
}

#[test]
fn distances_are_those_of_the_python_package() {
    let Some(folder) = folder() else { return };
    let network = Lpips::load(&folder.join("lpips_alex.safetensors")).unwrap();
    let text = std::fs::read_to_string(folder.join("lpips_expected.json")).unwrap();
    let expected: Value = serde_json::from_str(&text).unwrap();
    let reference = network.features(&picture(&folder, "ex_ref")).unwrap();
    for other in ["ex_p0", "ex_p1"] {
        let expected = &expected["alex"][format!("ex_ref|{other}")];
        let features = network.features(&picture(&folder, other)).unwrap();
        let distance = network.distance(&reference, &features).unwrap();
        let wanted = expected["total"].as_f64().unwrap();
        assert!(
            (distance.total() - wanted).abs() < 2e-6,
            "{distance:?} {wanted}"
        );
        for (layer, value) in distance.per_layer.iter().enumerate() {
            let wanted = expected["per_layer"][layer].as_f64().unwrap();
            assert!((value - wanted).abs() < 2e-6, "{layer}: {value} {wanted}");
        }
    }

    let ramp: Vec<f32> = (0..3 * 64 * 64)
        .map(|i| (f64::from(i) / (3.0 * 64.0 * 64.0 - 1.0) * 2.0 - 1.0) as f32)
        .collect();
    let negative: Vec<f32> = ramp.iter().map(|v| -v).collect();
    let [a, b] = [ramp, negative].map(|data| network.features_of(data, 64, 64).unwrap());
    let wanted = expected["alex"]["ramp64|-ramp64"].as_f64().unwrap();
    let total = network.distance(&a, &b).unwrap().total();
    assert!((total - wanted).abs() < 2e-6, "{total} {wanted}");
}

#[test]
fn the_bits_do_not_depend_on_the_threads() {
    let Some(folder) = folder() else { return };
    let network = Lpips::load(&folder.join("lpips_alex.safetensors")).unwrap();
    let noise = |seed: u32| {
        let pixels = (0..201 * 150u32).map(|i| {
            let h = (i ^ seed).wrapping_mul(0x9E37_79B1);
            [(h >> 8) as u8, (h >> 16) as u8, (h >> 24) as u8]
        });
        ColorImage::new(201, 150, pixels.collect()).unwrap()
    };
    let measure = |num_threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(num_threads);
        pool.build().unwrap().install(|| {
            let [a, b] = [1, 2].map(|seed| network.features(&noise(seed)).unwrap());
            network.distance(&a, &b).unwrap()
        })
    };
    let one = measure(1);
    assert!(one.total() > 0.01);
    assert_eq!(one, measure(2));
    assert_eq!(one, measure(5));
    let a = network.features(&noise(1)).unwrap();
    assert_eq!(network.distance(&a, &a).unwrap().total(), 0.0);
}

#[test]
fn wrong_files_are_refused_with_what_is_wrong() {
    let not_there = Lpips::load(Path::new("/nowhere/weights.safetensors")).unwrap_err();
    assert!(
        not_there
            .to_string()
            .contains("/nowhere/weights.safetensors")
    );
    assert!(matches!(
        Lpips::from_bytes(b"not a file of weights").unwrap_err(),
        LpipsError::Format(_)
    ));
    let header = br#"{"features.0.weight":{"dtype":"F32","shape":[1],"data_offsets":[0,4]}}"#;
    let mut bytes = (header.len() as u64).to_le_bytes().to_vec();
    bytes.extend(header);
    bytes.extend([0; 4]);
    let error = Lpips::from_bytes(&bytes).unwrap_err().to_string();
    assert!(
        error.contains("features.0.weight") && error.contains("[64, 3, 11, 11]"),
        "{error}"
    );
}

#[test]
fn sizes_must_do() {
    let Some(folder) = folder() else { return };
    let network = Lpips::load(&folder.join("lpips_alex.safetensors")).unwrap();
    let flat =
        |side: u32| ColorImage::new(side, side, vec![[9; 3]; (side * side) as usize]).unwrap();
    assert!(network.features(&flat(31)).is_ok());
    assert!(matches!(
        network.features(&flat(20)).unwrap_err(),
        LpipsError::TooSmall { .. }
    ));
    let [a, b] = [40, 80].map(|side| network.features(&flat(side)).unwrap());
    assert!(matches!(network.distance(&a, &b), Err(LpipsError::Size)));
}
