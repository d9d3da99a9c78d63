//! Kinetic term and shape energy of an affine body, with gradients and Hessians (Lan et al.,
//! *Affine Body Dynamics*, 2022).
//!
//! q = (p, A) with X relative to the centre of mass decouples translation and shape in the mass
//! matrix.

use glam::{DMat3, DVec3};

use super::state::AffineState;
use super::{Matrix12, Vector12};
use crate::fem::{Projection, outer, svd, symmetric_eigen};
use gripcast_base::error::{Error, Result};

/// Mass and stiffness constants of an affine body.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct AffineBody {
    mass_kg: f64,
    volume_m3: f64,
    second_moment: DMat3,
    stiffness_pa: f64,
}

impl AffineBody {
    /// Creates a body from mass (kg), volume (m³), second moment of volume about the centre of mass
    /// (∫ X Xᵀ dV, m⁵) and the modulus that preserves its shape (Pa, typically 1e9).
    ///
    /// # Errors
    /// `Input` unless mass, volume and modulus are positive and finite and the second moment is
    /// symmetric positive definite.
    pub fn new(
        mass_kg: f64,
        volume_m3: f64,
        volume_second_moment: DMat3,
        stiffness_pa: f64,
    ) -> Result<Self> {
        let named = [
            ("mass", mass_kg),
            ("volume", volume_m3),
            ("modulus", stiffness_pa),
        ];
        if let Some((name, value)) = named.iter().find(|(_, v)| !(*v > 0.0 && v.is_finite())) {
            let what = format!("the object's {name} must be positive and finite, found {value}");
            return Err(Error::input(what));
        }
        let skew = volume_second_moment - volume_second_moment.transpose();
        let largest = volume_second_moment
            .to_cols_array()
            .into_iter()
            .fold(0.0, |m: f64, v| m.max(v.abs()));
        let is_symmetric = skew.abs_diff_eq(DMat3::ZERO, 1e-9 * largest);
        let (values, _) = symmetric_eigen(&volume_second_moment);
        let is_definite = values.is_finite() && values.min_element() > 1e-12 * values.max_element();
        if !(is_symmetric && is_definite) {
            return Err(Error::input(format!(
                "the object's second moment must be symmetric positive definite, found \
                 {volume_second_moment}"
            ))
            .remedy("use a closed mesh whose triangles all face outwards"));
        }
        Ok(Self {
            mass_kg,
            volume_m3,
            second_moment: volume_second_moment * (mass_kg / volume_m3),
            stiffness_pa,
        })
    }

    /// Mass in kg.
    pub fn mass_kg(&self) -> f64 {
        self.mass_kg
    }

    /// Volume in m³.
    pub fn volume_m3(&self) -> f64 {
        self.volume_m3
    }

    /// Second moment of mass S in kg m², about the centre of mass, in the material frame.
    pub fn second_moment(&self) -> &DMat3 {
        &self.second_moment
    }

    /// Kinetic term 1/2 m |p - p^|² + 1/2 tr((A - A^) S (A - A^)^T) in kg m².
    pub fn kinetic(&self, state: &AffineState, inertial: &AffineState) -> f64 {
        let (p, a) = (state.p - inertial.p, state.a - inertial.a);
        let shape: f64 = (0..3)
            .map(|j| a.col(j).dot(a * self.second_moment.col(j)))
            .sum();
        0.5 * (self.mass_kg * p.length_squared() + shape)
    }

    /// Adds `scale` times the kinetic term's gradient.
    pub fn add_kinetic_gradient(
        &self,
        state: &AffineState,
        inertial: &AffineState,
        scale: f64,
        gradient: &mut Vector12,
    ) {
        let a = state.a - inertial.a;
        add_at(gradient, 0, (state.p - inertial.p) * (scale * self.mass_kg));
        for j in 0..3 {
            add_at(gradient, 3 + 3 * j, a * self.second_moment.col(j) * scale);
        }
    }

