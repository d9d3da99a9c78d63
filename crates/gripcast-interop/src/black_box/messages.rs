//! Messages of the channels: images as Foxglove protobuf, everything else as JSON.

use bytes::Bytes;
use prost::Message as _;
use prost_types::field_descriptor_proto::{Label, Type};
use prost_types::{
    DescriptorProto, FieldDescriptorProto, FileDescriptorProto, FileDescriptorSet, Timestamp,
};

use gripcast_base::error::{Error, Result};
use gripcast_imaging::{Frame, FrameBytes, PixelFormat, Role, jpeg};

/// Prefix of the cameras' topics; the role follows.
pub(super) const CAMERA_TOPIC: &str = "/camera/";
/// Topic of the shear of the gels.
pub(super) const SHEAR_TOPIC: &str = "/shear";
const COMPRESSED_IMAGE: &str = "foxglove.CompressedImage";
const RAW_IMAGE: &str = "foxglove.RawImage";

const EVENT_SCHEMA: &str = include_str!("schemas/event.json");
const STORED_SCHEMA: &str = include_str!("schemas/stored.json");
const PREDICTION_SCHEMA: &str = include_str!("schemas/prediction.json");
const SHEAR_SCHEMA: &str = include_str!("schemas/shear.json");
const CAMERAS_SCHEMA: &str = include_str!("schemas/cameras.json");

/// Channel of JSON messages.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Topic {
    /// Commands, faults, gaps of the log itself.
    Events,
    /// Answered changes of the dataset.
    Stored,
    /// Live predictions.
    Prediction,
    /// Shear of one gel in one frame.
    Shear,
    /// Health of all cameras.
    Cameras,
}

/// `foxglove.CompressedImage`.
#[derive(Clone, PartialEq, prost::Message)]
pub struct CompressedImage {
    /// Capture time of the driver.
    #[prost(message, optional, tag = "1")]
    pub timestamp: Option<Timestamp>,
    /// Data as sent by the camera.
    #[prost(bytes = "bytes", tag = "2")]
    pub data: Bytes,
    /// `jpeg`.
    #[prost(string, tag = "3")]
    pub format: String,
    /// Role of the camera.
    #[prost(string, tag = "4")]
    pub frame_id: String,
}

/// `foxglove.RawImage`.
#[derive(Clone, PartialEq, prost::Message)]
pub struct RawImage {
    /// Capture time of the driver.
    #[prost(message, optional, tag = "1")]
    pub timestamp: Option<Timestamp>,
    /// Width, px.
    #[prost(fixed32, tag = "2")]
    pub width: u32,
    /// Height, px.
    #[prost(fixed32, tag = "3")]
    pub height: u32,
    /// `yuyv`, `16UC1` or `mono8`.
    #[prost(string, tag = "4")]
    pub encoding: String,
    /// Bytes per row.
    #[prost(fixed32, tag = "5")]
    pub step: u32,
    /// Data as sent by the camera.
    #[prost(bytes = "bytes", tag = "6")]
    pub data: Bytes,
    /// Role of the camera.
    #[prost(string, tag = "7")]
    pub frame_id: String,
}

/// Topic, schema and encoding of a channel.
#[derive(Debug, PartialEq, Eq)]
pub struct ChannelSchema {
    /// Topic.
    pub topic: String,
    /// Name of the schema.
    pub schema: &'static str,
    /// `protobuf` or `jsonschema`.
    pub schema_encoding: &'static str,
    /// The schema itself.
    pub schema_data: Vec<u8>,
    /// `protobuf` or `json`.
    pub message_encoding: &'static str,
}

/// Returns the channel of a camera with this pixel format.
pub fn camera_channel(role: Role, format: PixelFormat) -> ChannelSchema {
    let schema = match raw_encoding(format) {
        None => COMPRESSED_IMAGE,
        Some(_) => RAW_IMAGE,
    };
    ChannelSchema {
        topic: format!("{CAMERA_TOPIC}{role}"),
        schema,
        schema_encoding: "protobuf",
        schema_data: descriptors(schema).encode_to_vec(),
        message_encoding: "protobuf",
    }
}

