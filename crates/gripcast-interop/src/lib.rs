//! Third-party dataset formats: export, import, HDF5; the log of a collection.

pub mod black_box;
pub mod export;
pub mod hdf5;
pub mod import;
mod left_out;
pub mod video;
