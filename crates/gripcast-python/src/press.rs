//! Indentation tests.

use pyo3::prelude::*;

use super::arrays::array;
use super::failure::Outcome;
use super::fields::FaceFields;
use super::mesh::Mesh;
use super::placement::check;
use super::work::{interruptible, pool};
use gripcast_base::error::{Error, Result, unknown_name};
use gripcast_base::number::NumberRange;
use gripcast_sim::fem::GelResolution;
use gripcast_sim::fields::FieldSampling;
use gripcast_sim::press::{Indenter, PressGel, PressPoint, PressSetup, points_without_force};

/// Indenters that have a name.
const SHAPES: [&str; 4] = ["sphere", "cylinder", "plate", "edge"];

/// Presses a shape into one gel and measures the force at each depth.
///
/// `indenter` is "sphere", "cylinder", "edge" (with `radius_m`), "plate", or a `Mesh` that points down
/// in the gel's frame. Depths (m) count from first contact; `shifts_m` are shear displacements along
/// the gel's x axis at the last depth. `gel` is coarse, default, fine, or refined (by symmetry; no mesh).
/// With `fields` ("stages", "all" or "every:N") the tractions are recorded.
#[pyfunction]
#[pyo3(signature = (indenter, *, radius_m = None, depths_m = None, shifts_m = None, gel = "default", friction = 0.0, young_pa = 1e6, poisson = 0.3, d_hat_m = 2e-5, kappa_pa = 3e6, face_m = 2e-4, fields = None, threads = None))]
#[pyo3(
    text_signature = "(indenter, *, radius_m=None, depths_m=None, shifts_m=None, gel='default', friction=0.0, young_pa=1000000.0, poisson=0.3, d_hat_m=2e-05, kappa_pa=3000000.0, face_m=0.0002, fields=None, threads=None)"
)]
#[allow(clippy::too_many_arguments)]
pub(crate) fn press(
    py: Python<'_>,
    indenter: &Bound<'_, PyAny>,
    radius_m: Option<f64>,
    depths_m: Option<Vec<f64>>,
    shifts_m: Option<Vec<f64>>,
    gel: &str,
    friction: f64,
    young_pa: f64,
    poisson: f64,
    d_hat_m: f64,
    kappa_pa: f64,
    face_m: f64,
    fields: Option<&str>,
    threads: Option<usize>,
) -> Outcome<PressResult> {
    check("friction", Some(friction), NumberRange::NOT_NEGATIVE)?;
    check("poisson", Some(poisson), NumberRange::above(-1.0, 0.5))?;
    for (name, value) in [
        ("young_pa", young_pa),
        ("d_hat_m", d_hat_m),
        ("kappa_pa", kappa_pa),
        ("face_m", face_m),
    ] {
        check(name, Some(value), NumberRange::POSITIVE)?;
    }
    let setup = PressSetup {
        gel: match gel {
            "refined" => PressGel::Refined,
            name => PressGel::Whole(GelResolution::from_name(name)?),
        },
        depths_m: depths_m.unwrap_or_else(|| PressSetup::DEPTHS_M.to_vec()),
        shifts_m: shifts_m.unwrap_or_default(),
        friction,
        young_pa,
        poisson,
        d_hat_m,
        kappa_pa,
        face_m,
        ..PressSetup::new(shape(indenter, radius_m)?)
    };
    let (press, targets) = setup.build()?;
    let gel_nodes = press.grid.nodes().into();
    let sampling = fields.map(str::parse::<FieldSampling>).transpose()?;
    let pool = pool(threads)?;
    let (points, fields) = interruptible(py, move |cancel| {
        pool.install(|| press.run_until(&targets, sampling, cancel))
    })?;
    let fields = fields
        .map(|series| FaceFields::new(py, &series))
        .transpose()?;
    let column = |value: fn(&PressPoint) -> f64| {
        array(py, points.iter().map(value).collect(), &[points.len()])
    };
    let unconverged = points.iter().filter(|point| !point.converged).count();
    let mut warnings = points_without_force(&points);
    if unconverged > 0 {
        warnings.push(format!(
            "{unconverged} of {} points did not converge: pass a larger `d_hat_m` or a coarser `gel`",
            points.len()
        ));
    }
    Ok(PressResult {
        depth_m: column(|point| point.depth_m)?,
        shift_m: column(|point| point.shift_m)?,
        normal_force_n: column(|point| point.normal_n)?,
        shear_force_n: column(|point| point.shear_n)?,
        gap_m: column(|point| point.gap_m)?,
        converged: array(
            py,
            points.iter().map(|point| point.converged).collect(),
            &[points.len()],
        )?,
        gel_nodes,
        fields: fields.map(|fields| Py::new(py, fields)).transpose()?,
        warnings,
    })
}

fn shape(indenter: &Bound<'_, PyAny>, radius_m: Option<f64>) -> Outcome<Indenter> {
    if let Ok(mesh) = indenter.cast::<Mesh>() {
        without_radius("mesh", radius_m)?;
        return Ok(Indenter::Mesh(mesh.get().surface().clone()));
    }
    let name: String = indenter
        .extract()
        .map_err(|_| Error::usage("`indenter` must be a name or a Mesh"))?;
    let radius =
        || radius_m.ok_or_else(|| Error::usage(format!("the indenter {name} needs `radius_m`")));
    Ok(match name.as_str() {
        "sphere" => Indenter::Sphere {
            radius_m: radius()?,
        },
        "cylinder" => Indenter::Cylinder {
            radius_m: radius()?,
        },
        "edge" => Indenter::Edge {
            radius_m: radius()?,
        },
        "plate" => {
            without_radius("plate", radius_m)?;
            Indenter::Plate
        }
        other => return Err(unknown_name("indenter", other, &SHAPES).into()),
    })
}

fn without_radius(name: &str, radius_m: Option<f64>) -> Result<()> {
    match radius_m {
        None => Ok(()),
        Some(_) => {
            Err(Error::usage(format!("the indenter {name} has no radius"))
                .remedy("omit `radius_m`"))
        }
    }
}

/// Result of a press: one row per depth, then one per shift (n).
#[pyclass(frozen, get_all, module = "gripcast")]
pub(crate) struct PressResult {
    /// n, float64, m: depth from first contact.
    depth_m: Py<PyAny>,
    /// n, float64, m: shift along the gel's x axis.
    shift_m: Py<PyAny>,
    /// n, float64, N.
    normal_force_n: Py<PyAny>,
    /// n, float64, N: force on the gel along its x axis.
    shear_force_n: Py<PyAny>,
    /// n, float64, m: force-weighted mean gap of contact.
    gap_m: Py<PyAny>,
    /// n, bool: whether all steps converged.
    converged: Py<PyAny>,
    /// Nodes of the gel mesh along x, y and z.
    gel_nodes: (usize, usize, usize),
    /// Tractions and displacements; None unless `fields` was given.
    fields: Option<Py<FaceFields>>,
    /// Reasons to doubt the result, one sentence each.
    warnings: Vec<String>,
}

#[pymethods]
impl PressResult {
    fn __repr__(&self, py: Python<'_>) -> PyResult<String> {
        let depths = self.depth_m.call_method0(py, "tolist")?;
        let forces = self.normal_force_n.call_method0(py, "tolist")?;
        Ok(format!(
            "<PressResult depth_m={depths} normal_force_n={forces}>"
        ))
    }
}
