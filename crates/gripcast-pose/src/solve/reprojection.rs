//! Least reprojection error by Levenberg–Marquardt, with a robust loss.

use glam::{DVec2, DVec3};

use crate::camera::{project, project_with_jacobian};
use crate::least_squares::{Search, Trial, huber, moved};
use gripcast_base::linear::{Cholesky, NormalEquations};
use gripcast_geometry::Pose;
use gripcast_imaging::Intrinsics;

const SEARCH: Search = Search {
    max_iterations: 60,
    min_decrease: 1e-12,
    largest_damping: None,
};
/// Steps below this (m, rad) change nothing.
const CONVERGED: f64 = 1e-10;

/// One corner: where it is on its part and where it was seen.
#[derive(Clone, Copy, Debug)]
pub(super) struct Observation {
    /// In the frame that is solved for, at opening 0, m.
    pub(super) point_m: DVec3,
    /// How far it moves along x per metre of opening.
    pub(super) slide: f64,
    /// Where it was seen.
    pub(super) pixel: DVec2,
}

/// What is solved for.
#[derive(Clone, Copy, Debug)]
pub(super) struct State {
    /// `t_camera_part`.
    pub(super) pose: Pose,
    /// Opening of the gripper, m; 0 where there is none.
    pub(super) opening_m: f64,
}

/// A minimum.
#[derive(Clone, Debug)]
pub(super) struct Fit<const N: usize> {
    pub(super) state: State,
    /// Robust cost, px².
    pub(super) cost: f64,
    /// Inverse of JᵀWJ in m, rad, m per px; the weights are those of the loss.
    pub(super) inverse_information: [[f64; N]; N],
}

/// Where a corner is seen, minus where `state` predicts it, px; none behind the camera.
pub(super) fn residual(
    intrinsics: &Intrinsics,
    state: &State,
    observation: &Observation,
) -> Option<DVec2> {
    let point = state.pose.transform_point(opened(state, observation));
    Some(observation.pixel - project(intrinsics, point)?)
}

/// Searches the nearest minimum of the Huber loss, squared up to `loss_px` from a corner.
///
/// Unknowns are [δt, δθ] (m, rad; `N` = 6) of t = t̂ + δt, R = exp(δθ) R̂, both along the
/// camera's axes, the opening as well (`N` = 7), or δt alone (`N` = 3). None where the corners do not determine them.
pub(super) fn minimise<const N: usize>(
    intrinsics: &Intrinsics,
    observations: &[Observation],
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
                is_small: step.iter().all(|s| s.abs() < CONVERGED),
            })
        },
    )?;
    Some(Fit {
        state: found.state,
        cost: found.cost,
        inverse_information: Cholesky::beyond_rounding(&found.equations.matrix)?.inverse(),
    })
}

/// The corner in the solved frame at the state's opening, m.
fn opened(state: &State, observation: &Observation) -> DVec3 {
    observation.point_m + DVec3::X * (observation.slide * state.opening_m)
}

fn stepped<const N: usize>(state: &State, step: &[f64; N]) -> State {
    State {
        pose: moved(&state.pose, step),
        opening_m: state.opening_m + step.get(6).copied().unwrap_or(0.0),
    }
}

/// Normal equations of the step and the robust cost; none if a corner falls behind the camera.
fn linearise<const N: usize>(
    intrinsics: &Intrinsics,
    observations: &[Observation],
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
            // d (δθ × arm) = δθ · (arm × gradient).
            let turn = arm.cross(gradient);
            let full = [
                gradient.x,
                gradient.y,
                gradient.z,
                turn.x,
                turn.y,
                turn.z,
                gradient.dot(along) * observation.slide,
            ];
            let mut row = [0.0; N];
            row.copy_from_slice(&full[..N]);
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

    fn seen() -> Vec<Observation> {
        (0..8)
            .map(|i| {
                let (f, slide) = (f64::from(i), if i < 4 { -0.5 } else { 0.5 });
                Observation {
                    point_m: DVec3::new(f.sin(), (2.0 * f).cos(), (1.7 * f).sin()) * 0.03,
                    slide,
                    pixel: DVec2::ZERO,
                }
            })
            .map(|o| Observation {
                pixel: -residual(&camera(), &truth(), &o).unwrap(),
                ..o
            })
            .collect()
    }

    #[test]
    fn the_gradient_is_that_of_finite_differences() {
        let observations = seen();
        let at = stepped(&truth(), &[0.004, -0.003, 0.01, 0.02, 0.05, -0.03, 0.01]);
        let loss = 2.0;
        let (equations, _) = linearise::<7>(&camera(), &observations, &at, loss).unwrap();
        for i in 0..7 {
            let cost = |h: f64| {
                let mut step = [0.0; 7];
                step[i] = h;
                linearise::<7>(&camera(), &observations, &stepped(&at, &step), loss)
                    .unwrap()
                    .1
            };
            let slope = (cost(1e-6) - cost(-1e-6)) / 2e-6;
            let ours = -2.0 * equations.vector[i];
            assert!(
                (slope - ours).abs() < 1e-5 * slope.abs().max(1e3),
                "{i}: {slope} {ours}"
            );
        }
    }

    #[test]
    fn pose_and_opening_are_recovered_from_afar() {
        let start = State {
            opening_m: 0.0,
            ..stepped(&truth(), &[0.02, 0.01, 0.05, 0.2, -0.1, 0.2])
        };
        let fit = minimise::<7>(&camera(), &seen(), start, 1e3).unwrap();
        assert!(fit.cost < 1e-16, "{}", fit.cost);
        assert!((fit.state.opening_m - 0.05).abs() < 1e-9);
        let apart = fit.state.pose.translation_m - truth().pose.translation_m;
        assert!(apart.length() < 1e-9, "{apart}");
    }

    #[test]
    fn one_wild_corner_pulls_little_with_a_robust_loss() {
        let mut observations = seen();
        observations[2].pixel += DVec2::new(30.0, -20.0);
        let off = |loss| {
            let fit = minimise::<7>(&camera(), &observations, truth(), loss).unwrap();
            fit.state
                .pose
                .translation_m
                .distance(truth().pose.translation_m)
        };
        assert!(off(0.05) < 0.1 * off(1e3), "{} {}", off(0.05), off(1e3));
    }

    #[test]
    fn an_opening_that_nothing_shows_is_not_invented() {
        let still: Vec<_> = seen()
            .into_iter()
            .map(|o| Observation { slide: 0.0, ..o })
            .collect();
        assert!(minimise::<7>(&camera(), &still, truth(), 1.0).is_none());
    }
}
