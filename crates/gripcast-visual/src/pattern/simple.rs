//! Patterns without a model: squares and clouds.

use super::noise::{Fractal, mix, mix_color};
use super::{PaintedSurface, paint_by_place, random_color, scaled};
use gripcast_base::random::SeedStream;

pub(super) fn checker(size_px: u32, stream: &mut SeedStream) -> PaintedSurface {
    let dark = random_color(stream, [0.0, 0.6], [0.1, 0.4]);
    let light = random_color(stream, [0.0, 0.5], [0.7, 0.95]);
    let squares = 2.0 * stream.pick([2.0_f32, 3.0, 4.0]);
    let worn = Fractal::new(stream.bits(), [6, 6], 4);
    let image = paint_by_place(size_px, |x, y| {
        let odd = ((x * squares) as u32 + (y * squares) as u32) % 2 == 1;
        let wear = mix(0.92, 1.04, worn.at(x, y));
        scaled(if odd { dark } else { light }, wear)
    });
    PaintedSurface::new(image, 0.2, stream.between(0.2, 0.7), 0.0)
}

pub(super) fn noise(size_px: u32, stream: &mut SeedStream) -> PaintedSurface {
    let colors = [(); 3].map(|()| random_color(stream, [0.1, 0.9], [0.2, 0.95]));
    let cells = stream.pick([3_u32, 5, 9]);
    let seed = stream.bits();
    let first = Fractal::new(seed, [cells; 2], 5);
    let second = Fractal::new(seed ^ 0x61, [cells + 1; 2], 5);
    let image = paint_by_place(size_px, |x, y| {
        // Away from the middle, where sums of octaves gather.
        let spread = |v: f32| (2.2 * (v - 0.5) + 0.5).clamp(0.0, 1.0);
        let mixed = mix_color(colors[0], colors[1], spread(first.at(x, y)));
        mix_color(mixed, colors[2], spread(second.at(x, y)))
    });
    PaintedSurface::new(image, 0.4, stream.between(0.3, 0.9), 0.0)
}
