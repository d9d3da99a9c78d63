//! Intrinsics of a camera from several views of a board.

use glam::{DVec2, DVec3};

use super::board_points::BoardPoint;
use super::bundle::{Bundle, BundleFit, Fitted, LENS, error_px, minimise};
use super::start::{homography, lenses, pose};
use crate::camera::intrinsics_jacobian;
use gripcast_base::error::{Error, Result};
use gripcast_base::statistics::median;
use gripcast_geometry::Pose;
use gripcast_imaging::Intrinsics;

/// Names of the parameters in the order of all lists of them.
pub const PARAMETERS: [&str; LENS] = ["fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2", "k3"];

/// Fewest views.
const MIN_VIEWS: usize = 3;
/// Loss of the first searches, px, and the narrowest of the last.
const ROUGH_LOSS_PX: f64 = 3.0;
const MIN_LOSS_PX: f64 = 0.1;
/// Residuals of the least-squares part of the loss, times their median.
const LOSS_OF_MEDIAN: f64 = 2.0;
/// A point is an outlier beyond this many medians of all residuals, and this, px. The median of a
/// Gaussian's lengths is 1.18 standard deviations.
const POINT_OUTLIER: (f64, f64) = (5.0, 0.25);
/// A view is an outlier beyond this many medians of the views' errors, and this, px.
const VIEW_OUTLIER: (f64, f64) = (3.0, 0.3);
/// Fewest points of a view after its outliers.
const MIN_POINTS: usize = 6;
/// Least angle between the board's normals in two views, rad: 8°.
const MIN_SPREAD_RAD: f64 = 0.14;
/// A focal length that is known worse than this, relatively, is not determined.
const WORST_FOCAL: f64 = 0.01;
/// A coefficient is fitted while directions in the image's corners stay known to this part of
/// the diagonal (one standard deviation): 2 px at 640×480.
const WORST_CORNER: f64 = 0.0025;
/// A coefficient is also fitted if it differs from 0 by this many standard deviations; k3 only
/// then.
const SIGNIFICANT: f64 = 3.0;
/// With a larger error the points are not where the board's description has them, px.
const CONTRADICTION_PX: f64 = 3.0;
/// Every fifth view is left out in turn.
const FOLDS: usize = 5;

/// How a view fits.
#[derive(Clone, Debug, PartialEq)]
pub struct ViewFit {
    /// Which of the views that were given.
    pub view: usize,
    /// Root mean square distance of its points from where they are predicted, px; with outliers
    /// for a view that was left out.
    pub rms_px: f64,
    /// Points that were used; none if the whole view was left out as an outlier.
    pub points: usize,
    /// Points that were left out as outliers.
    pub outliers: usize,
    /// Where the board was: maps its plane's frame into the camera's.
    pub t_camera_plane: Pose,
}

/// What views say that the calibration has not seen.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Holdout {
    /// How many times a part of the views was left out.
    pub folds: usize,
    /// Root mean square error of the points of left out views, of which only the pose is solved,
    /// px.
    pub rms_px: f64,
    /// Standard deviations of fx, fy, cx, cy from how they change when views are left out (jackknife), px.
    pub spread_px: [f64; 4],
}

/// Intrinsics and how far to trust them.
#[derive(Clone, Debug, PartialEq)]
pub struct CalibrationReport {
    /// The result; Brown–Conrady.
    pub intrinsics: Intrinsics,
    /// Standard deviations by [`PARAMETERS`]; 0 where a coefficient was not fitted.
    pub sigma: [f64; LENS],
    /// Which parameters were fitted; the others are 0.
    pub fitted: [bool; LENS],
    /// Root mean square reprojection error over all used points, px.
    pub rms_px: f64,
    /// Standard deviation of one coordinate of a point, px.
    pub point_sigma_px: f64,
    /// How well directions in the image's corners are known: the largest standard deviation, px.
    pub corner_sigma_px: f64,
    /// The views, in the order in which they were given.
    pub views: Vec<ViewFit>,
    /// Cross-validation; none with fewer than five views.
    pub holdout: Option<Holdout>,
}

