//! Monitors a stream by the times and counters of its frames.

use std::collections::VecDeque;

use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

/// Limits of supervision.
#[derive(Clone, Debug, PartialEq)]
pub struct SupervisionPolicy {
    /// Window of the measured frame rate, ns.
    pub fps_window_ns: u64,
    /// Nominal intervals without a frame after which the camera is silent.
    pub silent_periods: f64,
    /// Minimum time without a frame after which the camera is silent, ns.
    pub silent_after_ns: u64,
    /// Time after which a silent or frozen camera is reopened, ns.
    pub reopen_after_ns: u64,
    /// Time of repeated frames after which the image is frozen, ns; `None` for sources that may
    /// repeat frames.
    pub freeze_after_ns: Option<u64>,
    /// Time of depth frames without depth after which depth is missing, ns.
    pub no_depth_after_ns: u64,
    /// Initial backoff between attempts to open, ns; doubles with each failure.
    pub first_backoff_ns: u64,
    /// Maximum backoff, ns.
    pub max_backoff_ns: u64,
    /// Timeout for a frame, ns; bounds the response time to a stop request.
    pub frame_timeout_ns: u64,
    /// Maximum interval between reports, ns.
    pub report_every_ns: u64,
    /// Interval of reading the controls, ns; `None`: only after opening.
    pub controls_every_ns: Option<u64>,
}

impl Default for SupervisionPolicy {
    fn default() -> Self {
        Self {
            fps_window_ns: 2_000_000_000,
            silent_periods: 8.0,
            silent_after_ns: 250_000_000,
            reopen_after_ns: 3_000_000_000,
            freeze_after_ns: Some(1_000_000_000),
            no_depth_after_ns: 1_000_000_000,
            first_backoff_ns: 250_000_000,
            max_backoff_ns: 1_000_000_000,
            frame_timeout_ns: 100_000_000,
            report_every_ns: 200_000_000,
            controls_every_ns: Some(1_000_000_000),
        }
    }
}

/// Health of a stream. Whether its frames decode is not known here: see
/// [`super::CameraState`].
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Health {
    /// Opening, or waiting for the first frame.
    Opening,
    /// Frames arrive.
    Live,
    /// No frames from a connected device.
    Silent {
        /// Time of the last frame or of opening, ns.
        since_ns: u64,
    },
    /// The same frame is repeated.
    Frozen {
        /// Time of the first of the repeated frames, ns.
        since_ns: u64,
    },
    /// Depth frames without depth.
    NoValidDepth {
        /// Time of the last frame with a depth or of opening, ns.
        since_ns: u64,
    },
    /// Unplugged; retried.
    Unplugged {
        /// Error of the last attempt to open it.
        reason: String,
    },
    /// Present, but it cannot be opened; retried.
    Unavailable {
        /// Error of the last attempt to open it.
        reason: String,
    },
    /// A recorded stream has ended.
    Ended,
}

/// Counters since the start of the program.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
pub struct CameraCounters {
    /// Usable frames.
    pub received: u64,
    /// Frames missing in the driver's sequence.
    pub sequence_gaps: u64,
    /// Damaged frames.
    pub damaged: u64,
    /// Frames later than twice the nominal interval.
    pub late: u64,
    /// Frames equal to their predecessor.
    pub duplicates: u64,
    /// Number of reopens.
    pub reconnects: u64,
}

/// State of a stream.
#[derive(Clone, Debug, PartialEq)]
pub struct StreamReport {
    /// Health.
    pub health: Health,
    /// Counters.
    pub counters: CameraCounters,
    /// Rate of arriving frames over the policy's window, 1/s; 0 with fewer than two frames.
    pub measured_fps: f64,
}

/// A usable frame as seen by the monitor.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct FrameFacts {
    /// Driver's frame counter.
    pub sequence: u32,
    /// Time of reception, ns.
    pub received_ns: u64,
    /// What it shows.
    pub content: FrameContent,
}

/// What a frame shows, compared with its predecessor.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FrameContent {
    /// Something new.
    New,
    /// The same bytes.
    Repeated,
    /// A depth frame without depth.
    NoDepth,
}

/// State machine of a camera's health and counters.
#[derive(Debug)]
pub struct StreamMonitor {
    policy: SupervisionPolicy,
    interval_ns: u64,
    health: Health,
    counters: CameraCounters,
    arrivals_ns: VecDeque<u64>,
    last_sequence: Option<u32>,
    arrived_ns: u64,
    changed_ns: u64,
    depth_ns: u64,
    has_frame: bool,
    was_open: bool,
}

