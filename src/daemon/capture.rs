//! One thread a camera: supervised frames go into the hub.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::JoinHandle;

use super::hub::{CameraSlot, Hub};
use super::tasks::{Beat, Tasks};
use gripcast_base::error::Result;
use gripcast_capture::camera::{
    CameraEvent, CameraOpener, Health, MonotonicClock, SupervisionPolicy, run_camera,
};

/// The running capture threads; dropping them without [`CaptureThreads::stop`] leaves them to the
/// end of the process.
#[derive(Debug)]
pub(super) struct CaptureThreads {
    stop: Arc<AtomicBool>,
    threads: Vec<JoinHandle<()>>,
}

impl CaptureThreads {
    /// Starts a thread for every opener whose role the hub knows.
    ///
    /// # Errors
    /// When the operating system gives no thread.
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
            let body = move |beat: &Beat| {
                beat.busy();
                run_camera(
                    opener.as_mut(),
                    &policy,
                    &MonotonicClock,
                    &stop,
                    &mut |event| {
                        take_in(&slot, event);
                        // It tells something every second at least, unless the driver holds it.
                        beat.busy();
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
            // A panicked capture thread has nothing left to give back.
            let _ = thread.join();
        }
    }
}

fn take_in(slot: &CameraSlot, event: CameraEvent) {
    match event {
        CameraEvent::Opened {
            info,
            controls,
            warnings,
        } => slot.opened(info, controls, warnings),
        CameraEvent::Frame(frame) => slot.push(frame),
        CameraEvent::Controls(controls) => slot.facts(|facts| facts.controls = controls),
        CameraEvent::Report(report) => {
            if matches!(report.health, Health::Lost { .. }) {
                slot.forget_frames();
            }
            slot.facts(|facts| {
                facts.health = report.health;
                facts.counters = report.counters;
                facts.measured_fps = report.measured_fps;
            });
        }
        // The report that comes with it carries the counter.
        CameraEvent::Damaged { .. } | CameraEvent::Ended => {}
    }
}
