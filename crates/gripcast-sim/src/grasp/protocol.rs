//! The three stages of the paper (§3.1): finger closure, force adjustment, lift.

use serde::{Deserialize, Serialize};

use gripcast_base::error::{Error, Result};

/// How the fingers follow the force.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum ForceRule {
    /// The paper's: open at the adjustment speed while the mean force is above the threshold,
    /// close otherwise. It cycles by one step.
    BangBang,
    /// Speed in proportion to what is missing, at most the adjustment speed.
    Proportional {
        /// Motion of each finger for each newton that is missing, m/N. Stable below twice the
        /// compliance of a gel's contact.
        gain_m_per_n: f64,
    },
}

/// Speeds, durations and thresholds of a grasp. The defaults are the paper's.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Protocol {
    /// Closing speed of each finger, m/s.
    pub closing_speed_m_s: f64,
    /// Force of both gels at which closing ends, N.
    pub stop_force_n: f64,
    /// Speed of each finger in the adjustment, m/s.
    pub adjust_speed_m_s: f64,
    /// Duration of the adjustment, s.
    pub adjust_s: f64,
    /// Lifting speed, m/s.
    pub lift_speed_m_s: f64,
    /// Height of the lift, m.
    pub lift_m: f64,
    /// Success is when every point of the object is above this at the end, m.
    pub success_height_m: f64,
    /// How the fingers follow the force in adjustment and lift.
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
    /// Checks that every number can be computed with.
    ///
    /// # Errors
    /// [`ErrorKind::Config`] naming the parameter and what was found.
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

    /// Motion of each finger towards the other in one step, m.
    pub(super) fn adjustment(&self, mean_force_n: f64, dt: f64) -> f64 {
        let largest = self.adjust_speed_m_s * dt;
        match self.rule {
            ForceRule::BangBang if mean_force_n > self.stop_force_n => -largest,
            ForceRule::BangBang => largest,
            ForceRule::Proportional { gain_m_per_n } => {
                (gain_m_per_n * (self.stop_force_n - mean_force_n)).clamp(-largest, largest)
            }
        }
    }
}
