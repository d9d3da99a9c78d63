//! Preprocessing and augmentation: from the images of a sample to the network's input tensors.

use image::RgbImage;
use serde::{Deserialize, Serialize};

use gripcast_base::error::{Error, Result};
use gripcast_base::random::SeedStream;
use gripcast_dataset::shard::ShardImages;
use gripcast_imaging::{Decoder, Depth, DepthView, decode_png_grey16};
use gripcast_nn::IMAGE;
use gripcast_nn::predict::PointMap;
use gripcast_nn::predict::contract::{InputName, Modality, RgbNormalisation};

const HEIGHT: usize = IMAGE[0];
const WIDTH: usize = IMAGE[1];
/// Floats per image.
pub(super) const FLOATS: usize = HEIGHT * WIDTH * IMAGE[2];
/// Size of the table of normal numbers, read from random offsets: drawing new numbers would take
/// longer than the network.
const NOISE_TABLE: usize = 1 << 20;

/// Ranges of the data augmentation; 0 and `false` disable it.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Augmentation {
    /// Rotates the gripper by 180° about its approach with probability 0.5: the sensors swap. Such
    /// samples have touch alone, as the camera is on one side of the gripper.
    pub rotate_180: bool,
    /// Mirrors the fingers with probability 0.5: the sensors swap, their images are flipped
    /// vertically, colour and depth image horizontally.
    pub mirror: bool,
    /// Gain of a tactile sensor: 0.25 means 0.75 to 1.25.
    pub tactile_gain: f64,
    /// Gain of each of its colour channels.
    pub tactile_channel_gain: f64,
    /// Drift of a channel between initial and grasp image, grey levels (0 to 255).
    pub tactile_offset: f64,
    /// Maximum standard deviation of the noise of a tactile difference, grey levels (0 to 255).
    pub tactile_noise: f64,
    /// Maximum shift of a tactile image, px.
    pub tactile_shift: usize,
    /// Maximum fraction cropped from the sides of the colour image.
    pub crop: f64,
    /// Brightness of the colour image: 0.25 means 0.75 to 1.25.
    pub brightness: f64,
    /// Gain of each of its channels.
    pub channel_gain: f64,
    /// Saturation.
    pub saturation: f64,
    /// Maximum fraction of each side of the rectangles without depth, up to three per image.
    pub depth_holes: f64,
}

impl Augmentation {
    /// No augmentation.
    pub const NONE: Self = Self {
        rotate_180: false,
        mirror: false,
        tactile_gain: 0.0,
        tactile_channel_gain: 0.0,
        tactile_offset: 0.0,
        tactile_noise: 0.0,
        tactile_shift: 0,
        crop: 0.0,
        brightness: 0.0,
        channel_gain: 0.0,
        saturation: 0.0,
        depth_holes: 0.0,
    };
    /// Default augmentation.
    pub const DEFAULT: Self = Self {
        rotate_180: true,
        mirror: true,
        tactile_gain: 0.3,
        tactile_channel_gain: 0.15,
        tactile_offset: 4.0,
        tactile_noise: 3.0,
        tactile_shift: 10,
        crop: 0.03,
        brightness: 0.3,
        channel_gain: 0.1,
        saturation: 0.4,
        depth_holes: 0.25,
    };
}

/// Decoded images of a sample.
#[derive(Clone, Debug)]
pub(super) struct SampleImages {
    /// Left and right sensor, initial and grasp frame.
    pub(super) tactile: [[RgbImage; 2]; 2],
    /// Colour image of the grasp frame.
    pub(super) rgb: RgbImage,
    /// Depth image of the grasp frame, if it is used and there is one.
    pub(super) depth: Option<PointMap>,
}

/// Depth of one code in shards, m.
const DEPTH_UNIT_M: f64 = 1e-3;

impl SampleImages {
    /// Decodes the images of a modality; others stay empty.
    ///
    /// # Errors
    /// `Input`: an image is damaged or, depth apart, not 320×240.
    pub(super) fn decode(
        decoder: &mut Decoder,
        images: &ShardImages,
        modality: Modality,
    ) -> Result<Self> {
        let (touch, vision) = (modality.has_touch(), modality.has_vision());
        let depth = images.grasp_depth.as_ref().filter(|_| modality.has_depth());
        let depth = depth.map(|bytes| {
            let image = decode_png_grey16(bytes).map_err(|e| e.at("grasp_depth"))?;
            let unit_m = DEPTH_UNIT_M;
            Ok::<_, Error>(PointMap::new(&Depth { image, unit_m }, DepthView::Colour))
        });
        let mut image = |is_used: bool, name: &str, bytes: &[u8]| {
            if !is_used {
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
            .remedy("build the dataset from images cropped and resized to 320×240"))
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
            depth: depth.transpose()?,
        })
    }
}

