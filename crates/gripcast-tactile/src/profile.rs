//! Sensor profile: all parameters of the tactile renderer for one sensor.
//!
//! A profile is a TOML file (`calib/sensors/<serial>.toml`) written by the calibration, with the
//! background image as PNG beside it. The file also contains a smooth fit of the background, so
//! that it works alone.

use std::io;
use std::path::Path;

use image::RgbImage;
use serde::{Deserialize, Serialize};

use super::background::BackgroundFit;
use super::ensure;
use super::led::LedShading;
use super::markers;
use super::noise::Drift;
use super::press_depth::SensorGeometry;
use super::profile_gel::ProfileGel;
use super::shading::PolynomialShading;
use super::smooth::Smoothing;
use gripcast_base::error::{Error, Result};
use gripcast_base::files::{FileKind, FileName, Root, StagedFile, read_text};
use gripcast_base::random::SeedStream;
use gripcast_imaging::{CropProfile, decode_png_rgb, encode_png_rgb};
use gripcast_shear::{ExpectedMarkers, MarkerPattern};

/// Version of the file format.
const SCHEMA: u32 = 1;
/// Maximum width or height of an image, px.
const MAX_SIDE: usize = 4096;
/// Plausible pixel sizes, m.
const PIXEL_M: std::ops::RangeInclusive<f64> = 1e-6..=1e-3;
/// Plausible gel thicknesses, m.
const THICKNESS_M: std::ops::RangeInclusive<f64> = 1e-4..=0.05;
/// Plausible frame rates, Hz.
const FRAME_RATE_HZ: std::ops::RangeInclusive<f64> = 1.0..=1000.0;

/// Shading model: how slopes change the light.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(tag = "model", rename_all = "snake_case")]
pub enum ShadingModel {
    /// Polynomial of normal and position.
    Polynomial(PolynomialShading),
    /// Near point lights (LEDs).
    Leds(LedShading),
}

impl ShadingModel {
    fn validate(&self) -> Result<()> {
        match self {
            Self::Polynomial(shading) => shading.validate(),
            Self::Leds(shading) => shading.validate(),
        }
    }

    /// Tilt of the normal (x, y), of length 1, that brightens red, green and blue most.
    pub(super) fn brightening_slope(&self) -> [[f64; 2]; 3] {
        match self {
            Self::Polynomial(shading) => shading.brightening_slope(),
            Self::Leds(shading) => shading.brightening_slope(),
        }
    }
}

/// Background: image of the untouched gel.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Background {
    /// File name of the PNG image beside the profile; without it the fit is used.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub file: Option<FileName>,
    /// Smooth fit of the image.
    pub fit: BackgroundFit,
    /// The image, once loaded.
    #[serde(skip)]
    pub image: Option<RgbImage>,
}

/// All parameters of the tactile renderer for a sensor.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SensorProfile {
    /// Version of the format, 1.
    pub schema: u32,
    /// Name of the profile, as its file.
    pub name: String,
    /// USB serial of the sensor; empty for a generic profile.
    #[serde(default, skip_serializing_if = "String::is_empty")]
    pub serial: String,
    /// Crop of the camera frames that yields such images.
    #[serde(with = "crop_name")]
    pub crop_profile: CropProfile,
    /// Origin of the parameters.
    pub provenance: String,
    /// Standard deviation of the camera noise in red, green, blue, grey levels.
    pub noise_std: [f64; 3],
    /// Frames per second of the sensor's camera, if known.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub frame_rate_hz: Option<f64>,
    /// Pixel grid, scale and thickness of the gel.
    pub geometry: SensorGeometry,
    /// Pad and elastic law of the gel.
    #[serde(default)]
    pub gel: ProfileGel,
    /// Gel markers; absent for a gel without.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub markers: Option<MarkerPattern>,
    /// Gel shape around a contact.
    pub smoothing: Smoothing,
    /// Drift between frames.
    pub drift: Drift,
    /// Shading model.
    pub shading: ShadingModel,
    /// Background.
    pub background: Background,
    /// Presses that the profile was fitted to; empty if they are not recorded.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub fitted_to: Vec<FittedPress>,
}

