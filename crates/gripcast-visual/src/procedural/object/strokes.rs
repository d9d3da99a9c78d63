//! Random thin lines: scratches and fibres.

use std::f64::consts::TAU;

use super::super::noise::mix_colour;
use super::Layer;
use gripcast_base::random::SeedStream;

/// Line parameters; lengths in image widths. Lines wrap around the image.
pub(super) struct Strokes {
    pub(super) count: usize,
    /// Minimum and maximum length.
    pub(super) length: [f64; 2],
    /// Maximum angle to the random main direction, rad.
    pub(super) spread_rad: f64,
    /// Maximum change of direction along a line, rad.
    pub(super) bend_rad: f64,
    /// Fraction of the lines that are darker than the layer below.
    pub(super) dark: f64,
}

/// Line coverage per pixel: positive for light lines, negative for dark ones.
pub(super) struct Mask {
    size: usize,
    cover: Vec<f32>,
}

impl Mask {
    /// Draws the lines into a mask of `size_px` × `size_px` pixels.
    pub(super) fn drawn(size_px: u32, strokes: &Strokes, stream: &mut SeedStream) -> Self {
        let size = size_px.max(1) as usize;
        let mut mask = Self {
            size,
            cover: vec![0.0; size * size],
        };
        let main = stream.between(0.0, TAU);
        for _ in 0..strokes.count {
            mask.line(strokes, main, stream);
        }
        mask
    }

    fn line(&mut self, strokes: &Strokes, main: f64, stream: &mut SeedStream) {
        let size = self.size as f64;
        let [shortest, longest] = strokes.length;
        let steps = (2.0 * size * stream.between_log(shortest, longest)).max(1.0);
        let (mut x, mut y) = (stream.between(0.0, size), stream.between(0.0, size));
        let heading = main + stream.between(-strokes.spread_rad, strokes.spread_rad);
        let bend = stream.between(-strokes.bend_rad, strokes.bend_rad);
        let sign = if stream.uniform() < strokes.dark {
            -1.0
        } else {
            1.0
        };
        let strength = sign * stream.between(0.3, 1.0);
        let mut step = 0.0;
        while step < steps {
            // Both ends fade out.
            let along = step / steps;
            let pressure = (4.0 * along.min(1.0 - along)).min(1.0);
            self.dot(x, y, (strength * pressure) as f32);
            let (sin, cos) = (heading + bend * along).sin_cos();
            (x, y) = (x + 0.5 * cos, y + 0.5 * sin);
            step += 1.0;
        }
    }

    /// Splats a mark onto the four nearest pixels; the stronger mark wins.
    fn dot(&mut self, x: f64, y: f64, strength: f32) {
        let (column, row) = ((x - 0.5).floor(), (y - 0.5).floor());
        let (fx, fy) = ((x - 0.5 - column) as f32, (y - 0.5 - row) as f32);
        let wrap = |c: f64| (c as i64).rem_euclid(self.size as i64) as usize;
        for (dx, dy, fraction) in [
            (0.0, 0.0, (1.0 - fx) * (1.0 - fy)),
            (1.0, 0.0, fx * (1.0 - fy)),
            (0.0, 1.0, (1.0 - fx) * fy),
            (1.0, 1.0, fx * fy),
        ] {
            let at = wrap(row + dy) * self.size + wrap(column + dx);
            let mark = fraction * strength;
            if mark.abs() > self.cover[at].abs() {
                self.cover[at] = mark;
            }
        }
    }

    /// Layer that draws the lines in a dark and a light colour.
    pub(super) fn layer(self, dark: [f32; 3], light: [f32; 3]) -> Layer {
        let index = move |c: f32| ((c * self.size as f32) as usize).min(self.size - 1);
        Box::new(
            move |x, y, below| match self.cover[index(y) * self.size + index(x)] {
                mark if mark < 0.0 => mix_colour(below, dark, -0.9 * mark),
                mark => mix_colour(below, light, 0.9 * mark),
            },
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lines_wrap_and_have_both_signs() {
        let strokes = Strokes {
            count: 20,
            length: [0.5, 0.9],
            spread_rad: 3.0,
            bend_rad: 0.3,
            dark: 0.5,
        };
        let mut stream = SeedStream::named(1, "strokes");
        let mask = Mask::drawn(64, &strokes, &mut stream);
        let marks = |sign: f32| mask.cover.iter().filter(|m| **m * sign > 0.1).count();
        assert!(marks(1.0) > 50 && marks(-1.0) > 50);
        assert!(mask.cover.iter().all(|m| m.abs() <= 1.0));
        // As many marks near the border as elsewhere.
        let border = (0..64).filter(|&i| mask.cover[i * 64].abs() > 0.05).count();
        assert!(border > 2, "{border}");
    }
}
