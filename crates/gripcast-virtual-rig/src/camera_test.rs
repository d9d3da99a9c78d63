use std::collections::BTreeMap;
use std::fs;
use std::sync::Arc;
use std::time::Duration;

use super::camera::{VirtualRig, yuyv_bytes};
use super::{ClipLibrary, HandTarget};
use gripcast_base::error::ErrorKind;
use gripcast_capture::calibration::{CameraConfig, SourceKind};
use gripcast_capture::camera::{CameraOpener as _, CaptureError, Clock as _, ManualClock};
use gripcast_imaging::{PixelFormat, Role};

const MS: u64 = 1_000_000;
const TIMEOUT: Duration = Duration::from_millis(100);

fn config(format: PixelFormat, width: u32, height: u32, fps: f64) -> CameraConfig {
    CameraConfig {
        controls: BTreeMap::from([("gain".to_owned(), 7)]),
        ..CameraConfig::new(SourceKind::Virtual, format, width, height, fps)
    }
}

fn rig() -> (VirtualRig, Arc<ManualClock>) {
    let clock = Arc::new(ManualClock::new(1_000 * MS));
    let clips = ClipLibrary::built_in().unwrap();
    (VirtualRig::new(clips, 1, clock.clone()), clock)
}

#[test]
fn every_role_delivers_its_format() {
    let (rig, _) = rig();
    for (role, format, width, height) in [
        (Role::Left, PixelFormat::Mjpg, 640, 480),
        (Role::Right, PixelFormat::Mjpg, 3280, 2464),
        (Role::Rgb, PixelFormat::Yuyv, 1280, 720),
        (Role::Depth, PixelFormat::Z16, 848, 480),
        (Role::External, PixelFormat::Grey, 320, 240),
    ] {
        let mut opener = rig
            .camera(role, &config(format, width, height, 30.0))
            .unwrap();
        let mut camera = opener.open().unwrap();
        let frame = camera.next_frame(TIMEOUT).unwrap();
        assert_eq!(
            (frame.format, frame.width, frame.height),
            (format, width, height)
        );
        match format.frame_bytes(width, height) {
            Some(bytes) => assert_eq!(frame.data.len(), bytes, "{role}"),
            None => {
                let header = turbojpeg::read_header(&frame.data).unwrap();
                let size = (header.width, header.height);
                assert_eq!(size, (width as usize, height as usize));
            }
        }
    }
}

#[test]
fn camera_is_disconnected_while_the_file_lists_its_role() {
    let (rig, _) = rig();
    let file = tempfile::NamedTempFile::new().unwrap();
    let rig = rig.with_unplugged(file.path().to_owned());
    let config = config(PixelFormat::Mjpg, 160, 120, 25.0);
    let mut left = rig.camera(Role::Left, &config).unwrap();
    let mut right = rig.camera(Role::Right, &config).unwrap();
    let (mut seen, mut other) = (left.open().unwrap(), right.open().unwrap());
    assert!(seen.next_frame(TIMEOUT).is_ok());
    fs::write(file.path(), "depth left\n").unwrap();
    assert!(matches!(seen.next_frame(TIMEOUT), Err(CaptureError::Gone)));
    assert!(other.next_frame(TIMEOUT).is_ok());
    assert_eq!(left.open().err().unwrap().kind(), ErrorKind::Device);
    fs::write(file.path(), "").unwrap();
    assert!(left.open().unwrap().next_frame(TIMEOUT).is_ok());
}

#[test]
fn frames_are_paced_and_late_reader_sees_a_gap() {
    let (rig, clock) = rig();
    let config = config(PixelFormat::Mjpg, 160, 120, 25.0);
    let mut camera = rig.camera(Role::Left, &config).unwrap().open().unwrap();
    for number in 0..5 {
        let frame = camera.next_frame(TIMEOUT).unwrap();
        assert_eq!(frame.sequence, number);
        assert_eq!(
            frame.driver_time_ns,
            (1_000 + 40 * (u64::from(number) + 1)) * MS
        );
        assert_eq!(frame.received_ns, frame.driver_time_ns);
    }
    // 40 ms · 20 later the oldest of four buffers is frame 25 − 4.
    clock.advance(800 * MS);
    let frame = camera.next_frame(TIMEOUT).unwrap();
    assert_eq!(frame.sequence, 21);
    assert_eq!(frame.driver_time_ns, (1_000 + 22 * 40) * MS);
    assert_eq!(camera.next_frame(TIMEOUT).unwrap().sequence, 22);
}

#[test]
fn slow_camera_times_out_without_losing_its_frame() {
    let (rig, clock) = rig();
    let config = config(PixelFormat::Grey, 160, 120, 5.0);
    let mut camera = rig.camera(Role::Rgb, &config).unwrap().open().unwrap();
    let first = camera.next_frame(TIMEOUT);
    assert!(matches!(first, Err(CaptureError::Timeout)));
    assert_eq!(clock.now_ns(), 1_100 * MS);
    assert_eq!(camera.next_frame(TIMEOUT).unwrap().sequence, 0);
    assert_eq!(clock.now_ns(), 1_200 * MS);
}

#[test]
fn images_are_reproducible() {
    let image = || {
        let (rig, _) = rig();
        rig.hand().move_to(HandTarget::Closed);
        let config = config(PixelFormat::Mjpg, 320, 240, 1.0);
        let mut camera = rig.camera(Role::Left, &config).unwrap().open().unwrap();
        camera.next_frame(Duration::from_secs(2)).unwrap().data
    };
    assert_eq!(image(), image());
}

#[test]
fn identity_and_controls_are_readable() {
    let (rig, _) = rig();
    let config = config(PixelFormat::Mjpg, 320, 240, 25.0);
    let mut opener = rig.camera(Role::Right, &config).unwrap();
    assert_eq!(
        opener.describe(),
        "Virtual GelSight Mini, serial VIRT-RIGHT, port virtual"
    );
    let controls = opener.open().unwrap().controls().unwrap();
    assert_eq!(controls["gain"], 7);
    assert_eq!(controls["exposure_time_absolute"], 180);
}

#[test]
fn unsupported_modes_are_config_errors() {
    let (rig, _) = rig();
    for (role, config, expected) in [
        (
            Role::Left,
            config(PixelFormat::Z16, 640, 480, 25.0),
            "expected MJPG",
        ),
        (
            Role::Depth,
            config(PixelFormat::Mjpg, 640, 480, 25.0),
            "expected Z16",
        ),
        (
            Role::Rgb,
            config(PixelFormat::Yuyv, 641, 480, 25.0),
            "641×480",
        ),
        (Role::Rgb, config(PixelFormat::Yuyv, 640, 0, 25.0), "640×0"),
        (
            Role::Rgb,
            config(PixelFormat::Yuyv, 640, 480, 0.0),
            "found 0",
        ),
        (
            Role::Rgb,
            config(PixelFormat::Yuyv, 640, 480, f64::NAN),
            "found NaN",
        ),
    ] {
        let error = rig.camera(role, &config).err().unwrap();
        assert_eq!(error.kind(), ErrorKind::Config);
        assert!(error.to_string().contains(expected), "{error}");
    }
}

#[test]
fn yuyv_preserves_grey_and_red() {
    assert_eq!(yuyv_bytes(&[128; 6]), [126, 128, 126, 128]);
    let red = yuyv_bytes(&[255, 0, 0, 255, 0, 0]);
    assert!(red[0] > 70 && red[0] < 90, "{red:?}");
    assert!(red[1] < 100 && red[3] > 220, "{red:?}");
}
