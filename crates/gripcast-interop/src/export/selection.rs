//! Selects the grasps of an export and surveys their records.

use std::collections::{BTreeMap, BTreeSet};

use super::fields::{FieldSurvey, LiftCounts};
use super::plan::{ExportFormat, ExportPlan};
use crate::left_out::LeftOut;
use gripcast_base::error::{Error, Result, unknown_name};
use gripcast_dataset::{Dataset, GraspId, GraspRecord, Outcome, SplitFile, Stage};
use gripcast_imaging::{PixelFormat, Role};

/// Selected grasps of an export.
#[derive(Debug, Default)]
pub(super) struct Selection {
    /// Splits with their sorted grasps; none is empty.
    pub(super) splits: Vec<(String, Vec<GraspId>)>,
    pub(super) survey: Survey,
    pub(super) unlabelled: usize,
    pub(super) not_in_split: usize,
    pub(super) left_out: Vec<LeftOut>,
}

/// Survey of the records of the selected grasps.
#[derive(Debug, Default)]
pub(super) struct Survey {
    pub(super) grasps: usize,
    pub(super) cameras: BTreeMap<(Stage, Role), CameraCounts>,
    /// Field arrays of the gels.
    pub(super) fields: FieldSurvey,
    /// Lift frames by gel.
    pub(super) lifts: BTreeMap<Role, LiftCounts>,
    /// Number of tactile grasp images by crop profile.
    pub(super) crops: BTreeMap<String, usize>,
    pub(super) has_pose: bool,
    pub(super) has_prediction: bool,
    pub(super) has_force: bool,
    /// Whether the gripper's opening is known for any grasp.
    pub(super) has_opening: bool,
    /// Maximum length of an id, characters.
    pub(super) longest_id: usize,
    /// Maximum length of an object name, characters.
    pub(super) longest_object: usize,
}

/// Counts of one camera at one stage.
#[derive(Debug, Default)]
pub(super) struct CameraCounts {
    /// Number of grasps with an image.
    pub(super) grasps: usize,
    /// Number of those that are JPEG; the others are PNG.
    pub(super) jpegs: usize,
    /// Widths and heights, pixels.
    pub(super) sizes: BTreeSet<(u32, u32)>,
}

impl Survey {
    fn add(&mut self, record: &GraspRecord) {
        self.grasps += 1;
        self.fields.add(record);
        LiftCounts::survey(&mut self.lifts, record);
        self.has_pose |= record.pose.is_some();
        self.has_prediction |= record.prediction.is_some();
        self.has_force |= !record.grasp.force.is_empty();
        self.has_opening |= opening_m(record).is_some();
        self.longest_id = self.longest_id.max(record.id.chars().count());
        self.longest_object = self.longest_object.max(record.object.chars().count());
        let crops = record.grasp.cameras.values();
        for crop in crops.filter_map(|camera| camera.crop_profile.as_ref()) {
            *self.crops.entry(crop.clone()).or_default() += 1;
        }
        for (stage, frames) in record.stages() {
            for (role, camera) in &frames.cameras {
                let counts = self.cameras.entry((stage, *role)).or_default();
                counts.grasps += 1;
                counts.jpegs += usize::from(camera.format == PixelFormat::Mjpg);
                counts.sizes.insert((camera.width, camera.height));
            }
        }
    }

    /// Most common crop profile of the tactile images.
    pub(super) fn most_common_crop(&self) -> Option<&str> {
        let common = self.crops.iter().max_by_key(|(_, count)| **count);
        common.map(|(name, _)| name.as_str())
    }
}

/// Distance between the undeformed gel faces at the grasp, m: that of the simulator, or measured on
/// the gripper's tags.
pub(super) fn opening_m(record: &GraspRecord) -> Option<f64> {
    let annotated = record.pose.as_ref();
    let simulated = record.truth.as_ref().map(|truth| truth.opening_m);
    simulated.or_else(|| annotated?.quality.as_ref()?.opening_m)
}

impl Selection {
    pub(super) fn grasps(&self) -> usize {
        self.splits.iter().map(|(_, ids)| ids.len()).sum()
    }
}

