//! Reading bags: megabytes of raw images per second, by compression.

use std::hint::black_box;
use std::path::Path;

use criterion::{BatchSize, Criterion, Throughput};
use veneer::bag::{BagReader, BagWriter, Compression, TopicRoles};
use veneer::geom::Stamp;
use veneer::ingest::EventSource;
use veneer::wire::{Image, Message, WireHeader};

const NUM_IMAGES: u32 = 60;
const SIZE: [u32; 2] = [1280, 720];

/// Sensor-like pixels: a smooth picture with two bits of noise.
fn pixels() -> Vec<u8> {
    let [width, height] = SIZE;
    let pixel = |i: u32| i.wrapping_mul(2_654_435_761).to_be_bytes()[0] & 3;
    let shade = |i: u32| (i / 3 / 64 % 200).to_le_bytes()[0];
    (0..width * height * 3)
        .map(|i| shade(i) + pixel(i))
        .collect()
}

fn write_bag(path: &Path, pixels: &[u8], compression: Compression) {
    let [width, height] = SIZE;
    let mut bag = BagWriter::create(path, compression).expect("a new bag");
    let topic = "/camera/color/image_raw";
    let channel = bag.add_channel(topic, Image::TYPE_NAME, Image::SCHEMA);
    let channel = channel.expect("a channel");
    for i in 0..NUM_IMAGES {
        let stamp = Stamp::from_nanos(i64::from(i) * 33_000_000);
        let image = Image {
            header: WireHeader {
                stamp,
                frame_id: "camera",
            },
            height,
            width,
            encoding: "rgb8",
            is_bigendian: false,
            step: width * 3,
            data: pixels,
        };
        bag.write(channel, stamp, &image.encode())
            .expect("a message");
    }
    bag.finish().expect("a finished bag");
}

/// `bag_reading/{none,lz4,zstd}`: from open to the last event.
pub(crate) fn bench(criterion: &mut Criterion) {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let pixels = pixels();
    let mut group = criterion.benchmark_group("bag_reading");
    group.sample_size(10);
    group.throughput(Throughput::Bytes(
        pixels.len() as u64 * u64::from(NUM_IMAGES),
    ));
    for (name, compression) in [
        ("none", Compression::None),
        ("lz4", Compression::Lz4),
        ("zstd", Compression::Zstd),
    ] {
        let path = folder.path().join(name).with_extension("mcap");
        write_bag(&path, &pixels, compression);
        let open = || BagReader::open(&path, &TopicRoles::default()).expect("a bag");
        group.bench_function(name, |bencher| {
            bencher.iter_batched(
                || (),
                |()| {
                    let mut reader = open();
                    while let Some(event) = reader.next_event() {
                        black_box(event);
                    }
                },
                BatchSize::PerIteration,
            );
        });
    }
    group.finish();
}
