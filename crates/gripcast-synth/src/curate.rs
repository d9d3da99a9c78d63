//! Which simulations become the dataset, and in which part of it.
//!
//! Objects (or whole categories) are dealt to the parts first, so that no part sees another's: by
//! what is planned of them, so that two engines' datasets of the same grasps have the same objects
//! in each part, whatever their labels. Within each part, categories are capped and the two labels
//! balanced, as the paper does (§3.2).

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

use gripcast_base::error::{Error, Result};
use gripcast_base::random::SeedStream;
use gripcast_dataset::shard::{SplitFractions, SplitGroup};

/// What may not be in two parts.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Apart {
    /// All grasps of an object stay together.
    Object,
    /// All grasps of a category stay together: harder.
    Category,
}

/// How a dataset is chosen from results.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CurationSettings {
    /// What may not be in two parts.
    pub apart: Apart,
    /// Parts and their fractions of the simulations.
    pub parts: SplitFractions,
    /// Most simulations of a category, as a multiple of the mean; none for no cap.
    pub category_cap: Option<f64>,
    /// Whether each part gets as many stable simulations as lost ones at each force, so that the
    /// force says nothing about the label.
    pub is_balanced: bool,
    /// Whether the part `train` keeps all of both labels nevertheless: training can weigh them,
    /// figures of the other parts are of balanced ones.
    #[serde(default)]
    pub is_training_whole: bool,
    /// Decides what is left out.
    pub seed: u64,
}

/// Part that [`CurationSettings::is_training_whole`] is about.
const TRAIN: &str = "train";

impl Default for CurationSettings {
    /// 80 % to train, 10 % each to validate and test, no object in two; no category with more
    /// than twice the mean.
    fn default() -> Self {
        Self {
            apart: Apart::Object,
            parts: SplitFractions::standard(),
            category_cap: Some(2.0),
            is_balanced: true,
            is_training_whole: false,
            seed: 0,
        }
    }
}

/// An object of a plan.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct PlannedObject {
    /// Its category.
    pub category: String,
    /// Its simulations, with a label or without.
    pub simulations: usize,
}

/// A simulation that could be in the dataset.
#[derive(Clone, Debug, PartialEq)]
pub struct Labelled {
    /// Its id.
    pub id: String,
    /// Its object.
    pub object: String,
    /// The object's category.
    pub category: String,
    /// Stopping force, N.
    pub stop_force_n: f64,
    /// Whether it held.
    pub stable: bool,
}

/// Why a simulation is not in the dataset.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum LeftOut {
    /// Its category has enough.
    CategoryCap,
    /// Its label has enough.
    Balance,
}

/// What becomes of the simulations.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Curation {
    /// The part of each simulation that is in the dataset, by id.
    pub part: BTreeMap<String, String>,
    /// The others.
    pub left_out: BTreeMap<String, LeftOut>,
}

/// Chooses the dataset from the labelled simulations of the `planned` objects, by their names. The
/// result does not depend on the order of the simulations.
///
/// # Errors
/// `Input` where no simulation is left.
pub fn curate(
    planned: &BTreeMap<String, PlannedObject>,
    labelled: &[Labelled],
    settings: &CurationSettings,
) -> Result<Curation> {
    let mut groups: BTreeMap<String, SplitGroup> = BTreeMap::new();
    for (name, object) in planned {
        let (group, stratum) = match settings.apart {
            Apart::Object => (name.clone(), object.category.clone()),
            Apart::Category => (object.category.clone(), String::new()),
        };
        let new = SplitGroup { stratum, size: 0 };
        groups.entry(group).or_insert(new).size += object.simulations;
    }
    let dealt = settings.parts.assign(&groups, settings.seed);
    let mut by_part: BTreeMap<&String, Vec<&Labelled>> = BTreeMap::new();
    for one in labelled {
        let group = match settings.apart {
            Apart::Object => &one.object,
            Apart::Category => &one.category,
        };
        if let Some(part) = dealt.get(group) {
            by_part.entry(part).or_default().push(one);
        }
    }
    let mut curation = Curation::default();
    for (part, mut all) in by_part {
        // By chance, but the same for any order and for any other simulations beside them.
        all.sort_by_key(|one| (chance(settings.seed, &one.id), &one.id));
        cap(&mut all, settings.category_cap, &mut curation.left_out);
        if settings.is_balanced && !(settings.is_training_whole && part == TRAIN) {
            let mut forces: Vec<f64> = all.iter().map(|one| one.stop_force_n).collect();
            forces.sort_by(f64::total_cmp);
            forces.dedup();
            for force_n in forces {
                let at_force = |one: &&&Labelled| one.stop_force_n == force_n;
                let of_force = all.iter().filter(at_force).copied().collect();
                balance(of_force, &mut curation.left_out);
            }
            all.retain(|one| !curation.left_out.contains_key(&one.id));
        }
        let kept = all.iter().map(|one| (one.id.clone(), part.clone()));
        curation.part.extend(kept);
    }
    if curation.part.is_empty() {
        return Err(Error::input(format!(
            "no simulation is left of {}: {} of them held",
            labelled.len(),
            labelled.iter().filter(|one| one.stable).count()
        ))
        .remedy("simulate more grasps, or merge with --unbalanced"));
    }
    Ok(curation)
}

