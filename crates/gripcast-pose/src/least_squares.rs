//! Levenberg–Marquardt with Huber's loss (P. J. Huber, *Robust estimation of a location parameter*,
//! 1964): squared up to a distance, linear beyond.

use glam::{DQuat, DVec3};

use gripcast_geometry::Pose;

/// When a search ends.
pub(crate) struct Search {
    pub(crate) max_iterations: usize,
    /// Relative decrease of the cost that ends it.
    pub(crate) min_decrease: f64,
    /// Damping beyond which it ends where it is; `None` if a system without solution ends it
    /// without a result.
    pub(crate) largest_damping: Option<f64>,
}

/// A step that was tried.
pub(crate) struct Trial<S> {
    pub(crate) state: S,
    /// It is too small to change anything.
    pub(crate) is_small: bool,
}

/// A minimum.
pub(crate) struct Minimum<S, E> {
    pub(crate) state: S,
    /// Linearised there.
    pub(crate) equations: E,
    pub(crate) cost: f64,
}

impl Search {
    /// Searches the nearest minimum. `linearise` gives the equations of a step and the cost of a
    /// state; `step` solves them for a damping, by which it multiplies the diagonal.
    pub(crate) fn minimise<S, E>(
        &self,
        start: S,
        linearise: impl Fn(&S) -> Option<(E, f64)>,
        step: impl Fn(&S, &E, f64) -> Option<Trial<S>>,
    ) -> Option<Minimum<S, E>> {
        let (equations, cost) = linearise(&start)?;
        let mut best = Minimum {
            state: start,
            equations,
            cost,
        };
        let mut damping = 1e-4;
        for _ in 0..self.max_iterations {
            let trial = step(&best.state, &best.equations, damping);
            if trial.is_none() && self.largest_damping.is_none() {
                return None;
            }
            let is_small = trial.as_ref().is_some_and(|trial| trial.is_small);
            let next = trial.and_then(|trial| {
                let (equations, cost) = linearise(&trial.state)?;
                let state = trial.state;
                (cost <= best.cost).then_some(Minimum {
                    state,
                    equations,
                    cost,
                })
            });
            if let Some(next) = next {
                let decrease = best.cost - next.cost;
                let is_done = decrease <= self.min_decrease * best.cost || is_small;
                best = next;
                damping = (damping * 0.1).max(1e-12);
                if is_done {
                    break;
                }
            } else {
                damping *= 10.0;
                if is_small || self.largest_damping.is_some_and(|most| damping > most) {
                    break;
                }
            }
        }
        Some(best)
    }
}

/// Weight and cost of a residual of this length.
pub(crate) fn huber(length: f64, loss: f64) -> (f64, f64) {
    if length > loss {
        (loss / length, loss * (2.0 * length - loss))
    } else {
        (1.0, length * length)
    }
}

/// A pose after a step: shift (m), then turn (rad), if there is one, along the axes of the frame
/// that it maps to.
pub(crate) fn moved(pose: &Pose, step: &[f64]) -> Pose {
    let turn = step.get(3..6).map_or(DQuat::IDENTITY, |turn| {
        DQuat::from_scaled_axis(DVec3::from_slice(turn))
    });
    Pose::new(
        turn * pose.rotation,
        pose.translation_m + DVec3::from_slice(step),
    )
}
