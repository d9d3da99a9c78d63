//! [`VideoNode`] on the kernel: ioctl, mmap and poll on `/dev/videoN`.
//!
//! Request numbers and structures are those of the `v4l` crate.

#![allow(unsafe_code)]

use std::fs::{File, OpenOptions};
use std::io;
use std::os::fd::AsRawFd as _;
use std::os::unix::fs::OpenOptionsExt as _;
use std::path::Path;
use std::ptr::{self, NonNull};
use std::time::Duration;

use v4l::v4l_sys as sys;
use v4l::v4l2;
use v4l::v4l2::vidioc;

use super::clock::monotonic_ns;
use super::v4l2_node::{
    Capabilities, ControlRange, ExtensionRequest, FilledBuffer, FrameSize, Interval, Layout,
    Readiness, VideoNode, VideoNodes,
};
use super::v4l2_shared::SharedBytes;

const CAPTURE: u32 = sys::v4l2_buf_type_V4L2_BUF_TYPE_VIDEO_CAPTURE;
const MMAP: u32 = sys::v4l2_memory_V4L2_MEMORY_MMAP;

/// Device nodes of the kernel.
#[derive(Clone, Copy, Debug, Default)]
pub struct KernelNodes;

impl VideoNodes for KernelNodes {
    fn open(&self, path: &Path) -> io::Result<Box<dyn VideoNode>> {
        let file = OpenOptions::new()
            .read(true)
            .write(true)
            .custom_flags(libc::O_NONBLOCK | libc::O_CLOEXEC)
            .open(path)?;
        Ok(Box::new(KernelNode {
            file,
            buffers: Vec::new(),
        }))
    }
}

/// A mapped buffer of the driver.
struct Mapping {
    start: NonNull<u8>,
    length: usize,
    queued: bool,
}

// SAFETY: the mapping belongs to the process, not to a thread, and is only reached through the
// node that owns it.
unsafe impl Send for Mapping {}

impl Drop for Mapping {
    fn drop(&mut self) {
        // SAFETY: `start` and `length` come from one successful mmap and are unmapped only here.
        unsafe { libc::munmap(self.start.as_ptr().cast(), self.length) };
    }
}

struct KernelNode {
    file: File,
    buffers: Vec<Mapping>,
}

/// `struct uvc_xu_control_query` of `linux/uvcvideo.h`.
#[repr(C)]
struct UvcControlQuery {
    unit: u8,
    selector: u8,
    query: u8,
    size: u16,
    data: *mut u8,
}

/// `_IOWR('u', 0x21, struct uvc_xu_control_query)`.
const UVCIOC_CTRL_QUERY: vidioc::_IOC_TYPE = (3 << 30)
    | ((size_of::<UvcControlQuery>() as vidioc::_IOC_TYPE) << 16)
    | ((b'u' as vidioc::_IOC_TYPE) << 8)
    | 0x21;

/// A structure of the V4L2 ABI that may be zeroed.
///
/// # Safety
/// Every field, and every member of a union, must have a valid value of zero bytes.
unsafe trait Zeroable: Copy {}

macro_rules! zeroable {
    ($($structure:ident)*) => {$(
        // SAFETY: linux/videodev2.h declares it with integers, arrays of integers, unions of them
        // and raw pointers; it has no reference, no function pointer and no Rust enum.
        unsafe impl Zeroable for sys::$structure {}
    )*};
}
zeroable! {
    v4l2_buffer v4l2_capability v4l2_captureparm v4l2_fmtdesc v4l2_format v4l2_frmivalenum
    v4l2_frmsizeenum v4l2_pix_format v4l2_queryctrl v4l2_requestbuffers v4l2_streamparm
}

fn zeroed<T: Zeroable>() -> T {
    // SAFETY: that is what `Zeroable` promises.
    unsafe { std::mem::zeroed() }
}