/// Calibrates a camera with images of `size` (width, height) from the points of each view.
///
/// Coefficients that the views do not determine stay 0: k3, then p1 and p2, then k2, then k1 are
/// given up until the last one differs from 0 by more than three standard deviations or, but for
/// k3, directions in the image's corners are known to 0.25 % of its diagonal.
///
/// # Errors
/// `Input` if there are too few views, if they show the board from too few directions, or if the
/// points do not fit the board's description; the remedy says what helps.
pub fn calibrate_intrinsics(
    size: [u32; 2],
    views: &[Vec<BoardPoint>],
) -> Result<CalibrationReport> {
    let mut search = Search::new(size, views)?;
    search.rough()?;
    let (fit, fitted) = search.settle()?;
    let holdout = search.holdout(&fit, &fitted);
    Ok(search.report(fit, fitted, holdout))
}

/// The views as they are worked on: without those and the points that are outliers.
struct Search<'a> {
    size: [u32; 2],
    all: &'a [Vec<BoardPoint>],
    /// Indices into `all`, and their points.
    indices: Vec<usize>,
    views: Vec<Vec<BoardPoint>>,
    bundle: Bundle,
}

const FOCAL_ONLY: Fitted = fitted_up_to(2);

/// The first parameters.
const fn fitted_up_to(count: usize) -> Fitted {
    let mut fitted = [false; LENS];
    let mut i = 0;
    while i < count {
        fitted[i] = true;
        i += 1;
    }
    fitted
}

impl<'a> Search<'a> {
    /// Searches focal lengths and poses from each start.
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
            if best.as_ref().is_none_or(|(least, ..)| cost < *least) {
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

    /// More parameters step by step, and views away that do not belong to the others.
    fn rough(&mut self) -> Result<()> {
        let mut k1 = fitted_up_to(4);
        k1[4] = true;
        for fitted in [k1, fitted_up_to(8)] {
            let fit = self.minimise(&fitted, ROUGH_LOSS_PX);
            // Without enough tilt the principal point runs away; the settled model decides.
            if let Some(fit) = fit.filter(|fit| fit.bundle.lens.validate().is_ok()) {
                self.bundle = fit.bundle;
            }
        }
        let most = self.views.len() / 4;
        for _ in 0..most {
            let Some(worst) = self.outlying_view() else {
                break;
            };
            self.indices.remove(worst);
            self.views.remove(worst);
            self.bundle.poses.remove(worst);
            if let Some(fit) = self.minimise(&fitted_up_to(8), ROUGH_LOSS_PX) {
                self.bundle = fit.bundle;
            }
        }
        let median = median(self.errors()).unwrap_or(f64::INFINITY);
        if median > CONTRADICTION_PX {
            return Err(contradiction(median));
        }
        Ok(())
    }

    fn minimise(&self, fitted: &Fitted, loss_px: f64) -> Option<BundleFit> {
        minimise(&self.views, self.bundle.clone(), fitted, loss_px)
    }

    fn errors(&self) -> Vec<f64> {
        self.errors_of(&self.bundle)
    }

    fn errors_of(&self, bundle: &Bundle) -> Vec<f64> {
        let by_view = self.views.iter().zip(&bundle.poses);
        by_view
            .flat_map(|(points, pose)| {
                let lens = bundle.lens;
                points.iter().map(move |p| error_px(&lens, pose, p))
            })
            .collect()
    }

    /// The view that fits worst, if it is an outlier. The error of a view is its median, so that
    /// single points do not count.
    fn outlying_view(&self) -> Option<usize> {
        let errors: Vec<f64> = self
            .views
            .iter()
            .zip(&self.bundle.poses)
            .filter_map(|(points, pose)| {
                let error = |p| error_px(&self.bundle.lens, pose, p);
                median(points.iter().map(error))
            })
            .collect();
        let limit = VIEW_OUTLIER
            .1
            .max(VIEW_OUTLIER.0 * median(errors.iter().copied())?);
        let worst = (0..errors.len()).max_by(|a, b| errors[*a].total_cmp(&errors[*b]))?;
        (self.views.len() > MIN_VIEWS && errors[worst] > limit).then_some(worst)
    }

    /// The final fit, after outlying points have gone, with the parameters that are determined.
    fn settle(&mut self) -> Result<(BundleFit, Fitted)> {
        let mut fitted = fitted_up_to(8);
        for _ in 0..3 {
            let (fit, chosen) = self.modelled().ok_or_else(not_determined)?;
            (self.bundle, fitted) = (fit.bundle, chosen);
            if !self.drop_outliers() {
                break;
            }
        }
        let loss_px = self.loss_px();
        let fit = self.minimise(&fitted, loss_px).ok_or_else(not_determined)?;
        self.bundle = fit.bundle.clone();
        let sigma = self.point_sigma(&fit.bundle, &fitted);
        let lens = &fit.bundle.lens;
        let focal = [(lens.fx, 0), (lens.fy, 1)]
            .map(|(focal, i)| sigma * fit.inverse_information[i][i].max(0.0).sqrt() / focal);
        let is_known = lens.validate().is_ok() && focal.iter().all(|s| *s <= WORST_FOCAL);
        if !is_known {
            return Err(not_determined());
        }
        Ok((fit, fitted))
    }

    /// The largest model that the views determine.
    fn modelled(&self) -> Option<(BundleFit, Fitted)> {
        let limit = WORST_CORNER * f64::from(self.size[0]).hypot(f64::from(self.size[1]));
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
            let is_known = !newest.contains(&8) && sigma * self.corner_spread(&fit) <= limit;
            last = Some((fit, fitted));
            if is_significant || is_known {
                return last;
            }
        }
        last
    }

