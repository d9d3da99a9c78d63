//! Formatting of numbers, settings and outcomes.

use crate::report::{Proportion, Setting};
use gripcast_report::{MISSING, fixed, outcome_name, trimmed};
use maud::{Markup, html};

/// `p = 0.0012`, `p < 0.0001`.
pub(super) fn p_value(p: f64) -> String {
    if !p.is_finite() {
        return format!("p = {MISSING}");
    }
    if p < 1e-4 {
        return "p < 0.0001".to_owned();
    }
    let leading_zeros = (-p.log10().floor()).clamp(0.0, 6.0) as usize;
    let digits = if p >= 0.1 { 2 } else { 1 + leading_zeros };
    format!("p = {}", fixed(p, digits))
}

/// Formats the fraction; [`MISSING`] for no grasps.
pub(super) fn fraction(p: &Proportion) -> String {
    if p.n == 0 {
        return MISSING.to_owned();
    }
    fixed(p.fraction, 2)
}

/// Formats the 95 % interval; [`MISSING`] for no grasps.
pub(super) fn interval(p: &Proportion) -> String {
    if p.n == 0 {
        return MISSING.to_owned();
    }
    format!("{}–{}", fixed(p.low, 2), fixed(p.high, 2))
}

/// Returns the name of the force that the engine varies.
pub(super) fn force_name(engine: &str) -> Markup {
    html! {
        @if engine == "fem" { i { "F" } sub { "stop" } } @else { "closing force" }
    }
}

/// `friction 0.4, closing force 40 N`.
pub(super) fn setting(engine: &str, setting: Setting) -> Markup {
    html! {
        "friction " (trimmed(setting.friction, 3)) ", " (force_name(engine)) " "
        (trimmed(setting.force_n, 2)) "\u{a0}N"
    }
}

/// Whether an outcome agrees with reality, shown as sign and word besides the color.
pub(super) struct Agreement(pub(super) Option<bool>);

impl Agreement {
    pub(super) fn class(&self) -> &'static str {
        match self.0 {
            Some(true) => "yes",
            Some(false) => "no",
            None => "none",
        }
    }

    pub(super) fn sign(&self) -> &'static str {
        match self.0 {
            Some(true) => "✓",
            Some(false) => "✗",
            None => MISSING,
        }
    }

    pub(super) fn word(&self) -> &'static str {
        match self.0 {
            Some(true) => "agrees",
            Some(false) => "disagrees",
            None => "no outcome",
        }
    }

    /// Shows `✓ stable`.
    pub(super) fn outcome(&self, outcome: &str) -> Markup {
        html! { span class=(self.class()) { (self.sign()) " " (outcome_name(outcome)) } }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn p_values_are_short() {
        let p = [0.62, 0.031, 0.0012, 1e-9, 1.0].map(p_value);
        let expected = [
            "p = 0.62",
            "p = 0.031",
            "p = 0.0012",
            "p < 0.0001",
            "p = 1.00",
        ];
        assert_eq!(p, expected);
    }

    #[test]
    fn proportion_of_no_grasps_is_missing() {
        let none = Proportion {
            agree: 0,
            n: 0,
            fraction: 0.0,
            low: 0.0,
            high: 1.0,
        };
        assert_eq!((fraction(&none), interval(&none)), ("–".into(), "–".into()));
    }
}
