use std::sync::Mutex;

use super::super::v4l2_fake::{Camera, Event, FakeNodes};
use super::*;
use crate::calibration::SourceKind;
use gripcast_base::error::ErrorKind;
use gripcast_imaging::PixelFormat;
use gripcast_testing::sysfs_tree::{Tree, mini};

const WAIT: Duration = Duration::from_millis(200);
const YUYV_4X2: [u8; 16] = [1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15, 16];

fn frame(sequence: u32) -> Event {
    Event::Frame(sequence, YUYV_4X2.to_vec(), false)
}

fn yuyv_4x2() -> CameraConfig {
    CameraConfig {
        product: "GelSight Mini".into(),
        serial: Some("2BNN4ZE7".into()),
        ..CameraConfig::new(SourceKind::V4l2, PixelFormat::Yuyv, 4, 2, 25.0)
    }
}

struct Bench {
    tree: Tree,
    nodes: FakeNodes,
    camera: Arc<Mutex<Camera>>,
    opener: V4l2Opener,
}

/// A bench with one camera.
fn bench(camera: Camera, config: CameraConfig) -> Bench {
    let mut tree = Tree::new();
    let nodes = FakeNodes::default();
    let usb = mini("3-1", "GelSight Mini R0B 2BNN-4ZE7", "2BNN4ZE7");
    let number = tree.plug(usb, &[(0, 2)]);
    nodes.insert(tree.node(number + 1), Camera::metadata());
    let camera = nodes.insert(tree.node(number), camera);
    let root = SystemRoot {
        sys: tree.path("sys"),
        dev: tree.path("dev"),
        proc: tree.path("proc"),
    };
    let binder = Arc::new(CameraBinder::new(&[(Role::Left, config.clone())].into()));
    let opener = V4l2Opener::with_nodes(Role::Left, config, binder, root, Arc::new(nodes.clone()))
        .busy_pauses(vec![Duration::ZERO; 4]);
    Bench {
        tree,
        nodes,
        camera,
        opener,
    }
}

fn stream(events: impl IntoIterator<Item = Event>) -> (Bench, Box<dyn FrameSource>) {
    let mut bench = bench(Camera::yuyv_4x2(events), yuyv_4x2());
    let source = bench.opener.open().unwrap();
    (bench, source)
}

fn sequence(source: &mut dyn FrameSource) -> u32 {
    source.next_frame(WAIT).unwrap().sequence
}

#[test]
fn frames_have_the_bytes_sequence_and_time_of_the_driver() {
    let (bench, mut source) = stream([frame(7), frame(8), frame(11)]);
    let first = source.next_frame(WAIT).unwrap();
    assert_eq!(&*first.data, YUYV_4X2);
    assert_eq!((first.width, first.height, first.sequence), (4, 2, 7));
    assert_eq!(first.driver_time_ns, 1_040_000_000);
    assert_eq!(first.received_ns, 1_040_000_000);
    assert_eq!(sequence(source.as_mut()), 8);
    assert_eq!(sequence(source.as_mut()), 11, "gaps are kept");
    assert!(
        bench.camera.lock().unwrap().queued.iter().all(|&q| q),
        "buffers are returned at once"
    );
    assert_eq!(source.info().identity.serial, "2BNN4ZE7");
    assert_eq!(source.info().nominal_fps, 25.0);
    assert!(source.warnings().is_empty());
}

#[test]
fn invalid_time_stamps_are_replaced() {
    for (offset, expected) in [
        (None, 1_040_000_000),
        (Some(-9_000_000), 1_031_000_000),
        (Some(1_000_000), 1_040_000_000),
        (Some(60_000_000_000), 1_040_000_000),
    ] {
        let camera = Camera {
            stamp_offset_ns: offset,
            ..Camera::yuyv_4x2([frame(0)])
        };
        let mut bench = bench(camera, yuyv_4x2());
        let frame = bench.opener.open().unwrap().next_frame(WAIT).unwrap();
        assert_eq!(frame.driver_time_ns, expected, "{offset:?}");
    }
}

#[test]
fn stream_continues_after_a_timeout() {
    let (_bench, mut source) = stream([
        Event::Silence(Duration::from_millis(350)),
        frame(3),
        Event::Signal,
        Event::Nothing,
        frame(4),
    ]);
    assert!(matches!(
        source.next_frame(WAIT),
        Err(CaptureError::Timeout)
    ));
    assert_eq!(sequence(source.as_mut()), 3);
    assert_eq!(
        sequence(source.as_mut()),
        4,
        "signals and EAGAIN do not end the wait"
    );
    assert!(matches!(
        source.next_frame(WAIT),
        Err(CaptureError::Timeout)
    ));
}

