use proptest::prelude::*;

use super::*;

/// Which shape holds each cell, kept by the simplest means.
struct Plan {
    size: [u32; 2],
    pages: Vec<Vec<Option<SlotId>>>,
}

impl Plan {
    fn new(size: [u32; 2]) -> Self {
        Self {
            size,
            pages: Vec::new(),
        }
    }

    fn cells(&self, shape: &CellMask, slot: &Slot) -> Vec<usize> {
        let turned = shape.turned(slot.turn);
        let runs: Vec<_> = turned.runs().collect();
        runs.into_iter()
            .flat_map(|(y, first, len)| (first..first + len).map(move |x| [x, y]))
            .map(|[x, y]| {
                let [x, y] = [x + slot.cell[0], y + slot.cell[1]];
                assert!(
                    x < self.size[0] && y < self.size[1],
                    "{slot:?} leaves the page"
                );
                (y * self.size[0] + x) as usize
            })
            .collect()
    }

    fn add(&mut self, shape: &CellMask, slot: &Slot) {
        let num_cells = (self.size[0] * self.size[1]) as usize;
        while self.pages.len() <= slot.page as usize {
            self.pages.push(vec![None; num_cells]);
        }
        for cell in self.cells(shape, slot) {
            let before = self.pages[slot.page as usize][cell].replace(slot.id);
            assert_eq!(before, None, "{slot:?} lies on another");
        }
    }

    fn take(&mut self, shape: &CellMask, slot: &Slot) {
        for cell in self.cells(shape, slot) {
            let before = self.pages[slot.page as usize][cell].take();
            assert_eq!(before, Some(slot.id));
        }
    }

    fn is_free(&self, shape: &CellMask, slot: &Slot) -> bool {
        let page = &self.pages[slot.page as usize];
        self.cells(shape, slot)
            .iter()
            .all(|cell| page[*cell].is_none())
    }

    /// The rule of placement, by trying everything.
    fn best(&self, shape: &CellMask) -> Option<([u32; 2], u32, QuarterTurn)> {
        let mut best: Option<(u32, u32, usize, [u32; 2])> = None;
        for page in 0..self.pages.len() as u32 {
            for (index, turn) in QuarterTurn::ALL.into_iter().enumerate() {
                let [width, height] = turn.size(shape.size());
                for y in 0..(self.size[1] + 1).saturating_sub(height) {
                    for x in 0..(self.size[0] + 1).saturating_sub(width) {
                        let (id, cell) = (SlotId(0), [x, y]);
                        let slot = Slot {
                            id,
                            page,
                            cell,
                            turn,
                        };
                        let found = (y + height, page, index, [y, x]);
                        if best.is_none_or(|b| found < b) && self.is_free(shape, &slot) {
                            best = Some(found);
                        }
                    }
                }
            }
        }
        best.map(|(_, page, index, [y, x])| ([x, y], page, QuarterTurn::ALL[index]))
    }

    fn held(&self) -> Vec<Vec<bool>> {
        let is_held = |page: &Vec<Option<SlotId>>| page.iter().map(Option::is_some).collect();
        self.pages.iter().map(is_held).collect()
    }
}

fn held_cells(allocator: &PageAllocator) -> Vec<Vec<bool>> {
    let [width, height] = allocator.size_cells;
    let is_held =
        |page: &Page, x: u32, y: u32| page.row(0, y as usize)[x as usize / 64] >> (x % 64) & 1 == 1;
    let cells = |page: &Page| {
        let rows = (0..height).flat_map(|y| (0..width).map(move |x| (x, y)));
        rows.map(|(x, y)| is_held(page, x, y)).collect()
    };
    allocator.pages.iter().map(cells).collect()
}

/// Connected or not, with holes or not: cells of a rectangle, most of them.
fn shape() -> impl Strategy<Value = CellMask> {
    let size = prop_oneof![
        [1u32..8, 1u32..8],
        [1u32..40, 1u32..12],
        [1u32..80, 1u32..30]
    ];
    (size, any::<u64>(), 0u64..8).prop_map(|(size, seed, num_of_eight)| {
        let mut mask = CellMask::empty(size);
        let mut state = seed;
        for y in 0..size[1] {
            for x in 0..size[0] {
                state = state
                    .wrapping_mul(6_364_136_223_846_793_005)
                    .wrapping_add(1_442_695_040_888_963_407);
                // In patches of 3×3, so that there are bays to lie in.
                let patch = seed.wrapping_add(u64::from(x / 3 * 7919 + y / 3 * 104_729));
                if state >> 61 <= num_of_eight && patch.wrapping_mul(0x9e37_79b9) >> 29 & 7 > 1 {
                    mask.insert(x, y);
                }
            }
        }
        mask.insert(0, size[1] - 1);
        mask.insert(size[0] - 1, 0);
        mask
    })
}

#[derive(Clone, Debug)]
enum Operation {
    Insert(CellMask),
    /// The so-and-so-manieth of those that lie there.
    Remove(usize),
}

