//! Decodes frames to images.

use image::RgbImage;

use super::crop::{CropProfile, CropWindow};
use super::damage::FrameDamage;
use super::depth_preview::{self, DepthColours};
use super::frame::{Frame, MAX_SIDE, PixelFormat};
use super::jpeg::{self, JpegDecoder, JpegHeader, JpegScale};
use super::png::{decode_png_rgb, decode_webp_rgb};
use super::resample::{RgbScaler, Source, check_stored, check_target, crop_and_resize, window_of};
use super::yuyv::yuyv_to_rgb;
use super::z16::{self, DepthImage};
use gripcast_base::error::{Error, Result as CrateResult};
use gripcast_base::files::file_type;

/// Usual unit of a depth camera, m.
const MILLIMETRE: f64 = 0.001;

/// Decodes frames to images; reuses its buffers. Damaged frames are errors.
///
/// ```
/// use gripcast_imaging::{CropProfile, Decoder, Frame, PixelFormat, encode_jpeg, synthetic_gel};
///
/// let gel = synthetic_gel(640, 480, 1, 0.5);
/// let frame = Frame {
///     format: PixelFormat::Mjpg,
///     width: 640,
///     height: 480,
///     data: encode_jpeg(&gel, 90)?.into(),
///     sequence: 0,
///     driver_time_ns: 0,
///     received_ns: 0,
/// };
/// let mut decoder = Decoder::new()?;
/// let input = decoder.decode(&frame, Some(&CropProfile::GSMINI_SEVENTH), 320, 240)?;
/// assert_eq!(input.dimensions(), (320, 240));
/// # Ok::<(), gripcast_base::error::Error>(())
/// ```
pub struct Decoder {
    jpeg: JpegDecoder,
    scaler: RgbScaler,
    rgb: Vec<u8>,
}

impl Decoder {
    /// A decoder with empty buffers.
    ///
    /// # Errors
    /// When libjpeg-turbo fails to initialise.
    pub fn new() -> CrateResult<Self> {
        Ok(Self {
            jpeg: JpegDecoder::new()?,
            scaler: RgbScaler::default(),
            rgb: Vec::new(),
        })
    }

    /// Decodes a JPEG, PNG or WebP file at its size.
    ///
    /// # Errors
    /// `Input` for a damaged or unsupported file.
    pub fn stored_image(&mut self, bytes: &[u8]) -> CrateResult<RgbImage> {
        match bytes {
            [0xff, 0xd8, ..] => {
                let JpegHeader { width, height, .. } = jpeg::inspect(bytes)?;
                self.decode_file(bytes, None, width, height)
            }
            [0x89, b'P', b'N', b'G', ..] => decode_png_rgb(bytes),
            [b'R', b'I', b'F', b'F', _, _, _, _, form @ ..] if form.starts_with(b"WEBP") => {
                decode_webp_rgb(bytes)
            }
            _ => {
                let found = file_type(bytes).unwrap_or("another type of file");
                let what = format!("expected a JPEG, PNG or WebP image, found {found}");
                Err(Error::input(what).remedy("convert the image to PNG"))
            }
        }
    }

    /// Decodes, crops (`None`: not) and resizes a frame to RGB.
    ///
    /// A JPEG is decoded at the smallest scale of 1/8, 1/4, 1/2 and 1 with enough pixels in the
    /// crop. Depth is shown as by [`Decoder::depth_preview`], in units of a millimetre.
    ///
    /// # Errors
    /// [`FrameDamage`] of the frame or for an invalid size.
    pub fn decode(
        &mut self,
        frame: &Frame,
        crop: Option<&CropProfile>,
        width: u32,
        height: u32,
    ) -> Result<RgbImage, FrameDamage> {
        let crop = crop.unwrap_or(&CropProfile::FULL);
        if let Some(header) = check(frame)? {
            return self.decode_jpeg(&frame.data, &header, crop, width, height);
        }
        check_target(width, height)?;
        let window = window_of(crop, frame.width, frame.height)?;
        if frame.format == PixelFormat::Z16 {
            return Ok(depth_in_colour(frame, MILLIMETRE, window, (width, height)));
        }
        raw_to_rgb(frame, &mut self.rgb);
        let source = Source {
            width: frame.width,
            height: frame.height,
            rgb: &self.rgb,
            reduction: 1,
        };
        self.scaler.resample(&source, window, width, height)
    }

