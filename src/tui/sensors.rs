//! One line per camera: role, frame rates, age of the newest frame, problems.

use ratatui::buffer::Buffer;
use ratatui::layout::Rect;
use ratatui::style::Style;
use ratatui::text::{Line, Span};

use super::fault::state_and_extent;
use super::palette::Palette;
use super::text::{clipped, duration_ms, row, write};
use crate::daemon::{CameraState, CameraStatus, EngineStatus, GelStatus, ShearStatus};

/// Fraction of the nominal frame rate below which the rate is a warning.
const SLOW_FRACTION: f64 = 0.9;
/// Frame age above which it is a warning, nominal intervals.
const OLD_INTERVALS: f64 = 3.0;

pub(super) fn draw(buffer: &mut Buffer, area: Rect, status: &EngineStatus, palette: Palette) {
    let cameras = &status.cameras;
    let spare = usize::from(area.height).saturating_sub(cameras.len());
    let mut spare_rows = spare;
    let mut index = 0;
    for camera in cameras {
        let problems = problems(
            camera,
            status.gels.get(&camera.role),
            status.shear.get(&camera.role),
        );
        let (note, style) = match &camera.markers {
            Some(markers) if markers.ok && problems.is_empty() => {
                (markers.text.clone(), palette.stable())
            }
            _ => (problems.clone(), palette.warning()),
        };
        let own_line = !note.is_empty() && spare_rows > 0;
        let flagged = !problems.is_empty() && !own_line;
        write(buffer, row(area, index), &line(camera, flagged, palette));
        index += 1;
        if own_line {
            let text = clipped(&format!("  {note}"), usize::from(area.width));
            write(buffer, row(area, index), &Line::styled(text, style));
            index += 1;
            spare_rows -= 1;
        }
    }
}

/// Formats `left   25.0/25 fps 18 ms`, with `!` after the role if there are problems.
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
    let marked = |is_warning| palette.warning_if(is_warning, Style::new());
    Line::from(vec![
        role,
        flag,
        Span::styled(rate, marked(slow)),
        Span::styled(format!(" {age}"), marked(old)),
    ])
}

/// Describes a state in one or two words.
pub(super) fn state(state: &CameraState, palette: Palette) -> (String, Style) {
    let style = match state {
        CameraState::Opening | CameraState::Ended => palette.faint(),
        CameraState::Live => palette.stable(),
        CameraState::NoValidDepth { .. } => palette.warning(),
        _ => palette.slip(),
    };
    let (word, since) = state_and_extent(state);
    let words = match state {
        CameraState::Opening => "opening …".to_owned(),
        CameraState::Live => "live".to_owned(),
        CameraState::Ended => "recording ended".to_owned(),
        CameraState::NoValidDepth { .. } => "sees nothing".to_owned(),
        _ => format!("{word} {since}").trim_end().to_owned(),
    };
    (words, style)
}

/// Describes the problems of a gel's image, non-zero error counters and a missing pose; late frames are in the details only.
fn problems(camera: &CameraStatus, gel: Option<&GelStatus>, shear: Option<&ShearStatus>) -> String {
    let of_image = gel.into_iter().flat_map(|gel| gel.messages.clone());
    let of_shear = shear.into_iter().flat_map(|shear| shear.messages.clone());
    let counted = [
        (camera.counters.sequence_gaps, "lost"),
        (camera.counters.damaged, "damaged"),
        (camera.counters.reconnects, "reopened"),
    ]
    .into_iter()
    .filter(|(count, _)| *count > 0)
    .map(|(count, word)| format!("{count} {word}"));
    let no_pose = camera
        .markers
        .iter()
        .filter(|markers| !markers.ok)
        .map(|markers| format!("no pose: {}", markers.text));
    let all = of_image.chain(of_shear).chain(counted).chain(no_pose);
    all.collect::<Vec<_>>().join(" ")
}
