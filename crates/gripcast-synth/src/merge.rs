//! Merges the selected results of a plan into a dataset of Parquet shards.

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::Path;

use serde::{Deserialize, Serialize};
use sha2::{Digest as _, Sha256};

use super::contact_maps::contact_maps;
use super::curate::{
    Curation, CurationSettings, LabelledSimulation, LeftOut, ObjectSummary, curate,
};
use super::plan::{FrictionFrom, Plan, PlannedSimulation, replace};
use super::store::{ResultStore, SimulationResult};
use gripcast_base::error::{Error, Result};
use gripcast_base::files::{FileKind, Root, SimulationId, sha256_hex};
use gripcast_dataset::shard::{ShardRow, ShardWriter, shard_name, shard_path};
use gripcast_sim::fem::GelPad;
use gripcast_tactile::SensorProfile;

/// Description of the dataset, beside `data/`.
const DATASET_FILE: &str = "synth.json";
/// Dataset card, as the Hugging Face hub shows it.
const CARD_FILE: &str = "README.md";
/// Folder of the shards.
const DATA: &str = "data";
/// Maximum rows of a shard, about 150 MB.
const ROWS_PER_SHARD: usize = 2000;
const FORMAT: &str = "gripcast-synth-dataset";
const VERSION: u32 = 2;
/// Oldest version that can be read; see [`LabelBalance`](super::curate::LabelBalance).
const OLDEST_VERSION: u32 = 1;

/// How a dataset is merged.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct MergeSettings {
    /// What is selected.
    pub curation: CurationSettings,
    /// Whether a plan with open simulations may be merged.
    pub allow_partial: bool,
}

/// Contents of a dataset, and what was left out.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct MergeReport {
    format: String,
    version: u32,
    /// Hash of the plan.
    pub plan_sha256: String,
    /// How it was selected.
    pub curation: CurationSettings,
    /// Simulations of the plan.
    pub planned: usize,
    /// Simulations without a result yet.
    pub open: usize,
    /// Categories with open simulations: how many have a result, and how many are planned.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub incomplete: BTreeMap<String, [usize; 2]>,
    /// Simulations that failed.
    pub failed: usize,
    /// Simulations without a label, by outcome.
    pub without_sample: BTreeMap<String, usize>,
    /// Labelled simulations that were left out, by reason.
    pub left_out: BTreeMap<LeftOut, usize>,
    /// Tactile image pairs that occur in more than one simulation; real cameras never repeat an
    /// image.
    pub duplicates: usize,
    /// Contents of each split.
    #[serde(rename = "parts")]
    pub splits: BTreeMap<String, SplitFacts>,
    /// SHA-256 of the dataset's files, by name.
    pub files: BTreeMap<String, String>,
}

impl MergeReport {
    /// Reads the description of a dataset.
    ///
    /// # Errors
    /// `NotFound` for a folder without a dataset of `synth merge`; `Input` for a damaged
    /// description or another version.
    pub fn read(folder: &Path) -> Result<Self> {
        let path = Root::new(folder).top().join(DATASET_FILE);
        let bytes = path.read(FileKind::List).map_err(|e| {
            Error::io("cannot read the description of the dataset", e)
                .at(path.display())
                .remedy("give the folder that `gripcast synth merge --out` wrote")
        })?;
        let invalid = |what: String| {
            Error::input(what)
                .at(path.display())
                .remedy("merge again: gripcast synth merge --plan P --out D")
        };
        let found: Self = serde_json::from_slice(&bytes)
            .map_err(|e| invalid(format!("not a description of a dataset: {e}")))?;
        if found.format != FORMAT || !(OLDEST_VERSION..=VERSION).contains(&found.version) {
            return Err(invalid(format!(
                "expected {FORMAT} version {OLDEST_VERSION} to {VERSION}, found {:?} version {}",
                found.format, found.version
            )));
        }
        Ok(found)
    }
}

/// Contents of a split.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SplitFacts {
    /// Number of rows.
    pub rows: usize,
    /// Stable simulations.
    pub stable: usize,
    /// Simulations that slipped.
    pub slip: usize,
    /// Number of grasps: poses, at any force.
    pub grasps: usize,
    /// Number of objects.
    pub objects: usize,
    /// Stable simulations and slips, by category.
    pub categories: BTreeMap<String, [usize; 2]>,
}

/// Selected simulations of a split.
type SplitSimulations<'a> = Vec<(&'a PlannedSimulation, SimulationResult)>;

