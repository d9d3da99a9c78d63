//! Pose annotation of grasps (the paper's grasp-annotated dataset, §5.1): `t_object_gripper` from
//! the object's sheet and the gripper's tags in the external camera's images before the fingers
//! close.
//!
//! [`Annotator::observe`] measures one image, [`select`] selects the last sharp ones before the
//! gripper moves, [`Annotator::annotate`] does both for a grasp; [`overlay`] draws the result.

mod observation;
mod overlay;
mod plausibility;
mod selection;

pub use observation::{Annotator, Observation};
pub use overlay::{OverlayContent, draw_axes, draw_markers, overlay};
pub use plausibility::is_between_fingers;
pub use selection::{Selection, select};

use glam::DQuat;
use image::GrayImage;

use gripcast_base::error::{Error, Result};
use gripcast_dataset::{PoseQuality, PoseRecord};
use gripcast_geometry::Pose;

/// The pose of a grasp and its sources.
#[derive(Clone, Debug)]
pub struct Annotation {
    /// Record for `grasp.json`.
    pub record: PoseRecord,
    /// The latest selected observation.
    pub shown: Observation,
    /// File name of its image.
    pub shown_image: String,
}

/// Hashes of the boards of a pose.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct BoardHashes {
    /// Of the sheet.
    pub sheet: String,
    /// Of the tags.
    pub tags: String,
}

impl Annotator {
    /// Annotates a grasp from named images in order of time.
    ///
    /// # Errors
    /// `Input` if sheet and tags are in no image, with the cause for the last one.
    pub fn annotate<'a>(
        &mut self,
        images: impl IntoIterator<Item = (String, &'a GrayImage)>,
    ) -> Result<Annotation> {
        let mut observed = Vec::new();
        let mut failure = None;
        for (name, image) in images {
            match self.observe(image) {
                Ok(observation) => observed.push((name, observation)),
                Err(error) => failure = Some(error.at(name)),
            }
        }
        let named = observed
            .iter()
            .map(|(name, observation)| (name.as_str(), observation));
        annotation(named, self.boards()).ok_or_else(|| {
            failure.unwrap_or_else(|| {
                Error::input("there is no image of the external camera before the fingers close")
                    .remedy("bind an external camera in the rig file")
            })
        })
    }
}

/// Annotates a grasp from named observations in order of time. `None`: there are none.
#[must_use]
pub fn annotation<'a>(
    observations: impl IntoIterator<Item = (&'a str, &'a Observation)>,
    boards: BoardHashes,
) -> Option<Annotation> {
    let (names, all): (Vec<&str>, Vec<&Observation>) = observations.into_iter().unzip();
    let selection = select(&all)?;
    let shown = all[selection.last()].clone();
    let used = selection.used.iter().map(|i| names[*i].to_owned());
    Some(Annotation {
        record: record(&shown, &selection, used.collect(), boards),
        shown,
        shown_image: names[selection.last()].to_owned(),
    })
}

fn record(
    shown: &Observation,
    selection: &Selection,
    frames: Vec<String>,
    boards: BoardHashes,
) -> PoseRecord {
    let Pose {
        rotation,
        translation_m,
    } = selection.t_object_gripper;
    let DQuat { x, y, z, w } = rotation;
    let tags = &shown.gripper.body;
    let mut notes = shown.notes.clone();
    notes.extend(selection.notes.iter().cloned());
    PoseRecord {
        t_m: translation_m.to_array(),
        q_wxyz: [w, x, y, z],
        frame: "t_object_gripper".to_owned(),
        covariance: Some(selection.covariance.as_flattened().to_vec()),
        reprojection_px: Some(shown.object.rms_px),
        corrected_by_hand: false,
        quality: Some(PoseQuality {
            frames,
            markers: [shown.object.used_markers(), tags.used_markers()],
            tags_reprojection_px: tags.rms_px,
            spread_m: selection.spread_m,
            spread_rad: selection.spread_rad,
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
