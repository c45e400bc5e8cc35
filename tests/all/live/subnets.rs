//! Peers on another subnet, which multicast does not reach. Two network namespaces of our own stand for
//! two hosts, a third for the router between them.

use std::process::Command;

use super::rig::Rig;
use crate::python;

/// Two subnets and a router.
struct Subnets {
    names: [String; 3],
}

impl Subnets {
    const HOSTS: [&str; 2] = ["10.201.1.2", "10.201.2.2"];

    /// `None`, said aloud, where namespaces cannot be made.
    #[expect(clippy::print_stderr, reason = "a skipped test must be seen")]
    fn new() -> Option<Self> {
        let id = std::process::id();
        let names = ["a", "b", "r"].map(|name| format!("veneer{id}{name}"));
        let subnets = Self { names };
        let [a, b, router] = &subnets.names;
        let mut commands = Vec::new();
        for name in [a, b, router] {
            commands.push(format!("netns add {name}"));
            commands.push(format!("-n {name} link set lo up"));
        }
        for (host, number) in [(a, 1), (b, 2)] {
            commands.extend([
                format!("link add v0 netns {host} type veth peer name v{number} netns {router}"),
                format!("-n {host} addr add 10.201.{number}.2/24 dev v0"),
                format!("-n {router} addr add 10.201.{number}.1/24 dev v{number}"),
                format!("-n {host} link set v0 up"),
                format!("-n {router} link set v{number} up"),
                format!("-n {host} route add default via 10.201.{number}.1"),
            ]);
        }
        commands.push(format!(
            "netns exec {router} sysctl -qw net.ipv4.ip_forward=1"
        ));
        for command in commands {
            let made = python::run(Command::new("ip").args(command.split(' ')));
            if let Err(reason) = made {
                eprintln!("SKIPPED: no network namespaces: {reason}");
                return None;
            }
        }
        Some(subnets)
    }
}

impl Drop for Subnets {
    fn drop(&mut self) {
        for name in &self.names {
            let mut command = Command::new("ip");
            // It may never have been made.
            command.args(["netns", "del", name]).output().ok();
        }
    }
}

#[test]
fn static_peers_on_another_subnet_find_the_node_and_are_found() {
    let Some(rig) = Rig::new() else { return };
    let Some(subnets) = Subnets::new() else {
        return;
    };
    let [here, there] = [0, 1].map(|i| rig.within(&subnets.names[i]));
    let dir = tempfile::tempdir().unwrap();
    let num_heard = |wait: &str| {
        let topic = ["/diagnostics", "diagnostic_msgs/msg/DiagnosticArray"];
        let take = [&["take"], &topic[..], &["--wait", wait]].concat();
        let said = there.peer(&take).next();
        said["messages"].as_array().unwrap().len()
    };
    let node = here.node(dir.path(), &[]);
    assert_eq!(num_heard("5"), 0, "multicast crosses the router");
    drop(node);
    // RustDDS announces every ten seconds.
    let peers = [("ROS_STATIC_PEERS", Subnets::HOSTS[1])];
    let mut node = here.node_with(dir.path(), &[], &peers);
    assert_eq!(num_heard("40"), 1, "{}", node.log());
    // And the node hears them.
    let info = ["/rgb/camera_info", "sensor_msgs/msg/CameraInfo"];
    let publish = [&["publish"], &info[..], &["--wait", "40", "00010000"]].concat();
    let mut publisher = there.peer(&publish);
    assert_eq!(publisher.next()["matched"], true, "{}", node.log());
    assert!(node.is_running());
}
