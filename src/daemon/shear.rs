//! Shear of the rig's gels: a tracker per gel, started from the initial frame.

use std::collections::BTreeMap;
use std::sync::Arc;

use image::{Rgb, RgbImage};

use super::status::ShearStatus;
use gripcast_imaging::{Role, draw_arrow, draw_line};
use gripcast_shear::{
    ExpectedMarkers, FingerForce, MarkerField, MarkerPattern, ShearFrame, ShearTracker,
};
use gripcast_tactile::force::ForceEstimator;

/// Length of a drawn arrow over the displacement.
const ARROW_GAIN: f64 = 3.0;
/// Minimum displacement that is drawn as an arrow, px.
const MIN_ARROW_PX: f64 = 0.3;
const ARROW: Rgb<u8> = Rgb([255, 230, 0]);
const LOST: Rgb<u8> = Rgb([255, 0, 60]);

/// Scale of a gel's images, and the gel markers that its sensor profile names.
#[derive(Clone, Debug, PartialEq)]
pub struct GelScale {
    /// Scale of the cropped 320×240 image, m/px.
    pub m_per_px: f64,
    /// Gel markers of the sensor profile that the rig file names, `Some(None)` for a gel without;
    /// `None` where it names no profile, so that the image decides.
    pub markers: Option<Option<MarkerPattern>>,
}

/// Force estimators by gel; a gel of an unknown sensor has none.
pub type GelForces = BTreeMap<Role, Arc<ForceEstimator>>;

/// Measures the shear of all gels.
#[derive(Debug, Default)]
pub(super) struct GelTrackers {
    scales: BTreeMap<Role, GelScale>,
    forces: GelForces,
    trackers: BTreeMap<Role, ShearTracker>,
    /// Why a gel has no tracker.
    unavailable: BTreeMap<Role, String>,
}

impl GelTrackers {
    /// Gels without a scale are not tracked.
    pub(super) fn new(scales: BTreeMap<Role, GelScale>, forces: GelForces) -> Self {
        Self {
            scales,
            forces,
            ..Self::default()
        }
    }

    /// Starts again from the images of the untouched gels.
    pub(super) fn set_initial<'a>(
        &mut self,
        images: impl IntoIterator<Item = (Role, &'a RgbImage)>,
    ) {
        self.trackers.clear();
        self.unavailable.clear();
        for (role, image) in images {
            let Some(GelScale { m_per_px, markers }) = self.scales.get(&role) else {
                let reason = "scale unknown: name `sensor_profile` in the rig file";
                self.unavailable.insert(role, reason.into());
                continue;
            };
            let expected = match markers {
                None => ExpectedMarkers::Unknown,
                Some(None) => ExpectedMarkers::None,
                Some(Some(pattern)) => ExpectedMarkers::Pattern(pattern),
            };
            match ShearTracker::new(image, *m_per_px, expected) {
                Ok(tracker) => drop(self.trackers.insert(role, tracker)),
                Err(error) => drop(self.unavailable.insert(role, error.what().to_owned())),
            }
        }
    }

    /// Measures the newest image of a gel; `None` without an initial frame.
    pub(super) fn update(&mut self, role: Role, image: &RgbImage) -> Option<ShearFrame> {
        Some(self.trackers.get_mut(&role)?.update(image))
    }

    /// Measures an image of about now without becoming the newest.
    pub(super) fn measure(&self, role: Role, image: &RgbImage) -> Option<ShearFrame> {
        Some(self.trackers.get(&role)?.clone().update(image))
    }

    /// Force on a gel in an image, whose shear was measured; `None` without an estimator, and where
    /// the image does not fit.
    pub(super) fn force(
        &self,
        role: Role,
        initial: &RgbImage,
        image: &RgbImage,
        shear: &ShearFrame,
    ) -> Option<FingerForce> {
        self.forces.get(&role)?.estimate(initial, image, shear).ok()
    }

    /// Status of a gel without shear: why.
    pub(super) fn unavailable(&self) -> impl Iterator<Item = (Role, ShearStatus)> + '_ {
        let status = |reason: &String| ShearStatus {
            summary: None,
            messages: vec![reason.clone()],
        };
        self.unavailable
            .iter()
            .map(move |(role, reason)| (*role, status(reason)))
    }
}

