//! Bad recordings, through the command: one clear error or a counted skip, never a panic, and
//! nothing else lost.

use std::path::{Path, PathBuf};

use veneer::wire::Message;
use veneer::wire::camera_info::CameraInfo;
use veneer::wire::compressed_image::CompressedImage;
use veneer::wire::mesh_geometry::MeshGeometryStamped;
use veneer::wire::tf_message::TfMessage;

use crate::command::{said, small_tabletop, veneer};

const COLOR: &str = "/camera/color/image_raw/compressed";
const DEPTH: &str = "/camera/depth/image_raw/compressedDepth";
const COLOR_INFO: &str = "/camera/color/camera_info";
const TF: &str = "/tf";
const POSE: &str = "/camera/pose";
const MESH: &str = "/mesh";

/// What becomes of one message: topic, number on its topic, bytes → the bytes to write, or none.
pub(crate) type Edit<'a> = &'a dyn Fn(&str, usize, &[u8]) -> Option<Vec<u8>>;

/// Copies a bag message by message, and the description of its scene.
pub(crate) fn rewrite(bag: &Path, name: &str, edit: Edit<'_>) -> PathBuf {
    let bytes = std::fs::read(bag).unwrap();
    let path = bag.with_file_name(name);
    let file = std::io::BufWriter::new(std::fs::File::create(&path).unwrap());
    let mut writer = mcap::WriteOptions::new()
        .profile("ros2")
        .compression(None)
        .create(file)
        .unwrap();
    let mut num_by_topic = std::collections::BTreeMap::<String, usize>::new();
    for message in mcap::MessageStream::new(&bytes).unwrap() {
        let mut message = message.unwrap();
        let index = num_by_topic
            .entry(message.channel.topic.clone())
            .or_default();
        let edited = edit(&message.channel.topic, *index, &message.data);
        *index += 1;
        if let Some(data) = edited {
            message.data = data.into();
            writer.write(&message).unwrap();
        }
    }
    let name = veneer::synth::METADATA_NAME;
    if let Some(metadata) = veneer::bag::metadata(bag, name).unwrap() {
        let name = name.to_owned();
        let metadata = mcap::records::Metadata { name, metadata };
        writer.write_metadata(&metadata).unwrap();
    }
    writer.finish().unwrap();
    path
}

struct Outcome {
    code: Option<i32>,
    text: String,
    report: Option<serde_json::Value>,
}

impl Outcome {
    fn drops(&self) -> u64 {
        let drops = &self.report.as_ref().expect("a report")["drops"];
        let counts = drops.as_array().unwrap().iter();
        counts.map(|drop| drop["count"].as_u64().unwrap()).sum()
    }

    fn num_keyframes(&self) -> usize {
        let report = self.report.as_ref().expect("a report");
        report["keyframes"].as_array().unwrap().len()
    }

    #[track_caller]
    fn assert_fails_saying(&self, words: &[&str]) {
        assert_eq!(self.code, Some(1), "{}", self.text);
        assert!(!self.text.contains("panicked"), "{}", self.text);
        for word in words {
            assert!(
                self.text.contains(word),
                "'{word}' is not in: {}",
                self.text
            );
        }
    }

    #[track_caller]
    fn assert_succeeds(&self) {
        assert_eq!(self.code, Some(0), "{}", self.text);
    }
}

fn replay(bag: &Path) -> Outcome {
    let out = bag.with_extension("out");
    let output = veneer(&[
        "replay".as_ref(),
        bag.as_os_str(),
        "--out".as_ref(),
        out.as_os_str(),
    ]);
    let report = std::fs::read_to_string(out.join("report.json")).ok();
    Outcome {
        code: output.status.code(),
        text: said(&output),
        report: report.map(|text| serde_json::from_str(&text).unwrap()),
    }
}

fn without(topics: &'static [&'static str]) -> impl Fn(&str, usize, &[u8]) -> Option<Vec<u8>> {
    move |topic, _, data| (!topics.contains(&topic)).then(|| data.to_vec())
}

