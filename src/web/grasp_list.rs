//! Cached list of the grasps in a dataset.

use std::collections::BTreeMap;
use std::collections::btree_map::Entry;
use std::path::PathBuf;
use std::sync::Mutex;

use serde::{Deserialize, Serialize};
use utoipa::{IntoParams, ToSchema};

use crate::daemon::{lock, verdict_of};
use gripcast_base::error::{Error, Result};
use gripcast_base::files::ObjectName;
use gripcast_dataset::{Dataset, GraspId, GraspRecord, Outcome, PredictionRecord};
use gripcast_imaging::Role;
use gripcast_nn::predict::PredictedLabel;

/// Default number of grasps per page.
const DEFAULT_LIMIT: usize = 24;
/// Maximum number of grasps per page.
const MAX_LIMIT: usize = 500;

/// A grasp in a list.
#[derive(Clone, Debug, PartialEq, Serialize, ToSchema)]
pub(crate) struct GraspSummary {
    id: String,
    object: String,
    scene: String,
    operator: String,
    outcome: Outcome,
    labelled_at: Option<String>,
    captured_at: String,
    /// Prediction before the lift.
    prediction: Option<PredictionRecord>,
    /// Whether prediction and label agree; null without one of them or if the model was unsure.
    agrees: Option<bool>,
    /// Cameras with an image of the grasp.
    roles: Vec<Role>,
}

impl GraspSummary {
    fn new(record: &GraspRecord) -> Self {
        let predicted = record.prediction.as_ref().map(verdict_of);
        let agrees = match (predicted, record.outcome) {
            (Some(PredictedLabel::Stable), Outcome::Stable)
            | (Some(PredictedLabel::Slip), Outcome::Slip) => Some(true),
            (Some(PredictedLabel::Stable), Outcome::Slip)
            | (Some(PredictedLabel::Slip), Outcome::Stable) => Some(false),
            _ => None,
        };
        Self {
            id: record.id.to_string(),
            object: record.object.to_string(),
            scene: record.scene.to_string(),
            operator: record.operator.to_string(),
            outcome: record.outcome,
            labelled_at: record.labelled_at.clone(),
            captured_at: record.grasp.captured_at.clone(),
            prediction: record.prediction.clone(),
            agrees,
            roles: record.grasp.cameras.keys().copied().collect(),
        }
    }
}

/// Query of the grasp list.
#[derive(Clone, Debug, Default, Deserialize, IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub(crate) struct GraspQuery {
    /// Maximum number of grasps.
    #[param(minimum = 1, maximum = 500, default = 24)]
    limit: Option<usize>,
    /// Only grasps older than this id: `next` of the previous page.
    before: Option<String>,
    /// Only grasps of this object.
    #[param(value_type = Option<String>)]
    object: Option<ObjectName>,
    /// Only grasps with this outcome.
    outcome: Option<Outcome>,
    /// Only grasps whose label and prediction disagree (true) or agree (false).
    disagree: Option<bool>,
}

impl GraspQuery {
    fn matches(&self, grasp: &GraspSummary) -> bool {
        let Self { before, object, .. } = self;
        before.as_ref().is_none_or(|before| grasp.id < *before)
            && object
                .as_ref()
                .is_none_or(|object| *object == grasp.object.as_str())
            && self.outcome.is_none_or(|outcome| grasp.outcome == outcome)
            && self
                .disagree
                .is_none_or(|disagree| grasp.agrees == Some(!disagree))
    }
}

/// A page of the list.
#[derive(Clone, Debug, PartialEq, Serialize, ToSchema)]
pub(crate) struct GraspPage {
    /// Newest first.
    grasps: Vec<GraspSummary>,
    /// `before` of the next page; null on the last page.
    next: Option<String>,
}

/// The list; it follows all changes of the dataset on disk.
pub(crate) struct GraspList {
    path: PathBuf,
    cached: Mutex<BTreeMap<GraspId, GraspSummary>>,
}

impl GraspList {
    /// Creates the list of a dataset, which need not exist yet.
    pub(crate) fn new(path: PathBuf) -> Self {
        Self {
            path,
            cached: Mutex::new(BTreeMap::new()),
        }
    }

