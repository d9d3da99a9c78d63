//! Compares real and simulated tactile images of a grasp.

use image::{Rgb, RgbImage, imageops};

use super::object_file::ReplayObject;
use super::recording::RecordedGrasp;
use super::report::{ImagePair, TactilePair};
use gripcast_base::error::{Error, Result};
use gripcast_base::statistics::median;
use gripcast_dataset::{Dataset, Stage};
use gripcast_imaging::{CropProfile, Decoder, Role, TactileDifference};
use gripcast_report::image::data_uri;
use gripcast_sim::grasp::{Finger, Snapshot};
use gripcast_tactile::{SceneRenderer, SensorMount, SimulatedGel, TactileScene};

/// Width and height of the compared images, px.
const COMPARED: [u32; 2] = [320, 240];
/// Width and height of the shown images, px.
const SHOWN: [u32; 2] = [160, 120];
/// Amplification of the shown difference.
const GAIN: f32 = 1.5;
/// Minimum smoothed change in contact, grey levels; sensor noise is below.
const CONTACT_LEVELS: f32 = 8.0;
/// Half width of the smoothing filter of the contact mask, px.
const SMOOTH_PX: usize = 3;
/// Margin of the evaluated patch around both masks, px.
const PATCH_PX: usize = 10;

/// Compares the images of both sensors. `snapshot` is the end of the simulated adjustment.
///
/// # Errors
/// `NotFound` or `Input` if a stored frame is missing or damaged; errors of rendering.
pub(super) fn tactile_pairs(
    dataset: &Dataset,
    grasp: &RecordedGrasp,
    object: &ReplayObject,
    gel: &SimulatedGel,
    snapshot: &Snapshot,
    renderer: &mut dyn SceneRenderer,
) -> Result<Vec<TactilePair>> {
    let mut decoder = Decoder::new()?;
    let sensors = [(Role::Left, Finger::Left), (Role::Right, Finger::Right)];
    sensors
        .into_iter()
        .map(|(role, finger)| {
            let real = recorded(dataset, grasp, role, &mut decoder)?;
            let sensor = SensorMount::on(finger);
            let scene = TactileScene::from_snapshot(&object.mesh, gel, snapshot, sensor)?;
            let untouched = renderer.render(&scene.untouched(), None)?;
            let touched = renderer.render(&scene, None)?;
            let sim = Change::between(&resized(&untouched), &resized(&touched))?;
            pair(role, &real, &sim)
        })
        .collect()
}

/// Reads the change between the stored frames of a sensor.
fn recorded(
    dataset: &Dataset,
    grasp: &RecordedGrasp,
    role: Role,
    decoder: &mut Decoder,
) -> Result<Change> {
    let mut read = |stage: Stage| -> Result<RgbImage> {
        let camera = grasp.record.stage(stage).cameras.get(&role);
        let profile = camera.and_then(|camera| camera.crop_profile.as_deref());
        let crop = profile.map(CropProfile::by_name).transpose()?;
        let frame = dataset.load_frame(&grasp.record, stage, role)?;
        let [width, height] = COMPARED;
        decoder
            .decode(&frame, crop.as_ref(), width, height)
            .map_err(|damage| Error::input(format!("the {role} frame is damaged")).because(damage))
    };
    let initial = read(Stage::Initial)?;
    Change::between(&initial, &read(Stage::Grasp)?)
}

fn resized(image: &RgbImage) -> RgbImage {
    let [width, height] = COMPARED;
    if image.dimensions() == (width, height) {
        return image.clone();
    }
    imageops::resize(image, width, height, imageops::FilterType::Triangle)
}

/// Change of an image by the contact: grey levels, RGB per pixel.
struct Change {
    levels: Vec<f32>,
}

impl Change {
    /// Difference of two images, minus the median of each channel: exposure and white balance drift
    /// between frames, and most pixels are not in contact.
    fn between(initial: &RgbImage, grasp: &RgbImage) -> Result<Self> {
        let difference = TactileDifference::between(initial, grasp)?;
        let mut levels: Vec<f32> = difference.levels().iter().map(|l| f32::from(*l)).collect();
        for channel in 0..3 {
            let values = levels.iter().skip(channel).step_by(3);
            let median = median(values.map(|level| f64::from(*level))).unwrap_or(0.0) as f32;
            let of_channel = levels.iter_mut().skip(channel).step_by(3);
            of_channel.for_each(|level| *level -= median);
        }
        Ok(Self { levels })
    }

    /// Contact mask.
    fn mask(&self) -> Vec<bool> {
        let strength: Vec<f32> = self
            .levels
            .chunks_exact(3)
            .map(|pixel| {
                pixel
                    .iter()
                    .fold(0.0, |max: f32, level| max.max(level.abs()))
            })
            .collect();
        let smooth = box_mean(&strength, SMOOTH_PX);
        smooth.iter().map(|level| *level > CONTACT_LEVELS).collect()
    }

    /// Renders the change; 128 means no change.
    fn image(&self) -> RgbImage {
        let [width, height] = COMPARED;
        let mut image = RgbImage::new(width, height);
        for (pixel, levels) in image.pixels_mut().zip(self.levels.chunks_exact(3)) {
            // The cast saturates; + 0.5 rounds.
            *pixel = Rgb([0, 1, 2].map(|c| (128.5 + GAIN * levels[c]) as u8));
        }
        image
    }
}

