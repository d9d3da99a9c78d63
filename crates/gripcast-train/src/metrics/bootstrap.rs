//! Confidence intervals over objects by cluster bootstrap: grasps of one object are correlated, so
//! objects are resampled (Davison & Hinkley 1997, §3.8).

use std::fmt;

use serde::{Deserialize, Serialize};

use gripcast_base::random;
use gripcast_base::statistics::quantile;

/// Default number of resamples.
const RESAMPLES: usize = 2000;

/// Quantiles of the 95 % interval.
const QUANTILES: [f64; 2] = [0.025, 0.975];

/// Settings of a bootstrap; equal settings and samples give equal intervals.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Bootstrap {
    /// Number of resamples.
    pub resamples: usize,
    /// Random seed.
    pub seed: u64,
}

/// A metric with its 95 % percentile interval.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Interval {
    /// Metric of the samples.
    pub estimate: f64,
    /// 2.5 % quantile over the resamples.
    pub low: f64,
    /// 97.5 % quantile over the resamples.
    pub high: f64,
    /// Number of resamples in which the metric is defined.
    pub resamples: usize,
}

impl fmt::Display for Interval {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let text = format!("{:.3} [{:.3}, {:.3}]", self.estimate, self.low, self.high);
        f.pad(&text)
    }
}

impl Bootstrap {
    /// Returns a bootstrap with 2,000 resamples.
    pub fn new(seed: u64) -> Self {
        Self {
            resamples: RESAMPLES,
            seed,
        }
    }

    /// Computes the interval of a metric. `objects` holds the object of each sample; `metric` gets
    /// the multiplicity of each sample in a resample, see
    /// [`Ranking::resampled_auroc`](super::Ranking::resampled_auroc) and [`resampled_mean`].
    ///
    /// None with fewer than two objects, or if the metric of the samples or of all resamples is
    /// undefined.
    pub fn interval(
        &self,
        objects: &[usize],
        metric: impl Fn(&[u32]) -> Option<f64>,
    ) -> Option<Interval> {
        let defined = |multiplicities: &[u32]| metric(multiplicities).filter(|f| f.is_finite());
        let (clusters, count) = numbered(objects);
        if count < 2 {
            return None;
        }
        let estimate = defined(&vec![1; objects.len()])?;
        let mut drawn = vec![0; count];
        let mut multiplicities = vec![0; objects.len()];
        let mut metrics = Vec::new();
        for resample in 0..self.resamples {
            self.draw(resample, &mut drawn);
            for (times, &cluster) in multiplicities.iter_mut().zip(&clusters) {
                *times = drawn.get(cluster).copied().unwrap_or(0);
            }
            metrics.extend(defined(&multiplicities));
        }
        metrics.sort_by(f64::total_cmp);
        let [low, high] = QUANTILES.map(|fraction| quantile(&metrics, fraction));
        Some(Interval {
            estimate,
            low: low?,
            high: high?,
            resamples: metrics.len(),
        })
    }

    /// Computes the interval of the first metric minus the second on the same resamples (two
    /// models on the same samples), as [`Bootstrap::interval`].
    pub fn paired_interval(
        &self,
        objects: &[usize],
        first: impl Fn(&[u32]) -> Option<f64>,
        second: impl Fn(&[u32]) -> Option<f64>,
    ) -> Option<Interval> {
        self.interval(objects, |multiplicities| {
            Some(first(multiplicities)? - second(multiplicities)?)
        })
    }

    /// Draws as many objects as there are, with replacement; counts each.
    fn draw(&self, resample: usize, drawn: &mut [u32]) {
        drawn.fill(0);
        let count = drawn.len() as u64;
        for i in 0..count {
            let bits = random::numbered(self.seed, resample as u64 * count + i);
            // The upper half of the product is uniform below `count`.
            let object = (u128::from(bits) * u128::from(count)) >> 64;
            if let Some(times) = drawn.get_mut(object as usize) {
                *times += 1;
            }
        }
    }
}

/// Mean of a resample: value `i` counts `multiplicities[i]` times. NaN and infinite values are
/// ignored; none without values.
pub fn resampled_mean(values: &[f64], multiplicities: &[u32]) -> Option<f64> {
    let present = values.iter().zip(multiplicities);
    let (sum, n) = present
        .filter(|(value, _)| value.is_finite())
        .fold((0.0, 0_u64), |(sum, n), (value, &times)| {
            (sum + f64::from(times) * value, n + u64::from(times))
        });
    (n > 0).then(|| sum / n as f64)
}

/// Renumbers the objects from 0 without gaps; also returns their number.
fn numbered(objects: &[usize]) -> (Vec<usize>, usize) {
    let mut names = objects.to_vec();
    names.sort_unstable();
    names.dedup();
    let number = |object: &usize| names.partition_point(|name| name < object);
    (objects.iter().map(number).collect(), names.len())
}

/// Random number `counter` of a seed, uniform in [0, 1).
pub(super) fn unit(seed: u64, counter: u64) -> f64 {
    random::unit(random::numbered(seed, counter))
}

#[cfg(test)]
#[path = "bootstrap_test.rs"]
mod tests;
