//! JPEG to pixels through libjpeg-turbo.

use turbojpeg::{Decompressor, Image, PixelFormat, ScalingFactor};

use super::damage::JpegDamage;
use super::markers::{JpegHeader, inspect};
use super::standard_tables::with_standard_tables;

/// Scans of a progressive image that are still decoded; more is an attack on the decoder.
const MAX_SCANS: u32 = 100;

/// Size of the decoded image against the coded one; sizes are rounded up.
///
/// Only the factors for which libjpeg-turbo has SIMD inverse transforms. A tactile image that
/// goes through `Quarter` to 320×240 differs from one decoded whole and then resized by 0.15 grey
/// levels in the mean and at most 2.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum JpegScale {
    /// 1/8: the mean of each 8×8 block.
    Eighth,
    /// 1/4.
    Quarter,
    /// 1/2.
    Half,
    /// Every pixel.
    Whole,
}

impl JpegScale {
    /// Coded pixels to one decoded pixel along each axis: 1, 2, 4 or 8.
    #[must_use]
    pub fn denominator(self) -> u32 {
        match self {
            Self::Eighth => 8,
            Self::Quarter => 4,
            Self::Half => 2,
            Self::Whole => 1,
        }
    }

    /// The smallest scale at which a window of `window` coded pixels still has at least
    /// `target` pixels (width, height); `Whole` when even that has fewer.
    #[must_use]
    pub fn smallest_for(window: (u32, u32), target: (u32, u32)) -> Self {
        [Self::Eighth, Self::Quarter, Self::Half]
            .into_iter()
            .find(|scale| {
                let n = u64::from(scale.denominator());
                u64::from(window.0) >= n * u64::from(target.0)
                    && u64::from(window.1) >= n * u64::from(target.1)
            })
            .unwrap_or(Self::Whole)
    }

    fn factor(self) -> ScalingFactor {
        match self {
            Self::Eighth => ScalingFactor::ONE_EIGHTH,
            Self::Quarter => ScalingFactor::ONE_QUARTER,
            Self::Half => ScalingFactor::ONE_HALF,
            Self::Whole => ScalingFactor::ONE,
        }
    }
}

/// Decoded pixels, RGB, rows tightly packed; borrowed from the decoder that made them.
#[derive(Clone, Copy, Debug)]
pub struct JpegPixels<'a> {
    /// Width in pixels at the scale that was asked for.
    pub width: u32,
    /// Height in pixels at the scale that was asked for.
    pub height: u32,
    /// `height × width × 3` bytes.
    pub rgb: &'a [u8],
}

/// Decodes JPEG frames; keeps the libjpeg-turbo handle and its buffers between frames.
///
/// # What counts as damage
/// Everything that [`inspect`] refuses, and every warning of libjpeg-turbo: an illegal Huffman
/// code, a scan that ends too early, more than a few bytes left over after the last block. All
/// scales find the same damage, because all of them read all the entropy-coded data.
///
/// JPEG has no checksum, so damage that decodes as another legal image stays unseen: bytes
/// altered only where they hold values, not code lengths. Of seeded random alterations of a
/// 640×480 frame (13 kB) these were found: 1 byte 80 %, 2 bytes 89 %, 8 bytes 98 %, 50 bytes and
/// more 100 %; of a 3280×2464 frame (221 kB): 1 byte 94 %, 8 bytes and more 100 %. A lost stretch
/// of 200 bytes was always found. Checking each block's values against what 8-bit samples can
/// give found only 4 % of the rest, at the price of decoding twice.
///
/// # Speed
/// Reading the entropy-coded data is two thirds and more of the cost at 1/4 (frames of 200 kB
/// and more), so neither plainer colour upsampling (2 %) nor decoding to YCbCr (5 %) is worth its
/// loss. Decoding only the crop's blocks would save at most 15 %, and would not read the data
/// below the crop, where damage would stay unseen.
pub struct JpegDecoder {
    turbo: Decompressor,
    pixels: Vec<u8>,
    completed: Vec<u8>,
}

