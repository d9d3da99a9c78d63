//! The grasp stability classifier: network, training step, ONNX export and inference, vectorised
//! for the CPU (AVX2, AVX-512).
//!
//! Convolutions read their windows in place (no im2col matrix) and accumulate in registers. Results
//! do not depend on the number of threads, nor on the vector width if fused multiply-add is
//! available.
//!
//! ```
//! use gripcast_nn::predict::{Model, ModelInput, SHIPPED, model_bytes};
//!
//! let model = Model::from_bytes(&model_bytes(SHIPPED)?)?;
//! let input = ModelInput::zeros(model.contract())?;
//! let p_stable = model.predict(&input)?.p_stable;
//! assert!((0.0..=1.0).contains(&p_stable));
//! # Ok::<(), gripcast_base::error::Error>(())
//! ```

mod adam;
mod architecture;
mod batch;
mod batch_norm;
mod conv;
mod export;
mod extents;
mod import;
mod inference;
mod lanes;
mod network;
pub mod predict;
mod product;

pub use adam::{Adam, linear_schedule};
pub use architecture::{Architecture, CONTACT_CHANNELS, ConvSpec, GEOMETRY, IMAGE, Layout, Param};
pub use batch::{Batch, Outputs};
pub use export::to_onnx;
pub use extents::{EXTENT_UNITS, ExtentHead, extent_units};
pub use import::from_onnx;
pub use lanes::vector_bits;
pub use network::{Network, Scope, Step};
