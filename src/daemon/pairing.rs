//! Which frames of free-running cameras belong together.

use std::collections::BTreeMap;

use gripcast_imaging::{Frame, Role};

/// The frames that a trigger would save.
#[derive(Clone, Debug, Default)]
pub(super) struct Paired {
    /// One frame a camera; cameras without a good frame are absent.
    pub frames: BTreeMap<Role, Frame>,
    /// Spread of their driver times, ms.
    pub skew_ms: f64,
}

/// A camera whose newest frame is older does not set the time for the others, ns: half of what a
/// ring of 8 frames spans at 25/s.
const FALLEN_BEHIND_NS: u64 = 150_000_000;

/// Picks one good frame a camera, as new as possible and as close together as possible.
///
/// The camera whose newest frame is oldest sets the time: all others have a frame near it in
/// their ring. A camera that has fallen behind does not drag the others back.
#[must_use]
pub(super) fn pair(good: &BTreeMap<Role, Vec<Frame>>, now_ns: u64) -> Paired {
    let newest: Vec<u64> = good
        .values()
        .filter_map(|frames| frames.iter().map(|f| f.driver_time_ns).max())
        .collect();
    let fresh = newest
        .iter()
        .copied()
        .filter(|t| now_ns.saturating_sub(*t) <= FALLEN_BEHIND_NS);
    let Some(target) = fresh.min().or_else(|| newest.iter().copied().max()) else {
        return Paired::default();
    };
    let frames: BTreeMap<Role, Frame> = good
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
    Paired {
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

    fn paired_ms(good: &[(Role, &[u64])], now_ms: u64) -> (Vec<u64>, f64) {
        let good = good.iter().map(|(r, t)| (*r, frames(t))).collect();
        let paired = pair(&good, now_ms * 1_000_000);
        let times = paired.frames.values().map(|f| f.driver_time_ns / 1_000_000);
        (times.collect(), paired.skew_ms)
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
    fn a_silent_camera_does_not_drag_the_others_back() {
        let (times, skew) = paired_ms(
            &[(Role::Left, &[900, 940, 980]), (Role::Right, &[100, 140])],
            1000,
        );
        assert_eq!(times, [980, 140]);
        assert!(skew > 800.0, "the skew guard has to see it: {skew}");
    }

    #[test]
    fn no_frames_pair_to_nothing() {
        assert_eq!(paired_ms(&[], 10), (vec![], 0.0));
        assert_eq!(paired_ms(&[(Role::Left, &[])], 10), (vec![], 0.0));
    }
}
