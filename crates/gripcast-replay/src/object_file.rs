//! An object of a dataset: `OBJECTS/NAME.toml`.

use std::collections::BTreeMap;
use std::path::Path;
use std::sync::Arc;

use glam::DVec3;
use serde::{Deserialize, Serialize};

use gripcast_base::error::{Error, Result};
use gripcast_base::files::{BeneathPath, FileKind, ObjectName, Root};
use gripcast_geometry::{Aabb, LengthUnit, Pose, TriangleMesh, load_object_mesh_below};
use gripcast_pose::PrintedSheet;
use gripcast_sim::grasp::resting_pose;

/// Ending of object files.
const ENDING: &str = ".toml";
/// Version of the format.
const SCHEMA: u32 = 1;
/// Heaviest object that is believed, kg; more is mostly grams taken for kilograms.
const MAX_MASS_KG: f64 = 10.0;
/// The lowest point of an object on the ground may be off the ground by this, m.
const GROUND_TOLERANCE_M: f64 = 1e-3;

/// What is known of an object besides its name, which is that of the file.
///
/// ```toml
/// schema = 1
/// mesh = "b1.obj"            # below this file's folder, or builtin:NAME
/// unit = "mm"                # of the file's coordinates; not for builtin:NAME
/// scale = 1.0
/// mesh_sha256 = "…"          # optional: what `gripcast sim grasp --json` prints for the mesh
/// mass_kg = 0.070
/// stable_pose = 0            # or t_world_object = { t_m = [x, y, z], q_wxyz = [w, x, y, z] }
/// drawn_from_sha256 = "…"    # optional: the mesh that the printed sheet was drawn for, if this is
///                            # another one in the same frame
/// ```
///
/// Without `stable_pose` and `t_world_object` it lies as on its printed sheet, else in its stable
/// pose nearest to how the mesh stands, else the most probable one.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ObjectFile {
    /// Version of the format, 1.
    pub schema: u32,
    /// Mesh file below the folder of the object file, or `builtin:NAME`.
    pub mesh: String,
    /// Unit of the mesh file's coordinates: `mm`, `cm`, `m`, `in`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub unit: Option<String>,
    /// Factor on the size of the mesh.
    #[serde(default = "one")]
    pub scale: f64,
    /// Hash of the mesh as simulated, in metres: a mesh that changed since is refused.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub mesh_sha256: Option<String>,
    /// Mass, kg.
    pub mass_kg: f64,
    /// Number of the stable pose that it lies in, the most probable being 0.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub stable_pose: Option<usize>,
    /// Its pose on the ground, z up, ground z = 0.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub t_world_object: Option<Pose>,
    /// Hash of the mesh that the printed sheet was drawn for, where that is another mesh (for
    /// instance a finer one) in the same frame.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub drawn_from_sha256: Option<String>,
}

/// An object that can be simulated.
#[derive(Clone, Debug)]
pub struct ReplayObject {
    /// Its name in the dataset.
    pub name: ObjectName,
    /// What its file says.
    pub file: ObjectFile,
    /// Mesh file as found from here, or `builtin:NAME`.
    pub source: String,
    /// Unit of that file.
    pub unit: LengthUnit,
    /// Closed surface in its own frame, m.
    pub mesh: Arc<TriangleMesh>,
    /// Its content hash.
    pub mesh_sha256: String,
    /// What was fixed in the mesh.
    pub warnings: Vec<String>,
}

fn one() -> f64 {
    1.0
}

impl ObjectFile {
    /// Writes the file.
    ///
    /// # Errors
    /// That of the operating system.
    pub fn save(&self, place: &BeneathPath) -> Result<()> {
        let text = toml::to_string(self)
            .map_err(|e| Error::internal("cannot write the object file").because(e))?;
        place
            .replace(text.as_bytes())
            .map_err(|e| Error::io("cannot write the object file", e).at(place.display()))
    }

    fn read(place: &BeneathPath) -> Result<Self> {
        let text = place
            .read_to_string(FileKind::Record)
            .map_err(|e| Error::io("cannot read the object", e))?;
        let file: Self = toml::from_str(&text).map_err(|e| {
            Error::input("this is no object file").because(e).remedy(
                "write schema = 1, mesh, unit, mass_kg, and stable_pose or t_world_object \
                     (docs/replay.md)",
            )
        })?;
        file.check()?;
        Ok(file)
    }

    fn check(&self) -> Result<()> {
        let wrong = |what: String, remedy: &str| Err(Error::input(what).remedy(remedy.to_owned()));
        if self.schema != SCHEMA {
            return wrong(
                format!(
                    "the object file has schema {}, known is {SCHEMA}",
                    self.schema
                ),
                "read it with the release of gripcast that it was written for",
            );
        }
        if !(self.mass_kg > 0.0 && self.mass_kg <= MAX_MASS_KG) {
            return wrong(
                format!(
                    "`mass_kg` must be above 0 and at most {MAX_MASS_KG} kg, found {}",
                    self.mass_kg
                ),
                "give the mass in kilograms: 70 g are 0.070",
            );
        }
        if self.stable_pose.is_some() && self.t_world_object.is_some() {
            return wrong(
                "`stable_pose` and `t_world_object` contradict each other".to_owned(),
                "leave one of them out",
            );
        }
        if self.unit.is_none() && !self.mesh.starts_with("builtin:") {
            return wrong(
                "`unit` is missing: mesh files do not tell what their numbers mean".to_owned(),
                "write unit = \"mm\", \"cm\", \"m\" or \"in\"",
            );
        }
        Ok(())
    }
}

