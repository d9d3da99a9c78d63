//! The transfers between the host's controller and one plugged device.
//!
//! The host hands over transfers before there is data for them; a camera pump or the pedal
//! answers them later, from its own thread. Answers are written under the same lock that
//! guards the waiting transfers, so that the answer to a transfer always leaves before the
//! answer to its unlinking.

use std::collections::{BTreeMap, VecDeque};
use std::io::{self, Write};
use std::os::unix::net::UnixStream;
use std::sync::{Condvar, Mutex, MutexGuard, PoisonError};
use std::time::Instant;

use crate::profile::Mode;
use crate::usbip::{self, PacketDone, Status, Submit};

/// A stream between its start and its stop by the host.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Streaming {
    pub(crate) mode: Mode,
    pub(crate) since: Instant,
    /// Tells this run of the stream from the one before.
    run: u64,
}

/// Why a pump has to let go.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Interrupted {
    /// The host stopped the stream.
    Stopped,
    /// The device was unplugged.
    Unplugged,
}

struct State {
    to_host: UnixStream,
    waiting: BTreeMap<u8, VecDeque<Submit>>,
    highest_seq: u32,
    /// Unlinks that overtook their transfer: victim → seq of the unlink.
    early_unlinks: BTreeMap<u32, u32>,
    streams: BTreeMap<u8, Streaming>,
    runs: u64,
    is_unplugged: bool,
}

impl State {
    fn is_running(&self, interface: u8, run: u64) -> bool {
        self.streams.get(&interface).is_some_and(|s| s.run == run)
    }

    fn interruption(&self, interface: u8, run: u64) -> Option<Interrupted> {
        if self.is_unplugged {
            Some(Interrupted::Unplugged)
        } else if self.is_running(interface, run) {
            None
        } else {
            Some(Interrupted::Stopped)
        }
    }

    fn next_waiting(&mut self, endpoint: u8) -> Option<Submit> {
        self.waiting.get_mut(&endpoint)?.pop_front()
    }

    fn write(&mut self, reply: &[u8]) -> Result<(), Interrupted> {
        if self.to_host.write_all(reply).is_err() {
            self.is_unplugged = true;
            return Err(Interrupted::Unplugged);
        }
        Ok(())
    }
}

/// See the module.
pub(crate) struct Link {
    state: Mutex<State>,
    changed: Condvar,
}

impl Link {
    pub(crate) fn new(to_host: UnixStream) -> Self {
        Self {
            state: Mutex::new(State {
                to_host,
                waiting: BTreeMap::new(),
                highest_seq: 0,
                early_unlinks: BTreeMap::new(),
                streams: BTreeMap::new(),
                runs: 0,
                is_unplugged: false,
            }),
            changed: Condvar::new(),
        }
    }

