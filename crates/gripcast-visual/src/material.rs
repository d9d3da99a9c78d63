//! Surface materials.

use std::ops::RangeInclusive;

use gripcast_base::error::{Error, Result};

/// Index of refraction of glass, plastic, varnish and glaze.
pub(super) const IOR: f32 = 1.5;

/// Colour of a material: constant or textured.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Colour {
    /// Linear RGB in [0, 1].
    Constant([f32; 3]),
    /// Index into [`Scene::textures`](super::Scene::textures).
    Texture(usize),
}

/// Material of a surface.
///
/// `roughness` in [0, 1] is the square root of the GGX width α. All materials except
/// [`Material::Dielectric`] are opaque and two-sided.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Material {
    /// Lambertian reflection.
    Diffuse {
        /// Albedo.
        reflectance: Colour,
    },
    /// Metallic-roughness model of glTF: a dielectric layer over a diffuse base, blended with a
    /// metal of the same colour.
    Principled {
        /// Albedo of the base and reflectance of the metal at normal incidence.
        base_colour: Colour,
        /// From 0 (dielectric) to 1 (metal).
        metallic: f32,
        /// From 0 (mirror) to 1 (matt).
        roughness: f32,
        /// Index of refraction of the layer, usually 1.5.
        ior: f32,
    },
    /// Metal with the complex index of refraction η + ik for red, green, blue.
    Conductor {
        /// η.
        eta: [f32; 3],
        /// k.
        k: [f32; 3],
        /// From 0 (mirror) to 1 (matt).
        roughness: f32,
    },
    /// Solid glass. The mesh must be closed, with triangles counter-clockwise seen from outside.
    Dielectric {
        /// Index of refraction, inside over outside, e.g. 1.5.
        ior: f32,
        /// From 0 (clear) to 1 (frosted).
        roughness: f32,
        /// Transmittance of each interface, linear RGB in [0, 1].
        transmittance: [f32; 3],
    },
}

impl Material {
    /// Lambertian grey.
    pub fn grey(reflectance: f32) -> Self {
        Self::Diffuse {
            reflectance: Colour::Constant([reflectance; 3]),
        }
    }

    /// Principled material with the index of refraction of plastic, varnish and glaze.
    pub(super) fn glossy(base_colour: Colour, metallic: f32, roughness: f32) -> Self {
        Self::Principled {
            base_colour,
            metallic,
            roughness,
            ior: IOR,
        }
    }

    /// Returns the colour that may be textured.
    pub fn colour(&self) -> Option<Colour> {
        match *self {
            Self::Diffuse { reflectance } => Some(reflectance),
            Self::Principled { base_colour, .. } => Some(base_colour),
            Self::Conductor { .. } | Self::Dielectric { .. } => None,
        }
    }

    /// Checks the ranges and the texture index, given the number of textures.
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
            Some(Colour::Texture(t)) => ensure(t < textures, || {
                format!("texture index {t} is out of range, the scene has {textures} textures")
            }),
            None => Ok(()),
        }
    }
}

pub(super) fn in_range(name: &str, values: &[f32], range: RangeInclusive<f32>) -> Result<()> {
    let outside = values.iter().find(|v| !range.contains(v));
    ensure(outside.is_none(), || {
        let (low, high, found) = (range.start(), range.end(), outside.unwrap_or(&f32::NAN));
        format!("{name} must be from {low} to {high}, found {found}")
    })
}

/// Fails with an `Input` error of the given text unless the condition holds.
pub(super) fn ensure(holds: bool, text: impl FnOnce() -> String) -> Result<()> {
    if holds {
        Ok(())
    } else {
        Err(Error::input(text()))
    }
}
