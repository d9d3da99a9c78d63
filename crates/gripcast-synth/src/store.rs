//! Results of simulations: up to three files each, written atomically: the result as JSON, the record
//! of the grasp, and the images.

use std::path::Path;

use serde::{Deserialize, Serialize};
use sha2::{Digest as _, Sha256};

use super::plan::{Plan, PlannedSimulation};
use gripcast_base::error::{Error, Refused, Result};
use gripcast_base::files::{BeneathPath, FileKind, Printable, Root, SimulationId, sha256_hex};
use gripcast_dataset::shard::{ShardReader, ShardRow};
use gripcast_sim::grasp::GraspRecord;

/// Folder of the results inside the plan's folder.
pub const RESULTS: &str = "results";
const FORMAT: &str = "gripcast-synth-result";
const RECORD_FORMAT: &str = "gripcast-grasp-record";
/// Incremented whenever the same plan may give other results.
const VERSION: u32 = 6;
/// Outcome of a simulation that failed.
pub const FAILED: &str = "failed";
/// Suffix of result files.
const RESULT: &str = ".json";
/// Suffix of the records of grasps.
const RECORD: &str = ".grasp";

/// Result of one simulation.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SimulationResult {
    format: String,
    version: u32,
    /// SHA-256 of the plan.
    pub plan_sha256: String,
    /// Id of the simulation.
    pub id: SimulationId,
    /// `success`, `slip`, `eject`, …, or `failed`.
    pub outcome: String,
    /// Details of the outcome, or the reason of a failure.
    pub detail: Option<String>,
    /// Label: stable or slip; none without an outcome or without contact before the lift.
    pub stable: Option<bool>,
    /// Rise of the object's centre of mass, m.
    pub lifted_m: f64,
    /// Normal force on the left and the right finger before the lift, N.
    pub force_n: Option<[f64; 2]>,
    /// Time steps.
    pub steps: usize,
    /// Newton iterations.
    pub newton_iterations: u64,
    /// Steps that did not converge.
    pub unconverged_steps: usize,
    /// The file with the images; none without a label, or if they are not rendered yet.
    pub samples: Option<SampleFile>,
    /// CPU time, s.
    pub cpu_s: CpuSeconds,
}

/// The file with a simulation's images.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SampleFile {
    /// Number of rows.
    pub rows: usize,
    /// Length, bytes.
    pub bytes: u64,
    /// SHA-256, 64 hex digits.
    pub sha256: String,
}

/// CPU time by stage, s.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CpuSeconds {
    /// Preparing the mesh and its convex pieces.
    pub prepare: f64,
    /// Simulation.
    pub simulate: f64,
    /// Rendering tactile images.
    pub tactile: f64,
    /// Rendering colour images.
    pub visual: f64,
}

impl CpuSeconds {
    /// Sum of all stages, s.
    pub fn total(&self) -> f64 {
        self.prepare + self.simulate + self.tactile + self.visual
    }
}

impl SimulationResult {
    /// Creates the result of a failed simulation, to be filled in.
    pub(super) fn new(plan: &Plan, simulation: &PlannedSimulation) -> Self {
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

    /// Whether the simulation failed.
    pub fn is_failed(&self) -> bool {
        self.outcome == FAILED
    }

    /// Whether it has a label but no images yet.
    pub fn lacks_images(&self) -> bool {
        self.stable.is_some() && self.samples.is_none()
    }
}

/// The results of a plan.
#[derive(Clone, Debug)]
pub struct ResultStore {
    folder: BeneathPath,
}

impl ResultStore {
    /// Opens the results in a plan's folder.
    pub fn new(plan_folder: &Path) -> Self {
        Self {
            folder: Root::new(plan_folder).top().join(RESULTS),
        }
    }

    /// Loads a result; none if it is missing or damaged.
    ///
    /// # Errors
    /// `Input` for the result of another plan, or a file that leads out of the plan's folder.
    pub fn load(&self, plan: &Plan, id: &SimulationId) -> Result<Option<SimulationResult>> {
        let path = self.path(id, RESULT);
        let Some(found) = read(&path)? else {
            return Ok(None);
        };
        if found.plan_sha256 != plan.sha256 {
            return Err(Error::input(format!(
                "the result belongs to another plan: expected {}, found {}",
                short(&plan.sha256),
                Printable(short(&found.plan_sha256))
            ))
            .at(path.display())
            .remedy("use a separate folder for each plan and its results"));
        }
        let is_valid = found.format == FORMAT && found.version == VERSION && found.id == *id;
        let has_samples = |file: &SampleFile| {
            let stored = self.samples(id).metadata();
            stored.is_ok_and(|stored| stored.is_file && stored.bytes == file.bytes)
        };
        let is_valid = is_valid && found.samples.as_ref().is_none_or(has_samples);
        Ok(is_valid.then_some(found))
    }

