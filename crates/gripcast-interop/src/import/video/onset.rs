//! Finds the frames before and after two gels come into contact.
//!
//! The gripper is open and still before the fingers close. So the first frames in which both gels
//! stand still are taken for the open gripper, and a finger is in contact once its contact level
//! relative to them exceeds [`OnsetSettings::contact_level`] in [`PERSISTENT`] frames in a row.

use gripcast_base::error::{Error, Result};
use gripcast_imaging::GelCells;

/// Frames in a row in which nothing moves, of an open gripper.
const STILL: usize = 4;
/// Frames in a row with contact.
const PERSISTENT: usize = 3;
/// Maximum mean change of the cells from frame to frame while nothing moves, grey levels.
const STILL_LEVELS: f32 = 0.3;
/// Frames between the initial frame and the first contact: the finger may already touch lightly.
const BEFORE_CONTACT: usize = 2;

/// How contact is found.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct OnsetSettings {
    /// Frames at the beginning that are not used: cameras send old frames first.
    pub skip: usize,
    /// Frames in which both fingers must come into contact.
    pub search: usize,
    /// Contact level from which a finger is in contact, grey levels.
    pub contact_level: f32,
}

impl Default for OnsetSettings {
    fn default() -> Self {
        Self {
            skip: 5,
            search: 60,
            contact_level: 0.3,
        }
    }
}

impl OnsetSettings {
    /// Frames from the beginning that the search reads.
    #[must_use]
    pub fn frames(&self) -> usize {
        self.search + PERSISTENT - 1
    }
}

/// When two gels come into contact; frames count from 0.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct PairOnset {
    /// Last frame in which both gels are free and still.
    pub initial: usize,
    /// First frame in contact of the left and the right gel.
    pub contact: [usize; 2],
}

impl PairOnset {
    /// First frame in which both gels are in contact.
    #[must_use]
    pub fn both(&self) -> usize {
        self.contact[0].max(self.contact[1])
    }
}

/// Finds the contact of two gels, given their frames from the beginning; `initial` is the frame of
/// the open gripper, where it is known.
///
/// # Errors
/// `Input`: the gels are never still before `search`, or one of them does not come into contact.
pub fn find_onset(
    gels: [&[GelCells]; 2],
    initial: Option<usize>,
    settings: &OnsetSettings,
) -> Result<PairOnset> {
    let frames = gels[0].len().min(gels[1].len()).min(settings.frames());
    let reference = match initial {
        Some(initial) => initial,
        None => first_still(gels, frames, settings).ok_or_else(|| {
            Error::input(format!(
                "the gels are never still together in the frames {} to {frames}, so no open gripper \
                 was found",
                settings.skip
            ))
            .remedy("give the frame of the open gripper (`initial_frame`)")
        })?,
    };
    let contact = [0, 1].map(|side| first_contact(gels[side], reference, frames, settings));
    let [Some(left), Some(right)] = contact else {
        let which = match contact {
            [None, None] => "no gel comes into contact",
            [None, _] => "the left gel does not come into contact",
            _ => "the right gel does not come into contact",
        };
        let what = format!(
            "{which} between the frames {reference} and {}; the clip may begin in contact",
            frames.min(settings.search)
        );
        return Err(Error::input(what).remedy(
            "give `initial_frame` and `grasp_frame`, search more frames (`--search`), or take the \
             initial frame from the end of a clip that begins in contact (`--initial-at-end`)",
        ));
    };
    // A given frame stays.
    let before = left.min(right).saturating_sub(BEFORE_CONTACT);
    Ok(PairOnset {
        initial: initial.unwrap_or(before.max(reference)),
        contact: [left, right],
    })
}

/// Last of the first [`STILL`] frames in which nothing moves on either gel.
pub(super) fn first_still(
    gels: [&[GelCells]; 2],
    frames: usize,
    settings: &OnsetSettings,
) -> Option<usize> {
    let is_still = |at: usize| {
        gels.iter()
            .all(|gel| gel[at].mean_difference(&gel[at - 1]) < STILL_LEVELS)
    };
    let mut still = 0;
    for at in settings.skip.max(1)..frames {
        still = if is_still(at) { still + 1 } else { 0 };
        if still >= STILL - 1 && at + 1 >= settings.skip + STILL {
            return Some(at);
        }
    }
    None
}

fn first_contact(
    gel: &[GelCells],
    reference: usize,
    frames: usize,
    settings: &OnsetSettings,
) -> Option<usize> {
    let initial = gel.get(reference)?;
    let mut run = 0;
    for (at, cells) in gel.iter().enumerate().take(frames).skip(reference + 1) {
        run = match cells.contact_level(initial) > settings.contact_level {
            true => run + 1,
            false => 0,
        };
        if run == PERSISTENT {
            return Some(at + 1 - PERSISTENT);
        }
    }
    None
}
