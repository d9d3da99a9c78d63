//! Storage of chunks and metadata: a directory, or a zip file.

use std::fs::File;
use std::io::{self, BufWriter, Write as _};

use serde_json::Value;
use zip::write::SimpleFileOptions;
use zip::{CompressionMethod, DateTime, ZipWriter};

use super::super::staged::{StagedFolder, write_failed};
use super::ZIP_NAME;
use gripcast_base::error::{Error, Result};

/// A key-value store of a Zarr export.
pub(super) enum Store<'a> {
    Folder(&'a StagedFolder),
    /// Its directory, about 100 bytes per chunk, is in memory until the end.
    Zip(Box<ZipWriter<BufWriter<File>>>),
}

impl<'a> Store<'a> {
    pub(super) fn create(folder: &'a StagedFolder, is_zip: bool) -> Result<Self> {
        if !is_zip {
            return Ok(Self::Folder(folder));
        }
        let file = folder.file(ZIP_NAME)?;
        Ok(Self::Zip(Box::new(ZipWriter::new(file))))
    }

    pub(super) fn put(&mut self, key: &str, bytes: &[u8]) -> Result<()> {
        match self {
            Self::Folder(folder) => folder.write(key, bytes),
            Self::Zip(zip) => {
                // Chunks are already compressed; without a date equal chunks give equal files.
                let options = SimpleFileOptions::default()
                    .compression_method(CompressionMethod::Stored)
                    .last_modified_time(DateTime::default())
                    .unix_permissions(0o644);
                zip.start_file(key, options).map_err(zip_failed)?;
                zip.write_all(bytes).map_err(write_failed)
            }
        }
    }

    pub(super) fn put_json(&mut self, key: &str, value: &Value) -> Result<()> {
        let mut text = serde_json::to_vec_pretty(value)
            .map_err(|e| Error::internal("cannot write a description").because(e))?;
        text.push(b'\n');
        self.put(key, &text)
    }

    pub(super) fn finish(self) -> Result<()> {
        match self {
            Self::Folder(_) => Ok(()),
            Self::Zip(zip) => {
                let mut file = zip.finish().map_err(zip_failed)?;
                file.flush().map_err(write_failed)
            }
        }
    }
}

fn zip_failed(error: zip::result::ZipError) -> Error {
    match error {
        zip::result::ZipError::Io(error) => write_failed(error),
        other => write_failed(io::Error::other(other)),
    }
}
