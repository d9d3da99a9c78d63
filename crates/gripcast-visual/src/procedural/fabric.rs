//! Woven fabric.

use std::f32::consts::PI;

use super::noise::{FractalNoise, mix};
use super::{GeneratedTexture, random_colour, scaled, texture_from_fn};
use gripcast_base::random::{SeedStream, lattice};

/// Threads along each side of the texture.
const THREADS: u32 = 96;

pub(super) fn generate(size_px: u32, stream: &mut SeedStream) -> GeneratedTexture {
    let warp = random_colour(stream, [0.05, 0.7], [0.25, 0.9]);
    let weft = if stream.uniform() < 0.5 {
        scaled(warp, stream.between(0.6, 1.1) as f32)
    } else {
        random_colour(stream, [0.05, 0.7], [0.25, 0.9])
    };
    let weave = weave(THREADS, stream);
    let image = texture_from_fn(size_px, |x, y| {
        let (is_warp, shade) = weave(x, y);
        let base = if is_warp { warp } else { weft };
        base.map(|c| (c * shade).min(0.9))
    });
    GeneratedTexture::new(
        image,
        stream.between(0.06, 0.14),
        stream.between(0.8, 0.95),
        0.0,
    )
}

/// Woven threads: whether the top thread is warp, and the factor on its colour. `threads` must be
/// a multiple of 12, the common period of all weaves.
pub(super) fn weave(
    threads: u32,
    stream: &mut SeedStream,
) -> impl Fn(f32, f32) -> (bool, f32) + Sync + use<> {
    // 2: plain weave; 3, 4: twill, whose floats shift by one thread per row.
    let repeat = stream.pick([2_i64, 2, 3, 4]);
    let seed = stream.bits();
    let wear = FractalNoise::new(seed ^ 0x3c, [4, 4], 3);
    move |x, y| {
        let (sx, sy) = (x * threads as f32, y * threads as f32);
        let (i, j) = (sx as i64, sy as i64);
        let is_warp = (i + j).rem_euclid(repeat) < (repeat + 1) / 2;
        let (own, along, across, number) = if is_warp {
            (seed, sy, sx.fract(), i)
        } else {
            (seed ^ 0xa5, sx, sy.fract(), j)
        };
        // Threads are round and bend down where they pass under the next one.
        let round = (PI * across).sin().max(0.0).sqrt();
        let bend = 0.75 + 0.25 * (PI * along.fract()).sin();
        let thread = mix(0.8, 1.1, lattice(own, number, 0, 1));
        let twist = lattice(own, number, (along * 6.0) as i64, 2);
        let wear = mix(0.9, 1.08, wear.at(x, y));
        let shade = mix(0.35, 1.0, round) * bend * thread * mix(0.88, 1.08, twist) * wear;
        (is_warp, shade)
    }
}
