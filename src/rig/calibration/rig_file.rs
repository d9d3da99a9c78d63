//! The rig file (`calib/rigs/<id>.toml`).

use std::collections::BTreeMap;
use std::path::PathBuf;

use serde::{Deserialize, Serialize};

use crate::imaging::{PixelFormat, Role};

/// A rig: cameras by role, pedals.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RigFile {
    /// Version of this file format; 1.
    pub schema: u32,
    /// Name of the rig, stored with every dataset.
    pub id: String,
    /// Cameras by role; `left` and `right` are needed to collect.
    pub cameras: BTreeMap<Role, CameraConfig>,
    /// Foot pedals and presenters.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub pedals: Vec<PedalConfig>,
}

/// Where the frames of a camera come from.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum SourceKind {
    /// A real camera through V4L2.
    #[default]
    V4l2,
    /// A recorded directory.
    Replay,
    /// The built-in virtual rig.
    Virtual,
}

/// One camera of a rig.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CameraConfig {
    /// Kind of source.
    #[serde(default)]
    pub source: SourceKind,
    /// USB product string, or its beginning (`GelSight Mini`).
    #[serde(default, skip_serializing_if = "String::is_empty")]
    pub product: String,
    /// USB serial; needed when two cameras of the same product are bound.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub serial: Option<String>,
    /// USB video-control interface number; tells depth (0) from colour (3) on a D435.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub interface: Option<u8>,
    /// USB port path (`3-2.1`), only for devices without a serial.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub port: Option<String>,
    /// Directory of a `replay` source.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub path: Option<PathBuf>,
    /// Play a `replay` source as fast as it is read instead of with its own timing.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub unpaced: bool,
    /// Pixel format that is asked for.
    pub format: PixelFormat,
    /// Width in pixels.
    pub width: u32,
    /// Height in pixels.
    pub height: u32,
    /// Nominal frame rate, 1/s.
    pub fps: f64,
    /// Named crop profile of a tactile camera.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub crop_profile: Option<String>,
    /// Metres per count of a depth camera.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub depth_unit_m: Option<f64>,
    /// Controls to set, by V4L2 name in snake case; read back and stored with every frame.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub controls: BTreeMap<String, i64>,
}

/// A HID pedal or presenter.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PedalConfig {
    /// USB vendor id.
    pub vendor: u16,
    /// USB product id.
    pub product: u16,
    /// HID keyboard usage code → command (`trigger`, `stable`, `slip`, `undo`, …); by name of the
    /// key (`a`, `b`, `page_down`).
    pub keys: BTreeMap<String, String>,
    /// Presses closer together than this are bounces of the contact, ms.
    #[serde(default = "PedalConfig::default_debounce_ms")]
    pub debounce_ms: u64,
}

impl PedalConfig {
    fn default_debounce_ms() -> u64 {
        80
    }
}
