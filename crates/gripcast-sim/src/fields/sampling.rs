//! Which time steps of a simulation are recorded with their fields.

use std::fmt;
use std::num::NonZeroU32;
use std::str::FromStr;

use gripcast_base::error::{Error, Result};

/// Time steps whose fields are recorded: `all`, `stages` or `every:N`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FieldSampling {
    /// The first step and every N-th after it.
    Every(NonZeroU32),
    /// The last step of each stage of a grasp, and each target of a press.
    Stages,
}

impl FieldSampling {
    /// Every step.
    pub const ALL: Self = Self::Every(NonZeroU32::MIN);

    /// Whether the step with this index is recorded, apart from the ends of stages.
    pub(crate) fn takes(self, step: usize) -> bool {
        match self {
            Self::Every(n) => step.is_multiple_of(n.get() as usize),
            Self::Stages => false,
        }
    }
}

impl FromStr for FieldSampling {
    type Err = Error;

    fn from_str(text: &str) -> Result<Self> {
        let every = |n: &str| n.parse().ok().map(Self::Every);
        let found = match text {
            "all" => Some(Self::ALL),
            "stages" => Some(Self::Stages),
            _ => text.strip_prefix("every:").and_then(every),
        };
        found.ok_or_else(|| {
            Error::usage(format!(
                "expected `all`, `stages` or `every:N` with N from 1, found `{text}`"
            ))
            .remedy("pass for instance every:10 for each tenth time step")
        })
    }
}

impl fmt::Display for FieldSampling {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match *self {
            Self::ALL => f.write_str("all"),
            Self::Every(n) => write!(f, "every:{n}"),
            Self::Stages => f.write_str("stages"),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_round_trip_and_others_are_refused() {
        for name in ["all", "stages", "every:10"] {
            let sampling: FieldSampling = name.parse().unwrap();
            assert_eq!(sampling.to_string(), name);
        }
        let tenth: FieldSampling = "every:10".parse().unwrap();
        let taken: Vec<usize> = (0..25).filter(|step| tenth.takes(*step)).collect();
        assert_eq!(taken, [0, 10, 20]);
        for wrong in ["", "every", "every:0", "every:-1", "every:x", "10"] {
            let error = wrong.parse::<FieldSampling>().unwrap_err().to_string();
            assert!(error.contains("every:N"), "{error}");
        }
    }
}
