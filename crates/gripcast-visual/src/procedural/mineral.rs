//! Stone, concrete and tiles.

use super::noise::{FractalNoise, ValueNoise, WorleyNoise, mix, mix_colour, smoothstep};
use super::{GeneratedTexture, scaled, srgb, texture_from_fn};
use gripcast_base::random::{SeedStream, lattice};

/// Base and vein colours of marble.
const MARBLES: [[u32; 2]; 4] = [
    [0xe6e3de, 0x8d8a88],
    [0x2a2b2d, 0xa8a49c],
    [0xd8c9b0, 0x9a7f5f],
    [0x5b6b5f, 0xc9cfc4],
];
/// Mineral colours of granite.
const GRANITES: [[u32; 3]; 4] = [
    [0xb9b4ad, 0x77726c, 0x26262a],
    [0xc7a48f, 0x8a6a5c, 0x2e2a2a],
    [0x4a4d52, 0x2b2d31, 0x8f9296],
    [0xd8d4cc, 0xb0aaa0, 0x6c6862],
];

pub(super) fn stone(size_px: u32, stream: &mut SeedStream) -> GeneratedTexture {
    let is_marble = stream.uniform() < 0.5;
    let image = if is_marble {
        marble(size_px, stream)
    } else {
        granite(size_px, stream)
    };
    GeneratedTexture::new(
        image,
        if is_marble { 0.6 } else { 0.3 },
        stream.between(0.08, 0.4),
        0.0,
    )
}

fn marble(size_px: u32, stream: &mut SeedStream) -> image::RgbImage {
    let [ground, vein] = stream.pick(MARBLES).map(srgb);
    let veins = veins(stream.bits());
    texture_from_fn(size_px, |x, y| {
        let (fraction, cloud) = veins(x, y);
        scaled(mix_colour(ground, vein, fraction), cloud)
    })
}

/// Marble veins: fraction of the vein colour, and a factor on the result.
pub(super) fn veins(seed: u64) -> impl Fn(f32, f32) -> (f32, f32) + Sync {
    let bend = FractalNoise::new(seed, [3, 3], 4);
    let field = FractalNoise::new(seed ^ 0x11, [3, 4], 5);
    let fine = FractalNoise::new(seed ^ 0x12, [7, 6], 4);
    let cloud = FractalNoise::new(seed ^ 0x13, [3, 3], 3);
    move |x, y| {
        let bend = 0.18 * (bend.at(x, y) - 0.5);
        let field = field.at(x + bend, y - bend);
        // Veins follow the mid-level contour of the field.
        let ridge = 1.0 - (2.0 * field - 1.0).abs();
        let fine = fine.at(x - bend, y + bend);
        let fine = 1.0 - (2.0 * fine - 1.0).abs();
        let fraction = 0.75 * smoothstep(0.86, 1.0, ridge) + 0.3 * smoothstep(0.93, 1.0, fine);
        (fraction.min(1.0), mix(0.9, 1.04, cloud.at(x, y)))
    }
}

fn granite(size_px: u32, stream: &mut SeedStream) -> image::RgbImage {
    texture_from_fn(
        size_px,
        grains(stream.pick(GRANITES).map(srgb), stream.bits()),
    )
}

/// Colour of the grains of three minerals, given in order of frequency.
pub(super) fn grains(minerals: [[f32; 3]; 3], seed: u64) -> impl Fn(f32, f32) -> [f32; 3] + Sync {
    let bend = FractalNoise::new(seed, [24, 24], 3);
    let large = WorleyNoise::new(seed ^ 0x21, 70);
    let small = WorleyNoise::new(seed ^ 0x22, 150);
    let grain = ValueNoise::new(seed ^ 0x23, [160, 160]);
    move |x, y| {
        let bend = 0.012 * (bend.at(x, y) - 0.5);
        let (near, far, id) = large.at(x + bend, y - bend);
        let (_, _, small) = small.at(x - bend, y + bend);
        let chosen = match 0.7 * id + 0.3 * small {
            fraction if fraction < 0.5 => minerals[0],
            fraction if fraction < 0.74 => minerals[1],
            _ => minerals[2],
        };
        let edge = smoothstep(0.0, 0.25, far - near);
        let grain = mix(0.85, 1.1, grain.at(x, y));
        scaled(mix_colour(minerals[1], chosen, mix(0.55, 1.0, edge)), grain)
    }
}

pub(super) fn concrete(size_px: u32, stream: &mut SeedStream) -> GeneratedTexture {
    let grey = stream.between(0.16, 0.5) as f32;
    let warmth = stream.between(-0.05, 0.07) as f32;
    let base = [grey * (1.0 + warmth), grey, grey * (1.0 - warmth)];
    let concrete = stained_sand(stream.bits());
    GeneratedTexture::new(
        texture_from_fn(size_px, |x, y| scaled(base, concrete(x, y))),
        0.5,
        stream.between(0.6, 0.9),
        0.0,
    )
}

/// Brightness of stained sand with pores.
pub(super) fn stained_sand(seed: u64) -> impl Fn(f32, f32) -> f32 + Sync {
    let stain = FractalNoise::new(seed, [3, 3], 6);
    let sand = ValueNoise::new(seed ^ 0x31, [220, 220]);
    let pores = WorleyNoise::new(seed ^ 0x32, 60);
    move |x, y| {
        let stain = mix(0.8, 1.15, stain.at(x, y));
        let sand = mix(0.93, 1.05, sand.at(x, y));
        let (near, _, id) = pores.at(x, y);
        let radius = 0.16 * (id * 7.0).fract().powi(2);
        let pore = if id < 0.3 {
            1.0 - smoothstep(0.5 * radius, radius + 0.01, near)
        } else {
            0.0
        };
        stain * sand * (1.0 - 0.6 * pore)
    }
}

pub(super) fn tiles(size_px: u32, stream: &mut SeedStream) -> GeneratedTexture {
    let tile = srgb(stream.pick([0xe9e7e1, 0xcfd6d8, 0xb9a58c, 0x6f8088, 0x3d4246]));
    let grout = srgb(stream.pick([0x9b9790, 0x5f5c58, 0xd2cfc8]));
    let count = stream.pick([2_u32, 3, 4]);
    let is_bond = stream.uniform() < 0.4 && count.is_multiple_of(2);
    let seed = stream.bits();
    let tile_m = 0.4;
    let half_joint = 0.0015 / tile_m as f32 * count as f32;
    let clouds = FractalNoise::new(seed, [6, 6], 4);
    let sands = ValueNoise::new(seed ^ 0x41, [200, 200]);
    let image = texture_from_fn(size_px, |x, y| {
        let (mut sx, sy) = (x * count as f32, y * count as f32);
        let row = sy as i64;
        if is_bond && row % 2 == 1 {
            sx += 0.5;
        }
        let column = (sx as i64).rem_euclid(i64::from(count));
        let inset = |c: f32| c.fract().min(1.0 - c.fract());
        let edge = inset(sx).min(inset(sy));
        let in_joint = 1.0 - smoothstep(0.8 * half_joint, 1.4 * half_joint, edge);
        let own = mix(0.92, 1.05, lattice(seed, column, row, 0));
        let cloud = mix(0.94, 1.04, clouds.at(x, y));
        let sand = mix(0.8, 1.1, sands.at(x, y));
        mix_colour(scaled(tile, own * cloud), scaled(grout, sand), in_joint)
    });
    GeneratedTexture::new(image, tile_m, stream.between(0.1, 0.4), 0.0)
}
