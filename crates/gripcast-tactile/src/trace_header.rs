//! Object and gel data in the header of a trace.

use std::path::{Path, PathBuf};

use serde::Deserialize;
use serde_json::Value;

use super::scene::SimulatedGel;
use gripcast_base::error::{Error, Result};
use gripcast_geometry::{
    LengthUnit, MeshOptions, Pose, PrepareOptions, Repair, TriangleMesh, load_object_mesh,
};
use gripcast_sim::fem::GelGrid;

/// Object of a trace, from the header's `object`: `{"source", "sha256", "unit", "scale", "repair",
/// "wall_thickness_mm"}`.
#[derive(Clone, Debug, PartialEq, Deserialize)]
pub struct TraceObject {
    /// Mesh file, or `builtin:NAME`.
    pub source: String,
    /// Hash of the simulated mesh ([`TriangleMesh::content_hash`]).
    pub sha256: String,
    /// Length unit of the file: mm, cm, m, in.
    #[serde(default = "metre")]
    pub unit: String,
    /// Scale factor.
    #[serde(default = "one")]
    pub scale: f64,
    /// How it was repaired: none, auto, strict.
    #[serde(default = "auto")]
    pub repair: String,
    /// Wall that an open surface got, mm.
    #[serde(default)]
    pub wall_thickness_mm: Option<f64>,
}

fn metre() -> String {
    LengthUnit::Metre.to_string()
}

fn auto() -> String {
    Repair::Auto.to_string()
}

fn one() -> f64 {
    1.0
}

/// Initial poses of a grasp, from the header's `pose`.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
pub struct TraceStart {
    /// Pose of the object in the world.
    pub t_world_object: Pose,
    /// Pose of the gripper in the object frame.
    pub t_object_gripper: Pose,
    /// Distance between the undeformed gel faces, m.
    pub opening_m: f64,
}

impl TraceStart {
    /// Parses the header of a trace file.
    ///
    /// # Errors
    /// `Input` if the header lacks the poses.
    pub fn read(header: &Value) -> Result<Self> {
        Self::deserialize(&header["pose"]).map_err(|cause| {
            Error::input("the trace header lacks the initial poses")
                .because(cause)
                .remedy("simulate the grasp again with this version of gripcast")
        })
    }

    /// Pose of the gripper in the world.
    pub fn t_world_gripper(&self) -> Pose {
        self.t_world_object * self.t_object_gripper
    }
}

/// Header data used by the renderers.
#[derive(Clone, Debug)]
pub struct TraceHeader {
    /// Gel, from the header's `gel_axes_m` and `parameters.solver.d_hat_m`.
    pub gel: SimulatedGel,
    /// Object.
    pub object: TraceObject,
}

impl TraceHeader {
    /// Parses the header of a trace file.
    ///
    /// # Errors
    /// `Input` if it lacks gel or object, or the gel mesh is invalid.
    pub fn read(header: &Value) -> Result<Self> {
        let lacking = |cause| {
            Error::input("the trace header lacks object or gel data")
                .because(cause)
                .remedy("create a trace with `gripcast sim grasp … --trace FILE.bin`")
        };
        let d_hat_m = &header["parameters"]["solver"]["d_hat_m"];
        let axes_m = Deserialize::deserialize(&header["gel_axes_m"]).map_err(lacking)?;
        Ok(Self {
            object: TraceObject::deserialize(&header["object"]).map_err(lacking)?,
            gel: SimulatedGel {
                d_hat_m: f64::deserialize(d_hat_m).map_err(lacking)?,
                grid: GelGrid::new(axes_m)?,
            },
        })
    }
}

impl TraceObject {
    /// How its mesh is read for the surface.
    ///
    /// # Errors
    /// `Usage` for an unknown unit or repair.
    pub fn options(&self) -> Result<MeshOptions> {
        Ok(MeshOptions {
            prepare: PrepareOptions {
                repair: self.repair.parse()?,
                wall_thickness_m: self.wall_thickness_mm.map(|mm| 1e-3 * mm),
                needs_inside: false,
                ..PrepareOptions::default()
            },
            ..MeshOptions::new(self.unit.parse()?, self.scale)
        })
    }

    /// Loads the simulated mesh from [`Self::file`] and verifies its hash.
    ///
    /// # Errors
    /// `NotFound`, `Io`, `Input` as for reading a mesh; `Input` if the mesh differs from the
    /// simulated one.
    pub fn load(&self, trace: &Path) -> Result<TriangleMesh> {
        let path = self.file(trace);
        let source = path.map_or(self.source.clone(), |path| {
            path.to_string_lossy().into_owned()
        });
        let mesh = load_object_mesh(&source, &self.options()?)?.mesh;
        if mesh.content_hash() != self.sha256 {
            return Err(Error::input(format!(
                "the mesh differs from the simulated one (unit {}, scale {})",
                self.unit, self.scale
            ))
            .at(&self.source)
            .remedy("pass the simulated mesh with --object, or simulate the grasp again"));
        }
        Ok(mesh)
    }

    /// Returns the mesh file; `None` for a built-in shape. A relative path that does not exist is
    /// resolved against the trace's folder, then by its file name in that folder.
    pub fn file(&self, trace: &Path) -> Option<PathBuf> {
        if self.source.starts_with("builtin:") {
            return None;
        }
        let given = PathBuf::from(&self.source);
        let folder = trace.parent().unwrap_or_else(|| Path::new(""));
        let name = given.file_name().unwrap_or_default();
        let candidates = [given.clone(), folder.join(&given), folder.join(name)];
        let found = candidates.into_iter().find(|path| path.exists());
        Some(found.unwrap_or(given))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use gripcast_base::error::ErrorKind;
    use gripcast_geometry::{builtin, load_mesh, prepare, save_mesh};
    use gripcast_sim::fem::{GelPad, GelResolution};
    use serde_json::json;

    fn header(object: Value) -> Value {
        let grid = GelPad::default().grid(GelResolution::Coarse).unwrap();
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
    fn header_contains_gel_and_object() {
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
    fn mesh_is_found_beside_trace_and_verified() {
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
            repair: auto(),
            wall_thickness_mm: None,
        };
        let trace = folder.path().join("grasp.bin");
        assert_eq!(object.load(&trace).unwrap(), prepared.mesh);
        object.scale = 1.01;
        let text = object.load(&trace).unwrap_err().to_string();
        assert!(text.contains("differs from the simulated one"), "{text}");
        object.source = "lost.obj".to_owned();
        assert_eq!(object.load(&trace).unwrap_err().kind(), ErrorKind::NotFound);
    }

    #[test]
    fn header_without_gel_is_refused() {
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
