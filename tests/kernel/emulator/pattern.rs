//! Moving test images of the raw cameras. An image follows from its number alone, so that a
//! test can draw again what was sent, and holds that number: no two have the same bytes.

/// Ramps repeat after this many.
const DEPTH_PERIOD: usize = 256;
const LUMA_PERIOD: usize = 160;

/// Depth where a ramp begins, counts (mm).
const DEPTH_OFFSET: u16 = 400;
/// Luma where a ramp begins.
const LUMA_OFFSET: u8 = 40;
/// The image's number stands in this many pixels, lowest first, as digits to the base of the
/// ramp's period. Above the last it repeats: years at 30 fps.
const DIGITS: usize = 4;

/// `height` rows of `row_bytes`, row y being the ramp from `(y + number) % period` on; the first
/// row begins with the number's digits, each drawn as the ramp draws it.
fn sloping(
    ramp: &[u8],
    step_bytes: usize,
    period: usize,
    row_bytes: usize,
    height: u32,
    number: u64,
) -> Vec<u8> {
    let mut image = Vec::with_capacity(row_bytes * height as usize);
    for y in 0..u64::from(height) {
        let start = ((y + number) % period as u64) as usize * step_bytes;
        image.extend_from_slice(&ramp[start..start + row_bytes]);
    }
    let mut rest = number;
    for pixel in image.chunks_exact_mut(step_bytes).take(DIGITS) {
        let start = (rest % period as u64) as usize * step_bytes;
        pixel.copy_from_slice(&ramp[start..start + step_bytes]);
        rest /= period as u64;
    }
    image
}

/// The number that the first pixels of an image hold; any number for other pixels.
fn number_in(levels_above_offset: impl Iterator<Item = u16>, period: usize) -> u64 {
    let digits: Vec<u64> = levels_above_offset.take(DIGITS).map(u64::from).collect();
    let with_lower = |number: u64, digit: &u64| number * period as u64 + digit;
    digits.iter().rev().fold(0, with_lower)
}

/// The number of an image of [`depth`].
pub(crate) fn depth_number(image: &[u8]) -> u64 {
    let pixels = image.as_chunks().0.iter();
    let levels = pixels.map(|pixel| u16::from_le_bytes(*pixel).wrapping_sub(DEPTH_OFFSET));
    number_in(levels, DEPTH_PERIOD)
}

/// The number of an image of [`colour`].
pub(crate) fn colour_number(image: &[u8]) -> u64 {
    let lumas = image.iter().step_by(4);
    number_in(
        lumas.map(|luma| u16::from(luma.wrapping_sub(LUMA_OFFSET))),
        LUMA_PERIOD,
    )
}

/// Image `number` in Z16, tightly packed little-endian: pixel (x, y) holds
/// `DEPTH_OFFSET + (x + y + number) % DEPTH_PERIOD`, the first ones the number's digits.
pub(crate) fn depth(number: u64, width: u32, height: u32) -> Vec<u8> {
    let ramp: Vec<u8> = (0..width as usize + DEPTH_PERIOD)
        .flat_map(|k| (DEPTH_OFFSET + (k % DEPTH_PERIOD) as u16).to_le_bytes())
        .collect();
    sloping(&ramp, 2, DEPTH_PERIOD, width as usize * 2, height, number)
}

/// Image `number` in YUYV: pixel pair (i, y) has luma `40 + (i + y + number) % 160` and one
/// colour; the first pairs hold the number's digits.
pub(crate) fn colour(number: u64, width: u32, height: u32) -> Vec<u8> {
    let ramp: Vec<u8> = (0..width as usize / 2 + LUMA_PERIOD)
        .flat_map(|k| {
            let luma = LUMA_OFFSET + (k % LUMA_PERIOD) as u8;
            [luma, 118, luma, 140]
        })
        .collect();
    sloping(&ramp, 4, LUMA_PERIOD, width as usize * 2, height, number)
}

/// Image `number` in 8-bit grey: pixel (x, y) holds `40 + (x + y + number) % 160`, the first
/// ones the number's digits.
pub(crate) fn grey(number: u64, width: u32, height: u32) -> Vec<u8> {
    let ramp: Vec<u8> = (0..width as usize + LUMA_PERIOD)
        .map(|k| LUMA_OFFSET + (k % LUMA_PERIOD) as u8)
        .collect();
    sloping(&ramp, 1, LUMA_PERIOD, width as usize, height, number)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pixels_follow_the_stated_formulas() {
        let image = depth(300, 64, 8);
        assert_eq!(image.len(), 64 * 8 * 2);
        let at = |x: usize, y: usize| {
            let k = (y * 64 + x) * 2;
            u16::from_le_bytes([image[k], image[k + 1]])
        };
        assert_eq!(at(0, 0), 400 + 300 % 256);
        assert_eq!(at(10, 7), 400 + 317 % 256);

        let image = colour(159, 64, 8);
        assert_eq!(image[..8], [199, 118, 199, 140, 40, 118, 40, 140]);
        assert_eq!(image[16..20], [43, 118, 43, 140]);
        assert_eq!(grey(2, 16, 2)[16], 43);
    }

    #[test]
    fn images_hold_their_numbers() {
        for number in [0, 1, 159, 160, 256, 25_600, 65_536, 108_123] {
            assert_eq!(depth_number(&depth(number, 32, 4)), number);
            assert_eq!(colour_number(&colour(number, 32, 4)), number);
        }
        assert_ne!(grey(7, 32, 4), grey(167, 32, 4));
    }

    #[test]
    fn neighbouring_images_differ() {
        assert_ne!(depth(1, 32, 4), depth(2, 32, 4));
        assert_ne!(colour(1, 32, 4), colour(2, 32, 4));
        assert_ne!(grey(1, 32, 4), grey(2, 32, 4));
    }
}
