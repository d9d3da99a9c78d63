//! What a camera stream shows, which faults it suffers and what it has sent.
//!
//! A feed belongs to the camera and not to its plug: it goes on where it was after a replug.

use std::collections::BTreeMap;
use std::fs;
use std::io;
use std::path::{Path, PathBuf};
use std::str::FromStr;
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use crate::pattern;
use crate::profile::{Mode, Pixels};

/// What is wrong with an image.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Fault {
    /// The same image again and again.
    Freeze,
    /// No image, but the camera is still there.
    Silent,
    /// Only the first half is sent.
    Truncate,
    /// Some bytes in the middle are altered.
    Corrupt,
    /// The camera itself marks the image as broken.
    ErrorBit,
    /// A packet of the image is lost on the bus.
    LosePacket,
    /// The image is skipped, without a trace in the stream.
    Drop,
    /// A line feed, fill bytes and the tail of an older image follow the image.
    Tail,
    /// Bytes of an older image come before the image.
    Lead,
    /// The end marker of the JPEG is missing, its data are whole.
    NoEnd,
    /// All bytes are zero.
    Zero,
    /// The camera's clock stands still; the image itself is intact.
    StillClock,
    /// The camera's clock jumps back and forth; the image itself is intact.
    JumpingClock,
}

impl Fault {
    pub(crate) const ALL: [Self; 13] = [
        Self::Freeze,
        Self::Silent,
        Self::Truncate,
        Self::Corrupt,
        Self::ErrorBit,
        Self::LosePacket,
        Self::Drop,
        Self::Tail,
        Self::Lead,
        Self::NoEnd,
        Self::Zero,
        Self::StillClock,
        Self::JumpingClock,
    ];

    /// Name in commands and counters.
    pub(crate) fn name(self) -> &'static str {
        match self {
            Self::Freeze => "freeze",
            Self::Silent => "silent",
            Self::Truncate => "truncate",
            Self::Corrupt => "corrupt",
            Self::ErrorBit => "error-bit",
            Self::LosePacket => "lose-packet",
            Self::Drop => "drop",
            Self::Tail => "tail",
            Self::Lead => "lead",
            Self::NoEnd => "no-end",
            Self::Zero => "zero",
            Self::StillClock => "still-clock",
            Self::JumpingClock => "jumping-clock",
        }
    }
}

impl FromStr for Fault {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        Self::ALL
            .into_iter()
            .find(|fault| fault.name() == text)
            .ok_or_else(|| format!("unknown fault `{text}`"))
    }
}

/// Whether the gel of a tactile camera touches something.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) enum Touch {
    #[default]
    Free,
    Pressed,
}

/// Where images come from.
pub(crate) enum Images {
    /// JPEG files in a circle, each [`numbered`].
    Files {
        free: Vec<Arc<Vec<u8>>>,
        pressed: Vec<Arc<Vec<u8>>>,
    },
    /// Drawn for each frame.
    Drawn(Pixels),
}

impl Images {
    /// Reads `dir/free/*.jpg` and `dir/pressed/*.jpg`, or `dir/*.jpg` for both.
    pub(crate) fn from_dir(dir: &Path) -> io::Result<Self> {
        let pressed = dir.join("pressed");
        if pressed.is_dir() {
            Ok(Self::Files {
                free: jpeg_files(&dir.join("free"))?,
                pressed: jpeg_files(&pressed)?,
            })
        } else {
            let files = jpeg_files(dir)?;
            Ok(Self::Files {
                free: files.clone(),
                pressed: files,
            })
        }
    }

    fn image(&self, number: u64, touch: Touch, mode: Mode) -> Arc<Vec<u8>> {
        let (width, height) = (u32::from(mode.width), u32::from(mode.height));
        match self {
            Self::Files { free, pressed } => {
                let files = match touch {
                    Touch::Free => free,
                    Touch::Pressed => pressed,
                };
                let file = &files[(number % files.len() as u64) as usize];
                Arc::new(numbered(file, number))
            }
            Self::Drawn(Pixels::Z16) => Arc::new(pattern::depth(number, width, height)),
            Self::Drawn(Pixels::Grey) => Arc::new(pattern::grey(number, width, height)),
            Self::Drawn(Pixels::Yuyv | Pixels::Mjpg) => {
                Arc::new(pattern::colour(number, width, height))
            }
        }
    }
}

