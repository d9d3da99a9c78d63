//! Layout of the dashboard at all sizes.

use ratatui::Frame;
use ratatui::buffer::Buffer;
use ratatui::layout::Rect;
use ratatui::text::{Line, Span};

use super::super::palette::Palette;
use super::super::text::{
    clipped, columns, duration_ms, inset, row, without_last, write, write_all, write_right,
};
use super::plot;
use super::status::{TrainingStatus, figure};

/// Minimum size of the dashboard; smaller ones show one line only.
const MIN_COLUMNS: u16 = 40;
const MIN_ROWS: u16 = 6;
/// Minimum width for plots side by side.
const WIDE_COLUMNS: u16 = 64;
/// Minimum height of a plot with its title.
const PLOT_ROWS: u16 = 7;
/// Minimum width for the names of dataset and run.
const MIN_NAME_COLUMNS: u16 = 8;
/// Width of the name column.
const NAME_COLUMNS: usize = 10;

/// Draws the whole dashboard, a pure function of the status.
pub fn draw(frame: &mut Frame<'_>, status: &TrainingStatus, palette: Palette) {
    let area = frame.area();
    let buffer = frame.buffer_mut();
    if area.width < MIN_COLUMNS || area.height < MIN_ROWS {
        write(buffer, row(area, area.height / 2), &tiny(status, palette));
        return;
    }
    header(buffer, row(area, 0), status, palette);
    let last = area.height - 1;
    write(buffer, row(area, last), &keys(palette));
    let body = Rect::new(area.x, area.y + 1, area.width, area.height - 2);
    let lines = facts(status, body, palette);
    write_all(buffer, body, &lines);
    let rest = inset(body, 0, lines.len() as u16);
    draw_rest(buffer, rest, status, palette);
}

/// Draws the plots, if they fit, above the last lines.
fn draw_rest(buffer: &mut Buffer, area: Rect, status: &TrainingStatus, palette: Palette) {
    let lines = match area.height {
        0..=PLOT_ROWS => area.height,
        height => (height / 5).clamp(1, 8),
    };
    let plots = area.height - lines;
    if plots > 0 {
        let gap = u16::from(plots > PLOT_ROWS);
        let plots = Rect::new(area.x + 1, area.y + gap, area.width - 2, plots - gap);
        draw_plots(buffer, plots, status, palette);
    }
    let first = status.lines.len().saturating_sub(usize::from(lines));
    let width = usize::from(area.width.saturating_sub(1));
    let line = |text| Line::styled(format!(" {}", clipped(text, width)), palette.faint());
    let lines: Vec<_> = status
        .lines
        .iter()
        .skip(first)
        .map(|text| line(text))
        .collect();
    write_all(buffer, inset(area, 0, plots), &lines);
}

fn draw_plots(buffer: &mut Buffer, area: Rect, status: &TrainingStatus, palette: Palette) {
    let (width, height) = ((area.width - 2) / 2, area.height / 2);
    let [first, second] = if area.width >= WIDE_COLUMNS {
        [Rect { width, ..area }, inset(area, area.width - width, 0)]
    } else if area.height >= 2 * PLOT_ROWS {
        [Rect { height, ..area }, inset(area, 0, height)]
    } else {
        [area, Rect::ZERO]
    };
    plot::losses(buffer, first, status, palette);
    plot::accuracies(buffer, second, status, palette);
}

fn header(buffer: &mut Buffer, area: Rect, status: &TrainingStatus, palette: Palette) {
    let seconds = status.elapsed.as_secs();
    let (hours, minutes) = (seconds / 3600, seconds / 60 % 60);
    let mut right = format!("{hours}:{minutes:02}:{:02}", seconds % 60);
    if let Some(left) = status.remaining() {
        let bound = match status.settings.patience {
            0 => "about",
            _ => "at most",
        };
        let left = duration_ms(left.as_secs_f64().ceil() * 1e3);
        right = format!("{right}, {bound} {left} left");
    }
    let taken = write_right(buffer, area, &Line::from(format!("{right} ")));
    let title = " gripcast train";
    let mut line = Line::from(Span::styled(title, palette.strong()));
    let room = area.width.saturating_sub(taken + columns(title) + 6);
    if room >= MIN_NAME_COLUMNS {
        let data = clipped(&status.data, usize::from(room / 2));
        let out = clipped(&status.out, usize::from(room - columns(&data)));
        line.push_span(Span::raw(format!("  {data}")));
        line.push_span(Span::styled(" → ", palette.faint()));
        line.push_span(Span::raw(out));
    }
    write(buffer, without_last(area, taken), &line);
}

