//! Parquet shards: samples with images in a file that pandas and Hugging Face `datasets`
//! read in one line.
//!
//! A [`ShardRow`] is one grasp, real or a rendering of a simulated one. [`ShardWriter`] writes
//! rows to a file, [`ShardReader`] reads them with bounded memory, [`ShardSet`] is a directory of
//! such files by split. Columns that a real dataset also has share their names. A [`TableWriter`]
//! writes tables with other columns.
//!
//! Row groups are small, pages are not compressed (images already are), and a file does not depend
//! on the time, the machine or the number of threads. The file's metadata has a hash of each row
//! group, which the reader checks.

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
pub use set::{ShardSet, shard_name, shard_path};
pub use split::{SplitFractions, SplitGroup};
pub use table::TableWriter;
pub use table_column::ColumnType;
pub use writer::{ShardWriter, to_bytes};
