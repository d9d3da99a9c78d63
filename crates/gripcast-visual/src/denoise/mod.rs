//! Denoiser: non-local means guided by albedo, normal and depth of the first surfaces.
//!
//! A pixel becomes the weighted mean of its neighbourhood. Weights compare small patches of light,
//! demodulated by the albedo so that textures stay sharp, relative to the expected noise, and the
//! first surfaces. The weights for one half of the paths come from the other half, so that noise
//! does not select itself.
//!
//! A firefly (a pixel dominated by one or a few very bright paths) would be spread over its
//! neighbourhood as a bright square. Its weight is reduced (see [`noise::trust`]); its excess light
//! is lost, as with a clamp. Sources: Buades, Coll, Morel, *A non-local algorithm for image
//! denoising* (2005); Rousselle, Knaus, Zwicker, *Adaptive rendering with non-local means
//! filtering* (2012); Rousselle, Manzi, Zwicker, *Robust denoising using feature and color
//! information* (2013).

mod filter;
mod noise;

use rayon::prelude::*;

use self::filter::Guide;
use super::linear_image::Image;
use super::renderer::Rendering;

/// Minimum albedo by which light is demodulated.
const MIN_ALBEDO: f32 = 0.02;
/// Rows filtered together.
const BAND: usize = 16;

/// Usual radius of the search window of [`denoise`], px.
pub const DENOISE_RADIUS_PX: usize = 7;

/// Demodulated light of one half of the paths.
type Light = Vec<[f32; 3]>;

/// Returns the denoised image; `radius_px` is the radius of the search window.
pub fn denoise(rendering: &Rendering, radius_px: usize) -> Image {
    let (width, height) = (rendering.image.width, rendering.image.height);
    let albedo: Vec<[f32; 3]> = (0..width * height)
        .map(|at| match rendering.depth_m[at] > 0.0 {
            true => rendering.albedo.pixels[at].map(|a| a.max(MIN_ALBEDO)),
            false => [1.0; 3],
        })
        .collect();
    let halves: [Light; 2] = [0, 1].map(|half| {
        let pixels = rendering.halves[half].pixels.iter().zip(&albedo);
        pixels
            .map(|(p, a)| std::array::from_fn(|k| p[k] / a[k]))
            .collect()
    });
    let guide = Guide::new(rendering, radius_px, &halves, &albedo);
    let bands: Vec<Vec<[f32; 3]>> = (0..height.div_ceil(BAND))
        .into_par_iter()
        .map(|band| guide.filter(band * BAND..height.min((band + 1) * BAND)))
        .collect();
    let mut image = rendering.image.clone();
    for (at, light) in bands.into_iter().flatten().enumerate() {
        image.pixels[at] = std::array::from_fn(|k| light[k] * albedo[at][k]);
    }
    image
}

#[inline(always)]
fn add(sums: &mut [f32], values: &[f32]) {
    for (sum, value) in sums.iter_mut().zip(values) {
        *sum += value;
    }
}

#[cfg(test)]
mod tests {
    use super::noise::{trust, variance_of_paths};
    use super::*;

    /// A wall of two colours, half lit and half in shade, with noise.
    fn noisy() -> (Rendering, Image) {
        noisy_by(0.5)
    }

    /// With noise of this fraction of the light.
    fn noisy_by(noise: f32) -> (Rendering, Image) {
        let (width, height) = (48, 32);
        let mut truth = Image::filled(width, height, [0.0; 3]);
        let mut rendering = Rendering {
            image: truth.clone(),
            variance: Image::filled(width, height, [0.0; 3]),
            halves: [truth.clone(), truth.clone()],
            albedo: truth.clone(),
            normal: Image::filled(width, height, [0.0, 0.0, 1.0]),
            depth_m: vec![1.0; width * height],
        };
        let mut state = 1u64;
        let mut number = move || {
            state = state
                .wrapping_mul(6_364_136_223_846_793_005)
                .wrapping_add(1);
            (state >> 40) as f32 / (1u64 << 24) as f32 - 0.5
        };
        for at in 0..width * height {
            let (column, row) = (at % width, at / width);
            let albedo = if column / 3 % 2 == 0 { 0.8 } else { 0.2 };
            let light = if row < height / 2 { 1.0 } else { 0.3 };
            truth.pixels[at] = [albedo * light; 3];
            rendering.albedo.pixels[at] = [albedo; 3];
            let sigma = noise * light;
            let [a, b] = [(); 2].map(|()| albedo * (light + sigma * 12f32.sqrt() * number()));
            rendering.halves[0].pixels[at] = [a; 3];
            rendering.halves[1].pixels[at] = [b; 3];
            rendering.image.pixels[at] = [0.5 * (a + b); 3];
            rendering.variance.pixels[at] = [0.5 * (albedo * sigma).powi(2); 3];
        }
        (rendering, truth)
    }

