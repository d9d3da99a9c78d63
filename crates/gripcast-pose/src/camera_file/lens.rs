//! Camera matrices and coefficients of other programs as intrinsics.

use gripcast_base::error::{Error, Result};
use gripcast_imaging::{DistortionModel, Intrinsics};

/// OpenCV's order of coefficients, by what they belong to.
const COEFFICIENTS: [(&str, usize); 4] = [
    ("plumb bob", 5),
    ("the rational model (k4, k5, k6)", 8),
    ("the thin prism model (s1 to s4)", 12),
    ("the tilted model (τx, τy)", 14),
];

/// A matrix as files have it, row by row.
#[derive(Clone, Debug, serde::Deserialize)]
pub(super) struct Matrix {
    pub rows: usize,
    pub(super) cols: usize,
    pub(super) data: Vec<f64>,
}

impl Matrix {
    /// Its numbers, if there are as many as it says, and finite.
    pub(super) fn numbers(&self, what: &str) -> Result<&[f64]> {
        if self.rows.checked_mul(self.cols) != Some(self.data.len()) {
            return Err(Error::input(format!(
                "{what} is said to have {} × {} numbers, found {}",
                self.rows,
                self.cols,
                self.data.len()
            )));
        }
        if let Some(wild) = self.data.iter().find(|v| !v.is_finite()) {
            return Err(Error::input(format!("{what} has the entry {wild}")));
        }
        Ok(&self.data)
    }

    /// A 3 × 3 matrix.
    pub(super) fn square(&self, what: &str) -> Result<[f64; 9]> {
        if (self.rows, self.cols) != (3, 3) {
            return Err(Error::input(format!(
                "{what} must be 3 × 3, found {} × {}",
                self.rows, self.cols
            )));
        }
        let numbers = self.numbers(what)?;
        <[f64; 9]>::try_from(numbers)
            .map_err(|_| Error::input(format!("{what} must have 9 numbers")))
    }
}

/// A camera as a file of another program has it.
#[derive(Default)]
pub(super) struct ForeignCamera {
    pub(super) width: Option<u32>,
    pub(super) height: Option<u32>,
    /// The camera matrix, row by row.
    pub(super) matrix: [f64; 9],
    /// Coefficients in OpenCV's order.
    pub(super) coefficients: Vec<f64>,
    pub(super) camera_name: Option<String>,
    /// Reprojection error, px.
    pub(super) rms_px: Option<f64>,
    pub(super) notes: Vec<String>,
}

impl ForeignCamera {
    /// Its intrinsics, for images of the size that the file says, or else of `size`.
    pub(super) fn intrinsics(&self, size: Option<[u32; 2]>) -> Result<Intrinsics> {
        let own = self.width.zip(self.height);
        let (width, height) = own.or(size.map(<(u32, u32)>::from)).ok_or_else(|| {
            Error::input("the file does not say which image size its intrinsics are for").remedy(
                "convert it once with the size of the images it was calibrated with: `gripcast \
                 calibrate convert FILE --size 1280x720 --to toml --out FILE.toml`",
            )
        })?;
        let [fx, skew, cx, k10, fy, cy, k20, k21, scale] = self.matrix;
        if skew != 0.0 {
            return Err(Error::input(format!(
                "the camera matrix has a skew of {skew}, and pixels here have right angles"
            ))
            .remedy("calibrate without skew, as OpenCV and ROS do"));
        }
        if [k10, k20, k21] != [0.0; 3] || scale != 1.0 {
            return Err(Error::input(format!(
                "the camera matrix must be [fx 0 cx; 0 fy cy; 0 0 1], found {:?}",
                self.matrix
            ))
            .remedy("numbers are listed row by row"));
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
            model: if is_straight {
                DistortionModel::None
            } else {
                DistortionModel::BrownConrady
            },
            coefficients,
        })
    }
}

/// k1, k2, p1, p2, k3 of a longer or shorter list, if what is beyond them is zero.
fn plumb_bob(coefficients: &[f64]) -> Result<[f64; 5]> {
    let count = coefficients.len();
    if ![0, 4, 5, 8, 12, 14].contains(&count) {
        return Err(Error::input(format!(
            "there are {count} distortion coefficients; known are lists of 4, 5, 8, 12 and 14"
        )));
    }
    let used = coefficients.iter().rposition(|c| *c != 0.0);
    let needed = used.map_or(0, |last| last + 1);
    let model = COEFFICIENTS.iter().find(|(_, most)| needed <= *most);
    if needed > 5 {
        let name = model.map_or("an unknown model", |(name, _)| *name);
        return Err(unknown_lens(name));
    }
    let mut result = [0.0; 5];
    for (to, from) in result.iter_mut().zip(coefficients) {
        *to = *from;
    }
    Ok(result)
}

/// Refuses a lens model by its name.
pub(super) fn unknown_lens(name: &str) -> Error {
    Error::input(format!("the lens has {name}, which is not known here"))
        .remedy("calibrate with five coefficients: k1, k2, p1, p2, k3 (plumb_bob, radtan)")
}
