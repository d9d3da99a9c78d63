//! Height map of Taxim (Si & Yuan 2022, §III-B): gel around a contact as a pyramid of Gaussian
//! filters, each of which restores the object's shape in the deep contact.

use crate::gaussian::{Gaussian, Region};
use crate::press_depth::PressDepth;

/// Pixel size of Taxim's image of 640 × 480, m.
const PIXEL_M: f64 = 2.95e-5;
/// Standard deviations of the pyramid's filters in order, px of Taxim's image: the published
/// kernels of 201, 101, 51, 21, 11 and 5 pixels.
const PYRAMID_PX: [f64; 6] = [30.5, 15.5, 8.0, 3.5, 2.0, 1.1];
/// Standard deviation of the final filter of 5 pixels, px of Taxim's image.
const LAST_PX: f64 = 1.1;
/// The object's shape is restored where the press is deeper than this fraction of its maximum.
const KEPT_FRACTION: f64 = 0.4;

/// Returns the height of the face towards the camera, m.
pub(super) fn heights(press: &PressDepth) -> Vec<f32> {
    let grid = &press.geometry;
    let own_pixels = PIXEL_M / grid.pixel_m;
    let kept = (KEPT_FRACTION * press.deepest_m()) as f32;
    let mut heights = press.depth_m.clone();
    let Some(mut region) = Region::nonzero(&heights, grid.width) else {
        return heights;
    };
    for sigma in PYRAMID_PX {
        region = Gaussian::new(sigma * own_pixels).apply(&mut heights, grid.width, region);
        for (height, depth) in heights.iter_mut().zip(&press.depth_m) {
            if *depth > kept {
                *height = *depth;
            }
        }
    }
    Gaussian::new(LAST_PX * own_pixels).apply(&mut heights, grid.width, region);
    heights
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::press_depth::SensorGeometry;

    fn bump() -> PressDepth {
        let geometry = SensorGeometry {
            width: 80,
            height: 60,
            pixel_m: 6e-5,
            gel_thickness_m: 4e-3,
        };
        let depth = |i: usize| {
            let (x, y) = ((i % 80) as f32 - 40.0, (i / 80) as f32 - 30.0);
            if x * x + y * y < 144.0 { 1e-3 } else { 0.0 }
        };
        PressDepth {
            geometry,
            depth_m: (0..4800).map(depth).collect(),
        }
    }

    #[test]
    fn gel_rises_around_contact_and_keeps_its_depth() {
        let press = bump();
        let heights = heights(&press);
        let at = |x: usize, y: usize| heights[y * 80 + x];
        assert!((at(40, 30) - 1e-3).abs() < 1e-6, "{}", at(40, 30));
        let beside = [54, 58, 64, 72].map(|x| at(x, 30));
        assert!(beside.windows(2).all(|w| w[0] > w[1]), "{beside:?}");
        assert!(beside[0] > 1e-4 && beside[3] > 0.0);
        let untouched = PressDepth::untouched(press.geometry);
        assert_eq!(super::heights(&untouched), untouched.depth_m);
    }
}