#[test]
fn a_bag_that_lacks_what_is_needed_names_it() {
    let dir = tempfile::tempdir().unwrap();
    let bag = small_tabletop(dir.path(), &[]);
    let empty = rewrite(&bag, "empty.mcap", &|_, _, _| None);
    replay(&empty).assert_fails_saying(&["mesh"]);
    let no_mesh = rewrite(&bag, "no_mesh.mcap", &without(&[MESH]));
    replay(&no_mesh).assert_fails_saying(&["mesh"]);
    let no_pose = rewrite(&bag, "no_pose.mcap", &without(&[TF, POSE]));
    replay(&no_pose).assert_fails_saying(&["frame", "pose"]);
    let no_info = rewrite(&bag, "no_info.mcap", &without(&[COLOR_INFO]));
    replay(&no_info).assert_fails_saying(&["camera"]);
    let no_color = rewrite(&bag, "no_color.mcap", &without(&[COLOR]));
    replay(&no_color).assert_fails_saying(&["frame"]);
}

#[test]
fn files_that_are_no_bag_are_refused() {
    let dir = tempfile::tempdir().unwrap();
    for (name, bytes) in [
        ("zero.mcap", &b""[..]),
        ("text.mcap", &b"hello"[..]),
        ("magic.mcap", &b"\x89MCAP0\r\n"[..]),
    ] {
        let path = dir.path().join(name);
        std::fs::write(&path, bytes).unwrap();
        replay(&path).assert_fails_saying(&[name]);
    }
    replay(&dir.path().join("absent.mcap")).assert_fails_saying(&["absent.mcap"]);
}

#[test]
fn a_bag_cut_short_gives_what_precedes_the_cut() {
    let dir = tempfile::tempdir().unwrap();
    let bag = small_tabletop(dir.path(), &[]);
    let bytes = std::fs::read(&bag).unwrap();
    let cut = bag.with_file_name("cut.mcap");
    std::fs::write(&cut, &bytes[..bytes.len() * 6 / 10]).unwrap();
    let outcome = replay(&cut);
    outcome.assert_succeeds();
    let losses = outcome.report.as_ref().unwrap()["source"]["losses"]
        .as_array()
        .unwrap()
        .len();
    assert!(losses > 0, "{}", outcome.text);
    assert!(outcome.num_keyframes() > 0);
}

#[test]
fn bad_images_are_counted_and_the_others_used() {
    let dir = tempfile::tempdir().unwrap();
    let bag = small_tabletop(dir.path(), &[]);
    let good = replay(&bag);
    good.assert_succeeds();
    let broken = rewrite(&bag, "images.mcap", &|topic, index, data| {
        if topic != COLOR {
            return Some(data.to_vec());
        }
        let image = CompressedImage::decode(data).unwrap();
        let data = match index {
            1 => &b""[..],
            2 => &image.data[..image.data.len() / 3],
            3 => &b"not an image"[..],
            _ => &image.data,
        };
        let format = if index == 4 { "webp" } else { &image.format };
        let broken = CompressedImage {
            header: image.header,
            data: data.into(),
            format: format.into(),
        };
        Some(broken.encode())
    });
    let outcome = replay(&broken);
    outcome.assert_succeeds();
    assert!(outcome.drops() >= 3, "{}", outcome.text);
    assert!(outcome.num_keyframes() + 4 >= good.num_keyframes());
    assert!(outcome.num_keyframes() >= 3);
}

#[test]
fn bad_depth_images_leave_the_colour_frames() {
    let dir = tempfile::tempdir().unwrap();
    let bag = small_tabletop(dir.path(), &[]);
    let broken = rewrite(&bag, "depth.mcap", &|topic, index, data| {
        if topic != DEPTH || index % 2 == 0 {
            return Some(data.to_vec());
        }
        let image = CompressedImage::decode(data).unwrap();
        let half = CompressedImage {
            data: image.data[..image.data.len() / 2].into(),
            ..image.clone()
        };
        Some(half.encode())
    });
    let outcome = replay(&broken);
    outcome.assert_succeeds();
    assert!(outcome.num_keyframes() >= 3);
}

