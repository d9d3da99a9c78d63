//! Which grasps are exported, and what they have.

use std::collections::{BTreeMap, BTreeSet};

use super::plan::{ExportFormat, ExportPlan};
use crate::left_out::LeftOut;
use gripcast_base::error::{Error, Result, unknown_name};
use gripcast_dataset::{Dataset, GraspId, GraspRecord, Outcome, SplitFile, Stage};
use gripcast_imaging::Role;

/// The grasps of an export.
#[derive(Debug, Default)]
pub(super) struct Choice {
    /// Parts with their grasps, sorted; none is empty.
    pub(super) parts: Vec<(String, Vec<GraspId>)>,
    pub(super) survey: Survey,
    pub(super) unlabelled: usize,
    pub(super) not_in_split: usize,
    pub(super) left_out: Vec<LeftOut>,
}

/// What the records of the chosen grasps say, before their images are read.
#[derive(Debug, Default)]
pub(super) struct Survey {
    pub(super) grasps: usize,
    pub(super) cameras: BTreeMap<(Stage, Role), Seen>,
    /// Tactile images of the grasp by their crop profile.
    pub(super) crops: BTreeMap<String, usize>,
    pub(super) has_pose: bool,
    pub(super) has_prediction: bool,
    /// Longest id, in characters.
    pub(super) longest_id: usize,
    /// Longest object, in characters.
    pub(super) longest_object: usize,
}

/// Frames of one role at one stage.
#[derive(Debug, Default)]
pub(super) struct Seen {
    /// Grasps that have one.
    pub(super) grasps: usize,
    /// Widths and heights in pixels.
    pub(super) sizes: BTreeSet<(u32, u32)>,
}

impl Survey {
    fn add(&mut self, record: &GraspRecord) {
        self.grasps += 1;
        self.has_pose |= record.pose.is_some();
        self.has_prediction |= record.prediction.is_some();
        self.longest_id = self.longest_id.max(record.id.chars().count());
        self.longest_object = self.longest_object.max(record.object.chars().count());
        let crops = record.grasp.cameras.values();
        for crop in crops.filter_map(|camera| camera.crop_profile.as_ref()) {
            *self.crops.entry(crop.clone()).or_default() += 1;
        }
        for (stage, frames) in record.stages() {
            for (role, camera) in &frames.cameras {
                let seen = self.cameras.entry((stage, *role)).or_default();
                seen.grasps += 1;
                seen.sizes.insert((camera.width, camera.height));
            }
        }
    }

    /// Name of the crop profile that most tactile images have.
    pub(super) fn usual_crop(&self) -> Option<&str> {
        let most = self.crops.iter().max_by_key(|(_, count)| **count);
        most.map(|(name, _)| name.as_str())
    }
}

impl Choice {
    pub(super) fn grasps(&self) -> usize {
        self.parts.iter().map(|(_, ids)| ids.len()).sum()
    }
}

/// Reads all records and chooses.
///
/// # Errors
/// `Usage`: there is no such split or part. `Input`: nothing is left to export. When the dataset
/// cannot be read.
pub(super) fn choose(dataset: &Dataset, plan: &ExportPlan) -> Result<Choice> {
    let all = dataset.ids()?;
    let mut choice = Choice::default();
    let parts = match split_of(dataset, plan)? {
        None => vec![(plan.format.whole().to_owned(), all.clone())],
        Some(split) => {
            let named: BTreeSet<&GraspId> = split.grasps().collect();
            choice.not_in_split = all.iter().filter(|id| !named.contains(id)).count();
            parts_of(split, plan)?
        }
    };
    for (name, ids) in parts {
        let mut chosen = Vec::with_capacity(ids.len());
        for id in ids {
            match dataset.grasp_with_json(&id) {
                Ok((record, _)) if plan.wants_labels() && record.outcome == Outcome::Unlabelled => {
                    choice.unlabelled += 1;
                }
                Ok((record, _)) => {
                    choice.survey.add(&record);
                    chosen.push(id);
                }
                Err(error) => choice.left_out.push(LeftOut {
                    id: id.into(),
                    why: error.to_string(),
                }),
            }
        }
        if !chosen.is_empty() {
            choice.parts.push((name, chosen));
        }
    }
    if choice.parts.is_empty() {
        return Err(nothing_left(&choice, all.len(), plan));
    }
    Ok(choice)
}