/// A press that a profile was fitted to, by which later scores tell it from held-out presses.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct FittedPress {
    /// File name.
    pub file: String,
    /// SHA-256 of the file, 64 hex digits.
    pub sha256: String,
}

impl SensorProfile {
    /// Parses a profile; its background is the smooth fit.
    ///
    /// # Errors
    /// `Config` for another schema version, unknown or missing keys, values out of range.
    pub fn from_toml(text: &str) -> Result<Self> {
        let profile: Self = toml::from_str(text)
            .map_err(|cause| Error::config("cannot parse the sensor profile").because(cause))?;
        profile.validate()?;
        Ok(profile)
    }

    /// Reads a profile and its background image.
    ///
    /// # Errors
    /// `NotFound`, `Permission`, `Io` if a file cannot be read; `Config` as
    /// [`SensorProfile::from_toml`]; `Input` if the image is invalid or of another size.
    pub fn load(path: &Path) -> Result<Self> {
        let text = read_text(path, FileKind::Record).map_err(|e| {
            Error::io("cannot read the sensor profile", e)
                .at(path.display())
                .remedy("check the path, or create a profile with `gripcast render calibrate`")
        })?;
        let mut profile = Self::from_toml(&text).map_err(|e| e.at(path.display()))?;
        if let Some(name) = &profile.background.file {
            let beside = Root::beside(path).join(name);
            let bytes = beside.read(FileKind::Image).map_err(|e| {
                Error::io("cannot read the background image", e)
                    .at(beside.display())
                    .remedy(format!(
                        "put it beside the profile, or delete the line `file = {:?}` to use \
                         the smooth fit",
                        name.as_str()
                    ))
            })?;
            profile.background.image =
                Some(decode_png_rgb(&bytes).map_err(|e| e.at(beside.display()))?);
            profile.check_image().map_err(|e| e.at(beside.display()))?;
        }
        Ok(profile)
    }

    /// Writes the profile and, if it has one, the background image beside it as
    /// `<stem>.background.png`.
    ///
    /// # Errors
    /// `Config` if the profile is invalid; the error of the operating system if a file cannot be
    /// written, in which case the old files are kept.
    pub fn save(&self, path: &Path) -> Result<()> {
        let mut profile = self.clone();
        let stem = path.file_stem().unwrap_or_default().to_string_lossy();
        profile.background.file = self
            .background
            .image
            .as_ref()
            .map(|_| FileName::nearest(&format!("{stem}.background.png")));
        profile.validate()?;
        profile.check_image()?;
        let mut files = Vec::new();
        if let (Some(name), Some(image)) = (&profile.background.file, &self.background.image) {
            files.push((path.with_file_name(name.as_str()), encode_png_rgb(image)?));
        }
        files.push((path.to_owned(), profile.to_toml()?.into_bytes()));
        // All files are staged before the first is committed, since they belong together.
        let mut staged = Vec::new();
        for (path, bytes) in files {
            let file = StagedFile::write(&path, &bytes).map_err(|e| not_written(&path, e))?;
            staged.push((path, file));
        }
        for (path, file) in staged {
            file.commit().map_err(|e| not_written(&path, e))?;
        }
        Ok(())
    }

    /// Serialises the profile.
    ///
    /// # Errors
    /// None for a valid profile.
    pub fn to_toml(&self) -> Result<String> {
        toml::to_string(self)
            .map_err(|cause| Error::internal("cannot serialise the sensor profile").because(cause))
    }