/// Time of a frame, ns.
fn time_ns(seconds: u64, microseconds: u64) -> u64 {
    seconds
        .saturating_mul(1_000_000_000)
        .saturating_add(microseconds.saturating_mul(1000))
}

fn text(bytes: &[u8]) -> String {
    let end = bytes.iter().position(|&b| b == 0).unwrap_or(bytes.len());
    String::from_utf8_lossy(&bytes[..end]).into_owned()
}

impl KernelNode {
    /// An ioctl, repeated after signals.
    ///
    /// # Safety
    /// `argument` must be the structure that the kernel expects with `request`.
    unsafe fn call<T>(&self, request: vidioc::_IOC_TYPE, argument: &mut T) -> io::Result<()> {
        loop {
            // SAFETY: the caller vouches for the pair of request and structure; the descriptor is
            // open and the exclusive borrow outlives the call.
            let result = unsafe {
                v4l2::ioctl(
                    self.file.as_raw_fd(),
                    request,
                    ptr::from_mut(argument).cast(),
                )
            };
            match result {
                Err(error) if error.raw_os_error() == Some(libc::EINTR) => {}
                other => return other,
            }
        }
    }

    fn describe_buffer(index: u32) -> sys::v4l2_buffer {
        let mut buffer: sys::v4l2_buffer = zeroed();
        buffer.type_ = CAPTURE;
        buffer.memory = MMAP;
        buffer.index = index;
        buffer
    }

    fn map(&self, index: u32) -> io::Result<Mapping> {
        let mut buffer = Self::describe_buffer(index);
        // SAFETY: VIDIOC_QUERYBUF carries a v4l2_buffer.
        unsafe { self.call(vidioc::VIDIOC_QUERYBUF, &mut buffer)? };
        let length = buffer.length as usize;
        // SAFETY: for V4L2_MEMORY_MMAP the kernel fills `offset`.
        let offset = unsafe { buffer.m.offset };
        // SAFETY: a fresh mapping at an address of the kernel's choice; length and offset are
        // those of VIDIOC_QUERYBUF.
        let start = unsafe {
            libc::mmap(
                ptr::null_mut(),
                length,
                libc::PROT_READ | libc::PROT_WRITE,
                libc::MAP_SHARED,
                self.file.as_raw_fd(),
                libc::off_t::from(offset),
            )
        };
        if start == libc::MAP_FAILED {
            return Err(io::Error::last_os_error());
        }
        let start = NonNull::new(start.cast()).ok_or(io::ErrorKind::OutOfMemory)?;
        Ok(Mapping {
            start,
            length,
            queued: false,
        })
    }
}

impl VideoNode for KernelNode {
    fn capabilities(&mut self) -> io::Result<Capabilities> {
        let mut found: sys::v4l2_capability = zeroed();
        // SAFETY: VIDIOC_QUERYCAP carries a v4l2_capability.
        unsafe { self.call(vidioc::VIDIOC_QUERYCAP, &mut found)? };
        let flags = if found.capabilities & sys::V4L2_CAP_DEVICE_CAPS == 0 {
            found.capabilities
        } else {
            found.device_caps
        };
        Ok(Capabilities {
            driver: text(&found.driver),
            card: text(&found.card),
            video_capture: flags & sys::V4L2_CAP_VIDEO_CAPTURE != 0,
            streaming: flags & sys::V4L2_CAP_STREAMING != 0,
        })
    }

    fn pixel_format(&mut self, index: u32) -> io::Result<[u8; 4]> {
        let mut found: sys::v4l2_fmtdesc = zeroed();
        found.type_ = CAPTURE;
        found.index = index;
        // SAFETY: VIDIOC_ENUM_FMT carries a v4l2_fmtdesc.
        unsafe { self.call(vidioc::VIDIOC_ENUM_FMT, &mut found)? };
        Ok(found.pixelformat.to_le_bytes())
    }

