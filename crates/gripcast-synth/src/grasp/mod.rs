//! Grasps to simulate: drawn places, what goes wrong in practice, what the gripper would hit.

mod choice;
mod collision;
mod sampler;

pub use choice::{ChosenGrasp, GraspChoice, choose_given_grasps, choose_grasps};
pub use collision::{Obstacle, collides};
pub use sampler::{Candidate, FaultRanges, GraspFault, GraspSampler};
