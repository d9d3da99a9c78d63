//! Curation: which simulations become the dataset, and in which split.
//!
//! Objects (or whole categories) are assigned to splits first, so that no split contains another's
//! objects. The assignment depends on the plan alone: datasets of the same grasps from two engines
//! have the same objects in each split, whatever the labels. Within each split, categories are
//! capped and the two labels balanced, as in the paper (§3.2, §4).

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

use gripcast_base::error::{Error, Result};
use gripcast_base::random::SeedStream;
use gripcast_dataset::shard::{SplitFractions, SplitGroup};

/// Grouping key of the split: no group is in two splits.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum GroupKey {
    /// All grasps of an object stay together.
    Object,
    /// All grasps of a category stay together, which is harder.
    Category,
}

/// How the labels of a split are balanced: simulations with the more frequent label are left out
/// until both labels are equally frequent.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum LabelBalance {
    /// In the whole split, as in the paper's test set (§4): those left out are drawn at random, so
    /// forces and categories keep their own base rates.
    #[default]
    Overall,
    /// At each force, and first in the category with the largest surplus, so that neither the force
    /// nor the category predicts the label.
    Category,
    /// Not at all: all labelled simulations are kept.
    None,
}

/// Descriptions of datasets before version 2 have `is_balanced`: true is `category`, false `none`.
impl<'de> Deserialize<'de> for LabelBalance {
    fn deserialize<D: serde::Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        #[derive(Deserialize)]
        #[serde(untagged)]
        enum Stored {
            IsBalanced(bool),
            Name(String),
        }
        match Stored::deserialize(deserializer)? {
            Stored::IsBalanced(true) => Ok(Self::Category),
            Stored::IsBalanced(false) => Ok(Self::None),
            Stored::Name(name) => match &*name {
                "overall" => Ok(Self::Overall),
                "category" => Ok(Self::Category),
                "none" => Ok(Self::None),
                _ => Err(serde::de::Error::custom(format!(
                    "expected a balance overall, category or none, found {name:?}"
                ))),
            },
        }
    }
}

/// How a dataset is selected from results.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CurationSettings {
    /// Grouping key of the split.
    #[serde(rename = "apart")]
    pub group_by: GroupKey,
    /// Splits and their fractions of the simulations.
    #[serde(rename = "parts")]
    pub splits: SplitFractions,
    /// Maximum simulations of a category, as a multiple of the mean; none for no cap.
    pub category_cap: Option<f64>,
    /// How the labels of each split are balanced.
    #[serde(alias = "is_balanced")]
    pub balance: LabelBalance,
    /// Whether the split `train` keeps all of both labels nevertheless, since training can weight
    /// them; the other splits are still balanced.
    #[serde(default, rename = "is_training_whole")]
    pub keep_all_training: bool,
    /// Seed that decides which simulations are left out.
    pub seed: u64,
}

/// The split of [`CurationSettings::keep_all_training`].
const TRAIN: &str = "train";

impl Default for CurationSettings {
    /// 80 % train, 10 % validation, 10 % test; grouped by object; at most twice the mean of
    /// simulations per category; labels balanced over the split.
    fn default() -> Self {
        Self {
            group_by: GroupKey::Object,
            splits: SplitFractions::standard(),
            category_cap: Some(2.0),
            balance: LabelBalance::default(),
            keep_all_training: false,
            seed: 0,
        }
    }
}

/// Category and size of one object of a plan.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ObjectSummary {
    /// Category.
    pub category: String,
    /// Number of planned simulations, with a label or without.
    pub simulations: usize,
}

/// A simulation that may be in the dataset.
#[derive(Clone, Debug, PartialEq)]
pub struct LabelledSimulation {
    /// Id.
    pub id: String,
    /// Name of the object.
    pub object: String,
    /// Category of the object.
    pub category: String,
    /// Stopping force, N.
    pub stop_force_n: f64,
    /// Label: stable or slip.
    pub stable: bool,
}

