//! Bar charts that compare models, with error bars and the results of single seeds.

use super::with_legend;
use gripcast_report::chart::{
    Anchor, Axis, Chart, Entry, Key, NORMAL, Panel, SMALL, colour, text, width, wrapped,
};
use gripcast_report::{MISSING, fixed};
use maud::{Markup, html};

/// Height of the panel, px.
const HEIGHT: f64 = 260.0;
/// Room above the panel for the value of a bar that reaches the top, px.
const HEADROOM: f64 = 20.0;
/// Room between groups, px.
const GAP: f64 = 22.0;
/// Minimum width of a group and of all groups, px.
const MIN_WIDTHS: [f64; 2] = [64.0, 260.0];
/// Width of a bar as a fraction of its slot.
const BAR: f64 = 0.84;
/// Width of the seed dots as a fraction of the bar.
const SEEDS: f64 = 0.8;
/// Radius of a dot, px.
const RADIUS: f64 = 2.4;
/// Maximum number of lines of a group name, and line height, px.
const NAME_LINES: usize = 3;
const LINE: f64 = 15.0;

/// A bar chart.
#[derive(Clone, Debug, PartialEq)]
pub struct BarChart {
    /// Accessible name.
    pub title: String,
    /// What the bars show.
    pub y_label: String,
    /// Lowest and highest value of the axis.
    pub y_range: [f64; 2],
    /// Names of the bars of each group, for example V, T and V+T.
    pub series: Vec<String>,
    /// The groups, for example test sets.
    pub groups: Vec<BarGroup>,
    /// What error bars mean, for example "standard deviation over 5 seeds".
    pub interval_meaning: String,
    /// A value to compare with.
    pub reference: Option<Reference>,
}

/// Group of bars.
#[derive(Clone, Debug, PartialEq)]
pub struct BarGroup {
    /// Name below the bars.
    pub name: String,
    /// A bar per series; none for a missing value.
    pub bars: Vec<Option<Bar>>,
}

/// A bar.
#[derive(Clone, Debug, PartialEq)]
pub struct Bar {
    /// Value; the bar starts at 0 or at the end of the axis nearest to 0.
    pub mean: f64,
    /// Lower and upper end of its error bar.
    pub interval: Option<[f64; 2]>,
    /// Results of single seeds, drawn as dots.
    pub seeds: Vec<f64>,
}

/// A reference value, drawn as a dashed line.
#[derive(Clone, Debug, PartialEq)]
pub struct Reference {
    /// Name in the legend, for example "Majority class".
    pub name: String,
    /// The value.
    pub value: f64,
}

/// Draws a bar chart; six series have different colours.
pub fn bars(chart: &BarChart) -> Chart {
    let layout = Layout::new(chart);
    let panel = &layout.panel;
    let width = panel.right - panel.left;
    let names: Vec<Vec<String>> = chart.groups.iter().map(|g| layout.name(&g.name)).collect();
    let reference = chart.reference.as_ref().map(|reference| reference.value);
    let places = || {
        let groups = chart.groups.iter().enumerate();
        groups.flat_map(|(i, group)| {
            let bars = group.bars.iter().take(layout.series).enumerate();
            bars.map(move |(series, bar)| {
                let bar = bar.as_ref().filter(|bar| bar.mean.is_finite());
                ([i, series], bar)
            })
        })
    };
    let body = html! {
        (panel.grid())
        @for (i, (group, lines)) in chart.groups.iter().zip(&names).enumerate() {
            g {
                title { (group.name) }
                @for (row, line) in lines.iter().enumerate() {
                    @let y = panel.bottom + 18.0 + row as f64 * LINE;
                    (text("", [panel.left + layout.middle(i), y], Anchor::Middle, line))
                }
            }
        }
        @for (place, bar) in places() {
            @if let Some(bar) = bar { (layout.bar(place, bar)) }
        }
        @if let Some(y) = reference.filter(|&y| panel.y.contains(y)) {
            (panel.guide([0.0, y], [width, y]))
        }
        // After the line of the reference, which would cross them.
        @for (place, bar) in places() { (layout.value(place, bar)) }
        (panel.edges())
        @if panel.y.range()[0] < 0.0 && panel.y.contains(0.0) {
            (panel.segment("axis", [0.0, 0.0], [width, 0.0]))
        }
    };
    let rows = names.iter().map(Vec::len).fold(1, usize::max);
    let top = panel.bottom + 10.0 + rows as f64 * LINE + 8.0;
    let description = described(chart, layout.decimals);
    let entries = entries(chart, layout.decimals);
    with_legend(
        &chart.title,
        description,
        [panel.right, top],
        body,
        &entries,
    )
}

/// Layout of the bars.
struct Layout {
    /// Its abscissa is in px.
    panel: Panel,
    /// Bars in a group.
    series: usize,
    /// Decimals of values.
    decimals: usize,
    /// Slot width of a bar, px.
    slot: f64,
    /// Width of a group without the gap, px.
    group: f64,
}