/// The JPEG with a comment segment that holds the image's number, big-endian, after its first
/// marker: as with a real camera, no two images have the same bytes.
pub(crate) fn numbered(jpeg: &[u8], number: u64) -> Vec<u8> {
    const COMMENT: [u8; 4] = [0xff, 0xfe, 0, 10];
    let (start, rest) = jpeg.split_at(jpeg.len().min(2));
    [start, &COMMENT, &number.to_be_bytes(), rest].concat()
}

fn jpeg_files(dir: &Path) -> io::Result<Vec<Arc<Vec<u8>>>> {
    let place =
        |error: io::Error| io::Error::new(error.kind(), format!("{}: {error}", dir.display()));
    let mut paths: Vec<PathBuf> = fs::read_dir(dir)
        .map_err(place)?
        .map(|entry| entry.map(|e| e.path()))
        .collect::<io::Result<_>>()
        .map_err(place)?;
    paths.retain(|path| path.extension().is_some_and(|e| e == "jpg"));
    paths.sort();
    if paths.is_empty() {
        let what = format!("{}: holds no .jpg file", dir.display());
        return Err(io::Error::new(io::ErrorKind::NotFound, what));
    }
    paths
        .iter()
        .map(|path| fs::read(path).map(Arc::new))
        .collect()
}

/// One image on its way.
pub(crate) struct Transmission {
    pub(crate) bytes: Arc<Vec<u8>>,
    /// Error bit of the payload headers.
    pub(crate) has_error_bit: bool,
    /// The second packet does not arrive.
    pub(crate) loses_packet: bool,
    pub(crate) clock: Clock,
}

/// The camera's clock in the headers of an image.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Clock {
    Runs,
    StandsStill,
    /// It is ahead by this much.
    Ahead(Duration),
}

/// How far a jumping clock jumps.
const JUMP: Duration = Duration::from_secs(10);

#[derive(Default)]
struct State {
    number: u64,
    touch: Touch,
    fault: Option<Fault>,
    /// Images that the fault still hits; `None` = until it is taken away.
    hits_left: Option<u32>,
    sent: u64,
    faults: BTreeMap<&'static str, u64>,
    first_sent: Option<Instant>,
    /// Starts of the stream that the camera still refuses.
    refused_starts: u32,
    /// Plugged in again, and nothing sent since.
    back_at: Option<Instant>,
    /// From each plugging in again to the next image, s.
    came_back_s: Vec<f64>,
}

/// See the module.
pub(crate) struct Feed {
    images: Images,
    state: Mutex<State>,
    changed: Condvar,
}

impl Feed {
    pub(crate) fn new(images: Images) -> Self {
        Self {
            images,
            state: Mutex::default(),
            changed: Condvar::new(),
        }
    }

