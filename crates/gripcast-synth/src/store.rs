//! Results of simulations: two files each, there whole or not at all.

use std::path::Path;

use serde::{Deserialize, Serialize};
use sha2::{Digest as _, Sha256};

use super::plan::{Plan, PlannedSimulation};
use gripcast_base::error::{Error, Refused, Result};
use gripcast_base::files::{BeneathPath, FileKind, Printable, Root, SimulationId, sha256_hex};
use gripcast_dataset::shard::{ShardReader, ShardRow};
use gripcast_sim::grasp::Snapshot;

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
    pub id: SimulationId,
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
    /// The file of images; none where there is nothing to see, or they are still to be taken.
    pub samples: Option<SampleFile>,
    /// CPU time, s.
    pub cpu_s: CpuSeconds,
}

/// The file of a simulation's images.
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
    /// Tactile images.
    pub tactile: f64,
    /// Colour images.
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

    /// Whether it has a label but no images yet.
    pub fn lacks_images(&self) -> bool {
        self.stable.is_some() && self.samples.is_none()
    }
}

/// Outcome of a simulation that could not be done.
pub const FAILED: &str = "failed";

/// The results of a plan.
#[derive(Clone, Debug)]
pub struct ResultStore {
    folder: BeneathPath,
}

impl ResultStore {
    /// The results beside the plan of a folder.
    pub fn beside(plan_folder: &Path) -> Self {
        Self {
            folder: Root::new(plan_folder).top().join(RESULTS),
        }
    }

    /// A finished result; none if it is not there or damaged.
    ///
    /// # Errors
    /// `Input` for the result of another plan, and a file that leads out of the plan's folder.
    pub fn find(&self, plan: &Plan, id: &SimulationId) -> Result<Option<SimulationResult>> {
        let place = self.place(id, FACTS);
        let Some(found) = read(&place)? else {
            return Ok(None);
        };
        if found.plan_sha256 != plan.sha256 {
            return Err(Error::input(format!(
                "the result is of another plan: expected {}, found {}",
                short(&plan.sha256),
                Printable(short(&found.plan_sha256))
            ))
            .at(place.display())
            .remedy("keep each plan with its results in a folder of its own"));
        }
        let is_whole = found.format == FORMAT && found.version == VERSION && found.id == *id;
        let has_samples = |file: &SampleFile| {
            let there = self.samples(id).metadata();
            there.is_ok_and(|there| there.is_file && there.bytes == file.bytes)
        };
        let is_whole = is_whole && found.samples.as_ref().is_none_or(has_samples);
        Ok(is_whole.then_some(found))
    }

    /// Keeps a result with its images, a file of rows.
    ///
    /// # Errors
    /// `DiskFull`, `Io`, …; what was finished before stays.
    pub fn keep(
        &self,
        mut result: SimulationResult,
        samples: Option<(usize, &[u8])>,
    ) -> Result<()> {
        // The images first: a result that is there is whole.
        if let Some((rows, bytes)) = samples {
            write(&self.samples(&result.id), bytes)?;
            result.samples = Some(SampleFile {
                rows,
                bytes: bytes.len() as u64,
                sha256: sha256_hex(bytes),
            });
        }
        let text = serde_json::to_vec(&result)
            .map_err(|e| Error::internal("cannot write JSON").because(e))?;
        write(&self.place(&result.id, FACTS), &text)
    }

    /// Keeps what images of a labelled simulation are to be taken of later.
    ///
    /// # Errors
    /// `DiskFull`, `Io`, ….
    pub(super) fn keep_state(
        &self,
        plan: &Plan,
        id: &SimulationId,
        snapshot: &Snapshot,
    ) -> Result<()> {
        let state = State {
            version: VERSION,
            plan_sha256: plan.sha256.clone(),
            id: id.clone(),
            snapshot: snapshot.clone(),
        };
        let text = serde_json::to_string(&state)
            .map_err(|e| Error::internal("cannot write JSON").because(e))?;
        let file = format!("{}\n{text}", sha256_hex(&text));
        write(&self.place(id, STATE), file.as_bytes())
    }

    /// The state before the lift that was kept; none where there is none, or a damaged one: then
    /// the simulation is done again.
    pub(super) fn state(&self, plan: &Plan, id: &SimulationId) -> Option<Snapshot> {
        let file = self.place(id, STATE).read_to_string(FileKind::Mesh).ok()?;
        let (hash, text) = file.split_once('\n')?;
        let state: State = serde_json::from_str(text).ok()?;
        let is_ours = hash == sha256_hex(text)
            && state.version == VERSION
            && state.plan_sha256 == plan.sha256
            && state.id == *id;
        is_ours.then_some(state.snapshot)
    }

    /// Removes a state that is not needed any more.
    pub(super) fn drop_state(&self, id: &SimulationId) {
        // One that stays is only in the way.
        let _ = self.place(id, STATE).remove_file();
    }

    /// Whether there is a file of a result, sound or not.
    pub fn is_begun(&self, id: &SimulationId) -> bool {
        self.place(id, FACTS).is_taken()
    }

