//! Decoding: golden values, damage, real tactile images.

use std::fs;

use gripcast_imaging::jpeg::{JpegScale, Subsampling, inspect};
use gripcast_imaging::{
    CropProfile, Decoder, Frame, FrameDamage, JpegDamage, JpegDecoder, PixelFormat,
    TactileDifference, check_structure, crop_and_resize, decode_png_rgb, encode_jpeg,
    encode_png_rgb, synthetic_gel,
};
use image::{Rgb, RgbImage};
use proptest::prelude::*;
use rand::{Rng, RngExt, SeedableRng};
use rand_pcg::Pcg64Mcg;

use gripcast_testing::shared;

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

fn mjpg(image: &RgbImage, quality: u8) -> Frame {
    let (width, height) = image.dimensions();
    let bytes = encode_jpeg(image, quality).unwrap();
    frame(PixelFormat::Mjpg, width, height, bytes)
}

/// Mean and maximum difference of two images, grey levels.
fn distance(a: &RgbImage, b: &RgbImage) -> (f64, u8) {
    assert_eq!(a.dimensions(), b.dimensions());
    let each = || {
        a.as_raw()
            .iter()
            .zip(b.as_raw())
            .map(|(a, b)| a.abs_diff(*b))
    };
    let sum: u64 = each().map(u64::from).sum();
    (
        sum as f64 / a.as_raw().len() as f64,
        each().max().unwrap_or(0),
    )
}

/// Removes the segments of a marker.
fn without_segments(jpeg: &[u8], marker: u8) -> Vec<u8> {
    let mut out = jpeg[..2].to_vec();
    let mut at = 2;
    while jpeg[at + 1] != 0xda {
        let length = 2 + usize::from(u16::from_be_bytes([jpeg[at + 2], jpeg[at + 3]]));
        if jpeg[at + 1] != marker {
            out.extend_from_slice(&jpeg[at..at + length]);
        }
        at += length;
    }
    out.extend_from_slice(&jpeg[at..]);
    out
}

/// First byte of the entropy-coded data.
fn scan_start(jpeg: &[u8]) -> usize {
    let header = jpeg.windows(2).position(|w| w == [0xff, 0xda]).unwrap();
    header + 2 + usize::from(u16::from_be_bytes([jpeg[header + 2], jpeg[header + 3]]))
}

/// A JPEG with optimised Huffman tables, optionally progressive.
fn unusual_jpeg(image: &RgbImage, progressive: bool) -> Vec<u8> {
    let mut compressor = turbojpeg::Compressor::new().unwrap();
    compressor.set_optimize(true).unwrap();
    compressor.set_progressive(progressive).unwrap();
    compressor.set_subsamp(turbojpeg::Subsamp::Sub2x2).unwrap();
    compressor
        .compress_to_vec(turbojpeg::Image {
            pixels: image.as_raw().as_slice(),
            width: image.width() as usize,
            pitch: image.width() as usize * 3,
            height: image.height() as usize,
            format: turbojpeg::PixelFormat::RGB,
        })
        .unwrap()
}

#[test]
fn channel_order_is_correct_in_all_formats() {
    let red = RgbImage::from_pixel(64, 48, Rgb([220, 40, 10]));
    let mut decoder = Decoder::new().unwrap();
    // BT.601, limited range, of (220, 40, 10).
    let (y, u, v) = (94, 88, 209);
    let yuyv = frame(PixelFormat::Yuyv, 64, 48, [y, u, y, v].repeat(64 * 48 / 2));
    for (name, frame) in [("MJPG", mjpg(&red, 95)), ("YUYV", yuyv)] {
        for image in [
            decoder.decode(&frame, None, 32, 24).unwrap(),
            decoder.decode_full(&frame).unwrap(),
        ] {
            let centre = image.get_pixel(image.width() / 2, image.height() / 2);
            for (found, expected) in centre.0.into_iter().zip([220u8, 40, 10]) {
                assert!(found.abs_diff(expected) <= 3, "{name}: {centre:?}");
            }
        }
    }
}

