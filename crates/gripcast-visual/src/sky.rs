//! Procedural environment maps: rooms with lamps or windows, overcast and clear skies.
//!
//! Each map is scaled so that a white Lambertian table under it has luminance 1;
//! [`EnvMap::intensity`](super::EnvMap) alone sets the brightness.

use std::f32::consts::{PI, TAU};
use std::str::FromStr;

use glam::Vec3;
use rayon::prelude::*;

use super::env_map::light_of_kelvin;
use super::linear_image::Image;
use super::room::Room;
use gripcast_base::error::{Error, Result, unknown_name};
use gripcast_base::random::SeedStream;

/// Kind of a procedural environment map.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Sky {
    /// Room without windows, rectangular lamps on its ceiling.
    Studio,
    /// Room with windows on one or two walls.
    WindowRoom,
    /// Overcast sky (CIE standard overcast sky).
    Overcast,
    /// Clear sky with sun.
    Sunny,
}

impl Sky {
    /// All kinds.
    pub const ALL: [Self; 4] = [Self::Studio, Self::WindowRoom, Self::Overcast, Self::Sunny];

    /// Name on the command line and in files.
    pub fn name(self) -> &'static str {
        match self {
            Self::Studio => "studio",
            Self::WindowRoom => "window-room",
            Self::Overcast => "overcast",
            Self::Sunny => "sunny",
        }
    }

    /// Generates a map of `2 * height` × `height` pixels, laid out as in [`EnvMap`](super::EnvMap);
    /// the result depends on the arguments alone.
    pub fn generate(self, height: usize, seed: u64) -> Image {
        let mut stream = SeedStream::named(seed, self.name());
        let mut map = match self {
            Self::Studio => Room::with_lamps(&mut stream).env_map(height),
            Self::WindowRoom => Room::with_windows(&mut stream).env_map(height),
            Self::Overcast => {
                let sky = OvercastSky::random(&mut stream);
                map_from_fn(height, |d| sky.radiance(d))
            }
            Self::Sunny => {
                let sky = ClearSky::random(&mut stream);
                map_from_fn(height, |d| sky.radiance(d))
            }
        };
        normalise_env_map(&mut map);
        map
    }
}

impl FromStr for Sky {
    type Err = Error;

    fn from_str(text: &str) -> Result<Self> {
        let found = Self::ALL.into_iter().find(|sky| sky.name() == text);
        found.ok_or_else(|| unknown_name("sky", text, &Self::ALL.map(Self::name)))
    }
}

/// Returns the luminance of a white Lambertian horizontal surface under a map (irradiance over π).
pub fn white_table_luminance(map: &Image) -> f64 {
    let (width, height) = (map.width, map.height);
    let mut sum = 0.0;
    for (row, pixels) in map.pixels.chunks(width.max(1)).enumerate() {
        let (from, to) = (row as f64, row as f64 + 1.0);
        let [a, b] = [from, to].map(|r| {
            let polar = std::f64::consts::PI * (r / height as f64).min(0.5);
            polar.sin().powi(2)
        });
        // Integral of cos · sin over the row, times the pixel width.
        let weight = 0.5 * (b - a) * std::f64::consts::TAU / width as f64;
        let row_sum: f64 = pixels
            .iter()
            .map(|p| f64::from(super::linear_image::luminance(*p)))
            .sum();
        sum += weight * row_sum;
    }
    sum / std::f64::consts::PI
}

/// Scales a map so that [`white_table_luminance`] is 1; a map without light above the horizon is
/// unchanged.
pub fn normalise_env_map(map: &mut Image) {
    let found = white_table_luminance(map);
    if found.is_normal() && found > 0.0 {
        let factor = (1.0 / found) as f32;
        for value in map.pixels.iter_mut().flatten() {
            *value *= factor;
        }
    }
}

