//! Frames of a trigger, and the camera conditions for guards and scripts.

use std::collections::BTreeMap;

use jiff::Timestamp;

use super::Engine;
use crate::daemon::infer::InferenceState;
use crate::daemon::pairing::{FrameSet, pair};
use crate::daemon::pre_grasp::PreGraspFrames;
use crate::daemon::status::disk_free_bytes;
use gripcast_capture::calibration::SourceKind;
use gripcast_capture::camera::{CameraState, monotonic_ns};
use gripcast_dataset::{CapturedCamera, StageCapture};
use gripcast_imaging::{ChangeKind, Frame, GelChange, Role};
use gripcast_session::{CameraCondition, CommandSource, Conditions};

/// Frames paired for a trigger.
pub(super) struct Trigger {
    now_ns: u64,
    frame_set: FrameSet,
}

impl Engine {
    /// Returns whether every camera delivers frames and has a valid one.
    pub(super) fn all_live(&self) -> bool {
        let now_ns = monotonic_ns();
        self.hub.slots().all(|slot| {
            slot.camera_state(now_ns).delivers_frames() && !slot.valid_frames().is_empty()
        })
    }

    /// Returns whether every camera has a valid frame newer than the last capture and the last
    /// motion of a virtual hand.
    pub(super) fn has_fresh_frames(&self) -> bool {
        let motion_ns = self.hand.as_ref().map_or(0, |hand| hand.since_ns());
        let since_ns = self.session.captured_ns().max(motion_ns);
        let frames = self.pair(monotonic_ns()).frames;
        self.hub.slots().all(|slot| {
            let frame = frames.get(&slot.role);
            frame.is_some_and(|frame| frame.driver_time_ns > since_ns)
        })
    }

    /// Returns the revision of the initial frame with which the gels are compared: the pending or
    /// else the last one, which shows whether the gripper has let go.
    pub(super) fn compared_revision(&self, state: &InferenceState) -> Option<u64> {
        match self.session.pending() {
            Some(_) => Some(self.initial_revision),
            None => state.revision,
        }
    }

    /// Returns whether all gels are in contact (true) or none (false), relative to the pending or
    /// else the last initial frame; `None` while only one is, and until every gel has been compared
    /// in a frame newer than the last capture.
    pub(super) fn is_in_contact(&self) -> Option<bool> {
        let state = self.inference.state();
        // No contact is measured before the first initial frame.
        let Some(revision) = self.compared_revision(&state) else {
            return Some(false);
        };
        let since_ns = self.session.captured_ns();
        let gels = self.hub.slots().filter(|slot| slot.role.is_tactile());
        let changes = gels
            .map(|slot| state.change(slot.role, Some(revision), since_ns))
            .collect::<Option<Vec<GelChange>>>()?;
        let limit = self.guards.min_contact_fraction;
        let is_contact = |change: &GelChange| change.kind(limit) == ChangeKind::Contact;
        let touched = changes.iter().filter(|change| is_contact(change)).count();
        (touched == 0 || touched == changes.len()).then_some(touched > 0)
    }

    /// Pairs the newest frames of all cameras.
    pub(super) fn pair_newest(&self) -> Trigger {
        let now_ns = monotonic_ns();
        Trigger {
            now_ns,
            frame_set: self.pair(now_ns),
        }
    }

    fn pair(&self, now_ns: u64) -> FrameSet {
        let since_ns = self.session.captured_ns();
        let valid: BTreeMap<Role, Vec<Frame>> = self
            .hub
            .slots()
            .filter(|slot| is_usable(&slot.camera_state(now_ns)))
            .map(|slot| {
                let is_new = |frame: &Frame| frame.driver_time_ns > since_ns;
                let (new, old): (Vec<_>, Vec<_>) =
                    slot.valid_frames().into_iter().partition(is_new);
                // A guard reports cameras without a frame since the last capture.
                (slot.role, if new.is_empty() { old } else { new })
            })
            .filter(|(_, frames)| !frames.is_empty())
            .collect();
        pair(&valid, now_ns)
    }

