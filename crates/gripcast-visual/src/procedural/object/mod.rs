//! Coats: the whole surface of an object painted around the base colour of its [`Appearance`].

mod base;
mod palette;
mod pattern;
mod strokes;
mod wear;

use super::{GeneratedTexture, linear_from_fn};
use crate::appearance::Appearance;
use crate::appearance::FinishClass as Finish;
use crate::appearance::SurfacePattern as Pattern;
use crate::linear_image::{Image, luminance};
use gripcast_base::random::SeedStream;

use palette::MAX_REFLECTANCE;

/// A step of painting: the linear colour at a place of the unit square from the colour below.
type Layer = Box<dyn Fn(f32, f32, [f32; 3]) -> [f32; 3] + Sync>;

/// Metal that is left between spots of rust.
const RUSTY_METALLIC: f32 = 0.6;

/// Paints a object, `size_px` × `size_px` pixels that tile; the same arguments give the same bytes.
/// Its mean luminance is that of the base colour, but for print and rust.
pub(crate) fn paint(appearance: &Appearance, size_px: u32, seed: u64) -> GeneratedTexture {
    let mut stream = SeedStream::named(seed, "object");
    let layers = layers(appearance, size_px, &mut stream);
    let mut image = linear_from_fn(size_px, |x, y| {
        let paint = |below: [f32; 3], layer: &Layer| layer(x, y, below);
        layers.iter().fold(appearance.base_colour, paint)
    });
    if !appearance.is_print() && appearance.pattern != Pattern::Rusty {
        balance(&mut image, luminance(appearance.base_colour));
    }
    GeneratedTexture {
        image: image.to_srgb8(1.0),
        tile_m: tile_m(appearance),
        roughness: roughness(appearance),
        metallic: match (appearance.finish, appearance.pattern) {
            (Finish::Metal, Pattern::Rusty) => RUSTY_METALLIC,
            (Finish::Metal, _) => 1.0,
            _ => 0.0,
        },
    }
}

/// From the bottom to the top.
fn layers(appearance: &Appearance, size_px: u32, stream: &mut SeedStream) -> Vec<Layer> {
    let base = base::layer(appearance, stream);
    let pattern = pattern::layer(appearance, size_px, stream);
    let print = appearance
        .is_print()
        .then(|| pattern::printed(appearance.base_colour, size_px, stream));
    let wear = wear::layer(appearance, size_px, stream);
    let below = if appearance.finish == Finish::Fabric {
        // Colours are in the threads, whose relief shades them.
        [pattern, Some(base)]
    } else {
        [Some(base), pattern]
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
            *pixel = pixel.map(|c| (c * gain).min(MAX_REFLECTANCE));
        }
    }
}

/// Width of the painted square on the surface, m; chosen so that grain, threads and grooves have
/// their usual size on an object of some centimetres.
fn tile_m(appearance: &Appearance) -> f64 {
    match (appearance.finish, appearance.pattern) {
        (Finish::Wood, _) | (_, Pattern::Grain) => 0.10,
        (Finish::Fabric, _) | (_, Pattern::Woven | Pattern::Knitted) => 0.05,
        (Finish::Stone, Pattern::Marbled) => 0.16,
        (Finish::Rubber, _) => 0.06,
        (Finish::Metal | Finish::Organic, _) => 0.07,
        (Finish::Stone, _) => 0.12,
        _ => 0.09,
    }
}

/// Wear takes the gloss away.
fn roughness(appearance: &Appearance) -> f32 {
    let least = match appearance.pattern {
        Pattern::Scratched => 0.15,
        Pattern::Worn => 0.25,
        Pattern::Rusty => 0.5,
        _ => 0.0,
    };
    appearance.roughness.max(least)
}

#[cfg(test)]
#[path = "object_test.rs"]
mod tests;
