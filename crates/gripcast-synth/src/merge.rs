//! The dataset of a plan: closed Parquet shards of what was chosen.

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::Path;

use serde::{Deserialize, Serialize};
use sha2::{Digest as _, Sha256};

use super::curate::{Curation, CurationSettings, Labelled, LeftOut, PlannedObject, curate};
use super::plan::{Plan, PlannedSimulation, replace};
use super::store::{ResultStore, SimulationResult};
use gripcast_base::error::{Error, Result};
use gripcast_base::files::{FileKind, Root, SimulationId, sha256_hex};
use gripcast_dataset::shard::{ShardRow, ShardWriter, shard_name, shard_path};

/// Facts of the dataset, beside `data/`.
const DATASET_FILE: &str = "synth.json";
/// The text that people and the Hugging Face hub show.
const CARD_FILE: &str = "README.md";
/// Folder of the shards.
const DATA: &str = "data";
/// Rows of a shard: about 150 MB.
const ROWS_PER_SHARD: usize = 2000;
/// Name of the format.
const FORMAT: &str = "gripcast-synth-dataset";
const VERSION: u32 = 1;

/// How a dataset is merged.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct MergeSettings {
    /// What is chosen.
    pub curation: CurationSettings,
    /// Whether a plan with open simulations is merged as far as it is.
    pub is_partial_allowed: bool,
}

/// What is in a dataset, and what is not.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct MergeReport {
    format: String,
    version: u32,
    /// Hash of the plan.
    pub plan_sha256: String,
    /// How it was chosen.
    pub curation: CurationSettings,
    /// Simulations of the plan.
    pub planned: usize,
    /// Simulations without a result yet.
    pub open: usize,
    /// Simulations that could not be done.
    pub failed: usize,
    /// Simulations without an outcome or with nothing to see before the lift, by outcome.
    pub without_sample: BTreeMap<String, usize>,
    /// Simulations that were left out, by reason.
    pub left_out: BTreeMap<LeftOut, usize>,
    /// Images that stand in more than one simulation, which no camera would take.
    pub duplicates: usize,
    /// What is in each part.
    pub parts: BTreeMap<String, PartFacts>,
    /// Files of the dataset with their hashes.
    pub files: BTreeMap<String, String>,
}

impl MergeReport {
    /// The facts of a dataset.
    ///
    /// # Errors
    /// `NotFound` for a folder without a dataset of `synth merge`; `Input` for damaged facts or
    /// those of another version.
    pub fn read(folder: &Path) -> Result<Self> {
        let place = Root::new(folder).top().join(DATASET_FILE);
        let bytes = place.read(FileKind::List).map_err(|e| {
            Error::io("cannot read the facts of the dataset", e)
                .at(place.display())
                .remedy("give the folder that `gripcast synth merge --out` wrote")
        })?;
        let wrong = |what: String| {
            Error::input(what)
                .at(place.display())
                .remedy("merge again: gripcast synth merge --plan P --out D")
        };
        let found: Self = serde_json::from_slice(&bytes)
            .map_err(|e| wrong(format!("these are no facts of a dataset: {e}")))?;
        if found.format != FORMAT || found.version != VERSION {
            return Err(wrong(format!(
                "expected {FORMAT} version {VERSION}, found {:?} version {}",
                found.format, found.version
            )));
        }
        Ok(found)
    }
}

/// What is in a part of a dataset.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PartFacts {
    /// Rows.
    pub rows: usize,
    /// Simulations that held.
    pub stable: usize,
    /// Simulations that were lost.
    pub slip: usize,
    /// Grasps: poses, at any force.
    pub grasps: usize,
    /// Objects.
    pub objects: usize,
    /// Simulations that held and were lost, by category.
    pub categories: BTreeMap<String, [usize; 2]>,
}

/// Chosen simulations of a part.
type Part<'a> = Vec<(&'a PlannedSimulation, SimulationResult)>;

/// Writes the dataset of a plan into `out`. The same results make the same bytes, however they
/// were made.
///
/// # Errors
/// `Input` where simulations are open and that is not allowed, or nothing is left to choose, or
/// `out` holds another dataset; for images that are not those of the result; those of the
/// operating system.
pub fn merge(
    plan: &Plan,
    plan_folder: &Path,
    out: &Path,
    settings: &MergeSettings,
    on_progress: &(dyn Fn(usize, usize) + Sync),
) -> Result<MergeReport> {
    let store = ResultStore::beside(plan_folder);
    let Chosen {
        counts,
        usable,
        curation,
    } = Chosen::of(plan, &store, settings)?;
    let root = Root::new(out);
    check_free(&root, plan)?;
    let parts = parts(plan, &curation, usable);
    let chosen = parts.values().flatten();
    let lacking = chosen.filter(|(_, result)| result.lacks_images()).count();
    if lacking > 0 {
        return Err(without_images(lacking));
    }
    let mut writing = Writing::new(plan, &store, &root, on_progress)?;
    let mut facts = BTreeMap::new();
    writing.all = parts.values().map(Vec::len).sum();
    for (name, part) in &parts {
        writing.part(name, part)?;
        facts.insert(name.clone(), part_facts(plan, part)?);
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
        failed: counts.failed,
        without_sample: counts.without_sample,
        left_out,
        duplicates: writing.duplicates,
        parts: facts,
        files: writing.files,
    };
    replace(&root.top().join(CARD_FILE), card(plan, &report).as_bytes())?;
    let text = serde_json::to_string_pretty(&report)
        .map_err(|e| Error::internal("cannot write JSON").because(e))?;
    // Last: with this file the dataset is whole.
    replace(
        &root.top().join(DATASET_FILE),
        format!("{text}\n").as_bytes(),
    )?;
    Ok(report)
}

