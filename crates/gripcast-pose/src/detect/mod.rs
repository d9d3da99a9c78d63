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

/// Shortest side of a picture that is searched, px.
const LEAST_SIDE: u32 = 32;
/// Longest side of a picture that is searched, px.
const LARGEST_SIDE: u32 = 16_384;

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

/// `Input` for a picture that no detector takes.
fn check_size(picture: &GrayImage) -> Result<()> {
    let (width, height) = picture.dimensions();
    let taken = LEAST_SIDE..=LARGEST_SIDE;
    if taken.contains(&width) && taken.contains(&height) {
        return Ok(());
    }
    Err(Error::input(format!(
        "cannot search a picture of {width}×{height} pixels for markers: each side has to \
             have {LEAST_SIDE} to {LARGEST_SIDE}"
    )))
}
