//! The virtual hand: opens, closes and moves on to the next object when it is told to.

use std::sync::{Arc, Mutex, PoisonError};

use super::grasp::VirtualGrasp;
use crate::rig::camera::clock::Clock;

/// Time from open to closed, s.
const CLOSING_S: f64 = 0.6;

/// A hand that everything virtual shares; commands take effect at the clock's present time.
pub struct VirtualHand {
    clock: Arc<dyn Clock>,
    seed: u64,
    motion: Mutex<Motion>,
}

#[derive(Clone, Copy)]
struct Motion {
    closed: bool,
    from: f64,
    since_ns: u64,
    grasp: u64,
    placed_ns: u64,
}

impl Motion {
    fn closure(&self, now_ns: u64) -> f64 {
        let target = if self.closed { 1.0 } else { 0.0 };
        let elapsed_s = now_ns.saturating_sub(self.since_ns) as f64 * 1e-9;
        let t = (elapsed_s / CLOSING_S).min(1.0);
        self.from + (target - self.from) * t * t * (3.0 - 2.0 * t)
    }
}

/// State of the scene at one moment; what the painters paint.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SceneMoment {
    /// 0 open … 1 closed.
    pub closure: f64,
    /// The grasp under way.
    pub grasp: VirtualGrasp,
    /// How long the object has been on the table, s.
    pub placed_for_s: f64,
    /// Time, s.
    pub time_s: f64,
}

impl VirtualHand {
    /// An open hand over the first object.
    pub fn new(seed: u64, clock: Arc<dyn Clock>) -> Self {
        let now_ns = clock.now_ns();
        Self {
            clock,
            seed,
            motion: Mutex::new(Motion {
                closed: false,
                from: 0.0,
                since_ns: now_ns,
                grasp: 0,
                placed_ns: 0,
            }),
        }
    }

    /// Begins to close or to open, from wherever the hand is.
    pub fn set_closed(&self, closed: bool) {
        let now_ns = self.clock.now_ns();
        self.change(|motion| {
            if motion.closed != closed {
                motion.from = motion.closure(now_ns);
                motion.closed = closed;
                motion.since_ns = now_ns;
            }
        });
    }

    /// Whether the hand is closed or closing.
    pub fn is_closed(&self) -> bool {
        self.change(|motion| motion.closed)
    }

    /// Opens the hand and puts the next object on the table.
    pub fn next_object(&self) {
        self.set_closed(false);
        let now_ns = self.clock.now_ns();
        self.change(|motion| {
            motion.grasp += 1;
            motion.placed_ns = now_ns;
        });
    }

    /// The grasp under way.
    pub fn grasp(&self) -> VirtualGrasp {
        VirtualGrasp::new(self.seed, self.change(|motion| motion.grasp))
    }

    /// The scene at `now_ns`.
    pub fn moment(&self, now_ns: u64) -> SceneMoment {
        let motion = self.change(|motion| *motion);
        SceneMoment {
            closure: motion.closure(now_ns),
            grasp: VirtualGrasp::new(self.seed, motion.grasp),
            placed_for_s: now_ns.saturating_sub(motion.placed_ns) as f64 * 1e-9,
            time_s: now_ns as f64 * 1e-9,
        }
    }

    fn change<T>(&self, act: impl FnOnce(&mut Motion) -> T) -> T {
        // A motion is always whole, so that a panic elsewhere leaves nothing half done.
        act(&mut self.motion.lock().unwrap_or_else(PoisonError::into_inner))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rig::camera::ManualClock;

    const MS: u64 = 1_000_000;

    #[test]
    fn the_hand_closes_smoothly_and_turns_back_where_it_is() {
        let clock = Arc::new(ManualClock::at(1_000 * MS));
        let hand = VirtualHand::new(1, clock.clone());
        assert_eq!(hand.moment(1_000 * MS).closure, 0.0);
        hand.set_closed(true);
        let mut last = 0.0;
        for step in 0..=30 {
            let closure = hand.moment((1_000 + step * 20) * MS).closure;
            assert!(closure >= last && closure - last < 0.06, "step {step}");
            last = closure;
        }
        assert_eq!(last, 1.0);

        clock.advance(600 * MS);
        hand.set_closed(false);
        clock.advance(300 * MS);
        let half = hand.moment(clock.now_ns()).closure;
        assert!((half - 0.5).abs() < 1e-9);
        hand.set_closed(true);
        assert!((hand.moment(clock.now_ns()).closure - half).abs() < 1e-9);
        hand.set_closed(true);
        clock.advance(600 * MS);
        assert_eq!(hand.moment(clock.now_ns()).closure, 1.0);
    }

    #[test]
    fn the_next_object_opens_the_hand() {
        let clock = Arc::new(ManualClock::default());
        let hand = VirtualHand::new(1, clock.clone());
        hand.set_closed(true);
        clock.advance(1_000 * MS);
        hand.next_object();
        assert!(!hand.is_closed());
        assert_eq!(hand.grasp().number, 1);
        clock.advance(700 * MS);
        let moment = hand.moment(clock.now_ns());
        assert_eq!(moment.closure, 0.0);
        assert!((moment.placed_for_s - 0.7).abs() < 1e-9);
    }
}
