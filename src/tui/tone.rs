//! Sounds for eyes that are on the object: short tones through the system's player, or bells.
//!
//! Tones are synthesised here and played by the first of `pw-play`, `paplay` and `aplay`. When
//! none is installed, or one fails (no sound server over SSH), the terminal bell rings a pattern.

use std::collections::VecDeque;
use std::f64::consts::TAU;
use std::ffi::OsStr;
use std::io::Write;
use std::os::fd::AsRawFd;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, Sender, SyncSender, channel, sync_channel};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use gripcast_session::Tone;

/// Samples per second of the synthesised tones.
const SAMPLE_RATE_HZ: u32 = 16_000;
/// Peak of the tones, of 1.
const LOUDNESS: f64 = 0.55;
/// A player that takes longer hangs and is killed.
const PLAYER_LIMIT: Duration = Duration::from_secs(2);
const PLAYER_POLL: Duration = Duration::from_millis(10);
/// Tones that may wait for the one that sounds; more are dropped, old news is noise.
const QUEUED_TONES: usize = 2;
const PLAYERS: [&str; 3] = ["pw-play", "paplay", "aplay"];

/// How tones are given.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, clap::ValueEnum)]
pub enum Sound {
    /// Through a sound player when one works, else by the terminal bell
    #[default]
    Auto,
    /// By the terminal bell
    Bell,
    /// Not at all
    Off,
}

/// One piece of a tone: frequency, Hz, 0 for a rest; and duration, ms.
type Note = (f64, u32);

/// The melody of a tone: up is good, down is bad, long and alternating is trouble.
fn melody(tone: Tone) -> &'static [Note] {
    match tone {
        Tone::InitialSaved => &[(660.0, 130)],
        Tone::GraspSaved => &[(660.0, 90), (0.0, 30), (880.0, 150)],
        Tone::Stable => &[(523.0, 90), (659.0, 90), (1047.0, 200)],
        Tone::Slip => &[(440.0, 130), (294.0, 230)],
        Tone::Undone => &[(784.0, 60), (0.0, 40), (784.0, 60), (0.0, 40), (587.0, 110)],
        Tone::Refused => &[(196.0, 140), (0.0, 60), (196.0, 140)],
        Tone::Fault => &[
            (988.0, 150),
            (622.0, 150),
            (988.0, 150),
            (622.0, 150),
            (988.0, 150),
            (622.0, 150),
        ],
    }
}

/// When the bell rings for a tone, ms after it was asked for.
fn bells(tone: Tone) -> &'static [u64] {
    match tone {
        Tone::InitialSaved => &[0],
        Tone::GraspSaved => &[0, 150],
        Tone::Stable => &[0, 150, 300],
        Tone::Slip => &[0, 500],
        Tone::Undone => &[0, 150, 650],
        Tone::Refused => &[0, 500, 650],
        Tone::Fault => &[0, 150, 300, 450, 600, 750],
    }
}

/// Samples of a tone, with 8 ms ramps so that notes do not click.
fn samples(notes: &[Note]) -> Vec<i16> {
    let rate = f64::from(SAMPLE_RATE_HZ);
    let ramp = 0.008 * rate;
    let mut samples = Vec::new();
    for &(frequency_hz, duration_ms) in notes {
        let count = duration_ms * SAMPLE_RATE_HZ / 1000;
        for index in 0..count {
            let from_edge = f64::from(index.min(count - 1 - index));
            let envelope = (from_edge / ramp).min(1.0);
            let phase = TAU * frequency_hz * f64::from(index) / rate;
            // The overtones carry low notes through small loudspeakers.
            let wave = 0.7 * phase.sin() + 0.2 * (2.0 * phase).sin() + 0.1 * (3.0 * phase).sin();
            samples.push((wave * envelope * LOUDNESS * f64::from(i16::MAX)) as i16);
        }
    }
    samples
}

/// A WAV file of the tone: 16 kHz, mono, 16 bit.
fn wav(tone: Tone) -> Vec<u8> {
    const BYTES_PER_SAMPLE: u32 = 2;
    let samples = samples(melody(tone));
    let data_bytes = samples.len() as u32 * BYTES_PER_SAMPLE;
    let mut file = Vec::with_capacity(44 + data_bytes as usize);
    file.extend(b"RIFF");
    file.extend((36 + data_bytes).to_le_bytes());
    file.extend(b"WAVEfmt ");
    file.extend(16_u32.to_le_bytes());
    file.extend(1_u16.to_le_bytes());
    file.extend(1_u16.to_le_bytes());
    file.extend(SAMPLE_RATE_HZ.to_le_bytes());
    file.extend((SAMPLE_RATE_HZ * BYTES_PER_SAMPLE).to_le_bytes());
    file.extend((BYTES_PER_SAMPLE as u16).to_le_bytes());
    file.extend(16_u16.to_le_bytes());
    file.extend(b"data");
    file.extend(data_bytes.to_le_bytes());
    file.extend(samples.iter().flat_map(|sample| sample.to_le_bytes()));
    file
}

