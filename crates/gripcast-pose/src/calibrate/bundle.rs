//! Bundle adjustment of the intrinsics and the board poses of all views.
//!
//! The poses are eliminated view by view (Schur complement; B. Triggs et al., *Bundle adjustment —
//! a modern synthesis*, 2000), which leaves nine equations.

use glam::DVec2;

use super::board_points::BoardPoint;
use crate::camera::{intrinsics_jacobian, project, project_with_jacobian};
use crate::least_squares::{Search, Trial, huber, moved, pose_row};
use gripcast_base::linear::{Cholesky, NormalEquations};
use gripcast_geometry::Pose;
use gripcast_imaging::Intrinsics;

/// Number of intrinsics: fx, fy, cx, cy, k1, k2, p1, p2, k3.
pub(super) const LENS: usize = 9;
const SEARCH: Search = Search {
    max_iterations: 80,
    min_decrease: 1e-11,
    max_damping: Some(1e12),
};

/// Which intrinsics are free parameters.
pub(super) type Fitted = [bool; LENS];

/// Intrinsics and `t_camera_plane` of each view.
#[derive(Clone, Debug)]
pub(super) struct Bundle {
    pub(super) lens: Intrinsics,
    pub(super) poses: Vec<Pose>,
}

/// Result of [`minimise`].
#[derive(Clone, Debug)]
pub(super) struct BundleFit {
    pub(super) bundle: Bundle,
    /// Robust cost, px².
    pub(super) cost: f64,
    /// Inverse information of the intrinsics, poses marginalised; zero for fixed parameters.
    pub(super) inverse_information: [[f64; LENS]; LENS],
}

/// Reprojection error of a point, px; infinite behind the camera.
pub(super) fn error_px(lens: &Intrinsics, pose: &Pose, point: &BoardPoint) -> f64 {
    let predicted = project(lens, pose.transform_point(point.point_m));
    predicted.map_or(f64::INFINITY, |pixel| pixel.distance(point.pixel))
}

/// Minimises the Huber loss (quadratic up to `loss_px`) from `start`. None if the views do not
/// determine the parameters.
pub(super) fn minimise(
    views: &[Vec<BoardPoint>],
    start: Bundle,
    fitted: &Fitted,
    loss_px: f64,
) -> Option<BundleFit> {
    let minimum = SEARCH.minimise(
        start,
        |bundle| linearise(views, bundle, fitted, loss_px),
        |bundle, equations, damping| {
            let step = equations.step(damping)?;
            Some(Trial {
                state: stepped(bundle, &step),
                is_small: false,
            })
        },
    )?;
    let (reduced, _) = minimum.equations.reduced(0.0)?;
    let mut inverse_information = Cholesky::beyond_rounding(&reduced.matrix)?.inverse();
    for (i, row) in inverse_information.iter_mut().enumerate() {
        for (j, value) in row.iter_mut().enumerate() {
            if !(fitted[i] && fitted[j]) {
                *value = 0.0;
            }
        }
    }
    Some(BundleFit {
        bundle: minimum.state,
        cost: minimum.cost,
        inverse_information,
    })
}

/// Step of the intrinsics and of every pose.
struct Step {
    lens: [f64; LENS],
    poses: Vec<[f64; 6]>,
}

fn stepped(bundle: &Bundle, step: &Step) -> Bundle {
    let mut lens = bundle.lens;
    let [fx, fy, cx, cy, coefficients @ ..] = step.lens;
    lens.fx += fx;
    lens.fy += fy;
    lens.cx += cx;
    lens.cy += cy;
    for (value, step) in lens.coefficients.iter_mut().zip(coefficients) {
        *value += step;
    }
    let poses = bundle.poses.iter().zip(&step.poses);
    Bundle {
        lens,
        poses: poses.map(|(pose, step)| moved(pose, step)).collect(),
    }
}

/// Block normal equations.
struct Equations {
    lens: NormalEquations<LENS>,
    poses: Vec<NormalEquations<6>>,
    /// By view: intrinsics × pose.
    mixed: Vec<[[f64; 6]; LENS]>,
    fitted: Fitted,
}

