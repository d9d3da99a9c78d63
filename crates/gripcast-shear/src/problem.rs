//! Why a frame has no shear, or an uncertain one.

use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

/// A problem of tracking.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(tag = "kind", rename_all = "snake_case")]
pub enum ShearProblem {
    /// The sensor profile has gel markers, the initial image has none.
    NoMarkers,
    /// The initial image has gel markers, the sensor profile has none.
    UnexpectedMarkers,
    /// The pitch in the initial image is not that of the sensor profile.
    OtherPitch {
        /// Pitch in the image, px.
        found_px: f32,
        /// Pitch of the sensor profile, px.
        expected_px: f32,
    },
    /// The gel is deformed in the initial image already: displacements count from there.
    DeformedInitial,
    /// Many gel markers are lost.
    ManyLost {
        /// Gel markers that are lost.
        lost: usize,
        /// Gel markers in the initial image.
        total: usize,
    },
    /// The image is blurred.
    Blurred,
    /// The image has another size than the initial one.
    Resized {
        /// Width and height of this image, px.
        found: [u32; 2],
        /// Width and height of the initial image, px.
        expected: [u32; 2],
    },
    /// The gel markers have another size than in the initial image, also where nothing touches the
    /// gel.
    OtherMarkerSize {
        /// Median diameter relative to the initial image.
        ratio: f32,
    },
    /// Nothing touches the gel, so no texture can be followed.
    NoContact,
    /// The contact has no texture that could be followed.
    NoTexture,
}

impl ShearProblem {
    /// Whether the image cannot be compared with the initial one: it has neither summary nor field.
    #[must_use]
    pub fn excludes_image(self) -> bool {
        matches!(self, Self::Resized { .. } | Self::OtherMarkerSize { .. })
    }

    /// What is wrong.
    #[must_use]
    pub fn what(self) -> String {
        match self {
            Self::NoMarkers => {
                "the sensor profile has gel markers, but the initial image has none".into()
            }
            Self::UnexpectedMarkers => {
                "the initial image has gel markers, but the sensor profile has none".into()
            }
            Self::OtherPitch {
                found_px,
                expected_px,
            } => format!(
                "the gel markers are {found_px:.1} px apart, in the sensor profile {expected_px:.1} px"
            ),
            Self::DeformedInitial => {
                "something deforms the gel in the initial image, so displacements are relative to \
                 that"
                    .into()
            }
            Self::ManyLost { lost, total } => format!("{lost} of {total} gel markers are lost"),
            Self::Blurred => "the image is blurred".into(),
            Self::Resized { found, expected } => format!(
                "the image has {}×{} pixels, the initial image {}×{}",
                found[0], found[1], expected[0], expected[1]
            ),
            Self::OtherMarkerSize { ratio } => format!(
                "the gel markers have {ratio:.2} times the diameter of those in the initial image, \
                 so the image is of another sensor or scale"
            ),
            Self::NoContact => "nothing touches the gel, so there is no texture to follow".into(),
            Self::NoTexture => "the contact has no texture to follow".into(),
        }
    }

    /// What to do about it.
    #[must_use]
    pub fn remedy(self) -> &'static str {
        match self {
            Self::NoMarkers => {
                "choose the profile of a gel without markers, or take the initial image with the \
                 gripper open and the lamps on"
            }
            Self::UnexpectedMarkers => "choose the profile of a gel with markers",
            Self::OtherPitch { .. } => {
                "choose the profile of this gel, or correct its scale or pitch"
            }
            Self::DeformedInitial => "take the initial image with the gripper open",
            Self::ManyLost { .. } => {
                "open the gripper and take the initial image again; check the gel for damage"
            }
            Self::Blurred => "check the focus of the sensor and its exposure time",
            Self::Resized { .. } => "record all frames with the same mode and crop of the camera",
            Self::OtherMarkerSize { .. } => {
                "take the initial image with the same sensor, mode and crop as the others"
            }
            Self::NoContact => "close the gripper on an object",
            Self::NoTexture => "use a gel with markers for smooth objects",
        }
    }

    /// The problem with its remedy.
    #[must_use]
    pub fn text(self) -> String {
        format!("{}: {}", self.what(), self.remedy())
    }
}
