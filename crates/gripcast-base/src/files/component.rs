//! Types that are one component of a path.

use super::name::{ContentKey, FileName, GraspId, ObjectName, SimulationId};

/// A single, safe component of a path.
pub trait Component {
    /// The component as text.
    fn component(&self) -> &str;
}

macro_rules! components {
    ($($name:ty),*) => {
        $(impl Component for $name {
            fn component(&self) -> &str {
                self
            }
        })*
    };
}

components!(ContentKey, FileName, GraspId, ObjectName, SimulationId);

impl<T: Component> Component for &T {
    fn component(&self) -> &str {
        (*self).component()
    }
}

/// A literal of the program, never data from a file.
impl Component for &'static str {
    fn component(&self) -> &str {
        self
    }
}
