//! Log neo-Hookean law: energy density, stress and tangent of one deformation gradient.
//!
//! Psi(F) = mu/2 (tr F^T F - 3) - mu ln J + lambda/2 (ln J)^2, J = det F (Bonet and Wood,
//! *Nonlinear Continuum Mechanics for Finite Element Analysis*, eq. 6.28). It is infinite for
//! J <= 0. The tangent's eigensystem in closed form follows Smith, De Goes and Kim, *Analytic
//! Eigensystems for Isotropic Distortion Energies* (2019).

use glam::{DMat3, DVec3};

use super::svd::{Svd, svd, symmetric_eigen};
use gripcast_base::error::{Error, ErrorKind, Result};

/// What to do with negative eigenvalues of an element's tangent.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Projection {
    /// Nothing: the exact Hessian, perhaps indefinite.
    #[default]
    None,
    /// Set them to zero.
    Clamp,
    /// Take their absolute value.
    Abs,
}

impl Projection {
    /// What has to be added to an eigenvalue to project it.
    #[must_use]
    pub fn correction(self, eigenvalue: f64) -> f64 {
        self.factor() * (-eigenvalue).max(0.0)
    }

    /// Multiple of a negative eigenvalue's size that projects it.
    pub(super) fn factor(self) -> f64 {
        match self {
            Self::None => 0.0,
            Self::Clamp => 1.0,
            Self::Abs => 2.0,
        }
    }
}

/// The two Lamé constants in Pa.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct NeoHookean {
    mu: f64,
    lambda: f64,
}

impl NeoHookean {
    /// From Young's modulus in Pa and Poisson's ratio.
    ///
    /// # Errors
    /// `Config` unless the modulus is positive and finite and 0 <= ratio < 0.5.
    pub fn new(young_pa: f64, poisson: f64) -> Result<Self> {
        if !(young_pa > 0.0 && young_pa.is_finite()) {
            return Err(Error::new(
                ErrorKind::Config,
                format!("Young's modulus must be positive and finite, found {young_pa} Pa"),
            ));
        }
        if !(0.0..0.5).contains(&poisson) {
            return Err(Error::new(
                ErrorKind::Config,
                format!("Poisson's ratio must be at least 0 and below 0.5, found {poisson}"),
            )
            .remedy("use 0.49 for a nearly incompressible gel"));
        }
        Ok(Self {
            mu: young_pa / (2.0 * (1.0 + poisson)),
            lambda: young_pa * poisson / ((1.0 + poisson) * (1.0 - 2.0 * poisson)),
        })
    }

    /// Shear modulus in Pa.
    #[must_use]
    pub fn mu(&self) -> f64 {
        self.mu
    }

    /// First Lamé constant in Pa.
    #[must_use]
    pub fn lambda(&self) -> f64 {
        self.lambda
    }

    /// Energy density in J/m³; infinite for J <= 0 and for what is not a number.
    #[must_use]
    pub fn energy(&self, f: &DMat3) -> f64 {
        let j = f.determinant();
        if j.is_nan() || j <= 0.0 {
            return f64::INFINITY;
        }
        let log_j = j.ln();
        0.5 * self.mu * (squared_norm(f) - 3.0) + log_j * (0.5 * self.lambda * log_j - self.mu)
    }

    /// First Piola-Kirchhoff stress dPsi/dF in Pa; meaningful for J > 0.
    #[must_use]
    pub fn pk1(&self, f: &DMat3) -> DMat3 {
        let j = f.determinant();
        *f * self.mu + cofactor(f) * (self.log_slope(j) / j)
    }

    /// d²Psi/dF² in Pa, entry (3 l + k, 3 j + i) for F(k, l) and F(i, j) (row, column); J > 0.
    #[must_use]
    pub fn hessian(&self, f: &DMat3) -> [[f64; 9]; 9] {
        let j = f.determinant();
        let slope = self.log_slope(j) / j;
        let g = cofactor(f).to_cols_array();
        let curvature = (self.lambda / j - slope) / j;
        let mut h = [[0.0; 9]; 9];
        for (r, row) in h.iter_mut().enumerate() {
            for (c, entry) in row.iter_mut().enumerate() {
                *entry = curvature * g[r] * g[c];
            }
            row[r] += self.mu;
        }
        add_determinant_hessian(f, slope, &mut h);
        h
    }

