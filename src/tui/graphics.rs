//! Images through the graphics protocol of the terminal: kitty, iTerm2 or sixel.
//!
//! The terminal is asked once, before its keys are read; one that does not answer shows half
//! blocks. Inside tmux only tmux itself is asked: it draws sixel if it was built with it.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;
use std::time::{Duration, Instant};

use image::imageops::FilterType;
use image::{DynamicImage, RgbImage};
use ratatui::buffer::Buffer;
use ratatui::layout::{Rect, Size};
use ratatui::widgets::Widget as _;
use ratatui_image::protocol::Protocol;
use ratatui_image::protocol::iterm2::Iterm2;
use ratatui_image::protocol::kitty::Kitty;
use ratatui_image::protocol::sixel::Sixel;

use super::preview::fitted_to_cells;

/// How camera images are drawn.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, clap::ValueEnum)]
pub enum Graphics {
    /// Graphics protocol of the terminal if it has one, else half blocks
    #[default]
    Auto,
    /// Kitty graphics protocol
    Kitty,
    /// Inline images of iTerm2
    Iterm2,
    /// Sixel
    Sixel,
    /// Half blocks: two pixels per character
    Blocks,
}

/// Graphics protocol.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum GraphicsProtocol {
    Kitty,
    Iterm2,
    Sixel,
}

/// Size of a cell assumed if the terminal does not report it, pixels.
const DEFAULT_CELL: (u16, u16) = (8, 16);
/// Time for encoding within one drawing; keys wait for it.
const ENCODING_TIME: Duration = Duration::from_millis(30);
/// Minimum interval between two encodings of an image, locally and over SSH, whose images take
/// hundreds of kB.
const INTERVALS: [Duration; 2] = [Duration::from_millis(150), Duration::from_secs(1)];

/// Question to the terminal: kitty graphics, name, size of a cell, and last the device attributes,
/// which every terminal answers.
pub(super) const QUESTION: &str =
    "\x1b_Gi=4242,s=1,v=1,a=q,t=d,f=24;AAAA\x1b\\\x1b[>q\x1b[16t\x1b[c";

/// What a terminal answered.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub(super) struct Answer {
    has_kitty: bool,
    has_sixel: bool,
    name: String,
    cell: Option<(u16, u16)>,
    /// Whether the device attributes were answered, which come last.
    pub(super) is_complete: bool,
}

impl Answer {
    /// Reads the answers in `bytes`, which may have other input between them.
    pub(super) fn parse(bytes: &[u8]) -> Self {
        let text = String::from_utf8_lossy(bytes);
        let mut answer = Self::default();
        for sequence in text.split('\x1b').skip(1) {
            if let Some(kitty) = sequence.strip_prefix("_Gi=4242;") {
                answer.has_kitty = kitty.starts_with("OK");
            } else if let Some(name) = sequence.strip_prefix("P>|") {
                name.clone_into(&mut answer.name);
            } else if let Some(rest) = sequence.strip_prefix("[6;") {
                answer.cell = rest.split_once('t').and_then(|(size, _)| cell_size(size));
            } else if let Some(rest) = sequence.strip_prefix("[?")
                && let Some((attributes, _)) = rest.split_once('c')
            {
                answer.has_sixel = attributes.split(';').skip(1).any(|a| a == "4");
                answer.is_complete = true;
            }
        }
        answer
    }

    /// Returns the protocol that the terminal draws correctly.
    fn protocol(&self) -> Option<GraphicsProtocol> {
        let is = |name: &str| self.name.starts_with(name);
        // WezTerm and Konsole answer for kitty but do not draw its placeholders.
        if is("iTerm2") || is("WezTerm") || is("Konsole") || is("mintty") {
            return Some(GraphicsProtocol::Iterm2);
        }
        match (self.has_kitty, self.has_sixel) {
            (true, _) => Some(GraphicsProtocol::Kitty),
            (false, true) => Some(GraphicsProtocol::Sixel),
            (false, false) => None,
        }
    }
}