/// Evaluates the radiance of each pixel as the mean of four directions in it.
pub(super) fn map_from_fn(height: usize, radiance: impl Fn(Vec3) -> [f32; 3] + Sync) -> Image {
    let height = height.max(2);
    let width = 2 * height;
    let mut map = Image::filled(width, height, [0.0; 3]);
    map.pixels
        .par_chunks_mut(width)
        .enumerate()
        .for_each(|(row, pixels)| {
            for (column, pixel) in pixels.iter_mut().enumerate() {
                for offset in [[0.25, 0.25], [0.75, 0.25], [0.25, 0.75], [0.75, 0.75]] {
                    let polar = PI * (row as f32 + offset[0]) / height as f32;
                    let u = (column as f32 + offset[1]) / width as f32;
                    let azimuth = TAU * (0.5 - u);
                    let (z, ring) = (polar.cos(), polar.sin());
                    let value = radiance(Vec3::new(ring * azimuth.cos(), ring * azimuth.sin(), z));
                    for (sum, value) in pixel.iter_mut().zip(value) {
                        *sum += 0.25 * value;
                    }
                }
            }
        });
    map
}

/// Radiance of the surrounding ground, given that of unshaded ground.
fn ground_radiance(albedo: [f32; 3], direction: Vec3) -> [f32; 3] {
    // Towards the nadir, table and operator cast shadows.
    let shade = 1.0 - 0.5 * (-direction.z).clamp(0.0, 1.0);
    albedo.map(|a| a * shade)
}

/// CIE standard overcast sky (Moon and Spencer, 1942): three times brighter at the zenith than at
/// the horizon.
struct OvercastSky {
    tint: [f32; 3],
    ground: [f32; 3],
    /// Direction of the brightest clouds, and their relative extra brightness.
    bright: (Vec3, f32),
}

impl OvercastSky {
    fn random(stream: &mut SeedStream) -> Self {
        let azimuth = stream.between(0.0, f64::from(TAU)) as f32;
        let height = stream.between(0.5, 0.9) as f32;
        let ring = (1.0 - height * height).sqrt();
        let albedo = stream.between(0.1, 0.35) as f32;
        Self {
            tint: light_of_kelvin(stream.between(6000.0, 7500.0) as f32),
            ground: [albedo, 0.96 * albedo, 0.88 * albedo],
            bright: (
                Vec3::new(ring * azimuth.cos(), ring * azimuth.sin(), height),
                stream.between(0.0, 1.5) as f32,
            ),
        }
    }

    fn radiance(&self, d: Vec3) -> [f32; 3] {
        if d.z < 0.0 {
            return ground_radiance(self.ground.map(|g| g * 0.75), d);
        }
        let (towards, strength) = self.bright;
        let bright = strength * (d.dot(towards).max(0.0)).powi(12);
        let level = (1.0 + 2.0 * d.z) / 3.0 * (1.0 + bright);
        self.tint.map(|t| t * level)
    }
}

/// CIE clear sky with a sun disc of finite size.
struct ClearSky {
    sun: Vec3,
    /// Cosine of the angular radius of the sun disc.
    disc: f32,
    /// Radiance of the disc relative to the zenith.
    sun_level: f32,
    sun_tint: [f32; 3],
    ground: [f32; 3],
}

impl ClearSky {
    fn random(stream: &mut SeedStream) -> Self {
        let elevation = stream.between(0.25, 1.15) as f32;
        let azimuth = stream.between(0.0, f64::from(TAU)) as f32;
        let (z, ring) = (elevation.sin(), elevation.cos());
        // A disc wider than the real sun (0.27°) of the same irradiance avoids fireflies and keeps
        // shadows sharp enough.
        let radius = 1.2_f32.to_radians();
        let ratio = stream.between(3.0, 7.0) as f32;
        let albedo = stream.between(0.12, 0.35) as f32;
        Self {
            sun: Vec3::new(ring * azimuth.cos(), ring * azimuth.sin(), z),
            disc: radius.cos(),
            // Direct light is `ratio` times that of the sky, whose irradiance is about π · 1.5.
            sun_level: ratio * 1.5 * PI / (PI * radius * radius * z.max(0.2)),
            sun_tint: light_of_kelvin(3200.0 + 2600.0 * z),
            ground: [albedo, 0.95 * albedo, 0.82 * albedo],
        }
    }

