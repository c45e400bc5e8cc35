//! A live node, its real ROS 2 peers, and a domain of their own on 127.0.0.1.

use std::fs::File;
use std::io::{BufRead, BufReader};
use std::path::{Path, PathBuf};
use std::process::{Child, ChildStdin, Command, Stdio};
use std::sync::atomic::{AtomicU32, Ordering};
use std::sync::mpsc::{Receiver, RecvTimeoutError, channel};
use std::time::{Duration, Instant};

use serde_json::Value;

use crate::{interfaces, python};

/// What rclpy is made of, without the distribution's prefix.
const ROS_PACKAGES: [&str; 12] = [
    "rclpy",
    "rmw-fastrtps-cpp",
    "sensor-msgs",
    "visualization-msgs",
    "std-srvs",
    "nav-msgs",
    "shape-msgs",
    "geometry-msgs",
    "diagnostic-msgs",
    "lifecycle-msgs",
    "rosgraph-msgs",
    "rcl-interfaces",
];
/// What reads bags.
const BAG_PACKAGES: [&str; 4] = ["numpy", "mcap", "mcap-ros2-support==0.6.0", "lz4"];

/// Tests of several processes run at once; each test takes a domain that others hardly take.
pub(crate) fn free_domain() -> u16 {
    static NEXT: AtomicU32 = AtomicU32::new(0);
    let number = std::process::id() * 7 + NEXT.fetch_add(1, Ordering::Relaxed);
    u16::try_from(100 + number % 130).unwrap()
}

/// A domain on this host, and an interpreter with rclpy.
#[derive(Clone)]
pub(crate) struct Rig {
    python: PathBuf,
    /// What Python needs to find more than its own packages.
    environment: Vec<(&'static str, String)>,
    /// The network namespace in which all runs, if not this process'.
    namespace: Option<String>,
    pub(crate) domain: u16,
}

impl Rig {
    /// With rclpy of Jazzy.
    pub(crate) fn new() -> Option<Self> {
        Self::of("jazzy")
    }

    /// With rclpy of a distribution; `None`, said aloud, where pip cannot reach the packages.
    pub(crate) fn of(distribution: &str) -> Option<Self> {
        let ros = ROS_PACKAGES.map(|name| format!("ros-{distribution}-{name}"));
        let packages = ros.iter().map(String::as_str).chain(BAG_PACKAGES);
        let packages: Vec<&str> = packages.collect();
        Some(Self {
            python: python::venv(&format!("{distribution}-live"), &packages)?,
            environment: Vec::new(),
            namespace: None,
            domain: free_domain(),
        })
    }

    /// Peers in the same domain that know our own messages, built by the real rosidl, and few
    /// others.
    pub(crate) fn with_our_messages(&self) -> Option<Self> {
        let (python, environment) = interfaces::rosidl_python()?;
        Some(Self {
            python,
            environment,
            ..self.clone()
        })
    }

    /// Peers that are reached over the loopback alone, by the profile that the docs have.
    pub(crate) fn on_loopback(&self) -> Self {
        let profile = Path::new(env!("CARGO_MANIFEST_DIR")).join("docs/fastdds_loopback.xml");
        let profile = profile.to_str().unwrap().to_owned();
        Self {
            environment: vec![
                ("FASTRTPS_DEFAULT_PROFILES_FILE", profile),
                // With LOCALHOST, rmw would choose the addresses itself.
                ("ROS_AUTOMATIC_DISCOVERY_RANGE", "SUBNET".to_owned()),
            ],
            ..self.clone()
        }
    }

    /// The same on the subnet of a network namespace.
    pub(crate) fn within(&self, namespace: &str) -> Self {
        Self {
            environment: vec![("ROS_AUTOMATIC_DISCOVERY_RANGE", "SUBNET".to_owned())],
            namespace: Some(namespace.to_owned()),
            ..self.clone()
        }
    }

    /// What runs a program where the rig is, kept to its domain.
    fn command(&self, program: &Path) -> Command {
        let mut command = match &self.namespace {
            None => Command::new(program),
            Some(namespace) => {
                let mut command = Command::new("ip");
                command.args(["netns", "exec", namespace]).arg(program);
                command
            }
        };
        keep_to(self.domain, &mut command);
        command
    }

