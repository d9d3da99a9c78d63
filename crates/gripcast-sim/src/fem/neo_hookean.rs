//! Log neo-Hookean law: constants and projection of its tangent.
//!
//! Psi(F) = mu/2 (tr F^T F - 3) - mu ln J + lambda/2 (ln J)^2, J = det F (Bonet and Wood,
//! *Nonlinear Continuum Mechanics for Finite Element Analysis*, eq. 6.28). Psi is infinite for
//! J <= 0. The tangent's eigensystem in closed form follows Smith, De Goes and Kim, *Analytic
//! Eigensystems for Isotropic Distortion Energies* (2019).

use glam::{DMat3, DVec3};

use super::svd::{Svd, symmetric_eigen};
use gripcast_base::error::{Error, Result};

/// Treatment of negative eigenvalues of an element's tangent.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Projection {
    /// None: the exact, possibly indefinite Hessian.
    #[default]
    None,
    /// Set them to zero.
    Clamp,
    /// Take their absolute value.
    Abs,
}

impl Projection {
    /// Correction that projects an eigenvalue.
    pub fn correction(self, eigenvalue: f64) -> f64 {
        self.factor() * (-eigenvalue).max(0.0)
    }

    /// Correction as a multiple of a negative eigenvalue's magnitude.
    pub(super) fn factor(self) -> f64 {
        match self {
            Self::None => 0.0,
            Self::Clamp => 1.0,
            Self::Abs => 2.0,
        }
    }
}

/// Log neo-Hookean law with its Lamé constants in Pa.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct NeoHookean {
    mu: f64,
    lambda: f64,
}

impl NeoHookean {
    /// Creates a law from Young's modulus (Pa) and Poisson's ratio.
    ///
    /// # Errors
    /// `Config` unless the modulus is positive and finite and 0 <= ratio < 0.5.
    pub fn new(young_pa: f64, poisson: f64) -> Result<Self> {
        if !(young_pa > 0.0 && young_pa.is_finite()) {
            return Err(Error::config(format!(
                "Young's modulus must be positive and finite, found {young_pa} Pa"
            )));
        }
        if !(0.0..0.5).contains(&poisson) {
            return Err(Error::config(format!(
                "Poisson's ratio must be at least 0 and below 0.5, found {poisson}"
            ))
            .remedy("use 0.49 for a nearly incompressible gel"));
        }
        Ok(Self {
            mu: young_pa / (2.0 * (1.0 + poisson)),
            lambda: young_pa * poisson / ((1.0 + poisson) * (1.0 - 2.0 * poisson)),
        })
    }

    /// Shear modulus in Pa.
    pub fn mu(&self) -> f64 {
        self.mu
    }

    /// First Lamé constant in Pa.
    pub fn lambda(&self) -> f64 {
        self.lambda
    }

    /// lambda ln J - mu, the derivative of Psi by ln J at fixed tr F^T F.
    fn log_slope(&self, j: f64) -> f64 {
        self.lambda * j.ln() - self.mu
    }

    /// Corrections of the three modes that stretch along the singular directions.
    pub(super) fn scaling_corrections(&self, f: &Svd, projection: Projection) -> [(f64, DMat3); 3] {
        let (values, vectors) = symmetric_eigen(&self.scaling_tangent(f.sigma));
        [0, 1, 2].map(|k| {
            let stretch = DMat3::from_diagonal(vectors.col(k));
            let mode = f.u * stretch * f.v.transpose();
            (projection.correction(values[k]), mode)
        })
    }

    /// d²Psi / ds_i ds_j in the singular values.
    fn scaling_tangent(&self, sigma: DVec3) -> DMat3 {
        let inverse = sigma.recip();
        let slope = self.log_slope(sigma.element_product());
        let diagonal = DVec3::splat(self.mu) - slope * inverse * inverse;
        outer(inverse, inverse) * self.lambda + DMat3::from_diagonal(diagonal)
    }
}

/// a b^T.
pub(crate) fn outer(a: DVec3, b: DVec3) -> DMat3 {
    DMat3::from_cols(a * b.x, a * b.y, a * b.z)
}

#[cfg(test)]
#[path = "neo_hookean_reference.rs"]
mod reference;
#[cfg(test)]
#[path = "neo_hookean_test.rs"]
mod tests;
