//! Tests of reading logs, among them cut, damaged and foreign ones.

use std::collections::BTreeSet;
use std::fs;
use std::path::Path;

use super::sample_log::{PER_CHUNK, SampleEntry, write_log};
use super::{BlackBoxLog, LoggedMessage};
use gripcast_base::error::{ErrorKind, Result};
use gripcast_base::files::Root;
use gripcast_dataset::sample::jpeg;
use gripcast_imaging::{Frame, PixelFormat, Role};

const OFFSET: i128 = 1_795_000_000_000_000_000;
const FILE: &str = "2026-11-20T10-15-03Z-00001.mcap";

fn frame(format: PixelFormat, number: u32) -> Frame {
    let data = match format {
        PixelFormat::Mjpg => jpeg(16, 8, number as u8),
        _ => (0..256).map(|i| (i as u32 * number) as u8).collect(),
    };
    Frame {
        format,
        width: 16,
        height: 8,
        data: data.into(),
        sequence: number,
        driver_time_ns: 40_000_000 * u64::from(number),
        received_ns: 40_000_000 * u64::from(number),
    }
}

/// Left, depth and shear of frames `numbers`.
fn entries(numbers: std::ops::Range<u32>) -> Vec<SampleEntry> {
    let of_number = |number: u32| {
        let left = frame(PixelFormat::Mjpg, number);
        let time_ns = left.driver_time_ns;
        let shear = serde_json::json!({
            "role": "left", "frame_time_ns": time_ns, "summary": null, "problems": [],
            "force": null, "markers": {"shape": [1, 1, 5], "values": [1.5, 2, null, 0, number]},
        });
        [
            SampleEntry::Frame(Role::Left, left),
            SampleEntry::Frame(Role::Depth, frame(PixelFormat::Z16, number)),
            SampleEntry::Shear(time_ns, shear),
        ]
    };
    numbers.flat_map(of_number).collect()
}

fn open(directory: &Path) -> Result<BlackBoxLog> {
    BlackBoxLog::open(&Root::new(directory).top())
}

/// All messages of a log, as text.
fn messages(log: &BlackBoxLog) -> Result<Vec<String>> {
    let mut chunks: BTreeSet<usize> = BTreeSet::new();
    for collection in log.collections() {
        chunks.extend(collection.frames.values().flat_map(|f| f.values()));
        chunks.extend(collection.shear.values());
    }
    let mut found = Vec::new();
    log.read(&chunks, |message| {
        found.push(match message {
            LoggedMessage::Frame(message) => {
                let decoded = message.frame()?;
                let format = decoded.format;
                let expected = frame(format, decoded.sequence);
                // Metadata, with the clock, have no checksum.
                let decoded = Frame {
                    driver_time_ns: expected.driver_time_ns,
                    received_ns: expected.received_ns,
                    ..decoded
                };
                assert_eq!(decoded, expected);
                format!("{} {}", message.role, decoded.sequence)
            }
            LoggedMessage::Shear(shear) => {
                let markers = shear.markers.unwrap();
                assert_eq!(markers.values[..3], [Some(1.5), Some(2.0), None]);
                format!("shear {}", markers.values[4].unwrap())
            }
        });
        Ok(())
    })?;
    Ok(found)
}

fn expected(numbers: std::ops::Range<u32>) -> Vec<String> {
    let of_number = |n: u32| {
        [
            format!("left {n}"),
            format!("depth {n}"),
            format!("shear {n}"),
        ]
    };
    numbers.flat_map(of_number).collect()
}

#[test]
fn files_of_a_collection_are_one_and_times_are_those_of_the_driver() {
    let dir = tempfile::tempdir().unwrap();
    write_log(&dir.path().join(FILE), Some(OFFSET), &entries(1..8));
    let second = FILE.replace("00001", "00002");
    write_log(&dir.path().join(second), Some(OFFSET), &entries(8..11));
    let later = dir.path().join("2026-11-21T10-15-03Z-00001.partial.mcap");
    write_log(&later, Some(OFFSET + 7), &entries(3..5));
    // A copy of the first file, as `mcap recover` makes it.
    write_log(
        &dir.path().join("recovered.mcap"),
        Some(OFFSET),
        &entries(1..8),
    );
    fs::write(dir.path().join("notes.txt"), "not a log").unwrap();
    let log = open(dir.path()).unwrap();
    assert_eq!(log.notes(), [] as [String; 0]);
    let [first, other] = log.collections() else {
        panic!("{:?}", log.collections());
    };
    let times: Vec<u64> = (1..11).map(|n| n * 40_000_000).collect();
    assert!(first.frames[&Role::Left].keys().eq(&times));
    assert_eq!(first.shear.len(), 10);
    assert_eq!(other.clock_offset_ns, OFFSET + 7);
    let all = [expected(1..11), expected(3..5)].concat();
    assert_eq!(messages(&log).unwrap(), all);
}

