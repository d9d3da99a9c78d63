//! The dataset of a plan, as `synth merge` wrote it.

use std::collections::BTreeSet;
use std::path::Path;

use super::facts::{DatasetFacts, ProgressFacts};
use crate::MergeReport;
use crate::plan::Plan;
use gripcast_base::error::{Error, Result};
use gripcast_base::files::{BeneathPath, FileKind, Printable, Root, sha256_hex};
use gripcast_dataset::shard::ShardReader;

/// A dataset whose files are verified.
#[derive(Clone, Debug)]
pub(super) struct VerifiedDataset {
    merge: MergeReport,
    /// Ids of its simulations.
    pub(super) chosen: BTreeSet<String>,
}

impl VerifiedDataset {
    /// Reads the dataset of a plan and verifies its files.
    ///
    /// # Errors
    /// `NotFound` if a file is missing; `Input` for a dataset of another plan, or a damaged one.
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
                format!("the dataset belongs to another plan: expected {expected}, found {found}");
            return Err(Error::input(what)
                .at(folder.display())
                .remedy("name the plan that it was merged from, or merge this one"));
        }
        let root = Root::new(folder);
        let mut chosen = BTreeSet::new();
        for (name, sha256) in &merge.files {
            let located = |e: Error| {
                e.at(Printable(name))
                    .at(folder.display())
                    .remedy("merge again into a new folder: the dataset will be identical")
            };
            let unreadable = |e| located(Error::io("cannot read a file of the dataset", e));
            let path = root.resolve(name).map_err(unreadable)?;
            check(&path, sha256).map_err(located)?;
            for facts in ShardReader::open_beneath(&path)?.facts() {
                chosen.insert(facts?.simulation);
            }
        }
        Ok(Self { merge, chosen })
    }

    /// Returns its facts; later results may exist.
    pub(super) fn facts(&self, progress: &ProgressFacts) -> DatasetFacts {
        DatasetFacts {
            later_results: self.merge.open.saturating_sub(progress.open),
            merge: self.merge.clone(),
        }
    }
}

fn check(path: &BeneathPath, sha256: &str) -> Result<()> {
    let bytes = path
        .read(FileKind::Bulk)
        .map_err(|e| Error::io("cannot read a file of the dataset", e))?;
    if sha256_hex(bytes) == sha256 {
        return Ok(());
    }
    Err(Error::input("the file is not the one that was merged"))
}
