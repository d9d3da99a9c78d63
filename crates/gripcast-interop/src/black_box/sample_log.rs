//! Small logs for tests, as the program writes them.

use std::collections::BTreeMap;
use std::path::Path;

use mcap::WriteOptions;
use mcap::records::{MessageHeader, Metadata};

use super::{
    CLOCK_OFFSET, ChannelSchema, METADATA_RECORD, Topic, camera_channel, encode_frame, json_channel,
};
use gripcast_imaging::{Frame, PixelFormat, Role};

/// Messages per chunk.
pub(crate) const PER_CHUNK: usize = 6;

/// An entry of a log; its log time is the capture time.
#[derive(Clone)]
pub(crate) enum SampleEntry {
    Frame(Role, Frame),
    /// A JSON message with its time, ns.
    Shear(u64, serde_json::Value),
}

impl SampleEntry {
    pub(crate) fn time_ns(&self) -> u64 {
        match self {
            Self::Frame(_, frame) => frame.driver_time_ns,
            Self::Shear(time_ns, _) => *time_ns,
        }
    }
}

/// Writes a log with the entries in their order.
pub(crate) fn write_log(path: &Path, clock_offset_ns: Option<i128>, entries: &[SampleEntry]) {
    let file = std::fs::File::create(path).unwrap();
    let mut writer = WriteOptions::new()
        .compression(None)
        .chunk_size(None)
        .disable_seeking(true)
        .create(file)
        .unwrap();
    if let Some(offset) = clock_offset_ns {
        let metadata = BTreeMap::from([(CLOCK_OFFSET.to_owned(), offset.to_string())]);
        let name = METADATA_RECORD.to_owned();
        writer.write_metadata(&Metadata { name, metadata }).unwrap();
    }
    let offset = clock_offset_ns.unwrap_or(0);
    let mut channels: BTreeMap<(Option<Role>, Option<PixelFormat>), u16> = BTreeMap::new();
    for (index, entry) in entries.iter().enumerate() {
        let at = u64::try_from(i128::from(entry.time_ns()) + offset).unwrap();
        let mut message = Vec::new();
        let (key, channel, sequence): (_, ChannelSchema, u32) = match entry.clone() {
            SampleEntry::Frame(role, frame) => {
                let (format, sequence) = (frame.format, frame.sequence);
                encode_frame(role, frame, at, &mut message);
                let key = (Some(role), Some(format));
                (key, camera_channel(role, format), sequence)
            }
            SampleEntry::Shear(_, json) => {
                message = serde_json::to_vec(&json).unwrap();
                ((None, None), json_channel(Topic::Shear), index as u32)
            }
        };
        let channel_id = *channels.entry(key).or_insert_with(|| {
            let schema = writer
                .add_schema(
                    channel.schema,
                    channel.schema_encoding,
                    &channel.schema_data,
                )
                .unwrap();
            writer
                .add_channel(
                    schema,
                    &channel.topic,
                    channel.message_encoding,
                    &BTreeMap::new(),
                )
                .unwrap()
        });
        let header = MessageHeader {
            channel_id,
            sequence,
            log_time: at,
            publish_time: at,
        };
        writer.write_to_known_channel(&header, &message).unwrap();
        if (index + 1) % PER_CHUNK == 0 {
            writer.flush().unwrap();
        }
    }
    writer.finish().unwrap();
}
