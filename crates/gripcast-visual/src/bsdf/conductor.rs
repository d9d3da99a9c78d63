//! Metal with a complex index of refraction.

use glam::Vec3;

use super::albedo_table::AlbedoTable;
use super::diffuse::{cosine_density, sample_cosine};
use super::fresnel::conductor;
use super::ggx::{Ggx, SMOOTH};
use super::{Sample, Value};

/// Metal; light that facets reflect repeatedly is given back as in
/// [`principled`](super::principled).
#[derive(Clone, Debug)]
pub(in super::super) struct Conductor {
    eta: Vec3,
    k: Vec3,
    facets: Option<Facets>,
}

/// Roughness of a surface that is no mirror.
#[derive(Clone, Debug)]
struct Facets {
    ggx: Ggx,
    /// Share that facets which reflect everything send back.
    all: AlbedoTable,
    /// Factor of the repeated reflections.
    repeated: Vec3,
}

impl Conductor {
    pub(super) fn new(eta: Vec3, k: Vec3, roughness: f32) -> Self {
        let rough = roughness * roughness >= SMOOTH;
        Self {
            eta,
            k,
            facets: rough.then(|| Facets::new(eta, k, roughness)),
        }
    }

    pub(super) fn is_mirror(&self) -> bool {
        self.facets.is_none()
    }

    #[inline(always)]
    pub(super) fn value(&self, outgoing: Vec3, incoming: Vec3) -> Value {
        let Some(rough) = &self.facets else {
            return Value::NONE;
        };
        let ggx = &rough.ggx;
        let m = (outgoing + incoming).normalize_or_zero();
        let facets = ggx.density(m) / (4.0 * outgoing.z);
        let fresnel = conductor(outgoing.dot(m), self.eta, self.k);
        let cosine = cosine_density(incoming);
        let fraction = rough.all.at(outgoing.z);
        let spread = (1.0 - fraction) * (1.0 - rough.all.at(incoming.z)) * cosine;
        let seen = ggx.visible_from_both(outgoing, incoming);
        Value {
            value: fresnel * (facets * seen) + rough.repeated * spread,
            pdf: fraction * facets * ggx.visible(outgoing) + (1.0 - fraction) * cosine,
        }
    }

    #[inline(always)]
    pub(super) fn sample(&self, outgoing: Vec3, choice: f32, u: [f32; 2]) -> Option<Sample> {
        let Some(rough) = &self.facets else {
            return Some(Sample {
                direction: Vec3::new(-outgoing.x, -outgoing.y, outgoing.z),
                weight: conductor(outgoing.z, self.eta, self.k),
                pdf: 1.0,
                delta: true,
            });
        };
        let direction = if choice < rough.all.at(outgoing.z) {
            let m = rough.ggx.sample_visible(outgoing, u);
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

    /// Reflectance at normal incidence.
    pub(super) fn albedo(&self) -> Vec3 {
        conductor(1.0, self.eta, self.k)
    }
}

impl Facets {
    fn new(eta: Vec3, k: Vec3, roughness: f32) -> Self {
        let ggx = Ggx::of_roughness(roughness);
        let all = AlbedoTable::new(|v, u| {
            let m = ggx.sample_visible(v, u);
            let i = 2.0 * v.dot(m) * m - v;
            let seen = ggx.visible_from_both(v, i) / ggx.visible(v);
            if i.z > 0.0 { seen } else { 0.0 }
        });
        let mean_all = all.mean();
        let steps = 256;
        let mut mean = Vec3::ZERO;
        for i in 0..steps {
            let cos = (i as f32 + 0.5) / steps as f32;
            mean += conductor(cos, eta, k) * (2.0 * cos / steps as f32);
        }
        let series = Vec3::ONE - mean * (1.0 - mean_all);
        let repeated = mean * mean / series * (mean_all / (1.0 - mean_all).max(1e-6));
        Self { ggx, all, repeated }
    }
}
