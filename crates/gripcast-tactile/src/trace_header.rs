//! What a trace says about its object and its gels.

use std::path::{Path, PathBuf};

use serde::Deserialize;
use serde_json::Value;

use super::scene::SimulatedGel;
use gripcast_base::error::{Error, Result};
use gripcast_geometry::{
    LengthUnit, Pose, PrepareOptions, Prepared, TriangleMesh, builtin, load_mesh, prepare,
};
use gripcast_sim::fem::GelGrid;

/// The object of a trace. From its header's `object`: `{"source", "sha256", "unit", "scale"}`.
#[derive(Clone, Debug, PartialEq, Deserialize)]
pub struct TraceObject {
    /// Mesh file, or `builtin:NAME`.
    pub source: String,
    /// Hash of the mesh that was simulated ([`TriangleMesh::content_hash`]).
    pub sha256: String,
    /// Unit of the coordinates in the file: mm, cm, m, in.
    #[serde(default = "metre")]
    pub unit: String,
    /// Factor on its size.
    #[serde(default = "one")]
    pub scale: f64,
}

fn metre() -> String {
    LengthUnit::Metre.to_string()
}

fn one() -> f64 {
    1.0
}

/// How a grasp began. From the header's `pose`.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
pub struct TraceStart {
    /// The object in the world.
    pub t_world_object: Pose,
    /// The gripper in the object's frame.
    pub t_object_gripper: Pose,
    /// CentreDistance between the undeformed gel faces, m.
    pub opening_m: f64,
}

impl TraceStart {
    /// Reads it from the header of a trace file.
    ///
    /// # Errors
    /// `Input` where the header does not have it.
    pub fn read(header: &Value) -> Result<Self> {
        Self::deserialize(&header["pose"]).map_err(|cause| {
            Error::input("the trace's header does not tell how the grasp began")
                .because(cause)
                .remedy("simulate the grasp again with this gripcast")
        })
    }

    /// The gripper in the world.
    pub fn t_world_gripper(&self) -> Pose {
        self.t_world_object * self.t_object_gripper
    }
}

/// What a renderer needs of a trace's header.
#[derive(Clone, Debug)]
pub struct TraceHeader {
    /// The gels: the header's `gel_axes_m` and `parameters.solver.d_hat_m`.
    pub gel: SimulatedGel,
    /// The object.
    pub object: TraceObject,
}

#[derive(Deserialize)]
struct Record {
    gel_axes_m: [Vec<f64>; 3],
    object: TraceObject,
    parameters: Parameters,
}

#[derive(Deserialize)]
struct Parameters {
    solver: Solver,
}

#[derive(Deserialize)]
struct Solver {
    d_hat_m: f64,
}

impl TraceHeader {
    /// Reads the header of a trace file.
    ///
    /// # Errors
    /// `Input` where it lacks gels or object, or the gel's mesh is none.
    pub fn read(header: &Value) -> Result<Self> {
        let record = Record::deserialize(header).map_err(|cause| {
            Error::input("the trace's header does not tell its object and gels")
                .because(cause)
                .remedy("write one with `gripcast sim grasp … --trace FILE.bin`")
        })?;
        Ok(Self {
            gel: SimulatedGel {
                grid: GelGrid::new(record.gel_axes_m)?,
                d_hat_m: record.parameters.solver.d_hat_m,
            },
            object: record.object,
        })
    }
}

impl TraceObject {
    /// The simulated mesh, read again from [`Self::file`] and compared with the trace.
    ///
    /// # Errors
    /// `NotFound`, `Io`, `Input` as of reading a mesh; `Input` where the mesh is no longer the
    /// one that was simulated.
    pub fn load(&self, trace: &Path) -> Result<TriangleMesh> {
        let mesh = match self.file(trace) {
            None => builtin(&self.source)?,
            Some(path) => load_mesh(&path, self.unit.parse()?)?,
        };
        let Prepared { mesh, .. } = prepare(&mesh.scaled(self.scale), &PrepareOptions::default())
            .map_err(|e| e.at(&self.source))?;
        if mesh.content_hash() != self.sha256 {
            return Err(Error::input(format!(
                "this is another mesh than the simulated one, at unit {} and scale {}",
                self.unit, self.scale
            ))
            .at(&self.source)
            .remedy(
                "name the mesh that was simulated with --object, or simulate the grasp again",
            ));
        }
        Ok(mesh)
    }

