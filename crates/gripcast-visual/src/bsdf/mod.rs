//! How surfaces scatter light: value, density and sampling of each material in one place.
//!
//! Directions are unit vectors away from the surface in its local frame, z along the shading
//! normal: `outgoing` towards the camera, `incoming` towards the light. Opaque materials are only
//! asked with both above the surface.

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

/// What a pair of directions gives.
#[derive(Clone, Copy, Debug)]
pub(super) struct BsdfValue {
    /// Scattered fraction times |cos| of the incoming direction, 1/sr.
    pub(super) value: Vec3,
    /// Density with which the incoming direction is sampled, 1/sr.
    pub(super) pdf: f32,
}

impl BsdfValue {
    const NONE: Self = Self {
        value: Vec3::ZERO,
        pdf: 0.0,
    };
}

/// A sampled direction.
#[derive(Clone, Copy, Debug)]
pub(super) struct BsdfSample {
    /// Incoming direction.
    pub(super) direction: Vec3,
    /// BsdfValue over density.
    pub(super) weight: Vec3,
    /// Density, 1/sr; meaningless for `delta`.
    pub(super) pdf: f32,
    /// Only this direction scatters: no other way of sampling finds it.
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

/// Material with everything that does not depend on the place computed.
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

/// Material at a place, seen from a direction.
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

    /// Whether light passes through, so that it matters which side is outside.
    #[inline(always)]
    pub(super) fn transmits(&self) -> bool {
        matches!(self.kind, Kind::Dielectric(_))
    }

    /// Whether only sampling finds the directions that scatter.
    #[inline(always)]
    pub(super) fn is_delta(&self) -> bool {
        match &self.kind {
            Kind::Diffuse | Kind::Principled(_) => false,
            Kind::Conductor(surface) => surface.is_smooth(),
            Kind::Dielectric(surface) => surface.is_smooth(),
        }
    }

    /// The material at texture coordinates, seen from `outgoing`.
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
    /// Whether light passes through.
    #[inline(always)]
    pub(super) fn transmits(&self) -> bool {
        matches!(self, Self::Dielectric(_))
    }

    /// BsdfValue and density of a pair of directions.
    #[inline(always)]
    pub(super) fn value(&self, outgoing: Vec3, incoming: Vec3) -> BsdfValue {
        match self {
            Self::Diffuse(reflectance) => diffuse::value(*reflectance, incoming),
            Self::Principled(surface) => surface.value(outgoing, incoming),
            Self::Conductor(surface) => surface.value(outgoing, incoming),
            Self::Dielectric(surface) => surface.value(outgoing, incoming),
        }
    }

    /// Samples an incoming direction from three numbers in [0, 1); `None` where none scatters.
    #[inline(always)]
    pub(super) fn sample(&self, outgoing: Vec3, choice: f32, u: [f32; 2]) -> Option<BsdfSample> {
        match self {
            Self::Diffuse(reflectance) => Some(diffuse::sample(*reflectance, u)),
            Self::Principled(surface) => surface.sample(outgoing, choice, u),
            Self::Conductor(surface) => surface.sample(outgoing, choice, u),
            Self::Dielectric(surface) => surface.sample(outgoing, choice, u),
        }
    }

    /// Colour that guides a denoiser.
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
