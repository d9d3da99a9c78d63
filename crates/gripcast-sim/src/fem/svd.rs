//! Singular values and eigenvalues of 3x3 matrices by Jacobi rotations.

use glam::{DMat3, DVec3};

/// Maximum number of Jacobi sweeps; five reach rounding error.
const MAX_SWEEPS: usize = 16;

/// F = U diag(sigma) V^T with U and V orthogonal.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Svd {
    /// Left singular vectors, in columns.
    pub u: DMat3,
    /// Singular values, >= 0, unordered.
    pub sigma: DVec3,
    /// Right singular vectors, in columns; det V = 1.
    pub v: DMat3,
}

/// Singular value decomposition by one-sided Jacobi rotations (Hestenes 1958).
///
/// Small singular values keep their relative accuracy. det U has the sign of det F. For a
/// singular F the missing columns of U are completed to an orthogonal matrix.
pub fn svd(f: &DMat3) -> Svd {
    let mut g = [f.x_axis, f.y_axis, f.z_axis];
    let mut v = [DVec3::X, DVec3::Y, DVec3::Z];
    for _ in 0..MAX_SWEEPS {
        let mut rotated = false;
        for (p, q) in [(0, 1), (0, 2), (1, 2)] {
            let (a, b, c) = (g[p].length_squared(), g[q].length_squared(), g[p].dot(g[q]));
            if c.abs() > f64::EPSILON * (a * b).sqrt() {
                let rotation = rotation(a, b, c);
                rotate(&mut g, p, q, rotation);
                rotate(&mut v, p, q, rotation);
                rotated = true;
            }
        }
        if !rotated {
            break;
        }
    }
    let sigma = g.map(DVec3::length);
    Svd {
        u: left_vectors(&g, sigma),
        sigma: DVec3::from_array(sigma),
        v: DMat3::from_cols(v[0], v[1], v[2]),
    }
}

/// Cosine and sine of the rotation that diagonalises [[a, c], [c, b]].
fn rotation(a: f64, b: f64, c: f64) -> (f64, f64) {
    let (d, c2) = (b - a, 2.0 * c);
    let t = c2.copysign(c2 * d) / (d.abs() + (d * d + c2 * c2).sqrt());
    let cos = 1.0 / (1.0 + t * t).sqrt();
    (cos, cos * t)
}

fn rotate(columns: &mut [DVec3; 3], p: usize, q: usize, (cos, sin): (f64, f64)) {
    let (x, y) = (columns[p], columns[q]);
    columns[p] = cos * x - sin * y;
    columns[q] = sin * x + cos * y;
}

fn left_vectors(g: &[DVec3; 3], sigma: [f64; 3]) -> DMat3 {
    let mut order = [0, 1, 2];
    order.sort_by(|&i, &j| sigma[j].total_cmp(&sigma[i]));
    let [i, j, k] = order;
    let negligible = |s: f64| s <= 1e-300 || s <= sigma[i] * 1e-150;
    let first = if negligible(sigma[i]) {
        DVec3::X
    } else {
        g[i] / sigma[i]
    };
    let second = if negligible(sigma[j]) {
        first.any_orthonormal_vector()
    } else {
        g[j] / sigma[j]
    };
    let cyclic = (i + 1) % 3 == j;
    let third = if cyclic {
        first.cross(second)
    } else {
        second.cross(first)
    };
    let mut u = [DVec3::ZERO; 3];
    u[i] = first;
    u[j] = second;
    u[k] = if g[k].dot(third) < 0.0 { -third } else { third };
    DMat3::from_cols(u[0], u[1], u[2])
}

/// Eigenvalues and eigenvectors (columns) of a symmetric matrix, unordered.
///
/// Only the lower triangle is read.
pub fn symmetric_eigen(m: &DMat3) -> (DVec3, DMat3) {
    let mut a = [
        [m.x_axis.x, m.x_axis.y, m.x_axis.z],
        [m.x_axis.y, m.y_axis.y, m.y_axis.z],
        [m.x_axis.z, m.y_axis.z, m.z_axis.z],
    ];
    let mut v = [DVec3::X, DVec3::Y, DVec3::Z];
    for _ in 0..MAX_SWEEPS {
        let mut rotated = false;
        for (p, q) in [(0, 1), (0, 2), (1, 2)] {
            let scale = a[0][0].abs().max(a[1][1].abs()).max(a[2][2].abs());
            if a[p][q].abs() > 0.25 * f64::EPSILON * scale {
                let rotation = rotation(a[p][p], a[q][q], a[p][q]);
                rotate_symmetric(&mut a, p, q, rotation);
                rotate(&mut v, p, q, rotation);
                rotated = true;
            }
        }
        if !rotated {
            break;
        }
    }
    let values = DVec3::new(a[0][0], a[1][1], a[2][2]);
    (values, DMat3::from_cols(v[0], v[1], v[2]))
}

