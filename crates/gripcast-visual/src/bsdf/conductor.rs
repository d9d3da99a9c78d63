//! Conductor with a complex index of refraction.

use glam::Vec3;

use super::albedo_table::AlbedoTable;
use super::diffuse::{cosine_density, sample_cosine};
use super::fresnel::fresnel_conductor;
use super::ggx::{Ggx, MIN_ALPHA};
use super::{BsdfSample, BsdfValue};

/// Rough or smooth metal, with multiple scattering as in [`principled`](super::principled).
#[derive(Clone, Debug)]
pub(in super::super) struct Conductor {
    eta: Vec3,
    k: Vec3,
    facets: Option<Rough>,
}

/// Microfacets of a rough surface.
#[derive(Clone, Debug)]
struct Rough {
    ggx: Ggx,
    /// Directional single-scattering albedo for Fresnel reflectance 1.
    albedo: AlbedoTable,
    /// Factor of the multiple-scattering lobe.
    multi_scatter: Vec3,
}

impl Conductor {
    pub(super) fn new(eta: Vec3, k: Vec3, roughness: f32) -> Self {
        let rough = roughness * roughness >= MIN_ALPHA;
        Self {
            eta,
            k,
            facets: rough.then(|| Rough::new(eta, k, roughness)),
        }
    }

    pub(super) fn is_smooth(&self) -> bool {
        self.facets.is_none()
    }

    #[inline(always)]
    pub(super) fn value(&self, outgoing: Vec3, incoming: Vec3) -> BsdfValue {
        let Some(rough) = &self.facets else {
            return BsdfValue::NONE;
        };
        let ggx = &rough.ggx;
        let m = (outgoing + incoming).normalize_or_zero();
        let facets = ggx.ndf(m) / (4.0 * outgoing.z);
        let fresnel = fresnel_conductor(outgoing.dot(m), self.eta, self.k);
        let cosine = cosine_density(incoming);
        let fraction = rough.albedo.at(outgoing.z);
        let diffuse_lobe = (1.0 - fraction) * (1.0 - rough.albedo.at(incoming.z)) * cosine;
        let g2 = ggx.smith_g2(outgoing, incoming);
        BsdfValue {
            value: fresnel * (facets * g2) + rough.multi_scatter * diffuse_lobe,
            pdf: fraction * facets * ggx.smith_g1(outgoing) + (1.0 - fraction) * cosine,
        }
    }

    #[inline(always)]
    pub(super) fn sample(&self, outgoing: Vec3, choice: f32, u: [f32; 2]) -> Option<BsdfSample> {
        let Some(rough) = &self.facets else {
            return Some(BsdfSample {
                direction: Vec3::new(-outgoing.x, -outgoing.y, outgoing.z),
                weight: fresnel_conductor(outgoing.z, self.eta, self.k),
                pdf: 1.0,
                delta: true,
            });
        };
        let direction = if choice < rough.albedo.at(outgoing.z) {
            let m = rough.ggx.sample_vndf(outgoing, u);
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

    /// Returns the reflectance at normal incidence.
    pub(super) fn albedo(&self) -> Vec3 {
        fresnel_conductor(1.0, self.eta, self.k)
    }
}

impl Rough {
    fn new(eta: Vec3, k: Vec3, roughness: f32) -> Self {
        let ggx = Ggx::from_roughness(roughness);
        let albedo = AlbedoTable::new(|v, u| ggx.reflected(v, u).0);
        let mean_albedo = albedo.mean();
        let steps = 256;
        let mut mean = Vec3::ZERO;
        for i in 0..steps {
            let cos = (i as f32 + 0.5) / steps as f32;
            mean += fresnel_conductor(cos, eta, k) * (2.0 * cos / steps as f32);
        }
        let series = Vec3::ONE - mean * (1.0 - mean_albedo);
        let multi_scatter = mean * mean / series * (mean_albedo / (1.0 - mean_albedo).max(1e-6));
        Self {
            ggx,
            albedo,
            multi_scatter,
        }
    }
}