    fn frame_size(&mut self, fourcc: [u8; 4], index: u32) -> io::Result<FrameSize> {
        let mut found: sys::v4l2_frmsizeenum = zeroed();
        found.pixel_format = u32::from_le_bytes(fourcc);
        found.index = index;
        // SAFETY: VIDIOC_ENUM_FRAMESIZES carries a v4l2_frmsizeenum.
        unsafe { self.call(vidioc::VIDIOC_ENUM_FRAMESIZES, &mut found)? };
        // SAFETY: `type_` says which member of the union the kernel has filled.
        Ok(unsafe {
            if found.type_ == sys::v4l2_frmsizetypes_V4L2_FRMSIZE_TYPE_DISCRETE {
                let size = found.__bindgen_anon_1.discrete;
                FrameSize::Discrete(size.width, size.height)
            } else {
                let range = found.__bindgen_anon_1.stepwise;
                FrameSize::UpTo(range.max_width, range.max_height)
            }
        })
    }

    fn frame_interval(
        &mut self,
        fourcc: [u8; 4],
        width: u32,
        height: u32,
        index: u32,
    ) -> io::Result<Interval> {
        let mut found: sys::v4l2_frmivalenum = zeroed();
        found.pixel_format = u32::from_le_bytes(fourcc);
        found.width = width;
        found.height = height;
        found.index = index;
        // SAFETY: VIDIOC_ENUM_FRAMEINTERVALS carries a v4l2_frmivalenum.
        unsafe { self.call(vidioc::VIDIOC_ENUM_FRAMEINTERVALS, &mut found)? };
        // SAFETY: `type_` says which member of the union the kernel has filled.
        let interval = unsafe {
            if found.type_ == sys::v4l2_frmivaltypes_V4L2_FRMIVAL_TYPE_DISCRETE {
                found.__bindgen_anon_1.discrete
            } else {
                found.__bindgen_anon_1.stepwise.min
            }
        };
        Ok(Interval {
            numerator: interval.numerator,
            denominator: interval.denominator,
        })
    }

    fn set_format(&mut self, fourcc: [u8; 4], width: u32, height: u32) -> io::Result<Layout> {
        let mut format: sys::v4l2_format = zeroed();
        format.type_ = CAPTURE;
        let mut wanted: sys::v4l2_pix_format = zeroed();
        wanted.width = width;
        wanted.height = height;
        wanted.pixelformat = u32::from_le_bytes(fourcc);
        wanted.field = sys::v4l2_field_V4L2_FIELD_ANY;
        format.fmt.pix = wanted;
        // SAFETY: VIDIOC_S_FMT carries a v4l2_format.
        unsafe { self.call(vidioc::VIDIOC_S_FMT, &mut format)? };
        // SAFETY: for V4L2_BUF_TYPE_VIDEO_CAPTURE the kernel fills `pix`.
        let chosen = unsafe { format.fmt.pix };
        Ok(Layout {
            fourcc: chosen.pixelformat.to_le_bytes(),
            width: chosen.width,
            height: chosen.height,
            bytes_per_line: chosen.bytesperline,
        })
    }

    fn set_interval(&mut self, interval: Interval) -> io::Result<Interval> {
        let mut parameters: sys::v4l2_streamparm = zeroed();
        parameters.type_ = CAPTURE;
        let mut wanted: sys::v4l2_captureparm = zeroed();
        wanted.timeperframe = sys::v4l2_fract {
            numerator: interval.numerator,
            denominator: interval.denominator,
        };
        parameters.parm.capture = wanted;
        // SAFETY: VIDIOC_S_PARM carries a v4l2_streamparm.
        unsafe { self.call(vidioc::VIDIOC_S_PARM, &mut parameters)? };
        // SAFETY: for V4L2_BUF_TYPE_VIDEO_CAPTURE the kernel fills `capture`.
        let chosen = unsafe { parameters.parm.capture }.timeperframe;
        Ok(Interval {
            numerator: chosen.numerator,
            denominator: chosen.denominator,
        })
    }

