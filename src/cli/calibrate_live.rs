//! Views of a board from a camera of a rig, with hints in the terminal.

use std::io::{self, IsTerminal as _, Write as _};
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use crossterm::event::{self, Event, KeyCode, KeyEventKind, KeyModifiers};
use crossterm::terminal::{disable_raw_mode, enable_raw_mode};
use image::GrayImage;
use image::imageops::grayscale;

use super::calibrate_intrinsics::{Taken, diagnosed};
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

/// Longest wait for a frame.
const FRAME_TIMEOUT: Duration = Duration::from_secs(1);
/// Waits without a frame after which the camera counts as silent.
const TIMEOUTS_BORNE: u32 = 5;
/// Images without the board after which it is looked for what is there instead.
const WITHOUT_BOARD: u32 = 90;
/// Between two drawings of the block.
const DRAW_EVERY: Duration = Duration::from_millis(100);

/// Collects views from the camera of a role until there are enough.
///
/// # Errors
/// Those of the camera; `Interrupted` where the user leaves; `Input` where a recording ends before
/// there is a view.
pub(super) fn collect(
    context: &Context,
    collector: Collector,
    rig: &str,
    role: Role,
    keep: Option<&Path>,
) -> Result<Taken> {
    let rig = RigFile::find(rig)?;
    let sources = RigSources::new(&rig, &SystemRoot::default(), &mut VirtualSource::new(1))?;
    let known: Vec<String> = rig.cameras.keys().map(|r| r.name().to_owned()).collect();
    let opener = sources.openers.into_iter().find(|o| o.role() == role);
    let opener = opener.ok_or_else(|| {
        Error::usage(format!(
            "the rig {} has no camera with the role {role}",
            rig.id
        ))
        .remedy(format!("choose one with --camera: {}", known.join(", ")))
    })?;
    if let Some(folder) = keep {
        create_folder(folder)?;
    }
    let is_terminal = !context.quiet && io::stdin().is_terminal() && io::stderr().is_terminal();
    let keep = keep.map(Path::to_owned);
    // The block takes the place of the usual progress.
    let shown = Context {
        quiet: context.quiet || is_terminal,
        ..context.clone()
    };
    let taken = interruptible(&shown, "looking for the board", move |progress| {
        let mut live = Live {
            taken: Taken {
                collector,
                names: Vec::new(),
                left_out: Vec::new(),
                lost: 0,
            },
            keep,
            without_board: 0,
            message: String::new(),
            said: None,
        };
        if is_terminal {
            let block = Block::new()?;
            live.run(opener, &mut Screen::Terminal(block))?;
        } else {
            live.run(opener, &mut Screen::Lines(progress))?;
        }
        Ok(live.taken)
    });
    if is_terminal {
        // The thread with the block may be left behind by a signal.
        let _ = disable_raw_mode();
    }
    taken?
}

/// Where hints go.
enum Screen<'a> {
    Terminal(Block),
    Lines(&'a Progress),
}

/// What the user wants.
enum Wish {
    Finish,
    Leave,
}

struct Live {
    taken: Taken,
    keep: Option<PathBuf>,
    /// Images without the board in a row.
    without_board: u32,
    /// What was said last that is not of the newest image.
    message: String,
    /// The newest line, to say nothing twice.
    said: Option<Hint>,
}

impl Live {
    fn run(&mut self, mut opener: Box<dyn CameraOpener>, screen: &mut Screen<'_>) -> Result<()> {
        let mut source = opener.open().map_err(|e| e.at(opener.describe()))?;
        let mut decoder = Decoder::new()?;
        loop {
            let Some(image) = next(source.as_mut(), &mut decoder)? else {
                return self.ended();
            };
            let offer = self.taken.collector.add_image(&image)?;
            if offer.rejection.is_none() {
                self.keep(&image)?;
            }
            self.look_again(&offer, &image)?;
            self.show(&offer, screen)?;
            if offer.hint == Hint::Enough {
                return Ok(());
            }
            match screen.wish()? {
                None => {}
                Some(Wish::Leave) => {
                    let what = "left; nothing was written";
                    return Err(Error::new(ErrorKind::Interrupted, what));
                }
                Some(Wish::Finish) => match self.taken.collector.finish() {
                    Ok(_) => return Ok(()),
                    Err(error) => self.message = error.what().to_owned(),
                },
            }
        }
    }

    fn keep(&mut self, image: &GrayImage) -> Result<()> {
        let name = format!("view_{:03}.png", self.taken.names.len());
        if let Some(folder) = &self.keep {
            let path = folder.join(&name);
            let bytes = encode_png_grey8(image)?;
            save(&path, &bytes)?;
        }
        self.taken.names.push(name);
        Ok(())
    }

