//! Counts per category, as the paper's Figure 7, of all results and of the dataset.

use super::{bar, key, percent};
use crate::curate::{Apart, LeftOut};
use crate::merge::PartFacts;
use crate::report::facts::{DatasetFacts, Labels, SynthReport};
use gripcast_report::outcome_name;
use gripcast_report::page::{self, Table, nothing, number, text};
use maud::{Markup, Render, html};

pub(super) fn section(report: &SynthReport) -> Markup {
    let body = html! {
        p { "Simulations with a label. A grasp is a pose, simulated at every force." }
        (key())
        (results(report))
        @match &report.dataset {
            Some(dataset) => (of_dataset(dataset)),
            None => (nothing(html! {
                "No dataset was given; " code { "--dataset" } " adds what is in its splits."
            })),
        }
    };
    page::section("counts", "Counts by category (Figure 7)", body)
}

fn results(report: &SynthReport) -> Table {
    let columns = [
        text("Category"),
        text("Simulations"),
        number("held"),
        number("lost"),
        number("fraction held"),
        number("objects"),
        number("grasps"),
    ];
    let mut table = Table::new("Counts by category", columns).class("data categories");
    let all = report.categories.values().map(|facts| facts.labels.all());
    let most = all.max().unwrap_or(0);
    let cells = |labels: Labels| (labels.held, labels.lost, percent(labels.fraction()));
    let (mut objects, mut grasps) = (0, 0);
    for (name, facts) in &report.categories {
        let (held, lost, fraction) = cells(facts.labels);
        let bar = bar(facts.labels, most);
        let counts: [&dyn Render; 2] = [&facts.objects, &facts.grasps];
        table.row([
            name as &dyn Render,
            &bar,
            &held,
            &lost,
            &fraction,
            counts[0],
            counts[1],
        ]);
        objects += facts.objects;
        grasps += facts.grasps;
    }
    let (held, lost, fraction) = cells(report.progress.labels);
    table.total([
        &"all" as &dyn Render,
        &"",
        &held,
        &lost,
        &fraction,
        &objects,
        &grasps,
    ]);
    table
}

fn of_dataset(dataset: &DatasetFacts) -> Markup {
    let curation = &dataset.merge.curation;
    let apart = match curation.apart {
        Apart::Object => "no object is in two splits",
        Apart::Category => "no category is in two splits",
    };
    html! {
        h3 { "The dataset " span { (apart) "; seed " (curation.seed) } }
        (splits(dataset))
        (split_categories(dataset))
        (left_out(dataset))
    }
}

fn labels(part: &PartFacts) -> Labels {
    Labels {
        held: part.stable,
        lost: part.slip,
    }
}

fn splits(dataset: &DatasetFacts) -> Table {
    let numbers = ["held", "lost", "objects", "grasps", "renderings"];
    let columns = std::iter::once(text("Split")).chain(numbers.map(number));
    let mut table = Table::new("Splits of the dataset", columns);
    for (name, part) in &dataset.merge.parts {
        let labels = labels(part);
        table.row([
            name as &dyn Render,
            &labels.held,
            &labels.lost,
            &part.objects,
            &part.grasps,
            &part.rows,
        ]);
    }
    table
}

/// Bars of each split by category; each split has its own scale.
fn split_categories(dataset: &DatasetFacts) -> Table {
    let parts = &dataset.merge.parts;
    let mut categories: Vec<&String> = parts.values().flat_map(|p| p.categories.keys()).collect();
    categories.sort();
    categories.dedup();
    let of_part = parts
        .keys()
        .flat_map(|name| [text(name), number("held"), number("lost")]);
    let columns = std::iter::once(text("Category")).chain(of_part);
    let mut table = Table::new("Splits of the dataset by category", columns);
    for category in categories {
        let mut cells: Vec<Markup> = vec![category.render()];
        for part in parts.values() {
            let most = part.categories.values().map(|counts| counts[0] + counts[1]);
            let [held, lost] = part.categories.get(category).copied().unwrap_or_default();
            cells.push(bar(Labels { held, lost }, most.max().unwrap_or(0)));
            cells.extend([held.render(), lost.render()]);
        }
        table.row(cells.iter().map(|cell| cell as &dyn Render));
    }
    table
}

fn left_out(dataset: &DatasetFacts) -> Table {
    let merge = &dataset.merge;
    let mut table = Table::new(
        "Simulations that are not in the dataset",
        [text("Reason"), number("simulations")],
    )
    .caption("Simulations that are not in the dataset");
    for (reason, count) in &merge.left_out {
        let reason = match reason {
            LeftOut::CategoryCap => "its category has enough",
            LeftOut::Balance => "its label has enough",
        };
        table.row([&reason as &dyn Render, count]);
    }
    for (outcome, count) in &merge.without_sample {
        let reason = format!("nothing to see or no label: {}", outcome_name(outcome));
        table.row([&reason as &dyn Render, count]);
    }
    table.row([&"could not be simulated" as &dyn Render, &merge.failed]);
    table.row([&"no result when it was merged" as &dyn Render, &merge.open]);
    table
}
