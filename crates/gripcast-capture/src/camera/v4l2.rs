//! V4L2 cameras: configuration, streaming, and opening by identity.
//!
//! A frame is copied and its buffer returned at once: slow consumers do not starve the driver.
//! uvcvideo drops frames marked as bad by the camera, with a gap in the sequence; truncated JPEGs
//! are only detected by decoding. Frames may be out of sequence.

use std::io;
use std::ops::Range;
use std::sync::Arc;
use std::thread;
use std::time::Duration;

use super::CameraIdentity;
use super::source::{CameraOpener, CaptureError, ControlValues, FrameSource, StreamInfo};
use super::v4l2_controls as controls;
use super::v4l2_ioctl::KernelNodes;
use super::v4l2_node::{FilledBuffer, Interval, Layout, VideoNode, VideoNodes};
use super::v4l2_shared::SharedBytes;
use crate::calibration::CameraConfig;
use crate::device::{self, CameraBinder, SystemRoot, VideoDevice, device_error};
use gripcast_base::error::{Error, Result};
use gripcast_imaging::{Frame, FrameBytes, FramePool, Role};

/// Number of requested buffers: 0.2 s at 30/s.
const BUFFERS: u32 = 6;
/// Minimum number of buffers: one is read while the driver fills another.
const MIN_BUFFERS: u32 = 2;
/// Maximum difference of a driver's time stamp from now, ns.
const CLOCK_TOLERANCE_NS: u64 = 5_000_000_000;
/// Maximum relative error of the frame rate without a warning.
const FPS_TOLERANCE: f64 = 0.01;

/// Error of starting a stream.
#[derive(Debug)]
enum StartError {
    /// A system call failed in a step.
    System(&'static str, io::Error),
    /// The camera does not support the configuration.
    Unsupported(Error),
}

impl StartError {
    fn is_busy(&self) -> bool {
        matches!(self, Self::System(_, error) if error.raw_os_error() == Some(libc::EBUSY))
    }
}

fn failed_step(name: &'static str) -> impl FnOnce(io::Error) -> StartError {
    move |error| StartError::System(name, error)
}

/// A running V4L2 stream.
struct V4l2Source {
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
        let capabilities = node.capabilities().map_err(failed_step("query"))?;
        if !capabilities.video_capture || !capabilities.streaming {
            return Err(StartError::Unsupported(
                device_error(format!(
                    "{identity}: driver {} does not support streaming capture",
                    capabilities.driver
                ))
                .remedy("bind a different device; `gripcast rig list` lists all"),
            ));
        }
        let layout = node
            .set_format(config.format.fourcc(), config.width, config.height)
            .map_err(failed_step("set the format of"))?;
        let wanted = (config.format.fourcc(), config.width, config.height);
        if (layout.fourcc, layout.width, layout.height) != wanted {
            return Err(StartError::Unsupported(mode_error(
                node.as_mut(),
                &identity,
                config,
                layout,
            )));
        }
        let mut warnings = Vec::new();
        let nominal_fps = set_rate(node.as_mut(), config.fps, &mut warnings)?;
        warnings.extend(
            controls::apply(node.as_mut(), &config.controls)
                .map_err(failed_step("set controls of"))?,
        );
        let available =
            controls::available(node.as_mut()).map_err(failed_step("read controls of"))?;
        let count = node
            .map_buffers(BUFFERS)
            .map_err(failed_step("get buffers of"))?;
        if count < MIN_BUFFERS {
            return Err(StartError::System(
                "get buffers of",
                io::Error::from_raw_os_error(libc::ENOMEM),
            ));
        }
        for index in 0..count {
            node.enqueue(index)
                .map_err(failed_step("queue a buffer of"))?;
        }
        node.start().map_err(failed_step("start streaming from"))?;
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

    /// Dequeues a buffer, copies its frame and returns it to the driver.
    fn read_frame(&mut self) -> Result<Option<Frame>, CaptureError> {
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
        // The copied frame is delivered even if the camera was unplugged.
        if let Err(error) = self.node.enqueue(filled.index) {
            if error.raw_os_error() != Some(libc::ENODEV) {
                return Err(self.failed("return a buffer", error));
            }
            self.gone = true;
        }
        frame.map(Some)
    }

