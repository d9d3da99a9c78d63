//! The classifier's network and the arithmetic that trains and runs it, on the processor's widest
//! vectors.
//!
//! Convolutions gather their windows where they lie (no matrix of windows is made) and keep sums in
//! registers. Results do not depend on the number of threads, nor on the width of vectors where
//! they have fused multiply-add.
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
mod batch_norm;
mod conv;
mod export;
mod inference;
mod lanes;
mod network;
pub mod predict;
mod product;

pub use adam::{Adam, linear_schedule};
pub use architecture::{Architecture, ConvSpec, IMAGE, Layout, Part};
pub use export::to_onnx;
pub use lanes::vector_bits;
pub use network::{Batch, Network, Step};
