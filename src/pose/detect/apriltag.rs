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

use super::{MarkerFamily, check_size};
use crate::error::{Error, ErrorKind, Result};
use crate::pose::{Detection, MarkerDetector};

/// The library puts (0, 0) at the top-left pixel's corner.
const HALF_PIXEL: DVec2 = DVec2::splat(0.5);

/// What can be set.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ApriltagSettings {
    /// Quads are searched for in a picture of which every n-th pixel is taken; 1 to 4. Larger is
    /// faster and misses small markers; corners and codes come from the full picture.
    pub decimate: u32,
    /// Edges are fitted in the full picture.
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
    /// A detector for the markers of `family` whose ids are in `whitelist`.
    ///
    /// # Errors
    /// `Input` for an empty whitelist, an id that the dictionary does not have, or a dictionary
    /// or setting that the library cannot take.
    pub fn new(
        family: &MarkerFamily,
        whitelist: &[u32],
        settings: ApriltagSettings,
    ) -> Result<Self> {
        family.validate()?;
        let ids = allowed(family, whitelist)?;
        if !(1..=4).contains(&settings.decimate) {
            return Err(Error::new(
                ErrorKind::Input,
                format!("decimation by {}; possible are 1 to 4", settings.decimate),
            ));
        }
        let (bit_x, bit_y) = family.cells().into_iter().map(|(x, y)| (x + 1, y + 1)).unzip();
        let mut tables = Tables {
            codes: ids.iter().map(|id| family.codes[*id as usize]).collect(),
            bit_x,
            bit_y,
            name: CString::new(family.name.replace('\0', "")).unwrap_or_default(),
        };
        let raw = Box::into_raw(Box::new(raw_family(family, &mut tables)));
        // SAFETY: no arguments; the result is checked below.
        let detector = unsafe { sys::apriltag_detector_create() };
        let this = Self {
            detector,
            family: raw,
            _tables: tables,
            ids,
        };
        this.configure(settings, family.corrected_bits)?;
        Ok(this)
    }

    fn configure(&self, settings: ApriltagSettings, corrected_bits: u32) -> Result<()> {
        // SAFETY: null or a detector that create() made and that nobody else has.
        let Some(detector) = (unsafe { self.detector.as_mut() }) else {
            return Err(Error::new(
                ErrorKind::Internal,
                "the AprilTag library has no memory",
            ));
        };
        // A library of another version would have other fields at these places.
        let as_expected = detector.nthreads == 1
            && detector.quad_decimate == 2.0
            && detector.decode_sharpening == 0.25
            && detector.qtp.max_nmaxima == 10
            && detector.qtp.min_white_black_diff == 5;
        if !as_expected {
            return Err(Error::new(
                ErrorKind::Internal,
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
            return Err(Error::new(
                ErrorKind::Internal,
                "the AprilTag library could not prepare the dictionary",
            ));
        }
        Ok(())
    }

    fn detection(&self, raw: &sys::apriltag_detection) -> Option<Detection> {
        let id = *self.ids.get(usize::try_from(raw.id).ok()?)?;
        // The library starts at the bottom left and goes against the clock.
        let [c, d, e, f] = [3, 2, 1, 0].map(|i: usize| DVec2::from_array(raw.p[i]) - HALF_PIXEL);
        let corners_px = [c, d, e, f];
        corners_px.iter().all(|p| p.is_finite()).then_some(Detection {
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

    fn detect(&mut self, picture: &GrayImage) -> Result<Vec<Detection>> {
        check_size(picture)?;
        let (width, height) = (picture.width() as i32, picture.height() as i32);
        let mut image = sys::image_u8 {
            width,
            height,
            stride: width,
            // Only read: the library writes into its input for a blur alone, which is off.
            buf: picture.as_raw().as_ptr().cast_mut(),
        };
        // SAFETY: the detector is valid and borrowed exclusively; the image describes the
        // picture's pixels, width × height bytes that outlive the call.
        let found = unsafe { sys::apriltag_detector_detect(self.detector, &raw mut image) };
        // SAFETY: null or an array of the library with pointers to detections.
        let Some(array) = (unsafe { found.as_ref() }) else {
            return Err(Error::new(
                ErrorKind::Internal,
                "the AprilTag library has no memory",
            ));
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

impl MarkerFamily {
    /// AprilTag 36h11 with 587 markers, as the library has it.
    #[must_use]
    pub fn tag36h11() -> Self {
        // SAFETY: create() gives null or a family whose codes are `ncodes` numbers; destroy()
        // frees it after the copy.
        let codes = unsafe {
            let family = sys::tag36h11_create();
            let codes = family.as_ref().map_or_else(Vec::new, |family| {
                std::slice::from_raw_parts(family.codes, family.ncodes as usize).to_vec()
            });
            if !family.is_null() {
                sys::tag36h11_destroy(family);
            }
            codes
        };
        Self {
            name: "36h11".to_owned(),
            bits_per_side: 6,
            codes,
            min_distance: 11,
            corrected_bits: 1,
        }
    }
}

/// The whitelist in ascending order, every id once.
fn allowed(family: &MarkerFamily, whitelist: &[u32]) -> Result<Vec<u32>> {
    let mut ids = whitelist.to_vec();
    ids.sort_unstable();
    ids.dedup();
    let count = family.codes.len();
    match ids.last() {
        None => Err(Error::new(
            ErrorKind::Input,
            format!("no marker of {} to search for", family.name),
        )),
        Some(last) if *last as usize >= count => Err(Error::new(
            ErrorKind::Input,
            format!(
                "{} has the markers 0 to {}, not {last}",
                family.name,
                count - 1
            ),
        )
        .remedy("check the dictionary's name in the board's description")),
        Some(_) => Ok(ids),
    }
}

fn raw_family(family: &MarkerFamily, tables: &mut Tables) -> sys::apriltag_family {
    sys::apriltag_family {
        ncodes: tables.codes.len() as u32,
        codes: tables.codes.as_mut_ptr(),
        width_at_border: family.bits_per_side as i32 + 2,
        total_width: family.bits_per_side as i32 + 4,
        reversed_border: false,
        nbits: tables.bit_x.len() as u32,
        bit_x: tables.bit_x.as_mut_ptr(),
        bit_y: tables.bit_y.as_mut_ptr(),
        h: family.min_distance,
        name: tables.name.as_ptr().cast::<c_char>().cast_mut(),
        impl_: std::ptr::null_mut(),
    }
}