    #[test]
    fn noise_shrinks_and_edges_stay_sharp() {
        let (rendering, truth) = noisy();
        let before = rendering.image.rmse(&truth).unwrap();
        let image = denoise(&rendering, DENOISE_RADIUS_PX);
        let after = image.rmse(&truth).unwrap();
        assert!(after < 0.35 * before, "{before} to {after}");
        // The stripes of the texture keep their contrast.
        let row = |r: usize| (0..48).map(move |c| (c, r));
        for (column, row) in row(5).chain(row(26)) {
            let [found, wanted] = [&image, &truth].map(|p| p.at(column, row)[0]);
            assert!(
                (found / wanted - 1.0).abs() < 0.35,
                "{column}, {row}: {found} {wanted}"
            );
        }
    }

    #[test]
    fn noise_free_image_is_unchanged() {
        let (mut rendering, truth) = noisy();
        rendering.image = truth.clone();
        rendering.halves = [truth.clone(), truth.clone()];
        rendering.variance.pixels.fill([0.0; 3]);
        let image = denoise(&rendering, DENOISE_RADIUS_PX);
        assert!(image.rmse(&truth).unwrap() < 1e-4);
    }

    /// One path of many that is `factor` times the mean of all pixels after all are averaged.
    fn add_firefly(rendering: &mut Rendering, at: usize, factor: f32) {
        let mean = rendering.image.mean()[0] as f32;
        let extra = factor * mean;
        for value in &mut rendering.image.pixels[at] {
            *value += extra;
        }
        for value in &mut rendering.halves[0].pixels[at] {
            *value += 2.0 * extra;
        }
        for value in &mut rendering.variance.pixels[at] {
            *value += extra * extra;
        }
    }

    #[test]
    fn fireflies_leave_no_squares() {
        let (clean, truth) = noisy_by(0.1);
        let wanted = denoise(&clean, DENOISE_RADIUS_PX);
        // In the middle, near another, and in a corner.
        let fireflies = [(20, 10), (25, 12), (47, 31)];
        let mut rendering = clean;
        for ((column, row), factor) in fireflies.iter().zip([1000.0, 50.0, 1000.0]) {
            add_firefly(&mut rendering, row * 48 + column, factor);
        }
        let found = denoise(&rendering, DENOISE_RADIUS_PX);
        for (at, (found, wanted)) in found.pixels.iter().zip(&wanted.pixels).enumerate() {
            let ratio = found[0] / wanted[0];
            // Spread evenly, 1000 means would be 4.4 means a pixel.
            let pixel = (at % 48, at / 48);
            assert!((ratio - 1.0).abs() < 0.04, "{pixel:?}: {ratio}");
        }
        let [before, after] = [&wanted, &found].map(|p| p.rmse(&truth).unwrap());
        assert!(after < 1.05 * before, "{before} to {after}");
    }

    #[test]
    fn bright_pixel_of_many_paths_is_not_a_firefly() {
        let (mut rendering, _) = noisy();
        let of = |rendering: &Rendering| {
            let albedo = vec![[1.0; 3]; 48 * 32];
            let halves = [0, 1].map(|half: usize| rendering.halves[half].pixels.clone());
            let of_paths = variance_of_paths(rendering, &albedo);
            trust(&halves, &of_paths, [48, 32], 7)
        };
        assert!(of(&rendering).iter().all(|t| *t == 1.0));
        // A glint that a quarter of 64 paths meet.
        let at = 10 * 48 + 20;
        for image in [&mut rendering.image]
            .into_iter()
            .chain(&mut rendering.halves)
        {
            image.pixels[at] = [300.0; 3];
        }
        rendering.variance.pixels[at] = [300.0f32.powi(2) * 3.0 / 64.0; 3];
        assert!(of(&rendering).iter().all(|t| *t == 1.0));
    }
}
