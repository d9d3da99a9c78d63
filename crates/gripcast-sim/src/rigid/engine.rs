//! The rigid-body simulator as an [`Engine`].

use std::sync::Arc;

use serde_json::Value;

use super::cache::DecompositionCache;
use super::decomposition::Decomposition;
use super::run::Run;
use super::settings::RigidSettings;
use super::start;
use super::world::{World, WorldSetup};
use crate::fem::GelPad;
use crate::grasp::{GraspResult, MAX_OPENING_M};
use crate::{Engine, EngineKind, GraspSetup};
use gripcast_base::error::{Error, Result};
use gripcast_base::files::BeneathPath;
use gripcast_geometry::{TriangleMesh, check_mass};

/// Rigid fingers and a rigid object of convex pieces; the grasping force is the motor force per
/// finger.
#[derive(Debug, Default)]
pub struct RigidEngine {
    /// All parameters but friction and force.
    pub settings: RigidSettings,
    cache: DecompositionCache,
}

impl RigidEngine {
    /// An engine that caches decompositions in memory.
    pub fn new(settings: RigidSettings) -> Self {
        Self {
            settings,
            cache: DecompositionCache::default(),
        }
    }

    /// Also caches decompositions as files in a folder, which is created if missing. Damaged files
    /// are replaced; failures to write are ignored.
    ///
    /// # Errors
    /// `Io` if the folder cannot be created.
    pub fn with_cache(self, folder: BeneathPath) -> Result<Self> {
        Ok(Self {
            cache: DecompositionCache::in_folder(folder)?,
            ..self
        })
    }

    /// Convex pieces of a mesh (m), computed once per mesh and parameters.
    ///
    /// # Errors
    /// `Input` for a parameter out of range or a mesh without volume.
    pub fn decomposition(&self, mesh: &TriangleMesh) -> Result<Arc<Decomposition>> {
        self.settings.validate()?;
        self.cache.get(mesh, &self.settings.decomposition)
    }

    /// Opening at the start of a grasp, m.
    ///
    /// # Errors
    /// A description of the collision if the fingers start inside object or ground.
    pub fn start_opening(&self, setup: &GraspSetup, pieces: &Decomposition) -> Result<f64, String> {
        start::opening(setup, pieces, &self.settings)
    }
}

impl Engine for RigidEngine {
    fn kind(&self) -> EngineKind {
        EngineKind::Rigid
    }

    fn parameters(&self) -> Result<Value> {
        serde_json::to_value(self.settings)
            .map_err(|e| Error::internal("cannot encode the parameters").because(e))
    }

    fn success_height_m(&self) -> f64 {
        self.settings.success_rise_m()
    }

    fn pad(&self) -> GelPad {
        self.settings.pad
    }

    fn simulate(&self, setup: &GraspSetup, friction: f64, force_n: f64) -> Result<GraspResult> {
        validate(setup, friction, force_n)?;
        let pieces = self.decomposition(&setup.mesh)?;
        let opening_m = match self.start_opening(setup, &pieces) {
            Ok(opening_m) => opening_m,
            Err(detail) => return Ok(GraspResult::penetrating_start(detail)),
        };
        let world = WorldSetup {
            grasp: setup,
            pieces: &pieces,
            opening_m,
            friction,
            force_n,
        };
        let world = World::new(&world, &self.settings)?;
        Ok(Run::new(world, &self.settings, setup.t_world_gripper).finish())
    }
}

fn validate(setup: &GraspSetup, friction: f64, force_n: f64) -> Result<()> {
    check_mass(setup.mass_kg, &setup.mesh.bounds())?;
    let numbers = [
        ("friction coefficient", friction, "", 0.0, 100.0),
        ("grasping force", force_n, "N", 1e-6, 1e5),
        ("opening", setup.opening_m, "m", 1e-6, MAX_OPENING_M),
    ];
    for (name, found, unit, min, max) in numbers {
        // Also rejects NaN.
        if !(found >= min && found <= max) {
            return Err(Error::input(format!(
                "the {name} must be from {min} to {max} {unit}, found {found}"
            ))
            .remedy("use SI units: kg, N, m"));
        }
    }
    let poses = [&setup.t_world_object, &setup.t_world_gripper];
    if !poses
        .iter()
        .all(|p| p.translation_m.is_finite() && p.rotation.is_finite())
    {
        return Err(Error::input(
            "the poses of object and gripper must be finite",
        ));
    }
    Ok(())
}

#[cfg(test)]
#[path = "engine_test.rs"]
mod tests;
