//! Supervises a camera: opens it, reads frames, monitors and reopens it.

use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use super::clock::Clock;
use super::source::{CameraOpener, CaptureError, ControlValues, FrameSource, StreamInfo};
use super::stream_monitor::{
    FrameContent, FrameFacts, Health, StreamMonitor, StreamReport, SupervisionPolicy,
};
use gripcast_base::error::{Error, ErrorKind};
use gripcast_imaging::{Frame, FrameBytes, check_structure, valid_depth_fraction};

/// Fraction of valid pixels below which a depth frame has no depth.
const MIN_DEPTH_FRACTION: f64 = 0.001;

/// Event of a supervised camera.
#[derive(Clone, Debug)]
pub enum CameraEvent {
    /// The camera was opened or reopened.
    Opened {
        /// Configuration of the stream.
        info: StreamInfo,
        /// Control values.
        controls: ControlValues,
        /// Requests of the rig file that the camera did not accept.
        warnings: Vec<String>,
    },
    /// A usable frame.
    Frame(Frame),
    /// A damaged frame.
    Damaged {
        /// Driver's frame counter.
        sequence: u32,
        /// Description of the damage.
        reason: String,
    },
    /// The control values changed.
    Controls(ControlValues),
    /// Health and counters: on changes of health, and periodically.
    Report(StreamReport),
    /// The recording has ended; the last event.
    Ended,
}

/// Reason for the end of reading.
enum Stop {
    Requested,
    Ended,
    /// Reopen it: unplugged or unavailable, or `None` after silence.
    Reopen(Option<Health>),
}

/// Health of a camera that fails with this error.
pub fn health_of(error: &Error) -> Health {
    let reason = error.to_string();
    match error.kind() {
        ErrorKind::Device => Health::Unplugged { reason },
        _ => Health::Unavailable { reason },
    }
}

/// What a frame shows, compared with the frame before.
pub fn content_of(frame: &Frame, before: Option<&FrameBytes>) -> FrameContent {
    if valid_depth_fraction(frame).is_some_and(|valid| valid < MIN_DEPTH_FRACTION) {
        FrameContent::NoDepth
    } else if before.is_some_and(|before| **before == *frame.data) {
        FrameContent::Repeated
    } else {
        FrameContent::New
    }
}

/// Runs a camera until `stop` is set or a recording ends.
///
/// Blocks; run it on a thread. Opening is retried with bounded backoff. `sink` must return quickly.
pub fn run_camera(
    opener: &mut dyn CameraOpener,
    policy: &SupervisionPolicy,
    clock: &dyn Clock,
    stop: &AtomicBool,
    sink: &mut dyn FnMut(CameraEvent),
) {
    let mut monitor = StreamMonitor::new(policy.clone());
    let mut backoff_ns = policy.first_backoff_ns;
    sink(CameraEvent::Report(monitor.report(clock.now_ns())));
    while !stop.load(Ordering::Relaxed) {
        let health = match opener.open() {
            Ok(mut source) => {
                let received = monitor.report(clock.now_ns()).counters.received;
                match read_frames(source.as_mut(), policy, &mut monitor, clock, stop, sink) {
                    Stop::Requested => {
                        sink(CameraEvent::Report(monitor.report(clock.now_ns())));
                        return;
                    }
                    Stop::Ended => {
                        monitor.ended();
                        sink(CameraEvent::Report(monitor.report(clock.now_ns())));
                        sink(CameraEvent::Ended);
                        return;
                    }
                    Stop::Reopen(health) => {
                        if monitor.report(clock.now_ns()).counters.received > received {
                            backoff_ns = policy.first_backoff_ns;
                        }
                        health
                    }
                }
            }
            Err(error) => Some(health_of(&error)),
        };
        monitor.closed(health);
        sink(CameraEvent::Report(monitor.report(clock.now_ns())));
        pause(clock, clock.now_ns() + backoff_ns, stop);
        backoff_ns = (backoff_ns * 2).min(policy.max_backoff_ns);
    }
}

