//! Camera controls by name.
//!
//! Control ids are used because the kernel's names change between versions (`exposure_auto` to
//! `auto_exposure`, `exposure_absolute` to `exposure_time_absolute`).

use std::collections::BTreeMap;
use std::io;

use super::source::ControlValues;
use super::v4l2_node::{ControlRange, VideoNode};

const USER: u32 = 0x0098_0900;
const CAMERA: u32 = 0x009a_0900;

/// Known controls: name, V4L2 control id. Automatic modes come first: some controls can only be set
/// when these are off.
pub(crate) const CONTROLS: [(&str, u32); 14] = [
    ("auto_exposure", CAMERA + 1),
    ("exposure_dynamic_framerate", CAMERA + 3),
    ("white_balance_automatic", USER + 12),
    ("exposure_time_absolute", CAMERA + 2),
    ("gain", USER + 19),
    ("white_balance_temperature", USER + 26),
    ("power_line_frequency", USER + 24),
    ("brightness", USER),
    ("contrast", USER + 1),
    ("saturation", USER + 2),
    ("hue", USER + 3),
    ("gamma", USER + 16),
    ("sharpness", USER + 27),
    ("backlight_compensation", USER + 28),
];

/// Former names of controls, with the current one.
pub(crate) const FORMER_NAMES: [(&str, &str); 4] = [
    ("exposure_auto", "auto_exposure"),
    ("exposure_absolute", "exposure_time_absolute"),
    ("exposure_auto_priority", "exposure_dynamic_framerate"),
    ("white_balance_temperature_auto", "white_balance_automatic"),
];

/// Readable controls of a camera: name and id.
pub(crate) type Available = Vec<(&'static str, u32)>;

/// Lists the readable controls of a camera.
///
/// # Errors
/// `ENODEV` for an unplugged camera.
pub(crate) fn available(node: &mut dyn VideoNode) -> io::Result<Available> {
    let mut found = Vec::new();
    for (name, id) in CONTROLS {
        match node.control_range(id) {
            Ok(range) if range.readable => found.push((name, id)),
            Err(error) if error.raw_os_error() == Some(libc::ENODEV) => return Err(error),
            Ok(_) | Err(_) => {}
        }
    }
    Ok(found)
}

/// Reads the control values, without those that fail.
///
/// # Errors
/// `ENODEV` for an unplugged camera.
pub(crate) fn read(node: &mut dyn VideoNode, available: &Available) -> io::Result<ControlValues> {
    let mut values = ControlValues::new();
    for &(name, id) in available {
        match node.control(id) {
            Ok(value) => {
                values.insert(name.to_owned(), i64::from(value));
            }
            Err(error) if error.raw_os_error() == Some(libc::ENODEV) => return Err(error),
            Err(_) => {}
        }
    }
    Ok(values)
}

/// Sets controls, automatic modes first, and reads each back. Returns warnings about those that
/// were not set.
///
/// # Errors
/// `ENODEV` for an unplugged camera.
pub(crate) fn apply(
    node: &mut dyn VideoNode,
    wanted: &BTreeMap<String, i64>,
) -> io::Result<Vec<String>> {
    let mut warnings: Vec<String> = wanted
        .keys()
        .filter(|name| CONTROLS.iter().all(|(known, _)| known != name))
        .map(|name| format!("unknown control `{name}` was not set"))
        .collect();
    let mut absent = Vec::new();
    for (name, id) in CONTROLS {
        let Some(&value) = wanted.get(name) else {
            continue;
        };
        let range = match node.control_range(id) {
            Err(error) if error.raw_os_error() == Some(libc::EINVAL) => {
                absent.push(name);
                continue;
            }
            other => other,
        };
        match range.and_then(|range| apply_one(node, id, range, value)) {
            Ok(None) => {}
            Ok(Some(problem)) => warnings.push(format!("control `{name}`: {problem}")),
            Err(error) if error.raw_os_error() == Some(libc::ENODEV) => return Err(error),
            Err(error) => warnings.push(format!("cannot set control `{name}`: {error}")),
        }
    }
    if !absent.is_empty() {
        warnings.push(format!(
            "the camera does not support the controls {}",
            absent.join(", ")
        ));
    }
    Ok(warnings)
}

fn apply_one(
    node: &mut dyn VideoNode,
    id: u32,
    range: ControlRange,
    value: i64,
) -> io::Result<Option<String>> {
    let in_range = i32::try_from(value)
        .ok()
        .filter(|v| (range.minimum..=range.maximum).contains(v));
    let Some(wanted) = in_range else {
        return Ok(Some(format!(
            "not set: {value} is outside {}…{}",
            range.minimum, range.maximum
        )));
    };
    if !range.writable {
        return Ok(Some("it is read-only".to_owned()));
    }
    node.set_control(id, wanted)?;
    let found = node.control(id)?;
    Ok((found != wanted).then(|| format!("set to {wanted}, read back {found}")))
}
