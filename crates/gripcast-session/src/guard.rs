//! Guards: what must hold before a trigger is accepted.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

use super::pending::PendingFrame;
use gripcast_imaging::Role;

/// Limits of the guards; section `[guards]` of the configuration.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct GuardLimits {
    /// Oldest frame that is accepted, ms. A Mini's frame is 40 ms long on the wire and the next
    /// one comes 40–53 ms later, so a healthy stream stays below 100.
    pub max_frame_age_ms: f64,
    /// Largest spread of the cameras' driver times, ms. Free-running cameras at 25 and 30 fps
    /// can always be paired within half an interval, 20 ms.
    pub max_skew_ms: f64,
    /// Smallest part of a gel that must have changed since the initial frame, 0..1.
    pub min_contact_fraction: f64,
    /// Smallest free space on the dataset's disk, bytes.
    pub min_free_bytes: u64,
    /// Age of an initial frame from which the screen asks to take it again, s.
    pub initial_warn_age_s: f64,
}

impl Default for GuardLimits {
    fn default() -> Self {
        Self {
            max_frame_age_ms: 150.0,
            max_skew_ms: 40.0,
            min_contact_fraction: 0.005,
            min_free_bytes: 1_000_000_000,
            initial_warn_age_s: 300.0,
        }
    }
}

/// The guards by their names in `grasp.json`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Guard {
    /// A camera delivers nothing that can be used.
    MissingCamera,
    /// A frame is older than the limit.
    StaleFrame,
    /// The cameras' frames lie too far apart in time.
    Skew,
    /// There is no initial frame to subtract.
    NoInitial,
    /// The gels look as they did at the initial frame.
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

/// One guard's refusal.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Objection {
    /// Which guard.
    pub guard: Guard,
    /// What it saw, in a sentence.
    pub reason: String,
    /// Whether the operator may override it.
    pub can_override: bool,
}

/// One camera at the moment of a trigger.
#[derive(Clone, Debug, PartialEq)]
pub struct CameraCondition {
    /// Its role.
    pub role: Role,
    /// Age of the frame that would be saved, ms; `None` when there is none that can be used.
    pub age_ms: Option<f64>,
    /// Driver time of that frame, ns.
    pub frame_time_ns: u64,
    /// Why there is none.
    pub fault: Option<String>,
    /// Control values read back from the camera.
    pub controls: BTreeMap<String, i64>,
    /// Part of the gel that changed since the pending initial frame, 0..1; tactile cameras only,
    /// `None` until a frame was held against it.
    pub contact_fraction: Option<f64>,
}

/// What the engine sees at the moment of a command.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Conditions {
    /// `CLOCK_MONOTONIC`, ns.
    pub now_ns: u64,
    /// Cameras of the rig.
    pub cameras: Vec<CameraCondition>,
    /// Spread of the driver times of the frames that would be saved, ms.
    pub skew_ms: f64,
    /// Free space of the dataset's disk, bytes; `None` when it cannot be asked.
    pub disk_free_bytes: Option<u64>,
}

/// Controls whose change between initial and grasp spoils the tactile difference.
const EXPOSURE_CONTROLS: [&str; 6] = [
    "auto_exposure",
    "exposure_time_absolute",
    "gain",
    "white_balance_automatic",
    "white_balance_temperature",
    "gamma",
];

/// Guards of every frame, initial or grasp; `captured_ns` is the time of the last capture, whose
/// frames must not be saved again.
pub(crate) fn check_frames(
    limits: &GuardLimits,
    now: &Conditions,
    captured_ns: u64,
) -> Vec<Objection> {
    let mut objections = Vec::new();
    let old: Vec<&str> = now
        .cameras
        .iter()
        .filter(|camera| camera.age_ms.is_some() && camera.frame_time_ns <= captured_ns)
        .map(|camera| camera.role.name())
        .collect();
    if !old.is_empty() {
        objections.push(Objection {
            guard: Guard::StaleFrame,
            reason: format!("{}: no new frame since the last capture", old.join(", ")),
            can_override: false,
        });
    }
    for camera in &now.cameras {
        match camera.age_ms {
            None => {
                let fault = camera.fault.as_deref().unwrap_or("no frame yet");
                objections.push(Objection {
                    guard: Guard::MissingCamera,
                    reason: format!("{}: {fault}", camera.role),
                    can_override: !camera.role.is_tactile(),
                });
            }
            Some(age) if age > limits.max_frame_age_ms => objections.push(Objection {
                guard: Guard::StaleFrame,
                reason: format!(
                    "{}: newest good frame is {age:.0} ms old, limit {:.0} ms",
                    camera.role, limits.max_frame_age_ms
                ),
                can_override: true,
            }),
            Some(_) => {}
        }
    }
    if now.skew_ms > limits.max_skew_ms {
        objections.push(Objection {
            guard: Guard::Skew,
            reason: format!(
                "frames lie {:.0} ms apart, limit {:.0} ms",
                now.skew_ms, limits.max_skew_ms
            ),
            can_override: true,
        });
    }
    if let Some(free) = now.disk_free_bytes
        && free < limits.min_free_bytes
    {
        objections.push(Objection {
            guard: Guard::DiskLow,
            reason: format!(
                "{} MB free on the dataset's disk, limit {} MB",
                free / 1_000_000,
                limits.min_free_bytes / 1_000_000
            ),
            can_override: true,
        });
    }
    objections
}

/// Guards of the grasp frame against the initial one.
pub(crate) fn check_against_initial(
    limits: &GuardLimits,
    now: &Conditions,
    initial: &PendingFrame,
) -> Vec<Objection> {
    let mut objections = Vec::new();
    let contacts: Vec<f64> = now
        .cameras
        .iter()
        .filter_map(|camera| camera.contact_fraction)
        .collect();
    if contacts.iter().all(|c| *c < limits.min_contact_fraction) {
        let largest = contacts.iter().copied().reduce(f64::max);
        objections.push(Objection {
            guard: Guard::NoContact,
            reason: match largest {
                Some(largest) => format!(
                    "no contact: at most {:.1} % of a gel changed since the initial frame, limit \
                     {:.1} %",
                    largest * 100.0,
                    limits.min_contact_fraction * 100.0
                ),
                None => {
                    "contact is not known: no gel was held against the initial frame yet".into()
                }
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
            objections.push(Objection {
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
    objections
}
