//! Camera intrinsics from several views of a board.

use glam::{DVec2, DVec3};

use super::board_points::BoardPoint;
use super::bundle::{Bundle, BundleFit, Fitted, LENS, error_px, minimise};
use super::start::{homography, lenses, pose};
use crate::camera::intrinsics_jacobian;
use crate::least_squares::rms;
use gripcast_base::error::{Error, Result};
use gripcast_base::statistics::median;
use gripcast_geometry::Pose;
use gripcast_imaging::Intrinsics;

/// Names of the intrinsics, in the order of all parameter arrays.
pub const PARAMETERS: [&str; LENS] = ["fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2", "k3"];

/// Minimum number of views.
const MIN_VIEWS: usize = 3;
/// Huber loss of the initial fits, px.
const ROUGH_LOSS_PX: f64 = 3.0;
/// Minimum Huber loss of the final fit, px.
const MIN_LOSS_PX: f64 = 0.1;
/// Huber loss of the final fit, times the median residual.
const LOSS_OF_MEDIAN: f64 = 2.0;
/// A point is an outlier beyond this many median residuals, and this, px. The median residual of
/// Gaussian noise is 1.18 standard deviations.
const POINT_OUTLIER: (f64, f64) = (5.0, 0.25);
/// A view is an outlier beyond this many median view errors, and this, px.
const VIEW_OUTLIER: (f64, f64) = (3.0, 0.3);
/// Minimum number of inliers of a view.
const MIN_POINTS: usize = 6;
/// Minimum angle between the board normals of two views, rad: 8°.
const MIN_SPREAD_RAD: f64 = 0.14;
/// Maximum relative standard deviation of a focal length.
const MAX_FOCAL_SIGMA: f64 = 0.01;
/// A coefficient is fitted while the standard deviation of directions at the image corners stays
/// below this fraction of the diagonal: 2 px at 640×480.
const MAX_CORNER_SIGMA: f64 = 0.0025;
/// A coefficient is also fitted if it differs from 0 by this many standard deviations; k3 only
/// then.
const SIGNIFICANT: f64 = 3.0;
/// Maximum median error of points that match the board, px.
const MAX_MEDIAN_PX: f64 = 3.0;
/// Number of cross-validation folds.
const FOLDS: usize = 5;

/// Fit of a view.
#[derive(Clone, Debug, PartialEq)]
pub struct ViewFit {
    /// Index of the view.
    pub view: usize,
    /// RMS reprojection error, px; includes outliers for an excluded view.
    pub rms_px: f64,
    /// Number of inliers; 0 if the whole view was excluded as an outlier.
    pub points: usize,
    /// Number of outliers.
    pub outliers: usize,
    /// Pose of the board's plane in the camera frame.
    pub t_camera_plane: Pose,
}

/// Cross-validation result.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Holdout {
    /// Number of folds.
    pub folds: usize,
    /// RMS reprojection error over the held-out views, of which only the pose is fitted, px.
    pub rms_px: f64,
    /// Jackknife standard deviations of fx, fy, cx, cy, px.
    pub spread_px: [f64; 4],
}

/// Intrinsics with their uncertainty.
#[derive(Clone, Debug, PartialEq)]
pub struct CalibrationReport {
    /// The intrinsics; Brown–Conrady.
    pub intrinsics: Intrinsics,
    /// Standard deviations in the order of [`PARAMETERS`]; 0 for parameters that were not fitted.
    pub sigma: [f64; LENS],
    /// Which parameters were fitted; the others are 0.
    pub fitted: [bool; LENS],
    /// RMS reprojection error over all inliers, px.
    pub rms_px: f64,
    /// Standard deviation of one point coordinate, px.
    pub point_sigma_px: f64,
    /// Maximum standard deviation of directions at the image corners, px.
    pub corner_sigma_px: f64,
    /// The views in input order.
    pub views: Vec<ViewFit>,
    /// Cross-validation; none with fewer than five views.
    pub holdout: Option<Holdout>,
}

