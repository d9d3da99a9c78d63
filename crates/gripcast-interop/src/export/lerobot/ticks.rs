//! The frames of a sequence: which frame of each camera belongs to which moment.

use gripcast_base::error::{Error, Result};
use gripcast_imaging::Role;

/// Maximum age of the newest frame of a camera, ns. An older one is not what the camera sees.
pub(super) const MAX_AGE_NS: u64 = 500_000_000;
const SECOND_NS: i128 = 1_000_000_000;

/// Frames of one camera.
#[derive(Clone, Debug)]
pub(super) struct CameraTimes {
    pub(super) role: Role,
    /// Driver times, ascending, ns.
    pub(super) times_ns: Vec<u64>,
    /// Driver time of the stored frame of the grasp, ns; one of `times_ns`.
    pub(super) grasp_ns: u64,
}

/// Moments from the first to the last, `CLOCK_MONOTONIC`, ns. The grasp is between.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Window {
    pub(super) start_ns: u64,
    /// Driver time of the newest stored frame of the grasp.
    pub(super) grasp_ns: u64,
    pub(super) end_ns: u64,
}

/// Phase of a frame in a sequence.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Phase {
    /// Before the grasp trigger.
    Approach,
    /// The stored frames of the grasp.
    Grasp,
    /// After it.
    Lift,
}

impl Phase {
    /// Value of the feature `phase`.
    pub(super) fn number(self) -> i64 {
        match self {
            Self::Approach => 0,
            Self::Grasp => 1,
            Self::Lift => 2,
        }
    }
}

/// One frame of a sequence.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Tick {
    pub(super) phase: Phase,
    /// Driver times of the cameras' frames, in the order of the cameras, ns.
    pub(super) frames_ns: Vec<u64>,
}

/// Rate of the slowest camera and its role: the median of its intervals, rounded, at least 1.
///
/// # Errors
/// `Input`: a camera has fewer than two frames.
pub(super) fn slowest_rate(cameras: &[CameraTimes]) -> Result<(u32, Role)> {
    let mut slowest: Option<(u32, Role)> = None;
    for camera in cameras {
        let mut intervals: Vec<u64> = camera.times_ns.windows(2).map(|w| w[1] - w[0]).collect();
        intervals.sort_unstable();
        let Some(median) = intervals.get(intervals.len() / 2) else {
            let what = format!("the black box has no second frame of {}", camera.role);
            return Err(Error::input(what));
        };
        let rate = (1e9 / *median as f64).round().clamp(1.0, 1000.0) as u32;
        if slowest.is_none_or(|(least, _)| rate < least) {
            slowest = Some((rate, camera.role));
        }
    }
    slowest.ok_or_else(|| Error::input("the grasp has no cameras"))
}

/// Moments at a fixed rate, one of which is the grasp, with the newest frame of every camera at or
/// before each. The grasp has the stored frames, which were taken a little apart; no camera goes
/// back in time before it.
///
/// # Errors
/// `Input`: the newest frame of a camera is too old, or there is none.
pub(super) fn ticks(window: &Window, fps: u32, cameras: &[CameraTimes]) -> Result<Vec<Tick>> {
    let grasp_ns = i128::from(window.grasp_ns);
    let fps = i128::from(fps.max(1));
    let count = |duration_ns: u64| i128::from(duration_ns) * fps / SECOND_NS;
    let before = count(window.grasp_ns.saturating_sub(window.start_ns));
    let after = count(window.end_ns.saturating_sub(window.grasp_ns));
    let mut ticks = Vec::new();
    for step in -before..=after {
        let time_ns = u64::try_from(grasp_ns + step * SECOND_NS / fps).unwrap_or(0);
        let phase = match step {
            ..0 => Phase::Approach,
            0 => Phase::Grasp,
            1.. => Phase::Lift,
        };
        let frames = cameras.iter().map(|camera| match phase {
            Phase::Grasp => Ok(camera.grasp_ns),
            Phase::Approach => camera.newest(time_ns.min(camera.grasp_ns), time_ns, window),
            Phase::Lift => camera.newest(time_ns, time_ns, window),
        });
        ticks.push(Tick {
            phase,
            frames_ns: frames.collect::<Result<_>>()?,
        });
    }
    Ok(ticks)
}

