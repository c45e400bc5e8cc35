//! Settings of the live node alone.

use std::collections::BTreeMap;

use super::Config;
use super::parameter::ParameterError;
use crate::wire::event::MessageType;

/// How images come.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default)]
pub enum Transport {
    /// As they are published; the compressed one of two.
    #[default]
    Auto,
    /// `sensor_msgs/Image`.
    Raw,
    /// `sensor_msgs/CompressedImage`, on the topic of the transport.
    Compressed,
}

/// Quality of service that a topic is to have instead of what it would.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default)]
pub struct QosOverride {
    /// Whether what is lost is sent again.
    pub is_reliable: Option<bool>,
    /// Whether late joiners get what was published before.
    pub is_latched: Option<bool>,
    /// Messages kept, ≥ 1.
    pub depth: Option<usize>,
}

/// What peers may at most make the node hold or do. What goes beyond is refused and told.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct NodeLimits {
    /// Bytes of a message, ≥ 1.
    pub message_bytes: usize,
    /// Writers of one topic whose numbers are watched for losses, ≥ 1.
    pub writers: usize,
    /// Publishers of the node's inputs that are looked at, ≥ 1.
    pub publishers: usize,
    /// Readers of one output that are told apart, ≥ 1.
    pub readers: usize,
    /// Bytes of a request to a service, ≥ 1.
    pub request_bytes: usize,
    /// Parameters or prefixes that a request may name, ≥ 1.
    pub request_names: usize,
    /// Bytes of a path given to `~/save` or `~/load`, ≥ 1.
    pub path_bytes: usize,
    /// HTTP requests that are answered at once, ≥ 1.
    pub http_clients: usize,
    /// Bytes of an HTTP request's head, ≥ 1.
    pub http_request_bytes: usize,
    /// Seconds that an HTTP client may be silent, > 0.
    pub http_silence_s: u32,
}

impl Default for NodeLimits {
    fn default() -> Self {
        Self {
            message_bytes: 128_000_000,
            writers: 64,
            publishers: 1000,
            readers: 100,
            request_bytes: 65_536,
            request_names: 2000,
            path_bytes: 1000,
            http_clients: 8,
            http_request_bytes: 8192,
            http_silence_s: 10,
        }
    }
}

/// Settings of the live node.
#[derive(Clone, Debug, PartialEq)]
pub struct NodeParams {
    /// Whether time comes from `/clock`.
    pub use_sim_time: bool,
    /// Whether the node configures and activates itself at start.
    pub autostart: bool,
    /// How colour images come.
    pub image_transport: Transport,
    /// How depth images come.
    pub depth_transport: Transport,
    /// The type of the mesh topic; `None`: as it is published.
    pub mesh_type: Option<MessageType>,
    /// Bytes that may wait to be decoded, MB (10⁶ bytes), > 0.
    pub queue_mb: f64,
    /// Seconds of silence after which images that wait for a partner or a pose are given up on,
    /// > 0.
    pub idle_flush_s: f64,
    /// Least time between the starts of two paintings, seconds, ≥ 0.
    pub paint_period_s: f64,
    /// Least steps of the optimisation that `~/refine` asks for.
    pub refine_steps: usize,
    /// Bytes published in a second at most, all topics together, MB (10⁶ bytes), > 0.
    pub publish_rate_mb: f64,
    /// Messages that each output keeps for late joiners and for readers that lag, ≥ 1.
    pub publish_depth: usize,
    /// Time between two diagnostics, seconds, > 0.
    pub diagnostics_period_s: f64,
    /// Where the journal of the scan is; `None`: none is kept.
    pub journal_path: Option<String>,
    /// Least time between two meshes in the journal, seconds, ≥ 0.
    pub journal_mesh_period_s: f64,
    /// The folder that `~/save` and `~/load` are confined to.
    pub save_folder: Option<String>,
    /// What is saved when the process is told to stop; `None`: nothing.
    pub save_on_shutdown: Option<String>,
    /// Port of the HTTP server; 0: none.
    pub http_port: u32,
    /// Address that the HTTP server listens on; `None`: this host only.
    pub http_address: Option<String>,
    /// What peers may at most make the node hold or do.
    pub limits: NodeLimits,
    /// Quality of service by topic.
    pub qos_overrides: BTreeMap<String, QosOverride>,
}

impl Default for NodeParams {
    fn default() -> Self {
        Self {
            use_sim_time: false,
            autostart: true,
            image_transport: Transport::Auto,
            depth_transport: Transport::Auto,
            mesh_type: None,
            queue_mb: 256.0,
            idle_flush_s: 2.0,
            paint_period_s: 1.0,
            refine_steps: 200,
            publish_rate_mb: 10.0,
            publish_depth: 256,
            diagnostics_period_s: 1.0,
            journal_path: None,
            journal_mesh_period_s: 2.0,
            save_folder: None,
            save_on_shutdown: None,
            http_port: 0,
            http_address: None,
            limits: NodeLimits::default(),
            qos_overrides: BTreeMap::new(),
        }
    }
}

/// What the names of quality of service settings start with.
pub(super) const QOS_PREFIX: &str = "qos_overrides.";

/// Words for the range of such a setting.
const QOS_RANGE: &str = "qos_overrides./TOPIC.subscription.reliability (reliable | best_effort), \
                         .durability (transient_local | volatile) or .depth (5 ..= 1000)";

