//! The whole engine on cameras in memory.

use std::collections::BTreeMap;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use tokio::sync::{mpsc, oneshot, watch};

use super::*;
use gripcast_capture::camera::{
    CameraIdentity, CaptureError, ControlValues, FrameSource, StreamInfo,
};
use gripcast_dataset::sample::new_dataset;
use gripcast_dataset::{Dataset, Stage};
use gripcast_imaging::{Frame, PixelFormat};
use gripcast_session::{Command, CommandResult, CommandSource};

const WIDTH: u32 = 640;
const HEIGHT: u32 = 480;
const INTERVAL: Duration = Duration::from_millis(25);

/// A tactile camera that sends YUYV: even grey, stripes while its gel is pressed.
#[derive(Clone)]
struct YuyvGel {
    role: Role,
    is_pressed: Arc<AtomicBool>,
    info: StreamInfo,
    sequence: u32,
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

    fn next_frame(&mut self, _: Duration) -> std::result::Result<Frame, CaptureError> {
        std::thread::sleep(INTERVAL);
        let rise = 60 * u8::from(self.is_pressed.load(Ordering::Relaxed));
        // Luma and chroma of a pixel in turn; a stripe is 40 pixels wide.
        let pixel = |n: u32| [100 + rise * u8::from((n / 40).is_multiple_of(2)), 128];
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

fn setup(dataset: PathBuf, is_pressed: &Arc<AtomicBool>) -> EngineSetup {
    let mut rig = RigFile::virtual_rig();
    rig.cameras.retain(|role, _| role.is_tactile());
    let gel = |role| -> Box<dyn CameraOpener> {
        Box::new(YuyvGel {
            role,
            is_pressed: Arc::clone(is_pressed),
            info: StreamInfo {
                identity: CameraIdentity::default(),
                format: PixelFormat::Yuyv,
                width: WIDTH,
                height: HEIGHT,
                nominal_fps: 40.0,
                depth_unit_m: None,
            },
            sequence: 0,
        })
    };
    EngineSetup {
        openers: vec![gel(Role::Left), gel(Role::Right)],
        rig,
        intrinsics: BTreeMap::new(),
        supervision: SupervisionPolicy {
            freeze_after_ns: None,
            ..SupervisionPolicy::default()
        },
        dataset,
        new_dataset: new_dataset(),
        labels: Labels {
            object: "mug".parse().unwrap(),
            ..Labels::default()
        },
        guards: GuardLimits {
            // A loaded machine is slow.
            max_frame_age_ms: 5_000.0,
            max_skew_ms: 5_000.0,
            min_free_bytes: 0,
            ..GuardLimits::default()
        },
        model: Some(Model::baseline().unwrap()),
        script: None,
        boards: None,
        hand: None,
        black_box: None,
    }
}

/// Gives a command until it is accepted: frames and contact have to come first.
async fn accepted(commands: &mpsc::Sender<Asked>, command: Command) {
    for _ in 0..400 {
        let (asked, answer) = Asked::with_answer(command.clone(), CommandSource::Script);
        commands.send(asked).await.unwrap();
        match answer.await.unwrap() {
            CommandResult::Accepted => return,
            CommandResult::Refused { .. } => tokio::time::sleep(INTERVAL).await,
            CommandResult::Failed { error } => panic!("{error}"),
        }
    }
    panic!("`{command}` was never accepted");
}

#[tokio::test]
async fn a_rig_whose_gels_send_yuyv_saves_and_predicts() {
    let dir = tempfile::tempdir().unwrap();
    let is_pressed = Arc::new(AtomicBool::new(false));
    let setup = setup(dir.path().join("d"), &is_pressed);
    let starting = EngineStatus::starting("d", "bench", Labels::default());
    let (commands, command_queue) = mpsc::channel(8);
    let (_limits, limits) = mpsc::channel(1);
    let (status, mut newest) = watch::channel(Arc::new(starting));
    let (tones, _heard) = mpsc::unbounded_channel();
    let links = EngineLinks {
        commands: command_queue,
        limits,
        tasks: Tasks::default(),
        status,
        tones,
        stored: Box::new(|_| {}),
    };
    let (_stop, stopped) = oneshot::channel::<Ended>();
    let stop = async { stopped.await.unwrap_or(Ended::Interrupted) };
    let operator = async {
        accepted(&commands, Command::Initial).await;
        is_pressed.store(true, Ordering::Relaxed);
        accepted(&commands, Command::Grasp).await;
        let seen = newest
            .wait_for(|status| status.session.last.is_some())
            .await;
        let last = seen.unwrap().session.last.clone().unwrap();
        commands
            .send(Asked::new(Command::Quit, CommandSource::Script))
            .await
            .unwrap();
        last
    };
    let (report, last) = tokio::join!(run(setup, links, stop), operator);
    let report = report.unwrap();
    assert_eq!(report.ended, Ended::Quit);
    let said = last.predicted.expect("a prediction");
    assert_eq!(report.grasps[0].p_stable, Some(said.p_stable));

    let dataset = Dataset::open(dir.path().join("d")).unwrap();
    let record = dataset.grasp(&last.id).unwrap();
    assert_eq!(record.prediction, Some(said));
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
