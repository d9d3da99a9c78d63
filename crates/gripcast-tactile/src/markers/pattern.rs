//! Plausible marker patterns.

use gripcast_base::error::{Error, Result};
use gripcast_shear::MarkerPattern;

use crate::ensure;

/// Smallest pitch, pixels: less cannot be told apart.
const MIN_PITCH_PX: f64 = 4.0;
/// Largest pitch, m.
const MAX_PITCH_M: f64 = 0.02;
/// Largest tilt, degrees: beyond it a square lattice repeats.
const MAX_TILT_DEG: f64 = 45.0;

/// Checks a pattern for an image of a scale and a gel of a thickness.
///
/// # Errors
/// `Config` with the key, the expected and the found value.
pub(crate) fn validate(pattern: &MarkerPattern, pixel_m: f64, thickness_m: f64) -> Result<()> {
    let min_pitch_m = MIN_PITCH_PX * pixel_m;
    for pitch_m in pattern.pitch_m {
        within("pitch_m", pitch_m, [min_pitch_m, MAX_PITCH_M])?;
    }
    let [x, y] = pattern.pitch_m;
    let smaller_m = x.min(y);
    ensure(
        pattern.diameter_m > 0.0 && pattern.diameter_m < smaller_m,
        || {
            Error::config(format!(
                "sensor profile: markers.diameter_m must be above 0 and below the pitch of \
                 {smaller_m} m, found {}",
                pattern.diameter_m
            ))
            .remedy("gel markers must not touch: correct the diameter or the pitch")
        },
    )?;
    for (axis, offset_m) in pattern.offset_m.into_iter().enumerate() {
        let pitch_m = pattern.pitch_m[axis];
        within("offset_m", offset_m, [-pitch_m, pitch_m])?;
    }
    within("tilt_deg", pattern.tilt_deg, [-MAX_TILT_DEG, MAX_TILT_DEG])?;
    within("jitter_m", pattern.jitter_m, [0.0, 0.2 * smaller_m])?;
    within("darkness", pattern.darkness, [0.0, 1.0])?;
    within("edge_m", pattern.edge_m, [0.0, pattern.diameter_m])?;
    within("depth_m", pattern.depth_m, [0.0, thickness_m])
}

fn within(key: &str, value: f64, [low, high]: [f64; 2]) -> Result<()> {
    ensure((low..=high).contains(&value), || {
        Error::config(format!(
            "sensor profile: markers.{key} must be {low} to {high}, found {value}"
        ))
    })
}

/// A pattern for tests.
#[cfg(test)]
pub(crate) fn sample_pattern() -> MarkerPattern {
    MarkerPattern {
        pitch_m: [2e-3, 1.9e-3],
        diameter_m: 7.5e-4,
        offset_m: [3e-4, -2e-4],
        tilt_deg: -0.4,
        jitter_m: 4e-5,
        darkness: 0.66,
        edge_m: 1.5e-4,
        depth_m: 6e-5,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn implausible_pattern_names_the_key() {
        let good = sample_pattern();
        validate(&good, 6e-5, 4e-3).unwrap();
        let with = |change: &dyn Fn(&mut MarkerPattern)| {
            let mut pattern = good.clone();
            change(&mut pattern);
            validate(&pattern, 6e-5, 4e-3).unwrap_err().to_string()
        };
        for (text, key) in [
            (with(&|p| p.pitch_m[1] = 1e-4), "pitch_m"),
            (with(&|p| p.pitch_m[0] = f64::NAN), "pitch_m"),
            (with(&|p| p.diameter_m = 2.5e-3), "below the pitch"),
            (with(&|p| p.diameter_m = f64::NAN), "diameter_m"),
            (with(&|p| p.offset_m[0] = 5e-3), "offset_m"),
            (with(&|p| p.tilt_deg = 90.0), "tilt_deg"),
            (with(&|p| p.jitter_m = 1e-3), "jitter_m"),
            (with(&|p| p.darkness = 1.2), "darkness"),
            (with(&|p| p.edge_m = 1e-3), "edge_m"),
            (with(&|p| p.depth_m = -1e-5), "depth_m"),
        ] {
            assert!(text.contains(key), "{text}");
        }
    }
}
