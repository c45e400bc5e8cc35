//! Nodes with keys, in a keystore of the layout that `ros2 security` makes, and one without.

use std::path::{Path, PathBuf};
use std::process::Command;
use std::time::{Duration, Instant};

use super::raw_peer::RawPeer;
use super::rig::{LiveNode, free_domain, node_in};
use crate::command::{small_tabletop, veneer_ok};
use crate::python;

fn openssl(folder: &Path, args: &[&str]) {
    let run = Command::new("openssl")
        .args(args)
        .current_dir(folder)
        .output();
    let run = run.expect("openssl is there wherever the feature builds");
    let said = String::from_utf8_lossy(&run.stderr);
    assert!(run.status.success(), "openssl {args:?}: {said}");
}

const GOVERNANCE: &str = r#"<?xml version="1.0" encoding="UTF-8"?>
<dds xmlns:xsi="http://www.w3.org/2001/XMLSchema-instance" xsi:noNamespaceSchemaLocation="http://www.omg.org/spec/DDS-SECURITY/20170901/omg_shared_ca_governance.xsd">
  <domain_access_rules>
    <domain_rule>
      <domains><id_range><min>0</min><max>232</max></id_range></domains>
      <allow_unauthenticated_participants>false</allow_unauthenticated_participants>
      <enable_join_access_control>true</enable_join_access_control>
      <discovery_protection_kind>ENCRYPT</discovery_protection_kind>
      <liveliness_protection_kind>ENCRYPT</liveliness_protection_kind>
      <rtps_protection_kind>SIGN</rtps_protection_kind>
      <topic_access_rules>
        <topic_rule>
          <topic_expression>*</topic_expression>
          <enable_discovery_protection>true</enable_discovery_protection>
          <enable_liveliness_protection>true</enable_liveliness_protection>
          <enable_read_access_control>true</enable_read_access_control>
          <enable_write_access_control>true</enable_write_access_control>
          <metadata_protection_kind>ENCRYPT</metadata_protection_kind>
          <data_protection_kind>ENCRYPT</data_protection_kind>
        </topic_rule>
      </topic_access_rules>
    </domain_rule>
  </domain_access_rules>
</dds>
"#;

fn permissions(enclave: &str) -> String {
    format!(
        r#"<?xml version="1.0" encoding="UTF-8"?>
<dds xmlns:xsi="http://www.w3.org/2001/XMLSchema-instance" xsi:noNamespaceSchemaLocation="http://www.omg.org/spec/DDS-SECURITY/20170901/omg_shared_ca_permissions.xsd">
  <permissions>
    <grant name="{enclave}">
      <subject_name>CN={enclave}</subject_name>
      <validity>
        <not_before>2020-01-01T00:00:00</not_before>
        <not_after>2099-01-01T00:00:00</not_after>
      </validity>
      <allow_rule>
        <domains><id_range><min>0</min><max>232</max></id_range></domains>
        <publish><topics><topic>*</topic></topics></publish>
        <subscribe><topics><topic>*</topic></topics></subscribe>
      </allow_rule>
      <default>DENY</default>
    </grant>
  </permissions>
</dds>
"#
    )
}

/// As `ros2 security create_keystore` and `create_enclave` do: one authority for both parts, links
/// to what all enclaves share.
struct Keystore {
    root: PathBuf,
}

impl Keystore {
    fn new(root: &Path) -> Self {
        for folder in ["public", "private", "enclaves"] {
            std::fs::create_dir_all(root.join(folder)).unwrap();
        }
        let key = [
            "ecparam",
            "-name",
            "prime256v1",
            "-genkey",
            "-noout",
            "-out",
        ];
        openssl(root, &[&key[..], &["private/ca.key.pem"]].concat());
        let authority = "req -x509 -new -key private/ca.key.pem -subj /CN=sros2CA -days 3650 -out public/ca.cert.pem";
        openssl(root, &authority.split(' ').collect::<Vec<_>>());
        let keystore = Self {
            root: root.to_owned(),
        };
        for part in ["identity_ca", "permissions_ca"] {
            keystore.link("ca.cert.pem", &format!("public/{part}.cert.pem"));
            keystore.link("ca.key.pem", &format!("private/{part}.key.pem"));
        }
        std::fs::write(root.join("enclaves/governance.xml"), GOVERNANCE).unwrap();
        keystore.sign("enclaves/governance");
        keystore
    }

    fn link(&self, to: &str, from: &str) {
        std::os::unix::fs::symlink(to, self.root.join(from)).unwrap();
    }

    fn sign(&self, document: &str) {
        let (input, output) = (format!("{document}.xml"), format!("{document}.p7s"));
        let authority = ["-signer", "public/permissions_ca.cert.pem"];
        let key = ["-inkey", "private/permissions_ca.key.pem"];
        let files = ["-in", &input, "-out", &output];
        let args = [&["smime", "-sign", "-text"][..], &authority, &key, &files].concat();
        openssl(&self.root, &args);
    }

