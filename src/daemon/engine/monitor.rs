//! Monitoring: faults of cameras and threads, and the engine's status.

use std::collections::BTreeMap;
use std::sync::Arc;
use std::time::Duration;

use jiff::{SignedDuration, Timestamp};

use super::Engine;
use crate::daemon::black_box::BlackBox;
use crate::daemon::infer::InferenceState;
use crate::daemon::pre_grasp::PreGraspRecorder;
use crate::daemon::report::camera_status;
use crate::daemon::start_report::{StartFacts, start_report};
use crate::daemon::status::{CameraStatus, EngineStatus, GelStatus, PredictionStatus};
use crate::daemon::tasks::TaskState;
use gripcast_capture::camera::monotonic_ns;
use gripcast_imaging::{GelProblem, Role};
use gripcast_session::{Step, Tone};

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
            let state = slot.camera_state(monotonic_ns());
            let live = state.delivers_frames() && !state.is_fault();
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
                    "state": state.word(),
                    "reason": state.fault_text(),
                    "warnings": warnings,
                });
                self.log(event, &what);
            }
        }
    }

    /// Compares rig, cameras, model and clock with the dataset's grasps; logs new findings.
    pub(super) fn check_start(&mut self) {
        let now_ns = monotonic_ns();
        let now = Timestamp::now();
        let (start, start_ns) = self.started;
        let elapsed = Duration::from_nanos(now_ns.saturating_sub(start_ns));
        let elapsed = SignedDuration::try_from(elapsed).unwrap_or_default();
        let cameras: Vec<CameraStatus> = self
            .hub
            .slots()
            .map(|slot| camera_status(slot, &self.rig, now_ns))
            .collect();
        self.start_report = start_report(&StartFacts {
            dataset: &self.provenance,
            opening: &self.opening,
            newest_source: self.newest_source,
            rig: &self.rig,
            cameras: &cameras,
            model: self.model.as_ref(),
            object: &self.session.labels().object,
            now,
            clock_jump: now.duration_since(start) - elapsed,
            disk_free_bytes: self.disk_free_bytes,
            grasps_left: self.grasps_left(),
        });
        for finding in self.start_report.clone() {
            if !self.start_findings.contains_key(&finding.subject) {
                self.log("start_report", &finding);
                self.start_findings.insert(finding.subject, finding);
            }
        }
    }

    pub(super) fn send_status(&self) {
        // All receivers may be gone; the closing report is complete.
        let _ = self.links.status.send(Arc::new(self.status()));
    }

    /// Returns the number of grasps that fit on the disk before the guards refuse them.
    fn grasps_left(&self) -> Option<u64> {
        let free = self.disk_free_bytes?;
        let usable = free.saturating_sub(self.guards.min_free_bytes);
        usable.checked_div(self.store.mean_grasp_bytes()?)
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
            grasps_left: self.grasps_left(),
            target_per_object: self.target_per_object,
            start_report: self.start_report.clone(),
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
            lift: state.lift,
            no_prediction_reason: state.unavailable.clone(),
            adaptation: self.adaptation(),
            contact: state.contact_levels(),
            objects: Arc::clone(&self.objects),
            gels: self.gels(&state),
            shear: state.shear.clone(),
            force: state.force.clone(),
            marker_fields: state.marker_fields.clone(),
            previews: state.previews.clone(),
        }
    }

    fn gels(&self, state: &InferenceState) -> BTreeMap<Role, GelStatus> {
        let revision = self.compared_revision(state);
        let limit = self.guards.min_contact_fraction;
        let gels = state.gels.iter().map(|(role, gel)| {
            let change = revision.and_then(|_| state.change(*role, revision, 0));
            let mut gel = gel.clone();
            if self.session.step() != Step::Initial {
                // The gripper may still be closed.
                gel.problems
                    .retain(|problem| *problem != GelProblem::Marked);
            }
            (*role, GelStatus::new(gel, change, limit))
        });
        gels.collect()
    }
}
