//! Grasps that the bench and the validation share.

use glam::{DQuat, DVec3};
use serde::Serialize;

use super::placement::Placement;
use super::scene::Scene;
use super::settings::GraspSettings;
use crate::error::Result;
use crate::geometry::{Pose, TriangleMesh, builtin};

/// How much a grasp asks of the solver.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum CaseClass {
    /// Both gels meet the object squarely.
    Easy,
    /// The object is pushed, turned, tilted, touched at edges, or slides out.
    Hard,
}

/// What is grasped.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum CaseObject {
    /// A built-in mesh.
    Builtin(&'static str),
    /// A mesh file that is not part of the project.
    File {
        /// Path within the folder of shared data.
        path: &'static str,
        /// Length of a unit of the file, m.
        unit_m: f64,
    },
}

impl CaseObject {
    /// The mesh in metres. `shared` reads a file of the folder of shared data in its own unit, or
    /// finds nothing.
    ///
    /// # Errors
    /// Those of `shared`.
    pub fn load(
        &self,
        shared: &dyn Fn(&str) -> Result<Option<TriangleMesh>>,
    ) -> Result<Option<TriangleMesh>> {
        match self {
            Self::Builtin(name) => builtin(name).map(Some),
            Self::File { path, unit_m } => Ok(shared(path)?.map(|mesh| mesh.scaled(*unit_m))),
        }
    }
}

/// A grasp to try.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct GraspCase {
    /// Unique name, fit for a JSON key.
    pub name: &'static str,
    /// What it asks of the solver.
    pub class: CaseClass,
    /// What is grasped.
    pub object: CaseObject,
    /// Rotation of the object on the ground: w, x, y, z.
    pub q_wxyz: [f64; 4],
    /// Where the gripper stands.
    pub placement: Placement,
}

/// Mass of every case, kg.
const MASS_KG: f64 = 0.06;
/// Friction coefficient of every case.
const FRICTION: f64 = 0.4;

/// The cases.
pub fn cases() -> Vec<GraspCase> { Vec::new() }
