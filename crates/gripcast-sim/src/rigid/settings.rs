//! Parameters of the rigid-body simulator.

use serde::{Deserialize, Serialize};

use crate::fem::GelPad;
use gripcast_base::error::{Error, Result};

/// Parameters of a grasp of rigid bodies. The default is Taxim's set-up.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct RigidSettings {
    /// Distance between the faces from which the fingers close, m. Taxim: 0.09. A grasp with a
    /// wider opening, or without clearance for this one, keeps its own.
    pub opening_m: f64,
    /// Time steps of the closure. Taxim: at most 150.
    pub closing_steps: u32,
    /// Last steps of the closure, recorded as the adjustment: the force has settled by then.
    pub settle_steps: u32,
    /// Maximum finger speed relative to the gripper, m/s. 0.1: from 45 mm to the centre in 108 of
    /// the 150 steps.
    pub closing_speed_m_s: f64,
    /// Position gain: finger speed per metre from the gripper's centre, 1/s. 24: the gain of a
    /// PyBullet motor, 0.1 per step of 1/240 s.
    pub position_gain_per_s: f64,
    /// Decay time of the fingers' common motion along the closing direction, s. Two independent
    /// motors of the same force would let the gripped object float between them; the drive of a
    /// real gripper couples its fingers. 0.05: well within the settling time.
    pub centring_s: f64,
    /// Moving mass of a finger, kg. 0.2: guide and finger of Taxim's WSG 50.
    pub finger_mass_kg: f64,
    /// Control steps of the lift. Taxim: 60.
    pub lift_steps: u32,
    /// Rise of the gripper per control step of the lift, m. Taxim: 0.003.
    pub lift_step_m: f64,
    /// Time steps per control step of the lift: 4, i.e. 0.18 m/s. The lag of Taxim's arm is not
    /// simulated.
    pub lift_ticks: u32,
    /// A grasp succeeds if the object rises by this fraction of the lift. Taxim: 0.8.
    pub success_fraction: f64,
    /// Time step, s. 1/240: PyBullet's.
    pub dt_s: f64,
    /// Gravity, m/s².
    pub gravity_m_s2: f64,
    /// Solver substeps per time step. 8: small enough for the contact stiffness.
    pub solver_substeps: u32,
    /// Natural frequency of the contact springs, Hz. 480, a quarter of the substep rate: at 40 N a
    /// finger sinks 0.1 mm into an object of 50 g; with rapier's default of 30 Hz it would be 20
    /// mm.
    pub contact_frequency_hz: f64,
    /// Damping ratio of the contact springs; above 1 there is no bounce.
    pub contact_damping_ratio: f64,
    /// Contact prediction distance, m. 2 mm: more than two bodies approach in a step.
    pub prediction_m: f64,
    /// Convex decomposition of the object.
    pub decomposition: DecompositionSettings,
    /// Size of the fingers' faces and gels; omitted from JSON for the default pad.
    #[serde(skip_serializing_if = "GelPad::is_default")]
    pub pad: GelPad,
}

impl Default for RigidSettings {
    fn default() -> Self {
        Self {
            opening_m: 0.09,
            closing_steps: 150,
            settle_steps: 20,
            closing_speed_m_s: 0.1,
            position_gain_per_s: 24.0,
            centring_s: 0.05,
            finger_mass_kg: 0.2,
            lift_steps: 60,
            lift_step_m: 0.003,
            lift_ticks: 4,
            success_fraction: 0.8,
            dt_s: 1.0 / 240.0,
            gravity_m_s2: 9.81,
            solver_substeps: 8,
            contact_frequency_hz: 480.0,
            contact_damping_ratio: 5.0,
            prediction_m: 2e-3,
            decomposition: DecompositionSettings::default(),
            pad: GelPad::default(),
        }
    }
}

/// Parameters of the volumetric hierarchical approximate convex decomposition (Mamou, V-HACD).
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct DecompositionSettings {
    /// Bias towards cuts along planes of symmetry. Taxim: 0.06.
    pub alpha: f64,
    /// Bias towards cuts along axes of revolution. Default of V-HACD: 0.05.
    pub beta: f64,
    /// Concavity: pieces are cut until their hull exceeds their volume by less than this fraction
    /// of the whole hull, and merged below it. 0.01: finer cuts only follow the voxels.
    pub concavity: f64,
    /// Voxels along the longest side. 64 corresponds to a V-HACD resolution of about 1e5; the
    /// paper's 1e7 (215) takes minutes.
    pub resolution: u32,
    /// Maximum number of pieces.
    pub max_pieces: u32,
    /// Maximum number of corners of a piece. PyBullet: 64.
    pub max_corners: u32,
    /// Distance from the surface of a piece below which corners are left out, m.
    pub corner_tolerance_m: f64,
}

