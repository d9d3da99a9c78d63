//! Files with a camera matrix and distortion coefficients: `camera_info` of ROS as calibration
//! programs save it and as `rostopic echo` prints it, `FileStorage` of OpenCV in YAML, XML and JSON,
//! and the same numbers written by Python scripts.
//!
//! Keys are compared without case and underscores.

use super::lens::{ForeignCamera, Matrix, unsupported};
use super::node::{Node, from_xml};
use crate::yaml;
use gripcast_base::error::{Error, Result};

/// Tolerance for the rectification matrix to be the identity: a rotation by 10 µrad.
const TOLERANCE: f64 = 1e-5;
const CAMERA_MATRIX: &[&str] = &["cameramatrix", "intrinsicmatrix", "k", "mtx"];
const COEFFICIENTS: &[&str] = &[
    "distortioncoefficients",
    "distortioncoeffs",
    "distcoeffs",
    "distcoeff",
    "d",
    "dist",
];
const WIDTH: &[&str] = &["imagewidth", "width"];
const HEIGHT: &[&str] = &["imageheight", "height"];
const SIZE: &[&str] = &["imagesize", "resolution"];
const RMS: &[&str] = &["avgreprojectionerror", "reprojectionerror", "rms"];

/// Reads a `camera_info` of ROS.
pub(super) fn read_ros(text: &str) -> Result<ForeignCamera> {
    let file = File::parse(text, "the camera_info")?;
    let mut camera = file.camera()?;
    file.set_model(&mut camera, true)?;
    if let Some(matrix) = file.matrix("rectification_matrix", &["rectificationmatrix", "r"])? {
        check_rectification(&matrix.shaped("rectification_matrix", [3, 3])?)?;
    }
    if let Some(matrix) = file.matrix("projection_matrix", &["projectionmatrix", "p"])? {
        camera
            .notes
            .extend(projection_note(&matrix, &camera.matrix)?);
    }
    file.apply_binning_and_roi(&mut camera)?;
    Ok(camera)
}

/// Reads a `FileStorage` of OpenCV, or the same keys in plain YAML.
pub(super) fn read_opencv(text: &str) -> Result<ForeignCamera> {
    let file = File::parse(text, "the OpenCV camera file")?;
    let model = file.find(&["fisheyemodel", "fisheye"])?;
    let is_fisheye = match model.and_then(Node::number) {
        Some(flag) => flag != 0.0,
        // Older samples say so in the comment on their flags only.
        None => text.to_ascii_lowercase().contains("fisheye"),
    };
    if is_fisheye {
        return Err(unsupported("OpenCV fisheye model"));
    }
    let mut camera = file.camera()?;
    file.set_model(&mut camera, false)?;
    Ok(camera)
}

/// Entries of a file with their keys in lower case without underscores.
struct File(Vec<(String, String, Node)>);

impl File {
    fn parse(text: &str, what: &str) -> Result<Self> {
        let node: Node = if text.trim_start().starts_with('<') {
            from_xml(text)?
        } else {
            yaml::read(text, what)?
        };
        let Node::Map(entries) = node else {
            return Err(Error::input(format!("cannot read {what}: it has no keys")));
        };
        let plain = |key: &str| key.to_ascii_lowercase().replace(['_', '-', ' '], "");
        let entries = entries
            .into_iter()
            .map(|(key, node)| (plain(&key), key, node));
        Ok(Self(entries.collect()))
    }

    /// The entry with one of the keys.
    fn find(&self, keys: &[&str]) -> Result<Option<&Node>> {
        let mut found: Option<(&str, &Node)> = None;
        for (plain, key, node) in &self.0 {
            if !keys.contains(&&**plain) || *node == Node::Null {
                continue;
            }
            match found {
                Some((other, first)) if first != node => {
                    let what = format!("`{other}` and `{key}` differ, and mean the same");
                    return Err(Error::input(what).remedy("delete one of them"));
                }
                _ => found = Some((key, node)),
            }
        }
        Ok(found.map(|(_, node)| node))
    }

    fn text(&self, keys: &[&str]) -> Result<Option<String>> {
        Ok(self.find(keys)?.and_then(Node::text))
    }

    fn matrix(&self, name: &str, keys: &[&str]) -> Result<Option<Matrix>> {
        let node = self.find(keys)?;
        node.map(|node| Matrix::from_node(name, node)).transpose()
    }

    /// A number of pixels.
    fn pixels(&self, name: &str, node: Option<&Node>) -> Result<Option<u32>> {
        let Some(node) = node else { return Ok(None) };
        let value = node.number();
        let pixels = value.filter(|v| (0.0..=65_535.0).contains(v) && v.fract() == 0.0);
        match pixels {
            Some(pixels) => Ok(Some(pixels as u32)),
            None => Err(Error::input(format!(
                "{name} must be a number of pixels, found {}",
                value.map_or_else(|| node.text().unwrap_or_default(), |v| v.to_string())
            ))),
        }
    }

    fn size(&self) -> Result<Option<[u32; 2]>> {
        let width = self.pixels("image_width", self.find(WIDTH)?)?;
        let height = self.pixels("image_height", self.find(HEIGHT)?)?;
        if let (Some(width), Some(height)) = (width, height) {
            return Ok(Some([width, height]));
        }
        let Some(Node::List(size)) = self.find(SIZE)? else {
            return Ok(None);
        };
        let [width, height] = &size[..] else {
            return Err(Error::input("image_size must be [width, height]"));
        };
        let width = self.pixels("image_size", Some(width))?;
        let height = self.pixels("image_size", Some(height))?;
        Ok(width.zip(height).map(<[u32; 2]>::from))
    }

