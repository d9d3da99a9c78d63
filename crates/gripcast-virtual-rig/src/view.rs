//! What the D435 on the virtual gripper and a camera beside the table see: the path-traced
//! image of the last key step, with the noise of a frame.

use super::film::Film;
use super::hand::SceneMoment;
use super::random::{NoiseTable, mixed};
use gripcast_base::error::Result;
use gripcast_imaging::{DepthImage, RgbScaler};
use gripcast_visual::DepthSettings;

/// Noise of the colour camera, grey levels.
const COLOUR_NOISE: f64 = 1.5;
/// Steps of the depth noise table in a standard deviation.
const DEPTH_NOISE_STEPS: f64 = 16.0;

/// Which camera of a film.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Place {
    /// Between the fingers.
    Hand,
    /// Beside the table.
    Outside,
}

/// Paints colour images at a fixed size.
pub(super) struct ColourPainter {
    place: Place,
    seed: u64,
    size: (u32, u32),
    scaler: RgbScaler,
    noise: NoiseTable,
    /// Images of the keys, and of which grasp they are.
    shown: Option<(u64, Vec<Vec<u8>>)>,
}

impl ColourPainter {
    /// A painter of images of `size`.
    pub(super) fn new(place: Place, seed: u64, size: (u32, u32)) -> Self {
        let seed = mixed(seed, 0x7669_6577, place as u64);
        Self {
            place,
            seed,
            size,
            scaler: RgbScaler::default(),
            noise: NoiseTable::new(seed, COLOUR_NOISE),
            shown: None,
        }
    }

    /// The image at `moment` as RGB rows; `frame` picks the noise.
    ///
    /// # Errors
    /// `Input` where the film's strip is damaged.
    pub(super) fn paint(&mut self, moment: &SceneMoment, frame: u64) -> Result<Vec<u8>> {
        let images = match self.shown.take() {
            Some((grasp, images)) if grasp == moment.grasp => images,
            _ => self.images(&moment.film)?,
        };
        let key = match self.place {
            Place::Hand => moment.film.key_at(moment.step),
            Place::Outside => moment.film.outside_key_at(moment.step),
        };
        let mut image = images[key].clone();
        self.shown = Some((moment.grasp, images));
        let row_bytes = 3 * self.size.0 as usize;
        self.noise.add_to(&mut image, row_bytes, self.seed, frame);
        Ok(image)
    }

    fn images(&mut self, film: &Film) -> Result<Vec<Vec<u8>>> {
        let strip = match self.place {
            Place::Hand => film.colour(),
            Place::Outside => film.outside(),
        }?;
        strip
            .iter()
            .map(|image| Ok(self.scaler.cover(image, self.size)?.into_raw()))
            .collect()
    }
}

/// Paints depth images at a fixed size.
pub(super) struct DepthPainter {
    seed: u64,
    size: (u32, u32),
    settings: DepthSettings,
    noise: NoiseTable,
    shown: Option<(u64, Vec<DepthImage>)>,
}

impl DepthPainter {
    /// A painter of images of `size`.
    pub(super) fn new(seed: u64, size: (u32, u32)) -> Self {
        let seed = mixed(seed, 0x6465_7074, 0);
        Self {
            seed,
            size,
            settings: DepthSettings::default(),
            noise: NoiseTable::new(seed, DEPTH_NOISE_STEPS),
            shown: None,
        }
    }

    /// The image at `moment`, m; 0 where stereo is blind. `frame` picks the noise.
    ///
    /// # Errors
    /// `Input` where the film's strip is damaged.
    pub(super) fn paint_m(&mut self, moment: &SceneMoment, frame: u64) -> Result<Vec<f32>> {
        let images = match self.shown.take() {
            Some((grasp, images)) if grasp == moment.grasp => images,
            _ => moment.film.depth_mm()?,
        };
        let image = &images[moment.film.key_at(moment.step)];
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
        self.shown = Some((moment.grasp, images));
        Ok(depth_m)
    }
}

/// One axis of an image of which the middle is shown.
#[derive(Clone, Copy, Debug)]
struct Axis {
    first: f64,
    step: f64,
    last: u32,
}

impl Axis {
    /// Nearest line of the source.
    fn source(self, line: u32) -> u32 {
        ((self.first + (f64::from(line) + 0.5) * self.step) as u32).min(self.last)
    }
}

/// Columns and rows that fill `to` with the middle of an image of size `from`.
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
    use crate::FilmLibrary;

    fn moment(number: usize, progress: f64) -> SceneMoment {
        let film = FilmLibrary::built_in().unwrap().films()[number].clone();
        SceneMoment {
            grasp: number as u64,
            step: film.step_at(progress),
            film,
        }
    }

    #[test]
    fn images_follow_the_keys_and_noise_the_frame() {
        let mut painter = ColourPainter::new(Place::Hand, 1, (160, 120));
        let open = painter.paint(&moment(0, 0.0), 1).unwrap();
        assert!(open == painter.paint(&moment(0, 0.0), 1).unwrap());
        let difference = |a: &[u8], b: &[u8]| {
            let sum: u64 = a
                .iter()
                .zip(b)
                .map(|(a, b)| u64::from(a.abs_diff(*b)))
                .sum();
            sum as f64 / a.len() as f64
        };
        let noise = difference(&open, &painter.paint(&moment(0, 0.0), 2).unwrap());
        assert!((1.0..2.5).contains(&noise), "{noise}");
        let closed = painter.paint(&moment(0, 1.0), 1).unwrap();
        assert!(
            difference(&open, &closed) > 2.0 * noise,
            "the fingers are not seen closing"
        );
        let other = painter.paint(&moment(1, 0.0), 1).unwrap();
        assert!(
            difference(&open, &other) > 2.0 * noise,
            "another object looks the same"
        );
        let mut outside = ColourPainter::new(Place::Outside, 1, (160, 120));
        assert!(difference(&open, &outside.paint(&moment(0, 0.0), 1).unwrap()) > 2.0 * noise);
    }

    #[test]
    fn depth_is_that_of_the_table_and_noisy_as_stereo_is() {
        let mut painter = DepthPainter::new(1, (160, 120));
        let mut frames: Vec<Vec<f32>> = Vec::new();
        for frame in 0..40 {
            frames.push(painter.paint_m(&moment(0, 0.0), frame).unwrap());
        }
        let seen = frames[0].iter().filter(|z| **z > 0.0);
        assert!(seen.clone().count() > 160 * 120 / 2);
        assert!(seen.clone().all(|z| (0.1..1.5).contains(z)));
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
    fn other_shapes_show_the_middle() {
        let [across, down] = centred((320, 240), (160, 90));
        assert_eq!((across.source(0), across.source(159)), (1, 319));
        // 240 rows shrink to 120, of which 90 are shown.
        assert_eq!((down.source(0), down.source(89)), (31, 209));
        let [across, _] = centred((320, 240), (100, 100));
        assert!((across.first - 40.0).abs() < 1e-9);
    }
}
