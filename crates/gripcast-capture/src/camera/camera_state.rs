//! State of a camera: the one judgement that checks, screens, guards and the API share.

use std::collections::VecDeque;

use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use super::stream_monitor::Health;

/// Fraction of damaged frames above which a camera is damaged.
pub const MAX_DAMAGED_FRACTION: f64 = 0.1;
/// Fraction of damaged frames below which a damaged camera is live again.
const RECOVERED_FRACTION: f64 = 0.05;
/// Minimum number of frames that are judged by their fraction.
const MIN_FRAMES: usize = 8;
/// Minimum number of damaged frames of a damaged camera: the first frames of a stream are often cut.
const MIN_DAMAGED_FRAMES: usize = 3;
/// Newest frames that are judged while a camera runs: 2.5 s at 25/s.
const LIVE_FRAMES: usize = 64;

/// State of a camera.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(tag = "state", rename_all = "snake_case")]
pub enum CameraState {
    /// Being opened, or no frame was decoded yet.
    Opening,
    /// Frames arrive and decode.
    Live,
    /// Frames arrive, but many of them do not decode. Whole ones are used.
    Damaged {
        /// Damaged fraction of the newest frames, 0..1.
        fraction: f64,
        /// What the decoder or the driver said about the newest damaged frame.
        reason: String,
    },
    /// No frames arrive, but the device is present; reopened automatically.
    Silent {
        /// Seconds since the last frame.
        for_s: f64,
    },
    /// Frames arrive but the image does not change; reopened automatically.
    Frozen {
        /// Seconds since the last change.
        for_s: f64,
    },
    /// Depth frames arrive, but no pixel has a depth. They are used.
    NoValidDepth {
        /// Seconds since the last frame with a depth.
        for_s: f64,
    },
    /// The device is gone; reopened automatically.
    Unplugged {
        /// Error of the last attempt to open it.
        reason: String,
    },
    /// The device is present but cannot be opened; tried again automatically.
    Unavailable {
        /// Error of the last attempt to open it.
        reason: String,
    },
    /// A recorded stream has ended.
    Ended,
}

impl CameraState {
    /// Judges a camera by its stream and by the decoded frames.
    #[must_use]
    pub fn judge(health: &Health, quality: &FrameQuality, now_ns: u64) -> Self {
        let since_s = |since_ns: &u64| now_ns.saturating_sub(*since_ns) as f64 * 1e-9;
        match health {
            Health::Opening | Health::Live | Health::NoValidDepth { .. } if quality.is_damaged => {
                Self::Damaged {
                    fraction: quality.damaged_fraction(),
                    reason: quality.reason.clone(),
                }
            }
            Health::Live if !quality.has_whole_frame() => Self::Opening,
            Health::Opening => Self::Opening,
            Health::Live => Self::Live,
            Health::Silent { since_ns } => Self::Silent {
                for_s: since_s(since_ns),
            },
            Health::Frozen { since_ns } => Self::Frozen {
                for_s: since_s(since_ns),
            },
            Health::NoValidDepth { since_ns } => Self::NoValidDepth {
                for_s: since_s(since_ns),
            },
            Health::Unplugged { reason } => Self::Unplugged {
                reason: reason.clone(),
            },
            Health::Unavailable { reason } => Self::Unavailable {
                reason: reason.clone(),
            },
            Health::Ended => Self::Ended,
        }
    }

