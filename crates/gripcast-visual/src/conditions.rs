//! Per-image conditions for domain randomisation: light, ground, camera, colour of the gripper.

use std::f64::consts::TAU;
use std::sync::Arc;

use glam::{DQuat, DVec3};

use super::env_map::EnvMap;
use super::linear_image::Image;
use super::procedural::ProceduralTexture;
use super::sky::Sky;
use super::texture::Bitmap;
use gripcast_base::random::SeedStream;
use gripcast_geometry::Pose;

/// Rows of procedural environment maps.
const ENV_MAP_ROWS: usize = 256;

/// Ranges from which the conditions of an image are sampled.
#[derive(Clone, Debug)]
pub struct VisualRandomisation {
    /// Environment maps to choose from, laid out as in [`EnvMap`]; if empty, procedural skies.
    pub env_maps: Vec<Arc<Image>>,
    /// Procedural skies to choose from; if empty, all.
    pub skies: Vec<Sky>,
    /// Ground images to choose from, with their width on the ground, m; if empty, procedural
    /// textures.
    pub ground_images: Vec<(Arc<Bitmap>, f64)>,
    /// Procedural ground textures to choose from; if empty, [`ProceduralTexture::GROUNDS`].
    pub ground_textures: Vec<ProceduralTexture>,
    /// Range of the environment map's intensity, sampled log-uniformly. Automatic exposure
    /// compensates for most of it.
    pub intensity: [f64; 2],
    /// Maximum translation of the camera along each of its axes, m.
    pub camera_shift_m: f64,
    /// Maximum rotation of the camera about each of its axes, rad.
    pub camera_rotation_rad: f64,
    /// Range of the factor on the focal length.
    pub focal_factor: [f64; 2],
}

impl Default for VisualRandomisation {
    fn default() -> Self {
        Self {
            env_maps: Vec::new(),
            skies: Vec::new(),
            ground_images: Vec::new(),
            ground_textures: Vec::new(),
            intensity: [0.3, 3.0],
            camera_shift_m: 0.006,
            camera_rotation_rad: 2.5_f64.to_radians(),
            focal_factor: [0.96, 1.05],
        }
    }
}

/// Source of the environment map.
#[derive(Clone, Debug)]
pub enum EnvMapSource {
    /// Generated from a seed.
    Procedural(Sky, u64),
    /// A latitude-longitude image, such as a Radiance HDR file.
    Image(Arc<Image>),
}

/// Source of the ground texture.
#[derive(Clone, Debug)]
pub enum GroundSource {
    /// Generated from a seed.
    Procedural(ProceduralTexture, u64),
    /// An image and its width on the ground, m.
    Image(Arc<Bitmap>, f64),
}

/// Sampled conditions of one image.
#[derive(Clone, Debug)]
pub struct VisualConditions {
    /// Environment map.
    pub env_map: EnvMapSource,
    /// Rotation of the environment map about the world's z axis, rad.
    pub env_yaw_rad: f64,
    /// Factor on the environment map, which is normalised so that a white table has luminance 1.
    pub intensity: f64,
    /// Ground texture.
    pub ground: GroundSource,
    /// Rotation of the ground texture about the world's z axis, rad.
    pub ground_yaw_rad: f64,
    /// Translation of the ground texture, m.
    pub ground_shift_m: [f64; 2],
    /// Roughness of the ground if its texture is an image.
    pub ground_roughness: f64,
    /// Pose of the camera in its nominal optical frame.
    pub t_nominal_camera: Pose,
    /// Factor on the focal length.
    pub focal_factor: f64,
    /// Colour of the gripper's 3D-printed parts, linear RGB.
    pub print_colour: [f32; 3],
    /// Seed of the camera's sensor noise.
    pub sensor_seed: u64,
}

/// Filament colours, linear RGB: black, dark grey, grey, white, orange, blue.
const FILAMENTS: [[f32; 3]; 6] = [
    [0.018, 0.018, 0.02],
    [0.06, 0.06, 0.065],
    [0.25, 0.25, 0.26],
    [0.75, 0.75, 0.73],
    [0.72, 0.19, 0.03],
    [0.03, 0.13, 0.42],
];

impl VisualRandomisation {
    /// The default ranges widened by the factor `spread`; 0 gives the nominal camera and
    /// brightness.
    pub fn with_spread(spread: f64) -> Self {
        let usual = Self::default();
        Self {
            intensity: usual.intensity.map(|factor| factor.powf(spread)),
            camera_shift_m: spread * usual.camera_shift_m,
            camera_rotation_rad: spread * usual.camera_rotation_rad,
            focal_factor: usual.focal_factor.map(|factor| factor.powf(spread)),
            ..usual
        }
    }

