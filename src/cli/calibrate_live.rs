//! Collects calibration views from a camera of a rig, with hints on the terminal.

use std::io::{self, IsTerminal as _, Write as _};
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use crossterm::event::{self, Event, KeyCode, KeyEventKind, KeyModifiers};
use crossterm::terminal::{disable_raw_mode, enable_raw_mode};
use image::GrayImage;
use image::imageops::grayscale;

use super::calibrate_intrinsics::{Views, diagnosed};
use super::working::{Progress, interruptible};
use super::{Context, create_folder};
use crate::tui::Keyboard;
use gripcast_base::error::{Error, ErrorKind, Result};
use gripcast_base::files::{Printable, save};
use gripcast_capture::calibration::RigFile;
use gripcast_capture::camera::{CameraOpener, CaptureError, FrameSource, RigSources};
use gripcast_capture::device::SystemRoot;
use gripcast_imaging::{Decoder, Role, encode_png_grey8};
use gripcast_pose::calibrate::{AddedImage, Collector, Coverage, Hint, Rejection, Tilt};
use gripcast_virtual_rig::VirtualSource;

const FRAME_TIMEOUT: Duration = Duration::from_secs(1);
/// Timeouts tolerated before the camera is considered silent.
const MAX_TIMEOUTS: u32 = 5;
/// Consecutive images without the board that trigger a diagnosis.
const DIAGNOSIS_IMAGES: u32 = 90;
/// Minimum time between two drawings of the block.
const DRAW_INTERVAL: Duration = Duration::from_millis(100);

/// Collects views from the camera of a role until there are enough.
///
/// # Errors
/// Errors of the camera; `Interrupted` if the user quits; `Input` if a recording ends without a
/// view.
pub(super) fn collect(
    context: &Context,
    collector: Collector,
    rig: &str,
    role: Role,
    keep: Option<&Path>,
) -> Result<Views> {
    let rig = RigFile::find(rig)?;
    let sources = RigSources::new(&rig, &SystemRoot::default(), &mut VirtualSource::new(1))?;
    let roles: Vec<&str> = rig.cameras.keys().map(|r| r.name()).collect();
    let opener = sources.openers.into_iter().find(|o| o.role() == role);
    let opener = opener.ok_or_else(|| {
        let what = format!("the rig {} has no camera with the role {role}", rig.id);
        Error::usage(what).remedy(format!("choose one with --camera: {}", roles.join(", ")))
    })?;
    if let Some(folder) = keep {
        create_folder(folder)?;
    }
    let is_terminal = !context.quiet && io::stdin().is_terminal() && io::stderr().is_terminal();
    let keep = keep.map(Path::to_owned);
    // The block replaces the progress bar.
    let display = Context {
        quiet: context.quiet || is_terminal,
        ..context.clone()
    };
    let views = interruptible(&display, "looking for the board", move |progress| {
        let mut live = Live {
            views: Views::new(collector),
            keep,
            without_board: 0,
            message: String::new(),
            has_shown_hint: false,
        };
        if is_terminal {
            let block = Block::new()?;
            live.run(opener, &mut Screen::Terminal(block))?;
        } else {
            live.run(opener, &mut Screen::Lines(progress))?;
        }
        Ok(live.views)
    });
    if is_terminal {
        // A signal may have left the thread with the block behind.
        let _ = disable_raw_mode();
    }
    views?
}

/// Output of the hints.
enum Screen<'a> {
    Terminal(Block),
    Lines(&'a Progress),
}

/// Action of the user.
enum Action {
    Finish,
    Quit,
}

struct Live {
    views: Views,
    keep: Option<PathBuf>,
    /// Consecutive images without the board.
    without_board: u32,
    /// Last message that is not about the newest image.
    message: String,
    has_shown_hint: bool,
}

