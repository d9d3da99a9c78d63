//! A scripted video node.

use std::collections::{BTreeMap, VecDeque};
use std::io;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, MutexGuard};
use std::time::Duration;

use super::v4l2_node::{
    Capabilities, ControlRange, ExtensionRequest, FilledBuffer, FrameSize, Interval, Layout,
    Readiness, VideoNode, VideoNodes,
};
use super::v4l2_shared::SharedBytes;

/// Next event on the queue of a fake node.
#[derive(Clone, Debug)]
pub(crate) enum Event {
    /// A frame: sequence, payload, damaged flag; 40 ms after its predecessor.
    Frame(u32, Vec<u8>, bool),
    /// No events for a time.
    Silence(Duration),
    /// A signal interrupts the wait.
    Signal,
    /// Ready without a frame: `EAGAIN`.
    Nothing,
    /// The device is unplugged: every call fails with `ENODEV`.
    Unplug,
    /// The node hangs up without a frame: `EAGAIN` with `POLLERR`.
    HangUp,
    /// Dequeueing fails with this errno.
    Fault(i32),
}

/// State of a fake camera.
#[derive(Debug)]
pub(crate) struct Camera {
    pub(crate) video_capture: bool,
    pub(crate) modes: Vec<([u8; 4], u32, u32, Vec<u32>)>,
    /// Bytes per row beyond the pixels.
    pub(crate) padding: u32,
    pub(crate) controls: BTreeMap<u32, (i32, i32, i32)>,
    /// Controls that ignore the value set.
    pub(crate) stubborn: Vec<u32>,
    pub(crate) events: VecDeque<Event>,
    /// Errors of the next opens.
    pub(crate) open_faults: VecDeque<i32>,
    /// Errors of the next starts.
    pub(crate) start_faults: VecDeque<i32>,
    /// Offset of the driver's time stamps, ns; `None`: not monotonic.
    pub(crate) stamp_offset_ns: Option<i64>,
    /// Replies of the extension unit.
    pub(crate) extension: Vec<u8>,
    pub(crate) extension_set: Vec<u8>,
    pub(crate) now_ns: u64,
    pub(crate) queued: Vec<bool>,
    pub(crate) streaming: bool,
    pub(crate) opened: u32,
    pub(crate) stopped: u32,
    pub(crate) control_log: Vec<u32>,
}

impl Default for Camera {
    fn default() -> Self {
        Self {
            video_capture: true,
            modes: vec![(*b"MJPG", 3280, 2464, vec![25])],
            padding: 0,
            controls: BTreeMap::new(),
            stubborn: Vec::new(),
            events: VecDeque::new(),
            open_faults: VecDeque::new(),
            start_faults: VecDeque::new(),
            stamp_offset_ns: Some(0),
            extension: Vec::new(),
            extension_set: Vec::new(),
            now_ns: 1_000_000_000,
            queued: Vec::new(),
            streaming: false,
            opened: 0,
            stopped: 0,
            control_log: Vec::new(),
        }
    }
}

impl Camera {
    /// A metadata node.
    pub(crate) fn metadata() -> Self {
        Self {
            video_capture: false,
            ..Self::default()
        }
    }

    /// A camera with these modes: format, width, height, rates in 1/s.
    pub(crate) fn with_modes(modes: &[([u8; 4], u32, u32, Vec<u32>)]) -> Self {
        Self {
            modes: modes.to_vec(),
            ..Self::default()
        }
    }

    /// A camera with one small raw mode and these events on its queue.
    pub(crate) fn yuyv_4x2(events: impl IntoIterator<Item = Event>) -> Self {
        Self {
            events: events.into_iter().collect(),
            ..Self::with_modes(&[(*b"YUYV", 4, 2, vec![25])])
        }
    }
}

/// Fake nodes by path.
#[derive(Clone, Debug, Default)]
pub(crate) struct FakeNodes(Arc<Mutex<BTreeMap<PathBuf, Arc<Mutex<Camera>>>>>);

impl FakeNodes {
    /// Adds a camera at a path; returns its shared state.
    pub(crate) fn insert(&self, path: impl Into<PathBuf>, camera: Camera) -> Arc<Mutex<Camera>> {
        let shared = Arc::new(Mutex::new(camera));
        self.0.lock().unwrap().insert(path.into(), shared.clone());
        shared
    }
}

