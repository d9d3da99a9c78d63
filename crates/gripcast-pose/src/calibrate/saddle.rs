//! Corner refinement of inner chessboard corners, which are saddle points of the image.

use glam::{DMat2, DVec2};
use image::GrayImage;

use crate::refine::bilinear;
use gripcast_imaging::srgb_decode;

/// Range of window radii, px: smaller ones have too few pixels, larger ones are affected by
/// distortion.
const RADIUS_PX: [f64; 2] = [2.2, 8.0];
/// Margin between the window and the next marker for blur and derivative, px.
const MARGIN_PX: f64 = 2.0;
const MAX_STEPS: usize = 12;
/// Convergence tolerance, px.
const TOLERANCE_PX: f64 = 0.002;
/// Maximum distance from the prediction, in radii and px.
const MAX_DISTANCE: (f64, f64) = (0.6, 3.0);
/// Minimum ratio of the eigenvalues of the structure tensor; below, the window shows an edge.
const MIN_RATIO: f64 = 0.05;
/// Minimum difference between the white and black squares at a corner, linear intensity 0 to 1.
const MIN_CONTRAST: f64 = 0.02;

/// Prediction of a corner and its surroundings.
pub(super) struct ExpectedSaddle {
    /// Predicted corner, px.
    pub(super) pixel: DVec2,
    /// Points in the two adjacent white squares, near the corner and off the markers, px.
    pub(super) white: [DVec2; 2],
    /// The same in the two black squares.
    pub(super) black: [DVec2; 2],
    /// Distance to the nearest marker, px.
    pub(super) free_px: f64,
}

/// Refines a saddle point near the prediction. None if the image shows none or markers are too
/// near.
///
/// At the corner, every gradient in the window is perpendicular to the line to the corner (W.
/// Förstner and E. Gülch, *A fast operator for detection and precise location of distinct points*,
/// 1987). The window is round, follows the corner and ends before the markers; since a corner has
/// 180° rotational symmetry, blur and window do not bias it.
pub(super) fn refine_saddle(image: &GrayImage, expected: &ExpectedSaddle) -> Option<DVec2> {
    let room = expected.free_px - MARGIN_PX;
    // False for NaN.
    let has_room = room >= RADIUS_PX[0];
    if !has_room {
        return None;
    }
    let radius = room.min(RADIUS_PX[1]);
    let mut at = expected.pixel;
    for _ in 0..MAX_STEPS {
        let next = step(image, at, radius)?;
        let moved = next.distance(at);
        at = next;
        let is_near = at.distance(expected.pixel) <= (MAX_DISTANCE.0 * radius).min(MAX_DISTANCE.1);
        if !is_near {
            return None;
        }
        if moved < TOLERANCE_PX {
            break;
        }
    }
    is_saddle(image, expected, at - expected.pixel).then_some(at)
}

/// Whether the adjacent squares of a corner, shifted by `off`, are black and white.
fn is_saddle(image: &GrayImage, expected: &ExpectedSaddle, off: DVec2) -> bool {
    let intensity = |p: DVec2| bilinear(image, p + off);
    let ([Some(a), Some(b)], [Some(c), Some(d)]) =
        (expected.white.map(intensity), expected.black.map(intensity))
    else {
        return false;
    };
    a.min(b) - c.max(d) >= MIN_CONTRAST
}

/// Solves Σ w g gᵀ (p − corner) = 0 over the pixels around `centre`. Gradients are evaluated at
/// pixels and only the weights follow the centre: interpolated gradients would bias the result by
/// the sub-pixel position.
fn step(image: &GrayImage, centre: DVec2, radius: f64) -> Option<DVec2> {
    let (low, high) = ((centre - radius).ceil(), (centre + radius).floor());
    let is_inside = low.cmpge(DVec2::ONE).all()
        && high.x <= f64::from(image.width()) - 2.0
        && high.y <= f64::from(image.height()) - 2.0;
    if !is_inside {
        return None;
    }
    let mut structure = DMat2::ZERO;
    let mut moment = DVec2::ZERO;
    for y in low.y as usize..=high.y as usize {
        for x in low.x as usize..=high.x as usize {
            let off = DVec2::new(x as f64, y as f64) - centre;
            let near = (1.0 - off.length_squared() / (radius * radius)).max(0.0);
            let slope = gradient(image, x, y);
            let weighted = DMat2::from_cols(slope * slope.x, slope * slope.y) * (near * near);
            structure += weighted;
            moment += weighted * off;
        }
    }
    let (trace, determinant) = (
        structure.x_axis.x + structure.y_axis.y,
        structure.determinant(),
    );
    // Eigenvalues a ≥ b have b/a ≈ determinant/trace² where b is small.
    let is_corner = determinant > MIN_RATIO * trace * trace;
    is_corner.then(|| centre + structure.inverse() * moment)
}

