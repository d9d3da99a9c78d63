//! Division of a dataset into parts that share no object.

use std::collections::{BTreeMap, BTreeSet};
use std::fmt;
use std::io;
use std::path::Path;

use rand_pcg::Pcg64;
use rand_pcg::rand_core::{Rng as _, SeedableRng as _};
use serde::{Deserialize, Serialize};
use sha2::{Digest as _, Sha256};

use super::disk::{Disk as _, SystemDisk, replace};
use super::grasp::{GraspRecord, Outcome};
use super::reader::{Dataset, entries};
use super::schema::SCHEMA_VERSION;
use super::schema::check_schema;
use gripcast_base::error::{Error, Result};
use gripcast_base::files::{BeneathPath, FileKind, FileName, GraspId, read_regular};

/// How many seeded orders are tried; the best balanced one is kept.
const TRIALS: u64 = 64;

/// What may not be in two parts.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum SplitBy {
    /// All grasps of an object stay together.
    Object,
    /// All grasps in a scene stay together.
    Scene,
}

impl fmt::Display for SplitBy {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(match self {
            Self::Object => "object",
            Self::Scene => "scene",
        })
    }
}

impl SplitBy {
    /// The item of a grasp; spellings that differ in case or blanks are the same item.
    pub fn item(self, record: &GraspRecord) -> String {
        let name = match self {
            Self::Object => record.object.as_str(),
            Self::Scene => record.scene.as_str(),
        };
        let words: Vec<String> = name.split_whitespace().map(str::to_lowercase).collect();
        words.join(" ")
    }
}

/// What a split is to be.
#[derive(Clone, Debug, PartialEq)]
pub struct SplitPlan {
    /// Name of the file in `splits/`, without extension.
    pub name: String,
    /// What stays together.
    pub by: SplitBy,
    /// Decides between equally good splits.
    pub seed: u64,
    /// Fraction of the grasps of each part; sums to 1.
    pub fractions: BTreeMap<String, f64>,
}

/// `splits/<name>.json`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SplitFile {
    /// Version of the dataset format.
    pub schema: u32,
    /// What stays together.
    pub by: SplitBy,
    /// Seed.
    pub seed: u64,
    /// Fraction of the grasps that was asked for.
    pub fractions: BTreeMap<String, f64>,
    /// The parts.
    pub parts: BTreeMap<String, SplitPart>,
}

/// One part of a split.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SplitPart {
    /// Objects (or scenes) of the part: lower case, single blanks.
    pub items: BTreeSet<String>,
    /// Grasps of the part.
    pub grasps: BTreeSet<GraspId>,
    /// Grasps by outcome.
    pub outcomes: BTreeMap<Outcome, usize>,
}

/// Splits a dataset and writes `splits/<name>.json`.
///
/// The result depends on the seed and the set of grasps, not on their order.
///
/// # Errors
/// `Usage` for shares that are not shares; `Input` with fewer objects than parts, or when a grasp
/// cannot be read; `DiskFull`, `Io`, … when the file cannot be written.
pub fn split(dataset: &Dataset, plan: &SplitPlan) -> Result<SplitFile> {
    let name = file_name(&plan.name)?;
    check_fractions(&plan.fractions)?;
    let mut items: BTreeMap<String, Vec<(GraspId, Outcome)>> = BTreeMap::new();
    for record in dataset.grasps()? {
        let record = record.map_err(|e| {
            e.remedy("run `gripcast dataset verify` to see what is wrong with the dataset")
        })?;
        items
            .entry(plan.by.item(&record))
            .or_default()
            .push((record.id, record.outcome));
    }
    let parts = divide(&items, plan)?;
    let file = SplitFile {
        schema: SCHEMA_VERSION,
        by: plan.by,
        seed: plan.seed,
        fractions: plan.fractions.clone(),
        parts,
    };
    file.write(dataset, &name)?;
    Ok(file)
}

