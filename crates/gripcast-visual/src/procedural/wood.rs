//! Wood: growth rings cut along the grain, fibres, and joints between boards.

use std::f32::consts::TAU;

use super::noise::{FractalNoise, ValueNoise, mix, mix_colour, smoothstep};
use super::{GeneratedTexture, scaled, srgb, texture_from_fn};
use gripcast_base::random::{SeedStream, lattice};

/// Early and late wood of beech, oak, pine, cherry, walnut, wenge, bleached ash.
const SPECIES: [[u32; 2]; 7] = [
    [0xd9b48a, 0xbd8f63],
    [0xc9a173, 0x9c7346],
    [0xe2c292, 0xc08f55],
    [0xb5794f, 0x8a4f30],
    [0x7d5a41, 0x4f3626],
    [0x4a382d, 0x2c211b],
    [0xd8cdbd, 0xb9aa97],
];

/// Parameters of sawn wood; boards lie along x.
pub(super) struct Wood {
    /// Early and late wood of a growth ring.
    pub(super) early: [f32; 3],
    pub(super) late: [f32; 3],
    /// Boards in the unit square.
    pub(super) boards: u32,
    /// Growth rings across a board.
    pub(super) rings: f32,
    /// Waviness, growth rings.
    pub(super) wave: f32,
    pub(super) lightness: f32,
    pub(super) seed: u64,
}

pub(super) fn generate(size_px: u32, stream: &mut SeedStream) -> GeneratedTexture {
    let [early, late] = stream.pick(SPECIES).map(srgb);
    let boards = stream.pick([1_u32, 1, 3, 4, 6]);
    let wood = WoodTexture::new(Wood {
        early,
        late,
        boards,
        // Rings and fibres keep their width on the surface for any number of boards.
        rings: stream.between(8.0, 22.0).round() as f32 / boards as f32,
        wave: stream.between(0.6, 2.2) as f32,
        lightness: stream.between(0.85, 1.1) as f32,
        seed: stream.bits(),
    });
    GeneratedTexture::new(
        texture_from_fn(size_px, |x, y| wood.colour(x, y)),
        0.6,
        stream.between(0.3, 0.65),
        0.0,
    )
}

/// Texture of one or more boards.
pub(super) struct WoodTexture {
    wood: Wood,
    boards: Vec<Board>,
}

struct Board {
    seed: u64,
    tone: f32,
    warp: FractalNoise,
    fibre: FractalNoise,
    pores: ValueNoise,
    faint: FractalNoise,
}

impl WoodTexture {
    pub(super) fn new(wood: Wood) -> Self {
        let board = |number: u32| {
            let own = wood.seed.wrapping_add(u64::from(number) * 977);
            Board {
                seed: own,
                tone: wood.lightness * mix(0.92, 1.08, lattice(own, 1, 2, 3)),
                warp: FractalNoise::new(own, [2, 3 * wood.boards], 3),
                fibre: FractalNoise::new(own ^ 0x5bd1, [6, 160], 2),
                pores: ValueNoise::new(own ^ 0x77, [24, 300]),
                faint: FractalNoise::new(own ^ 0x2b, [3, 2 * wood.boards], 2),
            }
        };
        Self {
            boards: (0..wood.boards.max(1)).map(board).collect(),
            wood,
        }
    }

    pub(super) fn colour(&self, x: f32, y: f32) -> [f32; 3] {
        let Wood {
            early,
            late,
            rings,
            wave,
            ..
        } = self.wood;
        let count = self.boards.len();
        let number = ((y * count as f32) as usize).min(count - 1);
        let board = &self.boards[number];
        let across = y * count as f32 - number as f32;
        let warp = board.warp.at(x, y);
        let is_late = if count == 1 {
            // A single board must tile.
            0.5 - 0.5 * (TAU * (rings.round() * y + wave * (2.0 * warp - 1.0))).cos()
        } else {
            // A growth ring starts with light early wood and ends in a sharp dark line.
            let phase = rings * across + wave * (2.0 * warp - 1.0);
            let year = (phase + lattice(board.seed, 0, 0, 9)).rem_euclid(1.0);
            smoothstep(0.45, 0.9, year) * (1.0 - smoothstep(0.93, 1.0, year))
        };
        let fibre = board.fibre.at(x, y);
        let pore = smoothstep(0.78, 0.92, board.pores.at(x, y));
        let tone = board.tone * mix(0.86, 1.1, fibre) * (1.0 - 0.25 * pore);
        let faint = mix(0.35, 0.8, board.faint.at(x, y));
        let wood = scaled(mix_colour(early, late, faint * is_late), tone);
        scaled(wood, 1.0 - 0.65 * joint(x, across, count, board.seed))
    }
}

/// 1 in the joint between two boards or at the end of one.
fn joint(x: f32, across: f32, boards: usize, seed: u64) -> f32 {
    if boards == 1 {
        return 0.0;
    }
    // Half a joint of 1.6 mm on a texture of 0.6 m.
    let half = 0.0013;
    let side = across.min(1.0 - across) / boards as f32;
    let end = (x - lattice(seed, 4, 5, 6)).rem_euclid(1.0);
    let end = end.min(1.0 - end);
    1.0 - smoothstep(0.5 * half, 1.5 * half, side.min(end))
}
