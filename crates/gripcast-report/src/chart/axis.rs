//! Axes with round tick values.

use super::text::{SMALL, count, width};
use crate::fixed;

/// Larger values are ignored; they would overflow an axis.
const MAX: f64 = 1e12;

/// Returns the minimum and maximum of the finite values.
pub fn extent(values: impl Iterator<Item = f64>) -> Option<[f64; 2]> {
    values
        .filter(|value| value.abs() <= MAX)
        .fold(None, |range, value| match range {
            None => Some([value, value]),
            Some([low, high]) => Some([low.min(value), high.max(value)]),
        })
}

/// A tick with its label.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Tick {
    pub(super) value: f64,
    /// Empty if the axis has no labels.
    pub(super) text: String,
}

/// A linear axis.
#[derive(Clone, Debug)]
pub struct Axis {
    pub(super) label: String,
    pub(super) range: [f64; 2],
    pub(super) ticks: Vec<Tick>,
}

impl Axis {
    /// Creates an axis with about `count` round tick values. An empty range is widened; one that is
    /// not finite becomes 0 to 1.
    pub fn new(label: &str, range: [f64; 2], count: f64) -> Self {
        let range = match range {
            [low, high] if !(low.is_finite() && high.is_finite()) => [0.0, 1.0],
            [low, high] if high - low > 1e-9 * (1.0 + low.abs().max(high.abs())) => [low, high],
            [low, _] => [low, low + (1e-3 * low.abs()).max(1.0)],
        };
        Self {
            label: label.to_owned(),
            range,
            ticks: ticks(range, step((range[1] - range[0]) / count)),
        }
    }

    /// Creates an axis from 0 to 1.
    pub fn fractions(label: &str) -> Self {
        Self::new(label, [0.0, 1.0], 5.0)
    }

    /// Creates an axis of counts from 0 to at least `max`, with about three integer ticks.
    pub fn counts(label: &str, max: usize) -> Self {
        let max = max.max(1) as f64;
        let step = step(max / 2.0).max(1.0);
        let range = [0.0, (max / step).ceil() * step];
        let mut ticks = ticks(range, step);
        for tick in &mut ticks {
            tick.text = count(tick.value as usize);
        }
        Self {
            label: label.to_owned(),
            range,
            ticks,
        }
    }

    /// Creates an axis in px from the left or lower edge, without ticks.
    pub fn pixels(length: f64) -> Self {
        Self {
            label: String::new(),
            range: [0.0, length],
            ticks: Vec::new(),
        }
    }

    /// Removes all texts but keeps the ticks: for a panel that shares the axis of the panel below.
    #[must_use]
    pub fn without_labels(mut self) -> Self {
        self.label.clear();
        for tick in &mut self.ticks {
            tick.text.clear();
        }
        self
    }

    /// Minimum and maximum.
    pub fn range(&self) -> [f64; 2] {
        self.range
    }

    /// Whether a value is in the range.
    pub fn contains(&self, value: f64) -> bool {
        (self.range[0]..=self.range[1]).contains(&value)
    }

    /// Width of tick labels and axis label at the left of a panel, px.
    pub fn width_px(&self) -> f64 {
        let widths = self.ticks.iter().map(|tick| width(&tick.text, SMALL));
        super::panel::UPRIGHT + super::panel::GAP + widths.fold(0.0, f64::max)
    }

    /// Position of a value in the range, 0 to 1.
    pub(super) fn fraction(&self, value: f64) -> f64 {
        let [low, high] = self.range;
        ((value - low) / (high - low)).clamp(0.0, 1.0)
    }
}

/// The smallest of 1, 2 and 5 times a power of ten that is not below `rough`.
fn step(rough: f64) -> f64 {
    let power = 10_f64.powf(rough.log10().floor());
    let factors = [1.0, 2.0, 5.0].into_iter();
    // Tolerance for inexact quotients.
    let factor = factors.into_iter().find(|f| f * power >= 0.999 * rough);
    power * factor.unwrap_or(10.0)
}

/// Multiples of `step` in a range.
fn ticks([low, high]: [f64; 2], step: f64) -> Vec<Tick> {
    const SLACK: f64 = 1e-6;
    let decimals = (-(step.log10() + SLACK).floor()).clamp(0.0, 9.0) as usize;
    let first = (low / step - SLACK).ceil() as i64;
    let last = (high / step + SLACK).floor() as i64;
    let tick = |i: i64| {
        let value = i as f64 * step;
        Tick {
            value,
            text: fixed(value, decimals),
        }
    };
    (first..=last).map(tick).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn texts(axis: &Axis) -> Vec<String> {
        axis.ticks.iter().map(|tick| tick.text.clone()).collect()
    }

    #[test]
    fn tick_values_are_round_and_reach_the_ends() {
        let axis = Axis::fractions("");
        assert_eq!(texts(&axis), ["0.0", "0.2", "0.4", "0.6", "0.8", "1.0"]);
        // 0.7 / 0.05 is less than 14.
        let axis = Axis::new("", [0.5, 0.7], 5.0);
        assert_eq!(texts(&axis), ["0.50", "0.55", "0.60", "0.65", "0.70"]);
        let axis = Axis::new("", [-0.3, 0.3], 5.0);
        assert_eq!(texts(&axis), ["−0.2", "0.0", "0.2"]);
        let axis = Axis::new("", [0.0, 46.0], 6.0);
        assert_eq!(texts(&axis), ["0", "10", "20", "30", "40"]);
    }

    #[test]
    fn count_ticks_are_integers() {
        assert_eq!(texts(&Axis::counts("", 0)), ["0", "1"]);
        assert_eq!(texts(&Axis::counts("", 3)), ["0", "2", "4"]);
        assert_eq!(texts(&Axis::counts("", 230)), ["0", "200", "400"]);
        let axis = Axis::counts("", 17_000);
        assert_eq!(texts(&axis), ["0", "10,000", "20,000"]);
        for highest in 1..500 {
            let axis = Axis::counts("", highest);
            assert!(axis.range[1] >= highest as f64);
            assert!((2..=4).contains(&axis.ticks.len()), "{highest}");
        }
    }

    #[test]
    fn empty_range_is_widened() {
        assert_eq!(Axis::new("", [3.0, 3.0], 5.0).range, [3.0, 4.0]);
        assert_eq!(Axis::new("", [2.0, 1.0], 5.0).range, [2.0, 3.0]);
        for range in [[f64::NAN, 1.0], [0.0, f64::INFINITY]] {
            assert_eq!(Axis::new("", range, 5.0).range, [0.0, 1.0]);
        }
        let tiny = Axis::new("", [1e12, 1e12 + 1e-4], 5.0);
        assert!(tiny.ticks.len() < 10 && tiny.fraction(1e12).is_finite());
    }

    #[test]
    fn extent_skips_non_finite_values() {
        let values = [f64::NAN, 2.0, f64::INFINITY, -1.0, -1e300];
        assert_eq!(extent(values.into_iter()), Some([-1.0, 2.0]));
        assert_eq!(extent(std::iter::empty()), None);
    }
}
