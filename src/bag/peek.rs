//! A look at the first messages of a bag, for what types and names do not tell.

use std::collections::{BTreeMap, BTreeSet};

use crate::wire::event::MessageType;
use crate::wire::{
    CameraInfo, CompressedImage, Image, Marker, MarkerArray, Message, TfMessage, TopicRole, marker,
};

use super::mapped::MappedBag;
use super::roles::{Peek, Topics};

/// So many messages of a marker topic are looked at for triangles.
pub(super) const MAX_PEEKS: usize = 20;

/// So many messages of TF are looked at for the path to the camera.
const MAX_TF_MESSAGES: usize = 2000;

/// Whether the first message tells more than the type.
pub(super) fn needs_peek(message_type: MessageType) -> bool {
    matches!(
        message_type,
        MessageType::Image
            | MessageType::CompressedImage
            | MessageType::CameraInfo
            | MessageType::Marker
            | MessageType::MarkerArray
    )
}

/// Notes what a message shows; whether another should be looked at.
pub(super) fn peek(message_type: MessageType, data: &[u8], peek: &mut Peek) -> bool {
    match message_type {
        MessageType::Image => {
            let Ok(image) = Image::decode(data) else {
                return true;
            };
            peek.encoding = image.encoding.to_owned();
            peek.frame_id = image.header.to_header().frame_id.to_string();
            false
        }
        MessageType::CompressedImage => {
            let Ok(image) = CompressedImage::decode(data) else {
                return true;
            };
            peek.encoding = image.format.into_owned();
            peek.frame_id = image.header.to_header().frame_id.to_string();
            false
        }
        MessageType::CameraInfo => {
            let Ok(info) = CameraInfo::decode(data) else {
                return true;
            };
            peek.frame_id = info.header.to_header().frame_id.to_string();
            false
        }
        MessageType::Marker => {
            let marker = Marker::decode(data);
            peek.has_triangles |= marker.is_ok_and(|m| is_triangle_list(&m));
            !peek.has_triangles
        }
        _ => {
            let array = MarkerArray::decode(data);
            peek.has_triangles |= array.is_ok_and(|a| a.markers.iter().any(is_triangle_list));
            !peek.has_triangles
        }
    }
}

fn is_triangle_list(marker: &Marker<'_>) -> bool {
    marker.kind == marker::TRIANGLE_LIST && marker.action == marker::ADD
}

/// Whether a moving transform lies on the way from `frame` to the root of its TF tree, as far as
/// the first messages show the tree.
pub(super) fn moves(bag: &MappedBag, topics: &Topics, frame: &str) -> bool {
    let is_tf = |name: &&String| topics[*name].message_type.can_be(TopicRole::Transforms);
    let channels: BTreeMap<u16, bool> = topics
        .keys()
        .filter(is_tf)
        .flat_map(|name| {
            let is_static = name.ends_with("tf_static");
            bag.channels_of(name)
                .into_iter()
                .map(move |id| (id, is_static))
        })
        .collect();
    let mut parents: BTreeMap<String, (String, bool)> = BTreeMap::new();
    let mut num_left = MAX_TF_MESSAGES;
    let mut is_moving = false;
    let wanted = channels.keys().copied().collect();
    bag.scan(&wanted, |id, data| {
        let is_static = channels[&id];
        let transforms = TfMessage::decode(data).map(|tf| tf.to_transforms().0);
        let mut is_new = false;
        for t in transforms.unwrap_or_default() {
            let parent = (t.header.frame_id.to_string(), !is_static);
            is_new |= parents
                .insert(t.child_frame_id.to_string(), parent)
                .is_none();
        }
        is_moving |= is_new && path_moves(&parents, frame);
        num_left = num_left.saturating_sub(1);
        !is_moving && num_left > 0
    });
    is_moving
}

fn path_moves(parents: &BTreeMap<String, (String, bool)>, frame: &str) -> bool {
    let mut visited = BTreeSet::new();
    let mut at = frame;
    while let Some((parent, is_moving)) = parents.get(at) {
        if *is_moving {
            return true;
        }
        if !visited.insert(at) {
            return false;
        }
        at = parent;
    }
    false
}
