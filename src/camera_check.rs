//! Measurement of the cameras of a rig: frame rates, losses, timestamps, controls.

use std::path::Path;
use std::sync::mpsc::{Receiver, sync_channel};
use std::thread;
use std::time::Duration;

use serde_json::{Value, json};

use gripcast_base::error::{Error, ErrorKind, Result};
use gripcast_capture::calibration::colour_intrinsics;
use gripcast_capture::camera::{
    CameraOpener, CameraState, CaptureError, ControlValues, FrameFacts, FrameQuality, FrameSource,
    Health, KernelNodes, Recorder, StreamInfo, StreamMonitor, SupervisionPolicy, content_of,
    health_of,
};
use gripcast_capture::device::SystemRoot;
use gripcast_imaging::{Decoder, Frame, GelState, Intrinsics, PixelFormat, Role, whole_file};

use crate::gel_check::GelCheck;

/// Minimum fraction of the nominal frame rate; GelSight Minis are known to deliver three quarters.
const MIN_RATE_FRACTION: f64 = 0.7;
/// Remedy for damaged or repeated frames.
const DAMAGE_REMEDY: &str = "replug the camera; use another cable or port: cameras on one USB controller compete for \
     bandwidth";
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
    /// State at the end of the check.
    pub(crate) state: CameraState,
}

/// Measurement of an opened camera.
#[derive(Debug)]
pub(crate) struct CameraMeasurement {
    pub(crate) info: StreamInfo,
    pub(crate) frames: FrameStats,
    /// What was wrong with the newest damaged frame; empty without one.
    pub(crate) damage: String,
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
    /// Frames that arrived damaged or did not decode.
    pub(crate) damaged: u64,
    /// Frames that were decoded: as many as time allowed.
    pub(crate) decoded: u64,
    /// Damaged fraction, 0..1.
    pub(crate) damaged_fraction: f64,
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
            check.state = CameraState::judge(&health_of(&error), &FrameQuality::default(), 0);
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
    let gel = gel.unwrap_or_else(|error| {
        check.problems.push(error.to_string());
        None
    });
    let measured = measure(
        source.as_mut(),
        duration,
        recorder,
        gel,
        &mut check.problems,
    );
    let (frames, last, gel) = (measured.frames, measured.last, measured.gel);
    for problem in gel.iter().flat_map(|gel| &gel.problems) {
        let (what, remedy) = (problem.what(), problem.remedy());
        check.problems.push(format!("{what}\n  → {remedy}"));
    }
    let info = source.info().clone();
    let mut notes = source.warnings().to_vec();
    if let CameraState::NoValidDepth { .. } = measured.state {
        notes.extend(measured.state.fault_text());
    }
    notes.extend(last.as_ref().and_then(harmless_note));
    check.state = measured.state;
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
        damage: measured.damage,
        controls,
        last,
        intrinsics,
        gel,
        notes,
    });
    check
}

/// Describes the bytes of a frame that are not part of its image.
fn harmless_note(frame: &Frame) -> Option<String> {
    if frame.format != PixelFormat::Mjpg {
        return None;
    }
    let (_, repairs) = whole_file(&frame.data).ok()?;
    Some(format!("harmless in its JPEGs: {}", repairs?))
}

