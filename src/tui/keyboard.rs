//! Waits for keys and detects a closed terminal, on which the event source of `crossterm` never
//! returns.

use std::fs::File;
use std::io::{self, IsTerminal as _};
use std::os::fd::{AsFd, BorrowedFd};
use std::time::Duration;

use rustix::event::{PollFd, PollFlags, Timespec, poll};

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
