//! Zarr version 2 arrays that grow along their first axis.

use std::io::Write as _;

use flate2::Compression;
use flate2::write::ZlibEncoder;
use serde_json::{Value, json};

use super::super::staged::write_failed;
use super::store::Store;
use gripcast_base::error::Result;

/// Maximum number of rows of a chunk; each image has its own chunk.
const ROWS_PER_CHUNK: usize = 1024;
/// Size of a chunk of large rows, bytes.
const CHUNK_BYTES: usize = 1 << 20;
/// Level of zlib: higher ones hardly compress camera images further.
const LEVEL: u32 = 1;
/// Bytes per character of a string.
const CHARACTER: usize = 4;

/// Type of a value, little endian, named like in NumPy.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Kind {
    Bool,
    U1,
    I1,
    I8,
    F4,
    F8,
    /// UTF-32 string of this length, padded with zeros.
    Text(usize),
}

impl Kind {
    /// NumPy's name of the type.
    fn dtype(self) -> String {
        match self {
            Self::Bool => "|b1".to_owned(),
            Self::U1 => "|u1".to_owned(),
            Self::I1 => "|i1".to_owned(),
            Self::I8 => "<i8".to_owned(),
            Self::F4 => "<f4".to_owned(),
            Self::F8 => "<f8".to_owned(),
            Self::Text(length) => format!("<U{length}"),
        }
    }

    fn bytes(self) -> usize {
        match self {
            Self::Bool | Self::U1 | Self::I1 => 1,
            Self::F4 => 4,
            Self::I8 | Self::F8 => 8,
            Self::Text(length) => CHARACTER * length,
        }
    }

    /// Fill value of missing chunks.
    fn fill(self) -> Value {
        match self {
            Self::Bool => json!(false),
            Self::U1 | Self::I1 | Self::I8 => json!(0),
            Self::F4 | Self::F8 => json!("NaN"),
            Self::Text(_) => json!(""),
        }
    }
}

/// Array of small rows, buffered until a chunk is full.
pub(super) struct Rows {
    name: String,
    kind: Kind,
    /// Shape of a row.
    shape: Vec<usize>,
    buffer: Vec<u8>,
    rows: usize,
}

impl Rows {
    pub(super) fn new(name: impl Into<String>, kind: Kind, shape: &[usize]) -> Self {
        Self {
            name: name.into(),
            kind,
            shape: shape.to_vec(),
            buffer: Vec::new(),
            rows: 0,
        }
    }

    /// Appends a row of bytes, little endian.
    pub(super) fn push(&mut self, store: &mut Store<'_>, row: &[u8]) -> Result<()> {
        debug_assert_eq!(row.len(), self.row_bytes());
        self.buffer.extend_from_slice(row);
        self.rows += 1;
        if self.rows.is_multiple_of(self.rows_per_chunk()) {
            self.write_chunk(store)?;
        }
        Ok(())
    }

    /// Appends a string; longer ones are truncated.
    pub(super) fn push_text(&mut self, store: &mut Store<'_>, text: &str) -> Result<()> {
        let mut row: Vec<u8> = text
            .chars()
            .flat_map(|c| u32::from(c).to_le_bytes())
            .collect();
        row.resize(self.row_bytes(), 0);
        self.push(store, &row)
    }

    pub(super) fn finish(mut self, store: &mut Store<'_>) -> Result<()> {
        if !self.buffer.is_empty() {
            // All chunks have the same shape; readers ignore the padding.
            self.buffer
                .resize(self.rows_per_chunk() * self.row_bytes(), 0);
            self.write_chunk(store)?;
        }
        let shape: Vec<usize> = [&[self.rows], self.shape.as_slice()].concat();
        let chunks: Vec<usize> = [&[self.rows_per_chunk()], self.shape.as_slice()].concat();
        let description = describe(&shape, &chunks, self.kind);
        store.put_json(&format!("{}/.zarray", self.name), &description)
    }

    fn write_chunk(&mut self, store: &mut Store<'_>) -> Result<()> {
        let number = (self.rows - 1) / self.rows_per_chunk();
        let name = chunk_name(&self.name, number, self.shape.len());
        store.put(&name, &compressed(&self.buffer)?)?;
        self.buffer.clear();
        Ok(())
    }

    fn rows_per_chunk(&self) -> usize {
        let fitting = CHUNK_BYTES / self.row_bytes().max(1);
        fitting.clamp(1, ROWS_PER_CHUNK)
    }

    fn row_bytes(&self) -> usize {
        self.kind.bytes() * self.shape.iter().product::<usize>()
    }
}

/// Array of RGB images of equal size, one per chunk.
pub(super) struct Images {
    name: String,
    width: usize,
    height: usize,
    rows: usize,
}

impl Images {
    pub(super) fn new(name: String, (width, height): (u32, u32)) -> Self {
        Self {
            name,
            width: width as usize,
            height: height as usize,
            rows: 0,
        }
    }

    /// Appends an image of `height × width × 3` bytes; `None` reads as black.
    pub(super) fn push(&mut self, store: &mut Store<'_>, pixels: Option<&[u8]>) -> Result<()> {
        if let Some(pixels) = pixels {
            let name = chunk_name(&self.name, self.rows, 3);
            store.put(&name, &compressed(pixels)?)?;
        }
        self.rows += 1;
        Ok(())
    }

    pub(super) fn finish(self, store: &mut Store<'_>) -> Result<()> {
        let shape = [self.rows, self.height, self.width, 3];
        let chunks = [1, self.height, self.width, 3];
        let description = describe(&shape, &chunks, Kind::U1);
        store.put_json(&format!("{}/.zarray", self.name), &description)
    }
}

/// Name of a chunk, such as `data/left/7.0.0.0`; only the first axis is chunked.
fn chunk_name(array: &str, number: usize, further_axes: usize) -> String {
    format!("{array}/{number}{}", ".0".repeat(further_axes))
}

fn describe(shape: &[usize], chunks: &[usize], kind: Kind) -> Value {
    json!({
        "zarr_format": 2,
        "shape": shape,
        "chunks": chunks,
        "dtype": kind.dtype(),
        "compressor": {"id": "zlib", "level": LEVEL},
        "fill_value": kind.fill(),
        "order": "C",
        "filters": null,
    })
}

fn compressed(bytes: &[u8]) -> Result<Vec<u8>> {
    let mut encoder = ZlibEncoder::new(Vec::new(), Compression::new(LEVEL));
    let written = encoder.write_all(bytes).and_then(|()| encoder.finish());
    written.map_err(write_failed)
}
