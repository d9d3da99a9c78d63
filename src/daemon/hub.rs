//! The newest frames of every camera, shared by capture, decoding, inference and saving.
//!
//! Writers never wait for readers: a slow reader loses previews, never the frames of a trigger.

use std::collections::{BTreeMap, VecDeque};
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use image::RgbImage;

use super::black_box::Tap;
use gripcast_capture::camera::{CameraCounters, ControlValues, Health, StreamInfo};
use gripcast_imaging::{Frame, PixelFormat, Role};

/// Frames kept per camera: 0.3 s at 25/s, enough to pair cameras of different rates.
const RING: usize = 8;

/// Whether a frame can be shown and saved.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Soundness {
    /// Compressed and not decoded yet.
    Unknown,
    /// Complete: raw of the right size, or decoded without complaint.
    Sound,
}

#[derive(Debug)]
struct Held {
    frame: Frame,
    soundness: Soundness,
}

/// A frame that was decoded for inference and preview.
#[derive(Clone, Debug)]
pub(super) struct Decoded {
    /// Cropped and scaled image.
    pub image: Arc<RgbImage>,
    /// Driver time of its frame, ns.
    pub driver_time_ns: u64,
    /// Counts up with every decoded frame of this camera.
    pub serial: u64,
}

/// What is known of one camera.
#[derive(Debug)]
pub(super) struct CameraFacts {
    /// Health as the supervision sees it.
    pub health: Health,
    /// Counters of the supervision.
    pub counters: CameraCounters,
    /// Frames whose entropy data turned out to be damaged when decoded.
    pub damaged_when_decoded: u64,
    /// Frames that arrived while the decoder was busy and were therefore not decoded.
    pub not_decoded: u64,
    /// Measured frame rate, 1/s.
    pub measured_fps: f64,
    /// Stream, once opened.
    pub info: Option<StreamInfo>,
    /// Control values read back at the last opening.
    pub controls: ControlValues,
    /// Differences between what the rig file asks for and what the camera did.
    pub warnings: Vec<String>,
}

#[derive(Debug)]
struct SlotState {
    ring: VecDeque<Held>,
    facts: CameraFacts,
    decoded: Option<Decoded>,
    /// Driver time and sequence of the newest frame handed to the decoder.
    taken: Option<(u64, u32)>,
    closed: bool,
}

