//! Counts per category, as the paper's Figure 7, of all results and of the dataset.

use std::fmt::Write as _;

use super::{bar, key, percent};
use crate::curate::{Apart, LeftOut};
use crate::merge::PartFacts;
use crate::report::facts::{DatasetFacts, Labels, SynthReport};
use gripcast_report::{Esc, open_section, open_wide, outcome_name, put};

pub(super) fn section(report: &SynthReport, out: &mut String) {
    open_section(out, "counts", "Counts by category (Figure 7)");
    out.push_str("<p>Simulations with a label. A grasp is a pose, simulated at every force.</p>\n");
    key(out);
    results(report, out);
    match &report.dataset {
        Some(dataset) => of_dataset(dataset, out),
        None => out.push_str(
            "<p class=\"nothing\">No dataset was given; <code>--dataset</code> adds what is in \
             its parts.</p>\n",
        ),
    }
    out.push_str("</section>\n");
}

fn results(report: &SynthReport, out: &mut String) {
    let all = report.categories.values().map(|facts| facts.labels.all());
    let most = all.max().unwrap_or(0);
    open_wide(out, "Counts by category");
    out.push_str(
        "<table class=\"data categories\"><thead><tr><th scope=\"col\">Category</th>\
         <th scope=\"col\" class=\"plot\">Simulations</th><th scope=\"col\" class=\"n\">held</th>\
         <th scope=\"col\" class=\"n\">lost</th><th scope=\"col\" class=\"n\">share held</th>\
         <th scope=\"col\" class=\"n\">objects</th><th scope=\"col\" class=\"n\">grasps</th></tr>\
         </thead><tbody>\n",
    );
    let mut row = |name: &str, labels: Labels, full: usize, objects: usize, grasps: usize| {
        put!(out, "<tr><th scope=\"row\">{}</th><td>", Esc(name));
        bar(out, labels, full);
        put!(
            out,
            "</td><td class=\"n\">{}</td><td class=\"n\">{}</td><td class=\"n\">{}</td>\
             <td class=\"n\">{objects}</td><td class=\"n\">{grasps}</td></tr>\n",
            labels.held,
            labels.lost,
            percent(labels.share())
        );
    };
    let (mut objects, mut grasps) = (0, 0);
    for (name, facts) in &report.categories {
        row(name, facts.labels, most, facts.objects, facts.grasps);
        objects += facts.objects;
        grasps += facts.grasps;
    }
    let all = report.progress.labels;
    put!(out, "</tbody><tfoot>");
    put!(
        out,
        "<tr><th scope=\"row\">all</th><td></td><td class=\"n\">{}</td><td class=\"n\">{}</td>\
         <td class=\"n\">{}</td><td class=\"n\">{objects}</td><td class=\"n\">{grasps}</td></tr>\
         </tfoot></table></div>\n",
        all.held,
        all.lost,
        percent(all.share())
    );
}

fn of_dataset(dataset: &DatasetFacts, out: &mut String) {
    let merge = &dataset.merge;
    let apart = match merge.curation.apart {
        Apart::Object => "no object is in two parts",
        Apart::Category => "no category is in two parts",
    };
    put!(
        out,
        "<h3>The dataset <span>{apart}; seed {}</span></h3>\n",
        merge.curation.seed
    );
    parts(dataset, out);
    part_categories(dataset, out);
    left_out(dataset, out);
}

fn labels(part: &PartFacts) -> Labels {
    Labels {
        held: part.stable,
        lost: part.slip,
    }
}

fn parts(dataset: &DatasetFacts, out: &mut String) {
    open_wide(out, "Parts of the dataset");
    out.push_str(
        "<table class=\"data\"><thead><tr><th scope=\"col\">Part</th>\
         <th scope=\"col\" class=\"n\">held</th><th scope=\"col\" class=\"n\">lost</th>\
         <th scope=\"col\" class=\"n\">objects</th><th scope=\"col\" class=\"n\">grasps</th>\
         <th scope=\"col\" class=\"n\">renderings</th></tr></thead><tbody>\n",
    );
    for (name, part) in &dataset.merge.parts {
        let labels = labels(part);
        put!(
            out,
            "<tr><th scope=\"row\">{}</th><td class=\"n\">{}</td><td class=\"n\">{}</td>\
             <td class=\"n\">{}</td><td class=\"n\">{}</td><td class=\"n\">{}</td></tr>\n",
            Esc(name),
            labels.held,
            labels.lost,
            part.objects,
            part.grasps,
            part.rows
        );
    }
    out.push_str("</tbody></table></div>\n");
}

/// Bars of each part by category; each part has its own scale.
fn part_categories(dataset: &DatasetFacts, out: &mut String) {
    let parts = &dataset.merge.parts;
    let mut categories: Vec<&String> = parts.values().flat_map(|p| p.categories.keys()).collect();
    categories.sort();
    categories.dedup();
    open_wide(out, "Parts of the dataset by category");
    out.push_str("<table class=\"data\"><thead><tr><th scope=\"col\">Category</th>");
    for name in parts.keys() {
        let name = Esc(name);
        put!(
            out,
            "<th scope=\"col\">{name}</th><th scope=\"col\" class=\"n\">held</th>\
             <th scope=\"col\" class=\"n\">lost</th>"
        );
    }
    out.push_str("</tr></thead><tbody>\n");
    for category in categories {
        put!(out, "<tr><th scope=\"row\">{}</th>", Esc(category));
        for part in parts.values() {
            let most = part.categories.values().map(|counts| counts[0] + counts[1]);
            let [held, lost] = part.categories.get(category).copied().unwrap_or_default();
            out.push_str("<td>");
            bar(out, Labels { held, lost }, most.max().unwrap_or(0));
            put!(
                out,
                "</td><td class=\"n\">{held}</td><td class=\"n\">{lost}</td>"
            );
        }
        out.push_str("</tr>\n");
    }
    out.push_str("</tbody></table></div>\n");
}

fn left_out(dataset: &DatasetFacts, out: &mut String) {
    let merge = &dataset.merge;
    let mut rows: Vec<(String, usize)> = Vec::new();
    for (reason, count) in &merge.left_out {
        let reason = match reason {
            LeftOut::CategoryCap => "its category has enough",
            LeftOut::Balance => "its label has enough",
        };
        rows.push((reason.to_owned(), *count));
    }
    for (outcome, count) in &merge.without_sample {
        let outcome = Esc(outcome_name(outcome)).to_string();
        rows.push((format!("nothing to see or no label: {outcome}"), *count));
    }
    rows.push(("could not be simulated".to_owned(), merge.failed));
    rows.push(("no result when it was merged".to_owned(), merge.open));
    out.push_str(
        "<table class=\"data\"><caption>Simulations that are not in the dataset</caption><thead>\
         <tr><th scope=\"col\">Reason</th><th scope=\"col\" class=\"n\">simulations</th></tr>\
         </thead><tbody>\n",
    );
    for (reason, count) in rows {
        put!(
            out,
            "<tr><th scope=\"row\">{reason}</th><td class=\"n\">{count}</td></tr>\n"
        );
    }
    out.push_str("</tbody></table>\n");
}