fn chance(seed: u64, id: &str) -> u64 {
    SeedStream::named(seed, &format!("curation {id}")).bits()
}

/// Leaves out what a category has beyond `most` times the mean over categories.
fn cap(all: &mut Vec<&Labelled>, most: Option<f64>, left_out: &mut BTreeMap<String, LeftOut>) {
    let Some(most) = most else { return };
    let mut counts: BTreeMap<&String, usize> = BTreeMap::new();
    for one in all.iter() {
        *counts.entry(&one.category).or_default() += 1;
    }
    let mean = all.len() as f64 / counts.len().max(1) as f64;
    let most = (most * mean).ceil() as usize;
    let mut taken: BTreeMap<&String, usize> = BTreeMap::new();
    all.retain(|one| {
        let taken = taken.entry(&one.category).or_default();
        *taken += 1;
        if *taken > most {
            left_out.insert(one.id.clone(), LeftOut::CategoryCap);
        }
        *taken <= most
    });
}

/// Leaves out what one label has more, first where that label is most frequent in its category.
fn balance(all: Vec<&Labelled>, left_out: &mut BTreeMap<String, LeftOut>) {
    let stable = all.iter().filter(|one| one.stable).count();
    let frequent = 2 * stable > all.len();
    // By category: how many more of the frequent label there are, and these.
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
        let most = categories
            .values_mut()
            .filter(|(_, members)| !members.is_empty())
            .rev()
            .max_by_key(|(excess, _)| *excess);
        let Some((excess, members)) = most else { break };
        *excess -= 1;
        if let Some(id) = members.pop() {
            left_out.insert(id.clone(), LeftOut::Balance);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn labelled(count: usize) -> Vec<Labelled> {
        let mut draw = SeedStream::named(1, "test");
        (0..count)
            .map(|number| {
                // Mugs are four times as frequent, and held more often.
                let category = draw.pick(["mug", "mug", "mug", "mug", "box", "ring", "tool"]);
                let held = if category == "mug" { 0.8 } else { 0.5 };
                Labelled {
                    id: format!("s{number:04}"),
                    object: format!("{category}-{}", draw.index(12)),
                    category: category.to_owned(),
                    stop_force_n: if number % 3 == 0 { 10.0 } else { 40.0 },
                    stable: draw.uniform() < held,
                }
            })
            .collect()
    }

    fn planned(all: &[Labelled]) -> BTreeMap<String, PlannedObject> {
        let mut planned = BTreeMap::new();
        for one in all {
            let new = PlannedObject {
                category: one.category.clone(),
                simulations: 0,
            };
            let object = planned.entry(one.object.clone()).or_insert(new);
            object.simulations += 1;
        }
        planned
    }

    #[test]
    fn parts_share_no_object_have_their_size_and_as_many_of_both_labels() {
        let all = labelled(1200);
        let curation = curate(&planned(&all), &all, &CurationSettings::default()).unwrap();
        let mut part_of_object: BTreeMap<&str, &str> = BTreeMap::new();
        let mut counts: BTreeMap<(&str, bool), usize> = BTreeMap::new();
        let mut by_force: BTreeMap<(u32, bool), usize> = BTreeMap::new();
        for one in &all {
            let Some(part) = curation.part.get(&one.id) else {
                assert!(curation.left_out.contains_key(&one.id));
                continue;
            };
            let known = part_of_object.insert(&one.object, part);
            assert!(known.is_none_or(|known| known == part), "{}", one.object);
            *counts.entry((part, one.stable)).or_default() += 1;
            let force = one.stop_force_n as u32;
            *by_force.entry((force, one.stable)).or_default() += 1;
        }
        assert_eq!(counts.len(), 6);
        for part in ["train", "validation", "test"] {
            assert_eq!(counts[&(part, true)], counts[&(part, false)], "{part}");
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
    fn training_keeps_all_where_that_is_wanted_and_the_other_parts_stay_as_they_are() {
        let all = labelled(1200);
        let balanced = CurationSettings {
            category_cap: None,
            ..CurationSettings::default()
        };
        let whole = CurationSettings {
            is_training_whole: true,
            ..balanced.clone()
        };
        let [balanced, whole] =
            [balanced, whole].map(|settings| curate(&planned(&all), &all, &settings).unwrap());
        let of = |curation: &Curation, is_train: bool| -> Vec<String> {
            let parts = curation.part.iter();
            let of = parts.filter(|(_, part)| (*part == TRAIN) == is_train);
            of.map(|(id, _)| id.clone()).collect()
        };
        assert_eq!(of(&balanced, false), of(&whole, false));
        assert!(of(&whole, true).len() > of(&balanced, true).len() + 100);
        let left_out = whole.left_out.len() + whole.part.len();
        assert_eq!(left_out, all.len());
    }

    #[test]
    fn a_frequent_category_is_capped() {
        let all = labelled(1200);
        let settings = CurationSettings {
            is_balanced: false,
            category_cap: Some(1.2),
            ..CurationSettings::default()
        };
        let curation = curate(&planned(&all), &all, &settings).unwrap();
        let capped: Vec<&Labelled> = all
            .iter()
            .filter(|one| curation.left_out.get(&one.id) == Some(&LeftOut::CategoryCap))
            .collect();
        assert!(capped.len() > 100);
        assert!(capped.iter().all(|one| one.category == "mug"));
    }

    #[test]
    fn whole_categories_stay_together_where_that_is_wanted() {
        let all = labelled(600);
        let settings = CurationSettings {
            apart: Apart::Category,
            parts: "train=0.6,test=0.4".parse().unwrap(),
            is_balanced: false,
            category_cap: None,
            ..CurationSettings::default()
        };
        let curation = curate(&planned(&all), &all, &settings).unwrap();
        let mut parts: BTreeMap<&str, &str> = BTreeMap::new();
        for one in &all {
            let part = &curation.part[&one.id];
            assert!(
                parts
                    .insert(&one.category, part)
                    .is_none_or(|known| known == part)
            );
        }
        assert!(parts.values().any(|p| *p == "train") && parts.values().any(|p| *p == "test"));
    }

    #[test]
    fn neither_order_nor_repetition_changes_the_choice() {
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
    fn labels_do_not_decide_the_part_of_an_object() {
        let all = labelled(600);
        let planned = planned(&all);
        let parts = |labelled: &[Labelled]| {
            let settings = CurationSettings {
                is_balanced: false,
                category_cap: None,
                ..CurationSettings::default()
            };
            let curation = curate(&planned, labelled, &settings).unwrap();
            labelled
                .iter()
                .map(|one| (one.object.clone(), curation.part[&one.id].clone()))
                .collect::<BTreeMap<_, _>>()
        };
        let whole = parts(&all);
        // Most of one object's have no label, and none of another's.
        let mut seen = BTreeMap::new();
        let fewer: Vec<Labelled> = all
            .iter()
            .filter(|one| {
                let nth = seen.entry(&one.object).or_insert(0_usize);
                *nth += 1;
                one.object != "mug-3" && (!one.object.starts_with("mug") || *nth % 3 == 0)
            })
            .cloned()
            .collect();
        assert!(fewer.len() < all.len() / 2 + all.len() / 4);
        let lesser = parts(&fewer);
        assert!(!lesser.contains_key("mug-3"));
        for (object, part) in &lesser {
            assert_eq!(part, &whole[object], "{object}");
        }
    }

    #[test]
    fn one_label_alone_leaves_nothing() {
        let mut all = labelled(50);
        all.iter_mut().for_each(|one| one.stable = true);
        let error = curate(&planned(&all), &all, &CurationSettings::default()).unwrap_err();
        assert!(error.to_string().contains("50 of them held"), "{error}");
    }
}
