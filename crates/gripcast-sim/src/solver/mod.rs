//! Implicit Euler step of gels and object: the incremental potential and its minimisation.

mod candidates;
mod ccd;
mod collider;
mod coupling;
mod gel;
mod gel_contact;
mod gel_factor;
mod lbfgs;
mod object;
mod parameters;
mod system;
#[cfg(test)]
mod test_scene;

pub use collider::Collider;
#[cfg(feature = "bench")]
#[doc(hidden)]
pub use gel::GelPhases;
pub use gel::{Drive, Gel, GelMaterial};
pub use gel_contact::NodeContact;
pub use object::Object;
pub use parameters::SolverParameters;
pub use system::{PhaseTimes, StepReport, StepStart, System};