impl ReplayObject {
    /// Reads the file of an object in a folder, and its mesh.
    ///
    /// # Errors
    /// Those of reading the files; `Input` for what cannot be simulated, a mesh outside of the folder
    /// or another one than the file says.
    pub fn load(folder: &Root, place: &BeneathPath) -> Result<Self> {
        Self::read(folder, place).map_err(|e| e.at(place.display()))
    }

    fn read(folder: &Root, place: &BeneathPath) -> Result<Self> {
        let name = object_name(&place.name())?;
        let file = ObjectFile::read(place)?;
        let unit = file.unit.as_deref().unwrap_or("m").parse()?;
        let prepared = load_object_mesh_below(folder, &file.mesh, unit, file.scale)?;
        let source = match file.mesh.starts_with("builtin:") {
            true => file.mesh.clone(),
            false => folder.path().join(&file.mesh).display().to_string(),
        };
        let mesh_sha256 = prepared.mesh.content_hash();
        if let Some(expected) = &file.mesh_sha256
            && *expected != mesh_sha256
        {
            return Err(Error::input(format!(
                "the mesh changed: expected {expected}, found {mesh_sha256}"
            ))
            .remedy(
                "restore the mesh, its unit and scale; or, if the new one is right and in the same \
                 frame, write its hash into `mesh_sha256`",
            ));
        }
        Ok(Self {
            name,
            source,
            unit,
            mesh: Arc::new(prepared.mesh),
            mesh_sha256,
            warnings: prepared.warnings,
            file,
        })
    }

    /// How it lies on the ground; `sheet` is the printed sheet that it stood on.
    ///
    /// # Errors
    /// `Input` if the sheet was drawn for another mesh, the pose does not stand on the ground, or
    /// there is no such stable pose.
    pub fn t_world_object(&self, sheet: Option<&PrintedSheet>) -> Result<Pose> {
        if let Some(sheet) = sheet {
            self.check_sheet(sheet)?;
        }
        let given = self.file.t_world_object;
        let given = given.or_else(|| match self.file.stable_pose {
            Some(_) => None,
            None => sheet.map(|sheet| sheet.t_world_object),
        });
        let Some(pose) = given else {
            let (_, pose) = resting_pose(&self.mesh, self.file.stable_pose)?;
            return Ok(pose.t_world_object);
        };
        let points = self.mesh.all_corners().flatten();
        let lowest = Aabb::from_points(points.map(|v| pose.transform_point(v)))
            .min
            .z;
        if lowest.abs() > GROUND_TOLERANCE_M {
            return Err(Error::input(format!(
                "the lowest point of the object must lie on the ground (z = 0), found it at \
                     {:.1} mm",
                1e3 * lowest
            ))
            .remedy("correct `t_world_object`, or give `stable_pose` instead"));
        }
        // What a sheet leaves open to rounding would be a gap or a penetration.
        Ok(Pose::from_translation(DVec3::Z * -lowest) * pose)
    }

    fn check_sheet(&self, sheet: &PrintedSheet) -> Result<()> {
        let drawn = &sheet.object_sha256;
        if *drawn == self.mesh_sha256 || self.file.drawn_from_sha256.as_ref() == Some(drawn) {
            return Ok(());
        }
        Err(Error::input(format!(
            "the printed sheet was drawn for another mesh ({}, {drawn}) than {} ({}): shape, \
                 unit, scale or frame may differ",
            sheet.object, self.source, self.mesh_sha256
        ))
        .remedy(
            "give the mesh, unit and scale that the sheet was drawn for; or, if this one is in the \
             same frame, write the sheet's hash into `drawn_from_sha256`",
        ))
    }
}

/// All objects of a folder by name, or why one cannot be used.
///
/// # Errors
/// That of the operating system if the folder cannot be read; `NotFound` if it has no object file;
/// `Input` for a file name that no object can have.
pub fn load_objects(folder: &Path) -> Result<BTreeMap<ObjectName, Result<ReplayObject>>> {
    let root = Root::new(folder);
    let unreadable = |e| Error::io("cannot read the objects", e).at(folder.display());
    let mut objects = BTreeMap::new();
    for place in root.top().entries().map_err(unreadable)? {
        let file = place.name();
        // Editors keep hidden files beside those that are open.
        if file.ends_with(ENDING) && !file.starts_with('.') {
            let name = object_name(&file).map_err(|e| e.at(folder.display()))?;
            objects.insert(name, ReplayObject::load(&root, &place));
        }
    }
    if objects.is_empty() {
        return Err(Error::not_found("there is no object file")
            .at(folder.display())
            .remedy("write NAME.toml for each object of the dataset (docs/replay.md)"));
    }
    Ok(objects)
}

/// The object that a file is named after.
fn object_name(file: &str) -> Result<ObjectName> {
    ObjectName::parse(file.strip_suffix(ENDING).unwrap_or(file))
        .map_err(|e| e.remedy("rename the object file"))
}
