//! Dense symmetric systems of a size that is known only at run time.

/// A symmetric matrix; both halves are kept.
#[derive(Clone, Debug)]
pub(super) struct Symmetric {
    size: usize,
    entries: Vec<f64>,
}

impl Symmetric {
    pub(super) fn zero(size: usize) -> Self {
        Self {
            size,
            entries: vec![0.0; size * size],
        }
    }

    pub(super) fn size(&self) -> usize {
        self.size
    }

    pub(super) fn at(&self, i: usize, j: usize) -> f64 {
        self.entries[i * self.size + j]
    }

    pub(super) fn add(&mut self, i: usize, j: usize, value: f64) {
        self.entries[i * self.size + j] += value;
    }

    /// Adds weight · row rowᵀ; the row is given by its entries that are not zero.
    pub(super) fn add_outer(&mut self, row: &[(usize, f64)], weight: f64) {
        for (i, a) in row {
            for (j, b) in row {
                self.add(*i, *j, weight * a * b);
            }
        }
    }

    /// Multiplies the diagonal.
    pub(super) fn damp(&mut self, factor: f64) {
        for i in 0..self.size {
            self.entries[i * self.size + i] *= factor;
        }
    }

    /// Fixes an unknown: its step is 0 whatever the others do.
    pub(super) fn pin(&mut self, i: usize) {
        for j in 0..self.size {
            self.entries[i * self.size + j] = 0.0;
            self.entries[j * self.size + i] = 0.0;
        }
        self.entries[i * self.size + i] = 1.0;
    }

    /// Largest entry of the diagonal.
    pub(super) fn largest(&self) -> f64 {
        (0..self.size).map(|i| self.at(i, i)).fold(0.0, f64::max)
    }

    /// Cholesky's factor; none if the matrix is not positive definite beyond rounding.
    pub(super) fn factor(&self) -> Option<Factor> {
        let n = self.size;
        let mut lower = vec![0.0; n * n];
        for i in 0..n {
            for j in 0..=i {
                let dot: f64 = (0..j).map(|k| lower[i * n + k] * lower[j * n + k]).sum();
                let rest = self.at(i, j) - dot;
                if i == j {
                    // Written so that NaN is refused as well.
                    let positive = rest > 1e-13 * self.at(i, i).abs() && rest > 0.0;
                    if !positive {
                        return None;
                    }
                    lower[i * n + i] = rest.sqrt();
                } else {
                    lower[i * n + j] = rest / lower[j * n + j];
                }
            }
        }
        Some(Factor { size: n, lower })
    }
}

/// L of L Lᵀ.
#[derive(Clone, Debug)]
pub(super) struct Factor {
    size: usize,
    lower: Vec<f64>,
}

impl Factor {
    /// The unknowns for a right-hand side.
    pub(super) fn solve(&self, right: &[f64]) -> Vec<f64> {
        let (n, l) = (self.size, &self.lower);
        let mut x = right.to_vec();
        for i in 0..n {
            let dot: f64 = (0..i).map(|k| l[i * n + k] * x[k]).sum();
            x[i] = (x[i] - dot) / l[i * n + i];
        }
        for i in (0..n).rev() {
            let dot: f64 = (i + 1..n).map(|k| l[k * n + i] * x[k]).sum();
            x[i] = (x[i] - dot) / l[i * n + i];
        }
        x
    }

    /// The inverse of the factored matrix.
    pub(super) fn inverse(&self) -> Symmetric {
        let n = self.size;
        let mut result = Symmetric::zero(n);
        for i in 0..n {
            let mut unit = vec![0.0; n];
            unit[i] = 1.0;
            for (j, value) in self.solve(&unit).into_iter().enumerate() {
                // Rounding leaves it not quite symmetric.
                result.add(i, j, 0.5 * value);
                result.add(j, i, 0.5 * value);
            }
        }
        result
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn systems_are_solved_inverted_and_pinned() {
        let mut matrix = Symmetric::zero(3);
        matrix.add_outer(&[(0, 2.0), (1, 1.0)], 1.0);
        matrix.add_outer(&[(1, 1.0), (2, -1.0)], 2.0);
        assert!(
            matrix.factor().is_none(),
            "two rows do not make three unknowns"
        );
        matrix.add_outer(&[(2, 3.0)], 1.0);
        let x = [0.5, -1.5, 2.0];
        let right: Vec<f64> = (0..3)
            .map(|i| (0..3).map(|j| matrix.at(i, j) * x[j]).sum())
            .collect();
        let factor = matrix.factor().unwrap();
        for (a, b) in factor.solve(&right).iter().zip(x) {
            assert!((a - b).abs() < 1e-12);
        }
        let inverse = factor.inverse();
        for i in 0..3 {
            let row: f64 = (0..3).map(|k| matrix.at(i, k) * inverse.at(k, 1)).sum();
            assert!((row - f64::from(u8::from(i == 1))).abs() < 1e-12);
        }
        matrix.pin(1);
        assert_eq!(matrix.factor().unwrap().solve(&[0.0, 0.0, 9.0])[1], 0.0);
    }
}
