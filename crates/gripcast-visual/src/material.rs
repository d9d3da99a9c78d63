//! What surfaces are made of.

use std::ops::RangeInclusive;

use gripcast_base::error::{Error, Result};

/// Colour of a material: one value or a texture.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Colour {
    /// Linear RGB in [0, 1].
    Constant([f32; 3]),
    /// Index into [`Scene::textures`](super::Scene::textures).
    Texture(usize),
}

/// Reflection and transmission of a surface.
///
/// `roughness` is the square root of the width α of the GGX distribution of microfacets, in
/// [0, 1]. All materials but [`Material::Dielectric`] are opaque and alike on both sides.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Material {
    /// Ideal diffuse reflection.
    Diffuse {
        /// Fraction of the light that is reflected.
        reflectance: Colour,
    },
    /// Metallic-roughness model as in glTF: a dielectric layer over a diffuse base, blended with a
    /// metal of the same colour.
    Principled {
        /// Colour of the diffuse base and of the metal at normal incidence.
        base_colour: Colour,
        /// 0 dielectric to 1 metal.
        metallic: f32,
        /// 0 mirror to 1 dull.
        roughness: f32,
        /// Index of refraction of the layer, usually 1.5.
        ior: f32,
    },
    /// Metal by its complex index of refraction η + ik for red, green, blue.
    Conductor {
        /// Real part.
        eta: [f32; 3],
        /// Imaginary part.
        k: [f32; 3],
        /// 0 mirror to 1 dull.
        roughness: f32,
    },
    /// Solid glass. The mesh must be closed; its outside is where the corners of a triangle run
    /// counter-clockwise.
    Dielectric {
        /// Index of refraction inside over outside, e.g. 1.5.
        ior: f32,
        /// 0 clear to 1 frosted.
        roughness: f32,
        /// Factor on the light at each passage through the surface, linear RGB in [0, 1].
        transmittance: [f32; 3],
    },
}

impl Material {
    /// Diffuse grey.
    pub fn grey(reflectance: f32) -> Self {
        Self::Diffuse {
            reflectance: Colour::Constant([reflectance; 3]),
        }
    }

    /// The colour that may be a texture.
    pub fn colour(&self) -> Option<Colour> {
        match *self {
            Self::Diffuse { reflectance } => Some(reflectance),
            Self::Principled { base_colour, .. } => Some(base_colour),
            Self::Conductor { .. } | Self::Dielectric { .. } => None,
        }
    }
}

impl Material {
    /// Checks ranges and the index of the texture.
    pub(super) fn validate(&self, textures: usize) -> Result<()> {
        match *self {
            Self::Diffuse { .. } => Ok(()),
            Self::Principled {
                metallic,
                roughness,
                ior,
                ..
            } => {
                in_range("metallic", &[metallic], 0.0..=1.0)?;
                in_range("roughness", &[roughness], 0.0..=1.0)?;
                in_range("ior", &[ior], 1.0..=4.0)
            }
            Self::Conductor { eta, k, roughness } => {
                in_range("eta", &eta, 0.0..=100.0)?;
                in_range("k", &k, 0.0..=100.0)?;
                in_range("roughness", &[roughness], 0.0..=1.0)
            }
            Self::Dielectric {
                ior,
                roughness,
                transmittance,
            } => {
                in_range("ior", &[ior], 0.25..=4.0)?;
                in_range("roughness", &[roughness], 0.0..=1.0)?;
                in_range("transmittance", &transmittance, 0.0..=1.0)
            }
        }?;
        match self.colour() {
            Some(Colour::Constant(rgb)) => in_range("colour", &rgb, 0.0..=1.0),
            Some(Colour::Texture(t)) if t >= textures => Err(Error::input(format!(
                "it names texture {t}, but there are only {textures}"
            ))),
            Some(Colour::Texture(_)) | None => Ok(()),
        }
    }
}

pub(super) fn in_range(name: &str, values: &[f32], range: RangeInclusive<f32>) -> Result<()> {
    match values.iter().find(|v| !range.contains(v)) {
        None => Ok(()),
        Some(found) => Err(Error::input(format!(
            "{name} must be from {} to {}, found {found}",
            range.start(),
            range.end()
        ))),
    }
}
