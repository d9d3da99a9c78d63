//! Colours of the screen, adapted to the terminal.

use ratatui::style::{Color, Modifier, Style};

/// Colour depth of the terminal.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ColourDepth {
    /// 24-bit colour.
    True,
    /// The 256 colours of xterm.
    Indexed,
    /// No colour; images are drawn with characters.
    Mono,
}

impl ColourDepth {
    /// Reads `NO_COLOR`, `COLORTERM` and `TERM` through `variable`.
    ///
    /// ```
    /// use gripcast::tui::ColourDepth;
    /// let depth = ColourDepth::from_environment(|name| std::env::var(name).ok());
    /// # let _ = depth;
    /// ```
    pub fn from_environment(variable: impl Fn(&str) -> Option<String>) -> Self {
        let set = |name: &str| variable(name).filter(|value| !value.is_empty());
        if set("NO_COLOR").is_some() {
            return Self::Mono;
        }
        if matches!(set("COLORTERM").as_deref(), Some("truecolor" | "24bit")) {
            return Self::True;
        }
        match set("TERM").as_deref() {
            None | Some("dumb" | "vt100" | "vt220") => Self::Mono,
            Some(_) => Self::Indexed,
        }
    }

    /// Returns the nearest available colour; `None` without colours.
    pub(super) fn colour(self, [r, g, b]: [u8; 3]) -> Option<Color> {
        match self {
            Self::True => Some(Color::Rgb(r, g, b)),
            Self::Indexed => Some(Color::Indexed(xterm_index([r, g, b]))),
            Self::Mono => None,
        }
    }
}

/// Returns the index of the nearest colour in xterm's 6×6×6 cube or grey ramp.
fn xterm_index(rgb: [u8; 3]) -> u8 {
    const LEVELS: [u8; 6] = [0, 95, 135, 175, 215, 255];
    let distance = |other: [u8; 3]| -> u32 {
        rgb.iter()
            .zip(other)
            .map(|(&a, b)| u32::from(a.abs_diff(b)).pow(2))
            .sum()
    };
    let level = |value: u8| {
        (0..LEVELS.len())
            .min_by_key(|&i| LEVELS[i].abs_diff(value))
            .unwrap_or(0)
    };
    let [r, g, b] = rgb.map(level);
    let cube = distance([LEVELS[r], LEVELS[g], LEVELS[b]]);
    let mean = rgb.iter().map(|&v| u32::from(v)).sum::<u32>() / 3;
    let step = (mean.saturating_sub(3) / 10).min(23) as u8;
    let grey = 8 + 10 * step;
    if distance([grey; 3]) < cube {
        232 + step
    } else {
        (16 + 36 * r + 6 * g + b) as u8
    }
}

/// Styles by meaning. Colour is never the only carrier of meaning.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Palette {
    /// Colour depth of the terminal.
    pub depth: ColourDepth,
}

const GREEN: [u8; 3] = [60, 215, 110];
const RED: [u8; 3] = [255, 85, 75];
const AMBER: [u8; 3] = [255, 190, 50];
const BLUE: [u8; 3] = [70, 150, 255];
const CYAN: [u8; 3] = [60, 205, 215];
const SKY: [u8; 3] = [40, 125, 225];
const ORANGE: [u8; 3] = [205, 100, 20];
const GREY: [u8; 3] = [135, 135, 145];
const DARK: [u8; 3] = [60, 62, 72];
const BLACK: [u8; 3] = [0, 0, 0];
const WHITE: [u8; 3] = [255, 255, 255];
const DEEP_RED: [u8; 3] = [175, 0, 0];

impl Palette {
    fn text(self, rgb: [u8; 3]) -> Style {
        let style = Style::new();
        self.depth.colour(rgb).map_or(style, |c| style.fg(c))
    }

    fn block(self, foreground: [u8; 3], background: [u8; 3]) -> Style {
        let bold = Style::new().add_modifier(Modifier::BOLD);
        match (self.depth.colour(foreground), self.depth.colour(background)) {
            (Some(fg), Some(bg)) => bold.fg(fg).bg(bg),
            _ => bold.add_modifier(Modifier::REVERSED),
        }
    }

    pub(super) fn stable(self) -> Style {
        self.text(GREEN).add_modifier(Modifier::BOLD)
    }

    pub(super) fn slip(self) -> Style {
        self.text(RED).add_modifier(Modifier::BOLD)
    }

    pub(super) fn warning(self) -> Style {
        self.text(AMBER).add_modifier(Modifier::BOLD)
    }

