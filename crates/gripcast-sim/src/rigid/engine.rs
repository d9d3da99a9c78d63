//! The rigid-body simulator as an engine.

use std::sync::Arc;

use serde_json::Value;

use super::cache::DecompositionCache;
use super::decomposition::Decomposition;
use super::run::Run;
use super::settings::RigidSettings;
use super::start;
use super::world::{World, WorldSetup};
use crate::grasp::GraspResult;
use crate::{Engine, EngineKind, GraspSetup};
use gripcast_base::error::{Error, Result};
use gripcast_base::files::BeneathPath;
use gripcast_geometry::TriangleMesh;

/// Largest opening that a gripper can have, m.
const MAX_OPENING_M: f64 = 0.2;

/// Rigid fingers on a rigid object of convex pieces; the force is that of the fingers' motors.
#[derive(Debug, Default)]
pub struct RigidEngine {
    /// Everything but friction and force.
    pub settings: RigidSettings,
    cache: DecompositionCache,
}

impl RigidEngine {
    /// With parameters; decompositions are kept in memory.
    pub fn new(settings: RigidSettings) -> Self {
        Self {
            settings,
            cache: DecompositionCache::default(),
        }
    }

    /// Keeps decompositions in files of a folder as well, which is made if it does not exist. A
    /// file that is damaged or of something else is replaced; one that cannot be written is
    /// computed again next time.
    ///
    /// # Errors
    /// `Io`, … where there can be no such folder.
    pub fn with_cache(self, folder: BeneathPath) -> Result<Self> {
        Ok(Self {
            cache: DecompositionCache::in_folder(folder)?,
            ..self
        })
    }

    /// The convex pieces of a mesh (m), computed once for each mesh and set of parameters.
    ///
    /// # Errors
    /// `Input` where a parameter is out of its range, or the mesh encloses nothing.
    pub fn decomposition(&self, mesh: &TriangleMesh) -> Result<Arc<Decomposition>> {
        self.settings.validate()?;
        self.cache.get(mesh, &self.settings.decomposition)
    }

    /// The opening that a grasp of an object of `pieces` starts from, m.
    ///
    /// # Errors
    /// What the fingers would be inside of.
    pub fn start_opening(&self, setup: &GraspSetup, pieces: &Decomposition) -> Result<f64, String> {
        start::opening(setup, pieces, self.settings.opening_m)
    }
}

impl Engine for RigidEngine {
    fn kind(&self) -> EngineKind {
        EngineKind::Rigid
    }

    fn parameters(&self) -> Result<Value> {
        serde_json::to_value(self.settings)
            .map_err(|e| Error::internal("cannot write the parameters").because(e))
    }

    fn success_height_m(&self) -> f64 {
        self.settings.success_rise_m()
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
    let numbers = [
        ("mass", setup.mass_kg, "kg", 1e-6, 1e3),
        ("friction coefficient", friction, "", 0.0, 100.0),
        ("grasping force", force_n, "N", 1e-6, 1e5),
        ("opening", setup.opening_m, "m", 1e-6, MAX_OPENING_M),
    ];
    for (name, found, unit, least, most) in numbers {
        // Written so that NaN is refused as well.
        if !(found >= least && found <= most) {
            return Err(Error::input(format!(
                "the {name} must be from {least} to {most} {unit}, found {found}"
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
