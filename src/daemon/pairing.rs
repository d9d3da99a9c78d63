//! Pairing of frames from free-running cameras.

use std::collections::BTreeMap;

use gripcast_imaging::{Frame, Role};

/// The frames that a trigger saves.
#[derive(Clone, Debug, Default)]
pub(super) struct FrameSet {
    /// One frame per camera; cameras without a valid frame are missing.
    pub frames: BTreeMap<Role, Frame>,
    /// Skew: largest difference of the driver times, ms.
    pub skew_ms: f64,
}

/// Maximum age of a camera's newest frame for the camera to set the common time, ns: half the span
/// of a ring of 8 frames at 25/s.
const MAX_LAG_NS: u64 = 150_000_000;

/// Selects one valid frame per camera, as new and as close together in time as possible.
///
/// The camera whose newest frame is oldest sets the common time: all others have a frame near it in
/// their ring. Cameras that lag too far behind are ignored for this.
pub(super) fn pair(valid: &BTreeMap<Role, Vec<Frame>>, now_ns: u64) -> FrameSet {
    let newest: Vec<u64> = valid
        .values()
        .filter_map(|frames| frames.iter().map(|f| f.driver_time_ns).max())
        .collect();
    let fresh = newest
        .iter()
        .copied()
        .filter(|t| now_ns.saturating_sub(*t) <= MAX_LAG_NS);
    let Some(target) = fresh.min().or_else(|| newest.iter().copied().max()) else {
        return FrameSet::default();
    };
    let frames: BTreeMap<Role, Frame> = valid
        .iter()
        .filter_map(|(role, frames)| {
            let nearest = frames
                .iter()
                .min_by_key(|f| f.driver_time_ns.abs_diff(target))?;
            Some((*role, nearest.clone()))
        })
        .collect();
    let times = frames.values().map(|f| f.driver_time_ns);
    let spread = match (times.clone().max(), times.min()) {
        (Some(max), Some(min)) => max - min,
        _ => 0,
    };
    FrameSet {
        frames,
        skew_ms: spread as f64 * 1e-6,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use gripcast_imaging::PixelFormat;

    fn frames(times_ms: &[u64]) -> Vec<Frame> {
        times_ms
            .iter()
            .enumerate()
            .map(|(i, t)| Frame {
                format: PixelFormat::Grey,
                width: 1,
                height: 1,
                data: vec![0].into(),
                sequence: i as u32,
                driver_time_ns: t * 1_000_000,
                received_ns: 0,
            })
            .collect()
    }

    fn paired_ms(valid: &[(Role, &[u64])], now_ms: u64) -> (Vec<u64>, f64) {
        let valid = valid.iter().map(|(r, t)| (*r, frames(t))).collect();
        let frame_set = pair(&valid, now_ms * 1_000_000);
        let times = frame_set
            .frames
            .values()
            .map(|f| f.driver_time_ns / 1_000_000);
        (times.collect(), frame_set.skew_ms)
    }

    #[test]
    fn free_running_cameras_pair_within_half_an_interval() {
        let left: &[u64] = &[0, 40, 80, 120, 160];
        let right: &[u64] = &[15, 55, 95, 135, 175];
        let rgb: &[u64] = &[33, 66, 100, 133, 166, 199];
        let (times, skew) = paired_ms(
            &[(Role::Left, left), (Role::Right, right), (Role::Rgb, rgb)],
            205,
        );
        assert_eq!(times, [160, 175, 166]);
        assert!(skew <= 20.0);
    }

    #[test]
    fn silent_camera_does_not_delay_the_others() {
        let (times, skew) = paired_ms(
            &[(Role::Left, &[900, 940, 980]), (Role::Right, &[100, 140])],
            1000,
        );
        assert_eq!(times, [980, 140]);
        assert!(skew > 800.0, "the skew guard must trigger: {skew}");
    }

    #[test]
    fn no_frames_give_empty_set() {
        assert_eq!(paired_ms(&[], 10), (vec![], 0.0));
        assert_eq!(paired_ms(&[(Role::Left, &[])], 10), (vec![], 0.0));
    }
}
