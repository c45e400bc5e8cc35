//! Blocks put together again hold exactly what was published, early and late.

use std::collections::VecDeque;

use proptest::prelude::*;

use super::made::{CornerBits, Made, Scan};
use super::{messages_of, only};
use crate::export::{self, ExportParams, TexturedMesh};
use crate::publish::mirror::MirrorLimits;
use crate::publish::{
    Applied, Mirror, MirrorError, OutputTopic, PublishParams, Publisher, Snapshot,
};
use crate::wire::textured_mesh_block::TexturedMeshBlock;
use crate::wire::{Message, WireError};

const TOPIC: OutputTopic = OutputTopic::TexturedMesh;

pub(super) fn triangle_bits(mirror: &Mirror) -> Vec<[CornerBits; 3]> {
    let mut bits = Vec::new();
    for chart in mirror.charts() {
        for corners in chart.triangles.as_chunks::<3>().0 {
            bits.push(corners.map(|v| {
                let v = v as usize;
                let uv = [chart.uvs[2 * v], chart.uvs[2 * v + 1]];
                (
                    chart.vertices_m[v].map(f64::to_bits),
                    uv.map(f32::to_bits),
                    chart.page,
                )
            }));
        }
    }
    bits.sort_unstable();
    bits
}

pub(super) fn assert_holds(mirror: &Mirror, made: &Made, revision: u64) {
    assert_eq!(mirror.frame_id(), made.frame_id);
    assert!(mirror.revision().is_some_and(|held| held <= revision));
    let pages = made.texture.pages.iter().map(|page| &page.srgb);
    assert!(mirror.pages().iter().eq(pages), "revision {revision}");
    assert!(
        triangle_bits(mirror) == made.triangle_bits(),
        "revision {revision}"
    );
}

/// Applies messages; how many revisions they completed.
fn apply_all<'a>(mirror: &mut Mirror, messages: impl IntoIterator<Item = &'a [u8]>) -> usize {
    let applied = messages.into_iter().map(|bytes| {
        let block = TexturedMeshBlock::decode(bytes).unwrap();
        mirror.apply(&block).unwrap()
    });
    let applied: Vec<Applied> = applied.collect();
    let revisions = applied.iter().filter(|a| matches!(a, Applied::Revision(_)));
    revisions.count()
}

pub(super) fn new_mirror() -> Mirror {
    Mirror::new(MirrorLimits::default())
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(24))]

    #[test]
    fn early_and_late_readers_hold_what_was_published(
        seed in any::<u64>(),
        max_message_bytes in prop_oneof![Just(8192usize), 9000usize..40_000, Just(190_000)],
        tile_texel in 16u32..200,
        history_messages in prop_oneof![4 => 1usize..40, 1 => 40usize..200],
    ) {
        let params = PublishParams { max_message_bytes, tile_texel, history_messages, ..PublishParams::default() };
        let mut publisher = Publisher::new(params);
        let mut scan = Scan::new(seed);
        let mut early = new_mirror();
        // What a transient-local writer with KeepLast keeps.
        let mut history: VecDeque<Vec<u8>> = VecDeque::new();
        for revision in 1..8 {
            let made = scan.made();
            let outgoing = publisher.publish(&made.snapshot(revision), &only(TOPIC)).unwrap();
            let messages = messages_of(&outgoing, TOPIC);
            prop_assert!(messages.iter().all(|message| message.len() <= max_message_bytes));
            apply_all(&mut early, messages.iter().copied());
            assert_holds(&early, &made, revision);
            history.extend(messages.into_iter().map(<[u8]>::to_vec));
            history.drain(..history.len().saturating_sub(history_messages));
            let is_kept = publisher.num_messages_since_whole(TOPIC) <= history_messages;
            // Only a whole that is itself too long may outgrow what the writer keeps.
            let last = history.back().map(|m| TexturedMeshBlock::decode(m).unwrap().base_revision);
            prop_assert!(is_kept || last == Some(0));
            if is_kept {
                let mut late = new_mirror();
                apply_all(&mut late, history.iter().map(Vec::as_slice));
                prop_assert!(late.holds_same_as(&early), "revision {}", revision);
            }
            scan.change(seed ^ revision);
        }
    }

    #[test]
    fn changed_bytes_are_refused_or_held_but_never_panic(
        changes in prop::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 1..8),
    ) {
        let made = Scan::new(9).made();
        let params = PublishParams { max_message_bytes: 20_000, ..PublishParams::default() };
        let outgoing = Publisher::new(params).publish(&made.snapshot(1), &only(TOPIC)).unwrap();
        let limits = MirrorLimits { max_texels: 1 << 20, max_revision_bytes: 1 << 24 };
        let mut mirror = Mirror::new(limits);
        for message in &outgoing {
            let mut bytes = message.bytes.clone();
            for (at, value) in &changes {
                // Most of a block is pixels; its first fields matter most.
                let at = 4 + at.index(if value % 2 == 0 { 120 } else { bytes.len() - 4 });
                bytes[at] = *value;
            }
            if let Ok(block) = TexturedMeshBlock::decode(&bytes) {
                mirror.apply(&block).ok();
            }
        }
        prop_assert!(mirror.to_textured().is_ok());
    }
}

