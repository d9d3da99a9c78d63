//! Discovers video devices: the kernel's `video4linux` class joined with the USB devices.

use std::cmp::Ordering;
use std::fmt;
use std::fs;
use std::io;
use std::path::{Path, PathBuf};

use nusb::MaybeFuture as _;

use super::owner::NodeOwner;
use super::sysfs::{SystemRoot, attribute, file_name, hex_attribute};
use crate::camera::{CameraIdentity, FrameSize, VideoNode, VideoNodes};
use gripcast_base::error::{Error, Result};
use gripcast_imaging::PixelFormat;

/// A video device node.
#[derive(Clone, Debug, PartialEq)]
pub struct VideoDevice {
    /// Current device node (`/dev/video2`).
    pub node: PathBuf,
    /// Index among the nodes of the same USB function; the first one delivers images.
    pub index: u32,
    /// Card name, at most 31 characters.
    pub name: String,
    /// USB product string, or the card name.
    pub product: String,
    /// USB manufacturer string.
    pub manufacturer: String,
    /// USB serial; may be empty.
    pub serial: String,
    /// USB vendor id.
    pub vendor_id: Option<u16>,
    /// USB product id.
    pub product_id: Option<u16>,
    /// Number of the USB video-control interface.
    pub interface: u8,
    /// USB port path (`3-2.1`).
    pub port: String,
    /// USB bus number; devices on a bus share its bandwidth.
    pub bus: Option<u32>,
    /// Link speed, Mbit/s.
    pub speed_mbps: Option<u32>,
    /// Result of opening it.
    pub access: Access,
    /// Whether the node delivers images; `None` until probed.
    pub captures: Option<bool>,
    /// Supported modes; `None` until probed.
    pub modes: Option<Vec<Mode>>,
}

impl VideoDevice {
    /// Whether the node delivers images: as probed, else the first node of its function.
    #[must_use]
    pub fn is_camera(&self) -> bool {
        self.captures.unwrap_or(self.index == 0)
    }

    /// Whether it supports a pixel format; `None` for unknown modes.
    #[must_use]
    pub fn offers(&self, format: PixelFormat) -> Option<bool> {
        let modes = self.modes.as_ref()?;
        Some(modes.iter().any(|mode| mode.fourcc == format.fourcc()))
    }

    /// Camera identity of its stream.
    #[must_use]
    pub fn identity(&self) -> CameraIdentity {
        CameraIdentity {
            product: self.product.clone(),
            serial: self.serial.clone(),
            interface: self.interface,
            port: self.port.clone(),
            node: Some(self.node.display().to_string()),
        }
    }

    /// Orders by USB port (`3-2` before `3-10`), interface and node index.
    #[must_use]
    pub fn port_order(&self, other: &Self) -> Ordering {
        let numbers = |port: &str| -> Vec<u32> {
            port.split(['-', '.'])
                .map(|part| part.parse().unwrap_or(u32::MAX))
                .collect()
        };
        numbers(&self.port)
            .cmp(&numbers(&other.port))
            .then_with(|| self.port.cmp(&other.port))
            .then_with(|| self.interface.cmp(&other.interface))
            .then_with(|| self.index.cmp(&other.index))
    }
}

impl fmt::Display for VideoDevice {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}", self.product)?;
        match self.serial.as_str() {
            "" => f.write_str(", no serial")?,
            serial => write!(f, ", serial {serial}")?,
        }
        write!(f, ", port {}", self.port)
    }
}

/// Accessibility of a device node.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Access {
    /// Not tried.
    Unknown,
    /// Can be opened.
    Open,
    /// Permission denied: group or udev rule missing.
    Denied,
    /// The device has no node (yet).
    Missing,
    /// Opened by another process.
    Busy(Option<NodeOwner>),
    /// Other error of the operating system.
    Failed(String),
}

/// A camera mode.
#[derive(Clone, Debug, PartialEq)]
pub struct Mode {
    /// V4L2 pixel format.
    pub fourcc: [u8; 4],
    /// Width in pixels; the maximum for a continuous range.
    pub width: u32,
    /// Height in pixels.
    pub height: u32,
    /// Frame rates, 1/s.
    pub fps: Vec<f64>,
}

impl Mode {
    /// The pixel format as text (`MJPG`).
    #[must_use]
    pub fn format_name(&self) -> String {
        self.fourcc.escape_ascii().to_string().trim().to_owned()
    }
}

impl fmt::Display for Mode {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{} {}×{}", self.format_name(), self.width, self.height)?;
        for (i, fps) in self.fps.iter().enumerate() {
            let separator = if i == 0 { " @ " } else { "/" };
            write!(f, "{separator}{}", (fps * 100.0).round() / 100.0)?;
        }
        Ok(())
    }
}

