//! Readers on channels that lose, repeat and reorder, among publishers that start anew: what a
//! reader holds is always the whole of one revision, and the newest after the next whole one.

use std::collections::BTreeMap;

use super::made::{Made, Scan};
use super::mirrors::{new_mirror, triangle_bits};
use super::{messages_of, only};
use crate::publish::{Applied, Mirror, OutputTopic, PublishParams, Publisher, Snapshot};
use crate::wire::Message;
use crate::wire::textured_mesh_block::TexturedMeshBlock;

const TOPIC: OutputTopic = OutputTopic::TexturedMesh;
const NUM_STATES: u64 = 14;

/// SplitMix64.
struct Random(u64);

impl Random {
    fn below(&mut self, end: u64) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let z = (self.0 ^ (self.0 >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        let z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        (z ^ (z >> 31)) % end
    }
}

/// What was published, by session and revision.
type Published = BTreeMap<(u64, u64), Made>;

#[track_caller]
fn assert_holds_a_state(mirror: &Mirror, published: &Published) {
    let Some(revision) = mirror.revision() else {
        return;
    };
    let made = &published[&(mirror.session(), revision)];
    assert_eq!(mirror.frame_id(), made.frame_id);
    assert_eq!(mirror.page_size_texel(), made.layout.page_size_texel);
    let pages = made.texture.pages.iter().map(|page| &page.srgb);
    assert!(mirror.pages().iter().eq(pages), "texels of {revision}");
    let is_same = triangle_bits(mirror) == made.triangle_bits();
    assert!(is_same, "triangles of {revision}");
}

/// One reader and its channel.
struct Reader {
    mirror: Mirror,
    random: Random,
    /// In thousandths: lost, twice, and held back behind those that follow.
    faults: [u64; 3],
    held_back: Vec<Vec<u8>>,
    num_lost: u64,
}

impl Reader {
    fn new(seed: u64, faults: [u64; 3]) -> Self {
        Self {
            mirror: new_mirror(),
            random: Random(seed),
            faults,
            held_back: Vec::new(),
            num_lost: 0,
        }
    }

    /// What the channel makes of messages.
    fn channel(&mut self, messages: &[Vec<u8>]) -> Vec<Vec<u8>> {
        let [lost, twice, late] = self.faults;
        let mut out = Vec::new();
        for message in messages {
            let draw = self.random.below(1000);
            if draw < lost {
                self.num_lost += 1;
            } else if draw < lost + late {
                self.held_back.push(message.clone());
            } else {
                out.push(message.clone());
                if draw < lost + late + twice {
                    out.push(message.clone());
                }
            }
            if self.random.below(3) == 0 {
                out.append(&mut self.held_back);
            }
        }
        out
    }

    fn receive(&mut self, messages: &[Vec<u8>], published: &Published) {
        for bytes in self.channel(messages) {
            let block = TexturedMeshBlock::decode(&bytes).unwrap();
            // A block of a state that contradicts one that waits is refused, and harms nothing.
            let applied = self.mirror.apply(&block);
            if let Ok(Applied::Revision(revision)) = applied {
                assert_eq!(self.mirror.revision(), Some(revision));
                assert_holds_a_state(&self.mirror, published);
            }
        }
        assert_holds_a_state(&self.mirror, published);
    }
}

/// A publisher of a scan that changes; what it sends.
struct Source {
    scan: Scan,
    publisher: Publisher,
    params: PublishParams,
    session: u64,
    revision: u64,
}

impl Source {
    fn publish(&mut self, published: &mut Published) -> Vec<Vec<u8>> {
        self.revision += 1;
        let made = self.scan.made();
        let snapshot = Snapshot {
            session: self.session,
            ..made.snapshot(self.revision)
        };
        let outgoing = self.publisher.publish(&snapshot, &only(TOPIC)).unwrap();
        let messages = messages_of(&outgoing, TOPIC);
        let messages = messages.into_iter().map(<[u8]>::to_vec).collect();
        published.insert((self.session, self.revision), made);
        messages
    }

    fn change(&mut self, random: &mut Random) {
        match random.below(12) {
            0 => self.scan.resize(),
            1 => {
                // The process starts anew, or the scan is forgotten.
                self.publisher = Publisher::new(self.params);
                self.session += 1;
                self.revision = 0;
                self.scan = Scan::new(random.below(u64::MAX));
            }
            _ => self.scan.change(random.below(u64::MAX)),
        }
    }
}

fn run(seed: u64) -> u64 {
    let mut random = Random(seed);
    let params = PublishParams {
        max_message_bytes: 8192 + random.below(30_000) as usize,
        tile_texel: 16 + random.below(100) as u32,
        history_messages: 5 + random.below(60) as usize,
        ..PublishParams::default()
    };
    let mut source = Source {
        scan: Scan::new(seed),
        publisher: Publisher::new(params),
        params,
        session: 1,
        revision: 0,
    };
    let mut published = Published::new();
    let mut readers = vec![
        Reader::new(seed, [0; 3]),
        Reader::new(seed + 1, [120, 60, 0]),
        Reader::new(seed + 2, [80, 100, 200]),
    ];
    for state in 0..NUM_STATES {
        let messages = source.publish(&mut published);
        for reader in &mut readers {
            reader.receive(&messages, &published);
        }
        let lossless = &readers[0].mirror;
        if !messages.is_empty() {
            let now = (lossless.session(), lossless.revision());
            assert_eq!(now, (source.session, Some(source.revision)));
        }
        // Who comes late asks for the whole.
        if state == NUM_STATES / 2 {
            source.publisher.forget(TOPIC);
            readers.push(Reader::new(seed + 3, [0; 3]));
        }
        source.change(&mut random);
    }
    // The next whole one heals all losses.
    source.publisher.forget(TOPIC);
    let whole = source.publish(&mut published);
    for reader in &mut readers {
        reader.faults = [0; 3];
        reader.held_back.clear();
        reader.receive(&whole, &published);
        let now = (reader.mirror.session(), reader.mirror.revision());
        assert_eq!(now, (source.session, Some(source.revision)));
        assert!(reader.mirror.holds_same_as(&readers_first(&whole)));
    }
    readers.iter().map(|reader| reader.num_lost).sum()
}

/// What somebody holds who has got nothing else.
fn readers_first(whole: &[Vec<u8>]) -> Mirror {
    let mut mirror = new_mirror();
    for bytes in whole {
        let block = TexturedMeshBlock::decode(bytes).unwrap();
        mirror.apply(&block).unwrap();
    }
    mirror
}

#[test]
fn readers_hold_whole_revisions_whatever_the_channel_does() {
    let num_lost: u64 = (0..40).map(run).sum();
    assert!(num_lost > 100, "{num_lost}");
}