#[test]
fn cut_file_is_read_as_far_as_it_goes() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join(FILE.replace(".mcap", ".partial.mcap"));
    write_log(&path, Some(OFFSET), &entries(1..9));
    let whole = fs::read(&path).unwrap();
    let all = expected(1..9);
    let (mut least, mut most) = (usize::MAX, 0);
    for cut in (0..whole.len()).step_by(61) {
        fs::write(&path, &whole[..cut]).unwrap();
        let log = open(dir.path()).unwrap();
        let found = messages(&log).unwrap();
        assert_eq!(found.len() % PER_CHUNK, 0);
        assert_eq!(found, all[..found.len()], "cut at {cut}");
        if found.len() < all.len() {
            let [note] = log.notes() else {
                panic!("cut at {cut}: {:?}", log.notes());
            };
            let is_named = note.starts_with("2026-11-20T10-15-03Z-00001.partial.mcap");
            assert!(is_named, "{note}");
        }
        least = least.min(found.len());
        most = most.max(found.len());
    }
    assert_eq!((least, most), (0, all.len()));
}

/// Whatever is in a file, it is an error or read in part.
#[test]
fn damaged_file_never_yields_a_wrong_frame() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join(FILE);
    write_log(&path, Some(OFFSET), &entries(1..5));
    let whole = fs::read(&path).unwrap();
    let (mut noted, mut refused) = (0, 0);
    for at in (0..whole.len()).step_by(7) {
        for damage in [0x01, 0x80, 0xff] {
            let mut bytes = whole.clone();
            bytes[at] ^= damage;
            fs::write(&path, &bytes).unwrap();
            match open(dir.path()) {
                Ok(log) => {
                    // `messages` compares each frame with what was written.
                    let found = messages(&log).unwrap();
                    assert!(found.iter().all(|m| expected(1..5).contains(m)), "{at}");
                    noted += usize::from(!log.notes().is_empty());
                }
                Err(error) => {
                    assert_eq!(error.kind(), ErrorKind::Input, "{at}: {error}");
                    assert!(error.remedy_text().is_some(), "{at}: {error}");
                    refused += 1;
                }
            }
        }
    }
    assert!(noted > 0 && refused > 0, "{noted} {refused}");
}

#[test]
fn files_of_others_are_named() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join(FILE);
    let refused = |bytes: &[u8]| {
        fs::write(&path, bytes).unwrap();
        open(dir.path()).unwrap_err()
    };
    let error = refused(b"a text that is no log at all");
    assert!(error.what().contains("expected an MCAP file"), "{error}");
    assert!(error.location().unwrap().ends_with(FILE), "{error}");

    write_log(&path, None, &entries(1..5));
    let error = open(dir.path()).unwrap_err();
    assert!(
        error.what().contains("no metadata `gripcast.black_box`"),
        "{error}"
    );

    // An offset that no clock has.
    write_log(&path, Some(i128::MIN), &[]);
    let error = open(dir.path()).unwrap_err();
    assert!(error.what().contains("no metadata"), "{error}");

    // A chunk compressed with Zstandard, as other programs write them.
    let chunk = [
        &[0; 8][..],
        &[0; 8],
        &4_u64.to_le_bytes(),
        &0_u32.to_le_bytes(),
        &4_u32.to_le_bytes(),
        b"zstd",
        &4_u64.to_le_bytes(),
        &[1, 2, 3, 4],
    ]
    .concat();
    let head = [&[6][..], &(chunk.len() as u64).to_le_bytes()].concat();
    let error = refused(&[mcap::MAGIC, &head, &chunk].concat());
    assert!(error.what().contains("compressed with zstd"), "{error}");
    assert!(error.remedy_text().unwrap().contains("mcap decompress"));

    // The length of a record that no file has.
    let log = {
        let head = [&[1][..], &u64::MAX.to_le_bytes()].concat();
        fs::write(&path, [mcap::MAGIC, &head].concat()).unwrap();
        open(dir.path()).unwrap()
    };
    assert!(
        log.notes()[0].contains("damaged after 0 frames"),
        "{:?}",
        log.notes()
    );
}

#[test]
fn missing_log_is_not_found() {
    let dir = tempfile::tempdir().unwrap();
    for directory in [dir.path().join("blackbox"), dir.path().to_owned()] {
        let error = open(&directory).unwrap_err();
        assert_eq!(error.kind(), ErrorKind::NotFound);
        assert!(error.remedy_text().unwrap().contains("--black-box"));
    }
}
