//! The header of a PLY file: which elements with which properties follow, in which encoding.

use super::PlyError;

#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Scalar {
    I8,
    U8,
    I16,
    U16,
    I32,
    U32,
    F32,
    F64,
}

impl Scalar {
    pub(super) fn from_name(name: &str) -> Option<Self> {
        Some(match name {
            "char" | "int8" => Self::I8,
            "uchar" | "uint8" => Self::U8,
            "short" | "int16" => Self::I16,
            "ushort" | "uint16" => Self::U16,
            "int" | "int32" => Self::I32,
            "uint" | "uint32" => Self::U32,
            "float" | "float32" => Self::F32,
            "double" | "float64" => Self::F64,
            _ => return None,
        })
    }

    pub(super) fn is_integer(self) -> bool {
        !matches!(self, Self::F32 | Self::F64)
    }

    pub(super) fn num_bytes(self) -> usize {
        match self {
            Self::I8 | Self::U8 => 1,
            Self::I16 | Self::U16 => 2,
            Self::I32 | Self::U32 | Self::F32 => 4,
            Self::F64 => 8,
        }
    }
}

#[derive(Clone, Debug, PartialEq)]
pub(super) enum Property {
    Scalar(String, Scalar),
    List {
        name: String,
        length: Scalar,
        item: Scalar,
    },
}

#[derive(Clone, Debug)]
pub(super) struct Element {
    pub(super) name: String,
    pub(super) count: u64,
    pub(super) properties: Vec<Property>,
}

#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Encoding {
    Ascii,
    LittleEndian,
    BigEndian,
}

/// Longest header line that is looked at; real ones are a few dozen bytes (comments aside).
const MAX_HEADER_LINE_BYTES: usize = 1 << 14;

pub(super) struct Header {
    pub(super) encoding: Encoding,
    pub(super) elements: Vec<Element>,
    /// What `comment TextureFile` lines name, in order.
    pub(super) texture_files: Vec<String>,
    pub(super) body_offset: usize,
}

fn header_line(bytes: &[u8], offset: usize) -> Result<(&[u8], usize), PlyError> {
    let rest = bytes.get(offset..).unwrap_or_default();
    let window = &rest[..rest.len().min(MAX_HEADER_LINE_BYTES)];
    let end = window
        .iter()
        .position(|&b| b == b'\n')
        .ok_or(PlyError::HeaderUnfinished)?;
    let line = &window[..end];
    Ok((line.strip_suffix(b"\r").unwrap_or(line), offset + end + 1))
}

pub(super) fn parse(bytes: &[u8]) -> Result<Header, PlyError> {
    if !bytes.starts_with(b"ply") {
        return Err(PlyError::Magic);
    }
    let (_, mut offset) = header_line(bytes, 0)?;
    let mut encoding = None;
    let mut elements: Vec<Element> = Vec::new();
    let mut texture_files = Vec::new();
    for line_number in 2.. {
        let (line, next_offset) = header_line(bytes, offset)?;
        offset = next_offset;
        let text = String::from_utf8_lossy(line);
        let words: Vec<&str> = text.split_ascii_whitespace().collect();
        let refuse = |reason| PlyError::Header {
            line: line_number,
            text: text.chars().take(80).collect(),
            reason,
        };
        match words.as_slice() {
            ["end_header"] => break,
            // Names may have blanks in them, so the rest of the line is taken as it is.
            ["comment", "TextureFile", ..] => texture_files.extend(
                text.split_once("TextureFile")
                    .map(|(_, name)| name.trim().to_owned())
                    .filter(|name| !name.is_empty()),
            ),
            [] | ["comment" | "obj_info", ..] => {}
            ["format", format, "1.0"] => {
                encoding = Some(match *format {
                    "ascii" => Encoding::Ascii,
                    "binary_little_endian" => Encoding::LittleEndian,
                    "binary_big_endian" => Encoding::BigEndian,
                    _ => return Err(refuse("the format is unknown")),
                });
            }
            ["element", name, count] => elements.push(Element {
                name: (*name).to_owned(),
                count: count
                    .parse()
                    .map_err(|_| refuse("the count is no number"))?,
                properties: Vec::new(),
            }),
            ["property", definition @ ..] => elements
                .last_mut()
                .ok_or_else(|| refuse("a property before any element"))?
                .properties
                .push(parse_property(definition).map_err(refuse)?),
            _ => return Err(refuse("not a header line")),
        }
    }
    Ok(Header {
        encoding: encoding.ok_or(PlyError::Missing("format"))?,
        elements,
        texture_files,
        body_offset: offset,
    })
}

fn parse_property(definition: &[&str]) -> Result<Property, &'static str> {
    let scalar = |name| Scalar::from_name(name).ok_or("the type is unknown");
    match *definition {
        ["list", length, item, name] => {
            let length = scalar(length)?;
            if !length.is_integer() {
                return Err("a list's length must be an integer");
            }
            Ok(Property::List {
                name: name.to_owned(),
                length,
                item: scalar(item)?,
            })
        }
        [kind, name] if kind != "list" => Ok(Property::Scalar(name.to_owned(), scalar(kind)?)),
        _ => Err("a property is 'TYPE NAME' or 'list TYPE TYPE NAME'"),
    }
}
