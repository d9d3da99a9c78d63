//! The banner: which step comes next and what to do now, in words.

use ratatui::buffer::Buffer;
use ratatui::layout::Rect;
use ratatui::style::Style;
use ratatui::text::{Line, Span};

use super::big_digits::{self, Size};
use super::palette::Palette;
use super::text::{duration_ms, fill, row, write};
use gripcast_session::{SessionView, Step};

/// What the banner says.
struct Banner {
    number: u8,
    verb: &'static str,
    instruction: &'static str,
    /// For narrow screens.
    brief: &'static str,
    style: Style,
}

fn banner(session: &SessionView, palette: Palette) -> Banner {
    let number = match session.step {
        Step::Initial => 1,
        Step::Grasp => 2,
        Step::Label => 3,
    };
    if session.saving {
        return Banner {
            number,
            verb: "SAVING",
            instruction: "SAVING — hold still",
            brief: "SAVING — hold still",
            style: palette.busy_step(),
        };
    }
    if session.refusal.is_some() {
        return Banner {
            number,
            verb: "REFUSED",
            instruction: "NOT TAKEN — mend it and trigger again",
            brief: "NOT TAKEN — see reasons",
            style: palette.refusal(),
        };
    }
    match session.step {
        Step::Initial => Banner {
            number,
            verb: "OPEN",
            instruction: "OPEN THE GRIPPER, then SPACE or pedal",
            brief: "OPEN GRIPPER, then SPACE/pedal",
            style: palette.initial_step(),
        },
        Step::Grasp => Banner {
            number,
            verb: "CLOSE",
            instruction: "CLOSE THE GRIPPER, then SPACE or pedal",
            brief: "CLOSE GRIPPER, then SPACE/pedal",
            style: palette.grasp_step(),
        },
        Step::Label => Banner {
            number,
            verb: "LIFT",
            instruction: "LIFT IT — held: S (stable)   lost: F (slip)",
            brief: "LIFT — held: S   lost: F",
            style: palette.label_step(),
        },
    }
}

/// Rows of the banner: one line, or three with a big verb, or five with a bigger one.
pub(super) fn draw(buffer: &mut Buffer, area: Rect, session: &SessionView, palette: Palette) {
    let banner = banner(session, palette);
    fill(buffer, area, banner.style);
    let size = match area.height {
        5.. if area.width >= 110 => Size::Medium,
        3.. if area.width >= 60 => Size::Small,
        _ => {
            write(buffer, area, &line(&banner, area.width));
            write(
                buffer,
                row(inset(area, 1, 0), 1),
                &progress(session, banner.style),
            );
            return;
        }
    };
    big_digits::draw(
        buffer,
        inset(area, 1, (area.height - size.rows()) / 2),
        banner.verb,
        size,
        banner.style,
    );
    // The widest verb that stays for long; `REFUSED` and `SAVING` push the words to the right.
    let verb = size.columns(banner.verb).max(size.columns("CLOSE"));
    let words = inset(area, verb + 4, (area.height - 3) / 2);
    let heading = Line::styled(format!("STEP {}/3", banner.number), banner.style);
    write(buffer, words, &heading);
    let instruction = if usize::from(words.width) < banner.instruction.chars().count() {
        banner.brief
    } else {
        banner.instruction
    };
    write(
        buffer,
        row(words, 1),
        &Line::styled(instruction, banner.style),
    );
    write(buffer, row(words, 2), &progress(session, banner.style));
}

fn inset(area: Rect, left: u16, top: u16) -> Rect {
    let left = left.min(area.width);
    let top = top.min(area.height);
    Rect::new(
        area.x + left,
        area.y + top,
        area.width - left,
        area.height - top,
    )
}

fn line(banner: &Banner, width: u16) -> Line<'static> {
    let room = usize::from(width).saturating_sub(11);
    let words = if banner.instruction.chars().count() <= room {
        banner.instruction
    } else {
        banner.brief
    };
    Line::styled(format!(" STEP {}/3  {words}", banner.number), banner.style)
}

/// What to do in `room` columns: a sentence, or one verb.
pub(super) fn brief(session: &SessionView, room: usize, palette: Palette) -> Span<'static> {
    let banner = banner(session, palette);
    let words = if banner.brief.chars().count() <= room {
        banner.brief
    } else {
        banner.verb
    };
    Span::styled(words, banner.style)
}

/// `initial ✓ 12 s ago → grasp ▶ → label`, with the present step marked.
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
