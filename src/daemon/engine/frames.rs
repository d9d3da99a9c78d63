//! What the cameras show: the frames of a trigger, and what guards and scripts ask of them.

use std::collections::BTreeMap;

use jiff::Timestamp;

use super::{Engine, disk_free_bytes};
use crate::daemon::approach::Approach;
use crate::daemon::pairing::{Paired, pair};
use crate::daemon::report::fault_text;
use gripcast_capture::calibration::SourceKind;
use gripcast_capture::camera::{Health, monotonic_ns};
use gripcast_dataset::{CapturedCamera, StageCapture};
use gripcast_imaging::{Frame, Role};
use gripcast_session::{CameraCondition, CommandSource, Conditions};

/// The frames that a trigger would save.
pub(super) struct Trigger {
    now_ns: u64,
    paired: Paired,
}

impl Engine {
    /// Every camera delivers, and what it delivers can be used.
    pub(super) fn all_live(&self) -> bool {
        self.hub.slots().all(|slot| {
            slot.facts(|facts| facts.health == Health::Live) && !slot.sound_frames().is_empty()
        })
    }

    /// Every camera has a good frame newer than the last capture, and than the last change of what
    /// a virtual rig shows.
    pub(super) fn fresh(&self) -> bool {
        let changed_ns = self.hand.as_ref().map_or(0, |hand| hand.since_ns());
        let since_ns = self.session.captured_ns().max(changed_ns);
        let frames = self.pair(monotonic_ns()).frames;
        self.hub.slots().all(|slot| {
            let frame = frames.get(&slot.role());
            frame.is_some_and(|frame| frame.driver_time_ns > since_ns)
        })
    }

    /// Whether something touches a gel, against the pending initial frame or else the last one;
    /// `None` until every gel was held against it in a frame newer than the last capture.
    pub(super) fn touched(&self) -> Option<bool> {
        let findings = self.inference.findings();
        let change = match (self.session.pending(), findings.change) {
            // Before the first initial frame nothing is known to touch.
            (None, None) => return Some(false),
            (None, last) => last,
            (Some(_), _) => Some(self.initial_change),
        };
        let since_ns = self.session.captured_ns();
        let gels = self.hub.slots().filter(|slot| slot.role().is_tactile());
        let contacts = gels
            .map(|slot| findings.changed_fraction(slot.role(), change, since_ns))
            .collect::<Option<Vec<f64>>>()?;
        let limit = self.guards.min_contact_fraction;
        Some(contacts.iter().any(|changed| *changed >= limit))
    }

    /// Pairs the newest frames.
    pub(super) fn look(&self) -> Trigger {
        let now_ns = monotonic_ns();
        Trigger {
            now_ns,
            paired: self.pair(now_ns),
        }
    }

    fn pair(&self, now_ns: u64) -> Paired {
        let since_ns = self.session.captured_ns();
        let good: BTreeMap<Role, Vec<Frame>> = self
            .hub
            .slots()
            .filter(|slot| slot.facts(|facts| usable(&facts.health)))
            .map(|slot| {
                let is_new = |frame: &Frame| frame.driver_time_ns > since_ns;
                let (new, old): (Vec<_>, Vec<_>) =
                    slot.sound_frames().into_iter().partition(is_new);
                // Where there is none since the last capture, a guard tells.
                (slot.role(), if new.is_empty() { old } else { new })
            })
            .filter(|(_, frames)| !frames.is_empty())
            .collect();
        pair(&good, now_ns)
    }

    /// The cameras as the guards see them.
    pub(super) fn conditions(&self, trigger: &Trigger) -> Conditions {
        let Trigger { now_ns, paired } = trigger;
        let now_ns = *now_ns;
        let findings = self.inference.findings();
        let change = Some(self.initial_change);
        let since_ns = self.session.captured_ns();
        let cameras = self
            .hub
            .slots()
            .map(|slot| {
                let role = slot.role();
                let frame = paired.frames.get(&role);
                let (fault, controls) =
                    slot.facts(|facts| (fault_text(&facts.health, now_ns), facts.controls.clone()));
                CameraCondition {
                    role,
                    age_ms: frame.map(|frame| age_ms(frame, now_ns)),
                    frame_time_ns: frame.map_or(0, |frame| frame.driver_time_ns),
                    fault,
                    controls,
                    contact_fraction: findings.changed_fraction(role, change, since_ns),
                }
            })
            .collect();
        Conditions {
            now_ns,
            cameras,
            skew_ms: paired.skew_ms,
            disk_free_bytes: disk_free_bytes(&self.dataset),
        }
    }

    /// The frames of a trigger with all that is stored about them, and the board files that the
    /// approach to a grasp was measured with.
    pub(super) fn stage_capture(
        &self,
        trigger: Trigger,
        source: CommandSource,
        is_grasp: bool,
    ) -> (StageCapture, Option<[String; 2]>) {
        let Trigger { now_ns, paired } = trigger;
        let frames = paired.frames;
        let approach = match is_grasp {
            true => self.approach_of_grasp(&frames, now_ns),
            false => Approach::default(),
        };
        let gel = frames.get(&Role::Left).or_else(|| frames.get(&Role::Right));
        let seen_ns = gel.map_or(now_ns, |frame| frame.driver_time_ns);
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
            pre_grasp_frames: approach
                .frames
                .into_iter()
                .filter_map(|frame| captured(Role::External, frame))
                .collect(),
            pose: approach.pose.map(Box::new),
            truth: hand.map(|hand| Box::new(hand.truth(seen_ns))),
        };
        (capture, approach.boards)
    }

    fn captured(&self, role: Role, frame: Frame, now_ns: u64) -> Option<CapturedCamera> {
        let slot = self.hub.slot(role)?;
        let (info, controls) = slot.facts(|facts| (facts.info.clone(), facts.controls.clone()));
        let info = info?;
        let config = self.rig.cameras.get(&role);
        Some(CapturedCamera {
            age_ms: age_ms(&frame, now_ns),
            frame,
            product: info.identity.product,
            serial: info.identity.serial,
            interface: info.identity.interface,
            port: info.identity.port,
            controls,
            crop_profile: config.and_then(|c| c.crop_profile.clone()),
            depth_unit_m: info.depth_unit_m,
        })
    }

    /// What the external camera saw since the initial frame.
    fn approach_of_grasp(&self, frames: &BTreeMap<Role, Frame>, now_ns: u64) -> Approach {
        let pending = self.session.pending();
        let Some((watch, pending)) = self.approach.as_ref().zip(pending) else {
            return Approach::default();
        };
        // The frame that is stored with the grasp is none of the approach.
        let external = frames.get(&Role::External);
        let until_ns = external.map_or(now_ns, |frame| frame.driver_time_ns);
        let approach = watch.take(pending.trigger_time_ns, until_ns, pending.external.as_ref());
        if let Some(why) = &approach.absence {
            self.log("no_pose", &serde_json::json!({"reason": why}));
        }
        approach
    }

    /// What the gels feel is what the simulator knows.
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

/// Whether frames of a camera in this state may be saved; age is another matter.
fn usable(health: &Health) -> bool {
    matches!(health, Health::Live | Health::Silent { .. } | Health::Ended)
}
