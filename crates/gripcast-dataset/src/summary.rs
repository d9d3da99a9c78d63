//! Summary of a dataset.

use std::collections::{BTreeMap, BTreeSet};

use jiff::Timestamp;
use serde::Serialize;

use super::grasp::Outcome;
use super::reader::{Dataset, entries};
use gripcast_base::error::Result;
use gripcast_base::files::{BeneathPath, FieldName, Label, ObjectName};

/// Summary of a dataset.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct Summary {
    /// Name of the dataset.
    pub name: String,
    /// Version of the dataset format.
    pub schema: u32,
    /// Rigs that collected it.
    pub rigs: BTreeSet<String>,
    /// Licence of the data.
    pub licence: String,
    /// What `stable` and `slip` mean.
    pub label_definition: String,
    /// Complete grasps with a readable record.
    pub grasps: usize,
    /// Grasps with an unreadable record.
    pub unreadable: usize,
    /// Grasps by outcome.
    pub outcomes: BTreeMap<Outcome, usize>,
    /// Grasps by object and outcome.
    pub objects: BTreeMap<ObjectName, BTreeMap<Outcome, usize>>,
    /// Grasps by scene.
    pub scenes: BTreeMap<Label, usize>,
    /// Grasps by operator.
    pub operators: BTreeMap<Label, usize>,
    /// Fraction of stable grasps among the labelled ones.
    pub stable_fraction: Option<f64>,
    /// Time of the first grasp, RFC 3339 UTC.
    pub first_captured_at: Option<String>,
    /// Time of the last grasp, RFC 3339 UTC.
    pub last_captured_at: Option<String>,
    /// Grasps with a field array, by its name.
    pub fields: BTreeMap<FieldName, usize>,
    /// Grasps with lift frames.
    pub lifts: usize,
    /// Size of all complete grasps, bytes.
    pub bytes: u64,
    /// Size of `trash/`, bytes.
    pub trash_bytes: u64,
    /// Agreement of predictions and labels, by model.
    pub predictions: BTreeMap<String, Agreement>,
}

/// Confusion matrix of the predictions before the lift and the labels after it.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize)]
pub struct Agreement {
    /// Predicted stable, labelled stable.
    pub true_stable: usize,
    /// Predicted slip, labelled slip.
    pub true_slip: usize,
    /// Predicted stable, labelled slip.
    pub false_stable: usize,
    /// Predicted slip, labelled stable.
    pub false_slip: usize,
}

impl Agreement {
    /// Grasps with a prediction and a label.
    #[must_use]
    pub fn total(&self) -> usize {
        self.agreed() + self.false_stable + self.false_slip
    }

    /// Grasps whose prediction and label agree.
    #[must_use]
    pub fn agreed(&self) -> usize {
        self.true_stable + self.true_slip
    }
}

/// Summarises a dataset; reads all records but no image.
///
/// # Errors
/// `Io`, … when `grasps/` cannot be read.
pub fn summary(dataset: &Dataset) -> Result<Summary> {
    let descriptor = dataset.descriptor();
    let layout = dataset.layout();
    let mut summary = Summary {
        name: descriptor.name.clone(),
        schema: descriptor.schema,
        licence: descriptor.licence.clone(),
        label_definition: descriptor.label_definition.clone(),
        trash_bytes: directory_bytes(&layout.trash()),
        ..Summary::default()
    };
    let mut times = Vec::new();
    for id in dataset.ids()? {
        summary.bytes += directory_bytes(&layout.grasp(&id));
        let Ok(record) = dataset.grasp(&id) else {
            summary.unreadable += 1;
            continue;
        };
        summary.grasps += 1;
        summary.lifts += usize::from(record.lift.is_some());
        let stages = record.stages().into_iter();
        let fields = stages.flat_map(|(_, stage)| stage.fields.values().flat_map(BTreeMap::keys));
        for name in fields.collect::<BTreeSet<_>>() {
            *summary.fields.entry(name.clone()).or_default() += 1;
        }
        *summary.outcomes.entry(record.outcome).or_default() += 1;
        let outcomes = summary.objects.entry(record.object).or_default();
        *outcomes.entry(record.outcome).or_default() += 1;
        *summary.scenes.entry(record.scene).or_default() += 1;
        *summary.operators.entry(record.operator).or_default() += 1;
        summary.rigs.insert(record.rig);
        times.extend(record.grasp.captured_at.parse::<Timestamp>().ok());
        if let Some(prediction) = record.prediction {
            let agreement = summary.predictions.entry(prediction.model).or_default();
            let predicted_stable = prediction.p_stable >= prediction.threshold;
            match (predicted_stable, record.outcome) {
                (true, Outcome::Stable) => agreement.true_stable += 1,
                (false, Outcome::Slip) => agreement.true_slip += 1,
                (true, Outcome::Slip) => agreement.false_stable += 1,
                (false, Outcome::Stable) => agreement.false_slip += 1,
                (_, Outcome::Unlabelled) => {}
            }
        }
    }
    summary.first_captured_at = times.iter().min().map(Timestamp::to_string);
    summary.last_captured_at = times.iter().max().map(Timestamp::to_string);
    let count = |outcome| summary.outcomes.get(&outcome).copied().unwrap_or(0);
    let (stable, slip) = (count(Outcome::Stable), count(Outcome::Slip));
    summary.stable_fraction = (stable + slip > 0).then(|| stable as f64 / (stable + slip) as f64);
    Ok(summary)
}

/// Size of the files below a directory; unreadable ones count as 0.
fn directory_bytes(path: &BeneathPath) -> u64 {
    let entries = entries(path).into_iter().flatten();
    // Links could form a cycle.
    entries
        .filter(|entry| !entry.is_link())
        .map(|entry| match entry.metadata() {
            Ok(found) if found.is_dir => directory_bytes(&entry),
            found => found.map_or(0, |file| file.bytes),
        })
        .sum()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::DatasetWriter;
    use crate::sample::{capture, meta, new_dataset};

    #[test]
    fn predictions_are_compared_with_labels() {
        let dir = tempfile::tempdir().unwrap();
        let (mut writer, _) = DatasetWriter::open_or_create(dir.path(), &new_dataset()).unwrap();
        let outcomes = [Outcome::Stable, Outcome::Slip, Outcome::Unlabelled];
        for (number, outcome) in (0..).zip(outcomes) {
            let pending = writer
                .save_initial(&capture(2 * number + 1), Vec::new())
                .unwrap();
            let id = writer
                .save_grasp(&pending, &capture(2 * number + 2), meta("mug"))
                .unwrap()
                .id;
            let at = "2026-11-20T11:00:00Z".parse().unwrap();
            writer.set_outcome(&id, outcome, at, None).unwrap();
        }
        drop(writer);
        let summary = summary(&Dataset::open(dir.path()).unwrap()).unwrap();
        assert_eq!(summary.grasps, 3);
        assert_eq!(summary.stable_fraction, Some(0.5));
        assert_eq!(
            summary.predictions["baseline"],
            Agreement {
                true_stable: 1,
                false_stable: 1,
                ..Agreement::default()
            }
        );
        assert_eq!(
            summary.first_captured_at.as_deref(),
            Some("2026-11-20T10:15:02Z")
        );
        assert!(summary.bytes > 1000);
    }
}
