//! Results of a validation.

use std::time::Instant;

use serde::Serialize;

/// Tolerance of a found value.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Tolerance {
    /// Maximum absolute error, in the unit of the value.
    Absolute(f64),
    /// Maximum error as a fraction of the expected value.
    Relative(f64),
    /// Minimum: the expected value.
    AtLeast,
    /// Reported for information; must be finite.
    Informational,
}

/// Comparison of an expected and a found value.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct CaseResult {
    /// Case group (as for `--cases`), a slash, and the quantity.
    pub name: String,
    /// Value by theory or reference.
    pub expected: f64,
    /// Value of the simulator.
    pub found: f64,
    /// Unit of both values.
    pub unit: &'static str,
    /// Tolerance of the found value.
    pub tolerance: Tolerance,
    /// Whether the found value is within the tolerance.
    pub passed: bool,
    /// Wall time since the previous comparison, s.
    pub seconds: f64,
}

impl CaseResult {
    /// Relative error: `found / expected - 1`.
    pub fn deviation(&self) -> f64 {
        self.found / self.expected - 1.0
    }
}

/// All comparisons of a validation.
#[derive(Clone, Debug, Default, Serialize)]
pub struct Report {
    /// Number of passed comparisons.
    pub passed: usize,
    /// Number of failed comparisons.
    pub failed: usize,
    /// All comparisons.
    pub cases: Vec<CaseResult>,
}

/// Collects the comparisons of one case group.
#[derive(Debug)]
pub(super) struct Recorder {
    group: &'static str,
    since: Instant,
    pub(super) cases: Vec<CaseResult>,
}

impl Recorder {
    pub(super) fn new(group: &'static str) -> Self {
        Self {
            group,
            since: Instant::now(),
            cases: Vec::new(),
        }
    }

    /// Records a comparison.
    pub(super) fn check(
        &mut self,
        quantity: impl std::fmt::Display,
        (expected, found): (f64, f64),
        unit: &'static str,
        tolerance: Tolerance,
    ) {
        let error = (found - expected).abs();
        let passed = match tolerance {
            Tolerance::Absolute(limit) => error <= limit,
            Tolerance::Relative(fraction) => error <= fraction * expected.abs(),
            Tolerance::AtLeast => found >= expected,
            Tolerance::Informational => found.is_finite(),
        };
        let now = Instant::now();
        self.cases.push(CaseResult {
            name: format!("{}/{quantity}", self.group),
            expected,
            found,
            unit,
            tolerance,
            passed,
            seconds: now.duration_since(self.since).as_secs_f64(),
        });
        self.since = now;
    }

    /// Records a comparison with an absolute tolerance.
    pub(super) fn absolute(
        &mut self,
        quantity: impl std::fmt::Display,
        pair: (f64, f64),
        unit: &'static str,
        limit: f64,
    ) {
        self.check(quantity, pair, unit, Tolerance::Absolute(limit));
    }

    /// Records a comparison with a relative tolerance.
    pub(super) fn relative(
        &mut self,
        quantity: impl std::fmt::Display,
        pair: (f64, f64),
        unit: &'static str,
        fraction: f64,
    ) {
        self.check(quantity, pair, unit, Tolerance::Relative(fraction));
    }

    /// Records a condition that must hold.
    pub(super) fn require(&mut self, condition: impl std::fmt::Display, holds: bool) {
        let found = f64::from(u8::from(holds));
        self.check(condition, (1.0, found), "", Tolerance::Absolute(0.0));
    }
}

impl Report {
    /// Adds comparisons, e.g. those of another report.
    pub fn add(&mut self, cases: Vec<CaseResult>) {
        self.passed += cases.iter().filter(|case| case.passed).count();
        self.failed += cases.iter().filter(|case| !case.passed).count();
        self.cases.extend(cases);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn tolerances_are_inclusive_and_reject_nan() {
        let mut recorder = Recorder::new("g");
        recorder.check("a", (2.0, 2.5), "", Tolerance::Absolute(0.5));
        recorder.check("b", (-2.0, -2.5), "", Tolerance::Relative(0.25));
        recorder.check("c", (1.0, 1.0), "", Tolerance::AtLeast);
        recorder.require("e", true);
        assert!(recorder.cases.iter().all(|case| case.passed));
        for tolerance in [
            Tolerance::Absolute(1.0),
            Tolerance::Relative(1.0),
            Tolerance::AtLeast,
            Tolerance::Informational,
        ] {
            recorder.check("nan", (1.0, f64::NAN), "", tolerance);
        }
        recorder.require("f", false);
        let mut report = Report::default();
        report.add(recorder.cases);
        assert_eq!((report.passed, report.failed), (4, 5));
        assert_eq!(report.cases[0].name, "g/a");
    }
}
