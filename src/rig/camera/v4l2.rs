//! Real cameras through V4L2: configuring, streaming, and opening by identity.
//!
//! A frame is copied out of the driver's buffer and the buffer handed back at once, so that a
//! slow consumer never starves the driver. uvcvideo drops a frame that the camera marked as bad
//! and leaves a gap in the sequence; a truncated JPEG arrives like any other and is recognised
//! when it is decoded.

use std::io;
use std::sync::Arc;
use std::thread;
use std::time::Duration;

use super::CameraIdentity;
use super::source::{CameraOpener, CaptureError, ControlValues, FrameSource, StreamInfo};
use super::v4l2_controls as controls;
use super::v4l2_ioctl::KernelNodes;
use super::v4l2_node::{Filled, Interval, Layout, VideoNode, VideoNodes};
use crate::error::{Error, ErrorKind, Result};
use crate::imaging::{Frame, FrameBytes, FramePool, Role};
use crate::rig::calibration::CameraConfig;
use crate::rig::device::{self, SystemRoot, VideoDevice};

/// Buffers that are asked for; at 30/s they bridge a pause of 0.2 s on our side.
const BUFFERS: u32 = 6;
/// Fewer than this and the driver has none to fill while we hold one.
const BUFFERS_NEEDED: u32 = 2;
/// A driver's time further than this from now comes from a broken clock, ns.
const CLOCK_TOLERANCE_NS: u64 = 5_000_000_000;
/// Share by which the driver's frame rate may differ from the wanted one unremarked.
const FPS_TOLERANCE: f64 = 0.01;

/// Why a stream did not start.
#[derive(Debug)]
enum StartError {
    /// A system call failed; the caller knows the device and explains it.
    System(&'static str, io::Error),
    /// The camera does not do what the rig file asks for.
    Refused(Error),
}

impl StartError {
    fn is_busy(&self) -> bool {
        matches!(self, Self::System(_, error) if error.raw_os_error() == Some(libc::EBUSY))
    }
}

fn step(name: &'static str) -> impl FnOnce(io::Error) -> StartError {
    move |error| StartError::System(name, error)
}

/// A running V4L2 stream.
pub struct V4l2Source {
    node: Box<dyn VideoNode>,
    info: StreamInfo,
    layout: Layout,
    controls: controls::Available,
    warnings: Vec<String>,
    pool: FramePool,
    gone: bool,
}

impl V4l2Source {
    /// Configures an open node and starts its stream.
    fn start(
        mut node: Box<dyn VideoNode>,
        identity: CameraIdentity,
        config: &CameraConfig,
    ) -> Result<Self, StartError> {
        let capabilities = node.capabilities().map_err(step("query"))?;
        if !capabilities.video_capture || !capabilities.streaming {
            return Err(StartError::Refused(
                Error::new(
                    ErrorKind::Device,
                    format!(
                        "{identity}: driver {} offers no streaming capture",
                        capabilities.driver
                    ),
                )
                .remedy("bind another device; `gripcast rig list` shows all"),
            ));
        }
        let layout = node
            .set_format(config.format.fourcc(), config.width, config.height)
            .map_err(step("set the format of"))?;
        let wanted = (config.format.fourcc(), config.width, config.height);
        if (layout.fourcc, layout.width, layout.height) != wanted {
            return Err(StartError::Refused(mode_error(
                node.as_mut(),
                &identity,
                config,
                layout,
            )));
        }
        let mut warnings = Vec::new();
        let nominal_fps = set_rate(node.as_mut(), config.fps, &mut warnings)?;
        warnings.extend(
            controls::apply(node.as_mut(), &config.controls).map_err(step("set controls of"))?,
        );
        let available = controls::available(node.as_mut()).map_err(step("read controls of"))?;
        let count = node.map_buffers(BUFFERS).map_err(step("get buffers of"))?;
        if count < BUFFERS_NEEDED {
            return Err(StartError::System(
                "get buffers of",
                io::Error::from_raw_os_error(libc::ENOMEM),
            ));
        }
        for index in 0..count {
            node.enqueue(index).map_err(step("queue a buffer of"))?;
        }
        node.start().map_err(step("start streaming from"))?;
        Ok(Self {
            node,
            info: StreamInfo {
                identity,
                format: config.format,
                width: config.width,
                height: config.height,
                nominal_fps,
                depth_unit_m: config.depth_unit_m,
            },
            layout,
            controls: available,
            warnings,
            pool: FramePool::default(),
            gone: false,
        })
    }

