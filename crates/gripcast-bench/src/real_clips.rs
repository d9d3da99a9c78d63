//! `gripcast-bench real-clips`: recorded grasps of two GelSight Minis with gel markers.
//!
//! The data are a folder with `grasps.json` (`id`, `object`, `outcome`, `clip`) and two videos a
//! grasp, `grasps/ID/camera_0.avi` and `camera_2.avi`. Measured on the clips that begin with the
//! gripper open:
//!
//! * contact: whether the frame in which both fingers touch is found, and whether it lies within
//!   `--contact-frames`; on clips that begin in contact, whether that is noticed
//! * predictions: how often the built-in models call a pair of grasp frames uncertain, and pairs
//!   without contact stable
//! * tracking: share of the finger clips whose gel markers are tracked, and the drift after release
//! * alarms: whether a falling contact level, or slip, tells a loss ahead
//!
//! Only frames up to a fixed number after the contact are used, never the length of a clip.

use std::path::{Path, PathBuf};

use gripcast::cli::Context;
use gripcast::cli::bench::Report;
use gripcast::cli::working::{Progress, interruptible};
use gripcast_base::error::{Error, ErrorKind, Result};
use gripcast_base::files::{FileKind, read_regular};
use gripcast_base::statistics::{median, quantile, wilson_interval};
use gripcast_imaging::{CropProfile, GelCells, GelChange, TactileDifference, crop_and_resize};
use gripcast_interop::import::video::{OnsetSettings, PairOnset, find_onset};
use gripcast_interop::video::Video;
use gripcast_nn::predict::contract::InputName;
use gripcast_nn::predict::{BASELINE, InputImages, Model, PredictedLabel, SHIPPED, contact_doubt};
use gripcast_shear::{ExpectedMarkers, ShearProblem, ShearTracker, USUAL_M_PER_PX};
use image::RgbImage;
use serde::{Deserialize, Serialize};
use serde_json::{Value, json};

use crate::real_alarm::{ScoredClip, alarm_figures};

/// Files of the left and the right finger.
const CAMERAS: [&str; 2] = ["camera_0.avi", "camera_2.avi"];
/// Frames from the contact of both fingers to the grasp frame.
const SETTLE: usize = 3;
/// Frames after the contact that are used.
const AFTER_CONTACT: usize = 166;
/// Frames after the contact in which gel markers are tracked.
const TRACKED_FRAMES: usize = 120;
/// First frame after the contact that belongs to the shakes rather than the lift.
const SHAKES: usize = 45;
/// Frames that the contact level is compared with.
const BEFORE: usize = 20;
/// Fraction of the usual contact level below which a finger has lost contact.
const LOST_FRACTION: f32 = 0.15;
/// Frames in a row below it.
const LOST_FRAMES: usize = 5;

/// Arguments.
#[derive(Clone, Debug, clap::Args)]
pub(crate) struct Args {
    /// Folder with grasps.json and the videos
    #[arg(long, value_name = "DIR")]
    data: PathBuf,
    /// First and last frame in which both fingers touch, as the source states it
    #[arg(long, value_name = "N", num_args = 2, default_values_t = [13, 38])]
    contact_frames: Vec<usize>,
    /// Only the first clips
    #[arg(long, value_name = "N")]
    first: Option<usize>,
    /// Print the result as JSON
    #[arg(long)]
    json: bool,
}

#[derive(Clone, Debug, Deserialize)]
struct Listed {
    id: String,
    object: String,
    outcome: String,
    #[serde(default)]
    label_conflict: bool,
    clip: String,
}

/// What a clip that begins open gives.
struct Measured {
    onset: PairOnset,
    /// Clip for the alarms, by the contact level and by slip; none for a contradicted label.
    scored: Option<[ScoredClip; 2]>,
    /// OOD score of the built-in classifier, and whether the images themselves cannot tell.
    ood_score: Option<f64>,
    is_doubtful: bool,
    baseline: PredictedLabel,
    /// Label of the heuristic for two frames without contact.
    open: PredictedLabel,
    fingers: [Finger; 2],
}

