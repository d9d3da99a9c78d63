//! Marker detection with the AprilTag C library, which is compiled in.
//!
//! E. Olson, *AprilTag: a robust and flexible visual fiducial system*, ICRA 2011; J. Wang and
//! E. Olson, *AprilTag 2*, IROS 2016. Tag families are data, so the library detects ArUco
//! dictionaries as well.

#![allow(unsafe_code)]

use std::ffi::{CString, c_char};

use apriltag_sys as sys;
use glam::DVec2;
use image::GrayImage;

use super::check_size;
use crate::{Detection, Dictionary, MarkerDetector};
use gripcast_base::error::{Error, Result};
use gripcast_imaging::srgb_decode;

/// The library puts (0, 0) at the corner of the top-left pixel.
const HALF_PIXEL: DVec2 = DVec2::splat(0.5);
/// Maximum number of cells along a side: the library reserves one of 64 code bits.
const MAX_CELLS: usize = 7;
/// Minimum Hamming distance of a dictionary for bit correction.
const MIN_DISTANCE_TO_CORRECT: u32 = 6;
/// Side of a marker below which others may be too small for the decimated search, px: it finds
/// markers of 24 px, and those of one rig differ by a factor of two.
const SMALL_MARKER_PX: f64 = 48.0;
/// Fraction of saturated pixels after the intensity is stretched: lamps, glints.
const SATURATED_FRACTION: f64 = 0.002;
/// Maximum gain of the intensity stretch; limits noise.
const MAX_GAIN: f32 = 8.0;
/// Noise range in a thresholding window (144 pixels), in standard deviations, with some margin.
const NOISE_RANGE: f64 = 7.0;
/// Range of the minimum window contrast, grey levels; the lower bound is the library's default.
const MIN_CONTRAST: (i32, i32) = (5, 60);

/// Whether the image is also searched at full resolution, which takes four times as long.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FullSearch {
    /// Never: for live images.
    Never,
    /// If ids are missing, and the detected markers are small or there are none.
    IfSmall,
    /// Always: for images of unknown content.
    Always,
}

/// Detector settings.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ApriltagSettings {
    /// Decimation of the image for quad detection, 1 to 4. Larger values are faster and miss small
    /// markers; corners and codes are read from the full image.
    pub decimate: u32,
    /// Whether edges are refined in the full image.
    pub refine_edges: bool,
    /// Whether small markers are searched for at full resolution.
    pub full: FullSearch,
}

impl Default for ApriltagSettings {
    fn default() -> Self {
        Self {
            decimate: 2,
            refine_edges: true,
            full: FullSearch::IfSmall,
        }
    }
}

/// Detects the markers of one or several dictionaries on the calling thread.
pub struct ApriltagDetector {
    detector: *mut sys::apriltag_detector,
    families: Vec<Family>,
    settings: ApriltagSettings,
    /// Squares of the last image, markers or not.
    squares: u32,
}

/// The searched markers of a dictionary.
struct Family {
    raw: *mut sys::apriltag_family,
    /// Data that `raw` points to; must not be changed while it does.
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
    /// Creates a detector for the markers of `dictionary` with ids in `whitelist`. Corrects one bit
    /// if the dictionary's minimum Hamming distance is 6 or more, else none.
    ///
    /// # Errors
    /// `Input` for an empty whitelist, an unknown id, a dictionary of more than 7×7 cells, or an
    /// invalid decimation.
    pub fn new(
        dictionary: &Dictionary,
        whitelist: &[u32],
        settings: ApriltagSettings,
    ) -> Result<Self> {
        let mut this = Self::empty(settings)?;
        this.add(dictionary, whitelist)?;
        Ok(this)
    }

    /// Creates a detector for all markers of several dictionaries. The squares of an image are
    /// searched for once.
    ///
    /// # Errors
    /// As [`Self::new`].
    pub fn of_several(dictionaries: &[Dictionary], settings: ApriltagSettings) -> Result<Self> {
        let mut this = Self::empty(settings)?;
        for dictionary in dictionaries {
            let every_id: Vec<u32> = (0..dictionary.len() as u32).collect();
            this.add(dictionary, &every_id)?;
        }
        Ok(this)
    }

