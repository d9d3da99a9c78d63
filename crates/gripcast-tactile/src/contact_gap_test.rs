//! Tests of the contact gap, against plates and against a simulated press.

use glam::{DMat3, DVec3};

use super::*;
use crate::rays::bumpy_ball;
use gripcast_geometry::builtin;
use gripcast_sim::affine::{AffineBody, AffineState};
use gripcast_sim::fem::{GelPad, GelResolution, Side};
use gripcast_sim::solver::{
    Collider, Drive, Gel, GelMaterial, Object, SolverParameters, StepStart, System,
};

const D_HAT_M: f64 = 5e-4;

fn plate(z: f64) -> TriangleMesh {
    let corner = |x: f64, y: f64| DVec3::new(0.0125 * x, 0.01 * y, z);
    TriangleMesh {
        vertices: vec![
            corner(-1.0, -1.0),
            corner(1.0, -1.0),
            corner(1.0, 1.0),
            corner(-1.0, 1.0),
        ],
        triangles: vec![[0, 1, 2], [0, 2, 3]],
    }
}

#[test]
fn parallel_plates_have_gap_of_their_distance() {
    for gap in [1e-4, 3e-4, 4.8e-4] {
        let found = contact_gap(&plate(3e-3 + gap), &Pose::IDENTITY, &plate(3e-3), D_HAT_M);
        assert!((found.unwrap() - gap).abs() < 1e-9, "{found:?}");
    }
    for apart in [-1e-4, 5.01e-4] {
        let found = contact_gap(&plate(3e-3 + apart), &Pose::IDENTITY, &plate(3e-3), D_HAT_M);
        assert_eq!(found, None);
    }
}

#[test]
fn inclined_plates_have_gap_of_their_distance() {
    let tilted = |mesh: &TriangleMesh| {
        mesh.transformed(&Pose::from_rotation(glam::DQuat::from_rotation_x(0.5)))
    };
    let found = contact_gap(
        &tilted(&plate(3e-3 + 4e-4)),
        &Pose::IDENTITY,
        &tilted(&plate(3e-3)),
        D_HAT_M,
    );
    assert!((found.unwrap() - 4e-4).abs() < 1e-8, "{found:?}");
}

/// A gel pressed by `depth_m` beyond first contact, and the object in the gel's frame.
fn simulated(mesh: &TriangleMesh, depth_m: f64) -> (System, TriangleMesh) {
    let parameters = SolverParameters {
        dt_s: 1.0,
        gravity_m_s2: 0.0,
        newton_tolerance_m_s: 1e-7,
        ..SolverParameters::default()
    };
    let grid = GelPad::default().grid(GelResolution::Coarse).unwrap();
    let collider = Collider::new(mesh);
    let body = AffineBody::new(1.0, 1.0, DMat3::IDENTITY, 1e9).unwrap();
    let lowest = mesh.bounds().min.z;
    let position = DVec3::Z * (grid.thickness_m() + 1.02 * D_HAT_M - lowest);
    let object = Object::new(
        body,
        AffineState::rigid(position, DMat3::IDENTITY),
        &collider,
    )
    .fixed();
    let material = GelMaterial::default();
    let drive = Drive::PerArea(1e12);
    let gel = Gel::new(&grid, &material, drive, &parameters, |p| p).unwrap();
    let mut system = System::new(vec![gel], object, collider, 0.4, parameters).unwrap();
    let steps = (depth_m / 1e-4).ceil();
    for _ in 0..steps as usize {
        for gel in system.gels_mut() {
            gel.move_target(DVec3::Z * depth_m / steps);
        }
        assert!(system.step(&StepStart::default()).converged);
    }
    (system, mesh.transformed(&Pose::from_translation(position)))
}

#[test]
fn simulated_press_has_force_weighted_gap() {
    let ball = bumpy_ball(8e-3, 0.0, 60, 60);
    let mut block = builtin("builtin:box").unwrap();
    for vertex in &mut block.vertices {
        *vertex *= DVec3::new(0.2, 0.3, 0.2);
    }
    for mesh in [ball, block] {
        let (system, placed) = simulated(&mesh, 8e-4);
        let gel = &system.gels()[0];
        let grid = GelPad::default().grid(GelResolution::Coarse).unwrap();
        let face = TriangleMesh {
            vertices: gel.positions().to_vec(),
            triangles: grid.triangles(Side::Front).to_vec(),
        };
        let found = contact_gap(&placed, &Pose::IDENTITY, &face, D_HAT_M).unwrap();
        let (mean, min) = (gel.mean_gap().unwrap(), gel.min_gap().unwrap());
        assert!((found - mean).abs() < 1.5e-5, "{found:e} {mean:e} {min:e}");
        assert!(found > min && found < D_HAT_M);
    }
}
