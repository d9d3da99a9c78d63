//! Clamped logarithmic barrier (Li et al. 2020, eq. 6) with the normalisation of Taccel.
//!
//! `b(x) = −κ ((x − x̂) / x̂)² ln(x / x̂)` for `x < x̂`, else 0; twice differentiable at `x̂`.
//! Pairs take the squared distance, `x = d²`, `x̂ = d_hat²`; the half-space takes the distance
//! itself, `x = d`, `x̂ = d_hat`. `b` has the unit of κ, Pa: the energy of a contact is
//! `b · area · d_hat` with the area that the contact represents.

/// Value and derivatives of a barrier with respect to its argument.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Derivatives {
    /// Value, Pa.
    pub value: f64,
    /// First derivative, Pa per unit of the argument.
    pub first: f64,
    /// Second derivative, Pa per squared unit of the argument.
    pub second: f64,
}

impl Derivatives {
    /// Beyond the support of the barrier.
    pub const ZERO: Self = Self {
        value: 0.0,
        first: 0.0,
        second: 0.0,
    };

    /// Converts derivatives with respect to the squared distance into derivatives with respect to
    /// the distance (Pa/m, Pa/m²); `squared` in m².
    ///
    /// The second derivative is positive, so `second n nᵀ` is the positive semidefinite part of the
    /// contact Hessian along the unit normal.
    #[inline]
    #[must_use]
    pub fn to_linear(self, squared: f64) -> Self {
        Self {
            value: self.value,
            first: 2.0 * squared.sqrt() * self.first,
            second: 2.0 * self.first + 4.0 * squared * self.second,
        }
    }
}

/// The barrier of one scene.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Barrier {
    /// Stiffness, Pa.
    pub kappa: f64,
    /// Distance at which the barrier starts, m; must be positive.
    pub d_hat: f64,
}

impl Barrier {
    /// Square of `d_hat`, m².
    #[inline]
    pub fn d_hat_squared(&self) -> f64 {
        self.d_hat * self.d_hat
    }

    /// Value (Pa) at a squared distance (m²); infinite at and below zero.
    #[inline]
    pub fn value_squared(&self, squared: f64) -> f64 {
        value(self.kappa, squared, self.d_hat_squared())
    }

    /// Value and derivatives at a squared distance (m²), with respect to it.
    #[inline]
    pub fn squared(&self, squared: f64) -> Derivatives {
        derivatives(self.kappa, squared, self.d_hat_squared())
    }

    /// Value (Pa) at a signed distance (m) from a half-space; infinite at and below zero.
    #[inline]
    pub fn value_linear(&self, distance: f64) -> f64 {
        value(self.kappa, distance, self.d_hat)
    }

    /// Value and derivatives at a signed distance (m) from a half-space, with respect to it.
    #[inline]
    pub fn linear(&self, distance: f64) -> Derivatives {
        derivatives(self.kappa, distance, self.d_hat)
    }
}

#[inline]
fn value(kappa: f64, argument: f64, support: f64) -> f64 {
    if argument >= support {
        return 0.0;
    }
    if argument <= 0.0 {
        return f64::INFINITY;
    }
    let x = argument / support;
    -kappa * (x - 1.0) * (x - 1.0) * x.ln()
}

#[inline]
fn derivatives(kappa: f64, argument: f64, support: f64) -> Derivatives {
    if argument >= support {
        return Derivatives::ZERO;
    }
    if argument <= 0.0 {
        return Derivatives {
            value: f64::INFINITY,
            first: f64::NEG_INFINITY,
            second: f64::INFINITY,
        };
    }
    let x = argument / support;
    let (below, log) = (x - 1.0, x.ln());
    let ratio = below / x;
    Derivatives {
        value: -kappa * below * below * log,
        first: -kappa / support * below * (2.0 * log + ratio),
        second: -kappa / (support * support) * (2.0 * log + ratio * (4.0 - ratio)),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const BARRIER: Barrier = Barrier {
        kappa: 3e6,
        d_hat: 5e-4,
    };

    fn assert_near(found: f64, expected: f64, tolerance: f64) {
        let error = (found - expected).abs() / expected.abs();
        assert!(error <= tolerance, "{found} against {expected}: {error:e}");
    }

    #[test]
    fn derivatives_match_finite_differences() {
        for fraction in [1e-3, 1e-2, 0.1, 0.3, 0.5, 0.8, 0.95, 0.99] {
            for (x, of, value) in [
                (
                    fraction * fraction * BARRIER.d_hat_squared(),
                    Barrier::squared as fn(&Barrier, f64) -> Derivatives,
                    Barrier::value_squared as fn(&Barrier, f64) -> f64,
                ),
                (
                    fraction * BARRIER.d_hat,
                    Barrier::linear,
                    Barrier::value_linear,
                ),
            ] {
                let h = 1e-5 * x.min(2.0 * (1.0 - fraction) * x);
                let [low, mid, high] = [x - h, x, x + h].map(|x| of(&BARRIER, x));
                assert_eq!(mid.value, value(&BARRIER, x));
                assert_near(mid.first, (high.value - low.value) / (2.0 * h), 1e-6);
                assert_near(mid.second, (high.first - low.first) / (2.0 * h), 1e-6);
            }
        }
    }

    #[test]
    fn linear_conversion_is_the_chain_rule() {
        for fraction in [0.01, 0.3, 0.9] {
            let d = fraction * BARRIER.d_hat;
            let h = 1e-5 * d * (1.0 - fraction);
            let at = |d: f64| BARRIER.squared(d * d).to_linear(d * d);
            let (low, mid, high) = (at(d - h), at(d), at(d + h));
            assert_near(mid.first, (high.value - low.value) / (2.0 * h), 1e-6);
            assert_near(mid.second, (high.first - low.first) / (2.0 * h), 1e-6);
            assert!(mid.second > 0.0);
        }
    }

    #[test]
    fn barrier_is_zero_beyond_d_hat_and_infinite_at_contact() {
        let support = BARRIER.d_hat_squared();
        assert_eq!(BARRIER.squared(support), Derivatives::ZERO);
        assert_eq!(BARRIER.squared(2.0 * support), Derivatives::ZERO);
        assert_eq!(BARRIER.linear(BARRIER.d_hat), Derivatives::ZERO);
        for value in [
            BARRIER.value_squared(0.0),
            BARRIER.value_linear(-1e-9),
            BARRIER.squared(0.0).value,
        ] {
            assert_eq!(value, f64::INFINITY);
        }
        let near = BARRIER.squared(support * (1.0 - 1e-9));
        assert!(near.value >= 0.0 && near.first <= 0.0 && near.second >= 0.0);
    }

    #[test]
    fn normalised_barrier_matches_the_published_value() {
        let unit = Barrier {
            kappa: 1.0,
            d_hat: 5e-4,
        };
        let found = unit.squared(2.5e-4 * 2.5e-4);
        assert_near(found.value, 0.7797905781299385, 1e-12);
        assert_near(found.first, -17317766.1667, 1e-10);
        assert_near(found.second, 3.8036141956e14, 1e-10);
    }
}
