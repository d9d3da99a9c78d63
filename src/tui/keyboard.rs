//! Waits for keys and detects a closed terminal, on which the event source of `crossterm` never
//! returns.

use std::fs::File;
use std::io::{self, IsTerminal as _};
use std::os::fd::{AsFd, BorrowedFd};
use std::time::Duration;

use crossterm::event::{self, Event};
use rustix::event::{PollFd, PollFlags, Timespec, poll};

use gripcast_base::error::{Error, Result};

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

fn wait_for_input(terminal: BorrowedFd<'_>, timeout: Duration) -> io::Result<bool> {
    let mut watched = [PollFd::from_borrowed_fd(terminal, PollFlags::IN)];
    let timeout = Timespec {
        tv_sec: timeout.as_secs() as i64,
        tv_nsec: i64::from(timeout.subsec_nanos()),
    };
    match poll(&mut watched, Some(&timeout)) {
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
    fn input_ends_the_wait_and_hangup_is_detected() {
        let (ours, mut theirs) = UnixStream::pair().unwrap();
        assert!(wait_for_input(ours.as_fd(), Duration::ZERO).unwrap());
        theirs.write_all(b"q").unwrap();
        assert!(wait_for_input(ours.as_fd(), Duration::from_secs(60)).unwrap());
        drop(theirs);
        assert!(!wait_for_input(ours.as_fd(), Duration::from_secs(60)).unwrap());
    }
}
