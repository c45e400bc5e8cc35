//! `msg/` and `srv/` as they are declared, and a decoder that knows nothing else.

use std::collections::BTreeMap;

use serde_json::{Map, Value, json};
use veneer::wire::WireError;

use super::root;
use super::samples::samples;

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