    /// [`NeoHookean::hessian`] with its negative eigenvalues clamped or turned positive; J > 0.
    ///
    /// Six eigenpairs (twists and flips) are known in closed form, the other three follow from a
    /// 3x3 matrix that can only be indefinite once the volume has grown.
    #[must_use]
    pub fn projected_hessian(&self, f: &DMat3, projection: Projection) -> [[f64; 9]; 9] {
        let mut h = self.hessian(f);
        if projection == Projection::None {
            return h;
        }
        let modes = svd(f);
        for (weight, mode) in self.shear_corrections(&modes, projection) {
            add_outer(&mut h, weight, &mode);
        }
        for (weight, mode) in self.scaling_corrections(&modes, projection) {
            add_outer(&mut h, weight, &mode);
        }
        h
    }

    /// lambda ln J - mu, the derivative of Psi by ln J at fixed tr F^T F.
    fn log_slope(&self, j: f64) -> f64 {
        self.lambda * j.ln() - self.mu
    }

    /// Twist and flip modes: eigenvalues mu -+ c / (s_i s_j), c = lambda ln J - mu. Of each pair
    /// only the lower can be negative: the twist for c < 0, the flip for c > 0.
    fn shear_corrections(&self, f: &Svd, projection: Projection) -> [(f64, DMat3); 3] {
        let slope = self.log_slope(f.sigma.element_product());
        let sign = 1.0_f64.copysign(slope);
        [(0, 1), (0, 2), (1, 2)].map(|(i, j)| {
            let eigenvalue = self.mu - slope.abs() / (f.sigma[i] * f.sigma[j]);
            let mode = outer(f.u.col(i), f.v.col(j)) + outer(f.u.col(j), f.v.col(i)) * sign;
            (0.5 * projection.correction(eigenvalue), mode)
        })
    }

    /// The three modes that stretch along the singular directions.
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

/// Sum of squares of the entries.
fn squared_norm(f: &DMat3) -> f64 {
    f.x_axis.length_squared() + f.y_axis.length_squared() + f.z_axis.length_squared()
}

/// dJ/dF = J F^-T.
fn cofactor(f: &DMat3) -> DMat3 {
    DMat3::from_cols(
        f.y_axis.cross(f.z_axis),
        f.z_axis.cross(f.x_axis),
        f.x_axis.cross(f.y_axis),
    )
}

/// a b^T.
pub(super) fn outer(a: DVec3, b: DVec3) -> DMat3 {
    DMat3::from_cols(a * b.x, a * b.y, a * b.z)
}

/// Adds scale d²J/dF²: the block of columns j and j + 1 is the cross product with column j + 2.
fn add_determinant_hessian(f: &DMat3, scale: f64, h: &mut [[f64; 9]; 9]) {
    for j in 0..3 {
        let (l, w) = ((j + 1) % 3, f.col((j + 2) % 3) * scale);
        let cross = [[0.0, -w.z, w.y], [w.z, 0.0, -w.x], [-w.y, w.x, 0.0]];
        for (r, row) in cross.iter().enumerate() {
            for (c, entry) in row.iter().enumerate() {
                h[3 * l + r][3 * j + c] += entry;
                h[3 * j + c][3 * l + r] += entry;
            }
        }
    }
}

fn add_outer(h: &mut [[f64; 9]; 9], weight: f64, mode: &DMat3) {
    if weight == 0.0 {
        return;
    }
    let m = mode.to_cols_array();
    for (row, a) in h.iter_mut().zip(m) {
        for (entry, b) in row.iter_mut().zip(m) {
            *entry += weight * a * b;
        }
    }
}

#[cfg(test)]
#[path = "neo_hookean_test.rs"]
mod tests;
