//! The report of a synthetic dataset: how far it is, what is in it, how it is balanced, what it
//! looks like and what it cost; facts first, the page from them.
//!
//! Everything is read from the files of the plan, its results and the dataset, so the same files
//! give the same report.

mod balance;
mod contact;
mod costs;
mod dataset;
mod facts;
mod gather;
mod html;
mod look;
mod numbers;
#[cfg(test)]
mod report_test;
#[cfg(test)]
mod sample;
mod sheet;
mod unlabelled;

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

pub use facts::*;
pub use html::page;

use self::contact::Seen;
use self::dataset::FoundDataset;
use self::gather::{Done, Gathered};
use super::plan::Plan;
use super::store::ResultStore;
use gripcast_base::error::Result;
use gripcast_base::workers::par_map_single_threaded;

/// What is reported.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct SynthReportSettings {
    /// Folder of the dataset, where there is one.
    pub dataset: Option<PathBuf>,
    /// Grasps of each label on the contact sheet.
    pub examples: usize,
    /// Decides which grasps and renderings are looked at.
    pub seed: u64,
    /// Simulations that are looked at at a time; the report does not depend on it.
    pub jobs: usize,
}

/// The report of the plan in a folder, as far as its simulations are. `told` gets how many results
/// were looked at, and of how many.
///
/// # Errors
/// `Input` for results or a dataset of another plan, damaged images or a damaged dataset;
/// `NotFound` where a file is missing; those of the operating system.
pub fn report(
    plan: &Plan,
    folder: &Path,
    settings: &SynthReportSettings,
    on_progress: &(dyn Fn(usize, usize) + Sync),
) -> Result<SynthReport> {
    let store = ResultStore::beside(folder);
    let gathered = Gathered::read(plan, &store)?;
    let progress = gathered.progress();
    let found = settings.dataset.as_deref();
    let found = found
        .map(|path| FoundDataset::read(path, plan))
        .transpose()?;
    let chosen = found.as_ref().map(|found| &found.chosen);
    let seen = seen(&gathered, &store, chosen, settings, on_progress)?;
    Ok(SynthReport {
        format: SYNTH_REPORT_FORMAT.to_owned(),
        version: SYNTH_REPORT_VERSION,
        software: concat!("gripcast ", env!("CARGO_PKG_VERSION")).to_owned(),
        seed: settings.seed,
        plan: gather::plan_facts(plan),
        dataset: found.as_ref().map(|found| found.facts(&progress)),
        progress,
        categories: gathered.categories(plan),
        balance: balance::balance(&gathered, chosen),
        contact: contact::contact(&seen),
        costs: costs::costs(&gathered),
        unlabelled: unlabelled::unlabelled(&gathered),
        examples: sheet::examples(&seen),
    })
}

/// Looks at every result with a label and images; those on the contact sheet keep their images.
fn seen<'a>(
    gathered: &'a Gathered<'_>,
    store: &ResultStore,
    chosen: Option<&BTreeSet<String>>,
    settings: &SynthReportSettings,
    on_progress: &(dyn Fn(usize, usize) + Sync),
) -> Result<Vec<Seen<'a>>> {
    let has_images = |(done, _): &(&Done<'_>, bool)| !done.result.lacks_images();
    let labelled: Vec<(&Done<'_>, bool)> = gathered.labelled().filter(has_images).collect();
    let mut shown = BTreeSet::new();
    for label in [true, false] {
        let results = labelled.iter().filter(|(done, held)| {
            *held == label && chosen.is_none_or(|chosen| chosen.contains(&*done.simulation.id))
        });
        let results: Vec<&Done<'_>> = results.map(|(done, _)| *done).collect();
        shown.extend(sheet::choose(&results, settings.examples, settings.seed));
    }
    let look = |(done, _): &(&Done<'_>, bool)| {
        let is_shown = shown.contains(&*done.simulation.id);
        look::look(store, done, settings.seed, is_shown)
    };
    let all = labelled.len();
    let looks = par_map_single_threaded(settings.jobs, &labelled, &look, &|done| {
        on_progress(done, all)
    })?;
    let seen = labelled.iter().zip(looks);
    let seen = seen.map(|((done, held), look)| Seen {
        done,
        held: *held,
        look,
    });
    Ok(seen.collect())
}