/// Calibrates a camera with images of `size` (width, height) from the points of each view.
///
/// Coefficients that the views do not determine stay 0: k3, then p1 and p2, then k2, then k1 are
/// dropped until the last one differs from 0 by more than three standard deviations or, except for
/// k3, directions at the image corners are known to 0.25 % of the diagonal.
///
/// # Errors
/// `Input` if there are too few views, too few directions, or points that do not match the board.
pub fn calibrate_intrinsics(
    size: [u32; 2],
    views: &[Vec<BoardPoint>],
) -> Result<CalibrationReport> {
    let mut calibration = Calibration::new(size, views)?;
    calibration.fit_roughly()?;
    let (fit, fitted) = calibration.fit_inliers()?;
    let holdout = calibration.holdout(&fit, &fitted);
    Ok(calibration.report(fit, fitted, holdout))
}

/// Views without outliers, and the current estimate.
struct Calibration<'a> {
    size: [u32; 2],
    all: &'a [Vec<BoardPoint>],
    /// Indices into `all` of `views`.
    indices: Vec<usize>,
    views: Vec<Vec<BoardPoint>>,
    bundle: Bundle,
}

const FOCAL_ONLY: Fitted = fitted_up_to(2);

/// The first `count` parameters.
const fn fitted_up_to(count: usize) -> Fitted {
    let mut fitted = [false; LENS];
    let mut i = 0;
    while i < count {
        fitted[i] = true;
        i += 1;
    }
    fitted
}

impl<'a> Calibration<'a> {
    /// Fits focal lengths and poses from each initial estimate and keeps the best.
    fn new(size: [u32; 2], all: &'a [Vec<BoardPoint>]) -> Result<Self> {
        let usable = all.iter().enumerate().filter_map(|(index, points)| {
            let homography = homography(points)?;
            (points.len() >= MIN_POINTS).then_some((index, homography))
        });
        let usable: Vec<_> = usable.collect();
        if usable.len() < MIN_VIEWS {
            return Err(too_few(usable.len()));
        }
        let homographies: Vec<_> = usable.iter().map(|(_, h)| *h).collect();
        let mut best: Option<(f64, Vec<usize>, Bundle)> = None;
        for lens in lenses(size, &homographies) {
            let posed: Vec<(usize, Pose)> = usable
                .iter()
                .filter_map(|(index, h)| Some((*index, pose(&lens, h)?)))
                .collect();
            if 2 * posed.len() < all.len() {
                continue;
            }
            let indices: Vec<usize> = posed.iter().map(|(index, _)| *index).collect();
            let views = chosen(all, &indices);
            let start = Bundle {
                lens,
                poses: posed.into_iter().map(|(_, pose)| pose).collect(),
            };
            let Some(fit) = minimise(&views, start, &FOCAL_ONLY, ROUGH_LOSS_PX) else {
                continue;
            };
            let points = views.iter().map(Vec::len).sum::<usize>() as f64;
            let cost = fit.cost / points;
            if best.as_ref().is_none_or(|(min, ..)| cost < *min) {
                best = Some((cost, indices, fit.bundle));
            }
        }
        let (_, indices, bundle) = best.ok_or_else(not_determined)?;
        check_spread(&bundle.poses)?;
        Ok(Self {
            size,
            all,
            views: chosen(all, &indices),
            indices,
            bundle,
        })
    }

    /// Adds parameters step by step and drops outlying views.
    fn fit_roughly(&mut self) -> Result<()> {
        let mut k1 = fitted_up_to(4);
        k1[4] = true;
        for fitted in [k1, fitted_up_to(8)] {
            let fit = self.minimise(&fitted, ROUGH_LOSS_PX);
            // Without enough tilt the principal point diverges; the final model decides.
            if let Some(fit) = fit.filter(|fit| fit.bundle.lens.validate().is_ok()) {
                self.bundle = fit.bundle;
            }
        }
        for _ in 0..self.views.len() / 4 {
            let Some(worst) = self.outlying_view() else {
                break;
            };
            self.remove_view(worst);
            if let Some(fit) = self.minimise(&fitted_up_to(8), ROUGH_LOSS_PX) {
                self.bundle = fit.bundle;
            }
        }
        let median = median(self.errors()).unwrap_or(f64::INFINITY);
        if median > MAX_MEDIAN_PX {
            return Err(mismatch(median));
        }
        Ok(())
    }

