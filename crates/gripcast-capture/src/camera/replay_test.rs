use gripcast_base::error::ErrorKind;
use std::io::Write;

use super::*;
use crate::calibration::SourceKind;
use crate::camera::{ManualClock, Recorder};

const MS: u64 = 1_000_000;
const TIMEOUT: Duration = Duration::from_millis(100);

fn config(dir: &Path, format: PixelFormat, width: u32, height: u32) -> CameraConfig {
    CameraConfig {
        path: Some(dir.to_owned()),
        ..CameraConfig::new(SourceKind::Replay, format, width, height, 25.0)
    }
}

fn opener(dir: &Path, format: PixelFormat) -> (ReplayOpener, Arc<ManualClock>) {
    opener_of(config(dir, format, 2, 1))
}

fn opener_of(config: CameraConfig) -> (ReplayOpener, Arc<ManualClock>) {
    let clock = Arc::new(ManualClock::new(1_000 * MS));
    let opener = ReplayOpener::new(Role::Left, &config, clock.clone()).unwrap();
    (opener, clock)
}

/// Three GREY frames at 0, 40 and 95 ms with sequences 7, 8 and 10.
fn record(dir: &Path) {
    let info = StreamInfo {
        identity: CameraIdentity {
            product: "GelSight Mini".to_owned(),
            serial: "2BNN4ZE7".to_owned(),
            ..CameraIdentity::default()
        },
        format: PixelFormat::Grey,
        width: 2,
        height: 1,
        nominal_fps: 25.0,
        depth_unit_m: None,
    };
    let mut recorder = Recorder::create(dir, Role::Left, &info).unwrap();
    for (sequence, at_ms) in [(7, 500), (8, 540), (10, 595)] {
        recorder
            .write(&Frame {
                format: PixelFormat::Grey,
                width: 2,
                height: 1,
                data: vec![sequence as u8, 1].into(),
                sequence,
                driver_time_ns: at_ms * MS,
                received_ns: 0,
            })
            .unwrap();
    }
    recorder.finish().unwrap();
}

fn read_all(source: &mut ReplaySource) -> Vec<(u32, u64, u8)> {
    let mut frames = Vec::new();
    while let Ok(frame) = source.next_frame(TIMEOUT) {
        frames.push((frame.sequence, frame.driver_time_ns / MS, frame.data[0]));
    }
    frames
}

#[test]
fn recording_is_replayed_with_its_timing() {
    let dir = tempfile::tempdir().unwrap();
    record(dir.path());
    let (opener, _) = opener(dir.path(), PixelFormat::Grey);
    let (mut source, warnings) = opener.load().unwrap();
    assert!(warnings.is_empty());
    assert_eq!(source.info().identity.serial, "2BNN4ZE7");
    assert_eq!(
        read_all(&mut source),
        [(7, 1000, 7), (8, 1040, 8), (10, 1095, 10)]
    );
    let end = source.next_frame(TIMEOUT);
    assert!(matches!(end, Err(CaptureError::Ended)));
}

#[test]
fn unpaced_recording_does_not_wait() {
    let dir = tempfile::tempdir().unwrap();
    record(dir.path());
    let (opener, clock) = opener_of(CameraConfig {
        unpaced: true,
        ..config(dir.path(), PixelFormat::Grey, 2, 1)
    });
    let (mut source, _) = opener.load().unwrap();
    assert_eq!(read_all(&mut source).len(), 3);
    assert_eq!(clock.now_ns(), 1_000 * MS);
}

#[test]
fn incomplete_last_line_is_skipped_with_a_warning() {
    let dir = tempfile::tempdir().unwrap();
    record(dir.path());
    let index = dir.path().join("left").join(FRAMES_FILE);
    let mut file = fs::OpenOptions::new().append(true).open(&index).unwrap();
    file.write_all(b"{\"file\":\"0000").unwrap();
    let (opener, _) = opener(dir.path(), PixelFormat::Grey);
    let (source, warnings) = opener.load().unwrap();
    assert_eq!(source.frames.len(), 3);
    assert!(warnings[0].starts_with("frames.jsonl:4: skipped the incomplete last line"));

    let text = fs::read_to_string(&index).unwrap();
    fs::write(&index, format!("rubbish\n{text}")).unwrap();
    let error = opener.load().err().unwrap();
    assert!(
        error
            .to_string()
            .contains("frames.jsonl:1: invalid frame: `rubbish`")
    );
}

