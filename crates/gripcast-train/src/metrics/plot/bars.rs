//! Bar charts that compare models: groups of bars with error bars and the results of each seed.

use std::fmt::Write as _;

use super::figure::{colour, figure};
use super::frame::{Axis, Frame};
use super::legend::{self, Entry, Key};
use super::text::{Anchor, NORMAL, SMALL, label, value, width, wrapped};
use gripcast_report::{Esc, MISSING, fixed, put};

/// Height of the frame, px.
const HEIGHT: f64 = 260.0;
/// Room above the frame for the value of a bar that reaches the top, px.
const HEADROOM: f64 = 20.0;
/// Room between groups, px.
const GAP: f64 = 22.0;
/// Least width of a group and of all groups, px.
const NARROWEST: [f64; 2] = [64.0, 260.0];
/// Share of its room that a bar takes.
const BAR: f64 = 0.84;
/// Share of a bar over which the dots of seeds are spread.
const SEEDS: f64 = 0.8;
/// Most lines of a group's name, and their distance, px.
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

/// Bars beside each other under one name.
#[derive(Clone, Debug, PartialEq)]
pub struct BarGroup {
    /// Name below the bars.
    pub name: String,
    /// A bar for each series; none leaves its place empty.
    pub bars: Vec<Option<Bar>>,
}

/// A bar.
#[derive(Clone, Debug, PartialEq)]
pub struct Bar {
    /// Its end; it starts at 0 or the end of the axis nearest to 0.
    pub mean: f64,
    /// Lower and upper end of its error bar.
    pub interval: Option<[f64; 2]>,
    /// Results of the single seeds, a dot each.
    pub seeds: Vec<f64>,
}

/// A value to compare bars with, a dashed line.
#[derive(Clone, Debug, PartialEq)]
pub struct Reference {
    /// What the legend calls it, for example "Majority class".
    pub name: String,
    /// The value.
    pub value: f64,
}

/// A bar chart as SVG. Six series are told apart by colour, more by their order.
pub fn bars(chart: &BarChart) -> String {
    let layout = Layout::new(chart);
    let frame = &layout.frame;
    // Values come after the line of the reference, which would cross them.
    let (mut body, mut values) = (String::new(), String::new());
    frame.draw_ordinate(&mut body);
    let mut lowest_line = 1;
    for (i, group) in chart.groups.iter().enumerate() {
        let lines = layout.draw_name(&mut body, i, &group.name);
        lowest_line = lowest_line.max(lines);
        for (series, bar) in group.bars.iter().take(layout.series).enumerate() {
            let bar = bar.as_ref().filter(|bar| bar.mean.is_finite());
            layout.draw_place(&mut body, &mut values, [i, series], bar);
        }
    }
    let reference = chart.reference.as_ref().map(|reference| reference.value);
    if let Some(y) = reference.filter(|&y| layout.shows(y)) {
        frame.draw_guide(&mut body, [0.0, y], [1.0, y]);
    }
    body.push_str(&values);
    frame.draw_edges(&mut body);
    layout.draw_zero(&mut body);
    let top = frame.bottom + 10.0 + lowest_line as f64 * LINE + 8.0;
    let entries = entries(chart, layout.decimals);
    let height = legend::draw(&mut body, [8.0, top], frame.right - 8.0, &entries);
    let size = [frame.right + 8.0, top + height + 4.0];
    figure(
        size,
        &chart.title,
        &described(chart, layout.decimals),
        &body,
    )
}

/// Where bars stand.
struct Layout<'a> {
    frame: Frame<'a>,
    /// Bars in a group.
    series: usize,
    /// Decimals of values.
    decimals: usize,
    /// Room of a bar, px.
    place: f64,
    /// Room of a group without the gap, px.
    group: f64,
}

impl<'a> Layout<'a> {
    fn new(chart: &'a BarChart) -> Self {
        let ordinate = Axis::new(&chart.y_label, chart.y_range);
        let [low, high] = ordinate.range;
        let decimals = (3.0 - (high - low).log10().round()).clamp(0.0, 3.0) as usize;
        let all_bars = chart.groups.iter().flat_map(|group| &group.bars).flatten();
        let widths = all_bars.map(|bar| width(&fixed(bar.mean, decimals), SMALL));
        let place = widths.fold(30.0, f64::max) + 6.0;
        let in_groups = chart.groups.iter().map(|group| group.bars.len()).max();
        let series = in_groups.unwrap_or(0).max(chart.series.len()).max(1);
        let group = (place * series as f64).max(NARROWEST[0]);
        let left = ordinate.room();
        let inner = (GAP + group) * chart.groups.len() as f64 + GAP;
        Self {
            frame: Frame {
                left,
                right: left + inner.max(NARROWEST[1]),
                top: HEADROOM,
                bottom: HEADROOM + HEIGHT,
                abscissa: Axis {
                    label: "",
                    range: [0.0, 1.0],
                    ticks: Vec::new(),
                },
                ordinate,
            },
            series,
            decimals,
            place,
            group,
        }
    }

    /// Middle of a group, px.
    fn middle(&self, group: usize) -> f64 {
        self.frame.left + GAP + 0.5 * self.group + group as f64 * (GAP + self.group)
    }