    /// Takes one buffer from the driver, copies it and hands it back.
    fn take(&mut self) -> Result<Option<Frame>, CaptureError> {
        let filled = match self.node.dequeue() {
            Ok(filled) => filled,
            Err(error) => {
                return match error.raw_os_error() {
                    Some(libc::EAGAIN | libc::EINTR) => Ok(None),
                    Some(libc::ENODEV) => Err(self.lost()),
                    _ => Err(self.failed("dequeue a frame", error)),
                };
            }
        };
        let frame = self.copy(&filled);
        // A frame that is already ours is delivered even if the camera went away meanwhile.
        if let Err(error) = self.node.enqueue(filled.index) {
            if error.raw_os_error() != Some(libc::ENODEV) {
                return Err(self.failed("return a buffer", error));
            }
            self.gone = true;
        }
        frame.map(Some)
    }

    fn copy(&mut self, filled: &Filled) -> Result<Frame, CaptureError> {
        let damaged = |reason: String| CaptureError::Damaged {
            sequence: filled.sequence,
            reason,
        };
        if filled.damaged {
            return Err(damaged("the driver marked it as incomplete".to_owned()));
        }
        let used = filled.bytes_used as usize;
        let Some(bytes) = self.node.buffer(filled.index).and_then(|b| b.get(..used)) else {
            return Err(damaged(format!(
                "the driver reports {used} bytes in buffer {}, which is not that long",
                filled.index
            )));
        };
        if bytes.is_empty() {
            return Err(damaged("it is empty".to_owned()));
        }
        let data = copy_tight(
            &mut self.pool,
            bytes,
            &self.info,
            self.layout.bytes_per_line,
        )
        .map_err(damaged)?;
        let received_ns = self.node.now_ns();
        Ok(Frame {
            format: self.info.format,
            width: self.info.width,
            height: self.info.height,
            data,
            sequence: filled.sequence,
            driver_time_ns: filled
                .time_ns
                .filter(|&t| t > 0 && t.abs_diff(received_ns) < CLOCK_TOLERANCE_NS)
                .map_or(received_ns, |t| t.min(received_ns)),
            received_ns,
        })
    }

    fn lost(&mut self) -> CaptureError {
        self.gone = true;
        CaptureError::Gone
    }

