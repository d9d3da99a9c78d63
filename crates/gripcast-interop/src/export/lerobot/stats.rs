//! `meta/stats.json`: least, largest, mean and spread of every feature, over all frames.
//!
//! Colours are in [0, 1], as LeRobot loads them, depth in counts. Numbers that a grasp lacks do not
//! count. Quantiles are not written: LeRobot adds them where a policy wants them.

use serde_json::{Map, Value, json};

use super::features::{DEPTH, Features, colour_name};
use super::frames::FrameRow;
use gripcast_base::error::{Error, Result};
use gripcast_dataset::shard::TableKind;

/// Largest value of an 8-bit channel.
const WHITE: f64 = 255.0;

/// Of all features.
pub(super) struct Stats {
    frames: usize,
    colour: Vec<(String, [Levels; 3])>,
    depth: Option<Levels>,
    numbers: Vec<(String, Vec<Spread>)>,
}

/// Of the pixels of a channel; exact.
#[derive(Clone, Copy)]
struct Levels {
    least: u16,
    largest: u16,
    count: u64,
    sum: u128,
    squares: u128,
}

/// Of numbers, one after the other (Welford).
#[derive(Clone, Copy)]
struct Spread {
    least: f64,
    largest: f64,
    count: u64,
    mean: f64,
    squares: f64,
}

impl Levels {
    const NONE: Self = Self {
        least: u16::MAX,
        largest: 0,
        count: 0,
        sum: 0,
        squares: 0,
    };

    fn add(&mut self, levels: impl Iterator<Item = u16>) {
        // An image's sums fit: 2²⁶ pixels of 16 bits, squared, are below 2⁵⁸.
        let (mut sum, mut squares) = (0_u64, 0_u64);
        for level in levels {
            self.least = self.least.min(level);
            self.largest = self.largest.max(level);
            self.count += 1;
            sum += u64::from(level);
            squares += u64::from(level) * u64::from(level);
        }
        self.sum += u128::from(sum);
        self.squares += u128::from(squares);
    }

    /// Least, largest, mean, standard deviation; divided by `scale`.
    fn figures(&self, scale: f64) -> [f64; 4] {
        let count = self.count.max(1) as f64;
        let mean = self.sum as f64 / count;
        let variance = (self.squares as f64 / count - mean * mean).max(0.0);
        [
            f64::from(self.least),
            f64::from(self.largest),
            mean,
            variance.sqrt(),
        ]
        .map(|figure| figure / scale)
    }
}

impl Spread {
    const NONE: Self = Self {
        least: f64::INFINITY,
        largest: f64::NEG_INFINITY,
        count: 0,
        mean: 0.0,
        squares: 0.0,
    };

    fn add(&mut self, number: f64) {
        if number.is_nan() {
            return;
        }
        self.least = self.least.min(number);
        self.largest = self.largest.max(number);
        self.count += 1;
        let before = number - self.mean;
        self.mean += before / self.count as f64;
        self.squares += before * (number - self.mean);
    }

    fn figures(&self) -> [f64; 4] {
        let deviation = (self.squares / self.count.max(1) as f64).sqrt();
        [self.least, self.largest, self.mean, deviation]
    }
}

impl Stats {
    pub(super) fn new(features: &Features) -> Self {
        let colour = features.colour.iter();
        let numbers = features.columns().into_iter().filter_map(|(name, kind)| {
            let length = match kind {
                TableKind::Image => return None,
                TableKind::Singles(length) => length,
                _ => 1,
            };
            Some((name, vec![Spread::NONE; length]))
        });
        Self {
            frames: 0,
            colour: colour
                .map(|(role, _)| (colour_name(*role), [Levels::NONE; 3]))
                .collect(),
            depth: features.depth.map(|_| Levels::NONE),
            numbers: numbers.collect(),
        }
    }

    pub(super) fn add(&mut self, frame: &FrameRow) {
        self.frames += 1;
        for ((_, channels), pixels) in self.colour.iter_mut().zip(frame.colour()) {
            for (channel, levels) in channels.iter_mut().enumerate() {
                levels.add(pixels.pixels().map(|pixel| u16::from(pixel.0[channel])));
            }
        }
        if let (Some(levels), Some(counts)) = (&mut self.depth, frame.depth()) {
            levels.add(counts.iter().copied());
        }
        for ((_, spreads), numbers) in self.numbers.iter_mut().zip(&frame.numbers) {
            for (spread, number) in spreads.iter_mut().zip(numbers) {
                spread.add(*number);
            }
        }
    }

    /// # Errors
    /// `Internal`: a defect.
    pub(super) fn to_json(&self) -> Result<Vec<u8>> {
        let mut stats = Map::new();
        for (name, channels) in &self.colour {
            let figures = channels.map(|levels| levels.figures(WHITE));
            stats.insert(name.clone(), self.image(&figures));
        }
        if let Some(levels) = &self.depth {
            let figures = [levels.figures(1.0)];
            stats.insert(DEPTH.to_owned(), self.image(&figures));
        }
        for (name, spreads) in &self.numbers {
            // All are counted in the same frames.
            let count = spreads.iter().map(|spread| spread.count).min().unwrap_or(0);
            if count > 0 {
                let figures: Vec<[f64; 4]> = spreads.iter().map(Spread::figures).collect();
                let of = |which: usize| figures.iter().map(|f| json!(f[which])).collect();
                stats.insert(name.clone(), object(of, count));
            }
        }
        let mut text = serde_json::to_vec_pretty(&stats)
            .map_err(|e| Error::internal("cannot write the statistics").because(e))?;
        text.push(b'\n');
        Ok(text)
    }

    /// Channels × 1 × 1.
    fn image(&self, channels: &[[f64; 4]]) -> Value {
        let of = |which: usize| channels.iter().map(|f| json!([[f[which]]])).collect();
        object(of, self.frames as u64)
    }
}

fn object(of: impl Fn(usize) -> Vec<Value>, count: u64) -> Value {
    json!({
        "min": of(0),
        "max": of(1),
        "mean": of(2),
        "std": of(3),
        "count": [count],
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn both_ways_of_adding_up_agree() {
        let values = [0_u16, 3, 65_535, 7, 7, 1200];
        let (mut levels, mut spread) = (Levels::NONE, Spread::NONE);
        levels.add(values[..2].iter().copied());
        levels.add(values[2..].iter().copied());
        for value in values {
            spread.add(f64::from(value));
        }
        spread.add(f64::NAN);
        for (a, b) in levels.figures(1.0).into_iter().zip(spread.figures()) {
            assert!((a - b).abs() < 1e-9 * b.abs().max(1.0), "{a} {b}");
        }
        assert_eq!(levels.figures(1.0)[..2], [0.0, 65_535.0]);
        // Mean and standard deviation by hand: 66752 / 6, and the root of the mean square less it.
        assert!((spread.mean - 66_752.0 / 6.0).abs() < 1e-9);
    }
}
