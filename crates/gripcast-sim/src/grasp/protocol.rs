//! Protocol of the paper (§3.1): finger closure, force adjustment, lift.

use serde::{Deserialize, Serialize};

use gripcast_base::error::{Error, Result};

/// Force controller of the fingers.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum ForceRule {
    /// The paper's: open at the adjustment speed while the mean force exceeds the stopping force,
    /// close otherwise. The force cycles by one step.
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

    /// Motion of each finger towards the other in the next step, m.
    pub(super) fn adjustment(&self, mean_force_n: f64, dt: f64) -> f64 {
        let max = self.adjust_speed_m_s * dt;
        match self.rule {
            ForceRule::BangBang if mean_force_n > self.stop_force_n => -max,
            ForceRule::BangBang => max,
            ForceRule::Proportional { gain_m_per_n } => {
                (gain_m_per_n * (self.stop_force_n - mean_force_n)).clamp(-max, max)
            }
        }
    }
}
