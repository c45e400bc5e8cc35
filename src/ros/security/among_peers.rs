//! The node with keys among peers with the same keystore, with another, and without one.
//!
//! Keystores are made by `scripts/keystore.sh`, by openssl(1), as `ros2 security` lays them out.

use std::path::Path;
use std::process::Command;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::time::{Duration, Instant};

use futures::StreamExt;
use ros2_client::Context;
use rustdds::bytes::Bytes;

use super::{Asked, Security};
use crate::config::Config;
use crate::ros::args::RosArgs;
use crate::ros::env::Network;
use crate::ros::node::{self, NodeSetup};
use crate::ros::transport::{self, DdsTopic, RawReader, RawWriter, TopicQos};
use crate::wire::{DiagnosticArray, Message};

const RELIABLE: TopicQos = TopicQos {
    is_reliable: true,
    is_latched: false,
    depth: 10,
};

fn network(domain_id: u16) -> Network {
    Network {
        domain_id,
        interfaces: vec![std::net::Ipv4Addr::LOCALHOST],
        ..Network::default()
    }
}

/// A domain that other tests of this host hardly take.
fn free_domain() -> u16 {
    u16::try_from(100 + std::process::id() * 7 % 130).unwrap()
}

/// A keystore for `domain_id` with these enclaves; `false`, said aloud, where openssl is missing.
#[expect(clippy::print_stderr, reason = "a skipped test must be seen")]
fn make_keystore(folder: &Path, domain_id: u16, enclaves: &[&str]) -> bool {
    if Command::new("openssl").arg("version").output().is_err() {
        eprintln!("SKIPPED: no openssl");
        return false;
    }
    let made = Command::new("bash")
        .arg(Path::new(env!("CARGO_MANIFEST_DIR")).join("scripts/keystore.sh"))
        .arg(folder)
        .args(enclaves)
        .env("ROS_DOMAIN_ID", domain_id.to_string())
        .output()
        .unwrap();
    let said = String::from_utf8_lossy(&made.stderr);
    assert!(made.status.success(), "{said}");
    true
}

fn keys(keystore: &Path, enclave: &str) -> Security {
    let get = |name: &str| match name {
        "ROS_SECURITY_ENABLE" => Some("true".to_owned()),
        "ROS_SECURITY_STRATEGY" => Some("Enforce".to_owned()),
        "ROS_SECURITY_KEYSTORE" => Some(keystore.to_str().unwrap().to_owned()),
        _ => None,
    };
    match Security::from_variables(get, Some(enclave)).unwrap() {
        Asked::Keys(security) => security,
        other => panic!("{other:?}"),
    }
}

/// Runs the node until it is dropped.
struct Running {
    stop: smol::channel::Sender<()>,
    thread: Option<std::thread::JoinHandle<()>>,
}

impl Running {
    fn start(domain_id: u16, security: Option<Security>) -> Self {
        let (stop, word) = smol::channel::bounded(1);
        let setup = NodeSetup {
            config: Config::default(),
            names: RosArgs::default().resolver("veneer").unwrap(),
            network: network(domain_id),
            security,
            log_lines: None,
        };
        let thread = std::thread::spawn(move || node::run(&setup, &word).unwrap());
        Self {
            stop,
            thread: Some(thread),
        }
    }
}

impl Drop for Running {
    fn drop(&mut self) {
        self.stop.close();
        if let Some(thread) = self.thread.take() {
            assert!(thread.join().is_ok() || std::thread::panicking());
        }
    }
}

/// Publishes camera infos, and listens to the node's diagnostics.
struct Peer {
    context: Context,
    heard: Arc<AtomicUsize>,
    last: Arc<std::sync::Mutex<Vec<u8>>>,
    stop: Arc<AtomicBool>,
    thread: Option<std::thread::JoinHandle<()>>,
}

impl Peer {
    fn new(domain_id: u16, security: Option<&Security>, image_info: &'static str) -> Self {
        let participant = transport::participant(&network(domain_id), security).unwrap();
        let context = Context::from_domain_participant(participant).unwrap();
        let diagnostics = DdsTopic::message("/diagnostics", DiagnosticArray::TYPE_NAME);
        let reader = RawReader::new(&context, &diagnostics, RELIABLE).unwrap();
        let info = DdsTopic::message(image_info, "sensor_msgs/msg/CameraInfo");
        let writer = RawWriter::new(&context, &info, RELIABLE).unwrap();
        let (heard, stop) = (Arc::new(AtomicUsize::new(0)), Arc::default());
        let last = Arc::default();
        let thread = std::thread::spawn({
            let (heard, stop) = (Arc::clone(&heard), Arc::<AtomicBool>::clone(&stop));
            let last = Arc::<std::sync::Mutex<Vec<u8>>>::clone(&last);
            move || {
                smol::block_on(async {
                    let mut samples = Box::pin(reader.samples());
                    while !stop.load(Ordering::Relaxed) {
                        // What is in it does not matter: that it comes is counted.
                        drop(writer.write(Bytes::from_static(&[0, 1, 0, 0, 7, 0, 0, 0])));
                        let wait = smol::Timer::after(Duration::from_millis(100));
                        let next = futures::future::select(samples.next(), wait).await;
                        if let futures::future::Either::Left((Some(Ok(sample)), _)) = next {
                            heard.fetch_add(1, Ordering::Relaxed);
                            *last.lock().unwrap() = sample.bytes;
                        }
                    }
                });
            }
        });
        Self {
            context,
            heard,
            last,
            stop,
            thread: Some(thread),
        }
    }

