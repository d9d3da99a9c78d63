//! Camera projection, its derivatives and undistortion.

use glam::{DMat2, DVec2, DVec3};

use gripcast_imaging::{DistortionModel, Intrinsics};

/// Maximum number of Newton steps; any usable lens needs fewer.
const MAX_STEPS: usize = 30;
/// Convergence tolerance of Newton's method in normalised coordinates; far below 1e-6 px.
const TOLERANCE: f64 = 1e-12;
/// Minimum depth of a point in front of the camera, m.
const MIN_DEPTH_M: f64 = 1e-6;

/// Projects a point in the camera frame (m) to a pixel. None behind the camera or where the
/// distortion model folds over.
pub fn project(intrinsics: &Intrinsics, point_m: DVec3) -> Option<DVec2> {
    project_with_jacobian(intrinsics, point_m).map(|(pixel, _)| pixel)
}

/// Like [`project`], with the rows of the Jacobian: d x / d point and d y / d point, px/m.
pub fn project_with_jacobian(
    intrinsics: &Intrinsics,
    point_m: DVec3,
) -> Option<(DVec2, [DVec3; 2])> {
    if !(point_m.is_finite() && point_m.z > MIN_DEPTH_M) {
        return None;
    }
    let inverse_z = point_m.z.recip();
    let ideal = point_m.truncate() * inverse_z;
    let (distorted, d_distorted) = distort(intrinsics, ideal)?;
    let focal = DVec2::new(intrinsics.fx, intrinsics.fy);
    let pixel = focal * distorted + DVec2::new(intrinsics.cx, intrinsics.cy);
    let d_ideal_x = DVec3::new(inverse_z, 0.0, -ideal.x * inverse_z);
    let d_ideal_y = DVec3::new(0.0, inverse_z, -ideal.y * inverse_z);
    let row = |focal: f64, i: usize| {
        focal * (d_distorted.col(0)[i] * d_ideal_x + d_distorted.col(1)[i] * d_ideal_y)
    };
    Some((pixel, [row(focal.x, 0), row(focal.y, 1)]))
}

/// Derivatives of [`project`]'s x and y with respect to fx, fy, cx, cy, k1, k2, p1, p2, k3 of the
/// Brown–Conrady model, at a point that projects.
pub(super) fn intrinsics_jacobian(intrinsics: &Intrinsics, point_m: DVec3) -> [[f64; 9]; 2] {
    let at = point_m.truncate() / point_m.z;
    let (distorted, _) = polynomial(&intrinsics.coefficients, at);
    let (fx, fy) = (intrinsics.fx, intrinsics.fy);
    let (x, y) = (at.x, at.y);
    let r2 = x * x + y * y;
    let (xy, xx, yy) = (2.0 * x * y, r2 + 2.0 * x * x, r2 + 2.0 * y * y);
    let radial = [r2, r2 * r2, r2 * r2 * r2];
    let [a, b, c] = radial.map(|r| fx * x * r);
    let [d, e, f] = radial.map(|r| fy * y * r);
    [
        [distorted.x, 0.0, 1.0, 0.0, a, b, fx * xy, fx * xx, c],
        [0.0, distorted.y, 0.0, 1.0, d, e, fy * yy, fy * xy, f],
    ]
}

/// Normalised coordinates (x/z, y/z) of a pixel. None if the distortion cannot be inverted there.
pub fn undistort(intrinsics: &Intrinsics, pixel: DVec2) -> Option<DVec2> {
    let focal = DVec2::new(intrinsics.fx, intrinsics.fy);
    let distorted = (pixel - DVec2::new(intrinsics.cx, intrinsics.cy)) / focal;
    match intrinsics.model {
        DistortionModel::None => Some(distorted),
        DistortionModel::BrownConrady => invert(&intrinsics.coefficients, distorted),
        DistortionModel::InverseBrownConrady => {
            Some(polynomial(&intrinsics.coefficients, distorted).0)
        }
    }
    .filter(|ideal| ideal.is_finite())
}

/// Distorts normalised coordinates; returns the derivative as well.
fn distort(intrinsics: &Intrinsics, ideal: DVec2) -> Option<(DVec2, DMat2)> {
    let k = &intrinsics.coefficients;
    match intrinsics.model {
        DistortionModel::None => Some((ideal, DMat2::IDENTITY)),
        DistortionModel::BrownConrady => {
            let (distorted, derivative) = polynomial(k, ideal);
            // Beyond the fold, distant points would be mapped back into the image.
            let unfolded = derivative.determinant() > 0.0 && derivative.col(0).x > 0.0;
            unfolded.then_some((distorted, derivative))
        }
        DistortionModel::InverseBrownConrady => {
            let distorted = invert(k, ideal)?;
            let (_, derivative) = polynomial(k, distorted);
            Some((distorted, derivative.inverse()))
        }
    }
}

/// Brown–Conrady polynomial (D. C. Brown, *Close-range camera calibration*, 1971; coefficients in
/// OpenCV's order k1, k2, p1, p2, k3) and its derivative.
fn polynomial(k: &[f64; 5], at: DVec2) -> (DVec2, DMat2) {
    let [k1, k2, p1, p2, k3] = *k;
    let (x, y) = (at.x, at.y);
    let r2 = x * x + y * y;
    let radial = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3));
    let d_radial = k1 + r2 * (2.0 * k2 + r2 * 3.0 * k3);
    let value = DVec2::new(
        x * radial + 2.0 * p1 * x * y + p2 * (r2 + 2.0 * x * x),
        y * radial + p1 * (r2 + 2.0 * y * y) + 2.0 * p2 * x * y,
    );
    let mixed = 2.0 * x * y * d_radial + 2.0 * p1 * x + 2.0 * p2 * y;
    let derivative = DMat2::from_cols(
        DVec2::new(
            radial + 2.0 * x * x * d_radial + 2.0 * p1 * y + 6.0 * p2 * x,
            mixed,
        ),
        DVec2::new(
            mixed,
            radial + 2.0 * y * y * d_radial + 6.0 * p1 * y + 2.0 * p2 * x,
        ),
    );
    (value, derivative)
}

