//! Tables 1 and 2 of the paper.

use super::Page;
use super::head::METHODS;
use super::text::{force_name, fraction, interval, setting};
use crate::report::{ObjectFacts, Score};
use gripcast_report::image::image;
use gripcast_report::page::{Table, text};
use gripcast_report::{MISSING, engine_name, fixed, trimmed};
use maud::{Markup, Render, html};

/// Table 1: agreement by object, engine and method of choosing the setting.
pub(super) fn accuracy(page: &Page<'_>) -> Markup {
    let objects = page.report.objects.iter().map(|object| text(&object.name));
    let columns = std::iter::once(text("Engine")).chain(objects);
    let columns = columns.chain([text("Avg"), text("All grasps")]);
    let mut table = Table::new("Table 1", columns);
    for method in &METHODS {
        table.group(html! { (method.name) " " span { (method.description) } });
        let engines = || page.report.engines.iter();
        let scores: Vec<&Score> = engines().map(|e| (method.score)(&e.scores)).collect();
        for (engine, score) in engines().zip(&scores) {
            let name = engine_name(&engine.name).render();
            table.row(std::iter::once(name).chain(row(page, &scores, score)));
        }
    }
    let body = html! {
        p {
            "Fraction of grasps whose simulated outcome agrees with " (page.reality()) ", with the 95\u{a0}% \
             Wilson interval below. Avg: mean over objects. Bold: best engine of the column."
        }
        (table)
    };
    page.section("accuracy", "Table 1. Agreement by object", body)
}

fn row(page: &Page<'_>, all: &[&Score], score: &Score) -> Vec<Markup> {
    let objects = page.report.objects.iter().map(|object| {
        let of = |score: &Score| score.by_object.get(&object.name).copied();
        let Some(p) = of(score) else {
            return MISSING.render();
        };
        let best = all.iter().filter_map(|s| of(s)).map(|p| p.fraction);
        html! {
            span title={ (p.agree) " of " (p.n) } {
                (strong(&fraction(&p), is_best(p.fraction, best)))
                small { (interval(&p)) }
            }
        }
    });
    let mean = is_best(score.mean, all.iter().map(|s| s.mean));
    let p = &score.all;
    let best = is_best(p.fraction, all.iter().map(|s| s.all.fraction));
    let all = html! {
        (strong(&fraction(p), best))
        small { (interval(p)) }
        small { (p.agree) " of " (p.n) }
    };
    objects
        .chain([strong(&fixed(score.mean, 2), mean), all])
        .collect()
}

fn is_best(value: f64, all: impl Iterator<Item = f64> + Clone) -> bool {
    all.clone().count() > 1 && all.fold(f64::NEG_INFINITY, f64::max) <= value
}

fn strong(text: &str, is_best: bool) -> Markup {
    html! {
        @if is_best { b { (text) } } @else { (text) }
    }
}

/// Table 2: the objects and the settings chosen for them.
pub(super) fn parameters(page: &Page<'_>) -> Markup {
    let objects = page.report.objects.iter().enumerate();
    let objects = objects.map(|(i, object)| {
        text(html! {
            (object.name)
            @if let Some(uri) = &object.image {
                (image(uri, &format!("o{i}"), &format!("object {}", object.name)))
            }
        })
    });
    let mut table = Table::new("Table 2", std::iter::once(text("")).chain(objects));
    let mut row = |title: Markup, cell: &dyn Fn(&ObjectFacts) -> Markup| {
        table.row(std::iter::once(title).chain(page.report.objects.iter().map(cell)));
    };
    row("Mass, g".render(), &|o| fixed(1e3 * o.mass_kg, 0).render());
    for engine in &page.report.engines {
        let (name, scores) = (engine_name(&engine.name), &engine.scores);
        let title = html! { (name) ": friction coefficient" };
        row(title, &|_| trimmed(scores.friction, 3).render());
        let title = html! { (name) ": " (force_name(&engine.name)) ", N" };
        row(title, &|o| {
            let force = scores.force_n.get(&o.name);
            force
                .map_or_else(|| MISSING.to_owned(), |n| trimmed(*n, 2))
                .render()
        });
    }
    row("Grasps replayed (stable, slip)".render(), &|o| {
        let slip = o.grasps.saturating_sub(o.stable);
        format!("{} ({}, {slip})", o.grasps, o.stable).render()
    });
    row("Size, mm".render(), &|o| {
        let sides = o.size_m.map(|side| fixed(1e3 * side, 0));
        sides.join(" × ").render()
    });
    row("Mesh".render(), &|o| html! { code { (o.mesh) } });
    row("Triangles".render(), &|o| o.triangles.render());
    row("SHA-256 of the mesh".render(), &|o| {
        let short: String = o.mesh_sha256.chars().take(12).collect();
        html! { code title=(o.mesh_sha256) { (short) } }
    });
    let body = html! {
        (table)
        p {
            "One setting for all objects: "
            @for (i, engine) in page.report.engines.iter().enumerate() {
                @if i > 0 { "; " }
                (engine_name(&engine.name).to_lowercase()) " "
                (setting(&engine.name, engine.scores.best_setting))
            }
            "."
        }
    };
    page.section("parameters", "Table 2. Objects and chosen settings", body)
}