/// Simulations that a dataset of a plan takes, once all of them have a label, or of those that have
/// one where that is allowed.
///
/// # Errors
/// As [`merge`], but for those of writing.
pub fn chosen(
    plan: &Plan,
    plan_folder: &Path,
    settings: &MergeSettings,
) -> Result<BTreeSet<SimulationId>> {
    let store = ResultStore::beside(plan_folder);
    let Chosen { curation, .. } = Chosen::of(plan, &store, settings)?;
    let ids = plan.simulations.iter().map(|simulation| &simulation.id);
    let chosen = ids.filter(|id| curation.part.contains_key(id.as_str()));
    Ok(chosen.cloned().collect())
}

/// What is chosen of the results.
struct Chosen<'a> {
    counts: Counts,
    /// Results with a label.
    usable: BTreeMap<&'a SimulationId, (&'a PlannedSimulation, SimulationResult)>,
    curation: Curation,
}

impl<'a> Chosen<'a> {
    fn of(plan: &'a Plan, store: &ResultStore, settings: &MergeSettings) -> Result<Self> {
        let mut counts = Counts::default();
        let mut usable = BTreeMap::new();
        for simulation in &plan.simulations {
            match store.find(plan, &simulation.id)? {
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
        if counts.open > 0 && !settings.is_partial_allowed {
            return Err(unfinished(plan, counts.open));
        }
        let labelled = usable.values().map(|(simulation, result)| {
            Ok(Labelled {
                id: simulation.id.to_string(),
                object: simulation.object.to_string(),
                category: plan.object(simulation)?.category.clone(),
                stop_force_n: simulation.stop_force_n,
                stable: result.stable == Some(true),
            })
        });
        let labelled = labelled.collect::<Result<Vec<_>>>()?;
        Ok(Self {
            curation: curate(&planned_objects(plan)?, &labelled, &settings.curation)?,
            counts,
            usable,
        })
    }
}

/// Objects of a plan with the count of their simulations.
fn planned_objects(plan: &Plan) -> Result<BTreeMap<String, PlannedObject>> {
    let mut objects: BTreeMap<String, PlannedObject> = BTreeMap::new();
    for simulation in &plan.simulations {
        let new = PlannedObject {
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
        "{lacking} of the chosen simulations have no images yet"
    ))
    .remedy(
        "take them with `gripcast synth run --images chosen` and the same choice, or those of all \
         with `gripcast synth run`",
    )
}

/// What the results are, before any is chosen.
#[derive(Default)]
struct Counts {
    open: usize,
    failed: usize,
    without_sample: BTreeMap<String, usize>,
}

fn unfinished(plan: &Plan, open: usize) -> Error {
    Error::input(format!(
        "{open} of {} simulations have no result yet",
        plan.simulations.len()
    ))
    .remedy("finish them with `gripcast synth run`, or merge what is there with --partial")
}

/// Refuses a folder with the dataset of another plan.
fn check_free(root: &Root, plan: &Plan) -> Result<()> {
    let place = root.top().join(DATASET_FILE);
    if !place.is_taken() {
        return Ok(());
    }
    let there = place.read(FileKind::List).ok();
    let there = there.and_then(|text| serde_json::from_slice::<MergeReport>(&text).ok());
    if there.is_some_and(|there| there.plan_sha256 == plan.sha256) {
        return Ok(());
    }
    Err(Error::input("the folder holds another dataset")
        .at(place.display())
        .remedy("give a new folder"))
}

/// Chosen simulations by part, in the order of the plan.
fn parts<'a>(
    plan: &'a Plan,
    curation: &Curation,
    mut usable: BTreeMap<&SimulationId, (&'a PlannedSimulation, SimulationResult)>,
) -> BTreeMap<String, Part<'a>> {
    let mut parts: BTreeMap<String, Part<'a>> = BTreeMap::new();
    for simulation in &plan.simulations {
        if let Some(part) = curation.part.get(simulation.id.as_str())
            && let Some(one) = usable.remove(&simulation.id)
        {
            parts.entry(part.clone()).or_default().push(one);
        }
    }
    parts
}

fn part_facts(plan: &Plan, part: &Part<'_>) -> Result<PartFacts> {
    let mut facts = PartFacts::default();
    let mut objects: Vec<&SimulationId> = Vec::new();
    let mut grasps: Vec<(&SimulationId, u32)> = Vec::new();
    for (simulation, result) in part {
        let held = result.stable == Some(true);
        facts.rows += result.samples.as_ref().map_or(0, |file| file.rows);
        facts.stable += usize::from(held);
        facts.slip += usize::from(!held);
        let category = &plan.object(simulation)?.category;
        let counts = facts.categories.entry(category.clone()).or_default();
        counts[usize::from(!held)] += 1;
        objects.push(&simulation.object);
        grasps.push((&simulation.object, simulation.grasp));
    }
    objects.sort();
    objects.dedup();
    grasps.sort();
    grasps.dedup();
    facts.objects = objects.len();
    facts.grasps = grasps.len();
    Ok(facts)
}

/// A dataset being written.
struct Writing<'a> {
    plan: &'a Plan,
    store: &'a ResultStore,
    root: Root,
    on_progress: &'a (dyn Fn(usize, usize) + Sync),
    done: usize,
    all: usize,
    /// Simulation by hash of its tactile images.
    seen: BTreeMap<[u8; 16], String>,
    duplicates: usize,
    files: BTreeMap<String, String>,
}

