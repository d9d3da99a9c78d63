//! Test of the complete engine with cameras in memory.

use std::collections::BTreeMap;
use std::sync::mpsc::Receiver;
use std::sync::{Arc, Mutex};
use std::time::Duration;

use tokio::sync::{mpsc, oneshot, watch};

use super::*;
use crate::daemon::{CameraState, CameraStatus, LiftReport};
use gripcast_base::files::FileName;
use gripcast_capture::camera::{
    CameraIdentity, CaptureError, ControlValues, FrameSource, StreamInfo,
};
use gripcast_dataset::sample::new_dataset;
use gripcast_dataset::{Dataset, GraspIndex, LiftFrame, Outcome, Stage};
use gripcast_imaging::{Frame, PixelFormat};
use gripcast_nn::predict::Adaptation;
use gripcast_session::{Command, CommandResult, CommandSource};
use gripcast_tactile::SensorProfile;
use gripcast_tactile::force::ForceEstimator;

const WIDTH: u32 = 640;
const HEIGHT: u32 = 480;

/// Pitch and radius of the gel markers and their motion in contact, px of the camera.
const PITCH_PX: u32 = 60;
const RADIUS_PX: f64 = 11.0;
const SHIFT_PX: u32 = 5;
/// Millimetres per pixel of the camera: 5.9e-5 m for each of 320 pixels of the cropped 458.
const MM_PER_PX: f64 = 0.059 * 320.0 / 458.0;

/// Requests one frame, with or without contact.
type Shutter = std::sync::mpsc::Sender<bool>;

/// Tactile YUYV camera: grey with gel markers; in contact it has stripes, and the markers are
/// [`SHIFT_PX`] further right. It captures a frame on request.
#[derive(Clone)]
struct YuyvGel {
    role: Role,
    shutter: Arc<Mutex<Receiver<bool>>>,
    info: StreamInfo,
    sequence: u32,
}

impl YuyvGel {
    fn new(role: Role) -> (Self, Shutter) {
        let (shutter, taken) = std::sync::mpsc::channel();
        let gel = Self {
            role,
            shutter: Arc::new(Mutex::new(taken)),
            info: StreamInfo {
                identity: CameraIdentity::default(),
                format: PixelFormat::Yuyv,
                width: WIDTH,
                height: HEIGHT,
                nominal_fps: 40.0,
                depth_unit_m: None,
            },
            sequence: 0,
        };
        (gel, shutter)
    }
}

impl CameraOpener for YuyvGel {
    fn role(&self) -> Role {
        self.role
    }

    fn describe(&self) -> String {
        "a gel in memory".into()
    }

    fn open(&mut self) -> Result<Box<dyn FrameSource>> {
        Ok(Box::new(self.clone()))
    }
}

impl FrameSource for YuyvGel {
    fn info(&self) -> &StreamInfo {
        &self.info
    }

    fn next_frame(&mut self, timeout: Duration) -> std::result::Result<Frame, CaptureError> {
        let is_pressed = self.shutter.lock().unwrap().recv_timeout(timeout);
        let is_pressed = is_pressed.map_err(|_| CaptureError::Timeout)?;
        let rise = 140 * u8::from(is_pressed);
        // Luma and chroma bytes alternate; stripes are 40 pixels wide and in the middle of the gel.
        let pixel = |n: u32| {
            let is_stripe = (n / 40).is_multiple_of(2) && (210..270).contains(&(n / WIDTH));
            let shift = SHIFT_PX * u32::from(is_pressed);
            let from_centre = |position: u32| f64::from(position % PITCH_PX) - 30.0;
            let distance = from_centre(n % WIDTH + PITCH_PX - shift).hypot(from_centre(n / WIDTH));
            let darkness = 0.65 * (RADIUS_PX + 0.5 - distance).clamp(0.0, 1.0);
            let level = f64::from(100 + rise * u8::from(is_stripe)) * (1.0 - darkness);
            [level as u8, 128]
        };
        let data: Vec<u8> = (0..WIDTH * HEIGHT).flat_map(pixel).collect();
        self.sequence += 1;
        Ok(Frame {
            format: PixelFormat::Yuyv,
            width: WIDTH,
            height: HEIGHT,
            data: data.into(),
            sequence: self.sequence,
            driver_time_ns: monotonic_ns(),
            received_ns: monotonic_ns(),
        })
    }

