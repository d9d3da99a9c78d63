//! Proof of the emulator itself, without the program under test: streams all four cameras
//! through V4L2 at once and compares every image with what was fed.

use std::collections::BTreeMap;
use std::fs;
use std::io;
use std::path::Path;
use std::thread;
use std::time::{Duration, Instant};

use serde::Serialize;
use v4l::FourCC;
use v4l::buffer::Type;
use v4l::io::traits::CaptureStream as _;
use v4l::prelude::{Device, MmapStream};
use v4l::video::Capture as _;

use crate::feed;
use crate::pattern;
use crate::sysfs::{self, VideoNode};

/// What one camera delivered.
#[derive(Debug, Serialize)]
struct Delivered {
    node: String,
    name: String,
    product: String,
    serial: String,
    interface: u8,
    frames: u32,
    identical: u32,
    sequence_gaps: u32,
    /// Rate by the driver's time stamps, 1/s.
    fps: f64,
}

/// A camera as the probe looks for it.
struct Wanted {
    role: &'static str,
    serial: &'static str,
    interface: u8,
    fourcc: &'static [u8; 4],
    width: u32,
    height: u32,
}

const WANTED: [Wanted; 4] = [
    Wanted {
        role: "left",
        serial: "2BNN4ZE7",
        interface: 0,
        fourcc: b"MJPG",
        width: 3280,
        height: 2464,
    },
    Wanted {
        role: "right",
        serial: "28F5K4RR",
        interface: 0,
        fourcc: b"MJPG",
        width: 3280,
        height: 2464,
    },
    Wanted {
        role: "depth",
        serial: "814412070123",
        interface: 0,
        fourcc: b"Z16 ",
        width: 1280,
        height: 720,
    },
    Wanted {
        role: "rgb",
        serial: "814412070123",
        interface: 3,
        fourcc: b"YUYV",
        width: 1280,
        height: 720,
    },
];

const FRAMES: u32 = 50;

/// Opens the node of a camera that offers its format.
fn open(wanted: &Wanted, nodes: &[VideoNode]) -> io::Result<(VideoNode, Device)> {
    for node in nodes {
        if (node.serial.as_str(), node.interface) != (wanted.serial, wanted.interface) {
            continue;
        }
        let device = Device::with_path(&node.node)?;
        let offers = device.enum_formats().unwrap_or_default();
        if offers.iter().any(|f| f.fourcc.repr == *wanted.fourcc) {
            return Ok((node.clone(), device));
        }
    }
    let what = format!("no node for the {} camera", wanted.role);
    Err(io::Error::new(io::ErrorKind::NotFound, what))
}

/// Whether an image is one of those fed.
fn is_as_sent(wanted: &Wanted, image: &[u8], fed: &[Vec<u8>]) -> bool {
    let (width, height) = (wanted.width, wanted.height);
    match wanted.fourcc {
        b"MJPG" => {
            let number = image.get(6..14).and_then(|bytes| bytes.try_into().ok());
            number.is_some_and(|bytes| {
                let number = u64::from_be_bytes(bytes);
                fed.iter().any(|file| feed::numbered(file, number) == image)
            })
        }
        b"Z16 " => image == pattern::depth(pattern::depth_number(image), width, height),
        _ => image == pattern::colour(pattern::colour_number(image), width, height),
    }
}

fn stream(wanted: &Wanted, nodes: &[VideoNode], fed: &[Vec<u8>]) -> io::Result<Delivered> {
    let (node, device) = open(wanted, nodes)?;
    let mut format = device.format()?;
    format.fourcc = FourCC::new(wanted.fourcc);
    (format.width, format.height) = (wanted.width, wanted.height);
    device.set_format(&format)?;
    let mut stream = MmapStream::with_buffers(&device, Type::VideoCapture, 4)?;
    let mut identical = 0;
    let mut sequence_gaps = 0;
    let mut previous = None;
    let mut first_s = 0.0;
    let mut last_s = 0.0;
    for _ in 0..FRAMES {
        let (buffer, meta) = stream.next()?;
        let image = &buffer[..meta.bytesused as usize];
        identical += u32::from(is_as_sent(wanted, image, fed));
        last_s = meta.timestamp.sec as f64 + meta.timestamp.usec as f64 * 1e-6;
        match previous {
            None => first_s = last_s,
            Some(before) => sequence_gaps += meta.sequence - before - 1,
        }
        previous = Some(meta.sequence);
    }
    Ok(Delivered {
        node: node.node.display().to_string(),
        name: node.name,
        product: node.product,
        serial: node.serial,
        interface: node.interface,
        frames: FRAMES,
        identical,
        sequence_gaps,
        fps: f64::from(FRAMES - 1) / (last_s - first_s),
    })
}

/// Reads all JPEG files below a directory of images.
fn fed(dir: &Path) -> io::Result<Vec<Vec<u8>>> {
    let mut files = Vec::new();
    for entry in fs::read_dir(dir)? {
        let path = entry?.path();
        if path.is_dir() {
            files.extend(fed(&path)?);
        } else {
            files.push(fs::read(&path)?);
        }
    }
    Ok(files)
}

/// Waits until the five camera streams and the pedal have their nodes.
pub(crate) fn wait_for_nodes() -> io::Result<()> {
    const NODES: usize = 2 * 5;
    const PATIENCE: Duration = Duration::from_secs(20);
    let start = Instant::now();
    loop {
        let (video, hid) = (sysfs::video_nodes()?, sysfs::hid_names());
        let all_there = video.iter().all(|node| node.node.exists());
        if video.len() == NODES && all_there && hid.len() == 1 {
            return Ok(());
        }
        if start.elapsed() > PATIENCE {
            let what =
                format!("expected {NODES} video nodes and 1 pedal, found {video:#?} and {hid:?}");
            return Err(io::Error::new(io::ErrorKind::TimedOut, what));
        }
        thread::sleep(Duration::from_millis(20));
    }
}

/// Streams all cameras and writes `probe.json` into `out`. All devices must be plugged.
pub(crate) fn run(left: &Path, right: &Path, out: &Path) -> io::Result<()> {
    wait_for_nodes()?;
    let nodes = sysfs::video_nodes()?;
    let fed = [fed(left)?, fed(right)?];
    let delivered = thread::scope(|scope| {
        let running: Vec<_> = WANTED
            .iter()
            .map(|wanted| {
                let fed: &[Vec<u8>] = match wanted.role {
                    "left" => &fed[0],
                    "right" => &fed[1],
                    _ => &[],
                };
                let nodes = &nodes;
                scope.spawn(move || stream(wanted, nodes, fed))
            })
            .collect();
        let mut delivered = BTreeMap::new();
        for (wanted, thread) in WANTED.iter().zip(running) {
            let outcome = thread
                .join()
                .map_err(|_| io::Error::other(format!("{}: the stream panicked", wanted.role)))?;
            delivered.insert(wanted.role, outcome?);
        }
        io::Result::Ok(delivered)
    })?;
    let report = serde_json::json!({ "cameras": delivered, "hid": sysfs::hid_names() });
    fs::write(out.join("probe.json"), format!("{report:#}\n"))
}
