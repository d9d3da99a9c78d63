//! Frames as a camera may send them, and images as a dataset may hold them.
//!
//! Input: format (byte 0, modulo 4), width and height in pixels less one (bytes 1 and 2), payload.

use std::cell::RefCell;

use gripcast_imaging::{CropProfile, Decoder, Frame, PixelFormat, check_structure, whole_file};

/// Larger images only take longer.
const MAX_PIXELS: u32 = 1 << 16;

thread_local! {
    static DECODER: RefCell<Option<Decoder>> = const { RefCell::new(None) };
}

/// Panics where something is wrong.
pub(crate) fn check(input: &[u8]) {
    let [format, width, height, payload @ ..] = input else {
        return;
    };
    let format = [
        PixelFormat::Mjpg,
        PixelFormat::Yuyv,
        PixelFormat::Z16,
        PixelFormat::Grey,
    ][usize::from(*format) % 4];
    let frame = Frame {
        format,
        width: u32::from(*width) + 1,
        height: u32::from(*height) + 1,
        data: payload.to_vec().into(),
        sequence: 0,
        driver_time_ns: 0,
        received_ns: 0,
    };
    DECODER.with_borrow_mut(|decoder| {
        let decoder = decoder.get_or_insert_with(|| Decoder::new().expect("a decoder"));
        let sound = check_structure(&frame).is_ok();
        let whole = decoder.decode_full(&frame);
        assert!(sound || whole.is_err(), "decoded a frame that is refused");
        if let Ok(image) = &whole {
            assert_eq!((image.width(), image.height()), (frame.width, frame.height));
            if format == PixelFormat::Mjpg {
                stored_file_is_whole(decoder, &frame, image.as_raw());
            }
        }
        let _ = decoder.verify(&frame);
        let _ = decoder.depth(&frame);
        let _ = decoder.decode(&frame, Some(&CropProfile::FULL), 32, 24);
        if claimed_pixels(payload) <= MAX_PIXELS {
            let _ = decoder.decode_file(payload, None, 32, 24);
        }
    });
}

/// What is stored of a frame has its pixels and needs no repairs.
fn stored_file_is_whole(decoder: &mut Decoder, frame: &Frame, pixels: &[u8]) {
    let (file, _) = whole_file(&frame.data).expect("a file of a decoded frame");
    let (again, repairs) = whole_file(&file).expect("a file of a stored file");
    assert!(
        repairs.is_none() && *again == *file,
        "repaired twice: {repairs:?}"
    );
    let stored = decoder.stored_image(&file).expect("a stored file decodes");
    assert!(stored.as_raw() == pixels, "stored pixels differ");
}

/// What a JPEG's or PNG's header says; zero for others.
fn claimed_pixels(file: &[u8]) -> u32 {
    if let Ok(header) = gripcast_imaging::jpeg::inspect(file) {
        return header.width.saturating_mul(header.height);
    }
    let side = |at: usize| {
        let bytes = file.get(at..at + 4).and_then(|b| b.try_into().ok());
        bytes.map_or(0, u32::from_be_bytes)
    };
    side(16).saturating_mul(side(20))
}
