//! The object: an affine body (ABD, Lan et al. 2022) that stays very nearly rigid.

mod body;
mod dense;
mod state;

pub use body::AffineBody;
pub use dense::{Cholesky, Matrix12, Vector12};
pub use state::{AffineRate, AffineState, add_point_gradient, add_point_hessian, axis_weights};
