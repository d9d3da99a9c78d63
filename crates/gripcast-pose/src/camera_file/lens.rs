//! Conversion of third-party camera matrices and distortion coefficients.

use super::node::Node;
use gripcast_base::error::{Error, Result};
use gripcast_imaging::{DistortionModel, Intrinsics};

/// OpenCV's distortion models and their numbers of coefficients.
const MODELS: [(&str, usize); 4] = [
    ("plumb_bob", 5),
    ("rational model (k4, k5, k6)", 8),
    ("thin prism model (s1 to s4)", 12),
    ("tilted model (τx, τy)", 14),
];

/// A matrix in a file, row by row.
#[derive(Clone, Debug)]
pub(super) struct Matrix {
    /// Rows and columns; none for a plain list of numbers.
    shape: Option<[usize; 2]>,
    data: Vec<f64>,
}

impl Matrix {
    /// Reads `{rows, cols, data}`, a list of rows, or a list of numbers.
    pub(super) fn from_node(name: &str, node: &Node) -> Result<Self> {
        let data = node.get("data").unwrap_or(node).numbers();
        let Some(data) = data else {
            return Err(Error::input(format!("{name}: expected numbers")));
        };
        let side = |key: &str| node.get(key).and_then(Node::number).map(|n| n as usize);
        let shape = match (side("rows"), side("cols"), node) {
            (Some(rows), Some(cols), _) => Some([rows, cols]),
            (_, _, Node::List(rows)) if matches!(rows.first(), Some(Node::List(_))) => {
                let rows = rows.len();
                (data.len() % rows == 0).then_some([rows, data.len() / rows])
            }
            _ => None,
        };
        if let Some(invalid) = data.iter().find(|v| !v.is_finite()) {
            return Err(Error::input(format!("{name}: invalid entry {invalid}")));
        }
        Ok(Self { shape, data })
    }

    /// The entries of a matrix with `shape` rows and columns.
    pub(super) fn shaped<const N: usize>(&self, name: &str, shape: [usize; 2]) -> Result<[f64; N]> {
        self.check_count(name)?;
        let [rows, cols] = self.shape.unwrap_or(shape);
        let entries = self.data[..].try_into().ok();
        entries
            .filter(|_| [rows, cols] == shape)
            .ok_or_else(|| match self.shape {
                Some(_) => Error::input(format!(
                    "{name} must be {} × {}, found {rows} × {cols}",
                    shape[0], shape[1]
                )),
                None => Error::input(format!(
                    "{name} must have {N} numbers, found {}",
                    self.data.len()
                )),
            })
    }

    /// The entries of a list of distortion coefficients. Drivers write the eight numbers of a
    /// rational model over the five columns of plumb_bob.
    pub(super) fn coefficients(&self, notes: &mut Vec<String>) -> Result<Vec<f64>> {
        const NAME: &str = "distortion_coefficients";
        let count = self.data.len();
        if self.shape == Some([1, 5]) && [8, 12, 14].contains(&count) {
            notes.push(format!(
                "{NAME}: 1 × 5 is declared, all {count} numbers are read"
            ));
            return Ok(self.data.clone());
        }
        self.check_count(NAME)?;
        Ok(self.data.clone())
    }

    fn check_count(&self, name: &str) -> Result<()> {
        let found = self.data.len();
        match self.shape {
            Some([rows, cols]) if rows.checked_mul(cols) != Some(found) => Err(Error::input(
                format!("{name}: expected {rows} × {cols} numbers, found {found}"),
            )),
            _ => Ok(()),
        }
    }
}

/// A camera as described by a third-party file.
#[derive(Default)]
pub(super) struct ForeignCamera {
    pub(super) width: Option<u32>,
    pub(super) height: Option<u32>,
    /// Camera matrix, row by row.
    pub(super) matrix: [f64; 9],
    /// Distortion coefficients in OpenCV's order.
    pub(super) coefficients: Vec<f64>,
    /// Whether the coefficients map distorted to ideal coordinates.
    pub(super) is_inverse: bool,
    pub(super) camera_name: Option<String>,
    /// Reprojection error, px.
    pub(super) rms_px: Option<f64>,
    pub(super) notes: Vec<String>,
}

impl ForeignCamera {
    /// Converts to intrinsics for the image size of the file, else `size`.
    pub(super) fn intrinsics(&self, size: Option<[u32; 2]>) -> Result<Intrinsics> {
        let own = self.width.zip(self.height);
        let (width, height) = own.or(size.map(<(u32, u32)>::from)).ok_or_else(|| {
            Error::input("the file has no image size").remedy(
                "convert it once with the image size of the calibration: `gripcast calibrate \
                 convert FILE --size 1280x720 --to toml --out FILE.toml`",
            )
        })?;
        let [fx, skew, cx, k10, fy, cy, k20, k21, scale] = self.matrix;
        if skew != 0.0 {
            let what = format!("the camera matrix has a skew of {skew}, expected 0");
            return Err(Error::input(what).remedy("calibrate without skew, as OpenCV and ROS do"));
        }
        if [k10, k20, k21] != [0.0; 3] || scale != 1.0 {
            return Err(Error::input(format!(
                "the camera matrix must be [fx 0 cx; 0 fy cy; 0 0 1], found {:?}",
                self.matrix
            ))
            .remedy("list the numbers row by row"));
        }
        let coefficients = plumb_bob(&self.coefficients)?;
        let is_straight = coefficients == [0.0; 5];
        Ok(Intrinsics {
            width,
            height,
            fx,
            fy,
            cx,
            cy,
            model: match (is_straight, self.is_inverse) {
                (true, _) => DistortionModel::None,
                (false, true) => DistortionModel::InverseBrownConrady,
                (false, false) => DistortionModel::BrownConrady,
            },
            coefficients,
        })
    }
}

/// Reduces a coefficient list to k1, k2, p1, p2, k3 if all others are zero.
fn plumb_bob(coefficients: &[f64]) -> Result<[f64; 5]> {
    let count = coefficients.len();
    if ![0, 4, 5, 8, 12, 14].contains(&count) {
        return Err(Error::input(format!(
            "expected 4, 5, 8, 12 or 14 distortion coefficients, found {count}"
        )));
    }
    let used = coefficients.iter().rposition(|c| *c != 0.0);
    let needed = used.map_or(0, |last| last + 1);
    if needed > 5 {
        let model = MODELS.iter().find(|(_, count)| needed <= *count);
        let name = model.map_or("unknown distortion model", |(name, _)| *name);
        return Err(unsupported(name));
    }
    let mut result = [0.0; 5];
    let kept = count.min(5);
    result[..kept].copy_from_slice(&coefficients[..kept]);
    Ok(result)
}

/// Error for an unsupported camera or distortion model.
pub(super) fn unsupported(model: impl std::fmt::Display) -> Error {
    Error::input(format!("unsupported: {model}"))
        .remedy("calibrate with five coefficients: k1, k2, p1, p2, k3 (plumb_bob, radtan)")
}