    /// Returns the conditions that the guards check.
    pub(super) fn conditions(&self, trigger: &Trigger) -> Conditions {
        let Trigger { now_ns, frame_set } = trigger;
        let now_ns = *now_ns;
        let state = self.inference.state();
        let revision = self.compared_revision(&state);
        let since_ns = self.session.captured_ns();
        let cameras = self
            .hub
            .slots()
            .map(|slot| {
                let role = slot.role;
                let frame = frame_set.frames.get(&role);
                let controls = slot.with_info(|info| info.controls.clone());
                let gel = state.gels.get(&role);
                CameraCondition {
                    role,
                    age_ms: frame.map(|frame| age_ms(frame, now_ns)),
                    frame_time_ns: frame.map_or(0, |frame| frame.driver_time_ns),
                    fault: slot.camera_state(now_ns).fault_text(),
                    controls,
                    change: state.change(role, revision, since_ns),
                    gel_problems: gel.map(|gel| gel.problems.clone()).unwrap_or_default(),
                }
            })
            .collect();
        Conditions {
            now_ns,
            cameras,
            skew_ms: frame_set.skew_ms,
            disk_free_bytes: disk_free_bytes(&self.dataset),
        }
    }

    /// Returns the frames of a trigger with their metadata, and the board files used for the
    /// pre-grasp frames.
    pub(super) fn stage_capture(
        &self,
        trigger: Trigger,
        source: CommandSource,
        is_grasp: bool,
    ) -> (StageCapture, Option<[String; 2]>) {
        let Trigger { now_ns, frame_set } = trigger;
        let frames = frame_set.frames;
        let pre_grasp = match is_grasp {
            true => self.pre_grasp_frames(&frames, now_ns),
            false => PreGraspFrames::default(),
        };
        let gel = frames.get(&Role::Left).or_else(|| frames.get(&Role::Right));
        let gel_ns = gel.map_or(now_ns, |frame| frame.driver_time_ns);
        let hand = self.hand.as_ref().filter(|_| self.gels_are_virtual());
        let captured = |role, frame| self.captured(role, frame, now_ns);
        let capture = StageCapture {
            captured_at: Timestamp::now(),
            trigger_time_ns: now_ns,
            trigger: source.name().to_owned(),
            cameras: frames
                .into_iter()
                .filter_map(|(role, frame)| Some((role, captured(role, frame)?)))
                .collect(),
            pre_grasp_frames: pre_grasp
                .frames
                .into_iter()
                .filter_map(|frame| captured(Role::External, frame))
                .collect(),
            fields: Vec::new(),
            shear: BTreeMap::new(),
            force: BTreeMap::new(),
            pose: pre_grasp.pose.map(Box::new),
            truth: hand.map(|hand| Box::new(hand.truth(gel_ns))),
        };
        (capture, pre_grasp.boards)
    }

    fn captured(&self, role: Role, frame: Frame, now_ns: u64) -> Option<CapturedCamera> {
        let slot = self.hub.slot(role)?;
        let (stream, controls) =
            slot.with_info(|info| (info.stream.clone(), info.controls.clone()));
        let stream = stream?;
        let config = self.rig.cameras.get(&role);
        Some(CapturedCamera {
            age_ms: age_ms(&frame, now_ns),
            frame,
            product: stream.identity.product,
            serial: stream.identity.serial,
            interface: stream.identity.interface,
            port: stream.identity.port,
            controls,
            crop_profile: config.and_then(|c| c.crop_profile.clone()),
            depth_unit_m: stream.depth_unit_m,
        })
    }

    /// Returns the external camera's frames since the initial frame.
    fn pre_grasp_frames(&self, frames: &BTreeMap<Role, Frame>, now_ns: u64) -> PreGraspFrames {
        let pending = self.session.pending();
        let Some((recorder, pending)) = self.pre_grasp.as_ref().zip(pending) else {
            return PreGraspFrames::default();
        };
        // Excludes the external camera's grasp frame.
        let external = frames.get(&Role::External);
        let until_ns = external.map_or(now_ns, |frame| frame.driver_time_ns);
        let taken = recorder.take(pending.trigger_time_ns, until_ns, pending.external.as_ref());
        if let Some(reason) = &taken.no_pose_reason {
            self.log("no_pose", &serde_json::json!({"reason": reason}));
        }
        taken
    }

    /// Returns whether both tactile cameras are virtual, so that the ground truth is known.
    fn gels_are_virtual(&self) -> bool {
        [Role::Left, Role::Right].iter().all(|role| {
            let camera = self.rig.cameras.get(role);
            camera.is_some_and(|camera| camera.source == SourceKind::Virtual)
        })
    }
}

fn age_ms(frame: &Frame, now_ns: u64) -> f64 {
    now_ns.saturating_sub(frame.driver_time_ns) as f64 * 1e-6
}

/// Returns whether frames of a camera in this state may be saved, regardless of their age.
fn is_usable(state: &CameraState) -> bool {
    state.delivers_frames() || matches!(state, CameraState::Silent { .. } | CameraState::Ended)
}