fn blocks_of(made: &Made, revision: u64, publisher: &mut Publisher) -> Vec<Vec<u8>> {
    let outgoing = publisher.publish(&made.snapshot(revision), &only(TOPIC));
    outgoing.unwrap().into_iter().map(|m| m.bytes).collect()
}

#[test]
fn only_what_changed_is_sent() {
    let mut scan = Scan::new(11);
    let mut publisher = Publisher::new(PublishParams {
        tile_texel: 48,
        ..PublishParams::default()
    });
    blocks_of(&scan.made(), 1, &mut publisher);
    scan.paint(77);
    let painted = blocks_of(&scan.made(), 2, &mut publisher);
    let block = TexturedMeshBlock::decode(&painted[0]).unwrap();
    assert_eq!((painted.len(), block.base_revision), (1, 1));
    assert!(block.charts.is_empty() && block.removed_chart_ids.is_empty());
    assert_eq!(block.tiles.len(), 1);
    assert_eq!(
        (block.tiles[0].rect.width, block.tiles[0].rect.height),
        (48, 48)
    );
    scan.add();
    let grown = blocks_of(&scan.made(), 3, &mut publisher);
    let block = TexturedMeshBlock::decode(&grown[0]).unwrap();
    // The other charts have other numbers in the layout now, and vertices others in the mesh; only
    // positions along x, which follow the number here, make them new.
    assert_eq!(block.base_revision, 2);
    assert!(!block.charts.is_empty() && block.tiles.len() == 1);
}

#[test]
fn blocks_may_come_in_any_order_and_twice() {
    let made = Scan::new(12).made();
    let mut publisher = Publisher::new(PublishParams {
        max_message_bytes: 10_000,
        ..PublishParams::default()
    });
    let mut blocks = blocks_of(&made, 1, &mut publisher);
    assert!(blocks.len() > 4);
    let twice: Vec<Vec<u8>> = blocks.iter().chain(&blocks).cloned().collect();
    blocks.reverse();
    for blocks in [blocks, twice] {
        let mut mirror = new_mirror();
        assert_eq!(apply_all(&mut mirror, blocks.iter().map(Vec::as_slice)), 1);
        assert_holds(&mirror, &made, 1);
    }
}

#[test]
fn who_lost_a_block_waits_for_the_whole() {
    let mut scan = Scan::new(13);
    let params = PublishParams {
        max_message_bytes: 10_000,
        ..PublishParams::default()
    };
    let mut publisher = Publisher::new(params);
    let mut mirror = new_mirror();
    apply_all(
        &mut mirror,
        blocks_of(&scan.made(), 1, &mut publisher)
            .iter()
            .map(Vec::as_slice),
    );
    let before = mirror.clone();
    for patch in 0..4 {
        scan.paint(patch + 50);
    }
    let lossy = blocks_of(&scan.made(), 2, &mut publisher);
    assert!(lossy.len() > 1);
    apply_all(&mut mirror, lossy[1..].iter().map(Vec::as_slice));
    scan.paint(60);
    apply_all(
        &mut mirror,
        blocks_of(&scan.made(), 3, &mut publisher)
            .iter()
            .map(Vec::as_slice),
    );
    assert!(mirror.holds_same_as(&before), "a state that never was");
    publisher.forget(TOPIC);
    let whole = blocks_of(&scan.made(), 3, &mut publisher);
    apply_all(&mut mirror, whole.iter().map(Vec::as_slice));
    assert_holds(&mirror, &scan.made(), 3);
}

