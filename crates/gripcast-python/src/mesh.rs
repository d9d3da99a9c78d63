//! Meshes and objects.

use std::path::PathBuf;
use std::sync::Arc;

use glam::DVec3;
use pyo3::exceptions::PyTypeError;
use pyo3::prelude::*;

use super::arrays::{array, indices, numbers};
use super::failure::Outcome;
use super::work::{detached, interruptible};
use gripcast_base::error::{Error, Result};
use gripcast_base::number::NumberRange;
use gripcast_geometry::{
    BUILTIN_NAMES, MeshOptions, PrepareOptions, PreparedMesh, TriangleMesh, check_mass,
    load_object_mesh, prepare,
};

/// A mesh that is checked, repaired and in metres.
#[pyclass(frozen, module = "gripcast")]
#[derive(Clone)]
pub(crate) struct Mesh {
    pub(crate) prepared: Arc<PreparedMesh>,
    source: String,
}

/// How a mesh is repaired.
fn prepare_options(
    repair: &str,
    wall_thickness_m: Option<f64>,
    surface_only: bool,
) -> Result<PrepareOptions> {
    if let Some(thickness_m) = wall_thickness_m {
        NumberRange::POSITIVE
            .check(thickness_m)
            .map_err(|e| e.at("wall_thickness_m"))?;
    }
    Ok(PrepareOptions {
        repair: repair.parse()?,
        wall_thickness_m,
        needs_inside: !surface_only,
        ..PrepareOptions::default()
    })
}

impl Mesh {
    fn read(py: Python<'_>, source: String, options: MeshOptions) -> Outcome<Self> {
        let name = source.clone();
        let prepared = interruptible(py, move |_| load_object_mesh(&name, &options))?;
        Ok(Self {
            prepared: Arc::new(prepared),
            source,
        })
    }

    pub(crate) fn surface(&self) -> &TriangleMesh {
        &self.prepared.mesh
    }
}

#[pymethods]
impl Mesh {
    #[new]
    #[pyo3(signature = (*_args, **_kwargs))]
    fn new(_args: &Bound<'_, PyAny>, _kwargs: Option<&Bound<'_, PyAny>>) -> PyResult<Self> {
        Err(PyTypeError::new_err(
            "make a mesh with Mesh.load(path), Mesh.builtin(name) or Mesh.from_arrays(vertices_m, \
             triangles)",
        ))
    }

    /// Names of the built-in shapes.
    #[classattr]
    #[allow(non_snake_case)]
    fn BUILTIN(py: Python<'_>) -> PyResult<Py<PyAny>> {
        Ok(pyo3::types::PyTuple::new(py, BUILTIN_NAMES)?
            .into_any()
            .unbind())
    }

    /// Reads a mesh file (obj, stl, ply, glb, gltf).
    ///
    /// `unit` is that of its coordinates: m, cm, mm or in. `repair` is auto, none or strict. An open
    /// surface gets a wall of `wall_thickness_m`, inwards. With `surface_only` it needs no inside:
    /// enough for images, not for an object.
    #[staticmethod]
    #[pyo3(signature = (path, *, unit = "m", scale = 1.0, repair = "auto", wall_thickness_m = None, surface_only = false))]
    fn load(
        py: Python<'_>,
        path: PathBuf,
        unit: &str,
        scale: f64,
        repair: &str,
        wall_thickness_m: Option<f64>,
        surface_only: bool,
    ) -> Outcome<Self> {
        let options = MeshOptions {
            prepare: prepare_options(repair, wall_thickness_m, surface_only)?,
            ..MeshOptions::new(unit.parse()?, scale)
        };
        Self::read(py, path.to_string_lossy().into_owned(), options)
    }

    /// A built-in shape, one of `Mesh.BUILTIN`.
    #[staticmethod]
    #[pyo3(signature = (name, *, scale = 1.0))]
    fn builtin(py: Python<'_>, name: &str, scale: f64) -> Outcome<Self> {
        let name = name.strip_prefix("builtin:").unwrap_or(name);
        let options = MeshOptions {
            scale,
            ..MeshOptions::default()
        };
        Self::read(py, format!("builtin:{name}"), options)
    }

