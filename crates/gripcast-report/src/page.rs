//! The page of a report: head, style, sections, tables and lists.

use base64::Engine as _;
use base64::engine::general_purpose::STANDARD;
use maud::{DOCTYPE, Markup, PreEscaped, Render, html};
use sha2::{Digest as _, Sha256};

use crate::chart;
use crate::text::printable;

const STYLE: &str = include_str!("page.css");

/// Contents of a page.
pub struct Page<'a> {
    /// Program and version that created it.
    pub software: &'a str,
    /// Document title.
    pub title: &'a str,
    /// CSS rules in addition to those of every page.
    pub style: &'a str,
    /// The only script that the page may run.
    pub script: Option<&'a str>,
    /// Ids and names of the sections, for the navigation bar.
    pub sections: &'a [(&'a str, &'a str)],
    /// A warning in the navigation bar and on every printed page.
    pub flag: Option<&'a str>,
    /// The sections.
    pub main: Markup,
}

impl Page<'_> {
    /// Renders the page as a file: equal pages give identical bytes.
    pub fn to_html(&self) -> String {
        let script_source = self.script.map_or(String::new(), |script| {
            let hash = STANDARD.encode(Sha256::digest(script));
            format!("; script-src 'sha256-{hash}'")
        });
        let page = html! {
            (DOCTYPE)
            html lang="en" {
                head {
                    meta charset="utf-8";
                    meta name="viewport" content="width=device-width, initial-scale=1";
                    meta http-equiv="Content-Security-Policy" content={
                        "default-src 'none'; img-src data:; style-src 'unsafe-inline'"
                        (PreEscaped(script_source))
                    };
                    meta name="generator" content=(self.software);
                    title { (self.title) }
                    style { (PreEscaped(STYLE)) (PreEscaped(chart::STYLE)) (PreEscaped(self.style)) }
                }
                body {
                    @if let Some(flag) = self.flag {
                        div.spine aria-hidden="true" { (flag) }
                    }
                    (self.bar())
                    main { (self.main) }
                    @if let Some(script) = self.script {
                        script { (PreEscaped(script)) }
                    }
                }
            }
        };
        printable(page.into_string())
    }

    /// Links to the sections, and the colour scheme switch, which works without a script.
    fn bar(&self) -> Markup {
        html! {
            header.bar {
                nav aria-label="Sections" {
                    @for (id, name) in self.sections {
                        a href={ "#" (id) } { (name) }
                    }
                }
                @if let Some(flag) = self.flag {
                    span.flag { (flag) }
                }
                fieldset.theme {
                    legend { "Colours" }
                    @for value in ["auto", "light", "dark"] {
                        label {
                            input type="radio" name="theme" id={ "theme-" (value) }
                                checked[value == "auto"];
                            span { (value) }
                        }
                    }
                }
            }
        }
    }
}

/// Renders a section with its heading.
pub fn section(id: &str, title: &str, body: impl Render) -> Markup {
    html! {
        section id=(id) {
            h2 { (title) }
            (body)
        }
    }
}

/// Renders a warning.
pub fn warning(text: impl Render) -> Markup {
    html! { p.warning { (text) } }
}

/// Renders a placeholder for missing content.
pub fn placeholder(text: impl Render) -> Markup {
    html! { p.nothing { (text) } }
}

/// Renders a list of terms and their definitions.
pub fn definitions(class: &str, items: &[(&str, &dyn Render)]) -> Markup {
    html! {
        dl class=(class) {
            @for (term, text) in items {
                div {
                    dt { (term) }
                    dd { (text) }
                }
            }
        }
    }
}

/// Renders a bar of several segments, each with its CSS class and its fraction of the width.
pub fn stacked_bar<'a>(segments: impl IntoIterator<Item = (&'a str, f64)>) -> Markup {
    html! {
        div.stack aria-hidden="true" {
            @for (class, fraction) in segments {
                @if fraction > 0.0 {
                    i class=(class) style={ "width:" (format!("{:.2}", 100.0 * fraction)) "%" } {}
                }
            }
        }
    }
}

/// Renders a card of a grasp: its images, the largest first, and a text.
pub fn grasp_card(stable: bool, images: impl Render, text: impl Render) -> Markup {
    html! {
        li class=(if stable { "of-stable" } else { "of-slip" }) {
            div.views { (images) }
            (text)
        }
    }
}

/// A column of a [`Table`].
pub struct Column {
    title: Markup,
    is_number: bool,
}

impl Column {
    fn class(&self) -> Option<&'static str> {
        self.is_number.then_some("n")
    }
}

/// Returns a column of text.
pub fn text(title: impl Render) -> Column {
    Column {
        title: title.render(),
        is_number: false,
    }
}

/// Returns a column of numbers, aligned to the right.
pub fn number(title: impl Render) -> Column {
    Column {
        title: title.render(),
        is_number: true,
    }
}

/// A table in a frame that scrolls if it is too wide and can be focused by keyboard.
pub struct Table {
    label: String,
    class: &'static str,
    caption: Option<Markup>,
    columns: Vec<Column>,
    groups: Vec<Group>,
    foot: Option<Markup>,
}

struct Group {
    title: Option<Markup>,
    rows: Vec<Markup>,
}

