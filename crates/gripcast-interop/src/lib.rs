//! Datasets of other programs: import, export, HDF5.

pub mod export;
pub mod hdf5;
pub mod import;
mod left_out;