#[test]
fn short_and_missing_payloads_are_damaged_frames() {
    let dir = tempfile::tempdir().unwrap();
    record(dir.path());
    fs::write(dir.path().join("left/000001.grey"), [1]).unwrap();
    fs::remove_file(dir.path().join("left/000002.grey")).unwrap();
    let (opener, _) = opener(dir.path(), PixelFormat::Grey);
    let (mut source, _) = opener.load().unwrap();
    assert!(source.next_frame(TIMEOUT).is_ok());
    for expected in [8, 10] {
        match source.next_frame(TIMEOUT) {
            Err(CaptureError::Damaged { sequence, .. }) => assert_eq!(sequence, expected),
            other => panic!("expected damage, got {other:?}"),
        }
    }
}

#[test]
fn invalid_directories_are_rejected() {
    let dir = tempfile::tempdir().unwrap();
    let fail = |dir: &Path, format| opener(dir, format).0.load().err().unwrap();
    let missing = fail(&dir.path().join("absent"), PixelFormat::Mjpg);
    assert_eq!(missing.kind(), ErrorKind::NotFound);
    let empty = fail(dir.path(), PixelFormat::Mjpg);
    assert_eq!(empty.kind(), ErrorKind::Input);
    assert!(
        empty.to_string().contains("neither stream.json nor"),
        "{empty}"
    );
    record(dir.path());
    let other = fail(dir.path(), PixelFormat::Yuyv);
    assert!(
        other
            .to_string()
            .contains("the recording is GREY 2×1, expected YUYV 2×1"),
        "{other}"
    );
    let index = dir.path().join("left").join(FRAMES_FILE);
    let outside = r#"{"file":"../../passwd","sequence":0,"driver_time_ns":0}"#;
    fs::write(index, outside).unwrap();
    let escape = fail(dir.path(), PixelFormat::Grey);
    assert!(escape.to_string().contains("invalid file name"), "{escape}");
}

#[test]
fn images_are_played_in_the_order_of_their_names() {
    let dir = tempfile::tempdir().unwrap();
    for (name, level) in [("b.png", 200), ("a.png", 40)] {
        image::RgbImage::from_pixel(16, 8, image::Rgb([level; 3]))
            .save(dir.path().join(name))
            .unwrap();
    }
    fs::write(dir.path().join("notes.txt"), "not an image").unwrap();
    let clock = Arc::new(ManualClock::default());
    let config = config(dir.path(), PixelFormat::Mjpg, 16, 8);
    let opener = ReplayOpener::new(Role::Left, &config, clock.clone()).unwrap();
    let (mut source, _) = opener.load().unwrap();
    let levels: Vec<_> = (0..2)
        .map(|_| source.next_frame(TIMEOUT).unwrap())
        .map(|frame| {
            let image = turbojpeg::decompress(&frame.data, turbojpeg::PixelFormat::RGB).unwrap();
            (frame.driver_time_ns / MS, image.pixels[0])
        })
        .collect();
    assert_eq!(levels, [(0, 40), (40, 200)]);

    image::RgbImage::new(16, 9)
        .save(dir.path().join("c.png"))
        .unwrap();
    let error = opener.load().err().unwrap();
    assert!(
        error
            .to_string()
            .contains("c.png: expected an image of 16×8, found 16×9"),
        "{error}"
    );
    fs::write(dir.path().join("0.jpg"), "no").unwrap();
    let error = opener.load().err().unwrap();
    assert!(error.to_string().contains("0.jpg: invalid JPEG"), "{error}");
}
