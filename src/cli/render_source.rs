//! What is rendered: a trace of a simulated grasp with its object.

use std::path::Path;

use serde_json::Value;

use super::sim_object::SimObject;
use super::working::Progress;
use gripcast_base::error::{Error, Result};
use gripcast_base::files::{FileKind, read_regular};
use gripcast_geometry::{LengthUnit, TriangleMesh};
use gripcast_sim::grasp::{Snapshot, StageName, Trace, TraceFile};
use gripcast_tactile::{SimulatedGel, TraceHeader, TraceObject, TraceStart};
use gripcast_visual::{Finish, Model, demo_model, random_finish};

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

    /// The mesh with its looks; `finish` for what has none of its own, else one is drawn.
    pub(super) fn model(
        &self,
        finish: Option<Finish>,
        seed: u64,
        progress: &Progress,
    ) -> Result<Model> {
        let Some(path) = self.path() else {
            return match finish {
                None => demo_model(&self.name, seed),
                Some(finish) => Model::with_finish(&self.load()?, finish, seed),
            };
        };
        let finish = finish.unwrap_or_else(|| random_finish(seed));
        let loaded = Model::load(path, self.unit, finish, seed)?;
        for warning in &loaded.warnings {
            progress.line(format!("{}: {warning}", path.display()));
        }
        Ok(loaded.model.scaled(self.scale))
    }
}

/// A simulated grasp read back.
pub(super) struct SimulatedGrasp {
    pub(super) object: ObjectSource,
    pub(super) mesh: TriangleMesh,
    pub(super) gel: SimulatedGel,
    pub(super) header: Value,
    pub(super) trace: Trace,
    pub(super) start: TraceStart,
}

impl SimulatedGrasp {
    /// Reads a trace and the mesh that it names; `object` replaces the name of the mesh.
    pub(super) fn read(path: &Path, object: Option<&str>) -> Result<Self> {
        let bytes = read_regular(path, FileKind::Mesh)
            .map_err(|e| Error::io("cannot read the trace", e).at(path.display()))?;
        Self::parse(&bytes, path, object).map_err(|e| e.at(path.display()))
    }

    fn parse(bytes: &[u8], path: &Path, object: Option<&str>) -> Result<Self> {
        let file = TraceFile::read(bytes)?;
        let TraceHeader { gel, object: named } = TraceHeader::read(&file.header)?;
        let named = TraceObject {
            source: object.map_or(named.source, str::to_owned),
            ..named
        };
        let start = TraceStart::read(&file.header)?;
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
            header: file.header,
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
            Error::input(format!("the grasp ended before its {}", moment.name()))
                .remedy(format!("it has: initial {}", reached.join(" ")))
        })
    }
}