    fn empty(settings: ApriltagSettings) -> Result<Self> {
        let decimate = settings.decimate;
        if !(1..=4).contains(&decimate) {
            let what = format!("decimation must be 1 to 4, found {decimate}");
            return Err(Error::input(what));
        }
        let this = Self {
            // SAFETY: no arguments; `configure` checks the result.
            detector: unsafe { sys::apriltag_detector_create() },
            families: Vec::new(),
            settings,
            squares: 0,
        };
        this.configure()?;
        Ok(this)
    }

    fn add(&mut self, dictionary: &Dictionary, whitelist: &[u32]) -> Result<()> {
        let side = dictionary.bits_per_side();
        if side > MAX_CELLS {
            return Err(Error::input(format!(
                "the detector supports up to {MAX_CELLS}×{MAX_CELLS} cells, {} has {side}×{side}",
                dictionary.name()
            )));
        }
        let ids = sorted_ids(dictionary, whitelist)?;
        // The dictionary counts cells from 1 inside the border, the library from 0 with the border.
        let border = dictionary.border_cells() as u32 - 1;
        let cells = dictionary.rotation_grouped_cells();
        let mut tables = Tables {
            codes: ids
                .iter()
                .filter_map(|id| dictionary.rotation_grouped_code(*id))
                .collect(),
            bit_x: cells.iter().map(|cell| cell[0] + border).collect(),
            bit_y: cells.iter().map(|cell| cell[1] + border).collect(),
            name: CString::new(dictionary.name().replace('\0', "")).unwrap_or_default(),
        };
        let raw = Box::into_raw(Box::new(raw_family(dictionary, &mut tables)));
        self.families.push(Family {
            raw,
            _tables: tables,
            ids,
        });
        // In a small dictionary one wrong bit already makes markers of anything.
        let corrected_bits = i32::from(dictionary.min_distance() >= MIN_DISTANCE_TO_CORRECT);
        // SAFETY: `configure` has checked the detector; the family is owned by `self`, its tables
        // outlive the detector, and their sizes were validated.
        unsafe {
            sys::apriltag_detector_add_family_bits(self.detector, raw, corrected_bits);
        }
        // SAFETY: as above.
        if unsafe { (*raw).impl_.is_null() } {
            return Err(Error::internal(
                "the AprilTag library cannot prepare the dictionary",
            ));
        }
        Ok(())
    }

    fn configure(&self) -> Result<()> {
        // SAFETY: null, or a detector made by create() and owned by `self` alone.
        let Some(detector) = (unsafe { self.detector.as_mut() }) else {
            return Err(Error::internal("the AprilTag library is out of memory"));
        };
        // The defaults of another library version would be at other offsets.
        let as_expected = detector.nthreads == 1
            && detector.quad_decimate == 2.0
            && detector.decode_sharpening == 0.25
            && detector.qtp.max_nmaxima == 10
            && detector.qtp.min_white_black_diff == 5;
        if !as_expected {
            return Err(
                Error::internal("unexpected version of the AprilTag library linked")
                    .remedy("build with APRILTAG_SYS_METHOD=raw,static"),
            );
        }
        detector.refine_edges = self.settings.refine_edges;
        Ok(())
    }

