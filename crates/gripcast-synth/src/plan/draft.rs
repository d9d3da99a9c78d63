//! Objects on their way into a plan.

use super::{MeshSource, TextureDraft};
use crate::properties::{Material, Modifier};
use gripcast_base::error::{ErrorKind, Result};
use gripcast_base::files::SimulationId;
use gripcast_geometry::{Pose, TriangleMesh};

/// An object before it has properties and grasps.
#[derive(Clone, Debug)]
pub struct ObjectDraft {
    /// Name; a key, and begin of file names.
    pub name: SimulationId,
    /// Kind of thing.
    pub category: String,
    /// Where the plan has the mesh from.
    pub source: MeshSource,
    /// The mesh, m: closed.
    pub mesh: TriangleMesh,
    /// What it is made of.
    pub material: &'static Material,
    /// Fraction of the mesh's volume that is material; none for what is usual in the category.
    pub fill: Option<f64>,
    /// Mass, kg, where it is known.
    pub mass_kg: Option<f64>,
    /// Friction coefficient, where it is known.
    pub friction: Option<f64>,
    /// What it may look like, where that is known.
    pub looks: Vec<Modifier>,
    /// Images of its own.
    pub textures: Vec<TextureDraft>,
    /// Its grasps as `t_object_gripper`; none to draw them.
    pub grasps: Option<Vec<Pose>>,
}

/// An object that is not in the plan.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct LeftOutObject {
    /// Its name.
    pub name: String,
    /// Why.
    pub reason: String,
}

/// Objects of a source, and those that could not be read.
#[derive(Clone, Debug, Default)]
pub struct Drafts {
    /// The objects.
    pub drafts: Vec<ObjectDraft>,
    /// The others.
    pub left_out: Vec<LeftOutObject>,
}

impl Drafts {
    /// Adds an object or why it is none. What concerns the whole machine ends the reading.
    pub(super) fn note(&mut self, name: &str, read: Result<ObjectDraft>) -> Result<()> {
        match read {
            Ok(draft) => self.drafts.push(draft),
            Err(error) if error.kind() == ErrorKind::Internal => return Err(error),
            Err(error) => self.left_out.push(LeftOutObject {
                name: name.to_owned(),
                reason: error.to_string(),
            }),
        }
        Ok(())
    }

    /// Adds those of another source.
    pub fn extend(&mut self, others: Self) {
        self.drafts.extend(others.drafts);
        self.left_out.extend(others.left_out);
    }
}

impl From<Vec<ObjectDraft>> for Drafts {
    fn from(drafts: Vec<ObjectDraft>) -> Self {
        Self {
            drafts,
            left_out: Vec::new(),
        }
    }
}
