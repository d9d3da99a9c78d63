//! Fields of the gels' faces.

use pyo3::prelude::*;

use super::arrays::array;
use gripcast_sim::fields::{FaceField, FieldSeries};

/// Displacement and traction of the gels' faces at recorded time steps.
///
/// With m steps, g gels (left and right; one of a press) and ny × nx nodes. Vectors are in the gel
/// frame: z from the back to the face, x along the approach direction, y = z × x.
#[pyclass(frozen, get_all, module = "gripcast")]
pub(crate) struct FaceFields {
    /// m, uint32: index of the time step.
    step: Py<PyAny>,
    /// m: closure, adjustment, lift, or press.
    stage: Vec<&'static str>,
    /// m, float64, s.
    t_s: Py<PyAny>,
    /// nx, float64, m: nodes at rest along x.
    x_m: Py<PyAny>,
    /// ny, float64, m: nodes at rest along y.
    y_m: Py<PyAny>,
    /// Height of the face above the back, m.
    thickness_m: f64,
    /// ny × nx, float64, m²: area of each node.
    area_m2: Py<PyAny>,
    /// Tangential speed from which a node slips, m/s.
    eps_v_m_s: f64,
    /// m × g × ny × nx × 3, float32, m: displacement from rest.
    displacement_m: Py<PyAny>,
    /// m × g × ny × nx × 3, float32, Pa: contact force on the gel per area; z is negative where the
    /// object presses.
    traction_pa: Py<PyAny>,
    /// m × g × ny × nx, uint8: 0 open, 1 stick, 2 slip.
    contact: Py<PyAny>,
    /// m × g × 3, float64, N: force on the face.
    force_n: Py<PyAny>,
    /// m × g × 3, float64, N m: torque about the centre of the face.
    torque_n_m: Py<PyAny>,
    /// m × g × 3, float64, N: force on the side walls.
    side_force_n: Py<PyAny>,
    /// m × g × 3, float64, N m: torque of that force.
    side_torque_n_m: Py<PyAny>,
}

impl FaceFields {
    pub(crate) fn new(py: Python<'_>, series: &FieldSeries) -> PyResult<Self> {
        let mesh = &series.mesh;
        let (m, g, ny, nx) = (
            series.steps.len(),
            series.gels,
            mesh.y_m.len(),
            mesh.x_m.len(),
        );
        let gels = || series.steps.iter().flat_map(|step| &step.gels);
        let nodes = |vectors: fn(&FaceField) -> &Vec<[f32; 3]>| {
            let values = gels().flat_map(vectors).flatten().copied().collect();
            array::<f32>(py, values, &[m, g, ny, nx, 3])
        };
        let sums = |vector: fn(&FaceField) -> [f64; 3]| {
            array::<f64>(py, gels().flat_map(vector).collect(), &[m, g, 3])
        };
        let contact = gels().flat_map(|gel| &gel.contact);
        let steps = series.steps.iter();
        let stage = |stage: Option<gripcast_sim::grasp::StageName>| {
            stage.map_or("press", gripcast_sim::grasp::StageName::name)
        };
        Ok(Self {
            step: array(py, steps.clone().map(|step| step.step).collect(), &[m])?,
            stage: steps.clone().map(|step| stage(step.stage)).collect(),
            t_s: array(py, steps.map(|step| step.t_s).collect(), &[m])?,
            x_m: array(py, mesh.x_m.clone(), &[nx])?,
            y_m: array(py, mesh.y_m.clone(), &[ny])?,
            thickness_m: mesh.thickness_m,
            area_m2: array(py, mesh.area_m2.clone(), &[ny, nx])?,
            eps_v_m_s: series.eps_v_m_s,
            displacement_m: nodes(|gel| &gel.displacement_m)?,
            traction_pa: nodes(|gel| &gel.traction_pa)?,
            contact: array(py, contact.map(|c| *c as u8).collect(), &[m, g, ny, nx])?,
            force_n: sums(|gel| gel.resultant.force_n)?,
            torque_n_m: sums(|gel| gel.resultant.torque_n_m)?,
            side_force_n: sums(|gel| gel.sides.force_n)?,
            side_torque_n_m: sums(|gel| gel.sides.torque_n_m)?,
        })
    }
}

#[pymethods]
impl FaceFields {
    fn __repr__(&self, py: Python<'_>) -> PyResult<String> {
        let shape = self.displacement_m.getattr(py, "shape")?;
        Ok(format!(
            "<FaceFields of shape {shape}: steps, gels, rows, columns, vector>"
        ))
    }
}