/// Why a labelled simulation is not in the dataset.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum LeftOut {
    /// Its category reached the cap.
    CategoryCap,
    /// Its label is the more frequent one.
    Balance,
}

/// Result of a curation.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Curation {
    /// Split of each simulation that is in the dataset, by id.
    pub split_of: BTreeMap<String, String>,
    /// Reason for each of the others, by id.
    pub left_out: BTreeMap<String, LeftOut>,
}

/// Selects a dataset from the labelled simulations of the `planned` objects. The result does not
/// depend on the order of the simulations.
///
/// # Errors
/// `Input` if no simulation is left.
pub fn curate(
    planned: &BTreeMap<String, ObjectSummary>,
    labelled: &[LabelledSimulation],
    settings: &CurationSettings,
) -> Result<Curation> {
    let mut groups: BTreeMap<String, SplitGroup> = BTreeMap::new();
    for (name, object) in planned {
        let (group, stratum) = match settings.group_by {
            GroupKey::Object => (name.clone(), object.category.clone()),
            GroupKey::Category => (object.category.clone(), String::new()),
        };
        let new = SplitGroup { stratum, size: 0 };
        groups.entry(group).or_insert(new).size += object.simulations;
    }
    let assigned = settings.splits.assign(&groups, settings.seed);
    let mut by_split: BTreeMap<&String, Vec<&LabelledSimulation>> = BTreeMap::new();
    for one in labelled {
        let group = match settings.group_by {
            GroupKey::Object => &one.object,
            GroupKey::Category => &one.category,
        };
        if let Some(split) = assigned.get(group) {
            by_split.entry(split).or_default().push(one);
        }
    }
    let mut curation = Curation::default();
    for (split, mut all) in by_split {
        // A shuffle that does not depend on the order or on the other simulations.
        all.sort_by_key(|one| (shuffle_key(settings.seed, &one.id), &one.id));
        cap(&mut all, settings.category_cap, &mut curation.left_out);
        if !(settings.keep_all_training && split == TRAIN) {
            match settings.balance {
                LabelBalance::Overall => balance_overall(&all, &mut curation.left_out),
                LabelBalance::Category => balance_at_forces(&all, &mut curation.left_out),
                LabelBalance::None => {}
            }
            all.retain(|one| !curation.left_out.contains_key(&one.id));
        }
        let kept = all.iter().map(|one| (one.id.clone(), split.clone()));
        curation.split_of.extend(kept);
    }
    if curation.split_of.is_empty() {
        return Err(Error::input(format!(
            "curation leaves none of {} simulations; {} of them are stable",
            labelled.len(),
            labelled.iter().filter(|one| one.stable).count()
        ))
        .remedy("simulate more grasps, or merge with --balance none"));
    }
    Ok(curation)
}

fn shuffle_key(seed: u64, id: &str) -> u64 {
    SeedStream::named(seed, &format!("curation {id}")).bits()
}

/// Limits each category to `factor` times the mean over categories.
fn cap(
    all: &mut Vec<&LabelledSimulation>,
    factor: Option<f64>,
    left_out: &mut BTreeMap<String, LeftOut>,
) {
    let Some(factor) = factor else { return };
    let mut counts: BTreeMap<&String, usize> = BTreeMap::new();
    for one in all.iter() {
        *counts.entry(&one.category).or_default() += 1;
    }
    let mean = all.len() as f64 / counts.len().max(1) as f64;
    let max = (factor * mean).ceil() as usize;
    let mut taken: BTreeMap<&String, usize> = BTreeMap::new();
    all.retain(|one| {
        let taken = taken.entry(&one.category).or_default();
        *taken += 1;
        if *taken > max {
            left_out.insert(one.id.clone(), LeftOut::CategoryCap);
        }
        *taken <= max
    });
}

/// Drops the surplus of the more frequent label; `all` is in random order.
fn balance_overall(all: &[&LabelledSimulation], left_out: &mut BTreeMap<String, LeftOut>) {
    let (frequent, surplus) = surplus(all);
    let frequent = all.iter().filter(|one| one.stable == frequent);
    let dropped = frequent.take(surplus);
    left_out.extend(dropped.map(|one| (one.id.clone(), LeftOut::Balance)));
}