/// Writes the dataset of a plan into `out`. Equal results give identical bytes.
///
/// # Errors
/// `Input` if simulations are open and that is not allowed, if no simulation can be selected, if
/// `out` contains another dataset, or if images do not belong to their result; I/O errors.
pub fn merge(
    plan: &Plan,
    plan_folder: &Path,
    out: &Path,
    settings: &MergeSettings,
    on_progress: &(dyn Fn(usize, usize) + Sync),
) -> Result<MergeReport> {
    let store = ResultStore::new(plan_folder);
    let Selection {
        counts,
        usable,
        curation,
    } = Selection::new(plan, &store, settings)?;
    let root = Root::new(out);
    check_output(&root, plan)?;
    let splits = simulations_by_split(plan, &curation, usable);
    let selected = splits.values().flatten();
    let lacking = selected.filter(|(_, result)| result.lacks_images()).count();
    if lacking > 0 {
        return Err(without_images(lacking));
    }
    let mut writer = DatasetWriter::new(plan, &store, &root, on_progress)?;
    let mut facts = BTreeMap::new();
    writer.total = splits.values().map(Vec::len).sum();
    for (name, split) in &splits {
        writer.write_split(name, split)?;
        facts.insert(name.clone(), split_facts(plan, split)?);
    }
    let mut left_out = BTreeMap::new();
    for reason in curation.left_out.values() {
        *left_out.entry(*reason).or_default() += 1;
    }
    let report = MergeReport {
        format: FORMAT.to_owned(),
        version: VERSION,
        plan_sha256: plan.sha256.clone(),
        curation: settings.curation.clone(),
        planned: plan.simulations.len(),
        open: counts.open,
        incomplete: counts.incomplete,
        failed: counts.failed,
        without_sample: counts.without_sample,
        left_out,
        duplicates: writer.duplicates,
        splits: facts,
        files: writer.files,
    };
    replace(&root.top().join(CARD_FILE), card(plan, &report).as_bytes())?;
    let text = serde_json::to_string_pretty(&report)
        .map_err(|e| Error::internal("cannot write JSON").because(e))?;
    // Last: this file marks the dataset as complete.
    replace(
        &root.top().join(DATASET_FILE),
        format!("{text}\n").as_bytes(),
    )?;
    Ok(report)
}

/// Selects the simulations that [`merge`] would put into the dataset.
///
/// # Errors
/// As [`merge`], except for errors of writing.
pub fn select_simulations(
    plan: &Plan,
    plan_folder: &Path,
    settings: &MergeSettings,
) -> Result<BTreeSet<SimulationId>> {
    let store = ResultStore::new(plan_folder);
    let Selection { curation, .. } = Selection::new(plan, &store, settings)?;
    let ids = plan.simulations.iter().map(|simulation| &simulation.id);
    let selected = ids.filter(|id| curation.split_of.contains_key(id.as_str()));
    Ok(selected.cloned().collect())
}

/// The selected results of a plan.
struct Selection<'a> {
    counts: Counts,
    /// Results with a label.
    usable: BTreeMap<&'a SimulationId, (&'a PlannedSimulation, SimulationResult)>,
    curation: Curation,
}

impl<'a> Selection<'a> {
    fn new(plan: &'a Plan, store: &ResultStore, settings: &MergeSettings) -> Result<Self> {
        let mut counts = Counts::default();
        let mut usable = BTreeMap::new();
        for simulation in &plan.simulations {
            let result = store.load(plan, &simulation.id)?;
            let category = plan.object(simulation)?.category.clone();
            let finished = counts.incomplete.entry(category).or_default();
            finished[0] += usize::from(result.is_some());
            finished[1] += 1;
            match result {
                None => counts.open += 1,
                Some(result) if result.is_failed() => counts.failed += 1,
                Some(result) if result.stable.is_none() => {
                    *counts.without_sample.entry(result.outcome).or_default() += 1;
                }
                Some(result) => {
                    usable.insert(&simulation.id, (simulation, result));
                }
            }
        }
        counts
            .incomplete
            .retain(|_, [finished, planned]| finished < planned);
        if counts.open > 0 && !settings.allow_partial {
            return Err(unfinished(plan, counts.open));
        }
        let labelled = usable.values().map(|(simulation, result)| {
            Ok(LabelledSimulation {
                id: simulation.id.to_string(),
                object: simulation.object.to_string(),
                category: plan.object(simulation)?.category.clone(),
                stop_force_n: simulation.stop_force_n,
                stable: result.stable == Some(true),
            })
        });
        let labelled = labelled.collect::<Result<Vec<_>>>()?;
        Ok(Self {
            curation: curate(&object_summaries(plan)?, &labelled, &settings.curation)?,
            counts,
            usable,
        })
    }
}

