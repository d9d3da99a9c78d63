//! Smooth surfaces: brushed metal, glaze, plastic.

use super::noise::{FractalNoise, ValueNoise, WorleyNoise, mix, mix_colour, smoothstep};
use super::{GeneratedTexture, random_colour, scaled, srgb, texture_from_fn};
use gripcast_base::random::{SeedStream, lattice};

/// Aluminium, steel, brass, bronze, dark anodised: reflectance at normal incidence, sRGB.
const METALS: [u32; 5] = [0xe3e4e6, 0xc4c3c0, 0xd9bf7a, 0xb08d66, 0x6a6c70];
/// White, cream, celadon, sky blue, cobalt, terracotta, slate.
const GLAZES: [u32; 7] = [
    0xf0efea, 0xe8dfc9, 0xb7cbb4, 0xa9c4d8, 0x34508f, 0xb5603c, 0x4c5358,
];

pub(super) fn brushed_metal(size_px: u32, stream: &mut SeedStream) -> GeneratedTexture {
    let base = srgb(stream.pick(METALS));
    let streaks = streaks(stream);
    GeneratedTexture::new(
        texture_from_fn(size_px, |x, y| scaled(base, streaks(x, y))),
        0.1,
        stream.between(0.25, 0.45),
        1.0,
    )
}

/// Brightness of brushed streaks along x.
pub(super) fn streaks(stream: &mut SeedStream) -> impl Fn(f32, f32) -> f32 + Sync + use<> {
    let depth = stream.between(0.1, 0.25) as f32;
    let seed = stream.bits();
    let coarse = FractalNoise::new(seed, [3, 128], 2);
    let fine = ValueNoise::new(seed ^ 0x1f, [8, 512]);
    move |x, y| 1.0 - depth * (0.6 * coarse.at(x, y) + 0.4 * fine.at(x, y))
}

pub(super) fn ceramic(size_px: u32, stream: &mut SeedStream) -> GeneratedTexture {
    let base = srgb(stream.pick(GLAZES));
    let speck = srgb(stream.pick([0x5a4a3a, 0x2d3140, 0x8a7a66]));
    let is_speckled = stream.uniform() < 0.5;
    let seed = stream.bits();
    let (glaze, specks) = (glaze(seed), specks(seed ^ 0x51, 40));
    let image = texture_from_fn(size_px, |x, y| {
        let mottled = scaled(base, glaze(x, y));
        if !is_speckled {
            return mottled;
        }
        mix_colour(mottled, speck, 0.8 * specks(x, y))
    });
    GeneratedTexture::new(image, 0.12, stream.between(0.06, 0.22), 0.0)
}

/// Brightness of a glaze of slightly varying thickness.
pub(super) fn glaze(seed: u64) -> impl Fn(f32, f32) -> f32 + Sync {
    let thickness = FractalNoise::new(seed, [5, 5], 4);
    move |x, y| mix(0.94, 1.03, thickness.at(x, y))
}

/// Cover of scattered round specks of varying size in a third of `count` × `count` cells.
pub(super) fn specks(seed: u64, count: u32) -> impl Fn(f32, f32) -> f32 + Sync {
    let cells = WorleyNoise::new(seed, count);
    move |x, y| {
        let (near, _, id) = cells.at(x, y);
        let radius = 0.22 * (id * 3.0).fract();
        if id < 0.33 {
            1.0 - smoothstep(0.7 * radius, radius + 0.02, near)
        } else {
            0.0
        }
    }
}

pub(super) fn plastic(size_px: u32, stream: &mut SeedStream) -> GeneratedTexture {
    let is_coloured = stream.uniform() < 0.65;
    let base = if is_coloured {
        random_colour(stream, [0.35, 0.9], [0.35, 0.95])
    } else {
        let grey = stream.between_log(0.03, 0.75) as f32;
        [grey, 0.99 * grey, 0.96 * grey]
    };
    let moulded = moulded(stream.bits());
    GeneratedTexture::new(
        texture_from_fn(size_px, |x, y| scaled(base, moulded(x, y))),
        0.2,
        stream.between(0.2, 0.55),
        0.0,
    )
}

/// Brightness of moulded plastic: fine grain and faint clouds.
pub(super) fn moulded(seed: u64) -> impl Fn(f32, f32) -> f32 + Sync {
    let cloud = FractalNoise::new(seed, [4, 4], 3);
    move |x, y| {
        let grain = lattice(seed, (x * 512.0) as i64, (y * 512.0) as i64, 0);
        mix(0.95, 1.03, cloud.at(x, y)) * mix(0.985, 1.015, grain)
    }
}