    fn num_heard(&self) -> usize {
        self.heard.load(Ordering::Relaxed)
    }

    /// Writers of others that it knows of on the node's topics.
    fn num_discovered(&self) -> usize {
        let writers = self.context.domain_participant().discovered_writers();
        let topics = writers
            .iter()
            .map(|w| w.publication_topic_data.topic_name());
        topics
            .filter(|topic| *topic == "rt/diagnostics" || topic.starts_with("rt/veneer/"))
            .count()
    }

    /// A number from the last diagnostics that it heard.
    fn number(&self, key: &str) -> u64 {
        let bytes = self.last.lock().unwrap();
        let Ok(array) = DiagnosticArray::decode(&bytes) else {
            return 0;
        };
        let mut values = array.status.iter().flat_map(|status| &status.values);
        let found = values.find(|(name, _)| *name == key);
        found.map_or(0, |(_, value)| value.parse().unwrap())
    }
}

impl Drop for Peer {
    fn drop(&mut self) {
        self.stop.store(true, Ordering::Relaxed);
        if let Some(thread) = self.thread.take() {
            thread.join().ok();
        }
    }
}

#[test]
fn peers_with_keys_hear_each_other_and_no_one_else_does() {
    let dir = tempfile::tempdir().unwrap();
    let domain_id = free_domain();
    let (ours, theirs) = (dir.path().join("ours"), dir.path().join("theirs"));
    if !make_keystore(&ours, domain_id, &["/robot/veneer", "/camera"])
        || !make_keystore(&theirs, domain_id, &["/camera"])
    {
        return;
    }
    let _node = Running::start(domain_id, Some(keys(&ours, "/robot/veneer")));
    let (ours, theirs) = (keys(&ours, "/camera"), keys(&theirs, "/camera"));
    let friend = Peer::new(domain_id, Some(&ours), "/rgb/camera_info");
    let foreigner = Peer::new(domain_id, Some(&theirs), "/depth/camera_info");
    let stranger = Peer::new(domain_id, None, "/depth/camera_info");
    let deadline = Instant::now() + Duration::from_secs(60);
    while friend.num_heard() < 5 || friend.number("/rgb/camera_info received") < 10 {
        assert!(
            Instant::now() < deadline,
            "the friend heard {} diagnostics, the node {} of its messages",
            friend.num_heard(),
            friend.number("/rgb/camera_info received")
        );
        std::thread::sleep(Duration::from_millis(100));
    }
    assert!(friend.num_discovered() > 3, "{}", friend.num_discovered());
    for (who, peer) in [("foreigner", &foreigner), ("stranger", &stranger)] {
        assert_eq!((peer.num_heard(), peer.num_discovered()), (0, 0), "{who}");
    }
    assert_eq!(friend.number("/depth/camera_info received"), 0);
    assert_eq!(friend.number("/depth/camera_info publishers"), 0);
}

#[test]
fn keys_that_do_not_fit_are_refused_with_the_reason() {
    let dir = tempfile::tempdir().unwrap();
    let domain_id = free_domain();
    let (ours, theirs) = (dir.path().join("ours"), dir.path().join("theirs"));
    if !make_keystore(&ours, domain_id, &["/veneer"])
        || !make_keystore(&theirs, domain_id, &["/veneer"])
    {
        return;
    }
    let good = keys(&ours, "/veneer");
    let refusal = |domain_id, security: &Security| {
        let made = transport::participant(&network(domain_id), Some(security));
        made.err().unwrap().to_string()
    };
    let words = refusal(domain_id + 1, &good);
    assert!(words.contains("domain"), "{words}");
    for (file, reason) in [
        ("cert.pem", "identity"),
        ("permissions.p7s", "permissions"),
        ("governance.p7s", "permissions"),
    ] {
        let mixed = dir.path().join("mixed/enclaves");
        std::fs::create_dir_all(&mixed).unwrap();
        for entry in std::fs::read_dir(good.enclave_folder()).unwrap() {
            let path = entry.unwrap().path();
            std::fs::copy(&path, mixed.join(path.file_name().unwrap())).unwrap();
        }
        let other = theirs.join("enclaves/veneer").join(file);
        std::fs::copy(other, mixed.join(file)).unwrap();
        let words = refusal(domain_id, &keys(&dir.path().join("mixed"), "/"));
        assert!(words.contains(reason), "{file}: {words}");
        assert!(words.contains(mixed.to_str().unwrap()), "{file}: {words}");
    }
}
