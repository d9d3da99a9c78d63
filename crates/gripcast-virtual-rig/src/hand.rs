//! The virtual hand: opens, closes, lifts and moves on to the next object when it is told to.

use std::sync::{Arc, Mutex, PoisonError};

use super::film::Film;
use super::library::FilmLibrary;
use gripcast_capture::camera::Clock;
use gripcast_dataset::SimulatedTruth;

/// Time from open to closed, s.
const CLOSING_S: f64 = 0.6;
/// Time from closed to lifted, s.
const LIFTING_S: f64 = 0.9;

/// Where a hand goes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum HandGoal {
    /// Around the object without touching it.
    Open,
    /// The object is gripped, the force adjusted.
    Closed,
    /// The gripper is lifted.
    Lifted,
}

impl HandGoal {
    fn progress(self) -> f64 {
        match self {
            Self::Open => 0.0,
            Self::Closed => 1.0,
            Self::Lifted => 2.0,
        }
    }
}

/// A hand that everything virtual fractions; commands take effect at the clock's present time.
pub struct VirtualHand {
    clock: Arc<dyn Clock>,
    films: FilmLibrary,
    seed: u64,
    motion: Mutex<Motion>,
}

#[derive(Clone)]
struct Motion {
    goal: HandGoal,
    from: f64,
    since_ns: u64,
    grasp: u64,
    film: Arc<Film>,
}

impl Motion {
    fn progress(&self, now_ns: u64) -> f64 {
        let to = self.goal.progress();
        // Closing and lifting take their own times; a way through both takes both.
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

/// State of the scene at one moment; what the painters paint.
#[derive(Clone, Debug)]
pub struct SceneMoment {
    /// Number of the grasp, from 0.
    pub grasp: u64,
    /// The grasp under way.
    pub film: Arc<Film>,
    /// The step of it that is shown.
    pub step: usize,
}

impl VirtualHand {
    /// An open hand over the first object.
    pub fn new(films: FilmLibrary, seed: u64, clock: Arc<dyn Clock>) -> Self {
        let motion = Motion {
            goal: HandGoal::Open,
            from: 0.0,
            since_ns: clock.now_ns(),
            grasp: 0,
            film: films.film(seed, 0),
        };
        Self {
            clock,
            films,
            seed,
            motion: Mutex::new(motion),
        }
    }

    /// Begins to move, from wherever the hand is.
    pub fn go(&self, goal: HandGoal) {
        let now_ns = self.clock.now_ns();
        self.change(|motion| {
            if motion.goal != goal {
                motion.from = motion.progress(now_ns);
                motion.goal = goal;
                motion.since_ns = now_ns;
            }
        });
    }

    /// Where the hand is or goes.
    pub fn goal(&self) -> HandGoal {
        self.change(|motion| motion.goal)
    }

    /// When it last began to move or got another object, ns of its clock.
    pub fn since_ns(&self) -> u64 {
        self.change(|motion| motion.since_ns)
    }

    /// Puts the next object on the table, between open fingers.
    pub fn next_object(&self) {
        let now_ns = self.clock.now_ns();
        self.change(|motion| {
            motion.grasp += 1;
            motion.film = self.films.film(self.seed, motion.grasp);
            (motion.goal, motion.from, motion.since_ns) = (HandGoal::Open, 0.0, now_ns);
        });
    }

    /// The grasp under way.
    pub fn film(&self) -> Arc<Film> {
        self.change(|motion| motion.film.clone())
    }

    /// The scene at `now_ns`.
    pub fn moment(&self, now_ns: u64) -> SceneMoment {
        let motion = self.change(|motion| motion.clone());
        SceneMoment {
            step: motion.film.step_at(motion.progress(now_ns)),
            grasp: motion.grasp,
            film: motion.film,
        }
    }

    /// What is true at `now_ns`.
    pub fn truth(&self, now_ns: u64) -> SimulatedTruth {
        let SceneMoment { film, step, .. } = self.moment(now_ns);
        film.truth_at(step)
    }

    fn change<T>(&self, act: impl FnOnce(&mut Motion) -> T) -> T {
        // A motion is always whole, so that a panic elsewhere leaves nothing half done.
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
        let clock = Arc::new(ManualClock::at(1_000 * MS));
        let films = FilmLibrary::built_in().unwrap();
        (VirtualHand::new(films, 1, clock.clone()), clock)
    }

    #[test]
    fn the_hand_closes_smoothly_and_turns_back_where_it_is() {
        let (hand, clock) = hand();
        let film = hand.film();
        let at = |ms: u64| hand.moment((1_000 + ms) * MS).step;
        assert_eq!(at(0), 0);
        hand.go(HandGoal::Closed);
        let closing: Vec<usize> = (0..=30).map(|step| at(step * 20)).collect();
        assert!(
            closing.windows(2).all(|w| w[0] <= w[1] && w[1] - w[0] <= 3),
            "{closing:?}"
        );
        let closed = &film.steps()[closing[30]];
        assert_eq!(closed.stage, StageName::Adjustment);
        assert_eq!(film.steps()[closing[30] + 1].stage, StageName::Lift);

        clock.advance(600 * MS);
        hand.go(HandGoal::Open);
        clock.advance(300 * MS);
        let half = hand.moment(clock.now_ns()).step;
        assert!(
            half.abs_diff(closing[30] / 2) <= 1,
            "{half} of {}",
            closing[30]
        );
        hand.go(HandGoal::Closed);
        assert_eq!(hand.moment(clock.now_ns()).step, half);
        hand.go(HandGoal::Closed);
        clock.advance(600 * MS);
        assert_eq!(hand.moment(clock.now_ns()).step, closing[30]);
    }

    #[test]
    fn the_lift_shows_whether_it_holds_and_can_be_taken_back() {
        let (hand, clock) = hand();
        hand.go(HandGoal::Lifted);
        clock.advance(1_500 * MS);
        let film = hand.film();
        assert_eq!(hand.moment(clock.now_ns()).step, film.steps().len() - 1);
        let truth = hand.truth(clock.now_ns());
        assert!(truth.held && truth.clip == film.name());
        hand.go(HandGoal::Closed);
        clock.advance(900 * MS);
        let step = &film.steps()[hand.moment(clock.now_ns()).step];
        assert_eq!(step.stage, StageName::Adjustment);
        assert!(hand.truth(clock.now_ns()).force_n.iter().all(|f| *f > 1.0));
    }

    #[test]
    fn the_next_object_stands_between_open_fingers() {
        let (hand, clock) = hand();
        hand.go(HandGoal::Closed);
        clock.advance(1_000 * MS);
        hand.next_object();
        assert_eq!(hand.goal(), HandGoal::Open);
        let moment = hand.moment(clock.now_ns());
        assert_eq!((moment.grasp, moment.step), (1, 0));
        assert!(
            !hand.truth(clock.now_ns()).held,
            "the second grasp is one that is lost"
        );
    }
}
