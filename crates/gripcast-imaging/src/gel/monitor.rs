//! The state of one gel over time: level, clipping, noise, flicker, drift and named problems.

use std::collections::VecDeque;

use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use super::cells::{CELLS, GelCells, quantile};

/// Time that the monitor looks back, ns.
const WINDOW_NS: u64 = 5_000_000_000;
/// Maximum frames in the window.
const WINDOW_FRAMES: usize = 150;
/// Time over which drift is measured, ns.
const DRIFT_NS: u64 = 1_000_000_000;
/// Frames from which drift is measured.
const MIN_DRIFT_FRAMES: usize = 7;
/// Maximum pause between frames, ns; a longer one starts a new window.
const MAX_PAUSE_NS: u64 = 1_000_000_000;

/// Level that 95 % of a black gel's cells are below, in every channel. Gels have at least 100 in
/// their brightest channel.
pub(super) const BLACK_LEVEL: f32 = 25.0;
/// Level that 95 % of the cells are below in the channel of a dead lamp.
pub(super) const DEAD_LAMP_LEVEL: f32 = 15.0;
/// Level that 5 % of the cells exceed in another channel for a lamp to count as dead.
pub(super) const LIT_LEVEL: f32 = 50.0;
/// Maximum fraction of clipped pixels.
const MAX_CLIPPED: f32 = 0.1;
/// Maximum mean difference of neighbouring pixels, grey levels. Gels have 1 to 3, with markers 4.
const MAX_GRAIN: f32 = 20.0;
/// Minimum change of brightness or colour that counts as one swing of flicker, fraction.
const MIN_SWING: f32 = 0.015;
/// Swings from which the light flickers. Closing and opening on an object gives at most two.
const MIN_SWINGS: usize = 6;
/// Drift that is a problem, fraction per second.
const MAX_DRIFT_PER_S: f32 = 0.03;
/// Maximum noise of a cell, grey levels. Gels have 0.1 to 0.5.
const MAX_NOISE_LEVELS: f32 = 4.0;
/// Changes between frames from which noise is a problem.
const MIN_NOISE_FRAMES: usize = 10;
/// Levels of cells whose ratio between two frames is measured.
const MEASURABLE: std::ops::RangeInclusive<f32> = 8.0..=245.0;

/// A problem of a gel's image.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum GelProblem {
    /// The image is black.
    Black,
    /// One lamp is dead: its colour is missing (`lamp_dead`).
    LampDead,
    /// Much of the image is clipped.
    Saturated,
    /// The image is noise.
    Noisy,
    /// Brightness or colour goes up and down.
    Flickering,
    /// Brightness or colour changes steadily.
    Drifting,
    /// The image is that of the other gel.
    Swapped,
    /// With the gripper open, a part of the image stays other than in the last initial frame.
    Marked,
}

impl GelProblem {
    /// What is wrong.
    #[must_use]
    pub fn what(self) -> &'static str {
        match self {
            Self::Black => "image is black",
            Self::LampDead => "one colour is missing: a lamp is dead",
            Self::Saturated => "image is saturated",
            Self::Noisy => "image is mostly noise",
            Self::Flickering => "brightness or colour flickers",
            Self::Drifting => "brightness or colour drifts",
            Self::Swapped => {
                "the sensors are swapped: this is the other gel of the last initial frame"
            }
            Self::Marked => "a part of the gel stays other than in the last initial frame",
        }
    }

    /// What to do about it.
    #[must_use]
    pub fn remedy(self) -> &'static str {
        match self {
            Self::Black => "check the sensor's lamps, its cable and its exposure setting",
            Self::LampDead => "replug the sensor, else have it repaired",
            Self::Saturated => {
                "lower exposure_time_absolute or gain in the rig file, shield the gel from other light"
            }
            Self::Noisy => "check the lamps and the cable, lower the gain in the rig file",
            Self::Flickering => {
                "switch auto_exposure and white_balance_automatic off and set power_line_frequency \
                 in the rig file, shield the gel from lamps"
            }
            Self::Drifting => {
                "switch auto_exposure and white_balance_automatic off in the rig file, let the \
                 sensor warm up"
            }
            Self::Swapped => "swap the plugs, or the roles in the rig file",
            Self::Marked => "open the gripper, then clean the gel or look for damage",
        }
    }

    /// The problem with its remedy.
    #[must_use]
    pub fn text(self) -> String {
        format!("{}: {}", self.what(), self.remedy())
    }
}