/// Returns the lines of facts; low screens omit the upper ones.
fn facts(status: &TrainingStatus, area: Rect, palette: Palette) -> Vec<Line<'static>> {
    let (epoch, steps) = status.epoch();
    let epochs = status.total_epochs();
    let bar = |name, number: [u64; 2], fraction| {
        let number = format!("{} of {}", number[0], number[1]);
        bar(name, &number, fraction, usize::from(area.width), palette)
    };
    let mut lines = vec![
        dataset(status, palette),
        settings(status, palette),
        bar("epoch", [epoch, epochs], status.at),
        bar("step", steps, steps),
        now(status, palette),
        best(status, palette),
    ];
    let missing = lines.len().saturating_sub(usize::from(area.height));
    lines.split_off(missing)
}

fn named(name: &str, text: String, palette: Palette) -> Line<'static> {
    Line::from(vec![
        Span::styled(format!(" {name:<NAME_COLUMNS$}"), palette.faint()),
        Span::raw(text),
    ])
}

fn dataset(status: &TrainingStatus, palette: Palette) -> Line<'static> {
    let Some(start) = &status.start else {
        return named("data", "–".to_owned(), palette);
    };
    let (train, validation) = (start.train, start.validation);
    let text = format!(
        "{} samples of {} objects, {} stable · validation {} of {}, {} stable",
        train.samples,
        train.objects,
        train.stable,
        validation.samples,
        validation.objects,
        validation.stable,
    );
    named("data", text, palette)
}

fn settings(status: &TrainingStatus, palette: Palette) -> Line<'static> {
    let settings = &status.settings;
    let modality = settings.modality.words();
    let mut text = format!(
        "{modality} · network {} · batch {} · seed {}",
        settings.architecture.name, settings.batch_size, settings.seed
    );
    if status.seeds > 1 {
        text += &format!(", {} of {}", status.seed_number, status.seeds);
    }
    named("settings", text, palette)
}

fn now(status: &TrainingStatus, palette: Palette) -> Line<'static> {
    let text = match (status.stage, status.look) {
        (Some(stage), _) => stage.to_owned(),
        (None, Some([done, all])) => format!("validation, {done} of {all} samples"),
        (None, None) => {
            let pace = status.samples_per_s();
            let parts = [
                pace.map(|pace| format!("{pace:.1} samples/s")),
                status
                    .learning_rate
                    .map(|rate| format!("learning rate {rate:.2e}")),
                status.loss.map(|loss| format!("training loss {loss:.3}")),
            ];
            let parts: Vec<String> = parts.into_iter().flatten().collect();
            parts.join(" · ")
        }
    };
    named("now", text, palette)
}

fn best(status: &TrainingStatus, palette: Palette) -> Line<'static> {
    let text = status.best().map_or("–".to_owned(), |best| {
        format!(
            "epoch {} · AUROC {} · accuracy {:.3} · loss {:.3}",
            best.epoch,
            figure(best.validation_auroc),
            best.validation_accuracy,
            best.validation_loss,
        )
    });
    let mut line = named("best", text, palette);
    for span in line.spans.iter_mut().skip(1) {
        span.style = palette.strong();
    }
    line
}

/// Returns a progress bar with a number and percentage.
fn bar(
    name: &str,
    number: &str,
    [done, all]: [u64; 2],
    width: usize,
    palette: Palette,
) -> Line<'static> {
    let fraction = done.min(all) as f64 / all.max(1) as f64;
    let percent = format!(" {:>3.0} %", (100.0 * fraction).floor());
    let number = format!("{number:<16} ");
    let room = width.saturating_sub(NAME_COLUMNS + 2 + number.len() + percent.len());
    let full = (fraction * room as f64).floor() as usize;
    let mut line = named(name, number, palette);
    line.push_span(Span::styled("━".repeat(full), palette.first_curve()));
    line.push_span(Span::styled("·".repeat(room - full), palette.faint()));
    line.push_span(Span::raw(percent));
    line
}

fn keys(palette: Palette) -> Line<'static> {
    Line::from(vec![
        Span::styled(" q", palette.strong()),
        Span::raw(" stop; the same command resumes from the last checkpoint"),
    ])
}

/// Returns a one-line summary.
fn tiny(status: &TrainingStatus, palette: Palette) -> Line<'static> {
    let (epoch, [step, steps]) = status.epoch();
    let best = figure(status.best().and_then(|best| best.validation_auroc));
    let text = format!(
        "{epoch}/{} {step}/{steps} best {best}",
        status.total_epochs()
    );
    Line::styled(text, palette.strong())
}