    /// Largest deviation of where directions in the image's corners are seen, px for points
    /// known to 1 px.
    fn corner_spread(&self, fit: &BundleFit) -> f64 {
        corner_spread(&fit.bundle.lens, &fit.inverse_information)
    }

    fn loss_px(&self) -> f64 {
        let median = median(self.errors()).unwrap_or(0.0);
        MIN_LOSS_PX.max(LOSS_OF_MEDIAN * median)
    }

    /// Removes points that are outliers; whether there were some.
    fn drop_outliers(&mut self) -> bool {
        let Some(median) = median(self.errors()) else {
            return false;
        };
        let limit = POINT_OUTLIER.1.max(POINT_OUTLIER.0 * median);
        let lens = self.bundle.lens;
        let before: usize = self.views.iter().map(Vec::len).sum();
        for (points, pose) in self.views.iter_mut().zip(&self.bundle.poses) {
            points.retain(|p| error_px(&lens, pose, p) <= limit);
        }
        for i in (0..self.views.len()).rev() {
            if self.views[i].len() < MIN_POINTS && self.views.len() > MIN_VIEWS {
                self.views.remove(i);
                self.indices.remove(i);
                self.bundle.poses.remove(i);
            }
        }
        before > self.views.iter().map(Vec::len).sum()
    }

    /// Standard deviation of a coordinate of a point from the residuals at the minimum.
    fn point_sigma(&self, bundle: &Bundle, fitted: &Fitted) -> f64 {
        let errors = self.errors_of(bundle);
        let unknowns = fitted.iter().filter(|f| **f).count() + 6 * self.views.len();
        let freedom = (2 * errors.len()).saturating_sub(unknowns).max(1);
        (errors.iter().map(|e| e * e).sum::<f64>() / freedom as f64).sqrt()
    }

