//! Detection with the AprilTag C library, which is compiled in.
//!
//! E. Olson, *AprilTag: a robust and flexible visual fiducial system*, ICRA 2011; J. Wang and
//! E. Olson, *AprilTag 2*, IROS 2016. Its families are data, so that ArUco's dictionaries are
//! searched by the same code.

#![allow(unsafe_code)]

use std::ffi::{CString, c_char};

use apriltag_sys as sys;
use glam::DVec2;
use image::GrayImage;

use super::check_size;
use crate::{Detection, Dictionary, MarkerDetector};
use gripcast_base::error::{Error, Result};
use gripcast_imaging::srgb_decode;

/// The library puts (0, 0) at the top-left pixel's corner.
const HALF_PIXEL: DVec2 = DVec2::splat(0.5);
/// Most cells along a side: the library has 64 bits for a code and needs one of them.
const MAX_CELLS: usize = 7;
/// Least distance of a dictionary's markers at which a bit is corrected.
const MIN_DISTANCE_TO_CORRECT: u32 = 6;
/// Fraction of the pixels that may be brighter than white once light is stretched: lamps, glints.
const BRIGHTEST: f64 = 0.002;
/// Most that light is amplified; beyond, noise would be.
const MAX_GAIN: f32 = 8.0;
/// Range of noise in a window that is thresholded (144 pixels), in standard deviations, with some
/// reserve.
const NOISE_RANGE: f64 = 7.0;
/// Limits of the contrast that a window needs, grey levels; the first is the library's own.
const MIN_CONTRAST: (i32, i32) = (5, 60);

/// What can be set.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ApriltagSettings {
    /// Quads are searched for in an image of which every n-th pixel is taken; 1 to 4. Larger is
    /// faster and misses small markers; corners and codes come from the full image.
    pub decimate: u32,
    /// Edges are fitted in the full image.
    pub refine_edges: bool,
}

impl Default for ApriltagSettings {
    fn default() -> Self {
        Self {
            decimate: 2,
            refine_edges: true,
        }
    }
}

/// Searches for the markers of one dictionary, on the calling thread.
pub struct ApriltagDetector {
    detector: *mut sys::apriltag_detector,
    family: *mut sys::apriltag_family,
    /// What the family points to; not touched as long as it does.
    _tables: Tables,
    /// Marker id of each code of the family.
    ids: Vec<u32>,
}

struct Tables {
    codes: Vec<u64>,
    bit_x: Vec<u32>,
    bit_y: Vec<u32>,
    name: CString,
}

// SAFETY: the pointers are owned, the library keeps no thread-local state and, with one thread,
// starts none.
unsafe impl Send for ApriltagDetector {}

impl ApriltagDetector {
    /// A detector for the markers of `dictionary` whose ids are in `whitelist`. One wrong bit is
    /// corrected, but none in dictionaries whose markers differ by less than six.
    ///
    /// # Errors
    /// `Input` for an empty whitelist, an id that the dictionary does not have, a dictionary of
    /// more than 7×7 cells, or a decimation that is not possible.
    pub fn new(
        dictionary: &Dictionary,
        whitelist: &[u32],
        settings: ApriltagSettings,
    ) -> Result<Self> {
        let side = dictionary.bits_per_side();
        if side > MAX_CELLS {
            return Err(Error::input(format!(
                "the detector takes markers of up to {MAX_CELLS}×{MAX_CELLS} cells; {} has \
                     {side}×{side}",
                dictionary.name()
            )));
        }
        let ids = allowed(dictionary, whitelist)?;
        if !(1..=4).contains(&settings.decimate) {
            return Err(Error::input(format!(
                "decimation by {}; possible are 1 to 4",
                settings.decimate
            )));
        }
        // The dictionary counts cells from 1 within the border, the library from 0 with it.
        let border = dictionary.border_cells() as u32 - 1;
        let places = dictionary.rotation_grouped_places();
        let mut tables = Tables {
            codes: ids
                .iter()
                .filter_map(|id| dictionary.rotation_grouped_code(*id))
                .collect(),
            bit_x: places.iter().map(|place| place[0] + border).collect(),
            bit_y: places.iter().map(|place| place[1] + border).collect(),
            name: CString::new(dictionary.name().replace('\0', "")).unwrap_or_default(),
        };
        let raw = Box::into_raw(Box::new(raw_family(dictionary, &mut tables)));
        // SAFETY: no arguments; the result is checked below.
        let detector = unsafe { sys::apriltag_detector_create() };
        let this = Self {
            detector,
            family: raw,
            _tables: tables,
            ids,
        };
        this.configure(settings, corrected_bits(dictionary))?;
        Ok(this)
    }