/// Reads all records and selects the grasps of an export.
///
/// # Errors
/// `Usage`: unknown split. `Input`: no grasps to export. Those of reading the dataset.
pub(super) fn select(dataset: &Dataset, plan: &ExportPlan) -> Result<Selection> {
    let all = dataset.ids()?;
    let mut selection = Selection::default();
    let splits = match split_file(dataset, plan)? {
        None => vec![(plan.format.default_split().to_owned(), all.clone())],
        Some(file) => {
            let named: BTreeSet<&GraspId> = file.grasps().collect();
            selection.not_in_split = all.iter().filter(|id| !named.contains(id)).count();
            selected_splits(file, plan)?
        }
    };
    for (name, ids) in splits {
        let mut chosen = Vec::with_capacity(ids.len());
        for id in ids {
            match dataset.grasp_with_json(&id) {
                Ok((record, _))
                    if plan.requires_labels() && record.outcome == Outcome::Unlabelled =>
                {
                    selection.unlabelled += 1;
                }
                Ok((record, _)) => {
                    selection.survey.add(&record);
                    chosen.push(id);
                }
                Err(error) => selection.left_out.push(LeftOut {
                    id: id.into(),
                    reason: error.to_string(),
                }),
            }
        }
        if !chosen.is_empty() {
            selection.splits.push((name, chosen));
        }
    }
    if selection.splits.is_empty() {
        return Err(nothing_left(&selection, all.len(), plan));
    }
    Ok(selection)
}

/// Reads the split file of the plan, if any.
fn split_file(dataset: &Dataset, plan: &ExportPlan) -> Result<Option<SplitFile>> {
    if let Some(name) = &plan.split_file {
        let known = dataset.split_names()?;
        if !known.contains(name) {
            let known: Vec<&str> = known.iter().map(String::as_str).collect();
            return Err(unknown_split(name, &known));
        }
        return dataset.split(name).map(Some);
    }
    if plan.only_split.is_none() {
        return Ok(None);
    }
    let names = dataset.split_names()?;
    match names.as_slice() {
        [only] => dataset.split(only).map(Some),
        [] => Err(Error::usage("the dataset has no split file for `--subset`")
            .remedy("create one with `gripcast dataset split`, or omit `--subset`")),
        _ => Err(Error::usage("the dataset has several split files")
            .remedy(format!("choose one with `--split`: {}", names.join(", ")))),
    }
}

fn unknown_split(name: &str, known: &[&str]) -> Error {
    if known.is_empty() {
        let what = format!("unknown split file {name:?}: the dataset has none");
        return Error::usage(what).remedy("create one with `gripcast dataset split`");
    }
    unknown_name("split file", name, known)
}

/// Selected splits of a split file, with their grasps.
fn selected_splits(file: SplitFile, plan: &ExportPlan) -> Result<Vec<(String, Vec<GraspId>)>> {
    if let Some(wanted) = &plan.only_split
        && !file.splits.contains_key(wanted)
    {
        let known: Vec<&str> = file.splits.keys().map(String::as_str).collect();
        return Err(unknown_name("split", wanted, &known));
    }
    let is_renamed =
        plan.format == ExportFormat::Training && !file.splits.contains_key("validation");
    let wanted = |name: &String| plan.only_split.as_ref().is_none_or(|split| split == name);
    let splits = file.splits.into_iter().filter(|(name, _)| wanted(name));
    let checked = splits.map(|(name, members)| {
        // Names of splits become file names.
        let is_word = |c: char| c.is_ascii_alphanumeric() || c == '_';
        if name.is_empty() || !name.chars().all(is_word) {
            let what = format!("the split name {name:?} is not a valid file name");
            return Err(Error::input(what).remedy("use letters, digits and _ in splits/*.json"));
        }
        // `dataset split` uses `val`, `train` uses `validation`.
        let name = match &*name {
            "val" if is_renamed => "validation".to_owned(),
            _ => name,
        };
        Ok((name, members.grasps.into_iter().collect()))
    });
    checked.collect()
}

fn nothing_left(selection: &Selection, all: usize, plan: &ExportPlan) -> Error {
    let (what, remedy) = if all == 0 {
        (
            "nothing to export: the dataset has no grasps".to_owned(),
            "collect some with `gripcast collect`",
        )
    } else if selection.unlabelled > 0 {
        let what = format!(
            "nothing to export: none of the {} grasps is labelled",
            selection.unlabelled
        );
        let remedy = if plan.only_labelled {
            "label some, or omit `--only-labelled`"
        } else {
            "label some: this format requires labels"
        };
        (what, remedy)
    } else if selection.left_out.is_empty() {
        (
            "nothing to export: the split has no grasps".to_owned(),
            "choose another split",
        )
    } else {
        (
            format!(
                "cannot read any of the {} grasps, the first because of {}",
                selection.left_out.len(),
                selection.left_out[0].reason
            ),
            "run `gripcast dataset verify` and `recover`",
        )
    };
    Error::input(what).remedy(remedy)
}
