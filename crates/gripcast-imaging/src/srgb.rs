//! Transfer function of sRGB (IEC 61966-2-1).

use std::sync::LazyLock;

/// Linear light of each 8-bit value.
static LINEAR: LazyLock<[f32; 256]> =
    LazyLock::new(|| std::array::from_fn(|level| srgb_to_linear(level as f32)));

/// sRGB level from 0 to 255 to linear light in [0, 1].
pub fn srgb_to_linear(level: f32) -> f32 {
    let v = level / 255.0;
    if v <= 0.040_45 {
        v / 12.92
    } else {
        ((v + 0.055) / 1.055).powf(2.4)
    }
}

/// Linear light, clamped to [0, 1], to an sRGB level from 0 to 255; NaN is kept.
pub fn linear_to_srgb(linear: f32) -> f32 {
    let v = linear.clamp(0.0, 1.0);
    255.0
        * if v <= 0.003_130_8 {
            12.92 * v
        } else {
            1.055 * v.powf(1.0 / 2.4) - 0.055
        }
}

/// Linear light in [0, 1] to an 8-bit sRGB value; NaN becomes 0.
pub fn srgb_encode(linear: f32) -> u8 {
    linear_to_srgb(linear).round() as u8
}

/// 8-bit sRGB value to linear light in [0, 1].
#[inline]
pub fn srgb_decode(encoded: u8) -> f32 {
    LINEAR[usize::from(encoded)]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn values_round_trip() {
        for value in 0..=255u8 {
            assert_eq!(srgb_encode(srgb_decode(value)), value);
        }
        assert_eq!(srgb_encode(f32::NAN), 0);
        assert_eq!(srgb_encode(7.0), 255);
        // 18 % grey is 118 in sRGB.
        assert_eq!(srgb_encode(0.18), 118);
    }
}
