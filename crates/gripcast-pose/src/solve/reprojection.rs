//! Minimum of the reprojection error by Levenberg–Marquardt with the Huber loss.

use glam::{DVec2, DVec3};

use crate::camera::{project, project_with_jacobian};
use crate::least_squares::{Search, Trial, huber, moved, pose_row};
use gripcast_base::linear::{Cholesky, NormalEquations};
use gripcast_geometry::Pose;
use gripcast_imaging::Intrinsics;

const SEARCH: Search = Search {
    max_iterations: 60,
    min_decrease: 1e-12,
    max_damping: None,
};
/// Steps below this (m, rad) end the search.
const TOLERANCE: f64 = 1e-10;

/// A corner on its body and in the image.
#[derive(Clone, Copy, Debug)]
pub(super) struct CornerObservation {
    /// In the body frame at opening 0, m.
    pub(super) point_m: DVec3,
    /// Displacement along x per metre of opening.
    pub(super) slide: f64,
    pub(super) pixel: DVec2,
}

/// The unknowns.
#[derive(Clone, Copy, Debug)]
pub(super) struct State {
    /// `t_camera_body`.
    pub(super) pose: Pose,
    /// Opening of the gripper, m; 0 for a rigid body.
    pub(super) opening_m: f64,
}

/// A minimum.
#[derive(Clone, Debug)]
pub(super) struct Fit<const N: usize> {
    pub(super) state: State,
    /// Robust cost, px².
    pub(super) cost: f64,
    /// (JᵀWJ)⁻¹ in m, rad, m per px, with the weights of the loss.
    pub(super) inverse_information: [[f64; N]; N],
}

/// Observed minus predicted corner, px. `None`: behind the camera.
pub(super) fn residual(
    intrinsics: &Intrinsics,
    state: &State,
    observation: &CornerObservation,
) -> Option<DVec2> {
    let point = state.pose.transform_point(opened(state, observation));
    Some(observation.pixel - project(intrinsics, point)?)
}

/// Finds a local minimum of the Huber loss with threshold `loss_px`.
///
/// Unknowns are [δt, δθ] (m, rad; `N` = 6) of t = t̂ + δt, R = exp(δθ) R̂ along the camera axes,
/// and the opening (`N` = 7), or δt alone (`N` = 3). `None`: the corners do not determine them.
pub(super) fn minimise<const N: usize>(
    intrinsics: &Intrinsics,
    observations: &[CornerObservation],
    start: State,
    loss_px: f64,
) -> Option<Fit<N>> {
    let found = SEARCH.minimise(
        start,
        |state| linearise::<N>(intrinsics, observations, state, loss_px),
        |state, equations, damping| {
            let mut damped = equations.clone();
            for i in 0..N {
                damped.matrix[i][i] *= 1.0 + damping;
            }
            let step = damped.solve()?;
            Some(Trial {
                state: stepped(state, &step),
                is_small: step.iter().all(|s| s.abs() < TOLERANCE),
            })
        },
    )?;
    Some(Fit {
        state: found.state,
        cost: found.cost,
        inverse_information: Cholesky::beyond_rounding(&found.equations.matrix)?.inverse(),
    })
}

/// The corner in the body frame at the state's opening, m.
fn opened(state: &State, observation: &CornerObservation) -> DVec3 {
    observation.point_m + DVec3::X * (observation.slide * state.opening_m)
}

fn stepped<const N: usize>(state: &State, step: &[f64; N]) -> State {
    State {
        pose: moved(&state.pose, step),
        opening_m: state.opening_m + step.get(6).copied().unwrap_or(0.0),
    }
}

