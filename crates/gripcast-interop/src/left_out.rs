//! Grasps that an export or import had to leave out.

use serde::{Deserialize, Serialize};

/// A grasp that was left out.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct LeftOut {
    /// Id of the grasp.
    pub id: String,
    /// Reason.
    pub reason: String,
}
