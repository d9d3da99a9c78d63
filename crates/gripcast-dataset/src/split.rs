//! Splits a dataset so that no group (object or scene) is in two splits.

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
use super::schema::{SPLIT_VERSION, check_version};
use gripcast_base::error::{Error, Result};
use gripcast_base::files::{
    BeneathPath, FileKind, FileName, GraspId, folded_name, read_regular, without_bom,
};

/// Number of seeded orders; the best balanced one is kept.
const TRIALS: u64 = 64;

/// Group key: what may not be in two splits.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum GroupKey {
    /// No object is in two splits.
    Object,
    /// No scene is in two splits.
    Scene,
}

impl fmt::Display for GroupKey {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(match self {
            Self::Object => "object",
            Self::Scene => "scene",
        })
    }
}

impl GroupKey {
    /// Returns the group of a grasp; names that are easily confused are equal.
    pub fn group(self, record: &GraspRecord) -> String {
        let name = match self {
            Self::Object => record.object.as_str(),
            Self::Scene => record.scene.as_str(),
        };
        folded_name(name)
    }
}

/// Settings of a split.
#[derive(Clone, Debug, PartialEq)]
pub struct SplitPlan {
    /// Name of the file in `splits/`, without extension.
    pub name: String,
    /// Group key.
    pub by: GroupKey,
    /// Random seed.
    pub seed: u64,
    /// Fraction of the grasps in each split; sums to 1.
    pub fractions: BTreeMap<String, f64>,
}

/// `splits/<name>.json`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SplitFile {
    /// Version of the file.
    pub schema: u32,
    /// Group key.
    pub by: GroupKey,
    /// Random seed.
    pub seed: u64,
    /// Requested fraction of the grasps in each split.
    pub fractions: BTreeMap<String, f64>,
    /// The splits by name.
    #[serde(alias = "parts")]
    pub splits: BTreeMap<String, SplitMembers>,
}

/// Members of one split.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SplitMembers {
    /// Groups (objects or scenes) of the split: lower case, single blanks.
    #[serde(alias = "items")]
    pub groups: BTreeSet<String>,
    /// Grasps of the split.
    pub grasps: BTreeSet<GraspId>,
    /// Grasps by outcome.
    pub outcomes: BTreeMap<Outcome, usize>,
}

/// Splits a dataset and writes `splits/<name>.json`.
///
/// The result depends on the seed and the set of grasps, not on their order.
///
/// # Errors
/// `Usage` for invalid fractions; `Input` with fewer groups than splits, or when a grasp
/// cannot be read; `DiskFull`, `Io`, … when the file cannot be written.
pub fn split(dataset: &Dataset, plan: &SplitPlan) -> Result<SplitFile> {
    let name = file_name(&plan.name)?;
    check_fractions(&plan.fractions)?;
    let mut groups: BTreeMap<String, Vec<(GraspId, Outcome)>> = BTreeMap::new();
    for record in dataset.grasps()? {
        let record = record.map_err(|e| {
            e.remedy("run `gripcast dataset verify` to list the problems of the dataset")
        })?;
        groups
            .entry(plan.by.group(&record))
            .or_default()
            .push((record.id, record.outcome));
    }
    let splits = divide(&groups, plan)?;
    let file = SplitFile {
        schema: SPLIT_VERSION,
        by: plan.by,
        seed: plan.seed,
        fractions: plan.fractions.clone(),
        splits,
    };
    file.write(dataset, &name)?;
    Ok(file)
}

impl Dataset {
    /// Names of the split files, sorted.
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

    /// Reads a split file by its name.
    ///
    /// # Errors
    /// `Usage`: invalid name. As [`SplitFile::read`].
    pub fn split(&self, name: &str) -> Result<SplitFile> {
        let file = file_name(name)?;
        SplitFile::read_beneath(&self.layout().splits().join(file))
    }
}

