//! The newest frames of every camera, shared by capture, decoding, inference and storage.
//!
//! Writers never wait for readers: a slow reader misses previews, never frames of a trigger.

use std::collections::{BTreeMap, VecDeque};
use std::sync::{Arc, Condvar, Mutex};
use std::time::Duration;

use image::RgbImage;

use super::black_box::Tap;
use super::thread::{lock, wait_while};
use gripcast_capture::camera::{
    CameraCounters, CameraState, ControlValues, FrameQuality, Health, StreamInfo,
};
use gripcast_imaging::{Depth, Frame, PixelFormat, Role};

/// Frames kept per camera: 0.3 s at 25/s, enough to pair cameras of different frame rates.
const RING_FRAMES: usize = 8;

/// Whether a frame can be displayed and saved.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Validity {
    /// Compressed and not decoded yet.
    Unknown,
    /// Complete: raw of the expected size, or decoded without error.
    Valid,
}

#[derive(Debug)]
struct RingFrame {
    frame: Frame,
    validity: Validity,
}

/// A frame that was decoded for inference and preview.
#[derive(Clone, Debug)]
pub(super) struct Decoded {
    /// Cropped and scaled image.
    pub image: Arc<RgbImage>,
    /// Depth image of a depth camera.
    pub depth: Option<Arc<Depth>>,
    /// Driver time of its frame, ns.
    pub driver_time_ns: u64,
    /// Number of this decoded frame, counted per camera.
    pub serial: u64,
}

/// Health, counters and stream of one camera.
#[derive(Debug)]
pub(super) struct CameraInfo {
    /// Health of the stream, determined by the supervisor.
    pub health: Health,
    /// Quality of the stream's frames.
    pub quality: FrameQuality,
    /// Counters of the supervisor.
    pub counters: CameraCounters,
    /// Frames whose entropy-coded data failed to decode.
    pub damaged_when_decoded: u64,
    /// Frames skipped because the decoder was busy.
    pub not_decoded: u64,
    /// Measured frame rate, 1/s.
    pub measured_fps: f64,
    /// The stream, once opened.
    pub stream: Option<StreamInfo>,
    /// Control values read back when the camera was last opened.
    pub controls: ControlValues,
    /// Settings of the rig file that the camera did not apply.
    pub warnings: Vec<String>,
}

/// Maximum size of the frames that a camera keeps, bytes.
const MAX_KEPT_BYTES: usize = 256 << 20;

/// Frames of a span of time.
#[derive(Debug)]
struct KeptFrames {
    /// First and last driver time, ns.
    span_ns: std::ops::RangeInclusive<u64>,
    frames: Vec<Frame>,
    bytes: usize,
}

impl KeptFrames {
    fn add(&mut self, frame: &Frame) {
        let bytes = self.bytes + frame.data.len();
        if self.span_ns.contains(&frame.driver_time_ns) && bytes <= MAX_KEPT_BYTES {
            self.bytes = bytes;
            self.frames.push(frame.clone());
        }
    }
}

#[derive(Debug)]
struct SlotState {
    ring: VecDeque<RingFrame>,
    info: CameraInfo,
    decoded: Option<Decoded>,
    /// Frames to keep, if any.
    kept: Option<KeptFrames>,
    /// Driver time and sequence of the newest frame handed to the decoder.
    last_taken: Option<(u64, u32)>,
    closed: bool,
}

/// Frames and state of one camera in the hub.
#[derive(Debug)]
pub(super) struct CameraSlot {
    /// Role of the camera.
    pub(super) role: Role,
    tap: Tap,
    state: Mutex<SlotState>,
    arrived: Condvar,
}

impl CameraSlot {
    fn new(role: Role, tap: Tap) -> Self {
        Self {
            role,
            tap,
            state: Mutex::new(SlotState {
                ring: VecDeque::with_capacity(RING_FRAMES),
                info: CameraInfo {
                    health: Health::Opening,
                    quality: FrameQuality::default(),
                    counters: CameraCounters::default(),
                    damaged_when_decoded: 0,
                    not_decoded: 0,
                    measured_fps: 0.0,
                    stream: None,
                    controls: ControlValues::new(),
                    warnings: Vec::new(),
                },
                decoded: None,
                kept: None,
                last_taken: None,
                closed: false,
            }),
            arrived: Condvar::new(),
        }
    }