impl StreamMonitor {
    /// A camera that has not been opened yet.
    pub fn new(policy: SupervisionPolicy) -> Self {
        Self {
            policy,
            interval_ns: 0,
            health: Health::Opening,
            counters: CameraCounters::default(),
            arrivals_ns: VecDeque::new(),
            last_sequence: None,
            arrived_ns: 0,
            changed_ns: 0,
            depth_ns: 0,
            has_frame: false,
            was_open: false,
        }
    }

    /// The camera was opened; its sequence restarts.
    pub fn opened(&mut self, now_ns: u64, nominal_fps: f64) {
        if self.was_open {
            self.counters.reconnects += 1;
        }
        self.was_open = true;
        self.interval_ns = if nominal_fps > 0.0 {
            (1e9 / nominal_fps) as u64
        } else {
            0
        };
        self.arrivals_ns.clear();
        self.last_sequence = None;
        self.has_frame = false;
        self.arrived_ns = now_ns;
        self.changed_ns = now_ns;
        self.depth_ns = now_ns;
        // A silent or frozen camera that is reopened stays so until its frames prove otherwise.
        if !matches!(self.health, Health::Silent { .. } | Health::Frozen { .. }) {
            self.health = Health::Opening;
        }
    }

    /// A usable frame was received.
    pub fn frame(&mut self, facts: FrameFacts) {
        self.count_gap(facts.sequence);
        self.counters.received += 1;
        if self.has_frame
            && self.interval_ns > 0
            && facts.received_ns.saturating_sub(self.arrived_ns) > 2 * self.interval_ns
        {
            self.counters.late += 1;
        }
        if facts.content == FrameContent::Repeated && self.has_frame {
            self.counters.duplicates += 1;
        } else {
            self.changed_ns = facts.received_ns;
        }
        if facts.content != FrameContent::NoDepth {
            self.depth_ns = facts.received_ns;
        }
        let was_frozen = matches!(self.health, Health::Frozen { .. });
        let is_first = !self.has_frame;
        self.has_frame = true;
        self.arrived(facts.received_ns);
        let no_depth_ns = facts.received_ns.saturating_sub(self.depth_ns);
        if was_frozen && (is_first || facts.content == FrameContent::Repeated) {
            // After reopening, one frame does not prove a change.
            return;
        }
        self.health = if self.is_frozen(facts.received_ns) {
            Health::Frozen {
                since_ns: self.changed_ns,
            }
        } else if no_depth_ns > self.policy.no_depth_after_ns {
            Health::NoValidDepth {
                since_ns: self.depth_ns,
            }
        } else {
            Health::Live
        };
    }

    /// A damaged frame was received.
    pub fn damaged(&mut self, sequence: u32, now_ns: u64) {
        self.count_gap(sequence);
        self.counters.damaged += 1;
        self.arrived(now_ns);
        self.changed_ns = now_ns;
        self.health = Health::Live;
    }

    fn arrived(&mut self, now_ns: u64) {
        self.arrived_ns = now_ns;
        self.arrivals_ns.push_back(now_ns);
        self.drop_old_arrivals(now_ns);
    }

    /// The camera is closed: unplugged or unavailable, or `None` to reopen it after silence.
    pub fn closed(&mut self, health: Option<Health>) {
        self.arrivals_ns.clear();
        if let Some(health) = health {
            self.health = health;
        }
    }

    /// A recorded stream has ended.
    pub fn ended(&mut self) {
        self.health = Health::Ended;
    }

    /// Updates the health of an open camera; whether it must be reopened.
    pub fn tick(&mut self, now_ns: u64) -> bool {
        self.drop_old_arrivals(now_ns);
        let quiet_ns = now_ns.saturating_sub(self.arrived_ns);
        let periods_ns = (self.interval_ns as f64 * self.policy.silent_periods) as u64;
        let limit_ns = periods_ns.max(self.policy.silent_after_ns);
        let opening = self.health == Health::Opening;
        let is_silent = matches!(self.health, Health::Silent { .. });
        if quiet_ns > limit_ns && periods_ns > 0 && !opening && !is_silent {
            self.health = Health::Silent {
                since_ns: self.arrived_ns,
            };
        }
        if quiet_ns > self.policy.reopen_after_ns.max(limit_ns) {
            if opening {
                self.health = Health::Silent {
                    since_ns: self.arrived_ns,
                };
            }
            return true;
        }
        matches!(self.health, Health::Frozen { .. })
            && now_ns.saturating_sub(self.changed_ns) > self.policy.reopen_after_ns
    }

