//! Batch normalisation with ReLU (Ioffe and Szegedy, "Batch normalization", 2015).
//!
//! `a = max(0, γ·(z − mean)/√(var + ε) + β)` for each channel, mean and variance over all pixels of
//! all images of a batch.

use rayon::prelude::*;

use super::lanes::{Isa, Lanes, WithLanes};

/// Added to variances for numerical stability.
pub(super) const EPSILON: f32 = 1e-5;

/// Mean and variance of each channel.
#[derive(Clone, Debug, Default, PartialEq)]
pub(super) struct ChannelStats {
    pub(super) mean: Vec<f32>,
    /// Biased (population) variance.
    pub(super) variance: Vec<f32>,
}

impl ChannelStats {
    /// Computes the statistics of images of `image` floats each with `channels` channels.
    pub(super) fn from_images(z: &[f32], image: usize, channels: usize) -> Self {
        let partial_sums: Vec<Vec<[f64; 2]>> = z
            .par_chunks(image)
            .map(|z| {
                Isa::best().run(Sums {
                    z,
                    other: z,
                    channels,
                })
            })
            .collect();
        let count = (z.len() / channels) as f64;
        let mut stats = Self::default();
        for [sum, squares] in total(&partial_sums, channels) {
            let mean = sum / count;
            stats.mean.push(mean as f32);
            stats
                .variance
                .push((squares / count - mean * mean).max(0.0) as f32);
        }
        stats
    }

    /// `1/√(variance + ε)`.
    pub(super) fn inverse_deviation(&self) -> impl Iterator<Item = f32> {
        self.variance.iter().map(|v| 1.0 / (v + EPSILON).sqrt())
    }

    /// Scale and shift for [`normalise`].
    pub(super) fn scale_and_shift(&self, gamma: &[f32], beta: &[f32]) -> (Vec<f32>, Vec<f32>) {
        let scale: Vec<f32> = gamma
            .iter()
            .zip(self.inverse_deviation())
            .map(|(gamma, inverse)| gamma * inverse)
            .collect();
        let shift = beta
            .iter()
            .zip(self.mean.iter().zip(&scale))
            .map(|(beta, (mean, scale))| beta - mean * scale)
            .collect();
        (scale, shift)
    }
}

/// Adds partial sums in order.
fn total(partial_sums: &[Vec<[f64; 2]>], channels: usize) -> Vec<[f64; 2]> {
    let mut sums = vec![[0.0; 2]; channels];
    for partial in partial_sums {
        for (sum, partial) in sums.iter_mut().zip(partial) {
            sum[0] += partial[0];
            sum[1] += partial[1];
        }
    }
    sums
}

/// `a = max(0, z·scale + shift)`.
pub(super) fn normalise(z: &[f32], image: usize, scale: &[f32], shift: &[f32], a: &mut [f32]) {
    a.par_chunks_mut(image)
        .zip(z.par_chunks(image))
        .for_each(|(a, z)| Isa::best().run(Normalise { z, scale, shift, a }));
}

/// Forward values of a layer, for images of `image` floats.
#[derive(Clone, Copy, Debug)]
pub(super) struct Pass<'a> {
    /// Before normalisation.
    pub(super) z: &'a [f32],
    /// After ReLU.
    pub(super) a: &'a [f32],
    pub(super) image: usize,
    pub(super) stats: &'a ChannelStats,
    /// Whether the statistics are those of `z`, so that they depend on it.
    pub(super) is_of_batch: bool,
}

