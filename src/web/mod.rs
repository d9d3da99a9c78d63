//! HTTP API and web page of the running engine.
//!
//! ```text
//!  engine ── status, 20 a second ──► EngineStatus ──► GET /api/state, /api/events
//!         ◄── CommandRequest ── result ── POST /api/commands, labels, names, trash
//!  previews ──► encoder, one per camera, on demand ──► MJPEG
//!  dataset ──► list of grasps, files, previews
//! ```
//!
//! Handlers wait for the engine with a timeout; the engine never waits for them.
//! `docs/reference/api.md` is the contract; `/api/openapi.json` is generated from these functions.

mod access;
mod answers;
mod attach;
mod attached_commands;
mod backend;
mod cameras;
mod commands;
mod events;
mod failure;
mod frames;
mod grasp_list;
mod grasps;
mod health;
mod login;
mod origin;
mod page;
mod previews;
mod router;
mod sender;
mod serve;
mod sessions;
mod slots;
mod stall;

#[cfg(test)]
mod security_test;

pub(crate) use access::{Access, Token};
pub(crate) use attach::{Attached, Screen, Target, attach};
pub(crate) use backend::{Backend, News};
pub(crate) use grasp_list::{GraspList, GraspPage, GraspQuery};
pub(crate) use health::is_healthy;
pub(crate) use router::router;
pub(crate) use serve::{Listeners, serve};