    /// Detects the markers of all dictionaries in an image, each with the index of its dictionary,
    /// sorted by dictionary and id. An id is listed as often as it is in the image.
    ///
    /// # Errors
    /// `Input` for an image that is too small or too large.
    pub fn detect_all(&mut self, image: &GrayImage) -> Result<Vec<(usize, Detection)>> {
        check_size(image)?;
        let linear = linear_intensity(image);
        let decimate = self.settings.decimate;
        self.squares = 0;
        let mut found = Vec::new();
        let mut scales = vec![decimate];
        while let Some(scale) = scales.pop() {
            // 8-bit linear intensity lacks contrast in the dark beside lamps or windows.
            for levels in [&linear, image] {
                for (family, detection) in self.search(levels, scale)? {
                    let is_known = |(other, known): &(usize, Detection)| {
                        *other == family && is_same_marker(known, &detection)
                    };
                    if !found.iter().any(is_known) {
                        found.push((family, detection));
                    }
                }
            }
            if scale == decimate && decimate > 1 && self.needs_full_search(&found) {
                scales.push(1);
            }
        }
        found.sort_by_key(|(family, d)| (*family, d.id));
        Ok(found)
    }

    /// Number of dark squares in the last image that were compared with markers.
    #[must_use]
    pub fn squares(&self) -> u32 {
        self.squares
    }

    /// Whether a search at full resolution may find more markers.
    fn needs_full_search(&self, found: &[(usize, Detection)]) -> bool {
        let wanted: usize = self.families.iter().map(|family| family.ids.len()).sum();
        let smallest = found.iter().map(|(_, d)| d.min_side_px());
        match self.settings.full {
            FullSearch::Never => false,
            FullSearch::Always => true,
            FullSearch::IfSmall => {
                let smallest = smallest.fold(f64::INFINITY, f64::min);
                found.len() < wanted && (found.is_empty() || smallest < SMALL_MARKER_PX)
            }
        }
    }

    /// Runs the library once on an image. Windows without contrast above the noise are skipped;
    /// they would take most of the time.
    fn search(&mut self, image: &GrayImage, decimate: u32) -> Result<Vec<(usize, Detection)>> {
        let contrast = (NOISE_RANGE * noise(image)).round() as i32;
        let contrast = contrast.clamp(MIN_CONTRAST.0, MIN_CONTRAST.1);
        // SAFETY: the detector is valid, which `configure` has checked, and borrowed exclusively.
        unsafe {
            (*self.detector).qtp.min_white_black_diff = contrast;
            (*self.detector).quad_decimate = decimate as f32;
        }
        let (width, height) = (image.width() as i32, image.height() as i32);
        let mut image = sys::image_u8 {
            width,
            height,
            stride: width,
            // Only read: the library writes into its input for blurring only, which is off.
            buf: image.as_raw().as_ptr().cast_mut(),
        };
        // SAFETY: the detector is valid and borrowed exclusively; the image describes the
        // image's pixels, width × height bytes that outlive the call.
        let found = unsafe { sys::apriltag_detector_detect(self.detector, &raw mut image) };
        // SAFETY: null, or the library's array of pointers to detections.
        let Some(array) = (unsafe { found.as_ref() }) else {
            return Err(Error::internal("the AprilTag library is out of memory"));
        };
        // SAFETY: as above.
        self.squares = self.squares.max(unsafe { (*self.detector).nquads });
        let mut detections = Vec::new();
        let pointers = array.data.cast::<*const sys::apriltag_detection>();
        for i in 0..usize::try_from(array.size).unwrap_or(0) {
            // SAFETY: the array has `size` valid pointers to detections.
            let raw = unsafe { (*pointers.add(i)).as_ref() };
            detections.extend(raw.and_then(|raw| self.detection(raw)));
        }
        // SAFETY: the array came from this library and is not used afterwards.
        unsafe { sys::apriltag_detections_destroy(found) };
        Ok(detections)
    }

    fn detection(&self, raw: &sys::apriltag_detection) -> Option<(usize, Detection)> {
        let is_family = |family: &Family| std::ptr::eq(family.raw, raw.family);
        let family = self.families.iter().position(is_family)?;
        let id = *self.families[family]
            .ids
            .get(usize::try_from(raw.id).ok()?)?;
        // The library lists corners counter-clockwise from the bottom left.
        let corners_px = [3, 2, 1, 0].map(|i: usize| DVec2::from_array(raw.p[i]) - HALF_PIXEL);
        let detection = Detection {
            id,
            corners_px,
            hamming: u32::try_from(raw.hamming).unwrap_or(0),
            margin: raw.decision_margin,
        };
        corners_px
            .iter()
            .all(|p| p.is_finite())
            .then_some((family, detection))
    }
}