/// Parses `HEIGHT;WIDTH`.
fn cell_size(text: &str) -> Option<(u16, u16)> {
    let (height, width) = text.split_once(';')?;
    let size: (u16, u16) = (width.parse().ok()?, height.parse().ok()?);
    (size.0 > 0 && size.1 > 0).then_some(size)
}

/// Returns whether a terminal may be asked: some print what they do not know.
pub(super) fn can_be_asked(variable: impl Fn(&str) -> Option<String>) -> bool {
    let term = variable("TERM").unwrap_or_default();
    !(term.is_empty()
        || ["dumb", "linux", "vt"]
            .iter()
            .any(|name| term.starts_with(name)))
}

/// The images of the screen in the terminal's protocol.
pub(super) struct TerminalGraphics {
    protocol: GraphicsProtocol,
    /// Width and height of a cell, pixels.
    cell: (u16, u16),
    interval: Duration,
    images: BTreeMap<u32, EncodedImage>,
    /// Until when images of this drawing may be encoded.
    encode_until: Option<Instant>,
    /// Images that the last and this drawing had no time for.
    late: [BTreeSet<u32>; 2],
}

struct EncodedImage {
    /// Source, kept so that its address stays unique.
    source: Arc<RgbImage>,
    at: Instant,
    size: Size,
    encoded: Protocol,
}

impl TerminalGraphics {
    /// Returns the images of a terminal that answered `answer`, or `None` for half blocks.
    pub(super) fn new(choice: Graphics, answer: &Answer, is_remote: bool) -> Option<Self> {
        let protocol = match choice {
            Graphics::Auto => answer.protocol()?,
            Graphics::Kitty => GraphicsProtocol::Kitty,
            Graphics::Iterm2 => GraphicsProtocol::Iterm2,
            Graphics::Sixel => GraphicsProtocol::Sixel,
            Graphics::Blocks => return None,
        };
        Some(Self {
            protocol,
            cell: answer.cell.or_else(reported_cell).unwrap_or(DEFAULT_CELL),
            interval: INTERVALS[usize::from(is_remote)],
            images: BTreeMap::new(),
            encode_until: None,
            late: Default::default(),
        })
    }

    /// Returns the protocol.
    pub(super) fn protocol(&self) -> GraphicsProtocol {
        self.protocol
    }

    /// Adapts to a changed size of the terminal or of its font.
    pub(super) fn resize(&mut self) {
        self.cell = reported_cell().unwrap_or(self.cell);
        self.images.clear();
    }

    /// Starts a drawing.
    pub(super) fn start(&mut self, now: Instant) {
        self.encode_until = Some(now + ENCODING_TIME);
        self.late.swap(0, 1);
        self.late[1].clear();
    }

    /// Draws `image` at the top left of `area`, or its latest version that is encoded; returns
    /// false if there is none of this size.
    pub(super) fn draw(
        &mut self,
        buffer: &mut Buffer,
        area: Rect,
        id: u32,
        image: &Arc<RgbImage>,
    ) -> bool {
        let cell = (f64::from(self.cell.0), f64::from(self.cell.1));
        let fitted = fitted_to_cells(image.dimensions(), area.width, area.height, cell);
        let size = Size::new(fitted.width, fitted.height);
        let drawn = self.images.get(&id).filter(|drawn| drawn.size == size);
        let now = Instant::now();
        let is_due = drawn.is_none_or(|drawn| {
            !Arc::ptr_eq(&drawn.source, image)
                && now.saturating_duration_since(drawn.at) >= self.interval
        });
        if is_due && self.may_encode(id, now) {
            // An image that cannot be encoded is drawn with half blocks.
            if let Some(encoded) = self.encode(image, size, id) {
                let source = Arc::clone(image);
                self.images.insert(
                    id,
                    EncodedImage {
                        source,
                        at: now,
                        size,
                        encoded,
                    },
                );
            }
        }
        let Some(drawn) = self.images.get(&id).filter(|drawn| drawn.size == size) else {
            return false;
        };
        let at = Rect {
            width: size.width,
            height: size.height,
            ..area
        };
        ratatui_image::Image::new(&drawn.encoded).render(at, buffer);
        true
    }

