//! How a frame becomes the bytes of its file.

use std::borrow::Cow;

use image::ImageEncoder as _;
use image::codecs::png::{CompressionType, FilterType, PngEncoder};

use crate::error::{Error, ErrorKind, Result};
use crate::imaging::{Frame, PixelFormat};

/// Bytes to store: a JPEG exactly as the camera sent it, raw formats as PNG.
///
/// # Errors
/// `Input` when the payload does not fit the frame's size.
pub(super) fn encode(frame: &Frame) -> Result<Cow<'_, [u8]>> {
    if frame.data.is_empty() {
        return Err(Error::new(ErrorKind::Input, "the frame is empty"));
    }
    if let Some(expected) = frame.format.frame_bytes(frame.width, frame.height)
        && expected != frame.data.len()
    {
        return Err(Error::new(
            ErrorKind::Input,
            format!(
                "a {}×{} {} frame has {expected} bytes, this one {}",
                frame.width,
                frame.height,
                frame.format,
                frame.data.len()
            ),
        ));
    }
    let png = match frame.format {
        PixelFormat::Mjpg => return Ok(Cow::Borrowed(&frame.data)),
        PixelFormat::Yuyv => png(
            frame,
            &yuyv_to_rgb(&frame.data),
            image::ExtendedColorType::Rgb8,
        ),
        PixelFormat::Grey => png(frame, &frame.data, image::ExtendedColorType::L8),
        PixelFormat::Z16 => {
            let counts: Vec<u8> = frame
                .data
                .chunks_exact(2)
                .flat_map(|le| u16::from_le_bytes([le[0], le[1]]).to_ne_bytes())
                .collect();
            png(frame, &counts, image::ExtendedColorType::L16)
        }
    }?;
    Ok(Cow::Owned(png))
}

/// `pixels` in rows from the top; 16-bit samples in native order.
fn png(frame: &Frame, pixels: &[u8], colour: image::ExtendedColorType) -> Result<Vec<u8>> {
    let mut bytes = Vec::with_capacity(pixels.len() / 2);
    PngEncoder::new_with_quality(&mut bytes, CompressionType::Fast, FilterType::Up)
        .write_image(pixels, frame.width, frame.height, colour)
        .map_err(|e| {
            Error::new(
                ErrorKind::Input,
                format!(
                    "cannot encode the {}×{} frame as PNG",
                    frame.width, frame.height
                ),
            )
            .because(e)
        })?;
    Ok(bytes)
}

/// Y0 U Y1 V, BT.601 limited range, to RGB.
fn yuyv_to_rgb(yuyv: &[u8]) -> Vec<u8> {
    // Coefficients of BT.601 for 8-bit limited range, times 2¹⁶.
    const Y: i32 = 76_309;
    const V_RED: i32 = 104_597;
    const U_GREEN: i32 = 25_675;
    const V_GREEN: i32 = 53_279;
    const U_BLUE: i32 = 132_201;
    let level = |value: i32| ((value + 0x8000) >> 16).clamp(0, 255) as u8;
    let mut rgb = Vec::with_capacity(yuyv.len() / 2 * 3);
    for quad in yuyv.chunks_exact(4) {
        let u = i32::from(quad[1]) - 128;
        let v = i32::from(quad[3]) - 128;
        for y in [quad[0], quad[2]] {
            let y = (i32::from(y) - 16) * Y;
            rgb.extend([
                level(y + V_RED * v),
                level(y - U_GREEN * u - V_GREEN * v),
                level(y + U_BLUE * u),
            ]);
        }
    }
    rgb
}

#[cfg(test)]
mod tests {
    use super::*;

    fn frame(format: PixelFormat, width: u32, height: u32, data: Vec<u8>) -> Frame {
        Frame {
            format,
            width,
            height,
            data: data.into(),
            sequence: 0,
            driver_time_ns: 0,
            received_ns: 0,
        }
    }

    #[test]
    fn jpeg_bytes_are_kept_as_sent() {
        let sent = vec![0xff, 0xd8, 1, 2, 3, 0xff, 0xd9, 0, 0];
        let frame = frame(PixelFormat::Mjpg, 4, 4, sent.clone());
        assert_eq!(encode(&frame).unwrap().as_ref(), sent);
    }

    #[test]
    fn depth_counts_survive() {
        let counts: Vec<u16> = vec![0, 1, 255, 256, 1234, 65_535];
        let data = counts.iter().flat_map(|c| c.to_le_bytes()).collect();
        let png = encode(&frame(PixelFormat::Z16, 3, 2, data))
            .unwrap()
            .into_owned();
        let image = image::load_from_memory(&png).unwrap();
        assert_eq!(image.as_luma16().unwrap().as_raw(), &counts);
    }

    #[test]
    fn yuyv_colours_are_those_of_bt601() {
        // Studio white, black, red and blue (ITU-R BT.601 colour bars), one pair each.
        let data = vec![
            235, 128, 235, 128, 16, 128, 16, 128, 81, 90, 81, 240, 41, 240, 41, 110,
        ];
        let png = encode(&frame(PixelFormat::Yuyv, 8, 1, data))
            .unwrap()
            .into_owned();
        let image = image::load_from_memory(&png).unwrap().to_rgb8();
        let expected: [[i32; 3]; 4] = [[255, 255, 255], [0, 0, 0], [254, 0, 0], [0, 0, 255]];
        for (pair, colour) in expected.iter().enumerate() {
            let found = image.get_pixel(pair as u32 * 2, 0).0;
            for channel in 0..3 {
                let error = i32::from(found[channel]) - colour[channel];
                assert!(error.abs() <= 1, "{found:?} instead of {colour:?}");
            }
        }
    }

    #[test]
    fn a_short_payload_is_refused() {
        let error = encode(&frame(PixelFormat::Z16, 4, 4, vec![0; 31])).unwrap_err();
        assert_eq!(error.kind(), ErrorKind::Input);
        assert!(
            error.to_string().contains("32 bytes, this one 31"),
            "{error}"
        );
    }
}
