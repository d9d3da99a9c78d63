//! What every crate of gripcast uses: errors, files below folders that others made, random streams,
//! small linear systems, statistics, work spread over cores.
//!
//! ```
//! use gripcast_base::random::SeedStream;
//!
//! let mut stream = SeedStream::named(7, "masses");
//! let mass_kg = stream.between_log(0.01, 0.5);
//! assert!((0.01..0.5).contains(&mass_kg));
//! ```

pub mod error;
pub mod files;
pub mod linear;
pub mod quiet_panic;
pub mod random;
pub mod statistics;
pub mod workers;