    /// Reads or updates the camera's health, counters and stream.
    pub(super) fn with_info<T>(&self, f: impl FnOnce(&mut CameraInfo) -> T) -> T {
        f(&mut lock(&self.state).info)
    }

    /// Judges the camera.
    pub(super) fn camera_state(&self, now_ns: u64) -> CameraState {
        self.with_info(|info| CameraState::judge(&info.health, &info.quality, now_ns))
    }

    /// Starts a new stream and drops the frames of the previous one.
    pub(super) fn on_opened(
        &self,
        stream: StreamInfo,
        controls: ControlValues,
        warnings: Vec<String>,
    ) {
        let mut state = lock(&self.state);
        state.ring.clear();
        state.last_taken = None;
        state.info.quality = FrameQuality::default();
        state.info.stream = Some(stream);
        state.info.controls = controls;
        state.info.warnings = warnings;
    }

    /// Drops all frames, so that no stale frame of a disconnected camera is saved.
    pub(super) fn clear_frames(&self) {
        let mut state = lock(&self.state);
        state.ring.clear();
        state.last_taken = None;
        state.decoded = None;
    }

    /// Adds a captured frame.
    pub(super) fn push(&self, frame: Frame) {
        self.tap.frame(self.role, &frame);
        let mut state = lock(&self.state);
        if let Some(kept) = &mut state.kept {
            kept.add(&frame);
        }
        state.info.quality.arrived();
        make_room(&mut state.ring);
        let validity = match frame.format {
            PixelFormat::Mjpg => Validity::Unknown,
            _ => Validity::Valid,
        };
        insert(&mut state.ring, RingFrame { frame, validity });
        drop(state);
        self.arrived.notify_all();
    }

    /// Keeps all frames of this span of driver times (ns) that arrive from now on, up to 256 MB.
    pub(super) fn keep_frames(&self, span_ns: std::ops::RangeInclusive<u64>) {
        lock(&self.state).kept = Some(KeptFrames {
            span_ns,
            frames: Vec::new(),
            bytes: 0,
        });
    }

    /// Stops keeping frames and returns them, by arrival.
    pub(super) fn take_kept_frames(&self) -> Vec<Frame> {
        let kept = lock(&self.state).kept.take();
        kept.map_or_else(Vec::new, |kept| kept.frames)
    }

    /// Waits for a frame newer than the last one taken; `None` after `timeout` or when closed.
    /// Skipped frames are counted.
    pub(super) fn take_newest(&self, timeout: Duration) -> Option<Frame> {
        let fresh = |state: &SlotState| {
            let newest = key(&state.ring.back()?.frame);
            (state.last_taken != Some(newest)).then_some(newest)
        };
        let is_waiting = |state: &mut SlotState| !state.closed && fresh(state).is_none();
        let mut state = wait_while(&self.arrived, lock(&self.state), timeout, is_waiting);
        if state.closed {
            return None;
        }
        let newest = fresh(&state)?;
        if let Some((before, _)) = state.last_taken {
            let between = state
                .ring
                .iter()
                .filter(|entry| entry.frame.driver_time_ns > before)
                .count();
            state.info.not_decoded += between.saturating_sub(1) as u64;
        }
        state.last_taken = Some(newest);
        state.ring.back().map(|entry| entry.frame.clone())
    }

    /// Stores a decoded image and marks its frame as valid.
    pub(super) fn on_decoded(&self, frame: &Frame, image: RgbImage, depth: Option<Depth>) {
        let mut state = lock(&self.state);
        let serial = state.decoded.as_ref().map_or(0, |d| d.serial) + 1;
        state.decoded = Some(Decoded {
            image: Arc::new(image),
            depth: depth.map(Arc::new),
            driver_time_ns: frame.driver_time_ns,
            serial,
        });
        state.info.quality.decoded();
        mark_valid(&mut state, frame);
    }

    /// Counts a frame that is damaged for this reason and removes it from the ring.
    pub(super) fn on_damaged(&self, frame: &Frame, reason: String) {
        let mut state = lock(&self.state);
        state.info.damaged_when_decoded += 1;
        state.info.quality.undecodable(reason);
        state.ring.retain(|entry| key(&entry.frame) != key(frame));
    }