/// Counts the simulations of each object.
fn object_summaries(plan: &Plan) -> Result<BTreeMap<String, ObjectSummary>> {
    let mut objects: BTreeMap<String, ObjectSummary> = BTreeMap::new();
    for simulation in &plan.simulations {
        let new = ObjectSummary {
            category: plan.object(simulation)?.category.clone(),
            simulations: 0,
        };
        let object = objects.entry(simulation.object.to_string()).or_insert(new);
        object.simulations += 1;
    }
    Ok(objects)
}

fn without_images(lacking: usize) -> Error {
    Error::input(format!(
        "{lacking} of the selected simulations have no images yet"
    ))
    .remedy(
        "render them with `gripcast synth run --images chosen` and the same selection flags, or all \
         images with `gripcast synth run`",
    )
}

/// Results of a plan that cannot be selected.
#[derive(Default)]
struct Counts {
    open: usize,
    incomplete: BTreeMap<String, [usize; 2]>,
    failed: usize,
    without_sample: BTreeMap<String, usize>,
}

fn unfinished(plan: &Plan, open: usize) -> Error {
    Error::input(format!(
        "{open} of {} simulations have no result yet",
        plan.simulations.len()
    ))
    .remedy("finish them with `gripcast synth run`, or merge the finished ones with --partial")
}

/// Refuses a folder with the dataset of another plan.
fn check_output(root: &Root, plan: &Plan) -> Result<()> {
    let path = root.top().join(DATASET_FILE);
    if !path.is_taken() {
        return Ok(());
    }
    let existing = path.read(FileKind::List).ok();
    let existing = existing.and_then(|text| serde_json::from_slice::<MergeReport>(&text).ok());
    if existing.is_some_and(|existing| existing.plan_sha256 == plan.sha256) {
        return Ok(());
    }
    Err(Error::input("the folder contains another dataset")
        .at(path.display())
        .remedy("name a new folder"))
}

/// Selected simulations by split, in the order of the plan.
fn simulations_by_split<'a>(
    plan: &'a Plan,
    curation: &Curation,
    mut usable: BTreeMap<&SimulationId, (&'a PlannedSimulation, SimulationResult)>,
) -> BTreeMap<String, SplitSimulations<'a>> {
    let mut splits: BTreeMap<String, SplitSimulations<'a>> = BTreeMap::new();
    for simulation in &plan.simulations {
        if let Some(split) = curation.split_of.get(simulation.id.as_str())
            && let Some(one) = usable.remove(&simulation.id)
        {
            splits.entry(split.clone()).or_default().push(one);
        }
    }
    splits
}

fn split_facts(plan: &Plan, split: &SplitSimulations<'_>) -> Result<SplitFacts> {
    let mut facts = SplitFacts::default();
    let mut objects = BTreeSet::new();
    let mut grasps = BTreeSet::new();
    for (simulation, result) in split {
        let stable = result.stable == Some(true);
        facts.rows += result.samples.as_ref().map_or(0, |file| file.rows);
        facts.stable += usize::from(stable);
        facts.slip += usize::from(!stable);
        let category = &plan.object(simulation)?.category;
        let counts = facts.categories.entry(category.clone()).or_default();
        counts[usize::from(!stable)] += 1;
        objects.insert(&simulation.object);
        grasps.insert((&simulation.object, simulation.grasp));
    }
    facts.objects = objects.len();
    facts.grasps = grasps.len();
    Ok(facts)
}

/// Writes the shards of a dataset.
struct DatasetWriter<'a> {
    plan: &'a Plan,
    store: &'a ResultStore,
    root: Root,
    on_progress: &'a (dyn Fn(usize, usize) + Sync),
    done: usize,
    total: usize,
    /// Simulation by hash of its tactile images.
    simulation_of_image: BTreeMap<[u8; 16], String>,
    duplicates: usize,
    files: BTreeMap<String, String>,
    /// Width and height of the gel's face in a tactile image.
    view_m: [f64; 2],
}

