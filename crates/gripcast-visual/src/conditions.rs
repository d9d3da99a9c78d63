//! What differs from image to image: light, ground, camera, colour of the gripper.

use std::f64::consts::TAU;
use std::sync::Arc;

use glam::{DQuat, DVec3};

use super::environment::Environment;
use super::linear_image::Image;
use super::pattern::Pattern;
use super::sky::Sky;
use super::texture::Bitmap;
use gripcast_base::random::SeedStream;
use gripcast_geometry::Pose;

/// Rows of painted domes.
const DOME_ROWS: usize = 256;

/// Ranges from which the conditions of an image are drawn.
#[derive(Clone, Debug)]
pub struct VisualRandomisation {
    /// Domes to choose from, as [`Environment`] lays them out; none for painted skies.
    pub domes: Vec<Arc<Image>>,
    /// Kinds of painted skies to choose from; none for all.
    pub skies: Vec<Sky>,
    /// Textures of the ground to choose from, with their width on the ground, m; none for painted
    /// ones.
    pub grounds: Vec<(Arc<Bitmap>, f64)>,
    /// Kinds of painted grounds to choose from; none for all that tables are made of.
    pub patterns: Vec<Pattern>,
    /// Brightness of the dome, least and most; drawn log-uniformly. The automatic exposure evens
    /// out most of it.
    pub intensity: [f64; 2],
    /// Largest shift of the camera along each of its axes, m.
    pub camera_shift_m: f64,
    /// Largest turn of the camera about each of its axes, rad.
    pub camera_turn_rad: f64,
    /// Factor on the focal length, least and most.
    pub focal_factor: [f64; 2],
}

impl Default for VisualRandomisation {
    fn default() -> Self {
        Self {
            domes: Vec::new(),
            skies: Vec::new(),
            grounds: Vec::new(),
            patterns: Vec::new(),
            intensity: [0.3, 3.0],
            camera_shift_m: 0.006,
            camera_turn_rad: 2.5_f64.to_radians(),
            focal_factor: [0.96, 1.05],
        }
    }
}

/// Light of an image.
#[derive(Clone, Debug)]
pub enum DomeChoice {
    /// Painted from a seed.
    Painted(Sky, u64),
    /// An image, such as a Radiance HDR file.
    Image(Arc<Image>),
}

/// Ground of an image.
#[derive(Clone, Debug)]
pub enum GroundChoice {
    /// Painted from a seed.
    Painted(Pattern, u64),
    /// An image and its width on the ground, m.
    Image(Arc<Bitmap>, f64),
}

/// The conditions of one image.
#[derive(Clone, Debug)]
pub struct VisualConditions {
    /// Light.
    pub dome: DomeChoice,
    /// Turn of the dome about the world's z, rad.
    pub dome_turn_rad: f64,
    /// Factor on the dome, whose white table has luminance 1.
    pub intensity: f64,
    /// Ground.
    pub ground: GroundChoice,
    /// Turn of the ground's texture about the world's z, rad.
    pub ground_turn_rad: f64,
    /// Shift of the ground's texture, m.
    pub ground_shift_m: [f64; 2],
    /// Roughness of a ground from an image.
    pub ground_roughness: f64,
    /// Moves the camera in its own optical frame (maps the moved frame into the nominal one).
    pub camera_move: Pose,
    /// Factor on the focal length.
    pub focal_factor: f64,
    /// Colour of the gripper's printed parts, linear.
    pub print_colour: [f32; 3],
    /// Seed of the sensor's noise.
    pub sensor_seed: u64,
}

/// Colours of filament, linear: black, dark grey, grey, white, orange, blue.
const FILAMENTS: [[f32; 3]; 6] = [
    [0.018, 0.018, 0.02],
    [0.06, 0.06, 0.065],
    [0.25, 0.25, 0.26],
    [0.75, 0.75, 0.73],
    [0.72, 0.19, 0.03],
    [0.03, 0.13, 0.42],
];

impl VisualRandomisation {
    /// The usual ranges, `spread` times as wide: 0 for the nominal camera and brightness.
    pub fn spread(spread: f64) -> Self {
        let usual = Self::default();
        Self {
            intensity: usual.intensity.map(|factor| factor.powf(spread)),
            camera_shift_m: spread * usual.camera_shift_m,
            camera_turn_rad: spread * usual.camera_turn_rad,
            focal_factor: usual.focal_factor.map(|factor| factor.powf(spread)),
            ..usual
        }
    }

