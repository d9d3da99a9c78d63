//! Downhill simplex of Nelder and Mead (*The Computer Journal* 7, 1965).

/// Minimises a function from `start` with an initial step per unknown; stops after `evaluations` or
/// when the values at the vertices differ by less than `tolerance`. Returns the minimiser and its
/// value.
pub(super) fn minimise(
    start: &[f64],
    steps: &[f64],
    evaluations: usize,
    tolerance: f64,
    value: &mut dyn FnMut(&[f64]) -> f64,
) -> (Vec<f64>, f64) {
    let mut corners = vec![(value(start), start.to_vec())];
    for (i, step) in steps.iter().enumerate() {
        let mut corner = start.to_vec();
        corner[i] += step;
        corners.push((value(&corner), corner));
    }
    let mut left = evaluations.saturating_sub(corners.len());
    loop {
        corners.sort_by(|a, b| a.0.total_cmp(&b.0));
        let worst = corners.len() - 1;
        if left == 0 || corners[worst].0 - corners[0].0 < tolerance {
            let (best, point) = corners.swap_remove(0);
            return (point, best);
        }
        let middle = mean(&corners[..worst]);
        let mut probe = |factor: f64| {
            let point: Vec<f64> = middle
                .iter()
                .zip(&corners[worst].1)
                .map(|(m, w)| m + factor * (w - m))
                .collect();
            left = left.saturating_sub(1);
            (value(&point), point)
        };
        let reflected = probe(-1.0);
        let next = if reflected.0 < corners[0].0 {
            let expanded = probe(-2.0);
            Some(min_corner(reflected, expanded))
        } else if reflected.0 < corners[worst - 1].0 {
            Some(reflected)
        } else {
            let contracted = probe(if reflected.0 < corners[worst].0 {
                -0.5
            } else {
                0.5
            });
            (contracted.0 < reflected.0.min(corners[worst].0)).then_some(contracted)
        };
        match next {
            Some(corner) => corners[worst] = corner,
            None => left = left.saturating_sub(shrink(&mut corners, value)),
        }
    }
}

type Corner = (f64, Vec<f64>);

fn min_corner(a: Corner, b: Corner) -> Corner {
    if a.0 <= b.0 { a } else { b }
}

fn mean(corners: &[Corner]) -> Vec<f64> {
    let mut sum = vec![0.0; corners[0].1.len()];
    for (_, corner) in corners {
        for (sum, x) in sum.iter_mut().zip(corner) {
            *sum += x / corners.len() as f64;
        }
    }
    sum
}

/// Shrinks the simplex towards its best vertex; returns the number of evaluations.
fn shrink(corners: &mut [Corner], value: &mut dyn FnMut(&[f64]) -> f64) -> usize {
    let best = corners[0].1.clone();
    for (v, corner) in corners.iter_mut().skip(1) {
        for (x, b) in corner.iter_mut().zip(&best) {
            *x = 0.5 * (*x + b);
        }
        *v = value(corner);
    }
    corners.len() - 1
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rosenbrock_function_is_minimised() {
        let mut valley = |p: &[f64]| 100.0 * (p[1] - p[0] * p[0]).powi(2) + (1.0 - p[0]).powi(2);
        let (point, value) = minimise(&[-1.2, 1.0], &[0.2, 0.2], 400, 1e-12, &mut valley);
        assert!(value < 1e-8 && (point[0] - 1.0).abs() < 1e-3, "{point:?}");
    }

    #[test]
    fn nan_values_terminate() {
        let (_, value) = minimise(&[0.0], &[1.0], 50, 1e-9, &mut |_| f64::NAN);
        assert!(value.is_nan());
    }
}
