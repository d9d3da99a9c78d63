//! Procedural textures: tileable images of wood, stone, fabric, glaze, print and others.

mod fabric;
mod metal_glaze_plastic;
mod mineral;
mod noise;
mod object;
mod print;
mod simple;
mod wood;

use std::str::FromStr;

use image::RgbImage;
use rayon::prelude::*;

use super::linear_image::Image;
use gripcast_base::error::{Error, Result, unknown_name};
use gripcast_base::random::SeedStream;
use gripcast_imaging::srgb_decode;

pub(super) use object::object_texture;

/// Kind of a procedural texture.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ProceduralTexture {
    /// Boards or veneer of oak, beech, walnut and others.
    Wood,
    /// Metal brushed in one direction.
    BrushedMetal,
    /// Woven threads of two colours.
    Fabric,
    /// Glazed ceramic, plain or speckled.
    Ceramic,
    /// Plastic of one colour with a fine grain.
    Plastic,
    /// Printed carton: colour fields, lines of text, a bar code.
    Print,
    /// Granite or marble.
    Stone,
    /// Concrete with pores.
    Concrete,
    /// Tiles with grout.
    Tiles,
    /// Squares of two colours.
    Checker,
    /// Clouds of random colours.
    Noise,
}

impl ProceduralTexture {
    /// All kinds.
    pub const ALL: [Self; 11] = [
        Self::Wood,
        Self::BrushedMetal,
        Self::Fabric,
        Self::Ceramic,
        Self::Plastic,
        Self::Print,
        Self::Stone,
        Self::Concrete,
        Self::Tiles,
        Self::Checker,
        Self::Noise,
    ];

    /// Kinds found on table tops and floors.
    pub const GROUNDS: [Self; 6] = [
        Self::Wood,
        Self::Plastic,
        Self::Fabric,
        Self::Stone,
        Self::Concrete,
        Self::Tiles,
    ];

    /// Name on the command line and in files.
    pub fn name(self) -> &'static str {
        match self {
            Self::Wood => "wood",
            Self::BrushedMetal => "brushed-metal",
            Self::Fabric => "fabric",
            Self::Ceramic => "ceramic",
            Self::Plastic => "plastic",
            Self::Print => "print",
            Self::Stone => "stone",
            Self::Concrete => "concrete",
            Self::Tiles => "tiles",
            Self::Checker => "checker",
            Self::Noise => "noise",
        }
    }

    /// Generates `size_px` × `size_px` pixels; the result depends on the arguments alone.
    pub fn generate(self, size_px: u32, seed: u64) -> GeneratedTexture {
        let mut stream = SeedStream::named(seed, self.name());
        match self {
            Self::Wood => wood::generate(size_px, &mut stream),
            Self::BrushedMetal => metal_glaze_plastic::brushed_metal(size_px, &mut stream),
            Self::Fabric => fabric::generate(size_px, &mut stream),
            Self::Ceramic => metal_glaze_plastic::ceramic(size_px, &mut stream),
            Self::Plastic => metal_glaze_plastic::plastic(size_px, &mut stream),
            Self::Print => print::generate(size_px, &mut stream),
            Self::Stone => mineral::stone(size_px, &mut stream),
            Self::Concrete => mineral::concrete(size_px, &mut stream),
            Self::Tiles => mineral::tiles(size_px, &mut stream),
            Self::Checker => simple::checker(size_px, &mut stream),
            Self::Noise => simple::noise(size_px, &mut stream),
        }
    }
}

impl FromStr for ProceduralTexture {
    type Err = Error;

    fn from_str(text: &str) -> Result<Self> {
        let found = Self::ALL.into_iter().find(|texture| texture.name() == text);
        found.ok_or_else(|| unknown_name("texture", text, &Self::ALL.map(Self::name)))
    }
}

/// A tileable base-colour image with its reflection parameters.
#[derive(Clone, Debug, PartialEq)]
pub struct GeneratedTexture {
    /// Base colour, sRGB, square.
    pub image: RgbImage,
    /// Width of the image on the surface, m.
    pub tile_m: f64,
    /// Perceptual roughness, 0 (mirror) to 1 (matt).
    pub roughness: f32,
    /// 0 (dielectric) to 1 (metal).
    pub metallic: f32,
}

impl GeneratedTexture {
    fn new(image: RgbImage, tile_m: f64, roughness: f64, metallic: f32) -> Self {
        Self {
            image,
            tile_m,
            roughness: roughness as f32,
            metallic,
        }
    }
}

/// Square sRGB image of a function from the unit square to linear RGB.
fn texture_from_fn(size_px: u32, colour: impl Fn(f32, f32) -> [f32; 3] + Sync) -> RgbImage {
    linear_from_fn(size_px, colour).to_srgb8(1.0)
}