    fn camera(&self) -> Result<ForeignCamera> {
        let Some(matrix) = self.matrix("camera_matrix", CAMERA_MATRIX)? else {
            if self.find(&["m1"])?.is_some() {
                return Err(
                    Error::input("the file describes a stereo pair (M1, D1, M2, D2)").remedy(
                        "write M and D of one camera as camera_matrix and distortion_coefficients",
                    ),
                );
            }
            return Err(Error::input("the file has no camera_matrix")
                .remedy("OpenCV's calibration writes camera_matrix and distortion_coefficients"));
        };
        let mut notes = Vec::new();
        let coefficients = match self.matrix("distortion_coefficients", COEFFICIENTS)? {
            Some(matrix) => matrix.coefficients(&mut notes)?,
            None if self.text(&["distortionmodel"])?.is_some() => Vec::new(),
            None => {
                return Err(Error::input("the file has no distortion_coefficients")
                    .remedy("write five zeros for a lens without distortion"));
            }
        };
        let size = self.size()?;
        Ok(ForeignCamera {
            width: size.map(|[width, _]| width),
            height: size.map(|[_, height]| height),
            matrix: matrix.shaped("camera_matrix", [3, 3])?,
            coefficients,
            is_inverse: false,
            camera_name: self.text(&["cameraname"])?,
            rms_px: self
                .find(RMS)?
                .and_then(Node::number)
                .filter(|e| e.is_finite()),
            notes,
        })
    }

    /// Checks the distortion model. Names are those of ROS, Kalibr and librealsense.
    fn set_model(&self, camera: &mut ForeignCamera, is_required: bool) -> Result<()> {
        let model = self.text(&["distortionmodel"])?.unwrap_or_default();
        let plain = model.to_ascii_lowercase().replace(['_', '-', ' '], "");
        let is_straight = camera.coefficients.iter().all(|c| *c == 0.0);
        match &*plain {
            // The latter two are plumb_bob if their other coefficients are zero.
            "plumbbob" | "radtan" | "brownconrady" | "rationalpolynomial" | "thinprism" => Ok(()),
            "inversebrownconrady" => {
                camera.is_inverse = true;
                Ok(())
            }
            "" if !is_required => Ok(()),
            "" | "none" if is_straight => Ok(()),
            "" => Err(
                Error::input("distortion_coefficients without a distortion_model")
                    .remedy("add distortion_model: plumb_bob if they are k1, k2, p1, p2, k3"),
            ),
            _ => Err(unsupported(format!("distortion model {model:?}"))),
        }
    }

    /// Converts to the delivered image: `camera_info` describes the whole sensor and says which part
    /// is delivered (ROS, `sensor_msgs/CameraInfo`).
    fn apply_binning_and_roi(&self, camera: &mut ForeignCamera) -> Result<()> {
        let mut binning = [1.0, 1.0];
        for (factor, key) in binning.iter_mut().zip(["binningx", "binningy"]) {
            if let Some(pixels) = self.pixels("binning", self.find(&[key])?)? {
                *factor = f64::from(pixels.max(1));
            }
        }
        let roi = self.find(&["roi"])?;
        let entry = |key: &str| -> Result<u32> {
            let pixels = self.pixels("roi", roi.and_then(|roi| roi.get(key)))?;
            Ok(pixels.unwrap_or(0))
        };
        let offset = [entry("x_offset")?, entry("y_offset")?];
        let part = [entry("width")?, entry("height")?];
        let (Some(width), Some(height)) = (camera.width, camera.height) else {
            return Ok(());
        };
        // Zeros mean the whole image.
        let size = if part.contains(&0) {
            [width, height]
        } else {
            part
        };
        let delivered = [0, 1].map(|k| (f64::from(size[k]) / binning[k]) as u32);
        if delivered == [width, height] && offset == [0, 0] {
            return Ok(());
        }
        let [fx, _, cx, _, fy, cy, ..] = &mut camera.matrix;
        for (k, (f, c)) in [(fx, cx), (fy, cy)].into_iter().enumerate() {
            *f /= binning[k];
            // Binned pixels are averages: their centres are half a pixel off.
            *c = (*c - f64::from(offset[k]) + 0.5) / binning[k] - 0.5;
        }
        [camera.width, camera.height] = delivered.map(Some);
        camera.notes.push(format!(
            "binning {} × {} and roi at {}, {} are applied: the intrinsics are for images of {}×{} \
             px",
            binning[0], binning[1], offset[0], offset[1], delivered[0], delivered[1]
        ));
        Ok(())
    }
}

fn check_rectification(matrix: &[f64; 9]) -> Result<()> {
    let identity = [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0];
    let is_identity = matrix
        .iter()
        .zip(identity)
        .all(|(a, b)| (a - b).abs() < TOLERANCE);
    if is_identity {
        return Ok(());
    }
    Err(Error::input(
        "the rectification_matrix is not the identity: the camera is one of a stereo pair",
    )
    .remedy(
        "for raw images, replace it by the identity; for rectified images, write a file with the \
         projection_matrix as camera_matrix and no distortion",
    ))
}

/// Notes a projection matrix that differs from the camera matrix: it is for rectified images.
fn projection_note(projection: &Matrix, matrix: &[f64; 9]) -> Result<Option<String>> {
    let p: [f64; 12] = projection.shaped("projection_matrix", [3, 4])?;
    let same = (0..3).all(|row| p[4 * row..4 * row + 3] == matrix[3 * row..3 * row + 3]);
    Ok((!same).then(|| {
        "the projection matrix differs from the camera matrix: it is for rectified images; use \
         raw images (image_raw) with this file"
            .to_owned()
    }))
}
