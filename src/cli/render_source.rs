//! Input of the renderers: the trace of a simulated grasp and its object.

use std::path::Path;

use serde_json::Value;

use super::working::Progress;
use gripcast_base::error::{Error, Result};
use gripcast_base::files::{FileKind, read_regular};
use gripcast_geometry::{MeshOptions, TriangleMesh, load_object_mesh};
use gripcast_sim::grasp::{Snapshot, Trace, TraceFile};
use gripcast_tactile::{
    Moment, SensorMount, SimulatedGel, TactileScene, TraceHeader, TraceObject, TraceStart,
};
use gripcast_visual::{Finish, Model, demo_model, random_finish};

/// Mesh of a rendered object.
#[derive(Clone, Debug)]
pub(super) struct ObjectSource {
    /// File, or `builtin:NAME`.
    pub(super) name: String,
    /// How it is read.
    pub(super) options: MeshOptions,
}

impl ObjectSource {
    /// Loads the mesh as it is simulated, m.
    pub(super) fn load(&self) -> Result<TriangleMesh> {
        Ok(load_object_mesh(&self.name, &self.options)?.mesh)
    }

    /// Loads the mesh with its materials; `finish` replaces a missing material, else one is drawn
    /// from the seed.
    pub(super) fn model(
        &self,
        finish: Option<Finish>,
        seed: u64,
        progress: &Progress,
    ) -> Result<Model> {
        if self.name.starts_with("builtin:") {
            return match finish {
                None => demo_model(&self.name, seed),
                Some(finish) => Model::with_finish(&self.load()?, finish, seed),
            };
        }
        let path = Path::new(&self.name);
        let finish = finish.unwrap_or_else(|| random_finish(seed));
        let loaded = Model::load(path, self.options.unit, finish, seed)?;
        for warning in &loaded.warnings {
            progress.line(format!("{}: {warning}", path.display()));
        }
        Ok(loaded.model.scaled(self.options.scale))
    }
}

/// A simulated grasp.
pub(super) struct SimulatedGrasp {
    pub(super) object: ObjectSource,
    pub(super) mesh: TriangleMesh,
    pub(super) gel: SimulatedGel,
    pub(super) header: Value,
    pub(super) trace: Trace,
    pub(super) start: TraceStart,
}

impl SimulatedGrasp {
    /// Reads a trace and its mesh; `object` replaces the mesh named by the trace.
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
        let options = named.options()?;
        Ok(Self {
            object: ObjectSource {
                name: file_name.map_or(named.source, |file| file.display().to_string()),
                options,
            },
            mesh,
            gel,
            header: file.header,
            trace: file.trace,
            start,
        })
    }

    /// Returns the state at a moment; `None` for the initial one.
    pub(super) fn snapshot(&self, moment: Moment) -> Result<Option<&Snapshot>> {
        moment.snapshot(&self.trace)
    }

    /// Returns the contact scene of a sensor at a moment.
    pub(super) fn scene(&self, moment: Moment, mount: SensorMount) -> Result<TactileScene<'_>> {
        TactileScene::at_moment(
            &self.mesh,
            &self.gel,
            &self.start,
            &self.trace,
            moment,
            mount,
        )
    }
}
