//! Reads, crops, labels and validates presses.

use std::path::PathBuf;

use image::RgbImage;
use rayon::prelude::*;

use super::detect::find_contact;
use super::press_file::{Label, PressEntry, PressList, read_image};
use super::press_set::{LabelledPress, PressSet, ScaleSource, SkippedPress};
use super::score::{CentreDistance, ObservedChange, observe};
use crate::SensorGeometry;
use crate::background::planes_of;
use crate::ensure;
use gripcast_base::error::{Error, Result};
use gripcast_imaging::{CropProfile, CropWindow, crop_and_resize};

/// Longer side of a GelSight Mini's view, m, if the scale is not given. Published values lie
/// between 18.6 and 20.3 mm.
const NOMINAL_VIEW_M: f64 = 18.6e-3;
/// Gel thickness of a Mini, m.
const GEL_THICKNESS_M: f64 = 4e-3;
/// Plausible ball diameters, m.
const BALL_M: std::ops::RangeInclusive<f64> = 5e-4..=0.1;
/// Plausible pixel sizes, m.
const PIXEL_M: std::ops::RangeInclusive<f64> = 1e-6..=1e-3;
/// Maximum fraction of values in the contact disc newly at 0 or 255. One saturated channel is
/// common under the bright side of a real ball.
const MAX_SATURATED: f64 = 0.25;
/// Minimum fraction of the contact disc inside the image.
const MIN_INSIDE: f64 = 0.8;
/// Minimum change in the contact disc, grey levels (RMS of a channel).
const MIN_CHANGE: f64 = 5.0;
/// Maximum change far from the contact, grey levels (RMS of a channel), after gain and offset: a
/// real gel stays below 8.
const MAX_OUTSIDE: f64 = 16.0;
/// Plausible exposure gains.
const GAIN: std::ops::RangeInclusive<f64> = 0.5..=2.0;
/// Maximum stretch of one axis relative to the other by the resize: a crop by a seventh of
/// 640×480 pixels stretches by 0.4 %.
const MAX_STRETCH: f64 = 0.03;
/// Minimum side of an image, px.
const MIN_SIDE: u32 = 64;
/// Maximum side of an image, px.
const MAX_SIDE: u32 = 4096;

/// Source and preprocessing of the presses.
#[derive(Clone, Debug)]
pub struct ReadOptions {
    /// Folder with `presses.json`, or with images only.
    pub folder: PathBuf,
    /// Ball diameter, m; overrides that of the list.
    pub ball_diameter_m: Option<f64>,
    /// Pixel size of the stored images, m; overrides that of the list.
    pub pixel_m: Option<f64>,
    /// Crop of the stored images.
    pub crop: CropProfile,
    /// Width and height after the crop; `None` keeps the stored size.
    pub size: Option<(u32, u32)>,
    /// Pixel grid of a profile to score: replaces size and pixel size.
    pub grid: Option<SensorGeometry>,
    /// Detects all contacts, ignoring labels.
    pub find_contacts: bool,
}

impl ReadOptions {
    /// Reads a folder without preprocessing.
    pub fn from_folder(folder: impl Into<PathBuf>) -> Self {
        Self {
            folder: folder.into(),
            ball_diameter_m: None,
            pixel_m: None,
            crop: CropProfile::FULL,
            size: None,
            grid: None,
            find_contacts: false,
        }
    }
}

impl PressSet {
    /// Reads a folder. Unusable presses are listed with the reason.
    ///
    /// # Errors
    /// `NotFound`, `Io`, `Input` if the folder, its list or the no-contact image cannot be used,
    /// the ball diameter is unknown, or no press is usable.
    pub fn read(options: &ReadOptions) -> Result<Self> {
        let list = PressList::read(&options.folder)?;
        let all: Vec<usize> = (0..list.presses.len()).collect();
        Self::read_at(options, &list, &all)
    }

