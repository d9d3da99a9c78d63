//! Frames of the demo data's tactile sensors: GelSight Minis that are not the one the project was
//! calibrated on.

use image::{Rgb, RgbImage, imageops};

use crate::error::{Error, ErrorKind, Result};
use crate::geometry::TriangleMesh;
use crate::imaging::{CropWindow, encode_jpeg};
use crate::render::tactile::{
    BackgroundFit, ObjectDepthRenderer, SceneRenderer as _, SensorPlace, SensorProfile,
    ShadingModel, SimulatedGel, TactileScene,
};
use crate::sim::grasp::{Finger, Placed, Snapshot};

/// Size of the cameras' frames, px: a stream of the Mini.
pub(super) const FRAME: [u32; 2] = [640, 480];
/// JPEG quality of the frames.
const QUALITY: u8 = 92;

/// How a sensor differs from the shipped profile.
struct Differences {
    /// Factor on the light of the untouched gel in red, green, blue.
    light: [f64; 3],
    /// Factor on what a slope changes.
    response: [f64; 3],
    /// Factor on the camera's noise.
    noise: f64,
    /// Factor on the width of the smoothing.
    smoothing: f64,
}

/// Left and right.
const DIFFERENCES: [Differences; 2] = [
    Differences {
        light: [1.10, 0.93, 0.96],
        response: [0.85, 1.12, 0.95],
        noise: 1.6,
        smoothing: 1.2,
    },
    Differences {
        light: [0.92, 1.06, 1.03],
        response: [1.10, 0.88, 1.08],
        noise: 1.5,
        smoothing: 1.1,
    },
];

/// The sensor of a finger: the untouched gel is the shipped one's, mirrored left to right and of
/// another brightness for each colour; slopes change the light by another amount; noise and
/// smoothing are larger. By how much is a choice, not a measurement.
///
/// # Errors
/// None; a test makes them.
pub(super) fn sensor(finger: Finger) -> Result<SensorProfile> {
    let change = &DIFFERENCES[finger as usize];
    let mut profile = SensorProfile::gelsight_mini()?;
    profile.name = format!(
        "demo-{}",
        if finger == Finger::Left {
            "left"
        } else {
            "right"
        }
    );
    profile.provenance = format!(
        "Not a real sensor: the shipped gelsight-mini profile with its background mirrored and \
         scaled by {:?}, its shading scaled by {:?}, its noise by {} and its smoothing by {}.",
        change.light, change.response, change.noise, change.smoothing
    );
    profile.noise_std = profile.noise_std.map(|std| change.noise * std);
    profile.smoothing.sigma_m *= change.smoothing;
    if let ShadingModel::Polynomial(shading) = &mut profile.shading {
        let channels = [&mut shading.red, &mut shading.green, &mut shading.blue];
        for (channel, factor) in channels.into_iter().zip(change.response) {
            channel.iter_mut().for_each(|value| *value *= factor);
        }
    }
    if let Some(picture) = &mut profile.background.picture {
        imageops::flip_horizontal_in_place(picture);
        for pixel in picture.pixels_mut() {
            let scaled = |c: usize| (f64::from(pixel[c]) * change.light[c]).round().min(255.0);
            *pixel = Rgb([scaled(0) as u8, scaled(1) as u8, scaled(2) as u8]);
        }
        profile.background.fit = BackgroundFit::of_picture(picture, profile.background.fit.degree);
    }
    profile.validate()?;
    Ok(profile)
}

/// The cameras of both sensors.
pub(super) struct Sensors {
    profiles: [SensorProfile; 2],
}

/// What both sensors meet in a grasp.
pub(super) struct Contact<'a> {
    /// The object in its own frame, m.
    pub(super) mesh: &'a TriangleMesh,
    /// The gels that were simulated.
    pub(super) gel: &'a SimulatedGel,
    /// The object and the gripper before the fingers close.
    pub(super) t_world_object: crate::geometry::Pose,
    /// See `t_world_object`.
    pub(super) placed: &'a Placed,
    /// Before the lift.
    pub(super) grasped: &'a Snapshot,
}

impl Sensors {
    pub(super) fn new() -> Result<Self> {
        Ok(Self {
            profiles: [sensor(Finger::Left)?, sensor(Finger::Right)?],
        })
    }

    /// The profile of a finger's sensor.
    pub(super) fn profile(&self, finger: Finger) -> &SensorProfile {
        &self.profiles[finger as usize]
    }