impl<'a> DatasetWriter<'a> {
    fn new(
        plan: &'a Plan,
        store: &'a ResultStore,
        root: &Root,
        on_progress: &'a (dyn Fn(usize, usize) + Sync),
    ) -> Result<Self> {
        let folder = root.top().join(DATA);
        fs::create_dir_all(root.path())
            .and_then(|()| folder.create_dir_all())
            .map_err(|e| Error::io("cannot create the folder", e).at(folder.display()))?;
        let sensor = SensorProfile::gelsight_mini()?.geometry;
        let view_m = [sensor.width, sensor.height].map(|pixels| pixels as f64 * sensor.pixel_m);
        Ok(Self {
            view_m,
            plan,
            store,
            root: root.clone(),
            on_progress,
            done: 0,
            total: 0,
            simulation_of_image: BTreeMap::new(),
            duplicates: 0,
            files: BTreeMap::new(),
        })
    }

    fn write_split(&mut self, name: &str, split: &SplitSimulations<'_>) -> Result<()> {
        let shards = shards(split);
        let count = shards.len();
        for (number, shard) in shards.into_iter().enumerate() {
            let path = shard_path(&self.root, name, number, count)?;
            let info = format!("{{\"plan_sha256\":\"{}\"}}", self.plan.sha256);
            let mut writer = ShardWriter::create(&path, &info)?;
            for (_, result) in shard {
                let record = self.store.load_record(self.plan, &result.id);
                let pad = GelPad::default();
                let contact = record.and_then(|record| contact_maps(&record, &pad, self.view_m));
                for mut row in self.store.rows(result)? {
                    row.facts.contact.clone_from(&contact);
                    self.count_duplicate(&row);
                    writer.push(row)?;
                }
                self.done += 1;
                (self.on_progress)(self.done, self.total);
            }
            writer.finish()?;
            let bytes = path
                .read(FileKind::Bulk)
                .map_err(|e| Error::io("cannot read back the shard", e).at(path.display()))?;
            let file = shard_name(name, number, count)?;
            self.files.insert(file, sha256_hex(bytes));
        }
        Ok(())
    }

    fn count_duplicate(&mut self, row: &ShardRow) {
        let mut hasher = Sha256::new();
        for image in [&row.images.grasp_left, &row.images.grasp_right] {
            hasher.update(image);
        }
        let mut key = [0; 16];
        key.copy_from_slice(&hasher.finalize()[..16]);
        let simulation = &row.facts.simulation;
        let other = self.simulation_of_image.insert(key, simulation.clone());
        self.duplicates += usize::from(other.is_some_and(|other| other != *simulation));
    }
}

/// Groups the simulations of a split into shards.
fn shards<'p, 'a>(
    split: &'p SplitSimulations<'a>,
) -> Vec<Vec<&'p (&'a PlannedSimulation, SimulationResult)>> {
    let mut shards = vec![Vec::new()];
    let mut rows = 0;
    for one in split {
        let more = one.1.samples.as_ref().map_or(0, |file| file.rows);
        if rows > 0 && rows + more > ROWS_PER_SHARD {
            shards.push(Vec::new());
            rows = 0;
        }
        rows += more;
        if let Some(last) = shards.last_mut() {
            last.push(one);
        }
    }
    shards
}

/// Text of the dataset card.
fn card(plan: &Plan, report: &MergeReport) -> String {
    let mut splits = String::new();
    let mut table = String::new();
    for (name, split) in &report.splits {
        splits.push_str(&format!(
            "  - split: {name}\n    path: data/{name}-*.parquet\n"
        ));
        table.push_str(&format!(
            "| {name} | {} | {} | {} | {} | {} |\n",
            split.rows, split.grasps, split.objects, split.stable, split.slip
        ));
    }
    format!(
        "---\nconfigs:\n- config_name: default\n  data_files:\n{splits}---\n\n\
         # Simulated grasps\n\n\
         Made by {} from plan `{}` (preset {}, seed {}, engine {}, friction from {}). Everything here is simulated \
         and rendered; nothing was measured.\n\n\
         | part | rows | grasps | objects | stable simulations | slips |\n\
         | --- | --- | --- | --- | --- | --- |\n{table}",
        plan.header.software,
        plan.sha256,
        plan.header.preset,
        plan.header.seed,
        plan.header.engine.name(),
        match plan.header.friction_from {
            FrictionFrom::Soiled => "the soiled material",
            FrictionFrom::Material => "category and appearance",
        },
    )
}
