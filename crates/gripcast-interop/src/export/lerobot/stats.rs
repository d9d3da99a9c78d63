//! `meta/stats.json`: minimum, maximum, mean and standard deviation of every feature.
//!
//! Colours are in [0, 1], as LeRobot loads them, depth in counts. Missing numbers are skipped.
//! Quantiles are not written: LeRobot computes them where a policy needs them.

use serde_json::{Map, Value, json};

use super::features::{DEPTH, Features, colour_name};
use super::frames::FrameRow;
use gripcast_base::error::{Error, Result};
use gripcast_dataset::shard::ColumnType;

/// Maximum value of an 8-bit channel.
const WHITE: f64 = 255.0;

/// Statistics of all features.
pub(super) struct Stats {
    frames: usize,
    colour: Vec<(String, [PixelStats; 3])>,
    depth: Option<PixelStats>,
    numbers: Vec<(String, Vec<RunningStats>)>,
}

/// Exact statistics of the pixels of a channel.
#[derive(Clone, Copy)]
struct PixelStats {
    min: u16,
    max: u16,
    count: u64,
    sum: u128,
    squares: u128,
}

/// Running statistics of a number (Welford's algorithm).
#[derive(Clone, Copy)]
struct RunningStats {
    min: f64,
    max: f64,
    count: u64,
    mean: f64,
    squares: f64,
}

impl PixelStats {
    const NONE: Self = Self {
        min: u16::MAX,
        max: 0,
        count: 0,
        sum: 0,
        squares: 0,
    };

    fn add(&mut self, levels: impl Iterator<Item = u16>) {
        // The sums of an image fit: 2²⁶ squares of 16 bits are below 2⁵⁸.
        let (mut sum, mut squares) = (0_u64, 0_u64);
        for level in levels {
            self.min = self.min.min(level);
            self.max = self.max.max(level);
            self.count += 1;
            sum += u64::from(level);
            squares += u64::from(level) * u64::from(level);
        }
        self.sum += u128::from(sum);
        self.squares += u128::from(squares);
    }

    /// Minimum, maximum, mean, standard deviation; divided by `scale`.
    fn figures(&self, scale: f64) -> [f64; 4] {
        let count = self.count.max(1) as f64;
        let mean = self.sum as f64 / count;
        let variance = (self.squares as f64 / count - mean * mean).max(0.0);
        [
            f64::from(self.min),
            f64::from(self.max),
            mean,
            variance.sqrt(),
        ]
        .map(|figure| figure / scale)
    }
}

impl RunningStats {
    const NONE: Self = Self {
        min: f64::INFINITY,
        max: f64::NEG_INFINITY,
        count: 0,
        mean: 0.0,
        squares: 0.0,
    };

    fn add(&mut self, number: f64) {
        if number.is_nan() {
            return;
        }
        self.min = self.min.min(number);
        self.max = self.max.max(number);
        self.count += 1;
        let before = number - self.mean;
        self.mean += before / self.count as f64;
        self.squares += before * (number - self.mean);
    }

    fn figures(&self) -> [f64; 4] {
        let deviation = (self.squares / self.count.max(1) as f64).sqrt();
        [self.min, self.max, self.mean, deviation]
    }
}

impl Stats {
    pub(super) fn new(features: &Features) -> Self {
        let colour = features.colour.iter();
        let mut fields = features.fields.iter();
        let numbers = features.columns().into_iter().filter_map(|(name, kind)| {
            let length = match kind {
                ColumnType::Image => return None,
                ColumnType::Float32List(length) => length,
                // One figure for each component, which applies to the whole array.
                ColumnType::Float32Array(_) => fields.next()?.counts.columns.len(),
                _ => 1,
            };
            Some((name, vec![RunningStats::NONE; length]))
        });
        Self {
            frames: 0,
            colour: colour
                .map(|(role, _)| (colour_name(*role), [PixelStats::NONE; 3]))
                .collect(),
            depth: features.depth.map(|_| PixelStats::NONE),
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
        for ((_, spreads), numbers) in self.numbers.iter_mut().zip(frame.numbers()) {
            let components = spreads.len().max(1);
            for row in numbers.chunks_exact(components) {
                for (spread, number) in spreads.iter_mut().zip(row) {
                    spread.add(*number);
                }
            }
        }
    }

    /// # Errors
    /// `Internal`: a defect of gripcast.
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
            // All components have the same count.
            let count = spreads.iter().map(|spread| spread.count).min().unwrap_or(0);
            if count > 0 {
                let figures: Vec<[f64; 4]> = spreads.iter().map(RunningStats::figures).collect();
                let column = |which: usize| figures.iter().map(|f| json!(f[which])).collect();
                stats.insert(name.clone(), object(column, count));
            }
        }
        let mut text = serde_json::to_vec_pretty(&stats)
            .map_err(|e| Error::internal("cannot write the statistics").because(e))?;
        text.push(b'\n');
        Ok(text)
    }

    /// Statistics of an image, shape channels × 1 × 1.
    fn image(&self, channels: &[[f64; 4]]) -> Value {
        let column = |which: usize| channels.iter().map(|f| json!([[f[which]]])).collect();
        object(column, self.frames as u64)
    }
}

fn object(column: impl Fn(usize) -> Vec<Value>, count: u64) -> Value {
    json!({
        "min": column(0),
        "max": column(1),
        "mean": column(2),
        "std": column(3),
        "count": [count],
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pixel_and_running_stats_agree() {
        let values = [0_u16, 3, 65_535, 7, 7, 1200];
        let (mut levels, mut spread) = (PixelStats::NONE, RunningStats::NONE);
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
        // Mean by hand: 66752 / 6.
        assert!((spread.mean - 66_752.0 / 6.0).abs() < 1e-9);
    }
}
