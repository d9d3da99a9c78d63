//! Guards: conditions of a trigger.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

use super::pending::PendingFrame;
use gripcast_imaging::Role;

/// Limits of the guards; section `[guards]` of the configuration.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct GuardLimits {
    /// Maximum age of a frame, ms. A frame of a GelSight Mini takes 40 ms to transmit and the next
    /// one follows after 40–53 ms, so a healthy stream stays below 100.
    pub max_frame_age_ms: f64,
    /// Maximum skew of the cameras' driver times, ms. Free-running cameras at 25 and 30 fps can
    /// always be paired within half an interval, 20 ms.
    pub max_skew_ms: f64,
    /// Minimum fraction of a gel that must have changed since the initial frame, 0..1.
    pub min_contact_fraction: f64,
    /// Minimum free space on the dataset's disk, bytes.
    pub min_free_bytes: u64,
    /// Age of an initial frame at which the screen suggests retaking it, s.
    pub initial_warn_age_s: f64,
    /// Maximum age of a command, ms: from the key press or tap until it is carried out.
    pub max_command_age_ms: f64,
    /// Maximum age of a command that names what it changes, ms: a label, name or trash command with
    /// its grasp or name.
    pub max_named_command_age_ms: f64,
}

impl Default for GuardLimits {
    fn default() -> Self {
        Self {
            max_frame_age_ms: 150.0,
            max_skew_ms: 40.0,
            min_contact_fraction: 0.005,
            min_free_bytes: 1_000_000_000,
            initial_warn_age_s: 300.0,
            max_command_age_ms: 2_000.0,
            max_named_command_age_ms: 30_000.0,
        }
    }
}

/// A guard, as named in `grasp.json`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Guard {
    /// A camera delivers no usable frame.
    MissingCamera,
    /// A frame is older than the limit.
    StaleFrame,
    /// The skew of the cameras' frames exceeds the limit.
    Skew,
    /// There is no initial frame.
    NoInitial,
    /// The gels did not change since the initial frame.
    NoContact,
    /// Exposure, gain or white balance differ from the initial frame's.
    ExposureChanged,
    /// The dataset's disk is nearly full.
    DiskLow,
}

impl Guard {
    /// Name in files.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::MissingCamera => "missing_camera",
            Self::StaleFrame => "stale_frame",
            Self::Skew => "skew",
            Self::NoInitial => "no_initial",
            Self::NoContact => "no_contact",
            Self::ExposureChanged => "exposure_changed",
            Self::DiskLow => "disk_low",
        }
    }
}

/// A guard that was not met.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct GuardViolation {
    /// The guard.
    pub guard: Guard,
    /// Reason, one sentence.
    pub reason: String,
    /// Whether the operator may override it.
    pub can_override: bool,
}

/// State of a camera at a trigger.
#[derive(Clone, Debug, PartialEq)]
pub struct CameraCondition {
    /// Role of the camera.
    pub role: Role,
    /// Age of the frame to save, ms; `None` without a usable frame.
    pub age_ms: Option<f64>,
    /// Driver time of that frame, ns.
    pub frame_time_ns: u64,
    /// Reason for the missing frame.
    pub fault: Option<String>,
    /// Control values read back from the camera.
    pub controls: BTreeMap<String, i64>,
    /// Fraction of the gel that changed since the pending initial frame, 0..1; tactile cameras
    /// only, `None` before the first comparison.
    pub contact_fraction: Option<f64>,
}

/// State of cameras and disk at a command.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Conditions {
    /// `CLOCK_MONOTONIC`, ns.
    pub now_ns: u64,
    /// Cameras of the rig.
    pub cameras: Vec<CameraCondition>,
    /// Skew of the frames to save, ms.
    pub skew_ms: f64,
    /// Free space on the dataset's disk, bytes; `None` if unknown.
    pub disk_free_bytes: Option<u64>,
}

