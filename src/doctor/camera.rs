//! InferenceState of the camera measurement.

use super::{CheckStatus, Finding};
use crate::camera_check::{CameraCheck, CameraMeasurement};
use gripcast_capture::calibration::CameraConfig;
use gripcast_capture::camera::CameraState;
use gripcast_session::GuardLimits;

/// Maximum time of a timestamp after the frame's arrival, ms: two clock readings differ.
const MAX_AHEAD_MS: f64 = 1.0;

/// Checks frame rate, losses, timestamps and controls of a camera.
pub(super) fn findings(
    check: &CameraCheck,
    config: Option<&CameraConfig>,
    guards: &GuardLimits,
) -> Vec<Finding> {
    let role = check.role.name();
    let mut findings: Vec<Finding> = check
        .problems
        .iter()
        .map(|problem| {
            let (message, remedy) = problem.split_once("\n  → ").unwrap_or((
                problem,
                "see docs/how-to/kernel-tests.md for known camera problems",
            ));
            Finding::new("camera", role, CheckStatus::Fail, message).remedy(remedy)
        })
        .collect();
    let Some(measurement) = &check.measurement else {
        return findings;
    };
    if findings.is_empty() {
        findings.push(rate(role, measurement, &check.state));
    }
    findings.extend(timestamps(role, measurement, guards));
    findings.push(controls(role, measurement, config));
    findings
}

fn rate(role: &str, measurement: &CameraMeasurement, state: &CameraState) -> Finding {
    let (info, frames) = (&measurement.info, &measurement.frames);
    let fps = frames.fps.unwrap_or_default();
    let found = format!(
        "{}: {} {}×{}, {fps:.2} of {} frames/s, {} lost, {} damaged",
        info.identity,
        info.format,
        info.width,
        info.height,
        info.nominal_fps,
        frames.lost,
        frames.damaged
    );
    let found = match measurement.damage.as_str() {
        "" => found,
        damage => format!("{found} ({damage})"),
    };
    let finding = Finding::new("camera", role, CheckStatus::Ok, found)
        .measurement("fps", fps)
        .measurement("lost", frames.lost as f64)
        .measurement("damaged", frames.damaged as f64);
    if let CameraState::NoValidDepth { .. } = state {
        let mut finding = finding;
        finding.message += "; depth sees nothing";
        return finding
            .warn("move the camera away from the surface, add light, switch the emitter on");
    }
    if frames.lost == 0 && frames.damaged == 0 {
        return finding;
    }
    finding.warn("use another cable or port; cameras on one USB controller compete for bandwidth")
}

fn timestamps(
    role: &str,
    measurement: &CameraMeasurement,
    guards: &GuardLimits,
) -> Option<Finding> {
    let [min, max] = measurement.frames.delay_ms?;
    let name = format!("{role}, timestamps");
    let delay = format!("frames arrive {min:.1} to {max:.1} ms after their timestamp");
    let backwards = measurement.frames.backwards;
    let limit_ms = guards.max_frame_age_ms;
    let (message, remedy) = if backwards > 0 {
        (
            format!("timestamps ran backwards {backwards} times"),
            "check the camera's clock in `dmesg`; load uvcvideo with clock=CLOCK_MONOTONIC",
        )
    } else if min < -MAX_AHEAD_MS {
        (
            format!("timestamps are up to {:.1} ms in the future", -min),
            "load uvcvideo with clock=CLOCK_MONOTONIC, the default",
        )
    } else if max > limit_ms {
        (
            format!("{delay}; triggers accept frames of up to {limit_ms} ms"),
            "use a faster computer, smaller frames, or a larger guards.max_frame_age_ms",
        )
    } else {
        (delay, "")
    };
    let finding = Finding::new("camera", name, CheckStatus::Ok, message)
        .measurement("delay_ms_min", min)
        .measurement("delay_ms_max", max);
    Some(match remedy {
        "" => finding,
        remedy => finding.warn(remedy),
    })
}

