//! Images of the D435 on the virtual gripper and of the external camera: the path-traced image
//! of the last keyframe with the noise of a frame.

use super::clip::Clip;
use super::hand::SceneState;
use super::random::{NoiseTable, mixed};
use gripcast_base::error::Result;
use gripcast_imaging::{DepthImage, RgbScaler};
use gripcast_visual::DepthSettings;

/// Noise of the colour camera, grey levels.
const COLOUR_NOISE: f64 = 1.5;
/// Steps of the depth noise table in a standard deviation.
const DEPTH_NOISE_STEPS: f64 = 16.0;

/// Camera of a clip.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Viewpoint {
    /// On the gripper.
    Hand,
    /// Beside the table.
    External,
}

/// Renders colour images of a fixed size.
pub(super) struct ColourRenderer {
    place: Viewpoint,
    seed: u64,
    size: (u32, u32),
    scaler: RgbScaler,
    noise: NoiseTable,
    /// Index of the current grasp and its keyframe images.
    cached: Option<(u64, Vec<Vec<u8>>)>,
}

impl ColourRenderer {
    /// Creates a renderer of images of `size`.
    pub(super) fn new(place: Viewpoint, seed: u64, size: (u32, u32)) -> Self {
        let seed = mixed(seed, 0x7669_6577, place as u64);
        Self {
            place,
            seed,
            size,
            scaler: RgbScaler::default(),
            noise: NoiseTable::new(seed, COLOUR_NOISE),
            cached: None,
        }
    }

    /// Returns the image of `scene` as RGB bytes with the noise of `frame`.
    ///
    /// # Errors
    /// `Input` for a damaged image strip of the clip.
    pub(super) fn render_frame(&mut self, scene: &SceneState, frame: u64) -> Result<Vec<u8>> {
        let images = match self.cached.take() {
            Some((grasp, images)) if grasp == scene.grasp => images,
            _ => self.images(&scene.clip)?,
        };
        let key = match self.place {
            Viewpoint::Hand => scene.clip.key_at(scene.step),
            Viewpoint::External => scene.clip.external_key_at(scene.step),
        };
        let mut image = images[key].clone();
        self.cached = Some((scene.grasp, images));
        let row_bytes = 3 * self.size.0 as usize;
        self.noise.add_to(&mut image, row_bytes, self.seed, frame);
        Ok(image)
    }

    fn images(&mut self, clip: &Clip) -> Result<Vec<Vec<u8>>> {
        let strip = match self.place {
            Viewpoint::Hand => clip.colour(),
            Viewpoint::External => clip.external(),
        }?;
        strip
            .iter()
            .map(|image| Ok(self.scaler.cover(image, self.size)?.into_raw()))
            .collect()
    }
}

/// Renders depth images of a fixed size.
pub(super) struct DepthRenderer {
    seed: u64,
    size: (u32, u32),
    settings: DepthSettings,
    noise: NoiseTable,
    cached: Option<(u64, Vec<DepthImage>)>,
}

impl DepthRenderer {
    /// Creates a renderer of images of `size`.
    pub(super) fn new(seed: u64, size: (u32, u32)) -> Self {
        let seed = mixed(seed, 0x6465_7074, 0);
        Self {
            seed,
            size,
            settings: DepthSettings::default(),
            noise: NoiseTable::new(seed, DEPTH_NOISE_STEPS),
            cached: None,
        }
    }

    /// Returns the depth image of `scene`, m, with the noise of `frame`; 0 where stereo has no
    /// match.
    ///
    /// # Errors
    /// `Input` for a damaged image strip of the clip.
    pub(super) fn render_frame_m(&mut self, scene: &SceneState, frame: u64) -> Result<Vec<f32>> {
        let images = match self.cached.take() {
            Some((grasp, images)) if grasp == scene.grasp => images,
            _ => scene.clip.depth_mm()?,
        };
        let image = &images[scene.clip.depth_key_at(scene.step)];
        let (width, height) = self.size;
        let [across, down] = centred(image.dimensions(), self.size);
        let mut depth_m = Vec::with_capacity(width as usize * height as usize);
        for row in 0..height {
            let noise = self
                .noise
                .row(self.seed, frame, row as usize, width as usize);
            let from_row = down.source(row);
            for (column, noise) in (0..width).zip(noise) {
                let true_m = f64::from(image.get_pixel(across.source(column), from_row)[0]) * 1e-3;
                let deviation = self.settings.depth_std_m(true_m) / DEPTH_NOISE_STEPS;
                depth_m.push((true_m + deviation * f64::from(*noise)) as f32);
            }
        }
        self.cached = Some((scene.grasp, images));
        Ok(depth_m)
    }
}

