//! Reports on synthetic datasets: progress, contents, balance, examples and cost. The facts are
//! collected first; the page is rendered from them.
//!
//! Equal files of plan, results and dataset give identical reports.

mod balance;
mod contact;
mod costs;
mod dataset;
mod facts;
mod html;
mod inspect;
mod numbers;
#[cfg(test)]
mod report_test;
mod results;
#[cfg(test)]
mod sample;
mod sheet;
mod unlabelled;

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

pub use facts::*;
pub use html::page;

use self::contact::InspectedSimulation;
use self::dataset::VerifiedDataset;
use self::results::{FinishedSimulation, PlanResults};
use super::plan::Plan;
use super::store::ResultStore;
use gripcast_base::error::Result;
use gripcast_base::workers::par_map_single_threaded;

/// Settings of a report.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct SynthReportSettings {
    /// Folder of the dataset, if there is one.
    pub dataset: Option<PathBuf>,
    /// Number of grasps of each label on the contact sheet.
    pub examples: usize,
    /// Seed that selects the inspected grasps and renderings.
    pub seed: u64,
    /// Simulations that are inspected in parallel; the report does not depend on it.
    pub jobs: usize,
}

/// Creates the report on the plan in a folder; the plan may be unfinished. `on_progress` gets the
/// number of inspected results and their total.
///
/// # Errors
/// `Input` for results or a dataset of another plan, damaged images or a damaged dataset;
/// `NotFound` if a file is missing; I/O errors.
pub fn report(
    plan: &Plan,
    folder: &Path,
    settings: &SynthReportSettings,
    on_progress: &(dyn Fn(usize, usize) + Sync),
) -> Result<SynthReport> {
    let store = ResultStore::new(folder);
    let plan_results = PlanResults::read(plan, &store)?;
    let progress = plan_results.progress();
    let dataset = settings.dataset.as_deref();
    let dataset = dataset
        .map(|path| VerifiedDataset::read(path, plan))
        .transpose()?;
    let chosen = dataset.as_ref().map(|dataset| &dataset.chosen);
    let inspected = inspected(&plan_results, &store, chosen, settings, on_progress)?;
    Ok(SynthReport {
        format: SYNTH_REPORT_FORMAT.to_owned(),
        version: SYNTH_REPORT_VERSION,
        software: concat!("gripcast ", env!("CARGO_PKG_VERSION")).to_owned(),
        seed: settings.seed,
        plan: results::plan_facts(plan),
        dataset: dataset.as_ref().map(|dataset| dataset.facts(&progress)),
        progress,
        categories: plan_results.categories(plan),
        balance: balance::balance(&plan_results, chosen),
        contact: contact::contact(&inspected),
        costs: costs::costs(&plan_results),
        unlabelled: unlabelled::unlabelled(&plan_results),
        examples: sheet::examples(&inspected),
    })
}

/// Inspects every result with a label and images; those on the contact sheet get thumbnails.
fn inspected<'a>(
    plan_results: &'a PlanResults<'_>,
    store: &ResultStore,
    chosen: Option<&BTreeSet<String>>,
    settings: &SynthReportSettings,
    on_progress: &(dyn Fn(usize, usize) + Sync),
) -> Result<Vec<InspectedSimulation<'a>>> {
    let has_images = |(done, _): &(&FinishedSimulation<'_>, bool)| !done.result.lacks_images();
    let labelled: Vec<(&FinishedSimulation<'_>, bool)> =
        plan_results.labelled().filter(has_images).collect();
    let mut shown = BTreeSet::new();
    for label in [true, false] {
        let results = labelled.iter().filter(|(done, stable)| {
            *stable == label && chosen.is_none_or(|chosen| chosen.contains(&*done.simulation.id))
        });
        let results: Vec<&FinishedSimulation<'_>> = results.map(|(done, _)| *done).collect();
        shown.extend(sheet::choose(&results, settings.examples, settings.seed));
    }
    let inspect = |(done, _): &(&FinishedSimulation<'_>, bool)| {
        let with_thumbnails = shown.contains(&*done.simulation.id);
        inspect::inspect(store, done, settings.seed, with_thumbnails)
    };
    let total = labelled.len();
    let changes = par_map_single_threaded(settings.jobs, &labelled, &inspect, &|done| {
        on_progress(done, total)
    })?;
    let pairs = labelled.iter().zip(changes);
    let inspected = pairs.map(|((done, stable), change)| InspectedSimulation {
        done,
        stable: *stable,
        change,
    });
    Ok(inspected.collect())
}