/// The first sound player in the directories of `path` (the variable `PATH`).
fn player(path: Option<&OsStr>) -> Option<PathBuf> {
    let directories: Vec<_> = std::env::split_paths(path?).collect();
    PLAYERS.iter().find_map(|name| {
        directories
            .iter()
            .map(|directory| directory.join(name))
            .find(|file| file.is_file())
    })
}

/// Gives tones without ever waiting for them.
pub struct Speaker {
    voice: Voice,
    /// Moments at which the bell is due, in order.
    bells: VecDeque<Instant>,
}

enum Voice {
    Off,
    Bell,
    Player(PlayerThread),
}

impl Speaker {
    /// A speaker that looks for a player in this process's `PATH`.
    pub fn new(sound: Sound) -> Self {
        let found = || player(std::env::var_os("PATH").as_deref());
        let voice = match sound {
            Sound::Off => Voice::Off,
            Sound::Bell => Voice::Bell,
            Sound::Auto => found()
                .and_then(|program| PlayerThread::start(program).ok())
                .map_or(Voice::Bell, Voice::Player),
        };
        Self {
            voice,
            bells: VecDeque::new(),
        }
    }

    /// Gives `tone`; returns at once.
    pub fn give(&mut self, tone: Tone, now: Instant) {
        match &self.voice {
            Voice::Off => {}
            Voice::Bell => self.ring(tone, now),
            Voice::Player(player) => player.play(tone),
        }
    }

    /// How many bells are due; the caller writes them to its terminal between other output.
    pub fn bells_due(&mut self, now: Instant) -> usize {
        if let Voice::Player(player) = &self.voice {
            let unplayed: Vec<_> = player.unplayed.try_iter().collect();
            if !unplayed.is_empty() {
                self.voice = Voice::Bell;
            }
            for tone in unplayed {
                self.ring(tone, now);
            }
        }
        let due = self.bells.iter().take_while(|at| **at <= now).count();
        self.bells.drain(..due);
        due
    }

    /// A new tone replaces the rest of the one before: patterns must not mix.
    fn ring(&mut self, tone: Tone, now: Instant) {
        let at = |&ms: &u64| now + Duration::from_millis(ms);
        self.bells = bells(tone).iter().map(at).collect();
    }
}

/// A thread that runs the player, one tone after the other.
struct PlayerThread {
    /// `None` only while it is dropped.
    tones: Option<SyncSender<Tone>>,
    /// Tones that the player failed to play.
    unplayed: Receiver<Tone>,
    stop: Arc<AtomicBool>,
    thread: Option<JoinHandle<()>>,
}

impl PlayerThread {
    fn start(program: PathBuf) -> std::io::Result<Self> {
        let (tones, queue) = sync_channel(QUEUED_TONES);
        let (failures, unplayed) = channel();
        let stop = Arc::new(AtomicBool::new(false));
        let stopped = Arc::clone(&stop);
        let thread = std::thread::Builder::new()
            .name("tones".to_owned())
            .spawn(move || play_all(&program, &queue, &failures, &stopped))?;
        Ok(Self {
            tones: Some(tones),
            unplayed,
            stop,
            thread: Some(thread),
        })
    }

    fn play(&self, tone: Tone) {
        if let Some(tones) = &self.tones {
            // A full queue drops the tone: it would sound too late to mean anything.
            let _ = tones.try_send(tone);
        }
    }
}

impl Drop for PlayerThread {
    fn drop(&mut self) {
        self.stop.store(true, Ordering::Relaxed);
        self.tones = None;
        if let Some(thread) = self.thread.take() {
            let _ = thread.join();
        }
    }
}

fn play_all(program: &Path, queue: &Receiver<Tone>, failures: &Sender<Tone>, stop: &AtomicBool) {
    for tone in queue {
        if stop.load(Ordering::Relaxed) {
            return;
        }
        if play(program, tone, stop).is_err() && failures.send(tone).is_err() {
            return;
        }
    }
}

/// Plays one tone from memory to its end, or until `stop`.
fn play(program: &Path, tone: Tone, stop: &AtomicBool) -> std::io::Result<()> {
    // The player opens the memory file by our path, so it needs neither a name nor cleaning up.
    let memory = rustix::fs::memfd_create("gripcast-tone", rustix::fs::MemfdFlags::CLOEXEC)?;
    let mut file = std::fs::File::from(memory);
    file.write_all(&wav(tone))?;
    let path = format!("/proc/{}/fd/{}", std::process::id(), file.as_raw_fd());
    let child = Command::new(program)
        .arg(path)
        .stdin(Stdio::null())
        .stdout(Stdio::null())
        .stderr(Stdio::null())
        .spawn()?;
    wait(child, stop)
}