impl<'a> Writing<'a> {
    fn new(
        plan: &'a Plan,
        store: &'a ResultStore,
        root: &Root,
        on_progress: &'a (dyn Fn(usize, usize) + Sync),
    ) -> Result<Self> {
        let folder = root.top().join(DATA);
        fs::create_dir_all(root.path())
            .and_then(|()| folder.create_dir_all())
            .map_err(|e| Error::io("cannot make the folder", e).at(folder.display()))?;
        Ok(Self {
            plan,
            store,
            root: root.clone(),
            on_progress,
            done: 0,
            all: 0,
            seen: BTreeMap::new(),
            duplicates: 0,
            files: BTreeMap::new(),
        })
    }

    fn part(&mut self, name: &str, part: &Part<'_>) -> Result<()> {
        let shards = shards(part);
        let count = shards.len();
        for (number, shard) in shards.into_iter().enumerate() {
            let place = shard_path(&self.root, name, number, count)?;
            let info = format!("{{\"plan_sha256\":\"{}\"}}", self.plan.sha256);
            let mut writer = ShardWriter::create(&place, &info)?;
            for (_, result) in shard {
                for row in self.store.rows(result)? {
                    self.note(&row);
                    writer.push(row)?;
                }
                self.done += 1;
                (self.on_progress)(self.done, self.all);
            }
            writer.finish()?;
            let bytes = place
                .read(FileKind::Bulk)
                .map_err(|e| Error::io("cannot read the shard again", e).at(place.display()))?;
            let file = shard_name(name, number, count)?;
            self.files.insert(file, sha256_hex(bytes));
        }
        Ok(())
    }

    fn note(&mut self, row: &ShardRow) {
        let mut hasher = Sha256::new();
        for image in [&row.images.grasp_left, &row.images.grasp_right] {
            hasher.update(image);
        }
        let mut key = [0; 16];
        key.copy_from_slice(&hasher.finalize()[..16]);
        let simulation = &row.facts.simulation;
        let other = self.seen.insert(key, simulation.clone());
        self.duplicates += usize::from(other.is_some_and(|other| other != *simulation));
    }
}

/// Simulations of a part, a shard at a time.
fn shards<'p, 'a>(part: &'p Part<'a>) -> Vec<Vec<&'p (&'a PlannedSimulation, SimulationResult)>> {
    let mut shards = vec![Vec::new()];
    let mut rows = 0;
    for one in part {
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

/// The dataset's card.
fn card(plan: &Plan, report: &MergeReport) -> String {
    let mut splits = String::new();
    let mut table = String::new();
    for (name, part) in &report.parts {
        splits.push_str(&format!(
            "  - split: {name}\n    path: data/{name}-*.parquet\n"
        ));
        table.push_str(&format!(
            "| {name} | {} | {} | {} | {} | {} |\n",
            part.rows, part.grasps, part.objects, part.stable, part.slip
        ));
    }
    format!(
        "---\nconfigs:\n- config_name: default\n  data_files:\n{splits}---\n\n\
         # Simulated grasps\n\n\
         Made by {} from plan `{}` (preset {}, seed {}, engine {}). Everything here is simulated \
         and rendered; nothing was measured.\n\n\
         | part | rows | grasps | objects | stable simulations | slips |\n\
         | --- | --- | --- | --- | --- | --- |\n{table}",
        plan.header.software,
        plan.sha256,
        plan.header.preset,
        plan.header.seed,
        plan.header.engine.name(),
    )
}
