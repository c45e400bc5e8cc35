//! Parameters, services and lifecycle of the node, as rclpy finds and calls them.

use std::path::Path;
use std::time::Duration;

use serde_json::Value;

use super::raw_peer::RawPeer;
use super::rig::{LiveNode, Rig};
use super::{Painted, is_settled, wait_until};

const NODE: [&str; 4] = ["-r", "__ns:=/robot", "-r", "__node:=painter"];
const NAME: &str = "/robot/painter";

fn start(rig: &Rig, dir: &Path, args: &[&str]) -> LiveNode {
    rig.node(dir, &[&NODE, args].concat())
}

/// Calls a service below the node's name, of the type `package/srv/Name`.
fn call(rig: &Rig, name: &str, type_name: &str, request: &str) -> Value {
    rig.call(&format!("{NAME}/{name}"), type_name, request)
}

fn trigger(rig: &Rig, name: &str) -> Value {
    call(rig, name, "std_srvs/srv/Trigger", "{}")
}

#[test]
fn a_manager_drives_the_lifecycle() {
    let Some(rig) = Rig::new() else { return };
    let dir = tempfile::tempdir().unwrap();
    let mut node = start(&rig, dir.path(), &["-p", "autostart:=false"]);
    let state = || {
        let answer = call(&rig, "get_state", "lifecycle_msgs/srv/GetState", "{}");
        answer["current_state"]["label"].clone()
    };
    assert_eq!(state(), "unconfigured");
    let type_name = "lifecycle_msgs/srv/GetAvailableStates";
    let states = call(&rig, "get_available_states", type_name, "{}");
    assert_eq!(states["available_states"].as_array().unwrap().len(), 4);
    for (id, success, label) in [
        (3, false, "unconfigured"),
        (1, true, "inactive"),
        (3, true, "active"),
    ] {
        let request = format!(r#"{{"transition": {{"id": {id}}}}}"#);
        let type_name = "lifecycle_msgs/srv/ChangeState";
        let changed = call(&rig, "change_state", type_name, &request);
        assert_eq!(changed["success"], success);
        assert_eq!(state(), label);
    }
    let type_name = "lifecycle_msgs/srv/GetAvailableTransitions";
    let transitions = call(&rig, "get_available_transitions", type_name, "{}");
    let first = &transitions["available_transitions"][0]["transition"];
    assert_eq!(first["label"], "deactivate");
    assert!(node.is_running());
}

#[test]
fn parameters_are_listed_whole_described_and_set() {
    let Some(rig) = Rig::new() else { return };
    let dir = tempfile::tempdir().unwrap();
    let mut node = start(&rig, dir.path(), &[]);
    let near = rig.on_loopback();
    let of = |name: &str, type_name: &str, request: &str| {
        call(
            &near,
            name,
            &format!("rcl_interfaces/srv/{type_name}"),
            request,
        )
    };
    let all = of("list_parameters", "ListParameters", "{}");
    let all = all["result"]["names"].as_array().unwrap();
    let expected = veneer::config::tree::PARAMETERS.iter().map(|row| row.name);
    assert!(all.iter().map(|name| name.as_str().unwrap()).eq(expected));
    let everything = serde_json::json!({ "names": all }).to_string();
    let values = of("get_parameters", "GetParameters", &everything);
    assert_eq!(values["values"].as_array().unwrap().len(), all.len());
    let described = of("describe_parameters", "DescribeParameters", &everything);
    let described = described["descriptors"].as_array().unwrap();
    assert_eq!(described.len(), all.len());
    assert!(described.iter().all(|one| one["description"] != ""));

    let names = r#"{"names": ["paint_period", "image_transport", "photometric.max_turn_rad"]}"#;
    let described = of("describe_parameters", "DescribeParameters", names);
    let descriptors = described["descriptors"].as_array().unwrap();
    assert_eq!(descriptors[1]["read_only"], true);
    assert_eq!(descriptors[2]["floating_point_range"][0]["to_value"], 0.5);
    let prefix = r#"{"prefixes": ["texinit.chart"]}"#;
    let listed = of("list_parameters", "ListParameters", prefix);
    let listed = listed["result"]["names"].as_array().unwrap();
    assert!(listed.contains(&Value::from("texinit.chart.max_stretch")));
    let pairs = [
        "paint_period=2.5",
        "paint_period=-1.0",
        "image_transport=raw",
    ];
    let set = rig.peer(&[&["set", NAME], &pairs[..]].concat()).next();
    let results = set["results"].as_array().unwrap();
    assert_eq!(results[0]["successful"], true, "{set}");
    for (result, words) in [(1, "0 ..= 3600"), (2, "fixed")] {
        assert_eq!(results[result]["successful"], false, "{set}");
        assert!(results[result]["reason"].as_str().unwrap().contains(words));
    }
    let values = of("get_parameters", "GetParameters", names);
    assert_eq!(values["values"][0]["double_value"], 2.5);
    assert_eq!(values["values"][1]["string_value"], "auto");
    // To others a part of the names is given, with what to ask for to get the rest.
    let type_name = "rcl_interfaces/srv/ListParameters";
    let far = call(&rig, "list_parameters", type_name, "{}")["result"].clone();
    let num_names = far["names"].as_array().unwrap().len();
    assert!((10..all.len()).contains(&num_names), "{far}");
    let prefixes = far["prefixes"].as_array().unwrap();
    assert!(prefixes.contains(&Value::from("limits")), "{far}");
    assert!(node.is_running());
}

#[test]
fn triggers_answer_and_the_log_is_published() {
    let Some(rig) = Rig::new() else { return };
    let dir = tempfile::tempdir().unwrap();
    let mut node = start(&rig, dir.path(), &[]);
    assert_eq!(trigger(&rig, "pause")["success"], true);
    assert_eq!(trigger(&rig, "resume")["success"], true);
    let painted = trigger(&rig, "retexture");
    assert_eq!(painted["success"], false);
    let words = painted["message"].as_str().unwrap();
    assert!(words.contains("no mesh has come"), "{words}");
    assert_eq!(trigger(&rig, "reset")["success"], true);
    let how = ["--latched", "--num", "3"];
    let log = ["take", "/rosout", "rcl_interfaces/msg/Log"];
    let log = rig.peer(&[&log[..], &how].concat()).next();
    assert_eq!(log["messages"][0]["name"], "robot.painter", "{log}");
    assert!(node.is_running());
}

#[test]
fn who_comes_to_listen_hears_the_diagnostics_at_once() {
    let Some(rig) = Rig::new() else { return };
    let dir = tempfile::tempdir().unwrap();
    let mut node = rig.node(dir.path(), &["-p", "diagnostics.period:=600.0"]);
    let topic = ["/diagnostics", "diagnostic_msgs/msg/DiagnosticArray"];
    for _ in 0..2 {
        let said = rig
            .peer(&[&["take"], &topic[..], &["--wait", "30"]].concat())
            .next();
        let messages = said["messages"].as_array().cloned();
        assert_eq!(messages.map(|m| m.len()), Some(1), "{said}");
    }
    assert!(node.is_running());
}

/// What the graph shows of the node, by kind.
fn graph(rig: &Rig) -> Value {
    let of = ["graph", "painter", "--namespace", "/robot"];
    rig.peer(&[&of[..], &["--subscriptions", "/tf"]].concat())
        .next()
}

#[test]
fn the_graph_shows_what_the_page_of_topics_lists() {
    let Some(rig) = Rig::new() else { return };
    let dir = tempfile::tempdir().unwrap();
    let mut node = start(&rig, dir.path(), &[]);
    let graph = graph(&rig);
    for (kind, name) in [
        ("subscriptions", "/robot/rgb/camera_info"),
        ("publishers", "/robot/painter/markers"),
        ("services", "/robot/painter/save"),
    ] {
        assert!(graph[kind][name].is_array(), "{graph}");
    }
    let page = Path::new(env!("CARGO_MANIFEST_DIR")).join("docs/topics.md");
    let page = std::fs::read_to_string(page).unwrap();
    for kind in ["subscriptions", "publishers", "services"] {
        for name in graph[kind].as_object().unwrap().keys() {
            let private = name.strip_prefix("/robot/painter/");
            let written = match (private, name.strip_prefix("/robot/")) {
                (Some(private), _) => format!("`~/{private}`"),
                (None, Some(relative)) => format!("`{relative}`"),
                (None, None) => format!("`{name}`"),
            };
            assert!(page.contains(&written), "docs/topics.md lacks {written}");
        }
    }
    assert!(node.is_running());
}

#[test]
fn refine_changes_the_texture_of_a_live_scan() {
    let settings = ["refine_iterations:=3", "texsmooth.crop_px:=96"];
    let Some(mut live) = Painted::new(&settings) else {
        return;
    };
    let num_painted = live.seen.number("painting", "paintings");
    let before = live.glb();
    let again = |service: &str| {
        let before = live.rig.diagnostics().number("painting", "paintings");
        let done = live.rig.call(service, "std_srvs/srv/Trigger", "{}");
        assert_eq!(done["success"], true, "{done}");
        wait_until(&live.rig, "painted again", |seen| {
            let is_refined = seen.number("painting", "charts to refine") == 0;
            is_settled(seen) && is_refined && seen.number("painting", "paintings") > before
        })
    };
    let refined = again("/veneer/refine");
    assert!(refined.number("painting", "paintings") > num_painted);
    assert!(live.glb() != before, "refining changes nothing");
    // The optimisation is asked for once, not for all that comes after.
    again("/veneer/retexture");
    assert!(live.glb() == before, "painting again is not what it was");
    assert!(live.node.is_running());
}

/// Faces of a GLB.
fn num_faces(glb: &[u8]) -> usize {
    let glb = gltf::Gltf::from_slice(glb).unwrap();
    let primitives = glb.meshes().flat_map(|mesh| mesh.primitives());
    primitives.map(|p| p.indices().unwrap().count() / 3).sum()
}

#[test]
fn mesh_tools_services_give_the_whole_scan() {
    use veneer::wire::Message;
    use veneer::wire::service::Service;
    use veneer::wire::service::mesh::{
        GetGeometry, GetGeometryRequest, GetGeometryResponse, GetMaterials, GetMaterialsRequest,
        GetMaterialsResponse, GetTexture, GetTextureRequest, GetTextureResponse, GetUuids,
        GetUuidsRequest, GetUuidsResponse,
    };

    let Some(mut live) = Painted::new(&[]) else {
        return;
    };
    let peer = RawPeer::new(live.rig.domain);
    let client = |name: &str, type_name| peer.client(&format!("/veneer/{name}"), type_name);
    let wait = Duration::from_secs(10);
    let mut uuids = client("get_uuids", GetUuids::TYPE_NAME);
    let listed = uuids
        .call(GetUuidsRequest::default().encode(), wait)
        .unwrap();
    let listed = GetUuidsResponse::decode(&listed).unwrap().uuids;
    assert!(!listed.is_empty());
    let mut geometries = client("get_geometry", GetGeometry::TYPE_NAME);
    let mut materials = client("get_materials", GetMaterials::TYPE_NAME);
    let mut textures = client("get_texture", GetTexture::TYPE_NAME);
    let (mut num_given, mut longest) = (0, 0);
    for uuid in listed {
        let request = GetGeometryRequest { uuid: uuid.clone() };
        let geometry = geometries.call(request.encode(), wait).unwrap();
        let request = GetMaterialsRequest { uuid: uuid.clone() };
        let look = materials.call(request.encode(), wait).unwrap();
        let request = GetTextureRequest {
            uuid: uuid.clone(),
            texture_index: 0,
        };
        let texture = textures.call(request.encode(), wait).unwrap();
        longest = longest
            .max(geometry.len())
            .max(look.len())
            .max(texture.len());
        let GetGeometryResponse(geometry) = GetGeometryResponse::decode(&geometry).unwrap();
        let GetMaterialsResponse(look) = GetMaterialsResponse::decode(&look).unwrap();
        let GetTextureResponse(texture) = GetTextureResponse::decode(&texture).unwrap();
        assert_eq!(
            (geometry.uuid, look.uuid, texture.uuid),
            (&*uuid, &*uuid, &*uuid)
        );
        num_given += geometry.faces.len();
        assert_eq!(look.vertex_tex_coords.len(), geometry.vertices_m.len());
        let num_bytes = texture.image.width as usize * texture.image.height as usize * 3;
        assert_eq!(texture.image.data.len(), num_bytes);
    }
    assert!((10_000..=60_000).contains(&longest), "{longest} bytes");
    // Each face of the painted mesh is in one of them.
    assert_eq!(num_given, num_faces(&live.glb()));
    let gone = GetGeometryRequest {
        uuid: "gone".to_owned(),
    };
    assert!(
        geometries
            .call(gone.encode(), Duration::from_secs(1))
            .is_none()
    );
    assert!(
        live.node.log().contains("there is no mesh 'gone'"),
        "{}",
        live.node.log()
    );
    assert!(live.node.is_running());
}
