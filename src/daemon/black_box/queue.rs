//! Queue of log entries: bounded by bytes, never blocks a sender.

use std::collections::{BTreeMap, VecDeque};
use std::sync::{Arc, Condvar, Mutex};
use std::time::Duration;

use serde::Serialize;

use super::clock::WallClock;
use crate::daemon::thread::{lock, wait_while};
use gripcast_capture::camera::monotonic_ns;
use gripcast_imaging::{Frame, Role};
use gripcast_interop::black_box::Topic;

/// Extra space for JSON messages when frames have filled the queue, bytes.
const JSON_RESERVE: usize = 1 << 20;

/// Contents of a log entry.
#[derive(Debug)]
pub(super) enum Content {
    /// A camera frame.
    Frame {
        /// Role of the camera.
        role: Role,
        /// The frame; its data are shared.
        frame: Frame,
    },
    /// A JSON message.
    Json {
        /// Channel of the message.
        topic: Topic,
        /// JSON object as UTF-8.
        text: Vec<u8>,
    },
}

impl Content {
    fn len(&self) -> usize {
        match self {
            Self::Frame { frame, .. } => frame.data.len(),
            Self::Json { text, .. } => text.len(),
        }
    }
}

/// A log entry with its arrival time, `CLOCK_MONOTONIC`, ns. Times never decrease.
#[derive(Debug)]
pub(super) struct Entry {
    pub(super) at_ns: u64,
    pub(super) content: Content,
}

/// Result of waiting for an entry.
#[derive(Debug)]
pub(super) enum Next {
    /// The oldest entry.
    Entry(Entry),
    /// No entry arrived in time.
    Timeout,
    /// The queue is closed and empty.
    Closed,
}

/// Consecutive dropped frames of a camera.
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
    dropped_messages: u64,
    closed: bool,
}

/// Queue from all threads to the writer.
#[derive(Debug)]
pub(super) struct Queue {
    limit_bytes: usize,
    /// Clock of the log.
    pub(super) clock: WallClock,
    state: Mutex<State>,
    arrived: Condvar,
}

impl Queue {
    /// Creates an empty queue of at most `limit_bytes`.
    pub(super) fn new(limit_bytes: usize, clock: WallClock) -> Self {
        Self {
            limit_bytes,
            clock,
            state: Mutex::default(),
            arrived: Condvar::new(),
        }
    }

    fn push_frame(&self, role: Role, frame: &Frame) {
        let mut state = lock(&self.state);
        if state.closed {
            return;
        }
        // Read under the lock, so that entries are in order of time.
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
            state.add(at_ns, self.gap_event(role, &gap, at_ns));
        }
        let frame = frame.clone();
        state.add(at_ns, Content::Frame { role, frame });
        drop(state);
        self.arrived.notify_one();
    }

    fn push_json(&self, topic: Topic, text: Vec<u8>) {
        let mut state = lock(&self.state);
        if state.closed {
            return;
        }
        if state.bytes + text.len() > self.limit_bytes + JSON_RESERVE {
            state.dropped_messages += 1;
            return;
        }
        state.add(monotonic_ns(), Content::Json { topic, text });
        drop(state);
        self.arrived.notify_one();
    }

    /// Waits for the oldest entry and removes it.
    pub(super) fn next(&self, timeout: Duration) -> Next {
        let is_waiting = |state: &mut State| state.entries.is_empty() && !state.closed;
        let mut state = wait_while(&self.arrived, lock(&self.state), timeout, is_waiting);
        match state.entries.pop_front() {
            Some(entry) => {
                state.bytes -= entry.content.len();
                Next::Entry(entry)
            }
            None if state.closed => Next::Closed,
            None => Next::Timeout,
        }
    }

    /// Accepts no further entries. Queued entries and open gaps can still be taken.
    pub(super) fn close(&self) {
        let mut state = lock(&self.state);
        if !std::mem::replace(&mut state.closed, true) {
            let at_ns = monotonic_ns();
            for (role, gap) in std::mem::take(&mut state.gaps) {
                state.add(at_ns, self.gap_event(role, &gap, at_ns));
            }
        }
        drop(state);
        self.arrived.notify_one();
    }

    /// Accepts no further entries and drops the queued ones.
    pub(super) fn abandon(&self) {
        self.close();
        let mut state = lock(&self.state);
        state.entries = VecDeque::new();
        state.bytes = 0;
    }

    /// Returns the number of dropped frames by camera.
    pub(super) fn dropped(&self) -> BTreeMap<Role, u64> {
        lock(&self.state).dropped.clone()
    }

    /// Returns the number of dropped JSON messages.
    pub(super) fn dropped_messages(&self) -> u64 {
        lock(&self.state).dropped_messages
    }

    fn gap_event(&self, role: Role, gap: &Gap, at_ns: u64) -> Content {
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

/// Returns an event message in the format of the dataset's log.
pub(super) fn event(at: &str, event: &str, what: &serde_json::Value) -> Content {
    let line = serde_json::json!({"at": at, "event": event, "what": what});
    Content::Json {
        topic: Topic::Events,
        text: line.to_string().into_bytes(),
    }
}

/// Input of the black box for frames and messages; a default tap discards them.
#[derive(Clone, Debug, Default)]
pub(in crate::daemon) struct Tap(Option<Arc<Queue>>);

impl Tap {
    pub(super) fn new(queue: &Arc<Queue>) -> Self {
        Self(Some(Arc::clone(queue)))
    }

    /// Logs a frame as sent by the camera.
    pub(in crate::daemon) fn frame(&self, role: Role, frame: &Frame) {
        if let Some(queue) = &self.0 {
            queue.push_frame(role, frame);
        }
    }

    /// Logs a JSON object; `message` is not called without a black box.
    pub(in crate::daemon) fn json<T: Serialize>(&self, topic: Topic, message: impl FnOnce() -> T) {
        if let Some(queue) = &self.0
            && let Ok(text) = serde_json::to_vec(&message())
        {
            queue.push_json(topic, text);
        }
    }
}