/// Lists all video devices by node number, without opening them.
///
/// # Errors
/// When the device class exists and cannot be read.
pub fn scan(root: &SystemRoot) -> Result<Vec<VideoDevice>> {
    let class = root.sys.join("class/video4linux");
    let entries = match fs::read_dir(&class) {
        Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok(Vec::new()),
        other => {
            other.map_err(|e| Error::io("cannot list video devices", e).at(class.display()))?
        }
    };
    let mut numbered: Vec<(u32, PathBuf)> = entries
        .flatten()
        .filter_map(|entry| {
            let number = file_name(&entry.path())
                .strip_prefix("video")?
                .parse()
                .ok()?;
            Some((number, entry.path()))
        })
        .collect();
    numbered.sort();
    let mut devices: Vec<VideoDevice> = numbered
        .iter()
        .map(|(number, path)| describe(root, *number, path))
        .collect();
    if root.is_live() {
        join_usb(&mut devices);
    }
    Ok(devices)
}

fn describe(root: &SystemRoot, number: u32, class_entry: &Path) -> VideoDevice {
    let name = attribute(class_entry, "name").unwrap_or_default();
    // `device` links to the USB interface; its parent is the USB device.
    let interface = fs::canonicalize(class_entry.join("device")).unwrap_or_default();
    let usb = interface.parent().unwrap_or(Path::new(""));
    let vendor_id = hex_attribute(usb, "idVendor");
    let port_directory = if vendor_id.is_some() { usb } else { &interface };
    VideoDevice {
        node: root.dev.join(format!("video{number}")),
        index: attribute(class_entry, "index")
            .and_then(|text| text.parse().ok())
            .unwrap_or(0),
        product: attribute(usb, "product").unwrap_or_else(|| name.clone()),
        manufacturer: attribute(usb, "manufacturer").unwrap_or_default(),
        serial: attribute(usb, "serial").unwrap_or_default(),
        vendor_id,
        product_id: hex_attribute(usb, "idProduct"),
        interface: hex_attribute(&interface, "bInterfaceNumber")
            .and_then(|n| u8::try_from(n).ok())
            .unwrap_or(0),
        port: file_name(port_directory),
        bus: attribute(usb, "busnum").and_then(|text| text.parse().ok()),
        speed_mbps: attribute(usb, "speed")
            .and_then(|text| text.parse::<f64>().ok())
            .map(|speed| speed as u32),
        access: Access::Unknown,
        captures: None,
        modes: None,
        name,
    }
}

/// Adds attributes missing in sysfs from the USB listing.
fn join_usb(devices: &mut [VideoDevice]) {
    let Ok(listed) = nusb::list_devices().wait() else {
        return;
    };
    for usb in listed {
        let port = file_name(usb.sysfs_path());
        for device in devices.iter_mut().filter(|device| device.port == port) {
            device.vendor_id = device.vendor_id.or(Some(usb.vendor_id()));
            device.product_id = device.product_id.or(Some(usb.product_id()));
            device.bus = device.bus.or(Some(u32::from(usb.busnum())));
            if let Some(serial) = usb.serial_number().filter(|_| device.serial.is_empty()) {
                device.serial = serial.trim().to_owned();
            }
            if let Some(product) = usb
                .product_string()
                .filter(|_| device.product == device.name)
            {
                device.product = product.trim().to_owned();
            }
        }
    }
}

/// Opens the node and queries `access`, `captures` and `modes`.
pub fn probe(device: &mut VideoDevice, nodes: &dyn VideoNodes, root: &SystemRoot) {
    let mut node = match nodes.open(&device.node) {
        Ok(node) => node,
        Err(error) => {
            device.access = match error.raw_os_error() {
                Some(libc::EACCES | libc::EPERM) => Access::Denied,
                Some(libc::EBUSY) => Access::Busy(NodeOwner::find(root, &device.node)),
                Some(libc::ENOENT | libc::ENODEV | libc::ENXIO) => Access::Missing,
                _ => Access::Failed(error.to_string()),
            };
            return;
        }
    };
    device.access = match NodeOwner::find(root, &device.node) {
        Some(owner) => Access::Busy(Some(owner)),
        None => Access::Open,
    };
    if let Ok(capabilities) = node.capabilities() {
        device.captures = Some(capabilities.video_capture);
        if capabilities.video_capture {
            device.modes = Some(modes(node.as_mut()));
        }
    }
}

/// Maximum number of entries, in case of a driver whose enumeration never ends.
const ENUMERATION_LIMIT: u32 = 256;

/// All modes of an open camera.
pub(crate) fn modes(node: &mut dyn VideoNode) -> Vec<Mode> {
    let mut found = Vec::new();
    for format in 0..ENUMERATION_LIMIT {
        let Ok(fourcc) = node.pixel_format(format) else {
            break;
        };
        for size in 0..ENUMERATION_LIMIT {
            let Ok(frame_size) = node.frame_size(fourcc, size) else {
                break;
            };
            let (FrameSize::Discrete(width, height) | FrameSize::UpTo(width, height)) = frame_size;
            let fps = (0..ENUMERATION_LIMIT)
                .map_while(|i| node.frame_interval(fourcc, width, height, i).ok())
                .filter_map(|interval| interval.fps())
                .collect();
            found.push(Mode {
                fourcc,
                width,
                height,
                fps,
            });
            if matches!(frame_size, FrameSize::UpTo(..)) {
                break;
            }
        }
    }
    found
}
