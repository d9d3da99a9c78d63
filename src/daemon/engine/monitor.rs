//! Monitoring: faults of cameras and threads, and the engine's status.

use std::sync::Arc;

use super::Engine;
use crate::daemon::black_box::BlackBox;
use crate::daemon::pre_grasp::PreGraspRecorder;
use crate::daemon::report::camera_status;
use crate::daemon::status::{CameraStatus, EngineStatus, PredictionStatus};
use crate::daemon::tasks::TaskState;
use gripcast_capture::camera::{Health, monotonic_ns};
use gripcast_imaging::Role;
use gripcast_session::Tone;

impl Engine {
    /// Gives a fault tone and a log line for every thread that restarted or is stuck.
    pub(super) fn check_tasks(&mut self) {
        for task in self.links.tasks.report() {
            let now = (task.state == TaskState::Stuck, task.restarts);
            let before = self.last_task_states.insert(task.name.clone(), now);
            if before.unwrap_or_default() != now {
                // The receiver is gone without a screen; the log has the fault.
                let _ = self.links.tones.send(Tone::Fault);
                self.log("task", &task);
            }
        }
    }

    /// Gives a fault tone and a log line for every camera that fails, and a log line when it
    /// recovers.
    pub(super) fn check_cameras(&mut self) {
        let hub = self.hub.clone();
        for slot in hub.slots() {
            let (live, reason) = slot.with_info(|info| {
                let live = info.health == Health::Live;
                (live, format!("{:?}", info.health))
            });
            let before = self.was_live.insert(slot.role, live);
            if before == Some(true) && !live {
                // The receiver is gone without a screen; the log has the fault.
                let _ = self.links.tones.send(Tone::Fault);
            }
            if before.is_some_and(|before| before != live) {
                let event = if live { "camera_live" } else { "camera_fault" };
                let role = slot.role;
                let warnings = slot.with_info(|info| info.warnings.clone());
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
        // All receivers may be gone; the closing report is complete.
        let _ = self.links.status.send(Arc::new(self.status()));
    }

    fn status(&self) -> EngineStatus {
        let now_ns = monotonic_ns();
        let state = self.inference.state();
        EngineStatus {
            dataset: self.dataset_name.clone(),
            rig: self.rig.id.clone(),
            monotonic_ms: now_ns / 1_000_000,
            clock: jiff::Zoned::now().strftime("%H:%M:%S").to_string(),
            disk_free_bytes: self.disk_free_bytes,
            black_box: self.black_box.as_ref().map(BlackBox::status),
            session: self.session.view(now_ns),
            cameras: self
                .hub
                .slots()
                .map(|slot| {
                    let recorder = self.pre_grasp.as_ref();
                    let recorder = recorder.filter(|_| slot.role == Role::External);
                    CameraStatus {
                        markers: recorder.and_then(PreGraspRecorder::newest),
                        ..camera_status(slot, &self.rig, now_ns)
                    }
                })
                .collect(),
            prediction: state.live.clone().map(|live| PredictionStatus {
                frame_age_ms: now_ns.saturating_sub(live.frame_time_ns) as f64 * 1e-6,
                ..live
            }),
            no_prediction_reason: state.unavailable.clone(),
            contact: state.contact_levels(),
            previews: state.previews.clone(),
        }
    }
}
