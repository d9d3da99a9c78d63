//! Initial estimates of intrinsics and poses from homographies.

use glam::{DMat3, DQuat, DVec2, DVec3};

use super::board_points::BoardPoint;
use crate::solve::homography::plane_to_image;
use gripcast_base::linear::NormalEquations;
use gripcast_geometry::Pose;
use gripcast_imaging::{DistortionModel, Intrinsics};

/// Range of focal lengths, relative to the longer image side.
const FOCAL_RANGE: std::ops::RangeInclusive<f64> = 0.1..=30.0;

/// Homography from the board's plane to pixels. None if the points do not span the plane.
pub(super) fn homography(points: &[BoardPoint]) -> Option<DMat3> {
    let plane: Vec<DVec2> = points.iter().map(|p| p.point_m.truncate()).collect();
    let pixels: Vec<DVec2> = points.iter().map(|p| p.pixel).collect();
    plane_to_image(&plane, &pixels)
}

/// Intrinsics without distortion, with the principal point at the image centre.
pub(super) fn plain_lens([width, height]: [u32; 2], fx: f64, fy: f64) -> Intrinsics {
    Intrinsics {
        width,
        height,
        fx,
        fy,
        cx: 0.5 * (f64::from(width) - 1.0),
        cy: 0.5 * (f64::from(height) - 1.0),
        model: DistortionModel::BrownConrady,
        coefficients: [0.0; 5],
    }
}

/// Intrinsics with a focal length of the longer image side: an angle of view of 53°.
pub(super) fn default_lens(size: [u32; 2]) -> Intrinsics {
    let side = f64::from(size[0].max(size[1]));
    plain_lens(size, side, side)
}

/// Candidate intrinsics from homographies: Z. Zhang, *A flexible new technique for camera
/// calibration*, 2000, §3.1, with the principal point fixed at the image centre. This leaves two
/// unknowns (one for square pixels) and is robust for few and noisy images. The last candidate is a
/// default.
pub(super) fn lenses(size: [u32; 2], homographies: &[DMat3]) -> Vec<Intrinsics> {
    let side = f64::from(size[0].max(size[1]));
    let center = plain_lens(size, 1.0, 1.0);
    let mut both = NormalEquations::<2>::zero();
    let mut one = NormalEquations::<1>::zero();
    for h in homographies {
        // Orthogonal axes of equal length, in pixels from the centre and relative to the side.
        let ray = |column: DVec3| {
            let x = (column.x - center.cx * column.z) / side;
            let y = (column.y - center.cy * column.z) / side;
            DVec3::new(x, y, column.z)
        };
        let (a, b) = (ray(h.x_axis), ray(h.y_axis));
        let scale = (a.length() * b.length()).recip();
        let products = a * b * scale;
        let squares = 0.5 * (a * a - b * b) * scale;
        for row in [products, squares] {
            both.add(&[row.x, row.y], -row.z, 1.0);
            one.add(&[row.x + row.y], -row.z, 1.0);
        }
    }
    let focal = |inverse_square: f64| {
        let focal = inverse_square.sqrt().recip();
        FOCAL_RANGE.contains(&focal).then_some(focal * side)
    };
    let mut candidates = Vec::new();
    if let Some([x, y]) = both.solve()
        && let (Some(fx), Some(fy)) = (focal(x), focal(y))
        && (0.7..1.4).contains(&(fx / fy))
    {
        candidates.push(plain_lens(size, fx, fy));
    }
    if let Some([x]) = one.solve()
        && let Some(f) = focal(x)
    {
        candidates.push(plain_lens(size, f, f));
    }
    candidates.push(default_lens(size));
    candidates
}

/// Pose of a plane from its homography to pixels, ignoring distortion. None if the homography shows
/// the plane's back.
pub(super) fn pose(lens: &Intrinsics, homography: &DMat3) -> Option<Pose> {
    let to_ideal = DMat3::from_cols(
        DVec3::new(lens.fx.recip(), 0.0, 0.0),
        DVec3::new(0.0, lens.fy.recip(), 0.0),
        DVec3::new(-lens.cx / lens.fx, -lens.cy / lens.fy, 1.0),
    );
    let h = to_ideal * *homography;
    let scale = (h.x_axis.length() * h.y_axis.length()).sqrt().recip();
    let h = h * (scale * h.z_axis.z.signum());
    // Orthogonalise the two axes symmetrically.
    let (sum, difference) = (
        (h.x_axis.normalize() + h.y_axis.normalize()).try_normalize()?,
        (h.x_axis.normalize() - h.y_axis.normalize()).try_normalize()?,
    );
    let x = (sum + difference).try_normalize()?;
    let y = (sum - difference).try_normalize()?;
    let z = x.cross(y);
    let is_front = z.dot(h.z_axis) < 0.0 && h.z_axis.is_finite();
    is_front.then(|| Pose::new(DQuat::from_mat3(&DMat3::from_cols(x, y, z)), h.z_axis))
}
