//! Common interface of the finite-element and the rigid-body simulator.

use std::sync::Arc;

use serde::{Deserialize, Serialize};
use serde_json::Value;

use super::fem::{GelGrid, GelPad};
use super::grasp::{GraspResult, GraspSettings, Scene, simulate};
use gripcast_base::error::{Error, Result};
use gripcast_geometry::{Pose, TriangleMesh};

/// Kind of simulator.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum EngineKind {
    /// Finite-element gels, incremental potential contact.
    Fem,
    /// Rigid fingers and convex pieces, as in Taxim.
    Rigid,
}

impl EngineKind {
    /// All kinds, in the order of tables.
    pub const ALL: [Self; 2] = [Self::Fem, Self::Rigid];

    /// Name on the command line and in files.
    pub fn name(self) -> &'static str {
        match self {
            Self::Fem => "fem",
            Self::Rigid => "rigid",
        }
    }
}

/// A grasp before the fingers close, without friction and force.
#[derive(Clone, Debug)]
pub struct GraspSetup {
    /// Closed surface of the object in its own frame, m.
    pub mesh: Arc<TriangleMesh>,
    /// Mass of the object, kg.
    pub mass_kg: f64,
    /// Pose of the object on the ground (z = 0).
    pub t_world_object: Pose,
    /// Pose of the gripper; the fingers close along its x axis.
    pub t_world_gripper: Pose,
    /// Distance between the gel faces at the start, m.
    pub opening_m: f64,
}

/// A grasp simulator. The same input gives bit-identical results on any number of threads.
pub trait Engine: Send + Sync {
    /// Kind of simulator.
    fn kind(&self) -> EngineKind;

    /// All parameters that a result depends on besides setup, friction and force, as a JSON object.
    ///
    /// # Errors
    /// `Internal` for a number that JSON cannot represent.
    fn parameters(&self) -> Result<Value>;

    /// Success height, m: of the object's lowest point (finite elements), or the rise of the object
    /// (rigid bodies).
    fn success_height_m(&self) -> f64;

    /// Size of the gels, or of the rigid fingers' faces.
    fn pad(&self) -> GelPad;

    /// Mesh of the gels at rest and the contact distance `d_hat`, m; `None` without gels.
    ///
    /// # Errors
    /// `Config` for a pad whose size is out of range.
    fn gel(&self) -> Result<Option<(GelGrid, f64)>> {
        Ok(None)
    }

    /// Simulates a grasp with a Coulomb friction coefficient and a grasping force (N).
    ///
    /// # Errors
    /// `Input` or `Config` for an invalid setup or parameter. An initial penetration and a grasp
    /// that does not converge are outcomes, not errors.
    fn simulate(&self, setup: &GraspSetup, friction: f64, force_n: f64) -> Result<GraspResult>;
}

/// The finite-element simulator; its grasping force is the paper's F_stop.
#[derive(Clone, Copy, Debug, Default)]
pub struct FemEngine {
    /// All parameters; the stopping force is replaced by that of each grasp.
    pub settings: GraspSettings,
}

impl Engine for FemEngine {
    fn kind(&self) -> EngineKind {
        EngineKind::Fem
    }

    fn parameters(&self) -> Result<Value> {
        let mut value = serde_json::to_value(self.settings)
            .map_err(|e| Error::internal("cannot write the parameters").because(e))?;
        if let Some(protocol) = value.get_mut("protocol").and_then(Value::as_object_mut) {
            protocol.remove("stop_force_n");
        }
        Ok(value)
    }

    fn success_height_m(&self) -> f64 {
        self.settings.protocol.success_height_m
    }

    fn pad(&self) -> GelPad {
        self.settings.pad
    }

    fn gel(&self) -> Result<Option<(GelGrid, f64)>> {
        Ok(Some((
            self.settings.gel()?.grid,
            self.settings.solver.d_hat_m,
        )))
    }

    fn simulate(&self, setup: &GraspSetup, friction: f64, force_n: f64) -> Result<GraspResult> {
        let scene = Scene {
            mesh: setup.mesh.as_ref().clone(),
            mass_kg: setup.mass_kg,
            friction,
            t_world_object: setup.t_world_object,
            t_world_gripper: setup.t_world_gripper,
            opening_m: setup.opening_m,
            gel: self.settings.gel()?,
        };
        let mut protocol = self.settings.protocol;
        protocol.stop_force_n = force_n;
        simulate(&scene, &protocol, &self.settings.solver)
    }
}
