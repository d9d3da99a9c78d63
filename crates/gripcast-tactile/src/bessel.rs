//! Modified Bessel functions of the second kind K₀ and K₁ for positive arguments, relative error
//! below 1e-6 (Abramowitz and Stegun, *Handbook of Mathematical Functions*, 9.8.1 to 9.8.8).

/// Evaluates Σ c_i x^i.
fn polynomial(x: f64, coefficients: &[f64]) -> f64 {
    coefficients.iter().rev().fold(0.0, |sum, c| sum * x + c)
}

fn i0(x: f64) -> f64 {
    let t = (x / 3.75).powi(2);
    polynomial(
        t,
        &[
            1.0, 3.5156229, 3.0899424, 1.2067492, 0.2659732, 0.0360768, 0.0045813,
        ],
    )
}

fn i1(x: f64) -> f64 {
    let t = (x / 3.75).powi(2);
    x * polynomial(
        t,
        &[
            0.5, 0.87890594, 0.51498869, 0.15084934, 0.02658733, 0.00301532, 0.00032411,
        ],
    )
}

/// K₀(x), x > 0.
pub(super) fn k0(x: f64) -> f64 {
    if x <= 2.0 {
        let series = polynomial(
            (0.5 * x).powi(2),
            &[
                -0.57721566,
                0.42278420,
                0.23069756,
                0.03488590,
                0.00262698,
                0.00010750,
                0.00000740,
            ],
        );
        return series - (0.5 * x).ln() * i0(x);
    }
    let series = polynomial(
        2.0 / x,
        &[
            1.25331414,
            -0.07832358,
            0.02189568,
            -0.01062446,
            0.00587872,
            -0.00251540,
            0.00053208,
        ],
    );
    series * (-x).exp() / x.sqrt()
}

/// K₁(x), x > 0.
pub(super) fn k1(x: f64) -> f64 {
    if x <= 2.0 {
        let series = polynomial(
            (0.5 * x).powi(2),
            &[
                1.0,
                0.15443144,
                -0.67278579,
                -0.18156897,
                -0.01919402,
                -0.00110404,
                -0.00004686,
            ],
        );
        return (0.5 * x).ln() * i1(x) + series / x;
    }
    let series = polynomial(
        2.0 / x,
        &[
            1.25331414,
            0.23498619,
            -0.03655620,
            0.01504268,
            -0.00780353,
            0.00325614,
            -0.00068245,
        ],
    );
    series * (-x).exp() / x.sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// ∫₀^∞ exp(−x cosh t) cosh(νt) dt, the integral that defines K.
    fn integral(order: f64, x: f64) -> f64 {
        let step = 1e-4;
        (0..200_000)
            .map(|i| {
                let t = (i as f64 + 0.5) * step;
                (-x * t.cosh()).exp() * (order * t).cosh() * step
            })
            .sum()
    }

    #[test]
    fn k0_and_k1_equal_their_integrals() {
        for x in [0.05, 0.3, 1.0, 1.99, 2.01, 4.0, 9.0] {
            let (zero, one) = (integral(0.0, x), integral(1.0, x));
            assert!((k0(x) / zero - 1.0).abs() < 2e-6, "{x}: {} {zero}", k0(x));
            assert!((k1(x) / one - 1.0).abs() < 2e-6, "{x}: {} {one}", k1(x));
        }
    }
}