impl Dataset {
    /// Names of the splits, sorted.
    ///
    /// # Errors
    /// When `splits/` cannot be read.
    pub fn split_names(&self) -> Result<Vec<String>> {
        let dir = self.layout().splits();
        if !dir.is_dir() {
            return Ok(Vec::new());
        }
        let names = entries(&dir)?.into_iter().map(|entry| entry.name());
        Ok(names
            .filter(|name| !name.starts_with('.'))
            .filter_map(|name| name.strip_suffix(".json").map(str::to_owned))
            .collect())
    }

    /// A split, by its name.
    ///
    /// # Errors
    /// `Usage`: no split can be called so. As of [`SplitFile::read`].
    pub fn split(&self, name: &str) -> Result<SplitFile> {
        let file = file_name(name)?;
        SplitFile::read_beneath(&self.layout().splits().join(file))
    }
}

impl SplitFile {
    /// Reads a split file.
    ///
    /// # Errors
    /// `NotFound`, or `Input` when it is no split of this version.
    pub fn read(path: &Path) -> Result<Self> {
        Self::from_bytes(read_regular(path, FileKind::List)).map_err(|e| e.at(path.display()))
    }

    /// Reads a split of a dataset.
    pub(super) fn read_beneath(path: &BeneathPath) -> Result<Self> {
        Self::from_bytes(path.read(FileKind::List)).map_err(|e| e.at(path.display()))
    }

    fn from_bytes(bytes: io::Result<Vec<u8>>) -> Result<Self> {
        let unreadable = |e: serde_json::Error| Error::input("cannot read the split").because(e);
        let bytes = bytes.map_err(|e| Error::io("cannot read the split", e))?;
        let value: serde_json::Value = serde_json::from_slice(&bytes).map_err(unreadable)?;
        if let Some(schema) = value.get("schema").and_then(serde_json::Value::as_i64) {
            check_schema(schema)?;
        }
        serde_json::from_value(value).map_err(unreadable)
    }

    /// All grasps of all parts.
    pub fn grasps(&self) -> impl Iterator<Item = &GraspId> {
        self.parts.values().flat_map(|part| &part.grasps)
    }

    /// Items and grasps that are in two parts, a sentence each. `record` looks a grasp up: what
    /// counts is what the records say now.
    pub fn leaks<'a>(&self, record: impl Fn(&GraspId) -> Option<&'a GraspRecord>) -> Vec<String> {
        let mut parts_of_item: BTreeMap<String, BTreeSet<&str>> = BTreeMap::new();
        let mut parts_of_grasp: BTreeMap<&GraspId, BTreeSet<&str>> = BTreeMap::new();
        for (name, part) in &self.parts {
            for item in &part.items {
                parts_of_item.entry(item.clone()).or_default().insert(name);
            }
            for id in &part.grasps {
                parts_of_grasp.entry(id).or_default().insert(name);
                if let Some(record) = record(id) {
                    let item = self.by.item(record);
                    parts_of_item.entry(item).or_default().insert(name);
                }
            }
        }
        let sentence = |what: String, parts: BTreeSet<&str>| {
            let parts: Vec<&str> = parts.into_iter().collect();
            (parts.len() > 1).then(|| format!("{what} is in {}", parts.join(" and ")))
        };
        let by = self.by;
        let items = parts_of_item
            .into_iter()
            .filter_map(|(item, parts)| sentence(format!("{by} `{item}`"), parts));
        let grasps = parts_of_grasp
            .into_iter()
            .filter_map(|(id, parts)| sentence(format!("grasp {id}"), parts));
        items.chain(grasps).collect()
    }

    fn write(&self, dataset: &Dataset, name: &FileName) -> Result<()> {
        let layout = dataset.layout();
        let dir = layout.splits();
        let mut json = serde_json::to_value(self)
            .and_then(|value| serde_json::to_vec_pretty(&value))
            .map_err(|e| Error::internal("cannot write the split").because(e))?;
        json.push(b'\n');
        let made = if dir.is_dir() {
            Ok(())
        } else {
            SystemDisk
                .create_dir(&dir)
                .and_then(|()| SystemDisk.sync_dir(&layout.top()))
        };
        made.and_then(|()| replace(&SystemDisk, &dir, name, &json))
            .map_err(|e| layout.failed(&format!("cannot write splits/{name}"), e))
    }
}

