//! Tones for operators who look at the object: through the system's sound player, or bells.
//!
//! Tones are synthesised here and played by the first of `pw-play`, `paplay` and `aplay`. If none
//! is installed, or one fails (no sound server over SSH), the terminal bell rings a pattern.

use std::collections::VecDeque;
use std::f64::consts::TAU;
use std::ffi::OsStr;
use std::fs::File;
use std::io::{self, Write};
use std::os::fd::AsRawFd;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

use gripcast_session::Tone;

/// Sample rate of the tones.
const SAMPLE_RATE_HZ: u32 = 16_000;
/// Peak amplitude of the tones, of 1.
const LOUDNESS: f64 = 0.55;
/// Time after which a hanging player is killed.
const PLAYER_TIMEOUT: Duration = Duration::from_secs(2);
/// Maximum queued tones; further ones would sound too late and are dropped.
const MAX_QUEUED_TONES: usize = 2;
const PLAYERS: [&str; 3] = ["pw-play", "paplay", "aplay"];

/// Output of tones.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, clap::ValueEnum)]
pub enum Sound {
    /// Sound player if one works, else terminal bell
    #[default]
    Auto,
    /// Terminal bell
    Bell,
    /// No sound
    Off,
}

/// Frequency, Hz (0 for a rest), and duration, ms.
type Note = (f64, u32);

/// Returns the melody of a tone: rising is good, falling is bad, long and alternating is a fault.
fn melody(tone: Tone) -> &'static [Note] {
    const ALARM: [Note; 2] = [(988.0, 150), (622.0, 150)];
    match tone {
        Tone::InitialSaved => &[(660.0, 130)],
        Tone::GraspSaved => &[(660.0, 90), (0.0, 30), (880.0, 150)],
        Tone::Stable => &[(523.0, 90), (659.0, 90), (1047.0, 200)],
        Tone::Slip => &[(440.0, 130), (294.0, 230)],
        Tone::Undone => &[(784.0, 60), (0.0, 40), (784.0, 60), (0.0, 40), (587.0, 110)],
        Tone::Refused => &[(196.0, 140), (0.0, 60), (196.0, 140)],
        Tone::Fault => &[ALARM[0], ALARM[1], ALARM[0], ALARM[1], ALARM[0], ALARM[1]],
    }
}

/// Returns the times of the bells of a tone, ms after its start.
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

/// Synthesises a tone, with 8 ms ramps to avoid clicks.
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
            // Overtones make low notes audible on small loudspeakers.
            let wave = 0.7 * phase.sin() + 0.2 * (2.0 * phase).sin() + 0.1 * (3.0 * phase).sin();
            samples.push((wave * envelope * LOUDNESS * f64::from(i16::MAX)) as i16);
        }
    }
    samples
}

/// Encodes a tone as a WAV file: 16 kHz, mono, 16 bits.
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

/// Finds the first sound player in the directories of `path` (the variable `PATH`).
fn find_player(path: Option<&OsStr>) -> Option<PathBuf> {
    let directories: Vec<_> = std::env::split_paths(path?).collect();
    PLAYERS.iter().find_map(|name| {
        directories
            .iter()
            .map(|directory| directory.join(name))
            .find(|file| file.is_file())
    })
}

/// Gives tones without waiting for them.
pub struct Speaker {
    output: Output,
    /// Due times of the bells, ascending.
    bells: VecDeque<Instant>,
}

enum Output {
    Off,
    Bell,
    Player(Player),
}

impl Speaker {
    /// Creates a speaker that searches for a player in `PATH`.
    pub fn new(sound: Sound) -> Self {
        let output = match sound {
            Sound::Off => Output::Off,
            Sound::Bell => Output::Bell,
            Sound::Auto => find_player(std::env::var_os("PATH").as_deref())
                .map_or(Output::Bell, |program| Output::Player(Player::new(program))),
        };
        Self {
            output,
            bells: VecDeque::new(),
        }
    }

    /// Starts or queues `tone`; returns at once.
    pub fn give(&mut self, tone: Tone, now: Instant) {
        match &mut self.output {
            Output::Off => {}
            Output::Bell => self.ring(tone, now),
            Output::Player(player) => player.enqueue(tone),
        }
        self.update(now);
    }

    /// Returns the number of due bells, which the caller writes to its terminal. Call it regularly:
    /// it also plays queued tones.
    pub fn bells_due(&mut self, now: Instant) -> usize {
        self.update(now);
        let due = self.bells.iter().take_while(|at| **at <= now).count();
        self.bells.drain(..due);
        due
    }

    /// Plays queued tones; after a failure of the player, the bell rings instead.
    fn update(&mut self, now: Instant) {
        if let Output::Player(player) = &mut self.output
            && let Err(tone) = player.update(now)
        {
            self.output = Output::Bell;
            self.ring(tone, now);
        }
    }

    /// A new pattern replaces the rest of the previous one.
    fn ring(&mut self, tone: Tone, now: Instant) {
        let at = |&ms: &u64| now + Duration::from_millis(ms);
        self.bells = bells(tone).iter().map(at).collect();
    }
}

/// Runs the player program, one tone after the other.
struct Player {
    program: PathBuf,
    queue: VecDeque<Tone>,
    playing: Option<Playing>,
}

