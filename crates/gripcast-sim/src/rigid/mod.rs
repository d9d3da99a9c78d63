//! The rigid-body baseline: Taxim's set-up of a grasp.
//!
//! The fingers are two boxes of a gel's size. Each is driven by a motor of its own towards the
//! gripper's middle with at most the grasping force, and follows the gripper exactly in every
//! other direction. The object is a rigid body of convex pieces (V-HACD) with the mass properties
//! of its whole mesh. The gripper closes for 150 steps and is lifted by 0.18 m; the grasp succeeds
//! if the object's centre of mass rises by 80 % of that (Taxim-Robot, Si and Yuan 2022). Contacts
//! and friction are solved by rapier.
//!
//! Otherwise than there, the arm is not simulated, the ground has the object's friction
//! coefficient as in the finite-element simulator, and there is no rolling friction.

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