/// The state of one gel.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct GelState {
    /// Mean level of red, green and blue in the newest frame, 0 to 255.
    pub level: [f32; 3],
    /// Fraction of clipped pixels in the newest frame, 0 to 1.
    pub clipped_fraction: f32,
    /// Noise of the mean of 64 pixels between consecutive frames, grey levels; absent before the
    /// second frame.
    pub noise_levels: Option<f32>,
    /// Largest swing of brightness or colour in the last 5 s, fraction; 0 without flicker.
    pub flicker: f32,
    /// Change of brightness or colour per second over the last second, fraction; 0 unless steady.
    pub drift_per_s: f32,
    /// Problems.
    pub problems: Vec<GelProblem>,
}

/// Follows the images of one gel.
///
/// Brightness and colour are medians over the gel of the ratio of consecutive frames, so that a
/// contact that covers less than half of the gel does not count.
#[derive(Debug, Default)]
pub struct GelMonitor {
    previous: Option<GelCells>,
    samples: VecDeque<Sample>,
    state: Option<GelState>,
}

#[derive(Clone, Copy, Debug)]
struct Sample {
    time_ns: u64,
    /// Logarithm of the level of each channel relative to the first sample.
    log_level: [f32; 3],
    noise_levels: Option<f32>,
}

impl GelMonitor {
    /// Forgets the earlier frames, which something touched.
    pub fn restart(&mut self) {
        self.samples.clear();
    }

    /// Adds the next frame; `time_ns` is its driver time. Returns the new state.
    pub fn add(&mut self, cells: GelCells, time_ns: u64) -> &GelState {
        let newest = self.samples.back().copied();
        let step = newest.zip(self.previous.as_ref()).filter(|(newest, _)| {
            let pause = time_ns.checked_sub(newest.time_ns);
            pause.is_some_and(|pause| pause <= MAX_PAUSE_NS)
        });
        let step = step.and_then(|(newest, before)| Some((newest, Step::between(before, &cells)?)));
        let sample = match step {
            Some((newest, step)) => Sample {
                time_ns,
                log_level: std::array::from_fn(|c| newest.log_level[c] + step.log_ratio[c]),
                noise_levels: Some(step.noise_levels),
            },
            None => {
                self.samples.clear();
                Sample {
                    time_ns,
                    log_level: [0.0; 3],
                    noise_levels: None,
                }
            }
        };
        self.samples.push_back(sample);
        while self.samples.len() > WINDOW_FRAMES
            || self
                .samples
                .front()
                .is_some_and(|s| s.time_ns + WINDOW_NS < time_ns)
        {
            self.samples.pop_front();
        }
        let state = self.judge(&cells);
        self.previous = Some(cells);
        self.state.insert(state)
    }

    /// The state after the newest frame.
    #[must_use]
    pub fn state(&self) -> Option<&GelState> {
        self.state.as_ref()
    }

    fn judge(&self, cells: &GelCells) -> GelState {
        let mut noise: Vec<f32> = self.samples.iter().filter_map(|s| s.noise_levels).collect();
        let noise_levels = (!noise.is_empty()).then(|| quantile(&mut noise, 0.5));
        let largest = |measure: &dyn Fn(usize) -> f32| (0..3).map(measure).fold(0.0, f32::max);
        let flicker = largest(&|c| swing(self.samples.iter().map(|s| s.log_level[c])));
        let drift_per_s = largest(&|c| self.drift_per_s(c));
        let bright = cells.quantiles(0.95);
        let brightest = bright.into_iter().fold(0.0, f32::max);
        let darkest = bright.into_iter().fold(f32::INFINITY, f32::min);
        // Fingers that close change most frames of a short window, noise changes all.
        let is_noisy =
            noise.len() >= MIN_NOISE_FRAMES && quantile(&mut noise, 0.25) > MAX_NOISE_LEVELS;
        let problems = [
            (GelProblem::Black, brightest < BLACK_LEVEL),
            (
                GelProblem::LampDead,
                darkest < DEAD_LAMP_LEVEL && brightest > LIT_LEVEL,
            ),
            (GelProblem::Saturated, cells.clipped_fraction > MAX_CLIPPED),
            (GelProblem::Noisy, is_noisy || cells.grain > MAX_GRAIN),
            (GelProblem::Flickering, flicker > 0.0),
            // A slow flicker rises steadily for a second as well.
            (
                GelProblem::Drifting,
                flicker == 0.0 && drift_per_s > MAX_DRIFT_PER_S,
            ),
        ];
        GelState {
            level: cells.mean_levels(),
            clipped_fraction: cells.clipped_fraction,
            noise_levels,
            flicker,
            drift_per_s,
            problems: problems.into_iter().filter(|p| p.1).map(|p| p.0).collect(),
        }
    }