    fn failed(&self, what: &str, error: io::Error) -> CaptureError {
        CaptureError::Failed(Error::io(format!("cannot {what}"), error).at(&self.info.identity))
    }
}

/// Copies one frame; raw formats lose the padding at the end of each row.
fn copy_tight(
    pool: &mut FramePool,
    bytes: &[u8],
    info: &StreamInfo,
    bytes_per_line: u32,
) -> Result<FrameBytes, String> {
    let Some(expected) = info.format.frame_bytes(info.width, info.height) else {
        return Ok(pool.copy(bytes));
    };
    let height = info.height as usize;
    let row = expected.checked_div(height).unwrap_or(0);
    let stride = (bytes_per_line as usize).max(row);
    let needed = stride * height.saturating_sub(1) + row;
    let Some(bytes) = bytes.get(..needed) else {
        return Err(format!(
            "{} {}×{} needs {needed} bytes, {} came",
            info.format,
            info.width,
            info.height,
            bytes.len()
        ));
    };
    Ok(if stride == row {
        pool.copy(bytes)
    } else {
        pool.copy_rows(bytes.chunks(stride).map(|line| &line[..row]))
    })
}

/// Asks for a frame rate; a driver without rates, or with another one, is remarked upon.
fn set_rate(
    node: &mut dyn VideoNode,
    fps: f64,
    warnings: &mut Vec<String>,
) -> Result<f64, StartError> {
    let chosen = match node.set_interval(Interval::from_fps(fps)) {
        Ok(interval) => interval.fps().unwrap_or(fps),
        Err(error)
            if matches!(
                error.raw_os_error(),
                Some(libc::ENODEV | libc::EBUSY | libc::EACCES)
            ) =>
        {
            return Err(StartError::System("set the frame rate of", error));
        }
        Err(error) => {
            warnings.push(format!("the frame rate cannot be set: {error}"));
            fps
        }
    };
    if (chosen - fps).abs() > fps * FPS_TOLERANCE {
        warnings.push(format!(
            "{fps} frames/s were asked for, the camera chose {chosen}"
        ));
    }
    Ok(chosen)
}

fn mode_error(
    node: &mut dyn VideoNode,
    identity: &CameraIdentity,
    config: &CameraConfig,
    chosen: Layout,
) -> Error {
    let offered: Vec<String> = device::modes(node)
        .iter()
        .map(ToString::to_string)
        .collect();
    Error::new(
        ErrorKind::Config,
        format!(
            "{identity} does not deliver {} {}×{}: it stays at {} {}×{}",
            config.format,
            config.width,
            config.height,
            String::from_utf8_lossy(&chosen.fourcc).trim(),
            chosen.width,
            chosen.height
        ),
    )
    .remedy(format!(
        "write one of its modes into the rig file: {}",
        if offered.is_empty() {
            "it lists none".to_owned()
        } else {
            offered.join(", ")
        }
    ))
}

impl FrameSource for V4l2Source {
    fn info(&self) -> &StreamInfo {
        &self.info
    }

    fn next_frame(&mut self, timeout: Duration) -> Result<Frame, CaptureError> {
        let timeout_ns = u64::try_from(timeout.as_nanos()).unwrap_or(u64::MAX);
        let deadline_ns = self.node.now_ns().saturating_add(timeout_ns);
        loop {
            if self.gone {
                return Err(CaptureError::Gone);
            }
            let left_ns = deadline_ns.saturating_sub(self.node.now_ns());
            match self.node.wait(Duration::from_nanos(left_ns)) {
                Ok(ready) if ready.readable || ready.failed => match self.take()? {
                    Some(frame) => return Ok(frame),
                    // An error without a frame: the kernel has taken the node away.
                    None if ready.failed => return Err(self.lost()),
                    None => {}
                },
                Ok(_) => {}
                Err(error) if error.kind() == io::ErrorKind::Interrupted => {}
                Err(error) => return Err(self.failed("wait for a frame", error)),
            }
            if self.node.now_ns() >= deadline_ns {
                return Err(CaptureError::Timeout);
            }
        }
    }

    fn controls(&mut self) -> Result<ControlValues> {
        controls::read(self.node.as_mut(), &self.controls).map_err(|error| {
            self.gone = true;
            Error::new(ErrorKind::Device, "cannot read the controls back")
                .because(error)
                .at(&self.info.identity)
        })
    }

    fn warnings(&self) -> &[String] {
        &self.warnings
    }
}

impl Drop for V4l2Source {
    fn drop(&mut self) {
        // After an unplug STREAMOFF fails; the descriptor is closed all the same.
        self.node.stop().ok();
    }
}

/// Finds a camera by its identity and opens it, under whatever node it has at that moment.
pub struct V4l2Opener {
    role: Role,
    config: CameraConfig,
    root: SystemRoot,
    nodes: Arc<dyn VideoNodes>,
    busy_pauses: Vec<Duration>,
}

impl V4l2Opener {
    /// Opener of a camera of the rig file on the nodes of this machine.
    #[must_use]
    pub fn new(role: Role, config: CameraConfig, root: SystemRoot) -> Self {
        Self::with_nodes(role, config, root, Arc::new(KernelNodes))
    }

