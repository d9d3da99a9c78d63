//! Results of simulations: two files each, there whole or not at all.

use std::fs;
use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};
use sha2::{Digest as _, Sha256};

use super::plan::{Plan, PlannedSimulation};
use crate::error::{Error, ErrorKind, Result};
use crate::files::{save, sha256_hex};
use crate::shard::{ShardReader, ShardRow};
use crate::sim::grasp::Snapshot;

/// Folder of the results in that of the plan.
pub const RESULTS: &str = "results";
/// Name of the format in the file.
const FORMAT: &str = "gripcast-synth-result";
/// Raised whenever the same plan may give other results.
const VERSION: u32 = 4;

/// What became of a simulation.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SimulationResult {
    format: String,
    version: u32,
    /// Hash of the plan.
    pub plan_sha256: String,
    /// The simulation.
    pub id: String,
    /// `success`, `slip`, `eject`, …, or `failed` for a simulation that could not be done.
    pub outcome: String,
    /// More about it, where there is more to say.
    pub detail: Option<String>,
    /// Whether the object was held; none where there is no outcome, or nothing to see before the
    /// lift.
    pub stable: Option<bool>,
    /// Rise of the object's centre of mass, m.
    pub lifted_m: f64,
    /// Normal force on the left and the right finger before the lift, N.
    pub force_n: Option<[f64; 2]>,
    /// Steps.
    pub steps: usize,
    /// Newton iterations.
    pub newton_iterations: u64,
    /// Steps that did not converge.
    pub unconverged_steps: usize,
    /// The file of pictures; none where there is nothing to see, or they are still to be taken.
    pub samples: Option<SampleFile>,
    /// CPU time, s.
    pub cpu_s: CpuSeconds,
}

/// The file of a simulation's pictures.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SampleFile {
    /// Rows.
    pub rows: usize,
    /// Length, bytes.
    pub bytes: u64,
    /// SHA-256, 64 hex digits.
    pub sha256: String,
}

/// CPU time of the parts of a result, s.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CpuSeconds {
    /// Mesh, convex pieces.
    pub prepare: f64,
    /// The simulator.
    pub simulate: f64,
    /// Tactile pictures.
    pub tactile: f64,
    /// Colour pictures.
    pub visual: f64,
}

impl SimulationResult {
    /// A result without anything yet.
    pub(super) fn of(plan: &Plan, simulation: &PlannedSimulation) -> Self {
        Self {
            format: FORMAT.to_owned(),
            version: VERSION,
            plan_sha256: plan.sha256.clone(),
            id: simulation.id.clone(),
            outcome: FAILED.to_owned(),
            detail: None,
            stable: None,
            lifted_m: 0.0,
            force_n: None,
            steps: 0,
            newton_iterations: 0,
            unconverged_steps: 0,
            samples: None,
            cpu_s: CpuSeconds::default(),
        }
    }

    /// Whether nothing came of it.
    pub fn is_failed(&self) -> bool {
        self.outcome == FAILED
    }

    /// Whether it has a label but no pictures yet.
    pub fn lacks_pictures(&self) -> bool {
        self.stable.is_some() && self.samples.is_none()
    }
}

/// Outcome of a simulation that could not be done.
pub const FAILED: &str = "failed";

/// The results of a plan.
#[derive(Clone, Debug)]
pub struct ResultStore {
    folder: PathBuf,
}

impl ResultStore {
    /// The results beside the plan of a folder.
    pub fn beside(plan_folder: &Path) -> Self {
        Self {
            folder: plan_folder.join(RESULTS),
        }
    }

    /// A finished result; none if it is not there or damaged.
    ///
    /// # Errors
    /// `Input` for the result of another plan.
    pub fn find(&self, plan: &Plan, id: &str) -> Result<Option<SimulationResult>> {
        let path = self.path(id, "json");
        let Some(found) = read(&path) else {
            return Ok(None);
        };
        if found.plan_sha256 != plan.sha256 {
            return Err(Error::new(
                ErrorKind::Input,
                format!(
                    "the result is of another plan: expected {}, found {}",
                    short(&plan.sha256),
                    short(&found.plan_sha256)
                ),
            )
            .at(path.display())
            .remedy("keep each plan with its results in a folder of its own"));
        }
        let is_whole = found.format == FORMAT && found.version == VERSION && found.id == id;
        let has_samples = |file: &SampleFile| {
            fs::metadata(self.samples(id)).is_ok_and(|found| found.len() == file.bytes)
        };
        let is_whole = is_whole && found.samples.as_ref().is_none_or(has_samples);
        Ok(is_whole.then_some(found))
    }

    /// Keeps a result with its pictures, a file of rows.
    ///
    /// # Errors
    /// `DiskFull`, `Io`, …; what was finished before stays.
    pub fn keep(
        &self,
        mut result: SimulationResult,
        samples: Option<(usize, &[u8])>,
    ) -> Result<()> {
        let path = self.path(&result.id, "json");
        make_folder(&path)?;
        // The pictures first: a result that is there is whole.
        if let Some((rows, bytes)) = samples {
            save(&self.samples(&result.id), bytes)?;
            result.samples = Some(SampleFile {
                rows,
                bytes: bytes.len() as u64,
                sha256: sha256_hex(bytes),
            });
        }
        let text = serde_json::to_vec(&result)
            .map_err(|e| Error::new(ErrorKind::Internal, "cannot write JSON").because(e))?;
        save(&path, &text)
    }

