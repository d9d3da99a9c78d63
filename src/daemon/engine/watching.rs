//! What the engine tells while it runs: faults of cameras and threads, and its status.

use std::sync::Arc;

use super::Engine;
use crate::daemon::approach::ApproachWatch;
use crate::daemon::black_box::BlackBox;
use crate::daemon::report::camera_status;
use crate::daemon::status::{CameraStatus, EngineStatus, PredictionStatus};
use crate::daemon::tasks::TaskState;
use gripcast_capture::camera::{Health, monotonic_ns};
use gripcast_imaging::Role;
use gripcast_session::Tone;

impl Engine {
    /// A fault tone and a line of the log for every thread that had to be started again or is stuck.
    pub(super) fn watch_tasks(&mut self) {
        for task in self.links.tasks.report() {
            let now = (task.state == TaskState::Stuck, task.restarts);
            let before = self.tasks_were.insert(task.name.clone(), now);
            if before.unwrap_or_default() != now {
                // Without a screen nobody hears it; the log has it.
                let _ = self.links.tones.send(Tone::Fault);
                self.log("task", &task);
            }
        }
    }

    /// A fault tone for every camera that falls out.
    pub(super) fn watch_cameras(&mut self) {
        let hub = self.hub.clone();
        for slot in hub.slots() {
            let (live, reason) = slot.facts(|facts| {
                let live = facts.health == Health::Live;
                (live, format!("{:?}", facts.health))
            });
            let before = self.was_live.insert(slot.role(), live);
            if before == Some(true) && !live {
                // Without a screen nobody hears it; the log has it.
                let _ = self.links.tones.send(Tone::Fault);
            }
            if before.is_some_and(|before| before != live) {
                let event = if live { "camera_live" } else { "camera_fault" };
                let role = slot.role();
                let warnings = slot.facts(|facts| facts.warnings.clone());
                let what = serde_json::json!({
                    "role": role,
                    "health": reason,
                    "warnings": warnings,
                });
                self.log(event, &what);
            }
        }
    }

    pub(super) fn send_status(&self) {
        // Nobody looks when the screen has left; the report tells the rest.
        let _ = self.links.status.send(Arc::new(self.status()));
    }

    fn status(&self) -> EngineStatus {
        let now_ns = monotonic_ns();
        let findings = self.inference.findings();
        EngineStatus {
            dataset: self.dataset_name.clone(),
            rig: self.rig.id.clone(),
            clock: jiff::Zoned::now().strftime("%H:%M:%S").to_string(),
            disk_free_bytes: self.disk_free_bytes,
            black_box: self.black_box.as_ref().map(BlackBox::status),
            session: self.session.view(now_ns),
            cameras: self
                .hub
                .slots()
                .map(|slot| {
                    let approach = self.approach.as_ref();
                    let approach = approach.filter(|_| slot.role() == Role::External);
                    CameraStatus {
                        markers: approach.and_then(ApproachWatch::newest),
                        ..camera_status(slot, &self.rig, now_ns)
                    }
                })
                .collect(),
            prediction: findings.live.clone().map(|live| PredictionStatus {
                frame_age_ms: now_ns.saturating_sub(live.frame_time_ns) as f64 * 1e-6,
                ..live
            }),
            prediction_absent: findings.absent.clone(),
            contact: findings.contact_levels(),
            previews: findings.previews.clone(),
        }
    }
}
