//! JPEG frames: header, damage, pixels.
//!
//! [`inspect`] parses the markers without decoding; [`JpegDecoder`] decodes with libjpeg-turbo and
//! rejects damaged images. What is harmless is decoded and stays out of stored files
//! ([`whole_file`]): docs/reference/camera-states.md.

mod damage;
mod decoder;
mod encoder;
mod entropy;
#[cfg(test)]
mod harmless_test;
mod markers;
mod standard_tables;
mod whole_file;

pub use damage::JpegDamage;
pub use decoder::{JpegDecoder, JpegPixels, JpegScale};
pub use encoder::encode_jpeg;
pub use markers::{JpegHeader, Subsampling, inspect};
pub use whole_file::{JpegRepairs, whole_file};

/// Marker codes (the byte after 0xFF) of ITU T.81 table B.1.
mod code {
    pub(super) const SOF0: u8 = 0xc0;
    pub(super) const SOF1: u8 = 0xc1;
    pub(super) const SOF2: u8 = 0xc2;
    pub(super) const DHT: u8 = 0xc4;
    pub(super) const JPG: u8 = 0xc8;
    pub(super) const DAC: u8 = 0xcc;
    pub(super) const SOF15: u8 = 0xcf;
    pub(super) const RST0: u8 = 0xd0;
    pub(super) const RST7: u8 = 0xd7;
    pub(super) const SOI: u8 = 0xd8;
    pub(super) const EOI: u8 = 0xd9;
    pub(super) const SOS: u8 = 0xda;
    pub(super) const DQT: u8 = 0xdb;
    pub(super) const DRI: u8 = 0xdd;
    pub(super) const APP0: u8 = 0xe0;
    pub(super) const APP15: u8 = 0xef;
    pub(super) const COM: u8 = 0xfe;
}