fn rotate_symmetric(a: &mut [[f64; 3]; 3], p: usize, q: usize, (cos, sin): (f64, f64)) {
    for row in a.iter_mut() {
        let (x, y) = (row[p], row[q]);
        row[p] = cos * x - sin * y;
        row[q] = sin * x + cos * y;
    }
    let (x, y) = (a[p], a[q]);
    for k in 0..3 {
        a[p][k] = cos * x[k] - sin * y[k];
        a[q][k] = sin * x[k] + cos * y[k];
    }
    a[p][q] = 0.0;
    a[q][p] = 0.0;
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{RngExt, SeedableRng};
    use rand_pcg::Pcg64;

    fn random(rng: &mut Pcg64) -> DMat3 {
        DMat3::from_cols_array(&std::array::from_fn(|_| rng.random_range(-1.0..1.0)))
    }

    fn cases() -> Vec<DMat3> {
        let mut rng = Pcg64::seed_from_u64(3);
        let rotation = DMat3::from_rotation_y(0.3) * DMat3::from_rotation_x(-1.2);
        let mut all = vec![
            DMat3::IDENTITY,
            rotation,
            rotation * 1e-9,
            rotation * DMat3::from_diagonal(DVec3::new(2.0, 2.0, 0.5)),
            DMat3::from_diagonal(DVec3::new(1.0, 1.0 + 1e-13, -1.0)),
            rotation * DMat3::from_diagonal(DVec3::new(1.0, 1e-3, 1e-9)) * rotation,
            rotation * DMat3::from_diagonal(DVec3::new(1.0, 0.0, 0.0)) * rotation,
            rotation * DMat3::from_diagonal(DVec3::new(1.0, 0.0, 2.0)) * rotation,
            DMat3::from_cols(DVec3::X, DVec3::X, DVec3::X),
            DMat3::ZERO,
        ];
        all.extend((0..50).map(|_| random(&mut rng)));
        all
    }

    fn orthogonal(m: &DMat3) -> bool {
        (m.transpose() * *m).abs_diff_eq(DMat3::IDENTITY, 1e-14)
    }

    #[test]
    fn singular_value_decomposition_rebuilds_the_matrix() {
        for f in cases() {
            let Svd { u, sigma, v } = svd(&f);
            let size = f
                .to_cols_array()
                .iter()
                .fold(0.0, |m: f64, e| m.max(e.abs()));
            let back = u * DMat3::from_diagonal(sigma) * v.transpose();
            assert!(back.abs_diff_eq(f, 4e-15 * size), "{f}: {back}");
            assert!(orthogonal(&u) && orthogonal(&v), "{f}: {u} {v}");
            assert!(sigma.min_element() >= 0.0);
            assert!((v.determinant() - 1.0).abs() < 1e-14);
        }
    }

    #[test]
    fn small_singular_values_are_accurate() {
        let rotation = DMat3::from_rotation_y(0.3) * DMat3::from_rotation_x(-1.2);
        let f = rotation * DMat3::from_diagonal(DVec3::new(1.0, 1e-4, 1e-8));
        let mut sigma = svd(&f).sigma.to_array();
        sigma.sort_by(f64::total_cmp);
        for (found, expected) in sigma.into_iter().zip([1e-8, 1e-4, 1.0]) {
            assert!((found / expected - 1.0).abs() < 1e-13, "{found}");
        }
    }

    #[test]
    fn eigendecomposition_rebuilds_the_matrix() {
        for f in cases() {
            let m = f + f.transpose();
            let (values, vectors) = symmetric_eigen(&m);
            let size = m
                .to_cols_array()
                .iter()
                .fold(0.0, |a: f64, e| a.max(e.abs()));
            let back = vectors * DMat3::from_diagonal(values) * vectors.transpose();
            assert!(back.abs_diff_eq(m, 4e-15 * size), "{m}: {back}");
            assert!(orthogonal(&vectors));
        }
    }
}
