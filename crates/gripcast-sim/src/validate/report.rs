//! What a validation found.

use std::time::Instant;

use serde::Serialize;

/// How far a found number may be from the expected one.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Tolerance {
    /// By this much, in the unit of the number.
    Absolute(f64),
    /// By this fraction of the expected number.
    Relative(f64),
    /// The found number must be at least the expected one.
    AtLeast,
    /// The found number must be at most the expected one.
    AtMost,
    /// The number is stated; there is nothing to hold it against.
    Stated,
}

/// One number that was expected and found.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct CaseResult {
    /// Group that `--cases` selects, a slash, and what was looked at.
    pub name: String,
    /// What theory, or the reference, says.
    pub expected: f64,
    /// What the simulator does.
    pub found: f64,
    /// Unit of both.
    pub unit: &'static str,
    /// How far they may be apart.
    pub tolerance: Tolerance,
    /// Whether they are no further apart.
    pub passed: bool,
    /// Computing time since the number before, s.
    pub seconds: f64,
}

impl CaseResult {
    /// `found / expected - 1`.
    pub fn deviation(&self) -> f64 {
        self.found / self.expected - 1.0
    }
}

/// All numbers of a run.
#[derive(Clone, Debug, Default, Serialize)]
pub struct Report {
    /// Numbers that hold.
    pub passed: usize,
    /// Numbers that do not.
    pub failed: usize,
    /// All of them.
    pub cases: Vec<CaseResult>,
}

/// Collects the numbers of one group.
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

    /// Records a number.
    pub(super) fn check(
        &mut self,
        what: impl std::fmt::Display,
        (expected, found): (f64, f64),
        unit: &'static str,
        tolerance: Tolerance,
    ) {
        let off = (found - expected).abs();
        let passed = match tolerance {
            Tolerance::Absolute(limit) => off <= limit,
            Tolerance::Relative(fraction) => off <= fraction * expected.abs(),
            Tolerance::AtLeast => found >= expected,
            Tolerance::AtMost => found <= expected,
            Tolerance::Stated => found.is_finite(),
        };
        let now = Instant::now();
        self.cases.push(CaseResult {
            name: format!("{}/{what}", self.group),
            expected,
            found,
            unit,
            tolerance,
            passed,
            seconds: now.duration_since(self.since).as_secs_f64(),
        });
        self.since = now;
    }

    /// Records a number that may be off by `limit` in its unit.
    pub(super) fn absolute(
        &mut self,
        what: impl std::fmt::Display,
        pair: (f64, f64),
        unit: &'static str,
        limit: f64,
    ) {
        self.check(what, pair, unit, Tolerance::Absolute(limit));
    }

    /// Records a number that may be off by `fraction` of the expected one.
    pub(super) fn relative(
        &mut self,
        what: impl std::fmt::Display,
        pair: (f64, f64),
        unit: &'static str,
        fraction: f64,
    ) {
        self.check(what, pair, unit, Tolerance::Relative(fraction));
    }

    /// Records something that must be true.
    pub(super) fn hold(&mut self, what: impl std::fmt::Display, holds: bool) {
        let found = f64::from(u8::from(holds));
        self.check(what, (1.0, found), "", Tolerance::Absolute(0.0));
    }
}

impl Report {
    /// Takes in another report's numbers.
    pub fn absorb(&mut self, other: Self) {
        self.add(other.cases);
    }

    pub(super) fn add(&mut self, cases: Vec<CaseResult>) {
        self.passed += cases.iter().filter(|case| case.passed).count();
        self.failed += cases.iter().filter(|case| !case.passed).count();
        self.cases.extend(cases);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn tolerances_are_inclusive_and_refuse_nan() {
        let mut recorder = Recorder::new("g");
        recorder.check("a", (2.0, 2.5), "", Tolerance::Absolute(0.5));
        recorder.check("b", (-2.0, -2.5), "", Tolerance::Relative(0.25));
        recorder.check("c", (1.0, 1.0), "", Tolerance::AtLeast);
        recorder.check("d", (1.0, 1.0), "", Tolerance::AtMost);
        recorder.hold("e", true);
        assert!(recorder.cases.iter().all(|case| case.passed));
        for tolerance in [
            Tolerance::Absolute(1.0),
            Tolerance::Relative(1.0),
            Tolerance::AtLeast,
            Tolerance::AtMost,
            Tolerance::Stated,
        ] {
            recorder.check("nan", (1.0, f64::NAN), "", tolerance);
        }
        recorder.hold("f", false);
        let mut report = Report::default();
        report.add(recorder.cases);
        assert_eq!((report.passed, report.failed), (5, 6));
        assert_eq!(report.cases[0].name, "g/a");
    }
}
