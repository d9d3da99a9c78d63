//! Parquet shards: samples with their images in a file that pandas and Hugging Face `datasets`
//! read in one line.
//!
//! A [`ShardRow`] is one grasp, real or a rendering of a simulated one. [`ShardWriter`] writes rows into one
//! file, [`ShardReader`] reads them again with bounded memory, [`ShardSet`] is a folder of such
//! files by split. The columns that a real dataset has as well have the same names. A [`TableWriter`]
//! writes rows of other columns in the same way.
//!
//! Row groups are small, pages are not compressed (images are already), and nothing in a file
//! depends on the time, the machine or the number of threads. Each row group has a hash of its
//! contents in the file's metadata, which the reader checks.

mod cell;
mod columns;
mod cursor;
mod digest;
mod group;
mod layout;
mod metadata;
mod page;
mod reader;
mod row;
mod set;
mod source;
mod split;
mod staged;
mod table;
mod table_column;
mod writer;

#[cfg(test)]
mod damage_test;
#[cfg(test)]
mod foreign_test;
#[cfg(test)]
mod sample_rows;

pub use cell::Cell as TableCell;
pub use metadata::EXPORT;
pub use reader::ShardReader;
pub use row::{ShardEngine, ShardFacts, ShardImages, ShardOutcome, ShardRow};
pub use set::{ShardSet, shard_name, shard_place};
pub use split::{Split, SplitGroup};
pub use table::TableWriter;
pub use table_column::TableKind;
pub use writer::{ShardWriter, to_bytes};