/// Inverts the polynomial by Newton's method, starting from `target`.
fn invert(k: &[f64; 5], target: DVec2) -> Option<DVec2> {
    let mut at = target;
    for _ in 0..MAX_STEPS {
        let (value, derivative) = polynomial(k, at);
        if !(derivative.determinant() > 0.0 && derivative.col(0).x > 0.0) {
            return None;
        }
        let step = derivative.inverse() * (target - value);
        at += step;
        if !at.is_finite() {
            return None;
        }
        if step.length() < TOLERANCE {
            return Some(at);
        }
    }
    None
}

#[cfg(test)]
mod tests {
    use super::*;

    fn lens(model: DistortionModel) -> Intrinsics {
        Intrinsics {
            width: 1280,
            height: 720,
            fx: 915.0,
            fy: 911.0,
            cx: 642.8,
            cy: 357.4,
            model,
            coefficients: [0.12, -0.25, 0.0007, -0.0004, 0.08],
        }
    }

    const MODELS: [DistortionModel; 3] = [
        DistortionModel::None,
        DistortionModel::BrownConrady,
        DistortionModel::InverseBrownConrady,
    ];

    #[test]
    fn point_jacobian_matches_finite_differences() {
        for model in MODELS {
            let lens = lens(model);
            for point in [
                DVec3::new(0.02, -0.03, 0.5),
                DVec3::new(-0.3, 0.15, 0.6),
                DVec3::new(0.25, 0.2, 0.8),
            ] {
                let (_, rows) = project_with_jacobian(&lens, point).unwrap();
                for axis in 0..3 {
                    let mut step = DVec3::ZERO;
                    step[axis] = 1e-6;
                    let difference = (project(&lens, point + step).unwrap()
                        - project(&lens, point - step).unwrap())
                        / 2e-6;
                    let ours = DVec2::new(rows[0][axis], rows[1][axis]);
                    assert!(
                        ours.distance(difference) < 1e-4,
                        "{model:?} {axis}: {ours} {difference}"
                    );
                }
            }
        }
    }

    #[test]
    fn intrinsics_jacobian_matches_finite_differences() {
        let lens = lens(DistortionModel::BrownConrady);
        let point = DVec3::new(-0.3, 0.15, 0.6);
        let rows = intrinsics_jacobian(&lens, point);
        let moved = |which: usize, by: f64| {
            let mut lens = lens;
            match which {
                0 => lens.fx += by,
                1 => lens.fy += by,
                2 => lens.cx += by,
                3 => lens.cy += by,
                k => lens.coefficients[k - 4] += by,
            }
            project(&lens, point).unwrap()
        };
        for (which, by_x) in rows[0].iter().enumerate() {
            let h = 1e-6;
            let difference = (moved(which, h) - moved(which, -h)) / (2.0 * h);
            let ours = DVec2::new(*by_x, rows[1][which]);
            assert!(
                ours.distance(difference) < 1e-4,
                "{which}: {ours} {difference}"
            );
        }
    }

    #[test]
    fn undistort_inverts_project() {
        for model in MODELS {
            let lens = lens(model);
            for (x, y) in [(0.0, 0.0), (1279.0, 719.0), (640.0, 3.0), (100.0, 600.0)] {
                let pixel = DVec2::new(x, y);
                let ideal = undistort(&lens, pixel).unwrap();
                let back = project(&lens, ideal.extend(1.0) * 0.7).unwrap();
                assert!(back.distance(pixel) < 1e-8, "{model:?} {pixel} {back}");
            }
        }
    }

    #[test]
    fn inverse_model_distorts_in_opposite_direction() {
        let point = DVec3::new(0.3, 0.1, 0.6);
        let x = |model| project(&lens(model), point).unwrap().x;
        assert!(x(DistortionModel::BrownConrady) > x(DistortionModel::None) + 1.0);
        assert!(x(DistortionModel::InverseBrownConrady) < x(DistortionModel::None) - 1.0);
        // k1 r² of the ideal coordinates, by hand.
        let mut mild = lens(DistortionModel::BrownConrady);
        mild.coefficients = [0.1, 0.0, 0.0, 0.0, 0.0];
        let expected = 642.8 + 915.0 * 0.5 * (1.0 + 0.1 * (0.25 + 1.0 / 36.0));
        assert!((project(&mild, point).unwrap().x - expected).abs() < 1e-9);
    }

    #[test]
    fn project_refuses_points_outside_the_model() {
        let plain = lens(DistortionModel::None);
        for point in [
            DVec3::new(0.0, 0.0, 0.0),
            DVec3::new(0.0, 0.0, -1.0),
            DVec3::new(f64::NAN, 0.0, 1.0),
        ] {
            assert_eq!(project(&plain, point), None);
        }
        let mut folding = lens(DistortionModel::BrownConrady);
        folding.coefficients = [-0.5, 0.0, 0.0, 0.0, 0.0];
        assert_eq!(project(&folding, DVec3::new(2.0, 0.0, 1.0)), None);
        assert_eq!(undistort(&folding, DVec2::new(2000.0, 357.0)), None);
    }
}