    fn controls(&mut self) -> Result<ControlValues> {
        Ok(ControlValues::new())
    }
}

const GEL: GelScale = GelScale {
    m_per_px: 5.9e-5,
    markers: None,
};

/// Uncalibrated estimators of both gels.
fn gel_forces() -> GelForces {
    let profile = SensorProfile::gelsight_mini().unwrap();
    let estimator = Arc::new(ForceEstimator::new(&profile, None).unwrap());
    [Role::Left, Role::Right]
        .map(|role| (role, Arc::clone(&estimator)))
        .into()
}

fn setup(dataset: PathBuf, gels: [YuyvGel; 2]) -> EngineSetup {
    let mut rig = RigFile::virtual_rig();
    rig.cameras.retain(|role, _| role.is_tactile());
    EngineSetup {
        openers: gels
            .map(|gel| Box::new(gel) as Box<dyn CameraOpener>)
            .into(),
        rig,
        intrinsics: BTreeMap::new(),
        gel_scales: [Role::Left, Role::Right].map(|role| (role, GEL)).into(),
        gel_forces: gel_forces(),
        force_calibrations: BTreeMap::new(),
        supervision: SupervisionPolicy {
            freeze_after_ns: None,
            ..SupervisionPolicy::default()
        },
        index: GraspIndex::new(&dataset),
        dataset,
        new_dataset: new_dataset(),
        labels: Labels {
            object: "mug".parse().unwrap(),
            ..Labels::default()
        },
        guards: GuardLimits {
            // Tolerates a loaded machine.
            max_frame_age_ms: 5_000.0,
            max_skew_ms: 5_000.0,
            min_free_bytes: 0,
            ..GuardLimits::default()
        },
        model: Some(Model::baseline().unwrap()),
        decision: DecisionSettings::default(),
        script: None,
        boards: None,
        hand: None,
        target_per_object: 20,
        keep_lift: Duration::from_secs(10),
        black_box: None,
    }
}

/// Test fixture: commands, cameras and status.
struct Bench {
    commands: mpsc::Sender<CommandRequest>,
    shutters: [Shutter; 2],
    status: watch::Receiver<Arc<EngineStatus>>,
}

impl Bench {
    /// Captures frames of both gels until the status shows them.
    async fn take_frames(&mut self, is_pressed: bool, is_shown: impl Fn(&EngineStatus) -> bool) {
        while !is_shown(&self.status.borrow_and_update()) {
            for shutter in &self.shutters {
                shutter.send(is_pressed).unwrap();
            }
            self.status.changed().await.unwrap();
        }
    }

    /// A key that waited since the machine started, for example for a slow disk.
    async fn refused_as_late(&self, command: Command) {
        let (request, response) = CommandRequest::with_response(command, CommandSource::Keyboard);
        let late = CommandRequest {
            given_ns: 0,
            ..request
        };
        self.commands.send(late).await.unwrap();
        let result = response.await.unwrap();
        let is_stale = matches!(result, CommandResult::Refused { stale: true, .. });
        assert!(is_stale, "{result:?}");
        let message = self.status.borrow().session.message.clone().unwrap();
        assert!(message.text.contains("NOT carried out"), "{message:?}");
    }

    /// Saves a grasp.
    async fn take_grasp(&mut self) {
        let are_live = |status: &EngineStatus| {
            let live = |camera: &CameraStatus| camera.state == CameraState::Live;
            status.cameras.len() == 2 && status.cameras.iter().all(live)
        };
        self.take_frames(false, are_live).await;
        self.accepted(Command::Initial).await;
        let is_in_contact = |status: &EngineStatus| {
            status.contact.len() == 2 && status.contact.values().all(|levels| *levels > 10.0)
        };
        self.take_frames(true, is_in_contact).await;
        self.accepted(Command::Grasp).await;
    }

    async fn accepted(&self, command: Command) {
        let (request, response) = CommandRequest::with_response(command, CommandSource::Script);
        self.commands.send(request).await.unwrap();
        assert_eq!(response.await.unwrap(), CommandResult::Accepted);
    }
}

