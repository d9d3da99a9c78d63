//! Object textures: the whole surface of an object, generated around the base colour of its
//! [`Appearance`].

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

/// Texture layer: the linear colour at a position of the unit square, given the colour below.
type Layer = Box<dyn Fn(f32, f32, [f32; 3]) -> [f32; 3] + Sync>;

/// Metallic value of rusty metal.
const RUSTY_METALLIC: f32 = 0.6;

/// Generates a tileable texture of `size_px` × `size_px` pixels; the result depends on the
/// arguments alone. Its mean luminance is that of the base colour, except for prints and rust.
pub(crate) fn object_texture(appearance: &Appearance, size_px: u32, seed: u64) -> GeneratedTexture {
    let mut stream = SeedStream::named(seed, "coat");
    let layers = layers(appearance, size_px, &mut stream);
    let mut image = linear_from_fn(size_px, |x, y| {
        let apply = |below: [f32; 3], layer: &Layer| layer(x, y, below);
        layers.iter().fold(appearance.base_colour, apply)
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

/// Returns the layers from bottom to top.
fn layers(appearance: &Appearance, size_px: u32, stream: &mut SeedStream) -> Vec<Layer> {
    let base = base::layer(appearance, stream);
    let pattern = pattern::layer(appearance, size_px, stream);
    let print = appearance
        .is_print()
        .then(|| pattern::printed(appearance.base_colour, size_px, stream));
    let wear = wear::layer(appearance, size_px, stream);
    let below = if appearance.finish == Finish::Fabric {
        // The pattern is dyed into the threads, whose relief shades it.
        [pattern, Some(base)]
    } else {
        [Some(base), pattern]
    };
    below.into_iter().chain([print, wear]).flatten().collect()
}

/// Scales an image to a mean luminance, limited by [`MAX_REFLECTANCE`].
fn balance(image: &mut Image, wanted: f32) {
    // The second pass compensates for clipping in the first.
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

/// Width of the texture on the surface, m; grain, threads and grooves have their usual size on a
/// hand-sized object.
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

/// Wear increases the roughness.
fn roughness(appearance: &Appearance) -> f32 {
    let min = match appearance.pattern {
        Pattern::Scratched => 0.15,
        Pattern::Worn => 0.25,
        Pattern::Rusty => 0.5,
        _ => 0.0,
    };
    appearance.roughness.max(min)
}

#[cfg(test)]
#[path = "object_test.rs"]
mod tests;
