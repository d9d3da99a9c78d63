//! The virtual hand: opens, closes, lifts and moves on to the next object on command.

use std::sync::{Arc, Mutex, PoisonError};

use super::clip::Clip;
use super::library::ClipLibrary;
use gripcast_capture::camera::Clock;
use gripcast_dataset::SimulatedTruth;

/// Duration from open to closed, s.
const CLOSING_S: f64 = 0.6;
/// Duration from closed to lifted, s.
const LIFTING_S: f64 = 0.9;

/// Target state of the hand.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum HandTarget {
    /// Fingers around the object without contact.
    Open,
    /// Object grasped, force adjusted.
    Closed,
    /// Gripper lifted.
    Lifted,
}

impl HandTarget {
    fn progress(self) -> f64 {
        match self {
            Self::Open => 0.0,
            Self::Closed => 1.0,
            Self::Lifted => 2.0,
        }
    }
}

/// The hand of a virtual rig, shared by its cameras. Commands take effect at the current clock
/// time.
pub struct VirtualHand {
    clock: Arc<dyn Clock>,
    clips: ClipLibrary,
    seed: u64,
    motion: Mutex<Motion>,
}

#[derive(Clone)]
struct Motion {
    target: HandTarget,
    from: f64,
    since_ns: u64,
    grasp: u64,
    clip: Arc<Clip>,
}

impl Motion {
    fn progress(&self, now_ns: u64) -> f64 {
        let to = self.target.progress();
        // A motion through closing and lifting takes the sum of both durations.
        let time_at =
            |progress: f64| CLOSING_S * progress.min(1.0) + LIFTING_S * (progress - 1.0).max(0.0);
        let duration_s = (time_at(to) - time_at(self.from)).abs();
        let elapsed_s = now_ns.saturating_sub(self.since_ns) as f64 * 1e-9;
        if elapsed_s >= duration_s {
            return to;
        }
        let t = elapsed_s / duration_s;
        self.from + (to - self.from) * t * t * (3.0 - 2.0 * t)
    }
}

/// State of the scene at one time; input of the renderers.
#[derive(Clone, Debug)]
pub struct SceneState {
    /// Index of the grasp, from 0.
    pub grasp: u64,
    /// The current clip.
    pub clip: Arc<Clip>,
    /// Index of the shown step of the clip.
    pub step: usize,
}

impl VirtualHand {
    /// Creates an open hand around the first object.
    pub fn new(clips: ClipLibrary, seed: u64, clock: Arc<dyn Clock>) -> Self {
        let motion = Motion {
            target: HandTarget::Open,
            from: 0.0,
            since_ns: clock.now_ns(),
            grasp: 0,
            clip: clips.clip(seed, 0),
        };
        Self {
            clock,
            clips,
            seed,
            motion: Mutex::new(motion),
        }
    }

    /// Starts a motion from the current state to `target`.
    pub fn move_to(&self, target: HandTarget) {
        let now_ns = self.clock.now_ns();
        self.change(|motion| {
            if motion.target != target {
                motion.from = motion.progress(now_ns);
                motion.target = target;
                motion.since_ns = now_ns;
            }
        });
    }

    /// Returns the start time of the last motion or object change, ns of the hand's clock.
    pub fn since_ns(&self) -> u64 {
        self.change(|motion| motion.since_ns)
    }

    /// Places the next object between the open fingers.
    pub fn next_object(&self) {
        let now_ns = self.clock.now_ns();
        self.change(|motion| {
            motion.grasp += 1;
            motion.clip = self.clips.clip(self.seed, motion.grasp);
            (motion.target, motion.from, motion.since_ns) = (HandTarget::Open, 0.0, now_ns);
        });
    }

    /// Returns the current clip.
    pub fn clip(&self) -> Arc<Clip> {
        self.change(|motion| motion.clip.clone())
    }

    /// Returns the scene at `now_ns`.
    pub fn scene_at(&self, now_ns: u64) -> SceneState {
        let motion = self.change(|motion| motion.clone());
        SceneState {
            step: motion.clip.step_at(motion.progress(now_ns)),
            grasp: motion.grasp,
            clip: motion.clip,
        }
    }

    /// Returns the ground truth at `now_ns`.
    pub fn truth(&self, now_ns: u64) -> SimulatedTruth {
        let SceneState { clip, step, .. } = self.scene_at(now_ns);
        clip.truth_at(step)
    }

    fn change<T>(&self, act: impl FnOnce(&mut Motion) -> T) -> T {
        // A motion is always consistent, even after a panic of another holder.
        act(&mut self.motion.lock().unwrap_or_else(PoisonError::into_inner))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use gripcast_capture::camera::ManualClock;
    use gripcast_sim::grasp::StageName;

    const MS: u64 = 1_000_000;

    fn hand() -> (VirtualHand, Arc<ManualClock>) {
        let clock = Arc::new(ManualClock::new(1_000 * MS));
        let clips = ClipLibrary::built_in().unwrap();
        (VirtualHand::new(clips, 1, clock.clone()), clock)
    }

    #[test]
    fn hand_closes_smoothly_and_reverses_from_its_current_state() {
        let (hand, clock) = hand();
        let clip = hand.clip();
        let at = |ms: u64| hand.scene_at((1_000 + ms) * MS).step;
        assert_eq!(at(0), 0);
        hand.move_to(HandTarget::Closed);
        let closing: Vec<usize> = (0..=30).map(|step| at(step * 20)).collect();
        assert!(
            closing.windows(2).all(|w| w[0] <= w[1] && w[1] - w[0] <= 3),
            "{closing:?}"
        );
        let closed = &clip.steps[closing[30]];
        assert_eq!(closed.stage, StageName::Adjustment);
        assert_eq!(clip.steps[closing[30] + 1].stage, StageName::Lift);

        clock.advance(600 * MS);
        hand.move_to(HandTarget::Open);
        clock.advance(300 * MS);
        let half = hand.scene_at(clock.now_ns()).step;
        assert!(
            half.abs_diff(closing[30] / 2) <= 1,
            "{half} of {}",
            closing[30]
        );
        hand.move_to(HandTarget::Closed);
        assert_eq!(hand.scene_at(clock.now_ns()).step, half);
        hand.move_to(HandTarget::Closed);
        clock.advance(600 * MS);
        assert_eq!(hand.scene_at(clock.now_ns()).step, closing[30]);
    }

    #[test]
    fn lift_shows_the_outcome_and_can_be_undone() {
        let (hand, clock) = hand();
        hand.move_to(HandTarget::Lifted);
        clock.advance(1_500 * MS);
        let clip = hand.clip();
        assert_eq!(hand.scene_at(clock.now_ns()).step, clip.steps.len() - 1);
        let truth = hand.truth(clock.now_ns());
        assert!(truth.stable && truth.clip == clip.name);
        hand.move_to(HandTarget::Closed);
        clock.advance(900 * MS);
        let step = &clip.steps[hand.scene_at(clock.now_ns()).step];
        assert_eq!(step.stage, StageName::Adjustment);
        assert!(hand.truth(clock.now_ns()).force_n.iter().all(|f| *f > 1.0));
    }

    #[test]
    fn next_object_starts_with_an_open_hand() {
        let (hand, clock) = hand();
        hand.move_to(HandTarget::Closed);
        clock.advance(1_000 * MS);
        hand.next_object();
        let scene = hand.scene_at(clock.now_ns());
        assert_eq!((scene.grasp, scene.step), (1, 0));
        assert!(!hand.truth(clock.now_ns()).stable, "the second grasp slips");
    }
}
