//! Lift frames: the gels' frames in the time after the grasp trigger.

use std::collections::BTreeMap;

use super::Engine;
use crate::daemon::store::StoreMessage;
use gripcast_base::error::Result;
use gripcast_base::files::GraspId;
use gripcast_capture::camera::monotonic_ns;

/// Time after the last lift frame in which it may still arrive, ns.
const ARRIVAL_NS: u64 = 300_000_000;

/// A lift whose frames are being kept.
#[derive(Debug)]
pub(super) struct KeptLift {
    /// The grasp, once it is saved.
    id: Option<GraspId>,
    /// Driver time of the last frame, ns.
    until_ns: u64,
}

impl Engine {
    /// Keeps the gels' frames from a grasp trigger on. An earlier lift ends here.
    pub(super) fn keep_lift(&mut self, trigger_ns: u64) -> Result<()> {
        self.store_lift()?;
        if self.keep_lift.is_zero() {
            return Ok(());
        }
        let length_ns = u64::try_from(self.keep_lift.as_nanos()).unwrap_or(u64::MAX);
        let until_ns = trigger_ns.saturating_add(length_ns);
        for slot in self.hub.slots().filter(|slot| slot.role.is_tactile()) {
            slot.keep_frames(trigger_ns..=until_ns);
        }
        self.lift = Some(KeptLift { id: None, until_ns });
        Ok(())
    }

    /// The grasp of the lift is saved, or not.
    pub(super) fn name_lift(&mut self, id: Option<GraspId>) {
        match (&mut self.lift, id) {
            (Some(lift), Some(id)) => lift.id = Some(id),
            _ => self.drop_lift(),
        }
    }

    fn drop_lift(&mut self) {
        self.lift = None;
        for slot in self.hub.slots() {
            slot.take_kept_frames();
        }
    }

    /// Stores the lift frames once the last has arrived.
    pub(super) fn store_lift_if_complete(&mut self) -> Result<()> {
        let is_complete = |lift: &KeptLift| monotonic_ns() > lift.until_ns + ARRIVAL_NS;
        match self.lift.as_ref().is_some_and(is_complete) {
            true => self.store_lift(),
            false => Ok(()),
        }
    }

    /// Stores the lift frames that have arrived.
    pub(super) fn store_lift(&mut self) -> Result<()> {
        let Some(id) = self.lift.take().and_then(|lift| lift.id) else {
            self.drop_lift();
            return Ok(());
        };
        let frames = self
            .hub
            .slots()
            .map(|slot| (slot.role, slot.take_kept_frames()));
        let frames: BTreeMap<_, _> = frames.filter(|(_, frames)| !frames.is_empty()).collect();
        self.store.send(StoreMessage::AppendLift {
            id,
            frames,
            requested_s: self.keep_lift.as_secs_f64(),
        })
    }
}