    /// The same over other nodes than the kernel's.
    #[must_use]
    pub fn with_nodes(
        role: Role,
        config: CameraConfig,
        root: SystemRoot,
        nodes: Arc<dyn VideoNodes>,
    ) -> Self {
        Self {
            role,
            config,
            root,
            nodes,
            busy_pauses: [50, 100, 200, 400].map(Duration::from_millis).to_vec(),
        }
    }

    /// Pauses before each further attempt while the device is busy, 0.75 s in all by default:
    /// a device that resumes from suspension, or a program that is just ending, is waited for.
    #[must_use]
    pub fn busy_pauses(mut self, pauses: Vec<Duration>) -> Self {
        self.busy_pauses = pauses;
        self
    }

    /// Scans, learns what the candidates offer, and binds.
    ///
    /// # Errors
    /// As [`device::bind`].
    pub fn find(&self) -> Result<(VideoDevice, Vec<VideoDevice>)> {
        let mut devices = device::scan(&self.root)?;
        for candidate in &mut devices {
            if device::is_candidate(&self.config, candidate) {
                device::probe(candidate, self.nodes.as_ref(), &self.root);
            }
        }
        let bound = device::bind(self.role, &self.config, &devices)?.clone();
        Ok((bound, devices))
    }

    fn start(&self, device: &VideoDevice) -> Result<V4l2Source, StartError> {
        let mut pauses = self.busy_pauses.iter();
        loop {
            let attempt = self
                .nodes
                .open(&device.node)
                .map_err(step("open"))
                .and_then(|node| V4l2Source::start(node, device.identity(), &self.config));
            match attempt {
                Err(error) if error.is_busy() => match pauses.next() {
                    Some(pause) => thread::sleep(*pause),
                    None => return Err(error),
                },
                other => return other,
            }
        }
    }
}

impl CameraOpener for V4l2Opener {
    fn role(&self) -> Role {
        self.role
    }

    fn describe(&self) -> String {
        let config = &self.config;
        let mut text = match config.product.as_str() {
            "" => "any camera".to_owned(),
            product => product.to_owned(),
        };
        if let Some(serial) = &config.serial {
            text += &format!(", serial {serial}");
        }
        if let Some(interface) = config.interface {
            text += &format!(", interface {interface}");
        }
        if let Some(port) = config.port.as_ref().filter(|_| config.serial.is_none()) {
            text += &format!(", port {port}");
        }
        text
    }

    fn open(&mut self) -> Result<Box<dyn FrameSource>> {
        let (bound, devices) = self.find()?;
        let source = self.start(&bound).map_err(|error| {
            let error = match error {
                StartError::Refused(error) => error,
                StartError::System(_, cause) if cause.raw_os_error() == Some(libc::ENOSPC) => {
                    device::no_bandwidth_error(&bound, &devices)
                }
                StartError::System(step, cause) => {
                    device::open_error(&self.root, &bound, step, cause)
                }
            };
            error.at(format_args!("camera {}", self.role))
        })?;
        Ok(Box::new(source))
    }
}

#[cfg(test)]
mod tests {
    use std::sync::Mutex;

    use super::super::v4l2_fake::{Camera, Event, FakeNodes};
    use super::*;
    use crate::imaging::PixelFormat;
    use crate::rig::calibration::SourceKind;
    use crate::rig::device::sysfs_tree::{Tree, mini};

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

