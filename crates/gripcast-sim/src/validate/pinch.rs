//! Gels, an object and no protocol: the scenes of the analytic cases.

use glam::{DMat3, DQuat, DVec3};

use crate::affine::{AffineBody, AffineState};
use crate::fem::GelResolution;
use crate::grasp::{Finger, GelSpec};
use crate::solver::{Collider, Gel, Object, SolverParameters, StepReport, StepStart, System};
use gripcast_base::error::Result;
use gripcast_geometry::{MassProperties, Pose, TriangleMesh};

/// Standard gravity of all cases, m/s².
pub(super) const GRAVITY: f64 = 9.81;

/// Two gels on the world's x axis with an object between them.
#[derive(Debug)]
pub(super) struct Pinch {
    pub(super) system: System,
    pub(super) mass_kg: f64,
    /// Steps that did not converge.
    pub(super) unconverged: u32,
}

/// An object whose centre of mass is its origin, and its surface.
pub(super) fn solid(
    mesh: &TriangleMesh,
    mass_kg: f64,
    parameters: &SolverParameters,
) -> Result<(AffineBody, Collider)> {
    let properties = MassProperties::of(mesh)?;
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
    /// Faces of coarse gels `gap_m` away from the sides of an object that floats in the origin.
    ///
    /// # Errors
    /// Where the mesh or a parameter cannot be simulated.
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
            let away = match finger {
                Finger::Left => -bounds.min.x,
                Finger::Right => bounds.max.x,
            };
            let back = finger.closing() * -(away + gap_m + spec.grid.thickness_m());
            let place = Pose::new(DQuat::from_mat3(&finger.rotation()), back);
            let at = |p| place.transform_point(p);
            gels.push(Gel::new(
                &spec.grid,
                &spec.material,
                spec.drive,
                &parameters,
                at,
            )?);
        }
        Ok(Self {
            system: System::new(gels, object, collider, mu, parameters)?,
            mass_kg,
            unconverged: 0,
        })
    }

    /// One step in which each finger moves by `closing_m` towards the other and both by `together`.
    pub(super) fn step(&mut self, closing_m: f64, together: DVec3) -> StepReport {
        for (gel, finger) in self.system.gels_mut().iter_mut().zip(Finger::BOTH) {
            gel.move_target(finger.closing() * closing_m + together);
        }
        let report = self.system.step(&StepStart::default());
        self.unconverged += u32::from(!report.converged);
        report
    }

    /// Sum of contact and friction on both gels, N.
    pub(super) fn force_on_gels(&self) -> DVec3 {
        let gels = self.system.gels().iter();
        gels.flat_map(Gel::contact_forces).sum()
    }

    /// Force of each gel along the closing direction, N.
    pub(super) fn normal_forces(&self) -> [f64; 2] {
        let gels = self.system.gels();
        [0, 1].map(|i| {
            let sum: DVec3 = gels[i].contact_forces().sum();
            -sum.dot(Finger::BOTH[i].closing())
        })
    }
}