    /// Samples the conditions of a seed.
    pub fn sample(&self, seed: u64) -> VisualConditions {
        let mut light = SeedStream::named(seed, "light");
        let mut ground = SeedStream::named(seed, "ground");
        let mut camera = SeedStream::named(seed, "camera");
        let mut colour = SeedStream::named(seed, "print");
        let angle = self.camera_rotation_rad;
        let angles = [0; 3].map(|_| camera.between(-angle, angle));
        let shift = [0; 3].map(|_| camera.between(-1.0, 1.0) * self.camera_shift_m);
        let [near, far] = self.focal_factor;
        let [dim, bright] = self.intensity;
        VisualConditions {
            env_map: match self.env_maps.len() {
                0 => EnvMapSource::Procedural(
                    pick_from(&self.skies, &Sky::ALL, &mut light),
                    light.bits(),
                ),
                count => EnvMapSource::Image(self.env_maps[light.index(count)].clone()),
            },
            env_yaw_rad: light.between(0.0, TAU),
            intensity: light.between_log(dim, bright),
            ground: match self.ground_images.len() {
                0 => GroundSource::Procedural(
                    pick_from(
                        &self.ground_textures,
                        &ProceduralTexture::GROUNDS,
                        &mut ground,
                    ),
                    ground.bits(),
                ),
                count => {
                    let (bitmap, width) = &self.ground_images[ground.index(count)];
                    GroundSource::Image(bitmap.clone(), *width)
                }
            },
            ground_yaw_rad: ground.between(0.0, TAU),
            ground_shift_m: [ground.uniform(), ground.uniform()],
            ground_roughness: ground.between(0.3, 0.8),
            t_nominal_camera: Pose::new(
                DQuat::from_euler(glam::EulerRot::XYZ, angles[0], angles[1], angles[2]),
                DVec3::from_array(shift),
            ),
            focal_factor: camera.between(near, far),
            print_colour: colour.pick(FILAMENTS),
            sensor_seed: SeedStream::named(seed, "sensor").bits(),
        }
    }
}

/// Picks one of `named`, or of `all` if none is named.
fn pick_from<T: Copy>(named: &[T], all: &[T], stream: &mut SeedStream) -> T {
    let choice = if named.is_empty() { all } else { named };
    choice[stream.index(choice.len())]
}

impl VisualConditions {
    /// Returns the rotated and scaled environment map.
    pub fn env_map(&self) -> EnvMap {
        let mut map = match &self.env_map {
            EnvMapSource::Procedural(sky, seed) => sky.generate(ENV_MAP_ROWS, *seed),
            EnvMapSource::Image(image) => image.as_ref().clone(),
        };
        super::sky::normalise_env_map(&mut map);
        EnvMap {
            map,
            rotation_rad: self.env_yaw_rad as f32,
            intensity: self.intensity as f32,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn conditions_depend_on_seed_and_stay_in_range() {
        let ranges = VisualRandomisation::default();
        let mut skies = Vec::new();
        for seed in 0..40 {
            let sampled = ranges.sample(seed);
            assert_eq!(format!("{sampled:?}"), format!("{:?}", ranges.sample(seed)));
            assert!((0.3..=3.0).contains(&sampled.intensity));
            assert!((0.96..=1.05).contains(&sampled.focal_factor));
            assert!(sampled.t_nominal_camera.translation_m.abs().max_element() <= 0.006);
            let angle = 2.0 * sampled.t_nominal_camera.rotation.w.acos();
            assert!(angle <= 3f64.sqrt() * ranges.camera_rotation_rad + 1e-9);
            if let EnvMapSource::Procedural(sky, _) = sampled.env_map {
                skies.push(sky.name());
            }
        }
        skies.sort_unstable();
        skies.dedup();
        assert_eq!(skies.len(), 4);
    }

    #[test]
    fn spread_scales_the_ranges() {
        let usual = format!("{:?}", VisualRandomisation::default());
        assert_eq!(
            format!("{:?}", VisualRandomisation::with_spread(1.0)),
            usual
        );
        let nominal = VisualRandomisation::with_spread(0.0).sample(3);
        assert_eq!((nominal.intensity, nominal.focal_factor), (1.0, 1.0));
        assert_eq!(nominal.t_nominal_camera.translation_m, DVec3::ZERO);
        let wide = VisualRandomisation::with_spread(2.0);
        let beyond = (0..40).filter(|seed| {
            let sampled = wide.sample(*seed);
            assert!((0.09..=9.0).contains(&sampled.intensity));
            sampled.t_nominal_camera.translation_m.abs().max_element() > 0.006
        });
        assert!(beyond.count() > 10);
    }

    #[test]
    fn given_skies_and_ground_textures_are_used() {
        let named = VisualRandomisation {
            skies: vec![Sky::Overcast],
            ground_textures: vec![ProceduralTexture::Wood, ProceduralTexture::Stone],
            ..VisualRandomisation::default()
        };
        let mut ground_images = Vec::new();
        for seed in 0..20 {
            let sampled = named.sample(seed);
            assert!(matches!(
                sampled.env_map,
                EnvMapSource::Procedural(Sky::Overcast, _)
            ));
            let GroundSource::Procedural(pattern, _) = sampled.ground else {
                panic!("expected a procedural ground");
            };
            ground_images.push(pattern.name());
        }
        ground_images.sort_unstable();
        ground_images.dedup();
        assert_eq!(ground_images, ["stone", "wood"]);
    }

    #[test]
    fn given_images_are_used() {
        let map = Arc::new(Image::filled(8, 4, [3.0; 3]));
        let bitmap = Bitmap::from_srgb8(&image::RgbImage::new(2, 2)).unwrap();
        let ranges = VisualRandomisation {
            env_maps: vec![map],
            ground_images: vec![(Arc::new(bitmap), 0.5)],
            ..VisualRandomisation::default()
        };
        let sampled = ranges.sample(3);
        assert!(matches!(sampled.ground, GroundSource::Image(_, width) if width == 0.5));
        let light = sampled.env_map();
        assert!((light.map.pixels[0][0] - 1.0).abs() < 1e-5);
        assert!((f64::from(light.intensity) - sampled.intensity).abs() < 1e-6);
    }
}
