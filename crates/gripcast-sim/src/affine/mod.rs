//! The object: an affine body (ABD, Lan et al. 2022) that stays very nearly rigid.

mod body;
mod state;

pub use body::AffineBody;
pub use state::{AffineRate, AffineState, add_point_gradient, add_point_hessian, axis_weights};

/// The 12 numbers of an affine body: p, then the columns of A.
pub type Vector12 = [f64; 12];

/// A 12x12 matrix over them, by rows.
pub type Matrix12 = [[f64; 12]; 12];

/// Cholesky factor of such a matrix.
pub type Cholesky = gripcast_base::linear::Cholesky<12>;