    /// `veneer node --ros-args ARGS…` in this domain; its log goes to `dir`.
    pub(crate) fn node(&self, dir: &Path, args: &[&str]) -> LiveNode {
        self.node_with(dir, args, &[])
    }

    /// The same with more in its environment.
    pub(crate) fn node_with(
        &self,
        dir: &Path,
        args: &[&str],
        environment: &[(&str, &str)],
    ) -> LiveNode {
        let mut command = self.command(Path::new(env!("CARGO_BIN_EXE_veneer")));
        if self.namespace.is_some() {
            command.env("ROS_AUTOMATIC_DISCOVERY_RANGE", "SUBNET");
        }
        started(command.envs(environment.iter().copied()), dir, args)
    }

    /// A peer of `live_peer.py`.
    pub(crate) fn peer(&self, args: &[&str]) -> Peer {
        let environment = self.environment.iter();
        let environment: Vec<_> = environment.map(|(n, value)| (*n, value.as_str())).collect();
        let script = Path::new("tests/all/live_peer.py");
        self.other_peer(&self.python, script, args, &environment)
    }

    /// A peer of another script, below the checkout, and interpreter.
    pub(crate) fn other_peer(
        &self,
        python: &Path,
        script: &Path,
        args: &[&str],
        environment: &[(&str, &str)],
    ) -> Peer {
        let mut command = self.command(python);
        let mut child = command
            .envs(environment.iter().copied())
            .arg(Path::new(env!("CARGO_MANIFEST_DIR")).join(script))
            .args(args)
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .stderr(Stdio::inherit())
            .spawn()
            .unwrap();
        let stdout = BufReader::new(child.stdout.take().unwrap());
        let (sender, lines) = channel();
        std::thread::spawn(move || {
            for line in stdout.lines().map_while(Result::ok) {
                if sender.send(line).is_err() {
                    break;
                }
            }
        });
        Peer {
            stdin: child.stdin.take(),
            child,
            lines,
        }
    }

    /// Calls a service and gives its response.
    pub(crate) fn call(&self, service: &str, type_name: &str, request: &str) -> Value {
        let said = self.peer(&["call", service, type_name, request]).next();
        said.get("response")
            .unwrap_or_else(|| panic!("{service}: {said}"))
            .clone()
    }

