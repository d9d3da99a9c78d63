//! Tabulated directional albedo of rough surfaces.

use glam::Vec3;

const ENTRIES: usize = 64;
/// Quadrature steps per dimension.
const STEPS: usize = 24;

/// Function of the cosine to the normal in [0, 1], interpolated linearly.
#[derive(Clone, Debug)]
pub(super) struct AlbedoTable {
    values: [f32; ENTRIES],
}

impl AlbedoTable {
    /// Tabulates the mean of `weight` over the unit square of random numbers for directions v at
    /// each angle to the normal.
    pub(super) fn new(weight: impl Fn(Vec3, [f32; 2]) -> f32) -> Self {
        let midpoint = |i: usize| (i as f32 + 0.5) / STEPS as f32;
        let albedo = |cos: f32| {
            let v = Vec3::new((1.0 - cos * cos).max(0.0).sqrt(), 0.0, cos);
            let mut sum = 0.0;
            for i in 0..STEPS {
                for j in 0..STEPS {
                    sum += f64::from(weight(v, [midpoint(i), midpoint(j)]));
                }
            }
            (sum / (STEPS * STEPS) as f64) as f32
        };
        let cos = |entry: usize| (entry as f32 / (ENTRIES - 1) as f32).max(1e-3);
        Self {
            values: std::array::from_fn(|entry| albedo(cos(entry))),
        }
    }

    /// Returns the value at a cosine.
    #[inline(always)]
    pub(super) fn at(&self, cos: f32) -> f32 {
        let x = cos.clamp(0.0, 1.0) * (ENTRIES - 1) as f32;
        let entry = (x as usize).min(ENTRIES - 2);
        let (a, b) = (self.values[entry], self.values[entry + 1]);
        a + (b - a) * (x - entry as f32)
    }

    /// Returns the cosine-weighted mean over the hemisphere.
    pub(super) fn mean(&self) -> f32 {
        let step = 1.0 / (ENTRIES - 1) as f64;
        let mut sum = 0.0;
        for (entry, pair) in self.values.windows(2).enumerate() {
            let (a, b) = (f64::from(pair[0]), f64::from(pair[1]));
            let start = entry as f64 * step;
            // ∫ 2 μ (a + (b - a) (μ - start)/step) dμ over the interval.
            sum += step * (start * (a + b) + step * (a + 2.0 * b) / 3.0);
        }
        sum as f32
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn mean_of_linear_function_is_exact() {
        let constant = AlbedoTable::new(|_, _| 0.7);
        assert!((constant.mean() - 0.7).abs() < 1e-6 && (constant.at(0.3) - 0.7).abs() < 1e-6);
        let linear = AlbedoTable::new(|v, _| v.z);
        assert!(
            (linear.mean() - 2.0 / 3.0).abs() < 1e-4,
            "{}",
            linear.mean()
        );
        assert!((linear.at(0.37) - 0.37).abs() < 1e-5);
    }
}