/// Normal equations of the step and the robust cost. `None`: a corner is behind the camera.
fn linearise<const N: usize>(
    intrinsics: &Intrinsics,
    observations: &[CornerObservation],
    state: &State,
    loss_px: f64,
) -> Option<(NormalEquations<N>, f64)> {
    let mut equations = NormalEquations::zero();
    let mut cost = 0.0;
    let along = state.pose.transform_vector(DVec3::X);
    for observation in observations {
        let arm = state.pose.transform_vector(opened(state, observation));
        let point = arm + state.pose.translation_m;
        let (pixel, gradients) = project_with_jacobian(intrinsics, point)?;
        let residual = observation.pixel - pixel;
        let (weight, own_cost) = huber(residual.length(), loss_px);
        cost += own_cost;
        for (gradient, value) in gradients.into_iter().zip(residual.to_array()) {
            let slide = gradient.dot(along) * observation.slide;
            let columns = pose_row(gradient, arm).into_iter().chain([slide]);
            let mut row = [0.0; N];
            row.iter_mut()
                .zip(columns)
                .for_each(|(to, from)| *to = from);
            equations.add(&row, value, weight);
        }
    }
    cost.is_finite().then_some((equations, cost))
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::DQuat;
    use gripcast_imaging::DistortionModel;

    fn camera() -> Intrinsics {
        Intrinsics {
            width: 1280,
            height: 720,
            fx: 915.0,
            fy: 915.0,
            cx: 640.0,
            cy: 360.0,
            model: DistortionModel::BrownConrady,
            coefficients: [0.1, -0.2, 0.0005, 0.0003, 0.0],
        }
    }

    fn truth() -> State {
        State {
            pose: Pose::new(
                DQuat::from_scaled_axis(DVec3::new(2.6, 0.4, -0.3)),
                DVec3::new(0.03, -0.02, 0.5),
            ),
            opening_m: 0.05,
        }
    }

    fn observations() -> Vec<CornerObservation> {
        (0..8)
            .map(|i| {
                let (f, slide) = (f64::from(i), if i < 4 { -0.5 } else { 0.5 });
                CornerObservation {
                    point_m: DVec3::new(f.sin(), (2.0 * f).cos(), (1.7 * f).sin()) * 0.03,
                    slide,
                    pixel: DVec2::ZERO,
                }
            })
            .map(|o| CornerObservation {
                pixel: -residual(&camera(), &truth(), &o).unwrap(),
                ..o
            })
            .collect()
    }

    #[test]
    fn gradient_matches_finite_differences() {
        let corners = observations();
        let at = stepped(&truth(), &[0.004, -0.003, 0.01, 0.02, 0.05, -0.03, 0.01]);
        let loss = 2.0;
        let (equations, _) = linearise::<7>(&camera(), &corners, &at, loss).unwrap();
        for i in 0..7 {
            let cost = |h: f64| {
                let mut step = [0.0; 7];
                step[i] = h;
                linearise::<7>(&camera(), &corners, &stepped(&at, &step), loss)
                    .unwrap()
                    .1
            };
            let slope = (cost(1e-6) - cost(-1e-6)) / 2e-6;
            let gradient = -2.0 * equations.vector[i];
            assert!(
                (slope - gradient).abs() < 1e-5 * slope.abs().max(1e3),
                "{i}: {slope} {gradient}"
            );
        }
    }

    #[test]
    fn search_converges_from_a_distant_start() {
        let start = State {
            opening_m: 0.0,
            ..stepped(&truth(), &[0.02, 0.01, 0.05, 0.2, -0.1, 0.2])
        };
        let fit = minimise::<7>(&camera(), &observations(), start, 1e3).unwrap();
        assert!(fit.cost < 1e-16, "{}", fit.cost);
        assert!((fit.state.opening_m - 0.05).abs() < 1e-9);
        let error = fit.state.pose.translation_m - truth().pose.translation_m;
        assert!(error.length() < 1e-9, "{error}");
    }

    #[test]
    fn robust_loss_limits_the_influence_of_an_outlier() {
        let mut corners = observations();
        corners[2].pixel += DVec2::new(30.0, -20.0);
        let off = |loss| {
            let fit = minimise::<7>(&camera(), &corners, truth(), loss).unwrap();
            fit.state
                .pose
                .translation_m
                .distance(truth().pose.translation_m)
        };
        assert!(off(0.05) < 0.1 * off(1e3), "{} {}", off(0.05), off(1e3));
    }

    #[test]
    fn undetermined_opening_has_no_solution() {
        let rigid: Vec<_> = observations()
            .into_iter()
            .map(|o| CornerObservation { slide: 0.0, ..o })
            .collect();
        assert!(minimise::<7>(&camera(), &rigid, truth(), 1.0).is_none());
    }
}
