//! Small dense symmetric systems: normal equations and Cholesky factors.
//!
//! All sums run in a fixed order, so that results are the same on every machine.

/// Factors a symmetric matrix (row-major, only the lower triangle is read) into L Lᵀ in place; the
/// upper triangle is unchanged.
///
/// `pivot` maps the remainder of a diagonal entry and that entry to the square of L's entry; `None`
/// refuses the matrix. Columns of a zero pivot are zero.
fn factor_in_place(
    matrix: &mut [f64],
    size: usize,
    pivot: impl Fn(f64, f64) -> Option<f64>,
) -> Option<()> {
    for i in 0..size {
        for j in 0..=i {
            let (above, row) = matrix.split_at_mut(i * size);
            let other = if i == j { &*row } else { &above[j * size..] };
            let dot: f64 = row[..j].iter().zip(&other[..j]).map(|(a, b)| a * b).sum();
            let rest = row[j] - dot;
            row[j] = if i == j {
                pivot(rest, row[j])?.sqrt()
            } else if other[j] > 0.0 {
                rest / other[j]
            } else {
                0.0
            };
        }
    }
    Some(())
}

/// Solves L Lᵀ x = b in place, for a factor of [`factor_in_place`].
fn substitute(lower: &[f64], size: usize, x: &mut [f64]) {
    for i in 0..size {
        let dot: f64 = (0..i).map(|k| lower[i * size + k] * x[k]).sum();
        x[i] = (x[i] - dot) / lower[i * size + i];
    }
    for i in (0..size).rev() {
        let dot: f64 = (i + 1..size).map(|k| lower[k * size + i] * x[k]).sum();
        x[i] = (x[i] - dot) / lower[i * size + i];
    }
}

/// Refuses pivots that are not positive beyond rounding, and NaN.
fn positive_beyond_rounding(rest: f64, diagonal: f64) -> Option<f64> {
    (rest > 1e-13 * diagonal.abs() && rest > 0.0).then_some(rest)
}

/// Cholesky factor L of a symmetric matrix L Lᵀ of `N` rows.
#[derive(Clone, Debug)]
pub struct Cholesky<const N: usize> {
    lower: [[f64; N]; N],
}

impl<const N: usize> Cholesky<N> {
    /// Factors a matrix, of which only the lower triangle is read; `None` unless it is positive
    /// definite and finite.
    pub fn new(matrix: &[[f64; N]; N]) -> Option<Self> {
        Self::with_pivots(matrix, |rest, _| {
            (rest > 0.0 && rest.is_finite()).then_some(rest)
        })
    }

    /// As [`Cholesky::new`], but also refuses a matrix that is singular within rounding.
    pub fn beyond_rounding(matrix: &[[f64; N]; N]) -> Option<Self> {
        Self::with_pivots(matrix, positive_beyond_rounding)
    }

    /// Factors a matrix with a custom rule for the squares of L's diagonal: `pivot` gets the
    /// remainder of a diagonal entry, and the entry. A column with a zero pivot is zero.
    pub fn with_pivots(
        matrix: &[[f64; N]; N],
        pivot: impl Fn(f64, f64) -> Option<f64>,
    ) -> Option<Self> {
        let mut lower = *matrix;
        factor_in_place(lower.as_flattened_mut(), N, pivot)?;
        for (i, row) in lower.iter_mut().enumerate() {
            row[i + 1..].fill(0.0);
        }
        Some(Self { lower })
    }

    /// Returns L, row-major; zero above the diagonal.
    pub fn lower(&self) -> &[[f64; N]; N] {
        &self.lower
    }

    /// Solves L Lᵀ x = `b`.
    #[must_use]
    pub fn solve(&self, b: &[f64; N]) -> [f64; N] {
        let mut x = *b;
        substitute(self.lower.as_flattened(), N, &mut x);
        x
    }

