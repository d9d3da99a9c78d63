//! Levenberg–Marquardt with the Huber loss (P. J. Huber, *Robust estimation of a location
//! parameter*, 1964): quadratic up to a distance, linear beyond.

use glam::{DQuat, DVec3};

use gripcast_geometry::Pose;

/// Termination criteria.
pub(crate) struct Search {
    pub(crate) max_iterations: usize,
    /// Minimum relative decrease of the cost.
    pub(crate) min_decrease: f64,
    /// Damping at which the search ends with the current state. `None`: a singular system ends the
    /// search without a result.
    pub(crate) max_damping: Option<f64>,
}

/// A trial step.
pub(crate) struct Trial<S> {
    pub(crate) state: S,
    /// Whether the step is below the tolerance.
    pub(crate) is_small: bool,
}

/// Result of a search.
pub(crate) struct Minimum<S, E> {
    pub(crate) state: S,
    /// Equations linearised at `state`.
    pub(crate) equations: E,
    pub(crate) cost: f64,
}

impl Search {
    /// Finds a local minimum from `start`. `linearise` returns the equations of a step and the cost
    /// at a state; `step` solves them with the diagonal multiplied by 1 + damping.
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
            if trial.is_none() && self.max_damping.is_none() {
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
                if is_small || self.max_damping.is_some_and(|max| damping > max) {
                    break;
                }
            }
        }
        Some(best)
    }
}

/// Weight and cost of a residual.
pub(crate) fn huber(length: f64, loss: f64) -> (f64, f64) {
    if length > loss {
        (loss / length, loss * (2.0 * length - loss))
    } else {
        (1.0, length * length)
    }
}

/// Applies a step to a pose: translation (m), then rotation (rad) if the step has one, along the
/// axes of the target frame.
pub(crate) fn moved(pose: &Pose, step: &[f64]) -> Pose {
    let rotation = step.get(3..6).map_or(DQuat::IDENTITY, |rotation| {
        DQuat::from_scaled_axis(DVec3::from_slice(rotation))
    });
    Pose::new(
        rotation * pose.rotation,
        pose.translation_m + DVec3::from_slice(step),
    )
}

/// Jacobian row of [`moved`] for an image gradient (px/m) at a point rotated to `arm` (m).
pub(crate) fn pose_row(gradient: DVec3, arm: DVec3) -> [f64; 6] {
    // d (δθ × arm) = δθ · (arm × gradient).
    let [x, y, z] = gradient.to_array();
    let [rx, ry, rz] = arm.cross(gradient).to_array();
    [x, y, z, rx, ry, rz]
}

/// Angle between the rotations of two poses, rad.
pub(crate) fn angle_between(a: &Pose, b: &Pose) -> f64 {
    let d = a.rotation.conjugate() * b.rotation;
    2.0 * d.xyz().length().atan2(d.w.abs())
}

/// Root mean square; 0 without errors.
pub(crate) fn rms(errors: &[f64]) -> f64 {
    let squares: f64 = errors.iter().map(|e| e * e).sum();
    (squares / errors.len().max(1) as f64).sqrt()
}