    /// Change of a channel per second over the newest second, fraction; 0 unless each third of it
    /// contributes.
    fn drift_per_s(&self, channel: usize) -> f32 {
        let Some(newest) = self.samples.back() else {
            return 0.0;
        };
        let is_recent = |s: &&Sample| s.time_ns + DRIFT_NS + DRIFT_NS / 5 >= newest.time_ns;
        let recent: Vec<&Sample> = self.samples.iter().filter(is_recent).collect();
        let (Some(first), count) = (recent.first(), recent.len()) else {
            return 0.0;
        };
        let span_ns = newest.time_ns.saturating_sub(first.time_ns);
        if count < MIN_DRIFT_FRAMES || span_ns < DRIFT_NS * 4 / 5 {
            return 0.0;
        }
        let level = |third: usize| recent[third * (count - 1) / 3].log_level[channel];
        let change = level(3) - level(0);
        let is_steady = (0..3).all(|i| (level(i + 1) - level(i)) / change > 0.2);
        match is_steady {
            true => change.abs() / (span_ns as f32 * 1e-9),
            false => 0.0,
        }
    }
}

/// Change between consecutive frames.
struct Step {
    /// Logarithm of the ratio of the levels, by channel.
    log_ratio: [f32; 3],
    /// Noise of a cell, grey levels.
    noise_levels: f32,
}

impl Step {
    /// `None` if all cells of a channel are black or clipped.
    fn between(before: &GelCells, now: &GelCells) -> Option<Self> {
        let mut noise = Vec::with_capacity(3 * CELLS);
        let mut log_ratio = [0.0; 3];
        for (c, log_ratio) in log_ratio.iter_mut().enumerate() {
            let pairs = before.levels[c].iter().zip(&now.levels[c]);
            let pairs = pairs.filter(|(a, b)| MEASURABLE.contains(*a) && MEASURABLE.contains(*b));
            let mut ratios: Vec<f32> = pairs.clone().map(|(a, b)| b / a).collect();
            if ratios.is_empty() {
                continue;
            }
            let ratio = quantile(&mut ratios, 0.5);
            *log_ratio = ratio.ln();
            noise.extend(pairs.map(|(a, b)| (b - a * ratio).abs()));
        }
        // Median of the absolute difference of two draws to standard deviation of one.
        (!noise.is_empty()).then(|| Self {
            log_ratio,
            noise_levels: quantile(&mut noise, 0.5) * 1.483 * std::f32::consts::FRAC_1_SQRT_2,
        })
    }
}

/// Largest swing of a series that goes up and down at least [`MIN_SWINGS`] times, else 0.
fn swing(levels: impl Iterator<Item = f32>) -> f32 {
    let (mut swings, mut largest) = (0, 0.0_f32);
    // Direction (1 up, −1 down), start and newest extreme of the swing in progress.
    let (mut direction, mut start, mut extreme) = (0.0, None, 0.0);
    for level in levels {
        let start = start.get_or_insert(level);
        if direction == 0.0 {
            extreme = *start;
        }
        let forward = (level - extreme) * direction;
        if forward > 0.0 {
            extreme = level;
        } else if (level - extreme).abs() > MIN_SWING {
            direction = (level - extreme).signum();
            (*start, extreme) = (extreme, level);
            swings += 1;
        }
        largest = largest.max((extreme - *start).abs());
    }
    if swings >= MIN_SWINGS { largest } else { 0.0 }
}