impl VideoNodes for FakeNodes {
    fn open(&self, path: &Path) -> io::Result<Box<dyn VideoNode>> {
        let camera = self.0.lock().unwrap().get(path).cloned();
        let camera = camera.ok_or_else(|| errno(libc::ENOENT))?;
        let mut state = camera.lock().unwrap();
        state.opened += 1;
        if let Some(fault) = state.open_faults.pop_front() {
            return Err(errno(fault));
        }
        drop(state);
        Ok(Box::new(FakeNode {
            camera,
            buffers: Vec::new(),
        }))
    }
}

pub(crate) struct FakeNode {
    camera: Arc<Mutex<Camera>>,
    buffers: Vec<Vec<u8>>,
}

fn errno(code: i32) -> io::Error {
    io::Error::from_raw_os_error(code)
}

impl FakeNode {
    /// The camera, or `ENODEV` once it is unplugged.
    fn present(&self) -> io::Result<MutexGuard<'_, Camera>> {
        let camera = self.camera.lock().unwrap();
        if matches!(camera.events.front(), Some(Event::Unplug)) {
            return Err(errno(libc::ENODEV));
        }
        Ok(camera)
    }
}

impl VideoNode for FakeNode {
    fn capabilities(&mut self) -> io::Result<Capabilities> {
        Ok(Capabilities {
            driver: "fake".into(),
            card: "fake".into(),
            video_capture: self.camera.lock().unwrap().video_capture,
            streaming: true,
        })
    }

    fn pixel_format(&mut self, index: u32) -> io::Result<[u8; 4]> {
        let mut formats: Vec<[u8; 4]> = Vec::new();
        for mode in &self.camera.lock().unwrap().modes {
            if !formats.contains(&mode.0) {
                formats.push(mode.0);
            }
        }
        formats
            .get(index as usize)
            .copied()
            .ok_or_else(|| errno(libc::EINVAL))
    }

    fn frame_size(&mut self, fourcc: [u8; 4], index: u32) -> io::Result<FrameSize> {
        let camera = self.camera.lock().unwrap();
        let found = camera
            .modes
            .iter()
            .filter(|m| m.0 == fourcc)
            .nth(index as usize);
        found
            .map(|m| FrameSize::Discrete(m.1, m.2))
            .ok_or_else(|| errno(libc::EINVAL))
    }

    fn frame_interval(
        &mut self,
        fourcc: [u8; 4],
        width: u32,
        height: u32,
        index: u32,
    ) -> io::Result<Interval> {
        let camera = self.camera.lock().unwrap();
        let found = camera
            .modes
            .iter()
            .find(|m| (m.0, m.1, m.2) == (fourcc, width, height));
        found
            .and_then(|m| m.3.get(index as usize))
            .map(|&fps| Interval {
                numerator: 1,
                denominator: fps,
            })
            .ok_or_else(|| errno(libc::EINVAL))
    }

    fn set_format(&mut self, fourcc: [u8; 4], width: u32, height: u32) -> io::Result<Layout> {
        let camera = self.present()?;
        // Like the GelSight Mini: accepts any mode, but keeps the first.
        let chosen = camera
            .modes
            .iter()
            .find(|m| (m.0, m.1, m.2) == (fourcc, width, height))
            .or(camera.modes.first())
            .ok_or_else(|| errno(libc::EINVAL))?;
        let row = if chosen.0 == *b"MJPG" {
            0
        } else {
            chosen.1 * 2
        };
        Ok(Layout {
            fourcc: chosen.0,
            width: chosen.1,
            height: chosen.2,
            bytes_per_line: row + camera.padding,
        })
    }

    fn set_interval(&mut self, _interval: Interval) -> io::Result<Interval> {
        let camera = self.present()?;
        Ok(Interval {
            numerator: 1,
            denominator: camera.modes[0].3[0],
        })
    }

    fn map_buffers(&mut self, count: u32) -> io::Result<u32> {
        self.buffers = vec![vec![0; 4096]; count as usize];
        self.present()?.queued = vec![false; count as usize];
        Ok(count)
    }

