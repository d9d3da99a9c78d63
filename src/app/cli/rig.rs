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
use std::path::{Path, PathBuf};
use std::thread;
use std::time::Duration;

use serde_json::{Value, json};

use super::{Context, print, print_json};
use crate::error::{Error, ErrorKind, Result};
use crate::imaging::{Intrinsics, PixelFormat, Role};
use crate::rig::calibration::{RigFile, colour_intrinsics, draft};
use crate::rig::camera::{
    CameraOpener, CaptureError, ControlValues, FrameSource, KernelNodes, Recorder, RigSources,
    StreamInfo,
};
use crate::rig::device::{
    Access, SystemRoot, VideoDevice, crowded_buses, permission_error, probe, scan,
};

/// Share of the nominal frame rate that a camera has to reach; GelSight Minis are known to
/// deliver three quarters of theirs.
const RATE_NEEDED: f64 = 0.7;
/// Share of damaged frames that is borne.
const DAMAGE_BORNE: f64 = 0.1;
/// Longest wait for one frame.
const FRAME_TIMEOUT: Duration = Duration::from_secs(1);
/// Waits without a frame after which a camera counts as silent.
const TIMEOUTS_BORNE: u32 = 5;

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

fn seconds(text: &str) -> Result<f64, String> {
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
            let checks = check(
                RigSources::of(&rig, &root, 1)?.openers,
                &root,
                Duration::from_secs_f64(seconds),
                record.as_deref(),
            );
            if json {
                print_json(
                    &json!({ "rig": rig.id, "cameras": checks.iter().map(Check::json).collect::<Vec<_>>() }),
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

fn cameras(root: &SystemRoot) -> Result<Vec<VideoDevice>> {
    let mut devices = scan(root)?;
    for device in &mut devices {
        probe(device, &KernelNodes, root);
    }
    devices.retain(VideoDevice::is_camera);
    Ok(devices)
}

fn list(context: &Context, root: &SystemRoot, json: bool) -> Result<()> {
    let devices = cameras(root)?;
    let warnings = crowding(&devices);
    if json {
        let cameras: Vec<Value> = devices.iter().map(device_json).collect();
        print_json(&json!({ "cameras": cameras, "warnings": warnings }))?;
    } else {
        for device in &devices {
            print(&device_text(device))?;
        }
        if !context.quiet {
            for warning in &warnings {
                eprintln!("note: {warning}");
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
            eprintln!("{}", permission_error(device, "open"));
        }
    }
}

/// One sentence for each USB-2 bus that several cameras share.
fn crowding(devices: &[VideoDevice]) -> Vec<String> {
    crowded_buses(devices)
        .iter()
        .map(|(bus, on_bus)| {
            let names: Vec<String> = on_bus.iter().map(ToString::to_string).collect();
            format!(
                "{} cameras share USB bus {bus}, which may be too little for all: {}",
                on_bus.len(),
                names.join("; ")
            )
        })
        .collect()
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

fn access_text(access: &Access) -> String {
    match access {
        Access::Unknown => "not tried".to_owned(),
        Access::Open => "ready".to_owned(),
        Access::Denied => "no permission".to_owned(),
        Access::Missing => "no device node".to_owned(),
        Access::Busy(None) => "in use".to_owned(),
        Access::Busy(Some(owner)) => format!("in use by {owner}"),
        Access::Failed(reason) => reason.clone(),
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
    let draft = draft(&id, &cameras(root)?)?;
    let mut file = fs::File::create_new(out).map_err(|error| {
        let exists = error.kind() == io::ErrorKind::AlreadyExists;
        let error = if exists {
            Error::new(ErrorKind::Usage, "the rig file exists already")
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
        eprintln!("wrote {}", out.display());
        for note in &draft.notes {
            eprintln!("note: {note}");
        }
    }
    Ok(())
}

/// What the check of one camera found.
#[derive(Debug)]
struct Check {
    role: Role,
    wanted: String,
    opened: Option<Opened>,
    problems: Vec<String>,
    /// The camera is not there.
    missing: bool,
}

#[derive(Debug)]
struct Opened {
    info: StreamInfo,
    frames: Frames,
    controls: ControlValues,
    intrinsics: Option<Intrinsics>,
    notes: Vec<String>,
}

/// Counts over the time of the measurement.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
struct Frames {
    received: u64,
    lost: u64,
    damaged: u64,
    fps: Option<f64>,
}

fn check(
    openers: Vec<Box<dyn CameraOpener>>,
    root: &SystemRoot,
    duration: Duration,
    record: Option<&Path>,
) -> Vec<Check> {
    // All at once, because cameras compete for the bus.
    thread::scope(|scope| {
        let running: Vec<_> = openers
            .into_iter()
            .map(|mut opener| {
                let role = opener.role();
                let wanted = opener.describe();
                let worker =
                    scope.spawn(move || check_one(opener.as_mut(), root, duration, record));
                (role, wanted, worker)
            })
            .collect();
        running
            .into_iter()
            .map(|(role, wanted, worker)| {
                worker.join().unwrap_or_else(|_| Check {
                    role,
                    wanted,
                    opened: None,
                    problems: vec!["the check itself failed".to_owned()],
                    missing: false,
                })
            })
            .collect()
    })
}

fn check_one(
    opener: &mut dyn CameraOpener,
    root: &SystemRoot,
    duration: Duration,
    record: Option<&Path>,
) -> Check {
    let mut check = Check {
        role: opener.role(),
        wanted: opener.describe(),
        opened: None,
        problems: Vec::new(),
        missing: false,
    };
    let mut source = match opener.open() {
        Ok(source) => source,
        Err(error) => {
            check.missing = error.kind() == ErrorKind::Device;
            check.problems.push(error.to_string());
            return check;
        }
    };
    let controls = source.controls().unwrap_or_else(|error| {
        check.problems.push(error.to_string());
        ControlValues::new()
    });
    let recorder = record
        .map(|dir| Recorder::create(dir, check.role, source.info()))
        .transpose()
        .unwrap_or_else(|error| {
            check.problems.push(error.to_string());
            None
        });
    let frames = measure(source.as_mut(), duration, recorder, &mut check.problems);
    let info = source.info().clone();
    let mut notes = source.warnings().to_vec();
    let asked =
        (check.role == Role::Rgb && info.identity.product.contains("RealSense")).then(|| {
            colour_intrinsics(
                root,
                &KernelNodes,
                &info.identity.port,
                info.width,
                info.height,
            )
        });
    let intrinsics = match asked {
        Some(Ok(intrinsics)) => Some(intrinsics),
        Some(Err(error)) => {
            notes.push(format!("factory intrinsics: {error}"));
            None
        }
        None => None,
    };
    check.opened = Some(Opened {
        info,
        frames,
        controls,
        intrinsics,
        notes,
    });
    check
}

/// Counts the numbers that are missing. uvcvideo can deliver two frames in the wrong order, so a
/// number below the highest one is one that was taken for lost too early.
#[derive(Debug, Default)]
struct Sequences {
    highest: Option<u32>,
    lost: u64,
}

impl Sequences {
    fn count(&mut self, sequence: u32) {
        let highest = *self.highest.get_or_insert(sequence);
        let step = sequence.wrapping_sub(highest).cast_signed();
        if step > 0 {
            self.lost += u64::from(step.unsigned_abs() - 1);
            self.highest = Some(sequence);
        } else if step < 0 {
            self.lost = self.lost.saturating_sub(1);
        }
    }
}

/// Counts frames for `duration` from the first one, by the clock of the frames.
fn measure(
    source: &mut dyn FrameSource,
    duration: Duration,
    mut recorder: Option<Recorder>,
    problems: &mut Vec<String>,
) -> Frames {
    let nominal = source.info().nominal_fps;
    let damage_limit = 50 + (2.0 * nominal * duration.as_secs_f64()) as u64;
    let mut frames = Frames::default();
    let mut first: Option<(u64, u64)> = None;
    let mut last_time_ns = 0;
    let mut sequences = Sequences::default();
    let mut timeouts = 0;
    loop {
        match source.next_frame(FRAME_TIMEOUT) {
            Ok(frame) => {
                timeouts = 0;
                frames.received += 1;
                if let Some(recording) = &mut recorder
                    && let Err(error) = recording.write(&frame)
                {
                    problems.push(error.to_string());
                    recorder = None;
                }
                sequences.count(frame.sequence);
                last_time_ns = last_time_ns.max(frame.driver_time_ns);
                let (_, began) = *first.get_or_insert((frame.driver_time_ns, frame.received_ns));
                if u128::from(frame.received_ns.saturating_sub(began)) >= duration.as_nanos() {
                    break;
                }
            }
            Err(CaptureError::Damaged { sequence, .. }) => {
                timeouts = 0;
                frames.damaged += 1;
                sequences.count(sequence);
                if frames.damaged > damage_limit {
                    break;
                }
            }
            Err(CaptureError::Timeout) => {
                timeouts += 1;
                if timeouts >= TIMEOUTS_BORNE {
                    problems.push(format!("no frame came for {TIMEOUTS_BORNE} s"));
                    break;
                }
            }
            Err(CaptureError::Ended) => break,
            Err(error) => {
                problems.push(error.to_string());
                break;
            }
        }
    }
    if let Some(Err(error)) = recorder.map(Recorder::finish) {
        problems.push(error.to_string());
    }
    frames.lost = sequences.lost;
    frames.fps = first.and_then(|(from, _)| {
        let elapsed_s = last_time_ns.saturating_sub(from) as f64 / 1e9;
        (elapsed_s > 0.0).then(|| (frames.received - 1) as f64 / elapsed_s)
    });
    match frames.fps {
        Some(fps) if fps < RATE_NEEDED * nominal => {
            problems.push(format!("only {fps:.2} of {nominal} frames/s arrive"));
        }
        None if problems.is_empty() => problems.push("too few frames to measure a rate".to_owned()),
        _ => {}
    }
    let all = frames.received + frames.damaged;
    if frames.damaged as f64 > DAMAGE_BORNE * all as f64 {
        problems.push(format!("{} of {all} frames are damaged", frames.damaged));
    }
    frames
}

impl Check {
    fn json(&self) -> Value {
        let mut value = json!({
            "missing": self.missing,
            "ok": self.problems.is_empty(),
            "problems": self.problems,
            "role": self.role,
            "wanted": self.wanted,
        });
        if let (Some(opened), Value::Object(object)) = (&self.opened, &mut value) {
            let info = &opened.info;
            let more = json!({
                "controls": opened.controls,
                "damaged": opened.frames.damaged,
                "factory_intrinsics": opened.intrinsics,
                "format": info.format,
                "fps": opened.frames.fps,
                "height": info.height,
                "lost": opened.frames.lost,
                "node": info.identity.node,
                "nominal_fps": info.nominal_fps,
                "notes": opened.notes,
                "port": info.identity.port,
                "product": info.identity.product,
                "received": opened.frames.received,
                "serial": info.identity.serial,
                "width": info.width,
            });
            if let Value::Object(more) = more {
                object.extend(more);
            }
        }
        value
    }

    fn text(&self) -> String {
        let verdict = if self.problems.is_empty() {
            "ok"
        } else {
            "FAILED"
        };
        let mut text = format!("{:<9}{verdict:<8}", self.role.name());
        match &self.opened {
            None => text += &format!("{}\n", self.wanted),
            Some(Opened {
                info,
                frames,
                controls,
                intrinsics,
                notes,
            }) => {
                text += &format!(
                    "{}\n  {} {}×{}, {} of {} frames/s, {} received, {} lost, {} damaged\n",
                    info.identity,
                    info.format,
                    info.width,
                    info.height,
                    frames.fps.map_or("–".to_owned(), |fps| format!("{fps:.2}")),
                    info.nominal_fps,
                    frames.received,
                    frames.lost,
                    frames.damaged
                );
                if !controls.is_empty() {
                    let values: Vec<String> = controls
                        .iter()
                        .map(|(name, value)| format!("{name} {value}"))
                        .collect();
                    text += &format!("  controls: {}\n", values.join(", "));
                }
                if let Some(k) = intrinsics {
                    text += &format!(
                        "  factory intrinsics: fx {:.2}, fy {:.2}, cx {:.2}, cy {:.2}\n",
                        k.fx, k.fy, k.cx, k.cy
                    );
                }
                for note in notes {
                    text += &format!("  note: {note}\n");
                }
            }
        }
        for problem in &self.problems {
            text += &format!("  problem: {problem}\n");
        }
        text
    }
}

/// The error that the exit code follows from.
fn verdict(checks: &[Check]) -> Result<()> {
    let roles = |test: fn(&Check) -> bool| -> Vec<&str> {
        checks
            .iter()
            .filter(|check| test(check))
            .map(|check| check.role.name())
            .collect()
    };
    let missing = roles(|check| check.missing);
    let failed = roles(|check| !check.problems.is_empty());
    if !missing.is_empty() {
        return Err(Error::new(
            ErrorKind::Device,
            format!("missing cameras: {}", missing.join(", ")),
        )
        .remedy("see the problems above; `gripcast rig list` shows what is plugged in"));
    }
    if !failed.is_empty() {
        return Err(Error::new(
            ErrorKind::Check,
            format!("cameras with problems: {}", failed.join(", ")),
        ));
    }
    Ok(())
}

#[cfg(test)]
#[path = "rig_test.rs"]
mod tests;
