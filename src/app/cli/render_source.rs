//! What is rendered: a trace of a simulated grasp with its object.

use std::fs;
use std::path::{Path, PathBuf};

use serde::Deserialize;

use crate::error::{Error, ErrorKind, Result};
use crate::geometry::{LengthUnit, PrepareOptions, TriangleMesh, builtin, load_mesh, prepare};
use crate::render::tactile::SimulatedGel;
use crate::sim::fem::GelGrid;
use crate::sim::grasp::{Snapshot, StageName, Trace, TraceFile};

/// The moment of a grasp that is rendered.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub(super) enum Moment {
    /// Before the fingers close: the initial frame
    Initial,
    /// The end of closing
    Closure,
    /// The end of the force adjustment: the grasp frame
    Grasp,
    /// The end of the lift
    Lift,
}

impl Moment {
    /// Its name on the command line.
    pub(super) fn name(self) -> &'static str {
        match self {
            Self::Initial => "initial",
            Self::Closure => "closure",
            Self::Grasp => "grasp",
            Self::Lift => "lift",
        }
    }

    fn stage(self) -> Option<StageName> {
        match self {
            Self::Initial => None,
            Self::Closure => Some(StageName::Closure),
            Self::Grasp => Some(StageName::Adjustment),
            Self::Lift => Some(StageName::Lift),
        }
    }
}

/// Where the object's mesh comes from.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct ObjectSource {
    /// File, or `builtin:NAME`.
    pub(super) name: String,
    /// Unit of the file's coordinates.
    pub(super) unit: LengthUnit,
    /// Factor on its size.
    pub(super) scale: f64,
}

impl ObjectSource {
    /// The file, where it is one.
    pub(super) fn path(&self) -> Option<&Path> {
        let is_file = !self.name.starts_with("builtin:");
        is_file.then(|| Path::new(&self.name))
    }

    /// The mesh as it is simulated, m.
    pub(super) fn load(&self) -> Result<TriangleMesh> {
        let mesh = match self.path() {
            Some(path) => load_mesh(path, self.unit)?,
            None => builtin(&self.name)?,
        };
        let prepared = prepare(&mesh.scaled(self.scale), &PrepareOptions::default());
        Ok(prepared.map_err(|e| e.at(&self.name))?.mesh)
    }
}

/// A simulated grasp read back.
pub(super) struct SimulatedGrasp {
    pub(super) object: ObjectSource,
    pub(super) mesh: TriangleMesh,
    pub(super) gel: SimulatedGel,
    pub(super) trace: Trace,
    pub(super) start: Start,
}

/// How the grasp began.
#[derive(Clone, Copy, Debug, Deserialize)]
pub(super) struct Start {
    pub(super) t_world_object: crate::geometry::Pose,
    pub(super) t_object_gripper: crate::geometry::Pose,
    pub(super) opening_m: f64,
}

/// The parts of a trace's header that rendering needs.
#[derive(Deserialize)]
struct Header {
    object: ObjectHeader,
    pose: Start,
    parameters: Parameters,
    gel_axes_m: [Vec<f64>; 3],
}

#[derive(Deserialize)]
struct ObjectHeader {
    source: String,
    unit: String,
    scale: f64,
    sha256: String,
}

#[derive(Deserialize)]
struct Parameters {
    solver: Solver,
}

#[derive(Deserialize)]
struct Solver {
    d_hat_m: f64,
}

impl SimulatedGrasp {
    /// Reads a trace and the mesh that it names; `object` replaces the name of the mesh.
    ///
    /// A mesh file is looked for where the trace says, then relative to the trace, then beside it.
    pub(super) fn read(path: &Path, object: Option<&str>) -> Result<Self> {
        let bytes = fs::read(path)
            .map_err(|e| Error::io("cannot read the trace", e).at(path.display()))?;
        Self::parse(&bytes, path, object).map_err(|e| e.at(path.display()))
    }

    fn parse(bytes: &[u8], path: &Path, object: Option<&str>) -> Result<Self> {
        let file = TraceFile::read(bytes)?;
        let header: Header = serde_json::from_value(file.header).map_err(|e| {
            Error::new(
                ErrorKind::Input,
                "the trace does not say which object, gel or pose it belongs to",
            )
            .because(e)
            .remedy("simulate the grasp again with this gripcast")
        })?;
        let name = match object {
            Some(name) => name.to_owned(),
            None => found(&header.object.source, path),
        };
        let object = ObjectSource {
            name,
            unit: header.object.unit.parse()?,
            scale: header.object.scale,
        };
        let mesh = object
            .load()
            .map_err(|e| e.remedy("name the mesh that was simulated with --object"))?;
        let hash = mesh.content_hash();
        if hash != header.object.sha256 {
            let (expected, found) = (short(&header.object.sha256), short(&hash));
            return Err(Error::new(
                ErrorKind::Input,
                format!(
                    "{} is another mesh than the simulated one: expected {expected}, found {found}",
                    object.name
                ),
            )
            .remedy("name the mesh that was simulated with --object, or simulate again"));
        }
        let gel = SimulatedGel {
            grid: GelGrid::new(header.gel_axes_m)?,
            d_hat_m: header.parameters.solver.d_hat_m,
        };
        Ok(Self {
            object,
            mesh,
            gel,
            trace: file.trace,
            start: header.pose,
        })
    }

    /// The state at a moment; `None` for the initial one, which has none.
    pub(super) fn snapshot(&self, moment: Moment) -> Result<Option<&Snapshot>> {
        let Some(stage) = moment.stage() else {
            return Ok(None);
        };
        let found = self.trace.snapshots.iter().rfind(|s| s.stage == stage);
        found.map(Some).ok_or_else(|| {
            let reached: Vec<_> = [Moment::Closure, Moment::Grasp, Moment::Lift]
                .into_iter()
                .filter(|m| self.trace.snapshots.iter().any(|s| Some(s.stage) == m.stage()))
                .map(Moment::name)
                .collect();
            Error::new(
                ErrorKind::Input,
                format!("the grasp ended before its {}", moment.name()),
            )
            .remedy(format!("it has: initial {}", reached.join(" ")))
        })
    }
}

fn short(hash: &str) -> &str {
    hash.get(..12).unwrap_or(hash)
}

/// Where a mesh named by a trace lies.
fn found(source: &str, trace: &Path) -> String {
    if source.starts_with("builtin:") || Path::new(source).exists() {
        return source.to_owned();
    }
    let folder = trace.parent().unwrap_or_else(|| Path::new(""));
    let file_name = Path::new(source).file_name().unwrap_or_default();
    let places: [PathBuf; 2] = [folder.join(source), folder.join(file_name)];
    let there = places.into_iter().find(|place| place.exists());
    there.map_or_else(|| source.to_owned(), |place| place.display().to_string())
}
