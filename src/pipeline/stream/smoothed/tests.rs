use super::*;

#[test]
fn a_group_makes_as_many_steps_per_texel_as_the_whole() {
    let share = |num_own, num_all, num_in_crop| Share {
        num_own,
        num_all,
        num_in_crop,
    };
    // All of it, larger or smaller than a crop.
    for num_in_crop in [10, 7_000_001] {
        let all = share(7_000_000, 7_000_000, num_in_crop);
        assert_eq!(all.of_steps(4000), 4000);
    }
    // Crops are as full of a large group as of the whole.
    assert_eq!(share(700_000, 7_000_000, 65_536).of_steps(4000), 400);
    // A texel of the whole is in a crop every 7,000,000 / 70,000 steps, one of a small group in each.
    assert_eq!(share(700, 7_000_000, 70_000).of_steps(4000), 40);
    assert_eq!(share(60_000, 7_000_000, 70_000).of_steps(4000), 40);
    // Rounded up, at least one.
    assert_eq!(share(1, 7_000_000, 1).of_steps(4000), 1);
    assert_eq!(share(0, 0, 0).of_steps(1), 1);
    assert_eq!(share(3, 10, 1).of_steps(11), 4);
}

#[test]
fn charts_that_made_steps_before_make_fewer() {
    let share = Share {
        num_own: 1_000_000,
        num_all: 4_000_000,
        num_in_crop: 65_536,
    };
    let whole = share.of_texel_steps(1_000_000 * 400);
    let rest = share.of_texel_steps(500_000 * 400 + 500_000 * 200);
    assert_eq!((whole, rest), (100, 75));
}