    fn configure(&self, settings: ApriltagSettings, corrected_bits: u32) -> Result<()> {
        // SAFETY: null or a detector that create() made and that nobody else has.
        let Some(detector) = (unsafe { self.detector.as_mut() }) else {
            return Err(Error::internal("the AprilTag library has no memory"));
        };
        // A library of another version would have other fields at these places.
        let as_expected = detector.nthreads == 1
            && detector.quad_decimate == 2.0
            && detector.decode_sharpening == 0.25
            && detector.qtp.max_nmaxima == 10
            && detector.qtp.min_white_black_diff == 5;
        if !as_expected {
            return Err(Error::internal(
                "another version of the AprilTag library was linked than this program expects",
            )
            .remedy("build with APRILTAG_SYS_METHOD=raw,static"));
        }
        detector.quad_decimate = settings.decimate as f32;
        detector.refine_edges = settings.refine_edges;
        // SAFETY: both were made by `new`, the family for this detector alone; its tables live as
        // long as the detector, and their sizes were validated.
        unsafe {
            sys::apriltag_detector_add_family_bits(
                self.detector,
                self.family,
                corrected_bits as i32,
            );
        }
        // SAFETY: as above.
        if unsafe { (*self.family).impl_.is_null() } {
            return Err(Error::internal(
                "the AprilTag library could not prepare the dictionary",
            ));
        }
        Ok(())
    }

    /// Places without contrast beyond the noise are not searched: most of the time would go there.
    fn set_least_contrast(&mut self, image: &GrayImage) {
        let range = NOISE_RANGE * noise(image);
        let least = (range.round() as i32).clamp(MIN_CONTRAST.0, MIN_CONTRAST.1);
        // SAFETY: the detector is valid, which `configure` has checked, and borrowed exclusively.
        unsafe {
            (*self.detector).qtp.min_white_black_diff = least;
        }
    }

    /// One pass over an image.
    fn search(&mut self, image: &GrayImage) -> Result<Vec<Detection>> {
        self.set_least_contrast(image);
        let (width, height) = (image.width() as i32, image.height() as i32);
        let mut image = sys::image_u8 {
            width,
            height,
            stride: width,
            // Only read: the library writes into its input for a blur alone, which is off.
            buf: image.as_raw().as_ptr().cast_mut(),
        };
        // SAFETY: the detector is valid and borrowed exclusively; the image describes the
        // image's pixels, width × height bytes that outlive the call.
        let found = unsafe { sys::apriltag_detector_detect(self.detector, &raw mut image) };
        // SAFETY: null or an array of the library with pointers to detections.
        let Some(array) = (unsafe { found.as_ref() }) else {
            return Err(Error::internal("the AprilTag library has no memory"));
        };
        let mut detections = Vec::new();
        let pointers = array.data.cast::<*const sys::apriltag_detection>();
        for i in 0..usize::try_from(array.size).unwrap_or(0) {
            // SAFETY: the array has `size` pointers, each to a detection of its own.
            let raw = unsafe { (*pointers.add(i)).as_ref() };
            detections.extend(raw.and_then(|raw| self.detection(raw)));
        }
        // SAFETY: the array came from this library and is not used any more.
        unsafe { sys::apriltag_detections_destroy(found) };
        Ok(detections)
    }

    fn detection(&self, raw: &sys::apriltag_detection) -> Option<Detection> {
        let id = *self.ids.get(usize::try_from(raw.id).ok()?)?;
        // The library starts at the bottom left and goes against the clock.
        let [c, d, e, f] = [3, 2, 1, 0].map(|i: usize| DVec2::from_array(raw.p[i]) - HALF_PIXEL);
        let corners_px = [c, d, e, f];
        corners_px
            .iter()
            .all(|p| p.is_finite())
            .then_some(Detection {
                id,
                corners_px,
                hamming: u32::try_from(raw.hamming).unwrap_or(0),
                margin: raw.decision_margin,
            })
    }
}

