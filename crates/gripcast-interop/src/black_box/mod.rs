//! The black box: the log of a collection as MCAP files (`docs/reference/black-box.md`).
//!
//! The program writes the messages of this module; [`BlackBoxLog`] finds the frames of a grasp in
//! the files again.

mod chunk;
mod log;
#[cfg(test)]
mod log_test;
mod messages;
#[cfg(test)]
pub(crate) mod sample_log;

pub use log::{BlackBoxLog, Collection, FrameMessage, LoggedMessage, MarkerValues, ShearMessage};
pub use messages::{
    ChannelSchema, CompressedImage, ImageSchema, RawImage, Topic, camera_channel, decode_frame,
    encode_frame, json_channel,
};

/// Name of the metadata record of each file.
pub const METADATA_RECORD: &str = "gripcast.black_box";
/// Key in that record: wall clock minus `CLOCK_MONOTONIC`, ns. `publish_time` minus this number is
/// the driver's capture time.
pub const CLOCK_OFFSET: &str = "wall_minus_monotonic_ns";