fn read_frames(
    source: &mut dyn FrameSource,
    policy: &SupervisionPolicy,
    monitor: &mut StreamMonitor,
    clock: &dyn Clock,
    stop: &AtomicBool,
    sink: &mut dyn FnMut(CameraEvent),
) -> Stop {
    let mut controls = match source.controls() {
        Ok(controls) => controls,
        Err(error) => return Stop::Reopen(Some(health_of(&error))),
    };
    monitor.opened(clock.now_ns(), source.info().nominal_fps);
    sink(CameraEvent::Opened {
        info: source.info().clone(),
        controls: controls.clone(),
        warnings: source.warnings().to_vec(),
    });
    sink(CameraEvent::Report(monitor.report(clock.now_ns())));

    let timeout = Duration::from_nanos(policy.frame_timeout_ns);
    let mut previous: Option<FrameBytes> = None;
    let mut reported = monitor.health().clone();
    let mut report_ns = clock.now_ns() + policy.report_every_ns;
    let mut controls_ns = policy.controls_every_ns.map(|every| clock.now_ns() + every);
    loop {
        if stop.load(Ordering::Relaxed) {
            return Stop::Requested;
        }
        match source.next_frame(timeout) {
            Ok(frame) => match check_structure(&frame).err() {
                None => {
                    monitor.frame(FrameFacts {
                        sequence: frame.sequence,
                        received_ns: frame.received_ns,
                        content: content_of(&frame, previous.as_ref()),
                    });
                    previous = Some(frame.data.clone());
                    sink(CameraEvent::Frame(frame));
                }
                Some(damage) => {
                    monitor.damaged(frame.sequence, frame.received_ns);
                    sink(CameraEvent::Damaged {
                        sequence: frame.sequence,
                        reason: damage.to_string(),
                    });
                }
            },
            Err(CaptureError::Timeout) => {}
            Err(CaptureError::Damaged { sequence, reason }) => {
                monitor.damaged(sequence, clock.now_ns());
                sink(CameraEvent::Damaged { sequence, reason });
            }
            Err(CaptureError::Gone) => {
                let reason = CaptureError::Gone.to_string();
                return Stop::Reopen(Some(Health::Unplugged { reason }));
            }
            Err(CaptureError::Ended) => return Stop::Ended,
            Err(CaptureError::Failed(error)) => return Stop::Reopen(Some(health_of(&error))),
        }
        let now_ns = clock.now_ns();
        let reopen = monitor.tick(now_ns);
        if reported != *monitor.health() || now_ns >= report_ns {
            reported = monitor.health().clone();
            report_ns = now_ns + policy.report_every_ns;
            sink(CameraEvent::Report(monitor.report(now_ns)));
        }
        if reopen {
            return Stop::Reopen(None);
        }
        if let (Some(due_ns), Some(every_ns)) = (controls_ns, policy.controls_every_ns)
            && now_ns >= due_ns
            && *monitor.health() == Health::Live
        {
            controls_ns = Some(now_ns + every_ns);
            // Errors are ignored: an unplugged camera fails at the next frame.
            if let Ok(values) = source.controls()
                && values != controls
            {
                controls.clone_from(&values);
                sink(CameraEvent::Controls(values));
            }
        }
    }
}

fn pause(clock: &dyn Clock, until_ns: u64, stop: &AtomicBool) {
    const SLICE_NS: u64 = 50_000_000;
    while !stop.load(Ordering::Relaxed) {
        let now_ns = clock.now_ns();
        if now_ns >= until_ns {
            return;
        }
        clock.sleep_until(until_ns.min(now_ns + SLICE_NS));
    }
}

#[cfg(test)]
mod tests {
    use std::collections::{BTreeMap, VecDeque};
    use std::sync::{Arc, Mutex};

    use super::*;
    use crate::camera::{CameraIdentity, ManualClock};
    use crate::device::device_error;
    use gripcast_base::error::Result;
    use gripcast_imaging::PixelFormat;
    use gripcast_imaging::Role;

    const MS: u64 = 1_000_000;

    enum Step {
        Frame {
            after_ms: u64,
            sequence: u32,
            shade: u8,
        },
        Short {
            sequence: u32,
        },
        Driver(CaptureError),
        Exposure(i64),
        FailToOpen,
    }

    struct Scripted {
        steps: Arc<Mutex<VecDeque<Step>>>,
        clock: Arc<ManualClock>,
        stop: Arc<AtomicBool>,
    }

