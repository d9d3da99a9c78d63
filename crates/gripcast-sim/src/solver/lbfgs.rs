//! L-BFGS corrections (Nocedal 1980) of a factorised stiffness.

/// The last pairs of step and change of gradient.
#[derive(Clone, Debug)]
pub(super) struct History {
    capacity: usize,
    pairs: Vec<Pair>,
    alphas: Vec<f64>,
}

#[derive(Clone, Debug, Default)]
struct Pair {
    step: Vec<f64>,
    change: Vec<f64>,
    curvature: f64,
}

impl History {
    pub(super) fn new(capacity: usize) -> Self {
        Self {
            capacity,
            pairs: Vec::with_capacity(capacity),
            alphas: Vec::new(),
        }
    }

    pub(super) fn clear(&mut self) {
        self.pairs.clear();
    }

    /// Adds a pair if its curvature is positive beyond rounding.
    pub(super) fn push(&mut self, step: &[f64], gradient: &[f64], previous: &[f64]) {
        if self.capacity == 0 {
            return;
        }
        let mut pair = if self.pairs.len() == self.capacity {
            self.pairs.remove(0)
        } else {
            Pair::default()
        };
        pair.step.clear();
        pair.step.extend_from_slice(step);
        pair.change.clear();
        pair.change
            .extend(gradient.iter().zip(previous).map(|(now, then)| now - then));
        pair.curvature = dot(&pair.step, &pair.change);
        let scale = dot(&pair.step, &pair.step) * dot(&pair.change, &pair.change);
        if pair.curvature > 1e-10 * scale.sqrt() {
            self.pairs.push(pair);
        }
    }

    /// `x ← H x` by the two-loop recursion; `solve` applies the inverse of the factorised stiffness
    /// in place.
    pub(super) fn apply(&mut self, x: &mut [f64], solve: impl FnOnce(&mut [f64])) {
        self.alphas.clear();
        for pair in self.pairs.iter().rev() {
            let alpha = dot(&pair.step, x) / pair.curvature;
            axpy(x, -alpha, &pair.change);
            self.alphas.push(alpha);
        }
        solve(x);
        for (pair, alpha) in self.pairs.iter().zip(self.alphas.iter().rev()) {
            let beta = dot(&pair.change, x) / pair.curvature;
            axpy(x, alpha - beta, &pair.step);
        }
    }
}

fn axpy(x: &mut [f64], factor: f64, y: &[f64]) {
    pulp::Arch::new().dispatch(|| {
        for (x, y) in x.iter_mut().zip(y) {
            *x += factor * y;
        }
    });
}

/// Scalar product, vectorised for this machine.
pub(super) fn dot(a: &[f64], b: &[f64]) -> f64 {
    pulp::Arch::new().dispatch(|| dot_lanes(a, b))
}

/// Scalar product in eight lanes summed in a fixed order: the same bits on every machine.
#[inline(always)]
fn dot_lanes(a: &[f64], b: &[f64]) -> f64 {
    let n = a.len().min(b.len());
    let (a, b) = (&a[..n], &b[..n]);
    let mut lanes = [0.0; 8];
    for (x, y) in a.chunks_exact(8).zip(b.chunks_exact(8)) {
        for lane in 0..8 {
            lanes[lane] += x[lane] * y[lane];
        }
    }
    let tail = n - n % 8;
    let rest: f64 = a[tail..].iter().zip(&b[tail..]).map(|(x, y)| x * y).sum();
    let pair = |i: usize| lanes[i] + lanes[i + 4];
    (pair(0) + pair(1)) + (pair(2) + pair(3)) + rest
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Iterations to minimise a quadratic whose stiffness is up to 2.5 times the factorised one.
    fn iterations(capacity: usize) -> usize {
        let stiffness = [1.0, 1.7, 0.4, 1.9, 0.9, 1.3];
        let mut history = History::new(capacity);
        let mut x = vec![1.0, -2.0, 0.5, 3.0, -1.0, 0.2];
        let gradient =
            |x: &[f64]| -> Vec<f64> { x.iter().zip(stiffness).map(|(x, k)| x * k).collect() };
        for count in 0..200 {
            let before = gradient(&x);
            if dot(&before, &before) < 1e-20 {
                return count;
            }
            let mut direction: Vec<f64> = before.iter().map(|g| -g).collect();
            history.apply(&mut direction, |_| {});
            for (x, d) in x.iter_mut().zip(&direction) {
                *x += d;
            }
            history.push(&direction, &gradient(&x), &before);
        }
        200
    }

    #[test]
    fn history_speeds_up_convergence_with_stale_stiffness() {
        let (without, with) = (iterations(0), iterations(5));
        assert!(2 * with < without, "{with} against {without}");
    }
}
