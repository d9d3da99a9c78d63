//! Files that keep a camera's intrinsics: gripcast's own, and those of ROS, OpenCV and Kalibr.
//!
//! All of them have the same pinhole camera with k1, k2, p1, p2, k3 (Brown–Conrady) and the same
//! pixel convention as [`Intrinsics`]. What has another lens model is refused by its name, and
//! nothing is scaled to another image size: intrinsics belong to one.
//!
//! OpenCV's XML and JSON are not read.

mod kalibr;
mod lens;
mod opencv;
mod ros;
mod write;

use std::path::Path;

pub use write::{to_opencv, to_ros};

use gripcast_base::error::{Error, Result};
use gripcast_base::files::{FileKind, read_regular};
use gripcast_imaging::Intrinsics;

/// Formats of camera files.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum CameraFormat {
    /// gripcast's own.
    Toml,
    /// `camera_info` of ROS, YAML.
    Ros,
    /// OpenCV's `FileStorage`, YAML.
    Opencv,
    /// `camchain.yaml` of Kalibr; read only.
    Kalibr,
}

/// A camera file that was read.
#[derive(Clone, Debug, PartialEq)]
pub struct CameraFile {
    /// What it was.
    pub format: CameraFormat,
    /// The camera.
    pub intrinsics: Intrinsics,
    /// What the file calls the camera.
    pub camera_name: Option<String>,
    /// Reprojection error of the calibration, px.
    pub rms_px: Option<f64>,
    /// What a person should know about it.
    pub notes: Vec<String>,
}

/// What the reader is told beyond the file.
#[derive(Clone, Copy, Debug, Default)]
pub struct CameraChoice<'a> {
    /// Width and height for a file that does not have them; in others it has to agree, px.
    pub size: Option<[u32; 2]>,
    /// Which camera of a file with several.
    pub camera: Option<&'a str>,
}

impl CameraFormat {
    /// Its name on the command line.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Toml => "toml",
            Self::Ros => "ros",
            Self::Opencv => "opencv",
            Self::Kalibr => "kalibr",
        }
    }

    /// What a text is, by its content.
    ///
    /// # Errors
    /// `Input` for what is none of them.
    pub fn recognise(text: &str) -> Result<Self> {
        let text = text.trim_start_matches('\u{feff}');
        let start = text.trim_start();
        if start.starts_with('<') || start.starts_with('{') {
            let what = "XML and JSON of OpenCV's FileStorage are not read";
            return Err(Error::input(what)
                .remedy("write it as YAML: a file name that ends in .yml does that in OpenCV"));
        }
        if start.starts_with("%YAML:") || text.contains("!!opencv-matrix") {
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
        if has_line(&|line| line.starts_with("camera_matrix:")) {
            return Ok(Self::Ros);
        }
        let is_assignment = |line: &str| {
            let key = line.split_once('=').map(|(key, _)| key.trim());
            let is_word = |b: u8| b.is_ascii_alphanumeric() || b == b'_';
            key.is_some_and(|key| !key.is_empty() && key.bytes().all(is_word))
        };
        if has_line(&is_assignment) {
            return Ok(Self::Toml);
        }
        Err(Error::input("this is no camera file that is known").remedy(
            "give gripcast's TOML, camera_info YAML of ROS, YAML of OpenCV's FileStorage with \
             camera_matrix, or camchain.yaml of Kalibr",
        ))
    }
}

impl CameraFile {
    /// Reads a file of any known format.
    ///
    /// # Errors
    /// As [`Self::parse`], and that of the operating system.
    pub fn load(path: &Path, choice: CameraChoice<'_>) -> Result<Self> {
        let bytes = read_regular(path, FileKind::Record)
            .map_err(|e| Error::io("cannot read the camera file", e).at(path.display()))?;
        let text = String::from_utf8(bytes).map_err(|_| Error::input("the camera file is no text"));
        text.and_then(|text| Self::parse(&text, choice))
            .map_err(|e| e.at(path.display()))
    }

    /// Reads the text of a file.
    ///
    /// # Errors
    /// `Input` or `Config`: what is missing or wrong, or which lens model is not known.
    pub fn parse(text: &str, choice: CameraChoice<'_>) -> Result<Self> {
        let format = CameraFormat::recognise(text)?;
        let foreign = match format {
            CameraFormat::Toml => None,
            CameraFormat::Ros => Some(ros::read(text)?),
            CameraFormat::Opencv => Some(opencv::read(text)?),
            CameraFormat::Kalibr => Some(kalibr::read(text, choice.camera)?),
        };
        let intrinsics = match &foreign {
            Some(foreign) => foreign.intrinsics(choice.size).map_err(|e| {
                match foreign.camera_name.as_deref() {
                    // A camchain has several.
                    Some(name) if format == CameraFormat::Kalibr => e.at(name),
                    _ => e,
                }
            })?,
            None => toml::from_str(text).map_err(|e| Error::config(e.message().trim()))?,
        };
        let intrinsics = intrinsics.validate()?;
        if let Some([width, height]) = choice.size {
            require_size(&intrinsics, width, height)?;
        }
        let foreign = foreign.unwrap_or_default();
        Ok(Self {
            format,
            intrinsics,
            camera_name: foreign.camera_name,
            rms_px: foreign.rms_px,
            notes: foreign.notes,
        })
    }
}

/// Reads intrinsics from gripcast's TOML, or from a file of ROS, OpenCV or Kalibr: the content
/// decides.
///
/// # Errors
/// As [`CameraFile::load`].
pub fn load_intrinsics(path: &Path) -> Result<Intrinsics> {
    Ok(CameraFile::load(path, CameraChoice::default())?.intrinsics)
}

/// Refuses intrinsics of another image size than `width` × `height` px. They are not scaled:
/// drivers crop as often as they scale, and a wrong guess moves every pose unnoticed.
///
/// # Errors
/// `Input` with both sizes; the caller adds the image's name.
pub fn require_size(intrinsics: &Intrinsics, width: u32, height: u32) -> Result<()> {
    if (intrinsics.width, intrinsics.height) == (width, height) {
        return Ok(());
    }
    Err(Error::input(format!(
        "the intrinsics are for images of {}×{} pixels, and this is one of {width}×{height}",
        intrinsics.width, intrinsics.height
    ))
    .remedy(format!(
        "calibrate at {width}×{height}, or take images of {}×{}; intrinsics are not scaled",
        intrinsics.width, intrinsics.height
    )))
}

#[cfg(test)]
mod camera_file_test;
