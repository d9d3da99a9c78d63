//! What every crate of gripcast uses: errors, files below folders that others made, random streams,
//! work spread over cores.

pub mod error;
pub mod files;
pub mod quiet_panic;
pub mod random;
pub mod workers;