/// Tracking of one finger.
struct Finger {
    /// Smallest fraction of the gel markers tracked in a frame.
    tracked: f64,
    /// Median displacement once the gel is free again, px.
    drift_px: Option<f32>,
}

#[derive(Debug, Serialize)]
struct Contact {
    clips: usize,
    found: usize,
    in_stated_range: usize,
    first: Option<usize>,
    last: Option<usize>,
    not_found: Vec<String>,
    begin_in_contact: usize,
    begin_in_contact_noticed: usize,
}

/// Runs the benchmark.
pub(crate) fn run(context: &Context, args: &Args) -> Result<()> {
    let cloned = args.clone();
    let report = interruptible(context, "measuring", move |progress| {
        measured(&cloned, progress)
    })??;
    report.print(args.json)
}

fn measured(args: &Args, progress: &Progress) -> Result<Report> {
    let path = args.data.join("grasps.json");
    let bytes = read_regular(&path, FileKind::List)
        .map_err(|e| Error::io("cannot read the list of grasps", e).at(path.display()))?;
    let mut list: Vec<Listed> = serde_json::from_slice(&bytes).map_err(|e| {
        Error::input("invalid list of grasps")
            .because(e)
            .at(path.display())
    })?;
    list.truncate(args.first.unwrap_or(list.len()));
    let models = Models {
        classifier: Model::by_name(SHIPPED)?,
        heuristic: Model::by_name(BASELINE)?,
    };
    let mut contact = Contact {
        clips: 0,
        found: 0,
        in_stated_range: 0,
        first: None,
        last: None,
        not_found: Vec::new(),
        begin_in_contact: 0,
        begin_in_contact_noticed: 0,
    };
    let stated = args.contact_frames[0]..=args.contact_frames[1];
    let mut all = Vec::new();
    for (done, listed) in list.iter().enumerate() {
        progress.count(done, list.len());
        let clip = Clip::open(&args.data, listed)?;
        let onset = clip.onset();
        if listed.clip != "from_open" {
            contact.begin_in_contact += 1;
            let is_noticed = match onset {
                Err(error) if error.kind() == ErrorKind::Input => true,
                Err(error) => return Err(error),
                Ok(onset) => clip.is_deformed(onset.initial)?,
            };
            contact.begin_in_contact_noticed += usize::from(is_noticed);
            continue;
        }
        contact.clips += 1;
        let onset = match onset {
            Ok(onset) => onset,
            Err(error) if error.kind() == ErrorKind::Input => {
                contact.not_found.push(format!("{}: {error}", listed.id));
                continue;
            }
            Err(error) => return Err(error),
        };
        contact.found += 1;
        contact.in_stated_range += usize::from(stated.contains(&onset.both()));
        all.push(clip.measure(listed, onset, &models)?);
    }
    contact.first = all.iter().map(|one| one.onset.both()).min();
    contact.last = all.iter().map(|one| one.onset.both()).max();
    let figures = json!({
        "contact": contact,
        "predictions": predictions(&all),
        "tracking": tracking(&all),
        "alarms": alarms(&all),
    });
    let params = json!({
        "after_contact": AFTER_CONTACT,
        "settle": SETTLE,
        "shakes_from": SHAKES,
        "tracked_frames": TRACKED_FRAMES,
    });
    let text = serde_json::to_string_pretty(&figures)
        .map_err(|e| Error::internal("cannot write JSON").because(e))?;
    Ok(Report::new("real-clips", params, figures, text))
}

struct Models {
    classifier: Model,
    heuristic: Model,
}

/// The frames of a clip, at 320×240.
struct Clip {
    images: [Vec<RgbImage>; 2],
    cells: [Vec<GelCells>; 2],
}

