//! Film: pixel filter and accumulation of path samples.

use glam::{DVec3, Vec3};

use super::settings::PixelFilter;

const ENTRIES: usize = 256;
/// Standard deviation and cut-off radius of the Gaussian filter, px.
const SIGMA: f64 = 0.5;
const CUT: f64 = 2.0;

/// Reconstruction filter for filter importance sampling: pixel offsets are drawn from the filter
/// and every path has the same weight.
#[derive(Debug)]
pub(super) struct FilterTable {
    /// Inverse CDF at equal steps: offset from the pixel centre, px.
    offsets: [f32; ENTRIES + 1],
}

impl FilterTable {
    pub(super) fn new(filter: PixelFilter) -> Self {
        let radius = match filter {
            PixelFilter::Box => 0.5,
            PixelFilter::Gaussian => CUT,
        };
        let height = |x: f64| match filter {
            PixelFilter::Box => 1.0,
            PixelFilter::Gaussian => (-0.5 * (x / SIGMA).powi(2)).exp(),
        };
        let steps = 1 << 14;
        let width = 2.0 * radius / f64::from(steps);
        let middle = |i: u32| -radius + width * (f64::from(i) + 0.5);
        let total: f64 = (0..steps).map(|i| height(middle(i))).sum();
        let mut offsets = [radius as f32; ENTRIES + 1];
        let (mut sum, mut entry) = (0.0, 0);
        for i in 0..steps {
            let next = sum + height(middle(i)) / total;
            while entry < ENTRIES && entry as f64 / ENTRIES as f64 <= next {
                let within = (entry as f64 / ENTRIES as f64 - sum) / (next - sum);
                offsets[entry] = (middle(i) + width * (within - 0.5)) as f32;
                entry += 1;
            }
            sum = next;
        }
        Self { offsets }
    }

    /// Returns the offset for a random number in [0, 1), px.
    #[inline(always)]
    pub(super) fn offset(&self, u: f32) -> f32 {
        let x = u * ENTRIES as f32;
        let entry = (x as usize).min(ENTRIES - 1);
        let (a, b) = (self.offsets[entry], self.offsets[entry + 1]);
        a + (b - a) * (x - entry as f32)
    }
}

/// Contribution of one path.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct PathSample {
    pub(super) radiance: Vec3,
    /// Albedo of the first surface; for the environment its radiance, clipped to 1.
    pub(super) albedo: Vec3,
    /// Shading normal of the first surface, world; 0 for the environment.
    pub(super) normal: Vec3,
}

/// Sums over the paths of a pixel.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct PixelSums {
    radiance: DVec3,
    squares: DVec3,
    /// Radiance of the first half of the paths.
    first_half: DVec3,
    albedo: Vec3,
    normal: Vec3,
}

/// Means over the paths of a pixel.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct PixelMeans {
    pub(super) radiance: [f32; 3],
    /// Variance of the mean radiance, assuming independent paths.
    pub(super) variance: [f32; 3],
    /// Mean radiance of each half of the paths.
    pub(super) halves: [[f32; 3]; 2],
    pub(super) albedo: [f32; 3],
    pub(super) normal: [f32; 3],
}

impl PixelSums {
    #[inline(always)]
    pub(super) fn add(&mut self, sample: &PathSample, in_first_half: bool) {
        let radiance = sample.radiance.as_dvec3();
        self.radiance += radiance;
        self.squares += radiance * radiance;
        if in_first_half {
            self.first_half += radiance;
        }
        self.albedo += sample.albedo;
        self.normal += sample.normal;
    }

    /// Returns the means over `samples` paths, of which the first `first` form the first half.
    pub(super) fn means(&self, samples: u32, first: u32) -> PixelMeans {
        let n = f64::from(samples);
        let mean = self.radiance / n;
        let variance = std::array::from_fn(|k| {
            let spread = (self.squares[k] / n - mean[k] * mean[k]).max(0.0);
            (spread / (n - 1.0).max(1.0)) as f32
        });
        let half = |sum: f64, count: u32, mean: f64| match count {
            0 => mean as f32,
            count => (sum / f64::from(count)) as f32,
        };
        let halves = [
            std::array::from_fn(|k| half(self.first_half[k], first, mean[k])),
            std::array::from_fn(|k| {
                half(
                    self.radiance[k] - self.first_half[k],
                    samples - first,
                    mean[k],
                )
            }),
        ];
        PixelMeans {
            radiance: mean.as_vec3().to_array(),
            variance,
            halves,
            albedo: (self.albedo / samples as f32).to_array(),
            normal: (self.normal / samples as f32).to_array(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn offsets_follow_filter_distribution() {
        let spread = |filter| {
            let table = FilterTable::new(filter);
            let offsets = (0..4096).map(|i| table.offset((i as f32 + 0.5) / 4096.0));
            let sum: f64 = offsets.map(|x| f64::from(x).powi(2)).sum();
            (sum / 4096.0).sqrt()
        };
        assert!((spread(PixelFilter::Box) - 1.0 / 12f64.sqrt()).abs() < 1e-3);
        // The cut at 4 σ takes little off.
        assert!((spread(PixelFilter::Gaussian) - SIGMA).abs() < 5e-3);
        let table = FilterTable::new(PixelFilter::Gaussian);
        assert!(table.offset(0.5).abs() < 1e-3 && table.offset(0.0) == -2.0);
    }

    #[test]
    fn sums_give_mean_variance_and_halves() {
        let mut sums = PixelSums::default();
        for value in [1.0, 3.0, 5.0, 7.0] {
            let sample = PathSample {
                radiance: Vec3::splat(value),
                ..PathSample::default()
            };
            sums.add(&sample, value < 4.0);
        }
        let means = sums.means(4, 2);
        assert_eq!(means.radiance[0], 4.0);
        assert_eq!([means.halves[0][1], means.halves[1][1]], [2.0, 6.0]);
        // Variance 20/3 of the values, a quarter of it for the mean.
        assert!((means.variance[2] - 5.0 / 3.0).abs() < 1e-6);
    }
}