#[tokio::test]
async fn engine_saves_and_predicts_with_yuyv_cameras() {
    let dir = tempfile::tempdir().unwrap();
    let (left, left_shutter) = YuyvGel::new(Role::Left);
    let (right, right_shutter) = YuyvGel::new(Role::Right);
    let setup = setup(dir.path().join("d"), [left, right]);
    let starting = EngineStatus::starting("d", "bench", Labels::default());
    let (commands, command_queue) = mpsc::channel(8);
    let (_limits, limits) = mpsc::channel(1);
    let (status, newest) = watch::channel(Arc::new(starting));
    let (tones, _tone_receiver) = mpsc::unbounded_channel();
    let links = EngineLinks {
        commands: command_queue,
        limits,
        tasks: Tasks::default(),
        status,
        tones,
        on_stored: Box::new(|_| {}),
    };
    let (_stop, stopped) = oneshot::channel::<EndReason>();
    let stop = async { stopped.await.unwrap_or(EndReason::Interrupted) };
    let mut bench = Bench {
        commands,
        shutters: [left_shutter, right_shutter],
        status: newest,
    };
    let operator = async {
        let are_live = |status: &EngineStatus| {
            let live = |camera: &CameraStatus| camera.state == CameraState::Live;
            status.cameras.len() == 2 && status.cameras.iter().all(live)
        };
        bench.take_frames(false, are_live).await;
        bench.refused_as_late(Command::Initial).await;
        bench.accepted(Command::Initial).await;
        let is_in_contact = |status: &EngineStatus| {
            status.contact.len() == 2 && status.contact.values().all(|levels| *levels > 10.0)
        };
        bench.take_frames(true, is_in_contact).await;
        bench.accepted(Command::Grasp).await;
        let saved = bench
            .status
            .wait_for(|status| status.session.last.is_some());
        let saved = saved.await.unwrap().clone();
        assert_eq!(saved.target_per_object, 20);
        let last = saved.session.last.clone().unwrap();
        let left = bench.status.wait_for(|status| status.grasps_left.is_some());
        let left = left.await.unwrap().clone();
        let preview = &left.previews[&Role::Left];
        assert!(
            preview
                .difference
                .as_ref()
                .is_none_or(|shown| *shown != preview.image)
        );
        for _ in 0..3 {
            let time_ns = |status: &EngineStatus| {
                status
                    .cameras
                    .iter()
                    .map(|c| c.counters.received)
                    .sum::<u64>()
            };
            let before = time_ns(&bench.status.borrow());
            bench
                .take_frames(true, |status| time_ns(status) >= before + 2)
                .await;
        }
        bench
            .commands
            .send(CommandRequest::new(Command::Quit, CommandSource::Script))
            .await
            .unwrap();
        (last, left)
    };
    let (report, (last, left)) = tokio::join!(run(setup, links, stop), operator);
    let report = report.unwrap();
    assert_eq!(report.ended, EndReason::Quit);
    let prediction = last.predicted.expect("a prediction");
    assert_eq!(report.grasps[0].p_stable, Some(prediction.p_stable));

    let dataset = Dataset::open(dir.path().join("d")).unwrap();
    let record = dataset.grasp(&last.id).unwrap();
    assert_eq!(record.prediction, Some(prediction));
    for role in [Role::Left, Role::Right] {
        let [x, y] = record.grasp.shear[&role].mean_displacement_mm;
        let expected = f64::from(SHIFT_PX) * MM_PER_PX;
        assert!((x - expected).abs() < 0.02 && y.abs() < 0.02, "{x} {y}");
        let force = &record.grasp.force[&role];
        assert!(force.normal_n > 0.0 && force.is_finite() && !force.is_calibrated);
        let markers = &record.grasp.fields[&role];
        assert_eq!(markers.len(), 1);
        assert!(markers.values().all(|field| field.shape[2] == 5));
    }
    let lift = record.lift.as_ref().expect("lift frames");
    assert_eq!(lift.requested_s, 10.0);
    assert_eq!(
        report.lifts,
        LiftReport {
            stored: 1,
            failed: 0
        }
    );
    for camera in lift.cameras.values() {
        assert!(camera.frames.len() >= 3, "{}", camera.frames.len());
        let after = |frame: &LiftFrame| frame.driver_time_ns > record.grasp.trigger_time_ns;
        assert!(camera.frames.iter().all(after));
    }
    let is_image = |name: &FileName| !name.starts_with("lift.");
    let images = record.files.iter().filter(|(name, _)| is_image(name));
    let grasp_bytes: u64 = images.map(|(_, file)| file.bytes).sum();
    let expected = left.disk_free_bytes.unwrap() / grasp_bytes;
    assert_eq!(left.grasps_left, Some(expected));
    for stage in [Stage::Initial, Stage::Grasp] {
        let cameras = &record.stage(stage).cameras;
        assert_eq!(cameras.len(), 2);
        let formats = cameras.values().map(|camera| camera.format);
        assert!(
            formats
                .into_iter()
                .all(|format| format == PixelFormat::Yuyv)
        );
    }
}