    /// Checks all values.
    ///
    /// # Errors
    /// `Config` with the key, the expected and the found value.
    pub fn validate(&self) -> Result<()> {
        if self.schema != SCHEMA {
            return Err(
                invalid(format!("schema must be {SCHEMA}, found {}", self.schema))
                    .remedy("recalibrate the sensor with this version of gripcast"),
            );
        }
        let grid = &self.geometry;
        for (key, side) in [("width", grid.width), ("height", grid.height)] {
            ensure((2..=MAX_SIDE).contains(&side), || {
                invalid(format!(
                    "geometry.{key} must be 2 to {MAX_SIDE} pixels, found {side}"
                ))
            })?;
        }
        in_range("geometry.pixel_m", grid.pixel_m, PIXEL_M)?;
        in_range(
            "geometry.gel_thickness_m",
            grid.gel_thickness_m,
            THICKNESS_M,
        )?;
        for (key, values) in [
            ("noise_std", self.noise_std),
            ("drift.gain_std", self.drift.gain_std),
            ("drift.offset_std", self.drift.offset_std),
            ("drift.pivot", self.drift.pivot),
        ] {
            for value in values {
                in_range(key, value, 0.0..=255.0)?;
            }
        }
        if let Some(rate_hz) = self.frame_rate_hz {
            in_range("frame_rate_hz", rate_hz, FRAME_RATE_HZ)?;
        }
        self.gel.validate()?;
        if let Some(pattern) = &self.markers {
            markers::validate(pattern, grid.pixel_m, grid.gel_thickness_m)?;
        }
        self.smoothing.validate(grid.pixel_m)?;
        self.shading.validate()?;
        self.background.fit.validate()
    }

    /// Its gel markers.
    ///
    /// # Errors
    /// `Config` for a gel without.
    pub fn marker_pattern(&self) -> Result<&MarkerPattern> {
        self.markers.as_ref().ok_or_else(|| {
            let what = format!("the sensor profile `{}` has no gel markers", self.name);
            Error::config(what).remedy(
                "use --profile gelsight-mini-markers, or a profile with a table `[markers]`",
            )
        })
    }

    /// What the tracker expects in its images.
    #[must_use]
    pub fn expected_markers(&self) -> ExpectedMarkers<'_> {
        let pattern = self.markers.as_ref();
        pattern.map_or(ExpectedMarkers::None, ExpectedMarkers::Pattern)
    }

    /// Seed of what differs between gels of a kind: equal for equal names and serials.
    pub(super) fn gel_seed(&self) -> u64 {
        SeedStream::named(0, &format!("gel {} {}", self.name, self.serial)).bits()
    }

    pub(super) fn check_image(&self) -> Result<()> {
        let Some(image) = &self.background.image else {
            return Ok(());
        };
        let [width, height] = [image.width(), image.height()];
        let (columns, rows) = (self.geometry.width, self.geometry.height);
        ensure((columns, rows) == (width as usize, height as usize), || {
            Error::input(format!(
                "the background image must be {columns}×{rows} pixels as in the profile's \
                 geometry, found {width}×{height}"
            ))
        })
    }
}

pub(super) fn invalid(what: String) -> Error {
    Error::config(format!("sensor profile: {what}"))
}

pub(super) fn in_range(key: &str, value: f64, range: std::ops::RangeInclusive<f64>) -> Result<()> {
    let (low, high) = (range.start(), range.end());
    ensure(range.contains(&value), || {
        invalid(format!("{key} must be {low} to {high}, found {value}"))
    })
}

fn not_written(path: &Path, cause: io::Error) -> Error {
    Error::io("cannot write the sensor profile", cause)
        .at(path.display())
        .remedy("choose a file in an existing, writable folder")
}

/// Serialises a crop profile by its name.
mod crop_name {
    use serde::{Deserialize, Deserializer, Serializer, de::Error as _};

    use gripcast_imaging::CropProfile;

    pub(super) fn serialize<S: Serializer>(crop: &CropProfile, s: S) -> Result<S::Ok, S::Error> {
        s.serialize_str(crop.name())
    }

    pub(super) fn deserialize<'de, D: Deserializer<'de>>(d: D) -> Result<CropProfile, D::Error> {
        CropProfile::by_name(&String::deserialize(d)?).map_err(D::Error::custom)
    }
}

