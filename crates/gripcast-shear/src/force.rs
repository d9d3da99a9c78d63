//! Force on a gel, as it is shown and stored.

use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

/// Force that a contact exerts on one gel, estimated from its image. Axes are those of the image: x
/// right, y down.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct FingerForce {
    /// Normal force, N.
    pub normal_n: f64,
    /// Standard deviation of the normal force, N.
    pub normal_std_n: f64,
    /// Shear force along x and y, N; `None` where the motion of the skin is unknown.
    pub shear_n: Option<[f64; 2]>,
    /// Standard deviation of the shear force, N.
    pub shear_std_n: Option<f64>,
    /// Whether known weights calibrated the sensor; else the stiffness is that of the sensor
    /// profile's gel, and the newtons are those of such a gel.
    pub is_calibrated: bool,
}

impl FingerForce {
    /// Whether all numbers are finite; JSON has no others.
    #[must_use]
    pub fn is_finite(&self) -> bool {
        let shear = self.shear_n.into_iter().flatten().chain(self.shear_std_n);
        let normal = [self.normal_n, self.normal_std_n];
        normal.into_iter().chain(shear).all(f64::is_finite)
    }

    /// The normal force in a few words: `12.3 N ± 2`, with `uncalibrated` where no weights were
    /// used.
    #[must_use]
    pub fn words(&self) -> String {
        let std = self.normal_std_n;
        let about = if std < 0.95 {
            format!("{std:.1}")
        } else {
            format!("{std:.0}")
        };
        let doubt = if self.is_calibrated {
            ""
        } else {
            " uncalibrated"
        };
        format!("{:.1} N ± {about}{doubt}", self.normal_n)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn force_is_told_with_its_uncertainty_and_whether_it_is_calibrated() {
        let force = FingerForce {
            normal_n: 12.34,
            normal_std_n: 2.1,
            shear_n: None,
            shear_std_n: None,
            is_calibrated: true,
        };
        assert_eq!(force.words(), "12.3 N ± 2");
        let unknown = FingerForce {
            normal_std_n: 0.42,
            is_calibrated: false,
            ..force
        };
        assert_eq!(unknown.words(), "12.3 N ± 0.4 uncalibrated");
        assert!(unknown.is_finite());
        let lost = FingerForce {
            shear_n: Some([0.0, f64::NAN]),
            ..force
        };
        assert!(!lost.is_finite());
    }
}