    fn buffer(&self, index: u32) -> Option<SharedBytes<'_>> {
        let queued = self.camera.lock().unwrap().queued[index as usize];
        assert!(!queued, "buffer {index} belongs to the driver");
        let bytes = self.buffers.get(index as usize)?;
        Some(SharedBytes::from(&**bytes))
    }

    fn enqueue(&mut self, index: u32) -> io::Result<()> {
        let mut camera = self.present()?;
        let slot = &mut camera.queued[index as usize];
        assert!(!*slot, "buffer {index} queued twice");
        *slot = true;
        Ok(())
    }

    fn start(&mut self) -> io::Result<()> {
        let mut camera = self.present()?;
        if let Some(fault) = camera.start_faults.pop_front() {
            return Err(errno(fault));
        }
        camera.streaming = true;
        Ok(())
    }

    fn stop(&mut self) -> io::Result<()> {
        let mut camera = self.camera.lock().unwrap();
        camera.stopped += 1;
        camera.streaming = false;
        if matches!(camera.events.front(), Some(Event::Unplug)) {
            return Err(errno(libc::ENODEV));
        }
        Ok(())
    }

    fn wait(&mut self, timeout: Duration) -> io::Result<Readiness> {
        let mut camera = self.camera.lock().unwrap();
        let timeout_ns = timeout.as_nanos() as u64;
        let mut readiness = Readiness::default();
        match camera.events.front_mut() {
            None => camera.now_ns += timeout_ns,
            Some(Event::Silence(left)) => {
                let pause = timeout.min(*left);
                *left -= pause;
                if left.is_zero() {
                    camera.events.pop_front();
                }
                camera.now_ns += pause.as_nanos() as u64;
            }
            Some(Event::Signal) => {
                camera.events.pop_front();
                return Err(errno(libc::EINTR));
            }
            Some(Event::Unplug | Event::HangUp) => readiness.failed = true,
            Some(Event::Frame(..) | Event::Nothing | Event::Fault(_)) => readiness.readable = true,
        }
        Ok(readiness)
    }

    fn dequeue(&mut self) -> io::Result<FilledBuffer> {
        let mut camera = self.present()?;
        assert!(camera.streaming, "dequeue before start");
        let index = camera
            .queued
            .iter()
            .position(|&q| q)
            .expect("no buffer queued");
        match camera.events.pop_front() {
            Some(Event::Frame(sequence, payload, damaged)) => {
                camera.now_ns += 40_000_000;
                camera.queued[index] = false;
                let time_ns = camera
                    .stamp_offset_ns
                    .map(|offset| camera.now_ns.saturating_add_signed(offset));
                drop(camera);
                self.buffers[index][..payload.len()].copy_from_slice(&payload);
                Ok(FilledBuffer {
                    index: index as u32,
                    bytes_used: payload.len() as u32,
                    sequence,
                    damaged,
                    time_ns,
                })
            }
            Some(Event::Fault(code)) => Err(errno(code)),
            _ => Err(errno(libc::EAGAIN)),
        }
    }

    fn control_range(&mut self, id: u32) -> io::Result<ControlRange> {
        let camera = self.present()?;
        let (minimum, maximum, _) = camera
            .controls
            .get(&id)
            .ok_or_else(|| errno(libc::EINVAL))?;
        Ok(ControlRange {
            minimum: *minimum,
            maximum: *maximum,
            readable: true,
            writable: true,
        })
    }

    fn control(&mut self, id: u32) -> io::Result<i32> {
        let camera = self.present()?;
        camera
            .controls
            .get(&id)
            .map(|c| c.2)
            .ok_or_else(|| errno(libc::EINVAL))
    }

    fn set_control(&mut self, id: u32, value: i32) -> io::Result<()> {
        let mut camera = self.present()?;
        camera.control_log.push(id);
        let stubborn = camera.stubborn.contains(&id);
        let control = camera
            .controls
            .get_mut(&id)
            .ok_or_else(|| errno(libc::EINVAL))?;
        if !stubborn {
            control.2 = value;
        }
        Ok(())
    }

    fn extension_unit(
        &mut self,
        _unit: u8,
        _selector: u8,
        request: ExtensionRequest,
        data: &mut [u8],
    ) -> io::Result<()> {
        let mut camera = self.present()?;
        match request {
            ExtensionRequest::Set => camera.extension_set = data.to_vec(),
            ExtensionRequest::Get => data.copy_from_slice(&camera.extension),
        }
        Ok(())
    }

    fn now_ns(&self) -> u64 {
        self.camera.lock().unwrap().now_ns
    }
}
