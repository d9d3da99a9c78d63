//! One simulation of a replay, and the file that holds its result.

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

/// Name of the format in the file.
const FORMAT: &str = "gripcast-replay-case";
/// Raised whenever a simulator gives another result for the same input within a release.
const VERSION: u32 = 1;
/// Suffix of traces.
const TRACE: &str = "trace.bin";
/// Outcome of a case that an engine refuses.
pub(super) const REFUSED: &str = "refused";

/// A grasp in one engine with one friction and force.
#[derive(Clone)]
pub struct Case<'a> {
    /// The engine.
    pub engine: &'a dyn Engine,
    /// Where everything is.
    pub setup: GraspSetup,
    /// The object.
    pub object: &'a ReplayObject,
    /// Friction and force.
    pub setting: Setting,
}

/// Result of a case as it is stored.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CaseRecord {
    format: String,
    version: u32,
    /// Everything that the result depends on.
    identity: Value,
    /// Outcome and cost.
    pub facts: CaseFacts,
    /// Forces and heights.
    pub curves: Curves,
}

impl CaseFacts {
    /// Whether the object was held; none where the simulation has no outcome.
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
    /// Everything that the result depends on.
    ///
    /// # Errors
    /// `Internal` where a number has no JSON form.
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
            // Another release may have other simulators.
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

    /// Simulates it.
    ///
    /// An engine that refuses the input has no outcome but `refused`, with its reason.
    ///
    /// # Errors
    /// `Internal` where a number has no JSON form.
    pub fn simulate(&self) -> Result<(CaseRecord, Trace)> {
        let Setting { friction, force_n } = self.setting;
        let began = thread_cpu_s();
        let result = self.engine.simulate(&self.setup, friction, force_n);
        let cpu_s = thread_cpu_s() - began;
        let (facts, curves, trace) = match result {
            Ok(result) => {
                let facts = self.facts(&result, cpu_s);
                let mut curves = curves(&result.trace, &self.setup);
                curves.success_height_m = self.engine.success_height_m();
                (facts, curves, result.trace)
            }
            Err(error) => (refused(&error, cpu_s), Curves::default(), Trace::default()),
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

    /// The trace as a file that `gripcast render` reads.
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

fn refused(error: &Error, cpu_s: f64) -> CaseFacts {
    CaseFacts {
        outcome: REFUSED.to_owned(),
        detail: Some(error.to_string()),
        min_height_m: 0.0,
        lifted_m: 0.0,
        force_n: None,
        steps: 0,
        newton_iterations: 0,
        unconverged_steps: 0,
        cpu_s,
    }
}

fn absolute(source: &str) -> String {
    let path = fs::canonicalize(source).ok();
    path.and_then(|path| path.to_str().map(str::to_owned))
        .unwrap_or_else(|| source.to_owned())
}

/// The folder of finished cases. A file is there whole or not at all.
#[derive(Clone, Debug)]
pub struct CaseStore {
    folder: BeneathPath,
}

impl CaseStore {
    /// A store in a folder, which is made with the first case.
    pub fn new(folder: BeneathPath) -> Self {
        Self { folder }
    }

    /// A finished case; none if it is not there, or what is there is damaged or another case.
    ///
    /// # Errors
    /// `Internal` where a number has no JSON form.
    pub fn find(&self, case: &Case<'_>) -> Result<Option<CaseRecord>> {
        let identity = case.identity()?;
        let Ok(bytes) = self.place(&identity, "json")?.read(FileKind::List) else {
            return Ok(None);
        };
        let record: Option<CaseRecord> = serde_json::from_slice(&bytes).ok();
        Ok(record.filter(|found| {
            found.format == FORMAT && found.version == VERSION && found.identity == identity
        }))
    }

    /// Stores a finished case with its trace, where it has one that renderers need.
    ///
    /// # Errors
    /// `DiskFull`, `Io`, …
    pub fn keep(&self, case: &Case<'_>, record: &CaseRecord, trace: Trace) -> Result<()> {
        let save = |place: BeneathPath, bytes: &[u8]| {
            place
                .parent()
                .create_dir_all()
                .and_then(|()| place.replace(bytes))
                .map_err(|e| Error::io("cannot write the case", e).at(place.display()))
        };
        if has_gels(&trace) {
            let bytes = case.trace_file(record, trace)?.to_bytes()?;
            save(self.place(&record.identity, TRACE)?, &bytes)?;
        }
        let text = serde_json::to_vec(record)
            .map_err(|e| Error::internal("cannot write JSON").because(e))?;
        save(self.place(&record.identity, "json")?, &text)
    }

    /// The state of a finished case at the end of a stage; none if its trace has none.
    ///
    /// # Errors
    /// `Internal` where a number has no JSON form.
    pub fn snapshot(&self, case: &Case<'_>, stage: StageName) -> Result<Option<Snapshot>> {
        let file = self
            .place(&case.identity()?, TRACE)?
            .read(FileKind::Mesh)
            .ok();
        let file = file.and_then(|bytes| TraceFile::read(&bytes).ok());
        let mut snapshots = file.into_iter().flat_map(|file| file.trace.snapshots);
        Ok(snapshots.find(|snapshot| snapshot.stage == stage))
    }

    /// `<2 hex>/<30 hex>.<suffix>` of the hash of the identity.
    fn place(&self, identity: &Value, suffix: &str) -> Result<BeneathPath> {
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
