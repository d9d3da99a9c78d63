//! How exact poses are and how long they take, on synthetic pictures with known truth.

use std::time::Duration;

use glam::DVec2;
use serde::Serialize;

use super::detect::detectors;
use super::refine::refine_all;
use super::solve::{RelativePose, relative, solve_gripper, solve_part};
use super::synthetic::{
    GraspScene, PictureConditions, SyntheticPicture, gripper_markers, ring_board, test_camera,
};
use super::{Detection, Dictionary, MarkerDetector, Part};
use gripcast_base::error::Result;
use gripcast_imaging::Intrinsics;

/// All of its 587 markers are searched for, so that wrong ones can appear.
const DICTIONARY: &str = "36h11";

/// What is measured.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct PoseBench {
    /// Pictures, each of another scene.
    pub pictures: u64,
    /// Seed of scenes and noise.
    pub seed: u64,
    /// Width of the pictures, px; the height is 9/16 of it.
    pub width: u32,
    /// Path of the picture during the exposure, px, in a direction of its own for each picture.
    pub motion_px: f64,
    /// Standard deviation of the lens's blur, px.
    pub psf_px: f64,
    /// Standard deviation of the noise, grey levels.
    pub noise: f64,
}

impl Default for PoseBench {
    fn default() -> Self {
        Self {
            pictures: 40,
            seed: 1,
            width: 1280,
            motion_px: 0.0,
            psf_px: 0.7,
            noise: 3.0,
        }
    }
}

/// What came out; errors are those of the gripper's pose in the object's frame.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct PoseFigures {
    /// Median distance from the true place, mm.
    pub median_mm: f64,
    /// Median angle from the true direction, degrees.
    pub median_deg: f64,
    /// The same at 95 %.
    pub p95_mm: f64,
    /// The same at 95 %.
    pub p95_deg: f64,
    /// Median error of a corner, px.
    pub corner_px: f64,
    /// The same at 95 %.
    pub corner_p95_px: f64,
    /// Largest component of the mean error of all corners, px.
    pub corner_bias_px: f64,
    /// Part of the completely visible markers that was found.
    pub detected: f64,
    /// Part of the pictures that gave a pose that is not ambiguous.
    pub solved: f64,
    /// Detections that are not where a marker of that number is.
    pub false_ids: u64,
    /// Mean squared error of the pose by its covariance, over 6: 1 for an honest one.
    pub normalised_error: f64,
    /// Median time for one picture from grey levels to the pose, ms.
    pub ms: f64,
    /// The part of it that the detector takes, ms.
    pub detect_ms: f64,
}

/// Runs `bench` with every detector that is compiled in, on the same pictures; the default one
/// comes first. `clock` gives the time that the calling thread has used so far; `progress` is
/// called after each picture.
///
/// # Errors
/// Those of the detectors.
pub fn measure_pose(
    bench: &PoseBench,
    clock: impl Fn() -> Duration,
    mut progress: impl FnMut(),
) -> Result<Vec<(&'static str, PoseFigures)>> {
    let dictionary = Dictionary::by_name(DICTIONARY)?;
    let board = ring_board(&dictionary);
    let gripper = gripper_markers(&dictionary, [Part::Body; 2]);
    let camera = test_camera(bench.width, bench.width * 9 / 16);
    let ids: Vec<u32> = (0..dictionary.len() as u32).collect();
    let mut runs: Vec<(Box<dyn MarkerDetector>, Tally)> = detectors(&dictionary, &ids)?
        .into_iter()
        .map(|detector| (detector, Tally::default()))
        .collect();
    for index in 0..bench.pictures {
        let scene = GraspScene::random(&board, &gripper, &dictionary, bench.seed, index);
        let seen = scene.render(&camera, &conditions(bench, index), bench.seed ^ index);
        for (detector, tally) in &mut runs {
            let start = clock();
            let found = detector.detect(&seen.picture)?;
            let searched = clock();
            let found = refine_all(&seen.picture, &found);
            let pose = pose_of(&scene, &found, &camera);
            tally.ms.push(milliseconds(clock(), start));
            tally.detect_ms.push(milliseconds(searched, start));
            tally.add_corners(&seen, &found);
            if let Some(pose) = pose {
                tally.add_pose(&scene, &pose);
            }
        }
        progress();
    }
    let figures = |(detector, tally): (Box<dyn MarkerDetector>, Tally)| {
        (detector.name(), tally.figures(bench.pictures))
    };
    Ok(runs.into_iter().map(figures).collect())
}

fn milliseconds(end: Duration, start: Duration) -> f64 {
    1e3 * end.saturating_sub(start).as_secs_f64()
}

fn conditions(bench: &PoseBench, index: u64) -> PictureConditions {
    // Golden-ratio steps spread directions evenly.
    let direction = 2.399_963 * index as f64;
    PictureConditions {
        motion_px: DVec2::from_angle(direction) * bench.motion_px,
        psf_px: bench.psf_px,
        noise: bench.noise,
        ..PictureConditions::default()
    }
}

fn pose_of(scene: &GraspScene, found: &[Detection], camera: &Intrinsics) -> Option<RelativePose> {
    let object = solve_part(&scene.board, Part::Object, found, camera).ok()?;
    let gripper = solve_gripper(&scene.gripper, found, camera, None).ok()?;
    (!object.ambiguous && !gripper.body.ambiguous).then(|| relative(&object, &gripper.body))
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

/// A detection farther from the truth than this is of something else, px.
const ELSEWHERE_PX: f64 = 10.0;

impl Tally {
    fn add_corners(&mut self, seen: &SyntheticPicture, found: &[Detection]) {
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
        self.normalised.extend(pose.normalised_square(&error));
    }

    fn figures(mut self, pictures: u64) -> PoseFigures {
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
            solved: self.mm.len() as f64 / pictures.max(1) as f64,
            false_ids: self.false_ids,
            normalised_error: mean / 6.0,
            ms: quantile(&mut self.ms, 0.5),
            detect_ms: quantile(&mut self.detect_ms, 0.5),
        }
    }
}

/// NaN without values.
fn quantile(values: &mut [f64], part: f64) -> f64 {
    values.sort_by(f64::total_cmp);
    let at = (values.len().saturating_sub(1) as f64 * part).round() as usize;
    values.get(at).copied().unwrap_or(f64::NAN)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_few_pictures_reach_the_numbers() {
        let bench = PoseBench {
            pictures: 4,
            ..PoseBench::default()
        };
        let ticks = std::cell::Cell::new(0);
        let clock = || {
            ticks.set(ticks.get() + 1);
            Duration::from_millis(10 * ticks.get())
        };
        let mut done = 0;
        let all = measure_pose(&bench, clock, || done += 1).unwrap();
        let (name, figures) = &all[0];
        assert_eq!(*name, "apriltag");
        assert_eq!(done, 4);
        assert_eq!((figures.false_ids, figures.solved), (0, 1.0));
        assert!(figures.detected > 0.98, "{figures:?}");
        // Of four pictures the median is rougher than the goal for many.
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
        assert_eq!((figures.ms, figures.detect_ms), (20.0, 10.0));
    }

    #[test]
    fn quantiles_are_those_of_the_sorted_values() {
        let mut values = [3.0, 1.0, 2.0, 5.0, 4.0];
        assert_eq!(quantile(&mut values, 0.5), 3.0);
        assert_eq!(quantile(&mut values, 0.95), 5.0);
        assert!(quantile(&mut [], 0.5).is_nan());
    }
}