/// Sets `qos_overrides.TOPIC.subscription.POLICY`; `name` is without the prefix.
pub(super) fn set_qos(config: &mut Config, name: &str, value: &str) -> Result<(), ParameterError> {
    let refuse = || ParameterError::Type {
        name: "qos_overrides",
        expected: QOS_RANGE.to_owned(),
        value: format!("{name} = {value}"),
    };
    let (rest, policy) = name.rsplit_once('.').ok_or_else(refuse)?;
    let topic = rest.strip_suffix(".subscription").ok_or_else(refuse)?;
    let entry = config
        .node
        .qos_overrides
        .entry(topic.to_owned())
        .or_default();
    match (policy, value.trim()) {
        ("reliability", "reliable") => entry.is_reliable = Some(true),
        ("reliability", "best_effort") => entry.is_reliable = Some(false),
        ("durability", "transient_local") => entry.is_latched = Some(true),
        ("durability", "volatile") => entry.is_latched = Some(false),
        // Depths below 5 lose what a frame's fragments crowd out.
        ("depth", depth) => {
            let depth = depth.parse().ok().filter(|d| (5..=1000).contains(d));
            entry.depth = Some(depth.ok_or_else(refuse)?);
        }
        ("history", "keep_last") => {}
        _ => return Err(refuse()),
    }
    Ok(())
}

/// Types of the mesh topic by the word that chooses them.
const MESH_TYPES: [(&str, MessageType); 6] = [
    ("veneer/MeshUpdate", MessageType::MeshUpdate),
    (
        "mesh_msgs/MeshGeometryStamped",
        MessageType::MeshGeometryStamped,
    ),
    ("nvblox_msgs/Mesh", MessageType::NvbloxMesh),
    ("shape_msgs/Mesh", MessageType::ShapeMesh),
    ("visualization_msgs/Marker", MessageType::Marker),
    ("visualization_msgs/MarkerArray", MessageType::MarkerArray),
];

/// Words that [`set_mesh_type`] takes.
pub(super) const MESH_TYPE_WORDS: &[&str] = &[
    "auto",
    MESH_TYPES[0].0,
    MESH_TYPES[1].0,
    MESH_TYPES[2].0,
    MESH_TYPES[3].0,
    MESH_TYPES[4].0,
    MESH_TYPES[5].0,
];

pub(super) fn set_mesh_type(config: &mut Config, word: &str) {
    let found = MESH_TYPES.iter().find(|(name, _)| *name == word);
    config.node.mesh_type = found.map(|(_, message_type)| *message_type);
}

pub(super) fn mesh_type(config: &Config) -> &'static str {
    let chosen = config.node.mesh_type;
    let found = MESH_TYPES.iter().find(|(_, t)| Some(*t) == chosen);
    found.map_or("auto", |(name, _)| name)
}

/// Words that [`set_image_transport`] takes.
pub(super) const TRANSPORT_WORDS: &[&str] = &["auto", "raw", "compressed"];

fn transport(word: &str) -> Transport {
    match word {
        "raw" => Transport::Raw,
        "compressed" => Transport::Compressed,
        _ => Transport::Auto,
    }
}

fn transport_word(transport: Transport) -> &'static str {
    match transport {
        Transport::Auto => "auto",
        Transport::Raw => "raw",
        Transport::Compressed => "compressed",
    }
}

pub(super) fn set_image_transport(config: &mut Config, word: &str) {
    config.node.image_transport = transport(word);
}

pub(super) fn image_transport(config: &Config) -> &'static str {
    transport_word(config.node.image_transport)
}

pub(super) fn set_depth_transport(config: &mut Config, word: &str) {
    config.node.depth_transport = transport(word);
}

pub(super) fn depth_transport(config: &Config) -> &'static str {
    transport_word(config.node.depth_transport)
}

pub(super) fn set_memory_budget(config: &mut Config, text: &str) -> Option<()> {
    let budget_mb: f64 = text.parse().ok()?;
    if budget_mb != 0.0 && !(128.0..=1e6).contains(&budget_mb) {
        return None;
    }
    config.pipeline.memory.budget_mb = budget_mb;
    Some(())
}

pub(super) fn memory_budget(config: &Config) -> String {
    config.pipeline.memory.budget_mb.to_string()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn quality_of_service_is_set_by_topic() {
        let mut config = Config::default();
        for (name, value) in [
            ("qos_overrides./tf.subscription.reliability", "best_effort"),
            ("qos_overrides./tf.subscription.depth", "50"),
            ("qos_overrides./a/mesh.subscription.durability", "volatile"),
        ] {
            config.set(name, value).unwrap();
        }
        let tf = config.node.qos_overrides["/tf"];
        assert_eq!((tf.is_reliable, tf.depth), (Some(false), Some(50)));
        assert_eq!(config.node.qos_overrides["/a/mesh"].is_latched, Some(false));
        for (name, value) in [
            ("qos_overrides./tf.subscription.depth", "4"),
            ("qos_overrides./tf.subscription.depth", "many"),
            ("qos_overrides./tf.subscription.reliability", "maybe"),
            ("qos_overrides./tf.reliability", "reliable"),
            ("qos_overrides.reliability", "reliable"),
        ] {
            assert!(config.set(name, value).is_err(), "{name}");
        }
    }

    #[test]
    fn every_mesh_type_has_its_word() {
        let mut config = Config::default();
        for word in MESH_TYPE_WORDS {
            set_mesh_type(&mut config, word);
            assert_eq!(mesh_type(&config), *word);
        }
    }
}
