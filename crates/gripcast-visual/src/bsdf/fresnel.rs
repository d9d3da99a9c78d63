//! Fresnel reflectance of smooth interfaces.

use glam::Vec3;

/// Schlick's weight (1 - cos)⁵ (*An inexpensive BRDF model*, 1994).
#[inline(always)]
pub(super) fn schlick_weight(cos: f32) -> f32 {
    let m = (1.0 - cos).clamp(0.0, 1.0);
    let m2 = m * m;
    m2 * m2 * m
}

/// Reflectance of a dielectric at normal incidence.
pub(super) fn f0_from_ior(ior: f32) -> f32 {
    ((ior - 1.0) / (ior + 1.0)).powi(2)
}

/// Reflectance of a dielectric, and the cosine of the refracted ray (0 under total internal
/// reflection). `cos` > 0 on the incident side; `ior` is that of the far side over the incident
/// side.
#[inline(always)]
pub(super) fn fresnel_dielectric(cos: f32, ior: f32) -> (f32, f32) {
    let sin2 = (1.0 - cos * cos).max(0.0) / (ior * ior);
    if sin2 >= 1.0 {
        return (1.0, 0.0);
    }
    let cos_t = (1.0 - sin2).sqrt();
    let s = (cos - ior * cos_t) / (cos + ior * cos_t);
    let p = (ior * cos - cos_t) / (ior * cos + cos_t);
    (0.5 * (s * s + p * p), cos_t)
}

/// Reflectance of a conductor with index of refraction η + ik.
#[inline(always)]
pub(super) fn fresnel_conductor(cos: f32, eta: Vec3, k: Vec3) -> Vec3 {
    let cos2 = cos * cos;
    let sin2 = (1.0 - cos2).max(0.0);
    let (eta2, k2) = (eta * eta, k * k);
    let t0 = eta2 - k2 - Vec3::splat(sin2);
    let a2_b2 = root(t0 * t0 + 4.0 * eta2 * k2);
    let a = root(0.5 * (a2_b2 + t0).max(Vec3::ZERO));
    let t1 = a2_b2 + Vec3::splat(cos2);
    let t2 = 2.0 * cos * a;
    let s = (t1 - t2) / (t1 + t2);
    let t3 = cos2 * a2_b2 + Vec3::splat(sin2 * sin2);
    let t4 = sin2 * t2;
    let p = s * (t3 - t4) / (t3 + t4);
    (0.5 * (s + p)).clamp(Vec3::ZERO, Vec3::ONE)
}

#[inline(always)]
fn root(v: Vec3) -> Vec3 {
    Vec3::new(v.x.sqrt(), v.y.sqrt(), v.z.sqrt())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn dielectric_matches_known_reflectances() {
        assert!((fresnel_dielectric(1.0, 1.5).0 - 0.04).abs() < 1e-6);
        assert!((f0_from_ior(1.5) - 0.04).abs() < 1e-6);
        assert!(fresnel_dielectric(1e-4, 1.5).0 > 0.999);
        // Total reflection inside glass beyond 41.8°.
        assert_eq!(fresnel_dielectric(0.74, 1.0 / 1.5).0, 1.0);
        assert!(fresnel_dielectric(0.76, 1.0 / 1.5).0 < 1.0);
        // Brewster's angle: half of the perpendicular part is left.
        let brewster = 1.5f32.atan().cos();
        let perpendicular = ((1.0 - 2.25f32) / (1.0 + 2.25)).powi(2);
        assert!((fresnel_dielectric(brewster, 1.5).0 - 0.5 * perpendicular).abs() < 1e-6);
    }

    #[test]
    fn conductor_agrees_with_complex_arithmetic() {
        // r = (cos - n cos_t)/(cos + n cos_t) etc. with complex n, in double precision.
        let exact = |cos: f64, n: f64, k: f64| {
            type C = (f64, f64);
            let mul = |a: C, b: C| (a.0 * b.0 - a.1 * b.1, a.0 * b.1 + a.1 * b.0);
            let norm = |a: C| a.0 * a.0 + a.1 * a.1;
            let n2 = mul((n, k), (n, k));
            let inside = (n2.0 - (1.0 - cos * cos), n2.1);
            let size = norm(inside).sqrt();
            let n_cos_t = (
                (0.5 * (size + inside.0)).sqrt(),
                (0.5 * (size - inside.0)).sqrt(),
            );
            let s = norm((cos - n_cos_t.0, -n_cos_t.1)) / norm((cos + n_cos_t.0, n_cos_t.1));
            let n2c = (n2.0 * cos, n2.1 * cos);
            let p = norm((n2c.0 - n_cos_t.0, n2c.1 - n_cos_t.1))
                / norm((n2c.0 + n_cos_t.0, n2c.1 + n_cos_t.1));
            0.5 * (s + p)
        };
        for cos in [1.0, 0.8, 0.5, 0.2, 0.05] {
            let found = fresnel_conductor(cos, Vec3::new(0.2, 1.1, 2.9), Vec3::new(3.9, 2.6, 3.1));
            let wanted =
                [(0.2, 3.9), (1.1, 2.6), (2.9, 3.1)].map(|(n, k)| exact(f64::from(cos), n, k));
            for (f, w) in found.to_array().iter().zip(wanted) {
                assert!(
                    (f64::from(*f) - w).abs() < 1e-5,
                    "{cos}: {found} {wanted:?}"
                );
            }
        }
    }
}