#[test]
fn stream_continues_after_damaged_frames() {
    let (_bench, mut source) = stream([
        Event::Frame(1, YUYV_4X2.to_vec(), true),
        Event::Frame(2, Vec::new(), false),
        Event::Frame(3, vec![0; 15], false),
        frame(4),
    ]);
    let mut damage = || match source.next_frame(WAIT) {
        Err(CaptureError::Damaged { sequence, reason }) => (sequence, reason),
        other => panic!("{other:?}"),
    };
    assert_eq!(damage(), (1, "marked as incomplete by the driver".into()));
    assert_eq!(damage(), (2, "empty".into()));
    assert_eq!(damage(), (3, "YUYV 4×2 has 16 bytes, found 15".into()));
    assert_eq!(sequence(source.as_mut()), 4);
}

#[test]
fn row_padding_is_removed() {
    let mut padded = Vec::new();
    for row in YUYV_4X2.chunks(8) {
        padded.extend_from_slice(row);
        padded.extend_from_slice(&[0xff; 4]);
    }
    let camera = Camera {
        padding: 4,
        ..Camera::yuyv_4x2([Event::Frame(0, padded, false)])
    };
    let mut bench = bench(camera, yuyv_4x2());
    let frame = bench.opener.open().unwrap().next_frame(WAIT).unwrap();
    assert_eq!(&*frame.data, YUYV_4X2);
}

#[test]
fn unplugging_ends_the_stream() {
    for end in [Event::Unplug, Event::HangUp, Event::Fault(libc::ENODEV)] {
        let (bench, mut source) = stream([frame(0), end.clone()]);
        assert_eq!(sequence(source.as_mut()), 0, "{end:?}");
        assert!(
            matches!(source.next_frame(WAIT), Err(CaptureError::Gone)),
            "{end:?}"
        );
        assert!(
            matches!(source.next_frame(WAIT), Err(CaptureError::Gone)),
            "{end:?}"
        );
        drop(source);
        assert_eq!(bench.camera.lock().unwrap().stopped, 1);
    }
    let (_bench, mut source) = stream([Event::Fault(libc::EIO)]);
    assert!(matches!(
        source.next_frame(WAIT),
        Err(CaptureError::Failed(_))
    ));
}

#[test]
fn camera_is_reopened_by_serial_at_a_different_node() {
    let (mut bench, source) = stream([frame(0), Event::Unplug]);
    drop(source);
    std::fs::remove_dir_all(bench.tree.path("sys")).unwrap();
    assert_eq!(bench.opener.open().err().unwrap().kind(), ErrorKind::Device);
    std::fs::create_dir_all(bench.tree.path("sys/class/video4linux")).unwrap();
    let usb = mini("4-7", "GelSight Mini R0B 2BNN-4ZE7", "2BNN4ZE7");
    let number = bench.tree.plug(usb, &[(0, 2)]);
    bench
        .nodes
        .insert(bench.tree.node(number), Camera::yuyv_4x2([frame(0)]));
    let mut source = bench.opener.open().unwrap();
    assert_eq!(sequence(source.as_mut()), 0);
    assert_eq!(source.info().identity.port, "4-7");
}

#[test]
fn busy_device_is_retried() {
    let camera = Camera {
        // The first open probes the modes.
        open_faults: [libc::EBUSY, libc::EBUSY].into(),
        start_faults: [libc::EBUSY, libc::EBUSY].into(),
        ..Camera::yuyv_4x2([frame(0)])
    };
    let mut once = bench(camera, yuyv_4x2());
    assert_eq!(sequence(once.opener.open().unwrap().as_mut()), 0);
    assert_eq!(once.camera.lock().unwrap().opened, 5);

    let camera = Camera {
        start_faults: vec![libc::EBUSY; 9].into(),
        ..Camera::yuyv_4x2([])
    };
    let mut always = bench(camera, yuyv_4x2());
    always.tree.hold(99, "guvcview", 0);
    let error = always.opener.open().err().unwrap();
    assert_eq!(error.kind(), ErrorKind::Busy);
    assert!(
        error.to_string().contains("guvcview (process 99)"),
        "{error}"
    );
    assert_eq!(always.camera.lock().unwrap().start_faults.len(), 4);
}