    fn lock(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Sets or takes away a fault; it hits the next `images` images, or all.
    pub(crate) fn set_fault(&self, fault: Option<Fault>, images: Option<u32>) {
        let mut state = self.lock();
        state.fault = fault;
        state.hits_left = images;
    }

    /// Lets the camera refuse the next `times` starts of its stream.
    pub(crate) fn refuse_starts(&self, times: u32) {
        self.lock().refused_starts = times;
    }

    /// Whether the camera takes a start of its stream; counts the refused ones.
    pub(crate) fn takes_start(&self) -> bool {
        let mut state = self.lock();
        if state.refused_starts == 0 {
            return true;
        }
        state.refused_starts -= 1;
        *state.faults.entry("stall-commit").or_default() += 1;
        false
    }

    pub(crate) fn set_touch(&self, touch: Touch) {
        self.lock().touch = touch;
    }

    /// The next image; `None` where a fault keeps it back.
    pub(crate) fn next(&self, mode: Mode) -> Option<Transmission> {
        let mut state = self.lock();
        let fault = state.fault;
        if let Some(fault) = fault {
            *state.faults.entry(fault.name()).or_default() += 1;
            if let Some(left) = &mut state.hits_left {
                *left = left.saturating_sub(1);
                if *left == 0 {
                    state.fault = None;
                }
            }
        } else {
            state.sent += 1;
        }
        if fault != Some(Fault::Freeze) {
            state.number += 1;
        }
        if matches!(fault, Some(Fault::Silent | Fault::Drop)) {
            return None;
        }
        let mut bytes = self.images.image(state.number, state.touch, mode);
        match fault {
            Some(Fault::Truncate) => bytes = Arc::new(bytes[..bytes.len() / 2].to_vec()),
            Some(Fault::Corrupt) => bytes = Arc::new(corrupted(&bytes, state.number)),
            Some(Fault::Tail) => bytes = Arc::new(with_tail(&bytes)),
            Some(Fault::Lead) => bytes = Arc::new([&bytes[bytes.len() - 300..], &bytes].concat()),
            Some(Fault::NoEnd) => bytes = Arc::new(bytes[..bytes.len() - 2].to_vec()),
            Some(Fault::Zero) => bytes = Arc::new(vec![0; bytes.len()]),
            _ => {}
        }
        let now = Instant::now();
        state.first_sent.get_or_insert(now);
        if let Some(back_at) = state.back_at.take() {
            state.came_back_s.push((now - back_at).as_secs_f64());
        }
        self.changed.notify_all();
        Some(Transmission {
            bytes,
            has_error_bit: fault == Some(Fault::ErrorBit),
            loses_packet: fault == Some(Fault::LosePacket),
            clock: match fault {
                Some(Fault::StillClock) => Clock::StandsStill,
                Some(Fault::JumpingClock) => Clock::Ahead(JUMP * (state.number % 2) as u32),
                _ => Clock::Runs,
            },
        })
    }

    /// When the first image was sent; waits at most `timeout` for it.
    pub(crate) fn first_sent(&self, timeout: Duration) -> Option<Instant> {
        let (state, _) = self
            .changed
            .wait_timeout_while(self.lock(), timeout, |s| s.first_sent.is_none())
            .unwrap_or_else(PoisonError::into_inner);
        state.first_sent
    }

    /// The camera was plugged in; from now to its next image is the time of its coming back.
    pub(crate) fn plugged(&self) {
        let mut state = self.lock();
        if state.first_sent.is_some() {
            state.back_at = Some(Instant::now());
        }
    }

    /// From each plugging in again to the next image, s.
    pub(crate) fn came_back_s(&self) -> Vec<f64> {
        self.lock().came_back_s.clone()
    }

    /// Images sent intact, and hits by each fault.
    pub(crate) fn counters(&self) -> BTreeMap<&'static str, u64> {
        let state = self.lock();
        let mut counters = state.faults.clone();
        counters.insert("sent", state.sent);
        counters
    }
}

/// The image with a line feed, fill bytes and the tail of an older image behind it.
fn with_tail(bytes: &[u8]) -> Vec<u8> {
    let tail = &bytes[bytes.len() - 300..];
    [bytes, b"\n", &[0xff; 40], tail].concat()
}

/// The image with 200 bytes of its middle altered, each to a value that follows from `seed`.
fn corrupted(bytes: &[u8], seed: u64) -> Vec<u8> {
    const LENGTH: usize = 200;
    let mut bytes = bytes.to_vec();
    let start = bytes.len() / 2;
    let mut noise = seed | 1;
    for byte in bytes.iter_mut().skip(start).take(LENGTH) {
        noise ^= noise << 13;
        noise ^= noise >> 7;
        noise ^= noise << 17;
        // Never 0xff: that would start a marker and be found by a look at the markers alone.
        *byte = (noise % 0xff) as u8;
    }
    bytes
}

