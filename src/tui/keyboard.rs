//! Waits for keys and detects a closed terminal, on which the event source of `crossterm` never
//! returns.

use std::fs::File;
use std::io::{self, IsTerminal as _};
use std::os::fd::{AsFd, BorrowedFd};
use std::time::Duration;

use crossterm::event::{self, Event};
use rustix::event::{PollFd, PollFlags, Timespec, poll};

use gripcast_base::error::{Error, Result};

/// Maximum size of an answer of the terminal; more is other input.
const MAX_ANSWER_BYTES: usize = 4096;

/// Terminal for key input: standard input if it is a terminal, else the controlling terminal.
pub(crate) enum Keyboard {
    Standard,
    Controlling(File),
}

impl Keyboard {
    /// Opens the terminal that `crossterm` reads.
    ///
    /// # Errors
    /// If there is no terminal.
    pub(crate) fn open() -> io::Result<Self> {
        if io::stdin().is_terminal() {
            return Ok(Self::Standard);
        }
        File::open("/dev/tty").map(Self::Controlling)
    }

    /// Waits at most `timeout` and returns all pending events; `None` once the terminal is closed.
    ///
    /// # Errors
    /// Errors of the operating system.
    pub(super) fn events(&self, timeout: Duration) -> Result<Option<Vec<Event>>> {
        if !self.wait(timeout).map_err(unreadable)? {
            return Ok(None);
        }
        let mut events = Vec::new();
        while event::poll(Duration::ZERO).map_err(unreadable)? {
            events.push(event::read().map_err(unreadable)?);
        }
        Ok(Some(events))
    }

    /// Returns the answer of the terminal to a question that was written to it, or what has arrived
    /// of it until none arrives for `timeout`. `is_complete` is asked after each part.
    ///
    /// # Errors
    /// Errors of the operating system.
    pub(super) fn answer(
        &self,
        timeout: Duration,
        is_complete: impl Fn(&[u8]) -> bool,
    ) -> io::Result<Vec<u8>> {
        let mut answer = Vec::new();
        while answer.len() < MAX_ANSWER_BYTES && !is_complete(&answer) {
            let mut part = [0; 256];
            let count = match self {
                Self::Standard => read_part(io::stdin().as_fd(), timeout, &mut part)?,
                Self::Controlling(tty) => read_part(tty.as_fd(), timeout, &mut part)?,
            };
            if count == 0 {
                break;
            }
            answer.extend_from_slice(&part[..count]);
        }
        Ok(answer)
    }

    /// Waits for input, at most `timeout`; returns false once the terminal is closed.
    ///
    /// # Errors
    /// Errors of the operating system.
    pub(crate) fn wait(&self, timeout: Duration) -> io::Result<bool> {
        match self {
            Self::Standard => wait_for_input(io::stdin().as_fd(), timeout),
            Self::Controlling(tty) => wait_for_input(tty.as_fd(), timeout),
        }
    }
}

/// Returns the error of a terminal whose keys cannot be read.
pub(super) fn unreadable(source: io::Error) -> Error {
    Error::io("cannot read keys from this terminal", source)
        .remedy("run in a terminal, or without a screen (--headless)")
}

/// Reads what arrives within `timeout`; 0 bytes if nothing does or the terminal is closed.
fn read_part(terminal: BorrowedFd<'_>, timeout: Duration, part: &mut [u8]) -> io::Result<usize> {
    let mut watched = [PollFd::from_borrowed_fd(terminal, PollFlags::IN)];
    match poll(&mut watched, Some(&timespec(timeout))) {
        Ok(0) | Err(rustix::io::Errno::INTR) => return Ok(0),
        Ok(_) => {}
        Err(error) => return Err(error.into()),
    }
    Ok(rustix::io::read(terminal, part)?)
}

fn timespec(time: Duration) -> Timespec {
    Timespec {
        tv_sec: time.as_secs() as i64,
        tv_nsec: i64::from(time.subsec_nanos()),
    }
}

fn wait_for_input(terminal: BorrowedFd<'_>, timeout: Duration) -> io::Result<bool> {
    let mut watched = [PollFd::from_borrowed_fd(terminal, PollFlags::IN)];
    match poll(&mut watched, Some(&timespec(timeout))) {
        Ok(_) => {}
        // A signal, for example of a resize, may be an event.
        Err(rustix::io::Errno::INTR) => return Ok(true),
        Err(error) => return Err(error.into()),
    }
    let closed = PollFlags::HUP | PollFlags::ERR | PollFlags::NVAL;
    Ok(!watched[0].revents().intersects(closed))
}

#[cfg(test)]
mod tests {
    use std::io::Write as _;
    use std::os::unix::net::UnixStream;

    use super::*;

    #[test]
    fn answer_ends_when_complete_or_silent() {
        let (ours, mut theirs) = UnixStream::pair().unwrap();
        let keyboard = Keyboard::Controlling(File::from(std::os::fd::OwnedFd::from(ours)));
        let answer = || {
            let ends = |bytes: &[u8]| bytes.ends_with(b"c");
            keyboard.answer(Duration::ZERO, ends).unwrap()
        };
        assert_eq!(answer(), b"");
        theirs.write_all(b"\x1b[?1;2c").unwrap();
        assert_eq!(answer(), b"\x1b[?1;2c");
        theirs.write_all(&[0xff; 9000]).unwrap();
        assert!((MAX_ANSWER_BYTES..9000).contains(&answer().len()));
        drop(theirs);
        assert!(answer().len() < 9000);
    }

    #[test]
    fn input_ends_the_wait_and_hangup_is_detected() {
        let (ours, mut theirs) = UnixStream::pair().unwrap();
        assert!(wait_for_input(ours.as_fd(), Duration::ZERO).unwrap());
        theirs.write_all(b"q").unwrap();
        assert!(wait_for_input(ours.as_fd(), Duration::from_secs(60)).unwrap());
        drop(theirs);
        assert!(!wait_for_input(ours.as_fd(), Duration::from_secs(60)).unwrap());
    }
}