impl Clip {
    fn open(data: &Path, listed: &Listed) -> Result<Self> {
        let settings = OnsetSettings::default();
        let mut clip = Self {
            images: [Vec::new(), Vec::new()],
            cells: [Vec::new(), Vec::new()],
        };
        // Frames beyond these are never used.
        let frames = match listed.clip == "from_open" {
            true => settings.frames() + AFTER_CONTACT,
            false => settings.frames(),
        };
        for (side, camera) in CAMERAS.iter().enumerate() {
            let path = data.join("grasps").join(&listed.id).join(camera);
            let mut video = Video::open(&path)?;
            for image in (&mut video).take(frames) {
                let image = crop_and_resize(&image?, &CropProfile::FULL, 320, 240)?;
                clip.cells[side].push(GelCells::new(&image)?);
                clip.images[side].push(image);
            }
            video.stop()?;
        }
        Ok(clip)
    }

    fn onset(&self) -> Result<PairOnset> {
        let gels = [&self.cells[0][..], &self.cells[1][..]];
        find_onset(gels, None, &OnsetSettings::default())
    }

    /// Whether the gel markers show that the gel is pressed in a frame.
    fn is_deformed(&self, at: usize) -> Result<bool> {
        for images in &self.images {
            let image = &images[at];
            let frame =
                ShearTracker::new(image, USUAL_M_PER_PX, ExpectedMarkers::Unknown)?.update(image);
            if frame.problems.contains(&ShearProblem::DeformedInitial) {
                return Ok(true);
            }
        }
        Ok(false)
    }

    fn frames(&self) -> usize {
        self.images[0].len().min(self.images[1].len())
    }

    fn measure(&self, listed: &Listed, onset: PairOnset, models: &Models) -> Result<Measured> {
        let contact = onset.both();
        let end = self.frames().min(contact + AFTER_CONTACT);
        let levels = [0, 1].map(|side| {
            let cells = &self.cells[side];
            let level = |at: usize| cells[at].contact_level(&cells[onset.initial]);
            (contact..end).map(level).collect::<Vec<f32>>()
        });
        let loss = loss(&levels);
        let mut slips: [Vec<f32>; 2] = Default::default();
        let mut fingers = Vec::new();
        for side in [0, 1] {
            let (finger, slip) = self.tracked(side, onset, end, loss)?;
            fingers.push(finger);
            slips[side] = slip;
        }
        let is_slip = listed.outcome == "slip";
        let until = loss.unwrap_or(end - contact);
        // A stable grasp that is open again within these frames was opened.
        let scored = |scores: Vec<f32>| ScoredClip {
            object: listed.object.clone(),
            loss: loss.filter(|_| is_slip),
            scores,
        };
        let larger = |pair: [f32; 2]| pair[0].max(pair[1]);
        let level: Vec<f32> = (0..until)
            .map(|at| larger([0, 1].map(|side| drop_of(&levels[side], at))))
            .collect();
        let slip: Vec<f32> = (0..until)
            .map(|at| larger([slips[0][at], slips[1][at]]))
            .collect();
        // Without a loss in these frames a lost grasp is neither.
        let is_usable = !listed.label_conflict && (is_slip == loss.is_some() || !is_slip);
        let (grasp, open) = (contact + SETTLE, onset.initial.saturating_sub(1));
        let grasp = grasp.min(self.frames() - 1);
        let (ood_score, is_doubtful) =
            self.classifier_doubts(onset.initial, grasp, &models.classifier)?;
        let [first, second] = <[Finger; 2]>::try_from(fingers)
            .map_err(|_| Error::internal("expected two fingers"))?;
        Ok(Measured {
            onset,
            scored: is_usable.then(|| [scored(level), scored(slip)]),
            ood_score,
            is_doubtful,
            baseline: self.heuristic_label(onset.initial, grasp, &models.heuristic)?,
            open: self.heuristic_label(onset.initial, open, &models.heuristic)?,
            fingers: [first, second],
        })
    }

