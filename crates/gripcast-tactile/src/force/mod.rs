//! Force on a gel from its tactile image.
//!
//! The images of the untouched gel and of the press give the relief of the skin, and the relief
//! gives [`ForceFeatures`] without units. A [`ForceModel`], learned on simulated presses, maps them
//! to the force over Young's modulus. The modulus itself does not show in an image: two gels that
//! are pressed to the same depth look alike and carry different forces. It comes from a
//! [`ForceCalibration`] with known weights, else from the sensor profile.

mod calibration;
mod estimator;
mod features;
mod model;
mod relief;
mod slope_response;

pub use calibration::{CalibratedPress, ForceCalibration, GRAVITY_M_S2, MIN_PRESSES, WeightPress};
pub use estimator::ForceEstimator;
pub use features::{ForceFeatures, ForceSensor, SkinMotion};
pub use model::{ForceModel, ForceSpread, ForceTerm, NormalForce, POISSON, ShearTerm, UnitForce};
