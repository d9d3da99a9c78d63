//! Pad and elastic law of a sensor's gel.

use serde::{Deserialize, Serialize};

use super::markers::ElasticLayer;
use super::profile::in_range;
use gripcast_base::error::Result;
use gripcast_sim::solver::GelMaterial;

/// Plausible sides of a pad, m.
const SIZE_M: std::ops::RangeInclusive<f64> = 2e-3..=0.2;
/// Plausible Young's moduli, Pa.
const YOUNG_PA: std::ops::RangeInclusive<f64> = 1e3..=1e8;
/// Poisson's ratios for which the elastic energy is finite.
const POISSON: std::ops::RangeInclusive<f64> = 0.0..=0.499;

/// The gel of a sensor; its thickness is that of the [`SensorGeometry`](super::SensorGeometry).
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct ProfileGel {
    /// Length and width of the pad along the columns and rows of the image, m.
    pub size_m: [f64; 2],
    /// Young's modulus, Pa.
    pub young_pa: f64,
    /// Poisson's ratio.
    pub poisson: f64,
}

impl Default for ProfileGel {
    /// The pad of a GelSight Mini with the simulator's standard gel.
    fn default() -> Self {
        let GelMaterial {
            young_pa, poisson, ..
        } = GelMaterial::default();
        Self {
            size_m: [0.025, 0.020],
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
