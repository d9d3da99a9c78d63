//! Round numbers along an axis of a diagram.

/// A round distance between ticks, about `count` of them in `range`, and its decimals.
pub fn tick_step(range: f64, count: f64) -> (f64, usize) {
    let rough = range / count;
    let power = rough.log10().floor();
    let unit = 10f64.powf(power);
    let factor = [1.0, 2.0, 5.0]
        .into_iter()
        .find(|f| f * unit >= rough * 0.999);
    let step = unit * factor.unwrap_or(10.0);
    let decimals = (-step.log10().floor()).clamp(0.0, 9.0) as usize;
    (step, decimals)
}

/// Multiples of `step` from `low` to `high`.
pub fn ticks(low: f64, high: f64, step: f64) -> impl Iterator<Item = f64> {
    let (first, last) = ((low / step).ceil() as i64, (high / step).floor() as i64);
    (first..=last).map(move |i| i as f64 * step)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ticks_are_round() {
        assert_eq!(tick_step(46.0, 6.0), (10.0, 0));
        assert_eq!(tick_step(4.5, 10.0), (0.5, 1));
        assert_eq!(tick_step(0.12, 6.0).0, 0.02);
        let all: Vec<f64> = ticks(-3.0, 11.0, 5.0).collect();
        assert_eq!(all, [0.0, 5.0, 10.0]);
    }
}
