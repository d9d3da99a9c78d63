//! Stability prediction: model contract, preprocessing, ONNX engine.
//!
//! A model is an ONNX file whose metadata is a [`contract::ModelContract`]. [`Model`] loads and
//! checks it, [`ModelInput`] converts 320×240 images to its tensors, [`LivePredictor`] keeps the
//! images of a running session; [`Smoothing`] filters its output for display, [`OodDetector`]
//! detects out-of-distribution images, [`ConformalScores`] gives prediction sets at an error rate, [`Adaptation`] the base rate of a rig, [`PredictedLabel`] is the resulting label and
//! [`contact_doubt`] tells why the images cannot support it. [`SHIPPED`] is a
//! trained model, [`baseline`] a heuristic to compare with; [`onnx`] writes such files.

mod adaptation;
pub mod baseline;
mod benchmark;
mod boosted_trees;
mod builtin;
pub mod conformal;
mod constants;
pub mod contract;
mod engine;
mod graph_check;
mod grasp;
pub mod grasp_head;
mod input;
mod label;
pub mod lift;
mod live;
mod native_engine;
pub mod onnx;
pub mod ood;
mod part;
mod points;
mod smoothing;
mod tensors;

pub use adaptation::{ADAPTATION_STRENGTH, Adaptation, BASE_RATE, training_base_rate};
pub use baseline::BASELINE;
pub use benchmark::{PredictTimings, SelfCheck, measure, self_check};
pub use boosted_trees::{BoostedTrees, TreeNode};
pub use builtin::{SHIPPED, model_bytes};
pub use conformal::{ConformalLimits, ConformalScores, PredictionSet};
pub use contract::ModelContract;
pub use engine::{Model, Prediction};
pub use grasp::{GraspPrediction, InputImages};
pub use grasp_head::{GraspEstimator, GraspHead};
pub use input::ModelInput;
pub use label::{PredictedLabel, contact_doubt};
pub use lift::{LiftEstimator, LiftHead, LiftVerdict};
pub use live::{LivePrediction, LivePredictor};
pub use ood::OodDetector;
pub use points::PointMap;
pub use smoothing::Smoothing;