    /// The next diagnostics: for each part its level, message and values.
    pub(crate) fn diagnostics(&self) -> Diagnostics {
        let args = [
            "take",
            "/diagnostics",
            "diagnostic_msgs/msg/DiagnosticArray",
        ];
        let said = self.peer(&args).next();
        Diagnostics(said["messages"][0]["status"].clone())
    }
}

/// Keeps a process to a domain on this host.
fn keep_to(domain: u16, command: &mut Command) {
    command
        .env("ROS_DOMAIN_ID", domain.to_string())
        .env("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
        .env_remove("ROS_LOCALHOST_ONLY")
        .env_remove("ROS_STATIC_PEERS");
}

/// `veneer node --ros-args ARGS…` in a domain on this host; its log goes to `dir`.
pub(crate) fn node_in(domain: u16, dir: &Path, args: &[&str]) -> LiveNode {
    let mut command = Command::new(env!("CARGO_BIN_EXE_veneer"));
    keep_to(domain, &mut command);
    started(&mut command, dir, args)
}

fn started(command: &mut Command, dir: &Path, args: &[&str]) -> LiveNode {
    let log = dir.join("node.log");
    command
        .args(["node", "--ros-args"])
        .args(args)
        .current_dir(dir)
        .stdin(Stdio::null())
        .stdout(Stdio::null())
        .stderr(File::create(&log).unwrap());
    LiveNode {
        child: Some(command.spawn().unwrap()),
        log,
    }
}

/// One message of `/diagnostics`.
#[derive(Debug)]
pub(crate) struct Diagnostics(Value);

impl Diagnostics {
    fn part(&self, part: &str) -> Option<&Value> {
        let mut parts = self.0.as_array()?.iter();
        parts.find(|status| status["name"].as_str().unwrap().ends_with(part))
    }

    pub(crate) fn message(&self, part: &str) -> String {
        let found = self.part(part);
        found.map_or_else(String::new, |s| s["message"].as_str().unwrap().to_owned())
    }

    pub(crate) fn value(&self, part: &str, key: &str) -> Option<String> {
        let values = self.part(part)?["values"].as_array()?;
        let found = values.iter().find(|value| value["key"] == key)?;
        Some(found["value"].as_str()?.to_owned())
    }

    pub(crate) fn number(&self, part: &str, key: &str) -> u64 {
        let value = self.value(part, key);
        value.map_or(0, |text| text.parse().unwrap())
    }
}

/// A running `veneer node`.
pub(crate) struct LiveNode {
    child: Option<Child>,
    log: PathBuf,
}

impl LiveNode {
    pub(crate) fn is_running(&mut self) -> bool {
        let child = self.child.as_mut().unwrap();
        child.try_wait().unwrap().is_none()
    }

    pub(crate) fn log(&self) -> String {
        std::fs::read_to_string(&self.log).unwrap()
    }

    /// Sends a signal and waits for the end: whether it was a success, and how long it took.
    pub(crate) fn end(mut self, signal: &str) -> (bool, Duration) {
        let mut child = self.child.take().unwrap();
        let begun = Instant::now();
        send_signal(child.id(), signal);
        while begun.elapsed() < Duration::from_secs(20) {
            if let Some(status) = child.try_wait().unwrap() {
                return (status.success(), begun.elapsed());
            }
            std::thread::sleep(Duration::from_millis(5));
        }
        child.kill().unwrap();
        child.wait().unwrap();
        panic!("the node did not end:\n{}", self.log());
    }
}

impl Drop for LiveNode {
    fn drop(&mut self) {
        if let Some(mut child) = self.child.take() {
            child.kill().ok();
            child.wait().ok();
            if std::thread::panicking() {
                eprintln!("{}", self.log());
            }
        }
    }
}

/// Sends a signal by the system's own command.
pub(crate) fn send_signal(pid: u32, signal: &str) {
    let status = Command::new("kill")
        .args([format!("-{signal}"), pid.to_string()])
        .status();
    assert!(status.unwrap().success(), "kill -{signal} {pid}");
}

/// A Python process that says JSON.
pub(crate) struct Peer {
    child: Child,
    stdin: Option<ChildStdin>,
    lines: Receiver<String>,
}

impl Peer {
    pub(crate) fn pid(&self) -> u32 {
        self.child.id()
    }

    /// What it says next.
    pub(crate) fn next(&mut self) -> Value {
        loop {
            match self.lines.recv_timeout(Duration::from_secs(60)) {
                Ok(line) => match serde_json::from_str(&line) {
                    Ok(said) => return said,
                    // DDS libraries complain on the same channel.
                    Err(_) => eprintln!("a peer's library: {line}"),
                },
                Err(RecvTimeoutError::Timeout) => panic!("a peer says nothing"),
                Err(RecvTimeoutError::Disconnected) => panic!("a peer ended without a word"),
            }
        }
    }

    /// Whether it says nothing for so long; what it said is gone.
    pub(crate) fn is_silent_for(&mut self, time: Duration) -> bool {
        let said = self.lines.recv_timeout(time);
        matches!(said, Err(RecvTimeoutError::Timeout))
    }

    /// Tells it to stop, and gives the last thing it says.
    pub(crate) fn stop(mut self) -> Value {
        self.stdin = None;
        let mut last = Value::Null;
        while let Ok(line) = self.lines.recv_timeout(Duration::from_secs(20)) {
            last = serde_json::from_str(&line).unwrap_or(last);
        }
        last
    }
}

impl Drop for Peer {
    fn drop(&mut self) {
        self.child.kill().ok();
        self.child.wait().ok();
    }
}

/// The body of a GET on this host, and the status line.
pub(crate) fn http_get(port: u16, path: &str) -> (String, Vec<u8>) {
    use std::io::{Read, Write};

    let mut stream = std::net::TcpStream::connect(("127.0.0.1", port)).unwrap();
    write!(stream, "GET {path} HTTP/1.1\r\nHost: here\r\n\r\n").unwrap();
    let mut answer = Vec::new();
    stream.read_to_end(&mut answer).unwrap();
    let end = answer.windows(4).position(|w| w == b"\r\n\r\n").unwrap();
    let head = String::from_utf8(answer[..end].to_vec()).unwrap();
    let status = head.lines().next().unwrap().to_owned();
    (status, answer[end + 4..].to_vec())
}

/// A port that is free now.
pub(crate) fn free_port() -> u16 {
    let listener = std::net::TcpListener::bind(("127.0.0.1", 0)).unwrap();
    listener.local_addr().unwrap().port()
}