    /// Returns the newest decoded image.
    pub(super) fn latest(&self) -> Option<Decoded> {
        lock(&self.state).decoded.clone()
    }

    /// Returns the frames in the ring, oldest first.
    #[cfg(test)]
    fn frames(&self) -> Vec<(Frame, Validity)> {
        lock(&self.state)
            .ring
            .iter()
            .map(|entry| (entry.frame.clone(), entry.validity))
            .collect()
    }

    /// Returns the frames that can be saved, oldest first.
    pub(super) fn valid_frames(&self) -> Vec<Frame> {
        let state = lock(&self.state);
        let sound = state.ring.iter().filter(|h| h.validity == Validity::Valid);
        sound.map(|entry| entry.frame.clone()).collect()
    }

    /// Returns the driver time of the newest frame, ns.
    pub(super) fn newest_time_ns(&self) -> Option<u64> {
        lock(&self.state)
            .ring
            .back()
            .map(|entry| entry.frame.driver_time_ns)
    }

    /// Returns whether the hub is closed.
    pub(super) fn is_closed(&self) -> bool {
        lock(&self.state).closed
    }

    /// Waits for `pause`, or until the hub is closed.
    pub(super) fn wait_closed(&self, pause: Duration) {
        drop(wait_while(
            &self.arrived,
            lock(&self.state),
            pause,
            |state| !state.closed,
        ));
    }

    fn close(&self) {
        lock(&self.state).closed = true;
        self.arrived.notify_all();
    }
}

fn key(frame: &Frame) -> (u64, u32) {
    (frame.driver_time_ns, frame.sequence)
}

/// Inserts a frame in order of driver time: drivers may deliver frames out of order.
fn insert(ring: &mut VecDeque<RingFrame>, new: RingFrame) {
    let index = ring
        .iter()
        .rposition(|entry| entry.frame.driver_time_ns <= new.frame.driver_time_ns)
        .map_or(0, |i| i + 1);
    ring.insert(index, new);
}

/// Drops the oldest frame of a full ring, but never the newest valid one, so that a slow decoder
/// does not leave a live camera without a frame to save.
fn make_room(ring: &mut VecDeque<RingFrame>) {
    if ring.len() < RING_FRAMES {
        return;
    }
    let keep = ring
        .iter()
        .rposition(|entry| entry.validity == Validity::Valid);
    ring.remove(usize::from(keep == Some(0)));
}

fn mark_valid(state: &mut SlotState, frame: &Frame) {
    if let Some(entry) = state
        .ring
        .iter_mut()
        .find(|entry| key(&entry.frame) == key(frame))
    {
        entry.validity = Validity::Valid;
    } else if state.last_taken == Some(key(frame)) {
        // Newer frames of the same stream displaced it during decoding.
        make_room(&mut state.ring);
        let (frame, validity) = (frame.clone(), Validity::Valid);
        insert(&mut state.ring, RingFrame { frame, validity });
    }
}

/// All cameras of the rig.
#[derive(Clone, Debug)]
pub(super) struct Hub {
    slots: Arc<BTreeMap<Role, Arc<CameraSlot>>>,
    /// Input of the black box.
    pub(super) tap: Tap,
}

impl Hub {
    /// Creates a hub for these cameras; their frames also go to `tap`.
    pub(super) fn new(roles: impl IntoIterator<Item = Role>, tap: Tap) -> Self {
        let slots = roles
            .into_iter()
            .map(|role| (role, Arc::new(CameraSlot::new(role, tap.clone()))))
            .collect();
        Self {
            slots: Arc::new(slots),
            tap,
        }
    }

    /// Returns the slot of a camera.
    pub(super) fn slot(&self, role: Role) -> Option<&Arc<CameraSlot>> {
        self.slots.get(&role)
    }

    /// Iterates over all cameras in the order of [`Role::ALL`].
    pub(super) fn slots(&self) -> impl Iterator<Item = &Arc<CameraSlot>> {
        self.slots.values()
    }

