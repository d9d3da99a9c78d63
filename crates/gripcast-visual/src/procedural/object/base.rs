//! Base layer of a surface in one colour: wood, cloth, glaze, stone.

use std::f32::consts::PI;

use super::super::fabric;
use super::super::metal_glaze_plastic::{glaze, moulded};
use super::super::mineral::{grains, stained_sand, veins};
use super::super::noise::{FractalNoise, ValueNoise, WorleyNoise, mix, mix_colour, smoothstep};
use super::super::scaled;
use super::super::wood::{Wood, WoodTexture};
use super::palette::{grey_of, rotate_hue, tinted, with_luminance};
use super::{Finish, Layer, Pattern};
use crate::appearance::Appearance;
use crate::linear_image::luminance;
use gripcast_base::random::{SeedStream, lattice};

/// Threads along each side; a multiple of 12, the common period of all weaves.
const THREADS: u32 = 48;
/// Columns and rows of stitches.
const WALES: f32 = 18.0;
const COURSES: f32 = 24.0;

pub(super) fn layer(appearance: &Appearance, stream: &mut SeedStream) -> Layer {
    match (appearance.finish, appearance.pattern) {
        (Finish::Wood, _) => wood(1.0, stream),
        (Finish::Metal, _) => clouds([3, 3], [0.95, 1.03], stream),
        (Finish::Fabric, Pattern::Knitted) => knit(1.0, stream),
        (Finish::Fabric, _) => weave(1.0, stream),
        (Finish::Ceramic, _) => shaded(glaze(stream.bits())),
        (Finish::Plastic | Finish::Glass, _) => shaded(moulded(stream.bits())),
        (Finish::Print, _) => clouds([24, 24], [0.98, 1.02], stream),
        (Finish::Stone, Pattern::Speckled) => granite(appearance.base_colour, stream),
        (Finish::Stone, Pattern::Marbled) => marble(appearance.base_colour, stream),
        (Finish::Stone, _) => shaded(stained_sand(stream.bits())),
        (Finish::Rubber, _) => rubber(stream),
        (Finish::Paper, _) => paper(stream),
        (Finish::Organic, _) => peel(appearance.base_colour, stream),
    }
}

/// A layer that scales the brightness.
pub(super) fn shaded(shade: impl Fn(f32, f32) -> f32 + Sync + 'static) -> Layer {
    Box::new(move |x, y, below| scaled(below, shade(x, y)))
}

/// Clouds between two brightness factors.
pub(super) fn clouds(cells: [u32; 2], range: [f32; 2], stream: &mut SeedStream) -> Layer {
    let cloud = FractalNoise::new(stream.bits(), cells, 4);
    shaded(move |x, y| mix(range[0], range[1], cloud.at(x, y)))
}

/// Growth rings and fibres along y, vertical on the sides of an object.
pub(super) fn wood(contrast: f32, stream: &mut SeedStream) -> Layer {
    let toward = |factor: f32| mix(1.0, factor, contrast);
    let boards = WoodTexture::new(Wood {
        early: [1.12, 1.10, 1.06].map(toward),
        late: [0.62, 0.52, 0.44].map(toward),
        boards: 1,
        rings: stream.between(9.0, 22.0) as f32,
        wave: stream.between(0.8, 3.0) as f32,
        lightness: 1.0,
        seed: stream.bits(),
    });
    Box::new(move |x, y, below| tinted(below, boards.colour(y, x)))
}

/// Woven threads; `depth` is 1 for cloth, less for embossed patterns.
pub(super) fn weave(depth: f32, stream: &mut SeedStream) -> Layer {
    let weave = fabric::weave(THREADS, stream);
    let weft = stream.between(0.6, 1.0) as f32;
    shaded(move |x, y| {
        let (is_warp, shade) = weave(x, y);
        let own = if is_warp { 1.0 } else { weft };
        mix(1.0, own * shade, depth)
    })
}

