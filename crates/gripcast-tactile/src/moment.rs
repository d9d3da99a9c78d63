//! Moments of a simulated grasp that are rendered.

use gripcast_base::error::{Error, Result};
use gripcast_sim::grasp::{Snapshot, StageName, Trace};

/// Moment of a grasp.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Moment {
    /// Before closing (initial frame).
    Initial,
    /// End of the closure.
    Closure,
    /// End of the force adjustment (grasp frame).
    Grasp,
    /// End of the lift.
    Lift,
}

impl Moment {
    /// All moments in order.
    pub const ALL: [Self; 4] = [Self::Initial, Self::Closure, Self::Grasp, Self::Lift];

    /// Name in files and on the command line.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Initial => "initial",
            Self::Closure => "closure",
            Self::Grasp => "grasp",
            Self::Lift => "lift",
        }
    }

    fn stage(self) -> Option<StageName> {
        match self {
            Self::Initial => None,
            Self::Closure => Some(StageName::Closure),
            Self::Grasp => Some(StageName::Adjustment),
            Self::Lift => Some(StageName::Lift),
        }
    }

    /// Returns the state of a grasp at the moment; `None` for the initial one.
    ///
    /// # Errors
    /// `Input` if the grasp ended before.
    pub fn snapshot(self, trace: &Trace) -> Result<Option<&Snapshot>> {
        let find = |stage| trace.snapshots.iter().rfind(|s| s.stage == stage);
        let Some(stage) = self.stage() else {
            return Ok(None);
        };
        find(stage).map(Some).ok_or_else(|| {
            let reached = Self::ALL.into_iter().filter(|moment| {
                let stage = moment.stage();
                stage.is_none_or(|stage| find(stage).is_some())
            });
            let reached: Vec<_> = reached.map(Self::name).collect();
            Error::input(format!("the grasp ended before its {}", self.name()))
                .remedy(format!("it has: {}", reached.join(" ")))
        })
    }
}