impl Table {
    /// Creates a table without rows; `label` is its name for screen readers.
    pub fn new(label: &str, columns: impl IntoIterator<Item = Column>) -> Self {
        Self {
            label: label.to_owned(),
            class: "data",
            caption: None,
            columns: columns.into_iter().collect(),
            groups: Vec::new(),
            foot: None,
        }
    }

    /// Replaces the CSS class `data`.
    #[must_use]
    pub fn class(mut self, class: &'static str) -> Self {
        self.class = class;
        self
    }

    /// Adds a visible caption.
    #[must_use]
    pub fn caption(mut self, caption: impl Render) -> Self {
        self.caption = Some(caption.render());
        self
    }

    /// Starts a group of rows with a title.
    pub fn group(&mut self, title: impl Render) {
        self.groups.push(Group {
            title: Some(title.render()),
            rows: Vec::new(),
        });
    }

    /// Appends a row; its first cell is the row heading.
    pub fn row<R: Render>(&mut self, cells: impl IntoIterator<Item = R>) {
        let row = self.cells(cells);
        match self.groups.last_mut() {
            Some(group) => group.rows.push(row),
            None => self.groups.push(Group {
                title: None,
                rows: vec![row],
            }),
        }
    }

    /// Sets the footer row, which sums up the others.
    pub fn total<R: Render>(&mut self, cells: impl IntoIterator<Item = R>) {
        self.foot = Some(self.cells(cells));
    }

    fn cells<R: Render>(&self, cells: impl IntoIterator<Item = R>) -> Markup {
        html! {
            tr {
                @for (i, (cell, column)) in cells.into_iter().zip(&self.columns).enumerate() {
                    @if i == 0 {
                        th scope="row" { (cell) }
                    } @else {
                        td class=[column.class()] { (cell) }
                    }
                }
            }
        }
    }
}

impl Render for Table {
    fn render(&self) -> Markup {
        html! {
            div.wide role="region" tabindex="0" aria-label=(self.label) {
                table class=(self.class) {
                    @if let Some(caption) = &self.caption {
                        caption { (caption) }
                    }
                    thead {
                        tr {
                            @for column in &self.columns {
                                th class=[column.class()] scope="col" { (column.title) }
                            }
                        }
                    }
                    @for group in &self.groups {
                        tbody {
                            @if let Some(title) = &group.title {
                                tr.group {
                                    th colspan=(self.columns.len()) scope="rowgroup" { (title) }
                                }
                            }
                            @for row in &group.rows { (row) }
                        }
                    }
                    @if let Some(foot) = &self.foot {
                        tfoot { (foot) }
                    }
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const HOSTILE: &str = "<script>alert(\"1\")</script>&\u{0}\u{202e}é";
    const SAFE: &str = "&lt;script&gt;alert(&quot;1&quot;)&lt;/script&gt;&amp;  é";

    fn page(main: Markup, script: Option<&str>) -> String {
        let page = Page {
            software: HOSTILE,
            title: HOSTILE,
            style: "",
            script,
            sections: &[("one", HOSTILE)],
            flag: Some(HOSTILE),
            main,
        };
        page.to_html()
    }

    #[test]
    fn strings_are_escaped_everywhere() {
        let mut table = Table::new(HOSTILE, [text(HOSTILE), number(HOSTILE)]).caption(HOSTILE);
        table.group(HOSTILE);
        table.row([&HOSTILE as &dyn Render, &HOSTILE]);
        table.total([&HOSTILE as &dyn Render, &HOSTILE]);
        let main = html! {
            (section(HOSTILE, HOSTILE, &table))
            (definitions("facts", &[(HOSTILE, &HOSTILE)]))
            (warning(HOSTILE))
            (placeholder(HOSTILE))
        };
        let page = page(main, None);
        assert_eq!(page.matches(SAFE).count(), 5 + 2 + 9 + 4);
        assert!(!page.contains("<script") && !page.contains(['\0', '\u{202e}']));
    }

    #[test]
    fn content_policy_allows_only_the_hashed_script() {
        let with = page(html! {}, Some("alert(1 < 2)"));
        let hash = STANDARD.encode(Sha256::digest("alert(1 < 2)"));
        assert!(
            with.contains(&format!("; script-src 'sha256-{hash}'\"")),
            "{with}"
        );
        assert!(with.contains("<script>alert(1 < 2)</script>"));
        let without = page(html! {}, None);
        assert!(without.contains("default-src 'none'") && !without.contains("script-src"));
    }

    #[test]
    fn table_has_total_and_aligned_numbers() {
        let mut table = Table::new("T", [text("name"), number("n")]);
        table.row([&"a" as &dyn Render, &1]);
        table.total([&"all" as &dyn Render, &3]);
        let drawn = table.render().into_string();
        assert!(
            drawn.contains("<th scope=\"row\">a</th><td class=\"n\">1</td>"),
            "{drawn}"
        );
        assert!(
            drawn.contains("<tfoot><tr><th scope=\"row\">all</th>"),
            "{drawn}"
        );
    }

    #[test]
    fn stacked_bar_omits_empty_segments() {
        let drawn =
            stacked_bar([("stable", 1.0 / 3.0), ("slip", 0.0), ("other", f64::NAN)]).into_string();
        assert_eq!(drawn.matches("<i ").count(), 1);
        assert!(
            drawn.contains("class=\"stable\" style=\"width:33.33%\""),
            "{drawn}"
        );
    }
}