    /// Keeps what pictures of a labelled simulation are to be taken of later.
    ///
    /// # Errors
    /// `DiskFull`, `Io`, ….
    pub(super) fn keep_state(&self, plan: &Plan, id: &str, snapshot: &Snapshot) -> Result<()> {
        let path = self.path(id, STATE);
        make_folder(&path)?;
        let state = State {
            version: VERSION,
            plan_sha256: plan.sha256.clone(),
            id: id.to_owned(),
            snapshot: snapshot.clone(),
        };
        let text = serde_json::to_string(&state)
            .map_err(|e| Error::new(ErrorKind::Internal, "cannot write JSON").because(e))?;
        save(&path, format!("{}\n{text}", sha256_hex(&text)).as_bytes())
    }

    /// The state before the lift that was kept; none where there is none, or a damaged one: then
    /// the simulation is done again.
    pub(super) fn state(&self, plan: &Plan, id: &str) -> Option<Snapshot> {
        let file = fs::read_to_string(self.path(id, STATE)).ok()?;
        let (hash, text) = file.split_once('\n')?;
        let state: State = serde_json::from_str(text).ok()?;
        let is_ours = hash == sha256_hex(text)
            && state.version == VERSION
            && state.plan_sha256 == plan.sha256
            && state.id == id;
        is_ours.then_some(state.snapshot)
    }

    /// Removes a state that is not needed any more.
    pub(super) fn drop_state(&self, id: &str) {
        // One that stays is only in the way.
        let _ = fs::remove_file(self.path(id, STATE));
    }

    /// Whether there is a file of a result, sound or not.
    pub fn is_begun(&self, id: &str) -> bool {
        self.path(id, "json").exists()
    }

    /// The renderings of a result, whose file must be the one that was kept.
    ///
    /// # Errors
    /// `Input` for pictures that are damaged or of another result; those of the operating system.
    pub fn rows(&self, result: &SimulationResult) -> Result<Vec<ShardRow>> {
        let path = self.samples(&result.id);
        let wrong = || {
            Error::new(ErrorKind::Input, "the pictures are not those of the result")
                .at(path.display())
                .remedy("remove the file and run its shard again: it comes out the same")
        };
        let expected = result.samples.as_ref().ok_or_else(wrong)?;
        let bytes = fs::read(&path)
            .map_err(|e| Error::io("cannot read the pictures", e).at(path.display()))?;
        if sha256_hex(&bytes) != expected.sha256 {
            return Err(wrong());
        }
        let reader = ShardReader::from_bytes(path.display().to_string(), bytes)?;
        reader.rows().collect()
    }

    /// The file of a simulation's pictures.
    pub fn samples(&self, id: &str) -> PathBuf {
        self.path(id, "parquet")
    }

    /// `<2 hex>/<id>.<suffix>`, so that no folder gets too many files.
    fn path(&self, id: &str, suffix: &str) -> PathBuf {
        let digest = Sha256::digest(id);
        self.folder
            .join(format!("{:02x}", digest[0]))
            .join(format!("{id}.{suffix}"))
    }
}

/// Suffix of the files of states.
const STATE: &str = "state";

/// What a simulation was kept in before its pictures. In its file it comes after a line with its
/// SHA-256.
#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct State {
    version: u32,
    plan_sha256: String,
    id: String,
    snapshot: Snapshot,
}

fn make_folder(path: &Path) -> Result<()> {
    let Some(folder) = path.parent() else {
        return Ok(());
    };
    fs::create_dir_all(folder)
        .map_err(|e| Error::io("cannot make the folder of the results", e).at(folder.display()))
}

fn read(path: &Path) -> Option<SimulationResult> {
    serde_json::from_slice(&fs::read(path).ok()?).ok()
}

fn short(hash: &str) -> &str {
    hash.get(..12).unwrap_or(hash)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::synth::plan::sample_plan;

    fn result(plan: &Plan) -> SimulationResult {
        SimulationResult {
            outcome: "slip".to_owned(),
            stable: Some(false),
            ..SimulationResult::of(plan, &plan.simulations[0])
        }
    }

    #[test]
    fn a_result_is_found_again_only_whole_and_of_its_plan() {
        let folder = tempfile::tempdir().unwrap();
        let store = ResultStore::beside(folder.path());
        let plan = sample_plan(3);
        let id = &plan.simulations[0].id;
        assert_eq!(store.find(&plan, id).unwrap(), None);
        store.keep(result(&plan), Some((3, b"rows"))).unwrap();
        let found = store.find(&plan, id).unwrap().unwrap();
        assert_eq!(found.stable, Some(false));
        assert_eq!(found.samples.as_ref().unwrap().rows, 3);
        let error = store.find(&sample_plan(4), id).unwrap_err().to_string();
        assert!(error.contains("another plan"), "{error}");
        fs::write(store.samples(id), b"row").unwrap();
        assert_eq!(store.find(&plan, id).unwrap(), None, "pictures cut off");
        store.keep(result(&plan), None).unwrap();
        assert!(store.find(&plan, id).unwrap().is_some());
        fs::write(store.path(id, "json"), b"{").unwrap();
        assert_eq!(store.find(&plan, id).unwrap(), None, "a damaged result");
    }
}