/// Stockinette stitches: each a V of two strands.
pub(super) fn knit(depth: f32, stream: &mut SeedStream) -> Layer {
    let seed = stream.bits();
    let wear = FractalNoise::new(seed ^ 0x3c, [4, 4], 3);
    shaded(move |x, y| {
        let wale = x * WALES;
        // 0 in the middle of the V, 1 at its upper ends.
        let side = 2.0 * (wale.fract() - 0.5).abs();
        let course = y * COURSES + 0.9 * side;
        let strand = (PI * course.fract()).sin().max(0.0).sqrt();
        let groove = smoothstep(0.0, 0.3, side) * (1.0 - 0.7 * smoothstep(0.75, 1.0, side));
        let row = (course as i64).rem_euclid(COURSES as i64);
        let stitch = mix(0.88, 1.08, lattice(seed, wale as i64, row, 0));
        let twist = 0.5 + 0.5 * (6.0 * PI * (course + 0.4 * side)).sin();
        let round = mix(0.3, 1.0, strand) * mix(0.55, 1.0, groove);
        let shade = round * stitch * mix(0.9, 1.05, twist) * mix(0.92, 1.06, wear.at(x, y));
        mix(1.0, shade, depth)
    })
}

fn granite(base: [f32; 3], stream: &mut SeedStream) -> Layer {
    let light = with_luminance(mix_colour(base, grey_of(base), 0.3), 1.25 * luminance(base));
    let middle = scaled(base, 0.75);
    let dark = scaled(grey_of(base), 0.25);
    let granite = grains([light, middle, dark], stream.bits());
    Box::new(move |x, y, _| granite(x, y))
}

fn marble(base: [f32; 3], stream: &mut SeedStream) -> Layer {
    let veins = veins(stream.bits());
    let own = luminance(base);
    // Dark marble has light veins.
    let vein = if own > 0.12 {
        scaled(mix_colour(base, grey_of(base), 0.4), 0.35)
    } else {
        with_luminance(base, 5.0 * own + 0.05)
    };
    Box::new(move |x, y, below| {
        let (fraction, cloud) = veins(x, y);
        scaled(mix_colour(below, vein, fraction), cloud)
    })
}

fn rubber(stream: &mut SeedStream) -> Layer {
    let seed = stream.bits();
    let cloud = FractalNoise::new(seed, [5, 5], 4);
    let grain = ValueNoise::new(seed ^ 0x5e, [150, 150]);
    shaded(move |x, y| mix(0.93, 1.05, cloud.at(x, y)) * mix(0.95, 1.04, grain.at(x, y)))
}

/// Felted fibres in all directions.
fn paper(stream: &mut SeedStream) -> Layer {
    let seed = stream.bits();
    let cloud = FractalNoise::new(seed, [6, 6], 4);
    let lying = ValueNoise::new(seed ^ 0x71, [36, 180]);
    let upright = ValueNoise::new(seed ^ 0x72, [180, 36]);
    shaded(move |x, y| {
        let fibre = 0.5 * (lying.at(x, y) + upright.at(x, y));
        mix(0.95, 1.04, cloud.at(x, y)) * mix(0.92, 1.06, fibre)
    })
}

/// Skin of fruit or hide: broad hue variation and fine pores.
fn peel(base: [f32; 3], stream: &mut SeedStream) -> Layer {
    let seed = stream.bits();
    let angle = stream.between(-0.16, 0.16) as f32;
    let other = rotate_hue(base, angle);
    let broad = FractalNoise::new(seed, [3, 3], 4);
    let hue = FractalNoise::new(seed ^ 0x81, [2, 3], 3);
    let pores = WorleyNoise::new(seed ^ 0x82, 44);
    Box::new(move |x, y, below| {
        let fraction = smoothstep(0.35, 0.65, hue.at(x, y));
        let (near, _, id) = pores.at(x, y);
        let pore = (1.0 - smoothstep(0.1, 0.32, near)) * id;
        let shade = mix(0.84, 1.12, broad.at(x, y)) * (1.0 - 0.16 * pore);
        scaled(mix_colour(below, other, fraction), shade)
    })
}
