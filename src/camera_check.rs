//! Measurement of the cameras of a rig: frame rates, losses, timestamps, controls.

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
use gripcast_imaging::{Frame, GelState, Intrinsics, Role};

use crate::gel_check::GelCheck;

/// Minimum fraction of the nominal frame rate; GelSight Minis are known to deliver three quarters.
const MIN_RATE_FRACTION: f64 = 0.7;
/// Maximum fraction of damaged frames.
const MAX_DAMAGED_FRACTION: f64 = 0.1;
/// Timeout of one frame.
const FRAME_TIMEOUT: Duration = Duration::from_secs(1);
/// Consecutive timeouts after which a camera counts as silent.
const MAX_TIMEOUTS: u32 = 5;

/// Result of the check of one camera.
#[derive(Debug)]
pub(crate) struct CameraCheck {
    pub(crate) role: Role,
    expected: String,
    pub(crate) measurement: Option<CameraMeasurement>,
    pub(crate) problems: Vec<String>,
    /// Whether the camera is missing.
    missing: bool,
}

/// Measurement of an opened camera.
#[derive(Debug)]
pub(crate) struct CameraMeasurement {
    pub(crate) info: StreamInfo,
    pub(crate) frames: FrameStats,
    pub(crate) controls: ControlValues,
    /// The last frame.
    pub(crate) last: Option<Frame>,
    pub(crate) intrinsics: Option<Intrinsics>,
    /// State of the gel; tactile cameras only.
    pub(crate) gel: Option<GelState>,
    pub(crate) notes: Vec<String>,
}

/// Frame statistics of a measurement.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct FrameStats {
    pub(crate) received: u64,
    pub(crate) lost: u64,
    pub(crate) damaged: u64,
    pub(crate) fps: Option<f64>,
    /// Minimum and maximum time from the driver's timestamp to the arrival, ms.
    pub(crate) delay_ms: Option<[f64; 2]>,
    /// Consecutive frames whose timestamps do not increase.
    pub(crate) backwards: u64,
}

/// Opens all cameras at once, because they compete for the bus, and measures each for `duration`
/// from its first frame. Frames are recorded to the folder `record`.
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
                let check = CameraCheck::new(opener.role(), opener.describe());
                let role_and_name = (check.role, check.expected.clone());
                let run = move || check_one(check, opener.as_mut(), root, duration, record);
                (role_and_name, scope.spawn(run))
            })
            .collect();
        running
            .into_iter()
            .map(|((role, expected), worker)| {
                worker.join().unwrap_or_else(|_| CameraCheck {
                    problems: vec!["the check panicked".to_owned()],
                    ..CameraCheck::new(role, expected)
                })
            })
            .collect()
    })
}

fn check_one(
    mut check: CameraCheck,
    opener: &mut dyn CameraOpener,
    root: &SystemRoot,
    duration: Duration,
    record: Option<&Path>,
) -> CameraCheck {
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
    let gel = check.role.is_tactile().then(GelCheck::new).transpose();
    let mut gel = gel.unwrap_or_else(|error| {
        check.problems.push(error.to_string());
        None
    });
    let judge = |frame: &Frame| {
        if let Some(gel) = &mut gel {
            gel.add(frame);
        }
    };
    let (frames, last) = measure(
        source.as_mut(),
        duration,
        recorder,
        judge,
        &mut check.problems,
    );
    let gel = gel.and_then(|gel| gel.state().cloned());
    for problem in gel.iter().flat_map(|gel| &gel.problems) {
        let (what, remedy) = (problem.what(), problem.remedy());
        check.problems.push(format!("{what}\n  → {remedy}"));
    }
    let info = source.info().clone();
    let mut notes = source.warnings().to_vec();
    let mut intrinsics = None;
    if check.role == Role::Rgb && info.identity.product.contains("RealSense") {
        let (port, width, height) = (&info.identity.port, info.width, info.height);
        match colour_intrinsics(root, &KernelNodes, port, width, height) {
            Ok(found) => intrinsics = Some(found),
            Err(error) => notes.push(format!("factory intrinsics: {error}")),
        }
    }
    check.measurement = Some(CameraMeasurement {
        info,
        frames,
        controls,
        last,
        intrinsics,
        gel,
        notes,
    });
    check
}

/// Counts missing sequence numbers. uvcvideo can deliver two frames out of order, so a number below
/// the maximum was counted as lost too early.
#[derive(Debug, Default)]
struct Sequences {
    max: Option<u32>,
    lost: u64,
}

impl Sequences {
    fn count(&mut self, sequence: u32) {
        let max = *self.max.get_or_insert(sequence);
        let step = sequence.wrapping_sub(max).cast_signed();
        if step > 0 {
            self.lost += u64::from(step.unsigned_abs() - 1);
            self.max = Some(sequence);
        } else if step < 0 {
            self.lost = self.lost.saturating_sub(1);
        }
    }
}

