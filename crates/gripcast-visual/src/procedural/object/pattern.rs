//! Pattern layers: stripes, dots, specks, clouds, print.

use std::f32::consts::TAU;

use super::super::metal_glaze_plastic::{self, streaks};
use super::super::mineral::veins;
use super::super::noise::{FractalNoise, ValueNoise, WorleyNoise, mix, mix_colour, smoothstep};
use super::super::print::{Inks, Label};
use super::super::scaled;
use super::base::{clouds, knit, shaded, weave, wood};
use super::palette::{accent, faded, legible, rotate_hue, tinted, with_luminance};
use super::strokes::{Mask, Strokes};
use super::{Finish, Layer, Pattern};
use crate::appearance::Appearance;
use crate::linear_image::luminance;
use gripcast_base::random::SeedStream;

/// Luminance above which specks and bruises are darker than the base.
const LIGHT: f32 = 0.06;

/// Returns the layer of a pattern; `None` if the base layer already shows it or there is none.
pub(super) fn layer(
    appearance: &Appearance,
    size_px: u32,
    stream: &mut SeedStream,
) -> Option<Layer> {
    let base = appearance.base_colour;
    let layer = match appearance.pattern {
        Pattern::Grain if appearance.finish == Finish::Wood => return None,
        Pattern::Grain => wood(0.6, stream),
        Pattern::Brushed => shaded(streaks(stream)),
        Pattern::Woven | Pattern::Knitted if appearance.finish == Finish::Fabric => return None,
        Pattern::Woven => weave(0.5, stream),
        Pattern::Knitted => knit(0.5, stream),
        Pattern::Striped => striped(appearance, stream),
        Pattern::Dotted => dotted(base, stream),
        Pattern::Speckled => return speckled(appearance, size_px, stream),
        Pattern::Mottled => return mottled(appearance, stream),
        Pattern::Marbled if appearance.finish == Finish::Stone => return None,
        Pattern::Marbled => marbled(base, stream),
        Pattern::Plain
        | Pattern::Printed
        | Pattern::Scratched
        | Pattern::Worn
        | Pattern::Rusty
        | Pattern::Cracked => return None,
    };
    Some(layer)
}

fn striped(appearance: &Appearance, stream: &mut SeedStream) -> Layer {
    match appearance.finish {
        Finish::Paper => return corrugated(stream),
        Finish::Wood => return bands(tinted(appearance.base_colour, [0.42, 0.34, 0.28]), stream),
        Finish::Metal => return bands(scaled(appearance.base_colour, 0.55), stream),
        _ => {}
    }
    bands(accent(appearance.base_colour, stream), stream)
}

/// Bands along x: rings around an upright object.
fn bands(colour: [f32; 3], stream: &mut SeedStream) -> Layer {
    let count = stream.pick([3.0_f32, 4.0, 5.0, 6.0, 8.0]);
    let width = stream.between(0.15, 0.42) as f32;
    let phase = stream.uniform() as f32;
    // Thin line beside each band.
    let line = stream.pick([0.0_f32, 0.0, 0.06]);
    let soft = 0.004 * count;
    let hand = FractalNoise::new(stream.bits(), [5, 2], 2);
    Box::new(move |x, y, below| {
        let wander = 0.03 * (hand.at(x, y) - 0.5);
        let at = (count * y + phase + wander).rem_euclid(1.0);
        let from = |middle: f32, half: f32| {
            let distance = (at - middle).abs();
            1.0 - smoothstep(half - soft, half + soft, distance)
        };
        let mut cover = from(0.4, 0.5 * width);
        if line > 0.0 {
            cover = cover.max(from(0.48 + 0.5 * width + line, 0.5 * line));
        }
        mix_colour(below, colour, 0.95 * cover)
    })
}

/// Vertical flutes of corrugated cardboard.
fn corrugated(stream: &mut SeedStream) -> Layer {
    let flutes = stream.pick([14.0_f32, 18.0, 22.0]);
    let phase = stream.uniform() as f32;
    shaded(move |x, _| {
        let height = (TAU * (flutes * x + phase)).cos();
        // One flank faces the light.
        let flank = (TAU * (flutes * x + phase + 0.2)).sin();
        1.0 + 0.10 * height + 0.08 * flank
    })
}

/// Dots in rows, offset by half a dot.
fn dotted(base: [f32; 3], stream: &mut SeedStream) -> Layer {
    let colour = accent(base, stream);
    let count = stream.pick([4.0_f32, 6.0, 8.0]);
    let radius = stream.between(0.16, 0.30) as f32;
    let phase = [(); 2].map(|()| stream.uniform() as f32);
    let soft = 0.004 * count;
    Box::new(move |x, y, below| {
        let row = count * y + phase[1];
        let column = count * x + phase[0] + 0.5 * (row.floor() % 2.0);
        let distance = (column.rem_euclid(1.0) - 0.5).hypot(row.rem_euclid(1.0) - 0.5);
        let cover = 1.0 - smoothstep(radius - soft, radius + soft, distance);
        mix_colour(below, colour, 0.95 * cover)
    })
}