/// One camera's place in the hub.
#[derive(Debug)]
pub(super) struct CameraSlot {
    role: Role,
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
                ring: VecDeque::with_capacity(RING),
                facts: CameraFacts {
                    health: Health::Opening,
                    counters: CameraCounters::default(),
                    damaged_when_decoded: 0,
                    not_decoded: 0,
                    measured_fps: 0.0,
                    info: None,
                    controls: ControlValues::new(),
                    warnings: Vec::new(),
                },
                decoded: None,
                taken: None,
                closed: false,
            }),
            arrived: Condvar::new(),
        }
    }

    fn lock(&self) -> MutexGuard<'_, SlotState> {
        // A panicking holder leaves plain data behind, which is still the newest there is.
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Role of the camera.
    #[must_use]
    pub(super) fn role(&self) -> Role {
        self.role
    }

    /// Reads or changes what is known of the camera.
    pub(super) fn facts<T>(&self, f: impl FnOnce(&mut CameraFacts) -> T) -> T {
        f(&mut self.lock().facts)
    }

    /// A camera was opened: frames from before belong to another stream.
    pub(super) fn opened(&self, info: StreamInfo, controls: ControlValues, warnings: Vec<String>) {
        let mut state = self.lock();
        state.ring.clear();
        state.taken = None;
        state.facts.info = Some(info);
        state.facts.controls = controls;
        state.facts.warnings = warnings;
    }

    /// Forgets all frames: what an absent camera saw last must not be saved.
    pub(super) fn forget_frames(&self) {
        let mut state = self.lock();
        state.ring.clear();
        state.taken = None;
        state.decoded = None;
    }

    /// Takes in a frame.
    pub(super) fn push(&self, frame: Frame) {
        self.tap.frame(self.role, &frame);
        let mut state = self.lock();
        make_room(&mut state.ring);
        let soundness = match frame.format {
            PixelFormat::Mjpg => Soundness::Unknown,
            _ => Soundness::Sound,
        };
        insert(&mut state.ring, Held { frame, soundness });
        drop(state);
        self.arrived.notify_all();
    }

    /// Waits for a frame newer than the last one taken; `None` after `timeout` or when closed.
    /// Frames in between are skipped and counted.
    #[must_use]
    pub(super) fn take_newest(&self, timeout: Duration) -> Option<Frame> {
        let fresh = |state: &SlotState| {
            let newest = key(&state.ring.back()?.frame);
            (state.taken != Some(newest)).then_some(newest)
        };
        let (mut state, _) = self
            .arrived
            .wait_timeout_while(self.lock(), timeout, |state| {
                !state.closed && fresh(state).is_none()
            })
            .unwrap_or_else(PoisonError::into_inner);
        if state.closed {
            return None;
        }
        let newest = fresh(&state)?;
        if let Some((before, _)) = state.taken {
            let between = state
                .ring
                .iter()
                .filter(|held| held.frame.driver_time_ns > before)
                .count();
            state.facts.not_decoded += between.saturating_sub(1) as u64;
        }
        state.taken = Some(newest);
        state.ring.back().map(|held| held.frame.clone())
    }

    /// A frame was decoded without complaint.
    pub(super) fn decoded(&self, frame: &Frame, image: RgbImage) {
        let mut state = self.lock();
        let serial = state.decoded.as_ref().map_or(0, |d| d.serial) + 1;
        state.decoded = Some(Decoded {
            image: Arc::new(image),
            driver_time_ns: frame.driver_time_ns,
            serial,
        });
        mark_sound(&mut state, frame);
    }

    /// A frame is damaged: it leaves the ring.
    pub(super) fn damaged(&self, frame: &Frame) {
        let mut state = self.lock();
        state.facts.damaged_when_decoded += 1;
        state.ring.retain(|held| !same(&held.frame, frame));
    }

    /// The newest decoded image.
    #[must_use]
    pub(super) fn latest(&self) -> Option<Decoded> {
        self.lock().decoded.clone()
    }

    /// Frames in the ring, oldest first.
    #[cfg(test)]
    fn frames(&self) -> Vec<(Frame, Soundness)> {
        self.lock()
            .ring
            .iter()
            .map(|held| (held.frame.clone(), held.soundness))
            .collect()
    }

    /// Frames that can be saved, oldest first.
    #[must_use]
    pub(super) fn sound_frames(&self) -> Vec<Frame> {
        let state = self.lock();
        let sound = state
            .ring
            .iter()
            .filter(|h| h.soundness == Soundness::Sound);
        sound.map(|held| held.frame.clone()).collect()
    }

    /// Driver time of the newest frame, ns.
    #[must_use]
    pub(super) fn newest_time_ns(&self) -> Option<u64> {
        self.lock()
            .ring
            .back()
            .map(|held| held.frame.driver_time_ns)
    }

    /// Whether everything is ending.
    #[must_use]
    pub(super) fn is_closed(&self) -> bool {
        self.lock().closed
    }

    /// Waits, unless everything is ending.
    pub(super) fn wait_closed(&self, pause: Duration) {
        // Only whether it ended matters, and the caller asks for that anyway.
        let _ = self
            .arrived
            .wait_timeout_while(self.lock(), pause, |state| !state.closed);
    }

    fn close(&self) {
        self.lock().closed = true;
        self.arrived.notify_all();
    }
}

fn same(a: &Frame, b: &Frame) -> bool {
    a.sequence == b.sequence && a.driver_time_ns == b.driver_time_ns
}

fn key(frame: &Frame) -> (u64, u32) {
    (frame.driver_time_ns, frame.sequence)
}

/// Puts a frame where its driver time belongs: a driver may deliver one after a later one.
fn insert(ring: &mut VecDeque<Held>, new: Held) {
    let place = ring
        .iter()
        .rposition(|held| held.frame.driver_time_ns <= new.frame.driver_time_ns)
        .map_or(0, |i| i + 1);
    ring.insert(place, new);
}

/// Drops the oldest frame of a full ring, but never the newest sound one: a decoder that is slow
/// for a moment must not leave a live camera without a frame that can be saved.
fn make_room(ring: &mut VecDeque<Held>) {
    if ring.len() < RING {
        return;
    }
    let keep = ring
        .iter()
        .rposition(|held| held.soundness == Soundness::Sound);
    ring.remove(usize::from(keep == Some(0)));
}

fn mark_sound(state: &mut SlotState, frame: &Frame) {
    if let Some(held) = state.ring.iter_mut().find(|held| same(&held.frame, frame)) {
        held.soundness = Soundness::Sound;
    } else if state.taken == Some(key(frame)) {
        // Newer frames pushed it out while it was decoded; the stream is still the same one.
        make_room(&mut state.ring);
        let (frame, soundness) = (frame.clone(), Soundness::Sound);
        insert(&mut state.ring, Held { frame, soundness });
    }
}

/// All cameras of the rig.
#[derive(Clone, Debug)]
pub(super) struct Hub {
    slots: Arc<BTreeMap<Role, Arc<CameraSlot>>>,
    tap: Tap,
}

impl Hub {
    /// A hub for these cameras.
    #[must_use]
    pub(super) fn new(roles: impl IntoIterator<Item = Role>) -> Self {
        Self::tapped(roles, Tap::default())
    }

