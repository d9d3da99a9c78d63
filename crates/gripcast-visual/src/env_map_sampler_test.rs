use std::f32::consts::PI;

use super::super::linear_image::Image;
use super::super::sampler::SobolSampler;
use super::*;

/// EnvMapSampler with a gradient, a dark band and a small sun.
fn varied() -> EnvMap {
    let (width, height) = (64, 32);
    let mut map = Image::filled(width, height, [0.2, 0.3, 0.4]);
    for row in 0..height {
        for column in 0..width {
            let at = row * width + column;
            let value = &mut map.pixels[at];
            *value = value.map(|v| v * (1.0 + (column as f32 * 0.2).sin()));
            if (20..24).contains(&row) {
                *value = [0.0; 3];
            }
        }
    }
    map.pixels[9 * width + 40] = [4000.0, 3000.0, 2000.0];
    EnvMap {
        map,
        rotation_rad: 1.3,
        intensity: 0.5,
    }
}

fn samples(sampler: &EnvMapSampler, count: u32) -> Vec<EnvSample> {
    let net = SobolSampler::new(count, 4);
    (0..count)
        .map(|i| sampler.sample(net.sample(0, i).get_2d(0)))
        .collect()
}

#[test]
fn samples_agree_with_evaluation() {
    let sampler = EnvMapSampler::new(&varied());
    for sample in samples(&sampler, 4096) {
        let found = sampler.eval(sample.direction);
        assert!((sample.direction.length() - 1.0).abs() < 1e-5);
        let scale = sample.radiance.max_element();
        // Slopes beside the sun magnify the rounding of directions.
        assert!(
            (found.radiance - sample.radiance).abs().max_element() < 1e-2 * scale + 0.05,
            "{sample:?} {found:?}"
        );
        assert!((found.pdf - sample.pdf).abs() < 1e-2 * sample.pdf + 1e-3);
    }
}

#[test]
fn density_is_proportional_to_luminance_and_integrates_to_one() {
    let sampler = EnvMapSampler::new(&varied());
    let (rows, columns) = (1024, 2048);
    let mut sum = 0.0f64;
    let mut ratios: Vec<f32> = Vec::new();
    for row in 0..rows {
        let polar = PI * (row as f32 + 0.5) / rows as f32;
        for column in 0..columns {
            let azimuth = 2.0 * PI * (column as f32 + 0.5) / columns as f32;
            let direction = Vec3::new(
                polar.sin() * azimuth.cos(),
                polar.sin() * azimuth.sin(),
                polar.cos(),
            );
            let light = sampler.eval(direction);
            sum += f64::from(light.pdf * polar.sin());
            let value = luminance(light.radiance.to_array());
            // Not beside the sun: there the sine is that of its row.
            if (0.05..0.5).contains(&value) && (0.3..2.8).contains(&polar) {
                ratios.push(light.pdf / value);
            }
        }
    }
    let cell = 2.0 * std::f64::consts::PI.powi(2) / f64::from(rows * columns);
    assert!((sum * cell - 1.0).abs() < 2e-3, "{}", sum * cell);
    ratios.sort_by(f32::total_cmp);
    // Only the interpolation of the sine between the coarse rows makes a difference.
    let (low, high) = (ratios[0], ratios[ratios.len() - 1]);
    assert!(high / low < 1.15, "{low} {high}");
}

#[test]
fn irradiance_matches_closed_forms() {
    // Uniform: π L. Radiance 1 + z: π + 2π/3, from above.
    let horizontal = |env_map: &EnvMap| {
        let sampler = EnvMapSampler::new(env_map);
        let lights = samples(&sampler, 4096);
        let terms = lights
            .iter()
            .map(|l| l.radiance.x * l.direction.z.max(0.0) / l.pdf);
        terms.sum::<f32>() / 4096.0
    };
    let uniform = horizontal(&EnvMap::uniform([2.0; 3]));
    assert!((uniform - 2.0 * PI).abs() < 0.02, "{uniform}");
    let (width, height) = (8, 256);
    let mut map = Image::filled(width, height, [0.0; 3]);
    for row in 0..height {
        let z = (PI * (row as f32 + 0.5) / height as f32).cos();
        map.pixels[row * width..(row + 1) * width].fill([1.0 + z; 3]);
    }
    let gradient = horizontal(&EnvMap::new(map));
    assert!((gradient - PI * 5.0 / 3.0).abs() < 0.02, "{gradient}");
}

#[test]
fn directions_follow_documented_layout() {
    let mut map = Image::filled(8, 4, [0.0; 3]);
    // Left of the middle, upper half: around azimuth +π/8, polar 3π/8.
    map.pixels[8 + 3] = [1.0; 3];
    let polar = 3.0 * PI / 8.0;
    let towards = |azimuth: f32| {
        Vec3::new(
            polar.sin() * azimuth.cos(),
            polar.sin() * azimuth.sin(),
            polar.cos(),
        )
    };
    let env_map = EnvMap::new(map);
    let sampler = EnvMapSampler::new(&env_map);
    assert!((sampler.eval(towards(PI / 8.0)).radiance.x - 1.0).abs() < 1e-5);
    assert!(sampler.eval(towards(-PI / 8.0)).radiance.x < 1e-5);
    let turned = EnvMapSampler::new(&EnvMap {
        rotation_rad: 1.0,
        ..env_map
    });
    assert!((turned.eval(towards(PI / 8.0 + 1.0)).radiance.x - 1.0).abs() < 1e-5);
    for pole in [Vec3::Z, -Vec3::Z] {
        let light = sampler.eval(pole);
        assert!(light.radiance.is_finite() && light.pdf.is_finite());
    }
}

#[test]
fn black_texels_are_never_sampled() {
    let sampler = EnvMapSampler::new(&EnvMap::uniform([0.0; 3]));
    assert!(samples(&sampler, 16).iter().all(|l| l.pdf == 0.0));
    assert_eq!(sampler.eval(Vec3::X).pdf, 0.0);
    let sampler = EnvMapSampler::new(&varied());
    assert!(samples(&sampler, 4096).iter().all(|l| l.pdf > 0.0));
}

#[test]
fn texels_keep_five_digits_of_brightest_channel() {
    for rgb in [
        [0.0; 3],
        [1.0, 0.5, 0.25],
        [69_120.0, 3.0, 0.1],
        [1e-6, 2e-7, 0.0],
        [1e30; 3],
    ] {
        let light = Texel::new(rgb).decode();
        let largest = rgb.into_iter().fold(0.0, f32::max);
        for k in 0..3 {
            assert!(
                (light[k] - rgb[k]).abs() <= 4e-6 * largest,
                "{rgb:?} {light}"
            );
        }
        assert!((light.w - luminance(rgb)).abs() <= 8e-6 * largest);
    }
}
