//! Small dense least squares: normal equations and their Cholesky factor.

/// JᵀWJ and JᵀWr of up to `N` unknowns.
#[derive(Clone, Debug)]
pub(crate) struct NormalEquations<const N: usize> {
    /// JᵀWJ.
    pub(crate) matrix: [[f64; N]; N],
    /// JᵀWr.
    pub(crate) vector: [f64; N],
}

impl<const N: usize> NormalEquations<N> {
    pub(crate) fn zero() -> Self {
        Self {
            matrix: [[0.0; N]; N],
            vector: [0.0; N],
        }
    }

    /// Adds one equation: `row` times the unknowns is `value`.
    pub(crate) fn add(&mut self, row: &[f64; N], value: f64, weight: f64) {
        let sums = self.matrix.iter_mut().zip(&mut self.vector);
        for ((sums, sum), entry) in sums.zip(row) {
            let weighted = weight * entry;
            for (sum, other) in sums.iter_mut().zip(row) {
                *sum += weighted * other;
            }
            *sum += weighted * value;
        }
    }

    /// The unknowns; none where the equations do not determine them.
    pub(crate) fn solve(&self) -> Option<[f64; N]> {
        Some(substitute(&factor(&self.matrix)?, self.vector))
    }
}

/// Inverse of a symmetric positive definite matrix.
pub(crate) fn inverse<const N: usize>(matrix: &[[f64; N]; N]) -> Option<[[f64; N]; N]> {
    let lower = factor(matrix)?;
    let mut result = [[0.0; N]; N];
    for (i, row) in result.iter_mut().enumerate() {
        let mut unit = [0.0; N];
        unit[i] = 1.0;
        *row = substitute(&lower, unit);
    }
    // Rounding leaves it not quite symmetric.
    let mean = |i: usize, j: usize| 0.5 * (result[i][j] + result[j][i]);
    Some(std::array::from_fn(|i| std::array::from_fn(|j| mean(i, j))))
}

/// L of L Lᵀ; none if the matrix is not positive definite beyond rounding.
fn factor<const N: usize>(matrix: &[[f64; N]; N]) -> Option<[[f64; N]; N]> {
    let mut lower = [[0.0; N]; N];
    for i in 0..N {
        for j in 0..=i {
            let dot: f64 = (0..j).map(|k| lower[i][k] * lower[j][k]).sum();
            let rest = matrix[i][j] - dot;
            if i == j {
                // Written so that NaN is refused as well.
                let positive = rest > 1e-13 * matrix[i][i].abs() && rest > 0.0;
                if !positive {
                    return None;
                }
                lower[i][i] = rest.sqrt();
            } else {
                lower[i][j] = rest / lower[j][j];
            }
        }
    }
    Some(lower)
}

fn substitute<const N: usize>(lower: &[[f64; N]; N], mut x: [f64; N]) -> [f64; N] {
    for i in 0..N {
        let dot: f64 = (0..i).map(|k| lower[i][k] * x[k]).sum();
        x[i] = (x[i] - dot) / lower[i][i];
    }
    for i in (0..N).rev() {
        let dot: f64 = (i + 1..N).map(|k| lower[k][i] * x[k]).sum();
        x[i] = (x[i] - dot) / lower[i][i];
    }
    x
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn least_squares_and_inverse_agree_with_hand_calculation() {
        // A line through (0, 1), (1, 3), (2, 5) with a fourth point of no weight.
        let mut line = NormalEquations::<2>::zero();
        for (x, y, weight) in [
            (0.0, 1.0, 1.0),
            (1.0, 3.0, 2.0),
            (2.0, 5.0, 1.0),
            (9.0, 0.0, 0.0),
        ] {
            line.add(&[1.0, x], y, weight);
        }
        let [a, b] = line.solve().unwrap();
        assert!((a - 1.0).abs() < 1e-12 && (b - 2.0).abs() < 1e-12);
        let inverse = inverse(&[[4.0, 2.0], [2.0, 3.0]]).unwrap();
        assert!((inverse[0][0] - 0.375).abs() < 1e-15 && (inverse[0][1] + 0.25).abs() < 1e-15);
        assert!((inverse[1][1] - 0.5).abs() < 1e-15);
    }

    #[test]
    fn what_is_not_determined_has_no_solution() {
        let mut one = NormalEquations::<2>::zero();
        one.add(&[1.0, 2.0], 3.0, 1.0);
        assert_eq!(one.solve(), None);
        assert_eq!(inverse(&[[f64::NAN]]), None);
    }
}