    /// The mesh file, `None` for a built-in shape. A relative path that is not there is looked for
    /// from the trace's folder, then by its name in that folder.
    pub fn file(&self, trace: &Path) -> Option<PathBuf> {
        if self.source.starts_with("builtin:") {
            return None;
        }
        let given = PathBuf::from(&self.source);
        let folder = trace.parent().unwrap_or_else(|| Path::new(""));
        let name = given.file_name().unwrap_or_default();
        let places = [given.clone(), folder.join(&given), folder.join(name)];
        let found = places.into_iter().find(|place| place.exists());
        Some(found.unwrap_or(given))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use gripcast_base::error::ErrorKind;
    use gripcast_geometry::save_mesh;
    use gripcast_sim::fem::GelResolution;
    use serde_json::json;

    fn header(object: Value) -> Value {
        let grid = GelGrid::pad(GelResolution::Coarse).unwrap();
        json!({
            "outcome": "success",
            "object": object,
            "parameters": {"solver": {"d_hat_m": 5e-4, "dt_s": 0.01}},
            "gel_axes_m": grid.axes(),
        })
    }

    fn simulated(source: &str, scale: f64) -> String {
        let mesh = builtin(source).unwrap().scaled(scale);
        let prepared = prepare(&mesh, &PrepareOptions::default()).unwrap();
        prepared.mesh.content_hash()
    }

    #[test]
    fn a_header_gives_gel_and_object() {
        let sha256 = simulated("builtin:mug", 0.9);
        let object = json!({"source": "builtin:mug", "sha256": sha256, "scale": 0.9,
            "triangles": 1, "mass_kg": 0.06});
        let read = TraceHeader::read(&header(object)).unwrap();
        assert_eq!(read.gel.grid.nodes(), [13, 11, 3]);
        assert_eq!((read.gel.d_hat_m, read.object.unit.as_str()), (5e-4, "m"));
        let mesh = read.object.load(Path::new("grasp.bin")).unwrap();
        assert_eq!(mesh.content_hash(), sha256);
    }

    #[test]
    fn a_mesh_file_is_found_beside_the_trace_and_compared() {
        let folder = tempfile::tempdir().unwrap();
        let mesh = builtin("builtin:wedge").unwrap();
        save_mesh(&folder.path().join("part.obj"), &mesh).unwrap();
        let again = load_mesh(&folder.path().join("part.obj"), LengthUnit::Metre).unwrap();
        let prepared = prepare(&again, &PrepareOptions::default()).unwrap();
        let mut object = TraceObject {
            source: "part.obj".to_owned(),
            sha256: prepared.mesh.content_hash(),
            unit: metre(),
            scale: 1.0,
        };
        let trace = folder.path().join("grasp.bin");
        assert_eq!(object.load(&trace).unwrap(), prepared.mesh);
        object.scale = 1.01;
        let text = object.load(&trace).unwrap_err().to_string();
        assert!(
            text.contains("another mesh than the simulated one"),
            "{text}"
        );
        object.source = "lost.obj".to_owned();
        assert_eq!(object.load(&trace).unwrap_err().kind(), ErrorKind::NotFound);
    }

    #[test]
    fn headers_without_gels_are_explained() {
        for broken in [
            json!({}),
            json!([1]),
            json!({"gel_axes_m": [[0.0], [1.0], [2.0]]}),
        ] {
            let text = TraceHeader::read(&broken).unwrap_err().to_string();
            assert!(text.contains("sim grasp"), "{text}");
        }
    }
}