    /// Returns whether there is time to encode an image; those that were late come first.
    fn may_encode(&mut self, id: u32, now: Instant) -> bool {
        let [earlier, late] = &mut self.late;
        let is_turn = earlier.is_empty() || earlier.remove(&id);
        if is_turn && self.encode_until.is_some_and(|until| now < until) {
            return true;
        }
        late.insert(id);
        false
    }

    fn encode(&self, image: &RgbImage, size: Size, id: u32) -> Option<Protocol> {
        let width = u32::from(size.width) * u32::from(self.cell.0);
        let height = u32::from(size.height) * u32::from(self.cell.1);
        let scaled = image::imageops::resize(image, width, height, FilterType::Triangle);
        let scaled = DynamicImage::ImageRgb8(scaled);
        match self.protocol {
            GraphicsProtocol::Kitty => Kitty::new(scaled, size, id, false, true)
                .map(Protocol::Kitty)
                .ok(),
            GraphicsProtocol::Iterm2 => Iterm2::new(scaled, size, false).map(Protocol::ITerm2).ok(),
            GraphicsProtocol::Sixel => Sixel::new(scaled, size, false).map(Protocol::Sixel).ok(),
        }
    }
}

/// Returns the size of a cell that the operating system reports, pixels.
fn reported_cell() -> Option<(u16, u16)> {
    let window = crossterm::terminal::window_size().ok()?;
    let width = window.width.checked_div(window.columns)?;
    let height = window.height.checked_div(window.rows)?;
    (width > 0 && height > 0).then_some((width, height))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Answers to [`QUESTION`] as the terminals give them.
    const ANSWERS: [(&str, &str, Option<GraphicsProtocol>); 9] = [
        (
            "kitty",
            "\x1b_Gi=4242;OK\x1b\\\x1bP>|kitty(0.35.2)\x1b\\\x1b[6;20;10t\x1b[?62;c",
            Some(GraphicsProtocol::Kitty),
        ),
        (
            "foot",
            "\x1bP>|foot(1.16.2)\x1b\\\x1b[6;18;9t\x1b[?62;4;22c",
            Some(GraphicsProtocol::Sixel),
        ),
        (
            "WezTerm",
            "\x1b_Gi=4242;OK\x1b\\\x1bP>|WezTerm 20240203\x1b\\\x1b[6;16;8t\x1b[?65;4;6;18;22c",
            Some(GraphicsProtocol::Iterm2),
        ),
        (
            "Konsole",
            "\x1b_Gi=4242;OK\x1b\\\x1bP>|Konsole 23.08\x1b\\\x1b[?62;1;4c",
            Some(GraphicsProtocol::Iterm2),
        ),
        (
            "iTerm2",
            "\x1bP>|iTerm2 3.5.0\x1b\\\x1b[6;16;7t\x1b[?64;1;2;4;6;17c",
            Some(GraphicsProtocol::Iterm2),
        ),
        ("tmux", "\x1bP>|tmux 3.3a\x1b\\\x1b[?1;2c", None),
        (
            "tmux with sixel",
            "\x1bP>|tmux 3.4\x1b\\\x1b[6;16;8t\x1b[?1;2;4c",
            Some(GraphicsProtocol::Sixel),
        ),
        (
            "VTE",
            "\x1bP>|VTE(7600)\x1b\\\x1b[6;18;8t\x1b[?65;1;9c",
            None,
        ),
        ("xterm", "sif\x1b[?64;1;2;6;9;15;16;17;18;21;22;28cx", None),
    ];

    #[test]
    fn terminals_are_recognised_by_their_answers() {
        for (name, text, protocol) in ANSWERS {
            let answer = Answer::parse(text.as_bytes());
            assert!(answer.is_complete, "{name}");
            assert_eq!(answer.protocol(), protocol, "{name}");
        }
        let kitty = Answer::parse(ANSWERS[0].1.as_bytes());
        assert_eq!(kitty.cell, Some((10, 20)));
        for bytes in [
            &b""[..],
            b"\x1b",
            b"\x1b[?",
            b"\xff\xfe\x1b[6;0;0t",
            b"\x1b_Gi=4242;EINVAL",
        ] {
            assert_eq!(Answer::parse(bytes).protocol(), None);
            assert!(!Answer::parse(bytes).is_complete);
        }
    }

    #[test]
    fn consoles_that_print_questions_are_not_asked() {
        let asked = |term: &str| can_be_asked(|_| Some(term.to_owned()));
        assert!(asked("xterm-256color") && asked("tmux-256color") && asked("xterm-kitty"));
        assert!(!asked("linux") && !asked("dumb") && !asked("vt100") && !asked(""));
    }

    fn graphics(choice: Graphics) -> TerminalGraphics {
        let mut graphics = TerminalGraphics::new(choice, &Answer::default(), false).unwrap();
        graphics.cell = (8, 16);
        graphics.start(Instant::now() + Duration::from_secs(600));
        graphics
    }

    #[test]
    fn image_fills_cells_in_each_protocol() {
        let image = Arc::new(RgbImage::from_pixel(32, 24, image::Rgb([200, 10, 30])));
        let area = Rect::new(2, 1, 20, 6);
        for (choice, start) in [
            (Graphics::Kitty, "\x1b_Gq=2,i=7,a=T,U=1,"),
            (Graphics::Iterm2, "\x1b]1337;File=inline=1;"),
            (Graphics::Sixel, "\x1bP"),
        ] {
            let mut buffer = Buffer::empty(Rect::new(0, 0, 30, 10));
            assert!(
                graphics(choice).draw(&mut buffer, area, 7, &image),
                "{choice:?}"
            );
            assert!(buffer[(2, 1)].symbol().contains(start), "{choice:?}");
            // 16 × 6 cells of 8 × 16 pixels are 4:3.
            assert_eq!(buffer[(18, 1)], ratatui::buffer::Cell::EMPTY, "{choice:?}");
        }
    }

    #[test]
    fn image_is_encoded_when_it_changes_and_there_is_time() {
        let image = |level| Arc::new(RgbImage::from_pixel(32, 24, image::Rgb([level; 3])));
        let (first, second) = (image(10), image(20));
        let area = Rect::new(0, 0, 20, 6);
        let mut graphics = graphics(Graphics::Iterm2);
        let drawn = |graphics: &mut TerminalGraphics, image, id| {
            let mut buffer = Buffer::empty(area);
            let is_drawn = graphics.draw(&mut buffer, area, id, image);
            is_drawn.then(|| buffer[(0, 0)].symbol().to_owned())
        };
        let before = drawn(&mut graphics, &first, 1).unwrap();
        graphics.interval = Duration::ZERO;
        assert_ne!(drawn(&mut graphics, &second, 1).unwrap(), before);
        // Without time the older image stays; images that were late come first.
        graphics.encode_until = None;
        assert!(drawn(&mut graphics, &first, 1).is_some());
        assert_eq!(drawn(&mut graphics, &first, 2), None);
        graphics.start(Instant::now() + Duration::from_secs(600));
        assert_eq!(drawn(&mut graphics, &first, 3), None);
        assert!(drawn(&mut graphics, &first, 2).is_some());
    }

    #[test]
    fn half_blocks_need_no_graphics() {
        let kitty = Answer::parse(ANSWERS[0].1.as_bytes());
        assert!(TerminalGraphics::new(Graphics::Blocks, &kitty, false).is_none());
        assert!(TerminalGraphics::new(Graphics::Auto, &Answer::default(), false).is_none());
    }
}
