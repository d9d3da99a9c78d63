//! Marker detectors.

mod apriltag;
#[cfg(test)]
mod apriltag_test;

pub use apriltag::{ApriltagDetector, ApriltagSettings};

use image::GrayImage;

use crate::error::{Error, ErrorKind, Result};

/// Shortest side of a picture that is searched, px.
const LEAST_SIDE: u32 = 32;
/// Longest side of a picture that is searched, px.
const LARGEST_SIDE: u32 = 16_384;

/// `Input` for a picture that no detector takes.
fn check_size(picture: &GrayImage) -> Result<()> {
    let (width, height) = picture.dimensions();
    let taken = LEAST_SIDE..=LARGEST_SIDE;
    if taken.contains(&width) && taken.contains(&height) {
        return Ok(());
    }
    Err(Error::new(
        ErrorKind::Input,
        format!(
            "cannot search a picture of {width}×{height} pixels for markers: each side has to \
             have {LEAST_SIDE} to {LARGEST_SIDE}"
        ),
    ))
}