/// Writes input tensors.
#[derive(Debug)]
pub(super) struct InputWriter {
    augmentation: Augmentation,
    normalisation: RgbNormalisation,
    noise: Vec<f32>,
}

/// Where the inputs of a sample are written; empty slices for those that are not used.
#[derive(Debug, Default)]
pub(super) struct Slots<'a> {
    /// Left and right.
    pub(super) touch: [&'a mut [f32]; 2],
    pub(super) rgb: &'a mut [f32],
    pub(super) depth: &'a mut [f32],
}

/// What was written of a sample.
#[derive(Clone, Copy, Debug)]
pub(super) struct Written {
    /// The inputs that are valid; none if there are none.
    pub(super) available: Option<Modality>,
    pub(super) is_mirrored: bool,
    /// Whether left and right sensor are swapped.
    pub(super) is_swapped: bool,
}

impl InputWriter {
    /// Creates a writer; `augmentation` applies to samples with a seed.
    pub(super) fn new(augmentation: Augmentation, normalisation: RgbNormalisation) -> Self {
        let mut noise = Vec::new();
        if augmentation.tactile_noise > 0.0 {
            let mut draw = SeedStream::named(0, "noise");
            // The sum of four uniform numbers is nearly normal; scaled to unit variance.
            let mut normal = || 3_f64.sqrt() * ((0..4).map(|_| draw.uniform()).sum::<f64>() - 2.0);
            noise = (0..NOISE_TABLE + FLOATS).map(|_| normal() as f32).collect();
        }
        Self {
            augmentation,
            normalisation,
            noise,
        }
    }

    /// Writes left and right tactile difference, colour and depth image, HWC; empty slices stay
    /// empty. Without augmentation, the floats are those of
    /// [`ModelInput`](gripcast_nn::predict::ModelInput) up to rounding.
    pub(super) fn write(
        &self,
        images: &SampleImages,
        seed: Option<u64>,
        Slots { touch, rgb, depth }: Slots<'_>,
    ) -> Written {
        let augmentation = if seed.is_some() {
            self.augmentation
        } else {
            Augmentation::NONE
        };
        let mut draw = SeedStream::named(seed.unwrap_or(0), "augment");
        let rotate = augmentation.rotate_180 && draw.bits() & 1 == 1;
        let mirror = augmentation.mirror && draw.bits() & 1 == 1;
        let has_cameras = !rotate;
        // Each swaps the sensors, both together do not.
        let swap = rotate != mirror;
        let [from_left, from_right] = &images.tactile;
        let pairs = if swap {
            [from_right, from_left]
        } else {
            [from_left, from_right]
        };
        let has_touch = touch.iter().all(|to| !to.is_empty());
        for (pair, to) in pairs.into_iter().zip(touch) {
            if !to.is_empty() {
                self.write_difference(&augmentation, pair, mirror, &mut draw, to);
            }
        }
        let has_rgb = !rgb.is_empty();
        if has_rgb {
            self.write_rgb(&augmentation, &images.rgb, mirror, &mut draw, rgb);
        }
        let points = images.depth.as_ref().filter(|_| !depth.is_empty());
        if let Some(points) = points {
            write_points(&augmentation, points.points(), mirror, &mut draw, depth);
        }
        Written {
            available: Modality::of(|input| match input {
                InputName::TactileLeft | InputName::TactileRight => has_touch,
                InputName::Rgb => has_rgb && has_cameras,
                InputName::Depth => points.is_some() && has_cameras,
            }),
            is_mirrored: mirror,
            is_swapped: swap,
        }
    }

