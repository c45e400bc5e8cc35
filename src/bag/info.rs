//! What a bag holds, what veneer would use of it, and what is missing: `veneer info`.
//!
//! Every message's log time is read, and every message that veneer would use is decoded as
//! `replay` would decode it, so what is refused there is refused and counted here. Rates are
//! (messages − 1) / (last − first log time); a gap is a pause longer than three times the median
//! pause. Synchrony compares sensor stamps, not log times.

use std::collections::{BTreeMap, BTreeSet};
use std::fmt;
use std::path::{Path, PathBuf};

use crate::geom::Stamp;
use crate::ingest::{Event, EventSource};
use crate::wire::TopicRole;

use super::chunk;
use super::error::BagError;
use super::mapped::MappedBag;
use super::reader::BagReader;
use super::record::{MessageHeader, op};
use super::roles::{MissingRole, PoseSource, TopicRoles, Topics};

/// What a bag holds, what veneer would use of it, and what is missing.
#[derive(Clone, Debug, PartialEq, serde::Serialize)]
pub struct BagInfo {
    /// The file or folder.
    pub path: PathBuf,
    /// Bytes of the bag's file.
    pub num_bytes: u64,
    /// Whether the bag's own summary was there and intact.
    pub has_summary: bool,
    /// Log time of the first message, seconds since the epoch.
    pub start_s: f64,
    /// Seconds from the first message to the last.
    pub duration_s: f64,
    /// All topics, by name.
    pub topics: Vec<TopicInfo>,
    /// Where the camera's pose would come from.
    pub pose_source: PoseSource,
    /// How colour and depth fit in time, if both are there.
    pub sync: Option<SyncInfo>,
    /// Parts that nobody plays, and what to do about it.
    pub missing: Vec<MissingRole>,
    /// What could not be read of the file, in words.
    pub losses: Vec<String>,
}

/// One topic.
#[derive(Clone, Debug, PartialEq, serde::Serialize)]
pub struct TopicInfo {
    /// Its name.
    pub topic: String,
    /// Type of its messages.
    pub type_name: String,
    /// The parts it would play; none = not used.
    pub roles: Vec<TopicRole>,
    /// How many messages there are.
    pub num_messages: usize,
    /// Messages per second; `None` for fewer than two.
    pub rate_hz: Option<f64>,
    /// Pauses longer than three times the median pause.
    pub num_gaps: usize,
    /// The longest pause, seconds.
    pub longest_gap_s: f64,
    /// Encoding of its images.
    pub encoding: Option<String>,
    /// Frame of its first message.
    pub frame_id: Option<String>,
    /// Messages that would be refused.
    pub num_refused: usize,
    /// Why the first of them would be.
    pub first_refusal: Option<String>,
}

/// How colour and depth fit in time: of each colour image, the nearest depth image.
#[derive(Clone, Debug, PartialEq, serde::Serialize)]
pub struct SyncInfo {
    /// Colour images.
    pub num_color: usize,
    /// Those with a depth image of the same stamp.
    pub num_exact: usize,
    /// Median distance to the nearest depth image, seconds.
    pub median_s: f64,
    /// Distance that 95 % stay under, seconds.
    pub p95_s: f64,
    /// Largest distance, seconds.
    pub max_s: f64,
}

impl BagInfo {
    /// Reads a bag from end to end.
    ///
    /// # Errors
    /// [`BagError`] when the file cannot be read or is no bag, or a topic named in `roles` is not
    /// there.
    pub fn read(path: &Path, roles: &TopicRoles) -> Result<Self, BagError> {
        let bag = MappedBag::open(path)?;
        let views = bag.topics();
        let times = log_times(&bag);
        let all = || times.values().flatten();
        let start = all().min().copied().unwrap_or(0);
        let end = all().max().copied().unwrap_or(0);
        let mut topics = topic_infos(&bag, &views, &times);
        let mut reader = BagReader::open(path, roles)?;
        for assignment in &reader.plan().assignments {
            let topic = topics.iter_mut().find(|t| t.topic == assignment.topic);
            topic
                .into_iter()
                .for_each(|t| t.roles.push(assignment.role));
        }
        let stamps = play(&mut reader, &mut topics);
        let mut missing = reader.plan().missing.clone();
        missing.extend(refused_wholly(&topics));
        Ok(Self {
            path: path.to_owned(),
            num_bytes: bag.num_bytes as u64,
            has_summary: bag.index.has_summary,
            start_s: start as f64 * 1e-9,
            duration_s: (end - start) as f64 * 1e-9,
            topics,
            pose_source: reader.plan().pose_source,
            sync: stamps.sync(),
            missing,
            losses: reader.losses().to_vec(),
        })
    }
}