    /// Reads the presses at some positions of a list.
    pub(super) fn read_at(
        options: &ReadOptions,
        list: &PressList,
        positions: &[usize],
    ) -> Result<Self> {
        let folder = options.folder.display().to_string();
        let ball_m = 0.5 * ball_diameter(options, list).map_err(|e| e.at(&folder))?;
        let (stored, _) = read_image(&options.folder, &list.no_contact)?;
        let frame = Reframe::new(&stored, options).map_err(|e| e.at(&folder))?;
        let stated = options.pixel_m.or(list.m_per_px);
        let stated = stated.map(|pixel_m| plausible("the pixel size", pixel_m, PIXEL_M));
        let stated = stated.transpose().map_err(|e| e.at(&folder))?;
        let stated_pixel_m = stated.map(|pixel_m| pixel_m / frame.zoom());
        let (geometry, scale) = match (options.grid, stated_pixel_m) {
            (Some(grid), _) => (grid, ScaleSource::Profile),
            (None, Some(pixel_m)) => (frame.geometry(pixel_m), ScaleSource::Given),
            (None, None) => {
                let pixel_m = NOMINAL_VIEW_M / f64::from(frame.size.0.max(frame.size.1));
                (frame.geometry(pixel_m), ScaleSource::Nominal)
            }
        };
        let no_contact = frame.apply(&stored)?;
        let other_ball = |diameter_m: &f64| (diameter_m / (2.0 * ball_m) - 1.0).abs() > 1e-3;
        let mut set = Self {
            geometry,
            scale,
            stated_pixel_m,
            ball_m,
            overridden_ball_diameter_m: list.ball_diameter_m.filter(other_ball),
            untouched: planes_of(&no_contact),
            no_contact,
            presses: Vec::new(),
            skipped: Vec::new(),
        };
        let read: Vec<Result<LabelledPress, String>> = positions
            .par_iter()
            .map(|position| set.read_press(options, &frame, (*position, &list.presses[*position])))
            .collect();
        for (position, press) in positions.iter().zip(read) {
            match press {
                Ok(press) => set.presses.push(press),
                Err(reason) => set.skipped.push(SkippedPress {
                    number: position + 1,
                    file: list.presses[*position].file.clone(),
                    reason,
                }),
            }
        }
        if set.presses.is_empty() {
            return Err(none_usable(&set.skipped).at(folder));
        }
        Ok(set)
    }

    fn read_press(
        &self,
        options: &ReadOptions,
        frame: &Reframe,
        (position, entry): (usize, &PressEntry),
    ) -> Result<LabelledPress, String> {
        let label = entry.label()?;
        let (stored, sha256) =
            read_image(&options.folder, &entry.file).map_err(|e| e.to_string())?;
        if stored.dimensions() != frame.stored {
            return Err(format!(
                "the image has {}×{} pixels, the no-contact image {}×{}",
                stored.width(),
                stored.height(),
                frame.stored.0,
                frame.stored.1
            ));
        }
        let image = frame.apply(&stored).map_err(|e| e.to_string())?;
        let label = label.filter(|_| !options.find_contacts);
        let (centre_px, radius_px) = match label {
            Some(label) => frame.label(label),
            None => find_contact(self, &image)?,
        };
        let press = LabelledPress {
            number: position + 1,
            sha256,
            file: entry.file.clone(),
            image,
            centre_px,
            radius_px,
            is_detected: label.is_none(),
        };
        self.check(&press)?;
        Ok(press)
    }

    /// Checks a press; returns the reason why it cannot be used.
    fn check(&self, press: &LabelledPress) -> Result<(), String> {
        let (radius, ball) = (press.radius_px, self.ball_m / self.geometry.pixel_m);
        ensure(radius <= 1.05 * ball, || {
            format!(
                "the contact radius of {radius:.1} px exceeds the ball's radius of {ball:.1} px"
            )
        })?;
        let disc = Disc::of(press);
        let (inside, required) = (100.0 * disc.inside, 100.0 * MIN_INSIDE);
        ensure(disc.inside >= MIN_INSIDE, || {
            format!(
                "the contact lies off the image ({inside:.0} % of the disc is inside, at least \
                 {required:.0} % is required)"
            )
        })?;
        let saturated = disc.saturated(press, &self.no_contact);
        ensure(saturated <= MAX_SATURATED, || {
            format!(
                "the image is saturated: {:.0} % of the values in the contact are at 0 or 255; \
                 lower the exposure or press less",
                100.0 * saturated
            )
        })?;
        let ObservedChange {
            gain,
            change,
            outside_rms,
            ..
        } = observe(self, press);
        let outside = outside_rms.into_iter().fold(0.0, f64::max);
        let plausible = gain.iter().all(|gain| GAIN.contains(gain));
        ensure(outside <= MAX_OUTSIDE && plausible, || {
            format!(
                "the background differs from the no-contact image (gain {gain:.2?}, residual \
                 {outside:.1} grey levels): another sensor or other light?"
            )
        })?;
        let change = disc.rms(&change);
        ensure(change >= MIN_CHANGE, || {
            format!(
                "nothing changes inside the contact ({change:.1} grey levels, at least \
                 {MIN_CHANGE} are required): wrong label or image"
            )
        })
    }
}

fn ball_diameter(options: &ReadOptions, list: &PressList) -> Result<f64> {
    let Some(diameter) = options.ball_diameter_m.or(list.ball_diameter_m) else {
        return Err(Error::input("unknown ball diameter")
            .remedy("pass --ball-mm, or set `ball_diameter_m` in presses.json"));
    };
    plausible("the ball diameter", diameter, BALL_M)
}

fn plausible(what: &str, value: f64, range: std::ops::RangeInclusive<f64>) -> Result<f64> {
    if range.contains(&value) {
        return Ok(value);
    }
    Err(Error::input(format!(
        "{what} must be {} to {} mm, found {} mm",
        1e3 * range.start(),
        1e3 * range.end(),
        1e3 * value
    ))
    .remedy("options take millimetres, presses.json takes metres"))
}