impl CameraTimes {
    /// Newest frame at or before `limit_ns`, for the moment `time_ns`.
    fn newest(&self, limit_ns: u64, time_ns: u64, window: &Window) -> Result<u64> {
        let after = self.times_ns.partition_point(|time| *time <= limit_ns);
        let newest = after.checked_sub(1).map(|index| self.times_ns[index]);
        match newest {
            Some(newest) if time_ns - newest <= MAX_AGE_NS => Ok(newest),
            _ => {
                let offset_ns = i128::from(time_ns) - i128::from(window.grasp_ns);
                let (side, seconds) = match offset_ns {
                    ..0 => ("before", -offset_ns as f64 / 1e9),
                    0.. => ("after", offset_ns as f64 / 1e9),
                };
                Err(Error::input(format!(
                    "the black box has no frame of {} in the {} ms up to {seconds:.2} s {side} the grasp",
                    self.role,
                    MAX_AGE_NS / 1_000_000,
                )))
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const MS: u64 = 1_000_000;

    fn camera(role: Role, times_ms: &[u64], grasp_ms: u64) -> CameraTimes {
        CameraTimes {
            role,
            times_ns: times_ms.iter().map(|ms| ms * MS).collect(),
            grasp_ns: grasp_ms * MS,
        }
    }

    fn window(start_ms: u64, grasp_ms: u64, end_ms: u64) -> Window {
        Window {
            start_ns: start_ms * MS,
            grasp_ns: grasp_ms * MS,
            end_ns: end_ms * MS,
        }
    }

    fn chosen_ms(ticks: &[Tick], camera: usize) -> Vec<u64> {
        ticks.iter().map(|t| t.frames_ns[camera] / MS).collect()
    }

    #[test]
    fn newest_frame_at_or_before_each_moment() {
        let cameras = [
            camera(Role::Left, &[960, 1000, 1040, 1080, 1120], 1040),
            camera(Role::Rgb, &[950, 1035, 1110], 1035),
        ];
        let ticks = ticks(&window(960, 1040, 1125), 25, &cameras).unwrap();
        assert_eq!(chosen_ms(&ticks, 0), [960, 1000, 1040, 1080, 1120]);
        assert_eq!(chosen_ms(&ticks, 1), [950, 950, 1035, 1035, 1110]);
        let parts: Vec<i64> = ticks.iter().map(|tick| tick.phase.number()).collect();
        assert_eq!(parts, [0, 0, 1, 2, 2]);
    }

    /// The right frame was stored although newer ones were there at the moment of the left one.
    #[test]
    fn grasp_has_the_stored_frames_and_no_camera_goes_back() {
        let times: Vec<u64> = (0..40).map(|i| 900 + 10 * i).collect();
        let cameras = [
            camera(Role::Left, &times, 1100),
            camera(Role::Right, &times, 1030),
        ];
        let ticks = ticks(&window(1000, 1100, 1160), 50, &cameras).unwrap();
        assert_eq!(
            chosen_ms(&ticks, 1),
            [1000, 1020, 1030, 1030, 1030, 1030, 1120, 1140, 1160]
        );
        assert_eq!(ticks[5].phase, Phase::Grasp);
    }

    #[test]
    fn moments_do_not_drift() {
        let times: Vec<u64> = (0..4000).collect();
        let cameras = [camera(Role::Left, &times, 100)];
        let ticks = ticks(&window(100, 100, 3100), 30, &cameras).unwrap();
        assert_eq!(ticks.len(), 91);
        assert_eq!(chosen_ms(&ticks, 0)[90], 3100);
        assert_eq!(chosen_ms(&ticks, 0)[1], 133);
    }

    #[test]
    fn gaps_are_named() {
        let cameras = [camera(Role::Left, &[1000, 1100, 1750], 1100)];
        let error = ticks(&window(1000, 1100, 1750), 10, &cameras).unwrap_err();
        assert_eq!(
            error.what(),
            "the black box has no frame of left in the 500 ms up to 0.60 s after the grasp"
        );
        let error = ticks(&window(900, 1100, 1100), 10, &cameras).unwrap_err();
        assert!(error.what().contains("0.20 s before"), "{error}");
    }

    #[test]
    fn rate_is_that_of_the_slowest_camera() {
        let cameras = [
            camera(Role::Left, &[0, 40, 80, 120], 40),
            camera(Role::Rgb, &[0, 33, 66, 300, 333], 33),
            camera(Role::Depth, &[0, 66, 133, 200], 66),
        ];
        assert_eq!(slowest_rate(&cameras).unwrap(), (15, Role::Depth));
        let single = [camera(Role::Left, &[40], 40)];
        assert!(slowest_rate(&single).unwrap_err().what().contains("left"));
    }
}
