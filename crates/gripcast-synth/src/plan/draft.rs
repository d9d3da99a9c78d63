//! Drafts: objects before they are part of a plan.

use super::{MeshSource, TextureDraft};
use crate::acronym::AcronymGrasp;
use crate::properties::{DescribedAppearance, Material};
use gripcast_base::error::{ErrorKind, Result};
use gripcast_base::files::SimulationId;
use gripcast_geometry::TriangleMesh;

/// An object before it has properties and grasps.
#[derive(Clone, Debug)]
pub struct ObjectDraft {
    /// Name: a key and the start of file names.
    pub name: SimulationId,
    /// Category, for instance `mug`.
    pub category: String,
    /// Source of the mesh in the plan.
    pub source: MeshSource,
    /// Closed mesh, m.
    pub mesh: TriangleMesh,
    /// Material.
    pub material: &'static Material,
    /// Fraction of the mesh's volume that is material; none for the default of the category.
    pub fill: Option<f64>,
    /// Mass, kg, if known.
    pub mass_kg: Option<f64>,
    /// Friction coefficient, if known.
    pub friction: Option<f64>,
    /// Appearances, if known.
    pub appearances: Vec<DescribedAppearance>,
    /// Its own textures.
    pub textures: Vec<TextureDraft>,
    /// Given grasps; none to sample them.
    pub grasps: Option<Vec<AcronymGrasp>>,
}

/// An object that is not in the plan.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct LeftOutObject {
    /// Name.
    pub name: String,
    /// Why it was left out.
    pub reason: String,
}

/// Objects of one source, and those that cannot be used.
#[derive(Clone, Debug, Default)]
pub struct Drafts {
    /// Usable objects.
    pub drafts: Vec<ObjectDraft>,
    /// Objects that were left out.
    pub left_out: Vec<LeftOutObject>,
}

impl Drafts {
    /// Adds an object, or why it was left out. Internal errors are passed on.
    pub(super) fn push(&mut self, name: &str, read: Result<ObjectDraft>) -> Result<()> {
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

    /// Adds the objects of another source.
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