/// Mapping of one image axis to the centre crop of a source image.
#[derive(Clone, Copy, Debug)]
struct Axis {
    first: f64,
    step: f64,
    last: u32,
}

impl Axis {
    /// Returns the nearest row or column of the source.
    fn source(self, line: u32) -> u32 {
        ((self.first + (f64::from(line) + 0.5) * self.step) as u32).min(self.last)
    }
}

/// Maps columns and rows of an image of size `to` to the centre crop of one of size `from`.
fn centred(from: (u32, u32), to: (u32, u32)) -> [Axis; 2] {
    let scale = |from: u32, to: u32| f64::from(from) / f64::from(to);
    let step = scale(from.0, to.0).min(scale(from.1, to.1));
    let axis = |from: u32, to: u32| Axis {
        first: 0.5 * (f64::from(from) - step * f64::from(to)),
        step,
        last: from.saturating_sub(1),
    };
    [axis(from.0, to.0), axis(from.1, to.1)]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::ClipLibrary;

    fn scene_at(number: usize, progress: f64) -> SceneState {
        let clip = ClipLibrary::built_in().unwrap().clips()[number].clone();
        SceneState {
            grasp: number as u64,
            step: clip.step_at(progress),
            clip,
        }
    }

    #[test]
    fn image_follows_the_keyframe_and_noise_the_frame() {
        let mut renderer = ColourRenderer::new(Viewpoint::Hand, 1, (160, 120));
        let open = renderer.render_frame(&scene_at(0, 0.0), 1).unwrap();
        assert!(open == renderer.render_frame(&scene_at(0, 0.0), 1).unwrap());
        let difference = |a: &[u8], b: &[u8]| {
            let sum: u64 = a
                .iter()
                .zip(b)
                .map(|(a, b)| u64::from(a.abs_diff(*b)))
                .sum();
            sum as f64 / a.len() as f64
        };
        let noise = difference(&open, &renderer.render_frame(&scene_at(0, 0.0), 2).unwrap());
        assert!((1.0..2.5).contains(&noise), "{noise}");
        let closed = renderer.render_frame(&scene_at(0, 1.0), 1).unwrap();
        assert!(
            difference(&open, &closed) > 2.0 * noise,
            "the fingers must move"
        );
        let other = renderer.render_frame(&scene_at(1, 0.0), 1).unwrap();
        assert!(
            difference(&open, &other) > 2.0 * noise,
            "the object must differ"
        );
        let mut external = ColourRenderer::new(Viewpoint::External, 1, (160, 120));
        assert!(
            difference(&open, &external.render_frame(&scene_at(0, 0.0), 1).unwrap()) > 2.0 * noise
        );
    }

    #[test]
    fn depth_noise_matches_the_stereo_model() {
        let mut renderer = DepthRenderer::new(1, (160, 120));
        let mut frames: Vec<Vec<f32>> = Vec::new();
        for frame in 0..40 {
            frames.push(renderer.render_frame_m(&scene_at(0, 0.0), frame).unwrap());
        }
        let measured = frames[0].iter().filter(|z| **z > 0.0);
        assert!(measured.clone().count() > 160 * 120 / 2);
        assert!(measured.clone().all(|z| (0.1..1.5).contains(z)));
        // A pixel of the table, far from everything: its spread over the frames is z² s / (f b).
        let column: Vec<f64> = frames.iter().map(|f| f64::from(f[160 * 12 + 80])).collect();
        let mean = column.iter().sum::<f64>() / 40.0;
        let spread = (column.iter().map(|z| (z - mean).powi(2)).sum::<f64>() / 39.0).sqrt();
        let expected = DepthSettings::default().depth_std_m(mean);
        assert!(
            mean > 0.1 && (spread / expected - 1.0).abs() < 0.4,
            "{spread} {expected}"
        );
    }

    #[test]
    fn other_aspect_ratios_show_the_centre_crop() {
        let [across, down] = centred((320, 240), (160, 90));
        assert_eq!((across.source(0), across.source(159)), (1, 319));
        // 240 rows shrink to 120, of which 90 are shown.
        assert_eq!((down.source(0), down.source(89)), (31, 209));
        let [across, _] = centred((320, 240), (100, 100));
        assert!((across.first - 40.0).abs() < 1e-9);
    }
}
