//! One implicit Euler step: the incremental potential and its minimisation.

mod candidates;
mod ccd;
mod collider;
mod contact_load;
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
pub use contact_load::{ContactLoad, ContactPhases, ContactState, LoadMesh, PhaseMs};
pub use gel::{Drive, Gel, GelMaterial};
pub use gel_factor::{GelFactor, NotPositiveDefinite};
pub use object::Object;
pub use parameters::SolverParameters;
pub use system::{PhaseTimes, StepReport, StepStart, System};