    /// The renderings of a result, whose file must be the one that was kept.
    ///
    /// # Errors
    /// `Input` for images that are damaged or of another result; those of the operating system.
    pub fn rows(&self, result: &SimulationResult) -> Result<Vec<ShardRow>> {
        let place = self.samples(&result.id);
        let wrong = || {
            Error::input("the images are not those of the result")
                .at(place.display())
                .remedy("remove the file and run its shard again: it comes out the same")
        };
        let expected = result.samples.as_ref().ok_or_else(wrong)?;
        let bytes = place
            .read(FileKind::Bulk)
            .map_err(|e| Error::io("cannot read the images", e).at(place.display()))?;
        if sha256_hex(&bytes) != expected.sha256 {
            return Err(wrong());
        }
        let reader = ShardReader::from_bytes(place.display().to_string(), bytes)?;
        reader.rows().collect()
    }

    /// The file of a simulation's images.
    pub fn samples(&self, id: &SimulationId) -> BeneathPath {
        self.place(id, ".parquet")
    }

    /// `<2 hex>/<id><suffix>`, so that no folder gets too many files.
    fn place(&self, id: &SimulationId, suffix: &'static str) -> BeneathPath {
        let digest = Sha256::digest(id.as_str());
        self.folder
            .join_number("", digest[0])
            .join_affixed("", id, suffix)
    }
}

/// Suffix of the files of results.
const FACTS: &str = ".json";
/// Suffix of the files of states.
const STATE: &str = ".state";

/// What a simulation was kept in before its images. In its file it comes after a line with its
/// SHA-256.
#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct State {
    version: u32,
    plan_sha256: String,
    id: SimulationId,
    snapshot: Snapshot,
}

/// Writes a file whole, in the place of what had its name.
fn write(place: &BeneathPath, bytes: &[u8]) -> Result<()> {
    let folder = place.parent();
    folder
        .create_dir_all()
        .map_err(|e| Error::io("cannot make the folder of the results", e).at(folder.display()))?;
    place
        .replace(bytes)
        .map_err(|e| Error::io("cannot write the file", e).at(place.display()))
}

/// A file of a result; none where there is none, or a damaged one.
fn read(place: &BeneathPath) -> Result<Option<SimulationResult>> {
    match place.read(FileKind::Record) {
        Ok(bytes) => Ok(serde_json::from_slice(&bytes).ok()),
        Err(e) if e.get_ref().is_some_and(|e| e.is::<Refused>()) => {
            Err(Error::io("cannot read the result", e).at(place.display()))
        }
        Err(_) => Ok(None),
    }
}

fn short(hash: &str) -> &str {
    hash.get(..12).unwrap_or(hash)
}

#[cfg(test)]
mod tests {
    use gripcast_base::error::ErrorKind;
    use std::fs;
    use std::os::unix::fs::symlink;
    use std::path::PathBuf;

    use super::*;
    use crate::plan::sample_plan;
    use gripcast_geometry::Pose;
    use gripcast_sim::grasp::StageName;

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
        fs::write(store.samples(id).shown(), b"row").unwrap();
        assert_eq!(store.find(&plan, id).unwrap(), None, "images cut off");
        store.keep(result(&plan), None).unwrap();
        assert!(store.find(&plan, id).unwrap().is_some());
        fs::write(store.place(id, FACTS).shown(), b"{").unwrap();
        assert_eq!(store.find(&plan, id).unwrap(), None, "a damaged result");
    }

    fn snapshot() -> Snapshot {
        Snapshot {
            stage: StageName::Adjustment,
            t_s: 0.0,
            t_world_object: Pose::IDENTITY,
            t_world_gripper: Pose::IDENTITY,
            opening_m: 0.05,
            gels: [Vec::new(), Vec::new()],
        }
    }

    /// Where the files of a result are, and a file outside of the plan's folder.
    fn jail(dir: &Path) -> (ResultStore, PathBuf) {
        let secret = dir.join("secret");
        fs::write(&secret, "secret").unwrap();
        fs::create_dir(dir.join("plan")).unwrap();
        (ResultStore::beside(&dir.join("plan")), secret)
    }

    #[test]
    fn links_among_the_results_are_neither_followed_out_nor_overwritten() {
        let dir = tempfile::tempdir().unwrap();
        let (store, secret) = jail(dir.path());
        let plan = sample_plan(1);
        let id = &plan.simulations[0].id;
        let places = [FACTS, ".parquet", STATE].map(|suffix| store.place(id, suffix));
        places[0].parent().create_dir_all().unwrap();
        for place in &places {
            symlink(&secret, place.shown()).unwrap();
        }
        let error = store.find(&plan, id).unwrap_err();
        assert_eq!(error.kind(), ErrorKind::Input, "{error}");
        assert_eq!(store.state(&plan, id), None);
        store.keep_state(&plan, id, &snapshot()).unwrap();
        store.keep(result(&plan), Some((1, b"rows"))).unwrap();
        assert_eq!(fs::read(&secret).unwrap(), b"secret");
        assert!(store.find(&plan, id).unwrap().is_some());
        assert!(places.iter().all(|place| !place.is_link()));
    }

    #[test]
    fn a_folder_of_results_that_leads_out_is_refused() {
        let dir = tempfile::tempdir().unwrap();
        let (store, _) = jail(dir.path());
        let elsewhere = dir.path().join("elsewhere");
        fs::create_dir(&elsewhere).unwrap();
        symlink(&elsewhere, dir.path().join("plan").join(RESULTS)).unwrap();
        let plan = sample_plan(1);
        let error = store.find(&plan, &plan.simulations[0].id).unwrap_err();
        assert_eq!(error.kind(), ErrorKind::Input, "{error}");
        assert!(store.keep(result(&plan), Some((1, b"rows"))).is_err());
        assert_eq!(fs::read_dir(&elsewhere).unwrap().count(), 0);
    }
}