/// Whether two detections of a dictionary are of one marker: the same id at the same place.
fn is_same_marker(a: &Detection, b: &Detection) -> bool {
    let reach = 0.5 * a.min_side_px().min(b.min_side_px());
    a.id == b.id && a.center_px().distance(b.center_px()) < reach
}

impl MarkerDetector for ApriltagDetector {
    fn name(&self) -> &'static str {
        "apriltag"
    }

    fn detect(&mut self, image: &GrayImage) -> Result<Vec<Detection>> {
        let found = self.detect_all(image)?;
        Ok(found.into_iter().map(|(_, detection)| detection).collect())
    }
}

impl Drop for ApriltagDetector {
    fn drop(&mut self) {
        // SAFETY: made by `new` and not used afterwards; the detector releases the families first.
        unsafe {
            if !self.detector.is_null() {
                sys::apriltag_detector_destroy(self.detector);
            }
            for family in &self.families {
                drop(Box::from_raw(family.raw));
            }
        }
    }
}

/// Converts sRGB levels to linear intensity, stretched to the full range. In sRGB levels, white
/// spreads over black at blurred edges: small dark cells vanish and corners move inwards.
fn linear_intensity(image: &GrayImage) -> GrayImage {
    let mut counts = [0usize; 256];
    for level in image.as_raw() {
        counts[usize::from(*level)] += 1;
    }
    let mut above = (image.as_raw().len() as f64 * SATURATED_FRACTION) as usize;
    let white = (1..=255u8).rev().find(|level| {
        let count = counts[usize::from(*level)];
        above = above.saturating_sub(count);
        above == 0 && count > 0
    });
    let gain = (1.0 / srgb_decode(white.unwrap_or(255))).min(MAX_GAIN);
    let table: [u8; 256] = std::array::from_fn(|level| {
        (255.0 * gain * srgb_decode(level as u8)).round().min(255.0) as u8
    });
    let mut linear = image.clone();
    linear.iter_mut().for_each(|p| *p = table[usize::from(*p)]);
    linear
}

/// Standard deviation of the noise, grey levels, from the median absolute second difference along
/// rows, on which the few edges of an image have little effect.
fn noise(image: &GrayImage) -> f64 {
    const STRIDES: (usize, usize) = (7, 5);
    // Median of |x| times the deviation of a second difference, for unit noise.
    const MEDIAN_OF_UNIT_NOISE: f64 = 0.6745 * 2.449;
    let mut counts = [0u32; 1021];
    let rows = image.as_raw().chunks_exact(image.width() as usize);
    for row in rows.step_by(STRIDES.1) {
        for window in row.windows(3).step_by(STRIDES.0) {
            let [a, b, c] = [window[0], window[1], window[2]].map(i32::from);
            counts[(a - 2 * b + c).unsigned_abs() as usize] += 1;
        }
    }
    let half = counts.iter().sum::<u32>() / 2;
    let mut below = 0;
    let median = counts.iter().position(|count| {
        below += count;
        below > half
    });
    median.unwrap_or(0) as f64 / MEDIAN_OF_UNIT_NOISE
}

/// Sorts and deduplicates the whitelist; rejects ids outside the dictionary.
fn sorted_ids(dictionary: &Dictionary, whitelist: &[u32]) -> Result<Vec<u32>> {
    let mut ids = whitelist.to_vec();
    ids.sort_unstable();
    ids.dedup();
    let (name, count) = (dictionary.name(), dictionary.len());
    match ids.last() {
        None => Err(Error::input(format!("no marker ids of {name} given"))),
        Some(last) if *last as usize >= count => {
            let max = count - 1;
            let what = format!("id {last} is not in {name}, which has ids 0 to {max}");
            Err(Error::input(what).remedy("check the dictionary in the board file"))
        }
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
