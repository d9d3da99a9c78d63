//! Wear layers: scratches, rubbed and chipped areas, rust and tarnish, cracks.

use super::super::noise::{FractalNoise, ValueNoise, WorleyNoise, mix, mix_colour, smoothstep};
use super::super::{scaled, srgb};
use super::palette::{faded, grey_of, tinted, with_luminance};
use super::strokes::{Mask, Strokes};
use super::{Finish, Layer, Pattern};
use crate::appearance::Appearance;
use crate::linear_image::luminance;
use gripcast_base::random::SeedStream;

/// Rust: dark crust, brown, orange rim.
const RUST: [u32; 3] = [0x3a2016, 0x75401f, 0xa8622c];
/// Green copper carbonate.
const VERDIGRIS: u32 = 0x5f9686;
/// Raw wood, primer and sheet metal under paint and enamel.
const UNDER_PAINT: [u32; 3] = [0xbf9d6c, 0x8d8a84, 0x55524e];

pub(super) fn layer(
    appearance: &Appearance,
    size_px: u32,
    stream: &mut SeedStream,
) -> Option<Layer> {
    Some(match appearance.pattern {
        Pattern::Scratched => scratched(appearance, size_px, stream),
        Pattern::Worn => worn(appearance, stream),
        Pattern::Rusty => rusty(appearance, stream),
        Pattern::Cracked => cracked(appearance, stream),
        _ => return None,
    })
}

fn scratched(appearance: &Appearance, size_px: u32, stream: &mut SeedStream) -> Layer {
    let base = appearance.base_colour;
    let own = luminance(base);
    let strokes = Strokes {
        count: 90,
        length: [0.03, 0.6],
        spread_rad: stream.pick([0.5, 1.2, 3.2]),
        bend_rad: 0.35,
        dark: if own > 0.25 { 0.7 } else { 0.25 },
    };
    let mask = Mask::drawn(size_px, &strokes, stream);
    let light = match appearance.finish {
        Finish::Metal => scaled(base, 1.5),
        _ => faded(with_luminance(base, (2.0 * own + 0.04).min(0.8)), 0.6),
    };
    let dark = scaled(base, 0.4);
    mask.layer(dark, light)
}

/// Patches where the layer below shows through.
fn worn(appearance: &Appearance, stream: &mut SeedStream) -> Layer {
    let base = appearance.base_colour;
    let under = match appearance.finish {
        // Chips have sharp edges.
        Finish::Plastic | Finish::Ceramic | Finish::Glass => {
            return chipped(srgb(stream.pick(UNDER_PAINT)), base, stream);
        }
        Finish::Print => return chipped(srgb(0xe8e4da), base, stream),
        Finish::Metal => scaled(base, 0.55),
        Finish::Wood => mix_colour(faded(base, 0.6), grey_of(base), 0.6),
        Finish::Organic => tinted(base, [0.6, 0.5, 0.42]),
        Finish::Fabric | Finish::Stone | Finish::Rubber | Finish::Paper => faded(base, 0.9),
    };
    let cloud = FractalNoise::new(stream.bits(), [3, 3], 5);
    let fine = ValueNoise::new(stream.bits(), [110, 110]);
    Box::new(move |x, y, below| {
        let rubbed = cloud.at(x, y) + 0.12 * (fine.at(x, y) - 0.5);
        let fraction = smoothstep(0.46, 0.66, rubbed);
        // The relief of the texture remains visible on both.
        let relief = luminance(below) / luminance(base).max(1e-4);
        mix_colour(
            below,
            scaled(under, mix(1.0, relief.min(1.5), 0.6)),
            0.7 * fraction,
        )
    })
}

/// Chips of paint or glaze with a dark edge.
fn chipped(under: [f32; 3], base: [f32; 3], stream: &mut SeedStream) -> Layer {
    let seed = stream.bits();
    let large = FractalNoise::new(seed, [5, 5], 5);
    let small = FractalNoise::new(seed ^ 0xd1, [18, 18], 3);
    let tone = FractalNoise::new(seed ^ 0xd2, [20, 20], 3);
    let rim = scaled(base, 0.6);
    Box::new(move |x, y, below| {
        let depth = (large.at(x, y) - 0.63).max(0.75 * (small.at(x, y) - 0.76));
        let edge = smoothstep(-0.018, -0.004, depth);
        let bare = smoothstep(0.0, 0.008, depth);
        let bottom = scaled(under, mix(0.8, 1.15, tone.at(x, y)));
        mix_colour(mix_colour(below, rim, 0.6 * edge), bottom, bare)
    })
}