    /// State at `now_ns`.
    pub fn report(&mut self, now_ns: u64) -> StreamReport {
        self.drop_old_arrivals(now_ns);
        StreamReport {
            health: self.health.clone(),
            counters: self.counters,
            measured_fps: self.measured_fps(),
        }
    }

    /// Health of the camera.
    pub fn health(&self) -> &Health {
        &self.health
    }

    fn measured_fps(&self) -> f64 {
        match (self.arrivals_ns.front(), self.arrivals_ns.back()) {
            (Some(first), Some(last)) if last > first => {
                (self.arrivals_ns.len() - 1) as f64 * 1e9 / (last - first) as f64
            }
            _ => 0.0,
        }
    }

    fn is_frozen(&self, now_ns: u64) -> bool {
        self.policy
            .freeze_after_ns
            .is_some_and(|limit_ns| now_ns.saturating_sub(self.changed_ns) > limit_ns)
    }

    fn drop_old_arrivals(&mut self, now_ns: u64) {
        let oldest_ns = now_ns.saturating_sub(self.policy.fps_window_ns);
        while self.arrivals_ns.front().is_some_and(|at| *at < oldest_ns) {
            self.arrivals_ns.pop_front();
        }
    }

    fn count_gap(&mut self, sequence: u32) {
        if let Some(last) = self.last_sequence {
            let step = sequence.wrapping_sub(last);
            // A step of half the range or more is a restart of the counter.
            if step > 1 && step < u32::MAX / 2 {
                self.counters.sequence_gaps += u64::from(step - 1);
            }
        }
        self.last_sequence = Some(sequence);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const MS: u64 = 1_000_000;

    fn opened() -> StreamMonitor {
        let mut monitor = StreamMonitor::new(SupervisionPolicy::default());
        monitor.opened(0, 25.0);
        monitor
    }

    fn fresh(sequence: u32, at_ms: u64) -> FrameFacts {
        FrameFacts {
            sequence,
            received_ns: at_ms * MS,
            content: FrameContent::New,
        }
    }

    #[test]
    fn steady_stream_is_live() {
        let mut monitor = opened();
        assert_eq!(*monitor.health(), Health::Opening);
        for n in 0..100 {
            monitor.frame(fresh(n, 40 + u64::from(n) * 53));
            assert!(!monitor.tick((41 + u64::from(n) * 53) * MS));
        }
        let report = monitor.report((40 + 99 * 53) * MS);
        assert_eq!(report.health, Health::Live);
        assert!((report.measured_fps - 1000.0 / 53.0).abs() < 1e-9);
        let expected = CameraCounters {
            received: 100,
            ..CameraCounters::default()
        };
        assert_eq!(report.counters, expected);
    }

    #[test]
    fn gaps_are_counted_across_overflow() {
        let mut monitor = opened();
        for (n, sequence) in [u32::MAX - 1, u32::MAX, 0, 1, 4].into_iter().enumerate() {
            monitor.frame(fresh(sequence, 40 * (n as u64 + 1)));
        }
        assert_eq!(monitor.report(0).counters.sequence_gaps, 2);
    }

    #[test]
    fn restarted_counter_is_not_a_gap() {
        let mut monitor = opened();
        monitor.frame(fresh(500, 40));
        monitor.frame(fresh(0, 80));
        monitor.frame(fresh(1, 120));
        assert_eq!(monitor.report(0).counters.sequence_gaps, 0);
        monitor.frame(fresh(900, 160));
        monitor.opened(200 * MS, 25.0);
        monitor.frame(fresh(5, 240));
        assert_eq!(monitor.report(0).counters.sequence_gaps, 898);
        assert_eq!(monitor.report(0).counters.reconnects, 1);
    }

    #[test]
    fn late_frames_are_counted() {
        let mut monitor = opened();
        for (n, at_ms) in [40, 80, 160, 241, 281].into_iter().enumerate() {
            monitor.frame(fresh(n as u32, at_ms));
        }
        assert_eq!(monitor.report(0).counters.late, 1);
    }

    #[test]
    fn damaged_frames_arrive_and_cause_no_reopening() {
        let mut monitor = opened();
        monitor.frame(fresh(0, 40));
        for n in 1..=100 {
            let now_ns = (40 + u64::from(n) * 40) * MS;
            monitor.damaged(n, now_ns);
            assert!(!monitor.tick(now_ns));
        }
        let report = monitor.report(4040 * MS);
        assert_eq!(report.counters.damaged, 100);
        assert_eq!(report.counters.sequence_gaps, 0);
        assert_eq!(report.health, Health::Live);
        assert!((report.measured_fps - 25.0).abs() < 1e-9);
    }

    #[test]
    fn depth_without_depth_is_neither_frozen_nor_reopened() {
        let mut monitor = opened();
        let blind = |n: u32| FrameFacts {
            content: FrameContent::NoDepth,
            ..fresh(n, u64::from(n) * 40)
        };
        monitor.frame(fresh(1, 40));
        for n in 2..=26 {
            monitor.frame(blind(n));
            assert_eq!(*monitor.health(), Health::Live);
        }
        for n in 27..=200 {
            monitor.frame(blind(n));
            assert!(!monitor.tick(u64::from(n) * 40 * MS));
            let since_ns = 40 * MS;
            assert_eq!(*monitor.health(), Health::NoValidDepth { since_ns });
        }
        assert_eq!(monitor.report(8000 * MS).counters.duplicates, 0);
        monitor.frame(fresh(201, 8040));
        assert_eq!(*monitor.health(), Health::Live);
    }

    #[test]
    fn silence_outlasts_reopening() {
        let mut monitor = opened();
        monitor.frame(fresh(0, 40));
        assert!(monitor.tick(3100 * MS));
        monitor.closed(None);
        monitor.opened(3200 * MS, 25.0);
        assert!(!monitor.tick(3900 * MS));
        assert_eq!(*monitor.health(), Health::Silent { since_ns: 40 * MS });
        monitor.frame(fresh(1, 4000));
        assert_eq!(*monitor.health(), Health::Live);
    }

    #[test]
    fn silence_ends_with_a_frame_or_a_reopen() {
        let mut monitor = opened();
        monitor.frame(fresh(0, 40));
        assert!(!monitor.tick(360 * MS));
        assert_eq!(*monitor.health(), Health::Live);
        assert!(!monitor.tick(361 * MS));
        assert_eq!(*monitor.health(), Health::Silent { since_ns: 40 * MS });
        monitor.frame(fresh(1, 400));
        assert_eq!(*monitor.health(), Health::Live);
        assert!(monitor.tick(3500 * MS));
    }

    #[test]
    fn camera_without_frames_is_reopened() {
        let mut monitor = opened();
        assert!(!monitor.tick(2900 * MS));
        assert_eq!(*monitor.health(), Health::Opening);
        assert!(monitor.tick(3001 * MS));
    }

    #[test]
    fn repeated_frames_are_frozen() {
        let mut monitor = opened();
        monitor.frame(fresh(0, 0));
        for n in 1..=26_u32 {
            monitor.frame(FrameFacts {
                content: FrameContent::Repeated,
                ..fresh(n, u64::from(n) * 40)
            });
        }
        assert_eq!(*monitor.health(), Health::Frozen { since_ns: 0 });
        assert_eq!(monitor.report(1040 * MS).counters.duplicates, 26);
        monitor.frame(fresh(27, 1080));
        assert_eq!(*monitor.health(), Health::Live);
    }

    #[test]
    fn frozen_camera_is_reopened_unless_repeats_are_allowed() {
        for (freeze_after_ns, reopened) in [(Some(1_000 * MS), true), (None, false)] {
            let mut monitor = StreamMonitor::new(SupervisionPolicy {
                freeze_after_ns,
                ..SupervisionPolicy::default()
            });
            monitor.opened(0, 25.0);
            let mut reopen = false;
            for n in 0..100_u32 {
                monitor.frame(FrameFacts {
                    content: match n {
                        0 => FrameContent::New,
                        _ => FrameContent::Repeated,
                    },
                    ..fresh(n, u64::from(n) * 40)
                });
                reopen |= monitor.tick(u64::from(n) * 40 * MS);
            }
            assert_eq!(reopen, reopened);
        }
    }

    #[test]
    fn unplugged_and_ended_are_reported() {
        let mut monitor = opened();
        monitor.frame(fresh(0, 40));
        let unplugged = Health::Unplugged {
            reason: "no such device".to_owned(),
        };
        monitor.closed(Some(unplugged.clone()));
        let report = monitor.report(50 * MS);
        assert_eq!(report.health, unplugged);
        assert_eq!(report.measured_fps, 0.0);
        monitor.ended();
        assert_eq!(*monitor.health(), Health::Ended);
    }
}