fn speckled(appearance: &Appearance, size_px: u32, stream: &mut SeedStream) -> Option<Layer> {
    let base = appearance.base_colour;
    Some(match appearance.finish {
        // Speckled stone is a base layer.
        Finish::Stone => return None,
        Finish::Ceramic => specks(fired_speck(base), 40, stream),
        Finish::Print => specks(accent(base, stream), 34, stream),
        Finish::Plastic | Finish::Glass => grained([0.84, 1.12], stream),
        Finish::Metal => grained([0.78, 1.15], stream),
        Finish::Rubber => pores(stream),
        Finish::Paper => flecks(base, size_px, stream),
        Finish::Fabric => melange(stream),
        Finish::Wood => rays(stream),
        Finish::Organic => pebbled(stream),
    })
}

/// Iron specks in the glaze; light specks on a dark one.
fn fired_speck(base: [f32; 3]) -> [f32; 3] {
    let own = luminance(base);
    if own > LIGHT {
        [0.10 * own, 0.07 * own, 0.05 * own]
    } else {
        with_luminance([0.8, 0.75, 0.6], 6.0 * own + 0.03)
    }
}

fn specks(colour: [f32; 3], count: u32, stream: &mut SeedStream) -> Layer {
    let coarse = metal_glaze_plastic::specks(stream.bits(), count);
    let fine = metal_glaze_plastic::specks(stream.bits(), 2 * count);
    Box::new(move |x, y, below| {
        let cover = coarse(x, y).max(0.8 * fine(x, y));
        mix_colour(below, colour, 0.85 * cover)
    })
}

/// Fine bumps of powder coat, moulded leather grain or blasted metal.
fn grained(range: [f32; 2], stream: &mut SeedStream) -> Layer {
    let seed = stream.bits();
    let fine = ValueNoise::new(seed, [128, 128]);
    let bumps = WorleyNoise::new(seed ^ 0x91, 80);
    shaded(move |x, y| {
        let (near, _, _) = bumps.at(x, y);
        mix(range[0], range[1], fine.at(x, y)) * mix(1.05, 0.93, near.min(1.0))
    })
}

/// Open cells of foam.
fn pores(stream: &mut SeedStream) -> Layer {
    let cells = WorleyNoise::new(stream.bits(), 56);
    shaded(move |x, y| {
        let (near, _, id) = cells.at(x, y);
        let radius = mix(0.1, 0.42, id);
        1.0 - 0.55 * (1.0 - smoothstep(0.5 * radius, radius + 0.05, near))
    })
}

/// Coloured fibres of recycled paper.
fn flecks(base: [f32; 3], size_px: u32, stream: &mut SeedStream) -> Layer {
    let fibres = Strokes {
        count: 420,
        length: [0.008, 0.035],
        spread_rad: 3.2,
        bend_rad: 1.2,
        dark: 0.65,
    };
    let mask = Mask::drawn(size_px, &fibres, stream);
    let dark = scaled(rotate_hue(base, stream.between(-1.0, 1.0) as f32), 0.4);
    let light = faded(base, 1.0);
    mask.layer(dark, light)
}

/// Yarn of lighter and darker fibres.
fn melange(stream: &mut SeedStream) -> Layer {
    let seed = stream.bits();
    let lying = ValueNoise::new(seed, [24, 96]);
    let upright = ValueNoise::new(seed ^ 0xa1, [96, 24]);
    shaded(move |x, y| {
        let fraction = 0.5 * (lying.at(x, y) + upright.at(x, y));
        mix(0.55, 1.4, smoothstep(0.3, 0.7, fraction))
    })
}

/// Short dark rays of beech along the grain.
fn rays(stream: &mut SeedStream) -> Layer {
    let rays = ValueNoise::new(stream.bits(), [90, 24]);
    shaded(move |x, y| 1.0 - 0.35 * smoothstep(0.72, 0.9, rays.at(x, y)))
}

/// Pebbles with creases between them: leather, cork.
fn pebbled(stream: &mut SeedStream) -> Layer {
    let seed = stream.bits();
    let bend = FractalNoise::new(seed, [12, 12], 2);
    let count = stream.pick([30, 38, 46]);
    let cells = WorleyNoise::new(seed ^ 0xb1, count);
    shaded(move |x, y| {
        let shift = 0.02 * (bend.at(x, y) - 0.5);
        let (near, far, id) = cells.at(x + shift, y - shift);
        mix(0.58, 1.0, smoothstep(0.02, 0.26, far - near)) * mix(0.86, 1.12, id)
    })
}

