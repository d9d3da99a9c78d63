//! Lambertian reflection.

use std::f32::consts::{FRAC_1_PI, PI};

use glam::Vec3;

use super::super::trigonometry::sin_cos_turns;
use super::{BsdfSample, BsdfValue};

/// Samples a direction with density cos/π.
#[inline(always)]
pub(super) fn sample_cosine([u1, u2]: [f32; 2]) -> Vec3 {
    let (sin, cos) = sin_cos_turns(u2);
    let flat = u1.sqrt();
    Vec3::new(flat * cos, flat * sin, (1.0 - u1).max(1e-12).sqrt())
}

/// Density of [`sample_cosine`].
#[inline(always)]
pub(super) fn cosine_density(direction: Vec3) -> f32 {
    direction.z.max(0.0) * FRAC_1_PI
}

#[inline(always)]
pub(super) fn value(reflectance: Vec3, incoming: Vec3) -> BsdfValue {
    let pdf = cosine_density(incoming);
    BsdfValue {
        value: reflectance * pdf,
        pdf,
    }
}

#[inline(always)]
pub(super) fn sample(reflectance: Vec3, u: [f32; 2]) -> BsdfSample {
    let direction = sample_cosine(u);
    BsdfSample {
        direction,
        weight: reflectance,
        pdf: direction.z / PI,
        delta: false,
    }
}