    fn radiance(&self, d: Vec3) -> [f32; 3] {
        if d.z < 0.0 {
            // Sunlit ground is several times brighter than under the sky alone.
            return ground_radiance(self.ground.map(|g| 4.0 * g), d);
        }
        let cosine = d.dot(self.sun).clamp(-1.0, 1.0);
        let angle = cosine.acos();
        let z = d.z.max(0.01);
        let indicatrix = 0.91 + 10.0 * (-3.0 * angle).exp() + 0.45 * cosine * cosine;
        let level = (1.0 - (-0.32 / z).exp()) * indicatrix / 0.6;
        // Blue overhead, pale at the horizon and around the sun.
        let pale = (1.0 - z).powi(3).max(0.6 * (-4.0 * angle).exp());
        let tint: [f32; 3] = std::array::from_fn(|c| {
            let (blue, white) = ([0.42, 0.72, 1.45][c], [0.95, 1.0, 1.08][c]);
            blue + (white - blue) * pale
        });
        let mut sum = tint.map(|t| t * level);
        if cosine > self.disc {
            for (value, tint) in sum.iter_mut().zip(self.sun_tint) {
                *value += self.sun_level * tint;
            }
        }
        sum
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::linear_image::luminance;

    #[test]
    fn maps_are_deterministic_and_normalised() {
        for sky in Sky::ALL {
            for seed in 0..5 {
                let map = sky.generate(64, seed);
                assert_eq!((map.width, map.height), (128, 64));
                assert_eq!(map, sky.generate(64, seed), "{sky:?}");
                assert!(
                    map.pixels
                        .iter()
                        .flatten()
                        .all(|v| v.is_finite() && *v >= 0.0)
                );
                let table = white_table_luminance(&map);
                assert!((table - 1.0).abs() < 1e-3, "{sky:?} {seed}: {table}");
            }
            assert_ne!(sky.generate(32, 1), sky.generate(32, 2), "{sky:?}");
        }
    }

    #[test]
    fn constant_map_lights_table_with_its_radiance() {
        let mut map = Image::filled(32, 16, [0.25; 3]);
        assert!((white_table_luminance(&map) - 0.25).abs() < 1e-6);
        normalise_env_map(&mut map);
        assert!((map.pixels[3][1] - 1.0).abs() < 1e-6);
        let mut dark = Image::filled(4, 2, [0.0; 3]);
        normalise_env_map(&mut dark);
        assert_eq!(dark.pixels[0], [0.0; 3]);
    }

    #[test]
    fn only_overcast_sky_has_no_bright_spots() {
        let contrast = |sky: Sky, seed| {
            let map = sky.generate(128, seed);
            let levels = map.pixels.iter().map(|p| luminance(*p));
            let peak = levels.clone().fold(0.0, f32::max);
            peak / (levels.sum::<f32>() / map.pixels.len() as f32)
        };
        for seed in 0..4 {
            assert!(
                contrast(Sky::Sunny, seed) > 500.0,
                "{}",
                contrast(Sky::Sunny, seed)
            );
            assert!(contrast(Sky::Studio, seed) > 4.0);
            assert!(contrast(Sky::WindowRoom, seed) > 4.0);
            assert!(contrast(Sky::Overcast, seed) < 4.0);
        }
    }

    #[test]
    fn warm_light_is_red_and_cold_light_is_blue() {
        let (warm, cold) = (light_of_kelvin(2700.0), light_of_kelvin(9000.0));
        assert!(
            warm[0] > 2.0 * warm[2] && cold[2] > 1.2 * cold[0],
            "{warm:?} {cold:?}"
        );
        let white = light_of_kelvin(6500.0);
        assert!(white.iter().all(|c| (c - 1.0).abs() < 0.08), "{white:?}");
        assert!((luminance(warm) - 1.0).abs() < 0.02);
    }

    #[test]
    fn misspelt_sky_gets_a_suggestion() {
        let text = "suny".parse::<Sky>().unwrap_err().to_string();
        assert!(text.contains("did you mean sunny?"), "{text}");
        assert_eq!("window-room".parse::<Sky>().unwrap(), Sky::WindowRoom);
    }
}
