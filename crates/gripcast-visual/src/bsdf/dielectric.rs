//! Dielectric, smooth or rough (Walter et al., *Microfacet models for refraction through rough
//! surfaces*, 2007).
//!
//! Paths carry radiance divided by the squared index of refraction, which refraction preserves.
//! Energy lost to shadowing and masking is restored by a factor that depends on the outgoing
//! direction alone: rough glass conserves energy but is reciprocal only up to that factor.

use glam::Vec3;

use super::albedo_table::AlbedoTable;
use super::fresnel::fresnel_dielectric;
use super::ggx::{Ggx, MIN_ALPHA};
use super::{BsdfSample, BsdfValue};

/// Dielectric interface. Directions with z > 0 are outside.
#[derive(Clone, Debug)]
pub(in super::super) struct Dielectric {
    ior: f32,
    transmittance: Vec3,
    facets: Option<Rough>,
}

/// Microfacets of a rough surface.
#[derive(Clone, Debug)]
struct Rough {
    ggx: Ggx,
    /// Directional single-scattering albedo seen from outside and from inside.
    albedo: [AlbedoTable; 2],
}

impl Dielectric {
    pub(super) fn new(ior: f32, roughness: f32, transmittance: Vec3) -> Self {
        let rough = roughness * roughness >= MIN_ALPHA && ior != 1.0;
        let facets = rough.then(|| {
            let ggx = Ggx::from_roughness(roughness);
            let albedo = [ior, 1.0 / ior].map(|ior| {
                AlbedoTable::new(|v, u| {
                    let m = ggx.sample_vndf(v, u);
                    let (reflected, cos_t) = fresnel_dielectric(v.dot(m), ior);
                    let up = 2.0 * v.dot(m) * m - v;
                    let down = refracted(v, m, cos_t, ior);
                    let up = if up.z > 0.0 { ggx.smith_g1(up) } else { 0.0 };
                    let down = if down.z < 0.0 {
                        ggx.smith_g1(down)
                    } else {
                        0.0
                    };
                    reflected * up + (1.0 - reflected) * down
                })
            });
            Rough { ggx, albedo }
        });
        Self {
            ior,
            transmittance,
            facets,
        }
    }

    pub(super) fn is_smooth(&self) -> bool {
        self.facets.is_none()
    }

    /// Returns the index of refraction of the far side over the near side, and the sign that flips
    /// the near side up.
    #[inline(always)]
    fn seen_from(&self, outgoing: Vec3) -> (f32, f32) {
        if outgoing.z > 0.0 {
            (self.ior, 1.0)
        } else {
            (1.0 / self.ior, -1.0)
        }
    }

    #[inline(always)]
    fn tint(&self, reflects: bool) -> Vec3 {
        match reflects {
            true => Vec3::ONE,
            false => self.transmittance,
        }
    }

    #[inline(always)]
    pub(super) fn value(&self, outgoing: Vec3, incoming: Vec3) -> BsdfValue {
        let Some(rough) = &self.facets else {
            return BsdfValue::NONE;
        };
        let (ior, side) = self.seen_from(outgoing);
        let (o, i) = (outgoing * side, incoming * side);
        let reflects = i.z > 0.0;
        let m = if reflects { o + i } else { -(o + ior * i) };
        let m = m.normalize_or_zero();
        let m = if m.z < 0.0 { -m } else { m };
        let (cos_o, cos_i) = (o.dot(m), i.dot(m));
        if cos_o <= 0.0 || (cos_i > 0.0) != reflects {
            return BsdfValue::NONE;
        }
        let (fresnel, _) = fresnel_dielectric(cos_o, ior);
        let visible = rough.ggx.vndf_pdf(o, m);
        let pdf = density(fresnel, visible, [cos_o, cos_i], ior);
        let tint = self.tint(reflects);
        BsdfValue {
            value: tint * (pdf * rough.weight(o, i, side)),
            pdf,
        }
    }

    #[inline(always)]
    pub(super) fn sample(&self, outgoing: Vec3, choice: f32, u: [f32; 2]) -> Option<BsdfSample> {
        let (ior, side) = self.seen_from(outgoing);
        let o = outgoing * side;
        let m = match &self.facets {
            Some(rough) => rough.ggx.sample_vndf(o, u),
            None => Vec3::Z,
        };
        let cos_o = o.dot(m);
        let (fresnel, cos_t) = fresnel_dielectric(cos_o, ior);
        let reflects = choice < fresnel;
        let i = if reflects {
            2.0 * cos_o * m - o
        } else {
            refracted(o, m, cos_t, ior)
        };
        if (i.z > 0.0) != reflects || i.z == 0.0 {
            return None;
        }
        let tint = self.tint(reflects);
        let Some(rough) = &self.facets else {
            return Some(BsdfSample {
                direction: i * side,
                weight: tint,
                pdf: 1.0,
                delta: true,
            });
        };
        let visible = rough.ggx.vndf_pdf(o, m);
        let cos_i = if reflects { cos_o } else { i.dot(m) };
        let pdf = density(fresnel, visible, [cos_o, cos_i], ior);
        let weight = tint * rough.weight(o, i, side);
        (pdf > 0.0 && pdf.is_finite()).then_some(BsdfSample {
            direction: i * side,
            weight,
            pdf,
            delta: false,
        })
    }
}

impl Rough {
    /// Returns value over density of a sample, without tint.
    #[inline(always)]
    fn weight(&self, o: Vec3, i: Vec3, side: f32) -> f32 {
        let albedo = &self.albedo[usize::from(side < 0.0)];
        self.ggx.smith_g1(i) / albedo.at(o.z).max(1e-3)
    }
}

/// Sampling density of the incoming direction, given the density of the visible normal; the
/// direction is reflected if the cosines have the same sign, else refracted.
#[inline(always)]
fn density(fresnel: f32, visible: f32, [cos_o, cos_i]: [f32; 2], ior: f32) -> f32 {
    if cos_i > 0.0 {
        return fresnel * visible / (4.0 * cos_o);
    }
    let stretch = cos_o + ior * cos_i;
    let jacobian = ior * ior * -cos_i / (stretch * stretch).max(f32::MIN_POSITIVE);
    (1.0 - fresnel) * visible * jacobian
}

/// Returns the direction of light refracted at a microfacet towards `o`.
#[inline(always)]
fn refracted(o: Vec3, m: Vec3, cos_t: f32, ior: f32) -> Vec3 {
    let cos_o = o.dot(m);
    (cos_o / ior - cos_t) * m - o / ior
}