/// Returns the channel of JSON messages on a topic.
pub fn json_channel(topic: Topic) -> ChannelSchema {
    let (name, schema, data) = match topic {
        Topic::Events => ("/session/events", "gripcast.Event", EVENT_SCHEMA),
        Topic::Stored => ("/session/stored", "gripcast.Stored", STORED_SCHEMA),
        Topic::Prediction => ("/prediction", "gripcast.Prediction", PREDICTION_SCHEMA),
        Topic::Shear => (SHEAR_TOPIC, "gripcast.Shear", SHEAR_SCHEMA),
        Topic::Cameras => ("/cameras", "gripcast.Cameras", CAMERAS_SCHEMA),
    };
    ChannelSchema {
        topic: name.into(),
        schema,
        schema_encoding: "jsonschema",
        schema_data: data.into(),
        message_encoding: "json",
    }
}

/// Encodes a frame into `buffer`; `capture_ns` is the driver's capture time as wall clock time.
pub fn encode_frame(role: Role, frame: Frame, capture_ns: u64, buffer: &mut Vec<u8>) {
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
    debug_assert!(result.is_ok(), "a vector has no size limit");
}

/// Schema of a camera's messages.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ImageSchema {
    /// `foxglove.CompressedImage`.
    Compressed,
    /// `foxglove.RawImage`.
    Raw,
}

impl ImageSchema {
    /// Parses the name of a schema.
    pub(super) fn by_name(name: &str) -> Option<Self> {
        match name {
            COMPRESSED_IMAGE => Some(Self::Compressed),
            RAW_IMAGE => Some(Self::Raw),
            _ => None,
        }
    }
}

/// Decodes what [`encode_frame`] has written, to a frame without times and sequence. The image itself
/// is not decoded.
///
/// # Errors
/// `Input`: no such message, another encoding, or no JPEG where one is expected.
pub fn decode_frame(schema: ImageSchema, message: &[u8]) -> Result<Frame> {
    let damaged = |e: prost::DecodeError| Error::input("the image message is damaged").because(e);
    let frame = |format, width, height, data: Bytes| Frame {
        format,
        width,
        height,
        data: Vec::from(data).into(),
        sequence: 0,
        driver_time_ns: 0,
        received_ns: 0,
    };
    match schema {
        ImageSchema::Compressed => {
            let image = CompressedImage::decode(message).map_err(damaged)?;
            if image.format != "jpeg" {
                let what = format!("expected a JPEG, found the format {:?}", image.format);
                return Err(Error::input(what));
            }
            let header = jpeg::inspect(&image.data)?;
            let (width, height) = (header.width, header.height);
            Ok(frame(PixelFormat::Mjpg, width, height, image.data))
        }
        ImageSchema::Raw => {
            let image = RawImage::decode(message).map_err(damaged)?;
            let known = [
                PixelFormat::Yuyv,
                PixelFormat::Z16,
                PixelFormat::Grey,
                PixelFormat::Rgb,
            ];
            let name = |format: &PixelFormat| raw_encoding(*format).map(|(name, _)| name);
            let format = known
                .into_iter()
                .find(|format| name(format) == Some(&image.encoding));
            let format = format.ok_or_else(|| {
                Error::input(format!("unknown image encoding {:?}", image.encoding))
            })?;
            Ok(frame(format, image.width, image.height, image.data))
        }
    }
}

/// Returns Foxglove's name of a raw format and its bytes per pixel; `None` for compressed images.
fn raw_encoding(format: PixelFormat) -> Option<(&'static str, u32)> {
    match format {
        PixelFormat::Mjpg => None,
        PixelFormat::Yuyv => Some(("yuyv", 2)),
        PixelFormat::Z16 => Some(("16UC1", 2)),
        PixelFormat::Grey => Some(("mono8", 1)),
        PixelFormat::Rgb => Some(("rgb8", 3)),
    }
}

/// Frame data shared with a message.
struct Shared(FrameBytes);

impl AsRef<[u8]> for Shared {
    fn as_ref(&self) -> &[u8] {
        &self.0
    }
}

/// Returns the protobuf descriptors of a message.
fn descriptors(schema: &str) -> FileDescriptorSet {
    let (name, fields): (&str, &[(&str, i32, Type)]) = match schema {
        RAW_IMAGE => (
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
