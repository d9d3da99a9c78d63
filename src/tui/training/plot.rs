//! Plots of training metrics over epochs.

use ratatui::buffer::Buffer;
use ratatui::layout::Rect;
use ratatui::symbols::Marker;
use ratatui::text::{Line, Span};
use ratatui::widgets::{Axis, Chart, Dataset, GraphType, Widget as _};

use super::super::palette::Palette;
use super::super::text::{inset, row, write};
use super::status::{TrainingStatus, figure};
use gripcast_train::EpochMetrics;

/// Minimum number of epochs on the axis.
const MIN_EPOCHS: u64 = 4;

/// A plot of two curves with their names and newest values.
struct Plot {
    title: &'static str,
    /// Drawn as a line.
    first: (&'static str, Vec<(f64, f64)>),
    /// Drawn as dots.
    second: (&'static str, Vec<(f64, f64)>),
    /// Highlighted point of the first curve.
    marked: Vec<(f64, f64)>,
    /// The first curve within the current epoch.
    trace: Vec<(f64, f64)>,
    y: [f64; 2],
}

/// Draws training and validation loss.
pub(super) fn losses(buffer: &mut Buffer, area: Rect, status: &TrainingStatus, palette: Palette) {
    let first = curve(status, |e| Some(e.train_loss));
    let second = curve(status, |e| Some(e.validation_loss));
    let last = first.last().into_iter();
    let trace = last.chain(&status.trace).copied();
    let trace: Vec<_> = trace.filter(|(_, y)| y.is_finite()).collect();
    // The first step may be far above all others.
    let bounding = if first.is_empty() { &trace } else { &first };
    let values = bounding.iter().chain(&second).map(|(_, y)| *y);
    let max = values.fold(0.0, f64::max);
    let plot = Plot {
        title: "LOSS",
        trace,
        first: ("train", first),
        second: ("validation", second),
        marked: Vec::new(),
        y: [0.0, if max > 0.0 { 1.1 * max } else { 1.0 }],
    };
    plot.draw(buffer, area, right_edge(status), palette);
}

/// Draws AUROC and accuracy on the validation split.
pub(super) fn accuracies(
    buffer: &mut Buffer,
    area: Rect,
    status: &TrainingStatus,
    palette: Palette,
) {
    let first = curve(status, |e| e.validation_auroc);
    let second = curve(status, |e| Some(e.validation_accuracy));
    let values = first.iter().chain(&second).map(|(_, y)| *y);
    let min = values.fold(0.5, f64::min).max(0.0);
    let best = status.best();
    let marked = best.and_then(|e| Some((f64::from(e.epoch), e.validation_auroc?)));
    let plot = Plot {
        title: "VALIDATION",
        marked: marked.into_iter().collect(),
        first: ("AUROC", first),
        second: ("accuracy", second),
        trace: Vec::new(),
        y: [(10.0 * min).floor() / 10.0, 1.0],
    };
    plot.draw(buffer, area, right_edge(status), palette);
}

/// Returns a metric over epochs.
fn curve(
    status: &TrainingStatus,
    figure: impl Fn(&EpochMetrics) -> Option<f64>,
) -> Vec<(f64, f64)> {
    let points = status.epochs.iter();
    points
        .filter_map(|e| Some((f64::from(e.epoch), figure(e)?)))
        .filter(|(_, y)| y.is_finite())
        .collect()
}

/// Returns the last epoch of the axis, so that at least half of the width is used.
fn right_edge(status: &TrainingStatus) -> u64 {
    let current = status.epochs.len() as u64 + 1;
    let room = current.next_power_of_two().max(MIN_EPOCHS);
    room.min(status.total_epochs()).max(1)
}

impl Plot {
    fn draw(&self, buffer: &mut Buffer, area: Rect, epochs: u64, palette: Palette) {
        write(buffer, row(area, 0), &self.title(area.width, palette));
        let below = inset(area, 0, 1);
        if below.is_empty() {
            return;
        }
        let line = |points, style| {
            let line = Dataset::default().data(points).marker(Marker::Braille);
            line.graph_type(GraphType::Line).style(style)
        };
        let points = |points, marker, style| {
            let scatter = Dataset::default().data(points).marker(marker);
            scatter.graph_type(GraphType::Scatter).style(style)
        };
        let (first, second) = (palette.first_curve(), palette.second_curve());
        let curves = vec![
            line(&self.trace, palette.faint()),
            line(&self.first.1, first),
            points(&self.second.1, Marker::Dot, second),
            points(&self.marked, Marker::Custom('◆'), first),
        ];
        let [low, high] = self.y;
        let places = if high < 0.2 { 3 } else { 2 };
        let label = |y: f64| Line::styled(format!("{y:.places$}"), palette.faint());
        let y = Axis::default()
            .bounds(self.y)
            .labels([label(low), label(f64::midpoint(low, high)), label(high)])
            .style(palette.faint());
        let last = Line::styled(format!("epoch {epochs}"), palette.faint());
        let x = Axis::default()
            .bounds([0.0, epochs as f64])
            .labels([Line::styled("0", palette.faint()), last])
            .style(palette.faint());
        let chart = Chart::new(curves).x_axis(x).y_axis(y);
        chart.legend_position(None).render(below, buffer);
    }

    /// Returns the names of the curves with their newest values, without values if narrow.
    fn title(&self, width: u16, palette: Palette) -> Line<'static> {
        let line = |has_values: bool| {
            let named = |(name, curve): &(&str, Vec<(f64, f64)>)| {
                let newest = figure(curve.last().map(|(_, y)| *y));
                let newest = Some(newest).filter(|_| has_values);
                newest.map_or_else(|| (*name).to_owned(), |newest| format!("{name} {newest}"))
            };
            let mut spans = vec![
                Span::styled(self.title, palette.strong()),
                Span::styled(" ⠒⠤ ", palette.first_curve()),
                Span::raw(named(&self.first)),
                Span::styled(" • ", palette.second_curve()),
                Span::raw(named(&self.second)),
            ];
            if !self.marked.is_empty() {
                spans.push(Span::styled(" ◆ ", palette.first_curve()));
                spans.push(Span::raw("best"));
            }
            Line::from(spans)
        };
        let full = line(true);
        if full.width() <= usize::from(width) {
            full
        } else {
            line(false)
        }
    }
}