#[test]
fn bad_poses_are_counted_and_the_others_used() {
    let dir = tempfile::tempdir().unwrap();
    let bag = small_tabletop(dir.path(), &[]);
    let broken = rewrite(&bag, "poses.mcap", &|topic, index, data| {
        if topic == POSE {
            return None;
        }
        if topic != TF {
            return Some(data.to_vec());
        }
        let mut message = TfMessage::decode(data).unwrap();
        for transform in &mut message.transforms {
            match index {
                1 => transform.transform.position_m[0] = f64::NAN,
                2 => transform.transform.quaternion_xyzw = [0.0; 4],
                3 => transform.transform.quaternion_xyzw = [2.0, 0.0, 0.0, 0.0],
                _ => {}
            }
        }
        Some(message.encode())
    });
    let outcome = replay(&broken);
    outcome.assert_succeeds();
    assert!(outcome.drops() >= 3, "{}", outcome.text);
}

#[test]
fn bad_camera_infos_are_refused_by_field() {
    let dir = tempfile::tempdir().unwrap();
    let bag = small_tabletop(dir.path(), &[]);
    let broken = rewrite(&bag, "info.mcap", &|topic, _, data| {
        if topic != COLOR_INFO {
            return Some(data.to_vec());
        }
        let mut info = CameraInfo::decode(data).unwrap();
        info.k[0] = 0.0;
        Some(info.encode())
    });
    replay(&broken).assert_fails_saying(&[COLOR_INFO, "fx 0"]);
}