impl Layout {
    fn new(chart: &BarChart) -> Self {
        let y = Axis::new(&chart.y_label, chart.y_range, 5.0);
        let [low, high] = y.range();
        let decimals = (3.0 - (high - low).log10().round()).clamp(0.0, 3.0) as usize;
        let all_bars = chart.groups.iter().flat_map(|group| &group.bars).flatten();
        let widths = all_bars.map(|bar| width(&fixed(bar.mean, decimals), SMALL));
        let slot = widths.fold(30.0, f64::max) + 6.0;
        let in_groups = chart.groups.iter().map(|group| group.bars.len()).max();
        let series = in_groups.unwrap_or(0).max(chart.series.len()).max(1);
        let group = (slot * series as f64).max(MIN_WIDTHS[0]);
        let left = y.width_px();
        let inner = ((GAP + group) * chart.groups.len() as f64 + GAP).max(MIN_WIDTHS[1]);
        Self {
            panel: Panel {
                left,
                right: left + inner,
                top: HEADROOM,
                bottom: HEADROOM + HEIGHT,
                x: Axis::pixels(inner),
                y,
            },
            series,
            decimals,
            slot,
            group,
        }
    }

    /// Middle of a group, px from the left edge of the panel.
    fn middle(&self, group: usize) -> f64 {
        GAP + 0.5 * self.group + group as f64 * (GAP + self.group)
    }

    /// Middle of a bar, px from the left edge of the panel.
    fn x(&self, [group, series]: [usize; 2]) -> f64 {
        let from_middle = series as f64 + 0.5 - 0.5 * self.series as f64;
        self.middle(group) + from_middle * self.slot
    }

    /// Lines of the name of a group.
    fn name(&self, name: &str) -> Vec<String> {
        wrapped(name, NORMAL, self.group + 0.5 * GAP, NAME_LINES)
    }

    /// Draws a bar with its error bar and seed dots.
    fn bar(&self, place: [usize; 2], bar: &Bar) -> Markup {
        let (x, half) = (self.x(place), 0.5 * BAR * self.slot);
        let class = format!("bar {}", colour(place[1]));
        let across = |i: usize| (i as f64 + 0.5) / bar.seeds.len() as f64 - 0.5;
        html! {
            (self.panel.area(&class, [x - half, x + half], [0.0, bar.mean]))
            @if let Some(ends) = bar.interval {
                (self.panel.whisker("whisker", ends.map(|end| [x, end])))
            }
            @for (i, &seed) in self.shown_seeds(bar) {
                (self.panel.dot("seed", [x + 2.0 * SEEDS * half * across(i), seed], RADIUS))
            }
        }
    }

    fn shown_seeds<'a>(&'a self, bar: &'a Bar) -> impl Iterator<Item = (usize, &'a f64)> {
        let seeds = bar.seeds.iter().enumerate();
        seeds.filter(|(_, seed)| self.panel.y.contains(**seed))
    }

    /// Draws the value above a bar, or a dash if it is missing.
    fn value(&self, place: [usize; 2], bar: Option<&Bar>) -> Markup {
        let x = self.panel.left + self.x(place);
        let Some(bar) = bar else {
            let at = [x, self.panel.bottom - 5.0];
            return text("small halo", at, Anchor::Middle, MISSING);
        };
        let y = |value: f64| self.panel.to_px([0.0, value])[1];
        let ends = bar.interval.into_iter().flatten().map(y);
        let seeds = self.shown_seeds(bar).map(|(_, seed)| y(*seed) - RADIUS);
        let top = ends.chain(seeds).fold(y(bar.mean).min(y(0.0)), f64::min);
        let value = fixed(bar.mean, self.decimals);
        text("small halo", [x, top - 5.0], Anchor::Middle, &value)
    }
}

fn entries(chart: &BarChart, decimals: usize) -> Vec<Entry> {
    let bars = || chart.groups.iter().flat_map(|group| &group.bars).flatten();
    let series = chart.series.iter().enumerate();
    let mut entries: Vec<Entry> = series
        .map(|(i, name)| Entry::new(Key::Bar(format!("bar {}", colour(i))), name))
        .collect();
    if bars().any(|bar| bar.interval.is_some()) && !chart.interval_meaning.is_empty() {
        entries.push(Entry::new(Key::Whisker, &chart.interval_meaning));
    }
    if bars().any(|bar| !bar.seeds.is_empty()) {
        entries.push(Entry::new(Key::Dot("seed".to_owned()), "One seed"));
    }
    if let Some(reference) = &chart.reference {
        let value = fixed(reference.value, decimals);
        let name = format!("{} {value}", reference.name);
        entries.push(Entry::new(Key::Line("guide".to_owned()), name));
    }
    entries
}

/// Describes the chart in words.
fn described(chart: &BarChart, decimals: usize) -> String {
    let mut words = format!("Bar chart: {}.", chart.y_label);
    for group in &chart.groups {
        let bars = group.bars.iter().enumerate().map(|(series, bar)| {
            let name = chart.series.get(series).map_or("", String::as_str);
            let mean = bar.as_ref().map_or(f64::NAN, |bar| bar.mean);
            format!(" {name} {}", fixed(mean, decimals))
        });
        let bars: Vec<String> = bars.collect();
        words.push_str(&format!(" {}:{}.", group.name, bars.join(",")));
    }
    words
}