/// Log times by topic, sorted.
fn log_times(bag: &MappedBag) -> BTreeMap<&str, Vec<u64>> {
    let mut by_channel: BTreeMap<u16, Vec<u64>> = BTreeMap::new();
    let mut workspace = Vec::new();
    for segment in &bag.index.segments {
        // What cannot be read is among the losses of the reader.
        let Ok(stretch) = bag.map(&segment.place) else {
            continue;
        };
        let data = chunk::unpack(&stretch, &segment.place, &mut workspace);
        for record in data.records().filter(|r| r.opcode == op::MESSAGE) {
            if let Some(message) = MessageHeader::parse(&data.bytes[record.body]) {
                let times = by_channel.entry(message.channel_id).or_default();
                times.push(message.log_time);
            }
        }
    }
    let mut by_topic: BTreeMap<&str, Vec<u64>> = BTreeMap::new();
    for (id, channel) in &bag.index.channels {
        let times = by_topic.entry(&channel.topic).or_default();
        times.extend(by_channel.remove(id).unwrap_or_default());
    }
    by_topic
        .values_mut()
        .for_each(|times| times.sort_unstable());
    by_topic
}

fn topic_infos(
    bag: &MappedBag,
    views: &Topics,
    times: &BTreeMap<&str, Vec<u64>>,
) -> Vec<TopicInfo> {
    let info = |(&topic, times): (&&str, &Vec<u64>)| {
        let mut channels = bag.index.channels.values();
        let channel = channels.find(|c| c.topic == topic);
        let peek = views.get(topic).and_then(|view| view.peek.as_ref());
        let text = |s: &String| Some(s.clone()).filter(|s| !s.is_empty());
        let pauses = Pauses::of(times);
        TopicInfo {
            topic: topic.to_owned(),
            type_name: channel.map(|c| c.type_name.clone()).unwrap_or_default(),
            roles: Vec::new(),
            num_messages: times.len(),
            rate_hz: pauses.rate_hz,
            num_gaps: pauses.num_gaps,
            longest_gap_s: pauses.longest_s,
            encoding: peek.and_then(|p| text(&p.encoding)),
            frame_id: peek.and_then(|p| text(&p.frame_id)),
            num_refused: 0,
            first_refusal: None,
        }
    };
    times.iter().map(info).collect()
}

struct Pauses {
    rate_hz: Option<f64>,
    num_gaps: usize,
    longest_s: f64,
}

impl Pauses {
    fn of(times: &[u64]) -> Self {
        let pauses: Vec<u64> = times.windows(2).map(|w| w[1] - w[0]).collect();
        let mut sorted = pauses.clone();
        sorted.sort_unstable();
        let median = sorted.get(sorted.len() / 2).copied().unwrap_or(0);
        let total_s = pauses.iter().map(|&p| p as f64).sum::<f64>() * 1e-9;
        // A burst at one time (static transforms) has no rate, and no pause stands out from it.
        let is_gap = |&&pause: &&u64| median > 0 && pause > median.saturating_mul(3);
        Self {
            rate_hz: (total_s > 0.0).then(|| pauses.len() as f64 / total_s),
            num_gaps: pauses.iter().filter(is_gap).count(),
            longest_s: sorted.last().map_or(0.0, |&p| p as f64 * 1e-9),
        }
    }
}

/// Sensor stamps of the images that are used.
#[derive(Default)]
struct ImageStamps {
    color: Vec<Stamp>,
    depth: BTreeSet<Stamp>,
}

/// Plays the bag: counts what is refused, collects the images' stamps.
fn play(reader: &mut BagReader, topics: &mut [TopicInfo]) -> ImageStamps {
    let mut stamps = ImageStamps::default();
    while let Some(timed) = reader.next_event() {
        match timed.event {
            Ok(Event::Color(header, _)) => stamps.color.push(header.stamp),
            Ok(Event::Depth(header, _)) => {
                stamps.depth.insert(header.stamp);
            }
            Ok(_) => {}
            Err(rejection) => {
                if let Some(topic) = topics.iter_mut().find(|t| t.topic == rejection.topic) {
                    topic.num_refused += 1;
                    let first = &mut topic.first_refusal;
                    first.get_or_insert_with(|| {
                        format!("{}: {}", rejection.stamp, rejection.reason)
                    });
                }
            }
        }
    }
    stamps
}

