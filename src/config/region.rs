//! The words that stand for a region.

use super::Config;
use crate::mesh::Region;

pub(super) fn set_box(config: &mut Config, text: &str) -> Option<()> {
    let is_separator = |c: char| c.is_whitespace() || matches!(c, ',' | '[' | ']');
    let numbers: Vec<f64> = text
        .split(is_separator)
        .filter(|word| !word.is_empty())
        .map(str::parse)
        .collect::<Result<_, _>>()
        .ok()?;
    config.pipeline.region.region = match numbers[..] {
        [] => None,
        [x0, y0, z0, x1, y1, z1] => Some(Region::new([x0, y0, z0], [x1, y1, z1]).ok()?),
        _ => return None,
    };
    Some(())
}

pub(super) fn bounds(config: &Config) -> String {
    let Some(region) = config.pipeline.region.region else {
        return String::new();
    };
    let numbers = [region.min_m(), region.max_m()];
    let words = numbers.iter().flatten().map(f64::to_string);
    words.collect::<Vec<_>>().join(" ")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn six_numbers_are_a_box() {
        let mut config = Config::default();
        for text in ["0 -1 -inf 1.5 2 inf", "[0, -1, -inf, 1.5, 2, inf]"] {
            config.set("region.box", text).expect("six numbers");
            assert_eq!(bounds(&config), "0 -1 -inf 1.5 2 inf");
        }
        for text in ["0 0 0 1 1", "0 0 0 1 1 1 1", "1 0 0 0 1 1", "a b c d e f"] {
            assert!(config.set("region.box", text).is_err(), "{text}");
        }
        assert_eq!(bounds(&config), "0 -1 -inf 1.5 2 inf");
        config.set("region.box", "").expect("empty is all");
        assert_eq!(config.pipeline.region.region, None);
    }
}
