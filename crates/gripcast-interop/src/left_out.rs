//! What an export or import could not take.

use serde::{Deserialize, Serialize};

/// A grasp that is not in the result.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct LeftOut {
    /// Its id, or what that would have been.
    pub id: String,
    /// The reason.
    pub why: String,
}
