//! What a GelSight Mini on the virtual gripper sees: the tactile renderer's image of the step
//! that is shown, in the frame of the whole sensor.

use image::RgbImage;

use super::film::Film;
use super::hand::SceneMoment;
use super::random::{NoiseTable, mixed, signed_unit};
use gripcast_base::error::Result;
use gripcast_imaging::{CropWindow, Role};
use gripcast_sim::grasp::Finger;
use gripcast_tactile::{
    FrameNoise, PressDepth, Rasteriser, SensorMount, SensorProfile, TactileRenderer, TactileScene,
    WholeFrame, object_depth,
};

/// Largest difference of two sensors of a kind, grey levels.
const OWN_COLOUR: f64 = 4.0;

/// Paints one sensor's images at a fixed size.
pub(super) struct GelPainter {
    finger: Finger,
    seed: u64,
    look: FrameNoise,
    rasteriser: Rasteriser,
    renderer: TactileRenderer,
    frame: WholeFrame,
    untouched: RgbImage,
    noise: NoiseTable,
    /// The image without noise, and of which grasp and step it is.
    still: RgbImage,
    shown: Option<(u64, usize)>,
}

impl GelPainter {
    /// A painter of `painted` images of the gel on `side` for a camera with frames of `full`
    /// pixels.
    pub(super) fn new(
        side: Role,
        seed: u64,
        painted: (u32, u32),
        full: (u32, u32),
    ) -> Result<Self> {
        let profile = SensorProfile::gelsight_mini()?;
        let seed = mixed(seed, 0x67_656C, side as u64);
        let window = profile.crop_profile.window(full.0, full.1);
        let window = window.unwrap_or(CropWindow {
            left: 0,
            top: 0,
            width: full.0,
            height: full.1,
        });
        let frame = WholeFrame::new(&profile, window, full, painted);
        let look = FrameNoise {
            offset: [0, 1, 2].map(|n| (OWN_COLOUR * signed_unit(seed, 1, n)) as f32),
            ..FrameNoise::default()
        };
        // The crop is shrunk to the sensor's image, which averages noise.
        let shrunk = f64::from(painted.0) / f64::from(full.0) * f64::from(window.width)
            / profile.geometry.width as f64;
        let noise_std = profile.noise_std.iter().sum::<f64>() / 3.0 * shrunk.max(1.0);
        let mut renderer = TactileRenderer::new(&profile)?;
        let untouched = renderer.render(&PressDepth::untouched(profile.geometry), &look)?;
        Ok(Self {
            finger: if side == Role::Right {
                Finger::Right
            } else {
                Finger::Left
            },
            seed,
            look,
            rasteriser: Rasteriser::new(),
            renderer,
            frame,
            untouched,
            noise: NoiseTable::new(seed, noise_std),
            still: RgbImage::new(0, 0),
            shown: None,
        })
    }

    /// The image at `moment` as RGB rows; `frame` picks the noise.
    ///
    /// # Errors
    /// Where the object's mesh cannot be read.
    pub(super) fn paint(&mut self, moment: &SceneMoment, frame: u64) -> Result<Vec<u8>> {
        let wanted = (moment.grasp, moment.step);
        if self.shown != Some(wanted) {
            let image = self.render(&moment.film, moment.step)?;
            let image = image.as_ref().unwrap_or(&self.untouched);
            self.still = self.frame.compose(image, &self.untouched)?;
            self.shown = Some(wanted);
        }
        let mut image = self.still.as_raw().clone();
        let row_bytes = 3 * self.still.width() as usize;
        self.noise.add_to(&mut image, row_bytes, self.seed, frame);
        Ok(image)
    }

    /// The sensor's own image, none where nothing touches.
    fn render(&mut self, film: &Film, step: usize) -> Result<Option<RgbImage>> {
        let step = &film.steps()[step];
        if step.min_gap_m[self.finger as usize].is_none() {
            return Ok(None);
        }
        let place = SensorMount::on(self.finger);
        let t_world_gripper = film.start().t_world_gripper();
        let mesh = film.mesh()?;
        let scene = TactileScene::from_step(mesh, film.gel(), &t_world_gripper, step, place)?;
        let press = object_depth(&scene, &self.renderer.geometry(), &mut self.rasteriser);
        self.renderer.render(&press, &self.look).map(Some)
    }
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use super::*;
    use crate::FilmLibrary;
    use gripcast_imaging::{CropProfile, crop_and_resize};
    use gripcast_tactile::ObjectDepthRenderer;
    use gripcast_tactile::SceneRenderer as _;
    use gripcast_testing::mean_difference;

