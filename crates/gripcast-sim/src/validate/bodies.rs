//! Analytic cases of the object without gels: free fall, momentum, incline.

use glam::{DMat3, DVec3};

use super::pinch::{GRAVITY, solid};
use super::report::Recorder;
use crate::affine::{AffineRate, AffineState};
use crate::solver::{Object, SolverParameters, StepStart, System};
use gripcast_base::error::Result;
use gripcast_geometry::{Pose, builtin};

/// A system without gels; `make` configures the object at z = 1 m.
fn without_gels(gravity: f64, make: impl FnOnce(Object) -> Object) -> Result<System> {
    let parameters = SolverParameters {
        gravity_m_s2: gravity,
        newton_tolerance_m_s: 1e-10,
        ..SolverParameters::default()
    };
    let (body, collider) = solid(&builtin("box")?, 0.06, &parameters)?;
    let state = AffineState::rigid(DVec3::Z, DMat3::IDENTITY);
    let object = make(Object::new(body, state, &collider));
    System::new(Vec::new(), object, collider, 0.4, parameters)
}

/// Free fall with implicit Euler: g dt² n (n + 1) / 2 in n steps.
pub(super) fn free_fall(recorder: &mut Recorder) -> Result<()> {
    let mut system = without_gels(-GRAVITY, |object| object)?;
    let dt = system.parameters().dt_s;
    for n in 1..=50_u32 {
        system.step(&StepStart::default());
        if n % 25 == 0 {
            let steps = f64::from(n);
            let expected = -0.5 * GRAVITY * dt * dt * steps * (steps + 1.0);
            let found = system.object().state().p.z - 1.0;
            recorder.absolute(format!("{n} steps"), (expected, found), "m", 1e-9);
        }
    }
    Ok(())
}

/// Linear momentum is conserved; implicit Euler damps rotation: the angle φ per step becomes φ -
/// φ³, so after n steps it is φ / sqrt(1 + 2 n φ²).
pub(super) fn momentum(recorder: &mut Recorder) -> Result<()> {
    let velocity = DVec3::new(0.1, -0.05, 0.02);
    let spin = 2.0;
    let rate = AffineRate {
        p: velocity,
        a: DMat3::from_cols(DVec3::Y * spin, DVec3::X * -spin, DVec3::ZERO),
    };
    let mut system = without_gels(0.0, |object| object.with_rate(rate))?;
    let dt = system.parameters().dt_s;
    let mass = system.object().body().mass_kg();
    let angular = |system: &System| {
        // L = Σ m x × v = axial part of Ȧ S Aᵀ.
        let object = system.object();
        let moment =
            object.rate().a * *object.body().second_moment() * object.state().a.transpose();
        moment.x_axis.y - moment.y_axis.x
    };
    system.step(&StepStart::default());
    let first = angular(&system);
    let steps = 100_u32;
    for _ in 0..steps {
        system.step(&StepStart::default());
    }
    let found = system.object().rate().p * mass;
    for (axis, name) in ["x", "y", "z"].into_iter().enumerate() {
        let pair = (velocity[axis] * mass, found[axis]);
        recorder.absolute(format!("linear {name}"), pair, "kg m/s", 1e-12);
    }
    let angle = spin * dt;
    let after = |n: f64| (1.0 + 2.0 * n * angle * angle).sqrt().recip();
    let expected = after(f64::from(steps) + 1.0) / after(1.0);
    let pair = (expected, angular(&system) / first);
    recorder.relative("angular, conserved", pair, "", 1e-3);
    Ok(())
}

/// Friction coefficients and angles, degrees.
const INCLINES: [(f64, f64); 10] = [
    (0.4, 15.0),
    (0.4, 20.0),
    (0.4, 21.5),
    (0.4, 22.1),
    (0.4, 23.0),
    (0.4, 30.0),
    (0.2, 11.0),
    (0.2, 12.0),
    (0.8, 38.0),
    (0.8, 39.0),
];

/// A block on an incline creeps at eps_v (1 - sqrt(1 - tan θ / µ)) for tan θ < µ, and accelerates
/// by g (sin θ - µ cos θ) otherwise.
pub(super) fn incline(recorder: &mut Recorder) -> Result<()> {
    for (mu, degrees) in INCLINES {
        let angle = degrees.to_radians();
        let mut system = block(mu, angle)?;
        let dt = system.parameters().dt_s;
        let speed = |system: &System| system.object().rate().p.x;
        for _ in 0..60 {
            system.step(&StepStart::default());
        }
        let before = speed(&system);
        for _ in 0..20 {
            system.step(&StepStart::default());
        }
        let now = speed(&system);
        let name = format!("mu {mu}, {degrees} deg");
        let acceleration = (now - before) / (20.0 * dt);
        if angle.tan() < mu {
            let eps_v = system.parameters().eps_v_m_s;
            let expected = eps_v * (1.0 - (1.0 - angle.tan() / mu).sqrt());
            recorder.relative(format!("{name}: creep"), (expected, now), "m/s", 0.005);
            let pair = (0.0, acceleration);
            recorder.absolute(format!("{name}: no slip"), pair, "m/s2", 1e-5);
        } else {
            let expected = GRAVITY * (angle.sin() - mu * angle.cos());
            let pair = (expected, acceleration);
            recorder.relative(format!("{name}: slip"), pair, "m/s2", 0.005);
        }
    }
    Ok(())
}

/// A flat bar (20 x 120 mm on the ground, 10 mm high) on ground inclined by `angle` about y,
/// modelled by inclined gravity.
fn block(mu: f64, angle: f64) -> Result<System> {
    let parameters = SolverParameters {
        gravity_m_s2: -GRAVITY * angle.cos(),
        newton_tolerance_m_s: 1e-8,
        ..SolverParameters::default()
    };
    // Lays the bar down: 120 mm along x, 10 mm upright.
    let rotation = DMat3::from_cols(DVec3::Z, DVec3::Y, DVec3::NEG_X);
    let lay = Pose::new(glam::DQuat::from_mat3(&rotation), DVec3::ZERO);
    let mesh = builtin("bar")?.transformed(&lay);
    let mass = 0.06;
    let (body, collider) = solid(&mesh, mass, &parameters)?;
    let state = AffineState::rigid(DVec3::ZERO, DMat3::IDENTITY);
    let mut object = Object::new(body, state, &collider)
        .with_ground(mu)
        .with_acceleration(DVec3::X * GRAVITY * angle.sin());
    let weight = mass * GRAVITY * angle.cos();
    let rise =
        object.resting_height(&collider, &parameters.barrier(), weight) - object.lowest(&collider);
    object.raise(rise);
    System::new(Vec::new(), object, collider, mu, parameters)
}