/// Waits for `child`; kills it when it hangs or when `stop` is set. The child is always reaped.
fn wait(mut child: Child, stop: &AtomicBool) -> std::io::Result<()> {
    let deadline = Instant::now() + PLAYER_LIMIT;
    loop {
        if let Some(status) = child.try_wait()? {
            let failed = || std::io::Error::other(format!("the player ended with {status}"));
            return status.success().then_some(()).ok_or_else(failed);
        }
        let stopped = stop.load(Ordering::Relaxed);
        if stopped || Instant::now() >= deadline {
            child.kill()?;
            child.wait()?;
            let hung = std::io::ErrorKind::TimedOut.into();
            return stopped.then_some(()).ok_or(hung);
        }
        std::thread::sleep(PLAYER_POLL);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const TONES: [Tone; 7] = [
        Tone::InitialSaved,
        Tone::GraspSaved,
        Tone::Stable,
        Tone::Slip,
        Tone::Undone,
        Tone::Refused,
        Tone::Fault,
    ];

    #[test]
    fn wav_files_have_a_right_header_and_length() {
        for tone in TONES {
            let file = wav(tone);
            let word = |at: usize| u32::from_le_bytes(file[at..at + 4].try_into().unwrap());
            assert_eq!(&file[..4], b"RIFF");
            assert_eq!(&file[8..16], b"WAVEfmt ");
            assert_eq!(word(4) as usize, file.len() - 8);
            assert_eq!(word(24), SAMPLE_RATE_HZ);
            assert_eq!(word(28), SAMPLE_RATE_HZ * 2);
            assert_eq!(&file[36..40], b"data");
            assert_eq!(word(40) as usize, file.len() - 44);
            let duration_ms: u32 = melody(tone)
                .iter()
                .map(|(_, duration_ms)| duration_ms)
                .sum();
            assert_eq!(
                word(40),
                duration_ms * SAMPLE_RATE_HZ / 1000 * 2,
                "{tone:?}"
            );
        }
    }

    #[test]
    fn tones_are_loud_do_not_clip_and_start_and_end_quietly() {
        for tone in TONES {
            let samples = samples(melody(tone));
            let peak = samples.iter().map(|s| s.unsigned_abs()).max().unwrap();
            assert!((12_000..=24_000).contains(&peak), "{tone:?} {peak}");
            assert_eq!(samples[0], 0);
            assert!(samples[samples.len() - 1].abs() < 100);
        }
    }

    #[test]
    fn every_tone_differs_in_melody_and_in_bells() {
        for (index, one) in TONES.into_iter().enumerate() {
            for other in TONES.into_iter().skip(index + 1) {
                assert_ne!(wav(one), wav(other), "{one:?} {other:?}");
                assert_ne!(bells(one), bells(other), "{one:?} {other:?}");
            }
        }
    }

    #[test]
    fn bells_are_due_in_time_and_a_new_tone_replaces_the_old() {
        let mut speaker = Speaker::new(Sound::Bell);
        let start = Instant::now();
        let after = |ms| start + Duration::from_millis(ms);
        speaker.give(Tone::Stable, start);
        assert_eq!(speaker.bells_due(start), 1);
        assert_eq!(speaker.bells_due(after(149)), 0);
        assert_eq!(speaker.bells_due(after(151)), 1);
        speaker.give(Tone::InitialSaved, after(200));
        assert_eq!(speaker.bells_due(after(5_000)), 1);
        assert_eq!(speaker.bells_due(after(9_000)), 0);
    }

    #[test]
    fn off_is_silent() {
        let mut speaker = Speaker::new(Sound::Off);
        let now = Instant::now();
        speaker.give(Tone::Fault, now);
        assert_eq!(speaker.bells_due(now + Duration::from_secs(9)), 0);
    }

    #[test]
    fn the_first_player_in_the_path_is_taken() {
        let directory = tempfile::tempdir().unwrap();
        let path = Some(directory.path().as_os_str());
        assert_eq!(player(path), None);
        for name in ["aplay", "paplay"] {
            std::fs::write(directory.path().join(name), "").unwrap();
        }
        assert_eq!(player(path), Some(directory.path().join("paplay")));
        assert_eq!(player(None), None);
    }

    #[test]
    fn a_failing_player_hands_its_tone_to_the_bell() {
        let mut speaker = Speaker {
            voice: Voice::Player(PlayerThread::start(PathBuf::from("/bin/false")).unwrap()),
            bells: VecDeque::new(),
        };
        let now = Instant::now();
        speaker.give(Tone::Slip, now);
        let Voice::Player(thread) = &speaker.voice else {
            panic!("the player was given up before it failed");
        };
        let tone = thread.unplayed.recv().unwrap();
        assert_eq!(tone, Tone::Slip);
        speaker.ring(tone, now);
        assert_eq!(speaker.bells_due(now), 1);
    }

    #[test]
    fn a_stopped_player_is_killed_and_reaped() {
        let child = Command::new("sleep").arg("60").spawn().unwrap();
        let id = child.id();
        wait(child, &AtomicBool::new(true)).unwrap();
        assert!(!Path::new(&format!("/proc/{id}")).exists());
    }
}
