//! Colours derived from a base colour; all linear RGB.

use super::super::noise::{mix, mix_colour};
use super::super::random_colour;
use crate::linear_image::luminance;
use gripcast_base::random::SeedStream;

/// Maximum albedo of generated textures: bright white paint.
pub(super) const MAX_REFLECTANCE: f32 = 0.95;
/// Luminance of middle grey.
const MIDDLE: f32 = 0.18;

/// Multiplies a colour by factors per channel.
pub(super) fn tinted(colour: [f32; 3], factors: [f32; 3]) -> [f32; 3] {
    std::array::from_fn(|c| colour[c] * factors[c])
}

/// Returns the grey of a colour's luminance.
pub(super) fn grey_of(colour: [f32; 3]) -> [f32; 3] {
    [luminance(colour); 3]
}

/// Changes the luminance of a colour; desaturates it if it would be too bright.
pub(super) fn with_luminance(colour: [f32; 3], wanted: f32) -> [f32; 3] {
    let own = luminance(colour);
    let wanted = wanted.min(MAX_REFLECTANCE);
    if own < 1e-4 {
        return [wanted; 3];
    }
    let lit = colour.map(|c| c * wanted / own);
    let largest = lit.into_iter().fold(0.0, f32::max);
    if largest <= MAX_REFLECTANCE {
        return lit;
    }
    let grey = (largest - MAX_REFLECTANCE) / (largest - wanted).max(1e-6);
    mix_colour(lit, [wanted; 3], grey.min(1.0))
}

/// Rotates a colour about the grey axis, rad.
pub(super) fn rotate_hue(colour: [f32; 3], angle: f32) -> [f32; 3] {
    let (sin, cos) = angle.sin_cos();
    let mean = (colour[0] + colour[1] + colour[2]) / 3.0;
    let turned: [f32; 3] = std::array::from_fn(|c| {
        let across = (colour[(c + 2) % 3] - colour[(c + 1) % 3]) / 3f32.sqrt();
        (mean + cos * (colour[c] - mean) + sin * across).max(0.0)
    });
    with_luminance(turned, luminance(colour))
}

/// Whether a colour has little saturation.
fn is_grey(colour: [f32; 3]) -> bool {
    let largest = colour.into_iter().fold(0.0, f32::max);
    let smallest = colour.into_iter().fold(f32::MAX, f32::min);
    largest - smallest < 0.25 * largest
}

/// Returns an accent colour of a neighbouring or the opposite hue, darker than a light base and
/// lighter than a dark one.
pub(super) fn accent(base: [f32; 3], stream: &mut SeedStream) -> [f32; 3] {
    let random = random_colour(stream, [0.5, 0.95], [0.4, 0.95]);
    let angle = stream.pick([0.0_f32, 0.5, -0.5, 2.6, 3.1, -2.6]);
    let hue = if is_grey(base) {
        random
    } else {
        rotate_hue(base, angle)
    };
    with_luminance(hue, contrasting(base, stream))
}

/// Returns a luminance that contrasts with a colour.
fn contrasting(base: [f32; 3], stream: &mut SeedStream) -> f32 {
    let own = luminance(base);
    if own > MIDDLE {
        own * stream.between(0.2, 0.5) as f32
    } else {
        own * stream.between(3.0, 5.0) as f32 + 0.02
    }
}

/// Returns white on a dark colour, nearly black on a light one.
pub(super) fn legible(base: [f32; 3]) -> [f32; 3] {
    if luminance(base) > MIDDLE {
        [0.012; 3]
    } else {
        [0.85, 0.85, 0.82]
    }
}

/// Fades a colour towards dust or bare fibre: less saturated and lighter.
pub(super) fn faded(colour: [f32; 3], fraction: f32) -> [f32; 3] {
    let own = luminance(colour);
    let lighter = mix(own, 0.55, 0.35).max(own);
    mix_colour(
        colour,
        mix_colour(with_luminance(colour, lighter), [lighter; 3], 0.6),
        fraction,
    )
}
