//! Curation: which simulations become the dataset, and in which split.
//!
//! Objects (or whole categories) are assigned to splits first, so that no split contains another's
//! objects. The assignment depends on the plan alone: datasets of the same grasps from two engines
//! have the same objects in each split, whatever the labels. Within each split, categories are
//! capped and the two labels balanced, as in the paper (§3.2).

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
    /// Whether each split gets as many stable simulations as slips at each force, so that the force
    /// does not predict the label.
    pub is_balanced: bool,
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
    /// simulations per category.
    fn default() -> Self {
        Self {
            group_by: GroupKey::Object,
            splits: SplitFractions::standard(),
            category_cap: Some(2.0),
            is_balanced: true,
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
        if settings.is_balanced && !(settings.keep_all_training && split == TRAIN) {
            let mut forces: Vec<f64> = all.iter().map(|one| one.stop_force_n).collect();
            forces.sort_by(f64::total_cmp);
            forces.dedup();
            for force_n in forces {
                let at_force = |one: &&&LabelledSimulation| one.stop_force_n == force_n;
                let group = all.iter().filter(at_force).copied().collect();
                balance(group, &mut curation.left_out);
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
        .remedy("simulate more grasps, or merge with --unbalanced"));
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

/// Drops the surplus of the more frequent label, first from the category with the largest surplus.
fn balance(all: Vec<&LabelledSimulation>, left_out: &mut BTreeMap<String, LeftOut>) {
    let stable = all.iter().filter(|one| one.stable).count();
    let frequent = 2 * stable > all.len();
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
    for _ in 0..(2 * stable).abs_diff(all.len()) {
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
    fn splits_are_disjoint_sized_and_balanced() {
        let all = labelled(1200);
        let curation = curate(&planned(&all), &all, &CurationSettings::default()).unwrap();
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
            is_balanced: false,
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
            is_balanced: false,
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
                is_balanced: false,
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