/// Balances the simulations of each force.
fn balance_at_forces(all: &[&LabelledSimulation], left_out: &mut BTreeMap<String, LeftOut>) {
    let mut forces: Vec<f64> = all.iter().map(|one| one.stop_force_n).collect();
    forces.sort_by(f64::total_cmp);
    forces.dedup();
    for force_n in forces {
        let at_force = |one: &&&LabelledSimulation| one.stop_force_n == force_n;
        let group: Vec<_> = all.iter().filter(at_force).copied().collect();
        balance_by_category(&group, left_out);
    }
}

/// Returns the more frequent label and how many more simulations have it.
fn surplus(all: &[&LabelledSimulation]) -> (bool, usize) {
    let stable = all.iter().filter(|one| one.stable).count();
    (2 * stable > all.len(), (2 * stable).abs_diff(all.len()))
}

/// Drops the surplus of the more frequent label, first from the category with the largest surplus.
fn balance_by_category(all: &[&LabelledSimulation], left_out: &mut BTreeMap<String, LeftOut>) {
    let (frequent, surplus) = surplus(all);
    // By category: surplus of the frequent label, and the ids with it.
    let mut categories: BTreeMap<&String, (i64, Vec<&String>)> = BTreeMap::new();
    for one in all.iter() {
        let (excess, members) = categories.entry(&one.category).or_default();
        if one.stable == frequent {
            *excess += 1;
            members.push(&one.id);
        } else {
            *excess -= 1;
        }
    }
    for _ in 0..surplus {
        let largest = categories
            .values_mut()
            .filter(|(_, members)| !members.is_empty())
            .rev()
            .max_by_key(|(excess, _)| *excess);
        let Some((excess, members)) = largest else {
            break;
        };
        *excess -= 1;
        if let Some(id) = members.pop() {
            left_out.insert(id.clone(), LeftOut::Balance);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn labelled(count: usize) -> Vec<LabelledSimulation> {
        let mut draw = SeedStream::named(1, "test");
        (0..count)
            .map(|number| {
                // Mugs are four times as frequent, and stable more often.
                let category = draw.pick(["mug", "mug", "mug", "mug", "box", "ring", "tool"]);
                let probability = if category == "mug" { 0.8 } else { 0.5 };
                LabelledSimulation {
                    id: format!("s{number:04}"),
                    object: format!("{category}-{}", draw.index(12)),
                    category: category.to_owned(),
                    stop_force_n: if number % 3 == 0 { 10.0 } else { 40.0 },
                    stable: draw.uniform() < probability,
                }
            })
            .collect()
    }

    fn planned(all: &[LabelledSimulation]) -> BTreeMap<String, ObjectSummary> {
        let mut planned = BTreeMap::new();
        for one in all {
            let new = ObjectSummary {
                category: one.category.clone(),
                simulations: 0,
            };
            let object = planned.entry(one.object.clone()).or_insert(new);
            object.simulations += 1;
        }
        planned
    }

    #[test]
    fn overall_balance_keeps_base_rates_of_forces_and_categories() {
        let mut all = labelled(1200);
        // Strong grasps are stable more often.
        for one in &mut all {
            one.stable |= one.stop_force_n == 40.0 && one.id.ends_with(['1', '2', '3']);
        }
        let fractions = |balance: LabelBalance| {
            let settings = CurationSettings {
                balance,
                category_cap: None,
                ..CurationSettings::default()
            };
            let curation = curate(&planned(&all), &all, &settings).unwrap();
            let kept = all.iter().filter(|one| {
                let split = curation.split_of.get(&one.id);
                split.is_some_and(|split| split == TRAIN)
            });
            let kept: Vec<&LabelledSimulation> = kept.collect();
            let fraction = |of: &dyn Fn(&LabelledSimulation) -> bool| {
                let of: Vec<_> = kept.iter().filter(|one| of(one)).collect();
                of.iter().filter(|one| one.stable).count() as f64 / of.len() as f64
            };
            [
                fraction(&|_| true),
                fraction(&|one| one.stop_force_n == 40.0),
                fraction(&|one| one.category == "mug"),
            ]
        };
        let [all_kept, strong, mugs] = fractions(LabelBalance::Overall);
        assert_eq!(all_kept, 0.5);
        assert!(strong > 0.53 && mugs > 0.53, "{strong} {mugs}");
        let [all_kept, strong, balanced_mugs] = fractions(LabelBalance::Category);
        assert_eq!([all_kept, strong], [0.5, 0.5]);
        assert!(balanced_mugs < mugs, "{balanced_mugs} {mugs}");
        let [all_kept, ..] = fractions(LabelBalance::None);
        assert!(all_kept > 0.65, "{all_kept}");
    }

    #[test]
    fn older_descriptions_name_their_balance() {
        let read = |text: &str| serde_json::from_str::<LabelBalance>(text);
        for balance in [
            LabelBalance::Overall,
            LabelBalance::Category,
            LabelBalance::None,
        ] {
            let text = serde_json::to_string(&balance).unwrap();
            assert_eq!(read(&text).unwrap(), balance);
        }
        assert_eq!(read("true").unwrap(), LabelBalance::Category);
        assert_eq!(read("false").unwrap(), LabelBalance::None);
        assert!(read("\"all\"").is_err());
        let older = r#"{"apart": "object", "parts": {"train": 0.8, "test": 0.2},
            "category_cap": 2.0, "is_balanced": true, "is_training_whole": false, "seed": 0}"#;
        let settings: CurationSettings = serde_json::from_str(older).unwrap();
        assert_eq!(settings.balance, LabelBalance::Category);
    }

    #[test]
    fn splits_are_disjoint_sized_and_balanced_at_each_force() {
        let all = labelled(1200);
        let settings = CurationSettings {
            balance: LabelBalance::Category,
            ..CurationSettings::default()
        };
        let curation = curate(&planned(&all), &all, &settings).unwrap();
        let mut split_of_object: BTreeMap<&str, &str> = BTreeMap::new();
        let mut counts: BTreeMap<(&str, bool), usize> = BTreeMap::new();
        let mut by_force: BTreeMap<(u32, bool), usize> = BTreeMap::new();
        for one in &all {
            let Some(split) = curation.split_of.get(&one.id) else {
                assert!(curation.left_out.contains_key(&one.id));
                continue;
            };
            let previous = split_of_object.insert(&one.object, split);
            assert!(
                previous.is_none_or(|previous| previous == split),
                "{}",
                one.object
            );
            *counts.entry((split, one.stable)).or_default() += 1;
            let force = one.stop_force_n as u32;
            *by_force.entry((force, one.stable)).or_default() += 1;
        }
        assert_eq!(counts.len(), 6);
        for split in ["train", "validation", "test"] {
            assert_eq!(counts[&(split, true)], counts[&(split, false)], "{split}");
        }
        for force in [10, 40] {
            assert_eq!(
                by_force[&(force, true)],
                by_force[&(force, false)],
                "{force} N"
            );
        }
        let total: usize = counts.values().sum();
        let train = 2 * counts[&("train", true)];
        let fraction = train as f64 / total as f64;
        assert!((0.72..0.88).contains(&fraction), "{fraction}");
    }

    #[test]
    fn whole_training_split_keeps_other_splits_unchanged() {
        let all = labelled(1200);
        let balanced = CurationSettings {
            category_cap: None,
            ..CurationSettings::default()
        };
        let whole = CurationSettings {
            keep_all_training: true,
            ..balanced.clone()
        };
        let [balanced, whole] =
            [balanced, whole].map(|settings| curate(&planned(&all), &all, &settings).unwrap());
        let of = |curation: &Curation, is_train: bool| -> Vec<String> {
            let splits = curation.split_of.iter();
            let of = splits.filter(|(_, split)| (*split == TRAIN) == is_train);
            of.map(|(id, _)| id.clone()).collect()
        };
        assert_eq!(of(&balanced, false), of(&whole, false));
        assert!(of(&whole, true).len() > of(&balanced, true).len() + 100);
        let left_out = whole.left_out.len() + whole.split_of.len();
        assert_eq!(left_out, all.len());
    }

    #[test]
    fn frequent_category_is_capped() {
        let all = labelled(1200);
        let settings = CurationSettings {
            balance: LabelBalance::None,
            category_cap: Some(1.2),
            ..CurationSettings::default()
        };
        let curation = curate(&planned(&all), &all, &settings).unwrap();
        let capped: Vec<&LabelledSimulation> = all
            .iter()
            .filter(|one| curation.left_out.get(&one.id) == Some(&LeftOut::CategoryCap))
            .collect();
        assert!(capped.len() > 100);
        assert!(capped.iter().all(|one| one.category == "mug"));
    }

    #[test]
    fn category_grouping_keeps_categories_together() {
        let all = labelled(600);
        let settings = CurationSettings {
            group_by: GroupKey::Category,
            splits: "train=0.6,test=0.4".parse().unwrap(),
            balance: LabelBalance::None,
            category_cap: None,
            ..CurationSettings::default()
        };
        let curation = curate(&planned(&all), &all, &settings).unwrap();
        let mut splits: BTreeMap<&str, &str> = BTreeMap::new();
        for one in &all {
            let split = &curation.split_of[&one.id];
            assert!(
                splits
                    .insert(&one.category, split)
                    .is_none_or(|previous| previous == split)
            );
        }
        assert!(splits.values().any(|p| *p == "train") && splits.values().any(|p| *p == "test"));
    }

    #[test]
    fn selection_is_deterministic_and_order_independent() {
        let mut all = labelled(300);
        let first = curate(&planned(&all), &all, &CurationSettings::default()).unwrap();
        all.reverse();
        assert_eq!(
            curate(&planned(&all), &all, &CurationSettings::default()).unwrap(),
            first
        );
        let other = CurationSettings {
            seed: 1,
            ..CurationSettings::default()
        };
        assert_ne!(curate(&planned(&all), &all, &other).unwrap(), first);
    }

    #[test]
    fn split_of_an_object_is_independent_of_labels() {
        let all = labelled(600);
        let planned = planned(&all);
        let splits = |labelled: &[LabelledSimulation]| {
            let settings = CurationSettings {
                balance: LabelBalance::None,
                category_cap: None,
                ..CurationSettings::default()
            };
            let curation = curate(&planned, labelled, &settings).unwrap();
            labelled
                .iter()
                .map(|one| (one.object.clone(), curation.split_of[&one.id].clone()))
                .collect::<BTreeMap<_, _>>()
        };
        let whole = splits(&all);
        // Most simulations of one object have no label, and none of another.
        let mut seen = BTreeMap::new();
        let fewer: Vec<LabelledSimulation> = all
            .iter()
            .filter(|one| {
                let nth = seen.entry(&one.object).or_insert(0_usize);
                *nth += 1;
                one.object != "mug-3" && (!one.object.starts_with("mug") || *nth % 3 == 0)
            })
            .cloned()
            .collect();
        assert!(fewer.len() < all.len() / 2 + all.len() / 4);
        let lesser = splits(&fewer);
        assert!(!lesser.contains_key("mug-3"));
        for (object, split) in &lesser {
            assert_eq!(split, &whole[object], "{object}");
        }
    }

    #[test]
    fn single_label_leaves_nothing() {
        let mut all = labelled(50);
        all.iter_mut().for_each(|one| one.stable = true);
        let error = curate(&planned(&all), &all, &CurationSettings::default()).unwrap_err();
        assert!(
            error.to_string().contains("50 of them are stable"),
            "{error}"
        );
    }
}
