//! What is rendered: a trace of a simulated grasp with its object.

use std::fs;
use std::path::Path;

use serde::Deserialize;

use super::sim_object::SimObject;
use crate::error::{Error, ErrorKind, Result};
use crate::geometry::{LengthUnit, Pose, TriangleMesh};
use crate::render::tactile::{SimulatedGel, TraceHeader, TraceObject};
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
        SimObject::read(&self.name, self.unit, self.scale).map(|object| object.mesh)
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

/// How the grasp began: the header's `pose`.
#[derive(Clone, Copy, Debug, Deserialize)]
pub(super) struct Start {
    pub(super) t_world_object: Pose,
    pub(super) t_object_gripper: Pose,
    pub(super) opening_m: f64,
}

impl Start {
    /// The gripper in the world.
    pub(super) fn t_world_gripper(&self) -> Pose {
        self.t_world_object * self.t_object_gripper
    }
}

impl SimulatedGrasp {
    /// Reads a trace and the mesh that it names; `object` replaces the name of the mesh.
    pub(super) fn read(path: &Path, object: Option<&str>) -> Result<Self> {
        let bytes =
            fs::read(path).map_err(|e| Error::io("cannot read the trace", e).at(path.display()))?;
        Self::parse(&bytes, path, object).map_err(|e| e.at(path.display()))
    }

    fn parse(bytes: &[u8], path: &Path, object: Option<&str>) -> Result<Self> {
        let file = TraceFile::read(bytes)?;
        let TraceHeader { gel, object: named } = TraceHeader::read(&file.header)?;
        let named = TraceObject {
            source: object.map_or(named.source, str::to_owned),
            ..named
        };
        let start = Start::deserialize(&file.header["pose"]).map_err(|e| {
            Error::new(
                ErrorKind::Input,
                "the trace's header does not tell how the grasp began",
            )
            .because(e)
            .remedy("simulate the grasp again with this gripcast")
        })?;
        let mesh = named.load(path)?;
        let file_name = named.file(path);
        Ok(Self {
            object: ObjectSource {
                name: file_name.map_or(named.source, |file| file.display().to_string()),
                unit: named.unit.parse()?,
                scale: named.scale,
            },
            mesh,
            gel,
            trace: file.trace,
            start,
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
                .filter(|m| {
                    self.trace
                        .snapshots
                        .iter()
                        .any(|s| Some(s.stage) == m.stage())
                })
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
