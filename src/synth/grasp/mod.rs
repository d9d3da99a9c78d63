//! Grasps to simulate: drawn places, what goes wrong in practice, what the gripper would hit.

mod collision;
mod sampler;

pub use collision::{Obstacle, collides};
pub use sampler::{Candidate, GraspFault, GraspSampler};
