//! Dielectric layer over a diffuse base, blended with a conductor.
//!
//! The base receives what the layer transmits on the way in and out: (1 - E(o)) (1 - E(i)) / (1 -
//! mean E), with the directional albedo E of the layer. This is reciprocal and makes a white base
//! exactly white. Energy that rough metal loses to multiple scattering is restored in the same way
//! (Kulla and Conty, *Revisiting physically based shading at Imageworks*, 2017).

use glam::Vec3;

use super::albedo_table::AlbedoTable;
use super::diffuse::{cosine_density, sample_cosine};
use super::fresnel::{f0_from_ior, schlick_weight};
use super::ggx::Ggx;
use super::{BsdfSample, BsdfValue};
use crate::linear_image::luminance;

/// Minimum sampling fraction of each lobe.
const MIN_LOBE_FRACTION: f32 = 0.1;

/// Parameters of the whole surface.
#[derive(Clone, Debug)]
pub(super) struct Principled {
    ggx: Ggx,
    metallic: f32,
    /// Reflectance of the layer at normal incidence.
    f0: f32,
    /// Directional single-scattering albedo for Fresnel reflectance 1.
    metal_albedo: AlbedoTable,
    /// Directional albedo of the layer.
    layer_albedo: AlbedoTable,
    mean_metal_albedo: f32,
    mean_layer_albedo: f32,
}

/// The surface at a point, seen from a direction.
#[derive(Clone, Copy, Debug)]
pub(in super::super) struct PrincipledBsdf<'a> {
    surface: &'a Principled,
    /// Fresnel reflectance at normal incidence.
    f0: Vec3,
    /// Factors of the diffuse base and of the metal's multiple scattering.
    base: Vec3,
    multi_scatter: Vec3,
    /// Fraction of the samples drawn from the specular lobe.
    fraction: f32,
}

impl Principled {
    pub(super) fn new(metallic: f32, roughness: f32, ior: f32) -> Self {
        let ggx = Ggx::from_roughness(roughness);
        let f0 = f0_from_ior(ior);
        let metal_albedo = AlbedoTable::new(|v, u| ggx.reflected(v, u).0);
        let layer_albedo = AlbedoTable::new(|v, u| {
            let (weight, cos) = ggx.reflected(v, u);
            weight * (f0 + (1.0 - f0) * schlick_weight(cos))
        });
        Self {
            ggx,
            metallic,
            f0,
            mean_metal_albedo: metal_albedo.mean(),
            mean_layer_albedo: layer_albedo.mean(),
            metal_albedo,
            layer_albedo,
        }
    }

    #[inline(always)]
    pub(super) fn at(&self, colour: Vec3, outgoing: Vec3) -> PrincipledBsdf<'_> {
        let metal = self.metallic;
        let passed = 1.0 - self.layer_albedo.at(outgoing.z);
        let hidden = 1.0 - self.metal_albedo.at(outgoing.z);
        let base = colour * ((1.0 - metal) * passed / (1.0 - self.mean_layer_albedo));
        let multi_scatter = if metal > 0.0 {
            let mean = colour + (Vec3::ONE - colour) / 21.0;
            let series = Vec3::ONE - mean * (1.0 - self.mean_metal_albedo);
            let factor =
                metal * self.mean_metal_albedo * hidden / (1.0 - self.mean_metal_albedo).max(1e-6);
            mean * mean / series * factor
        } else {
            Vec3::ZERO
        };
        let f0 = Vec3::splat((1.0 - metal) * self.f0) + metal * colour;
        let grey = luminance(colour.to_array());
        let facets = (1.0 - metal) * (1.0 - passed) + metal * grey * (1.0 - hidden);
        let spread = (1.0 - metal) * passed * grey + metal * grey * hidden;
        let fraction = facets / (facets + spread).max(1e-6);
        let fraction = if metal == 1.0 {
            // Dark metal has no base to sample.
            (1.0 - hidden).max(MIN_LOBE_FRACTION)
        } else {
            fraction.clamp(MIN_LOBE_FRACTION, 1.0 - MIN_LOBE_FRACTION)
        };
        PrincipledBsdf {
            surface: self,
            f0,
            base,
            multi_scatter,
            fraction,
        }
    }
}

impl PrincipledBsdf<'_> {
    #[inline(always)]
    pub(super) fn value(&self, outgoing: Vec3, incoming: Vec3) -> BsdfValue {
        let surface = self.surface;
        let ggx = &surface.ggx;
        let m = (outgoing + incoming).normalize_or_zero();
        let cos = outgoing.dot(m);
        let facets = ggx.ndf(m) / (4.0 * outgoing.z);
        let weight = schlick_weight(cos);
        let fresnel = self.f0 + (Vec3::ONE - self.f0) * weight;
        let cosine = cosine_density(incoming);
        let mut spread = self.base * (1.0 - surface.layer_albedo.at(incoming.z));
        if surface.metallic > 0.0 {
            spread += self.multi_scatter * (1.0 - surface.metal_albedo.at(incoming.z));
        }
        let g2 = ggx.smith_g2(outgoing, incoming);
        BsdfValue {
            value: fresnel * (facets * g2) + spread * cosine,
            pdf: self.fraction * facets * ggx.smith_g1(outgoing) + (1.0 - self.fraction) * cosine,
        }
    }

    #[inline(always)]
    pub(super) fn sample(&self, outgoing: Vec3, choice: f32, u: [f32; 2]) -> Option<BsdfSample> {
        let direction = if choice < self.fraction {
            let m = self.surface.ggx.sample_vndf(outgoing, u);
            2.0 * outgoing.dot(m) * m - outgoing
        } else {
            sample_cosine(u)
        };
        if direction.z <= 0.0 {
            return None;
        }
        let BsdfValue { value, pdf } = self.value(outgoing, direction);
        BsdfSample::new(direction, value, pdf)
    }

    /// Albedo for the denoiser.
    #[inline(always)]
    pub(super) fn albedo(&self) -> Vec3 {
        (self.base + self.f0).min(Vec3::ONE)
    }
}
