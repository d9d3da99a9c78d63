//! `gripcast rig list|init|check`: the cameras of a rig.
//!
//! `list` shows every camera that the kernel sees, with its serial number, USB bus and speed,
//! whether it can be opened, and its modes. `init` writes a rig file from what is plugged in.
//! `check` opens every camera of a rig, measures its frame rate and reads its controls back.
//!
//! Exit codes: 0 all is well · 4 a camera of the rig does not do what the file says · 69 a camera
//! is missing, or none is there at all.

use std::fs;
use std::io::{self, Write as _};
use std::path::PathBuf;
use std::time::Duration;

use serde_json::{Value, json};

use super::{Context, print, print_json};
use crate::camera_check::{CameraCheck, check_cameras, verdict};
use crate::doctor::{access_text, connected_cameras, shared_buses};
use crate::note;
use gripcast_base::error::{Error, ErrorKind, Result};
use gripcast_capture::calibration::{RigFile, draft};
use gripcast_capture::camera::RigSources;
use gripcast_capture::device::{Access, SystemRoot, VideoDevice, permission_error};
use gripcast_imaging::PixelFormat;
use gripcast_virtual_rig::VirtualSource;

/// Arguments.
#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    #[command(subcommand)]
    verb: Verb,
    /// Read device descriptions below DIR instead of /sys
    #[arg(
        long,
        global = true,
        hide = true,
        value_name = "DIR",
        default_value = "/sys"
    )]
    sysfs_root: PathBuf,
    /// Look for device nodes below DIR instead of /dev
    #[arg(
        long,
        global = true,
        hide = true,
        value_name = "DIR",
        default_value = "/dev"
    )]
    dev_root: PathBuf,
    /// Look for the owners of device nodes below DIR instead of /proc
    #[arg(
        long,
        global = true,
        hide = true,
        value_name = "DIR",
        default_value = "/proc"
    )]
    proc_root: PathBuf,
}

#[derive(Debug, clap::Subcommand)]
enum Verb {
    /// List the cameras that are plugged in
    List {
        /// Print JSON
        #[arg(long)]
        json: bool,
    },
    /// Write a rig file from what is plugged in
    Init {
        /// File to write; it must not exist
        #[arg(long, value_name = "FILE")]
        out: PathBuf,
        /// Name of the rig; by default that of the file
        #[arg(long)]
        id: Option<String>,
    },
    /// Open every camera of a rig, measure its frame rate, read its controls back
    Check {
        /// Name or file of the rig
        #[arg(long, value_name = "NAME|FILE")]
        rig: String,
        /// How long to measure, s
        #[arg(long, default_value_t = 2.0, value_parser = seconds)]
        seconds: f64,
        /// Keep the frames as a recording that a `replay` camera plays
        #[arg(long, value_name = "DIR")]
        record: Option<PathBuf>,
        /// Print JSON
        #[arg(long)]
        json: bool,
    },
}

/// A duration to measure for, s.
pub(super) fn seconds(text: &str) -> Result<f64, String> {
    let value: f64 = text.parse().map_err(|_| "not a number".to_owned())?;
    if (0.1..=3600.0).contains(&value) {
        Ok(value)
    } else {
        Err("must be from 0.1 to 3600".to_owned())
    }
}

/// Runs the verb.
pub(crate) fn run(context: &Context, args: Args) -> Result<()> {
    let root = SystemRoot {
        sys: args.sysfs_root,
        dev: args.dev_root,
        proc: args.proc_root,
    };
    match args.verb {
        Verb::List { json } => list(context, &root, json),
        Verb::Init { out, id } => init(context, &root, &out, id),
        Verb::Check {
            rig,
            seconds,
            record,
            json,
        } => {
            let rig = RigFile::find(&rig)?;
            let checks = check_cameras(
                RigSources::of(&rig, &root, &mut VirtualSource::new(1))?.openers,
                &root,
                Duration::from_secs_f64(seconds),
                record.as_deref(),
            );
            if json {
                print_json(
                    &json!({ "rig": rig.id, "cameras": checks.iter().map(CameraCheck::json).collect::<Vec<_>>() }),
                )?;
            } else {
                for check in &checks {
                    print(&check.text())?;
                }
            }
            verdict(&checks)
        }
    }
}

fn list(context: &Context, root: &SystemRoot, json: bool) -> Result<()> {
    let devices = connected_cameras(root)?;
    let warnings = shared_buses(&devices);
    if json {
        let cameras: Vec<Value> = devices.iter().map(device_json).collect();
        print_json(&json!({ "cameras": cameras, "warnings": warnings }))?;
    } else {
        for device in &devices {
            print(&device_text(device))?;
        }
        if !context.quiet {
            for warning in &warnings {
                note!("note: {warning}");
            }
        }
    }
    explain_denied(&devices);
    if devices.is_empty() {
        return Err(Error::new(ErrorKind::Device, "no camera is plugged in").remedy(
            "plug one in; if it does not appear, `sudo dmesg` tells what the kernel makes of it. \
             `--rig virtual` works without cameras",
        ));
    }
    Ok(())
}

