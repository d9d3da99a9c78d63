//! Where the gripper was, relative to the object, in a grasp of a dataset: the external camera's
//! images from before the fingers closed, the sheet that the object stands on and the gripper's
//! tags give `t_object_gripper` (the paper's grasp-annotated dataset, §5.1).
//!
//! [`Annotator::observe`] measures one image, [`choose`] takes the last sharp ones before the
//! gripper moves, [`Annotator::annotate`] does both for a grasp; [`overlay`] draws what was found
//! over the image.

mod choice;
mod observation;
mod overlay;
mod plausibility;

pub use choice::{Choice, choose};
pub use observation::{Annotator, Observation};
pub use overlay::{OverlayContent, overlay};
pub use plausibility::is_between_fingers;

use glam::DQuat;
use image::GrayImage;

use gripcast_base::error::{Error, Result};
use gripcast_dataset::{PoseQuality, PoseRecord};
use gripcast_geometry::Pose;

/// A grasp's pose, with what it was found from.
#[derive(Clone, Debug)]
pub struct Annotation {
    /// What goes into `grasp.json`.
    pub record: PoseRecord,
    /// The last image that was used.
    pub shown: Observation,
    /// Name of that image's file.
    pub shown_image: String,
}

/// Hashes of the boards that a pose was found with.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct BoardHashes {
    /// Of the sheet.
    pub sheet: String,
    /// Of the tags.
    pub tags: String,
}

impl Annotator {
    /// The pose of a grasp from images by time, each with the name of its file.
    ///
    /// # Errors
    /// `Input` if no image shows sheet and tags; it tells why the last one does not.
    pub fn annotate<'a>(
        &mut self,
        images: impl IntoIterator<Item = (String, &'a GrayImage)>,
    ) -> Result<Annotation> {
        let mut seen = Vec::new();
        let mut failure = None;
        for (name, image) in images {
            match self.observe(image) {
                Ok(observation) => seen.push((name, observation)),
                Err(error) => failure = Some(error.at(name)),
            }
        }
        let named = seen.iter().map(|(name, seen)| (name.as_str(), seen));
        annotation(named, self.boards()).ok_or_else(|| {
            failure.unwrap_or_else(|| {
                Error::input(
                    "there is no image of the external camera from before the fingers closed",
                )
                .remedy("bind an external camera in the rig file")
            })
        })
    }
}

/// The pose of a grasp from observations by time, each with the name of its file; none without
/// observations.
#[must_use]
pub fn annotation<'a>(
    observations: impl IntoIterator<Item = (&'a str, &'a Observation)>,
    boards: BoardHashes,
) -> Option<Annotation> {
    let (names, all): (Vec<&str>, Vec<&Observation>) = observations.into_iter().unzip();
    let choice = choose(&all)?;
    let shown = all[choice.last()].clone();
    let used = choice.used.iter().map(|i| names[*i].to_owned());
    Some(Annotation {
        record: record(&shown, &choice, used.collect(), boards),
        shown,
        shown_image: names[choice.last()].to_owned(),
    })
}

fn record(
    shown: &Observation,
    choice: &Choice,
    frames: Vec<String>,
    boards: BoardHashes,
) -> PoseRecord {
    let Pose {
        rotation,
        translation_m,
    } = choice.t_object_gripper;
    let DQuat { x, y, z, w } = rotation;
    let tags = &shown.gripper.body;
    let mut notes = shown.notes.clone();
    notes.extend(choice.notes.iter().cloned());
    PoseRecord {
        t_m: translation_m.to_array(),
        q_wxyz: [w, x, y, z],
        frame: "t_object_gripper".to_owned(),
        covariance: Some(choice.covariance.as_flattened().to_vec()),
        reprojection_px: Some(shown.object.rms_px),
        corrected_by_hand: false,
        quality: Some(PoseQuality {
            frames,
            markers: [shown.object.used_markers(), tags.used_markers()],
            tags_reprojection_px: tags.rms_px,
            spread_m: choice.spread_m,
            spread_rad: choice.spread_rad,
            blur_px: shown.blur_px,
            opening_m: shown.gripper.opening.map(|opening| opening.opening_m),
            ambiguous: shown.is_ambiguous(),
            sheet: boards.sheet,
            tags: boards.tags,
            notes,
        }),
    }
}

#[cfg(test)]
#[path = "annotate_test.rs"]
mod tests;
