//! Rigid transforms.

use glam::{DMat3, DQuat, DVec3};
use pyo3::prelude::*;

use super::arrays::{array, numbers};
use super::failure::Outcome;
use gripcast_base::error::Error;
use gripcast_geometry as geometry;

/// Largest deviation of a rotation matrix from an orthonormal one.
const ORTHONORMAL: f64 = 1e-6;
/// Largest deviation of a quaternion's norm from 1.
const UNIT: f64 = 1e-3;

/// A rigid transform `t_a_b`: maps coordinates of frame b into frame a.
#[pyclass(frozen, module = "gripcast")]
#[derive(Clone, Copy)]
pub(crate) struct Pose(pub(crate) geometry::Pose);

#[pymethods]
impl Pose {
    #[new]
    #[pyo3(signature = (t_m = (0.0, 0.0, 0.0), q_wxyz = (1.0, 0.0, 0.0, 0.0)))]
    #[pyo3(text_signature = "(t_m=(0.0, 0.0, 0.0), q_wxyz=(1.0, 0.0, 0.0, 0.0))")]
    fn new(t_m: (f64, f64, f64), q_wxyz: (f64, f64, f64, f64)) -> Outcome<Self> {
        let (w, x, y, z) = q_wxyz;
        let rotation = DQuat::from_xyzw(x, y, z, w);
        let translation = DVec3::from(t_m);
        // Also rejects NaN.
        let is_unit = (rotation.length() - 1.0).abs() <= UNIT;
        if !(is_unit && translation.is_finite()) {
            return Err(Error::input(format!(
                "a pose needs finite numbers and a unit quaternion, found t_m {t_m:?}, q_wxyz \
                 {q_wxyz:?}"
            ))
            .into());
        }
        Ok(Self(geometry::Pose::new(rotation, translation)))
    }

    /// From a 4 × 4 matrix: a rotation, a translation (m) and the row 0, 0, 0, 1.
    #[staticmethod]
    fn from_matrix(matrix: &Bound<'_, PyAny>) -> Outcome<Self> {
        from_matrix(matrix, "matrix").map(Self)
    }

    /// Origin of b in coordinates of a, m.
    #[getter]
    fn t_m(&self) -> (f64, f64, f64) {
        self.0.translation_m.into()
    }

    /// Rotation from b to a, a unit quaternion with w ≥ 0.
    #[getter]
    pub(crate) fn q_wxyz(&self) -> (f64, f64, f64, f64) {
        let DQuat { x, y, z, w } = self.0.rotation;
        (w, x, y, z)
    }

    /// 4 × 4, float64.
    #[getter]
    fn matrix(&self, py: Python<'_>) -> PyResult<Py<PyAny>> {
        array(py, matrix(&self.0).to_vec(), &[4, 4])
    }

    /// `t_b_a` of a `t_a_b`.
    fn inverse(&self) -> Self {
        Self(self.0.inverse())
    }

    fn __matmul__(&self, other: &Self) -> Self {
        Self(self.0 * other.0)
    }

    fn __eq__(&self, other: &Self) -> bool {
        self.0 == other.0
    }

    fn __hash__(&self) -> u64 {
        let parts = matrix(&self.0).map(f64::to_bits);
        parts.iter().fold(0, |hash, bits| {
            (hash ^ bits).wrapping_mul(0x0100_0000_01b3).rotate_left(17)
        })
    }

    fn __repr__(&self) -> String {
        format!("Pose(t_m={:?}, q_wxyz={:?})", self.t_m(), self.q_wxyz())
    }

    fn __reduce__(&self, py: Python<'_>) -> PyResult<(Py<PyAny>, Py<PyAny>)> {
        let class = py.get_type::<Self>().into_any().unbind();
        let arguments = (self.t_m(), self.q_wxyz()).into_pyobject(py)?;
        Ok((class, arguments.into_any().unbind()))
    }
}

/// Row-major 4 × 4.
pub(crate) fn matrix(pose: &geometry::Pose) -> [f64; 16] {
    let DMat3 {
        x_axis: x,
        y_axis: y,
        z_axis: z,
    } = pose.rotation_matrix();
    let t = pose.translation_m;
    [
        x.x, y.x, z.x, t.x, x.y, y.y, z.y, t.y, x.z, y.z, z.z, t.z, 0.0, 0.0, 0.0, 1.0,
    ]
}

/// Poses as an array of n × 4 × 4.
pub(crate) fn trajectory(
    py: Python<'_>,
    poses: impl Iterator<Item = geometry::Pose>,
) -> PyResult<Py<PyAny>> {
    let values: Vec<f64> = poses.flat_map(|pose| matrix(&pose)).collect();
    let count = values.len() / 16;
    array(py, values, &[count, 4, 4])
}

/// A `Pose`, or a 4 × 4 matrix.
pub(crate) fn pose(value: &Bound<'_, PyAny>, name: &str) -> Outcome<geometry::Pose> {
    match value.cast::<Pose>() {
        Ok(pose) => Ok(pose.get().0),
        Err(_) => from_matrix(value, name),
    }
}

fn from_matrix(value: &Bound<'_, PyAny>, name: &str) -> Outcome<geometry::Pose> {
    let m = numbers(value, name, &[Some(4), Some(4)])?;
    let column = |j: usize| DVec3::new(m[j], m[4 + j], m[8 + j]);
    let rotation = DMat3::from_cols(column(0), column(1), column(2));
    let rest = rotation.transpose() * rotation - DMat3::IDENTITY;
    let deviation = rest
        .to_cols_array()
        .iter()
        .fold(0.0_f64, |d, x| d.max(x.abs()));
    let last = [m[12], m[13], m[14], m[15]];
    if deviation > ORTHONORMAL || rotation.determinant() < 0.0 || last != [0.0, 0.0, 0.0, 1.0] {
        return Err(Error::input(format!(
            "`{name}` must be a rigid transform: a rotation, a translation in metres and the row \
             0, 0, 0, 1; its rotation deviates by {deviation:.1e} from orthonormal, its last row is \
             {last:?}"
        ))
        .remedy("without scale or mirroring; `Pose(t_m, q_wxyz)` takes a quaternion")
        .into());
    }
    Ok(geometry::Pose::new(DQuat::from_mat3(&rotation), column(3)))
}
