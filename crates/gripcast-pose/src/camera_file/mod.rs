//! Camera intrinsics files of gripcast, ROS, OpenCV and Kalibr.
//!
//! All describe a pinhole camera with k1, k2, p1, p2, k3 (Brown–Conrady, `plumb_bob`) and use the
//! pixel convention of [`Intrinsics`]. Other distortion models are rejected. Intrinsics are not
//! scaled to other image sizes.

mod kalibr;
mod lens;
mod matrices;
mod node;
mod write;

use std::path::Path;

pub use write::{to_opencv, to_ros};

use lens::ForeignCamera;

use gripcast_base::error::{Error, Result};
use gripcast_base::files::{FileKind, read_regular};
use gripcast_imaging::Intrinsics;

/// Format of a camera file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum CameraFormat {
    /// gripcast's TOML.
    Toml,
    /// `camera_info` of ROS, YAML.
    Ros,
    /// OpenCV's `FileStorage` in YAML, XML or JSON, or its keys in plain YAML.
    Opencv,
    /// `camchain.yaml` of Kalibr; read only.
    Kalibr,
}

/// A parsed camera file.
#[derive(Clone, Debug, PartialEq)]
pub struct CameraFile {
    /// Its format.
    pub format: CameraFormat,
    /// The intrinsics.
    pub intrinsics: Intrinsics,
    /// Camera name given in the file.
    pub camera_name: Option<String>,
    /// Reprojection error of the calibration, px.
    pub rms_px: Option<f64>,
    /// Notes for the user.
    pub notes: Vec<String>,
}

/// What the file itself may not say.
#[derive(Clone, Copy, Debug, Default)]
pub struct CameraReadOptions<'a> {
    /// Image width and height, px, for files without them; must agree with the file otherwise.
    pub size: Option<[u32; 2]>,
    /// Name of the camera in a file with several.
    pub camera: Option<&'a str>,
}

impl CameraFormat {
    /// Name on the command line.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Toml => "toml",
            Self::Ros => "ros",
            Self::Opencv => "opencv",
            Self::Kalibr => "kalibr",
        }
    }

    /// Detects the format of a text.
    ///
    /// # Errors
    /// `Input` for an unknown format.
    pub fn detect(text: &str) -> Result<Self> {
        let text = text.trim_start_matches('\u{feff}');
        let start = text.trim_start();
        let is_opencv = start.starts_with(['<', '{']) || start.starts_with("%YAML:");
        if is_opencv || text.contains("!!opencv-matrix") {
            return Ok(Self::Opencv);
        }
        let has_line = |test: &dyn Fn(&str) -> bool| text.lines().any(test);
        let is_camera = |line: &str| {
            let number = line.strip_prefix("cam").and_then(|l| l.split_once(':'));
            number.is_some_and(|(n, _)| !n.is_empty() && n.bytes().all(|b| b.is_ascii_digit()))
        };
        if has_line(&is_camera) {
            return Ok(Self::Kalibr);
        }
        let has_key = |keys: &[&str]| {
            let key = |line: &str| {
                line.split_once(':')
                    .map(|(key, _)| key.trim_end().to_owned())
            };
            has_line(&|line| key(line).is_some_and(|key| keys.contains(&&*key)))
        };
        if has_key(&[
            "distortion_model",
            "rectification_matrix",
            "projection_matrix",
        ]) {
            return Ok(Self::Ros);
        }
        if has_key(&[
            "camera_matrix",
            "cameraMatrix",
            "intrinsic_matrix",
            "mtx",
            "K",
            "k",
        ]) {
            return Ok(Self::Opencv);
        }
        let is_assignment = |line: &str| {
            let key = line.split_once('=').map(|(key, _)| key.trim());
            let is_word = |b: u8| b.is_ascii_alphanumeric() || b == b'_';
            key.is_some_and(|key| !key.is_empty() && key.bytes().all(is_word))
        };
        if has_line(&is_assignment) {
            return Ok(Self::Toml);
        }
        Err(Error::input("unknown camera file format").remedy(
            "supported: gripcast's TOML, camera_info YAML of ROS, OpenCV FileStorage (YAML, XML, \
             JSON) with camera_matrix, camchain.yaml of Kalibr",
        ))
    }
}

impl CameraFile {
    /// Reads a file of any supported format.
    ///
    /// # Errors
    /// As [`Self::parse`], and IO errors.
    pub fn load(path: &Path, options: CameraReadOptions<'_>) -> Result<Self> {
        let bytes = read_regular(path, FileKind::Record)
            .map_err(|e| Error::io("cannot read the camera file", e).at(path.display()))?;
        let text =
            String::from_utf8(bytes).map_err(|_| Error::input("the camera file is not UTF-8 text"));
        text.and_then(|text| Self::parse(&text, options))
            .map_err(|e| e.at(path.display()))
    }

    /// Parses the text of a file.
    ///
    /// # Errors
    /// `Input` or `Config` for missing or invalid entries and unsupported distortion models.
    pub fn parse(text: &str, options: CameraReadOptions<'_>) -> Result<Self> {
        let format = CameraFormat::detect(text)?;
        let mut foreign = ForeignCamera::default();
        let intrinsics: Intrinsics = if format == CameraFormat::Toml {
            toml::from_str(text).map_err(|e| Error::config(e.message().trim()))?
        } else {
            foreign = match format {
                CameraFormat::Kalibr => kalibr::read(text, options.camera)?,
                CameraFormat::Opencv => matrices::read_opencv(text)?,
                _ => matrices::read_ros(text)?,
            };
            foreign.intrinsics(options.size).map_err(|e| {
                match foreign.camera_name.as_deref() {
                    // A camchain lists several cameras.
                    Some(name) if format == CameraFormat::Kalibr => e.at(name),
                    _ => e,
                }
            })?
        };
        let intrinsics = intrinsics.validate()?;
        if let Some([width, height]) = options.size {
            require_size(&intrinsics, width, height)?;
        }
        Ok(Self {
            format,
            intrinsics,
            camera_name: foreign.camera_name,
            rms_px: foreign.rms_px,
            notes: foreign.notes,
        })
    }
}

/// Reads intrinsics from a file of any supported format.
///
/// # Errors
/// As [`CameraFile::load`].
pub fn load_intrinsics(path: &Path) -> Result<Intrinsics> {
    Ok(CameraFile::load(path, CameraReadOptions::default())?.intrinsics)
}

/// Requires intrinsics for images of `width` × `height` px. Intrinsics are not scaled: drivers crop
/// as often as they scale, and a wrong guess biases every pose unnoticed.
///
/// # Errors
/// `Input` with both sizes; the caller adds the name of the image.
pub fn require_size(intrinsics: &Intrinsics, width: u32, height: u32) -> Result<()> {
    if (intrinsics.width, intrinsics.height) == (width, height) {
        return Ok(());
    }
    Err(Error::input(format!(
        "the intrinsics are for {}×{} px images, the image is {width}×{height} px",
        intrinsics.width, intrinsics.height
    ))
    .remedy(format!(
        "calibrate at {width}×{height}, or use images of {}×{}; intrinsics are not scaled",
        intrinsics.width, intrinsics.height
    )))
}

#[cfg(test)]
mod camera_file_test;
#[cfg(test)]
mod dialects_test;
