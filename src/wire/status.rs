//! `veneer/Status`: what veneer is doing.

use super::cdr::{CdrReader, CdrWriter};
use super::error::WireError;
use super::header::WireHeader;
use super::{Message, schema};

/// `veneer/TopicStatus`.
#[derive(Clone, Debug, PartialEq, Default)]
pub struct TopicStatus<'a> {
    /// The part it plays.
    pub role: &'a str,
    /// Its name in the graph; empty where none was found.
    pub topic: &'a str,
    /// Its type.
    pub type_name: &'a str,
    /// Messages that arrived.
    pub num_received: u64,
    /// Messages that were used.
    pub num_used: u64,
    /// Messages that were wrong or late.
    pub num_refused: u64,
    /// Messages that found a full queue.
    pub num_dropped: u64,
    /// Messages a second over the last few seconds.
    pub rate_hz: f32,
    /// Seconds since the last message; negative where none has come.
    pub age_s: f32,
}

/// `veneer/OutputStatus`.
#[derive(Clone, Debug, PartialEq, Default)]
pub struct OutputStatus<'a> {
    /// Its name in the graph.
    pub topic: &'a str,
    /// Who listens.
    pub num_subscribers: u32,
    /// Messages handed to the middleware.
    pub num_messages: u64,
    /// Their bytes.
    pub num_bytes: u64,
    /// Messages that a newer revision made needless before they were sent.
    pub num_superseded: u64,
}

/// `veneer/QueueStatus`.
#[derive(Clone, Debug, PartialEq, Eq, Default)]
pub struct QueueStatus<'a> {
    /// What waits in it.
    pub name: &'a str,
    /// How many wait.
    pub length: u32,
    /// How many can.
    pub capacity: u32,
    /// How many found no room.
    pub num_dropped: u64,
}

/// `veneer/StageStatus`.
#[derive(Clone, Debug, PartialEq, Default)]
pub struct StageStatus<'a> {
    /// What it does.
    pub name: &'a str,
    /// How often it ran.
    pub num_runs: u64,
    /// Wall time of the last run, seconds.
    pub last_s: f32,
    /// Wall time of the mean run, seconds.
    pub mean_s: f32,
}

/// `veneer/Status`.
#[derive(Clone, Debug, PartialEq, Default)]
pub struct Status<'a> {
    /// Now, and the world frame.
    pub header: WireHeader<'a>,
    /// Lifecycle state.
    pub state: &'a str,
    /// Whether frames are left out at a user's wish.
    pub is_paused: bool,
    /// Session that was published last.
    pub session: u64,
    /// Revision that was published last; 0 for none.
    pub revision: u64,
    /// What comes in.
    pub inputs: Vec<TopicStatus<'a>>,
    /// What goes out.
    pub outputs: Vec<OutputStatus<'a>>,
    /// What waits.
    pub queues: Vec<QueueStatus<'a>>,
    /// How long stages take.
    pub stages: Vec<StageStatus<'a>>,
    /// Mean difference of the stamps of paired colour and depth images, seconds.
    pub sync_error_s: f32,
    /// Keyframes that are kept.
    pub num_keyframes: u32,
    /// Their encoded bytes.
    pub keyframe_bytes: u64,
    /// Vertices of the mesh.
    pub num_vertices: u32,
    /// Triangles of the mesh.
    pub num_triangles: u32,
    /// Charts of the atlas.
    pub num_charts: u32,
    /// Pages of the atlas.
    pub num_pages: u32,
    /// Share of the mesh's area that a keyframe painted, 0 to 1.
    pub coverage: f32,
    /// From a frame's stamp to the publication of what it painted, seconds; negative where none was.
    pub latency_s: f32,
    /// Resident memory of the process.
    pub memory_bytes: u64,
}

impl<'a> TopicStatus<'a> {
    /// Three empty strings, four counts, two numbers.
    const MIN_BYTES: usize = 52;

    fn read(reader: &mut CdrReader<'a>) -> Result<Self, WireError> {
        Ok(Self {
            role: reader.string("inputs.role")?,
            topic: reader.string("inputs.topic")?,
            type_name: reader.string("inputs.type")?,
            num_received: reader.scalar("inputs.num_received")?,
            num_used: reader.scalar("inputs.num_used")?,
            num_refused: reader.scalar("inputs.num_refused")?,
            num_dropped: reader.scalar("inputs.num_dropped")?,
            rate_hz: reader.scalar("inputs.rate_hz")?,
            age_s: reader.scalar("inputs.age_s")?,
        })
    }

    fn write(&self, writer: &mut CdrWriter) {
        writer.string(self.role);
        writer.string(self.topic);
        writer.string(self.type_name);
        writer.scalar(self.num_received);
        writer.scalar(self.num_used);
        writer.scalar(self.num_refused);
        writer.scalar(self.num_dropped);
        writer.scalar(self.rate_hz);
        writer.scalar(self.age_s);
    }
}