    /// Closes all slots and wakes their readers.
    pub(super) fn close(&self) {
        for slot in self.slots() {
            slot.close();
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn frame(sequence: u32, format: PixelFormat) -> Frame {
        Frame {
            format,
            width: 2,
            height: 1,
            data: vec![0; 4].into(),
            sequence,
            driver_time_ns: u64::from(sequence) * 40_000_000,
            received_ns: 0,
        }
    }

    fn slot() -> Arc<CameraSlot> {
        Arc::clone(
            Hub::new([Role::Left], Tap::default())
                .slot(Role::Left)
                .unwrap(),
        )
    }

    #[test]
    fn ring_keeps_newest_frames() {
        let slot = slot();
        for sequence in 0..20 {
            slot.push(frame(sequence, PixelFormat::Yuyv));
        }
        let kept: Vec<u32> = slot.frames().iter().map(|(f, _)| f.sequence).collect();
        assert_eq!(kept, (12..20).collect::<Vec<_>>());
    }

    #[test]
    fn late_reader_gets_newest_frame_and_skips_are_counted() {
        let slot = slot();
        slot.push(frame(1, PixelFormat::Mjpg));
        assert_eq!(slot.take_newest(Duration::ZERO).unwrap().sequence, 1);
        assert!(slot.take_newest(Duration::ZERO).is_none());
        for sequence in 2..6 {
            slot.push(frame(sequence, PixelFormat::Mjpg));
        }
        assert_eq!(slot.take_newest(Duration::ZERO).unwrap().sequence, 5);
        assert_eq!(slot.with_info(|info| info.not_decoded), 3);
    }

    #[test]
    fn damaged_frame_is_removed_and_decoded_frame_is_valid() {
        let slot = slot();
        let (good, bad) = (frame(1, PixelFormat::Mjpg), frame(2, PixelFormat::Mjpg));
        slot.push(good.clone());
        slot.push(bad.clone());
        assert!(slot.frames().iter().all(|(_, s)| *s == Validity::Unknown));
        slot.on_decoded(&good, RgbImage::new(1, 1), None);
        slot.on_damaged(&bad, String::new());
        let frames = slot.frames();
        assert_eq!(frames.len(), 1);
        assert_eq!(frames[0].1, Validity::Valid);
        assert_eq!(slot.with_info(|info| info.damaged_when_decoded), 1);
    }

    #[test]
    fn out_of_order_frames_are_sorted_by_time() {
        let slot = slot();
        slot.push(frame(5, PixelFormat::Mjpg));
        slot.push(frame(7, PixelFormat::Mjpg));
        slot.push(frame(6, PixelFormat::Mjpg));
        let order: Vec<u32> = slot.frames().iter().map(|(f, _)| f.sequence).collect();
        assert_eq!(order, [5, 6, 7]);
        assert_eq!(slot.take_newest(Duration::ZERO).unwrap().sequence, 7);
    }

    fn valid(slot: &CameraSlot) -> Vec<u32> {
        let frames = slot.frames();
        let valid = frames.iter().filter(|(_, s)| *s == Validity::Valid);
        valid.map(|(frame, _)| frame.sequence).collect()
    }

    #[test]
    fn slow_decoder_keeps_newest_valid_frame() {
        let slot = slot();
        for round in 0..5 {
            let first = round * 20;
            slot.push(frame(first, PixelFormat::Mjpg));
            let taken = slot.take_newest(Duration::ZERO).unwrap();
            // The whole ring is newer when decoding ends.
            for sequence in first + 1..first + 20 {
                slot.push(frame(sequence, PixelFormat::Mjpg));
                assert_eq!(
                    valid(&slot),
                    if round > 0 { vec![first - 20] } else { vec![] }
                );
            }
            slot.on_decoded(&taken, RgbImage::new(1, 1), None);
            assert_eq!(valid(&slot).last(), Some(&first));
            assert_eq!(slot.frames().len(), RING_FRAMES);
        }
    }

    #[test]
    fn clear_frames_removes_all_frames() {
        let slot = slot();
        slot.push(frame(1, PixelFormat::Yuyv));
        slot.clear_frames();
        assert!(slot.frames().is_empty() && slot.latest().is_none());
    }

    #[test]
    fn frame_decoded_after_disconnect_is_not_restored() {
        let slot = slot();
        slot.push(frame(1, PixelFormat::Mjpg));
        let taken = slot.take_newest(Duration::ZERO).unwrap();
        slot.clear_frames();
        slot.on_decoded(&taken, RgbImage::new(1, 1), None);
        assert!(slot.frames().is_empty());
    }
}