fn pair(role: Role, real: &Change, sim: &Change) -> Result<TactilePair> {
    let difference = Change {
        levels: real
            .levels
            .iter()
            .zip(&sim.levels)
            .map(|(r, s)| r - s)
            .collect(),
    };
    let shown = |change: &Change| {
        let [width, height] = SHOWN;
        let image = imageops::thumbnail(&change.image(), width, height);
        data_uri(&image)
    };
    let (real_mask, sim_mask) = (real.mask(), sim.mask());
    let both = real_mask
        .iter()
        .zip(&sim_mask)
        .filter(|(r, s)| **r && **s)
        .count();
    let either: Vec<f32> = real_mask
        .iter()
        .zip(&sim_mask)
        .map(|(r, s)| f32::from(u8::from(*r || *s)))
        .collect();
    let union = either.iter().filter(|either| **either > 0.0).count();
    let patch = box_mean(&either, PATCH_PX);
    let in_patch = |levels: &[f32]| -> Vec<f64> {
        let pixels = levels.chunks_exact(3).zip(&patch);
        let pixels = pixels.filter(|(_, near)| **near > 0.0);
        pixels
            .flat_map(|(pixel, _)| pixel)
            .map(|level| f64::from(*level))
            .collect()
    };
    let square = |levels: &[f64]| levels.iter().map(|level| level * level).sum::<f64>();
    let (error, signal) = (in_patch(&difference.levels), in_patch(&real.levels));
    let count = error.len() as f64;
    let has_contact = union > 0;
    Ok(TactilePair {
        sensor: role.name().to_owned(),
        images: ImagePair {
            real: shown(real)?,
            sim: shown(sim)?,
        },
        difference: shown(&difference)?,
        contact_iou: has_contact.then(|| both as f64 / union as f64),
        // Without real contact there is no variance to explain.
        fve: real_mask
            .contains(&true)
            .then(|| 1.0 - square(&error) / square(&signal)),
        psnr_db: (square(&error) > 0.0)
            .then(|| 10.0 * (255.0 * 255.0 * count / square(&error)).log10()),
        l1: has_contact.then(|| error.iter().map(|level| level.abs()).sum::<f64>() / count),
    })
}

/// Box filter over squares of `2 half + 1` px, clipped at the border.
fn box_mean(values: &[f32], half: usize) -> Vec<f32> {
    let [width, height] = COMPARED.map(|side| side as usize);
    // Summed-area table.
    let mut sums = vec![0.0f64; (width + 1) * (height + 1)];
    for y in 0..height {
        let mut row = 0.0;
        for x in 0..width {
            row += f64::from(values[y * width + x]);
            sums[(y + 1) * (width + 1) + x + 1] = sums[y * (width + 1) + x + 1] + row;
        }
    }
    let at = |x: usize, y: usize| sums[y * (width + 1) + x];
    let mut out = Vec::with_capacity(values.len());
    for y in 0..height {
        let (top, bottom) = (y.saturating_sub(half), (y + half + 1).min(height));
        for x in 0..width {
            let (left, right) = (x.saturating_sub(half), (x + half + 1).min(width));
            let sum = at(right, bottom) - at(left, bottom) - at(right, top) + at(left, top);
            // Differences of sums leave rounding errors where all values are zero.
            let mean = sum / ((right - left) * (bottom - top)) as f64;
            out.push(if mean < 1e-9 { 0.0 } else { mean as f32 });
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A grey image with a brighter disc.
    fn disc(center: [f32; 2], radius: f32, level: u8) -> RgbImage {
        let [width, height] = COMPARED;
        RgbImage::from_fn(width, height, |x, y| {
            let off = (x as f32 - center[0]).hypot(y as f32 - center[1]);
            Rgb([if off < radius { level } else { 100 }; 3])
        })
    }

    fn scored(real: &RgbImage, sim: &RgbImage) -> TactilePair {
        let plain = disc([0.0; 2], 0.0, 100);
        let real = Change::between(&plain, real).unwrap();
        let sim = Change::between(&plain, sim).unwrap();
        pair(Role::Left, &real, &sim).unwrap()
    }

    #[test]
    fn identical_contacts_agree() {
        let touched = disc([160.0, 120.0], 40.0, 150);
        let found = scored(&touched, &touched);
        assert_eq!(found.contact_iou, Some(1.0));
        assert_eq!(
            (found.fve, found.l1, found.psnr_db),
            (Some(1.0), Some(0.0), None)
        );
        assert_eq!(found.sensor, "left");
    }

    #[test]
    fn shifted_contact_overlaps_partially() {
        let real = disc([150.0, 120.0], 40.0, 150);
        let sim = disc([190.0, 120.0], 40.0, 150);
        let found = scored(&real, &sim);
        // Two discs of radius r at distance r overlap in (2π/3 − √3/2) r² of (4π/3 + √3/2) r².
        let iou = found.contact_iou.unwrap();
        assert!((iou - 0.243).abs() < 0.03, "{iou}");
        assert!(found.fve.unwrap() < 0.0, "{found:?}");
    }

    #[test]
    fn images_without_contact_have_no_scores() {
        let brighter = disc([0.0; 2], 0.0, 100);
        let found = scored(&brighter, &brighter);
        assert_eq!((found.contact_iou, found.fve, found.l1), (None, None, None));
    }

    #[test]
    fn exposure_drift_is_not_contact() {
        let mut drifted = disc([160.0, 120.0], 40.0, 150);
        drifted.iter_mut().for_each(|level| *level += 9);
        let found = scored(&drifted, &disc([160.0, 120.0], 40.0, 150));
        assert_eq!((found.contact_iou, found.l1), (Some(1.0), Some(0.0)));
    }
}
