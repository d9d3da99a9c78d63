//! Coats: the whole surface of an object painted around the base colour of its [`Look`].

mod ground;
mod motif;
mod palette;
mod strokes;
mod wear;

use super::{PaintedSurface, light_by_place};
use crate::linear_image::{Image, luminance};
use crate::look::FinishClass as Finish;
use crate::look::Look;
use crate::look::PatternWord as Word;
use gripcast_base::random::SeedStream;

use palette::BRIGHTEST;

/// A step of painting: the linear colour at a place of the unit square from the colour below.
type Layer = Box<dyn Fn(f32, f32, [f32; 3]) -> [f32; 3] + Sync>;

/// Metal that is left between spots of rust.
const RUSTY_METALLIC: f32 = 0.6;

/// Paints a coat, `size_px` × `size_px` pixels that tile; the same arguments give the same bytes.
/// Its mean luminance is that of the base colour, but for print and rust.
pub(crate) fn paint(look: &Look, size_px: u32, seed: u64) -> PaintedSurface {
    let mut stream = SeedStream::named(seed, "coat");
    let layers = layers(look, size_px, &mut stream);
    let mut image = light_by_place(size_px, |x, y| {
        let paint = |below: [f32; 3], layer: &Layer| layer(x, y, below);
        layers.iter().fold(look.base_colour, paint)
    });
    if !look.is_print() && look.pattern != Word::Rusty {
        balance(&mut image, luminance(look.base_colour));
    }
    PaintedSurface {
        image: image.to_srgb8(1.0),
        tile_m: tile_m(look),
        roughness: roughness(look),
        metallic: match (look.finish, look.pattern) {
            (Finish::Metal, Word::Rusty) => RUSTY_METALLIC,
            (Finish::Metal, _) => 1.0,
            _ => 0.0,
        },
    }
}

/// From the bottom to the top.
fn layers(look: &Look, size_px: u32, stream: &mut SeedStream) -> Vec<Layer> {
    let ground = ground::layer(look, stream);
    let motif = motif::layer(look, size_px, stream);
    let print = look
        .is_print()
        .then(|| motif::printed(look.base_colour, size_px, stream));
    let wear = wear::layer(look, size_px, stream);
    let below = if look.finish == Finish::Fabric {
        // Colours are in the threads, whose relief shades them.
        [motif, Some(ground)]
    } else {
        [Some(ground), motif]
    };
    below.into_iter().chain([print, wear]).flatten().collect()
}

/// Scales an image so that its mean luminance is as wanted, as far as no pixel gets brighter
/// than bright paint.
fn balance(image: &mut Image, wanted: f32) {
    // What is cut off at the top is missing in the mean: the second pass makes up for it.
    for _ in 0..2 {
        let mean = luminance(image.mean().map(|c| c as f32));
        if mean <= 0.0 {
            return;
        }
        let gain = wanted / mean;
        for pixel in &mut image.pixels {
            *pixel = pixel.map(|c| (c * gain).min(BRIGHTEST));
        }
    }
}

/// Width of the painted square on the surface, m; chosen so that grain, threads and grooves have
/// their usual size on an object of some centimetres.
fn tile_m(look: &Look) -> f64 {
    match (look.finish, look.pattern) {
        (Finish::Wood, _) | (_, Word::Grain) => 0.10,
        (Finish::Fabric, _) | (_, Word::Woven | Word::Knitted) => 0.05,
        (Finish::Stone, Word::Marbled) => 0.16,
        (Finish::Rubber, _) => 0.06,
        (Finish::Metal | Finish::Organic, _) => 0.07,
        (Finish::Stone, _) => 0.12,
        _ => 0.09,
    }
}

/// Wear takes the gloss away.
fn roughness(look: &Look) -> f32 {
    let least = match look.pattern {
        Word::Scratched => 0.15,
        Word::Worn => 0.25,
        Word::Rusty => 0.5,
        _ => 0.0,
    };
    look.roughness.max(least)
}

#[cfg(test)]
#[path = "coat_test.rs"]
mod tests;