    /// JPEGs of a finger's camera before closing and before the lift; the seeds draw their noise.
    ///
    /// # Errors
    /// `Input` where the snapshot is not of the gel.
    pub(super) fn frames(
        &self,
        contact: &Contact<'_>,
        finger: Finger,
        seeds: [u64; 2],
    ) -> Result<[Vec<u8>; 2]> {
        let profile = self.profile(finger);
        let mut renderer = ObjectDepthRenderer::new(profile)?;
        let place = SensorPlace::on(finger);
        let poses = [&contact.t_world_object, &contact.placed.t_world_gripper];
        let opening = contact.placed.opening_m;
        let before = TactileScene::at_start(contact.mesh, contact.gel, poses, opening, place)?;
        let after = TactileScene::of_snapshot(contact.mesh, contact.gel, contact.grasped, place)?;
        let mut frame = |scene: &TactileScene<'_>, seed| -> Result<Vec<u8>> {
            let picture = renderer.render(scene, Some(seed))?;
            encode_jpeg(&whole_frame(&picture, profile)?, QUALITY)
        };
        Ok([frame(&before, seeds[0])?, frame(&after, seeds[1])?])
    }
}

/// The camera's frame of which the profile's crop is the picture; around it the housing is dark.
fn whole_frame(picture: &RgbImage, profile: &SensorProfile) -> Result<RgbImage> {
    let [width, height] = FRAME;
    let window = profile
        .crop_profile
        .window(width, height)
        .ok_or_else(|| Error::new(ErrorKind::Internal, "the crop leaves nothing of the frame"))?;
    let CropWindow { left, top, .. } = window;
    let columns = places(width, left, window.width, picture.width());
    let rows = places(height, top, window.height, picture.height());
    Ok(RgbImage::from_fn(width, height, |x, y| {
        let (column, row) = (&columns[x as usize], &rows[y as usize]);
        let dark = 1.0 / (1.0 + 40.0 * (column.outside.powi(2) + row.outside.powi(2)));
        let at = |x: u32, y: u32, c: usize| f32::from(picture.get_pixel(x, y)[c]);
        let level = |c: usize| {
            let mix = |y: u32| {
                let (a, b) = (at(column.before, y, c), at(column.before + 1, y, c));
                a + column.share * (b - a)
            };
            let (above, below) = (mix(row.before), mix(row.before + 1));
            (dark * (above + row.share * (below - above)) + 0.5) as u8
        };
        Rgb([level(0), level(1), level(2)])
    }))
}

/// Where a line of the frame lies in the picture.
struct Line {
    /// The picture's line before it.
    before: u32,
    /// Share of the line after that.
    share: f32,
    /// Distance outside of the crop, in parts of its size.
    outside: f32,
}

/// Places of `count` lines, of which `window` from `first` on show a picture of `size` lines.
fn places(count: u32, first: u32, window: u32, size: u32) -> Vec<Line> {
    (0..count)
        .map(|line| {
            let share = (f64::from(line) + 0.5 - f64::from(first)) / f64::from(window);
            let pixel = (share * f64::from(size) - 0.5).clamp(0.0, f64::from(size) - 1.0);
            let before = (pixel as u32).min(size.saturating_sub(2));
            Line {
                before,
                share: (pixel - f64::from(before)) as f32,
                outside: (-share).max(share - 1.0).max(0.0) as f32,
            }
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::imaging::{CropProfile, crop_and_resize};

    fn mean_difference(a: &RgbImage, b: &RgbImage) -> f64 {
        let sum: u64 = a
            .iter()
            .zip(b.iter())
            .map(|(a, b)| u64::from(a.abs_diff(*b)))
            .sum();
        sum as f64 / a.len() as f64
    }

    #[test]
    fn sensors_differ_from_the_shipped_one_and_from_each_other() {
        let shipped = SensorProfile::gelsight_mini().unwrap();
        let [left, right] = Finger::BOTH.map(|finger| sensor(finger).unwrap());
        let picture = |p: &SensorProfile| p.background.picture.clone().unwrap();
        assert!(mean_difference(&picture(&left), &picture(&shipped)) > 5.0);
        assert!(mean_difference(&picture(&left), &picture(&right)) > 5.0);
        assert_ne!(left.shading, shipped.shading);
        assert!(left.noise_std[0] > 1.4 * shipped.noise_std[0]);
        assert!(left.provenance.starts_with("Not a real sensor"));
    }

    #[test]
    fn the_usual_crop_gives_the_picture_back() {
        let profile = sensor(Finger::Left).unwrap();
        let picture = profile.background.picture.clone().unwrap();
        let frame = whole_frame(&picture, &profile).unwrap();
        let cut = crop_and_resize(&frame, &CropProfile::GSMINI_SEVENTH, 320, 240).unwrap();
        let off = mean_difference(&cut, &picture);
        assert!(off < 1.0, "{off}");
        let corner: u32 = frame.get_pixel(0, 0).0.iter().map(|v| u32::from(*v)).sum();
        let middle: u32 = frame
            .get_pixel(320, 240)
            .0
            .iter()
            .map(|v| u32::from(*v))
            .sum();
        assert!(2 * corner < middle);
    }
}