/// Measures frames for `duration` from the first one, by their time stamps.
fn measure(
    source: &mut dyn FrameSource,
    duration: Duration,
    mut recorder: Option<Recorder>,
    mut judge: impl FnMut(&Frame),
    problems: &mut Vec<String>,
) -> (FrameStats, Option<Frame>) {
    let nominal = source.info().nominal_fps;
    let damage_limit = 50 + (2.0 * nominal * duration.as_secs_f64()) as u64;
    let mut frames = FrameStats::default();
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
                judge(&frame);
                if let Some(recording) = &mut recorder
                    && let Err(error) = recording.write(&frame)
                {
                    problems.push(error.to_string());
                    recorder = None;
                }
                sequences.count(frame.sequence);
                frames.add_times(&frame, last.as_ref());
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
                if timeouts >= MAX_TIMEOUTS {
                    problems.push(format!("no frame for {MAX_TIMEOUTS} s"));
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
        Some(fps) if fps < MIN_RATE_FRACTION * nominal => {
            problems.push(format!("expected {nominal} frames/s, measured {fps:.2}"));
        }
        None if problems.is_empty() => {
            problems.push("too few frames to measure the frame rate".to_owned())
        }
        _ => {}
    }
    let all = frames.received + frames.damaged;
    if frames.damaged as f64 > MAX_DAMAGED_FRACTION * all as f64 {
        problems.push(format!("{} of {all} frames are damaged", frames.damaged));
    }
    (frames, last)
}

impl FrameStats {
    /// Adds the timestamps of a frame and its predecessor.
    fn add_times(&mut self, frame: &Frame, before: Option<&Frame>) {
        let delay_ms =
            (i128::from(frame.received_ns) - i128::from(frame.driver_time_ns)) as f64 * 1e-6;
        let [min, max] = self.delay_ms.unwrap_or([f64::INFINITY, f64::NEG_INFINITY]);
        self.delay_ms = Some([min.min(delay_ms), max.max(delay_ms)]);
        let is_backwards = before.is_some_and(|before| {
            frame.sequence == before.sequence.wrapping_add(1)
                && frame.driver_time_ns <= before.driver_time_ns
        });
        self.backwards += u64::from(is_backwards);
    }
}

impl CameraCheck {
    /// Creates the result of a camera that has not been opened.
    pub(crate) fn new(role: Role, expected: String) -> Self {
        Self {
            role,
            expected,
            measurement: None,
            problems: Vec::new(),
            missing: false,
        }
    }

    /// Returns the result as JSON.
    pub(crate) fn json(&self) -> Value {
        let mut value = json!({
            "expected": self.expected,
            "missing": self.missing,
            "ok": self.problems.is_empty(),
            "problems": self.problems,
            "role": self.role,
        });
        if let Some(measurement) = &self.measurement {
            let (info, frames) = (&measurement.info, &measurement.frames);
            for (key, field) in [
                ("controls", json!(measurement.controls)),
                ("damaged", json!(frames.damaged)),
                ("factory_intrinsics", json!(measurement.intrinsics)),
                ("format", json!(info.format)),
                ("fps", json!(frames.fps)),
                ("gel", json!(measurement.gel)),
                ("height", json!(info.height)),
                ("lost", json!(frames.lost)),
                ("node", json!(info.identity.node)),
                ("nominal_fps", json!(info.nominal_fps)),
                ("notes", json!(measurement.notes)),
                ("port", json!(info.identity.port)),
                ("product", json!(info.identity.product)),
                ("received", json!(frames.received)),
                ("serial", json!(info.identity.serial)),
                ("width", json!(info.width)),
            ] {
                value[key] = field;
            }
        }
        value
    }

    /// Returns the result as text.
    pub(crate) fn text(&self) -> String {
        let verdict = match self.problems.is_empty() {
            true => "ok",
            false => "FAILED",
        };
        let mut text = format!("{:<9}{verdict:<8}", self.role.name());
        match &self.measurement {
            None => text += &format!("{}\n", self.expected),
            Some(CameraMeasurement {
                info,
                frames,
                controls,
                intrinsics,
                gel,
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
                if let Some(gel) = gel {
                    let [red, green, blue] = gel.level;
                    let noise = gel.noise_levels.unwrap_or_default();
                    text += &format!(
                        "  gel: level {red:.0} {green:.0} {blue:.0} (RGB), noise {noise:.2}, \
                         {:.1} % clipped\n",
                        100.0 * gel.clipped_fraction
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

/// Returns an error for missing or failing cameras.
pub(crate) fn verdict(checks: &[CameraCheck]) -> Result<()> {
    let roles = |is_affected: fn(&CameraCheck) -> bool| -> Option<String> {
        let affected = checks.iter().filter(|check| is_affected(check));
        let names: Vec<&str> = affected.map(|check| check.role.name()).collect();
        (!names.is_empty()).then(|| names.join(", "))
    };
    if let Some(missing) = roles(|check| check.missing) {
        let what = format!("missing cameras: {missing}");
        return Err(Error::new(ErrorKind::Device, what)
            .remedy("see the problems above; `gripcast rig list` shows the connected cameras"));
    }
    match roles(|check| !check.problems.is_empty()) {
        Some(failed) => {
            let what = format!("cameras with problems: {failed}");
            Err(Error::new(ErrorKind::Check, what))
        }
        None => Ok(()),
    }
}

#[cfg(test)]
#[path = "camera_check_test.rs"]
mod tests;