    fn write_difference(
        &self,
        augmentation: &Augmentation,
        [initial, grasp]: &[RgbImage; 2],
        flip_vertical: bool,
        draw: &mut SeedStream,
        to: &mut [f32],
    ) {
        let mut about = |spread: f64| draw.between(-spread, spread);
        let gain = 1.0 + about(augmentation.tactile_gain);
        let gains: [f64; 3] =
            std::array::from_fn(|_| gain * (1.0 + about(augmentation.tactile_channel_gain)));
        let gains = gains.map(|gain| (gain / 255.0) as f32);
        let offsets: [f32; 3] =
            std::array::from_fn(|_| (about(augmentation.tactile_offset) / 255.0) as f32);
        let max = augmentation.tactile_shift;
        let (right, down) = (draw.index(2 * max + 1), draw.index(2 * max + 1));
        let noise = (draw.uniform() * augmentation.tactile_noise / 255.0) as f32;
        let noise_offset = draw.index(NOISE_TABLE);
        for (y, row) in to.chunks_exact_mut(3 * WIDTH).enumerate() {
            let source_y = if flip_vertical { HEIGHT - 1 - y } else { y };
            let from = (source_y + down).saturating_sub(max).min(HEIGHT - 1) * 3 * WIDTH;
            let initial = &initial.as_raw()[from..from + 3 * WIDTH];
            let grasp = &grasp.as_raw()[from..from + 3 * WIDTH];
            for (x, to) in row.as_chunks_mut::<3>().0.iter_mut().enumerate() {
                let from = 3 * (x + right).saturating_sub(max).min(WIDTH - 1);
                for c in 0..3 {
                    let change = f32::from(grasp[from + c]) - f32::from(initial[from + c]);
                    to[c] = change * gains[c] + offsets[c];
                }
            }
            if noise > 0.0 {
                let normals = &self.noise[noise_offset + y * 3 * WIDTH..][..3 * WIDTH];
                for (to, normal) in row.iter_mut().zip(normals) {
                    *to += noise * normal;
                }
            }
        }
    }

    fn write_rgb(
        &self,
        augmentation: &Augmentation,
        rgb: &RgbImage,
        is_mirrored: bool,
        draw: &mut SeedStream,
        to: &mut [f32],
    ) {
        let scale = 1.0 - augmentation.crop * draw.uniform();
        let [down, right] =
            [HEIGHT, WIDTH].map(|side| draw.uniform() * (1.0 - scale) * side as f64);
        let mut about = |spread: f64| 1.0 + draw.between(-spread, spread);
        let brightness = about(augmentation.brightness) / 255.0;
        let gains: [f32; 3] =
            std::array::from_fn(|_| (brightness * about(augmentation.channel_gain)) as f32);
        let saturation = about(augmentation.saturation) as f32;
        let RgbNormalisation { mean, std } = self.normalisation;
        let source = |i: usize, side: usize, flip: bool, offset: f64| {
            let i = if flip { side - 1 - i } else { i };
            ((offset + i as f64 * scale) as usize).min(side - 1)
        };
        let columns: Vec<usize> = (0..WIDTH)
            .map(|x| 3 * source(x, WIDTH, is_mirrored, right))
            .collect();
        for (y, row) in to.chunks_exact_mut(3 * WIDTH).enumerate() {
            let y = source(y, HEIGHT, false, down);
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

/// Writes the points of a depth image with some rectangles removed.
fn write_points(
    augmentation: &Augmentation,
    points: &[[f32; 3]],
    is_mirrored: bool,
    draw: &mut SeedStream,
    to: &mut [f32],
) {
    let pixels = to.as_chunks_mut::<3>().0.chunks_exact_mut(WIDTH);
    for (row, from) in pixels.zip(points.chunks_exact(WIDTH)) {
        if is_mirrored {
            for (to, [x, y, inverse]) in row.iter_mut().zip(from.iter().rev()) {
                *to = [-x, *y, *inverse];
            }
        } else {
            row.copy_from_slice(from);
        }
    }
    if augmentation.depth_holes <= 0.0 {
        return;
    }
    for _ in 0..draw.index(4) {
        let [height, width] = [HEIGHT, WIDTH]
            .map(|side| (draw.uniform() * augmentation.depth_holes * side as f64) as usize);
        let (top, left) = (draw.index(HEIGHT - height), draw.index(WIDTH - width));
        for row in to.chunks_exact_mut(3 * WIDTH).skip(top).take(height) {
            row[3 * left..3 * (left + width)].fill(0.0);
        }
    }
}
