//! One simulation of a replay, and the file with its result.

use std::fs;

use serde::{Deserialize, Serialize};
use serde_json::{Value, json};
use sha2::{Digest as _, Sha256};

use super::curves::{curves, min_height_m};
use super::object_file::ReplayObject;
use super::report::{CaseFacts, Curves, Setting};
use gripcast_base::error::{Error, Result};
use gripcast_base::files::{BeneathPath, FileKind, FileName, hex};
use gripcast_base::workers::thread_cpu_s;
use gripcast_sim::grasp::{
    GraspOutcome, GraspResult, STEADY_STEPS, Snapshot, StageName, Trace, TraceFile,
};
use gripcast_sim::{Engine, GraspSetup};

const FORMAT: &str = "gripcast-replay-case";
/// Incremented whenever a simulator changes its results within a release.
const VERSION: u32 = 1;
/// Suffix of trace files.
const TRACE: &str = "trace.bin";
/// Outcome of a case that the engine refuses.
pub(super) const REFUSED: &str = "refused";

/// One grasp in one engine with one setting.
#[derive(Clone)]
pub struct Case<'a> {
    /// The engine.
    pub engine: &'a dyn Engine,
    /// Initial poses, mesh and mass.
    pub setup: GraspSetup,
    /// The object.
    pub object: &'a ReplayObject,
    /// Friction and force.
    pub setting: Setting,
}

/// Stored result of a case.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CaseRecord {
    format: String,
    version: u32,
    /// All inputs that the result depends on.
    identity: Value,
    /// Outcome and CPU time.
    pub facts: CaseFacts,
    /// Forces and heights over time.
    pub curves: Curves,
}

impl CaseFacts {
    /// Label: stable or slip; none if the simulation has no outcome.
    pub fn stable(&self) -> Option<bool> {
        let without = [
            GraspOutcome::NotConverged.name(),
            GraspOutcome::PenetratingStart.name(),
            REFUSED,
        ];
        (!without.contains(&self.outcome.as_str()))
            .then(|| self.outcome == GraspOutcome::Success.name())
    }
}

impl Case<'_> {
    /// All inputs that the result depends on.
    ///
    /// # Errors
    /// `Internal` if a number has no JSON representation.
    pub fn identity(&self) -> Result<Value> {
        let GraspSetup {
            mesh: _,
            mass_kg,
            t_world_object,
            t_world_gripper,
            opening_m,
        } = &self.setup;
        Ok(json!({
            "version": VERSION,
            // Simulators may change between releases.
            "software": env!("CARGO_PKG_VERSION"),
            "engine": self.engine.kind().name(),
            "parameters": self.engine.parameters()?,
            "mesh_sha256": self.object.mesh_sha256,
            "mass_kg": mass_kg,
            "t_world_object": t_world_object,
            "t_world_gripper": t_world_gripper,
            "opening_m": opening_m,
            "friction": self.setting.friction,
            "force_n": self.setting.force_n,
        }))
    }

    /// Simulates the case. An input that the engine refuses has the outcome `refused`.
    ///
    /// # Errors
    /// `Internal` if a number has no JSON representation.
    pub fn simulate(&self) -> Result<(CaseRecord, Trace)> {
        let Setting { friction, force_n } = self.setting;
        let start = thread_cpu_s();
        let result = self.engine.simulate(&self.setup, friction, force_n);
        let cpu_s = thread_cpu_s() - start;
        let (facts, curves, trace) = match result {
            Ok(result) => {
                let facts = self.facts(&result, cpu_s);
                let mut curves = curves(&result.trace, &self.setup);
                curves.success_height_m = self.engine.success_height_m();
                (facts, curves, result.trace)
            }
            Err(error) => {
                let facts = CaseFacts {
                    outcome: REFUSED.to_owned(),
                    detail: Some(error.to_string()),
                    cpu_s,
                    ..CaseFacts::default()
                };
                (facts, Curves::default(), Trace::default())
            }
        };
        let record = CaseRecord {
            format: FORMAT.to_owned(),
            version: VERSION,
            identity: self.identity()?,
            facts,
            curves,
        };
        Ok((record, trace))
    }

    fn facts(&self, result: &GraspResult, cpu_s: f64) -> CaseFacts {
        let trace = &result.trace;
        let end = trace.steps.last();
        let t_world_object = end.map_or(self.setup.t_world_object, |step| step.t_world_object);
        let iterations = trace.steps.iter().filter_map(|step| step.solver);
        CaseFacts {
            outcome: result.outcome.name().to_owned(),
            detail: result.detail.clone(),
            min_height_m: min_height_m(&self.setup.mesh, &t_world_object),
            lifted_m: result.lifted_m,
            force_n: trace
                .mean_force(StageName::Adjustment, STEADY_STEPS)
                .or_else(|| trace.mean_force(StageName::Closure, 1)),
            steps: trace.steps.len(),
            newton_iterations: iterations.map(|step| u64::from(step.iterations)).sum(),
            unconverged_steps: result.unconverged_steps,
            cpu_s,
        }
    }

    /// Creates the trace file for `gripcast render`.
    fn trace_file(&self, record: &CaseRecord, trace: Trace) -> Result<TraceFile> {
        let GraspSetup {
            t_world_object,
            t_world_gripper,
            opening_m,
            ..
        } = &self.setup;
        let mut header = json!({
            "outcome": record.facts.outcome,
            "object": {
                "source": absolute(&self.object.source),
                "unit": self.object.unit.to_string(),
                "scale": self.object.file.scale,
                "sha256": self.object.mesh_sha256,
                "mass_kg": self.setup.mass_kg,
                "friction": self.setting.friction,
            },
            "pose": {
                "t_world_object": t_world_object,
                "t_object_gripper": t_world_object.inverse() * *t_world_gripper,
                "opening_m": opening_m,
            },
            "stop_force_n": self.setting.force_n,
            "parameters": self.engine.parameters()?,
        });
        if let Some((grid, _)) = self.engine.gel()? {
            header["gel_axes_m"] = json!(grid.axes());
        }
        Ok(TraceFile { header, trace })
    }
}