    fn remove_view(&mut self, index: usize) {
        self.indices.remove(index);
        self.views.remove(index);
        self.bundle.poses.remove(index);
    }

    fn minimise(&self, fitted: &Fitted, loss_px: f64) -> Option<BundleFit> {
        minimise(&self.views, self.bundle.clone(), fitted, loss_px)
    }

    fn errors(&self) -> Vec<f64> {
        self.errors_of(&self.bundle)
    }

    fn errors_of(&self, bundle: &Bundle) -> Vec<f64> {
        let views = self.views.iter().zip(&bundle.poses);
        views
            .flat_map(|(points, pose)| errors_px(&bundle.lens, pose, points))
            .collect()
    }

    /// The worst view, if it is an outlier. The error of a view is its median, so that single
    /// points do not matter.
    fn outlying_view(&self) -> Option<usize> {
        let views = self.views.iter().zip(&self.bundle.poses);
        let errors: Vec<f64> = views
            .filter_map(|(points, pose)| median(errors_px(&self.bundle.lens, pose, points)))
            .collect();
        let (medians, min_px) = VIEW_OUTLIER;
        let limit = min_px.max(medians * median(errors.iter().copied())?);
        let worst = (0..errors.len()).max_by(|a, b| errors[*a].total_cmp(&errors[*b]))?;
        (self.views.len() > MIN_VIEWS && errors[worst] > limit).then_some(worst)
    }

    /// The final fit without outliers, with the parameters that are determined.
    fn fit_inliers(&mut self) -> Result<(BundleFit, Fitted)> {
        let mut fitted = fitted_up_to(8);
        for _ in 0..3 {
            let (fit, selected) = self.select_model().ok_or_else(not_determined)?;
            (self.bundle, fitted) = (fit.bundle, selected);
            if !self.drop_outliers() {
                break;
            }
        }
        let fit = self.minimise(&fitted, self.loss_px());
        let fit = fit.ok_or_else(not_determined)?;
        self.bundle = fit.bundle.clone();
        let sigma = self.point_sigma(&fit.bundle, &fitted);
        let lens = &fit.bundle.lens;
        let focal = [(lens.fx, 0), (lens.fy, 1)]
            .map(|(focal, i)| sigma * fit.inverse_information[i][i].max(0.0).sqrt() / focal);
        let is_known = lens.validate().is_ok() && focal.iter().all(|s| *s <= MAX_FOCAL_SIGMA);
        if !is_known {
            return Err(not_determined());
        }
        Ok((fit, fitted))
    }

    /// Selects the largest model that the views determine.
    fn select_model(&self) -> Option<(BundleFit, Fitted)> {
        let limit = MAX_CORNER_SIGMA * f64::from(self.size[0]).hypot(f64::from(self.size[1]));
        let mut last = None;
        for (count, newest) in [(9, 8..9), (8, 6..8), (6, 5..6), (5, 4..5), (4, 4..4)] {
            let fitted = fitted_up_to(count);
            let mut start = self.bundle.clone();
            for coefficient in &mut start.lens.coefficients[count - 4..] {
                *coefficient = 0.0;
            }
            let Some(fit) = minimise(&self.views, start, &fitted, self.loss_px()) else {
                continue;
            };
            let sigma = self.point_sigma(&fit.bundle, &fitted);
            let is_significant = newest.clone().any(|i| {
                let own = sigma * fit.inverse_information[i][i].max(0.0).sqrt();
                fit.bundle.lens.coefficients[i - 4].abs() > SIGNIFICANT * own
            });
            let is_known = !newest.contains(&8) && sigma * corner_spread(&fit) <= limit;
            last = Some((fit, fitted));
            if is_significant || is_known {
                return last;
            }
        }
        last
    }

    fn loss_px(&self) -> f64 {
        let median = median(self.errors()).unwrap_or(0.0);
        MIN_LOSS_PX.max(LOSS_OF_MEDIAN * median)
    }