    /// Name in JSON.
    #[must_use]
    pub fn name(&self) -> &'static str {
        match self {
            Self::NoValidDepth { .. } => "no_valid_depth",
            _ => self.word(),
        }
    }

    /// The state in words.
    #[must_use]
    pub fn word(&self) -> &'static str {
        match self {
            Self::Opening => "opening",
            Self::Live => "live",
            Self::Damaged { .. } => "damaged",
            Self::Silent { .. } => "silent",
            Self::Frozen { .. } => "frozen",
            Self::NoValidDepth { .. } => "no valid depth",
            Self::Unplugged { .. } => "unplugged",
            Self::Unavailable { .. } => "unavailable",
            Self::Ended => "ended",
        }
    }

    /// Duration of the state, s; `None` for states without one.
    #[must_use]
    pub fn since_s(&self) -> Option<f64> {
        match self {
            Self::Silent { for_s } | Self::Frozen { for_s } | Self::NoValidDepth { for_s } => {
                Some(*for_s)
            }
            _ => None,
        }
    }

    /// Error or damage behind the state.
    #[must_use]
    pub fn reason(&self) -> Option<&str> {
        match self {
            Self::Damaged { reason, .. }
            | Self::Unplugged { reason }
            | Self::Unavailable { reason } => Some(reason),
            _ => None,
        }
    }

    /// Whether all is well.
    #[must_use]
    pub fn is_live(&self) -> bool {
        matches!(self, Self::Live)
    }

    /// Whether whole new frames arrive, so that a trigger can use them.
    #[must_use]
    pub fn delivers_frames(&self) -> bool {
        matches!(
            self,
            Self::Live | Self::Damaged { .. } | Self::NoValidDepth { .. }
        )
    }

    /// Whether the camera needs a person. Opening and the end of a recording are no faults; neither
    /// is missing depth, which is usual close to an object.
    #[must_use]
    pub fn is_fault(&self) -> bool {
        match self {
            Self::Damaged { .. }
            | Self::Silent { .. }
            | Self::Frozen { .. }
            | Self::Unplugged { .. }
            | Self::Unavailable { .. } => true,
            Self::Opening | Self::Live | Self::NoValidDepth { .. } | Self::Ended => false,
        }
    }

    /// Why frames are missing or wrong, one sentence without the role; `None` for a live camera.
    #[must_use]
    pub fn fault_text(&self) -> Option<String> {
        Some(match self {
            Self::Live => return None,
            Self::Opening => "not open yet".to_owned(),
            Self::Damaged { fraction, reason } => {
                format!("{} of its frames are damaged: {reason}", percent(*fraction))
            }
            Self::Silent { for_s } => format!("silent for {for_s:.1} s"),
            Self::Frozen { for_s } => format!("image frozen for {for_s:.1} s"),
            Self::NoValidDepth { for_s } => format!(
                "depth sees nothing for {for_s:.1} s: too close, too dark, or the emitter is off"
            ),
            Self::Unplugged { reason } => format!("unplugged: {reason}"),
            Self::Unavailable { reason } => format!("cannot be opened: {reason}"),
            Self::Ended => "the recording has ended".to_owned(),
        })
    }
}

/// A fraction in percent: `87 %`; never 0 or 100 for what is neither.
#[must_use]
pub fn percent(fraction: f64) -> String {
    let percent = fraction * 100.0;
    match percent {
        _ if percent > 0.0 && percent < 1.0 => "< 1 %".to_owned(),
        _ if percent > 99.0 && percent < 100.0 => "> 99 %".to_owned(),
        _ => format!("{percent:.0} %"),
    }
}

/// Verdicts on the newest frames.
#[derive(Clone, Debug, Default)]
struct Verdicts {
    /// Whether each frame is damaged, oldest first.
    newest: VecDeque<bool>,
    damaged: usize,
}

impl Verdicts {
    fn add(&mut self, is_damaged: bool, limit: usize) {
        if self.newest.len() >= limit && self.newest.pop_front() == Some(true) {
            self.damaged -= 1;
        }
        self.newest.push_back(is_damaged);
        self.damaged += usize::from(is_damaged);
    }

    fn damaged_fraction(&self) -> f64 {
        self.damaged as f64 / self.newest.len().max(1) as f64
    }
}

/// Quality of the frames of a stream. Every frame arrives; as many as time allows are decoded.
#[derive(Clone, Debug)]
pub struct FrameQuality {
    arrived: Verdicts,
    decoded: Verdicts,
    limit: usize,
    reason: String,
    is_damaged: bool,
}

impl Default for FrameQuality {
    fn default() -> Self {
        Self {
            arrived: Verdicts::default(),
            decoded: Verdicts::default(),
            limit: LIVE_FRAMES,
            reason: String::new(),
            is_damaged: false,
        }
    }
}

impl FrameQuality {
    /// Quality over all frames of a measurement, instead of the newest ones.
    #[must_use]
    pub fn of_measurement() -> Self {
        Self {
            limit: usize::MAX,
            ..Self::default()
        }
    }

    /// A frame of sound structure arrived; it may be decoded later.
    pub fn arrived(&mut self) {
        self.arrived.add(false, self.limit);
        self.update();
    }

    /// A frame arrived that needs no decoding to be refused.
    pub fn refused(&mut self, reason: String) {
        self.arrived.add(true, self.limit);
        self.reason = reason;
        self.update();
    }

    /// A frame of sound structure was decoded without damage.
    pub fn decoded(&mut self) {
        self.decoded.add(false, self.limit);
        self.update();
    }

    /// A frame of sound structure could not be decoded.
    pub fn undecodable(&mut self, reason: String) {
        self.decoded.add(true, self.limit);
        self.reason = reason;
        self.update();
    }

    /// Whether one of the frames was decoded without damage.
    fn has_whole_frame(&self) -> bool {
        self.decoded.newest.len() > self.decoded.damaged
    }