#[cfg(test)]
mod tests {
    use std::fs;

    use super::*;
    use gripcast_base::error::ErrorKind;

    #[test]
    fn builtin_profile_is_valid_and_round_trips() {
        let profile = SensorProfile::gelsight_mini().unwrap();
        assert_eq!(
            (profile.geometry.width, profile.geometry.height),
            (320, 240)
        );
        assert!(!profile.provenance.is_empty());
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("2BNN-4ZE7.toml");
        profile.save(&path).unwrap();
        let back = SensorProfile::load(&path).unwrap();
        assert_eq!(
            back.background.file.as_deref(),
            Some("2BNN-4ZE7.background.png")
        );
        assert_eq!(back.background.image, profile.background.image);
        assert_eq!(back.shading, profile.shading);
        assert_eq!(back.smoothing, profile.smoothing);
    }

    #[test]
    fn led_shading_round_trips() {
        let mut profile = SensorProfile::gelsight_mini().unwrap();
        profile.shading = ShadingModel::Leds(LedShading::mini_guess());
        let back = SensorProfile::from_toml(&profile.to_toml().unwrap()).unwrap();
        assert_eq!(back.shading, profile.shading);
    }

    #[test]
    fn invalid_profile_error_names_the_key() {
        let good = SensorProfile::gelsight_mini().unwrap().to_toml().unwrap();
        for (from, to, expected) in [
            ("schema = 1", "schema = 2", "schema must be 1"),
            ("noise_std", "noise_sdt", "noise_sdt"),
            ("gsmini-seventh-v1", "gsmini-sevenths", "gsmini-seventh-v1"),
            ("pixel_m = ", "pixel_m = 10", "pixel_m"),
            ("width = 320", "width = 0", "width"),
            ("model = \"polynomial\"", "model = \"neural\"", "neural"),
            ("sigma_m = ", "sigma_m = -", "sigma_m"),
        ] {
            assert!(good.contains(from), "{from}");
            let text = SensorProfile::from_toml(&good.replacen(from, to, 1))
                .unwrap_err()
                .to_string();
            assert!(text.contains(expected), "{from}: {text}");
        }
    }

    #[test]
    fn missing_or_invalid_files_are_explained() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.toml");
        assert_eq!(
            SensorProfile::load(&path).unwrap_err().kind(),
            ErrorKind::NotFound
        );
        let profile = SensorProfile::gelsight_mini().unwrap();
        profile.save(&path).unwrap();
        let image = folder.path().join("a.background.png");
        fs::write(&image, b"no image").unwrap();
        let text = SensorProfile::load(&path).unwrap_err().to_string();
        assert!(text.contains("a.background.png"), "{text}");
        fs::write(&image, encode_png_rgb(&RgbImage::new(10, 10)).unwrap()).unwrap();
        let text = SensorProfile::load(&path).unwrap_err().to_string();
        assert!(text.contains("found 10×10"), "{text}");
        fs::remove_file(&image).unwrap();
        let text = SensorProfile::load(&path).unwrap_err().to_string();
        assert!(text.contains("smooth fit"), "{text}");
        let nowhere = folder.path().join("no/such/a.toml");
        assert!(profile.save(&nowhere).is_err());
    }

    #[test]
    fn failed_save_keeps_old_image() {
        let folder = tempfile::tempdir().unwrap();
        let mut profile = SensorProfile::gelsight_mini().unwrap();
        let image = folder.path().join("a.background.png");
        fs::write(&image, b"old").unwrap();
        // No file can have this name, but the image can have its own.
        std::os::unix::fs::symlink("no/such/a.toml", folder.path().join("a.toml")).unwrap();
        profile.background.image = Some(RgbImage::new(320, 240));
        assert!(profile.save(&folder.path().join("a.toml")).is_err());
        assert_eq!(fs::read(&image).unwrap(), b"old");
        assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 2);
    }
}