fn absolute(source: &str) -> String {
    let path = fs::canonicalize(source).ok();
    path.and_then(|path| path.to_str().map(str::to_owned))
        .unwrap_or_else(|| source.to_owned())
}

/// A folder of finished cases; files are written atomically.
#[derive(Clone, Debug)]
pub struct CaseStore {
    folder: BeneathPath,
}

impl CaseStore {
    /// Creates a store in a folder, which is created with the first case.
    pub fn new(folder: BeneathPath) -> Self {
        Self { folder }
    }

    /// Loads a finished case; none if it is missing, damaged or another case.
    ///
    /// # Errors
    /// `Internal` if a number has no JSON representation.
    pub fn load(&self, case: &Case<'_>) -> Result<Option<CaseRecord>> {
        let identity = case.identity()?;
        let Ok(bytes) = self.path(&identity, "json")?.read(FileKind::List) else {
            return Ok(None);
        };
        let record: Option<CaseRecord> = serde_json::from_slice(&bytes).ok();
        Ok(record.filter(|found| {
            found.format == FORMAT && found.version == VERSION && found.identity == identity
        }))
    }

    /// Saves a finished case, and its trace if it contains gels.
    ///
    /// # Errors
    /// `DiskFull`, `Io`, …
    pub fn save(&self, case: &Case<'_>, record: &CaseRecord, trace: Trace) -> Result<()> {
        let save = |path: BeneathPath, bytes: &[u8]| {
            path.parent()
                .create_dir_all()
                .and_then(|()| path.replace(bytes))
                .map_err(|e| Error::io("cannot write the case", e).at(path.display()))
        };
        if has_gels(&trace) {
            let bytes = case.trace_file(record, trace)?.to_bytes()?;
            save(self.path(&record.identity, TRACE)?, &bytes)?;
        }
        let text = serde_json::to_vec(record)
            .map_err(|e| Error::internal("cannot write JSON").because(e))?;
        save(self.path(&record.identity, "json")?, &text)
    }

    /// Loads the state of a finished case at the end of a stage, if its trace contains it.
    ///
    /// # Errors
    /// `Internal` if a number has no JSON representation.
    pub fn snapshot(&self, case: &Case<'_>, stage: StageName) -> Result<Option<Snapshot>> {
        let file = self
            .path(&case.identity()?, TRACE)?
            .read(FileKind::Mesh)
            .ok();
        let file = file.and_then(|bytes| TraceFile::read(&bytes).ok());
        let mut snapshots = file.into_iter().flat_map(|file| file.trace.snapshots);
        Ok(snapshots.find(|snapshot| snapshot.stage == stage))
    }

    /// Returns `<2 hex>/<30 hex>.<suffix>` of the hash of the identity.
    fn path(&self, identity: &Value, suffix: &str) -> Result<BeneathPath> {
        let text = serde_json::to_vec(identity)
            .map_err(|e| Error::internal("cannot write JSON").because(e))?;
        let digest = Sha256::digest(text);
        let name = FileName::parse(&format!("{}.{suffix}", hex(&digest[1..16])))?;
        Ok(self.folder.join_number("", digest[0]).join(&name))
    }
}

fn has_gels(trace: &Trace) -> bool {
    let mut gels = trace.snapshots.iter().flat_map(|s| &s.gels);
    gels.any(|nodes| !nodes.is_empty())
}

#[cfg(test)]
#[path = "case_test.rs"]
mod tests;
