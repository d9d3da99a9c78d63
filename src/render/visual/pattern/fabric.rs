//! Woven fabric.

use std::f32::consts::PI;

use super::noise::{fractal, mix};
use super::{PaintedSurface, paint_by_place, random_color, scaled};
use crate::render::seed::{SeedStream, lattice};

/// Threads along each side of a tile; a multiple of the repeats of all weaves.
const THREADS: u32 = 96;

pub(super) fn paint(size_px: u32, stream: &mut SeedStream) -> PaintedSurface {
    let warp = random_color(stream, [0.05, 0.7], [0.25, 0.9]);
    let weft = if stream.uniform() < 0.5 {
        scaled(warp, stream.between(0.6, 1.1) as f32)
    } else {
        random_color(stream, [0.05, 0.7], [0.25, 0.9])
    };
    // 2: plain weave; 3, 4: twill, whose floats shift by one thread a row.
    let repeat = stream.pick([2_i64, 2, 3, 4]);
    let seed = stream.bits();
    let picture = paint_by_place(size_px, |x, y| {
        let (sx, sy) = (x * THREADS as f32, y * THREADS as f32);
        let (i, j) = (sx as i64, sy as i64);
        let is_warp_up = (i + j).rem_euclid(repeat) < (repeat + 1) / 2;
        let (own, along, across, number, base) = if is_warp_up {
            (seed, sy, sx.fract(), i, warp)
        } else {
            (seed ^ 0xa5, sx, sy.fract(), j, weft)
        };
        // A thread is round, and bends down where it goes under the next one.
        let round = (PI * across).sin().max(0.0).sqrt();
        let bend = 0.75 + 0.25 * (PI * along.fract()).sin();
        let thread = mix(0.8, 1.1, lattice(own, number, 0, 1));
        let twist = lattice(own, number, (along * 6.0) as i64, 2);
        let wear = mix(0.9, 1.08, fractal(seed ^ 0x3c, x, y, [4, 4], 3));
        let shade = mix(0.35, 1.0, round) * bend * thread * mix(0.88, 1.08, twist) * wear;
        base.map(|c| (c * shade).min(0.9))
    });
    PaintedSurface {
        picture,
        tile_m: stream.between(0.06, 0.14),
        roughness: stream.between(0.8, 0.95) as f32,
        metallic: 0.0,
    }
}