    /// OOD score of the classifier, and whether the tactile images alone make it uncertain. There is
    /// no colour image for a probability.
    fn classifier_doubts(
        &self,
        initial: usize,
        grasp: usize,
        model: &Model,
    ) -> Result<(Option<f64>, bool)> {
        let mut differences = Vec::new();
        let mut changes = Vec::new();
        for side in [0, 1] {
            let images = &self.images[side];
            differences.push(TactileDifference::between(
                &images[initial],
                &images[grasp],
            )?);
            let cells = &self.cells[side];
            changes.push(GelChange::between(&cells[initial], &cells[grasp], 0.0));
        }
        let score = model
            .ood_detector()
            .and_then(|detector| detector.max_score(&differences));
        Ok((
            score,
            contact_doubt([&changes[0], &changes[1]], true).is_some(),
        ))
    }

    fn heuristic_label(
        &self,
        initial: usize,
        grasp: usize,
        model: &Model,
    ) -> Result<PredictedLabel> {
        let prediction = model.predict_grasp(|name| {
            let side = match name {
                InputName::TactileLeft => 0,
                InputName::TactileRight => 1,
                InputName::Rgb | InputName::Depth => return Ok(None),
            };
            Ok(Some(InputImages::Tactile {
                initial: self.images[side][initial].clone(),
                grasp: self.images[side][grasp].clone(),
            }))
        })?;
        Ok(prediction.label)
    }

    /// Tracks the gel markers of one finger; returns also the slip ratio from the contact on.
    fn tracked(
        &self,
        side: usize,
        onset: PairOnset,
        end: usize,
        loss: Option<usize>,
    ) -> Result<(Finger, Vec<f32>)> {
        let contact = onset.both();
        let images = &self.images[side];
        let mut tracker = ShearTracker::new(
            &images[onset.initial],
            USUAL_M_PER_PX,
            ExpectedMarkers::Unknown,
        )?;
        let mut finger = Finger {
            tracked: 1.0,
            drift_px: None,
        };
        let mut slips = Vec::new();
        for (at, image) in images.iter().enumerate().take(end).skip(onset.initial) {
            let frame = tracker.update(image);
            let summary = frame.summary.as_ref();
            if at < contact + TRACKED_FRAMES {
                finger.tracked = finger
                    .tracked
                    .min(summary.map_or(0.0, |s| s.tracked_fraction));
            }
            if at >= contact {
                slips.push(summary.and_then(|s| s.slip_ratio).unwrap_or(0.0) as f32);
            }
            let is_free = loss.is_some_and(|loss| at >= contact + loss + LOST_FRAMES);
            if let (true, Some(field)) = (is_free, &frame.field) {
                let moved = field
                    .markers
                    .iter()
                    .flatten()
                    .filter(|m| m.confidence > 0.0);
                let lengths = moved.map(|marker| {
                    let [dx, dy] = marker.displacement_px();
                    f64::from(dx.hypot(dy))
                });
                finger.drift_px = median(lengths)
                    .map(|drift| drift as f32)
                    .or(finger.drift_px);
            }
        }
        Ok((finger, slips))
    }
}

/// First frame after the contact from which a finger feels nothing any more.
fn loss(levels: &[Vec<f32>; 2]) -> Option<usize> {
    let of_finger = |levels: &Vec<f32>| {
        let least = OnsetSettings::default().contact_level;
        let mut run = 0;
        for (at, level) in levels.iter().enumerate() {
            let usual = median(
                levels[at.saturating_sub(BEFORE + LOST_FRAMES)..at.saturating_sub(run)]
                    .iter()
                    .map(|l| f64::from(*l)),
            );
            let limit = usual.map_or(least, |usual| least.max(LOST_FRACTION * usual as f32));
            run = if *level < limit { run + 1 } else { 0 };
            if run == LOST_FRAMES {
                return Some(at + 1 - LOST_FRAMES);
            }
        }
        None
    };
    levels.iter().filter_map(of_finger).min()
}