#[test]
fn header_is_parsed() {
    let gel = synthetic_gel(321, 243, 1, 0.0);
    let bytes = encode_jpeg(&gel, 80).unwrap();
    let header = inspect(&bytes).unwrap();
    assert_eq!((header.width, header.height), (321, 243));
    assert_eq!(header.subsampling, Subsampling::S422);
    assert_eq!((header.components, header.scans), (3, 1));
    assert_eq!((header.start, header.end), (0, bytes.len()));
    assert!(header.has_huffman_tables && !header.progressive);
    let progressive = inspect(&unusual_jpeg(&gel, true)).unwrap();
    assert!(progressive.progressive && progressive.scans > 1);
    assert_eq!(progressive.subsampling, Subsampling::S420);
}

#[test]
fn smallest_sufficient_scale_is_selected() {
    let target = (320, 240);
    for (profile, expected) in [
        (CropProfile::FULL, JpegScale::Eighth),
        (CropProfile::GSMINI_SEVENTH, JpegScale::Quarter),
        (CropProfile::GSMINI_FIFTEEN, JpegScale::Quarter),
    ] {
        let w = profile.window(3280, 2464).unwrap();
        let scale = JpegScale::smallest_for((w.width, w.height), target);
        assert_eq!(scale, expected, "{profile}");
    }
    assert_eq!(JpegScale::smallest_for((640, 480), target), JpegScale::Half);
    assert_eq!(
        JpegScale::smallest_for((639, 480), target),
        JpegScale::Whole
    );
}

#[test]
fn scaled_decoding_is_close_to_whole_decoding() {
    let gel = synthetic_gel(3280, 2464, 5, 0.8);
    let frame = mjpg(&gel, 90);
    let mut decoder = Decoder::new().unwrap();
    let whole = decoder.decode_full(&frame).unwrap();
    for profile in CropProfile::ALL {
        let expected = crop_and_resize(&whole, &profile, 320, 240).unwrap();
        let found = decoder.decode(&frame, Some(&profile), 320, 240).unwrap();
        let (mean, largest) = distance(&found, &expected);
        println!("{profile}: mean {mean:.3}, largest {largest}");
        assert!(mean < 0.25 && largest <= 4, "{profile}: {mean}, {largest}");
    }
}

#[test]
fn odd_sizes_and_enlargement() {
    let gel = synthetic_gel(333, 251, 5, 0.8);
    let frame = mjpg(&gel, 95);
    let mut decoder = Decoder::new().unwrap();
    let whole = decoder.decode_full(&frame).unwrap();
    assert!(distance(&whole, &gel).0 < 2.0);
    for (width, height) in [(1, 1), (41, 31), (80, 60), (333, 251), (500, 400)] {
        let expected = crop_and_resize(&whole, &CropProfile::FULL, width, height).unwrap();
        let found = decoder.decode(&frame, None, width, height).unwrap();
        let (mean, _) = distance(&found, &expected);
        assert!(mean < 1.0, "{width}×{height}: {mean}");
    }
}

#[test]
fn truncated_files_are_rejected() {
    let frame_bytes = encode_jpeg(&synthetic_gel(640, 480, 3, 0.5), 85).unwrap();
    let mut decoder = JpegDecoder::new().unwrap();
    let tenths = (1..10).map(|tenth| frame_bytes.len() * tenth / 10);
    for length in tenths.chain([1, 3, frame_bytes.len() - 4, frame_bytes.len() - 3]) {
        let cut = &frame_bytes[..length];
        let damage = inspect(cut).unwrap_err();
        assert!(matches!(damage, JpegDamage::Truncated { .. }), "{damage}");
        assert_eq!(decoder.decode(cut, JpegScale::Eighth).unwrap_err(), damage);
        // Also if a driver pads them.
        let mut padded = cut.to_vec();
        padded.resize(frame_bytes.len(), 0);
        assert!(decoder.verify(&padded).is_err(), "{length} bytes, padded");
    }
    assert!(decoder.decode(&frame_bytes, JpegScale::Eighth).is_ok());
}