fn with_mesh(bag: &Path, name: &str, edit: &dyn Fn(&mut MeshGeometryStamped<'_>)) -> PathBuf {
    rewrite(bag, name, &|topic, _, data| {
        if topic != MESH {
            return Some(data.to_vec());
        }
        let mut mesh = MeshGeometryStamped::decode(data).unwrap();
        edit(&mut mesh);
        Some(mesh.encode())
    })
}

#[test]
fn bad_meshes_are_refused_or_cut_down() {
    let dir = tempfile::tempdir().unwrap();
    let bag = small_tabletop(dir.path(), &[]);
    let out_of_range = with_mesh(&bag, "index.mcap", &|mesh| mesh.faces[5][1] = 4_000_000);
    replay(&out_of_range).assert_fails_saying(&[MESH, "4000000"]);
    let no_triangles = with_mesh(&bag, "bare.mcap", &|mesh| mesh.faces.clear());
    replay(&no_triangles).assert_fails_saying(&["mesh"]);

    let num_faces = std::cell::Cell::new(0);
    let with_nan = with_mesh(&bag, "nan.mcap", &|mesh| {
        mesh.vertices_m[0][2] = f64::NAN;
        mesh.vertices_m[7] = [f64::INFINITY; 3];
        let is_hurt = |face: &&[u32; 3]| face.iter().any(|&v| v == 0 || v == 7);
        num_faces.set(mesh.faces.len() - mesh.faces.iter().filter(is_hurt).count());
    });
    let outcome = replay(&with_nan);
    outcome.assert_succeeds();
    let report = outcome.report.unwrap();
    assert_eq!(report["mesh"]["num_triangles"], num_faces.get());
}

#[test]
fn tiny_and_unseen_meshes_are_textured() {
    let dir = tempfile::tempdir().unwrap();
    let bag = small_tabletop(dir.path(), &[]);
    let single = with_mesh(&bag, "single.mcap", &|mesh| mesh.faces.truncate(1));
    replay(&single).assert_succeeds();
    let degenerate = with_mesh(&bag, "degenerate.mcap", &|mesh| {
        mesh.faces.truncate(40);
        mesh.faces[3] = [mesh.faces[3][0]; 3];
        let duplicate = mesh.faces[4];
        mesh.faces[5] = duplicate;
        mesh.faces[6] = [duplicate[0], duplicate[2], duplicate[1]];
    });
    replay(&degenerate).assert_succeeds();
    let unseen = with_mesh(&bag, "unseen.mcap", &|mesh| {
        for vertex in &mut mesh.vertices_m {
            vertex[0] += 500.0;
        }
    });
    let outcome = replay(&unseen);
    outcome.assert_succeeds();
    assert!(
        outcome.text.contains("no frame sees the mesh"),
        "{}",
        outcome.text
    );
    assert_eq!(outcome.report.unwrap()["coverage"]["keyframe_share"], 0.0);
}

#[test]
fn an_unwritable_output_is_an_error_that_names_it() {
    let dir = tempfile::tempdir().unwrap();
    let bag = small_tabletop(dir.path(), &[]);
    let file = dir.path().join("occupied");
    std::fs::write(&file, "").unwrap();
    let bag_arg = bag.to_str().unwrap();
    for out in [file.as_path(), Path::new("/proc/veneer-cannot-write-here")] {
        let output = veneer(&["replay", bag_arg, "--out", out.to_str().unwrap()]);
        assert_eq!(output.status.code(), Some(1));
        assert!(
            said(&output).contains(out.to_str().unwrap()),
            "{}",
            said(&output)
        );
    }
}

/// The shell's file size limit stands for a full disk: writes past it fail, as they do there.
#[test]
fn a_full_disk_is_an_error_and_leaves_no_partial_file() {
    let dir = tempfile::tempdir().unwrap();
    let bag = small_tabletop(dir.path(), &[]);
    let out = dir.path().join("out");
    let script = format!(
        "trap '' XFSZ; ulimit -f 64; exec {} replay {} --out {}",
        env!("CARGO_BIN_EXE_veneer"),
        bag.display(),
        out.display()
    );
    let output = std::process::Command::new("bash")
        .args(["-c", &script])
        .output()
        .unwrap();
    assert_eq!(output.status.code(), Some(1), "{}", said(&output));
    assert!(said(&output).contains("cannot"), "{}", said(&output));
    for name in ["scan.glb", "scan.obj", "scan.ply"] {
        assert!(!out.join(name).exists(), "{name} is there, cut short");
    }
}

#[test]
fn wrong_usage_exits_with_2() {
    let dir = tempfile::tempdir().unwrap();
    let bag = small_tabletop(dir.path(), &[]);
    let bag = bag.to_str().unwrap();
    for args in [
        &["replay"][..],
        &["paint", bag],
        &["replay", bag, "--out", "x", "--threads", "100000"],
        &["replay", bag, "--out", "x", "-p", "keyframe.budget_mbb:=1"],
        &["replay", bag, "--out", "x", "-p", "keyframe.budget_mb:=-1"],
        &["import", "scannet", ".", "-o", "x.mcap"],
        &["import", "tum", ".", "-o", "x", "--intrinsics", "1,2,3"],
        &["import", "tum", ".", "-o", "x", "--intrinsics", "1,2,3,x"],
        &["import", "capture", ".", "-o", "x", "--intrinsics=1,2,3,4"],
        &["import", "capture", ".", "-o", "x", "--min-confidence=9"],
    ] {
        let output = veneer(args);
        assert_eq!(output.status.code(), Some(2), "{args:?}: {}", said(&output));
    }
}

/// A rename puts a file where the device was: as root, for the whole machine.
#[cfg(unix)]
#[test]
fn a_device_or_folder_is_not_replaced_by_a_bag() {
    use std::os::unix::fs::FileTypeExt;
    let dir = tempfile::tempdir().unwrap();
    let pipe = dir.path().join("pipe");
    let made = std::process::Command::new("mkfifo").arg(&pipe).status();
    assert!(made.unwrap().success());
    for target in [pipe.as_path(), dir.path()] {
        let args = ["synth", "tabletop", "--frames", "1", "-o"].map(std::ffi::OsStr::new);
        let output = veneer(&[&args[..], &[target.as_os_str()]].concat());
        assert_eq!(output.status.code(), Some(1));
        let words = said(&output);
        assert!(words.contains("no file to be replaced"), "{words}");
    }
    assert!(std::fs::metadata(&pipe).unwrap().file_type().is_fifo());
}
