//! Ranges of numbers from flags, files and variables.

use std::fmt;

use crate::error::{Error, Result};

/// A range of finite numbers and its unit; one check for every source of a number.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct NumberRange {
    min: f64,
    max: f64,
    /// Whether `min` itself is outside.
    above: bool,
    unit: &'static str,
}

impl NumberRange {
    /// Any finite number.
    pub const FINITE: Self = Self::between(f64::MIN, f64::MAX);
    /// A finite number of at least 0.
    pub const NOT_NEGATIVE: Self = Self::between(0.0, f64::MAX);
    /// A finite number above 0.
    pub const POSITIVE: Self = Self::above(0.0, f64::MAX);
    /// A fraction.
    pub const FRACTION: Self = Self::between(0.0, 1.0);

    /// Numbers from `min` to `max`, both included.
    #[must_use]
    pub const fn between(min: f64, max: f64) -> Self {
        let (above, unit) = (false, "");
        Self {
            min,
            max,
            above,
            unit,
        }
    }

    /// Numbers above `min`, up to `max`.
    #[must_use]
    pub const fn above(min: f64, max: f64) -> Self {
        Self {
            above: true,
            ..Self::between(min, max)
        }
    }

    /// The same range with a unit for messages.
    #[must_use]
    pub const fn unit(self, unit: &'static str) -> Self {
        Self { unit, ..self }
    }

    /// Whether a number is finite and in the range.
    #[must_use]
    pub fn contains(&self, value: f64) -> bool {
        let is_above_min = if self.above {
            value > self.min
        } else {
            value >= self.min
        };
        value.is_finite() && is_above_min && value <= self.max
    }

    /// Returns a number of the range.
    ///
    /// # Errors
    /// `Input` with the expected range and the number.
    pub fn check(&self, value: f64) -> Result<f64> {
        if self.contains(value) {
            Ok(value)
        } else {
            Err(Error::input(format!("expected {self}, found {value}")))
        }
    }

    /// Parses a number of the range.
    ///
    /// # Errors
    /// `Input` with the expected range and the text.
    pub fn parse(&self, text: &str) -> Result<f64> {
        let value = text.trim().parse().ok();
        value
            .filter(|value| self.contains(*value))
            .ok_or_else(|| Error::input(format!("expected {self}, found `{text:.80}`")))
    }
}

/// The range in words: `a number from 0 to 60000 ms`.
impl fmt::Display for NumberRange {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let (min, max) = (self.min, self.max);
        match (min > f64::MIN, max < f64::MAX) {
            (false, false) => write!(f, "a finite number")?,
            (false, true) => write!(f, "a number of at most {max}")?,
            (true, false) if self.above => write!(f, "a finite number above {min}")?,
            (true, false) => write!(f, "a finite number of at least {min}")?,
            (true, true) if self.above => write!(f, "a number above {min} and at most {max}")?,
            (true, true) => write!(f, "a number from {min} to {max}")?,
        }
        if !self.unit.is_empty() {
            write!(f, " {}", self.unit)?;
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    const RANGES: [NumberRange; 5] = [
        NumberRange::FINITE,
        NumberRange::NOT_NEGATIVE,
        NumberRange::POSITIVE,
        NumberRange::FRACTION,
        NumberRange::between(-90.0, 90.0).unit("°"),
    ];

    #[test]
    fn no_range_contains_nan_or_infinity() {
        for range in RANGES {
            for text in [
                "nan", "-nan", "inf", "-inf", "infinity", "1e400", "-1e400", "", "ten",
            ] {
                let error = range.parse(text).unwrap_err().to_string();
                assert!(error.contains(&range.to_string()), "{error}");
            }
            assert!(range.check(f64::NAN).is_err());
        }
    }

    #[test]
    fn bounds_are_included_or_not() {
        let range = NumberRange::between(0.0, 1.0);
        assert!(range.contains(0.0) && range.contains(1.0) && !range.contains(1.000_001));
        let range = NumberRange::above(0.0, 1000.0).unit("ms");
        assert!(!range.contains(0.0) && !range.contains(-0.0) && range.contains(1000.0));
        let error = range.parse("-1").unwrap_err().to_string();
        assert!(
            error.contains("expected a number above 0 and at most 1000 ms, found `-1`"),
            "{error}"
        );
        assert_eq!(NumberRange::POSITIVE.to_string(), "a finite number above 0");
    }

    proptest! {
        #[test]
        fn parsed_numbers_are_in_the_range(value in any::<f64>(), index in 0..RANGES.len()) {
            let range = RANGES[index];
            let parsed = range.parse(&value.to_string());
            prop_assert_eq!(parsed.is_ok(), range.contains(value));
            prop_assert!(parsed.is_err() || value.is_finite());
        }
    }
}