    /// Returns the inverse of L Lᵀ.
    #[must_use]
    pub fn inverse(&self) -> [[f64; N]; N] {
        let columns: [[f64; N]; N] = std::array::from_fn(|i| {
            let mut unit = [0.0; N];
            unit[i] = 1.0;
            self.solve(&unit)
        });
        // Remove the asymmetry due to rounding.
        let mean = |i: usize, j: usize| 0.5 * (columns[i][j] + columns[j][i]);
        std::array::from_fn(|i| std::array::from_fn(|j| mean(i, j)))
    }
}

/// Normal equations JᵀWJ x = JᵀWr of `N` unknowns.
#[derive(Clone, Debug)]
pub struct NormalEquations<const N: usize> {
    /// JᵀWJ.
    pub matrix: [[f64; N]; N],
    /// JᵀWr.
    pub vector: [f64; N],
}

impl<const N: usize> NormalEquations<N> {
    /// An empty system.
    pub fn zero() -> Self {
        Self {
            matrix: [[0.0; N]; N],
            vector: [0.0; N],
        }
    }

    /// Adds one equation: `row` times the unknowns is `value`.
    pub fn add(&mut self, row: &[f64; N], value: f64, weight: f64) {
        let sums = self.matrix.iter_mut().zip(&mut self.vector);
        for ((sums, sum), entry) in sums.zip(row) {
            let weighted = weight * entry;
            for (sum, other) in sums.iter_mut().zip(row) {
                *sum += weighted * other;
            }
            *sum += weighted * value;
        }
    }

    /// Solves for the unknowns; `None` if the system is singular.
    pub fn solve(&self) -> Option<[f64; N]> {
        Some(Cholesky::beyond_rounding(&self.matrix)?.solve(&self.vector))
    }
}

/// A symmetric matrix of dynamic size; both triangles are stored.
#[derive(Clone, Debug)]
pub struct Symmetric {
    size: usize,
    entries: Vec<f64>,
}

impl Symmetric {
    /// A zero matrix.
    pub fn zero(size: usize) -> Self {
        Self {
            size,
            entries: vec![0.0; size * size],
        }
    }

    /// Number of rows.
    pub fn size(&self) -> usize {
        self.size
    }

    /// Entry in row `i`, column `j`.
    pub fn at(&self, i: usize, j: usize) -> f64 {
        self.entries[i * self.size + j]
    }

    /// Adds to an entry.
    pub fn add(&mut self, i: usize, j: usize, value: f64) {
        self.entries[i * self.size + j] += value;
    }

    /// Adds weight · row rowᵀ; the row is given by its non-zero entries.
    pub fn add_outer(&mut self, row: &[(usize, f64)], weight: f64) {
        for (i, a) in row {
            for (j, b) in row {
                self.add(*i, *j, weight * a * b);
            }
        }
    }

    /// Multiplies the diagonal by `factor`.
    pub fn damp(&mut self, factor: f64) {
        for i in 0..self.size {
            self.entries[i * self.size + i] *= factor;
        }
    }

    /// Fixes an unknown: its step is 0.
    pub fn pin(&mut self, i: usize) {
        for j in 0..self.size {
            self.entries[i * self.size + j] = 0.0;
            self.entries[j * self.size + i] = 0.0;
        }
        self.entries[i * self.size + i] = 1.0;
    }

    /// Largest diagonal entry.
    pub fn largest(&self) -> f64 {
        (0..self.size).map(|i| self.at(i, i)).fold(0.0, f64::max)
    }

    /// Cholesky factorisation; `None` if the matrix is not positive definite beyond rounding.
    pub fn factor(&self) -> Option<Factor> {
        let mut lower = self.entries.clone();
        factor_in_place(&mut lower, self.size, positive_beyond_rounding)?;
        let size = self.size;
        Some(Factor { size, lower })
    }
}

/// Cholesky factor of a [`Symmetric`].
#[derive(Clone, Debug)]
pub struct Factor {
    size: usize,
    lower: Vec<f64>,
}

