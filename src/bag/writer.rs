//! Writing bags that rosbag2, Python's `rosbags` and `mcap` read.
//!
//! The same calls give the same bytes on every machine. A bag written to a path appears there
//! only when it is finished: until then it is `<path>.part`, removed if it never is.

use std::collections::BTreeMap;
use std::ffi::OsString;
use std::fs::{self, File};
use std::io::{BufWriter, Seek, Write};
use std::path::{Path, PathBuf};

use mcap::records::MessageHeader;
use mcap::{WriteOptions, Writer};

use crate::geom::Stamp;

use super::error::BagError;

/// How chunks are compressed.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default)]
pub enum Compression {
    /// Not at all: fastest to read, and right where the images are compressed already.
    #[default]
    None,
    /// LZ4, rosbag2's fast choice.
    Lz4,
    /// Zstandard, rosbag2's small choice.
    Zstd,
}

/// A topic of a bag being written.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct ChannelId(u16);

/// What was written.
#[derive(Clone, Debug, PartialEq, Eq, Default)]
pub struct BagSummary {
    /// Messages by topic.
    pub num_messages: BTreeMap<String, u64>,
    /// Bytes of the file.
    pub num_bytes: u64,
}

struct Channel {
    topic: String,
    num_messages: u32,
}

/// Where a bag under way lies, and where it will.
struct PartialFile {
    part: PathBuf,
    path: PathBuf,
}

impl PartialFile {
    fn io_error(&self) -> impl Fn(std::io::Error) -> BagError {
        let path = self.path.clone();
        move |error| BagError::Io {
            path: path.clone(),
            error,
        }
    }
}

/// Where the bag of this path lies until it is finished.
pub fn partial_path(path: &Path) -> PathBuf {
    let mut part = OsString::from(path);
    part.push(".part");
    PathBuf::from(part)
}

/// A bag being written.
pub struct BagWriter<W: Write + Seek> {
    writer: Option<Writer<W>>,
    channels: BTreeMap<ChannelId, Channel>,
    file: Option<PartialFile>,
}

impl BagWriter<BufWriter<File>> {
    /// A bag at `path`, which appears (or is replaced) when [`Self::finish`] returns.
    ///
    /// # Errors
    /// [`BagError`] when the file cannot be created, or a folder or device has its name.
    pub fn create(path: &Path, compression: Compression) -> Result<Self, BagError> {
        // Renaming over a device would replace the device, over a folder fail after all the work.
        if fs::metadata(path).is_ok_and(|there| !there.is_file()) {
            return Err(BagError::Io {
                path: path.to_owned(),
                error: std::io::Error::other("is there already, and is no file to be replaced"),
            });
        }
        let part = partial_path(path);
        let file = File::create(&part).map_err(|error| BagError::Io {
            path: path.to_owned(),
            error,
        })?;
        let mut bag = Self::new(BufWriter::with_capacity(1 << 20, file), compression)?;
        bag.file = Some(PartialFile {
            part,
            path: path.to_owned(),
        });
        Ok(bag)
    }
}

impl<W: Write + Seek> BagWriter<W> {
    /// A bag written to `sink`.
    ///
    /// # Errors
    /// [`BagError::Write`] when the sink refuses the first bytes.
    pub fn new(sink: W, compression: Compression) -> Result<Self, BagError> {
        let compression = match compression {
            Compression::None => None,
            Compression::Lz4 => Some(mcap::Compression::Lz4),
            Compression::Zstd => Some(mcap::Compression::Zstd),
        };
        let options = WriteOptions::new()
            .profile("ros2")
            .library(concat!("veneer ", env!("CARGO_PKG_VERSION")))
            .compression(compression)
            // The bytes of threaded zstd differ from those of the plain one.
            .compression_threads(0);
        Ok(Self {
            writer: Some(options.create(sink)?),
            channels: BTreeMap::new(),
            file: None,
        })
    }

    fn writer(&mut self) -> Result<&mut Writer<W>, BagError> {
        let finished = mcap::McapError::AttemptedWriteAfterFailure;
        self.writer.as_mut().ok_or(BagError::Write(finished))
    }

    /// A topic of messages of a type ([`crate::wire::Message::TYPE_NAME`] and its `SCHEMA`).
    /// QoS is left to the player, as `rosbags` leaves it.
    ///
    /// # Errors
    /// [`BagError::Write`] when the bag cannot be written, or has 65,535 topics.
    pub fn add_channel(
        &mut self,
        topic: &str,
        type_name: &str,
        schema: &str,
    ) -> Result<ChannelId, BagError> {
        let metadata = BTreeMap::from([("offered_qos_profiles".to_owned(), String::new())]);
        let writer = self.writer()?;
        let schema_id = writer.add_schema(type_name, "ros2msg", schema.as_bytes())?;
        let id = ChannelId(writer.add_channel(schema_id, topic, "cdr", &metadata)?);
        let channel = Channel {
            topic: topic.to_owned(),
            num_messages: 0,
        };
        self.channels.entry(id).or_insert(channel);
        Ok(id)
    }

    /// A serialised message, logged and published at `log_time` (times before 1970 count as 0:
    /// MCAP has no others).
    ///
    /// # Errors
    /// [`BagError::Write`] when the bag cannot be written.
    pub fn write(
        &mut self,
        channel: ChannelId,
        log_time: Stamp,
        message: &[u8],
    ) -> Result<(), BagError> {
        let log_time = u64::try_from(log_time.as_nanos()).unwrap_or(0);
        let mut sequence = 0;
        if let Some(channel) = self.channels.get_mut(&channel) {
            sequence = channel.num_messages;
            channel.num_messages = channel.num_messages.wrapping_add(1);
        }
        let header = MessageHeader {
            channel_id: channel.0,
            sequence,
            log_time,
            publish_time: log_time,
        };
        self.writer()?.write_to_known_channel(&header, message)?;
        Ok(())
    }

    /// A named set of key-value pairs.
    ///
    /// # Errors
    /// [`BagError::Write`] when the bag cannot be written.
    pub fn write_metadata(
        &mut self,
        name: &str,
        metadata: BTreeMap<String, String>,
    ) -> Result<(), BagError> {
        self.writer()?.write_metadata(&mcap::records::Metadata {
            name: name.to_owned(),
            metadata,
        })?;
        Ok(())
    }

    /// Writes the index and completes the bag.
    ///
    /// # Errors
    /// [`BagError`] when the rest cannot be written, or the file not moved to its name.
    pub fn finish(mut self) -> Result<BagSummary, BagError> {
        let finished = mcap::McapError::AttemptedWriteAfterFailure;
        let mut writer = self.writer.take().ok_or(BagError::Write(finished))?;
        writer.finish()?;
        let mut sink = writer.into_inner();
        let io_error = |error| BagError::Write(mcap::McapError::Io(error));
        let num_bytes = sink.stream_position().map_err(io_error)?;
        sink.flush().map_err(io_error)?;
        drop(sink);
        if let Some(file) = &self.file {
            fs::rename(&file.part, &file.path).map_err(file.io_error())?;
        }
        self.file = None;
        let channels = std::mem::take(&mut self.channels).into_values();
        Ok(BagSummary {
            num_messages: channels.map(|c| (c.topic, c.num_messages.into())).collect(),
            num_bytes,
        })
    }
}

impl<W: Write + Seek> Drop for BagWriter<W> {
    fn drop(&mut self) {
        drop(self.writer.take());
        if let Some(file) = &self.file {
            // Nothing is left to do about a file that cannot be removed.
            fs::remove_file(&file.part).ok();
        }
    }
}