impl Live {
    fn run(&mut self, mut opener: Box<dyn CameraOpener>, screen: &mut Screen<'_>) -> Result<()> {
        let mut source = opener.open().map_err(|e| e.at(opener.describe()))?;
        let mut decoder = Decoder::new()?;
        loop {
            let Some(image) = next(source.as_mut(), &mut decoder)? else {
                return self.ended();
            };
            let offer = self.views.collector.add_image(&image)?;
            if offer.rejection.is_none() {
                self.keep(&image)?;
            }
            self.diagnose(&offer, &image)?;
            self.show(&offer, screen)?;
            if offer.hint == Hint::Enough {
                return Ok(());
            }
            match screen.action()? {
                None => {}
                Some(Action::Quit) => {
                    let what = "quit; nothing was written";
                    return Err(Error::new(ErrorKind::Interrupted, what));
                }
                Some(Action::Finish) => match self.views.collector.finish() {
                    Ok(_) => return Ok(()),
                    Err(error) => self.message = error.what().to_owned(),
                },
            }
        }
    }

    fn keep(&mut self, image: &GrayImage) -> Result<()> {
        let name = format!("view_{:03}.png", self.views.names.len());
        if let Some(folder) = &self.keep {
            save(&folder.join(&name), &encode_png_grey8(image)?)?;
        }
        self.views.names.push(name);
        Ok(())
    }

    /// Diagnoses the image if the board has been missing for long.
    fn diagnose(&mut self, offer: &AddedImage, image: &GrayImage) -> Result<()> {
        if offer.rejection != Some(Rejection::NoBoard) {
            self.without_board = 0;
            return Ok(());
        }
        self.without_board += 1;
        if self.without_board == DIAGNOSIS_IMAGES {
            self.message = diagnosed(&self.views.collector, image)?.to_string();
        }
        Ok(())
    }

    fn show(&mut self, offer: &AddedImage, screen: &mut Screen<'_>) -> Result<()> {
        let coverage = self.views.collector.coverage();
        match screen {
            Screen::Terminal(block) => block.draw(&lines(&coverage, offer, &self.message)),
            Screen::Lines(progress) => {
                if offer.rejection.is_none() || !self.has_shown_hint {
                    let (views, wanted) = (coverage.views, coverage.wanted);
                    progress.line(format!("{views} of {wanted} views; {}", offer.hint));
                }
                if !self.message.is_empty() {
                    progress.line(std::mem::take(&mut self.message));
                }
                self.has_shown_hint = true;
                Ok(())
            }
        }
    }

    /// Checks the views at the end of a recording.
    fn ended(&self) -> Result<()> {
        if self.views.names.is_empty() {
            let what = "the recording has no usable view of the board";
            return Err(Error::input(what)
                .remedy("check that the board file matches the board in the images"));
        }
        Ok(())
    }
}

/// Returns the next undamaged image; none at the end of a recording.
fn next(source: &mut dyn FrameSource, decoder: &mut Decoder) -> Result<Option<GrayImage>> {
    let mut timeouts = 0;
    loop {
        match source.next_frame(FRAME_TIMEOUT) {
            Ok(frame) => {
                // Damaged frames are skipped.
                if let Ok(image) = decoder.decode_full(&frame) {
                    return Ok(Some(grayscale(&image)));
                }
            }
            Err(CaptureError::Damaged { .. }) => {}
            Err(CaptureError::Ended) => return Ok(None),
            Err(CaptureError::Timeout) if timeouts < MAX_TIMEOUTS => timeouts += 1,
            Err(CaptureError::Failed(error)) => return Err(error),
            Err(error) => {
                return Err(Error::new(ErrorKind::Device, error.to_string())
                    .remedy("check the cable; `gripcast rig check` measures the camera"));
            }
        }
    }
}

