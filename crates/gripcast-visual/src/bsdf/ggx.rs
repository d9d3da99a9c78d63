//! GGX microfacet distribution with visible-normal sampling.
//!
//! Sources: Walter et al., *Microfacet models for refraction through rough surfaces* (2007); Heitz,
//! *Understanding the masking-shadowing function* (2014); Dupuy and Benyoub, *Sampling visible GGX
//! normals with spherical caps* (2023).

use std::f32::consts::PI;

use glam::Vec3;

use super::super::trigonometry::sin_cos_turns;

/// Minimum α of a rough surface; below it the surface is smooth.
pub(super) const MIN_ALPHA: f32 = 1e-3;

/// Isotropic GGX distribution. Vectors are in the shading frame, z along the normal.
#[derive(Clone, Copy, Debug)]
pub(super) struct Ggx {
    /// Width α.
    alpha: f32,
}

impl Ggx {
    /// Distribution of a perceptual roughness in [0, 1].
    pub(super) fn from_roughness(roughness: f32) -> Self {
        Self {
            alpha: (roughness * roughness).max(MIN_ALPHA),
        }
    }

    /// Normal distribution D(m), m.z > 0.
    #[inline(always)]
    pub(super) fn ndf(&self, m: Vec3) -> f32 {
        let a2 = self.alpha * self.alpha;
        // 1 - m.z² from the other components keeps precision near the normal.
        let spread = m.x * m.x + m.y * m.y + a2 * m.z * m.z;
        a2 / (PI * spread * spread)
    }

    /// Smith's Λ(v).
    #[inline(always)]
    fn lambda(&self, v: Vec3) -> f32 {
        let tan2 = (v.x * v.x + v.y * v.y) / (v.z * v.z).max(f32::MIN_POSITIVE);
        0.5 * ((1.0 + self.alpha * self.alpha * tan2).sqrt() - 1.0)
    }

    /// Smith masking G1(v).
    #[inline(always)]
    pub(super) fn smith_g1(&self, v: Vec3) -> f32 {
        1.0 / (1.0 + self.lambda(v))
    }

    /// Height-correlated Smith masking-shadowing G2(a, b).
    #[inline(always)]
    pub(super) fn smith_g2(&self, a: Vec3, b: Vec3) -> f32 {
        1.0 / (1.0 + self.lambda(a) + self.lambda(b))
    }

    /// Samples a visible normal from `v` (v.z > 0) with two numbers in [0, 1).
    #[inline(always)]
    pub(super) fn sample_vndf(&self, v: Vec3, [u1, u2]: [f32; 2]) -> Vec3 {
        let stretched = Vec3::new(self.alpha * v.x, self.alpha * v.y, v.z).normalize();
        let (sin, cos) = sin_cos_turns(u1);
        let z = (1.0 - u2) * (1.0 + stretched.z) - stretched.z;
        let flat = (1.0 - z * z).max(0.0).sqrt();
        let half = Vec3::new(flat * cos, flat * sin, z) + stretched;
        Vec3::new(self.alpha * half.x, self.alpha * half.y, half.z.max(1e-7)).normalize()
    }

    /// Density of [`Ggx::sample_vndf`] at `m`.
    #[inline(always)]
    pub(super) fn vndf_pdf(&self, v: Vec3, m: Vec3) -> f32 {
        self.smith_g1(v) * v.dot(m).max(0.0) * self.ndf(m) / v.z.max(f32::MIN_POSITIVE)
    }

    /// Weight of a sampled reflection of `v` for Fresnel reflectance 1, and the cosine between
    /// `v` and the microfacet normal.
    pub(super) fn reflected(&self, v: Vec3, u: [f32; 2]) -> (f32, f32) {
        let m = self.sample_vndf(v, u);
        let i = 2.0 * v.dot(m) * m - v;
        let weight = self.smith_g2(v, i) / self.smith_g1(v);
        (if i.z > 0.0 { weight } else { 0.0 }, v.dot(m))
    }
}