    /// Opens the dataset.
    ///
    /// # Errors
    /// As [`Dataset::open`].
    pub(crate) fn dataset(&self) -> Result<Dataset> {
        Dataset::open(&self.path)
    }

    /// Drops the cached summary of a changed grasp.
    pub(crate) fn forget(&self, id: &GraspId) {
        lock(&self.cached).remove(id);
    }

    /// Returns a page of the list, without unreadable grasps (see `dataset verify`).
    ///
    /// # Errors
    /// Errors of reading the dataset; `Input` for an invalid limit.
    pub(crate) fn page(&self, query: &GraspQuery) -> Result<GraspPage> {
        let dataset = self.dataset()?;
        let ids = dataset.ids()?;
        let mut cached = lock(&self.cached);
        cached.retain(|id, _| ids.binary_search(id).is_ok());
        for id in ids {
            if let Entry::Vacant(entry) = cached.entry(id)
                && let Ok(record) = dataset.grasp(entry.key())
            {
                entry.insert(GraspSummary::new(&record));
            }
        }
        let limit = query.limit.unwrap_or(DEFAULT_LIMIT);
        if !(1..=MAX_LIMIT).contains(&limit) {
            return Err(Error::input(format!(
                "expected a limit of 1 to {MAX_LIMIT}, found {limit}"
            )));
        }
        let mut grasps: Vec<GraspSummary> = cached
            .values()
            .rev()
            .filter(|grasp| query.matches(grasp))
            .take(limit + 1)
            .cloned()
            .collect();
        let next = (grasps.len() > limit).then(|| {
            grasps.truncate(limit);
            grasps.last().map(|last| last.id.clone())
        });
        Ok(GraspPage {
            grasps,
            next: next.flatten(),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use gripcast_dataset::DatasetWriter;
    use gripcast_dataset::sample::{capture, meta, new_dataset};

    fn ids(page: &GraspPage) -> Vec<&str> {
        page.grasps.iter().map(|grasp| grasp.id.as_str()).collect()
    }

    #[test]
    fn pages_follow_dataset_and_filters() {
        let dir = tempfile::tempdir().unwrap();
        let (mut writer, _) = DatasetWriter::open_or_create(dir.path(), &new_dataset()).unwrap();
        let mut saved = Vec::new();
        for (number, object) in [(1, "mug"), (3, "cup"), (5, "mug")] {
            let pending = writer.save_initial(&capture(number), Vec::new()).unwrap();
            let record = writer
                .save_grasp(&pending, &capture(number + 1), meta(object))
                .unwrap();
            saved.push(record.id);
        }
        saved.sort();
        let list = GraspList::new(dir.path().to_owned());
        let page = |query: GraspQuery| list.page(&query).unwrap();

        let first = page(GraspQuery {
            limit: Some(2),
            ..GraspQuery::default()
        });
        assert_eq!(ids(&first), [saved[2].as_str(), saved[1].as_str()]);
        let rest = page(GraspQuery {
            before: first.next.clone(),
            ..GraspQuery::default()
        });
        assert_eq!(
            (ids(&rest), rest.next.clone()),
            (vec![saved[0].as_str()], None)
        );
        let mugs = page(GraspQuery {
            object: Some(" mug".parse().unwrap()),
            ..GraspQuery::default()
        });
        assert_eq!(mugs.grasps.len(), 2);

        let at = "2026-11-20T11:00:00Z".parse().unwrap();
        writer.set_outcome(&saved[0], Outcome::Slip, at).unwrap();
        list.forget(&saved[0]);
        writer.trash_grasp(&saved[1]).unwrap();
        let slips = page(GraspQuery {
            outcome: Some(Outcome::Slip),
            ..GraspQuery::default()
        });
        assert_eq!(ids(&slips), [saved[0].as_str()]);
        assert_eq!(page(GraspQuery::default()).grasps.len(), 2);
        let disagreeing = page(GraspQuery {
            disagree: Some(true),
            ..GraspQuery::default()
        });
        let prediction = slips.grasps[0].prediction.as_ref();
        let expected = usize::from(prediction.is_some_and(|p| p.p_stable >= 0.5));
        assert_eq!(disagreeing.grasps.len(), expected);
    }
}
