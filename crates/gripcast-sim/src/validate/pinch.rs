//! Scenes of the analytic cases: gels and an object without protocol.

use glam::{DMat3, DQuat, DVec3};

use crate::affine::{AffineBody, AffineState};
use crate::fem::GelResolution;
use crate::grasp::{Finger, GelSpec};
use crate::solver::{Collider, Gel, Object, SolverParameters, StepStart, System};
use gripcast_base::error::Result;
use gripcast_geometry::{MassProperties, Pose, TriangleMesh};

/// Gravity of all cases, m/s².
pub(super) const GRAVITY: f64 = 9.81;

/// Two gels on the world's x axis with an object between them.
#[derive(Debug)]
pub(super) struct Pinch {
    pub(super) system: System,
    pub(super) mass_kg: f64,
    /// Steps that did not converge.
    pub(super) unconverged: u32,
}

/// Body and collision surface of an object around its centre of mass.
pub(super) fn solid(
    mesh: &TriangleMesh,
    mass_kg: f64,
    parameters: &SolverParameters,
) -> Result<(AffineBody, Collider)> {
    let properties = MassProperties::from_mesh(mesh)?;
    let mesh = mesh.transformed(&Pose::from_translation(-properties.center_of_mass_m));
    let body = AffineBody::new(
        mass_kg,
        properties.volume_m3,
        properties.second_moment_m5,
        parameters.affine_stiffness_pa,
    )?;
    Ok((body, Collider::new(&mesh)))
}

impl Pinch {
    /// Coarse gels at a distance `gap_m` from the sides of an object that floats at the origin.
    ///
    /// # Errors
    /// For an invalid mesh or parameter.
    pub(super) fn new(
        mesh: &TriangleMesh,
        (mass_kg, mu): (f64, f64),
        gap_m: f64,
        parameters: SolverParameters,
    ) -> Result<Self> {
        let (body, collider) = solid(mesh, mass_kg, &parameters)?;
        let state = AffineState::rigid(DVec3::ZERO, DMat3::IDENTITY);
        let object = Object::new(body, state, &collider);
        let spec = GelSpec::standard(GelResolution::Coarse)?;
        let bounds = collider.bounds();
        let mut gels = Vec::new();
        for finger in Finger::BOTH {
            let half_width = match finger {
                Finger::Left => -bounds.min.x,
                Finger::Right => bounds.max.x,
            };
            let back = finger.closing() * -(half_width + gap_m + spec.grid.thickness_m());
            let t_world_gel = Pose::new(DQuat::from_mat3(&finger.rotation()), back);
            let to_world = |p| t_world_gel.transform_point(p);
            gels.push(Gel::new(
                &spec.grid,
                &spec.material,
                spec.drive,
                &parameters,
                to_world,
            )?);
        }
        Ok(Self {
            system: System::new(gels, object, collider, mu, parameters)?,
            mass_kg,
            unconverged: 0,
        })
    }

    /// Advances one step in which each finger moves by `closing_m` towards the other and both by
    /// `translation`.
    pub(super) fn step(&mut self, closing_m: f64, translation: DVec3) {
        for (gel, finger) in self.system.gels_mut().iter_mut().zip(Finger::BOTH) {
            gel.move_target(finger.closing() * closing_m + translation);
        }
        let report = self.system.step(&StepStart::default());
        self.unconverged += u32::from(!report.converged);
    }

    /// Total contact and friction force on both gels, N.
    pub(super) fn force_on_gels(&self) -> DVec3 {
        let gels = self.system.gels().iter();
        gels.flat_map(Gel::contact_forces).sum()
    }

    /// Normal force of each gel, N.
    pub(super) fn normal_forces(&self) -> [f64; 2] {
        let gels = self.system.gels();
        [0, 1].map(|i| {
            let sum: DVec3 = gels[i].contact_forces().sum();
            -sum.dot(Finger::BOTH[i].closing())
        })
    }
}
