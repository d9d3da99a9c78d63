//! Incremental potential contact (IPC, Li et al. 2020): distances, barrier, edge-edge mollifier,
//! friction, continuous collision detection.
//!
//! Positions are in m, in one common frame. Every pair is a stencil of four points: a point and a
//! triangle `[p, t0, t1, t2]`, or two edges `[a0, a1, b0, b1]`.

pub mod barrier;
pub mod ccd;
pub mod distance;
pub mod friction;
pub mod mollifier;

#[cfg(test)]
pub(crate) mod stencil_cases;
