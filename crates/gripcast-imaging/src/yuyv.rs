//! YUYV to RGB.

/// Converts packed 4:2:2 (Y0 U Y1 V, BT.601, limited range) to RGB.
///
/// `yuyv` has 4 bytes and `rgb` 6 bytes per pair of pixels; excess bytes are ignored. Both pixels
/// of a pair have its chroma.
pub(super) fn yuyv_to_rgb(yuyv: &[u8], rgb: &mut [u8]) {
    for (pair, out) in yuyv.chunks_exact(4).zip(rgb.chunks_exact_mut(6)) {
        let u = i32::from(pair[1]) - 128;
        let v = i32::from(pair[3]) - 128;
        // BT.601 coefficients × 256; the 128 rounds.
        let red = 409 * v + 128;
        let green = -100 * u - 208 * v + 128;
        let blue = 516 * u + 128;
        for (luma, pixel) in [pair[0], pair[2]].into_iter().zip(out.chunks_exact_mut(3)) {
            let y = 298 * (i32::from(luma) - 16);
            pixel[0] = ((y + red) >> 8).clamp(0, 255) as u8;
            pixel[1] = ((y + green) >> 8).clamp(0, 255) as u8;
            pixel[2] = ((y + blue) >> 8).clamp(0, 255) as u8;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn colour_bars_of_bt601() {
        // (Y, U, V) and RGB of the 100 % bars.
        for (yuv, rgb) in [
            ([235, 128, 128], [255, 255, 255]),
            ([16, 128, 128], [0, 0, 0]),
            ([81, 90, 240], [255, 0, 0]),
            ([145, 54, 34], [0, 255, 0]),
            ([41, 240, 110], [0, 0, 255]),
            ([210, 16, 146], [255, 255, 0]),
        ] {
            let [y, u, v] = yuv;
            let mut out = [0; 6];
            yuyv_to_rgb(&[y, u, y, v], &mut out);
            for (found, expected) in out.iter().zip(rgb.iter().cycle()) {
                assert!(found.abs_diff(*expected) <= 1, "{yuv:?}: {out:?}");
            }
        }
    }

    #[test]
    fn pixels_of_a_pair_have_their_own_luma() {
        let mut out = [0; 6];
        yuyv_to_rgb(&[16, 128, 235, 128], &mut out);
        assert_eq!(out, [0, 0, 0, 255, 255, 255]);
    }

    #[test]
    fn matches_the_formula() {
        for y in [0u8, 15, 16, 128, 240, 255] {
            for u in [0u8, 16, 128, 240, 255] {
                for v in [0u8, 16, 128, 240, 255] {
                    let mut out = [0; 6];
                    yuyv_to_rgb(&[y, u, y, v], &mut out);
                    let (l, b, r) = (
                        (f64::from(y) - 16.0) * 255.0 / 219.0,
                        (f64::from(u) - 128.0) * 255.0 / 224.0,
                        (f64::from(v) - 128.0) * 255.0 / 224.0,
                    );
                    let expected = [
                        l + 1.402 * r,
                        l - 0.344_136 * b - 0.714_136 * r,
                        l + 1.772 * b,
                    ];
                    for (found, expected) in out.iter().zip(expected) {
                        let expected = expected.clamp(0.0, 255.0);
                        assert!((f64::from(*found) - expected).abs() <= 1.5);
                    }
                }
            }
        }
    }
}
