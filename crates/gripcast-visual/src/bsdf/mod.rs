//! BSDFs: value, density and sampling of each material.
//!
//! Directions are unit vectors away from the surface in the shading frame, z along the shading
//! normal: `outgoing` towards the camera, `incoming` towards the light. Opaque materials are
//! evaluated only with both above the surface.

mod albedo_table;
mod conductor;
mod dielectric;
mod diffuse;
mod fresnel;
mod ggx;
mod principled;

use glam::Vec3;

use self::conductor::Conductor;
use self::dielectric::Dielectric;
use self::principled::{Principled, PrincipledBsdf};
use super::material::{Colour, Material};
use super::texture::Bitmap;

/// BSDF value and density for a pair of directions.
#[derive(Clone, Copy, Debug)]
pub(super) struct BsdfValue {
    /// BSDF times |cos| of the incoming direction, 1/sr.
    pub(super) value: Vec3,
    /// Sampling density of the incoming direction, 1/sr.
    pub(super) pdf: f32,
}

impl BsdfValue {
    const NONE: Self = Self {
        value: Vec3::ZERO,
        pdf: 0.0,
    };
}

/// A sampled incoming direction.
#[derive(Clone, Copy, Debug)]
pub(super) struct BsdfSample {
    /// Incoming direction.
    pub(super) direction: Vec3,
    /// Value over density.
    pub(super) weight: Vec3,
    /// Density, 1/sr; meaningless if `delta`.
    pub(super) pdf: f32,
    /// Whether the direction comes from a delta lobe.
    pub(super) delta: bool,
}

impl BsdfSample {
    #[inline(always)]
    fn new(direction: Vec3, value: Vec3, pdf: f32) -> Option<Self> {
        (pdf > 0.0).then(|| Self {
            direction,
            weight: value / pdf,
            pdf,
            delta: false,
        })
    }
}

/// Material with everything precomputed that does not depend on position and direction.
#[derive(Clone, Debug)]
pub(super) struct PreparedMaterial {
    kind: Kind,
    colour: Colour,
}

#[derive(Clone, Debug)]
enum Kind {
    Diffuse,
    Principled(Box<Principled>),
    Conductor(Box<Conductor>),
    Dielectric(Box<Dielectric>),
}

/// BSDF at a surface point seen from a direction.
#[derive(Clone, Copy, Debug)]
pub(super) enum Bsdf<'a> {
    Diffuse(Vec3),
    Principled(PrincipledBsdf<'a>),
    Conductor(&'a Conductor),
    Dielectric(&'a Dielectric),
}

impl PreparedMaterial {
    pub(super) fn new(material: &Material) -> Self {
        let kind = match *material {
            Material::Diffuse { .. } => Kind::Diffuse,
            Material::Principled {
                metallic,
                roughness,
                ior,
                ..
            } => Kind::Principled(Box::new(Principled::new(metallic, roughness, ior))),
            Material::Conductor { eta, k, roughness } => {
                Kind::Conductor(Box::new(Conductor::new(eta.into(), k.into(), roughness)))
            }
            Material::Dielectric {
                ior,
                roughness,
                transmittance,
            } => Kind::Dielectric(Box::new(Dielectric::new(
                ior,
                roughness,
                transmittance.into(),
            ))),
        };
        Self {
            kind,
            colour: material.colour().unwrap_or(Colour::Constant([1.0; 3])),
        }
    }

    /// Whether the material transmits light.
    #[inline(always)]
    pub(super) fn transmits(&self) -> bool {
        matches!(self.kind, Kind::Dielectric(_))
    }

    /// Whether the BSDF has only delta lobes.
    #[inline(always)]
    pub(super) fn is_delta(&self) -> bool {
        match &self.kind {
            Kind::Diffuse | Kind::Principled(_) => false,
            Kind::Conductor(surface) => surface.is_smooth(),
            Kind::Dielectric(surface) => surface.is_smooth(),
        }
    }

    /// Returns the BSDF at texture coordinates, seen from `outgoing`.
    #[inline(always)]
    pub(super) fn at(&self, textures: &[Bitmap], uv: [f32; 2], outgoing: Vec3) -> Bsdf<'_> {
        let colour = || match self.colour {
            Colour::Constant(rgb) => Vec3::from_array(rgb),
            Colour::Texture(t) => Vec3::from_array(textures[t].sample(uv)),
        };
        match &self.kind {
            Kind::Diffuse => Bsdf::Diffuse(colour()),
            Kind::Principled(surface) => Bsdf::Principled(surface.at(colour(), outgoing)),
            Kind::Conductor(surface) => Bsdf::Conductor(surface),
            Kind::Dielectric(surface) => Bsdf::Dielectric(surface),
        }
    }
}

impl Bsdf<'_> {
    /// Whether the material transmits light.
    #[inline(always)]
    pub(super) fn transmits(&self) -> bool {
        matches!(self, Self::Dielectric(_))
    }

    /// Evaluates a pair of directions.
    #[inline(always)]
    pub(super) fn value(&self, outgoing: Vec3, incoming: Vec3) -> BsdfValue {
        match self {
            Self::Diffuse(reflectance) => diffuse::value(*reflectance, incoming),
            Self::Principled(surface) => surface.value(outgoing, incoming),
            Self::Conductor(surface) => surface.value(outgoing, incoming),
            Self::Dielectric(surface) => surface.value(outgoing, incoming),
        }
    }

    /// Samples an incoming direction from three numbers in [0, 1); `None` if nothing scatters.
    #[inline(always)]
    pub(super) fn sample(&self, outgoing: Vec3, choice: f32, u: [f32; 2]) -> Option<BsdfSample> {
        match self {
            Self::Diffuse(reflectance) => Some(diffuse::sample(*reflectance, u)),
            Self::Principled(surface) => surface.sample(outgoing, choice, u),
            Self::Conductor(surface) => surface.sample(outgoing, choice, u),
            Self::Dielectric(surface) => surface.sample(outgoing, choice, u),
        }
    }

    /// Albedo for the denoiser.
    #[inline(always)]
    pub(super) fn albedo(&self) -> Vec3 {
        match self {
            Self::Diffuse(reflectance) => *reflectance,
            Self::Principled(surface) => surface.albedo(),
            Self::Conductor(surface) => surface.albedo(),
            Self::Dielectric(_) => Vec3::ONE,
        }
    }
}

#[cfg(test)]
#[path = "bsdf_test.rs"]
mod tests;
