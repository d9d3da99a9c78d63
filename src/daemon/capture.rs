//! Capture threads, one per camera: supervised frames go to the hub.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::JoinHandle;

use super::hub::{CameraSlot, Hub};
use super::tasks::{Heartbeat, Tasks};
use gripcast_base::error::Result;
use gripcast_capture::camera::{
    CameraEvent, CameraOpener, Health, MonotonicClock, SupervisionPolicy, run_camera,
};

/// The running capture threads; without [`CaptureThreads::stop`] they run until the process ends.
#[derive(Debug)]
pub(super) struct CaptureThreads {
    stop: Arc<AtomicBool>,
    threads: Vec<JoinHandle<()>>,
}

impl CaptureThreads {
    /// Starts a thread for every opener with a slot in the hub.
    ///
    /// # Errors
    /// `Io` if a thread cannot be started.
    pub(super) fn start(
        openers: Vec<Box<dyn CameraOpener>>,
        hub: &Hub,
        policy: &SupervisionPolicy,
        tasks: &Tasks,
    ) -> Result<Self> {
        let mut capture = Self {
            stop: Arc::new(AtomicBool::new(false)),
            threads: Vec::new(),
        };
        for mut opener in openers {
            let role = opener.role();
            let Some(slot) = hub.slot(role).map(Arc::clone) else {
                continue;
            };
            let (stop, policy) = (Arc::clone(&capture.stop), policy.clone());
            let body = move |heartbeat: &Heartbeat| {
                heartbeat.busy();
                run_camera(
                    opener.as_mut(),
                    &policy,
                    &MonotonicClock,
                    &stop,
                    &mut |event| {
                        handle_event(&slot, event);
                        // Events arrive at least once per second, unless the driver blocks.
                        heartbeat.busy();
                    },
                );
            };
            let thread = tasks.spawn(&format!("capture-{role}"), body)?;
            capture.threads.push(thread);
        }
        Ok(capture)
    }

    /// Stops all threads and waits for them.
    pub(super) fn stop(&mut self) {
        self.stop.store(true, Ordering::Relaxed);
        for thread in self.threads.drain(..) {
            // A panic has been reported already.
            let _ = thread.join();
        }
    }
}

fn handle_event(slot: &CameraSlot, event: CameraEvent) {
    match event {
        CameraEvent::Opened {
            info,
            controls,
            warnings,
        } => slot.on_opened(info, controls, warnings),
        CameraEvent::Frame(frame) => slot.push(frame),
        CameraEvent::Controls(controls) => slot.with_info(|info| info.controls = controls),
        CameraEvent::Report(report) => {
            if matches!(
                report.health,
                Health::Unplugged { .. } | Health::Unavailable { .. }
            ) {
                slot.clear_frames();
            }
            slot.with_info(|info| {
                info.health = report.health;
                info.counters = report.counters;
                info.measured_fps = report.measured_fps;
            });
        }
        // The next report carries the counter.
        CameraEvent::Damaged { reason, .. } => slot.with_info(|info| info.quality.refused(reason)),
        CameraEvent::Ended => {}
    }
}
