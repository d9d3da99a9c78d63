use std::collections::VecDeque;

use super::*;
use gripcast_capture::camera::CameraIdentity;
use gripcast_imaging::PixelFormat;

/// A source with a clock of its own: each frame 40 ms after the one before.
struct Scripted {
    info: StreamInfo,
    script: VecDeque<Result<u32, CaptureError>>,
    now_ns: u64,
}

impl Scripted {
    fn new(nominal_fps: f64, script: impl IntoIterator<Item = Result<u32, CaptureError>>) -> Self {
        Self {
            info: StreamInfo {
                identity: CameraIdentity::default(),
                format: PixelFormat::Grey,
                width: 1,
                height: 1,
                nominal_fps,
                depth_unit_m: None,
            },
            script: script.into_iter().collect(),
            now_ns: 5,
        }
    }
}

impl FrameSource for Scripted {
    fn info(&self) -> &StreamInfo {
        &self.info
    }

    fn next_frame(&mut self, _timeout: Duration) -> Result<Frame, CaptureError> {
        self.now_ns += 40_000_000;
        let sequence = self
            .script
            .pop_front()
            .unwrap_or(Err(CaptureError::Timeout))?;
        Ok(Frame {
            format: PixelFormat::Grey,
            width: 1,
            height: 1,
            data: vec![sequence as u8].into(),
            sequence,
            driver_time_ns: self.now_ns,
            received_ns: self.now_ns,
        })
    }

    fn controls(&mut self) -> Result<ControlValues> {
        Ok([("gain".to_owned(), 7)].into())
    }
}

struct Opener(Role, Option<Result<Scripted>>);

impl CameraOpener for Opener {
    fn role(&self) -> Role {
        self.0
    }

    fn describe(&self) -> String {
        "a scripted camera".to_owned()
    }

    fn open(&mut self) -> Result<Box<dyn FrameSource>> {
        Ok(Box::new(self.1.take().unwrap()?))
    }
}

fn measured(mut source: Scripted) -> (FrameStats, Vec<String>) {
    let mut problems = Vec::new();
    let measured = measure(
        &mut source,
        Duration::from_secs(1),
        None,
        None,
        &mut problems,
    );
    assert_eq!(measured.last.is_some(), measured.frames.received > 0);
    (measured.frames, problems)
}

fn damaged(sequence: u32) -> Result<u32, CaptureError> {
    Err(CaptureError::Damaged {
        sequence,
        reason: "error flag".to_owned(),
    })
}

#[test]
fn rate_and_losses_are_measured_for_the_duration() {
    let (frames, problems) = measured(Scripted::new(25.0, (0..99).map(Ok)));
    assert_eq!((frames.received, frames.lost, frames.damaged), (26, 0, 0));
    assert!((frames.fps.unwrap() - 25.0).abs() < 1e-9);
    assert!(problems.is_empty(), "{problems:?}");

    let script = [Ok(1), Ok(2), damaged(4), Ok(6), Ok(7)].into_iter();
    let (frames, _) = measured(Scripted::new(25.0, script));
    assert_eq!((frames.received, frames.lost, frames.damaged), (4, 2, 1));
}

#[test]
fn out_of_order_frames_are_not_lost() {
    let lost = |numbers: &[u32]| {
        let mut sequences = Sequences::default();
        numbers.iter().for_each(|&n| sequences.count(n));
        sequences.lost
    };
    assert_eq!(lost(&[7, 8, 10, 9, 11]), 0);
    assert_eq!(lost(&[7, 8, 10, 12, 11]), 1);
    assert_eq!(lost(&[u32::MAX - 1, u32::MAX, 0, 2]), 1);
    assert_eq!(lost(&[3, 3, 4]), 0);
}

#[test]
fn slow_silent_damaged_and_unplugged_cameras_have_a_problem() {
    let (_, problems) = measured(Scripted::new(60.0, (0..99).map(Ok)));
    assert_eq!(problems, ["expected 60 frames/s, measured 25.00"]);
    let (_, problems) = measured(Scripted::new(25.0, []));
    assert_eq!(problems, ["no frame for 5 s"]);
    let (frames, problems) = measured(Scripted::new(25.0, (0..).map(damaged).take(500)));
    assert_eq!(frames.damaged, 101, "it does not go on for ever");
    assert!(
        problems[1].contains("100 % of its frames are damaged: error flag"),
        "{problems:?}"
    );
    let (_, problems) = measured(Scripted::new(25.0, [Ok(1), Ok(2), Err(CaptureError::Gone)]));
    assert_eq!(problems, ["the camera was unplugged"]);
}

#[test]
fn missing_camera_takes_precedence_over_failing_one() {
    let good = || Some(Ok(Scripted::new(25.0, (0..99).map(Ok))));
    let slow = || Some(Ok(Scripted::new(99.0, (0..99).map(Ok))));
    let absent = || Some(Err(Error::new(ErrorKind::Device, "not there")));
    let busy = || Some(Err(Error::new(ErrorKind::Busy, "in use")));
    for (left, right, expected) in [
        (good(), good(), None),
        (good(), slow(), Some(ErrorKind::Check)),
        (busy(), good(), Some(ErrorKind::Check)),
        (absent(), slow(), Some(ErrorKind::Device)),
    ] {
        let openers: Vec<Box<dyn CameraOpener>> = vec![
            Box::new(Opener(Role::Left, left)),
            Box::new(Opener(Role::Right, right)),
        ];
        let checks = check_cameras(
            openers,
            &SystemRoot::default(),
            Duration::from_secs(1),
            None,
        );
        assert_eq!(verdict(&checks).err().map(|e| e.kind()), expected);
    }
}

#[test]
fn report_has_stable_keys() {
    let mut opener = Opener(Role::Left, Some(Ok(Scripted::new(25.0, (0..99).map(Ok)))));
    let root = SystemRoot::default();
    let check = CameraCheck::new(Role::Left, opener.describe());
    let check = check_one(check, &mut opener, &root, Duration::from_secs(1), None);
    let value = check.json();
    let keys: Vec<&str> = value
        .as_object()
        .unwrap()
        .keys()
        .map(String::as_str)
        .collect();
    assert_eq!(
        keys,
        [
            "controls",
            "damage",
            "damaged",
            "damaged_fraction",
            "decoded",
            "expected",
            "factory_intrinsics",
            "format",
            "fps",
            "gel",
            "height",
            "lost",
            "missing",
            "node",
            "nominal_fps",
            "notes",
            "ok",
            "port",
            "problems",
            "product",
            "received",
            "role",
            "serial",
            "state",
            "width"
        ]
    );
    assert_eq!(value["controls"]["gain"], 7);
    assert_eq!(value["ok"], true);
    assert_eq!(
        (&value["state"], &value["damage"]),
        (&"live".into(), &Value::Null)
    );
    assert!(check.text().starts_with("left     ok"), "{}", check.text());
}