    /// One camera on the bench, opened by serial without pauses.
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
        let opener = V4l2Opener::with_nodes(Role::Left, config, root, Arc::new(nodes.clone()))
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
    fn frames_carry_bytes_sequence_and_times_as_the_driver_gave_them() {
        let (bench, mut source) = stream([frame(7), frame(8), frame(11)]);
        let first = source.next_frame(WAIT).unwrap();
        assert_eq!(&*first.data, YUYV_4X2);
        assert_eq!((first.width, first.height, first.sequence), (4, 2, 7));
        assert_eq!(first.driver_time_ns, 1_040_000_000);
        assert_eq!(first.received_ns, 1_040_000_000);
        assert_eq!(sequence(source.as_mut()), 8);
        assert_eq!(
            sequence(source.as_mut()),
            11,
            "a gap is passed on, not hidden"
        );
        assert!(
            bench.camera.lock().unwrap().queued.iter().all(|&q| q),
            "each buffer goes back at once"
        );
        assert_eq!(source.info().identity.serial, "2BNN4ZE7");
        assert_eq!(source.info().nominal_fps, 25.0);
        assert!(source.warnings().is_empty());
    }

    #[test]
    fn a_stamp_of_another_or_broken_clock_is_replaced() {
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
    fn after_a_timeout_the_stream_goes_on() {
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
            "signals and EAGAIN are waited through"
        );
        assert!(matches!(
            source.next_frame(WAIT),
            Err(CaptureError::Timeout)
        ));
    }

    #[test]
    fn damaged_empty_and_short_frames_are_told_and_the_stream_goes_on() {
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
        assert_eq!(damage(), (1, "the driver marked it as incomplete".into()));
        assert_eq!(damage(), (2, "it is empty".into()));
        assert_eq!(damage(), (3, "YUYV 4×2 needs 16 bytes, 15 came".into()));
        assert_eq!(sequence(source.as_mut()), 4);
    }

    #[test]
    fn padded_rows_are_packed_tightly() {
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
    fn unplugging_ends_the_stream_and_dropping_it_is_harmless() {
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
    fn a_camera_is_opened_again_by_serial_under_another_node() {
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
    fn a_busy_device_is_tried_again_within_bounds() {
        let camera = Camera {
            // The first open is the one that asks for the modes.
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
    fn refusals_at_the_start_name_the_cause() {
        let refuse = |code| {
            let camera = Camera {
                start_faults: [code].into(),
                ..Camera::yuyv_4x2([])
            };
            bench(camera, yuyv_4x2()).opener.open().err().unwrap()
        };
        let full = refuse(libc::ENOSPC);
        assert_eq!(full.kind(), ErrorKind::Device);
        assert!(
            full.to_string()
                .contains("USB bus 3 has too little bandwidth"),
            "{full}"
        );
        assert!(full.to_string().starts_with("camera left: "), "{full}");
        assert_eq!(refuse(libc::ENODEV).kind(), ErrorKind::Device);
        assert_eq!(refuse(libc::EACCES).kind(), ErrorKind::Permission);
    }

    #[test]
    fn a_mode_that_the_camera_only_pretends_to_take_is_refused_with_its_modes() {
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
            text.contains("MJPG 640×480: it stays at MJPG 3280×2464"),
            "{text}"
        );
        assert!(
            text.contains("its modes into the rig file: MJPG 3280×2464 @ 25"),
            "{text}"
        );
    }

    #[test]
    fn controls_are_set_automatic_ones_first_and_read_back() {
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
            warnings.contains("`gain`: 200 is outside 0…100"),
            "{warnings}"
        );
        assert!(
            warnings.contains("`hue`: the camera does not have it"),
            "{warnings}"
        );
        assert!(
            warnings.contains("`white_balance_temperature`: set to 4500, the camera holds 4600"),
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
    fn a_rate_that_the_camera_does_not_take_is_remarked_upon() {
        let config = CameraConfig {
            fps: 60.0,
            ..yuyv_4x2()
        };
        let mut bench = bench(Camera::yuyv_4x2([]), config);
        let source = bench.opener.open().unwrap();
        assert_eq!(source.info().nominal_fps, 25.0);
        assert_eq!(
            source.warnings(),
            ["60 frames/s were asked for, the camera chose 25"]
        );
    }

    #[test]
    fn the_opener_says_what_it_looks_for() {
        let bench = bench(Camera::default(), yuyv_4x2());
        assert_eq!(bench.opener.describe(), "GelSight Mini, serial 2BNN4ZE7");
    }
}
