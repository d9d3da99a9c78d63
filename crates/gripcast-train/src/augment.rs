//! From the images of a sample to the floats that the network sees, changed at random in
//! training.

use image::RgbImage;
use serde::{Deserialize, Serialize};

use gripcast_base::error::{Error, Result};
use gripcast_base::random::SeedStream;
use gripcast_dataset::shard::ShardImages;
use gripcast_imaging::Decoder;
use gripcast_nn::IMAGE;
use gripcast_nn::predict::contract::RgbNormalisation;

const HEIGHT: usize = IMAGE[0];
const WIDTH: usize = IMAGE[1];
/// Floats of an image.
pub(super) const FLOATS: usize = HEIGHT * WIDTH * IMAGE[2];
/// Numbers that noise is taken from, at random places: drawing new ones would take longer than the
/// network.
const NOISE: usize = 1 << 20;

/// How far images are changed in training. Zeros and `false` leave them as they are.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Augmentation {
    /// Half of the samples are seen as if the gripper were turned by 180° about its approach: the
    /// sensors swap, the colour image turns.
    pub turned: bool,
    /// Half of the samples are mirrored between the fingers: the sensors swap and their images
    /// turn upside down, left and right of the colour image swap.
    pub mirrored: bool,
    /// Sensitivity of a tactile sensor, as a fraction: 0.25 is 0.75 to 1.25.
    pub tactile_gain: f64,
    /// The same for each of its colours.
    pub tactile_colour: f64,
    /// Drift of a colour between the initial and the grasp image, grey levels of 255.
    pub tactile_offset: f64,
    /// Largest deviation of a tactile difference's noise, grey levels of 255.
    pub tactile_noise: f64,
    /// Largest shift of a tactile sensor's image, pixels.
    pub tactile_shift: usize,
    /// Largest part of the colour image's sides that is cut off.
    pub crop: f64,
    /// Brightness of the colour image, as a fraction.
    pub brightness: f64,
    /// The same for each of its colours.
    pub colour: f64,
    /// Saturation, as a fraction.
    pub saturation: f64,
}

impl Augmentation {
    /// Images as they are.
    pub const NONE: Self = Self {
        turned: false,
        mirrored: false,
        tactile_gain: 0.0,
        tactile_colour: 0.0,
        tactile_offset: 0.0,
        tactile_noise: 0.0,
        tactile_shift: 0,
        crop: 0.0,
        brightness: 0.0,
        colour: 0.0,
        saturation: 0.0,
    };
    /// What training uses.
    pub const USUAL: Self = Self {
        turned: true,
        mirrored: true,
        tactile_gain: 0.3,
        tactile_colour: 0.15,
        tactile_offset: 4.0,
        tactile_noise: 3.0,
        tactile_shift: 10,
        crop: 0.15,
        brightness: 0.3,
        colour: 0.1,
        saturation: 0.4,
    };
}

/// The decoded images of a sample.
#[derive(Clone, Debug)]
pub(super) struct SampleImages {
    /// Left and right sensor, initial and grasp.
    pub(super) tactile: [[RgbImage; 2]; 2],
    /// Colour camera in the grasp.
    pub(super) rgb: RgbImage,
}

impl SampleImages {
    /// Decodes what a network with these senses sees; other images are empty.
    ///
    /// # Errors
    /// `Input`: an image is damaged or not 320×240.
    pub(super) fn decode(
        decoder: &mut Decoder,
        images: &ShardImages,
        [touch, vision]: [bool; 2],
    ) -> Result<Self> {
        let mut image = |is_seen: bool, name: &str, bytes: &[u8]| {
            if !is_seen {
                return Ok(RgbImage::default());
            }
            let image = decoder.stored_image(bytes)?;
            let (width, height) = image.dimensions();
            if (width as usize, height as usize) == (WIDTH, HEIGHT) {
                return Ok(image);
            }
            Err(Error::input(format!(
                "`{name}`: expected {WIDTH}×{HEIGHT} pixels, found {width}×{height}"
            ))
            .remedy("make the dataset of images that are cropped and resized to 320×240"))
        };
        Ok(Self {
            tactile: [
                [
                    image(touch, "initial_left", &images.initial_left)?,
                    image(touch, "grasp_left", &images.grasp_left)?,
                ],
                [
                    image(touch, "initial_right", &images.initial_right)?,
                    image(touch, "grasp_right", &images.grasp_right)?,
                ],
            ],
            rgb: image(vision, "grasp_rgb", &images.grasp_rgb)?,
        })
    }
}

/// Writes the floats of samples.
#[derive(Debug)]
pub(super) struct InputWriter {
    augmentation: Augmentation,
    normalisation: RgbNormalisation,
    noise: Vec<f32>,
}

/// How one sample is seen.
struct Pose {
    swap: bool,
    upside_down: bool,
    left_right: bool,
}

impl InputWriter {
    /// A writer; images are changed by `augmentation` where a seed is given.
    pub(super) fn new(augmentation: Augmentation, normalisation: RgbNormalisation) -> Self {
        let mut noise = Vec::new();
        if augmentation.tactile_noise > 0.0 {
            let mut draw = SeedStream::named(0, "noise");
            // The sum of four uniform numbers is nearly normal; this one has a deviation of 1.
            let mut normal = || 3_f64.sqrt() * ((0..4).map(|_| draw.uniform()).sum::<f64>() - 2.0);
            noise = (0..NOISE + FLOATS).map(|_| normal() as f32).collect();
        }
        Self {
            augmentation,
            normalisation,
            noise,
        }
    }

