//! Frames of a GelSight Mini on the virtual gripper: the rendered tactile image of the shown step,
//! placed in the frame of the whole sensor.

use image::RgbImage;

use super::clip::Clip;
use super::hand::SceneState;
use super::random::{NoiseTable, mixed, signed_unit};
use gripcast_base::error::Result;
use gripcast_imaging::{CropWindow, Role};
use gripcast_sim::grasp::Finger;
use gripcast_tactile::{
    FrameNoise, NodeMotion, PressDepth, Rasteriser, SensorMount, SensorProfile, Skin,
    TactileRenderer, TactileScene, WholeFrame, object_depth,
};

/// Maximum colour offset between two sensors of the same model, grey levels.
const MAX_COLOUR_OFFSET: f64 = 4.0;

/// Renders the frames of one sensor at a fixed size.
pub(super) struct GelRenderer {
    finger: Finger,
    seed: u64,
    look: FrameNoise,
    rasteriser: Rasteriser,
    renderer: TactileRenderer,
    frame: WholeFrame,
    untouched: RgbImage,
    noise: NoiseTable,
    /// Image without noise, and its grasp and step.
    noiseless: RgbImage,
    cached: Option<(u64, usize)>,
}

impl GelRenderer {
    /// Creates a renderer of images of `render_size` for the gel of a profile on `side`, whose camera
    /// has frames of `full` pixels.
    pub(super) fn new(
        side: Role,
        seed: u64,
        render_size: (u32, u32),
        full: (u32, u32),
        profile: &SensorProfile,
    ) -> Result<Self> {
        let seed = mixed(seed, 0x67_656C, side as u64);
        let window = profile.crop_profile.window(full.0, full.1);
        let window = window.unwrap_or(CropWindow {
            left: 0,
            top: 0,
            width: full.0,
            height: full.1,
        });
        let frame = WholeFrame::new(profile, window, full, render_size);
        let look = FrameNoise {
            offset: [0, 1, 2].map(|n| (MAX_COLOUR_OFFSET * signed_unit(seed, 1, n)) as f32),
            ..FrameNoise::default()
        };
        // Downscaling the crop to the model's image averages noise.
        let shrunk = f64::from(render_size.0) / f64::from(full.0) * f64::from(window.width)
            / profile.geometry.width as f64;
        let noise_std = profile.noise_std.iter().sum::<f64>() / 3.0 * shrunk.max(1.0);
        let mut renderer = TactileRenderer::new(profile)?;
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
            noiseless: RgbImage::new(0, 0),
            cached: None,
        })
    }

    /// Returns the frame of `scene` as RGB bytes with the noise of `frame`.
    ///
    /// # Errors
    /// Errors of reading the object's mesh.
    pub(super) fn render_frame(&mut self, scene: &SceneState, frame: u64) -> Result<Vec<u8>> {
        let key = (scene.grasp, scene.step);
        if self.cached != Some(key) {
            let image = self.render(&scene.clip, scene.step)?;
            let image = image.as_ref().unwrap_or(&self.untouched);
            self.noiseless = self.frame.compose(image, &self.untouched)?;
            self.cached = Some(key);
        }
        let mut image = self.noiseless.as_raw().clone();
        let row_bytes = 3 * self.noiseless.width() as usize;
        self.noise.add_to(&mut image, row_bytes, self.seed, frame);
        Ok(image)
    }

    /// Renders the sensor image, or `None` without contact.
    fn render(&mut self, clip: &Clip, index: usize) -> Result<Option<RgbImage>> {
        let step = &clip.steps[index];
        if step.min_gap_m[self.finger as usize].is_none() {
            return Ok(None);
        }
        let place = SensorMount::on(self.finger);
        let t_world_gripper = clip.start.t_world_gripper();
        let mesh = clip.mesh()?;
        let mut scene = TactileScene::from_step(mesh, &clip.gel, &t_world_gripper, step, place)?;
        if let Some(field) = clip.field_at(index, self.finger) {
            let motion = NodeMotion::of_field(&clip.gel.grid, field, place.mounting)?;
            scene.skin = Skin::Nodes(motion);
        }
        let press = object_depth(&scene, &self.renderer.geometry(), &mut self.rasteriser);
        let image = self
            .renderer
            .render_with_skin(&press, &scene.skin, &self.look)?;
        Ok(Some(image))
    }
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use super::*;
    use crate::ClipLibrary;
    use gripcast_imaging::{CropProfile, crop_and_resize};
    use gripcast_tactile::SceneRenderer as _;
    use gripcast_tactile::{ObjectDepthRenderer, SensorName};
    use gripcast_testing::mean_difference;

    const SIZE: (u32, u32) = (640, 480);

    fn mini() -> SensorProfile {
        SensorProfile::gelsight_mini().unwrap()
    }

    fn clip(name: &str) -> Arc<Clip> {
        let library = ClipLibrary::built_in().unwrap();
        let found = library.clips().iter().find(|clip| clip.name == name);
        found.unwrap().clone()
    }

    fn scene_at(clip: &Arc<Clip>, progress: f64) -> SceneState {
        SceneState {
            grasp: 0,
            clip: clip.clone(),
            step: clip.step_at(progress),
        }
    }

    /// Crops the sensor image out of a frame as `collect` does.
    fn cropped(frame: Vec<u8>) -> RgbImage {
        let frame = RgbImage::from_raw(SIZE.0, SIZE.1, frame).unwrap();
        crop_and_resize(&frame, &CropProfile::GSMINI_SEVENTH, 320, 240).unwrap()
    }

    #[test]
    fn crop_of_the_frame_matches_the_rendered_image() {
        let clip = clip("mug");
        let profile = SensorProfile::gelsight_mini().unwrap();
        let mut reference = ObjectDepthRenderer::new(&profile).unwrap();
        for (side, finger) in [(Role::Left, Finger::Left), (Role::Right, Finger::Right)] {
            let mut renderer = GelRenderer::new(side, 1, SIZE, SIZE, &mini()).unwrap();
            renderer.look = FrameNoise::default();
            let shown = scene_at(&clip, 1.0);
            let cut = cropped(renderer.render_frame(&shown, 1).unwrap());
            let step = &clip.steps[shown.step];
            let t_world_gripper = clip.start.t_world_gripper();
            let place = SensorMount::on(finger);
            let mesh = clip.mesh().unwrap();
            let scene =
                TactileScene::from_step(mesh, &clip.gel, &t_world_gripper, step, place).unwrap();
            let expected = reference.render(&scene, None).unwrap();
            let bare = reference.render(&scene.untouched(), None).unwrap();
            assert!(mean_difference(&expected, &bare) > 1.0, "no contact");
            let off = mean_difference(&cut, &expected);
            assert!(
                off < 1.2,
                "{side}: {off} grey levels between frame and renderer"
            );
        }
    }

    #[test]
    fn frames_without_contact_differ_by_noise_only() {
        let clip = clip("ball");
        let mut renderer = GelRenderer::new(Role::Left, 1, SIZE, SIZE, &mini()).unwrap();
        let a = cropped(renderer.render_frame(&scene_at(&clip, 0.0), 1).unwrap());
        let b = cropped(renderer.render_frame(&scene_at(&clip, 0.2), 2).unwrap());
        assert!(a != b, "every frame must have its own noise");
        // Two of 0.84 grey levels, as calibrated; mean |N(0, σ√2)| is 0.8 σ√2.
        let mean = mean_difference(&a, &b);
        assert!((0.5..1.3).contains(&mean), "{mean}");
        let again = cropped(renderer.render_frame(&scene_at(&clip, 0.0), 1).unwrap());
        assert!(a == again);
    }

    #[test]
    fn contact_grows_during_closure_and_the_rim_is_dark() {
        let clip = clip("ball");
        let mut renderer = GelRenderer::new(Role::Right, 1, SIZE, SIZE, &mini()).unwrap();
        let mut at = |progress: f64| {
            renderer
                .render_frame(&scene_at(&clip, progress), 1)
                .unwrap()
        };
        let open = at(0.0);
        let corner: u32 = open[..30].iter().map(|v| u32::from(*v)).sum();
        let middle: u32 = open[3 * (240 * 640 + 320)..][..30]
            .iter()
            .map(|v| u32::from(*v))
            .sum();
        assert!(2 * corner < middle, "{corner} {middle}");
        let bare = cropped(open);
        let changes = [0.4, 0.6, 0.7, 0.8].map(|p| mean_difference(&cropped(at(p)), &bare));
        assert!(
            changes.windows(2).all(|pair| pair[0] < pair[1]),
            "{changes:?}"
        );
    }

    #[test]
    fn unusual_frame_sizes_are_filled() {
        let clip = clip("ball");
        for size in [(16, 16), (18, 400), (820, 616)] {
            let mut renderer = GelRenderer::new(Role::Left, 1, size, size, &mini()).unwrap();
            let image = renderer.render_frame(&scene_at(&clip, 1.0), 0).unwrap();
            assert_eq!(image.len(), 3 * (size.0 * size.1) as usize);
        }
    }

    #[test]
    fn gel_markers_move_with_the_lifted_object() {
        let clip = clip("mug");
        let profile = SensorName::by_name("gelsight-mini-markers")
            .unwrap()
            .profile()
            .unwrap();
        let mut renderer = GelRenderer::new(Role::Left, 1, SIZE, SIZE, &profile).unwrap();
        let bare = GelRenderer::new(Role::Left, 1, SIZE, SIZE, &mini()).unwrap();
        let open = cropped(renderer.render_frame(&scene_at(&clip, 0.0), 1).unwrap());
        let dark = |image: &RgbImage| image.pixels().filter(|p| p[1] < 60).count();
        // 63 dots of 12.6 pixels cover a tenth of the image.
        assert!((4000..12_000).contains(&dark(&open)), "{}", dark(&open));
        assert!(dark(&bare.untouched) < 500, "{}", dark(&bare.untouched));
        let step = clip.steps.last().unwrap();
        let mesh = clip.mesh().unwrap();
        let start = clip.start.t_world_gripper();
        let place = SensorMount::on(Finger::Left);
        let scene = TactileScene::from_step(mesh, &clip.gel, &start, step, place).unwrap();
        let field = ObjectDepthRenderer::new(&profile)
            .unwrap()
            .marker_field(&scene);
        let field = field.unwrap().unwrap();
        assert_eq!((field.columns, field.rows), (10, 7));
        let seen = field.markers.iter().flatten();
        let moved = seen
            .map(|m| m.displacement_px())
            .fold([0.0f32; 2], |sum, [x, y]| [sum[0] + x, sum[1] + y]);
        // The object's weight pulls the skin down, against the approach axis' up: along +x.
        assert!(moved[0] > 0.0 && moved[0] > moved[1].abs(), "{moved:?}");
    }
}
