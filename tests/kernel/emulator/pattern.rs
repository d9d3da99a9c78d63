//! Moving test pictures of the raw cameras. A picture follows from its number alone, so that a
//! test can draw again what was sent.

/// Pictures repeat after this many.
const DEPTH_PERIOD: usize = 256;
const LUMA_PERIOD: usize = 160;

/// Depth of the first pixel of picture 0, counts (mm).
pub(crate) const DEPTH_OFFSET: u16 = 400;
/// Luma of the first pixel of picture 0.
pub(crate) const LUMA_OFFSET: u8 = 40;

/// `height` rows of `row_bytes`, row y being the ramp from `(y + number) % period` on.
fn sloping(
    ramp: &[u8],
    step_bytes: usize,
    period: usize,
    row_bytes: usize,
    height: u32,
    number: u64,
) -> Vec<u8> {
    let mut picture = Vec::with_capacity(row_bytes * height as usize);
    for y in 0..u64::from(height) {
        let start = ((y + number) % period as u64) as usize * step_bytes;
        picture.extend_from_slice(&ramp[start..start + row_bytes]);
    }
    picture
}

/// Picture `number` in Z16, tightly packed little-endian: pixel (x, y) holds
/// `DEPTH_OFFSET + (x + y + number) % DEPTH_PERIOD`.
pub(crate) fn depth(number: u64, width: u32, height: u32) -> Vec<u8> {
    let ramp: Vec<u8> = (0..width as usize + DEPTH_PERIOD)
        .flat_map(|k| (DEPTH_OFFSET + (k % DEPTH_PERIOD) as u16).to_le_bytes())
        .collect();
    sloping(&ramp, 2, DEPTH_PERIOD, width as usize * 2, height, number)
}

/// Picture `number` in YUYV: pixel pair (i, y) has luma `40 + (i + y + number) % 160` and one
/// colour.
pub(crate) fn colour(number: u64, width: u32, height: u32) -> Vec<u8> {
    let ramp: Vec<u8> = (0..width as usize / 2 + LUMA_PERIOD)
        .flat_map(|k| {
            let luma = LUMA_OFFSET + (k % LUMA_PERIOD) as u8;
            [luma, 118, luma, 140]
        })
        .collect();
    sloping(&ramp, 4, LUMA_PERIOD, width as usize * 2, height, number)
}

/// Picture `number` in 8-bit grey: pixel (x, y) holds `40 + (x + y + number) % 160`.
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
        let picture = depth(300, 64, 8);
        assert_eq!(picture.len(), 64 * 8 * 2);
        let at = |x: usize, y: usize| {
            let k = (y * 64 + x) * 2;
            u16::from_le_bytes([picture[k], picture[k + 1]])
        };
        assert_eq!(at(0, 0), 400 + 300 % 256);
        assert_eq!(at(10, 7), 400 + 317 % 256);

        let picture = colour(159, 64, 8);
        assert_eq!(picture[..8], [199, 118, 199, 140, 40, 118, 40, 140]);
        assert_eq!(grey(2, 16, 2)[16], 43);
    }

    #[test]
    fn neighbouring_pictures_differ() {
        assert_ne!(depth(1, 32, 4), depth(2, 32, 4));
        assert_ne!(colour(1, 32, 4), colour(2, 32, 4));
        assert_ne!(grey(1, 32, 4), grey(2, 32, 4));
    }
}
