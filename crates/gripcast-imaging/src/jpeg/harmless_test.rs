//! What is harmless is used, what is damaged is refused.

use std::time::{Duration, Instant};

use gripcast_testing::jpeg::{damaged_frames, harmless_frames, scan_start, with_restart_markers};
use rand::{Rng as _, RngExt as _, SeedableRng as _};
use rand_pcg::Pcg64Mcg;

use super::*;
use crate::synthetic_gel;

/// A frame, the same with restart markers, and the frame before.
fn frames() -> [Vec<u8>; 3] {
    let encode = |image: &image::RgbImage| encode_jpeg(image, 85).unwrap();
    let gel = synthetic_gel(640, 480, 3, 0.5);
    let previous = encode(&synthetic_gel(640, 480, 4, 0.2));
    [encode(&gel), with_restart_markers(&gel, encode), previous]
}

fn pixels(jpeg: &[u8]) -> Result<Vec<u8>, JpegDamage> {
    let mut decoder = JpegDecoder::new().unwrap();
    let decoded = decoder.decode(jpeg, JpegScale::Whole)?;
    Ok(decoded.rgb.to_vec())
}

#[test]
fn harmless_bytes_change_no_pixel_and_stay_out_of_the_file() {
    let [plain, restarts, previous] = frames();
    let expected = [pixels(&plain).unwrap(), pixels(&restarts).unwrap()];
    for (name, sent) in harmless_frames(&plain, &restarts, &previous) {
        let found = pixels(&sent).unwrap_or_else(|damage| panic!("{name}: {damage}"));
        assert!(expected.contains(&found), "{name}: other pixels");
        let (file, repairs) = whole_file(&sent).unwrap();
        let is_changed = *file != sent;
        assert_eq!(is_changed, repairs.is_some(), "{name}: {repairs:?}");
        // As strict as libjpeg gets, on the file alone.
        let strict = turbojpeg::decompress(&file, turbojpeg::PixelFormat::RGB);
        let strict = strict.unwrap_or_else(|error| panic!("{name}: {error}"));
        assert!(strict.pixels == found, "{name}: other pixels in the file");
        assert!(
            file.starts_with(&[0xff, 0xd8]) && file.ends_with(&[0xff, 0xd9]),
            "{name}"
        );
        assert_eq!(whole_file(&file).unwrap().1, None, "{name}");
    }
}

#[test]
fn one_decoder_takes_clean_stray_and_damaged_frames_in_turn() {
    let [plain, restarts, previous] = frames();
    let expected = [pixels(&plain).unwrap(), pixels(&restarts).unwrap()];
    let mut decoder = JpegDecoder::new().unwrap();
    let damaged = damaged_frames(&plain, &restarts);
    for ((name, sent), (_, damaged)) in harmless_frames(&plain, &restarts, &previous)
        .into_iter()
        .zip(damaged.iter().cycle())
    {
        for _ in 0..2 {
            let found = decoder
                .decode(&sent, JpegScale::Whole)
                .map(|p| p.rgb.to_vec());
            assert!(expected.contains(&found.unwrap()), "{name}");
        }
        assert!(decoder.verify(damaged).is_err());
    }
}

#[test]
fn damaged_frames_are_refused() {
    let [plain, restarts, _] = frames();
    for (name, sent) in damaged_frames(&plain, &restarts) {
        let damage = pixels(&sent)
            .err()
            .unwrap_or_else(|| panic!("{name} is accepted"));
        println!("{name}: {damage}");
        assert!(JpegDecoder::new().unwrap().verify(&sent).is_err(), "{name}");
    }
}

#[test]
fn recorded_field_inputs_are_judged_by_their_images() {
    for (folder, damaged) in [
        ("jpeg-tail", 0),
        ("jpeg-tail-previous-frame", 0),
        ("jpeg-bytes-before-restart-markers", 0),
        ("jpeg-garbage-before-start", 0),
        ("jpeg-without-end-marker", 0),
        ("jpeg-87-percent-truncated", 7),
    ] {
        let Some(path) = gripcast_testing::shared(&format!("field/capture-web/{folder}/left"))
        else {
            return;
        };
        let mut decoder = JpegDecoder::new().unwrap();
        let mut found = 0;
        for number in 0..8 {
            let bytes = std::fs::read(path.join(format!("{number:06}.jpg"))).unwrap();
            match decoder.verify(&bytes) {
                Ok(_) => assert_eq!(whole_file(&whole_file(&bytes).unwrap().0).unwrap().1, None),
                Err(damage) => {
                    println!("{folder} {number}: {damage}");
                    found += 1;
                }
            }
        }
        assert_eq!(found, damaged, "{folder}");
    }
}

/// Tolerance of stray bytes and missing markers hardly ever accepts other pixels than strict
/// decoding. JPEG has no checksum: libjpeg decodes some damaged frames without a warning, and
/// damage in the last bytes can look like whole data with stray bytes behind it. Seeds as many as
/// fit into `GRIPCAST_FUZZ_SECONDS` seconds, else 300.
#[test]
fn tolerance_accepts_changed_pixels_in_less_than_one_of_5000_damaged_frames() {
    let [plain, restarts, _] = frames();
    let seconds = std::env::var("GRIPCAST_FUZZ_SECONDS").ok();
    let seconds: Option<u64> = seconds.map(|text| text.parse().unwrap());
    for (name, whole) in [("plain", plain), ("with restart markers", restarts)] {
        let expected = pixels(&whole).unwrap();
        let scan = scan_start(&whole);
        let (mut cases, mut accepted, mut undetectable, mut tolerated) = (0, 0, 0, 0);
        let start = Instant::now();
        while match seconds {
            Some(seconds) => start.elapsed() < Duration::from_secs(seconds),
            None => cases < 300,
        } {
            let seed = cases;
            cases += 1;
            let mut random = Pcg64Mcg::seed_from_u64(seed);
            let at = random.random_range(scan..whole.len() - 2);
            let length = [1, 2, 3, 8, 50, 200][random.random_range(0..6)].min(whole.len() - at);
            let mut bytes = whole.clone();
            match seed % 4 {
                0 => bytes.truncate(at),
                1 => drop(bytes.drain(at..at + length)),
                2 => random.fill_bytes(&mut bytes[at..at + length]),
                _ => bytes[at..].fill(0),
            }
            let Ok(found) = pixels(&bytes) else { continue };
            accepted += 1;
            if found == expected {
                continue;
            }
            let strict = turbojpeg::decompress(&bytes, turbojpeg::PixelFormat::RGB);
            match strict {
                Ok(_) => undetectable += 1,
                Err(error) => {
                    println!("{name}, seed {seed}: {length} bytes at {at}: {error}");
                    tolerated += 1;
                }
            }
        }
        println!(
            "{name}: of {cases}, {accepted} accepted; with other pixels {undetectable} that libjpeg \
             accepts, {tolerated} that it does not"
        );
        assert!(tolerated * 5000 <= cases, "{name}: {tolerated} of {cases}");
    }
}
