//! gripcast: collect grasps with touch, predict before the lift whether they hold.
//!
//! # Units and frames
//! SI units everywhere (m, kg, s, N, Pa, rad); a suffix names the unit where a number crosses a
//! boundary. `t_a_b` maps coordinates of frame b into frame a. Colour order is RGB. Pixel (0,0)
//! is the centre of the top-left pixel. Tactile difference = grasp − initial, signed.
//!
//! # Areas
//! Imports only point down this list; a test holds every `use crate::…` against it.
//!
//! | layer | area | job |
//! | --- | --- | --- |
//! | 0 | [`error`], [`files`], [`geometry`], [`imaging`], [`workers`] | errors; files written whole; meshes and poses; frames, decoding, crops, differences; one item a core |
//! | 1 | [`dataset`], [`pose`], [`shard`], [`sim`] | the crash-safe dataset on disk; poses from markers; Parquet shards; the grasp simulator |
//! | 2 | [`render`], [`predict`], [`annotate`], [`import`], [`export`] | tactile and path-traced pictures of grasps; model contract, preprocessing, ONNX engine; poses of a dataset's grasps; datasets of others; a dataset in formats of others |
//! | 3 | [`rig`], [`session`] | cameras, pedals; the collection state machine |
//! | 4 | [`synth`] | synthetic datasets: objects, plans, simulation, pictures, curation, report |
//! | 5 | [`replay`] | annotated grasps in the simulators, scores and report |
//! | 6 | [`app`] | command line, engine, operator's screen |

#![deny(unsafe_code)]

pub mod annotate;
pub mod app;
pub mod dataset;
pub mod error;
pub mod export;
pub mod files;
pub mod geometry;
pub(crate) mod hdf5;
pub(crate) mod html;
pub mod imaging;
pub mod import;
pub mod nn;
pub mod pose;
pub mod predict;
pub(crate) mod quiet_panic;
pub mod render;
pub mod replay;
pub mod rig;
pub mod session;
pub mod shard;
pub mod sim;
#[cfg(test)]
#[path = "../tests/support/skip.rs"]
mod skip;
pub mod synth;
pub mod train;
pub mod workers;