/// Decodes frames beside the measurement and judges the gel in them; the damage of each.
fn decode_frames(
    frames: &Receiver<Frame>,
    mut gel: Option<GelCheck>,
) -> (Vec<Option<String>>, Option<GelState>) {
    let mut decoder = match Decoder::new() {
        Ok(decoder) => decoder,
        Err(error) => return (vec![Some(error.to_string())], None),
    };
    let damage = |frame: Frame| {
        if let Some(gel) = &mut gel {
            gel.add(&frame);
        }
        decoder
            .verify(&frame)
            .err()
            .map(|damage| damage.to_string())
    };
    let damages = frames.iter().map(damage).collect();
    (damages, gel.and_then(|gel| gel.state().cloned()))
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

/// Result of [`measure`].
struct Measured {
    frames: FrameStats,
    state: CameraState,
    damage: String,
    last: Option<Frame>,
    gel: Option<GelState>,
}

/// Measures frames for `duration` from the first one, by their time stamps.
fn measure(
    source: &mut dyn FrameSource,
    duration: Duration,
    recorder: Option<Recorder>,
    gel: Option<GelCheck>,
    problems: &mut Vec<String>,
) -> Measured {
    let nominal = source.info().nominal_fps;
    let mut measuring = Measuring {
        frames: FrameStats::default(),
        quality: FrameQuality::of_measurement(),
        monitor: StreamMonitor::new(SupervisionPolicy::default()),
        now_ns: None,
        first: None,
        last_time_ns: 0,
        sequences: Sequences::default(),
        last: None,
        recorder,
    };
    // The decoder gets a frame whenever it is idle, so that no frame is lost to a slow one.
    let (sender, receiver) = sync_channel(1);
    let (health, (verdicts, gel)) = thread::scope(|scope| {
        let decoder = scope.spawn(move || decode_frames(&receiver, gel));
        let health = measuring.run(source, duration, problems, |frame| {
            // Fails while the decoder is busy.
            let _ = sender.try_send(frame);
        });
        drop(sender);
        (health, decoder.join().unwrap_or_default())
    });
    Measured {
        gel,
        ..measuring.finish(health, verdicts, nominal, problems)
    }
}

/// State of a measurement.
struct Measuring {
    frames: FrameStats,
    quality: FrameQuality,
    monitor: StreamMonitor,
    /// Time of the newest event, ns.
    now_ns: Option<u64>,
    /// Driver time and arrival of the first frame, ns.
    first: Option<(u64, u64)>,
    last_time_ns: u64,
    sequences: Sequences,
    last: Option<Frame>,
    recorder: Option<Recorder>,
}

impl Measuring {
    /// Reads frames until the time is over; the health of a stream that ends earlier.
    fn run(
        &mut self,
        source: &mut dyn FrameSource,
        duration: Duration,
        problems: &mut Vec<String>,
        decode: impl Fn(Frame),
    ) -> Option<Health> {
        let nominal = source.info().nominal_fps;
        let damage_limit = 50 + (2.0 * nominal * duration.as_secs_f64()) as u64;
        let mut timeouts = 0;
        loop {
            match source.next_frame(FRAME_TIMEOUT) {
                Ok(frame) => {
                    timeouts = 0;
                    decode(frame.clone());
                    let began = self.add(frame, nominal, problems);
                    let elapsed_ns = self.now_ns.unwrap_or(began).saturating_sub(began);
                    if u128::from(elapsed_ns) >= duration.as_nanos() {
                        return None;
                    }
                }
                Err(CaptureError::Damaged { sequence, reason }) => {
                    timeouts = 0;
                    self.frames.damaged += 1;
                    self.sequences.count(sequence);
                    self.quality.refused(reason);
                    let now_ns = self.now_ns.unwrap_or(0);
                    self.monitor.damaged(sequence, now_ns);
                    if self.frames.damaged > damage_limit {
                        return None;
                    }
                }
                Err(CaptureError::Timeout) => {
                    timeouts += 1;
                    if timeouts >= MAX_TIMEOUTS {
                        problems.push(format!("no frame for {MAX_TIMEOUTS} s"));
                        let quiet_ns = FRAME_TIMEOUT.as_nanos() as u64 * u64::from(timeouts);
                        let since_ns = self.now_ns.unwrap_or(0);
                        self.now_ns = Some(since_ns + quiet_ns);
                        return Some(Health::Silent { since_ns });
                    }
                }
                Err(CaptureError::Ended) => return None,
                Err(CaptureError::Gone) => {
                    let reason = CaptureError::Gone.to_string();
                    problems.push(reason.clone());
                    return Some(Health::Unplugged { reason });
                }
                Err(CaptureError::Failed(error)) => {
                    problems.push(error.to_string());
                    return Some(health_of(&error));
                }
            }
        }
    }

    /// Adds a frame; returns the arrival of the first one, ns.
    fn add(&mut self, frame: Frame, nominal_fps: f64, problems: &mut Vec<String>) -> u64 {
        self.frames.received += 1;
        if let Some(recording) = &mut self.recorder
            && let Err(error) = recording.write(&frame)
        {
            problems.push(error.to_string());
            self.recorder = None;
        }
        if self.first.is_none() {
            self.monitor.opened(frame.received_ns, nominal_fps);
        }
        self.quality.arrived();
        self.monitor.frame(FrameFacts {
            sequence: frame.sequence,
            received_ns: frame.received_ns,
            content: content_of(&frame, self.last.as_ref().map(|last| &last.data)),
        });
        self.sequences.count(frame.sequence);
        self.frames.add_times(&frame, self.last.as_ref());
        self.last_time_ns = self.last_time_ns.max(frame.driver_time_ns);
        self.now_ns = Some(frame.received_ns);
        let (_, began) = *self
            .first
            .get_or_insert((frame.driver_time_ns, frame.received_ns));
        self.last = Some(frame);
        began
    }

    /// Judges what was measured.
    fn finish(
        mut self,
        health: Option<Health>,
        verdicts: Vec<Option<String>>,
        nominal: f64,
        problems: &mut Vec<String>,
    ) -> Measured {
        if let Some(Err(error)) = self.recorder.take().map(Recorder::finish) {
            problems.push(error.to_string());
        }
        for verdict in verdicts {
            self.frames.decoded += 1;
            match verdict {
                None => self.quality.decoded(),
                Some(damage) => {
                    self.frames.damaged += 1;
                    self.quality.undecodable(damage);
                }
            }
        }
        self.frames.damaged_fraction = self.quality.damaged_fraction();
        self.frames.lost = self.sequences.lost;
        self.frames.fps = self.first.and_then(|(from, _)| {
            let elapsed_s = self.last_time_ns.saturating_sub(from) as f64 / 1e9;
            (elapsed_s > 0.0).then(|| (self.frames.received - 1) as f64 / elapsed_s)
        });
        match self.frames.fps {
            Some(fps) if fps < MIN_RATE_FRACTION * nominal => {
                problems.push(format!("expected {nominal} frames/s, measured {fps:.2}"));
            }
            None if problems.is_empty() => {
                problems.push("too few frames to measure the frame rate".to_owned())
            }
            _ => {}
        }
        let health = health.unwrap_or_else(|| self.monitor.health().clone());
        let state = CameraState::judge(&health, &self.quality, self.now_ns.unwrap_or(0));
        if let CameraState::Damaged { .. } | CameraState::Frozen { .. } = state {
            let fault = state.fault_text().unwrap_or_default();
            problems.push(format!("{fault}\n  → {DAMAGE_REMEDY}"));
        }
        Measured {
            frames: self.frames,
            state,
            damage: self.quality.reason().to_owned(),
            last: self.last,
            gel: None,
        }
    }
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
            state: CameraState::Opening,
        }
    }

    /// Returns whether the camera is not connected.
    fn is_missing(&self) -> bool {
        self.measurement.is_none() && matches!(self.state, CameraState::Unplugged { .. })
    }

    /// Returns the result as JSON.
    pub(crate) fn json(&self) -> Value {
        let mut value = json!({
            "state": self.state.name(),
            "expected": self.expected,
            "missing": self.is_missing(),
            "ok": self.problems.is_empty(),
            "problems": self.problems,
            "role": self.role,
        });
        if let Some(measurement) = &self.measurement {
            let (info, frames) = (&measurement.info, &measurement.frames);
            for (key, field) in [
                ("controls", json!(measurement.controls)),
                (
                    "damage",
                    json!(Some(&measurement.damage).filter(|text| !text.is_empty())),
                ),
                ("damaged", json!(frames.damaged)),
                ("damaged_fraction", json!(frames.damaged_fraction)),
                ("decoded", json!(frames.decoded)),
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
                    "{}\n  {} {}×{}, {} of {} frames/s, {} received, {} lost, {} decoded, {} damaged\n",
                    info.identity,
                    info.format,
                    info.width,
                    info.height,
                    frames.fps.map_or("–".to_owned(), |fps| format!("{fps:.2}")),
                    info.nominal_fps,
                    frames.received,
                    frames.lost,
                    frames.decoded,
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
    if let Some(missing) = roles(CameraCheck::is_missing) {
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