/// Scharr derivatives at an inner pixel (H. Scharr, *Optimal operators in digital image
/// processing*, 2000), linear intensity per px: sRGB levels would shift edges to their dark side.
fn gradient(image: &GrayImage, x: usize, y: usize) -> DVec2 {
    const WEIGHTS: [f64; 3] = [3.0 / 32.0, 10.0 / 32.0, 3.0 / 32.0];
    let (pixels, width) = (image.as_raw(), image.width() as usize);
    let pixel = |x: usize, y: usize| f64::from(srgb_decode(pixels[y * width + x]));
    let mut slope = DVec2::ZERO;
    for (k, weight) in WEIGHTS.iter().enumerate() {
        slope.x += weight * (pixel(x + 1, y + k - 1) - pixel(x - 1, y + k - 1));
        slope.y += weight * (pixel(x + k - 1, y + 1) - pixel(x + k - 1, y - 1));
    }
    slope
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A blurred corner at `at` between squares whose edges run at two angles, rad.
    fn image(at: DVec2, angles: [f64; 2]) -> GrayImage {
        let side = |p: DVec2, angle: f64| {
            let distance = DVec2::from_angle(angle).perp_dot(p - at);
            // Close to the error function, for a blur of 0.8 px.
            (distance / 0.8 * 1.2).tanh()
        };
        GrayImage::from_fn(40, 40, |x, y| {
            let p = DVec2::new(f64::from(x), f64::from(y));
            let value = side(p, angles[0]) * side(p, angles[1]);
            image::Luma([gripcast_imaging::srgb_encode((0.4 + 0.35 * value) as f32)])
        })
    }

    fn expected(at: DVec2, angles: [f64; 2], free_px: f64) -> ExpectedSaddle {
        let bisector = 0.5 * (angles[0] + angles[1]);
        let across = [0.0, 1.0].map(|k| DVec2::from_angle(bisector + std::f64::consts::PI * k));
        let along = across.map(DVec2::perp);
        ExpectedSaddle {
            pixel: at,
            black: across.map(|d| at + 5.0 * d),
            white: along.map(|d| at + 5.0 * d),
            free_px,
        }
    }

    #[test]
    fn saddles_are_accurate_to_hundredths_of_a_pixel() {
        for (k, (x, y)) in [(20.0, 20.0), (19.3, 20.6), (20.45, 19.55)]
            .iter()
            .enumerate()
        {
            let truth = DVec2::new(*x, *y);
            let angles = [0.3 * k as f64, 1.3 + 0.2 * k as f64];
            let image = image(truth, angles);
            for off in [DVec2::ZERO, DVec2::new(0.9, -0.7), DVec2::new(-1.1, 0.2)] {
                let expected = expected(truth + off, angles, 8.0);
                let found = refine_saddle(&image, &expected).unwrap();
                assert!(found.distance(truth) < 0.03, "{k} {off} {}", found - truth);
            }
        }
    }

    #[test]
    fn refine_saddle_refuses_other_structures() {
        let (at, angles) = (DVec2::splat(20.2), [0.2, 1.6]);
        let saddle = image(at, angles);
        assert!(refine_saddle(&saddle, &expected(at, angles, 8.0)).is_some());
        // No room before the markers.
        assert!(refine_saddle(&saddle, &expected(at, angles, 3.0)).is_none());
        assert!(refine_saddle(&saddle, &expected(at, angles, f64::NAN)).is_none());
        // Black and white exchanged.
        let mut swapped = expected(at, angles, 8.0);
        std::mem::swap(&mut swapped.black, &mut swapped.white);
        assert!(refine_saddle(&saddle, &swapped).is_none());
        // Too far away, at the border, nothing there.
        let far = at + DVec2::new(3.5, 0.0);
        assert!(refine_saddle(&saddle, &expected(far, angles, 8.0)).is_none());
        let corner = DVec2::splat(1.0);
        assert!(refine_saddle(&saddle, &expected(corner, angles, 8.0)).is_none());
        let flat = GrayImage::from_pixel(40, 40, image::Luma([90]));
        assert!(refine_saddle(&flat, &expected(at, angles, 8.0)).is_none());
        // The corner of one square.
        let single = GrayImage::from_fn(40, 40, |x, y| {
            image::Luma([if x > 20 && y > 20 { 30 } else { 200 }])
        });
        let straight = [0.0, std::f64::consts::FRAC_PI_2];
        assert!(refine_saddle(&single, &expected(at, straight, 8.0)).is_none());
    }
}
