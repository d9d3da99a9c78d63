//! Fraction of its friction limit that a grip needs.

use glam::DVec3;

use crate::solver::Gel;

/// Load of a gel's friction as a fraction of its limit, by the ellipse of shear and torsion (Howe
/// and Cutkosky, IJRR 1996): `sqrt((S / μ N)² + (T / μ Σ Nᵢ rᵢ)²)` with the shear S, the torque T
/// about the centre of pressure, and the normal forces Nᵢ at distances rᵢ from it. Above 1 the
/// contact slides. `None` without contact or friction.
///
/// Regularised friction does not stick: at a fraction u the contact creeps at
/// `eps_v (1 - sqrt(1 - u))`.
pub(super) fn friction_use(gel: &Gel, closing: DVec3, mu: f64) -> Option<f64> {
    let loads: Vec<(DVec3, DVec3)> = gel
        .contact_forces()
        .zip(gel.positions())
        .map(|(force, position)| (force, *position))
        .collect();
    let normal = |force: DVec3| (-force.dot(closing)).max(0.0);
    let total: f64 = loads.iter().map(|(force, _)| normal(*force)).sum();
    if total * mu <= super::MIN_CONTACT_FORCE_N {
        return None;
    }
    let moments = loads.iter().map(|(force, x)| *x * normal(*force));
    let center = moments.sum::<DVec3>() / total;
    let (mut shear, mut torque, mut torque_limit) = (DVec3::ZERO, 0.0, 0.0);
    for (force, position) in loads {
        let arm = (position - center).reject_from_normalized(closing);
        shear += force.reject_from_normalized(closing);
        torque += arm.cross(force).dot(closing);
        torque_limit += mu * normal(force) * arm.length();
    }
    let twist = if torque_limit > 0.0 {
        torque / torque_limit
    } else {
        0.0
    };
    Some((shear.length() / (mu * total)).hypot(twist))
}
