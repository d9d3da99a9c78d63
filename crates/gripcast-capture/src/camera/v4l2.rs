//! Real cameras through V4L2: configuring, streaming, and opening by identity.
//!
//! A frame is copied out of the driver's buffer and the buffer handed back at once, so that a
//! slow consumer never starves the driver. uvcvideo drops a frame that the camera marked as bad
//! and leaves a gap in the sequence; a truncated JPEG arrives like any other and is recognised
//! when it is decoded. Two frames may come in the wrong order (their sequence numbers tell).

use std::io;
use std::ops::Range;
use std::sync::Arc;
use std::thread;
use std::time::Duration;

use super::CameraIdentity;
use super::source::{CameraOpener, CaptureError, ControlValues, FrameSource, StreamInfo};
use super::v4l2_controls as controls;
use super::v4l2_ioctl::KernelNodes;
use super::v4l2_node::{Filled, Interval, Layout, VideoNode, VideoNodes};
use super::v4l2_shared::SharedBytes;
use crate::calibration::CameraConfig;
use crate::device::{self, SystemRoot, VideoDevice};
use gripcast_base::error::{Error, ErrorKind, Result};
use gripcast_imaging::{Frame, FrameBytes, FramePool, Role};

/// Buffers that are asked for; at 30/s they bridge a pause of 0.2 s on our side.
const BUFFERS: u32 = 6;
/// Fewer than this and the driver has none to fill while we hold one.
const BUFFERS_NEEDED: u32 = 2;
/// A driver's time further than this from now comes from a broken clock, ns.
const CLOCK_TOLERANCE_NS: u64 = 5_000_000_000;
/// Fraction by which the driver's frame rate may differ from the wanted one unremarked.
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
        let buffer = self.node.buffer(filled.index);
        let Some(bytes) = buffer.and_then(|buffer| buffer.first(used)) else {
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
    bytes: SharedBytes<'_>,
    info: &StreamInfo,
    bytes_per_line: u32,
) -> Result<FrameBytes, String> {
    let whole = bytes.len();
    let Some(expected) = info.format.frame_bytes(info.width, info.height) else {
        return copied(pool, bytes, std::iter::once(0..whole));
    };
    let height = info.height as usize;
    let row = expected.checked_div(height).unwrap_or(0);
    let stride = (bytes_per_line as usize).max(row);
    let needed = stride
        .saturating_mul(height.saturating_sub(1))
        .saturating_add(row);
    if needed > whole {
        return Err(format!(
            "{} {}×{} needs {needed} bytes, {whole} came",
            info.format, info.width, info.height
        ));
    }
    if stride == row {
        return copied(pool, bytes, std::iter::once(0..needed));
    }
    let starts = (0..height).map(|line| line * stride);
    copied(pool, bytes, starts.map(|start| start..start + row))
}

/// Copies parts of a buffer, one after the other.
fn copied(
    pool: &mut FramePool,
    bytes: SharedBytes<'_>,
    mut parts: impl Iterator<Item = Range<usize>>,
) -> Result<FrameBytes, String> {
    let mut complete = false;
    let copy = pool.fill(|to| complete = parts.all(|part| bytes.append(part, to)));
    if complete {
        return Ok(copy);
    }
    Err(format!("a row reaches beyond its {} bytes", bytes.len()))
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
    Error::config(format!(
        "{identity} does not deliver {} {}×{}: it stays at {} {}×{}",
        config.format,
        config.width,
        config.height,
        String::from_utf8_lossy(&chosen.fourcc).trim(),
        chosen.width,
        chosen.height
    ))
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
#[path = "v4l2_test.rs"]
mod tests;