    /// Adds `scale` times the kinetic term's Hessian, diag(m, S) times the 3x3 identity.
    pub fn add_kinetic_hessian(&self, scale: f64, hessian: &mut Matrix12) {
        for axis in 0..3 {
            hessian[axis][axis] += scale * self.mass_kg;
            for j in 0..3 {
                for k in 0..3 {
                    hessian[3 + 3 * j + axis][3 + 3 * k + axis] +=
                        scale * self.second_moment.col(k)[j];
                }
            }
        }
    }

    /// Shape energy V E/8 |A^T A - I|² in J.
    pub fn shape(&self, a: &DMat3) -> f64 {
        let strain = a.transpose() * *a - DMat3::IDENTITY;
        let squares: f64 = strain.to_cols_array().iter().map(|e| e * e).sum();
        self.shape_factor() * squares
    }

    /// Adds `scale` times the shape energy's gradient, V E/2 A (A^T A - I), on A's columns.
    pub fn add_shape_gradient(&self, a: &DMat3, scale: f64, gradient: &mut Vector12) {
        let strain = a.transpose() * *a - DMat3::IDENTITY;
        let slope = *a * strain * (4.0 * scale * self.shape_factor());
        for j in 0..3 {
            add_at(gradient, 3 + 3 * j, slope.col(j));
        }
    }

    /// Adds `scale` times the shape energy's Hessian, exact or projected.
    pub fn add_shape_hessian(
        &self,
        a: &DMat3,
        projection: Projection,
        scale: f64,
        hessian: &mut Matrix12,
    ) {
        let k = 4.0 * scale * self.shape_factor();
        let left = *a * a.transpose();
        for i in 0..3 {
            for j in 0..3 {
                let same = if i == j { 1.0 } else { 0.0 };
                let strain = a.col(i).dot(a.col(j)) - same;
                let block = DMat3::from_diagonal(DVec3::splat(strain))
                    + outer(a.col(j), a.col(i))
                    + left * same;
                add_block(hessian, 3 + 3 * i, 3 + 3 * j, &(block * k));
            }
        }
        if projection != Projection::None {
            add_corrections(a, k, projection, hessian);
        }
    }

    fn shape_factor(&self) -> f64 {
        self.volume_m3 * self.stiffness_pa / 8.0
    }
}

/// Adds corrections of the negative modes. In singular values s the eigenvalues are k (s_i² - s_i
/// s_j + s_j² - 1) for twists, k (s_i² + s_i s_j + s_j² - 1) for flips, k (3 s_i² - 1) for
/// stretches (Smith, De Goes and Kim 2019 for this energy). Twists need the signs of a reflected A,
/// which U carries.
fn add_corrections(a: &DMat3, k: f64, projection: Projection, hessian: &mut Matrix12) {
    let parts = svd(a);
    let (u, s, v) = (parts.u, parts.sigma, parts.v);
    for i in 0..3 {
        let stretch = outer(u.col(i), v.col(i));
        add_mode(
            hessian,
            projection.correction(k * (3.0 * s[i] * s[i] - 1.0)),
            &stretch,
        );
    }
    for (i, j) in [(0, 1), (0, 2), (1, 2)] {
        let (squares, product) = (s[i] * s[i] + s[j] * s[j] - 1.0, s[i] * s[j]);
        for sign in [1.0, -1.0] {
            let mode = outer(u.col(i), v.col(j)) + outer(u.col(j), v.col(i)) * sign;
            let correction = projection.correction(k * (squares + sign * product));
            add_mode(hessian, 0.5 * correction, &mode);
        }
    }
}

fn add_at(gradient: &mut Vector12, start: usize, v: DVec3) {
    for axis in 0..3 {
        gradient[start + axis] += v[axis];
    }
}

fn add_block(hessian: &mut Matrix12, row: usize, column: usize, block: &DMat3) {
    for c in 0..3 {
        for r in 0..3 {
            hessian[row + r][column + c] += block.col(c)[r];
        }
    }
}

fn add_mode(hessian: &mut Matrix12, weight: f64, mode: &DMat3) {
    if weight == 0.0 {
        return;
    }
    let m = mode.to_cols_array();
    for (row, a) in hessian[3..].iter_mut().zip(m) {
        for (entry, b) in row[3..].iter_mut().zip(m) {
            *entry += weight * a * b;
        }
    }
}

#[cfg(test)]
#[path = "body_test.rs"]
mod tests;
