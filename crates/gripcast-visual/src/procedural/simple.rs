//! Checkerboard and random clouds.

use super::noise::{FractalNoise, mix, mix_colour};
use super::{GeneratedTexture, random_colour, scaled, texture_from_fn};
use gripcast_base::random::SeedStream;

pub(super) fn checker(size_px: u32, stream: &mut SeedStream) -> GeneratedTexture {
    let dark = random_colour(stream, [0.0, 0.6], [0.1, 0.4]);
    let light = random_colour(stream, [0.0, 0.5], [0.7, 0.95]);
    let squares = 2.0 * stream.pick([2.0_f32, 3.0, 4.0]);
    let worn = FractalNoise::new(stream.bits(), [6, 6], 4);
    let image = texture_from_fn(size_px, |x, y| {
        let odd = ((x * squares) as u32 + (y * squares) as u32) % 2 == 1;
        let wear = mix(0.92, 1.04, worn.at(x, y));
        scaled(if odd { dark } else { light }, wear)
    });
    GeneratedTexture::new(image, 0.2, stream.between(0.2, 0.7), 0.0)
}

pub(super) fn noise(size_px: u32, stream: &mut SeedStream) -> GeneratedTexture {
    let colors = [(); 3].map(|()| random_colour(stream, [0.1, 0.9], [0.2, 0.95]));
    let cells = stream.pick([3_u32, 5, 9]);
    let seed = stream.bits();
    let first = FractalNoise::new(seed, [cells; 2], 5);
    let second = FractalNoise::new(seed ^ 0x61, [cells + 1; 2], 5);
    let image = texture_from_fn(size_px, |x, y| {
        // Increases the contrast: sums of octaves cluster around the middle.
        let spread = |v: f32| (2.2 * (v - 0.5) + 0.5).clamp(0.0, 1.0);
        let mixed = mix_colour(colors[0], colors[1], spread(first.at(x, y)));
        mix_colour(mixed, colors[2], spread(second.at(x, y)))
    });
    GeneratedTexture::new(image, 0.4, stream.between(0.3, 0.9), 0.0)
}
