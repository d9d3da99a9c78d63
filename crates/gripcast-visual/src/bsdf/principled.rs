//! Dielectric layer over a diffuse base, blended with metal.
//!
//! The base gets what the layer lets through, on the way in and out: (1 - E(o)) (1 - E(i)) /
//! (1 - mean E), with E the share that the layer reflects in all. This keeps reciprocity, and a
//! white base makes the whole exactly white. What rough metal loses because facets hide one
//! another is given back the same way (Kulla and Conty, *Revisiting physically based shading at
//! Imageworks*, 2017).

use glam::Vec3;

use super::albedo_table::AlbedoTable;
use super::diffuse::{cosine_density, sample_cosine};
use super::fresnel::{normal_reflectance, schlick_weight};
use super::ggx::Ggx;
use super::{Sample, Value};
use crate::linear_image::luminance;

/// Least fraction of either lobe in the samples, so that none is starved.
const MIN_FRACTION: f32 = 0.1;

/// Parameters that hold for the whole surface.
#[derive(Clone, Debug)]
pub(super) struct Principled {
    ggx: Ggx,
    metallic: f32,
    /// Reflectance of the layer at normal incidence.
    normal: f32,
    /// Share that facets which reflect everything send back.
    all: AlbedoTable,
    /// Share that the layer sends back.
    layer: AlbedoTable,
    mean_all: f32,
    mean_layer: f32,
}

/// The surface at a place, seen from a direction.
#[derive(Clone, Copy, Debug)]
pub(in super::super) struct PrincipledAt<'a> {
    surface: &'a Principled,
    /// Reflectance of facets at normal incidence.
    normal: Vec3,
    /// Factors of the base and of the metal's repeated reflections.
    base: Vec3,
    repeated: Vec3,
    /// Fraction of the samples that go to the facets.
    fraction: f32,
}

impl Principled {
    pub(super) fn new(metallic: f32, roughness: f32, ior: f32) -> Self {
        let ggx = Ggx::of_roughness(roughness);
        let normal = normal_reflectance(ior);
        let weight = |v: Vec3, u: [f32; 2]| {
            let m = ggx.sample_visible(v, u);
            let i = 2.0 * v.dot(m) * m - v;
            let seen = ggx.visible_from_both(v, i) / ggx.visible(v);
            (if i.z > 0.0 { seen } else { 0.0 }, v.dot(m))
        };
        let all = AlbedoTable::new(|v, u| weight(v, u).0);
        let layer = AlbedoTable::new(|v, u| {
            let (seen, cos) = weight(v, u);
            seen * (normal + (1.0 - normal) * schlick_weight(cos))
        });
        Self {
            ggx,
            metallic,
            normal,
            mean_all: all.mean(),
            mean_layer: layer.mean(),
            all,
            layer,
        }
    }

    #[inline(always)]
    pub(super) fn at(&self, colour: Vec3, outgoing: Vec3) -> PrincipledAt<'_> {
        let metal = self.metallic;
        let passed = 1.0 - self.layer.at(outgoing.z);
        let hidden = 1.0 - self.all.at(outgoing.z);
        let base = colour * ((1.0 - metal) * passed / (1.0 - self.mean_layer));
        let repeated = if metal > 0.0 {
            let mean = colour + (Vec3::ONE - colour) / 21.0;
            let series = Vec3::ONE - mean * (1.0 - self.mean_all);
            let factor = metal * self.mean_all * hidden / (1.0 - self.mean_all).max(1e-6);
            mean * mean / series * factor
        } else {
            Vec3::ZERO
        };
        let normal = Vec3::splat((1.0 - metal) * self.normal) + metal * colour;
        let grey = luminance(colour.to_array());
        let facets = (1.0 - metal) * (1.0 - passed) + metal * grey * (1.0 - hidden);
        let spread = (1.0 - metal) * passed * grey + metal * grey * hidden;
        let fraction = facets / (facets + spread).max(1e-6);
        let fraction = if metal == 1.0 {
            // Dark metal has no base that could be starved.
            (1.0 - hidden).max(MIN_FRACTION)
        } else {
            fraction.clamp(MIN_FRACTION, 1.0 - MIN_FRACTION)
        };
        PrincipledAt {
            surface: self,
            normal,
            base,
            repeated,
            fraction,
        }
    }
}

impl PrincipledAt<'_> {
    #[inline(always)]
    pub(super) fn value(&self, outgoing: Vec3, incoming: Vec3) -> Value {
        let surface = self.surface;
        let ggx = &surface.ggx;
        let m = (outgoing + incoming).normalize_or_zero();
        let cos = outgoing.dot(m);
        let facets = ggx.density(m) / (4.0 * outgoing.z);
        let weight = schlick_weight(cos);
        let fresnel = self.normal + (Vec3::ONE - self.normal) * weight;
        let cosine = cosine_density(incoming);
        let mut spread = self.base * (1.0 - surface.layer.at(incoming.z));
        if surface.metallic > 0.0 {
            spread += self.repeated * (1.0 - surface.all.at(incoming.z));
        }
        let seen = ggx.visible_from_both(outgoing, incoming);
        Value {
            value: fresnel * (facets * seen) + spread * cosine,
            pdf: self.fraction * facets * ggx.visible(outgoing) + (1.0 - self.fraction) * cosine,
        }
    }

    #[inline(always)]
    pub(super) fn sample(&self, outgoing: Vec3, choice: f32, u: [f32; 2]) -> Option<Sample> {
        let direction = if choice < self.fraction {
            let m = self.surface.ggx.sample_visible(outgoing, u);
            2.0 * outgoing.dot(m) * m - outgoing
        } else {
            sample_cosine(u)
        };
        if direction.z <= 0.0 {
            return None;
        }
        let Value { value, pdf } = self.value(outgoing, direction);
        Sample::of(direction, value, pdf)
    }

    /// Fraction of the light that is sent back in all, for guiding a denoiser.
    #[inline(always)]
    pub(super) fn albedo(&self) -> Vec3 {
        (self.base + self.normal).min(Vec3::ONE)
    }
}
