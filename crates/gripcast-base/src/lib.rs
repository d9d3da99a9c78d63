//! Foundation of all gripcast crates: errors, safe and atomic file access, random streams, ranges
//! of numbers, small linear systems, statistics, parallel work.
//!
//! ```
//! use gripcast_base::random::SeedStream;
//!
//! let mut stream = SeedStream::named(7, "masses");
//! let mass_kg = stream.between_log(0.01, 0.5);
//! assert!((0.01..0.5).contains(&mass_kg));
//! ```

pub mod catch_panic;
pub mod error;
pub mod files;
pub mod linear;
pub mod number;
pub mod random;
pub mod statistics;
pub mod workers;