/// Compares the controls with the rig file.
fn controls(role: &str, measurement: &CameraMeasurement, config: Option<&CameraConfig>) -> Finding {
    let name = format!("{role}, controls");
    let mut problems = measurement.notes.clone();
    let configured = config.map_or(0, |config| config.controls.len());
    for (control, value) in config.into_iter().flat_map(|config| &config.controls) {
        match measurement.controls.get(control) {
            Some(found) if found == value => {}
            Some(found) => problems.push(format!("expected {control} {value}, found {found}")),
            None => problems.push(format!("{control} cannot be read back")),
        }
    }
    if !problems.is_empty() {
        return Finding::new("camera", name, CheckStatus::Ok, problems.join("; ")).warn(
            "correct [cameras.ROLE.controls] in the rig file; `gripcast rig check` prints the values",
        );
    }
    let message = match configured {
        0 => "none set in the rig file".to_owned(),
        count => format!("{count} as set in the rig file"),
    };
    Finding::new("camera", name, CheckStatus::Ok, message)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::camera_check::FrameStats;
    use gripcast_capture::calibration::SourceKind;
    use gripcast_capture::camera::{CameraIdentity, StreamInfo};
    use gripcast_imaging::{PixelFormat, Role};

    fn check(frames: FrameStats, controls: &[(&str, i64)], problems: &[&str]) -> CameraCheck {
        let measurement = CameraMeasurement {
            info: StreamInfo {
                identity: CameraIdentity::default(),
                format: PixelFormat::Mjpg,
                width: 640,
                height: 480,
                nominal_fps: 25.0,
                depth_unit_m: None,
            },
            frames,
            damage: String::new(),
            controls: controls
                .iter()
                .map(|(n, v)| ((*n).to_owned(), *v))
                .collect(),
            last: None,
            intrinsics: None,
            gel: None,
            notes: Vec::new(),
        };
        let problems = problems.iter().map(|p| (*p).to_owned()).collect();
        let mut check = CameraCheck::new(Role::Left, String::new());
        (check.measurement, check.problems) = (Some(measurement), problems);
        check
    }

    fn statuses(check: &CameraCheck, gain: Option<i64>) -> Vec<CheckStatus> {
        let mut config = CameraConfig::new(SourceKind::V4l2, PixelFormat::Mjpg, 640, 480, 25.0);
        config
            .controls
            .extend(gain.map(|gain| ("gain".to_owned(), gain)));
        let found = findings(check, Some(&config), &GuardLimits::default());
        for finding in &found {
            let needs_fixing = finding.status > CheckStatus::Ok;
            assert_eq!(needs_fixing, finding.remedy.is_some(), "{finding:?}");
        }
        found.iter().map(|finding| finding.status).collect()
    }

    #[test]
    fn losses_clocks_and_controls_are_distinguished() {
        use CheckStatus::{Fail, Ok, Warn};
        let valid = FrameStats {
            received: 50,
            fps: Some(25.0),
            delay_ms: Some([2.0, 9.0]),
            ..FrameStats::default()
        };
        let of = |frames| check(frames, &[("gain", 7)], &[]);
        assert_eq!(statuses(&of(valid), Some(7)), [Ok, Ok, Ok]);
        assert_eq!(statuses(&of(valid), None), [Ok, Ok, Ok]);
        assert_eq!(statuses(&of(valid), Some(8)), [Ok, Ok, Warn]);
        let lossy = FrameStats { lost: 1, ..valid };
        assert_eq!(statuses(&of(lossy), None), [Warn, Ok, Ok]);
        for frames in [
            FrameStats {
                delay_ms: Some([-80.0, 3.0]),
                ..valid
            },
            FrameStats {
                delay_ms: Some([2.0, 900.0]),
                ..valid
            },
            FrameStats {
                backwards: 2,
                ..valid
            },
        ] {
            assert_eq!(statuses(&of(frames), None), [Ok, Warn, Ok]);
        }
        let broken = check(valid, &[], &["no frame came\n  → plug it in"]);
        assert_eq!(statuses(&broken, None), [Fail, Ok, Ok]);
        let found = findings(&broken, None, &GuardLimits::default());
        assert_eq!(found[0].remedy.as_deref(), Some("plug it in"));
    }
}
