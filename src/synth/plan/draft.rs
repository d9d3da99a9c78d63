//! Objects on their way into a plan.

use std::path::Path;

use super::{MeshSource, PictureTexture};
use crate::error::{Error, ErrorKind, Result};
use crate::geometry::{Pose, TriangleMesh};
use crate::synth::properties::{Material, Modifier};

/// An object before it has properties and grasps.
#[derive(Clone, Debug)]
pub struct ObjectDraft {
    /// Name; a key.
    pub name: String,
    /// Kind of thing.
    pub category: String,
    /// Where the mesh comes from.
    pub source: MeshSource,
    /// The mesh, m: closed.
    pub mesh: TriangleMesh,
    /// What it is made of.
    pub material: &'static Material,
    /// Share of the mesh's volume that is material; none for what is usual in the category.
    pub fill: Option<f64>,
    /// Mass, kg, where it is known.
    pub mass_kg: Option<f64>,
    /// Friction coefficient, where it is known.
    pub friction: Option<f64>,
    /// What it may look like, where that is known.
    pub looks: Vec<Modifier>,
    /// Pictures of its own.
    pub textures: Vec<PictureTexture>,
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

/// A file as plans name it: relative where it lies in the plan's folder, so that the folder can be
/// moved with it, else from the root.
pub(super) fn stored_path(file: &Path, plan_folder: &Path) -> Result<String> {
    let whole = file
        .canonicalize()
        .map_err(|e| Error::io("cannot find the file", e).at(file.display()))?;
    let folder = plan_folder.canonicalize().ok();
    let stored = folder
        .and_then(|folder| whole.strip_prefix(folder).ok().map(Path::to_owned))
        .unwrap_or(whole);
    stored.to_str().map(str::to_owned).ok_or_else(|| {
        Error::new(ErrorKind::Input, "the path is no Unicode")
            .at(stored.display())
            .remedy("rename the file: plans are text")
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn files_in_the_folder_of_the_plan_move_with_it() {
        let folder = tempfile::tempdir().unwrap();
        let plan = folder.path().join("plan");
        std::fs::create_dir(&plan).unwrap();
        let [inside, outside] = [plan.join("a.obj"), folder.path().join("b.obj")];
        std::fs::write(&inside, "").unwrap();
        std::fs::write(&outside, "").unwrap();
        assert_eq!(stored_path(&inside, &plan).unwrap(), "a.obj");
        let stored = stored_path(&outside, &plan).unwrap();
        assert!(Path::new(&stored).is_absolute());
        assert!(stored_path(&plan.join("c.obj"), &plan).is_err());
    }
}