    /// Keys for the enclave `/name`.
    fn enclave(&self, name: &str) -> PathBuf {
        let folder = self.root.join("enclaves").join(name);
        std::fs::create_dir_all(&folder).unwrap();
        let below = |file: &str| format!("enclaves/{name}/{file}");
        for part in ["identity_ca", "permissions_ca"] {
            let shared = format!("../../public/{part}.cert.pem");
            self.link(&shared, &below(&format!("{part}.cert.pem")));
        }
        self.link("../governance.p7s", &below("governance.p7s"));
        let key = [
            "ecparam",
            "-name",
            "prime256v1",
            "-genkey",
            "-noout",
            "-out",
        ];
        openssl(&folder, &[&key[..], &["key.pem"]].concat());
        let subject = format!("/CN=\\/{name}");
        let request = [
            "req",
            "-new",
            "-key",
            "key.pem",
            "-subj",
            &subject,
            "-out",
            "request.pem",
        ];
        openssl(&folder, &request);
        let sign = "x509 -req -in request.pem -CA ../../public/identity_ca.cert.pem -CAkey ../../private/identity_ca.key.pem -CAcreateserial -days 3650 -out cert.pem";
        openssl(&folder, &sign.split(' ').collect::<Vec<_>>());
        std::fs::remove_file(folder.join("request.pem")).unwrap();
        std::fs::write(
            folder.join("permissions.xml"),
            permissions(&format!("/{name}")),
        )
        .unwrap();
        self.sign(&below("permissions"));
        folder
    }
}

/// A node that saves what it has when it ends.
fn node(dir: &Path, domain: u16, name: &str, keystore: Option<&Path>, args: &[&str]) -> LiveNode {
    let folder = dir.join(name);
    std::fs::create_dir(&folder).unwrap();
    let saves = format!("save.folder:={}", folder.display());
    let own = format!("__node:={name}");
    let base = [
        "-r",
        &own,
        "-p",
        &saves,
        "-p",
        "save.on_shutdown:=scan.mcap",
        "-p",
        "mesh_frame:=map",
        "-p",
        "pose_source:=pose",
    ];
    let mut environment = Vec::new();
    if let Some(keystore) = keystore {
        environment.extend([
            ("ROS_SECURITY_ENABLE", "true".to_owned()),
            ("ROS_SECURITY_STRATEGY", "Enforce".to_owned()),
            ("ROS_SECURITY_KEYSTORE", keystore.display().to_string()),
            ("ROS_SECURITY_ENCLAVE_OVERRIDE", format!("/{name}")),
        ]);
    }
    node_in(domain, &folder, &[&base[..], args].concat(), &environment)
}

/// Messages by topic in what a node saved.
fn saved(dir: &Path, name: &str) -> serde_json::Value {
    let bag = dir.join(name).join("scan.mcap");
    let said = veneer_ok(&["info", "--json", bag.to_str().unwrap()]);
    serde_json::from_str(&said).unwrap()
}

fn wait_for(what: &str, node: &LiveNode, words: &str) {
    let deadline = Instant::now() + Duration::from_secs(30);
    while !node.log().contains(words) {
        assert!(Instant::now() < deadline, "{what}: {}", node.log());
        std::thread::sleep(Duration::from_millis(100));
    }
}

#[test]
fn nodes_with_keys_hear_each_other_and_nobody_else() {
    let dir = tempfile::tempdir().unwrap();
    let bag = small_tabletop(dir.path(), &[]);
    let keystore = dir.path().join("keystore");
    let keys = Keystore::new(&keystore);
    let feeder = ["painter", "viewer", "feeder"].map(|name| keys.enclave(name))[2].clone();
    let domain = free_domain();
    let painter = node(dir.path(), domain, "painter", Some(&keystore), &[]);
    let mesh = ["-r", "mesh:=/painter/mesh_geometry"];
    let viewer = node(dir.path(), domain, "viewer", Some(&keystore), &mesh);
    let stranger = node(dir.path(), domain, "stranger", None, &mesh);
    let mut peer = RawPeer::secured(domain, &feeder);
    for (topic, input) in [
        ("/mesh", "/mesh"),
        ("/camera/color/camera_info", "/rgb/camera_info"),
        ("/camera/pose", "/pose"),
        (
            "/camera/color/image_raw/compressed",
            "/rgb/image/compressed",
        ),
    ] {
        assert!(peer.send(&bag, topic, input) > 0);
    }
    wait_for(
        "the viewer reads the painter",
        &viewer,
        "reads /painter/mesh_geometry",
    );
    std::thread::sleep(Duration::from_secs(5));
    for node in [painter, viewer, stranger] {
        node.end("TERM");
    }
    println!("{}", saved(dir.path(), "painter"));
    println!("{}", saved(dir.path(), "viewer"));
    println!("{}", dir.path().join("stranger/scan.mcap").exists());
    let _ = python::run;
}