pub(super) fn none_usable(skipped: &[SkippedPress]) -> Error {
    let first = skipped.first().map_or_else(
        || "the list is empty".to_owned(),
        |press| format!("{}: {}", press.file, press.reason),
    );
    Error::input(format!(
        "none of {} presses is usable ({first})",
        skipped.len()
    ))
    .remedy("fix the presses or take new ones")
}

/// Crop and resize of images and labels.
struct Reframe {
    crop: CropProfile,
    stored: (u32, u32),
    window: CropWindow,
    size: (u32, u32),
}

impl Reframe {
    fn new(stored: &RgbImage, options: &ReadOptions) -> Result<Self> {
        let (width, height) = stored.dimensions();
        let refused = |what: String| {
            Err(Error::input(what).remedy("use images of 64 to 4096 pixels per side"))
        };
        let Some(window) = options.crop.window(width, height) else {
            return refused(format!(
                "crop `{}` of {width}×{height} pixels is empty",
                options.crop
            ));
        };
        let size = match options.grid {
            Some(grid) => (grid.width as u32, grid.height as u32),
            None => options.size.unwrap_or((window.width, window.height)),
        };
        if size.0.min(size.1) < MIN_SIDE || size.0.max(size.1) > MAX_SIDE {
            return refused(format!(
                "images of {}×{} pixels cannot be calibrated",
                size.0, size.1
            ));
        }
        let aspect = |(width, height): (u32, u32)| f64::from(width) / f64::from(height);
        let stretch = aspect(size) / aspect((window.width, window.height));
        if (stretch - 1.0).abs() > MAX_STRETCH {
            return Err(Error::input(format!(
                "images of {}×{} pixels cannot be shown as {}×{}: that stretches them by {:.0} %",
                window.width,
                window.height,
                size.0,
                size.1,
                100.0 * (stretch.max(stretch.recip()) - 1.0)
            ))
            .remedy("crop and turn the images as those of the sensor profile"));
        }
        Ok(Self {
            crop: options.crop,
            stored: (width, height),
            window,
            size,
        })
    }

    /// Pixel grid of the resized images.
    fn geometry(&self, pixel_m: f64) -> SensorGeometry {
        SensorGeometry {
            width: self.size.0 as usize,
            height: self.size.1 as usize,
            pixel_m,
            gel_thickness_m: GEL_THICKNESS_M,
        }
    }

    /// Scale of the resize, mean of both axes.
    fn zoom(&self) -> f64 {
        let x = f64::from(self.size.0) / f64::from(self.window.width);
        let y = f64::from(self.size.1) / f64::from(self.window.height);
        0.5 * (x + y)
    }

    fn apply(&self, stored: &RgbImage) -> Result<RgbImage> {
        Ok(crop_and_resize(
            stored,
            &self.crop,
            self.size.0,
            self.size.1,
        )?)
    }

    fn label(&self, (centre, radius): Label) -> Label {
        let along = |value: f64, first: u32, from: u32, to: u32| {
            (value + 0.5 - f64::from(first)) * f64::from(to) / f64::from(from) - 0.5
        };
        let x = along(centre[0], self.window.left, self.window.width, self.size.0);
        let y = along(centre[1], self.window.top, self.window.height, self.size.1);
        ([x, y], radius * self.zoom())
    }
}

/// Pixels of a contact disc.
struct Disc {
    pixels: Vec<usize>,
    /// Fraction of the disc inside the image.
    inside: f64,
}

impl Disc {
    fn of(press: &LabelledPress) -> Self {
        let distance = CentreDistance::new(press);
        let count = (press.image.width() * press.image.height()) as usize;
        let pixels: Vec<usize> = (0..count)
            .filter(|i| distance.at(*i) < press.radius_px)
            .collect();
        let area = std::f64::consts::PI * press.radius_px * press.radius_px;
        Self {
            inside: pixels.len() as f64 / area.max(1.0),
            pixels,
        }
    }

    fn saturated(&self, press: &LabelledPress, no_contact: &RgbImage) -> f64 {
        let at_end = |level: u8| level == 0 || level == 255;
        let (real, free) = (press.image.as_raw(), no_contact.as_raw());
        let values = self.pixels.iter().flat_map(|i| 3 * i..3 * i + 3);
        let count = values
            .filter(|v| at_end(real[*v]) && !at_end(free[*v]))
            .count();
        count as f64 / (3 * self.pixels.len()).max(1) as f64
    }

    /// Maximum over the channels of the RMS change.
    fn rms(&self, change: &[Vec<f32>; 3]) -> f64 {
        let count = self.pixels.len().max(1) as f64;
        change
            .iter()
            .map(|plane| {
                let square: f64 = self
                    .pixels
                    .iter()
                    .map(|i| f64::from(plane[*i]).powi(2))
                    .sum();
                (square / count).sqrt()
            })
            .fold(0.0, f64::max)
    }
}