    /// Returns the warning style if `is_warning`, else `style`.
    pub(super) fn warning_if(self, is_warning: bool, style: Style) -> Style {
        if is_warning { self.warning() } else { style }
    }

    /// Secondary text, readable on dark and light backgrounds.
    pub(super) fn faint(self) -> Style {
        match self.depth {
            ColourDepth::Mono => Style::new().add_modifier(Modifier::DIM),
            _ => self.text(GREY),
        }
    }

    /// The empty part of a bar.
    pub(super) fn trough(self) -> Style {
        self.text(DARK)
    }

    /// Returns the symbol of the empty part of a bar; without colours it differs from `full`.
    pub(super) fn empty(self, full: &'static str) -> &'static str {
        match self.depth {
            ColourDepth::Mono => "·",
            _ => full,
        }
    }

    pub(super) fn strong(self) -> Style {
        Style::new().add_modifier(Modifier::BOLD)
    }

    pub(super) fn key(self) -> Style {
        self.text(CYAN).add_modifier(Modifier::BOLD)
    }

    /// First curve of a chart, legible on black and on white.
    pub(super) fn first_curve(self) -> Style {
        self.text(SKY)
    }

    /// Second curve of a chart, legible on black and on white.
    pub(super) fn second_curve(self) -> Style {
        self.text(ORANGE)
    }

    pub(super) fn initial_step(self) -> Style {
        self.block(BLACK, CYAN)
    }

    pub(super) fn grasp_step(self) -> Style {
        self.block(WHITE, [25, 95, 200])
    }

    pub(super) fn label_step(self) -> Style {
        self.block(BLACK, AMBER)
    }

    pub(super) fn busy_step(self) -> Style {
        self.block(WHITE, DARK)
    }

    pub(super) fn refusal(self) -> Style {
        self.block(BLACK, [255, 140, 30])
    }

    pub(super) fn fault(self) -> Style {
        self.block(WHITE, DEEP_RED)
    }

    pub(super) fn entry(self) -> Style {
        self.block(WHITE, BLUE.map(|v| v / 2))
    }

    pub(super) fn panel(self) -> Style {
        match self.depth {
            ColourDepth::Mono => Style::new(),
            _ => self
                .block(WHITE, [30, 32, 40])
                .remove_modifier(Modifier::BOLD),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn depth(pairs: &[(&str, &str)]) -> ColourDepth {
        ColourDepth::from_environment(|name| {
            pairs
                .iter()
                .find(|(key, _)| *key == name)
                .map(|(_, value)| (*value).to_owned())
        })
    }

    #[test]
    fn colour_depth_follows_the_environment() {
        let xterm = ("TERM", "xterm-256color");
        assert_eq!(depth(&[xterm]), ColourDepth::Indexed);
        assert_eq!(
            depth(&[xterm, ("COLORTERM", "truecolor")]),
            ColourDepth::True
        );
        assert_eq!(
            depth(&[xterm, ("COLORTERM", "24bit"), ("NO_COLOR", "1")]),
            ColourDepth::Mono
        );
        assert_eq!(depth(&[xterm, ("NO_COLOR", "")]), ColourDepth::Indexed);
        assert_eq!(depth(&[("TERM", "dumb")]), ColourDepth::Mono);
        assert_eq!(depth(&[]), ColourDepth::Mono);
    }

    #[test]
    fn nearest_xterm_colour_is_chosen() {
        assert_eq!(xterm_index([0, 0, 0]), 16);
        assert_eq!(xterm_index([255, 255, 255]), 231);
        assert_eq!(xterm_index([255, 0, 0]), 196);
        assert_eq!(xterm_index([128, 128, 128]), 244);
    }

    #[test]
    fn curves_are_legible_on_black_and_on_white() {
        let light = |v: u8| f64::from(v).powf(2.2) / 255_f64.powf(2.2);
        for [r, g, b] in [SKY, ORANGE, GREY] {
            let luminance = 0.2126 * light(r) + 0.7152 * light(g) + 0.0722 * light(b);
            let (on_white, on_black) = (1.05 / (luminance + 0.05), (luminance + 0.05) / 0.05);
            assert!(on_white > 3.0 && on_black > 3.0, "{on_white} {on_black}");
        }
    }

    #[test]
    fn without_colours_no_style_has_one() {
        let palette = Palette {
            depth: ColourDepth::Mono,
        };
        for style in [
            palette.stable(),
            palette.slip(),
            palette.fault(),
            palette.label_step(),
            palette.panel(),
            palette.faint(),
            palette.first_curve(),
        ] {
            assert_eq!((style.fg, style.bg), (None, None));
        }
    }
}