    struct ScriptedSource {
        steps: Arc<Mutex<VecDeque<Step>>>,
        clock: Arc<ManualClock>,
        stop: Arc<AtomicBool>,
        info: StreamInfo,
        exposure: i64,
    }

    impl CameraOpener for Scripted {
        fn role(&self) -> Role {
            Role::Left
        }

        fn describe(&self) -> String {
            "scripted".to_owned()
        }

        fn open(&mut self) -> Result<Box<dyn FrameSource>> {
            let mut steps = self.steps.lock().unwrap();
            if matches!(steps.front(), Some(Step::FailToOpen)) {
                steps.pop_front();
                return Err(device_error("no camera with serial X"));
            }
            Ok(Box::new(ScriptedSource {
                steps: self.steps.clone(),
                clock: self.clock.clone(),
                stop: self.stop.clone(),
                info: StreamInfo {
                    identity: CameraIdentity::default(),
                    format: PixelFormat::Grey,
                    width: 2,
                    height: 1,
                    nominal_fps: 25.0,
                    depth_unit_m: None,
                },
                exposure: 180,
            }))
        }
    }

    impl FrameSource for ScriptedSource {
        fn info(&self) -> &StreamInfo {
            &self.info
        }

        fn next_frame(&mut self, timeout: Duration) -> Result<Frame, CaptureError> {
            let act = self.steps.lock().unwrap().pop_front();
            let frame = |sequence, data: Vec<u8>| Frame {
                format: PixelFormat::Grey,
                width: 2,
                height: 1,
                data: data.into(),
                sequence,
                driver_time_ns: self.clock.now_ns(),
                received_ns: self.clock.now_ns(),
            };
            match act {
                Some(Step::Frame {
                    after_ms,
                    sequence,
                    shade,
                }) => {
                    self.clock.advance(after_ms * MS);
                    Ok(Frame {
                        received_ns: self.clock.now_ns(),
                        ..frame(sequence, vec![shade, 0])
                    })
                }
                Some(Step::Short { sequence }) => Ok(frame(sequence, vec![1])),
                Some(Step::Driver(CaptureError::Timeout)) => {
                    self.clock.advance(timeout.as_nanos() as u64);
                    Err(CaptureError::Timeout)
                }
                Some(Step::Driver(error)) => Err(error),
                Some(Step::Exposure(value)) => {
                    self.exposure = value;
                    self.clock.advance(1_000 * MS);
                    Ok(frame(9, vec![value as u8, 1]))
                }
                Some(Step::FailToOpen) => Err(CaptureError::Gone),
                None => {
                    self.stop.store(true, Ordering::Relaxed);
                    Err(CaptureError::Timeout)
                }
            }
        }

        fn controls(&mut self) -> Result<ControlValues> {
            Ok(BTreeMap::from([("exposure".to_owned(), self.exposure)]))
        }
    }

    fn play(steps: Vec<Step>) -> (Vec<CameraEvent>, u64) {
        let clock = Arc::new(ManualClock::default());
        let stop = Arc::new(AtomicBool::new(false));
        let mut opener = Scripted {
            steps: Arc::new(Mutex::new(steps.into())),
            clock: clock.clone(),
            stop: stop.clone(),
        };
        let mut events = Vec::new();
        run_camera(
            &mut opener,
            &SupervisionPolicy::default(),
            &*clock,
            &stop,
            &mut |event| events.push(event),
        );
        (events, clock.now_ns())
    }

    fn steady(first: u32, count: u32) -> Vec<Step> {
        (first..first + count)
            .map(|sequence| Step::Frame {
                after_ms: 40,
                sequence,
                shade: sequence as u8,
            })
            .collect()
    }

    fn reports(events: &[CameraEvent]) -> Vec<StreamReport> {
        events
            .iter()
            .filter_map(|event| match event {
                CameraEvent::Report(report) => Some(report.clone()),
                _ => None,
            })
            .collect()
    }

