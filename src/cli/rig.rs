//! `gripcast rig list|init|check`: the cameras of a rig.
//!
//! `list` shows every connected camera with its serial number, USB bus and speed, access and modes.
//! `init` writes a rig file from the connected cameras. `check` opens every camera of a rig,
//! measures its frame rate and reads its controls back.
//!
//! Exit codes: 0 ok · 4 a camera does not match the rig file · 69 no camera, or one is missing.

use std::fs;
use std::io::{self, Write as _};
use std::path::{Path, PathBuf};
use std::time::Duration;

use serde_json::{Value, json};

use super::flags::seconds;
use super::{Context, print_report};
use crate::camera_check::{CameraCheck, check_cameras, verdict};
use crate::doctor::{access_text, connected_cameras, repeated_serials, shared_buses};
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
    action: Action,
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
enum Action {
    /// List the connected cameras
    List {
        /// Print the result as JSON
        #[arg(long)]
        json: bool,
    },
    /// Write a rig file from the connected cameras
    Init {
        /// Rig file to write; must not exist
        #[arg(long, value_name = "FILE")]
        out: PathBuf,
        /// Name of the rig [default: the file name]
        #[arg(long, value_name = "NAME")]
        id: Option<String>,
    },
    /// Check every camera of a rig: open it, measure its frame rate, read its controls back
    Check {
        /// Name or file of the rig
        #[arg(long, value_name = "NAME|FILE")]
        rig: String,
        /// Measuring time, s
        #[arg(long, value_name = "S", default_value_t = 2.0, value_parser = seconds)]
        seconds: f64,
        /// Record the frames for a camera with the source `replay`
        #[arg(long, value_name = "DIR")]
        record: Option<PathBuf>,
        /// Print the result as JSON
        #[arg(long)]
        json: bool,
    },
}

/// Runs the command.
pub(crate) fn run(context: &Context, args: Args) -> Result<()> {
    let root = SystemRoot {
        sys: args.sysfs_root,
        dev: args.dev_root,
        proc: args.proc_root,
    };
    match args.action {
        Action::List { json } => list(context, &root, json),
        Action::Init { out, id } => init(context, &root, &out, id),
        Action::Check {
            rig,
            seconds,
            record,
            json,
        } => {
            let rig = RigFile::find(&rig)?;
            let checks = check_cameras(
                RigSources::new(&rig, &root, &mut VirtualSource::new(1))?.openers,
                &root,
                Duration::from_secs_f64(seconds),
                record.as_deref(),
            );
            let cameras: Vec<Value> = checks.iter().map(CameraCheck::json).collect();
            let report = json!({ "rig": rig.id, "cameras": cameras });
            print_report(json, &report, |_| {
                checks.iter().map(CameraCheck::text).collect()
            })?;
            verdict(&checks)
        }
    }
}

fn list(context: &Context, root: &SystemRoot, json: bool) -> Result<()> {
    let devices = connected_cameras(root)?;
    let warnings = [shared_buses(&devices), repeated_serials(&devices)].concat();
    let cameras: Vec<Value> = devices.iter().map(device_json).collect();
    let report = json!({ "cameras": cameras, "warnings": warnings });
    if json || !devices.is_empty() {
        print_report(json, &report, |_| devices.iter().map(device_text).collect())?;
    }
    if !json {
        context.warn(&warnings);
    }
    explain_denied(&devices);
    if devices.is_empty() {
        return Err(Error::new(ErrorKind::Device, "no camera is connected").remedy(
            "plug one in; if it does not appear, check `sudo dmesg`; `--rig virtual` works without \
             cameras",
        ));
    }
    Ok(())
}

/// Explains once per product how to get access.
fn explain_denied(devices: &[VideoDevice]) {
    let mut explained = Vec::new();
    for device in devices.iter().filter(|d| d.access == Access::Denied) {
        let ids = (device.vendor_id, device.product_id);
        if !explained.contains(&ids) {
            explained.push(ids);
            note!("{}", permission_error(device, "open"));
        }
    }
}

/// Returns the likely role of a camera, by its product.
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
    let mut unsupported: Vec<String> = Vec::new();
    for mode in device.modes.iter().flatten() {
        if PixelFormat::from_fourcc(mode.fourcc).is_some() {
            text += &format!("    {mode}\n");
        } else if !unsupported.contains(&mode.format_name()) {
            unsupported.push(mode.format_name());
        }
    }
    if !unsupported.is_empty() {
        text += &format!("    unsupported formats: {}\n", unsupported.join(" "));
    }
    text
}

fn init(context: &Context, root: &SystemRoot, out: &Path, id: Option<String>) -> Result<()> {
    let stem = out.file_stem().unwrap_or_default();
    let id = id.unwrap_or_else(|| stem.to_string_lossy().into_owned());
    let draft = draft(&id, &connected_cameras(root)?)?;
    let mut file = fs::File::create_new(out).map_err(|error| {
        let exists = error.kind() == io::ErrorKind::AlreadyExists;
        let error = if exists {
            Error::usage("the rig file exists").remedy("give another --out, or remove the file")
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
