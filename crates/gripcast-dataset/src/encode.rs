//! Encodes frames for storage.

use std::borrow::Cow;

use image::GrayImage;

use gripcast_base::error::{Error, Result};
use gripcast_imaging::{
    Decoder, Frame, PixelFormat, check_structure, encode_png_grey8, encode_png_grey16,
    encode_png_rgb,
};

/// Returns the bytes to store: a JPEG exactly as the camera sent it, raw formats as PNG (YUYV as
/// the RGB image that it decodes to).
///
/// # Errors
/// `Input` when the payload does not match the frame's size.
pub(super) fn encode(frame: &Frame) -> Result<Cow<'_, [u8]>> {
    if frame.data.is_empty() {
        return Err(Error::input("empty frame"));
    }
    Ok(match frame.format {
        PixelFormat::Mjpg => Cow::Borrowed(&frame.data),
        PixelFormat::Yuyv | PixelFormat::Rgb => {
            encode_png_rgb(&Decoder::new()?.decode_full(frame)?)?.into()
        }
        PixelFormat::Z16 => encode_png_grey16(&Decoder::new()?.depth(frame)?)?.into(),
        PixelFormat::Grey => {
            check_structure(frame)?;
            let image = GrayImage::from_raw(frame.width, frame.height, frame.data.to_vec());
            let image =
                image.ok_or_else(|| Error::internal("a checked frame has an invalid size"))?;
            encode_png_grey8(&image)?.into()
        }
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use gripcast_base::error::ErrorKind;

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
    fn jpeg_is_stored_as_sent() {
        let sent = vec![0xff, 0xd8, 1, 2, 3, 0xff, 0xd9, 0, 0];
        let frame = frame(PixelFormat::Mjpg, 4, 4, sent.clone());
        assert_eq!(encode(&frame).unwrap().as_ref(), sent);
    }

    #[test]
    fn depth_counts_are_preserved() {
        let counts: Vec<u16> = vec![0, 1, 255, 256, 1234, 65_535];
        let data = counts.iter().flat_map(|c| c.to_le_bytes()).collect();
        let png = encode(&frame(PixelFormat::Z16, 3, 2, data))
            .unwrap()
            .into_owned();
        let image = image::load_from_memory(&png).unwrap();
        assert_eq!(image.as_luma16().unwrap().as_raw(), &counts);
    }

    #[test]
    fn yuyv_decodes_as_bt601() {
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
    fn short_payload_is_refused() {
        let error = encode(&frame(PixelFormat::Z16, 4, 4, vec![0; 31])).unwrap_err();
        assert_eq!(error.kind(), ErrorKind::Input);
        assert!(error.to_string().contains("32 bytes, found 31"), "{error}");
    }
}