    /// Saves a result with its images: the number of rows and the Parquet file.
    ///
    /// # Errors
    /// `DiskFull`, `Io`, …; existing results stay intact.
    pub fn save(
        &self,
        mut result: SimulationResult,
        samples: Option<(usize, &[u8])>,
    ) -> Result<()> {
        // The images first: a result that exists is complete.
        if let Some((rows, bytes)) = samples {
            write(&self.samples(&result.id), bytes)?;
            result.samples = Some(SampleFile {
                rows,
                bytes: bytes.len() as u64,
                sha256: sha256_hex(bytes),
            });
        }
        write(&self.path(&result.id, RESULT), &to_json(&result)?)
    }

    /// Saves the record of a labelled grasp, [`GraspRecord::to_bytes`].
    ///
    /// # Errors
    /// `DiskFull`, `Io`, ….
    pub(super) fn save_record(&self, plan: &Plan, id: &SimulationId, record: &[u8]) -> Result<()> {
        let mut file = to_json(&RecordHeader::new(plan, id, record))?;
        file.push(b'\n');
        file.extend(record);
        write(&self.path(id, RECORD), &file)
    }

    /// Loads the record of a labelled grasp; none if it is missing or damaged, which means that the
    /// simulation has to be run again.
    pub fn load_record(&self, plan: &Plan, id: &SimulationId) -> Option<GraspRecord> {
        let file = self.path(id, RECORD).read(FileKind::Record).ok()?;
        let end = file.iter().position(|byte| *byte == b'\n')?;
        let (header, record) = (&file[..end], &file[end + 1..]);
        let found: RecordHeader = serde_json::from_slice(header).ok()?;
        let is_valid = found == RecordHeader::new(plan, id, record);
        is_valid.then(|| GraspRecord::from_bytes(record).ok())?
    }

    /// Whether a result file exists, valid or not.
    pub fn has_file(&self, id: &SimulationId) -> bool {
        self.path(id, RESULT).is_taken()
    }

    /// Reads the rows of a result and checks the hash of their file.
    ///
    /// # Errors
    /// `Input` for images that are damaged or belong to another result; I/O errors.
    pub fn rows(&self, result: &SimulationResult) -> Result<Vec<ShardRow>> {
        let path = self.samples(&result.id);
        let mismatch = || {
            Error::input("the images do not belong to the result")
                .at(path.display())
                .remedy("remove the file and run its shard again: the result will be identical")
        };
        let expected = result.samples.as_ref().ok_or_else(mismatch)?;
        let bytes = path
            .read(FileKind::Bulk)
            .map_err(|e| Error::io("cannot read the images", e).at(path.display()))?;
        if sha256_hex(&bytes) != expected.sha256 {
            return Err(mismatch());
        }
        let reader = ShardReader::from_bytes(path.display().to_string(), bytes)?;
        reader.rows().collect()
    }

    /// Path of the file with a simulation's images.
    pub fn samples(&self, id: &SimulationId) -> BeneathPath {
        self.path(id, ".parquet")
    }

    /// Returns `<2 hex>/<id><suffix>`: no folder gets too many files.
    fn path(&self, id: &SimulationId, suffix: &'static str) -> BeneathPath {
        let digest = Sha256::digest(id.as_str());
        self.folder
            .join_number("", digest[0])
            .join_affixed("", id, suffix)
    }
}

/// First line of the file with a grasp's record.
#[derive(PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct RecordHeader {
    format: String,
    version: u32,
    plan_sha256: String,
    id: SimulationId,
    /// SHA-256 of the record.
    sha256: String,
}

impl RecordHeader {
    fn new(plan: &Plan, id: &SimulationId, record: &[u8]) -> Self {
        Self {
            format: RECORD_FORMAT.to_owned(),
            version: VERSION,
            plan_sha256: plan.sha256.clone(),
            id: id.clone(),
            sha256: sha256_hex(record),
        }
    }
}

fn to_json(value: &impl Serialize) -> Result<Vec<u8>> {
    serde_json::to_vec(value).map_err(|e| Error::internal("cannot write JSON").because(e))
}

/// Replaces a file atomically.
fn write(path: &BeneathPath, bytes: &[u8]) -> Result<()> {
    let folder = path.parent();
    folder
        .create_dir_all()
        .map_err(|e| Error::io("cannot create the folder of results", e).at(folder.display()))?;
    path.replace(bytes)
        .map_err(|e| Error::io("cannot write the file", e).at(path.display()))
}

