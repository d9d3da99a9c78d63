//! What the cameras of a rig deliver: rates, losses, timestamps, controls.

use std::path::Path;
use std::thread;
use std::time::Duration;

use serde_json::{Value, json};

use gripcast_base::error::{Error, ErrorKind, Result};
use gripcast_capture::calibration::colour_intrinsics;
use gripcast_capture::camera::{
    CameraOpener, CaptureError, ControlValues, FrameSource, KernelNodes, Recorder, StreamInfo,
};
use gripcast_capture::device::SystemRoot;
use gripcast_imaging::{Frame, Intrinsics, Role};

/// Fraction of the nominal frame rate that a camera has to reach; GelSight Minis are known to
/// deliver three quarters of theirs.
const RATE_NEEDED: f64 = 0.7;
/// Fraction of damaged frames that is borne.
const DAMAGE_BORNE: f64 = 0.1;
/// Longest wait for one frame.
const FRAME_TIMEOUT: Duration = Duration::from_secs(1);
/// Waits without a frame after which a camera counts as silent.
const TIMEOUTS_BORNE: u32 = 5;

/// What the check of one camera found.
#[derive(Debug)]
pub(crate) struct CameraCheck {
    pub(crate) role: Role,
    wanted: String,
    pub(crate) opened: Option<Opened>,
    pub(crate) problems: Vec<String>,
    /// The camera is not there.
    missing: bool,
}

/// What a camera delivered.
#[derive(Debug)]
pub(crate) struct Opened {
    pub(crate) info: StreamInfo,
    pub(crate) frames: Frames,
    pub(crate) controls: ControlValues,
    /// The last frame.
    pub(crate) last: Option<Frame>,
    pub(crate) intrinsics: Option<Intrinsics>,
    pub(crate) notes: Vec<String>,
}

/// Counts over the time of the measurement.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct Frames {
    pub(crate) received: u64,
    pub(crate) lost: u64,
    pub(crate) damaged: u64,
    pub(crate) fps: Option<f64>,
    /// Shortest and longest time from the driver's timestamp to us, ms.
    pub(crate) delay_ms: Option<[f64; 2]>,
    /// Frames whose timestamp is not after that of the frame with the number before.
    pub(crate) backwards: u64,
}

/// Opens cameras all at once, because they compete for the bus, and measures each for `duration`
/// from its first frame on. `record` is a folder that gets the frames.
pub(crate) fn check_cameras(
    openers: Vec<Box<dyn CameraOpener>>,
    root: &SystemRoot,
    duration: Duration,
    record: Option<&Path>,
) -> Vec<CameraCheck> {
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
                worker.join().unwrap_or_else(|_| CameraCheck {
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
) -> CameraCheck {
    let mut check = CameraCheck {
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
    let (frames, last) = measure(source.as_mut(), duration, recorder, &mut check.problems);
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
        last,
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
) -> (Frames, Option<Frame>) {
    let nominal = source.info().nominal_fps;
    let damage_limit = 50 + (2.0 * nominal * duration.as_secs_f64()) as u64;
    let mut frames = Frames::default();
    let mut first: Option<(u64, u64)> = None;
    let mut last_time_ns = 0;
    let mut sequences = Sequences::default();
    let mut timeouts = 0;
    let mut last: Option<Frame> = None;
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
                frames.time(&frame, last.as_ref());
                last_time_ns = last_time_ns.max(frame.driver_time_ns);
                let (_, began) = *first.get_or_insert((frame.driver_time_ns, frame.received_ns));
                let elapsed_ns = frame.received_ns.saturating_sub(began);
                last = Some(frame);
                if u128::from(elapsed_ns) >= duration.as_nanos() {
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
    (frames, last)
}

impl Frames {
    /// Counts the timestamps of a frame and the one before.
    fn time(&mut self, frame: &Frame, before: Option<&Frame>) {
        let delay_ms =
            (i128::from(frame.received_ns) - i128::from(frame.driver_time_ns)) as f64 * 1e-6;
        let [least, most] = self.delay_ms.unwrap_or([f64::INFINITY, f64::NEG_INFINITY]);
        self.delay_ms = Some([least.min(delay_ms), most.max(delay_ms)]);
        let is_next = before.is_some_and(|before| {
            frame.sequence == before.sequence.wrapping_add(1)
                && frame.driver_time_ns <= before.driver_time_ns
        });
        self.backwards += u64::from(is_next);
    }
}

impl CameraCheck {
    /// What a check found, for tests of those that read it.
    #[cfg(test)]
    pub(crate) fn new(role: Role, opened: Option<Opened>, problems: Vec<String>) -> Self {
        Self {
            role,
            wanted: String::new(),
            opened,
            problems,
            missing: false,
        }
    }

    /// The report as JSON.
    pub(crate) fn json(&self) -> Value {
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

    /// The report for people.
    pub(crate) fn text(&self) -> String {
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
                ..
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
pub(crate) fn verdict(checks: &[CameraCheck]) -> Result<()> {
    let roles = |test: fn(&CameraCheck) -> bool| -> Vec<&str> {
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
#[path = "camera_check_test.rs"]
mod tests;
