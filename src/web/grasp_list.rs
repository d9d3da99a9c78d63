//! Pages of the grasps in a dataset.

use jiff::Timestamp;
use jiff::civil::Date;
use jiff::tz::TimeZone;
use serde::{Deserialize, Serialize};
use utoipa::{IntoParams, ToSchema};

use crate::daemon::verdict_of;
use gripcast_base::error::{Error, Result};
use gripcast_base::files::ObjectName;
use gripcast_dataset::{Dataset, GraspId, GraspIndex, IndexRow, Outcome, PredictionRecord};
use gripcast_imaging::Role;
use gripcast_nn::predict::PredictedLabel;

/// Default number of grasps per page.
const DEFAULT_LIMIT: usize = 24;
/// Maximum number of grasps per page.
const MAX_LIMIT: usize = 500;

/// A grasp in a list.
#[derive(Clone, Debug, PartialEq, Serialize, ToSchema)]
pub(crate) struct GraspSummary {
    pub(crate) id: String,
    pub(crate) object: String,
    scene: String,
    operator: String,
    pub(crate) outcome: Outcome,
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
    fn new(id: &GraspId, row: &IndexRow) -> Self {
        Self {
            id: id.to_string(),
            object: row.object.to_string(),
            scene: row.scene.to_string(),
            operator: row.operator.to_string(),
            outcome: row.outcome,
            labelled_at: row.labelled_at.clone(),
            captured_at: row.captured_at.clone(),
            prediction: row.prediction.clone(),
            agrees: agrees(row),
            roles: row.roles(),
        }
    }
}

/// Whether prediction and label agree; `None` without one of them or if the model was unsure.
fn agrees(row: &IndexRow) -> Option<bool> {
    let predicted = row.prediction.as_ref().map(verdict_of)?;
    match (predicted, row.outcome) {
        (PredictedLabel::Stable, Outcome::Stable) | (PredictedLabel::Slip, Outcome::Slip) => {
            Some(true)
        }
        (PredictedLabel::Stable, Outcome::Slip) | (PredictedLabel::Slip, Outcome::Stable) => {
            Some(false)
        }
        _ => None,
    }
}

/// Query of the grasp list.
#[derive(Clone, Debug, Default, Deserialize, IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub(crate) struct GraspQuery {
    /// Maximum number of grasps.
    #[param(minimum = 1, maximum = 500, default = 24)]
    pub(crate) limit: Option<usize>,
    /// Only grasps older than this id: `next` of the previous page.
    pub(crate) before: Option<String>,
    /// Only grasps of this object.
    #[param(value_type = Option<String>)]
    pub(crate) object: Option<ObjectName>,
    /// Only grasps with this outcome.
    pub(crate) outcome: Option<Outcome>,
    /// Only grasps whose label and prediction disagree (true) or agree (false).
    pub(crate) disagree: Option<bool>,
    /// Only grasps taken at or after this time, RFC 3339; a date is its beginning in UTC.
    #[param(example = "2026-11-20T08:00:00Z")]
    pub(crate) since: Option<String>,
    /// Only grasps taken before this time, RFC 3339; a date is its beginning in UTC.
    #[param(example = "2026-11-21")]
    pub(crate) until: Option<String>,
}

impl GraspQuery {
    /// The condition on a grasp.
    ///
    /// # Errors
    /// `Input` for an invalid time.
    fn condition(&self) -> Result<impl Fn(&IndexRow) -> bool> {
        let since = self.since.as_deref().map(|text| time("since", text));
        let until = self.until.as_deref().map(|text| time("until", text));
        let (since, until) = (since.transpose()?, until.transpose()?);
        Ok(move |row: &IndexRow| {
            self.object
                .as_ref()
                .is_none_or(|object| row.object == *object)
                && self.outcome.is_none_or(|outcome| row.outcome == outcome)
                && since.is_none_or(|since| row.time.is_some_and(|time| time >= since))
                && until.is_none_or(|until| row.time.is_some_and(|time| time < until))
                && self
                    .disagree
                    .is_none_or(|disagree| agrees(row) == Some(!disagree))
        })
    }
}

