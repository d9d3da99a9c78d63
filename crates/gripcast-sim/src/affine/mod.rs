//! Affine body dynamics (ABD, Lan et al. 2022): a nearly rigid object with 12 degrees of freedom.

mod body;
mod state;

pub use body::AffineBody;
pub use state::{AffineRate, AffineState, add_point_gradient, add_point_hessian, axis_weights};

/// Vector over the unknowns of an affine body: p, then the columns of A.
pub type Vector12 = [f64; 12];

/// Matrix over the unknowns of an affine body, row-major.
pub type Matrix12 = [[f64; 12]; 12];

/// Cholesky factor of a [`Matrix12`].
pub type Cholesky = gripcast_base::linear::Cholesky<12>;
