//! Guards: conditions of a trigger.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

use super::pending::PendingFrame;
use gripcast_imaging::{ChangeKind, GelChange, GelProblem, MIN_CONTACT_FRACTION, Role};

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
    /// Minimum fraction of a gel with contact structure since the initial frame, 0..1; 0 accepts
    /// any image.
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
            min_contact_fraction: MIN_CONTACT_FRACTION,
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
    /// A gel is still in contact at an initial frame.
    GripperClosed,
    /// A gel's image is black, saturated, noise, flickering or drifting.
    GelImage,
    /// No gel is in contact.
    NoContact,
    /// Only one gel is in contact.
    OneSidedContact,
    /// No gel is in contact, but the light changed since the initial frame.
    IlluminationChanged,
    /// A gel is not the one of the initial frame.
    OtherGel,
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
            Self::GripperClosed => "gripper_closed",
            Self::GelImage => "gel_image",
            Self::NoContact => "no_contact",
            Self::OneSidedContact => "one_sided_contact",
            Self::IlluminationChanged => "illumination_changed",
            Self::OtherGel => "other_gel",
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
    /// Reason for a missing or old frame.
    pub fault: Option<String>,
    /// Control values read back from the camera.
    pub controls: BTreeMap<String, i64>,
    /// Change of the gel since the pending or else the last initial frame; tactile cameras only,
    /// `None` before the first comparison.
    pub change: Option<GelChange>,
    /// Problems of the gel's image; tactile cameras only.
    pub gel_problems: Vec<GelProblem>,
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
                    "{}: newest valid frame is {age:.0} ms old, limit {:.0} ms{}",
                    camera.role,
                    limits.max_frame_age_ms,
                    match &camera.fault {
                        Some(fault) => format!("; {fault}"),
                        None => String::new(),
                    }
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

/// Checks the images of the gels. Drift counts with the gripper open only: a closing gripper changes
/// the light on the gels as well. A mark is no reason to refuse: it is part of the initial frame.
pub(crate) fn check_gels(now: &Conditions, is_open: bool) -> Vec<GuardViolation> {
    let named = |problem: &GelProblem| match problem {
        GelProblem::Drifting => is_open,
        GelProblem::Marked => false,
        _ => true,
    };
    let cameras = now.cameras.iter();
    let problems = cameras.flat_map(|camera| {
        let problems = camera.gel_problems.iter().copied().filter(named);
        problems.map(|problem| (camera.role, problem))
    });
    problems
        .map(|(role, problem)| GuardViolation {
            guard: Guard::GelImage,
            reason: format!("{role}: {}", problem.text()),
            can_override: true,
        })
        .collect()
}

/// Returns the compared gels with the kind of their change.
fn compared_gels(limits: &GuardLimits, now: &Conditions) -> Vec<(Role, GelChange, ChangeKind)> {
    let limit = limits.min_contact_fraction;
    let compared = |camera: &CameraCondition| {
        let change = camera.change?;
        Some((camera.role, change, change.kind(limit)))
    };
    now.cameras.iter().filter_map(compared).collect()
}

/// Checks that no gel is in contact at an initial frame. Without an earlier initial frame nothing
/// is known.
pub(crate) fn check_open(limits: &GuardLimits, now: &Conditions) -> Vec<GuardViolation> {
    let limit = limits.min_contact_fraction;
    let gels = compared_gels(limits, now).into_iter();
    let touched: Vec<String> = gels
        .filter(|(_, _, kind)| *kind == ChangeKind::Contact && limit > 0.0)
        .map(|(role, change, _)| format!("{role} {:.1} %", change.contact_fraction * 100.0))
        .collect();
    if touched.is_empty() {
        return Vec::new();
    }
    let reason = format!(
        "the gripper is still closed: contact since the last initial frame: {}, limit {:.1} %; \
         open it, or override if the gel itself has changed",
        touched.join(", "),
        limit * 100.0
    );
    vec![GuardViolation {
        guard: Guard::GripperClosed,
        reason,
        can_override: true,
    }]
}

/// Checks that both gels are in contact.
fn check_contact(limits: &GuardLimits, now: &Conditions) -> Vec<GuardViolation> {
    let gels = compared_gels(limits, now);
    let of_kind = |kind: ChangeKind| gels.iter().filter(move |gel| gel.2 == kind);
    let violation = |guard, reason| GuardViolation {
        guard,
        reason,
        can_override: true,
    };
    let mut violations: Vec<GuardViolation> = of_kind(ChangeKind::OtherGel)
        .map(|(role, ..)| {
            let reason = format!(
                "{role}: another gel than in the initial frame: check whether the sensors are \
                 swapped, then retake the initial frame"
            );
            violation(Guard::OtherGel, reason)
        })
        .collect();
    let touched: Vec<Role> = of_kind(ChangeKind::Contact).map(|gel| gel.0).collect();
    let brightened = of_kind(ChangeKind::Illumination);
    let brightest =
        brightened.max_by(|a, b| a.1.illumination_levels.total_cmp(&b.1.illumination_levels));
    let limit = limits.min_contact_fraction * 100.0;
    let percent = |change: &GelChange| change.contact_fraction * 100.0;
    if gels.is_empty() {
        let reason = "contact unknown: no gel was compared with the initial frame yet";
        violations.push(violation(Guard::NoContact, reason.into()));
    } else if let [role] = touched[..]
        && let Some((other, change, _)) = gels.iter().find(|gel| gel.0 != role)
        && violations.is_empty()
    {
        let reason = format!(
            "only the {role} gel is in contact: {:.1} % of the {other} gel, limit {limit:.1} %; \
             centre the gripper on the object",
            percent(change)
        );
        violations.push(violation(Guard::OneSidedContact, reason));
    } else if touched.is_empty()
        && let Some((role, change, _)) = brightest
    {
        let reason = format!(
            "no contact: only the light on the {role} gel changed, by {:.0} grey levels since the \
             initial frame: check lamps and exposure, then retake the initial frame",
            change.illumination_levels
        );
        violations.push(violation(Guard::IlluminationChanged, reason));
    } else if touched.is_empty() && violations.is_empty() {
        let max = gels.iter().map(|gel| percent(&gel.1)).fold(0.0, f64::max);
        let reason = format!("no contact: at most {max:.1} % of a gel, limit {limit:.1} %");
        violations.push(violation(Guard::NoContact, reason));
    }
    violations
}

/// Checks the grasp frame against the initial frame.
pub(crate) fn check_against_initial(
    limits: &GuardLimits,
    now: &Conditions,
    initial: &PendingFrame,
) -> Vec<GuardViolation> {
    let mut violations = check_contact(limits, now);
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