impl JpegDecoder {
    /// A decoder with empty buffers.
    ///
    /// # Errors
    /// [`JpegDamage::Unsupported`] when libjpeg-turbo cannot be set up (out of memory).
    pub fn new() -> Result<Self, JpegDamage> {
        let set_up = || -> turbojpeg::Result<Decompressor> {
            let mut turbo = Decompressor::new()?;
            turbo.set_scan_limit(MAX_SCANS)?;
            Ok(turbo)
        };
        Ok(Self {
            turbo: set_up().map_err(|error| damage_of(&error))?,
            pixels: Vec::new(),
            completed: Vec::new(),
        })
    }

    /// Decodes an image to RGB.
    ///
    /// # Errors
    /// [`JpegDamage`] for a damaged image; there are no pixels then.
    pub fn decode(&mut self, bytes: &[u8], scale: JpegScale) -> Result<JpegPixels<'_>, JpegDamage> {
        let header = inspect(bytes)?;
        self.decode_inspected(bytes, &header, scale)
    }

    /// [`JpegDecoder::decode`] for bytes whose header is already known.
    pub(crate) fn decode_inspected(
        &mut self,
        bytes: &[u8],
        header: &JpegHeader,
        scale: JpegScale,
    ) -> Result<JpegPixels<'_>, JpegDamage> {
        let (width, height) = self.run(bytes, header, scale, PixelFormat::RGB)?;
        Ok(JpegPixels {
            width,
            height,
            rgb: &self.pixels[..width as usize * height as usize * 3],
        })
    }

    /// Decodes all entropy-coded data and as few pixels as possible.
    ///
    /// # Errors
    /// Exactly those of [`JpegDecoder::decode`].
    pub fn verify(&mut self, bytes: &[u8]) -> Result<JpegHeader, JpegDamage> {
        let header = inspect(bytes)?;
        self.verify_inspected(bytes, &header)?;
        Ok(header)
    }

    /// [`JpegDecoder::verify`] for bytes whose header is already known.
    pub(crate) fn verify_inspected(
        &mut self,
        bytes: &[u8],
        header: &JpegHeader,
    ) -> Result<(), JpegDamage> {
        self.run(bytes, header, JpegScale::Eighth, PixelFormat::GRAY)?;
        Ok(())
    }

    fn run(
        &mut self,
        bytes: &[u8],
        header: &JpegHeader,
        scale: JpegScale,
        format: PixelFormat,
    ) -> Result<(u32, u32), JpegDamage> {
        let image = &bytes[..header.length.min(bytes.len())];
        // libjpeg-turbo has the standard tables too, but prefers those of an earlier frame.
        let image = if header.has_huffman_tables {
            image
        } else {
            with_standard_tables(image, &mut self.completed);
            self.completed.as_slice()
        };
        let width = header.width.div_ceil(scale.denominator());
        let height = header.height.div_ceil(scale.denominator());
        let pitch = width as usize * format.size();
        let needed = pitch * height as usize;
        if self.pixels.len() < needed {
            self.pixels.resize(needed, 0);
        }
        self.turbo
            .set_scaling_factor(scale.factor())
            .and_then(|()| {
                self.turbo.decompress(
                    image,
                    Image {
                        pixels: &mut self.pixels[..needed],
                        width: width as usize,
                        pitch,
                        height: height as usize,
                        format,
                    },
                )
            })
            .map_err(|error| damage_of(&error))?;
        Ok((width, height))
    }
}

/// libjpeg-turbo tells its reasons in words only.
fn damage_of(error: &turbojpeg::Error) -> JpegDamage {
    let turbojpeg::Error::TurboJpegError(text) = error else {
        return JpegDamage::Unsupported(error.to_string());
    };
    if let Some(what) = text.strip_prefix("Corrupt JPEG data: ") {
        JpegDamage::CorruptEntropy(what.to_owned())
    } else if text.starts_with("Premature end") {
        JpegDamage::CorruptEntropy(text.clone())
    } else if text.starts_with("Unsupported") {
        JpegDamage::Unsupported(text.clone())
    } else {
        JpegDamage::Malformed(text.clone())
    }
}
