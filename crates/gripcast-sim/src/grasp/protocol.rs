//! Protocol of the paper (§3.1): finger closure, force adjustment, lift.

use serde::{Deserialize, Serialize};

use super::run::MIN_CONTACT_FORCE_N;
use gripcast_base::error::{Error, Result};

/// Force change per step, as a fraction of the stopping force, above which steps are shortened.
const COARSE_STEP: f64 = 0.5;
/// Smallest force change of a shortened step, as a fraction of the stopping force.
const FINE_STEP: f64 = 0.1;

/// Force controller of the fingers.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum ForceRule {
    /// The paper's: open at the adjustment speed while the mean force exceeds the stopping force,
    /// close otherwise. The force cycles by one step. Where a step would change the force by more
    /// than half the stopping force, it is shortened by the measured stiffness to what the force
    /// lacks, but at least to a tenth of the stopping force.
    BangBang,
    /// Speed proportional to the force error, at most the adjustment speed.
    Proportional {
        /// Finger motion per step and newton of force error, m/N. Stable below twice the compliance
        /// of a gel's contact.
        gain_m_per_n: f64,
    },
}

/// Speeds, durations and thresholds of a grasp; the defaults are the paper's.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Protocol {
    /// Closing speed of each finger, m/s.
    pub closing_speed_m_s: f64,
    /// Stopping force per finger at which closure ends, N.
    pub stop_force_n: f64,
    /// Speed of each finger in the adjustment, m/s.
    pub adjust_speed_m_s: f64,
    /// Duration of the adjustment, s.
    pub adjust_s: f64,
    /// Lifting speed, m/s.
    pub lift_speed_m_s: f64,
    /// Height of the lift, m.
    pub lift_m: f64,
    /// Height that every point of the object must exceed at the end for success, m.
    pub success_height_m: f64,
    /// Force controller in adjustment and lift.
    pub rule: ForceRule,
    /// Whether the lift ends as soon as the outcome is certain ([`super::LiftMonitor`]).
    #[serde(skip_serializing_if = "is_false")]
    pub early_end: bool,
}

fn is_false(value: &bool) -> bool {
    !value
}

impl ForceRule {
    /// Gain of [`Self::Proportional`] unless another is given, m/N.
    pub const GAIN_M_PER_N: f64 = 5e-6;
}

impl Default for Protocol {
    fn default() -> Self {
        Self {
            closing_speed_m_s: 0.01,
            stop_force_n: 40.0,
            adjust_speed_m_s: 0.002,
            adjust_s: 1.5,
            lift_speed_m_s: 0.02,
            lift_m: 0.05,
            success_height_m: 0.02,
            rule: ForceRule::BangBang,
            early_end: false,
        }
    }
}

impl Protocol {
    /// Checks the range of every parameter.
    ///
    /// # Errors
    /// `Config`, with the parameter and its value.
    pub fn validate(&self) -> Result<()> {
        let mut positive = vec![
            ("closing_speed_m_s", self.closing_speed_m_s),
            ("stop_force_n", self.stop_force_n),
            ("adjust_speed_m_s", self.adjust_speed_m_s),
            ("adjust_s", self.adjust_s),
            ("lift_speed_m_s", self.lift_speed_m_s),
            ("lift_m", self.lift_m),
            ("success_height_m", self.success_height_m),
        ];
        if let ForceRule::Proportional { gain_m_per_n } = self.rule {
            positive.push(("gain_m_per_n", gain_m_per_n));
        }
        for (name, value) in positive {
            if !(value.is_finite() && value > 0.0) {
                return Err(Error::config(format!(
                    "`{name}` must be a number above 0, found {value}"
                )));
            }
        }
        Ok(())
    }

    /// Motion of each finger towards the other in the next step, m; `stiffness_n_m` is the force
    /// per finger motion.
    pub(super) fn adjustment(&self, mean_force_n: f64, stiffness_n_m: f64, dt: f64) -> f64 {
        let max = self.adjust_speed_m_s * dt;
        let missing_n = self.stop_force_n - mean_force_n;
        match self.rule {
            ForceRule::BangBang => {
                let is_fine = self.resolves_force(stiffness_n_m, dt);
                let is_loose = mean_force_n < MIN_CONTACT_FORCE_N;
                let step = if is_fine || is_loose {
                    max
                } else {
                    let change_n = missing_n.abs().max(FINE_STEP * self.stop_force_n);
                    max.min(change_n / stiffness_n_m)
                };
                if missing_n < 0.0 { -step } else { step }
            }
            ForceRule::Proportional { gain_m_per_n } => (gain_m_per_n * missing_n).clamp(-max, max),
        }
    }

    /// Whether a step at the adjustment speed changes the force by at most half the stopping force.
    pub(super) fn resolves_force(&self, stiffness_n_m: f64, dt: f64) -> bool {
        stiffness_n_m * self.adjust_speed_m_s * dt <= COARSE_STEP * self.stop_force_n
    }

    /// Force of one controller step, N: of a step at the adjustment speed, or of a shortened one.
    pub(super) fn step_force_n(&self, stiffness_n_m: f64, dt: f64) -> f64 {
        match self.rule {
            ForceRule::BangBang if !self.resolves_force(stiffness_n_m, dt) => {
                2.0 * FINE_STEP * self.stop_force_n
            }
            _ => stiffness_n_m * self.adjust_speed_m_s * dt,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const DT_S: f64 = 0.01;
    /// Of both gels on a flat face.
    const STIFFNESS_N_M: f64 = 1.35e5;

    #[test]
    fn paper_forces_keep_the_paper_rule() {
        for stop_force_n in [10.0, 20.0, 40.0, 80.0] {
            let protocol = Protocol {
                stop_force_n,
                ..Protocol::default()
            };
            for force in [0.0, 0.9, 0.999, 1.001, 1.5].map(|f| f * stop_force_n) {
                let by = protocol.adjustment(force, STIFFNESS_N_M, DT_S);
                assert_eq!(by.abs(), 2e-5);
                assert_eq!(by < 0.0, force > stop_force_n);
            }
        }
    }

    #[test]
    fn small_forces_are_resolved() {
        let protocol = Protocol {
            stop_force_n: 0.5,
            ..Protocol::default()
        };
        // A spring with an unknown offset, first pressed far too much.
        let (mut opening, mut forces) = (-1e-4, Vec::new());
        for _ in 0..60 {
            let force = f64::max(0.0, -STIFFNESS_N_M * opening);
            forces.push(force);
            opening -= protocol.adjustment(force, STIFFNESS_N_M, DT_S);
        }
        let last = &forces[40..];
        assert!(last.iter().all(|f| (f - 0.5).abs() <= 0.06), "{last:?}");
        let band = protocol.step_force_n(STIFFNESS_N_M, DT_S);
        assert!((band - 0.1).abs() < 1e-12, "{band}");
    }
}
