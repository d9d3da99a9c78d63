//! The grasp simulator: finite-element gels, incremental potential contact, an affine-body object;
//! beside it, a rigid-body baseline.
//!
//! Deterministic, f64, without input or output but the baseline's cache of convex pieces, with no
//! threads of its own but rayon's.

pub mod affine;
pub mod contact;
mod engine;
pub mod fem;
pub mod grasp;
pub mod press;
pub mod rigid;
pub mod solver;
pub mod validate;

pub use engine::{Engine, EngineKind, FemEngine, GraspSetup};