/// Reads a result file; none if it is missing or damaged.
fn read(path: &BeneathPath) -> Result<Option<SimulationResult>> {
    match path.read(FileKind::Record) {
        Ok(bytes) => Ok(serde_json::from_slice(&bytes).ok()),
        Err(e) if e.get_ref().is_some_and(|e| e.is::<Refused>()) => {
            Err(Error::io("cannot read the result", e).at(path.display()))
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

    fn result(plan: &Plan) -> SimulationResult {
        SimulationResult {
            outcome: "slip".to_owned(),
            stable: Some(false),
            ..SimulationResult::new(plan, &plan.simulations[0])
        }
    }

    #[test]
    fn load_requires_complete_files_and_the_same_plan() {
        let folder = tempfile::tempdir().unwrap();
        let store = ResultStore::new(folder.path());
        let plan = sample_plan(3);
        let id = &plan.simulations[0].id;
        assert_eq!(store.load(&plan, id).unwrap(), None);
        store.save(result(&plan), Some((3, b"rows"))).unwrap();
        let found = store.load(&plan, id).unwrap().unwrap();
        assert_eq!(found.stable, Some(false));
        assert_eq!(found.samples.as_ref().unwrap().rows, 3);
        let error = store.load(&sample_plan(4), id).unwrap_err().to_string();
        assert!(error.contains("another plan"), "{error}");
        fs::write(store.samples(id).shown(), b"row").unwrap();
        assert_eq!(store.load(&plan, id).unwrap(), None, "truncated images");
        store.save(result(&plan), None).unwrap();
        assert!(store.load(&plan, id).unwrap().is_some());
        fs::write(store.path(id, RESULT).shown(), b"{").unwrap();
        assert_eq!(store.load(&plan, id).unwrap(), None, "a damaged result");
    }

    /// Bytes of a record without states.
    fn record() -> Vec<u8> {
        let record = GraspRecord {
            t_world_gripper: Pose::IDENTITY,
            face_nodes: [0; 2],
            states: Vec::new(),
        };
        record.to_bytes().unwrap()
    }

    #[test]
    fn record_is_read_back_unless_damaged_or_of_another_plan() {
        let folder = tempfile::tempdir().unwrap();
        let store = ResultStore::new(folder.path());
        let plan = sample_plan(3);
        let id = &plan.simulations[0].id;
        store.save_record(&plan, id, &record()).unwrap();
        assert!(store.load_record(&plan, id).is_some());
        assert_eq!(store.load_record(&sample_plan(4), id), None);
        let path = store.path(id, RECORD).shown().to_owned();
        let mut bytes = fs::read(&path).unwrap();
        *bytes.last_mut().unwrap() ^= 1;
        fs::write(&path, bytes).unwrap();
        assert_eq!(store.load_record(&plan, id), None);
    }

    /// A result store, and a file outside of the plan's folder.
    fn jail(dir: &Path) -> (ResultStore, PathBuf) {
        let secret = dir.join("secret");
        fs::write(&secret, "secret").unwrap();
        fs::create_dir(dir.join("plan")).unwrap();
        (ResultStore::new(&dir.join("plan")), secret)
    }

    #[test]
    fn links_out_of_the_results_are_not_followed_or_written() {
        let dir = tempfile::tempdir().unwrap();
        let (store, secret) = jail(dir.path());
        let plan = sample_plan(1);
        let id = &plan.simulations[0].id;
        let paths = [RESULT, ".parquet", RECORD].map(|suffix| store.path(id, suffix));
        paths[0].parent().create_dir_all().unwrap();
        for path in &paths {
            symlink(&secret, path.shown()).unwrap();
        }
        let error = store.load(&plan, id).unwrap_err();
        assert_eq!(error.kind(), ErrorKind::Input, "{error}");
        assert_eq!(store.load_record(&plan, id), None);
        store.save_record(&plan, id, &record()).unwrap();
        store.save(result(&plan), Some((1, b"rows"))).unwrap();
        assert_eq!(fs::read(&secret).unwrap(), b"secret");
        assert!(store.load(&plan, id).unwrap().is_some());
        assert!(paths.iter().all(|path| !path.is_link()));
    }

    #[test]
    fn results_folder_that_leads_out_is_refused() {
        let dir = tempfile::tempdir().unwrap();
        let (store, _) = jail(dir.path());
        let elsewhere = dir.path().join("elsewhere");
        fs::create_dir(&elsewhere).unwrap();
        symlink(&elsewhere, dir.path().join("plan").join(RESULTS)).unwrap();
        let plan = sample_plan(1);
        let error = store.load(&plan, &plan.simulations[0].id).unwrap_err();
        assert_eq!(error.kind(), ErrorKind::Input, "{error}");
        assert!(store.save(result(&plan), Some((1, b"rows"))).is_err());
        assert_eq!(fs::read_dir(&elsewhere).unwrap().count(), 0);
    }
}
