//! Encodes frames for storage.

use std::borrow::Cow;

use image::GrayImage;

use gripcast_base::error::{Error, Result};
use gripcast_imaging::{
    Decoder, Frame, JpegRepairs, PixelFormat, check_structure, encode_png_grey8, encode_png_grey16,
    encode_png_rgb, whole_file,
};

/// Returns the bytes to store: a JPEG as the camera sent it except for the repairs, raw formats as
/// PNG (YUYV as the RGB image that it decodes to). A damaged JPEG is stored as sent.
///
/// # Errors
/// `Input` when the payload does not match the frame's size.
pub(super) fn encode(frame: &Frame) -> Result<(Cow<'_, [u8]>, Option<JpegRepairs>)> {
    if frame.data.is_empty() {
        return Err(Error::input("empty frame"));
    }
    if frame.format == PixelFormat::Mjpg {
        return Ok(whole_file(&frame.data).unwrap_or((Cow::Borrowed(&frame.data), None)));
    }
    Ok((encode_raw(frame)?.into(), None))
}

fn encode_raw(frame: &Frame) -> Result<Vec<u8>> {
    Ok(match frame.format {
        PixelFormat::Mjpg => frame.data.to_vec(),
        PixelFormat::Yuyv | PixelFormat::Rgb => {
            encode_png_rgb(&Decoder::new()?.decode_full(frame)?)?
        }
        PixelFormat::Z16 => encode_png_grey16(&Decoder::new()?.depth(frame)?)?,
        PixelFormat::Grey => {
            check_structure(frame)?;
            let image = GrayImage::from_raw(frame.width, frame.height, frame.data.to_vec());
            let image =
                image.ok_or_else(|| Error::internal("a checked frame has an invalid size"))?;
            encode_png_grey8(&image)?
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
    fn jpeg_is_stored_as_sent_without_what_is_no_image() {
        let jpeg = crate::sample::jpeg(24, 16, 3);
        let stored = |sent: &[u8]| {
            let frame = frame(PixelFormat::Mjpg, 24, 16, sent.to_vec());
            let (bytes, repairs) = encode(&frame).unwrap();
            assert_eq!(*bytes, jpeg);
            repairs
        };
        assert_eq!(stored(&jpeg), None);
        let repairs = stored(&[b"\n\0", &jpeg[..jpeg.len() - 2], &[0; 4]].concat());
        let json = serde_json::to_value(repairs).unwrap();
        let expected = serde_json::json!({
            "removed_before_start": 2,
            "removed_after_end": 4,
            "added_end_marker": true,
        });
        assert_eq!(json, expected);
    }

    #[test]
    fn depth_counts_are_preserved() {
        let counts: Vec<u16> = vec![0, 1, 255, 256, 1234, 65_535];
        let data = counts.iter().flat_map(|c| c.to_le_bytes()).collect();
        let png = encode_raw(&frame(PixelFormat::Z16, 3, 2, data)).unwrap();
        let image = image::load_from_memory(&png).unwrap();
        assert_eq!(image.as_luma16().unwrap().as_raw(), &counts);
    }

    #[test]
    fn yuyv_decodes_as_bt601() {
        // Studio white, black, red and blue (ITU-R BT.601 colour bars), one pair each.
        let data = vec![
            235, 128, 235, 128, 16, 128, 16, 128, 81, 90, 81, 240, 41, 240, 41, 110,
        ];
        let png = encode_raw(&frame(PixelFormat::Yuyv, 8, 1, data)).unwrap();
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