/// A tone that is being played. Dropping it kills and reaps the program.
struct Playing {
    tone: Tone,
    child: Child,
    deadline: Instant,
    /// The tone's WAV file, which the program opens by our path.
    _file: File,
}

impl Player {
    fn new(program: PathBuf) -> Self {
        Self {
            program,
            queue: VecDeque::new(),
            playing: None,
        }
    }

    fn enqueue(&mut self, tone: Tone) {
        if self.queue.len() < MAX_QUEUED_TONES {
            self.queue.push_back(tone);
        }
    }

    /// Starts the next tone once the previous one has ended; returns a tone that failed.
    fn update(&mut self, now: Instant) -> Result<(), Tone> {
        if let Some(playing) = &mut self.playing {
            match playing.child.try_wait() {
                Ok(Some(status)) if status.success() => self.playing = None,
                Ok(None) if now < playing.deadline => return Ok(()),
                _ => return Err(playing.tone),
            }
        }
        if let Some(tone) = self.queue.pop_front() {
            self.playing = Some(Playing::start(&self.program, tone, now).map_err(|_| tone)?);
        }
        Ok(())
    }
}

impl Playing {
    fn start(program: &Path, tone: Tone, now: Instant) -> io::Result<Self> {
        // A memory file needs neither a name nor cleaning up.
        let memory = rustix::fs::memfd_create("gripcast-tone", rustix::fs::MemfdFlags::CLOEXEC)?;
        let mut file = File::from(memory);
        file.write_all(&wav(tone))?;
        let path = format!("/proc/{}/fd/{}", std::process::id(), file.as_raw_fd());
        let child = Command::new(program)
            .arg(path)
            .stdin(Stdio::null())
            .stdout(Stdio::null())
            .stderr(Stdio::null())
            .spawn()?;
        Ok(Self {
            tone,
            child,
            deadline: now + PLAYER_TIMEOUT,
            _file: file,
        })
    }
}

impl Drop for Playing {
    fn drop(&mut self) {
        // Both fail only if the program has already been reaped.
        let _ = self.child.kill();
        let _ = self.child.wait();
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
    fn wav_files_have_valid_header_and_length() {
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
    fn tones_are_loud_without_clipping_and_ramped() {
        for tone in TONES {
            let samples = samples(melody(tone));
            let peak = samples.iter().map(|s| s.unsigned_abs()).max().unwrap();
            assert!((12_000..=24_000).contains(&peak), "{tone:?} {peak}");
            assert_eq!(samples[0], 0);
            assert!(samples[samples.len() - 1].abs() < 100);
        }
    }

    #[test]
    fn tones_differ_in_melody_and_bells() {
        for (index, one) in TONES.into_iter().enumerate() {
            for other in TONES.into_iter().skip(index + 1) {
                assert_ne!(wav(one), wav(other), "{one:?} {other:?}");
                assert_ne!(bells(one), bells(other), "{one:?} {other:?}");
            }
        }
    }

    #[test]
    fn bells_are_timed_and_new_tone_replaces_old() {
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
    fn first_player_in_path_is_used() {
        let directory = tempfile::tempdir().unwrap();
        let path = Some(directory.path().as_os_str());
        assert_eq!(find_player(path), None);
        for name in ["aplay", "paplay"] {
            std::fs::write(directory.path().join(name), "").unwrap();
        }
        assert_eq!(find_player(path), Some(directory.path().join("paplay")));
        assert_eq!(find_player(None), None);
    }

    #[test]
    fn failing_player_falls_back_to_the_bell() {
        let mut speaker = Speaker {
            output: Output::Player(Player::new(PathBuf::from("/bin/false"))),
            bells: VecDeque::new(),
        };
        let start = Instant::now();
        speaker.give(Tone::Slip, start);
        let Output::Player(player) = &mut speaker.output else {
            panic!("the player has started");
        };
        player.playing.as_mut().unwrap().child.wait().unwrap();
        assert_eq!(speaker.bells_due(start), 1);
        assert!(matches!(speaker.output, Output::Bell));
    }

    #[test]
    fn queued_tones_are_played_in_order_and_limited() {
        let mut player = Player::new(PathBuf::from("/bin/true"));
        for tone in TONES {
            player.enqueue(tone);
        }
        assert_eq!(player.queue.make_contiguous(), &TONES[..MAX_QUEUED_TONES]);
        player.update(Instant::now()).unwrap();
        assert_eq!(player.playing.as_ref().unwrap().tone, TONES[0]);
    }

    #[test]
    fn stopped_player_is_killed_and_reaped() {
        let directory = tempfile::tempdir().unwrap();
        let program = directory.path().join("player");
        std::fs::write(&program, "#!/bin/sh\nexec sleep 60\n").unwrap();
        let permissions = std::os::unix::fs::PermissionsExt::from_mode(0o700);
        std::fs::set_permissions(&program, permissions).unwrap();
        let playing = Playing::start(&program, Tone::Stable, Instant::now()).unwrap();
        let id = playing.child.id();
        drop(playing);
        assert!(!Path::new(&format!("/proc/{id}")).exists());
    }
}