/// Formats the block.
fn lines(coverage: &Coverage, offer: &AddedImage, message: &str) -> Vec<String> {
    let tilts: Vec<String> = Tilt::ALL
        .iter()
        .zip(coverage.tilts)
        .map(|(tilt, count)| format!("{} {count}/{}", tilt.edge(), Coverage::VIEWS_PER_TILT))
        .collect();
    let cells = |row: usize| -> String {
        let cell = |column| match coverage.is_covered(column, row) {
            true => "■ ",
            false => "□ ",
        };
        (0..coverage.cells[row].len()).map(cell).collect()
    };
    let now = match &offer.rejection {
        None => format!("accepted: {} points", offer.points),
        Some(refusal) => refusal.to_string(),
    };
    vec![
        format!(
            "{}  {} of {} views",
            cells(0),
            coverage.views,
            coverage.wanted
        ),
        format!("{}  far edge: {}", cells(1), tilts.join(", ")),
        format!(
            "{}  distances 1 to {:.2} (of {})",
            cells(2),
            coverage.distance_ratio,
            Coverage::MIN_DISTANCE_RATIO
        ),
        format!("now: {now}"),
        format!("→ {}", offer.hint),
        if message.is_empty() {
            "Enter: finish with these views, q: quit".to_owned()
        } else {
            message.to_owned()
        },
    ]
}

impl Screen<'_> {
    /// Reads the pressed keys.
    fn action(&self) -> Result<Option<Action>> {
        let Self::Terminal(block) = self else {
            return Ok(None);
        };
        let failed = |e| Error::io("cannot read the keyboard", e);
        // On a closed terminal, crossterm would never return.
        if !block.keyboard.wait(Duration::ZERO).map_err(failed)? {
            return Ok(Some(Action::Quit));
        }
        while event::poll(Duration::ZERO).map_err(failed)? {
            let Event::Key(key) = event::read().map_err(failed)? else {
                continue;
            };
            if key.kind == KeyEventKind::Release {
                continue;
            }
            let with_control = key.modifiers.contains(KeyModifiers::CONTROL);
            match key.code {
                KeyCode::Enter => return Ok(Some(Action::Finish)),
                KeyCode::Char('q' | 'Q') | KeyCode::Esc => return Ok(Some(Action::Quit)),
                KeyCode::Char('c') if with_control => return Ok(Some(Action::Quit)),
                _ => {}
            }
        }
        Ok(None)
    }
}

/// Lines on the terminal that are redrawn in place; dropping it restores the terminal.
struct Block {
    keyboard: Keyboard,
    drawn_lines: usize,
    drawn_at: Option<Instant>,
}

impl Block {
    fn new() -> Result<Self> {
        let unreadable = |e| Error::io("cannot read keys from this terminal", e);
        let keyboard = Keyboard::open().map_err(unreadable)?;
        enable_raw_mode().map_err(unreadable)?;
        Ok(Self {
            keyboard,
            drawn_lines: 0,
            drawn_at: None,
        })
    }

    fn draw(&mut self, lines: &[String]) -> Result<()> {
        if self.drawn_at.is_some_and(|at| at.elapsed() < DRAW_INTERVAL) {
            return Ok(());
        }
        self.drawn_at = Some(Instant::now());
        let width = crossterm::terminal::size().map_or(80, |(columns, _)| usize::from(columns));
        let mut text = String::new();
        if self.drawn_lines > 0 {
            text += &format!("\x1b[{}A", self.drawn_lines);
        }
        for line in lines {
            // A wrapped line would make the block grow.
            let line = Printable(line).to_string();
            let cut: String = line.chars().take(width.saturating_sub(1)).collect();
            text += &format!("\r\x1b[2K{cut}\r\n");
        }
        self.drawn_lines = lines.len();
        let mut out = io::stderr().lock();
        out.write_all(text.as_bytes())
            .and_then(|()| out.flush())
            .map_err(|e| Error::io("cannot write to the terminal", e))
    }
}

impl Drop for Block {
    fn drop(&mut self) {
        // On a closed terminal nothing can be restored.
        let _ = disable_raw_mode();
    }
}