fn operations() -> impl Strategy<Value = Vec<Operation>> {
    let operation = prop_oneof![
        3 => shape().prop_map(Operation::Insert),
        2 => any::<usize>().prop_map(Operation::Remove),
    ];
    proptest::collection::vec(operation, 1..60)
}

/// Places after each operation, checked against a plan of cells.
fn run(operations: &[Operation], size: [u32; 2], max_pages: u32) -> (PageAllocator, Vec<Slot>) {
    let mut allocator = PageAllocator::new(size, max_pages);
    let mut plan = Plan::new(size);
    let mut lying: Vec<(Slot, CellMask)> = Vec::new();
    let mut history = Vec::new();
    for operation in operations {
        match operation {
            Operation::Insert(shape) => {
                let expected = plan.best(shape);
                let num_pages = allocator.num_pages();
                if let Some(slot) = allocator.insert(shape) {
                    match expected {
                        Some(best) => assert_eq!((slot.cell, slot.page, slot.turn), best),
                        None => assert_eq!(slot.page, num_pages, "on a page of its own"),
                    }
                    plan.add(shape, &slot);
                    lying.push((slot, shape.clone()));
                    history.push(slot);
                } else {
                    assert_eq!(expected, None);
                    let fits = |[w, h]: [u32; 2]| w <= size[0] && h <= size[1];
                    let [w, h] = shape.size();
                    assert!(num_pages == max_pages || !(fits([w, h]) || fits([h, w])));
                }
            }
            Operation::Remove(pick) if !lying.is_empty() => {
                let (slot, shape) = lying.remove(pick % lying.len());
                assert_eq!(allocator.remove(slot.id), Some(slot));
                assert_eq!(allocator.remove(slot.id), None, "twice");
                plan.take(&shape, &slot);
            }
            Operation::Remove(_) => {}
        }
        assert!(
            lying
                .iter()
                .all(|(slot, _)| allocator.slot(slot.id) == Some(*slot)),
            "moved"
        );
        assert_eq!(held_cells(&allocator), plan.held());
    }
    let num_free = plan.held().iter().flatten().filter(|held| !**held).count();
    assert_eq!(allocator.num_free_cells(), num_free);
    (allocator, history)
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(40))]
    #[test]
    fn shapes_never_overlap_nor_move_and_lie_where_the_rule_says(operations in operations()) {
        let (_, history) = run(&operations, [70, 48], 3);
        prop_assert_eq!(run(&operations, [70, 48], 3).1, history);
    }

    #[test]
    fn what_all_is_taken_from_is_as_new(operations in operations(), is_reversed: bool) {
        let (mut allocator, history) = run(&operations, [130, 40], 2);
        let mut ids: Vec<SlotId> = history.iter().map(|slot| slot.id).collect();
        if is_reversed {
            ids.reverse();
        }
        for id in ids {
            allocator.remove(id);
        }
        prop_assert_eq!(allocator.num_slots(), 0);
        for page in &allocator.pages {
            // Every word of every table, not just the free cells.
            prop_assert!(*page == Page::new([130, 40]));
        }
    }

    #[test]
    fn fragmentation_counts_free_cells_out_of_reach(
        operations in operations(), side in 1u32..9,
    ) {
        let (allocator, _) = run(&operations, [70, 48], 2);
        let held = held_cells(&allocator);
        let (mut num_free, mut num_reached) = (0u32, 0u32);
        for page in &held {
            let is_free = |x: u32, y: u32| !page[(y * 70 + x) as usize];
            let mut is_reached = vec![false; 70 * 48];
            for y in 0..=48 - side {
                for x in 0..=70 - side {
                    let cells = (y..y + side).flat_map(|v| (x..x + side).map(move |u| (u, v)));
                    if cells.clone().all(|(u, v)| is_free(u, v)) {
                        cells.for_each(|(u, v)| is_reached[(v * 70 + u) as usize] = true);
                    }
                }
            }
            num_reached += is_reached.iter().filter(|r| **r).count() as u32;
            num_free += page.iter().filter(|h| !**h).count() as u32;
        }
        let expected = if num_free == 0 {
            0.0
        } else {
            f64::from(num_free - num_reached) / f64::from(num_free)
        };
        prop_assert_eq!(allocator.fragmentation(side), expected);
    }
}

#[test]
fn pages_are_opened_up_to_the_budget() {
    let mut allocator = PageAllocator::for_budget([64, 64], 4, 2 * 64 * 64 + 100);
    let whole = CellMask::full([16, 16]);
    assert_eq!(allocator.insert(&CellMask::full([17, 1])), None);
    assert_eq!(allocator.num_pages(), 0);
    let pages = [(); 3].map(|()| allocator.insert(&whole).map(|slot| slot.page));
    assert_eq!(pages, [Some(0), Some(1), None]);
    assert_eq!(allocator.used_rows(1), 16);
    assert_eq!(allocator.insert(&CellMask::empty([3, 3])), None);
}