    /// Leaves out every n-th view in turn.
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
                let view = [self.views[i].clone()];
                let start = Bundle {
                    lens,
                    poses: vec![fit.bundle.poses[i]],
                };
                let posed = minimise(&view, start, &[false; LENS], loss_px)?;
                let pose = posed.bundle.poses[0];
                squares += view[0]
                    .iter()
                    .map(|p| error_px(&lens, &pose, p).powi(2))
                    .sum::<f64>();
                points += view[0].len();
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
            corner_sigma_px: point_sigma_px * self.corner_spread(&fit),
            views: views.collect(),
            holdout,
        }
    }

    fn view_fit(&self, view: usize, bundle: &Bundle) -> Option<ViewFit> {
        let points = &self.all[view];
        if let Some(place) = self.indices.iter().position(|i| *i == view) {
            let (used, pose) = (&self.views[place], bundle.poses[place]);
            let errors: Vec<f64> = used
                .iter()
                .map(|p| error_px(&bundle.lens, &pose, p))
                .collect();
            return Some(ViewFit {
                view,
                rms_px: rms(&errors),
                points: used.len(),
                outliers: points.len() - used.len(),
                t_camera_plane: pose,
            });
        }
        let start = Bundle {
            lens: bundle.lens,
            poses: vec![pose(&bundle.lens, &homography(points)?)?],
        };
        let fit = minimise(
            std::slice::from_ref(points),
            start,
            &[false; LENS],
            ROUGH_LOSS_PX,
        )?;
        let pose = fit.bundle.poses[0];
        let errors: Vec<f64> = points
            .iter()
            .map(|p| error_px(&bundle.lens, &pose, p))
            .collect();
        Some(ViewFit {
            view,
            rms_px: rms(&errors),
            points: 0,
            outliers: points.len(),
            t_camera_plane: pose,
        })
    }
}

fn chosen(views: &[Vec<BoardPoint>], indices: &[usize]) -> Vec<Vec<BoardPoint>> {
    indices.iter().map(|i| views[*i].clone()).collect()
}

/// Standard deviation of a mean from the values with one part left out each time (J. Tukey, 1958).
fn jackknife(values: impl Iterator<Item = f64> + Clone) -> f64 {
    let count = values.clone().count() as f64;
    let mean = values.clone().sum::<f64>() / count;
    let squares: f64 = values.map(|v| (v - mean).powi(2)).sum();
    (squares * (count - 1.0) / count).sqrt()
}

/// Root of the largest eigenvalue's bound of the covariance of an image's corners, px for points
/// known to 1 px. The board's pose takes up a turn of the camera, so that a shift of all four
/// corners together does not count.
fn corner_spread(lens: &Intrinsics, inverse_information: &[[f64; LENS]; LENS]) -> f64 {
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
                // The principal point alone is a turn of the camera.
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

fn rms(errors: &[f64]) -> f64 {
    let squares: f64 = errors.iter().map(|e| e * e).sum();
    (squares / errors.len().max(1) as f64).sqrt()
}

/// Refuses views that all show the board from one direction: focal length and distance then
/// change together.
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
        "all views show the board from the same direction (within {:.0}°), which does not \
             tell the focal length from the distance",
        widest.to_degrees()
    ))
    .remedy(TILT_REMEDY))
}

const TILT_REMEDY: &str = "take images with the board tilted by 20° to 40° to the left, to the right, upwards \
                           and downwards, in all parts of the image";

fn not_determined() -> Error {
    let what =
        "the views do not determine the focal length: they show the board from too few directions";
    Error::input(what).remedy(TILT_REMEDY)
}

fn too_few(count: usize) -> Error {
    Error::input(format!(
        "a calibration needs at least {MIN_VIEWS} usable views of the board, found {count}"
    ))
    .remedy("take 12 to 20 images, with the board tilted and in all parts of the image")
}

fn contradiction(error_px: f64) -> Error {
    Error::input(format!(
            "the points are {error_px:.1} px away from where the board's description puts them"
        ))
    .remedy(
        "check the description (markers, squares, legacy layout), that the board is flat, and that all images are \
         from one camera with one zoom and focus",
    )
}