/// Parses a time or a date.
fn time(parameter: &str, text: &str) -> Result<Timestamp> {
    let of_date = |text: &str| {
        let date: Date = text.parse().ok()?;
        Some(date.to_zoned(TimeZone::UTC).ok()?.timestamp())
    };
    let parsed = text.parse().ok().or_else(|| of_date(text));
    parsed.ok_or_else(|| {
        Error::input(format!("invalid time {text:.40?} in `{parameter}`"))
            .remedy("give an RFC 3339 time such as 2026-11-20T08:00:00Z, or a date")
    })
}

/// A page of the list.
#[derive(Clone, Debug, PartialEq, Serialize, ToSchema)]
pub(crate) struct GraspPage {
    /// Newest first.
    pub(crate) grasps: Vec<GraspSummary>,
    /// `before` of the next page; null on the last page.
    pub(crate) next: Option<String>,
}

/// The list: pages of the index that the engine keeps.
pub(crate) struct GraspList {
    index: GraspIndex,
}

impl GraspList {
    /// Creates the list of a dataset, which need not exist yet.
    pub(crate) fn new(index: GraspIndex) -> Self {
        Self { index }
    }

    /// Opens the dataset.
    ///
    /// # Errors
    /// As [`Dataset::open`].
    pub(crate) fn dataset(&self) -> Result<Dataset> {
        Dataset::open(self.index.path())
    }

    /// Returns a page of the list, without unreadable grasps (see `dataset verify`).
    ///
    /// # Errors
    /// Errors of reading the dataset; `Input` for an invalid limit or time.
    pub(crate) fn page(&self, query: &GraspQuery) -> Result<GraspPage> {
        let limit = query.limit.unwrap_or(DEFAULT_LIMIT);
        if !(1..=MAX_LIMIT).contains(&limit) {
            return Err(Error::input(format!(
                "expected a limit of 1 to {MAX_LIMIT}, found {limit}"
            )));
        }
        let condition = query.condition()?;
        // Without a dataset, this says so.
        self.dataset()?;
        self.index.refresh()?;
        let found = self
            .index
            .newest(query.before.as_deref(), limit + 1, condition);
        let next = found.get(limit).and(found.get(limit - 1));
        Ok(GraspPage {
            next: next.map(|(id, _)| id.to_string()),
            grasps: found
                .iter()
                .take(limit)
                .map(|(id, row)| GraspSummary::new(id, row))
                .collect(),
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
        let list = GraspList::new(GraspIndex::new(dir.path()));
        let (mut writer, _) =
            DatasetWriter::open_index(list.index.clone(), &new_dataset()).unwrap();
        let mut saved = Vec::new();
        for (number, object) in [(1, "mug"), (3, "cup"), (5, "mug")] {
            let pending = writer.save_initial(&capture(number), Vec::new()).unwrap();
            let record = writer
                .save_grasp(&pending, &capture(number + 1), meta(object))
                .unwrap();
            saved.push(record.id);
        }
        saved.sort();
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
        writer
            .set_outcome(&saved[0], Outcome::Slip, at, None)
            .unwrap();
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
        let between = |since: &str, until: &str| GraspQuery {
            since: Some(since.to_owned()),
            until: Some(until.to_owned()),
            ..GraspQuery::default()
        };
        let taken = &slips.grasps[0].captured_at;
        assert_eq!(
            ids(&page(between(taken, "2026-11-21"))).last(),
            Some(&saved[0].as_str())
        );
        assert!(!ids(&page(between("2026-11-20", taken))).contains(&saved[0].as_str()));
        assert!(list.page(&between("yesterday", taken)).is_err());
        // All of this without reading a record.
        assert_eq!(list.index.work().records, 0);
    }
}
