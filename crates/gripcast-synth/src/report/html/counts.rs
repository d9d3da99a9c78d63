//! Counts by category (the paper's Figure 7) of all results and of the dataset.

use std::collections::BTreeSet;

use super::{bar, key, percent};
use crate::curate::{GroupKey, LabelBalance, LeftOut};
use crate::merge::SplitFacts;
use crate::report::facts::{DatasetFacts, LabelCounts, SynthReport};
use gripcast_report::outcome_name;
use gripcast_report::page::{self, Table, number, placeholder, text};
use maud::{Markup, Render, html};

pub(super) fn section(report: &SynthReport) -> Markup {
    let body = html! {
        p { "Labelled simulations. A grasp is a pose that is simulated at every force." }
        (key())
        (results(report))
        @match &report.dataset {
            Some(dataset) => (of_dataset(dataset)),
            None => (placeholder(html! {
                "No dataset was given; " code { "--dataset" } " adds the contents of its splits."
            })),
        }
    };
    page::section("counts", "Counts by category (Figure 7)", body)
}

fn results(report: &SynthReport) -> Table {
    let columns = [
        text("Category"),
        text("Simulations"),
        number("stable"),
        number("slip"),
        number("stable fraction"),
        number("objects"),
        number("grasps"),
    ];
    let mut table = Table::new("Counts by category", columns).class("data categories");
    let all = report.categories.values().map(|facts| facts.labels.total());
    let max = all.max().unwrap_or(0);
    let cells = |name: &str, bar: Markup, labels: LabelCounts, [objects, grasps]: [usize; 2]| {
        [
            name.render(),
            bar,
            labels.stable.render(),
            labels.slip.render(),
            percent(labels.stable_fraction()).render(),
            objects.render(),
            grasps.render(),
        ]
    };
    let mut sums = [0; 2];
    for (name, facts) in &report.categories {
        let counts = [facts.objects, facts.grasps];
        table.row(cells(name, bar(facts.labels, max), facts.labels, counts));
        sums = [sums[0] + counts[0], sums[1] + counts[1]];
    }
    table.total(cells("all", html! {}, report.progress.labels, sums));
    table
}

fn of_dataset(dataset: &DatasetFacts) -> Markup {
    let curation = &dataset.merge.curation;
    let grouping = match curation.group_by {
        GroupKey::Object => "grouped by object",
        GroupKey::Category => "grouped by category",
    };
    let balance = match curation.balance {
        LabelBalance::Overall => "labels balanced overall",
        LabelBalance::Category => "labels balanced at each force and by category",
        LabelBalance::None => "labels not balanced",
    };
    html! {
        h3 { "The dataset " span { (grouping) "; " (balance) "; seed " (curation.seed) } }
        (splits(dataset))
        (split_categories(dataset))
        (left_out(dataset))
    }
}

fn labels(split: &SplitFacts) -> LabelCounts {
    LabelCounts {
        stable: split.stable,
        slip: split.slip,
    }
}

fn splits(dataset: &DatasetFacts) -> Table {
    let numbers = ["stable", "slip", "objects", "grasps", "renderings"];
    let columns = std::iter::once(text("Split")).chain(numbers.map(number));
    let mut table = Table::new("Splits of the dataset", columns);
    for (name, split) in &dataset.merge.splits {
        let labels = labels(split);
        table.row([
            name as &dyn Render,
            &labels.stable,
            &labels.slip,
            &split.objects,
            &split.grasps,
            &split.rows,
        ]);
    }
    table
}

/// Bars of each split by category; each split has its own scale.
fn split_categories(dataset: &DatasetFacts) -> Table {
    let splits = &dataset.merge.splits;
    let categories = splits.values().flat_map(|split| split.categories.keys());
    let categories: BTreeSet<&String> = categories.collect();
    let split_columns = splits
        .keys()
        .flat_map(|name| [text(name), number("stable"), number("slip")]);
    let columns = std::iter::once(text("Category")).chain(split_columns);
    let mut table = Table::new("Splits of the dataset by category", columns);
    for category in categories {
        let mut cells: Vec<Markup> = vec![category.render()];
        for split in splits.values() {
            let totals = split
                .categories
                .values()
                .map(|counts| counts[0] + counts[1]);
            let [stable, slip] = split.categories.get(category).copied().unwrap_or_default();
            cells.push(bar(LabelCounts { stable, slip }, totals.max().unwrap_or(0)));
            cells.extend([stable.render(), slip.render()]);
        }
        table.row(cells);
    }
    table
}

fn left_out(dataset: &DatasetFacts) -> Table {
    let merge = &dataset.merge;
    let mut table = Table::new(
        "Simulations outside of the dataset",
        [text("Reason"), number("simulations")],
    )
    .caption("Simulations outside of the dataset");
    for (reason, count) in &merge.left_out {
        let reason = match reason {
            LeftOut::CategoryCap => "its category reached the cap",
            LeftOut::Balance => "its label is the more frequent one",
        };
        table.row([&reason as &dyn Render, count]);
    }
    for (outcome, count) in &merge.without_sample {
        let reason = format!("no label: {}", outcome_name(outcome));
        table.row([&reason as &dyn Render, count]);
    }
    table.row([&"failed" as &dyn Render, &merge.failed]);
    table.row([
        &"no result at the time of merging" as &dyn Render,
        &merge.open,
    ]);
    table
}
