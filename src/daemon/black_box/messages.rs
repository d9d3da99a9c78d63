//! The messages of the channels: Foxglove's well-known images as protobuf, the rest as JSON.

use bytes::Bytes;
use prost::Message as _;
use prost_types::field_descriptor_proto::{Label, Type};
use prost_types::{
    DescriptorProto, FieldDescriptorProto, FileDescriptorProto, FileDescriptorSet, Timestamp,
};

use super::queue::Topic;
use gripcast_imaging::{Frame, FrameBytes, PixelFormat, Role};

/// `foxglove.CompressedImage`.
#[derive(Clone, PartialEq, prost::Message)]
pub(super) struct CompressedImage {
    /// Driver's capture time.
    #[prost(message, optional, tag = "1")]
    pub(super) timestamp: Option<Timestamp>,
    /// Exactly what the camera sent.
    #[prost(bytes = "bytes", tag = "2")]
    pub(super) data: Bytes,
    /// `jpeg`.
    #[prost(string, tag = "3")]
    pub(super) format: String,
    /// Role of the camera.
    #[prost(string, tag = "4")]
    pub(super) frame_id: String,
}

/// `foxglove.RawImage`.
#[derive(Clone, PartialEq, prost::Message)]
pub(super) struct RawImage {
    /// Driver's capture time.
    #[prost(message, optional, tag = "1")]
    pub(super) timestamp: Option<Timestamp>,
    /// Pixels.
    #[prost(fixed32, tag = "2")]
    pub(super) width: u32,
    /// Pixels.
    #[prost(fixed32, tag = "3")]
    pub(super) height: u32,
    /// `yuyv`, `16UC1` or `mono8`.
    #[prost(string, tag = "4")]
    pub(super) encoding: String,
    /// Bytes of a row.
    #[prost(fixed32, tag = "5")]
    pub(super) step: u32,
    /// Exactly what the camera sent.
    #[prost(bytes = "bytes", tag = "6")]
    pub(super) data: Bytes,
    /// Role of the camera.
    #[prost(string, tag = "7")]
    pub(super) frame_id: String,
}

/// What a reader has to know of a channel.
#[derive(Debug, PartialEq, Eq)]
pub(super) struct ChannelForm {
    pub(super) topic: String,
    pub(super) schema: &'static str,
    pub(super) schema_encoding: &'static str,
    pub(super) schema_data: Vec<u8>,
    pub(super) message_encoding: &'static str,
}

/// The channel of a camera's frames of one format.
pub(super) fn camera_channel(role: Role, format: PixelFormat) -> ChannelForm {
    let schema = match raw_encoding(format) {
        None => "foxglove.CompressedImage",
        Some(_) => "foxglove.RawImage",
    };
    ChannelForm {
        topic: format!("/camera/{role}"),
        schema,
        schema_encoding: "protobuf",
        schema_data: descriptors(schema).encode_to_vec(),
        message_encoding: "protobuf",
    }
}

/// The channel of notes on a topic.
pub(super) fn note_channel(topic: Topic) -> ChannelForm {
    let (name, schema, data) = match topic {
        Topic::Events => ("/session/events", "gripcast.Event", EVENT_SCHEMA),
        Topic::Stored => ("/session/stored", "gripcast.Stored", STORED_SCHEMA),
        Topic::Prediction => ("/prediction", "gripcast.Prediction", PREDICTION_SCHEMA),
        Topic::Cameras => ("/cameras", "gripcast.Cameras", CAMERAS_SCHEMA),
    };
    ChannelForm {
        topic: name.into(),
        schema,
        schema_encoding: "jsonschema",
        schema_data: data.into(),
        message_encoding: "json",
    }
}

/// Writes a frame's message into `buffer`. `capture_ns`: driver's capture time as wall clock.
pub(super) fn encode_frame(role: Role, frame: Frame, capture_ns: u64, buffer: &mut Vec<u8>) {
    let timestamp = Some(Timestamp {
        seconds: i64::try_from(capture_ns / 1_000_000_000).unwrap_or(i64::MAX),
        nanos: (capture_ns % 1_000_000_000) as i32,
    });
    let frame_id = role.name().to_owned();
    let (width, height) = (frame.width, frame.height);
    let encoding = raw_encoding(frame.format);
    let data = Bytes::from_owner(Shared(frame.data));
    buffer.clear();
    let result = match encoding {
        None => CompressedImage {
            timestamp,
            data,
            format: "jpeg".into(),
            frame_id,
        }
        .encode(buffer),
        Some((encoding, pixel_bytes)) => RawImage {
            timestamp,
            width,
            height,
            encoding: encoding.into(),
            step: width * pixel_bytes,
            data,
            frame_id,
        }
        .encode(buffer),
    };
    debug_assert!(result.is_ok(), "a vector grows");
}