#[test]
fn missing_and_overwritten_bytes_are_detected() {
    let mut random = Pcg64Mcg::seed_from_u64(7);
    let mut decoder = JpegDecoder::new().unwrap();
    let whole = encode_jpeg(&synthetic_gel(640, 480, 3, 0.5), 85).unwrap();
    let scan = scan_start(&whole);
    let (mut overwritten, mut lost) = (0, 0);
    for _ in 0..200 {
        let at = random.random_range(scan..whole.len() - 202);
        let mut bytes = whole.clone();
        random.fill_bytes(&mut bytes[at..at + 200]);
        overwritten += usize::from(decoder.verify(&bytes).is_err());
        let mut bytes = whole.clone();
        bytes.drain(at..at + 200);
        lost += usize::from(decoder.verify(&bytes).is_err());
    }
    println!("detected of 200: overwritten {overwritten}, lost {lost}");
    assert_eq!((overwritten, lost), (200, 200));
}

#[test]
fn padding_is_accepted() {
    let gel = synthetic_gel(160, 120, 3, 0.5);
    let clean = mjpg(&gel, 85);
    let mut decoder = Decoder::new().unwrap();
    let expected = decoder.decode_full(&clean).unwrap();
    let mut bytes = clean.data.to_vec();
    bytes.resize(bytes.len() + 3000, 0);
    let padded = frame(PixelFormat::Mjpg, 160, 120, bytes.clone());
    assert_eq!(decoder.decode_full(&padded).unwrap(), expected);
    bytes[clean.data.len() + 50] = 7;
    let padded = frame(PixelFormat::Mjpg, 160, 120, bytes);
    assert_eq!(decoder.decode_full(&padded).unwrap(), expected);
}

#[test]
fn missing_huffman_tables_are_supplied() {
    let gel = synthetic_gel(320, 240, 9, 0.6);
    let complete = mjpg(&gel, 85);
    let mut decoder = Decoder::new().unwrap();
    let expected = decoder.decode_full(&complete).unwrap();
    let bare = without_segments(&complete.data, 0xc4);
    assert!(bare.len() < complete.data.len());
    assert!(!inspect(&bare).unwrap().has_huffman_tables);
    let bare = frame(PixelFormat::Mjpg, 320, 240, bare);
    assert_eq!(
        Decoder::new().unwrap().decode_full(&bare).unwrap(),
        expected
    );
    // Not those of an earlier frame.
    let other = unusual_jpeg(&synthetic_gel(320, 240, 1, 0.0), false);
    decoder
        .decode_full(&frame(PixelFormat::Mjpg, 320, 240, other))
        .unwrap();
    assert_eq!(decoder.decode_full(&bare).unwrap(), expected);
}

#[test]
fn restart_markers_are_checked() {
    // Joins two images of one coding unit by a restart marker.
    let parts = [1, 2].map(|seed| encode_jpeg(&synthetic_gel(16, 8, seed, 0.5), 85).unwrap());
    let start = scan_start(&parts[0]);
    let scans = parts.each_ref().map(|part| &part[start..part.len() - 2]);
    let mut head = parts[0][..start].to_vec();
    let sof = head.windows(2).position(|w| w == [0xff, 0xc0]).unwrap();
    head[sof + 6] = 16;
    head.splice(2..2, [0xff, 0xdd, 0, 4, 0, 1]);
    let with_marker = |restart: &[u8]| {
        let joined = [&head[..], scans[0], restart, scans[1], &[0xff, 0xd9]].concat();
        frame(PixelFormat::Mjpg, 16, 16, joined)
    };
    let mut decoder = Decoder::new().unwrap();
    let joined = decoder.decode_full(&with_marker(&[0xff, 0xd0])).unwrap();
    for (part, rows) in parts.iter().zip(joined.as_raw().chunks(16 * 8 * 3)) {
        let alone = decoder
            .decode_full(&frame(PixelFormat::Mjpg, 16, 8, part.clone()))
            .unwrap();
        assert_eq!(alone.as_raw(), rows);
    }
    for (restart, expected) in [
        (&[0xff, 0xd3][..], "restart marker 3"),
        (&[], "compressed data is corrupt"),
    ] {
        let damage = decoder.verify(&with_marker(restart)).unwrap_err();
        assert!(damage.to_string().contains(expected), "{damage}");
    }
}

