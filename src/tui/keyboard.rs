//! Waits for keys and sees when the terminal has gone: the event source of `crossterm` reads an
//! abandoned terminal for ever without returning.

use std::fs::File;
use std::io::{self, IsTerminal as _};
use std::os::fd::{AsFd, BorrowedFd};
use std::time::Duration;

use rustix::event::{PollFd, PollFlags, Timespec, poll};

/// The terminal that keys come from: standard input, or the controlling terminal where that is
/// something else.
pub(crate) enum Keyboard {
    Standard,
    Controlling(File),
}

impl Keyboard {
    /// The same terminal that `crossterm` reads.
    ///
    /// # Errors
    /// Where there is no terminal.
    pub(crate) fn open() -> io::Result<Self> {
        if io::stdin().is_terminal() {
            return Ok(Self::Standard);
        }
        File::open("/dev/tty").map(Self::Controlling)
    }

    /// Waits until something was typed, at most `longest`. False once the terminal has gone.
    ///
    /// # Errors
    /// Those of the operating system.
    pub(crate) fn wait(&self, longest: Duration) -> io::Result<bool> {
        match self {
            Self::Standard => is_there(io::stdin().as_fd(), longest),
            Self::Controlling(tty) => is_there(tty.as_fd(), longest),
        }
    }
}

fn is_there(terminal: BorrowedFd<'_>, longest: Duration) -> io::Result<bool> {
    let mut watched = [PollFd::from_borrowed_fd(terminal, PollFlags::IN)];
    let longest = Timespec {
        tv_sec: longest.as_secs() as i64,
        tv_nsec: i64::from(longest.subsec_nanos()),
    };
    match poll(&mut watched, Some(&longest)) {
        Ok(_) => {}
        // A signal, such as that of a changed size: there may be an event.
        Err(rustix::io::Errno::INTR) => return Ok(true),
        Err(error) => return Err(error.into()),
    }
    let gone = PollFlags::HUP | PollFlags::ERR | PollFlags::NVAL;
    Ok(!watched[0].revents().intersects(gone))
}

#[cfg(test)]
mod tests {
    use std::io::Write as _;
    use std::os::unix::net::UnixStream;

    use super::*;

    #[test]
    fn typing_ends_the_wait_and_a_hangup_is_seen() {
        let (ours, mut theirs) = UnixStream::pair().unwrap();
        assert!(is_there(ours.as_fd(), Duration::ZERO).unwrap());
        theirs.write_all(b"q").unwrap();
        assert!(is_there(ours.as_fd(), Duration::from_secs(60)).unwrap());
        drop(theirs);
        assert!(!is_there(ours.as_fd(), Duration::from_secs(60)).unwrap());
    }
}
