//! Grasp simulator: finite-element gels, incremental potential contact and an affine-body object,
//! and a rigid-body baseline.
//!
//! Deterministic and in f64. Uses rayon for threads; the only I/O is the baseline's cache of convex
//! pieces.
//!
//! ```
//! use gripcast_geometry::{PrepareOptions, builtin, prepare};
//! use gripcast_sim::fem::GelResolution;
//! use gripcast_sim::grasp::{GraspSettings, Placement, Scene, resting_pose, simulate};
//!
//! let mesh = prepare(&builtin("sphere")?, &PrepareOptions::default())?.mesh;
//! let (_, rest) = resting_pose(&mesh, None)?;
//! let placed = Placement::default().place(&mesh, &rest.t_world_object)?;
//! let mut settings = GraspSettings::default();
//! settings.resolution = GelResolution::Coarse;
//! settings.protocol.stop_force_n = 10.0;
//! let scene = Scene {
//!     mesh,
//!     mass_kg: 0.06,
//!     friction: 0.4,
//!     t_world_object: rest.t_world_object,
//!     t_world_gripper: placed.t_world_gripper,
//!     opening_m: placed.opening_m,
//!     gel: settings.gel()?,
//! };
//! let result = simulate(&scene, &settings.protocol, &settings.solver)?;
//! println!("{:?}, lifted {:.1} mm", result.outcome, 1e3 * result.lifted_m);
//! # Ok::<(), gripcast_base::error::Error>(())
//! ```

pub mod affine;
pub mod contact;
mod engine;
pub mod fem;
pub mod fields;
pub mod grasp;
pub mod press;
pub mod rigid;
pub mod solver;
pub mod validate;

pub use engine::{Engine, EngineKind, FemEngine, GraspSetup};
