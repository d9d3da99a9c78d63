//! Trait of the system calls on a video node.

use std::io;
use std::path::Path;
use std::time::Duration;

use super::v4l2_shared::SharedBytes;

/// Result of `VIDIOC_QUERYCAP`.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Capabilities {
    /// Kernel driver, `uvcvideo` for USB cameras.
    pub driver: String,
    /// Card name, at most 31 characters.
    pub card: String,
    /// Whether the node delivers images.
    pub video_capture: bool,
    /// Whether the node supports streaming with mapped buffers.
    pub streaming: bool,
}

/// Frame sizes of a pixel format, pixels.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FrameSize {
    /// Width and height.
    Discrete(u32, u32),
    /// Maximum width and height of a range.
    UpTo(u32, u32),
}

/// Frame interval, s, as a fraction.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Interval {
    /// Numerator.
    pub numerator: u32,
    /// Denominator.
    pub denominator: u32,
}

impl Interval {
    /// The interval of a frame rate (1/s), rounded to 0.001/s.
    #[must_use]
    pub fn from_fps(fps: f64) -> Self {
        let milli = (fps * 1000.0).round().clamp(1.0, 1e9) as u32;
        let common = greatest_common_divisor(milli, 1000);
        Self {
            numerator: 1000 / common,
            denominator: milli / common,
        }
    }

    /// Frame rate, 1/s.
    #[must_use]
    pub fn fps(self) -> Option<f64> {
        (self.numerator > 0 && self.denominator > 0)
            .then(|| f64::from(self.denominator) / f64::from(self.numerator))
    }
}

fn greatest_common_divisor(mut a: u32, mut b: u32) -> u32 {
    while b > 0 {
        (a, b) = (b, a % b);
    }
    a
}

/// Format selected by the driver.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Layout {
    /// Pixel format.
    pub fourcc: [u8; 4],
    /// Width in pixels.
    pub width: u32,
    /// Height in pixels.
    pub height: u32,
    /// Row stride, bytes; 0 for compressed formats.
    pub bytes_per_line: u32,
}

/// Result of waiting for a frame.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Readiness {
    /// A buffer can be dequeued.
    pub readable: bool,
    /// The node reports an error or a hang-up.
    pub failed: bool,
}

/// A buffer filled by the driver.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct FilledBuffer {
    /// Index of the buffer.
    pub index: u32,
    /// Payload size, bytes.
    pub bytes_used: u32,
    /// Driver's frame counter.
    pub sequence: u32,
    /// Whether the driver marked the payload as incomplete.
    pub damaged: bool,
    /// Capture time on `CLOCK_MONOTONIC`, ns; `None` for other clocks.
    pub time_ns: Option<u64>,
}

/// Range of a control.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ControlRange {
    /// Minimum.
    pub minimum: i32,
    /// Maximum.
    pub maximum: i32,
    /// Whether it is readable.
    pub readable: bool,
    /// Whether it is writable.
    pub writable: bool,
}

/// Request to a UVC extension unit.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ExtensionRequest {
    /// Writes the current value.
    Set,
    /// Reads the current value.
    Get,
}

/// System calls on an open video node. Errors have the kernel's errno.
///
/// Dropping a node unmaps its buffers and closes it.
#[allow(clippy::missing_errors_doc)]
pub trait VideoNode: Send {
    /// `VIDIOC_QUERYCAP`.
    fn capabilities(&mut self) -> io::Result<Capabilities>;
    /// `VIDIOC_ENUM_FMT`; `EINVAL` past the last one.
    fn pixel_format(&mut self, index: u32) -> io::Result<[u8; 4]>;
    /// `VIDIOC_ENUM_FRAMESIZES`; `EINVAL` past the last one.
    fn frame_size(&mut self, fourcc: [u8; 4], index: u32) -> io::Result<FrameSize>;
    /// `VIDIOC_ENUM_FRAMEINTERVALS`; `EINVAL` past the last one.
    fn frame_interval(
        &mut self,
        fourcc: [u8; 4],
        width: u32,
        height: u32,
        index: u32,
    ) -> io::Result<Interval>;
    /// `VIDIOC_S_FMT`; returns the format selected by the driver.
    fn set_format(&mut self, fourcc: [u8; 4], width: u32, height: u32) -> io::Result<Layout>;
    /// `VIDIOC_S_PARM`; returns the interval selected by the driver.
    fn set_interval(&mut self, interval: Interval) -> io::Result<Interval>;
    /// `VIDIOC_REQBUFS`, `VIDIOC_QUERYBUF` and `mmap`; returns the number of buffers.
    fn map_buffers(&mut self, count: u32) -> io::Result<u32>;
    /// Bytes of a buffer; `None` while queued.
    fn buffer(&self, index: u32) -> Option<SharedBytes<'_>>;
    /// `VIDIOC_QBUF`.
    fn enqueue(&mut self, index: u32) -> io::Result<()>;
    /// `VIDIOC_STREAMON`.
    fn start(&mut self) -> io::Result<()>;
    /// `VIDIOC_STREAMOFF`.
    fn stop(&mut self) -> io::Result<()>;
    /// `poll`, at most `timeout`; may return `EINTR`.
    fn wait(&mut self, timeout: Duration) -> io::Result<Readiness>;
    /// `VIDIOC_DQBUF`.
    fn dequeue(&mut self) -> io::Result<FilledBuffer>;
    /// `VIDIOC_QUERYCTRL`; `EINVAL` for an unsupported control.
    fn control_range(&mut self, id: u32) -> io::Result<ControlRange>;
    /// `VIDIOC_G_CTRL`.
    fn control(&mut self, id: u32) -> io::Result<i32>;
    /// `VIDIOC_S_CTRL`.
    fn set_control(&mut self, id: u32, value: i32) -> io::Result<()>;
    /// `UVCIOC_CTRL_QUERY`.
    fn extension_unit(
        &mut self,
        unit: u8,
        selector: u8,
        request: ExtensionRequest,
        data: &mut [u8],
    ) -> io::Result<()>;
    /// `CLOCK_MONOTONIC`, ns.
    fn now_ns(&self) -> u64;
}

/// Opens video nodes.
pub trait VideoNodes: Send + Sync {
    /// Opens the node at `path` for reading and writing, without blocking.
    ///
    /// # Errors
    /// The errno of the kernel.
    fn open(&self, path: &Path) -> io::Result<Box<dyn VideoNode>>;
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn intervals_are_reduced_fractions() {
        let of = |fps| {
            let interval = Interval::from_fps(fps);
            (interval.numerator, interval.denominator)
        };
        assert_eq!(of(25.0), (1, 25));
        assert_eq!(of(29.97), (100, 2997));
        assert_eq!(of(18.75), (4, 75));
        assert_eq!(Interval::from_fps(18.75).fps(), Some(18.75));
        assert_eq!(
            Interval {
                numerator: 0,
                denominator: 25
            }
            .fps(),
            None
        );
    }
}
