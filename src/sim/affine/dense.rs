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
