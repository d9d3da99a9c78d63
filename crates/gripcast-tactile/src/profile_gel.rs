//! Pad and elastic law of a sensor's gel.

use serde::{Deserialize, Serialize};

use super::markers::ElasticLayer;
use super::profile::{SensorProfile, in_range};
use gripcast_base::error::{Error, Result};
use gripcast_sim::fem::{GelGrid, GelPad};
use gripcast_sim::solver::GelMaterial;

/// Plausible sides of a pad, m.
const SIZE_M: std::ops::RangeInclusive<f64> = 2e-3..=0.2;
/// Plausible Young's moduli, Pa.
const YOUNG_PA: std::ops::RangeInclusive<f64> = 1e3..=1e8;
/// Poisson's ratios for which the elastic energy is finite.
const POISSON: std::ops::RangeInclusive<f64> = 0.0..=0.499;

/// Difference of the sizes of equal pads, m.
const SAME_SIZE_M: f64 = 1e-6;

/// The gel of a sensor; its thickness is that of the [`SensorGeometry`](super::SensorGeometry).
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct ProfileGel {
    /// Length and width of the pad along x and y of the gel frame, the columns and rows of the image
    /// of a sensor mounted at 0°, m.
    pub size_m: [f64; 2],
    /// Young's modulus, Pa.
    pub young_pa: f64,
    /// Poisson's ratio.
    pub poisson: f64,
}

impl SensorProfile {
    /// Pad of the gel, for the simulator.
    #[must_use]
    pub fn pad(&self) -> GelPad {
        self.gel.pad(self.geometry.gel_thickness_m)
    }

    /// Material of the gel, for the simulator.
    #[must_use]
    pub fn gel_material(&self) -> GelMaterial {
        GelMaterial {
            young_pa: self.gel.young_pa,
            poisson: self.gel.poisson,
            ..GelMaterial::default()
        }
    }

    /// Checks that a simulated gel is the pad of this sensor.
    ///
    /// # Errors
    /// `Input` with both sizes.
    pub fn check_pad(&self, simulated: &GelGrid) -> Result<()> {
        self.gel.check_pad(self.geometry.gel_thickness_m, simulated)
    }
}

impl Default for ProfileGel {
    /// The pad of a GelSight Mini with the simulator's standard gel.
    fn default() -> Self {
        let GelMaterial {
            young_pa, poisson, ..
        } = GelMaterial::default();
        Self {
            size_m: GelPad::default().size_m,
            young_pa,
            poisson,
        }
    }
}

impl ProfileGel {
    /// Checks all values.
    ///
    /// # Errors
    /// `Config` with the key, the expected and the found value.
    pub(super) fn validate(&self) -> Result<()> {
        for size_m in self.size_m {
            in_range("gel.size_m", size_m, SIZE_M)?;
        }
        in_range("gel.young_pa", self.young_pa, YOUNG_PA)?;
        in_range("gel.poisson", self.poisson, POISSON)
    }

    /// Checks that a simulated gel is the pad of this profile, whose thickness is `thickness_m`.
    ///
    /// # Errors
    /// `Input` with both sizes.
    fn check_pad(&self, thickness_m: f64, simulated: &GelGrid) -> Result<()> {
        let (found, expected) = (simulated.pad().box_m(), self.pad(thickness_m).box_m());
        let same = |(a, b): (&f64, &f64)| (a - b).abs() <= SAME_SIZE_M;
        if found.iter().zip(&expected).all(same) {
            return Ok(());
        }
        let mm = |size: [f64; 3]| {
            let [x, y, z] = size.map(|m| 1e3 * m);
            format!("{x:.1} × {y:.1} × {z:.1} mm")
        };
        Err(Error::input(format!(
            "the trace has a gel of {}, the sensor profile one of {}",
            mm(found),
            mm(expected)
        ))
        .remedy("render with the profile that was simulated, or simulate the grasp with this one"))
    }

    fn pad(&self, thickness_m: f64) -> GelPad {
        GelPad {
            size_m: self.size_m,
            thickness_m,
        }
    }

    /// The gel as an elastic layer.
    pub(super) fn layer(&self, thickness_m: f64) -> ElasticLayer {
        ElasticLayer {
            thickness_m,
            young_pa: self.young_pa,
            poisson: self.poisson,
            size_m: self.size_m,
        }
    }
}