    /// Shows a Z16 frame in colour: Turbo over [`DEPTH_RANGE_M`](crate::DEPTH_RANGE_M) from blue
    /// (near) to red (far), grey stripes without depth, nearest neighbour, with the scale at the
    /// lower edge. `unit_m`: metres per count.
    ///
    /// # Errors
    /// [`FrameDamage`] of the frame, for another format or for an invalid size.
    pub fn depth_preview(
        &mut self,
        frame: &Frame,
        unit_m: f64,
        width: u32,
        height: u32,
    ) -> Result<RgbImage, FrameDamage> {
        check(frame)?;
        check_target(width, height)?;
        let format = frame.format;
        if format != PixelFormat::Z16 {
            return Err(FrameDamage::NoDepth { format });
        }
        let window = window_of(&CropProfile::FULL, frame.width, frame.height)?;
        Ok(depth_in_colour(frame, unit_m, window, (width, height)))
    }

    fn decode_jpeg(
        &mut self,
        bytes: &[u8],
        header: &JpegHeader,
        crop: &CropProfile,
        width: u32,
        height: u32,
    ) -> Result<RgbImage, FrameDamage> {
        check_target(width, height)?;
        let window = window_of(crop, header.width, header.height)?;
        let scale = JpegScale::smallest_for((window.width, window.height), (width, height));
        let pixels = self.jpeg.decode_inspected(bytes, header, scale)?;
        let source = Source {
            width: pixels.width,
            height: pixels.height,
            rgb: pixels.rgb,
            reduction: scale.denominator(),
        };
        self.scaler.resample(&source, window, width, height)
    }

    /// The whole frame at its own size, RGB; depth in colour, in units of a millimetre.
    ///
    /// # Errors
    /// [`FrameDamage`] says what is wrong with the frame.
    pub fn decode_full(&mut self, frame: &Frame) -> Result<RgbImage, FrameDamage> {
        let rgb = match check(frame)? {
            Some(header) => self
                .jpeg
                .decode_inspected(&frame.data, &header, JpegScale::Whole)?
                .rgb
                .to_vec(),
            None => {
                let mut rgb = Vec::new();
                raw_to_rgb(frame, &mut rgb);
                rgb
            }
        };
        RgbImage::from_raw(frame.width, frame.height, rgb).ok_or(FrameDamage::TargetSize {
            width: frame.width,
            height: frame.height,
        })
    }

    /// A stored JPEG or PNG, cropped and resized exactly as [`Decoder::decode`] does with frames;
    /// this is how training reads what the live path saw.
    ///
    /// # Errors
    /// `Input` for a damaged or unsupported file, or an invalid size.
    pub fn decode_file(
        &mut self,
        bytes: &[u8],
        crop: Option<&CropProfile>,
        width: u32,
        height: u32,
    ) -> CrateResult<RgbImage> {
        let crop = crop.unwrap_or(&CropProfile::FULL);
        match bytes {
            [0xff, 0xd8, ..] => {
                let header = jpeg::inspect(bytes)?;
                let pixels = u64::from(header.width) * u64::from(header.height);
                check_stored(header.width, header.height, 3 * pixels)?;
                Ok(self.decode_jpeg(bytes, &header, crop, width, height)?)
            }
            _ => {
                let image = self.stored_image(bytes)?;
                Ok(crop_and_resize(&image, crop, width, height)?)
            }
        }
    }

    /// Depth in the camera's units; 0: unknown.
    ///
    /// # Errors
    /// [`FrameDamage::NoDepth`] for other formats, or the damage of the frame.
    pub fn depth(&self, frame: &Frame) -> Result<DepthImage, FrameDamage> {
        check(frame)?;
        let no_depth = FrameDamage::NoDepth {
            format: frame.format,
        };
        if frame.format != PixelFormat::Z16 {
            return Err(no_depth);
        }
        DepthImage::from_raw(frame.width, frame.height, z16::values(&frame.data)).ok_or(no_depth)
    }

    /// Checks that a frame decodes, at minimum cost: decodes all entropy-coded data of a JPEG at
    /// the smallest scale; checks the size of raw formats.
    ///
    /// # Errors
    /// The damage found by [`Decoder::decode`].
    pub fn verify(&mut self, frame: &Frame) -> Result<(), FrameDamage> {
        if let Some(header) = check(frame)? {
            self.jpeg.verify_inspected(&frame.data, &header)?;
        }
        Ok(())
    }
}

