//! Default materials for bodies without their own.

use std::str::FromStr;

use super::material::{Colour, IOR, Material};
use super::procedural::ProceduralTexture;
use super::texture::Bitmap;
use gripcast_base::error::{Error, Result, unknown_name};

/// Side of the generated textures, px.
const TEXTURE_PX: u32 = 512;

/// Complex index of refraction (η, k) of chromium, which resembles stainless steel, at 630, 532 and
/// 465 nm (Rakic et al., Applied Optics, 1998).
pub(super) const STEEL: [[f32; 3]; 2] = [[3.11, 3.18, 2.32], [3.33, 3.33, 3.135]];

/// Material of a whole body.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Finish {
    /// Procedural texture.
    Textured(ProceduralTexture),
    /// Clear glass; the mesh must be closed.
    Glass,
    /// Polished stainless steel (optical constants of chromium).
    Steel,
    /// Polished aluminium.
    Aluminium,
    /// Polished copper.
    Copper,
    /// Polished gold.
    Gold,
}

impl Finish {
    const UNTEXTURED: [Self; 5] = [
        Self::Glass,
        Self::Steel,
        Self::Aluminium,
        Self::Copper,
        Self::Gold,
    ];

    /// Iterates over all finishes.
    pub fn all() -> impl Iterator<Item = Self> {
        let textured = ProceduralTexture::ALL.into_iter().map(Self::Textured);
        textured.chain(Self::UNTEXTURED)
    }

    /// Name on the command line and in files.
    pub fn name(self) -> &'static str {
        match self {
            Self::Textured(texture) => texture.name(),
            Self::Glass => "glass",
            Self::Steel => "steel",
            Self::Aluminium => "aluminium",
            Self::Copper => "copper",
            Self::Gold => "gold",
        }
    }

    /// Returns the material and, for textured finishes, the texture and its width on the surface,
    /// m. The material refers to the texture by the index `texture`.
    ///
    /// # Errors
    /// None in practice; passed on from [`Bitmap::from_srgb8`].
    pub(super) fn material(
        self,
        seed: u64,
        texture: usize,
    ) -> Result<(Material, Option<(Bitmap, f64)>)> {
        // (η, k) as for [`STEEL`].
        let (eta, k, roughness) = match self {
            Self::Textured(texture_kind) => {
                let generated = texture_kind.generate(TEXTURE_PX, seed);
                let colour = Colour::Texture(texture);
                let material = Material::glossy(colour, generated.metallic, generated.roughness);
                let bitmap = Bitmap::from_srgb8(&generated.image)?;
                return Ok((material, Some((bitmap, generated.tile_m))));
            }
            Self::Glass => {
                let material = Material::Dielectric {
                    ior: IOR,
                    roughness: 0.0,
                    transmittance: [0.98, 0.99, 0.985],
                };
                return Ok((material, None));
            }
            Self::Steel => (STEEL[0], STEEL[1], 0.22),
            Self::Aluminium => ([1.35, 0.97, 0.62], [7.47, 6.40, 5.30], 0.25),
            Self::Copper => ([0.20, 0.92, 1.10], [3.91, 2.45, 2.14], 0.2),
            Self::Gold => ([0.14, 0.37, 1.44], [3.98, 2.39, 1.60], 0.18),
        };
        Ok((Material::Conductor { eta, k, roughness }, None))
    }
}

impl FromStr for Finish {
    type Err = Error;

    fn from_str(text: &str) -> Result<Self> {
        let found = Self::all().find(|f| f.name() == text);
        found.ok_or_else(|| {
            let names: Vec<&str> = Self::all().map(Self::name).collect();
            unknown_name("finish", text, &names)
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_finish_has_a_name_and_a_material() {
        for finish in Finish::all() {
            assert_eq!(finish.name().parse::<Finish>().unwrap(), finish);
            let (material, texture) = finish.material(1, 0).unwrap();
            material.validate(usize::from(texture.is_some())).unwrap();
            assert_eq!(texture.is_some(), matches!(finish, Finish::Textured(_)));
        }
        let text = "glas".parse::<Finish>().unwrap_err().to_string();
        assert!(text.contains("did you mean glass?"), "{text}");
    }
}