#[test]
fn stored_files_are_decoded_like_frames() {
    let gel = synthetic_gel(640, 480, 2, 0.4);
    let live = mjpg(&gel, 90);
    let crop = Some(&CropProfile::GSMINI_FIFTEEN);
    let mut decoder = Decoder::new().unwrap();
    assert_eq!(
        decoder.decode_file(&live.data, crop, 320, 240).unwrap(),
        decoder.decode(&live, crop, 320, 240).unwrap()
    );
    let png = encode_png_rgb(&gel).unwrap();
    assert_eq!(
        decoder.decode_file(&png, crop, 320, 240).unwrap(),
        crop_and_resize(&gel, &CropProfile::GSMINI_FIFTEEN, 320, 240).unwrap()
    );
    let text = decoder
        .decode_file(b"II*\0", crop, 8, 8)
        .unwrap_err()
        .to_string();
    assert!(text.contains("found a TIFF image"), "{text}");
}

#[test]
fn missing_quantisation_tables_are_rejected() {
    let complete = mjpg(&synthetic_gel(64, 48, 9, 0.6), 85);
    let mut decoder = JpegDecoder::new().unwrap();
    decoder.decode(&complete.data, JpegScale::Whole).unwrap();
    let bare = without_segments(&complete.data, 0xdb);
    let damage = decoder.decode(&bare, JpegScale::Whole).unwrap_err();
    assert!(
        damage.to_string().contains("quantisation table"),
        "{damage}"
    );
}

#[test]
fn decoder_recovers_from_damage() {
    let good = mjpg(&synthetic_gel(160, 120, 9, 0.6), 85);
    let mut bad = good.data.to_vec();
    let at = scan_start(&bad) + 40;
    bad[at..at + 100].fill(0xaa);
    let bad = frame(PixelFormat::Mjpg, 160, 120, bad);
    let mut decoder = Decoder::new().unwrap();
    let expected = decoder.decode_full(&good).unwrap();
    for _ in 0..3 {
        let damage = decoder.decode_full(&bad).unwrap_err();
        assert!(matches!(damage, FrameDamage::Jpeg(_)), "{damage}");
        assert!(check_structure(&bad).is_ok());
        assert!(decoder.verify(&bad).is_err());
        assert_eq!(decoder.decode_full(&good).unwrap(), expected);
    }
}

