//! Accuracy and time of pose estimation on synthetic images with ground truth.

use glam::DVec2;
use gripcast_base::error::Result;
use gripcast_base::workers::thread_cpu_s;
use gripcast_imaging::Intrinsics;
use gripcast_pose::detect::{FullSearch, detectors};
use gripcast_pose::refine::refine_all;
use gripcast_pose::solve::{RelativePose, relative_pose, solve_body_pose, solve_gripper};
use gripcast_pose::synthetic::{
    GraspScene, ImageConditions, SyntheticImage, gripper_markers, ring_board, test_camera,
};
use gripcast_pose::{Body, Detection, Dictionary, MarkerDetector};
use serde::Serialize;

/// All of its 587 markers are searched for, to allow false detections.
const DICTIONARY: &str = "36h11";

/// Settings of the benchmark.
#[derive(Clone, Copy)]
pub(crate) struct PoseScenes {
    /// Number of images, each of a random scene.
    pub(crate) images: u64,
    /// Random seed of scenes and noise.
    pub(crate) seed: u64,
    /// Width of the images, px; the height is 9/16 of it.
    pub(crate) width: u32,
    /// Motion blur, px, in a random direction per image.
    pub(crate) motion_px: f64,
    /// Standard deviation of the lens blur, px.
    pub(crate) psf_px: f64,
    /// Standard deviation of the noise, grey levels.
    pub(crate) noise: f64,
}

/// Figures; errors are those of the gripper pose in the object's frame.
#[derive(Debug, Serialize)]
pub(crate) struct PoseFigures {
    /// Median position error, mm.
    pub(crate) median_mm: f64,
    /// Median rotation error, degrees.
    pub(crate) median_deg: f64,
    /// 95th percentile of the position error, mm.
    pub(crate) p95_mm: f64,
    /// 95th percentile of the rotation error, degrees.
    pub(crate) p95_deg: f64,
    /// Median corner error, px.
    pub(crate) corner_px: f64,
    /// 95th percentile of the corner error, px.
    pub(crate) corner_p95_px: f64,
    /// Largest component of the mean error of all corners, px.
    pub(crate) corner_bias_px: f64,
    /// Detected fraction of the completely visible markers.
    pub(crate) detected: f64,
    /// Fraction of the images with an unambiguous pose.
    pub(crate) solved: f64,
    /// False detections.
    pub(crate) false_ids: u64,
    /// Mean squared Mahalanobis error of the pose over 6: 1 for a consistent covariance.
    pub(crate) normalised_error: f64,
    /// Median time from grey image to pose, ms.
    pub(crate) ms: f64,
    /// Median time of the detection, ms.
    pub(crate) detect_ms: f64,
}

impl PoseScenes {
    /// Runs all compiled-in detectors on the same images, the default detector first. `progress`
    /// gets the number of finished images.
    pub(crate) fn measure(
        &self,
        progress: impl Fn(u64),
    ) -> Result<Vec<(&'static str, PoseFigures)>> {
        let dictionary = Dictionary::by_name(DICTIONARY)?;
        let board = ring_board(&dictionary);
        let gripper = gripper_markers(&dictionary, [Body::Gripper; 2]);
        let camera = test_camera(self.width, self.width * 9 / 16);
        let ids: Vec<u32> = (0..dictionary.len() as u32).collect();
        let mut runs: Vec<(Box<dyn MarkerDetector>, Tally)> =
            detectors(&dictionary, &ids, FullSearch::Never)?
                .into_iter()
                .map(|detector| (detector, Tally::default()))
                .collect();
        for index in 0..self.images {
            let scene = GraspScene::random(&board, &gripper, &dictionary, self.seed, index);
            let seen = scene.render(&camera, &self.conditions(index), self.seed ^ index);
            for (detector, tally) in &mut runs {
                let started = thread_cpu_s();
                let found = detector.detect(&seen.image)?;
                let detected = thread_cpu_s();
                let found = refine_all(&seen.image, &found);
                let pose = pose_of(&scene, &found, &camera);
                tally.ms.push(1e3 * (thread_cpu_s() - started));
                tally.detect_ms.push(1e3 * (detected - started));
                tally.add_corners(&seen, &found);
                if let Some(pose) = pose {
                    tally.add_pose(&scene, &pose);
                }
            }
            progress(index + 1);
        }
        let figures = |(detector, tally): (Box<dyn MarkerDetector>, Tally)| {
            (detector.name(), tally.figures(self.images))
        };
        Ok(runs.into_iter().map(figures).collect())
    }

    fn conditions(&self, index: u64) -> ImageConditions {
        // Golden-ratio steps spread directions evenly.
        let direction = 2.399_963 * index as f64;
        ImageConditions {
            motion_px: DVec2::from_angle(direction) * self.motion_px,
            psf_px: self.psf_px,
            noise: self.noise,
            ..ImageConditions::default()
        }
    }
}

