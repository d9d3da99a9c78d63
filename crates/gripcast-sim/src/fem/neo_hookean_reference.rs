//! Energy density, stress and tangent of one deformation gradient: the reference for the kernels.

use glam::DMat3;

use super::super::svd::{Svd, svd};
use super::{NeoHookean, Projection, outer};

impl NeoHookean {
    /// Energy density in J/m³; infinite for J <= 0 and NaN.
    pub(crate) fn energy(&self, f: &DMat3) -> f64 {
        let j = f.determinant();
        if j.is_nan() || j <= 0.0 {
            return f64::INFINITY;
        }
        let log_j = j.ln();
        0.5 * self.mu * (squared_norm(f) - 3.0) + log_j * (0.5 * self.lambda * log_j - self.mu)
    }

    /// First Piola-Kirchhoff stress dPsi/dF in Pa; meaningful for J > 0.
    pub(crate) fn pk1(&self, f: &DMat3) -> DMat3 {
        let j = f.determinant();
        *f * self.mu + cofactor(f) * (self.log_slope(j) / j)
    }

    /// d²Psi/dF² in Pa, entry (3 l + k, 3 j + i) for F(k, l) and F(i, j) (row, column); J > 0.
    pub(crate) fn hessian(&self, f: &DMat3) -> [[f64; 9]; 9] {
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
    pub(crate) fn projected_hessian(&self, f: &DMat3, projection: Projection) -> [[f64; 9]; 9] {
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