    fn copy(&mut self, filled: &FilledBuffer) -> Result<Frame, CaptureError> {
        let damaged = |reason: String| CaptureError::Damaged {
            sequence: filled.sequence,
            reason,
        };
        if filled.damaged {
            return Err(damaged("marked as incomplete by the driver".to_owned()));
        }
        let used = filled.bytes_used as usize;
        let buffer = self.node.buffer(filled.index);
        let Some(bytes) = buffer.and_then(|buffer| buffer.first(used)) else {
            return Err(damaged(format!(
                "the driver reports {used} bytes, more than buffer {} has",
                filled.index
            )));
        };
        if bytes.is_empty() {
            return Err(damaged("empty".to_owned()));
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

/// Copies a frame, without the row padding of raw formats.
fn copy_tight(
    pool: &mut FramePool,
    bytes: SharedBytes<'_>,
    info: &StreamInfo,
    bytes_per_line: u32,
) -> Result<FrameBytes, String> {
    let whole = bytes.len();
    let Some(expected) = info.format.frame_bytes(info.width, info.height) else {
        return copy_ranges(pool, bytes, std::iter::once(0..whole));
    };
    let height = info.height as usize;
    let row = expected.checked_div(height).unwrap_or(0);
    let stride = (bytes_per_line as usize).max(row);
    let needed = stride
        .saturating_mul(height.saturating_sub(1))
        .saturating_add(row);
    if needed > whole {
        return Err(format!(
            "{} {}×{} has {needed} bytes, found {whole}",
            info.format, info.width, info.height
        ));
    }
    if stride == row {
        return copy_ranges(pool, bytes, std::iter::once(0..needed));
    }
    let starts = (0..height).map(|line| line * stride);
    copy_ranges(pool, bytes, starts.map(|start| start..start + row))
}

/// Concatenates ranges of a buffer.
fn copy_ranges(
    pool: &mut FramePool,
    bytes: SharedBytes<'_>,
    mut ranges: impl Iterator<Item = Range<usize>>,
) -> Result<FrameBytes, String> {
    let mut is_complete = false;
    let copy = pool.fill(|to| is_complete = ranges.all(|range| bytes.append(range, to)));
    if is_complete {
        return Ok(copy);
    }
    Err(format!("a row exceeds its {} bytes", bytes.len()))
}

/// Requests a frame rate; adds a warning if the driver does not accept it.
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
            "requested {fps} frames/s, the camera delivers {chosen}"
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
    let mut modes: Vec<String> = device::modes(node)
        .iter()
        .map(ToString::to_string)
        .collect();
    if modes.is_empty() {
        modes.push("it lists none".to_owned());
    }
    Error::config(format!(
        "{identity} does not support {} {}×{}: it selects {} {}×{}",
        config.format,
        config.width,
        config.height,
        String::from_utf8_lossy(&chosen.fourcc).trim(),
        chosen.width,
        chosen.height
    ))
    .remedy(format!(
        "set one of its modes in the rig file: {}",
        modes.join(", ")
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
                Ok(ready) if ready.readable || ready.failed => match self.read_frame()? {
                    Some(frame) => return Ok(frame),
                    // An error without a frame: unplugged.
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
            device_error("cannot read the controls")
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
        // Fails for an unplugged camera; the descriptor is closed anyway.
        self.node.stop().ok();
    }
}

/// Opens a camera by its identity.
pub struct V4l2Opener {
    role: Role,
    config: CameraConfig,
    binder: Arc<CameraBinder>,
    root: SystemRoot,
    nodes: Arc<dyn VideoNodes>,
    busy_pauses: Vec<Duration>,
}

impl V4l2Opener {
    /// Opener of a camera on the kernel's nodes; `binder` is that of its rig.
    #[must_use]
    pub fn new(
        role: Role,
        config: CameraConfig,
        binder: Arc<CameraBinder>,
        root: SystemRoot,
    ) -> Self {
        Self::with_nodes(role, config, binder, root, Arc::new(KernelNodes))
    }

    /// Opener of a camera on `nodes`.
    #[must_use]
    pub fn with_nodes(
        role: Role,
        config: CameraConfig,
        binder: Arc<CameraBinder>,
        root: SystemRoot,
        nodes: Arc<dyn VideoNodes>,
    ) -> Self {
        Self {
            role,
            config,
            binder,
            root,
            nodes,
            busy_pauses: [50, 100, 200, 400].map(Duration::from_millis).to_vec(),
        }
    }

    /// Sets the pauses before retries while the device is busy, by default 0.75 s in total: it may
    /// be resuming, or a program may be releasing it.
    #[must_use]
    pub fn busy_pauses(mut self, pauses: Vec<Duration>) -> Self {
        self.busy_pauses = pauses;
        self
    }

    /// Scans the devices, probes the candidates, and binds.
    ///
    /// # Errors
    /// As [`CameraBinder::bind`].
    pub fn find(&self) -> Result<(VideoDevice, Vec<VideoDevice>)> {
        let mut devices = device::scan(&self.root)?;
        for candidate in &mut devices {
            if self.binder.is_candidate(self.role, candidate) {
                device::probe(candidate, self.nodes.as_ref(), &self.root);
            }
        }
        let bound = self.binder.bind(self.role, &devices)?.clone();
        Ok((bound, devices))
    }

    fn start(&self, device: &VideoDevice) -> Result<V4l2Source, StartError> {
        let mut pauses = self.busy_pauses.iter();
        loop {
            let attempt = self
                .nodes
                .open(&device.node)
                .map_err(failed_step("open"))
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
        let by_port = self.binder.is_bound_by_port(self.role);
        if let Some(port) = config.port.as_ref().filter(|_| by_port) {
            text += &format!(", port {port}");
        }
        text
    }

    fn open(&mut self) -> Result<Box<dyn FrameSource>> {
        let (bound, devices) = self.find()?;
        let source = self.start(&bound).map_err(|error| {
            let error = match error {
                StartError::Unsupported(error) => error,
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
#[path = "v4l2_test.rs"]
mod tests;