impl MarkerDetector for ApriltagDetector {
    fn name(&self) -> &'static str {
        "apriltag"
    }

    fn detect(&mut self, image: &GrayImage) -> Result<Vec<Detection>> {
        check_size(image)?;
        let mut detections = self.search(&light(image))?;
        // Light of 8 bits lacks contrast where it is dim beside bright lamps or windows.
        for dim in self.search(image)? {
            if detections.iter().all(|known| known.id != dim.id) {
                detections.push(dim);
            }
        }
        detections.sort_by_key(|d| d.id);
        Ok(detections)
    }
}

impl Drop for ApriltagDetector {
    fn drop(&mut self) {
        // SAFETY: made by `new` and not used any more; the detector lets go of the family first.
        unsafe {
            if !self.detector.is_null() {
                sys::apriltag_detector_destroy(self.detector);
            }
            drop(Box::from_raw(self.family));
        }
    }
}

/// Light instead of sRGB levels, stretched to the whole range. In levels white spreads over black
/// where an edge is blurred, so that small dark cells vanish and corners move inwards.
fn light(image: &GrayImage) -> GrayImage {
    let mut counts = [0usize; 256];
    for level in image.as_raw() {
        counts[usize::from(*level)] += 1;
    }
    let mut above = (image.as_raw().len() as f64 * BRIGHTEST) as usize;
    let white = (1..=255u8).rev().find(|level| {
        let count = counts[usize::from(*level)];
        above = above.saturating_sub(count);
        above == 0 && count > 0
    });
    let gain = (1.0 / srgb_decode(white.unwrap_or(255))).min(MAX_GAIN);
    let table: [u8; 256] = std::array::from_fn(|level| {
        (255.0 * gain * srgb_decode(level as u8)).round().min(255.0) as u8
    });
    let mut light = image.clone();
    for pixel in light.iter_mut() {
        *pixel = table[usize::from(*pixel)];
    }
    light
}

/// Standard deviation of the noise, grey levels: the median second difference along rows, which
/// the few edges of an image hardly change.
fn noise(image: &GrayImage) -> f64 {
    const EVERY: (usize, usize) = (7, 5);
    // Median of |x| and deviation of a second difference, for a deviation of 1.
    const OF_DEVIATION: f64 = 0.6745 * 2.449;
    let mut counts = [0u32; 1021];
    for row in image
        .as_raw()
        .chunks_exact(image.width() as usize)
        .step_by(EVERY.1)
    {
        for three in row.windows(3).step_by(EVERY.0) {
            let [a, b, c] = [three[0], three[1], three[2]].map(i32::from);
            counts[(a - 2 * b + c).unsigned_abs() as usize] += 1;
        }
    }
    let half = counts.iter().sum::<u32>() / 2;
    let mut below = 0;
    let median = counts.iter().position(|count| {
        below += count;
        below > half
    });
    median.unwrap_or(0) as f64 / OF_DEVIATION
}

/// Bits that may be corrected without taking one marker for another: in a small dictionary, one
/// wrong bit already makes markers of anything.
fn corrected_bits(dictionary: &Dictionary) -> u32 {
    u32::from(dictionary.min_distance() >= MIN_DISTANCE_TO_CORRECT)
}

/// The whitelist in ascending order, every id once.
fn allowed(dictionary: &Dictionary, whitelist: &[u32]) -> Result<Vec<u32>> {
    let mut ids = whitelist.to_vec();
    ids.sort_unstable();
    ids.dedup();
    let count = dictionary.len();
    match ids.last() {
        None => Err(Error::input(format!(
            "no marker of {} to search for",
            dictionary.name()
        ))),
        Some(last) if *last as usize >= count => Err(Error::input(format!(
            "{} has the markers 0 to {}, not {last}",
            dictionary.name(),
            count - 1
        ))
        .remedy("check the dictionary's name in the board's description")),
        Some(_) => Ok(ids),
    }
}

fn raw_family(dictionary: &Dictionary, tables: &mut Tables) -> sys::apriltag_family {
    sys::apriltag_family {
        ncodes: tables.codes.len() as u32,
        codes: tables.codes.as_mut_ptr(),
        width_at_border: dictionary.cells_per_side() as i32,
        total_width: dictionary.cells_per_side() as i32 + 2,
        reversed_border: false,
        nbits: tables.bit_x.len() as u32,
        bit_x: tables.bit_x.as_mut_ptr(),
        bit_y: tables.bit_y.as_mut_ptr(),
        h: dictionary.min_distance(),
        name: tables.name.as_ptr().cast::<c_char>().cast_mut(),
        impl_: std::ptr::null_mut(),
    }
}
