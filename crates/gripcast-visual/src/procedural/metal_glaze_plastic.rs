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
    let streaks = Streaks::random(stream);
    GeneratedTexture::new(
        texture_from_fn(size_px, |x, y| scaled(base, streaks.shade(x, y))),
        0.1,
        stream.between(0.25, 0.45),
        1.0,
    )
}

/// Brushed streaks along x.
pub(super) struct Streaks {
    depth: f32,
    coarse: FractalNoise,
    fine: ValueNoise,
}

impl Streaks {
    pub(super) fn random(stream: &mut SeedStream) -> Self {
        let depth = stream.between(0.1, 0.25) as f32;
        let seed = stream.bits();
        Self {
            depth,
            coarse: FractalNoise::new(seed, [3, 128], 2),
            fine: ValueNoise::new(seed ^ 0x1f, [8, 512]),
        }
    }

    /// Factor on the colour.
    pub(super) fn shade(&self, x: f32, y: f32) -> f32 {
        let (coarse, fine) = (self.coarse.at(x, y), self.fine.at(x, y));
        1.0 - self.depth * (0.6 * coarse + 0.4 * fine)
    }
}

pub(super) fn ceramic(size_px: u32, stream: &mut SeedStream) -> GeneratedTexture {
    let base = srgb(stream.pick(GLAZES));
    let speck = srgb(stream.pick([0x5a4a3a, 0x2d3140, 0x8a7a66]));
    let is_speckled = stream.uniform() < 0.5;
    let seed = stream.bits();
    let (glaze, specks) = (Glaze::new(seed), Specks::new(seed ^ 0x51, 40));
    let image = texture_from_fn(size_px, |x, y| {
        let mottled = scaled(base, glaze.shade(x, y));
        if !is_speckled {
            return mottled;
        }
        mix_colour(mottled, speck, 0.8 * specks.cover(x, y))
    });
    GeneratedTexture::new(image, 0.12, stream.between(0.06, 0.22), 0.0)
}

/// Glaze of slightly varying thickness.
pub(super) struct Glaze(FractalNoise);

impl Glaze {
    pub(super) fn new(seed: u64) -> Self {
        Self(FractalNoise::new(seed, [5, 5], 4))
    }

    /// Factor on the colour.
    pub(super) fn shade(&self, x: f32, y: f32) -> f32 {
        mix(0.94, 1.03, self.0.at(x, y))
    }
}

/// Scattered round specks of varying size.
pub(super) struct Specks(WorleyNoise);

impl Specks {
    /// A third of the `count` × `count` cells contain a speck.
    pub(super) fn new(seed: u64, count: u32) -> Self {
        Self(WorleyNoise::new(seed, count))
    }

    /// 1 on a speck, 0 elsewhere.
    pub(super) fn cover(&self, x: f32, y: f32) -> f32 {
        let (near, _, id) = self.0.at(x, y);
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
    let moulded = Moulded::new(stream.bits());
    GeneratedTexture::new(
        texture_from_fn(size_px, |x, y| scaled(base, moulded.shade(x, y))),
        0.2,
        stream.between(0.2, 0.55),
        0.0,
    )
}

/// Moulded plastic: fine grain and faint clouds.
pub(super) struct Moulded {
    seed: u64,
    cloud: FractalNoise,
}

impl Moulded {
    pub(super) fn new(seed: u64) -> Self {
        Self {
            seed,
            cloud: FractalNoise::new(seed, [4, 4], 3),
        }
    }

    /// Factor on the colour.
    pub(super) fn shade(&self, x: f32, y: f32) -> f32 {
        let grain = lattice(self.seed, (x * 512.0) as i64, (y * 512.0) as i64, 0);
        mix(0.95, 1.03, self.cloud.at(x, y)) * mix(0.985, 1.015, grain)
    }
}
