//! One implicit Euler step: the incremental potential and its minimisation.

mod candidates;
mod ccd;
mod collider;
mod coupling;
mod gel;
mod gel_contact;
mod gel_factor;
#[cfg(feature = "bench")]
mod gel_phases;
mod lbfgs;
mod object;
mod parameters;
mod system;
#[cfg(test)]
mod test_scene;

pub use collider::Collider;
pub use gel::{Drive, Gel, GelMaterial};
pub use gel_factor::{GelFactor, NotPositiveDefinite};
#[cfg(feature = "bench")]
#[doc(hidden)]
pub use gel_phases::GelPhases;
pub use object::Object;
pub use parameters::SolverParameters;
pub use system::{PhaseTimes, StepReport, StepStart, System};