impl SplitFile {
    /// Reads a split file.
    ///
    /// # Errors
    /// `NotFound`, or `Input` when it is not a valid split file of this version.
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
        let value: serde_json::Value =
            serde_json::from_slice(without_bom(&bytes)).map_err(unreadable)?;
        if let Some(schema) = value.get("schema").and_then(serde_json::Value::as_i64) {
            check_version(schema, SPLIT_VERSION..=SPLIT_VERSION)?;
        }
        serde_json::from_value(value).map_err(unreadable)
    }

    /// Grasps of all splits.
    pub fn grasps(&self) -> impl Iterator<Item = &GraspId> {
        self.splits.values().flat_map(|members| &members.grasps)
    }

    /// Lists groups and grasps that are in two splits, a sentence each. `record` looks up a grasp:
    /// its current record counts.
    pub fn leaks<'a>(&self, record: impl Fn(&GraspId) -> Option<&'a GraspRecord>) -> Vec<String> {
        let by = self.by;
        // Groups come before grasps.
        let mut splits_of: BTreeMap<(bool, String), BTreeSet<&str>> = BTreeMap::new();
        for (name, members) in &self.splits {
            let mut add = |is_grasp, item| {
                splits_of.entry((is_grasp, item)).or_default().insert(name);
            };
            for group in &members.groups {
                add(false, format!("{by} `{group}`"));
            }
            for id in &members.grasps {
                add(true, format!("grasp {id}"));
                if let Some(record) = record(id) {
                    add(false, format!("{by} `{}`", by.group(record)));
                }
            }
        }
        let leaks = splits_of.into_iter().filter(|(_, splits)| splits.len() > 1);
        leaks
            .map(|((_, item), splits)| {
                let splits: Vec<&str> = splits.into_iter().collect();
                format!("{item} is in {}", splits.join(" and "))
            })
            .collect()
    }

    fn write(&self, dataset: &Dataset, name: &FileName) -> Result<()> {
        let layout = dataset.layout();
        let dir = layout.splits();
        let mut json = serde_json::to_value(self)
            .and_then(|value| serde_json::to_vec_pretty(&value))
            .map_err(|e| Error::internal("cannot write the split").because(e))?;
        json.push(b'\n');
        let created = if dir.is_dir() {
            Ok(())
        } else {
            SystemDisk
                .create_dir(&dir)
                .and_then(|()| SystemDisk.sync_dir(&layout.top()))
        };
        created
            .and_then(|()| replace(&SystemDisk, &dir, name, &json))
            .map_err(|e| layout.failed(&format!("cannot write splits/{name}"), e))
    }
}