/// Runs an engine with adaptation while `operator` acts.
async fn run_adapted<F: Future>(dataset: &std::path::Path, operator: impl FnOnce(Bench) -> F) {
    let (left, left_shutter) = YuyvGel::new(Role::Left);
    let (right, right_shutter) = YuyvGel::new(Role::Right);
    let setup = EngineSetup {
        decision: DecisionSettings {
            error_rate: None,
            adapt_strength: Some(10.0),
        },
        keep_lift: Duration::ZERO,
        ..setup(dataset.to_owned(), [left, right])
    };
    let starting = EngineStatus::starting("d", "bench", Labels::default());
    let (commands, command_queue) = mpsc::channel(8);
    let (_limits, limits) = mpsc::channel(1);
    let (status, newest) = watch::channel(Arc::new(starting));
    let (tones, _tone_receiver) = mpsc::unbounded_channel();
    let links = EngineLinks {
        commands: command_queue,
        limits,
        tasks: Tasks::default(),
        status,
        tones,
        on_stored: Box::new(|_| {}),
    };
    let bench = Bench {
        commands: commands.clone(),
        shutters: [left_shutter, right_shutter],
        status: newest,
    };
    let operator = async {
        operator(bench).await;
        let quit = CommandRequest::new(Command::Quit, CommandSource::Script);
        commands.send(quit).await.unwrap();
    };
    let (report, ()) = tokio::join!(run(setup, links, std::future::pending()), operator);
    assert_eq!(report.unwrap().ended, EndReason::Quit);
}

#[tokio::test]
async fn predictions_adapt_to_labels_and_back() {
    let dir = tempfile::tempdir().unwrap();
    let dataset = dir.path().join("d");
    /// Waits until predictions are adapted to this number of labels.
    async fn adapted_to(bench: &mut Bench, labels: u64) -> Adaptation {
        let is_adapted =
            |status: &Arc<EngineStatus>| status.adaptation.is_some_and(|now| now.labels == labels);
        let status = bench.status.wait_for(is_adapted).await.unwrap();
        status.adaptation.unwrap()
    }
    run_adapted(&dataset, async |mut bench: Bench| {
        bench.take_grasp().await;
        assert_eq!(adapted_to(&mut bench, 0).await.base_rate, 0.5);
        bench.accepted(Command::Label(Outcome::Stable)).await;
        let stable = adapted_to(&mut bench, 1).await.base_rate;
        assert!((stable - 6.0 / 11.0).abs() < 1e-12, "{stable}");
        bench.accepted(Command::Undo).await;
        assert_eq!(adapted_to(&mut bench, 0).await.offset, 0.0);
        bench.accepted(Command::Label(Outcome::Slip)).await;
        let slip = adapted_to(&mut bench, 1).await;
        assert!((slip.base_rate - 5.0 / 11.0).abs() < 1e-12, "{slip:?}");
        assert!(slip.offset < 0.0);
    })
    .await;
    // A restart continues with the labels of the dataset.
    run_adapted(&dataset, async |mut bench: Bench| {
        let now = adapted_to(&mut bench, 1).await;
        assert_eq!((now.labels, now.stable), (1, 0));
        bench.take_grasp().await;
    })
    .await;
    let opened = Dataset::open(&dataset).unwrap();
    let mut predictions = Vec::new();
    for id in opened.ids().unwrap() {
        let record = opened.grasp(&id).unwrap();
        predictions.push(record.prediction.expect("a prediction"));
    }
    let [first, second] = &predictions[..] else {
        panic!("two grasps: {}", predictions.len());
    };
    let of_first = first.adapted.expect("adapted");
    assert_eq!((of_first.labels, of_first.p_stable), (0, first.p_stable));
    let of_second = second.adapted.expect("adapted");
    assert_eq!(of_second.labels, 1);
    assert!(of_second.p_stable < second.p_stable, "{second:?}");
}
