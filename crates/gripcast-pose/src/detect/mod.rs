//! Marker detectors.

mod apriltag;
#[cfg(test)]
mod apriltag_test;
mod diagnosis;
mod identify;
#[cfg(feature = "opencv")]
mod opencv;

#[cfg(feature = "opencv")]
pub use self::opencv::OpencvDetector;
pub use apriltag::{ApriltagDetector, ApriltagSettings, FullSearch};
pub use diagnosis::{Diagnosis, diagnose};
pub use identify::{Identified, identify};

use image::GrayImage;

use super::{Dictionary, MarkerDetector};
use gripcast_base::error::{Error, Result};

/// Supported image sides, px.
const SIDE_RANGE: std::ops::RangeInclusive<u32> = 32..=16_384;

/// Creates all detectors that are compiled in, the default one first, for the markers of
/// `dictionary` with ids in `whitelist`. `full` says whether images are also searched at full
/// resolution.
///
/// # Errors
/// Those of the detectors.
pub fn detectors(
    dictionary: &Dictionary,
    whitelist: &[u32],
    full: FullSearch,
) -> Result<Vec<Box<dyn MarkerDetector>>> {
    let settings = ApriltagSettings {
        full,
        ..ApriltagSettings::default()
    };
    let apriltag = ApriltagDetector::new(dictionary, whitelist, settings)?;
    Ok(vec![
        Box::new(apriltag),
        #[cfg(feature = "opencv")]
        Box::new(OpencvDetector::new(dictionary, whitelist)?),
    ])
}

/// Refuses images that no detector supports.
pub(crate) fn check_size(image: &GrayImage) -> Result<()> {
    let (width, height) = image.dimensions();
    if SIDE_RANGE.contains(&width) && SIDE_RANGE.contains(&height) {
        return Ok(());
    }
    Err(Error::input(format!(
        "cannot detect markers in a {width}×{height} px image: each side must have {} to {} px",
        SIDE_RANGE.start(),
        SIDE_RANGE.end()
    )))
}