/// Foxglove's name of a raw format and its bytes a pixel.
fn raw_encoding(format: PixelFormat) -> Option<(&'static str, u32)> {
    match format {
        PixelFormat::Mjpg => None,
        PixelFormat::Yuyv => Some(("yuyv", 2)),
        PixelFormat::Z16 => Some(("16UC1", 2)),
        PixelFormat::Grey => Some(("mono8", 1)),
        PixelFormat::Rgb => Some(("rgb8", 3)),
    }
}

/// A frame's bytes, lent to a message.
struct Shared(FrameBytes);

impl AsRef<[u8]> for Shared {
    fn as_ref(&self) -> &[u8] {
        &self.0
    }
}

/// The description of a message for readers that do not know it.
fn descriptors(schema: &str) -> FileDescriptorSet {
    let (name, fields): (&str, &[(&str, i32, Type)]) = match schema {
        "foxglove.RawImage" => (
            "RawImage",
            &[
                ("timestamp", 1, Type::Message),
                ("width", 2, Type::Fixed32),
                ("height", 3, Type::Fixed32),
                ("encoding", 4, Type::String),
                ("step", 5, Type::Fixed32),
                ("data", 6, Type::Bytes),
                ("frame_id", 7, Type::String),
            ],
        ),
        _ => (
            "CompressedImage",
            &[
                ("timestamp", 1, Type::Message),
                ("data", 2, Type::Bytes),
                ("format", 3, Type::String),
                ("frame_id", 4, Type::String),
            ],
        ),
    };
    let time = &[("seconds", 1, Type::Int64), ("nanos", 2, Type::Int32)];
    let stamp = file("google/protobuf/timestamp.proto", "google.protobuf");
    let image = file(&format!("foxglove/{name}.proto"), "foxglove");
    FileDescriptorSet {
        file: vec![
            FileDescriptorProto {
                message_type: vec![message("Timestamp", time)],
                ..stamp.clone()
            },
            FileDescriptorProto {
                dependency: vec![stamp.name().to_owned()],
                message_type: vec![message(name, fields)],
                ..image
            },
        ],
    }
}

fn file(name: &str, package: &str) -> FileDescriptorProto {
    FileDescriptorProto {
        name: Some(name.into()),
        package: Some(package.into()),
        syntax: Some("proto3".into()),
        ..FileDescriptorProto::default()
    }
}

fn message(name: &str, fields: &[(&str, i32, Type)]) -> DescriptorProto {
    let field = |(name, number, kind): &(&str, i32, Type)| FieldDescriptorProto {
        name: Some((*name).into()),
        number: Some(*number),
        label: Some(Label::Optional.into()),
        r#type: Some((*kind).into()),
        type_name: (*kind == Type::Message).then(|| ".google.protobuf.Timestamp".into()),
        ..FieldDescriptorProto::default()
    };
    DescriptorProto {
        name: Some(name.into()),
        field: fields.iter().map(field).collect(),
        ..DescriptorProto::default()
    }
}

const EVENT_SCHEMA: &str = r#"{
  "title": "gripcast.Event",
  "type": "object",
  "properties": {
    "at": {"type": "string", "format": "date-time", "description": "wall clock, UTC"},
    "event": {"type": "string"},
    "what": {"type": "object", "description": "depends on the event"}
  }
}"#;

const STORED_SCHEMA: &str = r#"{
  "title": "gripcast.Stored",
  "type": "object",
  "properties": {
    "at": {"type": "string", "format": "date-time", "description": "wall clock of the answer, UTC"},
    "request": {"type": "object", "description": "what was asked for, by its name"},
    "reply": {"description": "the answer: unless it is `failed`, the change is durable"}
  }
}"#;

const PREDICTION_SCHEMA: &str = r#"{
  "title": "gripcast.Prediction",
  "type": "object",
  "properties": {
    "p_stable": {"type": "number", "description": "probability that the grasp is stable, steadied over the frames"},
    "p_stable_frame": {"type": "number", "description": "the same of the newest frame alone"},
    "novelty": {"type": ["number", "null"], "description": "distance from the training images over what counts as known"},
    "frame_time_ns": {"type": "integer", "description": "CLOCK_MONOTONIC of the newest frame, ns"},
    "latency_ms": {"type": "number", "description": "that frame to the result"},
    "engine_ms": {"type": "number", "description": "the model alone"}
  }
}"#;

const CAMERAS_SCHEMA: &str = r#"{
  "title": "gripcast.Cameras",
  "type": "object",
  "description": "health and counters by role",
  "additionalProperties": {
    "type": "object",
    "properties": {
      "state": {"type": "string"},
      "fault": {"type": ["string", "null"], "description": "why its frames cannot be used"},
      "frame_age_ms": {"type": ["number", "null"], "description": "age of the newest frame"},
      "report": {"type": "object", "description": "counters since the start"}
    }
  }
}"#;
