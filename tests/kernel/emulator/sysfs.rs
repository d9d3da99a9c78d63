//! What the guest's kernel says of its cameras and pedals.

use std::fs;
use std::io;
use std::path::{Path, PathBuf};

/// A capture node with the USB device behind it.
#[derive(Clone, Debug)]
pub(crate) struct VideoNode {
    pub(crate) node: PathBuf,
    /// Name that V4L2 gives, cut off at 31 characters.
    pub(crate) name: String,
    pub(crate) product: String,
    pub(crate) serial: String,
    /// Video-control interface.
    pub(crate) interface: u8,
}

fn attribute(dir: &Path, name: &str) -> Option<String> {
    fs::read_to_string(dir.join(name))
        .ok()
        .map(|text| text.trim_end_matches('\n').to_owned())
}

/// Video nodes in order, metadata nodes among them. Nodes that vanish meanwhile are left out.
pub(crate) fn video_nodes() -> io::Result<Vec<VideoNode>> {
    let mut found = Vec::new();
    for entry in fs::read_dir("/sys/class/video4linux")? {
        let entry = entry?;
        let interface = entry.path().join("device");
        let read = || {
            let device = fs::canonicalize(&interface).ok()?.parent()?.to_owned();
            Some(VideoNode {
                node: Path::new("/dev").join(entry.file_name()),
                name: attribute(&entry.path(), "name")?,
                product: attribute(&device, "product")?,
                serial: attribute(&device, "serial")?,
                interface: u8::from_str_radix(&attribute(&interface, "bInterfaceNumber")?, 16)
                    .ok()?,
            })
        };
        found.extend(read());
    }
    found.sort_by(|a, b| a.node.cmp(&b.node));
    Ok(found)
}

/// HID names of the raw HID nodes.
pub(crate) fn hid_names() -> Vec<String> {
    let Ok(entries) = fs::read_dir("/sys/class/hidraw") else {
        return Vec::new();
    };
    let mut names: Vec<String> = entries
        .filter_map(|entry| attribute(&entry.ok()?.path().join("device"), "uevent"))
        .filter_map(|uevent| {
            let line = uevent.lines().find_map(|l| l.strip_prefix("HID_NAME="))?;
            Some(line.to_owned())
        })
        .collect();
    names.sort();
    names
}
