//! One line a camera: role, measured and nominal rate, age of the newest frame, what went wrong.

use ratatui::buffer::Buffer;
use ratatui::layout::Rect;
use ratatui::style::Style;
use ratatui::text::{Line, Span};

use super::fault::trouble;
use super::palette::Palette;
use super::text::{clipped, duration_ms, row, write};
use crate::daemon::{CameraState, CameraStatus};

/// Fraction of the nominal rate below which the rate is shown as a warning.
const SLOW_FRACTION: f64 = 0.9;
/// Age of the newest frame from which it is shown as a warning, in nominal intervals.
const OLD_INTERVALS: f64 = 3.0;

pub(super) fn draw(buffer: &mut Buffer, area: Rect, cameras: &[CameraStatus], palette: Palette) {
    let spare = usize::from(area.height).saturating_sub(cameras.len());
    let mut troubled = spare;
    let mut index = 0;
    for camera in cameras {
        let trouble = counted(camera);
        let (note, style) = match &camera.markers {
            Some(seen) if seen.ok && trouble.is_empty() => (seen.text.clone(), palette.stable()),
            _ => (trouble.clone(), palette.warning()),
        };
        let own_line = !note.is_empty() && troubled > 0;
        let flagged = !trouble.is_empty() && !own_line;
        write(buffer, row(area, index), &line(camera, flagged, palette));
        index += 1;
        if own_line {
            let text = clipped(&format!("  {note}"), usize::from(area.width));
            write(buffer, row(area, index), &Line::styled(text, style));
            index += 1;
            troubled -= 1;
        }
    }
}

/// `left   25.0/25 fps 18 ms`; `!` at the role when counters are not clean.
fn line(camera: &CameraStatus, flagged: bool, palette: Palette) -> Line<'static> {
    let flag = if flagged { "!" } else { " " };
    let role = Span::raw(format!("{:<5.5}", camera.role));
    let flag = Span::styled(flag, palette.warning());
    if !camera.state.is_live() {
        let (words, style) = state(&camera.state, palette);
        return Line::from(vec![role, flag, Span::styled(words, style)]);
    }
    let slow = camera.measured_fps < SLOW_FRACTION * camera.nominal_fps;
    let rate = format!("{:>5.1}/{:.0} fps", camera.measured_fps, camera.nominal_fps);
    let old = camera
        .frame_age_ms
        .is_none_or(|age| age * camera.nominal_fps > OLD_INTERVALS * 1e3);
    let age = camera
        .frame_age_ms
        .map_or_else(|| "–".to_owned(), duration_ms);
    let marked = |is_odd| palette.warning_if(is_odd, Style::new());
    Line::from(vec![
        role,
        flag,
        Span::styled(rate, marked(slow)),
        Span::styled(format!(" {age}"), marked(old)),
    ])
}

/// A state in one or two words.
pub(super) fn state(state: &CameraState, palette: Palette) -> (String, Style) {
    let style = match state {
        CameraState::Opening | CameraState::Ended => palette.faint(),
        CameraState::Live => palette.stable(),
        _ => palette.slip(),
    };
    let (word, since) = trouble(state);
    let words = match state {
        CameraState::Opening => "opening …".to_owned(),
        CameraState::Live => "live".to_owned(),
        CameraState::Ended => "recording ended".to_owned(),
        CameraState::Lost { .. } => word,
        _ => format!("{word} {since}"),
    };
    (words, style)
}

/// Counters that are not zero, in words; late frames are left to the detail screen.
fn counted(camera: &CameraStatus) -> String {
    [
        (camera.counters.sequence_gaps, "lost"),
        (camera.counters.damaged, "damaged"),
        (camera.counters.reconnects, "reopened"),
    ]
    .into_iter()
    .filter(|(count, _)| *count > 0)
    .map(|(count, word)| format!("{count} {word}"))
    .chain(markers(camera))
    .collect::<Vec<_>>()
    .join(" ")
}

/// That there would be no pose, and why.
fn markers(camera: &CameraStatus) -> Option<String> {
    let markers = camera.markers.as_ref().filter(|markers| !markers.ok)?;
    Some(format!("no pose: {}", markers.text))
}
