//! What waits to be written: bounded by bytes, and nobody waits to put something in.

use std::collections::{BTreeMap, VecDeque};
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use serde::Serialize;

use super::clock::WallClock;
use gripcast_capture::camera::monotonic_ns;
use gripcast_imaging::{Frame, Role};

/// Notes still find room when frames have filled the queue, bytes.
const NOTE_ROOM: usize = 1 << 20;

/// Channels of what is no image.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(in crate::daemon) enum Topic {
    /// Commands, faults, gaps of the log itself.
    Events,
    /// Answered changes of the dataset.
    Stored,
    /// Live predictions.
    Prediction,
    /// Health of all cameras.
    Cameras,
}

/// Something to write.
#[derive(Debug)]
pub(super) enum Content {
    /// A frame of a camera.
    Frame {
        /// Its camera.
        role: Role,
        /// The frame; its bytes are shared.
        frame: Frame,
    },
    /// JSON.
    Note {
        /// Its channel.
        topic: Topic,
        /// UTF-8 text of an object.
        text: Vec<u8>,
    },
}

impl Content {
    fn len(&self) -> usize {
        match self {
            Self::Frame { frame, .. } => frame.data.len(),
            Self::Note { text, .. } => text.len(),
        }
    }
}

/// Something to write and when it came, `CLOCK_MONOTONIC`, ns. Times never go back.
#[derive(Debug)]
pub(super) struct Entry {
    pub(super) at_ns: u64,
    pub(super) content: Content,
}

/// What the queue has.
#[derive(Debug)]
pub(super) enum Taken {
    /// The oldest entry.
    Entry(Entry),
    /// Nothing came in time.
    Nothing,
    /// Nothing more will come.
    Closed,
}

/// Frames that were left out one after the other.
#[derive(Clone, Copy, Debug)]
struct Gap {
    frames: u64,
    first_sequence: u32,
    last_sequence: u32,
    since_ns: u64,
}

#[derive(Debug, Default)]
struct State {
    entries: VecDeque<Entry>,
    bytes: usize,
    gaps: BTreeMap<Role, Gap>,
    dropped: BTreeMap<Role, u64>,
    dropped_notes: u64,
    closed: bool,
}

/// The queue between all threads and the writer.
#[derive(Debug)]
pub(super) struct Queue {
    limit_bytes: usize,
    /// The clock of the log.
    pub(super) clock: WallClock,
    state: Mutex<State>,
    arrived: Condvar,
}

impl Queue {
    /// An empty queue that holds at most this much.
    pub(super) fn new(limit_bytes: usize, clock: WallClock) -> Self {
        Self {
            limit_bytes,
            clock,
            state: Mutex::default(),
            arrived: Condvar::new(),
        }
    }

    fn lock(&self) -> MutexGuard<'_, State> {
        // A panicking holder leaves plain data behind, which is still the newest there is.
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn push_frame(&self, role: Role, frame: &Frame) {
        let mut state = self.lock();
        if state.closed {
            return;
        }
        // Read under the lock, so that the order of the entries is that of their times.
        let at_ns = monotonic_ns();
        if state.bytes + frame.data.len() > self.limit_bytes {
            *state.dropped.entry(role).or_default() += 1;
            let gap = state.gaps.entry(role).or_insert(Gap {
                frames: 0,
                first_sequence: frame.sequence,
                last_sequence: frame.sequence,
                since_ns: at_ns,
            });
            gap.frames += 1;
            gap.last_sequence = frame.sequence;
            return;
        }
        if let Some(gap) = state.gaps.remove(&role) {
            state.add(at_ns, self.gap_note(role, &gap, at_ns));
        }
        let frame = frame.clone();
        state.add(at_ns, Content::Frame { role, frame });
        drop(state);
        self.arrived.notify_one();
    }

    fn push_note(&self, topic: Topic, text: Vec<u8>) {
        let mut state = self.lock();
        if state.closed {
            return;
        }
        if state.bytes + text.len() > self.limit_bytes + NOTE_ROOM {
            state.dropped_notes += 1;
            return;
        }
        state.add(monotonic_ns(), Content::Note { topic, text });
        drop(state);
        self.arrived.notify_one();
    }

    /// Waits for the oldest entry.
    pub(super) fn take(&self, timeout: Duration) -> Taken {
        let (mut state, _) = self
            .arrived
            .wait_timeout_while(self.lock(), timeout, |state| {
                state.entries.is_empty() && !state.closed
            })
            .unwrap_or_else(PoisonError::into_inner);
        match state.entries.pop_front() {
            Some(entry) => {
                state.bytes -= entry.content.len();
                Taken::Entry(entry)
            }
            None if state.closed => Taken::Closed,
            None => Taken::Nothing,
        }
    }

    /// Takes nothing more in. What is in it, and the gaps that no frame has ended, can be taken.
    pub(super) fn close(&self) {
        let mut state = self.lock();
        if !std::mem::replace(&mut state.closed, true) {
            let at_ns = monotonic_ns();
            for (role, gap) in std::mem::take(&mut state.gaps) {
                state.add(at_ns, self.gap_note(role, &gap, at_ns));
            }
        }
        drop(state);
        self.arrived.notify_one();
    }

    /// Takes nothing more in and forgets what is in it.
    pub(super) fn abandon(&self) {
        self.close();
        let mut state = self.lock();
        state.entries = VecDeque::new();
        state.bytes = 0;
    }

    /// Frames that were left out, by camera.
    pub(super) fn dropped(&self) -> BTreeMap<Role, u64> {
        self.lock().dropped.clone()
    }

    /// Notes that were left out.
    pub(super) fn dropped_notes(&self) -> u64 {
        self.lock().dropped_notes
    }

    fn gap_note(&self, role: Role, gap: &Gap, at_ns: u64) -> Content {
        let what = serde_json::json!({
            "role": role,
            "frames": gap.frames,
            "first_sequence": gap.first_sequence,
            "last_sequence": gap.last_sequence,
            "since": self.clock.text(gap.since_ns),
        });
        event(&self.clock.text(at_ns), "black_box_gap", &what)
    }
}

impl State {
    fn add(&mut self, at_ns: u64, content: Content) {
        self.bytes += content.len();
        self.entries.push_back(Entry { at_ns, content });
    }
}

/// A line of the channel of events, in the form of the dataset's own log.
pub(super) fn event(at: &str, event: &str, what: &serde_json::Value) -> Content {
    let line = serde_json::json!({"at": at, "event": event, "what": what});
    Content::Note {
        topic: Topic::Events,
        text: line.to_string().into_bytes(),
    }
}

/// Where frames and notes go into the black box; without one they go nowhere.
#[derive(Clone, Debug, Default)]
pub(in crate::daemon) struct Tap(Option<Arc<Queue>>);

impl Tap {
    pub(super) fn new(queue: &Arc<Queue>) -> Self {
        Self(Some(Arc::clone(queue)))
    }

    /// A frame as the camera sent it; shares its bytes.
    pub(in crate::daemon) fn frame(&self, role: Role, frame: &Frame) {
        if let Some(queue) = &self.0 {
            queue.push_frame(role, frame);
        }
    }

    /// Something that is an object in JSON; `note` is not called without a black box.
    pub(in crate::daemon) fn note<T: Serialize>(&self, topic: Topic, note: impl FnOnce() -> T) {
        if let Some(queue) = &self.0
            && let Ok(text) = serde_json::to_vec(&note())
        {
            queue.push_note(topic, text);
        }
    }
}
