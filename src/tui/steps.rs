//! The banner: current step and instruction.

use ratatui::buffer::Buffer;
use ratatui::layout::Rect;
use ratatui::style::Style;
use ratatui::text::{Line, Span};

use super::big_digits::{self, Size};
use super::palette::Palette;
use super::text::{duration_ms, fill, inset, row, write, write_all};
use gripcast_session::{SessionView, Step};

/// Texts and style of the banner.
struct Banner {
    number: u8,
    verb: &'static str,
    instruction: String,
    /// Instruction for narrow screens.
    brief: String,
    style: Style,
}

impl Banner {
    /// Returns the longest instruction of at most `columns`.
    fn fitting(&self, columns: usize) -> &str {
        match self.instruction.chars().count() <= columns {
            true => &self.instruction,
            false => &self.brief,
        }
    }
}

fn banner(session: &SessionView, palette: Palette) -> Banner {
    let number = match session.step {
        Step::Initial => 1,
        Step::Grasp => 2,
        Step::Label => 3,
    };
    if let Some(refusal) = session.refusal.as_ref().filter(|_| !session.saving) {
        let stage = refusal.stage.to_uppercase();
        let keys = match refusal.can_override {
            true => "SPACE again, or ! overrides",
            false => "fix it, then SPACE again",
        };
        return Banner {
            number,
            verb: "REFUSED",
            instruction: format!("{stage} NOT TAKEN — {keys}"),
            brief: format!("NOT TAKEN — {keys}"),
            style: palette.refusal(),
        };
    }
    let (verb, instruction, brief, style) = match session.step {
        _ if session.saving => (
            "SAVING",
            "SAVING — hold still",
            "SAVING — hold still",
            palette.busy_step(),
        ),
        Step::Initial => (
            "OPEN",
            "OPEN THE GRIPPER, then SPACE or pedal",
            "OPEN GRIPPER, then SPACE/pedal",
            palette.initial_step(),
        ),
        Step::Grasp => (
            "CLOSE",
            "CLOSE THE GRIPPER, then SPACE or pedal",
            "CLOSE GRIPPER, then SPACE/pedal",
            palette.grasp_step(),
        ),
        Step::Label => (
            "LIFT",
            "LIFT, then label: S stable   F slip",
            "LIFT — S stable   F slip",
            palette.label_step(),
        ),
    };
    Banner {
        number,
        verb,
        instruction: instruction.to_owned(),
        brief: brief.to_owned(),
        style,
    }
}

/// Draws the banner: one line, or a large verb on three or five rows.
pub(super) fn draw(buffer: &mut Buffer, area: Rect, session: &SessionView, palette: Palette) {
    let banner = banner(session, palette);
    fill(buffer, area, banner.style);
    let size = match area.height {
        5.. if area.width >= 110 => Size::Medium,
        3.. if area.width >= 60 => Size::Small,
        _ => {
            write(buffer, area, &line(&banner, area.width));
            let below = row(inset(area, 1, 0), 1);
            write(buffer, below, &progress(session, banner.style));
            return;
        }
    };
    let at = inset(area, 1, (area.height - size.rows()) / 2);
    big_digits::draw(buffer, at, banner.verb, size, banner.style);
    // The widest verb of a step; `REFUSED` and `SAVING` are short-lived and shift the words.
    let verb = size.columns(banner.verb).max(size.columns("CLOSE"));
    let words = inset(area, verb + 4, (area.height - 3) / 2);
    let heading = format!("STEP {}/3", banner.number);
    let instruction = banner.fitting(usize::from(words.width)).to_owned();
    let lines = [
        Line::styled(heading, banner.style),
        Line::styled(instruction, banner.style),
        progress(session, banner.style),
    ];
    write_all(buffer, words, &lines);
}

fn line(banner: &Banner, width: u16) -> Line<'static> {
    let words = banner.fitting(usize::from(width).saturating_sub(11));
    Line::styled(format!(" STEP {}/3  {words}", banner.number), banner.style)
}

/// Returns the instruction in `room` columns: a sentence or one verb.
pub(super) fn brief(session: &SessionView, room: usize, palette: Palette) -> Span<'static> {
    let banner = banner(session, palette);
    let words = if banner.brief.chars().count() <= room {
        banner.brief
    } else {
        banner.verb.to_owned()
    };
    Span::styled(words, banner.style)
}

/// Formats `initial ✓ 12 s ago → grasp ▶ → label`.
fn progress(session: &SessionView, style: Style) -> Line<'static> {
    let mark = |step: Step, done: bool| match (session.step == step, done) {
        (true, _) => " ▶",
        (false, true) => " ✓",
        (false, false) => "",
    };
    let age = session
        .initial_age_s
        .filter(|_| session.step == Step::Grasp)
        .map(|age_s| format!(" {} ago", duration_ms(age_s * 1e3)))
        .unwrap_or_default();
    let text = format!(
        "initial{}{age} → grasp{} → label{}",
        mark(Step::Initial, true),
        mark(Step::Grasp, session.step == Step::Label),
        mark(Step::Label, false),
    );
    Line::styled(text, style)
}