/// Words by which `imagefolder` takes a file for a part of the data, and then sees nothing else.
const PART_WORDS: [&str; 10] = [
    "train",
    "training",
    "validation",
    "valid",
    "val",
    "dev",
    "test",
    "testing",
    "eval",
    "evaluation",
];

/// The file of a split of this name.
pub(super) fn file_name(name: &str) -> Result<FileName> {
    check_name(name)?;
    FileName::parse(&format!("{name}.json"))
}

/// Refuses names that are no plain file names or would hide the dataset from `imagefolder`.
pub(super) fn check_name(name: &str) -> Result<()> {
    let refused = |why: &str| {
        Err(Error::usage(format!(
            "`{name}` cannot be the name of a split: {why}"
        )))
    };
    let plain = !name.is_empty()
        && !name.starts_with('.')
        && name
            .chars()
            .all(|c| c.is_ascii_alphanumeric() || matches!(c, '-' | '_' | '.'));
    if !plain {
        return refused("use letters, digits, `-`, `_` and `.`");
    }
    let mut words = name.split(|c: char| !c.is_ascii_alphabetic());
    match words.find(|word| PART_WORDS.contains(&word.to_ascii_lowercase().as_str())) {
        Some(word) => refused(&format!(
            "`imagefolder` would take the file for the {word} part of the data and load nothing \
             else; the parts are inside the file"
        )),
        None => Ok(()),
    }
}

fn check_fractions(fractions: &BTreeMap<String, f64>) -> Result<()> {
    let sum: f64 = fractions.values().sum();
    let are_fractions = fractions
        .values()
        .all(|fraction| (0.0..=1.0).contains(fraction));
    if are_fractions && (sum - 1.0).abs() < 1e-6 {
        return Ok(());
    }
    let text: Vec<String> = fractions
        .iter()
        .map(|(name, fraction)| format!("{name} {fraction}"))
        .collect();
    Err(Error::usage(format!(
        "the fractions ({}) must lie between 0 and 1 and sum to 1, not {sum:.6}",
        text.join(", ")
    )))
}

/// Grasps by outcome: stable, slip, unlabelled.
type Tally = [f64; 3];

fn tally(grasps: &[(GraspId, Outcome)]) -> Tally {
    let mut tally = [0.0; 3];
    for (_, outcome) in grasps {
        tally[*outcome as usize] += 1.0;
    }
    tally
}

/// Assigns items to parts, greedily in the best of several seeded orders.
fn divide(
    items: &BTreeMap<String, Vec<(GraspId, Outcome)>>,
    plan: &SplitPlan,
) -> Result<BTreeMap<String, SplitPart>> {
    let parts: Vec<(&String, f64)> = plan
        .fractions
        .iter()
        .filter(|(_, fraction)| **fraction > 0.0)
        .map(|(name, fraction)| (name, *fraction))
        .collect();
    if items.len() < parts.len() {
        return Err(Error::input(format!(
            "{} parts need at least {} different {}s, but the dataset has {}",
            parts.len(),
            parts.len(),
            plan.by,
            items.len()
        ))
        .remedy("collect more of them, or give fewer parts a fraction above 0"));
    }
    let tallies: Vec<(&String, Tally)> = items
        .iter()
        .map(|(item, grasps)| (item, tally(grasps)))
        .collect();
    let mut total = [0.0; 3];
    for (_, tally) in &tallies {
        for (sum, count) in total.iter_mut().zip(tally) {
            *sum += count;
        }
    }
    let targets: Vec<Tally> = parts
        .iter()
        .map(|(_, fraction)| total.map(|count| count * fraction))
        .collect();
    let mut best: Option<(f64, BTreeMap<&String, usize>)> = None;
    for trial in 0..TRIALS {
        let (cost, assignment) = assign(&tallies, &targets, plan.seed, trial);
        if best.as_ref().is_none_or(|(least, _)| cost < *least) {
            best = Some((cost, assignment));
        }
    }
    let mut divided: BTreeMap<String, SplitPart> = parts
        .iter()
        .map(|(name, _)| ((*name).clone(), SplitPart::default()))
        .collect();
    for (item, part) in best.map(|(_, assignment)| assignment).unwrap_or_default() {
        let Some(part) = divided.get_mut(parts[part].0) else {
            continue;
        };
        part.items.insert(item.clone());
        for (id, outcome) in &items[item] {
            part.grasps.insert(id.clone());
            *part.outcomes.entry(*outcome).or_default() += 1;
        }
    }
    Ok(divided)
}