    #[test]
    fn unplugged_camera_is_reopened_and_keeps_its_counters() {
        let mut steps = steady(0, 10);
        steps.push(Step::Driver(CaptureError::Gone));
        steps.push(Step::FailToOpen);
        steps.push(Step::FailToOpen);
        steps.extend(steady(0, 10));
        let (events, end_ns) = play(steps);
        let opened = events
            .iter()
            .filter(|event| matches!(event, CameraEvent::Opened { .. }))
            .count();
        assert_eq!(opened, 2);
        let lost: Vec<_> = reports(&events)
            .into_iter()
            .filter_map(|report| match report.health {
                Health::Unplugged { reason } => Some(reason),
                _ => None,
            })
            .collect();
        assert_eq!(lost.len(), 3);
        assert!(lost[0].contains("unplugged"), "{lost:?}");
        assert!(lost[2].contains("serial X"), "{lost:?}");
        let last = reports(&events).pop().unwrap();
        assert_eq!(last.counters.reconnects, 1);
        assert_eq!(last.counters.sequence_gaps, 0);
        // Backoff of 250, 500 and 1000 ms, and 20 frames of 40 ms.
        assert_eq!(end_ns, (1750 + 800) * MS);
    }

    #[test]
    fn damaged_frames_are_reported_only() {
        let mut steps = steady(0, 3);
        steps.push(Step::Short { sequence: 3 });
        steps.push(Step::Driver(CaptureError::Damaged {
            sequence: 4,
            reason: "error flag".to_owned(),
        }));
        steps.extend(steady(5, 10));
        let (events, _) = play(steps);
        let damaged: Vec<_> = events
            .iter()
            .filter_map(|event| match event {
                CameraEvent::Damaged { sequence, reason } => Some((*sequence, reason.clone())),
                _ => None,
            })
            .collect();
        assert_eq!(damaged.len(), 2);
        assert_eq!(
            damaged[0],
            (3, "a 2×1 GREY frame has 2 bytes, found 1".to_owned())
        );
        let frames = events
            .iter()
            .filter(|event| matches!(event, CameraEvent::Frame(_)))
            .count();
        assert_eq!(frames, 13);
        assert_eq!(reports(&events).pop().unwrap().counters.sequence_gaps, 0);
    }

    #[test]
    fn silent_camera_is_reopened() {
        let mut steps = steady(0, 5);
        steps.extend((0..32).map(|_| Step::Driver(CaptureError::Timeout)));
        steps.extend(steady(0, 5));
        let (events, _) = play(steps);
        let reports = reports(&events);
        assert!(
            reports
                .iter()
                .any(|report| matches!(report.health, Health::Silent { .. }))
        );
        let is_absent = |report: &StreamReport| {
            let health = &report.health;
            matches!(
                health,
                Health::Unplugged { .. } | Health::Unavailable { .. }
            )
        };
        assert!(!reports.iter().any(is_absent), "it is still plugged in");
        assert_eq!(reports.last().unwrap().counters.reconnects, 1);
    }

    #[test]
    fn frozen_camera_is_reopened() {
        let steps = (0..120)
            .map(|sequence| Step::Frame {
                after_ms: 40,
                sequence,
                shade: 7,
            })
            .collect();
        let (events, _) = play(steps);
        let reports = reports(&events);
        assert!(
            reports
                .iter()
                .any(|report| matches!(report.health, Health::Frozen { .. }))
        );
        assert_eq!(reports.last().unwrap().counters.reconnects, 1);
        let is_absent = |report: &StreamReport| {
            let health = &report.health;
            matches!(
                health,
                Health::Unplugged { .. } | Health::Unavailable { .. }
            )
        };
        assert!(!reports.iter().any(is_absent), "it is still plugged in");
    }

    #[test]
    fn changed_controls_are_reported_once() {
        let mut steps = steady(0, 3);
        steps.push(Step::Exposure(90));
        steps.extend(steady(10, 40));
        let (events, _) = play(steps);
        let values: Vec<_> = events
            .iter()
            .filter_map(|event| match event {
                CameraEvent::Controls(values) => Some(values["exposure"]),
                _ => None,
            })
            .collect();
        assert_eq!(values, [90]);
    }

    #[test]
    fn ended_recording_is_not_reopened() {
        let mut steps = steady(0, 3);
        steps.push(Step::Driver(CaptureError::Ended));
        steps.extend(steady(0, 3));
        let (events, _) = play(steps);
        assert!(matches!(events.last(), Some(CameraEvent::Ended)));
        assert_eq!(reports(&events).pop().unwrap().health, Health::Ended);
    }
}