fn rusty(appearance: &Appearance, stream: &mut SeedStream) -> Layer {
    let base = appearance.base_colour;
    let is_coppery = appearance.finish == Finish::Metal && base[0] > 1.4 * base[2];
    if is_coppery {
        tarnished(base, stream)
    } else {
        rusted(stream)
    }
}

/// Rust spots growing from pits, with an orange rim.
fn rusted(stream: &mut SeedStream) -> Layer {
    let seed = stream.bits();
    let [crust, brown, rim] = RUST.map(srgb);
    let spread = stream.between(0.50, 0.58) as f32;
    let large = FractalNoise::new(seed, [4, 4], 5);
    let pits = WorleyNoise::new(seed ^ 0xe1, 16);
    let fine = FractalNoise::new(seed ^ 0xe2, [32, 32], 3);
    Box::new(move |x, y, below| {
        let (near, _, id) = pits.at(x, y);
        let pit = 0.30 * id * (1.0 - smoothstep(0.0, 0.5, near));
        let fine = fine.at(x, y);
        let depth = large.at(x, y) + pit + 0.16 * (fine - 0.5) - spread;
        let cover = smoothstep(0.0, 0.035, depth);
        let inside = smoothstep(0.02, 0.12, depth);
        let colour = mix_colour(
            rim,
            mix_colour(brown, crust, smoothstep(0.4, 0.6, fine)),
            inside,
        );
        // Stain around the spot.
        let stain = 0.35 * smoothstep(-0.08, 0.0, depth);
        let stained = mix_colour(below, tinted(below, [0.85, 0.6, 0.4]), stain);
        mix_colour(stained, colour, 0.95 * cover)
    })
}

/// Brown tarnish and, in the deepest areas, verdigris.
fn tarnished(base: [f32; 3], stream: &mut SeedStream) -> Layer {
    let brown = tinted(base, [0.34, 0.26, 0.20]);
    let green = srgb(VERDIGRIS);
    let large = FractalNoise::new(stream.bits(), [3, 4], 5);
    let fine = FractalNoise::new(stream.bits(), [20, 20], 3);
    let has_green = stream.uniform() < 0.6;
    Box::new(move |x, y, below| {
        let depth = large.at(x, y) + 0.12 * (fine.at(x, y) - 0.5);
        let tarnish = mix_colour(below, brown, 0.85 * smoothstep(0.36, 0.60, depth));
        if !has_green {
            return tarnish;
        }
        mix_colour(tarnish, green, 0.8 * smoothstep(0.62, 0.68, depth))
    })
}

fn cracked(appearance: &Appearance, stream: &mut SeedStream) -> Layer {
    let base = appearance.base_colour;
    let own = luminance(base);
    // Glaze crackles in a fine net; other surfaces have few deep cracks.
    let (count, width, depth) = match appearance.finish {
        Finish::Ceramic | Finish::Glass => (stream.pick([11, 14, 17]), 0.13, 0.7),
        Finish::Organic => (stream.pick([8, 11, 14]), 0.12, 0.7),
        _ => (stream.pick([5, 6, 7]), 0.08, 0.85),
    };
    let crack = if own > 0.03 {
        tinted(base, [0.16, 0.13, 0.11])
    } else {
        with_luminance(base, 5.0 * own + 0.02)
    };
    let seed = stream.bits();
    let bend = [0, 1].map(|k| FractalNoise::new(seed ^ k, [9, 9], 4));
    let open = FractalNoise::new(seed ^ 0xf1, [4, 4], 3);
    let cells = WorleyNoise::new(seed ^ 0xf2, count);
    let is_net = appearance.finish == Finish::Ceramic || appearance.finish == Finish::Glass;
    Box::new(move |x, y, below| {
        let [dx, dy] = [0, 1].map(|k: usize| 0.09 * (bend[k].at(x, y) - 0.5));
        let (near, far, _) = cells.at(x + dx, y + dy);
        // Cracks end where the surface holds together.
        let open = if is_net {
            1.0
        } else {
            smoothstep(0.38, 0.55, open.at(x, y))
        };
        let cover = open * (1.0 - smoothstep(0.35 * width, width, far - near));
        mix_colour(below, crack, depth * cover)
    })
}
