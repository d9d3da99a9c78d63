//! Objects and grasps of ACRONYM (Eppner, Mousavian and Fox, *ACRONYM: A Large-Scale Grasp Dataset
//! Based on Simulation*, 2021): one HDF5 file per object, with the result of each grasp in NVIDIA
//! FleX. The meshes come separately, from ShapeNetSem.
//!
//! The grasps are poses of a Franka Panda's hand in the frame of the scaled mesh. The hand has the
//! axes of our gripper: its fingers close along x and point along z. The marker of `acronym_tools`
//! has its fingers at x = ±41 mm and their tips at z = 112.2 mm. The origins differ by
//! [`PANDA_GEL_CENTER_M`] along z.

mod object;
mod transform;

#[cfg(test)]
mod acronym_test;

pub use object::{AcronymObject, AcronymSet, read_acronym};
pub use transform::{AcronymGrasp, PANDA_GEL_CENTER_M, SkippedGrasp};