fn pose_of(scene: &GraspScene, found: &[Detection], camera: &Intrinsics) -> Option<RelativePose> {
    let object = solve_body_pose(&scene.board, Body::Object, found, camera).ok()?;
    let gripper = solve_gripper(&scene.gripper, found, camera, None).ok()?;
    (!object.ambiguous && !gripper.body.ambiguous).then(|| relative_pose(&object, &gripper.body))
}

#[derive(Default)]
struct Tally {
    mm: Vec<f64>,
    deg: Vec<f64>,
    normalised: Vec<f64>,
    corners: Vec<DVec2>,
    visible: u64,
    found: u64,
    false_ids: u64,
    ms: Vec<f64>,
    detect_ms: Vec<f64>,
}

/// Maximum corner error of a true detection, px.
const ELSEWHERE_PX: f64 = 10.0;

impl Tally {
    fn add_corners(&mut self, seen: &SyntheticImage, found: &[Detection]) {
        self.visible += seen.truth.len() as u64;
        for detection in found {
            let errors = |truth: &Detection| {
                let pairs = detection.corners_px.iter().zip(truth.corners_px);
                pairs.map(|(a, b)| *a - b).collect::<Vec<DVec2>>()
            };
            let of_id = |list: &[Detection]| {
                let truth = list.iter().find(|t| t.id == detection.id);
                truth
                    .map(errors)
                    .filter(|e| e.iter().all(|e| e.length() < ELSEWHERE_PX))
            };
            match of_id(&seen.truth) {
                Some(errors) => {
                    self.found += 1;
                    self.corners.extend(errors);
                }
                None if of_id(&seen.covered).is_none() => self.false_ids += 1,
                None => {}
            }
        }
    }

    fn add_pose(&mut self, scene: &GraspScene, pose: &RelativePose) {
        let truth = scene.t_object_gripper();
        let difference = truth * pose.t_object_gripper.inverse();
        let turn = difference.rotation.to_scaled_axis();
        let shift = truth.translation_m - pose.t_object_gripper.translation_m;
        self.mm.push(1e3 * shift.length());
        self.deg.push(turn.length().to_degrees());
        let error = [shift.x, shift.y, shift.z, turn.x, turn.y, turn.z];
        self.normalised.extend(pose.squared_mahalanobis(&error));
    }

    fn figures(mut self, images: u64) -> PoseFigures {
        let mut lengths: Vec<f64> = self.corners.iter().map(|e| e.length()).collect();
        let count = self.corners.len().max(1) as f64;
        let bias = self.corners.iter().sum::<DVec2>() / count;
        let mean = self.normalised.iter().sum::<f64>() / self.normalised.len().max(1) as f64;
        PoseFigures {
            median_mm: quantile(&mut self.mm, 0.5),
            median_deg: quantile(&mut self.deg, 0.5),
            p95_mm: quantile(&mut self.mm, 0.95),
            p95_deg: quantile(&mut self.deg, 0.95),
            corner_px: quantile(&mut lengths, 0.5),
            corner_p95_px: quantile(&mut lengths, 0.95),
            corner_bias_px: bias.abs().max_element(),
            detected: self.found as f64 / self.visible.max(1) as f64,
            solved: self.mm.len() as f64 / images.max(1) as f64,
            false_ids: self.false_ids,
            normalised_error: mean / 6.0,
            ms: quantile(&mut self.ms, 0.5),
            detect_ms: quantile(&mut self.detect_ms, 0.5),
        }
    }
}

/// Returns a quantile; NaN without values.
fn quantile(values: &mut [f64], q: f64) -> f64 {
    values.sort_by(f64::total_cmp);
    let index = (values.len().saturating_sub(1) as f64 * q).round() as usize;
    values.get(index).copied().unwrap_or(f64::NAN)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn few_images_reach_expected_accuracy() {
        let scenes = PoseScenes {
            images: 4,
            seed: 1,
            width: 1280,
            motion_px: 0.0,
            psf_px: 0.7,
            noise: 3.0,
        };
        let done = std::cell::Cell::new(0);
        let all = scenes.measure(|images| done.set(images)).unwrap();
        let (name, figures) = &all[0];
        assert_eq!(*name, "apriltag");
        assert_eq!(done.get(), 4);
        assert_eq!((figures.false_ids, figures.solved), (0, 1.0));
        assert!(figures.detected > 0.98, "{figures:?}");
        // The median of four images is less accurate than the goal.
        assert!(
            figures.median_mm < 0.1 && figures.median_deg < 0.12,
            "{figures:?}"
        );
        assert!(
            figures.corner_px < 0.05 && figures.corner_bias_px < 0.01,
            "{figures:?}"
        );
        assert!(
            (0.2..2.0).contains(&figures.normalised_error),
            "{figures:?}"
        );
        assert!(
            0.0 < figures.detect_ms && figures.detect_ms < figures.ms,
            "{figures:?}"
        );
    }

    #[test]
    fn quantile_sorts_values() {
        let mut values = [3.0, 1.0, 2.0, 5.0, 4.0];
        assert_eq!(quantile(&mut values, 0.5), 3.0);
        assert_eq!(quantile(&mut values, 0.95), 5.0);
        assert!(quantile(&mut [], 0.5).is_nan());
    }
}