    /// A hub for these cameras; their frames go to the black box as well.
    #[must_use]
    pub(super) fn tapped(roles: impl IntoIterator<Item = Role>, tap: Tap) -> Self {
        let slots = roles
            .into_iter()
            .map(|role| (role, Arc::new(CameraSlot::new(role, tap.clone()))))
            .collect();
        Self {
            slots: Arc::new(slots),
            tap,
        }
    }

    /// Where the black box takes notes.
    #[must_use]
    pub(super) fn tap(&self) -> &Tap {
        &self.tap
    }

    /// One camera.
    #[must_use]
    pub(super) fn slot(&self, role: Role) -> Option<&Arc<CameraSlot>> {
        self.slots.get(&role)
    }

    /// All cameras, in the order of [`Role::ALL`].
    pub(super) fn slots(&self) -> impl Iterator<Item = &Arc<CameraSlot>> {
        self.slots.values()
    }

    /// Wakes every reader for the last time.
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
        Arc::clone(Hub::new([Role::Left]).slot(Role::Left).unwrap())
    }

    #[test]
    fn the_ring_keeps_the_newest_frames() {
        let slot = slot();
        for sequence in 0..20 {
            slot.push(frame(sequence, PixelFormat::Yuyv));
        }
        let kept: Vec<u32> = slot.frames().iter().map(|(f, _)| f.sequence).collect();
        assert_eq!(kept, (12..20).collect::<Vec<_>>());
    }

    #[test]
    fn a_late_reader_gets_the_newest_and_the_skipped_are_counted() {
        let slot = slot();
        slot.push(frame(1, PixelFormat::Mjpg));
        assert_eq!(slot.take_newest(Duration::ZERO).unwrap().sequence, 1);
        assert!(slot.take_newest(Duration::ZERO).is_none());
        for sequence in 2..6 {
            slot.push(frame(sequence, PixelFormat::Mjpg));
        }
        assert_eq!(slot.take_newest(Duration::ZERO).unwrap().sequence, 5);
        assert_eq!(slot.facts(|f| f.not_decoded), 3);
    }

    #[test]
    fn damaged_frames_leave_the_ring_and_decoded_ones_are_sound() {
        let slot = slot();
        let (good, bad) = (frame(1, PixelFormat::Mjpg), frame(2, PixelFormat::Mjpg));
        slot.push(good.clone());
        slot.push(bad.clone());
        assert!(slot.frames().iter().all(|(_, s)| *s == Soundness::Unknown));
        slot.decoded(&good, RgbImage::new(1, 1));
        slot.damaged(&bad);
        let frames = slot.frames();
        assert_eq!(frames.len(), 1);
        assert_eq!(frames[0].1, Soundness::Sound);
        assert_eq!(slot.facts(|f| f.damaged_when_decoded), 1);
    }

    #[test]
    fn a_frame_that_comes_late_does_not_pass_for_the_newest() {
        let slot = slot();
        slot.push(frame(5, PixelFormat::Mjpg));
        slot.push(frame(7, PixelFormat::Mjpg));
        slot.push(frame(6, PixelFormat::Mjpg));
        let order: Vec<u32> = slot.frames().iter().map(|(f, _)| f.sequence).collect();
        assert_eq!(order, [5, 6, 7]);
        assert_eq!(slot.take_newest(Duration::ZERO).unwrap().sequence, 7);
    }

    fn sound(slot: &CameraSlot) -> Vec<u32> {
        let frames = slot.frames();
        let sound = frames.iter().filter(|(_, s)| *s == Soundness::Sound);
        sound.map(|(frame, _)| frame.sequence).collect()
    }

    #[test]
    fn a_slow_decoder_leaves_the_newest_sound_frame() {
        let slot = slot();
        for round in 0..5 {
            let first = round * 20;
            slot.push(frame(first, PixelFormat::Mjpg));
            let taken = slot.take_newest(Duration::ZERO).unwrap();
            // All of the ring is newer when the decoder has finished.
            for sequence in first + 1..first + 20 {
                slot.push(frame(sequence, PixelFormat::Mjpg));
                assert_eq!(
                    sound(&slot),
                    if round > 0 { vec![first - 20] } else { vec![] }
                );
            }
            slot.decoded(&taken, RgbImage::new(1, 1));
            assert_eq!(sound(&slot).last(), Some(&first));
            assert_eq!(slot.frames().len(), RING);
        }
    }

    #[test]
    fn reopening_forgets_the_frames_of_the_stream_before() {
        let slot = slot();
        slot.push(frame(1, PixelFormat::Yuyv));
        slot.forget_frames();
        assert!(slot.frames().is_empty() && slot.latest().is_none());
    }

    #[test]
    fn what_was_being_decoded_when_the_camera_went_does_not_come_back() {
        let slot = slot();
        slot.push(frame(1, PixelFormat::Mjpg));
        let taken = slot.take_newest(Duration::ZERO).unwrap();
        slot.forget_frames();
        slot.decoded(&taken, RgbImage::new(1, 1));
        assert!(slot.frames().is_empty());
    }
}