impl ImageStamps {
    fn sync(&self) -> Option<SyncInfo> {
        let nearest = |color: &Stamp| {
            let before = self.depth.range(..=*color).next_back();
            let after = self.depth.range(*color..).next();
            let distances = before.into_iter().chain(after);
            distances.map(|depth| depth.abs_diff_nanos(*color)).min()
        };
        let mut distances: Vec<u64> = self.color.iter().filter_map(nearest).collect();
        distances.sort_unstable();
        let last = distances.len().checked_sub(1)?;
        let at = |index: usize| distances[index] as f64 * 1e-9;
        Some(SyncInfo {
            num_color: distances.len(),
            num_exact: distances.iter().filter(|&&d| d == 0).count(),
            median_s: at(last / 2),
            p95_s: at(last * 95 / 100),
            max_s: at(last),
        })
    }
}

/// A topic all of whose messages are refused plays its part no better than one that is not there.
fn refused_wholly(topics: &[TopicInfo]) -> Vec<MissingRole> {
    let useless = topics
        .iter()
        .filter(|t| t.num_messages > 0 && t.num_refused >= t.num_messages);
    let missing = useless.flat_map(|topic| {
        topic.roles.iter().map(|&role| MissingRole {
            role,
            remedy: format!(
                "every message of {} is refused: {}",
                topic.topic,
                topic
                    .first_refusal
                    .as_deref()
                    .unwrap_or("no reason was given")
            ),
        })
    });
    missing.collect()
}

impl fmt::Display for BagInfo {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(
            f,
            "{}: {:.1} MB, {:.1} s{}",
            self.path.display(),
            self.num_bytes as f64 * 1e-6,
            self.duration_s,
            if self.has_summary {
                ""
            } else {
                ", without summary"
            }
        )?;
        self.topics.iter().try_for_each(|t| writeln!(f, "{t}"))?;
        let source = match self.pose_source {
            PoseSource::Pose => "a pose topic",
            PoseSource::Odom => "odometry",
            _ => "the TF tree",
        };
        writeln!(f, "\nPose from {source}.")?;
        if let Some(sync) = &self.sync {
            writeln!(f, "{sync}")?;
        }
        for loss in &self.losses {
            writeln!(f, "Lost: {loss}.")?;
        }
        if self.missing.is_empty() {
            return writeln!(f, "Nothing is missing: `veneer replay` can paint this bag.");
        }
        writeln!(f, "\nMissing:")?;
        let mut missing = self.missing.iter();
        missing.try_for_each(|m| writeln!(f, "  {}: {}", m.role.name(), m.remedy))
    }
}

impl fmt::Display for TopicInfo {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let mark = if self.roles.is_empty() { ' ' } else { '*' };
        let TopicInfo {
            topic,
            type_name,
            num_messages,
            ..
        } = self;
        write!(f, "{mark} {topic}  {type_name}  {num_messages} messages")?;
        if let Some(rate_hz) = self.rate_hz {
            write!(f, "  {rate_hz:.1} Hz")?;
        }
        if self.num_gaps > 0 {
            let (n, s) = (self.num_gaps, self.longest_gap_s);
            write!(f, "  {n} gaps, the longest {s:.2} s")?;
        }
        for detail in self.encoding.iter().chain(&self.frame_id) {
            write!(f, "  {detail}")?;
        }
        let roles: Vec<&str> = self.roles.iter().map(|role| role.name()).collect();
        if !roles.is_empty() {
            write!(f, "\n    used for {}", roles.join(" and "))?;
        }
        if let Some(reason) = &self.first_refusal {
            write!(f, "\n    {} refused, the first: {reason}", self.num_refused)?;
        }
        Ok(())
    }
}

impl fmt::Display for SyncInfo {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(
            f,
            "Colour to nearest depth: {} of {} at the same stamp; median {:.1} ms, 95 % under {:.1} ms, largest {:.1} ms.",
            self.num_exact,
            self.num_color,
            self.median_s * 1e3,
            self.p95_s * 1e3,
            self.max_s * 1e3
        )
    }
}