    /// Removes outliers; returns whether there were any.
    fn drop_outliers(&mut self) -> bool {
        let Some(median) = median(self.errors()) else {
            return false;
        };
        let (medians, min_px) = POINT_OUTLIER;
        let limit = min_px.max(medians * median);
        let lens = self.bundle.lens;
        let before: usize = self.views.iter().map(Vec::len).sum();
        for (points, pose) in self.views.iter_mut().zip(&self.bundle.poses) {
            points.retain(|p| error_px(&lens, pose, p) <= limit);
        }
        for i in (0..self.views.len()).rev() {
            if self.views[i].len() < MIN_POINTS && self.views.len() > MIN_VIEWS {
                self.remove_view(i);
            }
        }
        before > self.views.iter().map(Vec::len).sum()
    }

    /// Standard deviation of one point coordinate from the residuals.
    fn point_sigma(&self, bundle: &Bundle, fitted: &Fitted) -> f64 {
        let errors = self.errors_of(bundle);
        let unknowns = fitted.iter().filter(|f| **f).count() + 6 * self.views.len();
        let freedom = (2 * errors.len()).saturating_sub(unknowns).max(1);
        (errors.iter().map(|e| e * e).sum::<f64>() / freedom as f64).sqrt()
    }

    /// Cross-validates; fold `i` holds out every n-th view.
    fn holdout(&self, fit: &BundleFit, fitted: &Fitted) -> Option<Holdout> {
        let count = self.views.len();
        if count < MIN_VIEWS + 2 {
            return None;
        }
        let folds = FOLDS.min(count);
        let loss_px = self.loss_px();
        let (mut squares, mut points) = (0.0, 0usize);
        let mut lenses = Vec::new();
        for fold in 0..folds {
            let (out, kept): (Vec<usize>, Vec<usize>) = (0..count).partition(|i| i % folds == fold);
            let start = Bundle {
                lens: fit.bundle.lens,
                poses: kept.iter().map(|i| fit.bundle.poses[*i]).collect(),
            };
            let rest = minimise(&chosen(&self.views, &kept), start, fitted, loss_px)?;
            let lens = rest.bundle.lens;
            for i in out {
                let view = &self.views[i];
                let pose = fit_pose(&lens, fit.bundle.poses[i], view, loss_px)?;
                let errors = errors_px(&lens, &pose, view);
                squares += errors.map(|e| e.powi(2)).sum::<f64>();
                points += view.len();
            }
            lenses.push([lens.fx, lens.fy, lens.cx, lens.cy]);
        }
        Some(Holdout {
            folds,
            rms_px: (squares / points.max(1) as f64).sqrt(),
            spread_px: std::array::from_fn(|i| jackknife(lenses.iter().map(|l| l[i]))),
        })
    }

    fn report(self, fit: BundleFit, fitted: Fitted, holdout: Option<Holdout>) -> CalibrationReport {
        let errors = self.errors();
        let point_sigma_px = self.point_sigma(&fit.bundle, &fitted);
        let sigma = |i: usize| point_sigma_px * fit.inverse_information[i][i].max(0.0).sqrt();
        let views = (0..self.all.len()).filter_map(|view| self.view_fit(view, &fit.bundle));
        CalibrationReport {
            intrinsics: fit.bundle.lens,
            sigma: std::array::from_fn(sigma),
            fitted,
            rms_px: rms(&errors),
            point_sigma_px,
            corner_sigma_px: point_sigma_px * corner_spread(&fit),
            views: views.collect(),
            holdout,
        }
    }

    fn view_fit(&self, view: usize, bundle: &Bundle) -> Option<ViewFit> {
        let (all, lens) = (&self.all[view], &bundle.lens);
        let index = self.indices.iter().position(|i| *i == view);
        let (pose, shown, points) = match index {
            Some(i) => (bundle.poses[i], &self.views[i], self.views[i].len()),
            None => {
                let start = pose(lens, &homography(all)?)?;
                (fit_pose(lens, start, all, ROUGH_LOSS_PX)?, all, 0)
            }
        };
        let errors: Vec<f64> = errors_px(lens, &pose, shown).collect();
        Some(ViewFit {
            view,
            rms_px: rms(&errors),
            points,
            outliers: all.len() - points,
            t_camera_plane: pose,
        })
    }
}

fn chosen(views: &[Vec<BoardPoint>], indices: &[usize]) -> Vec<Vec<BoardPoint>> {
    indices.iter().map(|i| views[*i].clone()).collect()
}