/// Square linear image of a function from the unit square to linear RGB.
fn linear_from_fn(size_px: u32, colour: impl Fn(f32, f32) -> [f32; 3] + Sync) -> Image {
    let size = size_px.max(1) as usize;
    let position = |index: usize| (index as f32 + 0.5) / size as f32;
    let mut image = Image::filled(size, size, [0.0; 3]);
    image
        .pixels
        .par_chunks_mut(size)
        .enumerate()
        .for_each(|(row, pixels)| {
            for (column, pixel) in pixels.iter_mut().enumerate() {
                *pixel = colour(position(column), position(row));
            }
        });
    image
}

/// Linear RGB of an sRGB colour `0xRRGGBB`.
fn srgb(code: u32) -> [f32; 3] {
    [16, 8, 0].map(|shift| srgb_decode((code >> shift & 0xff) as u8))
}

/// Scales all channels of a colour.
fn scaled(colour: [f32; 3], factor: f32) -> [f32; 3] {
    colour.map(|c| c * factor)
}

/// Random linear colour with hue, saturation and value in the given ranges.
fn random_colour(stream: &mut SeedStream, saturation: [f64; 2], value: [f64; 2]) -> [f32; 3] {
    let hue = stream.between(0.0, 6.0);
    let s = stream.between(saturation[0], saturation[1]);
    let v = stream.between(value[0], value[1]);
    let channel = |offset: f64| {
        let k = (offset + hue) % 6.0;
        let encoded = v - v * s * k.min(4.0 - k).clamp(0.0, 1.0);
        srgb_decode((255.0 * encoded).round() as u8)
    };
    [channel(5.0), channel(3.0), channel(1.0)]
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Mean absolute difference of neighbouring columns (or rows) `a` and `b`.
    fn step(image: &RgbImage, a: u32, b: u32, by_row: bool) -> f64 {
        let n = image.width();
        let at = |i: u32, j: u32| if by_row { (j, i) } else { (i, j) };
        let sum: f64 = (0..n)
            .flat_map(|j| {
                let (p, q) = (at(a, j), at(b, j));
                let (p, q) = (image.get_pixel(p.0, p.1).0, image.get_pixel(q.0, q.1).0);
                [0, 1, 2].map(|c| (f64::from(p[c]) - f64::from(q[c])).abs())
            })
            .sum();
        sum / f64::from(3 * n)
    }

    /// Asserts that an image's opposite borders match.
    pub(super) fn closes(image: &RgbImage, name: &str) {
        let n = image.width();
        for by_row in [false, true] {
            // The step over the border is no larger than the largest one inside.
            let border = step(image, n - 1, 0, by_row);
            let inside = (1..n).map(|i| step(image, i - 1, i, by_row));
            let largest = inside.fold(0.0, f64::max);
            assert!(
                border <= 1.3 * largest + 1.0,
                "{name}: {border} > {largest}"
            );
        }
    }

    #[test]
    fn textures_depend_on_seed_and_tile() {
        for pattern in ProceduralTexture::ALL {
            let texture = pattern.generate(128, 5);
            assert_eq!(texture, pattern.generate(128, 5), "{pattern:?}");
            let other = pattern.generate(128, 6);
            assert_ne!(texture.image, other.image, "{pattern:?}");
            assert!(texture.tile_m > 0.0 && (0.0..=1.0).contains(&texture.roughness));
            closes(&texture.image, pattern.name());
        }
    }

    #[test]
    fn textures_vary_and_have_plausible_albedo() {
        for pattern in ProceduralTexture::ALL {
            for seed in 0..6 {
                let image = pattern.generate(64, seed).image;
                let mean = image.iter().map(|v| f64::from(*v)).sum::<f64>() / image.len() as f64;
                assert!((8.0..=246.0).contains(&mean), "{pattern:?} {seed}: {mean}");
                let first = image.get_pixel(0, 0);
                assert!(image.pixels().any(|p| p != first), "{pattern:?} {seed}");
            }
        }
    }

    #[test]
    fn names_round_trip_and_misspelt_gets_suggestion() {
        for pattern in ProceduralTexture::ALL {
            assert_eq!(
                pattern.name().parse::<ProceduralTexture>().unwrap(),
                pattern
            );
        }
        let text = "wod".parse::<ProceduralTexture>().unwrap_err().to_string();
        assert!(
            text.contains("did you mean wood?") && text.contains("concrete"),
            "{text}"
        );
    }

    #[test]
    fn random_colours_stay_in_range() {
        let mut stream = SeedStream::named(1, "colors");
        for _ in 0..100 {
            let colour = random_colour(&mut stream, [0.2, 0.8], [0.3, 0.9]);
            assert!(colour.iter().all(|c| (0.0..=0.9).contains(c)), "{colour:?}");
        }
    }
}