/// The split that the plan asks for.
fn split_of(dataset: &Dataset, plan: &ExportPlan) -> Result<Option<SplitFile>> {
    if let Some(name) = &plan.split {
        let known = dataset.split_names()?;
        if !known.contains(name) {
            let known: Vec<&str> = known.iter().map(String::as_str).collect();
            return Err(unknown_split(name, &known));
        }
        return dataset.split(name).map(Some);
    }
    if plan.part.is_none() {
        return Ok(None);
    }
    let names = dataset.split_names()?;
    match names.as_slice() {
        [only] => dataset.split(only).map(Some),
        [] => Err(
            Error::usage("a part was asked for, but the dataset has no split")
                .remedy("make one with `gripcast dataset split`, or leave `--subset` out"),
        ),
        _ => Err(
            Error::usage("a part was asked for, but the dataset has several splits")
                .remedy(format!("name one with `--split`: {}", names.join(", "))),
        ),
    }
}

fn unknown_split(name: &str, known: &[&str]) -> Error {
    if known.is_empty() {
        let what = format!("there is no split named {name:?}: the dataset has none");
        return Error::usage(what).remedy("make one with `gripcast dataset split`");
    }
    unknown_name("split", name, known)
}

/// Parts of the split that the plan asks for, with their grasps.
fn parts_of(split: SplitFile, plan: &ExportPlan) -> Result<Vec<(String, Vec<GraspId>)>> {
    if let Some(wanted) = &plan.part
        && !split.parts.contains_key(wanted)
    {
        let known: Vec<&str> = split.parts.keys().map(String::as_str).collect();
        return Err(unknown_name("part", wanted, &known));
    }
    let is_renamed =
        plan.format == ExportFormat::Training && !split.parts.contains_key("validation");
    let wanted = |name: &String| plan.part.as_ref().is_none_or(|part| part == name);
    let parts = split.parts.into_iter().filter(|(name, _)| wanted(name));
    let checked = parts.map(|(name, part)| {
        // Parts become file names.
        let is_word = |c: char| c.is_ascii_alphanumeric() || c == '_';
        if name.is_empty() || !name.chars().all(is_word) {
            let what = format!("the part {name:?} of the split cannot be a file name");
            return Err(
                Error::input(what).remedy("call it by letters, digits and _ in splits/*.json")
            );
        }
        // `dataset split` says `val`, `train` wants `validation`.
        let name = match &*name {
            "val" if is_renamed => "validation".to_owned(),
            _ => name,
        };
        Ok((name, part.grasps.into_iter().collect()))
    });
    checked.collect()
}

fn nothing_left(choice: &Choice, all: usize, plan: &ExportPlan) -> Error {
    let (what, remedy) = if all == 0 {
        (
            "the dataset has no grasps, there is nothing to export".to_owned(),
            "collect some with `gripcast collect`",
        )
    } else if choice.unlabelled > 0 {
        let what = format!(
            "none of the {} grasps has a label, there is nothing to export",
            choice.unlabelled
        );
        let remedy = if plan.only_labelled {
            "label some, or leave out `--only-labelled`"
        } else {
            "label some: this format says of every grasp whether it held"
        };
        (what, remedy)
    } else if choice.left_out.is_empty() {
        (
            "the part has no grasps, there is nothing to export".to_owned(),
            "choose another part or split",
        )
    } else {
        (
            format!(
                "none of the {} grasps can be read, the first because of {}",
                choice.left_out.len(),
                choice.left_out[0].why
            ),
            "run `gripcast dataset verify` and `recover`",
        )
    };
    Error::input(what).remedy(remedy)
}