fn mottled(appearance: &Appearance, stream: &mut SeedStream) -> Option<Layer> {
    let base = appearance.base_colour;
    Some(match appearance.finish {
        Finish::Metal => hammered(stream),
        Finish::Paper => crumpled(stream),
        Finish::Rubber => dusty(base, stream),
        Finish::Organic => bruised(base, stream),
        Finish::Stone => clouds([2, 3], [0.72, 1.22], stream),
        Finish::Wood
        | Finish::Fabric
        | Finish::Ceramic
        | Finish::Plastic
        | Finish::Print
        | Finish::Glass => clouds([4, 4], [0.55, 1.45], stream),
    })
}

/// Dents of a round hammer, each reflecting another part of the room.
fn hammered(stream: &mut SeedStream) -> Layer {
    let count = stream.pick([9, 11, 14]);
    let cells = WorleyNoise::new(stream.bits(), count);
    shaded(move |x, y| {
        let (near, far, id) = cells.at(x, y);
        let rim = 1.0 - smoothstep(0.0, 0.14, far - near);
        mix(0.72, 1.05, id) * mix(0.92, 1.1, near.min(1.0)) + 0.16 * rim
    })
}

/// Facets of crumpled paper, bright along the folds.
fn crumpled(stream: &mut SeedStream) -> Layer {
    let seed = stream.bits();
    let bend = FractalNoise::new(seed, [6, 6], 3);
    let large = WorleyNoise::new(seed ^ 0xc1, 5);
    let small = WorleyNoise::new(seed ^ 0xc2, 11);
    shaded(move |x, y| {
        let shift = 0.05 * (bend.at(x, y) - 0.5);
        let facet = |cells: &WorleyNoise, fold: f32| {
            let (near, far, id) = cells.at(x + shift, y + shift);
            let edge = 1.0 - smoothstep(0.0, fold, far - near);
            // Each facet has its own inclination.
            mix(0.84, 1.06, id) + 0.1 * (id - 0.5) * near + 0.08 * edge
        };
        facet(&large, 0.05) * facet(&small, 0.09)
    })
}

/// Patches of pale dust.
fn dusty(base: [f32; 3], stream: &mut SeedStream) -> Layer {
    let own = luminance(base);
    let dust = mix_colour(
        with_luminance([0.5, 0.47, 0.42], (2.0 * own + 0.03).min(0.7)),
        base,
        0.3,
    );
    let cloud = FractalNoise::new(stream.bits(), [4, 4], 5);
    Box::new(move |x, y, below| {
        let fraction = smoothstep(0.4, 0.72, cloud.at(x, y));
        mix_colour(below, dust, 0.6 * fraction)
    })
}

/// Brown patches; pale ones on dark surfaces.
fn bruised(base: [f32; 3], stream: &mut SeedStream) -> Layer {
    let own = luminance(base);
    let patch = if own > LIGHT {
        tinted(base, [0.55, 0.40, 0.30])
    } else {
        faded(with_luminance(base, 3.0 * own + 0.01), 0.5)
    };
    let cloud = FractalNoise::new(stream.bits(), [4, 5], 5);
    Box::new(move |x, y, below| {
        let fraction = smoothstep(0.5, 0.68, cloud.at(x, y));
        mix_colour(below, patch, 0.8 * fraction)
    })
}

/// Two colours stirred together: wax, soap, clay.
fn marbled(base: [f32; 3], stream: &mut SeedStream) -> Layer {
    let own = luminance(base);
    let turned = rotate_hue(base, stream.between(-0.5, 0.5) as f32);
    let other = if own > 0.12 {
        with_luminance(turned, 0.4 * own)
    } else {
        with_luminance(turned, 4.0 * own + 0.02)
    };
    let veins = veins(stream.bits());
    let stirred = FractalNoise::new(stream.bits(), [2, 3], 3);
    Box::new(move |x, y, below| {
        let (fraction, cloud) = veins(x, y);
        let swirl = (TAU * 2.5 * stirred.at(x, y)).sin();
        let wide = 0.55 * smoothstep(0.55, 1.0, swirl);
        scaled(mix_colour(below, other, fraction.max(wide)), cloud)
    })
}

/// A label with ink colours that match the base.
pub(super) fn printed(base: [f32; 3], size_px: u32, stream: &mut SeedStream) -> Layer {
    let mut label = Label::random(stream);
    label.inks = Inks {
        text: legible(base),
        field: accent(base, stream),
        badge: accent(base, stream),
    };
    // Letter strokes are narrower than a pixel: average of four positions.
    let quarter = 0.25 / size_px.max(1) as f32;
    let within = [
        [-quarter, -quarter],
        [quarter, -quarter],
        [-quarter, quarter],
        [quarter, quarter],
    ];
    Box::new(move |x, y, below| {
        let sum = within.iter().fold([0.0; 3], |sum: [f32; 3], [dx, dy]| {
            let ink = label.ink(x + dx, y + dy, below);
            std::array::from_fn(|c| sum[c] + ink[c])
        });
        scaled(sum, 0.25 * label.paper(x, y))
    })
}