#[test]
fn invalid_frames_are_rejected() {
    let gel = synthetic_gel(64, 48, 1, 0.0);
    let jpeg = encode_jpeg(&gel, 80).unwrap();
    let mut restarts = jpeg.clone();
    let at = scan_start(&restarts) + 9;
    restarts.splice(at..at, [0xff, 0xd0]);
    let mut arithmetic = jpeg.clone();
    let sof = arithmetic
        .windows(2)
        .position(|w| w == [0xff, 0xc0])
        .unwrap();
    arithmetic[sof + 1] = 0xc9;
    let mut twelve_bit = jpeg.clone();
    twelve_bit[sof + 4] = 12;
    use PixelFormat::{Grey, Mjpg, Yuyv, Z16};
    for (format, width, height, data, expected) in [
        (Mjpg, 64, 48, vec![], "found no bytes"),
        (Mjpg, 64, 48, b"GIF89a".to_vec(), "found 47 49 46 38"),
        (
            Mjpg,
            64,
            48,
            vec![0xff, 0xd8],
            "found the end after 2 bytes",
        ),
        (
            Mjpg,
            64,
            48,
            vec![0xff, 0xd8, 0xff, 0xd9],
            "before its frame header",
        ),
        (
            Mjpg,
            640,
            480,
            jpeg,
            "expected a JPEG of 640×480 as configured, found 64×48",
        ),
        (Mjpg, 64, 48, restarts, "no restart interval"),
        (Mjpg, 64, 48, arithmetic, "frame type SOF9"),
        (Mjpg, 64, 48, twelve_bit, "12 bits per sample"),
        (Yuyv, 64, 48, vec![0; 6143], "has 6144 bytes, found 6143"),
        (Yuyv, 63, 48, vec![0; 6048], "an even width"),
        (Grey, 64, 48, vec![0; 9216], "has 3072 bytes, found 9216"),
        (Z16, 64, 48, vec![], "has 6144 bytes, found 0"),
        (Grey, 0, 48, vec![], "1 to 16384 pixels"),
        (Z16, u32::MAX, u32::MAX, vec![], "1 to 16384 pixels"),
    ] {
        let frame = frame(format, width, height, data);
        let text = check_structure(&frame).unwrap_err().to_string();
        assert!(text.contains(expected), "{text}");
        let error = Decoder::new().unwrap().decode(&frame, None, 8, 8);
        assert_eq!(error.unwrap_err().to_string(), text);
    }
    let good = mjpg(&gel, 80);
    let mut decoder = Decoder::new().unwrap();
    let text = decoder.depth(&good).unwrap_err().to_string();
    assert!(text.contains("found a MJPG frame"), "{text}");
    let text = decoder.decode(&good, None, 0, 8).unwrap_err().to_string();
    assert!(text.contains("0×8"), "{text}");
    let tiny = mjpg(&synthetic_gel(2, 2, 1, 0.0), 80);
    let text = decoder
        .decode(&tiny, Some(&CropProfile::GSMINI_SEVENTH), 8, 8)
        .unwrap_err()
        .to_string();
    assert!(text.contains("has no window in a 2×2 image"), "{text}");
}

#[test]
fn depth_is_decoded() {
    let mut data = Vec::new();
    for value in [0u16, 100, 1500, 800] {
        data.extend_from_slice(&value.to_le_bytes());
    }
    let frame = frame(PixelFormat::Z16, 2, 2, data);
    let mut decoder = Decoder::new().unwrap();
    let depth = decoder.depth(&frame).unwrap();
    assert_eq!(depth.get_pixel(1, 0).0, [100]);
    assert_eq!(depth.as_raw(), &[0, 100, 1500, 800]);
    let shown = decoder.decode(&frame, None, 4, 4).unwrap();
    let [r, g, b] = shown.get_pixel(1, 1).0;
    assert!(r == g && g == b, "no depth is grey, found {r} {g} {b}");
    let (near, far) = (shown.get_pixel(3, 0).0, shown.get_pixel(0, 3).0);
    assert!(
        near[2] > near[0] && far[0] > far[2],
        "near {near:?}, far {far:?}"
    );
    assert_eq!(shown.get_pixel(3, 3).0, far, "beyond the working range");
    assert_eq!(decoder.decode_full(&frame).unwrap().get_pixel(1, 0).0, near);
    assert_eq!(decoder.depth_preview(&frame, 0.001, 4, 4).unwrap(), shown);
    // In units of 10 mm, 100 counts are beyond the range.
    let coarse = decoder.depth_preview(&frame, 0.01, 4, 4).unwrap();
    assert_eq!(coarse.get_pixel(3, 0).0, far);
    let colour = self::frame(PixelFormat::Rgb, 2, 2, vec![0; 12]);
    assert!(decoder.depth_preview(&colour, 0.001, 4, 4).is_err());
}

#[test]
fn decoder_is_send() {
    fn movable<T: Send + 'static>(_: &T) {}
    movable(&Decoder::new().unwrap());
}

#[test]
fn grey_frames_are_decoded() {
    let frame = frame(PixelFormat::Grey, 4, 2, vec![0, 50, 100, 255, 1, 2, 3, 4]);
    let image = Decoder::new().unwrap().decode_full(&frame).unwrap();
    assert_eq!(image.get_pixel(1, 0).0, [50; 3]);
    assert_eq!(image.get_pixel(3, 1).0, [4; 3]);
}