impl Factor {
    /// Solves for the unknowns of a right-hand side.
    pub fn solve(&self, right: &[f64]) -> Vec<f64> {
        let mut x = right.to_vec();
        substitute(&self.lower, self.size, &mut x);
        x
    }

    /// Returns the inverse of the factored matrix.
    pub fn inverse(&self) -> Symmetric {
        let mut result = Symmetric::zero(self.size);
        for i in 0..self.size {
            let mut unit = vec![0.0; self.size];
            unit[i] = 1.0;
            for (j, value) in self.solve(&unit).into_iter().enumerate() {
                // Remove the asymmetry due to rounding.
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
    use crate::random::SeedStream;

    /// B Bᵀ + I for a random B: positive definite.
    fn matrix(stream: &mut SeedStream) -> [[f64; 12]; 12] {
        let b: [[f64; 12]; 12] =
            std::array::from_fn(|_| std::array::from_fn(|_| stream.between(-1.0, 1.0)));
        std::array::from_fn(|i| {
            std::array::from_fn(|j| {
                let product: f64 = (0..12).map(|k| b[i][k] * b[j][k]).sum();
                product + if i == j { 1.0 } else { 0.0 }
            })
        })
    }

    #[test]
    fn solution_satisfies_the_equations() {
        let mut stream = SeedStream::named(2, "cholesky");
        for _ in 0..20 {
            let m = matrix(&mut stream);
            let b: [f64; 12] = std::array::from_fn(|_| stream.between(-1.0, 1.0));
            let x = Cholesky::new(&m).unwrap().solve(&b);
            for (row, b) in m.iter().zip(b) {
                let found: f64 = row.iter().zip(&x).map(|(a, x)| a * x).sum();
                assert!((found - b).abs() < 1e-12);
            }
        }
    }

    #[test]
    fn indefinite_and_nan_matrices_have_no_factor() {
        let good = matrix(&mut SeedStream::named(2, "cholesky"));
        for (value, k) in [(-1.0, 0), (-1.0, 11), (f64::NAN, 5), (f64::INFINITY, 5)] {
            let mut m = good;
            m[k][k] = value;
            assert!(Cholesky::new(&m).is_none(), "{value}");
        }
    }

    #[test]
    fn zero_pivots_give_zero_columns() {
        let factor =
            Cholesky::with_pivots(&[[4.0, 2.0], [2.0, 1.0]], |rest, _| Some(rest.max(0.0)));
        assert_eq!(*factor.unwrap().lower(), [[2.0, 0.0], [1.0, 0.0]]);
        let none = Cholesky::with_pivots(&[[0.0, 0.0], [0.0, 9.0]], |rest, _| Some(rest.max(0.0)));
        assert_eq!(*none.unwrap().lower(), [[0.0, 0.0], [0.0, 3.0]]);
    }

    #[test]
    fn least_squares_and_inverse_match_hand_calculation() {
        // A line through (0, 1), (1, 3), (2, 5) and a point of zero weight.
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
        let inverse = Cholesky::new(&[[4.0, 2.0], [2.0, 3.0]]).unwrap().inverse();
        assert!((inverse[0][0] - 0.375).abs() < 1e-15 && (inverse[0][1] + 0.25).abs() < 1e-15);
        assert!((inverse[1][1] - 0.5).abs() < 1e-15);
    }

    #[test]
    fn singular_system_has_no_solution() {
        let mut one = NormalEquations::<2>::zero();
        one.add(&[1.0, 2.0], 3.0, 1.0);
        assert_eq!(one.solve(), None);
        assert!(Cholesky::beyond_rounding(&[[f64::NAN]]).is_none());
    }

    #[test]
    fn symmetric_systems_are_solved_inverted_and_pinned() {
        let mut matrix = Symmetric::zero(3);
        matrix.add_outer(&[(0, 2.0), (1, 1.0)], 1.0);
        matrix.add_outer(&[(1, 1.0), (2, -1.0)], 2.0);
        assert!(
            matrix.factor().is_none(),
            "two equations for three unknowns"
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