impl<'a> OutputStatus<'a> {
    const MIN_BYTES: usize = 32;

    fn read(reader: &mut CdrReader<'a>) -> Result<Self, WireError> {
        Ok(Self {
            topic: reader.string("outputs.topic")?,
            num_subscribers: reader.scalar("outputs.num_subscribers")?,
            num_messages: reader.scalar("outputs.num_messages")?,
            num_bytes: reader.scalar("outputs.num_bytes")?,
            num_superseded: reader.scalar("outputs.num_superseded")?,
        })
    }

    fn write(&self, writer: &mut CdrWriter) {
        writer.string(self.topic);
        writer.scalar(self.num_subscribers);
        writer.scalar(self.num_messages);
        writer.scalar(self.num_bytes);
        writer.scalar(self.num_superseded);
    }
}

impl<'a> QueueStatus<'a> {
    const MIN_BYTES: usize = 20;

    fn read(reader: &mut CdrReader<'a>) -> Result<Self, WireError> {
        Ok(Self {
            name: reader.string("queues.name")?,
            length: reader.scalar("queues.length")?,
            capacity: reader.scalar("queues.capacity")?,
            num_dropped: reader.scalar("queues.num_dropped")?,
        })
    }

    fn write(&self, writer: &mut CdrWriter) {
        writer.string(self.name);
        writer.scalar(self.length);
        writer.scalar(self.capacity);
        writer.scalar(self.num_dropped);
    }
}

impl<'a> StageStatus<'a> {
    const MIN_BYTES: usize = 20;

    fn read(reader: &mut CdrReader<'a>) -> Result<Self, WireError> {
        Ok(Self {
            name: reader.string("stages.name")?,
            num_runs: reader.scalar("stages.num_runs")?,
            last_s: reader.scalar("stages.last_s")?,
            mean_s: reader.scalar("stages.mean_s")?,
        })
    }

    fn write(&self, writer: &mut CdrWriter) {
        writer.string(self.name);
        writer.scalar(self.num_runs);
        writer.scalar(self.last_s);
        writer.scalar(self.mean_s);
    }
}

impl<'a> Message<'a> for Status<'a> {
    const TYPE_NAME: &'static str = "veneer/msg/Status";
    const SCHEMA: &'static str = schema::STATUS;

    fn read(reader: &mut CdrReader<'a>) -> Result<Self, WireError> {
        Ok(Self {
            header: WireHeader::read(reader)?,
            state: reader.string("state")?,
            is_paused: reader.bool("paused")?,
            session: reader.scalar("session")?,
            revision: reader.scalar("revision")?,
            inputs: reader.sequence("inputs", TopicStatus::MIN_BYTES, TopicStatus::read)?,
            outputs: reader.sequence("outputs", OutputStatus::MIN_BYTES, OutputStatus::read)?,
            queues: reader.sequence("queues", QueueStatus::MIN_BYTES, QueueStatus::read)?,
            stages: reader.sequence("stages", StageStatus::MIN_BYTES, StageStatus::read)?,
            sync_error_s: reader.scalar("sync_error_s")?,
            num_keyframes: reader.scalar("num_keyframes")?,
            keyframe_bytes: reader.scalar("keyframe_bytes")?,
            num_vertices: reader.scalar("num_vertices")?,
            num_triangles: reader.scalar("num_triangles")?,
            num_charts: reader.scalar("num_charts")?,
            num_pages: reader.scalar("num_pages")?,
            coverage: reader.scalar("coverage")?,
            latency_s: reader.scalar("latency_s")?,
            memory_bytes: reader.scalar("memory_bytes")?,
        })
    }

    fn write(&self, writer: &mut CdrWriter) {
        self.header.write(writer);
        writer.string(self.state);
        writer.bool(self.is_paused);
        writer.scalar(self.session);
        writer.scalar(self.revision);
        writer.sequence_len(self.inputs.len());
        self.inputs.iter().for_each(|input| input.write(writer));
        writer.sequence_len(self.outputs.len());
        self.outputs.iter().for_each(|output| output.write(writer));
        writer.sequence_len(self.queues.len());
        self.queues.iter().for_each(|queue| queue.write(writer));
        writer.sequence_len(self.stages.len());
        self.stages.iter().for_each(|stage| stage.write(writer));
        writer.scalar(self.sync_error_s);
        writer.scalar(self.num_keyframes);
        writer.scalar(self.keyframe_bytes);
        writer.scalar(self.num_vertices);
        writer.scalar(self.num_triangles);
        writer.scalar(self.num_charts);
        writer.scalar(self.num_pages);
        writer.scalar(self.coverage);
        writer.scalar(self.latency_s);
        writer.scalar(self.memory_bytes);
    }
}
