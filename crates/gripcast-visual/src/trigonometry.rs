//! Inlined single-precision sine, cosine and arc tangent for mapping directions to the environment
//! map. Error below 3e-7 (polynomials 4.3.97, 4.3.99 and 4.4.49 of Abramowitz and Stegun, *Handbook
//! of Mathematical Functions*).

use std::f32::consts::{FRAC_PI_2, PI};

/// Evaluates a polynomial; coefficients in ascending order.
#[inline(always)]
fn polynomial<const N: usize>(x: f32, coefficients: [f32; N]) -> f32 {
    let mut sum = 0.0;
    for k in (0..N).rev() {
        sum = sum * x + coefficients[k];
    }
    sum
}

/// Sine and cosine of an angle in [0, 1) turns.
#[inline(always)]
pub(super) fn sin_cos_turns(turns: f32) -> (f32, f32) {
    // Fold to [-π/2, π/2].
    let centred = turns - 0.5;
    let folded = if centred.abs() > 0.25 {
        0.5f32.copysign(centred) - centred
    } else {
        centred
    };
    let x = 2.0 * PI * folded;
    let x2 = x * x;
    let sin = x * polynomial(
        x2,
        [
            1.0,
            -0.166_666_67,
            0.008_333_332,
            -0.000_198_409,
            0.000_002_752_6,
            -0.000_000_023_9,
        ],
    );
    let cos = polynomial(
        x2,
        [
            1.0,
            -0.5,
            0.041_666_64,
            -0.001_388_839_7,
            0.000_024_760_9,
            -0.000_000_260_5,
        ],
    );
    let cos = if centred.abs() > 0.25 { -cos } else { cos };
    (-sin, -cos)
}

/// Angle of a vector from the x axis, turns in [-0.5, 0.5]; 0 for the zero vector.
#[inline(always)]
pub(super) fn turns_of(y: f32, x: f32) -> f32 {
    let (ax, ay) = (x.abs(), y.abs());
    let (small, large) = if ax < ay { (ax, ay) } else { (ay, ax) };
    let ratio = small / large.max(f32::MIN_POSITIVE);
    let r2 = ratio * ratio;
    let angle = ratio
        * polynomial(
            r2,
            [
                1.0,
                -0.333_331_45,
                0.199_935_51,
                -0.142_089,
                0.106_562_64,
                -0.075_289_64,
                0.042_909_614,
                -0.016_165_737,
                0.002_866_225_7,
            ],
        );
    let octant = if ax < ay { FRAC_PI_2 - angle } else { angle };
    let half = if x < 0.0 { PI - octant } else { octant };
    half.copysign(y) * (0.5 / PI)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sine_and_cosine_match_std() {
        for i in 0..=4000 {
            let turns = f64::from(i) / 4000.0;
            let (sin, cos) = sin_cos_turns(turns as f32);
            let exact = (std::f64::consts::TAU * turns).sin_cos();
            assert!((f64::from(sin) - exact.0).abs() < 6e-7, "{turns}: {sin}");
            assert!((f64::from(cos) - exact.1).abs() < 6e-7, "{turns}: {cos}");
        }
    }

    #[test]
    fn turns_of_inverts_sine_and_cosine() {
        for i in -2000..=2000 {
            let turns = f64::from(i) / 4001.0;
            let (sin, cos) = (std::f64::consts::TAU * turns).sin_cos();
            let found = turns_of(3.0 * sin as f32, 3.0 * cos as f32);
            assert!((f64::from(found) - turns).abs() < 1e-7, "{turns}: {found}");
        }
        assert_eq!(turns_of(0.0, 0.0), 0.0);
        assert_eq!(turns_of(0.0, -1.0), 0.5);
    }
}