    fn map_buffers(&mut self, count: u32) -> io::Result<u32> {
        let mut request: sys::v4l2_requestbuffers = zeroed();
        request.type_ = CAPTURE;
        request.memory = MMAP;
        request.count = count;
        // SAFETY: VIDIOC_REQBUFS carries a v4l2_requestbuffers.
        unsafe { self.call(vidioc::VIDIOC_REQBUFS, &mut request)? };
        self.buffers = (0..request.count)
            .map(|index| self.map(index))
            .collect::<io::Result<_>>()?;
        Ok(request.count)
    }

    fn buffer(&self, index: u32) -> Option<SharedBytes<'_>> {
        let mapping = self.buffers.get(index as usize).filter(|m| !m.queued)?;
        // SAFETY: the mapping is `length` bytes and readable as long as `self` lives.
        Some(unsafe { SharedBytes::new(mapping.start, mapping.length) })
    }

    fn enqueue(&mut self, index: u32) -> io::Result<()> {
        let mut buffer = Self::describe_buffer(index);
        // SAFETY: VIDIOC_QBUF carries a v4l2_buffer.
        unsafe { self.call(vidioc::VIDIOC_QBUF, &mut buffer)? };
        if let Some(mapping) = self.buffers.get_mut(index as usize) {
            mapping.queued = true;
        }
        Ok(())
    }

    fn start(&mut self) -> io::Result<()> {
        let mut kind = CAPTURE;
        // SAFETY: VIDIOC_STREAMON carries an int.
        unsafe { self.call(vidioc::VIDIOC_STREAMON, &mut kind) }
    }

    fn stop(&mut self) -> io::Result<()> {
        let mut kind = CAPTURE;
        // SAFETY: VIDIOC_STREAMOFF carries an int.
        unsafe { self.call(vidioc::VIDIOC_STREAMOFF, &mut kind) }
    }

    fn wait(&mut self, timeout: Duration) -> io::Result<Readiness> {
        let mut polled = libc::pollfd {
            fd: self.file.as_raw_fd(),
            events: libc::POLLIN,
            revents: 0,
        };
        let milliseconds = timeout.as_micros().div_ceil(1000).min(i32::MAX as u128) as i32;
        // SAFETY: one valid pollfd, count 1.
        if unsafe { libc::poll(&raw mut polled, 1, milliseconds) } < 0 {
            return Err(io::Error::last_os_error());
        }
        Ok(Readiness {
            readable: polled.revents & libc::POLLIN != 0,
            failed: polled.revents & (libc::POLLERR | libc::POLLHUP | libc::POLLNVAL) != 0,
        })
    }

    fn dequeue(&mut self) -> io::Result<FilledBuffer> {
        let mut buffer = Self::describe_buffer(0);
        // SAFETY: VIDIOC_DQBUF carries a v4l2_buffer.
        unsafe { self.call(vidioc::VIDIOC_DQBUF, &mut buffer)? };
        if let Some(mapping) = self.buffers.get_mut(buffer.index as usize) {
            mapping.queued = false;
        }
        let monotonic = buffer.flags & sys::V4L2_BUF_FLAG_TIMESTAMP_MASK
            == sys::V4L2_BUF_FLAG_TIMESTAMP_MONOTONIC;
        let seconds = u64::try_from(buffer.timestamp.tv_sec).ok();
        let microseconds = u64::try_from(buffer.timestamp.tv_usec).ok();
        Ok(FilledBuffer {
            index: buffer.index,
            bytes_used: buffer.bytesused,
            sequence: buffer.sequence,
            damaged: buffer.flags & sys::V4L2_BUF_FLAG_ERROR != 0,
            time_ns: seconds
                .zip(microseconds)
                .filter(|_| monotonic)
                .map(|(s, us)| time_ns(s, us)),
        })
    }

    fn control_range(&mut self, id: u32) -> io::Result<ControlRange> {
        let mut found: sys::v4l2_queryctrl = zeroed();
        found.id = id;
        // SAFETY: VIDIOC_QUERYCTRL carries a v4l2_queryctrl.
        unsafe { self.call(vidioc::VIDIOC_QUERYCTRL, &mut found)? };
        if found.flags & sys::V4L2_CTRL_FLAG_DISABLED != 0 {
            return Err(io::Error::from_raw_os_error(libc::EINVAL));
        }
        Ok(ControlRange {
            minimum: found.minimum,
            maximum: found.maximum,
            readable: found.flags & sys::V4L2_CTRL_FLAG_WRITE_ONLY == 0,
            writable: found.flags & sys::V4L2_CTRL_FLAG_READ_ONLY == 0,
        })
    }

    fn control(&mut self, id: u32) -> io::Result<i32> {
        let mut control = sys::v4l2_control { id, value: 0 };
        // SAFETY: VIDIOC_G_CTRL carries a v4l2_control.
        unsafe { self.call(vidioc::VIDIOC_G_CTRL, &mut control)? };
        Ok(control.value)
    }

    fn set_control(&mut self, id: u32, value: i32) -> io::Result<()> {
        let mut control = sys::v4l2_control { id, value };
        // SAFETY: VIDIOC_S_CTRL carries a v4l2_control.
        unsafe { self.call(vidioc::VIDIOC_S_CTRL, &mut control) }
    }

    fn extension_unit(
        &mut self,
        unit: u8,
        selector: u8,
        request: ExtensionRequest,
        data: &mut [u8],
    ) -> io::Result<()> {
        let size = u16::try_from(data.len()).map_err(|_| io::ErrorKind::InvalidInput)?;
        let mut query = UvcControlQuery {
            unit,
            selector,
            query: match request {
                ExtensionRequest::Set => 0x01,
                ExtensionRequest::Get => 0x81,
            },
            size,
            data: data.as_mut_ptr(),
        };
        // SAFETY: UVCIOC_CTRL_QUERY carries this structure; `data` is valid for `size` bytes, for
        // reading and writing, until the call returns.
        unsafe { self.call(UVCIOC_CTRL_QUERY, &mut query) }
    }

    fn now_ns(&self) -> u64 {
        monotonic_ns()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn request_number_matches_the_kernel_header() {
        assert_eq!(UVCIOC_CTRL_QUERY, 0xc010_7521);
    }

    #[test]
    fn plain_file_is_not_a_video_node() {
        let file = tempfile::NamedTempFile::new().unwrap();
        let mut node = KernelNodes.open(file.path()).unwrap();
        let not_a_device = |e: io::Error| e.raw_os_error() == Some(libc::ENOTTY);
        assert!(node.capabilities().is_err_and(not_a_device));
        assert!(node.pixel_format(0).is_err_and(not_a_device));
        assert!(node.map_buffers(4).is_err_and(not_a_device));
        assert!(node.control(0x0098_0900).is_err_and(not_a_device));
        assert!(
            node.extension_unit(3, 1, ExtensionRequest::Get, &mut [0; 4])
                .is_err_and(not_a_device)
        );
        assert!(node.buffer(0).is_none());
        assert!(node.now_ns() > 0);
    }

    #[test]
    fn invalid_times_saturate() {
        assert_eq!(time_ns(2, 500_000), 2_500_000_000);
        assert_eq!(time_ns(0, i64::MAX as u64), u64::MAX);
        assert_eq!(time_ns(u64::MAX, 1), u64::MAX);
    }

    #[test]
    fn structures_are_zeroed() {
        let buffer: sys::v4l2_buffer = zeroed();
        assert_eq!((buffer.index, buffer.length, buffer.flags), (0, 0, 0));
        let found: sys::v4l2_capability = zeroed();
        assert_eq!(text(&found.card), "");
    }

    #[test]
    fn kernel_strings_are_truncated_safely() {
        assert_eq!(text(b"uvcvideo\0\0\0"), "uvcvideo");
        assert_eq!(text(&[b'a', 0xc3]), "a\u{fffd}");
    }
}