    /// Line from which bars of either sign start.
    fn draw_zero(&self, out: &mut String) {
        if self.frame.ordinate.range[0] < 0.0 && self.shows(0.0) {
            let [left, y] = self.frame.place([0.0, 0.0]);
            let right = self.frame.right;
            put!(
                out,
                "<path class=\"axis\" d=\"M{left:.1} {y:.1}H{right:.1}\"/>"
            );
        }
    }

    /// Writes the name of a group; returns how many lines it takes.
    fn draw_name(&self, out: &mut String, group: usize, name: &str) -> usize {
        let lines = wrapped(name, NORMAL, self.group + 0.5 * GAP, NAME_LINES);
        put!(out, "<g><title>{}</title>", Esc(name));
        for (i, line) in lines.iter().enumerate() {
            let y = self.frame.bottom + 18.0 + i as f64 * LINE;
            label(out, [self.middle(group), y], Anchor::Middle, line);
        }
        put!(out, "</g>");
        lines.len()
    }

    /// Draws a bar with its error bar, seeds and value, or a dash where there is none.
    fn draw_place(
        &self,
        out: &mut String,
        values: &mut String,
        [group, series]: [usize; 2],
        bar: Option<&Bar>,
    ) {
        let from_middle = series as f64 + 0.5 - 0.5 * self.series as f64;
        let x = self.middle(group) + from_middle * self.place;
        let Some(bar) = bar else {
            value(values, [x, self.frame.bottom - 5.0], MISSING);
            return;
        };
        let [end, base] = [self.frame.y(bar.mean), self.frame.y(0.0)];
        let top = end.min(base);
        let half = 0.5 * BAR * self.place;
        put!(
            out,
            "<rect class=\"bar {}\" x=\"{:.1}\" y=\"{top:.1}\" width=\"{:.1}\" height=\"{:.1}\"/>",
            colour(series),
            x - half,
            2.0 * half,
            (end - base).abs()
        );
        let whisker = self.draw_whisker(out, x, bar.interval).unwrap_or(top);
        let seeds = self.draw_seeds(out, x, half, &bar.seeds);
        let highest = top.min(whisker).min(seeds);
        let mean = fixed(bar.mean, self.decimals);
        value(values, [x, highest - 5.0], &mean);
    }

    /// Draws an error bar, without a cap where it leaves the frame; returns its upper end, px.
    fn draw_whisker(&self, out: &mut String, x: f64, interval: Option<[f64; 2]>) -> Option<f64> {
        let ends = interval.filter(|ends| ends.iter().all(|end| end.is_finite()))?;
        let [low, high] = ends.map(|end| self.frame.y(end));
        put!(
            out,
            "<path class=\"whisker\" d=\"M{x:.1} {low:.1}V{high:.1}"
        );
        for end in ends.into_iter().filter(|&end| self.shows(end)) {
            put!(out, "M{:.1} {:.1}h8", x - 4.0, self.frame.y(end));
        }
        put!(out, "\"/>");
        Some(low.min(high))
    }

    /// Whether a value is in the range of the axis.
    fn shows(&self, value: f64) -> bool {
        let [low, high] = self.frame.ordinate.range;
        (low..=high).contains(&value)
    }

    /// Draws the dots of the seeds in the range, each at the same place of every bar; returns their upper edge, px.
    fn draw_seeds(&self, out: &mut String, x: f64, half: f64, seeds: &[f64]) -> f64 {
        const RADIUS: f64 = 2.4;
        let mut upper_edge = f64::INFINITY;
        for (i, &seed) in seeds.iter().enumerate().filter(|(_, s)| self.shows(**s)) {
            let across = (i as f64 + 0.5) / seeds.len() as f64 - 0.5;
            let y = self.frame.y(seed);
            upper_edge = upper_edge.min(y - RADIUS);
            put!(
                out,
                "<circle class=\"seed\" cx=\"{:.1}\" cy=\"{y:.1}\" r=\"{RADIUS}\"/>",
                x + 2.0 * SEEDS * half * across
            );
        }
        upper_edge
    }
}

fn entries(chart: &BarChart, decimals: usize) -> Vec<Entry> {
    let bars = || chart.groups.iter().flat_map(|group| &group.bars).flatten();
    let mut entries = Vec::new();
    for (series, name) in chart.series.iter().enumerate() {
        entries.push(Entry::new(Key::Bar(series), name));
    }
    if bars().any(|bar| bar.interval.is_some()) && !chart.interval_meaning.is_empty() {
        entries.push(Entry::new(Key::Whisker, &chart.interval_meaning));
    }
    if bars().any(|bar| !bar.seeds.is_empty()) {
        entries.push(Entry::new(Key::Seed, "One seed"));
    }
    if let Some(reference) = &chart.reference {
        let value = fixed(reference.value, decimals);
        let name = format!("{} {value}", reference.name);
        entries.push(Entry::new(Key::Guide, name));
    }
    entries
}

/// The chart in words.
fn described(chart: &BarChart, decimals: usize) -> String {
    let mut text = format!("Bar chart: {}.", chart.y_label);
    for group in &chart.groups {
        put!(text, " {}:", group.name);
        for (series, bar) in group.bars.iter().enumerate() {
            let name = chart.series.get(series).map_or("", String::as_str);
            let mean = bar.as_ref().map_or(f64::NAN, |bar| bar.mean);
            let separator = if series == 0 { "" } else { "," };
            put!(text, "{separator} {name} {}", fixed(mean, decimals));
        }
        text.push('.');
    }
    text
}