#[cfg(test)]
mod tests {
    use super::*;

    const MODE: Mode = Mode {
        width: 64,
        height: 4,
        fps: 30,
    };

    fn files() -> Feed {
        let image = |byte: u8| Arc::new(vec![byte; 986]);
        Feed::new(Images::Files {
            free: vec![image(1), image(2)],
            pressed: vec![image(3)],
        })
    }

    fn first_byte(feed: &Feed) -> Option<u8> {
        feed.next(MODE).map(|t| t.bytes[0])
    }

    #[test]
    fn images_go_round_and_follow_the_touch() {
        let feed = files();
        let seen: Vec<_> = (0..3).map(|_| first_byte(&feed)).collect();
        assert_eq!(seen, [Some(2), Some(1), Some(2)]);
        feed.set_touch(Touch::Pressed);
        assert_eq!(first_byte(&feed), Some(3));
        assert_eq!(feed.counters()["sent"], 4);
    }

    #[test]
    fn frame_number_makes_equal_images_differ() {
        let jpeg = [0xff, 0xd8, 0xff, 0xd9];
        let sent = numbered(&jpeg, 0x0102);
        assert_eq!(sent[2..14], [0xff, 0xfe, 0, 10, 0, 0, 0, 0, 0, 0, 1, 2]);
        assert_eq!([&sent[..2], &sent[14..]].concat(), jpeg);
        assert_ne!(numbered(&jpeg, 3), sent);
    }

    #[test]
    fn fault_hits_requested_number_of_images() {
        let feed = files();
        feed.set_fault(Some(Fault::Truncate), Some(2));
        let lengths: Vec<_> = (0..3)
            .map(|_| feed.next(MODE).unwrap().bytes.len())
            .collect();
        assert_eq!(lengths, [499, 499, 998]);
        assert_eq!(feed.counters()["truncate"], 2);
        assert_eq!(feed.counters()["sent"], 1);
    }

    #[test]
    fn frozen_repeats_and_dropped_skips() {
        let feed = files();
        assert_eq!(first_byte(&feed), Some(2));
        feed.set_fault(Some(Fault::Freeze), None);
        assert_eq!(first_byte(&feed), Some(2));
        assert_eq!(first_byte(&feed), Some(2));
        feed.set_fault(Some(Fault::Drop), Some(1));
        assert_eq!(first_byte(&feed), None);
        assert_eq!(first_byte(&feed), Some(2));
    }

    #[test]
    fn image_is_whole_among_strange_bytes() {
        let feed = files();
        let sent = |fault| {
            feed.set_fault(Some(fault), Some(1));
            feed.next(MODE).unwrap().bytes.to_vec()
        };
        let (tail, lead, no_end) = (sent(Fault::Tail), sent(Fault::Lead), sent(Fault::NoEnd));
        assert_eq!((tail.len(), lead.len(), no_end.len()), (1339, 1298, 996));
        assert_eq!(tail[998..1000], [b'\n', 0xff]);
        assert_eq!(sent(Fault::Zero), vec![0; 998]);
    }

    #[test]
    fn start_is_refused_as_often_as_requested() {
        let feed = files();
        feed.refuse_starts(2);
        let taken: Vec<bool> = (0..3).map(|_| feed.takes_start()).collect();
        assert_eq!(taken, [false, false, true]);
        assert_eq!(feed.counters()["stall-commit"], 2);
    }

    #[test]
    fn corruption_alters_the_middle_only() {
        let before = vec![0xff; 1000];
        let after = corrupted(&before, 7);
        assert_eq!(after.len(), before.len());
        assert_eq!(after[..500], before[..500]);
        assert!(after[500..700].iter().all(|&byte| byte != 0xff));
        assert_eq!(after[700..], before[700..]);
    }

    #[test]
    fn every_fault_has_its_own_name() {
        for fault in Fault::ALL {
            assert_eq!(fault.name().parse(), Ok(fault));
        }
        assert!("fire".parse::<Fault>().is_err());
    }
}