#[test]
fn start_errors_have_their_kind() {
    let start_error = |code| {
        let camera = Camera {
            start_faults: [code].into(),
            ..Camera::yuyv_4x2([])
        };
        bench(camera, yuyv_4x2()).opener.open().err().unwrap()
    };
    let full = start_error(libc::ENOSPC);
    assert_eq!(full.kind(), ErrorKind::Device);
    assert!(
        full.to_string()
            .contains("USB bus 3 has too little bandwidth"),
        "{full}"
    );
    assert!(full.to_string().starts_with("camera left: "), "{full}");
    assert_eq!(start_error(libc::ENODEV).kind(), ErrorKind::Device);
    assert_eq!(start_error(libc::EACCES).kind(), ErrorKind::Permission);
}

#[test]
fn unsupported_mode_is_rejected_with_the_supported_modes() {
    let config = CameraConfig {
        format: PixelFormat::Mjpg,
        width: 640,
        height: 480,
        ..yuyv_4x2()
    };
    let error = bench(Camera::default(), config)
        .opener
        .open()
        .err()
        .unwrap();
    assert_eq!(error.kind(), ErrorKind::Config);
    let text = error.to_string();
    assert!(
        text.contains("MJPG 640×480: it selects MJPG 3280×2464"),
        "{text}"
    );
    assert!(
        text.contains("its modes in the rig file: MJPG 3280×2464 @ 25"),
        "{text}"
    );
}

#[test]
fn controls_are_set_with_automatic_modes_first() {
    let id = |name: &str| {
        let known = controls::CONTROLS.iter().find(|(n, _)| *n == name);
        known.unwrap().1
    };
    let camera = Camera {
        controls: [
            (id("auto_exposure"), (0, 3, 3)),
            (id("exposure_time_absolute"), (1, 5000, 157)),
            (id("gain"), (0, 100, 0)),
            (id("white_balance_temperature"), (2800, 6500, 4600)),
        ]
        .into(),
        stubborn: vec![id("white_balance_temperature")],
        ..Camera::yuyv_4x2([frame(0)])
    };
    let wanted = [
        ("auto_exposure", 1),
        ("exposure_time_absolute", 180),
        ("gain", 200),
        ("hue", 0),
        ("white_balance_temperature", 4500),
    ];
    let config = CameraConfig {
        controls: wanted.iter().map(|&(n, v)| (n.to_owned(), v)).collect(),
        ..yuyv_4x2()
    };
    let mut bench = bench(camera, config);
    let mut source = bench.opener.open().unwrap();
    let log = bench.camera.lock().unwrap().control_log.clone();
    assert_eq!(
        log[..2],
        [id("auto_exposure"), id("exposure_time_absolute")]
    );
    let warnings = source.warnings().join("\n");
    assert_eq!(source.warnings().len(), 3, "{warnings}");
    assert!(
        warnings.contains("`gain`: not set: 200 is outside 0…100"),
        "{warnings}"
    );
    assert!(
        warnings.contains("does not support the controls hue"),
        "{warnings}"
    );
    assert!(
        warnings.contains("`white_balance_temperature`: set to 4500, read back 4600"),
        "{warnings}"
    );
    let values = source.controls().unwrap();
    assert_eq!(values.len(), 4);
    assert_eq!(values["exposure_time_absolute"], 180);
    assert_eq!(values["white_balance_temperature"], 4600);
    bench.camera.lock().unwrap().events = [Event::Unplug].into();
    assert_eq!(source.controls().unwrap_err().kind(), ErrorKind::Device);
}

#[test]
fn unsupported_rate_is_a_warning() {
    let config = CameraConfig {
        fps: 60.0,
        ..yuyv_4x2()
    };
    let mut bench = bench(Camera::yuyv_4x2([]), config);
    let source = bench.opener.open().unwrap();
    assert_eq!(source.info().nominal_fps, 25.0);
    assert_eq!(
        source.warnings(),
        ["requested 60 frames/s, the camera delivers 25"]
    );
}

#[test]
fn opener_describes_its_camera() {
    let bench = bench(Camera::default(), yuyv_4x2());
    assert_eq!(bench.opener.describe(), "GelSight Mini, serial 2BNN4ZE7");
}