    /// The conditions of a seed.
    pub fn sample(&self, seed: u64) -> VisualConditions {
        let mut light = SeedStream::named(seed, "light");
        let mut ground = SeedStream::named(seed, "ground");
        let mut camera = SeedStream::named(seed, "camera");
        let mut colour = SeedStream::named(seed, "print");
        let turn = self.camera_turn_rad;
        let turns = [0; 3].map(|_| camera.between(-turn, turn));
        let shift = [0; 3].map(|_| camera.between(-1.0, 1.0) * self.camera_shift_m);
        let [near, far] = self.focal_factor;
        let [dim, bright] = self.intensity;
        VisualConditions {
            dome: match self.domes.len() {
                0 => DomeChoice::Painted(one_of(&self.skies, &Sky::ALL, &mut light), light.bits()),
                count => DomeChoice::Image(self.domes[light.index(count)].clone()),
            },
            dome_turn_rad: light.between(0.0, TAU),
            intensity: light.between_log(dim, bright),
            ground: match self.grounds.len() {
                0 => GroundChoice::Painted(
                    one_of(&self.patterns, &Pattern::GROUNDS, &mut ground),
                    ground.bits(),
                ),
                count => {
                    let (bitmap, width) = &self.grounds[ground.index(count)];
                    GroundChoice::Image(bitmap.clone(), *width)
                }
            },
            ground_turn_rad: ground.between(0.0, TAU),
            ground_shift_m: [ground.uniform(), ground.uniform()],
            ground_roughness: ground.between(0.3, 0.8),
            camera_move: Pose::new(
                DQuat::from_euler(glam::EulerRot::XYZ, turns[0], turns[1], turns[2]),
                DVec3::from_array(shift),
            ),
            focal_factor: camera.between(near, far),
            print_colour: colour.pick(FILAMENTS),
            sensor_seed: SeedStream::named(seed, "sensor").bits(),
        }
    }
}

/// One of those that were named, else of all.
fn one_of<T: Copy>(named: &[T], all: &[T], stream: &mut SeedStream) -> T {
    let choice = if named.is_empty() { all } else { named };
    choice[stream.index(choice.len())]
}

impl VisualConditions {
    /// The dome of light, scaled and turned.
    pub fn environment(&self) -> Environment {
        let mut map = match &self.dome {
            DomeChoice::Painted(sky, seed) => sky.paint(DOME_ROWS, *seed),
            DomeChoice::Image(image) => image.as_ref().clone(),
        };
        super::sky::normalise(&mut map);
        Environment {
            map,
            rotation_rad: self.dome_turn_rad as f32,
            intensity: self.intensity as f32,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn conditions_are_fixed_by_the_seed_and_within_their_ranges() {
        let ranges = VisualRandomisation::default();
        let mut skies = Vec::new();
        for seed in 0..40 {
            let drawn = ranges.sample(seed);
            assert_eq!(format!("{drawn:?}"), format!("{:?}", ranges.sample(seed)));
            assert!((0.3..=3.0).contains(&drawn.intensity));
            assert!((0.96..=1.05).contains(&drawn.focal_factor));
            assert!(drawn.camera_move.translation_m.abs().max_element() <= 0.006);
            let turn = 2.0 * drawn.camera_move.rotation.w.acos();
            assert!(turn <= 3f64.sqrt() * ranges.camera_turn_rad + 1e-9);
            if let DomeChoice::Painted(sky, _) = drawn.dome {
                skies.push(sky.name());
            }
        }
        skies.sort_unstable();
        skies.dedup();
        assert_eq!(skies.len(), 4);
    }

    #[test]
    fn ranges_are_widened_and_narrowed() {
        let usual = format!("{:?}", VisualRandomisation::default());
        assert_eq!(format!("{:?}", VisualRandomisation::spread(1.0)), usual);
        let nominal = VisualRandomisation::spread(0.0).sample(3);
        assert_eq!((nominal.intensity, nominal.focal_factor), (1.0, 1.0));
        assert_eq!(nominal.camera_move.translation_m, DVec3::ZERO);
        let wide = VisualRandomisation::spread(2.0);
        let beyond = (0..40).filter(|seed| {
            let drawn = wide.sample(*seed);
            assert!((0.09..=9.0).contains(&drawn.intensity));
            drawn.camera_move.translation_m.abs().max_element() > 0.006
        });
        assert!(beyond.count() > 10);
    }

    #[test]
    fn named_skies_and_grounds_are_used() {
        let named = VisualRandomisation {
            skies: vec![Sky::Overcast],
            patterns: vec![Pattern::Wood, Pattern::Stone],
            ..VisualRandomisation::default()
        };
        let mut grounds = Vec::new();
        for seed in 0..20 {
            let drawn = named.sample(seed);
            assert!(matches!(drawn.dome, DomeChoice::Painted(Sky::Overcast, _)));
            let GroundChoice::Painted(pattern, _) = drawn.ground else {
                panic!("an image was drawn");
            };
            grounds.push(pattern.name());
        }
        grounds.sort_unstable();
        grounds.dedup();
        assert_eq!(grounds, ["stone", "wood"]);
    }

    #[test]
    fn named_images_are_used() {
        let dome = Arc::new(Image::filled(8, 4, [3.0; 3]));
        let bitmap = Bitmap::from_srgb8(&image::RgbImage::new(2, 2)).unwrap();
        let ranges = VisualRandomisation {
            domes: vec![dome],
            grounds: vec![(Arc::new(bitmap), 0.5)],
            ..VisualRandomisation::default()
        };
        let drawn = ranges.sample(3);
        assert!(matches!(drawn.ground, GroundChoice::Image(_, width) if width == 0.5));
        let light = drawn.environment();
        assert!((light.map.pixels[0][0] - 1.0).abs() < 1e-5);
        assert!((f64::from(light.intensity) - drawn.intensity).abs() < 1e-6);
    }
}
