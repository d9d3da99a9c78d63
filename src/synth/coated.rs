//! An object with an appearance, as the path tracer draws it.

use image::{Rgb, RgbImage};

use super::properties::{FinishClass, Look, PatternWord};
use crate::error::Result;
use crate::geometry::TriangleMesh;
use crate::imaging::{srgb_decode, srgb_encode};
use crate::render::visual::{
    Bitmap, CREASE_RAD, Colour, Material, Model, Pattern, Projection, Texture, shaded_mesh,
};

/// Width and height of painted textures, px.
const TEXTURE_PX: u32 = 256;
/// Index of refraction of glass, plastic and lacquer.
const IOR: f32 = 1.5;
/// Share of a print's own colours beside the appearance's.
const PRINT_SHARE: f32 = 0.6;

/// The model of a mesh (m) with an appearance; the seed says where grain and wear lie.
///
/// # Errors
/// None for a valid mesh.
pub(super) fn coated_model(mesh: &TriangleMesh, look: &Look, seed: u64) -> Result<Model> {
    if look.finish == FinishClass::Glass {
        let material = Material::Dielectric {
            ior: IOR,
            roughness: look.roughness,
            transmittance: look.base_colour,
        };
        return Ok(Model {
            meshes: vec![shaded_mesh(mesh, CREASE_RAD, Projection::None, 0)],
            materials: vec![material],
            textures: Vec::new(),
        });
    }
    let painted = pattern(look).paint(TEXTURE_PX, seed);
    let picture = recoloured(&painted.picture, look);
    let material = Material::Principled {
        base_colour: Colour::Texture(0),
        metallic: if look.finish == FinishClass::Metal {
            1.0
        } else {
            0.0
        },
        roughness: look.roughness,
        ior: IOR,
    };
    let projection = Projection::Box {
        width_m: painted.tile_m,
        origin_m: mesh.bounds().min,
    };
    Ok(Model {
        meshes: vec![shaded_mesh(mesh, CREASE_RAD, projection, 0)],
        materials: vec![material],
        textures: vec![Texture::Bitmap(Bitmap::from_srgb8(&picture)?)],
    })
}

fn pattern(look: &Look) -> Pattern {
    match (look.finish, look.pattern) {
        (_, PatternWord::Grain) | (FinishClass::Wood, _) => Pattern::Wood,
        (_, PatternWord::Brushed) | (FinishClass::Metal, _) => Pattern::BrushedMetal,
        (_, PatternWord::Woven | PatternWord::Knitted) | (FinishClass::Fabric, _) => {
            Pattern::Fabric
        }
        (_, PatternWord::Printed) | (FinishClass::Print, _) => Pattern::Print,
        (_, PatternWord::Marbled) | (FinishClass::Stone, _) => Pattern::Stone,
        (_, PatternWord::Speckled) | (FinishClass::Ceramic, _) => Pattern::Ceramic,
        (_, PatternWord::Mottled | PatternWord::Worn | PatternWord::Rusty) => Pattern::Noise,
        _ => Pattern::Plastic,
    }
}

/// The lights and darks of a picture in the colour of the appearance.
fn recoloured(picture: &RgbImage, look: &Look) -> RgbImage {
    let light = |pixel: &Rgb<u8>| {
        let [r, g, b] = pixel.0.map(srgb_decode);
        0.2126 * r + 0.7152 * g + 0.0722 * b
    };
    let sum: f32 = picture.pixels().map(light).sum();
    let mean = (sum / picture.len().max(1) as f32 * 3.0).max(1e-3);
    let own = if pattern(look) == Pattern::Print {
        PRINT_SHARE
    } else {
        0.0
    };
    let mut recoloured = picture.clone();
    for pixel in recoloured.pixels_mut() {
        let factor = light(pixel) / mean;
        let level = |c: usize| {
            let coloured = look.base_colour[c] * factor;
            let kept = srgb_decode(pixel[c]);
            srgb_encode((coloured + own * (kept - coloured)).clamp(0.0, 1.0))
        };
        *pixel = Rgb([level(0), level(1), level(2)]);
    }
    recoloured
}
