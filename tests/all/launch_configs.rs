//! Every launch file and parameter file in `launch_configs/`: well formed, with names that veneer knows
//! and values that it takes.

#![expect(clippy::unwrap_used, reason = "a test may panic")]

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use veneer::config::{Config, params_file};

const RIGS: [&str; 6] = [
    "realsense",
    "oak_d",
    "zed",
    "azure_kinect",
    "orbbec",
    "iphone",
];
const MESH_SOURCES: [&str; 2] = ["nvblox", "mesh"];

fn folder() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("launch_configs")
}

fn files_in(folder: &Path) -> Vec<String> {
    let entries = std::fs::read_dir(folder).unwrap().map(|e| e.unwrap());
    let files = entries.filter(|entry| entry.path().is_file());
    let mut names: Vec<String> = files
        .map(|entry| entry.file_name().into_string().unwrap())
        .collect();
    names.sort();
    names
}

/// An element of an XML file.
#[derive(Debug, Default)]
struct Element {
    name: String,
    attributes: BTreeMap<String, String>,
    children: Vec<Element>,
}

impl Element {
    fn get(&self, attribute: &str) -> &str {
        let value = self.attributes.get(attribute);
        value.unwrap_or_else(|| panic!("<{}> without {attribute}", self.name))
    }

    fn all<'a>(&'a self, name: &str, out: &mut Vec<&'a Element>) {
        for child in &self.children {
            if child.name == name {
                out.push(child);
            }
            child.all(name, out);
        }
    }

    fn named(&self, name: &str) -> Vec<&Element> {
        let mut found = Vec::new();
        self.all(name, &mut found);
        found
    }
}

/// The attributes of a tag; values must be quoted and free of what XML escapes.
fn attributes(mut text: &str) -> BTreeMap<String, String> {
    let mut attributes = BTreeMap::new();
    loop {
        text = text.trim_start();
        if text.is_empty() {
            return attributes;
        }
        let (name, rest) = text.split_once("=\"").unwrap();
        let (value, rest) = rest.split_once('"').unwrap();
        assert!(!name.contains(char::is_whitespace), "{name}");
        assert!(!value.contains(['<', '&']), "{value}");
        let was = attributes.insert(name.to_owned(), value.to_owned());
        assert!(was.is_none(), "{name} twice");
        text = rest;
    }
}

/// The root element of the part of XML that launch files need: elements, attributes, comments.
fn parse_xml(text: &str) -> Element {
    let mut rest = text.strip_prefix("<?xml version=\"1.0\"?>").unwrap();
    let mut open = vec![Element::default()];
    while let Some((between, tag)) = rest.split_once('<') {
        assert_eq!(between.trim(), "", "text between elements");
        if let Some(comment) = tag.strip_prefix("!--") {
            rest = comment.split_once("-->").unwrap().1;
            continue;
        }
        let (tag, after) = tag.split_once('>').unwrap();
        rest = after;
        if let Some(name) = tag.strip_prefix('/') {
            let element = open.pop().unwrap();
            assert_eq!(element.name, name);
            open.last_mut().unwrap().children.push(element);
            continue;
        }
        let (tag, is_empty) = match tag.strip_suffix('/') {
            Some(tag) => (tag, true),
            None => (tag, false),
        };
        let (name, text) = tag.split_once(char::is_whitespace).unwrap_or((tag, ""));
        let element = Element {
            name: name.to_owned(),
            attributes: attributes(text),
            children: Vec::new(),
        };
        if is_empty {
            open.last_mut().unwrap().children.push(element);
        } else {
            open.push(element);
        }
    }
    assert_eq!(rest.trim(), "");
    let mut document = open.pop().unwrap();
    assert!(open.is_empty(), "<{}> is not closed", document.name);
    assert_eq!(document.children.len(), 1);
    document.children.remove(0)
}

/// Names within `$(var NAME)`.
fn variables(text: &str) -> Vec<&str> {
    let parts = text.split("$(var ").skip(1);
    parts.map(|part| part.split_once(')').unwrap().0).collect()
}

fn launch_file(name: &str) -> Element {
    let text = std::fs::read_to_string(folder().join(name)).unwrap();
    let launch = parse_xml(&text);
    assert_eq!(launch.name, "launch");
    launch
}

fn node<'a>(launch: &'a Element, package: &str) -> &'a Element {
    let nodes = launch.named("node");
    let mut found = nodes.into_iter().filter(|n| n.get("pkg") == package);
    let node = found.next().unwrap_or_else(|| panic!("no {package}"));
    assert!(found.next().is_none(), "two of {package}");
    node
}

fn remaps(node: &Element) -> BTreeMap<&str, &str> {
    let remaps = node.children.iter().filter(|child| child.name == "remap");
    remaps.map(|r| (r.get("from"), r.get("to"))).collect()
}

fn configured(file: &Path) -> Config {
    let text = std::fs::read_to_string(file).unwrap();
    let mut config = Config::default();
    params_file::apply(&mut config, &text, "/veneer")
        .unwrap_or_else(|error| panic!("{}: {error}", file.display()));
    config
}

