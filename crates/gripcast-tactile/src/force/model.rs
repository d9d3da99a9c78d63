//! The learned map from features to force.
//!
//! The normal force over Young's modulus is a sum of products of powers of the features with
//! non-negative weights and exponents, so it grows with every feature and with the load. Poisson's
//! ratio enters through the stiffness of laterally constrained material.

use serde::{Deserialize, Serialize};

use super::features::{ForceFeatures, SkinMotion};
use gripcast_base::error::{Error, Result};
use gripcast_shear::ShearSource;

/// Version of the model file.
const SCHEMA: u32 = 1;
/// The shipped model, as `gripcast-bench force-model` wrote it.
const SHIPPED: &str = include_str!("../../../../calib/force/gelsight-mini.toml");

/// Poisson's ratios for which the model was fitted.
pub const POISSON: [f64; 2] = [0.3, 0.48];

/// A product of powers of the features.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ForceTerm {
    /// Weight, not negative.
    pub weight: f64,
    /// Exponents of the features in the order of [`ForceFeatures::to_array`], not negative.
    pub exponents: [f64; 8],
    /// Exponent of the constrained stiffness over Young's modulus, not negative.
    pub constrained: f64,
}

impl ForceTerm {
    /// The product without the weight.
    #[must_use]
    pub fn product(&self, features: &ForceFeatures, poisson: f64) -> f64 {
        let powers = features.to_array().into_iter().zip(self.exponents);
        let powers = powers.filter(|(_, exponent)| *exponent != 0.0);
        let powers = powers.map(|(value, exponent)| value.max(0.0).powf(exponent));
        constrained_modulus(poisson).powf(self.constrained) * powers.product::<f64>()
    }
}

/// Stiffness of laterally constrained material over Young's modulus.
fn constrained_modulus(poisson: f64) -> f64 {
    (1.0 - poisson) / ((1.0 + poisson) * (1.0 - 2.0 * poisson))
}

/// Residuals of held-out presses.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ForceSpread {
    /// Standard deviation, fraction of the force.
    pub fraction: f64,
    /// Standard deviation without force, over Young's modulus and the square of the gel's thickness.
    pub floor: f64,
}

impl ForceSpread {
    /// Standard deviation of a force, both over Young's modulus and the square of the thickness.
    fn of(&self, force: f64) -> f64 {
        (self.fraction * force).hypot(self.floor)
    }
}

/// Normal force on one kind of gel.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct NormalForce {
    /// Residuals.
    pub spread: ForceSpread,
    /// Terms.
    pub terms: Vec<ForceTerm>,
}

impl NormalForce {
    /// Force over Young's modulus and the square of the gel's thickness.
    #[must_use]
    pub fn of(&self, features: &ForceFeatures, poisson: f64) -> UnitForce<f64> {
        let terms = self.terms.iter();
        let value = terms
            .map(|term| term.weight * term.product(features, poisson))
            .sum();
        UnitForce {
            value,
            std: self.spread.of(value),
        }
    }
}

/// Shear force by what the motion was measured on: force over Young's modulus and the square of the
/// thickness per unit of motion.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ShearTerm {
    /// Weight of the motion for markers; of the motion times the root of the deep area for texture.
    pub weight: f64,
    /// Residuals.
    pub spread: ForceSpread,
}

/// The model of the force on a gel of the size of a GelSight Mini's.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ForceModel {
    /// Version of the file.
    pub schema: u32,
    /// What it was fitted to and how it does on what it has not seen.
    pub provenance: String,
    /// Shear force from gel markers.
    pub marker_shear: ShearTerm,
    /// Shear force from texture.
    pub texture_shear: ShearTerm,
    /// Normal force on gels without markers.
    pub plain: NormalForce,
    /// Normal force on gels with markers.
    pub markers: NormalForce,
}

/// A force over Young's modulus and the square of the gel's thickness, with its standard deviation.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct UnitForce<T> {
    /// The force.
    pub value: T,
    /// Standard deviation from what the model does not explain.
    pub std: f64,
}

impl ForceModel {
    /// The shipped model.
    ///
    /// # Errors
    /// None; a test covers the shipped file.
    pub fn shipped() -> Result<Self> {
        Self::from_toml(SHIPPED)
    }

    /// Reads a model.
    ///
    /// # Errors
    /// `Config` for an invalid one.
    pub fn from_toml(text: &str) -> Result<Self> {
        let model: Self = toml::from_str(text)
            .map_err(|e| Error::config(format!("invalid force model: {}", e.message())))?;
        let is_valid = |term: &ForceTerm| {
            let numbers = term
                .exponents
                .iter()
                .chain([&term.weight, &term.constrained]);
            numbers.into_iter().all(|n| n.is_finite() && *n >= 0.0)
        };
        if model.schema != SCHEMA {
            let what = format!(
                "expected force model version {SCHEMA}, found {}",
                model.schema
            );
            return Err(Error::config(what));
        }
        let kinds = [&model.plain, &model.markers];
        if kinds
            .iter()
            .any(|kind| kind.terms.is_empty() || !kind.terms.iter().all(is_valid))
        {
            let what = "the weights and exponents of a force model must be finite and not negative";
            return Err(Error::config(what));
        }
        Ok(model)
    }

    /// The model as text.
    ///
    /// # Errors
    /// `Internal` if it cannot be written.
    pub fn to_toml(&self) -> Result<String> {
        toml::to_string(self)
            .map_err(|e| Error::internal("cannot write the force model").because(e))
    }

    /// Normal force.
    #[must_use]
    pub fn normal(&self, features: &ForceFeatures, poisson: f64) -> UnitForce<f64> {
        match features.has_markers {
            true => self.markers.of(features, poisson),
            false => self.plain.of(features, poisson),
        }
    }

    /// Shear force along x and y of the image.
    #[must_use]
    pub fn shear(
        &self,
        motion: &SkinMotion,
        features: &ForceFeatures,
        poisson: f64,
    ) -> UnitForce<[f64; 2]> {
        // Shear modulus over Young's modulus.
        let shear_modulus = 0.5 / (1.0 + poisson);
        let (term, size) = match motion.source {
            ShearSource::Markers => (&self.marker_shear, 1.0),
            ShearSource::Texture => (&self.texture_shear, features.deep_area.max(0.0).sqrt()),
        };
        let value = motion
            .motion
            .map(|m| term.weight * shear_modulus * size * m);
        UnitForce {
            value,
            std: term.spread.of(value[0].hypot(value[1])),
        }
    }
}