impl Default for DecompositionSettings {
    fn default() -> Self {
        Self {
            alpha: 0.06,
            beta: 0.05,
            concavity: 0.01,
            resolution: 64,
            max_pieces: 32,
            max_corners: 64,
            corner_tolerance_m: 2e-5,
        }
    }
}

impl RigidSettings {
    /// Height of the lift, m.
    pub fn lift_m(&self) -> f64 {
        f64::from(self.lift_steps) * self.lift_step_m
    }

    /// Minimum rise of the object for success, m.
    pub fn success_rise_m(&self) -> f64 {
        self.success_fraction * self.lift_m()
    }

    /// Speed of the lift, m/s.
    pub(super) fn lift_speed_m_s(&self) -> f64 {
        self.lift_step_m / (f64::from(self.lift_ticks) * self.dt_s)
    }

    /// Checks the range of every parameter.
    ///
    /// # Errors
    /// `Input`, or `Config` for the pad, with the parameter, its value and its range.
    pub fn validate(&self) -> Result<()> {
        self.pad.validate()?;
        let d = &self.decomposition;
        let numbers = [
            ("opening_m", self.opening_m, 0.0, 0.5),
            ("closing_speed_m_s", self.closing_speed_m_s, 1e-4, 2.0),
            ("position_gain_per_s", self.position_gain_per_s, 1e-3, 1e4),
            ("centring_s", self.centring_s, 1e-6, 1e9),
            ("finger_mass_kg", self.finger_mass_kg, 1e-3, 100.0),
            ("lift_step_m", self.lift_step_m, 0.0, 0.1),
            ("success_fraction", self.success_fraction, 0.0, 1.0),
            ("dt_s", self.dt_s, 1e-5, 0.02),
            ("gravity_m_s2", self.gravity_m_s2, 0.0, 100.0),
            ("contact_frequency_hz", self.contact_frequency_hz, 1.0, 1e6),
            (
                "contact_damping_ratio",
                self.contact_damping_ratio,
                0.1,
                1e3,
            ),
            ("prediction_m", self.prediction_m, 1e-5, 0.02),
            ("decomposition.alpha", d.alpha, 0.0, 1.0),
            ("decomposition.beta", d.beta, 0.0, 1.0),
            ("decomposition.concavity", d.concavity, 1e-4, 1.0),
            (
                "decomposition.corner_tolerance_m",
                d.corner_tolerance_m,
                0.0,
                0.01,
            ),
        ];
        for (name, found, min, max) in numbers {
            // Also rejects NaN.
            if !(found >= min && found <= max) {
                return Err(out_of_range(name, found, min, max));
            }
        }
        let counts = [
            ("closing_steps", self.closing_steps, 1, 100_000),
            ("settle_steps", self.settle_steps, 0, self.closing_steps),
            ("lift_steps", self.lift_steps, 1, 100_000),
            ("lift_ticks", self.lift_ticks, 1, 1000),
            ("solver_substeps", self.solver_substeps, 1, 1000),
            ("decomposition.resolution", d.resolution, 8, 512),
            ("decomposition.max_pieces", d.max_pieces, 1, 1024),
            ("decomposition.max_corners", d.max_corners, 4, 4096),
        ];
        for (name, found, min, max) in counts {
            if !(min..=max).contains(&found) {
                return Err(out_of_range(name, found, min, max));
            }
        }
        Ok(())
    }
}

fn out_of_range<T: std::fmt::Display>(name: &str, found: T, min: T, max: T) -> Error {
    Error::input(format!(
        "`{name}` of the rigid simulator must be from {min} to {max}, found {found}"
    ))
    .remedy("omit it to use the default")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn default_settings_are_valid() {
        let settings = RigidSettings::default();
        settings.validate().unwrap();
        assert!((settings.lift_m() - 0.18).abs() < 1e-12);
        assert!((settings.lift_speed_m_s() - 0.18).abs() < 1e-12);
    }

    #[test]
    fn invalid_settings_are_rejected_by_name() {
        let error_text = |change: fn(&mut RigidSettings)| {
            let mut settings = RigidSettings::default();
            change(&mut settings);
            settings.validate().unwrap_err().to_string()
        };
        assert!(error_text(|s| s.dt_s = f64::NAN).contains("dt_s"));
        assert!(error_text(|s| s.settle_steps = 151).contains("0 to 150"));
        assert!(error_text(|s| s.decomposition.resolution = 0).contains("resolution"));
        assert!(error_text(|s| s.finger_mass_kg = 0.0).contains("finger_mass_kg"));
    }

    #[test]
    fn settings_default_if_missing_and_reject_unknown_keys() {
        let settings: RigidSettings = serde_json::from_str(r#"{"lift_ticks": 8}"#).unwrap();
        assert_eq!(settings.lift_ticks, 8);
        assert_eq!(settings.closing_steps, 150);
        assert!(serde_json::from_str::<RigidSettings>(r#"{"lift_tick": 8}"#).is_err());
    }
}