/// Inverse pose block of each view.
type Eliminated = Vec<[[f64; 6]; 6]>;

impl Equations {
    /// Equations of the intrinsics with the poses eliminated; fixed parameters have a step of 0.
    fn reduced(&self, damping: f64) -> Option<(NormalEquations<LENS>, Eliminated)> {
        let mut reduced = self.lens.clone();
        for i in 0..LENS {
            reduced.matrix[i][i] *= 1.0 + damping;
            if !self.fitted[i] {
                reduced.matrix[i][i] = 1.0;
            }
        }
        let mut eliminated = Vec::with_capacity(self.poses.len());
        for (pose, mixed) in self.poses.iter().zip(&self.mixed) {
            let mut block = pose.matrix;
            for (i, row) in block.iter_mut().enumerate() {
                row[i] *= 1.0 + damping;
            }
            let inverse = Cholesky::beyond_rounding(&block)?.inverse();
            for i in 0..LENS {
                let row = times(&inverse, &mixed[i]);
                for (entry, other) in reduced.matrix[i].iter_mut().zip(mixed) {
                    *entry -= dot(&row, other);
                }
                reduced.vector[i] -= dot(&row, &pose.vector);
            }
            eliminated.push(inverse);
        }
        Some((reduced, eliminated))
    }

    fn step(&self, damping: f64) -> Option<Step> {
        let (reduced, eliminated) = self.reduced(damping)?;
        let lens = reduced.solve()?;
        let blocks = self.poses.iter().zip(&self.mixed).zip(&eliminated);
        let poses = blocks.map(|((pose, mixed), inverse)| {
            let mut rest = pose.vector;
            for (value, row) in lens.iter().zip(mixed) {
                for (rest, entry) in rest.iter_mut().zip(row) {
                    *rest -= value * entry;
                }
            }
            times(inverse, &rest)
        });
        Some(Step {
            lens,
            poses: poses.collect(),
        })
    }
}

fn times(matrix: &[[f64; 6]; 6], vector: &[f64; 6]) -> [f64; 6] {
    std::array::from_fn(|i| dot(&matrix[i], vector))
}

fn dot(a: &[f64; 6], b: &[f64; 6]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}

/// Normal equations of the step and robust cost. None if a point does not project.
fn linearise(
    views: &[Vec<BoardPoint>],
    bundle: &Bundle,
    fitted: &Fitted,
    loss_px: f64,
) -> Option<(Equations, f64)> {
    let mut cost = 0.0;
    let mut equations = Equations {
        lens: NormalEquations::zero(),
        poses: Vec::with_capacity(views.len()),
        mixed: Vec::with_capacity(views.len()),
        fitted: *fitted,
    };
    for (points, pose) in views.iter().zip(&bundle.poses) {
        let mut own = NormalEquations::<6>::zero();
        let mut mixed = [[0.0; 6]; LENS];
        for point in points {
            let arm = pose.transform_vector(point.point_m);
            let point_m = arm + pose.translation_m;
            let (pixel, gradients) = project_with_jacobian(&bundle.lens, point_m)?;
            let mut by_lens = intrinsics_jacobian(&bundle.lens, point_m);
            let residual: DVec2 = point.pixel - pixel;
            let (weight, own_cost) = huber(residual.length(), loss_px);
            cost += own_cost;
            for (axis, value) in residual.to_array().into_iter().enumerate() {
                let gradient = gradients[axis];
                let row = pose_row(gradient, arm);
                for (entry, is_fitted) in by_lens[axis].iter_mut().zip(fitted) {
                    if !is_fitted {
                        *entry = 0.0;
                    }
                }
                own.add(&row, value, weight);
                equations.lens.add(&by_lens[axis], value, weight);
                for (sums, entry) in mixed.iter_mut().zip(by_lens[axis]) {
                    for (sum, other) in sums.iter_mut().zip(row) {
                        *sum += weight * entry * other;
                    }
                }
            }
        }
        equations.poses.push(own);
        equations.mixed.push(mixed);
    }
    cost.is_finite().then_some((equations, cost))
}
