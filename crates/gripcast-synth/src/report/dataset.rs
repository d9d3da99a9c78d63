//! The dataset of a plan: what `synth merge` wrote.

use std::collections::BTreeSet;
use std::path::Path;

use super::facts::{DatasetFacts, ProgressFacts};
use crate::MergeReport;
use crate::plan::Plan;
use gripcast_base::error::{Error, Result};
use gripcast_base::files::{BeneathPath, FileKind, Printable, Root, sha256_hex};
use gripcast_dataset::shard::ShardReader;

/// A dataset whose files are those that were written.
#[derive(Clone, Debug)]
pub(super) struct FoundDataset {
    merge: MergeReport,
    /// Its simulations.
    pub(super) chosen: BTreeSet<String>,
}

impl FoundDataset {
    /// Reads the dataset of a plan and checks its files.
    ///
    /// # Errors
    /// `NotFound` where there is none or a file is missing; `Input` for a dataset of another plan,
    /// or a damaged one.
    pub(super) fn read(folder: &Path, plan: &Plan) -> Result<Self> {
        let merge = MergeReport::read(folder)?;
        if merge.plan_sha256 != plan.sha256 {
            let [expected, found] = [&plan.sha256, &merge.plan_sha256].map(|hash| {
                Printable(hash)
                    .to_string()
                    .chars()
                    .take(12)
                    .collect::<String>()
            });
            let what =
                format!("the dataset is of another plan: expected {expected}, found {found}");
            return Err(Error::input(what)
                .at(folder.display())
                .remedy("give the plan that it was merged from, or merge this one"));
        }
        let root = Root::new(folder);
        let mut chosen = BTreeSet::new();
        for (name, sha256) in &merge.files {
            let wrong = |e: Error| {
                e.at(Printable(name))
                    .at(folder.display())
                    .remedy("merge again into a new folder: it comes out the same")
            };
            let cannot = |e| wrong(Error::io("cannot read a file of the dataset", e));
            let place = root.resolve(name).map_err(cannot)?;
            check(&place, sha256).map_err(wrong)?;
            for facts in ShardReader::open_beneath(&place)?.facts() {
                chosen.insert(facts?.simulation);
            }
        }
        Ok(Self { merge, chosen })
    }

    /// Its facts; results may have come after it.
    pub(super) fn facts(&self, progress: &ProgressFacts) -> DatasetFacts {
        DatasetFacts {
            later_results: self.merge.open.saturating_sub(progress.open),
            merge: self.merge.clone(),
        }
    }
}

fn check(place: &BeneathPath, sha256: &str) -> Result<()> {
    let bytes = place
        .read(FileKind::Bulk)
        .map_err(|e| Error::io("cannot read a file of the dataset", e))?;
    if sha256_hex(bytes) == sha256 {
        return Ok(());
    }
    let what = "the file is not the one that was merged";
    Err(Error::input(what))
}
