//! Rigid-body baseline: Taxim's simulation of a grasp (Taxim-Robot, Si and Yuan 2022).
//!
//! The fingers are two boxes of the size of a gel. Each has a motor that drives it towards the
//! centre of the gripper with at most the grasping force, and is rigidly attached in all other
//! directions. The object is a rigid body of convex pieces (V-HACD) with the mass properties of its
//! mesh. The gripper closes for 150 steps and is lifted by 0.18 m; the grasp succeeds if the
//! object's centre of mass rises by 80 % of that. Contact and friction are solved by rapier.
//!
//! Unlike in Taxim, the arm is not simulated, the ground has the object's friction coefficient (as
//! in the finite-element simulator), and there is no rolling friction.

mod cache;
mod collision;
mod contact;
mod convert;
mod decomposition;
mod engine;
mod merge;
mod run;
mod settings;
mod start;
mod world;

pub use collision::CollisionShape;
pub use decomposition::Decomposition;
pub use engine::RigidEngine;
pub use settings::{DecompositionSettings, RigidSettings};