    const SIZE: (u32, u32) = (640, 480);

    fn film(name: &str) -> Arc<Film> {
        let library = FilmLibrary::built_in().unwrap();
        let found = library.films().iter().find(|film| film.name() == name);
        found.unwrap().clone()
    }

    fn moment(film: &Arc<Film>, progress: f64) -> SceneMoment {
        SceneMoment {
            grasp: 0,
            film: film.clone(),
            step: film.step_at(progress),
        }
    }

    /// The sensor's image as a program crops it out of the frame.
    fn cropped(frame: Vec<u8>) -> RgbImage {
        let frame = RgbImage::from_raw(SIZE.0, SIZE.1, frame).unwrap();
        crop_and_resize(&frame, &CropProfile::GSMINI_SEVENTH, 320, 240).unwrap()
    }

    #[test]
    fn the_crop_gives_back_what_the_renderer_made() {
        let film = film("mug");
        let profile = SensorProfile::gelsight_mini().unwrap();
        let mut renderer = ObjectDepthRenderer::new(&profile).unwrap();
        for (side, finger) in [(Role::Left, Finger::Left), (Role::Right, Finger::Right)] {
            let mut painter = GelPainter::new(side, 1, SIZE, SIZE).unwrap();
            painter.look = FrameNoise::default();
            let shown = moment(&film, 1.0);
            let cut = cropped(painter.paint(&shown, 1).unwrap());
            let step = &film.steps()[shown.step];
            let t_world_gripper = film.start().t_world_gripper();
            let place = SensorMount::on(finger);
            let mesh = film.mesh().unwrap();
            let scene =
                TactileScene::from_step(mesh, film.gel(), &t_world_gripper, step, place).unwrap();
            let made = renderer.render(&scene, None).unwrap();
            let bare = renderer.render(&scene.untouched(), None).unwrap();
            assert!(mean_difference(&made, &bare) > 1.0, "nothing is pressed in");
            let off = mean_difference(&cut, &made);
            assert!(
                off < 1.2,
                "{side}: {off} grey levels between frame and renderer"
            );
        }
    }

    #[test]
    fn untouched_gels_differ_by_the_sensors_noise_only() {
        let film = film("ball");
        let mut painter = GelPainter::new(Role::Left, 1, SIZE, SIZE).unwrap();
        let a = cropped(painter.paint(&moment(&film, 0.0), 1).unwrap());
        let b = cropped(painter.paint(&moment(&film, 0.2), 2).unwrap());
        assert!(a != b, "every frame has its own noise");
        // Two of 0.84 grey levels, as calibrated; mean |N(0, σ√2)| is 0.8 σ√2.
        let mean = mean_difference(&a, &b);
        assert!((0.5..1.3).contains(&mean), "{mean}");
        let again = cropped(painter.paint(&moment(&film, 0.0), 1).unwrap());
        assert!(a == again);
    }

    #[test]
    fn contact_grows_while_the_hand_closes_and_the_rim_is_dark() {
        let film = film("ball");
        let mut painter = GelPainter::new(Role::Right, 1, SIZE, SIZE).unwrap();
        let mut at = |progress: f64| painter.paint(&moment(&film, progress), 1).unwrap();
        let open = at(0.0);
        let corner: u32 = open[..30].iter().map(|v| u32::from(*v)).sum();
        let middle: u32 = open[3 * (240 * 640 + 320)..][..30]
            .iter()
            .map(|v| u32::from(*v))
            .sum();
        assert!(2 * corner < middle, "{corner} {middle}");
        let bare = cropped(open);
        let changes = [0.2, 0.4, 0.6, 0.8].map(|p| mean_difference(&cropped(at(p)), &bare));
        assert!(
            changes.windows(2).all(|pair| pair[0] < pair[1]),
            "{changes:?}"
        );
    }

    #[test]
    fn odd_frames_are_filled() {
        let film = film("ball");
        for size in [(16, 16), (18, 400), (820, 616)] {
            let mut painter = GelPainter::new(Role::Left, 1, size, size).unwrap();
            let image = painter.paint(&moment(&film, 1.0), 0).unwrap();
            assert_eq!(image.len(), 3 * (size.0 * size.1) as usize);
        }
    }
}