/// Returns the gradients of γ and β; replaces the gradient of `a` in `d` by that of `z`.
pub(super) fn backward(pass: Pass<'_>, gamma: &[f32], d: &mut [f32]) -> [Vec<f32>; 2] {
    let Pass {
        z,
        a,
        image,
        stats,
        is_of_batch,
    } = pass;
    let channels = gamma.len();
    let partial_sums: Vec<Vec<[f64; 2]>> = d
        .par_chunks_mut(image)
        .zip(a.par_chunks(image).zip(z.par_chunks(image)))
        .map(|(d, (a, z))| {
            Isa::best().run(Mask { a, d });
            Isa::best().run(Sums {
                z: d,
                other: z,
                channels,
            })
        })
        .collect();
    let count = (z.len() / channels) as f64;
    let inverse: Vec<f32> = stats.inverse_deviation().collect();
    // Constant statistics have no gradient.
    let of_batch = f64::from(u8::from(is_of_batch));
    let (mut dgamma, mut dbeta) = (Vec::new(), Vec::new());
    let (mut factor, mut slope, mut offset) = (Vec::new(), Vec::new(), Vec::new());
    for (c, [sum, with_z]) in total(&partial_sums, channels).into_iter().enumerate() {
        let (mean, inverse) = (f64::from(stats.mean[c]), f64::from(inverse[c]));
        // Σ d·(z − mean)/deviation.
        let with_normal = (with_z - mean * sum) * inverse;
        dgamma.push(with_normal as f32);
        dbeta.push(sum as f32);
        // dz = γ/deviation·(d − mean(d) − normal·mean(d·normal)), as factor·d + slope·z + offset.
        // Both means are the gradient of the statistics.
        let scale = f64::from(gamma[c]) * inverse;
        let of_z = -scale * inverse * with_normal / count * of_batch;
        factor.push(scale as f32);
        slope.push(of_z as f32);
        offset.push((-scale * sum / count * of_batch - of_z * mean) as f32);
    }
    d.par_chunks_mut(image)
        .zip(z.par_chunks(image))
        .for_each(|(d, z)| {
            Isa::best().run(Combine {
                d,
                z,
                factor: &factor,
                slope: &slope,
                offset: &offset,
            });
        });
    [dgamma, dbeta]
}

/// Sums of `z` and of `z·other` per channel, accumulated in f32 over short rows of pixels.
struct Sums<'a> {
    z: &'a [f32],
    other: &'a [f32],
    channels: usize,
}

/// Number of pixels accumulated in f32.
const FLOAT_PIXELS: usize = 64;

impl WithLanes for Sums<'_> {
    type Output = Vec<[f64; 2]>;

    #[inline(always)]
    fn with_lanes<S: Lanes>(self, _: S) -> Self::Output {
        let Self { z, other, channels } = self;
        let mut sums = vec![[0.0; 2]; channels];
        let (mut sum, mut product) = (vec![0.0_f32; channels], vec![0.0_f32; channels]);
        let some = FLOAT_PIXELS * channels;
        for (z, other) in z.chunks(some).zip(other.chunks(some)) {
            sum.fill(0.0);
            product.fill(0.0);
            for (z, other) in z.chunks_exact(channels).zip(other.chunks_exact(channels)) {
                for ((z, other), (sum, product)) in
                    z.iter().zip(other).zip(sum.iter_mut().zip(&mut product))
                {
                    *sum += z;
                    *product += z * other;
                }
            }
            for (sums, (sum, product)) in sums.iter_mut().zip(sum.iter().zip(&product)) {
                sums[0] += f64::from(*sum);
                sums[1] += f64::from(*product);
            }
        }
        sums
    }
}

struct Normalise<'a> {
    z: &'a [f32],
    scale: &'a [f32],
    shift: &'a [f32],
    a: &'a mut [f32],
}

impl WithLanes for Normalise<'_> {
    type Output = ();

    #[inline(always)]
    fn with_lanes<S: Lanes>(self, _: S) {
        let channels = self.scale.len();
        let pixels = self
            .a
            .chunks_exact_mut(channels)
            .zip(self.z.chunks_exact(channels));
        for (a, z) in pixels {
            for ((a, z), (scale, shift)) in
                a.iter_mut().zip(z).zip(self.scale.iter().zip(self.shift))
            {
                *a = (z * scale + shift).max(0.0);
            }
        }
    }
}

/// Clears gradients where ReLU was inactive.
struct Mask<'a> {
    a: &'a [f32],
    d: &'a mut [f32],
}

impl WithLanes for Mask<'_> {
    type Output = ();

    #[inline(always)]
    fn with_lanes<S: Lanes>(self, _: S) {
        for (d, a) in self.d.iter_mut().zip(self.a) {
            *d = if *a > 0.0 { *d } else { 0.0 };
        }
    }
}

struct Combine<'a> {
    d: &'a mut [f32],
    z: &'a [f32],
    factor: &'a [f32],
    slope: &'a [f32],
    offset: &'a [f32],
}

impl WithLanes for Combine<'_> {
    type Output = ();

    #[inline(always)]
    fn with_lanes<S: Lanes>(self, _: S) {
        let channels = self.factor.len();
        let pixels = self
            .d
            .chunks_exact_mut(channels)
            .zip(self.z.chunks_exact(channels));
        for (d, z) in pixels {
            let of_channel = self.factor.iter().zip(self.slope).zip(self.offset);
            for ((d, z), ((factor, slope), offset)) in d.iter_mut().zip(z).zip(of_channel) {
                *d = *d * factor + z * slope + offset;
            }
        }
    }
}