/// Words in file names that `imagefolder` takes for the name of a split.
const SPLIT_WORDS: [&str; 10] = [
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

/// File name of a split.
pub(super) fn file_name(name: &str) -> Result<FileName> {
    check_name(name)?;
    FileName::parse(&format!("{name}.json"))
}

/// Refuses invalid file names and names that hide the dataset from `imagefolder`.
pub(super) fn check_name(name: &str) -> Result<()> {
    let refused = |why: &str| Err(Error::usage(format!("invalid split name `{name}`: {why}")));
    let plain = !name.is_empty()
        && !name.starts_with('.')
        && name
            .chars()
            .all(|c| c.is_ascii_alphanumeric() || matches!(c, '-' | '_' | '.'));
    if !plain {
        return refused("use letters, digits, `-`, `_` and `.`");
    }
    let mut words = name.split(|c: char| !c.is_ascii_alphabetic());
    match words.find(|word| SPLIT_WORDS.contains(&word.to_ascii_lowercase().as_str())) {
        Some(word) => refused(&format!(
            "`imagefolder` would take the file for the {word} split and load nothing else"
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
        "expected fractions between 0 and 1 that sum to 1, found {} (sum {sum:.6})",
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

/// Assigns groups to splits, greedily in the best of several seeded orders.
fn divide(
    groups: &BTreeMap<String, Vec<(GraspId, Outcome)>>,
    plan: &SplitPlan,
) -> Result<BTreeMap<String, SplitMembers>> {
    let splits: Vec<(&String, f64)> = plan
        .fractions
        .iter()
        .filter(|(_, fraction)| **fraction > 0.0)
        .map(|(name, fraction)| (name, *fraction))
        .collect();
    if groups.len() < splits.len() {
        return Err(Error::input(format!(
            "{} splits need at least {} different {}s, found {}",
            splits.len(),
            splits.len(),
            plan.by,
            groups.len()
        ))
        .remedy("collect more of them, or use fewer splits"));
    }
    let tallies: Vec<(&String, Tally)> = groups
        .iter()
        .map(|(group, grasps)| (group, tally(grasps)))
        .collect();
    let mut total = [0.0; 3];
    for (_, tally) in &tallies {
        for (sum, count) in total.iter_mut().zip(tally) {
            *sum += count;
        }
    }
    let targets: Vec<Tally> = splits
        .iter()
        .map(|(_, fraction)| total.map(|count| count * fraction))
        .collect();
    let mut best: Option<(f64, BTreeMap<&String, usize>)> = None;
    for trial in 0..TRIALS {
        let (cost, assignment) = assign(&tallies, &targets, plan.seed, trial);
        if best.as_ref().is_none_or(|(min, _)| cost < *min) {
            best = Some((cost, assignment));
        }
    }
    let mut divided: BTreeMap<String, SplitMembers> = splits
        .iter()
        .map(|(name, _)| ((*name).clone(), SplitMembers::default()))
        .collect();
    for (group, split) in best.map(|(_, assignment)| assignment).unwrap_or_default() {
        let Some(members) = divided.get_mut(splits[split].0) else {
            continue;
        };
        members.groups.insert(group.clone());
        for (id, outcome) in &groups[group] {
            members.grasps.insert(id.clone());
            *members.outcomes.entry(*outcome).or_default() += 1;
        }
    }
    Ok(divided)
}

/// One greedy assignment of groups to splits, with its distance from the targets.
fn assign<'a>(
    tallies: &[(&'a String, Tally)],
    targets: &[Tally],
    seed: u64,
    trial: u64,
) -> (f64, BTreeMap<&'a String, usize>) {
    let mut order: Vec<(u64, &String, Tally)> = tallies
        .iter()
        .map(|(group, tally)| (draw(seed, trial, group), *group, *tally))
        .collect();
    order.sort_by(|a, b| (a.0, a.1).cmp(&(b.0, b.1)));
    let mut filled = vec![[0.0; 3]; targets.len()];
    let mut groups_in = vec![0_usize; targets.len()];
    let mut assignment = BTreeMap::new();
    let count = order.len();
    for (position, (_, group, tally)) in order.into_iter().enumerate() {
        let empty = groups_in.iter().filter(|count| **count == 0).count();
        let only_empty = count - position <= empty;
        // Decrease of the split's distance from its target by adding the group.
        let gain = |split: usize| {
            let after: Tally = std::array::from_fn(|i| filled[split][i] + tally[i]);
            distance(&filled[split], &targets[split]) - distance(&after, &targets[split])
        };
        let chosen = (0..targets.len())
            .filter(|split| !only_empty || groups_in[*split] == 0)
            .max_by(|a, b| gain(*a).total_cmp(&gain(*b)).then(b.cmp(a)));
        let Some(split) = chosen else { continue };
        for (sum, count) in filled[split].iter_mut().zip(tally) {
            *sum += count;
        }
        groups_in[split] += 1;
        assignment.insert(group, split);
    }
    let cost = filled
        .iter()
        .zip(targets)
        .map(|(filled, target)| distance(filled, target))
        .sum();
    (cost, assignment)
}

/// Squared distance in the counts by outcome and, with the same weight, in the number of grasps.
fn distance(filled: &Tally, target: &Tally) -> f64 {
    let by_outcome: f64 = filled
        .iter()
        .zip(target)
        .map(|(filled, target)| (filled - target).powi(2))
        .sum();
    let all = filled.iter().sum::<f64>() - target.iter().sum::<f64>();
    by_outcome + all.powi(2)
}

/// Random number of a group, independent of other groups and their order.
fn draw(seed: u64, trial: u64, group: &str) -> u64 {
    let mut hasher = Sha256::new();
    hasher.update(b"dataset split\0");
    hasher.update(seed.to_le_bytes());
    hasher.update(trial.to_le_bytes());
    hasher.update(group.as_bytes());
    Pcg64::from_seed(hasher.finalize().into()).next_u64()
}

#[cfg(test)]
mod tests {
    use super::*;
    use gripcast_base::error::ErrorKind;

    fn plan(seed: u64) -> SplitPlan {
        SplitPlan {
            name: "seed-7".into(),
            by: GroupKey::Object,
            seed,
            fractions: BTreeMap::from([
                ("train".into(), 0.7),
                ("val".into(), 0.15),
                ("test".into(), 0.15),
            ]),
        }
    }

    fn groups(count: usize) -> BTreeMap<String, Vec<(GraspId, Outcome)>> {
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
    fn splits_are_balanced_complete_and_reproducible() {
        let groups = groups(40);
        let all: usize = groups.values().map(Vec::len).sum();
        let splits = divide(&groups, &plan(7)).unwrap();
        assert_eq!(splits, divide(&groups, &plan(7)).unwrap());
        assert_ne!(splits, divide(&groups, &plan(8)).unwrap());
        let placed: usize = splits.values().map(|split| split.grasps.len()).sum();
        assert_eq!(placed, all);
        let slips_of_all = groups
            .values()
            .flatten()
            .filter(|(_, outcome)| *outcome == Outcome::Slip)
            .count() as f64
            / all as f64;
        for (name, fraction) in &plan(7).fractions {
            let split = &splits[name];
            let found = split.grasps.len() as f64 / all as f64;
            assert!((found - fraction).abs() < 0.03, "{name}: {found}");
            let slips = split.outcomes[&Outcome::Slip] as f64 / split.grasps.len() as f64;
            assert!((slips - slips_of_all).abs() < 0.05, "{name}: {slips}");
        }
    }

    #[test]
    fn every_split_gets_an_object() {
        let splits = divide(&groups(3), &plan(1)).unwrap();
        assert!(splits.values().all(|split| split.groups.len() == 1));
        let error = divide(&groups(2), &plan(1)).unwrap_err();
        assert!(error.to_string().contains("3 different objects"), "{error}");
    }

    #[test]
    fn invalid_fractions_are_refused() {
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
    fn split_words_in_names_are_refused() {
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
    fn leak_is_reported() {
        let members = |group: &str, id: &str| SplitMembers {
            groups: BTreeSet::from([group.to_owned()]),
            grasps: BTreeSet::from([GraspId::parse(id).unwrap()]),
            outcomes: BTreeMap::new(),
        };
        let file = SplitFile {
            schema: 1,
            by: GroupKey::Object,
            seed: 0,
            fractions: BTreeMap::new(),
            splits: BTreeMap::from([
                ("test".into(), members("mug", "a")),
                ("train".into(), members("mug", "a")),
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
