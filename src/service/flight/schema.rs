//! The schemas of the topics: protobuf, those of Foxglove where there is one, else of `retroflex.proto`.
//!
//! `schemas.bin` describes them; `tests/program/schemas.rs` compiles it. Messages are made from JSON and read as JSON, with the
//! names of the fields, but for the cycles, whose message holds bytes.

use prost_reflect::prost::Message;
use prost_reflect::prost_types::FileDescriptorSet;
use prost_reflect::{
    DescriptorPool, DynamicMessage, MessageDescriptor, SerializeOptions, Value as Field,
};
use serde_json::Value;
use std::io;
use std::sync::LazyLock;

/// Encoding of the schemas and of the messages, as MCAP names it.
pub const ENCODING: &str = "protobuf";
/// Topics and the names of their schemas. Every file declares all of them.
pub const TOPICS: [(&str, &str); 12] = [
    ("/angles", "retroflex.Angles"),
    ("/pistons", "retroflex.Pistons"),
    ("/gains", "retroflex.Gains"),
    ("/mode", "retroflex.Mode"),
    ("/faults", "retroflex.Faults"),
    ("/imu", "retroflex.Imu"),
    ("/imu/base", "retroflex.Imu"),
    ("/tf", "foxglove.FrameTransform"),
    ("/scene", "foxglove.SceneUpdate"),
    ("/log", "foxglove.Log"),
    ("/events", "retroflex.Event"),
    ("/cycles", "retroflex.Cycles"),
];
/// Those of the first topics that show fields of the status.
pub const STATUS: usize = 5;

static POOL: LazyLock<DescriptorPool> = LazyLock::new(|| {
    DescriptorPool::decode(include_bytes!("schemas.bin").as_slice()).unwrap_or_default()
});

/// The schema of a topic.
///
/// # Errors
/// The topic has none.
fn of_topic(topic: &str) -> io::Result<MessageDescriptor> {
    let known = TOPICS.iter().find(|(name, _)| *name == topic);
    let schema = known.and_then(|(_, schema)| POOL.get_message_by_name(schema));
    schema.ok_or_else(|| io::Error::other(format!("channel {topic} has no schema")))
}

/// Names of the fields of a topic.
pub fn fields(topic: &str) -> Vec<String> {
    let all = of_topic(topic).map(|schema| schema.fields().map(|f| f.name().to_owned()).collect());
    all.unwrap_or_default()
}

/// The schema of a topic as a `FileDescriptorSet`, with the files that it needs before it.
///
/// # Errors
/// The topic has none.
pub fn description(topic: &str) -> io::Result<Vec<u8>> {
    let mut needed = vec![of_topic(topic)?.parent_file()];
    let mut next = 0;
    while let Some(file) = needed.get(next) {
        let more: Vec<_> = file.dependencies().collect();
        needed.extend(more);
        next += 1;
    }
    let files = POOL.files().filter(|file| needed.contains(file));
    let file = files.map(|file| file.file_descriptor_proto().clone());
    let file = file.collect();
    Ok(FileDescriptorSet { file }.encode_to_vec())
}

/// The message of a topic with these fields; null is absent, and not a number in a list.
///
/// # Errors
/// What does not fit the schema.
pub fn encode(topic: &str, mut fields: Value) -> io::Result<Vec<u8>> {
    let all = fields.as_object_mut().into_iter().flatten();
    let lists = all.filter_map(|(_, field)| field.as_array_mut());
    for item in lists.flatten().filter(|item| item.is_null()) {
        *item = "NaN".into();
    }
    let message = DynamicMessage::deserialize(of_topic(topic)?, fields);
    Ok(message.map_err(io::Error::other)?.encode_to_vec())
}

/// The fields of a message of a topic; what is absent is null.
///
/// # Errors
/// What is wrong with the message.
pub fn decode(topic: &str, message: &[u8]) -> io::Result<Value> {
    let schema = of_topic(topic)?;
    let message = DynamicMessage::decode(schema.clone(), message).map_err(io::Error::other)?;
    let options = SerializeOptions::new()
        .skip_default_fields(false)
        .use_proto_field_name(true);
    let mut value = message.serialize_with_options(serde_json::value::Serializer, &options)?;
    for field in schema.fields() {
        if field.supports_presence() && !message.has_field(&field) {
            value[field.name()] = Value::Null;
        }
    }
    Ok(value)
}

/// Number of the field of a message that holds bytes.
const BYTES: u32 = 1;

/// The message of a topic that holds bytes.
///
/// # Errors
/// The topic has no schema.
pub fn wrap(topic: &str, bytes: Vec<u8>) -> io::Result<Vec<u8>> {
    let mut message = DynamicMessage::new(of_topic(topic)?);
    message.set_field_by_number(BYTES, Field::Bytes(bytes.into()));
    Ok(message.encode_to_vec())
}

/// The bytes that a message of a topic holds.
///
/// # Errors
/// What is wrong with the message.
pub fn unwrap(topic: &str, message: &[u8]) -> io::Result<Vec<u8>> {
    let message = DynamicMessage::decode(of_topic(topic)?, message).map_err(io::Error::other)?;
    let bytes = message.get_field_by_number(BYTES);
    let bytes = bytes.and_then(|field| field.as_bytes().map(|bytes| bytes.to_vec()));
    Ok(bytes.unwrap_or_default())
}