/// Controls that must not change between initial and grasp frame.
const EXPOSURE_CONTROLS: [&str; 6] = [
    "auto_exposure",
    "exposure_time_absolute",
    "gain",
    "white_balance_automatic",
    "white_balance_temperature",
    "gamma",
];

/// Checks initial or grasp frames; `captured_ns` is the time of the last capture, whose frames must
/// not be saved again.
pub(crate) fn check_frames(
    limits: &GuardLimits,
    now: &Conditions,
    captured_ns: u64,
) -> Vec<GuardViolation> {
    let mut violations = Vec::new();
    let old: Vec<&str> = now
        .cameras
        .iter()
        .filter(|camera| camera.age_ms.is_some() && camera.frame_time_ns <= captured_ns)
        .map(|camera| camera.role.name())
        .collect();
    if !old.is_empty() {
        violations.push(GuardViolation {
            guard: Guard::StaleFrame,
            reason: format!("{}: no new frame since the last capture", old.join(", ")),
            can_override: false,
        });
    }
    for camera in &now.cameras {
        match camera.age_ms {
            None => {
                let fault = camera.fault.as_deref().unwrap_or("no frame yet");
                violations.push(GuardViolation {
                    guard: Guard::MissingCamera,
                    reason: format!("{}: {fault}", camera.role),
                    can_override: !camera.role.is_tactile(),
                });
            }
            Some(age) if age > limits.max_frame_age_ms => violations.push(GuardViolation {
                guard: Guard::StaleFrame,
                reason: format!(
                    "{}: newest valid frame is {age:.0} ms old, limit {:.0} ms",
                    camera.role, limits.max_frame_age_ms
                ),
                can_override: true,
            }),
            Some(_) => {}
        }
    }
    if now.skew_ms > limits.max_skew_ms {
        violations.push(GuardViolation {
            guard: Guard::Skew,
            reason: format!(
                "skew of the frames is {:.0} ms, limit {:.0} ms",
                now.skew_ms, limits.max_skew_ms
            ),
            can_override: true,
        });
    }
    if let Some(free) = now.disk_free_bytes
        && free < limits.min_free_bytes
    {
        violations.push(GuardViolation {
            guard: Guard::DiskLow,
            reason: format!(
                "{} MB free on the dataset's disk, limit {} MB",
                free / 1_000_000,
                limits.min_free_bytes / 1_000_000
            ),
            can_override: true,
        });
    }
    violations
}

/// Checks the grasp frame against the initial frame.
pub(crate) fn check_against_initial(
    limits: &GuardLimits,
    now: &Conditions,
    initial: &PendingFrame,
) -> Vec<GuardViolation> {
    let mut violations = Vec::new();
    let contacts: Vec<f64> = now
        .cameras
        .iter()
        .filter_map(|camera| camera.contact_fraction)
        .collect();
    if contacts.iter().all(|c| *c < limits.min_contact_fraction) {
        let max = contacts.iter().copied().reduce(f64::max);
        violations.push(GuardViolation {
            guard: Guard::NoContact,
            reason: match max {
                Some(max) => format!(
                    "no contact: at most {:.1} % of a gel changed since the initial frame, limit \
                     {:.1} %",
                    max * 100.0,
                    limits.min_contact_fraction * 100.0
                ),
                None => "contact unknown: no gel was compared with the initial frame yet".into(),
            },
            can_override: true,
        });
    }
    for camera in &now.cameras {
        let Some(initial) = initial.controls.get(&camera.role) else {
            continue;
        };
        let changed: Vec<String> = EXPOSURE_CONTROLS
            .iter()
            .filter_map(|name| {
                let (before, after) = (initial.get(*name)?, camera.controls.get(*name)?);
                (before != after).then(|| format!("{name} {before} → {after}"))
            })
            .collect();
        if !changed.is_empty() {
            violations.push(GuardViolation {
                guard: Guard::ExposureChanged,
                reason: format!(
                    "{}: changed since the initial frame: {}",
                    camera.role,
                    changed.join(", ")
                ),
                can_override: true,
            });
        }
    }
    violations
}
