//! Stability prediction: model contract, preprocessing, ONNX engine.
//!
//! A model is one ONNX file whose metadata is a [`contract::ModelContract`]. [`Model`] loads and
//! checks it, [`ModelInput`] turns 320×240 images into its tensors, [`LivePredictor`] keeps the
//! images of a running session; [`Smoothing`] calms its answers for a screen, [`Novelty`] tells
//! images that are unlike those of the training, [`Verdict`] what may be claimed. [`SHIPPED`] is a trained model, [`baseline`] a heuristic to hold it against;
//! [`onnx`] writes such files.

pub mod baseline;
pub mod contract;
mod engine;
mod graph_check;
mod input;
mod live;
mod named;
pub mod novelty;
pub mod onnx;
mod own_engine;
mod smoothing;
mod tensors;
mod timing;
mod verdict;

pub use baseline::BASELINE;
pub use contract::ModelContract;
pub use engine::{Model, Prediction};
pub use input::ModelInput;
pub use live::{LivePrediction, LivePredictor};
pub use named::{SHIPPED, model_bytes};
pub use novelty::Novelty;
pub use smoothing::Smoothing;
pub use timing::{PredictFigures, SelfCheck, measure, self_check};
pub use verdict::Verdict;
