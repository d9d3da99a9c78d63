//! Even surfaces: brushed metal, glaze, plastic.

use super::noise::{cellular, fractal, mix, mix_color, smoothstep, value};
use super::{PaintedSurface, paint_by_place, random_color, scaled, srgb};
use crate::render::seed::{SeedStream, lattice};

/// Aluminium, steel, brass, bronze, dark anodised: reflectance at normal incidence, sRGB.
const METALS: [u32; 5] = [0xe3e4e6, 0xc4c3c0, 0xd9bf7a, 0xb08d66, 0x6a6c70];
/// White, cream, celadon, sky blue, cobalt, terracotta, slate.
const GLAZES: [u32; 7] = [
    0xf0efea, 0xe8dfc9, 0xb7cbb4, 0xa9c4d8, 0x34508f, 0xb5603c, 0x4c5358,
];

pub(super) fn brushed_metal(size_px: u32, stream: &mut SeedStream) -> PaintedSurface {
    let base = srgb(stream.pick(METALS));
    let depth = stream.between(0.1, 0.25) as f32;
    let seed = stream.bits();
    let picture = paint_by_place(size_px, |x, y| {
        let coarse = fractal(seed, x, y, [3, 128], 2);
        let fine = value(seed ^ 0x1f, x, y, [8, 512]);
        scaled(base, 1.0 - depth * (0.6 * coarse + 0.4 * fine))
    });
    PaintedSurface {
        picture,
        tile_m: 0.1,
        roughness: stream.between(0.25, 0.45) as f32,
        metallic: 1.0,
    }
}

pub(super) fn ceramic(size_px: u32, stream: &mut SeedStream) -> PaintedSurface {
    let base = srgb(stream.pick(GLAZES));
    let speck = srgb(stream.pick([0x5a4a3a, 0x2d3140, 0x8a7a66]));
    let is_speckled = stream.uniform() < 0.5;
    let seed = stream.bits();
    let picture = paint_by_place(size_px, |x, y| {
        let mottled = scaled(base, mix(0.94, 1.03, fractal(seed, x, y, [5, 5], 4)));
        if !is_speckled {
            return mottled;
        }
        let (near, _, id) = cellular(seed ^ 0x51, x, y, 40);
        // A third of the cells hold a speck, each of its own size.
        let radius = 0.22 * (id * 3.0).fract();
        let covered = if id < 0.33 {
            1.0 - smoothstep(0.7 * radius, radius + 0.02, near)
        } else {
            0.0
        };
        mix_color(mottled, speck, 0.8 * covered)
    });
    PaintedSurface {
        picture,
        tile_m: 0.12,
        roughness: stream.between(0.06, 0.22) as f32,
        metallic: 0.0,
    }
}

pub(super) fn plastic(size_px: u32, stream: &mut SeedStream) -> PaintedSurface {
    let is_coloured = stream.uniform() < 0.65;
    let base = if is_coloured {
        random_color(stream, [0.35, 0.9], [0.35, 0.95])
    } else {
        let grey = stream.between_log(0.03, 0.75) as f32;
        [grey, 0.99 * grey, 0.96 * grey]
    };
    let seed = stream.bits();
    let picture = paint_by_place(size_px, |x, y| {
        let grain = lattice(seed, (x * 512.0) as i64, (y * 512.0) as i64, 0);
        let cloud = fractal(seed, x, y, [4, 4], 3);
        scaled(base, mix(0.95, 1.03, cloud) * mix(0.985, 1.015, grain))
    });
    PaintedSurface {
        picture,
        tile_m: 0.2,
        roughness: stream.between(0.2, 0.55) as f32,
        metallic: 0.0,
    }
}