/// Drop of the contact level against the mean of the frames before, fraction; 0 at the beginning.
fn drop_of(levels: &[f32], at: usize) -> f32 {
    let before = &levels[at.saturating_sub(BEFORE)..at];
    if before.is_empty() {
        return 0.0;
    }
    let mean = before.iter().sum::<f32>() / before.len() as f32;
    1.0 - levels[at] / mean.max(f32::MIN_POSITIVE)
}

fn share(count: usize, of: usize) -> Value {
    let [low, high] = wilson_interval(count, of);
    json!({"count": count, "of": of, "fraction": count as f64 / of.max(1) as f64, "interval": [low, high]})
}

fn predictions(all: &[Measured]) -> Value {
    let count =
        |is: &dyn Fn(&Measured) -> bool| share(all.iter().filter(|one| is(one)).count(), all.len());
    let is_ood = |one: &Measured| one.ood_score.is_some_and(|score| score > 1.0);
    let scores = || {
        let mut scores: Vec<f64> = all.iter().filter_map(|one| one.ood_score).collect();
        scores.sort_by(f64::total_cmp);
        scores
    };
    json!({
        "classifier_ood": count(&is_ood),
        "classifier_ood_score": ([0.1, 0.5, 0.9].map(|fraction| quantile(&scores(), fraction))),
        "classifier_unsure": count(&|one| is_ood(one) || one.is_doubtful),
        "heuristic_unsure": count(&|one| one.baseline == PredictedLabel::Unsure),
        "heuristic_stable": count(&|one| one.baseline == PredictedLabel::Stable),
        "without_contact_stable": count(&|one| one.open == PredictedLabel::Stable),
        "without_contact_unsure": count(&|one| one.open == PredictedLabel::Unsure),
    })
}

fn tracking(all: &[Measured]) -> Value {
    let fingers: Vec<&Finger> = all.iter().flat_map(|one| &one.fingers).collect();
    let tracked = fingers
        .iter()
        .filter(|finger| finger.tracked >= 0.95)
        .count();
    let mut drifts: Vec<f64> = fingers
        .iter()
        .filter_map(|finger| finger.drift_px.map(f64::from))
        .collect();
    drifts.sort_by(f64::total_cmp);
    json!({
        "finger_clips_95_percent_in_every_frame": share(tracked, fingers.len()),
        "released": drifts.len(),
        "return_drift_px": ([0.5, 0.9, 1.0].map(|fraction| quantile(&drifts, fraction))),
    })
}

fn alarms(all: &[Measured]) -> Value {
    let of = |which: usize| {
        let clips: Vec<ScoredClip> = all
            .iter()
            .filter_map(|one| Some(one.scored.as_ref()?[which].clone()))
            .collect();
        json!({
            "lift": alarm_figures(&clips, 0..SHAKES),
            "shakes": alarm_figures(&clips, SHAKES..AFTER_CONTACT),
        })
    };
    json!({"contact_level": of(0), "slip_ratio": of(1)})
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn loss_is_where_a_finger_feels_nothing_any_more() {
        let held = vec![5.0; 40];
        let mut lost = held.clone();
        lost[20..].fill(0.1);
        assert_eq!(loss(&[held.clone(), lost.clone()]), Some(20));
        // A bounce of a few frames is none.
        let mut bounce = held.clone();
        bounce[20..23].fill(0.1);
        assert_eq!(loss(&[bounce, held.clone()]), None);
        // A weaker contact is one.
        let mut weaker = held.clone();
        weaker[20..].fill(1.5);
        assert_eq!(loss(&[weaker, held]), None);
    }

    #[test]
    fn drop_is_relative_to_the_frames_before() {
        let levels = [4.0, 4.0, 4.0, 3.0, 1.0];
        assert_eq!(drop_of(&levels, 0), 0.0);
        assert_eq!(drop_of(&levels, 2), 0.0);
        assert_eq!(drop_of(&levels, 3), 0.25);
    }
}
