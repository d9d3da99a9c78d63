//! Parameters of the solver.

use serde::{Deserialize, Serialize};

use crate::contact::barrier::Barrier;
use gripcast_base::error::{Error, Result};

/// Parameters of a time step, besides the scene.
///
/// The defaults are those of the paper (§3.1); values it does not give were tuned by measurement.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct SolverParameters {
    /// Time step, s.
    pub dt_s: f64,
    /// Stiffness of the contact barrier, Pa.
    pub kappa_pa: f64,
    /// Distance below which contact acts, m.
    pub d_hat_m: f64,
    /// Relative speed below which friction is mollified, m/s.
    pub eps_v_m_s: f64,
    /// Newton convergence tolerance: maximum nodal speed within an iteration, m/s.
    pub newton_tolerance_m_s: f64,
    /// Iteration limit of a step; beyond it the step has not converged.
    pub max_iterations: u32,
    /// Iteration limit of a whole grasp; beyond it the grasp has not converged. The slowest of 900
    /// hard grasps on the default mesh took 7,300.
    pub max_grasp_iterations: u64,
    /// Gravity on the object along the world's z axis, m/s². The gels weigh 2 g; gravity does not
    /// act on them.
    pub gravity_m_s2: f64,
    /// Stiffness that keeps the object rigid, Pa.
    pub affine_stiffness_pa: f64,
    /// Broad-phase margin: candidate pairs are built up to this distance beyond `d_hat_m`, m.
    pub candidate_margin_m: f64,
    /// L-BFGS memory; 0 is Newton with a stale matrix.
    pub memory: usize,
    /// Iterations after which the stiffness is refactorised; 1 is Newton.
    pub max_factor_age: u32,
    /// Fraction of each distance that continuous collision detection preserves.
    pub ccd_slack: f64,
}

impl Default for SolverParameters {
    fn default() -> Self {
        Self {
            dt_s: 0.01,
            kappa_pa: 3e6,
            d_hat_m: 5e-4,
            eps_v_m_s: 1e-3,
            newton_tolerance_m_s: 1e-4,
            max_iterations: 200,
            max_grasp_iterations: 50_000,
            gravity_m_s2: -9.81,
            affine_stiffness_pa: 1e9,
            candidate_margin_m: 4e-4,
            memory: 8,
            max_factor_age: 20,
            ccd_slack: 0.1,
        }
    }
}

impl SolverParameters {
    /// The barrier between gels, object and ground.
    pub fn barrier(&self) -> Barrier {
        Barrier {
            kappa: self.kappa_pa,
            d_hat: self.d_hat_m,
        }
    }

    /// Checks the range of every parameter.
    ///
    /// # Errors
    /// `Config`, with the parameter, its value and its range.
    pub fn validate(&self) -> Result<()> {
        let positive = [
            ("dt_s", self.dt_s),
            ("kappa_pa", self.kappa_pa),
            ("d_hat_m", self.d_hat_m),
            ("eps_v_m_s", self.eps_v_m_s),
            ("newton_tolerance_m_s", self.newton_tolerance_m_s),
            ("affine_stiffness_pa", self.affine_stiffness_pa),
            ("candidate_margin_m", self.candidate_margin_m),
            ("ccd_slack", self.ccd_slack),
        ];
        for (name, value) in positive {
            if !(value.is_finite() && value > 0.0) {
                return Err(invalid(name, value, "a number above 0"));
            }
        }
        if !self.gravity_m_s2.is_finite() {
            return Err(invalid("gravity_m_s2", self.gravity_m_s2, "a number"));
        }
        if self.ccd_slack >= 1.0 {
            return Err(invalid("ccd_slack", self.ccd_slack, "a number below 1"));
        }
        if self.max_iterations == 0 || self.max_grasp_iterations == 0 || self.max_factor_age == 0 {
            return Err(Error::config(
                "`max_iterations`, `max_grasp_iterations` and `max_factor_age` must be at least 1, \
                 found 0",
            ));
        }
        Ok(())
    }
}

fn invalid(name: &str, value: f64, expected: &str) -> Error {
    Error::config(format!("`{name}` must be {expected}, found {value}"))
}

#[cfg(test)]
#[path = "parameters_test.rs"]
mod tests;
