//! Grasps to simulate: antipodal candidates, typical faults of a person, collision checks.

mod choice;
mod collision;
mod sampler;

pub use choice::{ChosenGrasp, GraspSelection, sample_grasps, select_given_grasps};
pub use collision::{Obstacle, find_collision};
pub use sampler::{Candidate, FaultRanges, GraspFault, GraspSampler};