/// Draws an arrow for each gel marker that moved, three times as long as its displacement, and a
/// dot for each lost one.
pub(super) fn draw_markers(image: &mut RgbImage, field: &MarkerField) {
    for marker in field.markers.iter().flatten() {
        let from = marker.rest_px.map(f64::from);
        if marker.confidence <= 0.0 {
            draw_line(image, from, from, 3.0, LOST);
            continue;
        }
        let moved = marker.displacement_px().map(f64::from);
        if moved[0].hypot(moved[1]) < MIN_ARROW_PX {
            continue;
        }
        let to = [0, 1].map(|i| from[i] + ARROW_GAIN * moved[i]);
        draw_arrow(image, from, to, 1.0, ARROW);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use gripcast_imaging::synthetic_gel;
    use gripcast_shear::GelMarker;
    use gripcast_tactile::{FrameNoise, PressDepth, SensorProfile, TactileRenderer};

    fn field(displacement: [f32; 2], confidence: f32) -> MarkerField {
        let rest_px = [20.0, 20.0];
        let position_px = [rest_px[0] + displacement[0], rest_px[1] + displacement[1]];
        let marker = GelMarker {
            rest_px,
            position_px,
            confidence,
        };
        MarkerField {
            columns: 1,
            rows: 1,
            m_per_px: 3e-5,
            markers: vec![Some(marker)],
        }
    }

    #[test]
    fn arrows_are_three_times_the_displacement_and_lost_markers_dots() {
        let mut image = RgbImage::new(60, 40);
        draw_markers(&mut image, &field([8.0, 0.0], 1.0));
        assert_eq!(image.get_pixel(43, 20), &ARROW);
        assert_eq!(image.get_pixel(46, 20).0, [0; 3]);
        let mut image = RgbImage::new(60, 40);
        draw_markers(&mut image, &field([8.0, 0.0], 0.0));
        assert_eq!(image.get_pixel(20, 20), &LOST);
        assert_eq!(image.get_pixel(43, 20).0, [0; 3]);
        let mut image = RgbImage::new(60, 40);
        draw_markers(&mut image, &field([0.1, 0.0], 1.0));
        assert!(image.pixels().all(|pixel| pixel.0 == [0; 3]));
    }

    #[test]
    fn gels_without_scale_say_so() {
        let gel = synthetic_gel(320, 240, 1, 0.0);
        let scale = GelScale {
            m_per_px: 5.9e-5,
            markers: None,
        };
        let mut trackers = GelTrackers::new([(Role::Left, scale)].into(), GelForces::new());
        assert_eq!(trackers.update(Role::Left, &gel), None);
        trackers.set_initial([(Role::Left, &gel), (Role::Right, &gel)]);
        assert!(trackers.update(Role::Left, &gel).is_some());
        assert_eq!(trackers.update(Role::Right, &gel), None);
        let reasons: Vec<_> = trackers.unavailable().collect();
        assert_eq!(reasons.len(), 1);
        assert_eq!(reasons[0].0, Role::Right);
        assert!(reasons[0].1.messages[0].contains("sensor_profile"));
    }

    #[test]
    fn gel_of_an_untouched_finger_stays_at_rest() {
        let profile = SensorProfile::named_or_load("gelsight-mini-markers").unwrap();
        let mut renderer = TactileRenderer::new(&profile).unwrap();
        let geometry = renderer.geometry();
        let mut gel = |depth_m: f64, shift_m: f64, seed: u64| {
            let mut press = PressDepth::untouched(geometry);
            for row in 0..geometry.height {
                for column in 0..geometry.width {
                    let [x, y] = geometry.pixel_to_gel_m(column as f64, row as f64);
                    let depth = depth_m - (x * x + y * y) / 0.02;
                    press.depth_m[row * geometry.width + column] = depth.max(0.0) as f32;
                }
            }
            let noise = FrameNoise {
                noise_seed: Some(seed),
                ..FrameNoise::default()
            };
            renderer
                .render_with_markers(&press, &noise, &|_| [shift_m, 0.0])
                .unwrap()
                .0
        };
        let scale = GelScale {
            m_per_px: geometry.pixel_m,
            markers: Some(profile.markers.clone()),
        };
        let scales = [Role::Left, Role::Right].map(|role| (role, scale.clone()));
        let mut trackers = GelTrackers::new(scales.into(), GelForces::new());
        let initial = [gel(0.0, 0.0, 1), gel(0.0, 0.0, 2)];
        trackers.set_initial([(Role::Left, &initial[0]), (Role::Right, &initial[1])]);
        let mut shear = |role: Role, image: &RgbImage| {
            let frame = trackers.update(role, image).unwrap();
            assert_eq!(frame.problems, []);
            frame.summary.unwrap()
        };
        let touched = shear(Role::Left, &gel(1e-3, 2e-4, 3));
        assert!((touched.mean_displacement_mm[0] - 0.2).abs() < 0.01);
        assert!(touched.contact_fraction > 0.05 && touched.slip_ratio.is_some());
        let untouched = shear(Role::Right, &gel(0.0, 0.0, 4));
        assert!(untouched.max_displacement_mm < 0.03);
        assert_eq!(
            (untouched.contact_fraction, untouched.slip_ratio),
            (0.0, None)
        );
    }
}