/// Checks sizes and the marker structure of a JPEG, without decoding.
///
/// # Errors
/// The damage of the frame.
pub fn check_structure(frame: &Frame) -> Result<(), FrameDamage> {
    check(frame).map(|_| ())
}

/// [`check_structure`], returning the header of a JPEG.
fn check(frame: &Frame) -> Result<Option<JpegHeader>, FrameDamage> {
    let Frame {
        format,
        width,
        height,
        ref data,
        ..
    } = *frame;
    let invalid = |expected| FrameDamage::FrameSize {
        format,
        width,
        height,
        expected,
    };
    if !(1..=MAX_SIDE).contains(&width) || !(1..=MAX_SIDE).contains(&height) {
        return Err(invalid("1 to 16384 pixels a side"));
    }
    if format == PixelFormat::Yuyv && width % 2 != 0 {
        return Err(invalid("an even width"));
    }
    if let Some(expected) = format.frame_bytes(width, height) {
        let found = data.len();
        if found != expected {
            return Err(FrameDamage::ByteCount {
                format,
                width,
                height,
                expected,
                found,
            });
        }
        return Ok(None);
    }
    let header = jpeg::inspect(data)?;
    let (expected, found) = ((width, height), (header.width, header.height));
    if expected != found {
        return Err(FrameDamage::ImageSize { expected, found });
    }
    Ok(Some(header))
}

/// Depth in colour, of a checked frame.
fn depth_in_colour(frame: &Frame, unit_m: f64, window: CropWindow, size: (u32, u32)) -> RgbImage {
    let depth = |x: u32, y: u32| {
        let at = (y as usize * frame.width as usize + x as usize) * 2;
        u16::from_le_bytes([frame.data[at], frame.data[at + 1]])
    };
    depth_preview::draw(depth, unit_m, window, size)
}

/// Converts a raw frame with a checked byte count.
fn raw_to_rgb(frame: &Frame, rgb: &mut Vec<u8>) {
    rgb.resize(frame.width as usize * frame.height as usize * 3, 0);
    match frame.format {
        PixelFormat::Yuyv => yuyv_to_rgb(&frame.data, rgb),
        PixelFormat::Grey => {
            for (pixel, level) in rgb.chunks_exact_mut(3).zip(frame.data.iter()) {
                pixel.fill(*level);
            }
        }
        PixelFormat::Z16 => {
            let colours = DepthColours::new(MILLIMETRE);
            let positions = (0..frame.height).flat_map(|y| (0..frame.width).map(move |x| (x, y)));
            let depths = frame.data.chunks_exact(2).zip(positions);
            for (pixel, (depth, (x, y))) in rgb.chunks_exact_mut(3).zip(depths) {
                let depth = u16::from_le_bytes([depth[0], depth[1]]);
                pixel.copy_from_slice(&colours.colour(depth, x, y));
            }
        }
        PixelFormat::Rgb => rgb.copy_from_slice(&frame.data),
        PixelFormat::Mjpg => {}
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn files_that_are_no_supported_images_are_named() {
        let mut decoder = Decoder::new().unwrap();
        for (bytes, found) in [
            (&b"BM\x10\0\0\0"[..], "found a BMP image"),
            (b"II*\0", "found a TIFF image"),
            (b"<html>", "found an HTML page"),
            (b"\x01\x02", "found another type of file"),
            (b"", "found an empty file"),
        ] {
            let error = decoder.stored_image(bytes).unwrap_err().to_string();
            assert!(error.contains(found), "{error}");
        }
    }

    #[test]
    fn webp_is_decoded_and_damage_is_an_error() {
        let image = RgbImage::from_fn(7, 5, |x, y| image::Rgb([(30 * x) as u8, 40 * y as u8, 9]));
        let mut webp = Vec::new();
        let encoder = image::codecs::webp::WebPEncoder::new_lossless(&mut webp);
        image.write_with_encoder(encoder).unwrap();
        let mut decoder = Decoder::new().unwrap();
        assert_eq!(decoder.stored_image(&webp).unwrap(), image);
        let error = decoder.stored_image(&webp[..webp.len() / 2]).unwrap_err();
        assert!(error.to_string().contains("damaged WebP image"), "{error}");
    }
}
