//! Wood: year rings cut along the grain, fibres, and joints between boards.

use std::f32::consts::TAU;

use super::noise::{fractal, mix, mix_color, smoothstep, value};
use super::{PaintedSurface, paint_by_place, scaled, srgb};
use crate::render::seed::{SeedStream, lattice};

/// Light and dark wood of a year: beech, oak, pine, cherry, walnut, wenge, bleached ash.
const SPECIES: [[u32; 2]; 7] = [
    [0xd9b48a, 0xbd8f63],
    [0xc9a173, 0x9c7346],
    [0xe2c292, 0xc08f55],
    [0xb5794f, 0x8a4f30],
    [0x7d5a41, 0x4f3626],
    [0x4a382d, 0x2c211b],
    [0xd8cdbd, 0xb9aa97],
];

pub(super) fn paint(size_px: u32, stream: &mut SeedStream) -> PaintedSurface {
    let [early, late] = stream.pick(SPECIES).map(srgb);
    let boards = stream.pick([1_u32, 1, 3, 4, 6]);
    // Rings and fibres keep their width on the surface, however many boards there are.
    let rings = stream.between(8.0, 22.0).round() as f32 / boards as f32;
    let wave = stream.between(0.6, 2.2) as f32;
    let lightness = stream.between(0.85, 1.1) as f32;
    let seed = stream.bits();
    let picture = paint_by_place(size_px, |x, y| {
        let board = ((y * boards as f32) as u32).min(boards - 1);
        let across = y * boards as f32 - board as f32;
        let own = seed.wrapping_add(u64::from(board) * 977);
        let warp = fractal(own, x, y, [2, 3 * boards], 3);
        let phase = rings * across + wave * (2.0 * warp - 1.0);
        // A year begins with light wood and ends in a sharp dark line.
        let year = (phase + lattice(own, 0, 0, 9)).rem_euclid(1.0);
        let is_late = if boards == 1 {
            // One board has to close on itself.
            0.5 - 0.5 * (TAU * (rings.round() * y + wave * (2.0 * warp - 1.0))).cos()
        } else {
            smoothstep(0.45, 0.9, year) * (1.0 - smoothstep(0.93, 1.0, year))
        };
        let fibre = fractal(own ^ 0x5bd1, x, y, [6, 160], 2);
        let pore = smoothstep(0.78, 0.92, value(own ^ 0x77, x, y, [24, 300]));
        let tone = lightness
            * mix(0.92, 1.08, lattice(own, 1, 2, 3))
            * mix(0.86, 1.1, fibre)
            * (1.0 - 0.25 * pore);
        let faint = mix(0.35, 0.8, fractal(own ^ 0x2b, x, y, [3, 2 * boards], 2));
        let wood = scaled(mix_color(early, late, faint * is_late), tone);
        scaled(wood, 1.0 - 0.65 * joint(x, across, boards, own))
    });
    PaintedSurface {
        picture,
        tile_m: 0.6,
        roughness: stream.between(0.3, 0.65) as f32,
        metallic: 0.0,
    }
}

/// 1 in the joint between two boards, or at the end of one.
fn joint(x: f32, across: f32, boards: u32, seed: u64) -> f32 {
    if boards == 1 {
        return 0.0;
    }
    // Half a joint of 1.6 mm, on a tile of 0.6 m.
    let half = 0.0013;
    let side = across.min(1.0 - across) / boards as f32;
    let end = (x - lattice(seed, 4, 5, 6)).rem_euclid(1.0);
    let end = end.min(1.0 - end);
    1.0 - smoothstep(0.5 * half, 1.5 * half, side.min(end))
}