    /// Says what is in the image if the board has not been there for long.
    fn look_again(&mut self, offer: &AddedImage, image: &GrayImage) -> Result<()> {
        if offer.rejection != Some(Rejection::NoBoard) {
            self.without_board = 0;
            return Ok(());
        }
        self.without_board += 1;
        if self.without_board == WITHOUT_BOARD {
            let diagnosis = diagnosed(&self.taken.collector, image)?;
            self.message = diagnosis.to_string();
        }
        Ok(())
    }

    fn show(&mut self, offer: &AddedImage, screen: &mut Screen<'_>) -> Result<()> {
        let coverage = self.taken.collector.coverage();
        match screen {
            Screen::Terminal(block) => block.draw(&lines(&coverage, offer, &self.message)),
            Screen::Lines(progress) => {
                if offer.rejection.is_none() || self.said.is_none() {
                    let (views, wanted) = (coverage.views, coverage.wanted);
                    progress.line(format!("{views} of {wanted} views; {}", offer.hint));
                }
                if !self.message.is_empty() {
                    progress.line(std::mem::take(&mut self.message));
                }
                self.said = Some(offer.hint);
                Ok(())
            }
        }
    }

    /// A recording has ended.
    fn ended(&self) -> Result<()> {
        if self.taken.names.is_empty() {
            let what = "the recording has ended without a usable view of the board";
            return Err(Error::input(what)
                .remedy("check that the board file is that of the board in the images"));
        }
        Ok(())
    }
}

/// The next whole image; none at the end of a recording.
fn next(source: &mut dyn FrameSource, decoder: &mut Decoder) -> Result<Option<GrayImage>> {
    let mut timeouts = 0;
    loop {
        match source.next_frame(FRAME_TIMEOUT) {
            Ok(frame) => {
                // A damaged frame is one view less and no reason to stop.
                if let Ok(image) = decoder.decode_full(&frame) {
                    return Ok(Some(grayscale(&image)));
                }
            }
            Err(CaptureError::Damaged { .. }) => {}
            Err(CaptureError::Ended) => return Ok(None),
            Err(CaptureError::Timeout) if timeouts < TIMEOUTS_BORNE => timeouts += 1,
            Err(CaptureError::Failed(error)) => return Err(error),
            Err(error) => {
                return Err(Error::new(ErrorKind::Device, error.to_string())
                    .remedy("check the cable; `gripcast rig check` measures the camera"));
            }
        }
    }
}

/// The block of lines that is shown.
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
        None => format!("taken: {} points", offer.points),
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
            "Enter ends with these views, q leaves".to_owned()
        } else {
            message.to_owned()
        },
    ]
}

impl Screen<'_> {
    /// What was typed since.
    fn wish(&self) -> Result<Option<Wish>> {
        let Self::Terminal(block) = self else {
            return Ok(None);
        };
        let failed = |e| Error::io("cannot read the keyboard", e);
        // On a terminal that has gone, crossterm reads for ever.
        if !block.keyboard.wait(Duration::ZERO).map_err(failed)? {
            return Ok(Some(Wish::Leave));
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
                KeyCode::Enter => return Ok(Some(Wish::Finish)),
                KeyCode::Char('q' | 'Q') | KeyCode::Esc => return Ok(Some(Wish::Leave)),
                KeyCode::Char('c') if with_control => return Ok(Some(Wish::Leave)),
                _ => {}
            }
        }
        Ok(None)
    }
}

/// Lines on the terminal that are drawn over; dropping it gives the terminal back.
struct Block {
    keyboard: Keyboard,
    drawn: usize,
    at: Option<Instant>,
}

impl Block {
    fn new() -> Result<Self> {
        let unreadable = |e| Error::io("cannot read keys from this terminal", e);
        let keyboard = Keyboard::open().map_err(unreadable)?;
        enable_raw_mode().map_err(unreadable)?;
        Ok(Self {
            keyboard,
            drawn: 0,
            at: None,
        })
    }

    fn draw(&mut self, lines: &[String]) -> Result<()> {
        if self.at.is_some_and(|at| at.elapsed() < DRAW_EVERY) {
            return Ok(());
        }
        self.at = Some(Instant::now());
        let width = crossterm::terminal::size().map_or(80, |(columns, _)| usize::from(columns));
        let mut text = String::new();
        if self.drawn > 0 {
            text += &format!("\x1b[{}A", self.drawn);
        }
        for line in lines {
            // A line that wraps would make the block grow.
            let line = Printable(line).to_string();
            let cut: String = line.chars().take(width.saturating_sub(1)).collect();
            text += &format!("\r\x1b[2K{cut}\r\n");
        }
        self.drawn = lines.len();
        let mut out = io::stderr().lock();
        out.write_all(text.as_bytes())
            .and_then(|()| out.flush())
            .map_err(|e| Error::io("cannot write to the terminal", e))
    }
}

impl Drop for Block {
    fn drop(&mut self) {
        // Nothing can be done when a terminal has gone.
        let _ = disable_raw_mode();
    }
}
