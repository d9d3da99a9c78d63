//! Layout of the *Feeling of Success*: a list of dictionaries as written by `deepdish`.
//!
//! ```text
//! data/i0/ gelsightA_before   [height, width, 3] u8, RGB
//!          gelsightA_during   …
//!          gelsightB_before, gelsightB_during, kinectA_rgb_during
//!          @is_gripping       attribute, boolean
//!          @object_name       attribute, text
//! data/i1/ …
//! ```
//!
//! `…_before` is taken before the gripper approaches the object, `…_during` with closed fingers
//! before the lift, `…_after` after the lift. The last is never read: it shows the outcome.

use std::path::Path;

use image::RgbImage;
use image::imageops::crop_imm;

use crate::hdf5::{ByteArray, Hdf5, wrong_shape};
use gripcast_base::error::{Error, Result};
use gripcast_base::files::ObjectName;
use gripcast_dataset::shard::ShardImages;
use gripcast_imaging::{CropProfile, Decoder, crop_and_resize, encode_jpeg};

/// Crop profile of the tactile images.
pub(super) const CROP: CropProfile = CropProfile::GELSIGHT_2017_FULL;
/// Names of the list's group in different releases of deepdish.
const LISTS: [&str; 2] = ["data", "_top"];
/// Sensor A is taken as the left one; the dataset does not define the side.
const INITIAL_LEFT: &str = "gelsightA_before";
const INITIAL_RIGHT: &str = "gelsightB_before";
const GRASP_LEFT: &str = "gelsightA_during";
const GRASP_RIGHT: &str = "gelsightB_during";
const GRASP_RGB: &str = "kinectA_rgb_during";
const IMAGES: [&str; 5] = [
    INITIAL_LEFT,
    INITIAL_RIGHT,
    GRASP_LEFT,
    GRASP_RIGHT,
    GRASP_RGB,
];
const LABEL: &str = "is_gripping";
const OBJECT: &str = "object_name";
/// Maximum size of an image, bytes; the Kinect's have 6 MB.
const MAX_BYTES: u64 = 64 << 20;
/// Size of the images of a shard.
const WIDTH: u32 = 320;
const HEIGHT: u32 = 240;
/// JPEG quality, that of rendered images.
const QUALITY: u8 = 92;
/// Crop of the Kinect's image to the table, as by the authors: left, top, right, bottom as
/// fractions of width and height.
const TABLE: [f64; 4] = [0.064, 0.135, 0.606, 0.976];

/// A file of grasps.
pub(super) struct GraspFile {
    grasps: Vec<Hdf5>,
}

/// Label and object of a grasp.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct GraspLabel {
    pub(super) object: ObjectName,
    pub(super) is_stable: bool,
}

impl GraspFile {
    /// # Errors
    /// Those of reading the file; `Input` without a list of grasps.
    pub(super) fn open(path: &Path) -> Result<Self> {
        let read = || {
            let file = Hdf5::open(path, "the Feeling of Success (calandra_corl2017_*.h5)")?;
            for list in LISTS {
                if let Some(mut grasps) = file.groups(list)? {
                    if grasps.is_empty() {
                        return Err(Error::input(format!("no grasps in `{list}`")));
                    }
                    grasps.sort_by_cached_key(|grasp| sort_key(grasp.name()));
                    return Ok(Self { grasps });
                }
            }
            Err(file.missing(LISTS[0]))
        };
        read().map_err(|e: Error| e.at(path.display()))
    }

    /// Grasps in order.
    pub(super) fn grasps(&self) -> &[Hdf5] {
        &self.grasps
    }
}

/// Sort key: `i12` after `i7`; other names last.
fn sort_key(name: &str) -> (u64, String) {
    let digits = name
        .strip_prefix('i')
        .and_then(|digits| digits.parse().ok());
    (digits.unwrap_or(u64::MAX), name.to_owned())
}

impl GraspLabel {
    /// Reads label and object, and checks that the images exist.
    ///
    /// # Errors
    /// `Input`: a key is missing or has another type, a label is neither 0 nor 1.
    pub(super) fn read(grasp: &Hdf5) -> Result<Self> {
        for key in IMAGES {
            shape(&image(grasp, key)?, key)?;
        }
        let label = match grasp.attribute_number(LABEL)? {
            Some(label) => Some(label),
            None => grasp.number(LABEL)?,
        };
        let is_stable = match label {
            Some(0.0) => false,
            Some(1.0) => true,
            Some(other) => {
                return Err(Error::input(format!(
                    "expected 0 or 1 in `{LABEL}`, found {other}"
                )));
            }
            None => return Err(grasp.missing(LABEL)),
        };
        let object = match grasp.attribute_text(OBJECT)? {
            Some(object) => Some(object),
            None => grasp.text(OBJECT)?,
        };
        let object = object.ok_or_else(|| grasp.missing(OBJECT))?;
        let object = ObjectName::parse(object.trim()).map_err(|e| e.at(OBJECT))?;
        Ok(Self { object, is_stable })
    }
}