/// Says once for each product how to get permission.
fn explain_denied(devices: &[VideoDevice]) {
    let mut told = Vec::new();
    for device in devices.iter().filter(|d| d.access == Access::Denied) {
        let ids = (device.vendor_id, device.product_id);
        if !told.contains(&ids) {
            told.push(ids);
            note!("{}", permission_error(device, "open"));
        }
    }
}

/// What a camera would be good for, as far as its product tells.
fn role_hint(device: &VideoDevice) -> Option<&'static str> {
    let offers = |format| device.offers(format) == Some(true);
    if device.product.starts_with("GelSight Mini") {
        Some("left or right")
    } else if offers(PixelFormat::Z16) {
        Some("depth")
    } else if device.product.contains("RealSense") && offers(PixelFormat::Yuyv) {
        Some("rgb")
    } else {
        None
    }
}

fn device_json(device: &VideoDevice) -> Value {
    let hex = |id: Option<u16>| id.map(|id| format!("{id:04x}"));
    let modes = device.modes.as_ref().map(|modes| {
        modes
            .iter()
            .map(|mode| {
                json!({
                    "format": mode.format_name(),
                    "fps": mode.fps,
                    "height": mode.height,
                    "width": mode.width,
                })
            })
            .collect::<Vec<_>>()
    });
    json!({
        "access": match &device.access {
            Access::Unknown => "unknown",
            Access::Open => "ready",
            Access::Denied => "denied",
            Access::Missing => "missing",
            Access::Busy(_) => "busy",
            Access::Failed(_) => "failed",
        },
        "access_text": access_text(&device.access),
        "bus": device.bus,
        "interface": device.interface,
        "modes": modes,
        "name": device.name,
        "node": device.node,
        "port": device.port,
        "product": device.product,
        "product_id": hex(device.product_id),
        "role_hint": role_hint(device),
        "serial": device.serial,
        "speed_mbps": device.speed_mbps,
        "vendor_id": hex(device.vendor_id),
    })
}

fn device_text(device: &VideoDevice) -> String {
    let mut text = device.product.clone();
    if let Some(hint) = role_hint(device) {
        text += &format!("  ({hint})");
    }
    let serial = match device.serial.as_str() {
        "" => "no serial".to_owned(),
        serial => format!("serial {serial}"),
    };
    let ids = match (device.vendor_id, device.product_id) {
        (Some(vendor), Some(product)) => format!(" · {vendor:04x}:{product:04x}"),
        _ => String::new(),
    };
    let bus = match (device.bus, device.speed_mbps) {
        (Some(bus), Some(speed)) => format!(" · bus {bus}, {speed} Mbit/s"),
        (Some(bus), None) => format!(" · bus {bus}"),
        _ => String::new(),
    };
    text += &format!(
        "\n  {serial}{ids} · port {}{bus} · interface {} · {} · {}\n",
        device.port,
        device.interface,
        device.node.display(),
        access_text(&device.access)
    );
    let mut unread: Vec<String> = Vec::new();
    for mode in device.modes.iter().flatten() {
        if PixelFormat::from_fourcc(mode.fourcc).is_some() {
            text += &format!("    {mode}\n");
        } else if !unread.contains(&mode.format_name()) {
            unread.push(mode.format_name());
        }
    }
    if !unread.is_empty() {
        text += &format!("    not read by gripcast: {}\n", unread.join(" "));
    }
    text
}

fn init(
    context: &Context,
    root: &SystemRoot,
    out: &std::path::Path,
    id: Option<String>,
) -> Result<()> {
    let stem = out
        .file_stem()
        .map(|stem| stem.to_string_lossy().into_owned());
    let id = id.or(stem).unwrap_or_default();
    let draft = draft(&id, &connected_cameras(root)?)?;
    let mut file = fs::File::create_new(out).map_err(|error| {
        let exists = error.kind() == io::ErrorKind::AlreadyExists;
        let error = if exists {
            Error::usage("the rig file exists already")
                .remedy("give another --out, or remove the file")
        } else {
            Error::io("cannot create the rig file", error)
        };
        error.at(out.display())
    })?;
    file.write_all(draft.text.as_bytes())
        .and_then(|()| file.sync_all())
        .map_err(|e| Error::io("cannot write the rig file", e).at(out.display()))?;
    if !context.quiet {
        note!("wrote {}", out.display());
        for note in &draft.notes {
            note!("note: {note}");
        }
    }
    Ok(())
}
