//! The grasps of a dataset as a list that is kept: a page of it costs no reading of what is known.

use std::collections::BTreeMap;
use std::collections::btree_map::Entry;
use std::path::PathBuf;
use std::sync::{Mutex, MutexGuard, PoisonError};

use serde::{Deserialize, Serialize};
use utoipa::{IntoParams, ToSchema};

use crate::daemon::verdict_of;
use gripcast_base::error::{Error, Result};
use gripcast_dataset::{Dataset, GraspId, GraspRecord, Outcome, PredictionRecord};
use gripcast_imaging::Role;
use gripcast_nn::predict::PredictedLabel;

/// Grasps in an answer where no number is asked for.
const USUAL_LIMIT: usize = 24;
/// Most of them.
const MAX: usize = 500;

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
    /// What was predicted before the lift.
    prediction: Option<PredictionRecord>,
    /// Whether the prediction says what the label says; null without one of them, or where the
    /// model was not sure.
    agrees: Option<bool>,
    /// Cameras that saw it.
    roles: Vec<Role>,
}

impl GraspSummary {
    fn of(record: &GraspRecord) -> Self {
        let claimed = record.prediction.as_ref().map(verdict_of);
        let agrees = match (claimed, record.outcome) {
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

/// Which grasps are asked for.
#[derive(Clone, Debug, Default, Deserialize, IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub(crate) struct Wanted {
    /// How many at most.
    #[param(minimum = 1, maximum = 500, default = 24)]
    limit: Option<usize>,
    /// Only those older than this id: `next` of the page before.
    before: Option<String>,
    /// Only those of this object.
    object: Option<String>,
    /// Only those of this outcome.
    outcome: Option<Outcome>,
    /// Only those whose label is not what was predicted (true) or is (false).
    disagree: Option<bool>,
}

impl Wanted {
    fn takes(&self, grasp: &GraspSummary) -> bool {
        let is_before = self.before.as_ref().is_none_or(|before| grasp.id < *before);
        is_before
            && self
                .object
                .as_ref()
                .is_none_or(|object| grasp.object == *object)
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
    /// Where the next page begins; null at the end.
    next: Option<String>,
}

/// The list; it follows the dataset on disk, whoever changes it.
pub(crate) struct GraspList {
    path: PathBuf,
    known: Mutex<BTreeMap<GraspId, GraspSummary>>,
}

impl GraspList {
    /// The list of a dataset, which may not be there yet.
    pub(crate) fn new(path: PathBuf) -> Self {
        Self {
            path,
            known: Mutex::new(BTreeMap::new()),
        }
    }

    /// The dataset itself.
    ///
    /// # Errors
    /// As [`Dataset::open`].
    pub(crate) fn dataset(&self) -> Result<Dataset> {
        Dataset::open(&self.path)
    }

    fn lock(&self) -> MutexGuard<'_, BTreeMap<GraspId, GraspSummary>> {
        // A panicking holder leaves plain data behind; the directory corrects it.
        self.known.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// What is known of a grasp is out of date.
    pub(crate) fn forget(&self, id: &GraspId) {
        self.lock().remove(id);
    }

    /// A page of the list. Grasps that cannot be read are left out: `dataset verify` tells them.
    ///
    /// # Errors
    /// When the dataset cannot be read; `Input` for an impossible limit.
    pub(crate) fn page(&self, wanted: &Wanted) -> Result<GraspPage> {
        let dataset = self.dataset()?;
        let ids = dataset.ids()?;
        let mut known = self.lock();
        known.retain(|id, _| ids.binary_search(id).is_ok());
        for id in ids {
            if let Entry::Vacant(place) = known.entry(id)
                && let Ok(record) = dataset.grasp(place.key())
            {
                place.insert(GraspSummary::of(&record));
            }
        }
        let limit = wanted.limit.unwrap_or(USUAL_LIMIT);
        if !(1..=MAX).contains(&limit) {
            return Err(Error::input(format!(
                "expected a limit of 1 to {MAX}, found {limit}"
            )));
        }
        let mut grasps: Vec<GraspSummary> = known
            .values()
            .rev()
            .filter(|grasp| wanted.takes(grasp))
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
    fn pages_follow_the_dataset_and_the_filters() {
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
        let page = |wanted: Wanted| list.page(&wanted).unwrap();

        let first = page(Wanted {
            limit: Some(2),
            ..Wanted::default()
        });
        assert_eq!(ids(&first), [saved[2].as_str(), saved[1].as_str()]);
        let rest = page(Wanted {
            before: first.next.clone(),
            ..Wanted::default()
        });
        assert_eq!(
            (ids(&rest), rest.next.clone()),
            (vec![saved[0].as_str()], None)
        );
        let mugs = page(Wanted {
            object: Some("mug".into()),
            ..Wanted::default()
        });
        assert_eq!(mugs.grasps.len(), 2);

        let at = "2026-11-20T11:00:00Z".parse().unwrap();
        writer.set_outcome(&saved[0], Outcome::Slip, at).unwrap();
        list.forget(&saved[0]);
        writer.trash_grasp(&saved[1]).unwrap();
        let slips = page(Wanted {
            outcome: Some(Outcome::Slip),
            ..Wanted::default()
        });
        assert_eq!(ids(&slips), [saved[0].as_str()]);
        assert_eq!(page(Wanted::default()).grasps.len(), 2);
        let wrong = page(Wanted {
            disagree: Some(true),
            ..Wanted::default()
        });
        let claims = slips.grasps[0].prediction.as_ref();
        let expected = usize::from(claims.is_some_and(|said| said.p_stable >= 0.5));
        assert_eq!(wrong.grasps.len(), expected);
    }
}
