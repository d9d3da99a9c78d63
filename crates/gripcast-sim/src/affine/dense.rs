//! Linear algebra of the 12 numbers of one affine body.

/// The 12 numbers of an affine body: p, then the columns of A.
pub type Vector12 = [f64; 12];

/// A 12x12 matrix over them, by rows.
pub type Matrix12 = [[f64; 12]; 12];

/// Cholesky factor of a symmetric positive definite 12x12 matrix.
#[derive(Clone, Debug)]
pub struct Cholesky {
    lower: Matrix12,
}

impl Cholesky {
    /// Factors `m`, of which only the lower triangle is read; none when it is not positive
    /// definite or not finite.
    #[must_use]
    pub fn new(m: &Matrix12) -> Option<Self> {
        let mut lower = [[0.0; 12]; 12];
        for j in 0..12 {
            for i in j..12 {
                let done: f64 = lower[i][..j]
                    .iter()
                    .zip(&lower[j][..j])
                    .map(|(a, b)| a * b)
                    .sum();
                let rest = m[i][j] - done;
                if i > j {
                    lower[i][j] = rest / lower[j][j];
                } else if rest > 0.0 && rest.is_finite() {
                    lower[j][j] = rest.sqrt();
                } else {
                    return None;
                }
            }
        }
        Some(Self { lower })
    }

    /// x with M x = `b`.
    #[must_use]
    pub fn solve(&self, b: &Vector12) -> Vector12 {
        let mut x = *b;
        for i in 0..12 {
            let done: f64 = (0..i).map(|k| self.lower[i][k] * x[k]).sum();
            x[i] = (x[i] - done) / self.lower[i][i];
        }
        for i in (0..12).rev() {
            let done: f64 = (i + 1..12).map(|k| self.lower[k][i] * x[k]).sum();
            x[i] = (x[i] - done) / self.lower[i][i];
        }
        x
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{RngExt, SeedableRng};
    use rand_pcg::Pcg64;

    /// B B^T + I for a random B: positive definite.
    fn matrix(rng: &mut Pcg64) -> Matrix12 {
        let b: Matrix12 =
            std::array::from_fn(|_| std::array::from_fn(|_| rng.random_range(-1.0..1.0)));
        std::array::from_fn(|i| {
            std::array::from_fn(|j| {
                let product: f64 = (0..12).map(|k| b[i][k] * b[j][k]).sum();
                product + if i == j { 1.0 } else { 0.0 }
            })
        })
    }

    #[test]
    fn solutions_satisfy_the_equations() {
        let mut rng = Pcg64::seed_from_u64(2);
        for _ in 0..20 {
            let m = matrix(&mut rng);
            let b: Vector12 = std::array::from_fn(|_| rng.random_range(-1.0..1.0));
            let x = Cholesky::new(&m).unwrap().solve(&b);
            for (row, b) in m.iter().zip(b) {
                let found: f64 = row.iter().zip(&x).map(|(a, x)| a * x).sum();
                assert!((found - b).abs() < 1e-12);
            }
        }
    }

    #[test]
    fn indefinite_and_broken_matrices_have_no_factor() {
        let mut rng = Pcg64::seed_from_u64(2);
        let good = matrix(&mut rng);
        for (value, k) in [(-1.0, 0), (-1.0, 11), (f64::NAN, 5), (f64::INFINITY, 5)] {
            let mut m = good;
            m[k][k] = value;
            assert!(Cholesky::new(&m).is_none(), "{value}");
        }
    }
}