    fn lock(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn wait<'a>(&self, state: MutexGuard<'a, State>) -> MutexGuard<'a, State> {
        self.changed
            .wait(state)
            .unwrap_or_else(PoisonError::into_inner)
    }

    /// Waits until something changes or `due` has come; true once it has come.
    fn wait_until<'a>(
        &self,
        state: MutexGuard<'a, State>,
        due: Instant,
    ) -> (MutexGuard<'a, State>, bool) {
        let left = due.saturating_duration_since(Instant::now());
        if left.is_zero() {
            return (state, true);
        }
        let (state, _) = self
            .changed
            .wait_timeout(state, left)
            .unwrap_or_else(PoisonError::into_inner);
        (state, false)
    }

    /// Takes a transfer in. Control transfers come back, to be answered by the caller.
    pub(crate) fn accept(&self, submit: Submit) -> Option<Submit> {
        let mut state = self.lock();
        state.highest_seq = state.highest_seq.max(submit.seq);
        if let Some(unlink) = state.early_unlinks.remove(&submit.seq) {
            let _ = state.write(&usbip::unlink_reply(unlink, Status::Unlinked));
            return None;
        }
        if submit.endpoint == 0 {
            return Some(submit);
        }
        state
            .waiting
            .entry(submit.endpoint)
            .or_default()
            .push_back(submit);
        self.changed.notify_all();
        None
    }

    /// Takes a transfer back. The kernel's two sender threads can overtake each other, so that
    /// an unlink arrives before its transfer; it is then answered when the transfer comes, since
    /// an answer to a transfer that the kernel has already forgotten makes it drop the device.
    pub(crate) fn unlink(&self, seq: u32, victim: u32) {
        let mut state = self.lock();
        let mut was_waiting = false;
        for queue in state.waiting.values_mut() {
            let before = queue.len();
            queue.retain(|submit| submit.seq != victim);
            was_waiting |= queue.len() < before;
        }
        if !was_waiting && victim > state.highest_seq {
            state.early_unlinks.insert(victim, seq);
            return;
        }
        let status = if was_waiting {
            Status::Unlinked
        } else {
            Status::Ok
        };
        let _ = state.write(&usbip::unlink_reply(seq, status));
    }

    /// Answers a control transfer: the data read, nothing for a write, or a stall.
    pub(crate) fn answer_control(&self, submit: &Submit, answer: Option<&[u8]>) {
        let reply = match answer {
            None => usbip::submit_reply(submit.seq, Status::Stall, &[], 0, &[]),
            Some(data) if submit.is_in => {
                let data = &data[..data.len().min(submit.length as usize)];
                usbip::submit_reply(submit.seq, Status::Ok, data, data.len() as u32, &[])
            }
            Some(_) => {
                usbip::submit_reply(submit.seq, Status::Ok, &[], submit.data.len() as u32, &[])
            }
        };
        let _ = self.lock().write(&reply);
    }

    /// Answers the next transfer of an interrupt endpoint; waits for one.
    pub(crate) fn answer_interrupt(&self, endpoint: u8, report: &[u8]) -> Result<(), Interrupted> {
        let mut state = self.lock();
        loop {
            if state.is_unplugged {
                return Err(Interrupted::Unplugged);
            }
            if let Some(submit) = state.next_waiting(endpoint) {
                let length = report.len() as u32;
                let reply = usbip::submit_reply(submit.seq, Status::Ok, report, length, &[]);
                return state.write(&reply);
            }
            state = self.wait(state);
        }
    }

    /// Answers the next transfer of an isochronous endpoint; waits for one while the stream
    /// runs. `fill` returns the compacted data and the packets.
    pub(crate) fn answer_isochronous(
        &self,
        endpoint: u8,
        interface: u8,
        streaming: Streaming,
        fill: impl FnOnce(&Submit) -> (Vec<u8>, Vec<PacketDone>),
    ) -> Result<(), Interrupted> {
        let mut state = self.lock();
        loop {
            if let Some(why) = state.interruption(interface, streaming.run) {
                return Err(why);
            }
            if let Some(submit) = state.next_waiting(endpoint) {
                let (data, packets) = fill(&submit);
                let length = data.len() as u32;
                let reply = usbip::submit_reply(submit.seq, Status::Ok, &data, length, &packets);
                return state.write(&reply);
            }
            state = self.wait(state);
        }
    }

    /// The host starts a stream.
    pub(crate) fn start_stream(&self, interface: u8, mode: Mode) {
        let mut state = self.lock();
        state.runs += 1;
        let run = state.runs;
        let since = Instant::now();
        state
            .streams
            .insert(interface, Streaming { mode, since, run });
        self.changed.notify_all();
    }

    /// The host stops a stream.
    pub(crate) fn stop_stream(&self, interface: u8) {
        self.lock().streams.remove(&interface);
        self.changed.notify_all();
    }

    /// Waits until the host starts the stream; `None` once the device is unplugged.
    pub(crate) fn wait_for_stream(&self, interface: u8) -> Option<Streaming> {
        let mut state = self.lock();
        loop {
            if state.is_unplugged {
                return None;
            }
            if let Some(streaming) = state.streams.get(&interface) {
                return Some(*streaming);
            }
            state = self.wait(state);
        }
    }

    /// Sleeps while the stream runs.
    pub(crate) fn sleep_while_streaming(
        &self,
        interface: u8,
        streaming: Streaming,
        due: Instant,
    ) -> Result<(), Interrupted> {
        let mut state = self.lock();
        loop {
            if let Some(why) = state.interruption(interface, streaming.run) {
                return Err(why);
            }
            let come;
            (state, come) = self.wait_until(state, due);
            if come {
                return Ok(());
            }
        }
    }

    /// Sleeps while the device is plugged.
    pub(crate) fn sleep_until(&self, due: Instant) -> Result<(), Interrupted> {
        let mut state = self.lock();
        loop {
            if state.is_unplugged {
                return Err(Interrupted::Unplugged);
            }
            let come;
            (state, come) = self.wait_until(state, due);
            if come {
                return Ok(());
            }
        }
    }

    /// Pulls the plug, in both directions.
    pub(crate) fn unplug(&self) -> io::Result<()> {
        let mut state = self.lock();
        state.is_unplugged = true;
        self.changed.notify_all();
        state.to_host.shutdown(std::net::Shutdown::Both)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::io::Read;

    fn submit(seq: u32, endpoint: u8) -> Submit {
        Submit {
            seq,
            endpoint,
            is_in: true,
            length: 8,
            setup: [0; 8],
            data: Vec::new(),
            packets: Vec::new(),
        }
    }

    fn link() -> (Link, UnixStream) {
        let (ours, kernels) = UnixStream::pair().unwrap();
        (Link::new(ours), kernels)
    }

    /// Kind, seq and status of the next answer without data.
    fn answer(kernels: &mut UnixStream) -> (u32, u32, i32) {
        let mut bytes = [0; 48];
        kernels.read_exact(&mut bytes).unwrap();
        let word = |i: usize| u32::from_be_bytes(bytes[i * 4..i * 4 + 4].try_into().unwrap());
        (word(0), word(1), word(5).cast_signed())
    }

    #[test]
    fn pending_transfer_is_cancelled() {
        let (link, mut kernels) = link();
        assert!(link.accept(submit(1, 1)).is_none());
        link.unlink(2, 1);
        assert_eq!(answer(&mut kernels), (4, 2, -104));
    }

    #[test]
    fn answered_transfer_cannot_be_cancelled() {
        let (link, mut kernels) = link();
        link.accept(submit(1, 1));
        link.answer_interrupt(1, &[]).unwrap();
        link.unlink(2, 1);
        assert_eq!(answer(&mut kernels), (3, 1, 0));
        assert_eq!(answer(&mut kernels), (4, 2, 0));
    }

    #[test]
    fn unlink_before_transfer_waits_for_it() {
        let (link, mut kernels) = link();
        link.accept(submit(5, 1));
        link.unlink(7, 6);
        link.answer_interrupt(1, &[]).unwrap();
        assert!(link.accept(submit(6, 1)).is_none());
        assert_eq!(answer(&mut kernels), (3, 5, 0));
        assert_eq!(answer(&mut kernels), (4, 7, -104));
        assert!(link.lock().next_waiting(1).is_none());
    }

    #[test]
    fn stopped_stream_and_unplug_interrupt_pump() {
        let (link, _kernels) = link();
        let mode = Mode {
            width: 640,
            height: 480,
            fps: 30,
        };
        link.start_stream(1, mode);
        let streaming = link.wait_for_stream(1).unwrap();
        link.stop_stream(1);
        link.start_stream(1, mode);
        let nothing = |_: &Submit| (Vec::new(), Vec::new());
        assert_eq!(
            link.answer_isochronous(1, 1, streaming, nothing),
            Err(Interrupted::Stopped)
        );
        link.unplug().unwrap();
        assert_eq!(link.wait_for_stream(1), None);
        assert_eq!(link.answer_interrupt(1, &[]), Err(Interrupted::Unplugged));
    }
}