#[test]
fn another_session_begins_anew() {
    let (old, new) = (Scan::new(14).made(), Scan::new(15).made());
    let mut publisher = Publisher::new(PublishParams::default());
    let mut mirror = new_mirror();
    apply_all(
        &mut mirror,
        blocks_of(&old, 9, &mut publisher).iter().map(Vec::as_slice),
    );
    let snapshot = Snapshot {
        session: 7,
        ..new.snapshot(1)
    };
    let outgoing = publisher.publish(&snapshot, &only(TOPIC)).unwrap();
    assert_eq!(apply_all(&mut mirror, messages_of(&outgoing, TOPIC)), 1);
    assert_holds(&mirror, &new, 1);
    assert_eq!(mirror.session(), 7);
}

#[test]
fn what_is_held_exports_as_what_was_published() {
    let mut scan = Scan::new(16);
    scan.origin_m = 5e6;
    let made = scan.made();
    let mut mirror = new_mirror();
    let blocks = blocks_of(&made, 1, &mut Publisher::new(PublishParams::default()));
    apply_all(&mut mirror, blocks.iter().map(Vec::as_slice));
    let (mesh, layout, texture) = mirror.to_textured().unwrap();
    let again = Made {
        frame_id: made.frame_id.clone(),
        mesh,
        layout,
        texture,
        keyframes: Vec::new(),
    };
    assert!(again.triangle_bits() == made.triangle_bits());
    let folder = tempfile::tempdir().unwrap();
    let params = ExportParams {
        provenance: false,
        ..ExportParams::default()
    };
    let files = ["ours", "theirs"].map(|name| folder.path().join(name));
    for (made, out) in [&made, &again].into_iter().zip(&files) {
        let textured = TexturedMesh::new(&made.mesh, &made.layout, &made.texture).unwrap();
        export::write_all(&textured, out, &params).unwrap();
    }
    for page in 0..2 {
        let [ours, theirs] = [0, 1].map(|i| {
            let path = files[i].join(format!("atlas/page_{page}.png"));
            std::fs::read(path).unwrap()
        });
        assert!(ours == theirs, "page {page}");
    }
}

#[test]
fn shares_of_a_page_are_turned_to_texels_that_give_the_same_shares() {
    for side in (1u32..4000).step_by(7) {
        for i in 0..200u32 {
            let texel = side as f32 * (i as f32 * 0.618_034).fract();
            let share = texel / side as f32;
            let again = crate::publish::mirror::texel_of(share, side);
            assert_eq!(
                (again / side as f32).to_bits(),
                share.to_bits(),
                "{texel} of {side}"
            );
        }
    }
}

fn with_block(change: impl Fn(&mut TexturedMeshBlock<'_>)) -> Result<Applied, MirrorError> {
    let made = Scan::new(17).made();
    let blocks = blocks_of(&made, 1, &mut Publisher::new(PublishParams::default()));
    assert_eq!(blocks.len(), 1);
    let mut block = TexturedMeshBlock::decode(&blocks[0])?;
    change(&mut block);
    new_mirror().apply(&block)
}

impl From<WireError> for MirrorError {
    fn from(error: WireError) -> Self {
        panic!("{error}")
    }
}

#[test]
fn what_cannot_be_is_refused_with_its_numbers() {
    assert_eq!(with_block(|_| {}), Ok(Applied::Revision(1)));
    let words =
        |change: &dyn Fn(&mut TexturedMeshBlock<'_>)| with_block(change).unwrap_err().to_string();
    assert!(words(&|b| b.block_index = 9).contains("block 9 of 1"));
    assert!(words(&|b| b.revision = 0).contains("revision 0"));
    assert!(words(&|b| b.page_size_texel = [u32::MAX; 2]).contains("limit of 268435456"));
    assert!(words(&|b| b.removed_chart_ids = vec![3]).contains("chart 3 is to be removed"));
    assert!(words(&|b| b.charts[1].id = b.charts[0].id).contains("there already"));
    assert!(words(&|b| b.charts[0].triangles[0] = 1 << 30).contains("out of range"));
    assert!(words(&|b| b.charts[0].uvs[0] = f32::NAN).contains("off its page"));
    assert!(words(&|b| b.charts[0].page = 7).contains("page that is not there"));
    assert!(words(&|b| b.tiles[0].rect.x = u32::MAX).contains("not on a page"));
    assert!(words(&|b| b.tiles[0].format = "bmp").contains("'bmp'"));
    assert!(words(&|b| b.tiles[0].rect.width -= 1).contains("page 0"));
    assert_eq!(with_block(|b| b.base_revision = 5), Ok(Applied::Useless));
}