#[test]
fn there_is_one_for_each_rig_and_mesh_source() {
    let mut launch: Vec<String> = RIGS
        .iter()
        .flat_map(|rig| MESH_SOURCES.map(|source| format!("{rig}_{source}.launch.xml")))
        .collect();
    launch.sort();
    assert_eq!(files_in(&folder()), launch);
    let mut params: Vec<String> = RIGS.iter().map(|rig| format!("{rig}.yaml")).collect();
    params.sort();
    assert_eq!(files_in(&folder().join("params")), params);
}

#[test]
fn parameter_files_hold_names_and_values_that_veneer_takes() {
    for name in files_in(&folder().join("params")) {
        let config = configured(&folder().join("params").join(&name));
        // Something in it is not the default, or the file would not be needed.
        let differs =
            format!("{:?}", config.pipeline) != format!("{:?}", Config::default().pipeline);
        assert!(differs, "{name}");
    }
}

#[test]
fn launch_files_start_veneer_with_topics_and_parameters_that_it_knows() {
    for name in files_in(&folder()) {
        let launch = launch_file(&name);
        let veneer = node(&launch, "veneer");
        assert_eq!((veneer.get("exec"), veneer.get("args")), ("veneer", "node"));
        let mut config = Config::default();
        for (from, to) in remaps(veneer) {
            config
                .remap(from, to)
                .unwrap_or_else(|error| panic!("{name}: {error}"));
            assert!(
                to.starts_with('/') || to.starts_with("$(var "),
                "{name}: {to}"
            );
        }
        for part in [
            "rgb/image",
            "rgb/camera_info",
            "depth/image",
            "depth/camera_info",
            "mesh",
        ] {
            assert!(remaps(veneer).contains_key(part), "{name} has no {part}");
        }
        let params: Vec<&Element> = veneer
            .children
            .iter()
            .filter(|c| c.name == "param")
            .collect();
        let files: Vec<&str> = params
            .iter()
            .filter_map(|param| param.attributes.get("from").map(String::as_str))
            .collect();
        assert_eq!(files, ["$(var params_file)"], "{name}");
        for param in params
            .iter()
            .filter(|param| param.attributes.contains_key("name"))
        {
            let (parameter, value) = (param.get("name"), param.get("value"));
            let value = value.replace("$(var map_frame)", "map");
            config
                .set(parameter, &value)
                .unwrap_or_else(|error| panic!("{name}: {error}"));
        }
    }
}

#[test]
fn arguments_are_declared_and_their_files_are_there() {
    for name in files_in(&folder()) {
        let launch = launch_file(&name);
        // Arguments of the file, not those that it passes on.
        let declared = launch.children.iter().filter(|child| child.name == "arg");
        let declared: BTreeMap<&str, &Element> = declared.map(|a| (a.get("name"), a)).collect();
        for argument in declared.values() {
            assert!(argument.get("description").len() > 10, "{name}");
        }
        let text = std::fs::read_to_string(folder().join(&name)).unwrap();
        for variable in variables(&text) {
            assert!(declared.contains_key(variable), "{name}: {variable}");
        }
        for argument in declared.keys() {
            let used = variables(&text).iter().filter(|v| *v == argument).count();
            assert!(used > 0, "{name}: nothing uses {argument}");
        }
        let file = declared["params_file"].get("default");
        let file = file.strip_prefix("$(dirname)/").unwrap();
        let rig = RIGS.iter().find(|rig| name.starts_with(*rig)).unwrap();
        assert_eq!(file, format!("params/{rig}.yaml"));
        configured(&folder().join(file));
    }
}

#[test]
fn what_veneer_reads_is_what_the_mesh_is_made_from() {
    for rig in RIGS {
        let [nvblox, mesh] = MESH_SOURCES.map(|s| launch_file(&format!("{rig}_{s}.launch.xml")));
        let cameras = [
            "rgb/image",
            "rgb/camera_info",
            "depth/image",
            "depth/camera_info",
        ];
        let ours = remaps(node(&nvblox, "veneer"));
        let theirs = remaps(node(&nvblox, "nvblox_ros"));
        for part in cameras {
            assert_eq!(ours[part], remaps(node(&mesh, "veneer"))[part], "{rig}");
            let camera = part.replacen("rgb/", "color/", 1);
            assert_eq!(
                ours[part],
                theirs[format!("camera_0/{camera}").as_str()],
                "{rig}"
            );
        }
        assert_eq!(ours["mesh"], "/nvblox_node/mesh");
        assert_eq!(node(&nvblox, "nvblox_ros").get("name"), "nvblox_node");
        // A pose topic is remapped where poses come from one, and only there.
        let file = folder().join(format!("params/{rig}.yaml"));
        let mut config = configured(&file);
        let pose_source = veneer::config::tree::PARAMETERS
            .iter()
            .find(|parameter| parameter.name == "pose_source")
            .unwrap()
            .get(&mut config);
        for launch in [&nvblox, &mesh] {
            let has_pose = remaps(node(launch, "veneer")).contains_key("pose");
            assert_eq!(has_pose, pose_source == "pose", "{rig}: {pose_source}");
        }
    }
}
