//! Printed carton: colour fields, a badge, lines of text, a bar code.

use super::noise::{FractalNoise, mix, mix_colour};
use super::{GeneratedTexture, random_colour, scaled, srgb, texture_from_fn};
use gripcast_base::random::{SeedStream, lattice};

/// Bare paper.
const PAPER: u32 = 0xf4f2ec;
/// Black ink.
const INK: u32 = 0x1d1d22;

/// Ink colours of a label.
#[derive(Clone, Copy)]
pub(super) struct Inks {
    pub text: [f32; 3],
    pub(super) field: [f32; 3],
    pub(super) badge: [f32; 3],
}

/// Layout of a label; positions and sizes in the unit square.
pub(super) struct Label {
    ground: [f32; 3],
    pub(super) inks: Inks,
    /// Lower and upper edge of the colour band.
    band: [f32; 2],
    /// Centre and radius of the badge.
    disc: [f32; 3],
    /// Left, top, right, bottom of the text block, and the line height.
    text: [f32; 5],
    /// Left, top, right, bottom of the bar code.
    bars: [f32; 4],
    seed: u64,
    paper: FractalNoise,
}

pub(super) fn generate(size_px: u32, stream: &mut SeedStream) -> GeneratedTexture {
    let label = Label::random(stream);
    GeneratedTexture::new(
        texture_from_fn(size_px, |x, y| {
            scaled(label.ink(x, y, label.ground), label.paper(x, y))
        }),
        0.08,
        stream.between(0.25, 0.6),
        0.0,
    )
}

impl Label {
    pub(super) fn random(stream: &mut SeedStream) -> Self {
        let is_white = stream.uniform() < 0.4;
        let ground = if is_white {
            srgb(0xf1efe9)
        } else {
            random_colour(stream, [0.3, 0.85], [0.6, 0.95])
        };
        let top = stream.between(0.1, 0.4) as f32;
        let mut between = |low: f64, high: f64| stream.between(low, high) as f32;
        let disc = [between(0.25, 0.75), between(0.25, 0.45), between(0.1, 0.2)];
        let left = between(0.06, 0.2);
        let text = [
            left,
            between(0.6, 0.68),
            between(0.5, 0.66),
            0.92,
            between(0.018, 0.03),
        ];
        let bars = [0.72, between(0.72, 0.8), 0.93, 0.92];
        let inks = Inks {
            text: srgb(INK),
            field: random_colour(stream, [0.5, 0.95], [0.35, 0.95]),
            badge: random_colour(stream, [0.4, 0.95], [0.5, 1.0]),
        };
        let band = [top, top + stream.between(0.12, 0.3) as f32];
        let seed = stream.bits();
        Self {
            ground,
            inks,
            band,
            disc,
            text,
            bars,
            seed,
            paper: FractalNoise::new(seed, [24, 24], 3),
        }
    }

    /// Factor of the paper texture.
    pub(super) fn paper(&self, x: f32, y: f32) -> f32 {
        mix(0.95, 1.02, self.paper.at(x, y))
    }

    /// Colour of the label on a ground colour, without paper texture.
    pub(super) fn ink(&self, x: f32, y: f32, ground: [f32; 3]) -> [f32; 3] {
        let mut colour = ground;
        if (self.band[0]..self.band[1]).contains(&y) {
            colour = self.inks.field;
        }
        let [cx, cy, radius] = self.disc;
        let from_centre = (x - cx).hypot(y - cy) / radius;
        if from_centre < 1.0 {
            colour = if from_centre > 0.86 {
                srgb(PAPER)
            } else {
                self.inks.badge
            };
        }
        match self.is_bar(x, y) {
            Some(true) => colour = mix_colour(colour, srgb(INK), 0.93),
            _ if self.is_text(x, y) => colour = mix_colour(colour, self.inks.text, 0.93),
            Some(false) => colour = srgb(PAPER),
            None => {}
        }
        colour
    }

    /// Whether a position is inked text: words of letters made of strokes.
    fn is_text(&self, x: f32, y: f32) -> bool {
        let [left, top, right, bottom, height] = self.text;
        if !(left..right).contains(&x) || !(top..bottom).contains(&y) {
            return false;
        }
        let line = (y - top) / (1.9 * height);
        if line.fract() > 0.53 {
            return false;
        }
        let line = line as i64;
        let letter = ((x - left) / (0.55 * height)) as i64;
        let is_space = lattice(self.seed, letter, line, 1) < 0.17;
        // Three by five strokes per letter.
        let column = ((x - left) / (0.55 * height) * 3.6).fract();
        let stroke = ((x - left) / (0.55 * height) * 3.0) as i64;
        let row = (((y - top) / (1.9 * height)).fract() / 0.53 * 5.0) as i64;
        !is_space && column > 0.1 && lattice(self.seed, stroke, 5 * line + row, 2) < 0.55
    }

    /// Whether a position of the bar code is inked; `None` outside of it.
    fn is_bar(&self, x: f32, y: f32) -> Option<bool> {
        let [left, top, right, bottom] = self.bars;
        let margin = 0.012;
        let inside = (left - margin..right + margin).contains(&x)
            && (top - margin..bottom + margin).contains(&y);
        inside.then(|| {
            let bar = ((x - left) * 280.0) as i64;
            (left..right).contains(&x)
                && (top..bottom).contains(&y)
                && lattice(self.seed, bar, 0, 3) < 0.5
        })
    }
}