    /// Damaged fraction of the frames, 0..1.
    #[must_use]
    pub fn damaged_fraction(&self) -> f64 {
        1.0 - (1.0 - self.arrived.damaged_fraction()) * (1.0 - self.decoded.damaged_fraction())
    }

    /// What was wrong with the newest damaged frame; empty without one.
    #[must_use]
    pub fn reason(&self) -> &str {
        &self.reason
    }

    fn update(&mut self) {
        let judged = self.arrived.damaged + self.decoded.newest.len();
        let is_repeated = self.arrived.damaged + self.decoded.damaged >= MIN_DAMAGED_FRAMES;
        let fraction = self.damaged_fraction();
        self.is_damaged = match self.is_damaged {
            true => fraction >= RECOVERED_FRACTION,
            false => judged >= MIN_FRAMES && is_repeated && fraction > MAX_DAMAGED_FRACTION,
        };
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn played(kinds: impl IntoIterator<Item = char>) -> (FrameQuality, CameraState) {
        let mut quality = FrameQuality::default();
        for kind in kinds {
            match kind {
                'r' => quality.refused("cut".to_owned()),
                'd' => {
                    quality.arrived();
                    quality.undecodable("corrupt".to_owned());
                }
                _ => {
                    quality.arrived();
                    quality.decoded();
                }
            }
        }
        let state = CameraState::judge(&Health::Live, &quality, 0);
        (quality, state)
    }

    #[test]
    fn frames_that_arrive_but_do_not_decode_are_damage_not_silence() {
        for kind in ['r', 'd'] {
            let (_, state) = played([kind; 30]);
            let CameraState::Damaged { fraction, .. } = state else {
                panic!("{state:?}");
            };
            assert_eq!(fraction, 1.0);
        }
        let (_, state) = played("grrrrrrr".chars().cycle().take(200));
        let expected = CameraState::Damaged {
            fraction: 0.875,
            reason: "cut".to_owned(),
        };
        assert_eq!(state, expected);
        assert_eq!(
            state.fault_text().unwrap(),
            "88 % of its frames are damaged: cut"
        );
        assert!(state.delivers_frames() && state.is_fault() && !state.is_live());
    }

    #[test]
    fn damage_in_both_ways_adds_up() {
        let (quality, _) = played("rdgg".chars().cycle().take(64));
        assert!((quality.damaged_fraction() - 0.5).abs() < 1e-9);
    }

    #[test]
    fn rare_damage_and_a_cut_first_frame_are_live() {
        for kinds in [
            "d".to_owned() + &"g".repeat(20),
            "dggggggggggggggggggg".repeat(5),
        ] {
            assert_eq!(played(kinds.chars()).1, CameraState::Live, "{kinds}");
        }
        assert_eq!(played("rdr".chars()).1, CameraState::Opening);
    }

    #[test]
    fn damaged_camera_recovers_below_half_the_limit() {
        let ill = "r".repeat(10);
        assert!(matches!(played(ill.chars()).1, CameraState::Damaged { .. }));
        assert!(matches!(
            played((ill.clone() + &"g".repeat(58)).chars()).1,
            CameraState::Damaged { .. }
        ));
        assert_eq!(played((ill + &"g".repeat(64)).chars()).1, CameraState::Live);
    }

    #[test]
    fn absence_and_silence_come_before_damage() {
        let (quality, _) = played(['r'; 30]);
        let silent = Health::Silent { since_ns: 0 };
        assert_eq!(
            CameraState::judge(&silent, &quality, 2_000_000_000),
            CameraState::Silent { for_s: 2.0 }
        );
        let reason = "no such device".to_owned();
        let unplugged = Health::Unplugged {
            reason: reason.clone(),
        };
        assert_eq!(
            CameraState::judge(&unplugged, &quality, 0),
            CameraState::Unplugged { reason }
        );
    }

    #[test]
    fn names_are_those_of_json() {
        let reason = String::new();
        for state in [
            CameraState::Opening,
            CameraState::Live,
            CameraState::Damaged {
                fraction: 0.5,
                reason: reason.clone(),
            },
            CameraState::Silent { for_s: 1.0 },
            CameraState::Frozen { for_s: 1.0 },
            CameraState::NoValidDepth { for_s: 1.0 },
            CameraState::Unplugged {
                reason: reason.clone(),
            },
            CameraState::Unavailable { reason },
            CameraState::Ended,
        ] {
            let json = serde_json::to_value(&state).unwrap();
            assert_eq!(json["state"], state.name());
        }
    }

    #[test]
    fn percentages_are_never_rounded_to_all_or_nothing() {
        assert_eq!(percent(0.872), "87 %");
        assert_eq!(percent(0.001), "< 1 %");
        assert_eq!(percent(0.999), "> 99 %");
        assert_eq!(percent(1.0), "100 %");
    }
}