    /// From arrays: vertices n × 3 (m), triangles n × 3 (indices, counter-clockwise seen from
    /// outside).
    #[staticmethod]
    #[pyo3(signature = (vertices_m, triangles, *, repair = "auto", wall_thickness_m = None, surface_only = false))]
    fn from_arrays(
        py: Python<'_>,
        vertices_m: &Bound<'_, PyAny>,
        triangles: &Bound<'_, PyAny>,
        repair: &str,
        wall_thickness_m: Option<f64>,
        surface_only: bool,
    ) -> Outcome<Self> {
        let options = prepare_options(repair, wall_thickness_m, surface_only)?;
        let corners = numbers(vertices_m, "vertices_m", &[None, Some(3)])?;
        let vertices: Vec<DVec3> = corners.chunks_exact(3).map(DVec3::from_slice).collect();
        let mesh = TriangleMesh {
            triangles: indices(triangles, "triangles", vertices.len())?,
            vertices,
        };
        let prepared = interruptible(py, move |_| prepare(&mesh, &options))?;
        Ok(Self {
            prepared: Arc::new(prepared),
            source: "arrays".to_owned(),
        })
    }

    /// File, `builtin:NAME`, or `arrays`.
    #[getter]
    pub(crate) fn source(&self) -> &str {
        &self.source
    }

    /// n × 3, float64, m.
    #[getter]
    fn vertices_m(&self, py: Python<'_>) -> PyResult<Py<PyAny>> {
        let vertices = &self.surface().vertices;
        let values = vertices.iter().flat_map(|v| v.to_array()).collect();
        array::<f64>(py, values, &[vertices.len(), 3])
    }

    /// n × 3, uint32; counter-clockwise seen from outside.
    #[getter]
    fn triangles(&self, py: Python<'_>) -> PyResult<Py<PyAny>> {
        let triangles = &self.surface().triangles;
        array(py, triangles.concat(), &[triangles.len(), 3])
    }

    /// Sides of the bounding box, m.
    #[getter]
    fn size_m(&self) -> (f64, f64, f64) {
        self.surface().bounds().extent().into()
    }

    /// Volume of the inside, m³; None without one.
    #[getter]
    fn volume_m3(&self) -> Option<f64> {
        Some(self.prepared.solid?.properties.volume_m3)
    }

    /// Centre of mass of a uniform density, m; None without an inside.
    #[getter]
    fn center_of_mass_m(&self) -> Option<(f64, f64, f64)> {
        Some(self.prepared.solid?.properties.center_of_mass_m.into())
    }

    /// Hash of vertices and triangles, as in traces.
    #[getter]
    fn sha256(&self, py: Python<'_>) -> Outcome<String> {
        detached(py, || Ok(self.surface().content_hash()))
    }

    /// Repairs and defects, one sentence each.
    #[getter]
    fn warnings(&self) -> Vec<String> {
        self.prepared.warnings.clone()
    }

    pub(crate) fn __repr__(&self) -> String {
        let [x, y, z] = self.surface().bounds().extent().to_array().map(|m| 1e3 * m);
        let count = self.surface().triangles.len();
        format!(
            "<Mesh {}: {count} triangles, {x:.1} × {y:.1} × {z:.1} mm>",
            self.source
        )
    }
}

/// An object to grasp.
#[pyclass(frozen, module = "gripcast")]
#[derive(Clone)]
pub(crate) struct Object {
    pub(crate) mesh: Mesh,
    /// Mass, kg.
    #[pyo3(get)]
    pub(crate) mass_kg: f64,
    /// Coulomb friction coefficient of gel and object, and of object and ground.
    #[pyo3(get)]
    pub(crate) friction: f64,
}

#[pymethods]
impl Object {
    #[new]
    #[pyo3(signature = (mesh, mass_kg = 0.06, friction = 0.4))]
    fn new(mesh: &Mesh, mass_kg: f64, friction: f64) -> Outcome<Self> {
        check_mass(mass_kg, &mesh.surface().bounds())?;
        NumberRange::NOT_NEGATIVE
            .check(friction)
            .map_err(|e| Error::input(format!("`friction`: {}", e.what())))?;
        if mesh.prepared.solid.is_none() {
            return Err(
                Error::input("the mesh has no inside, which an object needs")
                    .at(&mesh.source)
                    .remedy("load it without `surface_only`")
                    .into(),
            );
        }
        Ok(Self {
            mesh: mesh.clone(),
            mass_kg,
            friction,
        })
    }

    /// Its mesh.
    #[getter]
    fn mesh(&self) -> Mesh {
        self.mesh.clone()
    }

    fn __repr__(&self) -> String {
        format!(
            "Object({}, mass_kg={}, friction={})",
            self.mesh.__repr__(),
            self.mass_kg,
            self.friction
        )
    }
}
