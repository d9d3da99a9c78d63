//! Marker detectors.

mod apriltag;
#[cfg(test)]
mod apriltag_test;
mod diagnosis;
#[cfg(feature = "opencv")]
mod opencv;

#[cfg(feature = "opencv")]
pub use self::opencv::OpencvDetector;
pub use apriltag::{ApriltagDetector, ApriltagSettings};
pub use diagnosis::{Diagnosis, diagnose, known_dictionaries};

use image::GrayImage;

use super::{Dictionary, MarkerDetector};
use gripcast_base::error::{Error, Result};

/// Shortest side of an image that is searched, px.
const MIN_SIDE: u32 = 32;
/// Longest side of an image that is searched, px.
const MAX_SIDE: u32 = 16_384;

/// All detectors that are compiled in, the default one first, for the markers of `dictionary`
/// whose ids are in `whitelist`.
///
/// # Errors
/// `Input` for what they cannot search for.
pub fn detectors(
    dictionary: &Dictionary,
    whitelist: &[u32],
) -> Result<Vec<Box<dyn MarkerDetector>>> {
    let settings = ApriltagSettings::default();
    let apriltag = ApriltagDetector::new(dictionary, whitelist, settings)?;
    Ok(vec![
        Box::new(apriltag),
        #[cfg(feature = "opencv")]
        Box::new(OpencvDetector::new(dictionary, whitelist)?),
    ])
}

/// `Input` for an image that no detector takes.
fn check_size(image: &GrayImage) -> Result<()> {
    let (width, height) = image.dimensions();
    let taken = MIN_SIDE..=MAX_SIDE;
    if taken.contains(&width) && taken.contains(&height) {
        return Ok(());
    }
    Err(Error::input(format!(
        "cannot search an image of {width}×{height} pixels for markers: each side has to \
             have {MIN_SIDE} to {MAX_SIDE}"
    )))
}