/// Reads the images of a grasp, cropped and resized for a shard.
///
/// # Errors
/// `Input`: an image is damaged, missing or of another type.
pub(super) fn images(grasp: &Hdf5, decoder: &mut Decoder) -> Result<ShardImages> {
    let mut read = |key: &str| -> Result<Vec<u8>> {
        let read = |decoder: &mut Decoder| {
            let whole = decoded(&image(grasp, key)?, key, decoder)?;
            let whole = match key {
                GRASP_RGB => table(&whole),
                _ => whole,
            };
            encode_jpeg(&crop_and_resize(&whole, &CROP, WIDTH, HEIGHT)?, QUALITY)
        };
        read(decoder).map_err(|e| e.at(key))
    };
    Ok(ShardImages {
        initial_left: read(INITIAL_LEFT)?,
        initial_right: read(INITIAL_RIGHT)?,
        grasp_left: read(GRASP_LEFT)?,
        grasp_right: read(GRASP_RIGHT)?,
        grasp_rgb: read(GRASP_RGB)?,
        initial_rgb: None,
        grasp_depth: None,
    })
}

fn image<'a>(grasp: &Hdf5, key: &'a str) -> Result<ByteArray<'a>> {
    let found = grasp.bytes(key, MAX_BYTES)?;
    found.ok_or_else(|| grasp.missing(key))
}

/// Width and height of a pixel array; none for an encoded image.
fn shape(array: &ByteArray<'_>, key: &str) -> Result<Option<(u32, u32)>> {
    let side = |length: u64| u32::try_from(length).ok().filter(|side| *side > 0);
    match *array.shape {
        [height, width, 3] if let (Some(w), Some(h)) = (side(width), side(height)) => {
            Ok(Some((w, h)))
        }
        [length] if length > 0 => Ok(None),
        _ => Err(wrong_shape(
            key,
            "[height, width, 3], or the bytes of a JPEG or PNG",
            &array.shape,
        )),
    }
}

fn decoded(array: &ByteArray<'_>, key: &str, decoder: &mut Decoder) -> Result<RgbImage> {
    let size = shape(array, key)?;
    let bytes = array.read()?;
    let Some((width, height)) = size else {
        return decoder.stored_image(&bytes);
    };
    let found = bytes.len();
    RgbImage::from_raw(width, height, bytes).ok_or_else(|| {
        let what = format!("expected {width}×{height} pixels in `{key}`, found {found} bytes");
        Error::input(what)
    })
}

/// Crops the Kinect's image to the table, extended to 4:3 within the image.
fn table(whole: &RgbImage) -> RgbImage {
    let (width, height) = (f64::from(whole.width()), f64::from(whole.height()));
    let [left, top, right, bottom] = TABLE;
    let (w, h) = ((right - left) * width, (bottom - top) * height);
    let aspect = f64::from(WIDTH) / f64::from(HEIGHT);
    let (w, h) = (w.max(aspect * h), h.max(w / aspect));
    // First pixel and number of pixels along an axis.
    let along = |middle: f64, length: f64, side: f64| {
        let length = length.min(side).round().max(1.0);
        let begin = (middle - 0.5 * length).clamp(0.0, side - length).floor();
        (begin as u32, length as u32)
    };
    let (x, w) = along(0.5 * (left + right) * width, w, width);
    let (y, h) = along(0.5 * (top + bottom) * height, h, height);
    crop_imm(whole, x, y, w, h).to_image()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn table_crop_is_4_to_3_within_the_image() {
        let cut = table(&RgbImage::new(1920, 1080));
        assert_eq!(cut.dimensions(), (1211, 908));
        for (width, height) in [(1, 1), (3, 200), (200, 3), (512, 424)] {
            let cut = table(&RgbImage::new(width, height));
            assert!(cut.width() <= width && cut.height() <= height);
            assert!(cut.width() > 0 && cut.height() > 0);
        }
    }

    #[test]
    fn grasps_are_sorted_by_number() {
        let mut names = ["i10", "x", "i9", "i0"];
        names.sort_by_cached_key(|name| sort_key(name));
        assert_eq!(names, ["i0", "i9", "i10", "x"]);
    }
}
