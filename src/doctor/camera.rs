//! What a camera of the rig delivered while it was measured.

use super::{Finding, Verdict};
use crate::camera_check::{CameraCheck, Opened};
use gripcast_capture::calibration::CameraConfig;
use gripcast_session::GuardLimits;

/// Most that a timestamp may lie after the frame's arrival, ms: two clocks are read.
const AHEAD_MS: f64 = 1.0;

/// Rate and losses, timestamps and controls of a camera.
pub(super) fn findings(
    check: &CameraCheck,
    wanted: Option<&CameraConfig>,
    guards: &GuardLimits,
) -> Vec<Finding> {
    let role = check.role.name();
    let mut findings: Vec<Finding> = check
        .problems
        .iter()
        .map(|problem| {
            let (found, remedy) = match problem.split_once("\n  → ") {
                Some((found, remedy)) => (found, remedy),
                None => (
                    &**problem,
                    "see docs/kernel-tests.md for what cameras are known to do",
                ),
            };
            Finding::new("camera", role, Verdict::Fail, found).remedy(remedy)
        })
        .collect();
    let Some(opened) = &check.opened else {
        return findings;
    };
    if findings.is_empty() {
        findings.push(rate(role, opened));
    }
    findings.extend(timestamps(role, opened, guards));
    findings.push(controls(role, opened, wanted));
    findings
}

fn rate(role: &str, opened: &Opened) -> Finding {
    let (info, frames) = (&opened.info, &opened.frames);
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
    let is_whole = frames.lost == 0 && frames.damaged == 0;
    let verdict = if is_whole { Verdict::Ok } else { Verdict::Warn };
    let finding = Finding::new("camera", role, verdict, found)
        .figure("fps", fps)
        .figure("lost", frames.lost as f64)
        .figure("damaged", frames.damaged as f64);
    if is_whole {
        return finding;
    }
    finding
        .remedy("another cable or port; cameras on one USB controller take frames from each other")
}

fn timestamps(role: &str, opened: &Opened, guards: &GuardLimits) -> Option<Finding> {
    let [least, most] = opened.frames.delay_ms?;
    let name = format!("{role}, timestamps");
    let found = format!("frames arrive {least:.1} to {most:.1} ms after their timestamp");
    let finding = Finding::new("camera", name, Verdict::Ok, found)
        .figure("delay_ms_min", least)
        .figure("delay_ms_max", most);
    let warned = |found: String| Finding {
        verdict: Verdict::Warn,
        found,
        ..finding.clone()
    };
    Some(if opened.frames.backwards > 0 {
        warned(format!(
            "timestamps ran backwards {} times",
            opened.frames.backwards
        ))
        .remedy("`dmesg` for the camera's clock; uvcvideo's parameter clock=CLOCK_MONOTONIC")
    } else if least < -AHEAD_MS {
        warned(format!(
            "timestamps lie up to {:.1} ms in the future",
            -least
        ))
        .remedy("load uvcvideo with clock=CLOCK_MONOTONIC, as it is by default")
    } else if most > guards.max_frame_age_ms {
        warned(format!(
            "{found}; triggers take frames of up to {} ms",
            guards.max_frame_age_ms,
            found = finding.found
        ))
        .remedy("a faster computer, smaller frames, or a larger guards.max_frame_age_ms")
    } else {
        finding
    })
}

/// Whether controls came to hold as the rig file has them.
fn controls(role: &str, opened: &Opened, wanted: Option<&CameraConfig>) -> Finding {
    let name = format!("{role}, controls");
    let mut differing: Vec<String> = Vec::new();
    let wanted = wanted.into_iter().flat_map(|camera| &camera.controls);
    let mut asked = 0;
    for (control, value) in wanted {
        asked += 1;
        match opened.controls.get(control) {
            Some(found) if found == value => {}
            Some(found) => differing.push(format!("{control} is {found}, not {value}")),
            None => differing.push(format!("{control} is not read back")),
        }
    }
    let mut notes = opened.notes.clone();
    notes.extend(differing);
    if notes.is_empty() {
        let found = match asked {
            0 => "the rig file sets none".to_owned(),
            asked => format!("{asked} as the rig file has them"),
        };
        return Finding::new("camera", name, Verdict::Ok, found);
    }
    Finding::new("camera", name, Verdict::Warn, notes.join("; ")).remedy(
        "correct [cameras.ROLE.controls] of the rig file; `gripcast rig check` prints what holds",
    )
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::camera_check::Frames;
    use gripcast_capture::calibration::SourceKind;
    use gripcast_capture::camera::{CameraIdentity, StreamInfo};
    use gripcast_imaging::{PixelFormat, Role};

    fn check(frames: Frames, controls: &[(&str, i64)], problems: &[&str]) -> CameraCheck {
        let opened = Opened {
            info: StreamInfo {
                identity: CameraIdentity::default(),
                format: PixelFormat::Mjpg,
                width: 640,
                height: 480,
                nominal_fps: 25.0,
                depth_unit_m: None,
            },
            frames,
            controls: controls
                .iter()
                .map(|(n, v)| ((*n).to_owned(), *v))
                .collect(),
            last: None,
            intrinsics: None,
            notes: Vec::new(),
        };
        let problems = problems.iter().map(|p| (*p).to_owned()).collect();
        CameraCheck::new(Role::Left, Some(opened), problems)
    }

    fn verdicts(check: &CameraCheck, gain: Option<i64>) -> Vec<Verdict> {
        let mut wanted = CameraConfig::new(SourceKind::V4l2, PixelFormat::Mjpg, 640, 480, 25.0);
        wanted
            .controls
            .extend(gain.map(|gain| ("gain".to_owned(), gain)));
        let found = findings(check, Some(&wanted), &GuardLimits::default());
        for finding in &found {
            let needs_fixing = finding.verdict > Verdict::Ok;
            assert_eq!(needs_fixing, finding.remedy.is_some(), "{finding:?}");
        }
        found.iter().map(|finding| finding.verdict).collect()
    }

    #[test]
    fn losses_clocks_and_controls_are_told_apart() {
        use Verdict::{Fail, Ok, Warn};
        let sound = Frames {
            received: 50,
            fps: Some(25.0),
            delay_ms: Some([2.0, 9.0]),
            ..Frames::default()
        };
        let of = |frames| check(frames, &[("gain", 7)], &[]);
        assert_eq!(verdicts(&of(sound), Some(7)), [Ok, Ok, Ok]);
        assert_eq!(verdicts(&of(sound), None), [Ok, Ok, Ok]);
        assert_eq!(verdicts(&of(sound), Some(8)), [Ok, Ok, Warn]);
        let lossy = Frames { lost: 1, ..sound };
        assert_eq!(verdicts(&of(lossy), None), [Warn, Ok, Ok]);
        for frames in [
            Frames {
                delay_ms: Some([-80.0, 3.0]),
                ..sound
            },
            Frames {
                delay_ms: Some([2.0, 900.0]),
                ..sound
            },
            Frames {
                backwards: 2,
                ..sound
            },
        ] {
            assert_eq!(verdicts(&of(frames), None), [Ok, Warn, Ok]);
        }
        let broken = check(sound, &[], &["no frame came\n  → plug it in"]);
        assert_eq!(verdicts(&broken, None), [Fail, Ok, Ok]);
        let found = findings(&broken, None, &GuardLimits::default());
        assert_eq!(found[0].remedy.as_deref(), Some("plug it in"));
    }
}
