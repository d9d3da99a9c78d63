//! Camera intrinsics and their file.

use std::path::Path;

use serde::{Deserialize, Serialize};

use gripcast_base::error::{Error, Result};
use gripcast_base::files::{FileKind, read_text, save};

/// Distortion model of a lens.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum DistortionModel {
    /// No distortion.
    None,
    /// Brown–Conrady from ideal to distorted coordinates (OpenCV; `plumb_bob` of ROS).
    BrownConrady,
    /// Brown–Conrady from distorted to ideal coordinates (D435 colour).
    InverseBrownConrady,
}

/// Pinhole intrinsics for an image size, in its pixels.
///
/// Pixel (0,0) is the centre of the top-left pixel; camera frame x right, y down, z forward.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Intrinsics {
    /// Width of the image.
    pub width: u32,
    /// Height of the image.
    pub height: u32,
    /// Focal length along x.
    pub fx: f64,
    /// Focal length along y.
    pub fy: f64,
    /// Principal point, x.
    pub cx: f64,
    /// Principal point, y.
    pub cy: f64,
    /// Distortion model.
    pub model: DistortionModel,
    /// Coefficients k1, k2, p1, p2, k3.
    pub coefficients: [f64; 5],
}

impl Intrinsics {
    /// Reads a TOML file.
    ///
    /// # Errors
    /// When the file cannot be read, or `Config` for invalid intrinsics.
    pub fn load(path: &Path) -> Result<Self> {
        let text = read_text(path, FileKind::Record)
            .map_err(|e| Error::io("cannot read the intrinsics", e).at(path.display()))?;
        let read: Self = toml::from_str(&text)
            .map_err(|e| Error::config(e.message().trim().to_owned()).at(path.display()))?;
        read.validate().map_err(|error| error.at(path.display()))
    }

    /// Writes a TOML file.
    ///
    /// # Errors
    /// When the file cannot be written.
    pub fn save(&self, path: &Path) -> Result<()> {
        let text = toml::to_string(self)
            .map_err(|e| Error::internal("cannot write intrinsics as TOML").because(e))?;
        save(path, text.as_bytes())
    }

    /// Checks focal length and principal point for plausibility.
    ///
    /// # Errors
    /// `Config` for implausible intrinsics.
    pub fn validate(self) -> Result<Self> {
        let largest = f64::from(self.width.max(self.height));
        let focal = |f: f64| f > 0.05 * largest && f < 50.0 * largest;
        let inside = |c: f64, side: u32| c > -0.5 * f64::from(side) && c < 1.5 * f64::from(side);
        let plausible = self.width > 0
            && self.height > 0
            && focal(self.fx)
            && focal(self.fy)
            && inside(self.cx, self.width)
            && inside(self.cy, self.height)
            && self.coefficients.iter().all(|c| c.is_finite());
        if plausible {
            return Ok(self);
        }
        Err(Error::config(format!(
            "implausible intrinsics for {}×{} pixels: focal length {:.1}, {:.1}, principal \
                 point {:.1}, {:.1}",
            self.width, self.height, self.fx, self.fy, self.cx, self.cy
        ))
        .remedy("give fx, fy, cx, cy in pixels of this image size"))
    }
}

#[cfg(test)]
mod tests {
    use std::fs;

    use super::*;

    #[test]
    fn file_round_trips() {
        let directory = tempfile::tempdir().unwrap();
        let path = directory.path().join("rgb.toml");
        let intrinsics = Intrinsics {
            width: 1280,
            height: 720,
            fx: 912.5,
            fy: 911.75,
            cx: 640.2,
            cy: 361.9,
            model: DistortionModel::InverseBrownConrady,
            coefficients: [0.1, -0.2, 0.001, 0.0, 0.05],
        };
        intrinsics.save(&path).unwrap();
        assert_eq!(Intrinsics::load(&path).unwrap(), intrinsics);
        for (from, to, expected) in [
            ("fx = 912.5", "fx = 0.9125", "implausible"),
            ("fx = 912.5", "fx = nan", "implausible"),
            ("fy = ", "focal = ", "unknown field `focal`"),
            ("inverse-brown-conrady", "fisheye", "unknown variant"),
        ] {
            let text = fs::read_to_string(&path).unwrap();
            let bad = directory.path().join("bad.toml");
            fs::write(&bad, text.replace(from, to)).unwrap();
            let error = Intrinsics::load(&bad).unwrap_err();
            assert!(error.to_string().contains(expected), "{error}");
        }
    }
}