#[test]
fn real_contact_exceeds_the_noise() {
    let Some(folder) = shared("data/gsmini_taxim_ball") else {
        return;
    };
    let load = |name: &str| decode_png_rgb(&fs::read(folder.join(name)).unwrap()).unwrap();
    let free = load("nocontact.png");
    let means: Vec<u64> = (0..3)
        .map(|c| free.pixels().map(|p| u64::from(p.0[c])).sum::<u64>() / (640 * 480))
        .collect();
    assert!(
        means[0] < means[1] && means[1] < means[2],
        "not RGB: {means:?}"
    );

    let profile = CropProfile::GSMINI_SEVENTH;
    let model_view = |image: &RgbImage| {
        let frame = mjpg(image, 92);
        Decoder::new()
            .unwrap()
            .decode(&frame, Some(&profile), 320, 240)
            .unwrap()
    };
    let reference = model_view(&free);
    // The data set has one image without contact; the noise is measured in a corner outside the
    // contact.
    for press in 0..24 {
        let pressed = model_view(&load(&format!("ball_{press:02}.png")));
        let strength = |x: u32, y: u32, width: u32, height: u32| {
            let part = |p: &RgbImage| image::imageops::crop_imm(p, x, y, width, height).to_image();
            TactileDifference::between(&part(&reference), &part(&pressed))
                .unwrap()
                .mean_abs()
        };
        let contact = strength(130, 80, 80, 80);
        let noise = strength(0, 180, 80, 60);
        println!("ball {press}: contact {contact:.1}, noise {noise:.2}");
        assert!(
            contact > 4.0 * noise,
            "ball {press}: contact {contact}, noise {noise}"
        );
        assert!(noise < 2.0, "ball {press}: noise {noise}");
        let all = strength(0, 0, 320, 240);
        assert!(
            all > noise,
            "ball {press}: whole image {all}, noise {noise}"
        );
    }
}

proptest! {
    #![proptest_config(ProptestConfig {
        cases: 200,
        failure_persistence: None,
        ..ProptestConfig::default()
    })]

    #[test]
    fn decoder_does_not_panic(
        format in prop::sample::select(vec![
            PixelFormat::Mjpg,
            PixelFormat::Yuyv,
            PixelFormat::Z16,
            PixelFormat::Grey,
            PixelFormat::Rgb,
        ]),
        width in prop_oneof![0u32..40, any::<u32>()],
        height in prop_oneof![0u32..40, any::<u32>()],
        bytes in prop::collection::vec(any::<u8>(), 0..3000),
        exact in any::<bool>(),
    ) {
        let mut bytes = bytes;
        if exact && width < 40 && height < 40 {
            bytes.resize(format.frame_bytes(width, height).unwrap_or(bytes.len()), 3);
        }
        let frame = frame(format, width, height, bytes);
        let mut decoder = Decoder::new().unwrap();
        let sound = check_structure(&frame).is_ok();
        prop_assert_eq!(decoder.verify(&frame).is_ok(), sound);
        prop_assert_eq!(decoder.decode_full(&frame).is_ok(), sound);
        let _ = decoder.decode(&frame, Some(&CropProfile::GSMINI_GS_SDK), 16, 12);
        let _ = decoder.depth(&frame);
    }

    #[test]
    fn verify_and_decode_agree(
        changes in prop::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 1..6),
        progressive in any::<bool>(),
    ) {
        let gel = synthetic_gel(48, 40, 4, 0.5);
        let mut bytes = if progressive {
            unusual_jpeg(&gel, true)
        } else {
            encode_jpeg(&gel, 80).unwrap()
        };
        for (index, value) in changes {
            let at = index.index(bytes.len());
            bytes[at] = value;
        }
        let frame = frame(PixelFormat::Mjpg, 48, 40, bytes);
        let mut decoder = Decoder::new().unwrap();
        let verdict = decoder.verify(&frame);
        prop_assert_eq!(decoder.decode_full(&frame).is_ok(), verdict.is_ok());
        prop_assert_eq!(decoder.decode(&frame, None, 12, 10).is_ok(), verdict.is_ok());
    }
}