    /// Writes left and right tactile difference and the colour image, HWC; slices that are empty
    /// stay empty. Unchanged images give the floats of
    /// [`ModelInput`](gripcast_nn::predict::ModelInput) but for the last bits: here levels are
    /// multiplied with gains, there divided by 255.
    pub(super) fn write(
        &self,
        images: &SampleImages,
        seed: Option<u64>,
        [left, right]: [&mut [f32]; 2],
        rgb: &mut [f32],
    ) {
        let augmentation = if seed.is_some() {
            self.augmentation
        } else {
            Augmentation::NONE
        };
        let mut draw = SeedStream::named(seed.unwrap_or(0), "augment");
        let turned = augmentation.turned && draw.bits() & 1 == 1;
        let mirrored = augmentation.mirrored && draw.bits() & 1 == 1;
        let pose = Pose {
            // Both swap the sensors, so that together they do not.
            swap: turned != mirrored,
            upside_down: turned,
            left_right: turned != mirrored,
        };
        let [of_left, of_right] = &images.tactile;
        let pairs = if pose.swap {
            [of_right, of_left]
        } else {
            [of_left, of_right]
        };
        for (pair, to) in pairs.into_iter().zip([left, right]) {
            if !to.is_empty() {
                self.write_difference(&augmentation, pair, mirrored, &mut draw, to);
            }
        }
        if !rgb.is_empty() {
            self.write_rgb(&augmentation, &images.rgb, &pose, &mut draw, rgb);
        }
    }

    fn write_difference(
        &self,
        augmentation: &Augmentation,
        [initial, grasp]: &[RgbImage; 2],
        upside_down: bool,
        draw: &mut SeedStream,
        to: &mut [f32],
    ) {
        let mut about = |spread: f64| draw.between(-spread, spread);
        let gain = 1.0 + about(augmentation.tactile_gain);
        let gains: [f64; 3] =
            std::array::from_fn(|_| gain * (1.0 + about(augmentation.tactile_colour)));
        let gains = gains.map(|gain| (gain / 255.0) as f32);
        let offsets: [f32; 3] =
            std::array::from_fn(|_| (about(augmentation.tactile_offset) / 255.0) as f32);
        let most = augmentation.tactile_shift;
        let (right, down) = (draw.index(2 * most + 1), draw.index(2 * most + 1));
        let noise = (draw.uniform() * augmentation.tactile_noise / 255.0) as f32;
        let noise_at = draw.index(NOISE);
        for (y, row) in to.chunks_exact_mut(3 * WIDTH).enumerate() {
            let y_seen = if upside_down { HEIGHT - 1 - y } else { y };
            let from = (y_seen + down).saturating_sub(most).min(HEIGHT - 1) * 3 * WIDTH;
            let initial = &initial.as_raw()[from..from + 3 * WIDTH];
            let grasp = &grasp.as_raw()[from..from + 3 * WIDTH];
            for (x, to) in row.as_chunks_mut::<3>().0.iter_mut().enumerate() {
                let from = 3 * (x + right).saturating_sub(most).min(WIDTH - 1);
                for c in 0..3 {
                    let change = f32::from(grasp[from + c]) - f32::from(initial[from + c]);
                    to[c] = change * gains[c] + offsets[c];
                }
            }
            if noise > 0.0 {
                let of_row = &self.noise[noise_at + y * 3 * WIDTH..][..3 * WIDTH];
                for (to, normal) in row.iter_mut().zip(of_row) {
                    *to += noise * normal;
                }
            }
        }
    }

    fn write_rgb(
        &self,
        augmentation: &Augmentation,
        rgb: &RgbImage,
        pose: &Pose,
        draw: &mut SeedStream,
        to: &mut [f32],
    ) {
        let scale = 1.0 - augmentation.crop * draw.uniform();
        let [down, right] =
            [HEIGHT, WIDTH].map(|side| draw.uniform() * (1.0 - scale) * side as f64);
        let mut about = |spread: f64| 1.0 + draw.between(-spread, spread);
        let brightness = about(augmentation.brightness) / 255.0;
        let gains: [f32; 3] =
            std::array::from_fn(|_| (brightness * about(augmentation.colour)) as f32);
        let saturation = about(augmentation.saturation) as f32;
        let RgbNormalisation { mean, std } = self.normalisation;
        let seen = |at: usize, side: usize, is_turned: bool, offset: f64| {
            let at = if is_turned { side - 1 - at } else { at };
            ((offset + at as f64 * scale) as usize).min(side - 1)
        };
        let columns: Vec<usize> = (0..WIDTH)
            .map(|x| 3 * seen(x, WIDTH, pose.left_right, right))
            .collect();
        for (y, row) in to.chunks_exact_mut(3 * WIDTH).enumerate() {
            let y = seen(y, HEIGHT, pose.upside_down, down);
            let from = &rgb.as_raw()[y * 3 * WIDTH..][..3 * WIDTH];
            for (to, &x) in row.as_chunks_mut::<3>().0.iter_mut().zip(&columns) {
                let pixel: [f32; 3] = std::array::from_fn(|c| f32::from(from[x + c]) * gains[c]);
                let grey = (pixel[0] + pixel[1] + pixel[2]) / 3.0;
                for c in 0..3 {
                    let value = grey + (pixel[c] - grey) * saturation;
                    to[c] = (value - mean[c]) / std[c];
                }
            }
        }
    }
}
