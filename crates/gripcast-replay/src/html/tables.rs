//! Tables 1 and 2 of the paper.

use std::fmt::Write as _;

use super::head::WAYS;
use super::text::{
    Esc, MISSING, engine_name, fixed, force_name, interval, optional, share, trimmed,
};
use super::{Page, open_wide, picture, put};
use crate::report::{ObjectFacts, Score};

/// Table 1: agreement by object, engine and way to choose the setting.
pub(super) fn accuracy(page: &Page<'_>, out: &mut String) {
    page.open_section(out, "accuracy", "Table 1. Agreement by object");
    put!(
        out,
        "<p>Share of grasps whose simulated outcome is that of {}, below it the 95&nbsp;% Wilson \
         interval. Avg is the mean over objects. Bold is the best engine of a column.</p>\n",
        page.reality()
    );
    open_wide(out, "Table 1");
    out.push_str("<table class=\"data\"><thead><tr><th scope=\"col\">Engine</th>");
    for object in &page.report.objects {
        put!(out, "<th scope=\"col\">{}</th>", Esc(&object.name));
    }
    out.push_str("<th scope=\"col\">Avg</th><th scope=\"col\">All grasps</th></tr></thead>\n");
    let columns = page.report.objects.len() + 3;
    for way in &WAYS {
        put!(
            out,
            "<tbody><tr class=\"group\"><th colspan=\"{columns}\" scope=\"rowgroup\">{} \
             <span>{}</span></th></tr>\n",
            way.name,
            way.how
        );
        let scores: Vec<&Score> = page
            .report
            .engines
            .iter()
            .map(|engine| (way.score)(&engine.scores))
            .collect();
        for (engine, score) in page.report.engines.iter().zip(&scores) {
            put!(
                out,
                "<tr><th scope=\"row\">{}</th>",
                Esc(engine_name(&engine.name))
            );
            row(page, out, &scores, score);
            out.push_str("</tr>\n");
        }
        out.push_str("</tbody>\n");
    }
    out.push_str("</table></div>\n</section>\n");
}

fn row(page: &Page<'_>, out: &mut String, all: &[&Score], score: &Score) {
    for object in &page.report.objects {
        let of = |score: &Score| score.by_object.get(&object.name).copied();
        let Some(p) = of(score) else {
            put!(out, "<td>{MISSING}</td>");
            continue;
        };
        let best = all.iter().filter_map(|s| of(s)).map(|p| p.share);
        put!(
            out,
            "<td title=\"{} of {}\">{}<small>{}</small></td>",
            p.agree,
            p.n,
            strong(&share(&p), is_best(p.share, best)),
            interval(&p)
        );
    }
    let means = all.iter().map(|s| s.mean);
    let p = &score.all;
    let shares = all.iter().map(|s| s.all.share);
    put!(
        out,
        "<td>{}</td><td>{}<small>{}</small><small>{} of {}</small></td>",
        strong(&fixed(score.mean, 2), is_best(score.mean, means)),
        strong(&share(p), is_best(p.share, shares)),
        interval(p),
        p.agree,
        p.n
    );
}

fn is_best(value: f64, all: impl Iterator<Item = f64> + Clone) -> bool {
    all.clone().count() > 1 && all.fold(f64::NEG_INFINITY, f64::max) <= value
}

fn strong(text: &str, is_best: bool) -> String {
    if is_best {
        format!("<b>{text}</b>")
    } else {
        text.to_owned()
    }
}

/// Table 2: what each object is and which setting was chosen for it.
pub(super) fn parameters(page: &Page<'_>, out: &mut String) {
    page.open_section(out, "parameters", "Table 2. Objects and chosen settings");
    open_wide(out, "Table 2");
    out.push_str("<table class=\"data\"><thead><tr><th scope=\"col\"></th>");
    for (i, object) in page.report.objects.iter().enumerate() {
        put!(out, "<th scope=\"col\">{}", Esc(&object.name));
        if let Some(uri) = &object.picture {
            picture::picture(
                out,
                uri,
                &format!("o{i}"),
                &format!("object {}", object.name),
            );
        }
        out.push_str("</th>");
    }
    out.push_str("</tr></thead>\n<tbody>\n");
    chosen(page, out);
    properties(page, out);
    out.push_str("</tbody></table></div>\n");
    one_setting(page, out);
    out.push_str("</section>\n");
}

fn chosen(page: &Page<'_>, out: &mut String) {
    objects_row(page, out, "Mass, g", |o| fixed(1e3 * o.mass_kg, 0));
    for engine in &page.report.engines {
        let name = Esc(engine_name(&engine.name)).to_string();
        let scores = &engine.scores;
        let title = format!("{name}: friction coefficient");
        objects_row(page, out, &title, |_| trimmed(scores.friction, 3));
        let title = format!("{name}: {}, N", force_name(&engine.name));
        objects_row(page, out, &title, |o| {
            let force = scores.force_n.get(&o.name);
            force.map_or_else(|| MISSING.to_owned(), |n| trimmed(*n, 2))
        });
    }
}

fn properties(page: &Page<'_>, out: &mut String) {
    objects_row(page, out, "Grasps replayed (held, lost)", |o| {
        let lost = o.grasps.saturating_sub(o.stable);
        format!("{} ({}, {lost})", o.grasps, o.stable)
    });
    objects_row(page, out, "Size, mm", |o| {
        o.size_m.map(|side| fixed(1e3 * side, 0)).join(" × ")
    });
    objects_row(page, out, "Mesh", |o| {
        format!("<code>{}</code>", Esc(&o.mesh))
    });
    objects_row(page, out, "Triangles", |o| o.triangles.to_string());
    objects_row(page, out, "SHA-256 of the mesh", |o| {
        let short: String = o.mesh_sha256.chars().take(12).collect();
        format!(
            "<code title=\"{}\">{}</code>",
            Esc(&o.mesh_sha256),
            Esc(&short)
        )
    });
}

fn objects_row(
    page: &Page<'_>,
    out: &mut String,
    title: &str,
    cell: impl Fn(&ObjectFacts) -> String,
) {
    put!(out, "<tr><th scope=\"row\">{title}</th>");
    for object in &page.report.objects {
        put!(out, "<td>{}</td>", cell(object));
    }
    out.push_str("</tr>\n");
}

fn one_setting(page: &Page<'_>, out: &mut String) {
    out.push_str("<p>One setting for all objects: ");
    for (i, engine) in page.report.engines.iter().enumerate() {
        let one = engine.scores.one;
        put!(
            out,
            "{}{} friction {}, {} {}&nbsp;N",
            if i == 0 { "" } else { "; " },
            Esc(&engine_name(&engine.name).to_lowercase()),
            optional(Some(one.friction), 2),
            force_name(&engine.name),
            trimmed(one.force_n, 2)
        );
    }
    out.push_str(".</p>\n");
}