fn errors_px(lens: &Intrinsics, pose: &Pose, points: &[BoardPoint]) -> impl Iterator<Item = f64> {
    points.iter().map(move |p| error_px(lens, pose, p))
}

/// Fits the pose of one view with fixed intrinsics.
pub(super) fn fit_pose(
    lens: &Intrinsics,
    start: Pose,
    points: &Vec<BoardPoint>,
    loss_px: f64,
) -> Option<Pose> {
    let start = Bundle {
        lens: *lens,
        poses: vec![start],
    };
    let views = std::slice::from_ref(points);
    let fit = minimise(views, start, &[false; LENS], loss_px)?;
    fit.bundle.poses.first().copied()
}

/// Jackknife standard deviation of a mean (J. Tukey, 1958).
fn jackknife(values: impl Iterator<Item = f64> + Clone) -> f64 {
    let count = values.clone().count() as f64;
    let mean = values.clone().sum::<f64>() / count;
    let squares: f64 = values.map(|v| (v - mean).powi(2)).sum();
    (squares * (count - 1.0) / count).sqrt()
}

/// Upper bound of the standard deviation of directions at the image corners, px for point noise of
/// 1 px. A common shift of all four corners does not count: the board's pose compensates for a
/// rotation of the camera.
fn corner_spread(fit: &BundleFit) -> f64 {
    let (lens, inverse_information) = (&fit.bundle.lens, &fit.inverse_information);
    let (right, bottom) = (f64::from(lens.width) - 1.0, f64::from(lens.height) - 1.0);
    let corners = [(0.0, 0.0), (right, 0.0), (right, bottom), (0.0, bottom)];
    let rows = |(x, y): (f64, f64)| {
        let ideal = crate::camera::undistort(lens, DVec2::new(x, y))?;
        Some(intrinsics_jacobian(lens, DVec3::new(ideal.x, ideal.y, 1.0)))
    };
    let mut largest: f64 = 0.0;
    for corner in corners {
        let Some(rows) = rows(corner) else {
            return f64::INFINITY;
        };
        let variance: f64 = rows
            .iter()
            .map(|row| {
                let mut row = *row;
                // A shift of the principal point equals a rotation of the camera.
                row[2] = 0.0;
                row[3] = 0.0;
                let product = |i: usize| -> f64 {
                    (0..LENS)
                        .map(|j| row[i] * inverse_information[i][j] * row[j])
                        .sum()
                };
                (0..LENS).map(product).sum::<f64>()
            })
            .sum();
        largest = largest.max(variance);
    }
    largest.max(0.0).sqrt()
}

/// Refuses views that all show the board from one direction: focal length and distance are then
/// coupled.
fn check_spread(poses: &[Pose]) -> Result<()> {
    let normals: Vec<DVec3> = poses.iter().map(|p| p.transform_vector(DVec3::Z)).collect();
    let mut widest: f64 = 0.0;
    for (i, a) in normals.iter().enumerate() {
        for b in &normals[..i] {
            widest = widest.max(a.angle_between(*b));
        }
    }
    if widest >= MIN_SPREAD_RAD {
        return Ok(());
    }
    Err(Error::input(format!(
        "all views show the board from the same direction (within {:.0}°), so focal length and \
         distance cannot be separated",
        widest.to_degrees()
    ))
    .remedy(TILT_REMEDY))
}

const TILT_REMEDY: &str = "take images with the board tilted by 20° to 40° to the left, right, top \
                           and bottom, in all regions of the image";

fn not_determined() -> Error {
    let what = "the views do not determine the focal length: too few directions of the board";
    Error::input(what).remedy(TILT_REMEDY)
}

fn too_few(count: usize) -> Error {
    Error::input(format!(
        "a calibration needs at least {MIN_VIEWS} usable views of the board, found {count}"
    ))
    .remedy("take 12 to 20 images, with the board tilted and in all regions of the image")
}

fn mismatch(error_px: f64) -> Error {
    Error::input(format!(
        "the points do not match the board file: median error {error_px:.1} px"
    ))
    .remedy(
        "check the board file (markers, squares, legacy layout), that the board is flat, and that \
         all images are from one camera with fixed zoom and focus",
    )
}
