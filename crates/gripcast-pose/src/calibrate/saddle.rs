//! Inner corners of a chessboard: saddle points of the image.

use glam::{DMat2, DVec2};
use image::GrayImage;

use gripcast_imaging::srgb_decode;

/// Radii of windows that are used, px: a smaller one has too few pixels, a larger one gains
/// nothing and bends with the lens.
const RADIUS_PX: [f64; 2] = [2.2, 8.0];
/// Reach of blur and of the derivative, kept between the window and the next marker, px.
const REACH_PX: f64 = 2.0;
const MAX_STEPS: usize = 12;
/// Steps below this have arrived, px.
const ARRIVED_PX: f64 = 0.002;
/// Farthest way from the prediction, in radii and px.
const MAX: (f64, f64) = (0.6, 3.0);
/// Ratio of the structure's eigenvalues below which there is one edge and no corner.
const MIN_RATIO: f64 = 0.05;
/// Least difference between the white and the black squares beside a corner, light from 0 to 1.
const MIN_CONTRAST: f64 = 0.02;

/// Where a corner should be, and what is around it.
pub(super) struct ExpectedSaddle {
    /// The corner, px.
    pub(super) at: DVec2,
    /// Places in the two white squares beside it, near the corner and off the markers, px.
    pub(super) white: [DVec2; 2],
    /// Such places in the two black squares.
    pub(super) black: [DVec2; 2],
    /// Distance to the nearest marker, px.
    pub(super) free_px: f64,
}

/// The saddle point near the expected place; none where the image has none, or where markers are
/// so near that they would draw it to their side.
///
/// At the corner, every gradient of the window is perpendicular to the line to the corner (W.
/// Förstner and E. Gülch, *A fast operator for detection and precise location of distinct points*,
/// 1987). The window is round, moves with the corner and ends before the markers: a corner looks
/// the same turned by 180°, so that blur and window do not bias it.
pub(super) fn refine_saddle(image: &GrayImage, expected: &ExpectedSaddle) -> Option<DVec2> {
    let room = expected.free_px - REACH_PX;
    // Written so that NaN is refused as well.
    let has_room = room >= RADIUS_PX[0];
    if !has_room {
        return None;
    }
    let radius = room.min(RADIUS_PX[1]);
    let mut at = expected.at;
    for _ in 0..MAX_STEPS {
        let next = step(image, at, radius)?;
        let moved = next.distance(at);
        at = next;
        let is_near = at.distance(expected.at) <= (MAX.0 * radius).min(MAX.1);
        if !is_near {
            return None;
        }
        if moved < ARRIVED_PX {
            break;
        }
    }
    is_saddle(image, expected, at - expected.at).then_some(at)
}

/// Whether the squares beside a corner that is `off` the prediction are black and white.
fn is_saddle(image: &GrayImage, expected: &ExpectedSaddle, off: DVec2) -> bool {
    let levels = |places: [DVec2; 2]| places.map(|p| level(image, p + off));
    let ([Some(a), Some(b)], [Some(c), Some(d)]) = (levels(expected.white), levels(expected.black))
    else {
        return false;
    };
    a.min(b) - c.max(d) >= MIN_CONTRAST
}

/// One solution of Σ w g gᵀ (p − corner) = 0 over the pixels around `centre`. Gradients are taken at
/// pixels and only the weights move with the centre: values between pixels would bring a bias that
/// depends on where between them the corner is.
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
            let part = DMat2::from_cols(slope * slope.x, slope * slope.y) * (near * near);
            structure += part;
            moment += part * off;
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

/// Scharr's derivatives at a pixel that is not at the border (H. Scharr, *Optimal operators in
/// digital image processing*, 2000), light/px: levels would put edges on their dark side.
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

/// Light between pixels; none at the image's border.
fn level(image: &GrayImage, at: DVec2) -> Option<f64> {
    let (width, height) = (image.width() as usize, image.height() as usize);
    let inside =
        at.x >= 0.0 && at.y >= 0.0 && at.x < width as f64 - 1.0 && at.y < height as f64 - 1.0;
    if !inside {
        return None;
    }
    let (x, y) = (at.x as usize, at.y as usize);
    let (fx, fy) = (at.x - x as f64, at.y - y as f64);
    let pixels = image.as_raw();
    let pixel = |x: usize, y: usize| f64::from(srgb_decode(pixels[y * width + x]));
    let top = pixel(x, y) * (1.0 - fx) + pixel(x + 1, y) * fx;
    let bottom = pixel(x, y + 1) * (1.0 - fx) + pixel(x + 1, y + 1) * fx;
    Some(top * (1.0 - fy) + bottom * fy)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A corner at `at` between squares whose edges run at two angles, rad, blurred.
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
        let middle = 0.5 * (angles[0] + angles[1]);
        let across = [0.0, 1.0].map(|k| DVec2::from_angle(middle + std::f64::consts::PI * k));
        let along = across.map(DVec2::perp);
        ExpectedSaddle {
            at,
            black: across.map(|d| at + 5.0 * d),
            white: along.map(|d| at + 5.0 * d),
            free_px,
        }
    }

    #[test]
    fn saddles_are_found_to_hundredths_of_a_pixel() {
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
    fn what_is_no_saddle_is_refused() {
        let (at, angles) = (DVec2::splat(20.2), [0.2, 1.6]);
        let saddle = image(at, angles);
        assert!(refine_saddle(&saddle, &expected(at, angles, 8.0)).is_some());
        // No room before the markers.
        assert!(refine_saddle(&saddle, &expected(at, angles, 3.0)).is_none());
        assert!(refine_saddle(&saddle, &expected(at, angles, f64::NAN)).is_none());
        // Black and white exchanged.
        let mut turned = expected(at, angles, 8.0);
        std::mem::swap(&mut turned.black, &mut turned.white);
        assert!(refine_saddle(&saddle, &turned).is_none());
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