/// One greedy assignment: item → part, and how far the parts are from their targets.
fn assign<'a>(
    tallies: &[(&'a String, Tally)],
    targets: &[Tally],
    seed: u64,
    trial: u64,
) -> (f64, BTreeMap<&'a String, usize>) {
    let mut order: Vec<(u64, &String, Tally)> = tallies
        .iter()
        .map(|(item, tally)| (draw(seed, trial, item), *item, *tally))
        .collect();
    order.sort_by(|a, b| (a.0, a.1).cmp(&(b.0, b.1)));
    let mut filled = vec![[0.0; 3]; targets.len()];
    let mut items_in = vec![0_usize; targets.len()];
    let mut assignment = BTreeMap::new();
    let count = order.len();
    for (position, (_, item, tally)) in order.into_iter().enumerate() {
        let empty = items_in.iter().filter(|items| **items == 0).count();
        let only_empty = count - position <= empty;
        // The part whose distance to its target shrinks most by taking the item.
        let gain = |part: usize| {
            let after: Tally = std::array::from_fn(|i| filled[part][i] + tally[i]);
            distance(&filled[part], &targets[part]) - distance(&after, &targets[part])
        };
        let chosen = (0..targets.len())
            .filter(|part| !only_empty || items_in[*part] == 0)
            .max_by(|a, b| gain(*a).total_cmp(&gain(*b)).then(b.cmp(a)));
        let Some(part) = chosen else { continue };
        for (sum, count) in filled[part].iter_mut().zip(tally) {
            *sum += count;
        }
        items_in[part] += 1;
        assignment.insert(item, part);
    }
    let cost = filled
        .iter()
        .zip(targets)
        .map(|(filled, target)| distance(filled, target))
        .sum();
    (cost, assignment)
}

/// Squared distance in outcomes and, counted as much as all of them, in the number of grasps.
fn distance(filled: &Tally, target: &Tally) -> f64 {
    let by_outcome: f64 = filled
        .iter()
        .zip(target)
        .map(|(filled, target)| (filled - target).powi(2))
        .sum();
    let all = filled.iter().sum::<f64>() - target.iter().sum::<f64>();
    by_outcome + all.powi(2)
}

/// The item's own random number: independent of all other items and of any order.
fn draw(seed: u64, trial: u64, item: &str) -> u64 {
    let mut hasher = Sha256::new();
    hasher.update(b"dataset split\0");
    hasher.update(seed.to_le_bytes());
    hasher.update(trial.to_le_bytes());
    hasher.update(item.as_bytes());
    Pcg64::from_seed(hasher.finalize().into()).next_u64()
}

#[cfg(test)]
mod tests {
    use super::*;
    use gripcast_base::error::ErrorKind;

    fn plan(seed: u64) -> SplitPlan {
        SplitPlan {
            name: "seed-7".into(),
            by: SplitBy::Object,
            seed,
            fractions: BTreeMap::from([
                ("train".into(), 0.7),
                ("val".into(), 0.15),
                ("test".into(), 0.15),
            ]),
        }
    }

    fn items(count: usize) -> BTreeMap<String, Vec<(GraspId, Outcome)>> {
        (0..count)
            .map(|object| {
                let grasps = (0..4 + object % 5)
                    .map(|grasp| {
                        let outcome = if (object + grasp) % 3 == 0 {
                            Outcome::Slip
                        } else {
                            Outcome::Stable
                        };
                        (
                            GraspId::parse(&format!("{object}-{grasp}")).unwrap(),
                            outcome,
                        )
                    })
                    .collect();
                (format!("object {object}"), grasps)
            })
            .collect()
    }

    #[test]
    fn parts_are_balanced_complete_and_reproducible() {
        let items = items(40);
        let all: usize = items.values().map(Vec::len).sum();
        let parts = divide(&items, &plan(7)).unwrap();
        assert_eq!(parts, divide(&items, &plan(7)).unwrap());
        assert_ne!(parts, divide(&items, &plan(8)).unwrap());
        let placed: usize = parts.values().map(|part| part.grasps.len()).sum();
        assert_eq!(placed, all);
        let slips_of_all = items
            .values()
            .flatten()
            .filter(|(_, outcome)| *outcome == Outcome::Slip)
            .count() as f64
            / all as f64;
        for (name, fraction) in &plan(7).fractions {
            let part = &parts[name];
            let found = part.grasps.len() as f64 / all as f64;
            assert!((found - fraction).abs() < 0.03, "{name}: {found}");
            let slips = part.outcomes[&Outcome::Slip] as f64 / part.grasps.len() as f64;
            assert!((slips - slips_of_all).abs() < 0.05, "{name}: {slips}");
        }
    }

    #[test]
    fn every_part_gets_an_object_and_too_few_objects_are_refused() {
        let parts = divide(&items(3), &plan(1)).unwrap();
        assert!(parts.values().all(|part| part.items.len() == 1));
        let error = divide(&items(2), &plan(1)).unwrap_err();
        assert!(error.to_string().contains("3 different objects"), "{error}");
    }

    #[test]
    fn fractions_must_be_fractions() {
        let fractions = |train: f64, val: f64| {
            check_fractions(&BTreeMap::from([
                ("train".into(), train),
                ("val".into(), val),
            ]))
        };
        assert!(fractions(0.8, 0.2).is_ok());
        assert!(fractions(0.8, 0.3).is_err());
        assert!(fractions(1.5, -0.5).is_err());
        assert!(fractions(f64::NAN, 1.0).is_err());
    }

    #[test]
    fn names_that_mislead_imagefolder_are_refused() {
        for name in ["object-7", "fold_3", "contest", "v1.2"] {
            assert!(check_name(name).is_ok(), "{name}");
        }
        for name in ["", ".x", "../x", "a b", "test", "my-Train_2", "val.1"] {
            assert_eq!(
                check_name(name).unwrap_err().kind(),
                ErrorKind::Usage,
                "{name}"
            );
        }
    }

    #[test]
    fn a_leak_is_named() {
        let part = |item: &str, id: &str| SplitPart {
            items: BTreeSet::from([item.to_owned()]),
            grasps: BTreeSet::from([GraspId::parse(id).unwrap()]),
            outcomes: BTreeMap::new(),
        };
        let file = SplitFile {
            schema: 1,
            by: SplitBy::Object,
            seed: 0,
            fractions: BTreeMap::new(),
            parts: BTreeMap::from([
                ("test".into(), part("mug", "a")),
                ("train".into(), part("mug", "a")),
            ]),
        };
        assert_eq!(
            file.leaks(|_| None),
            [
                "object `mug` is in test and train",
                "grasp a is in test and train"
            ]
        );
    }
}
