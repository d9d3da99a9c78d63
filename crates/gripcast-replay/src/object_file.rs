//! Object files: `OBJECTS/NAME.toml`.

use std::collections::BTreeMap;
use std::path::Path;
use std::sync::Arc;

use glam::DVec3;
use serde::{Deserialize, Serialize};

use gripcast_base::error::{Error, Result};
use gripcast_base::files::{BeneathPath, FileKind, ObjectName, Root};
use gripcast_geometry::{
    Aabb, LengthUnit, MeshOptions, Pose, TriangleMesh, check_mass, load_object_mesh_below,
};
use gripcast_pose::PrintedSheet;
use gripcast_sim::grasp::resting_pose;

/// Suffix of object files.
const SUFFIX: &str = ".toml";
/// Version of the format.
const SCHEMA: u32 = 1;
/// Maximum height of the lowest point above or below the ground, m.
const GROUND_TOLERANCE_M: f64 = 1e-3;

/// Description of an object; its name is that of the file.
///
/// ```toml
/// schema = 1
/// mesh = "b1.obj"            # below this file's folder, or builtin:NAME
/// unit = "mm"                # of the file's coordinates; not needed for builtin:NAME
/// scale = 1.0
/// repair = "auto"            # optional: none, auto, strict
/// wall_thickness_mm = 2.0    # optional: the wall of a mesh modelled without thickness
/// mesh_sha256 = "…"          # optional: what `gripcast sim grasp --json` prints for the mesh
/// mass_kg = 0.070
/// stable_pose = 0            # or t_world_object = { t_m = [x, y, z], q_wxyz = [w, x, y, z] }
/// drawn_from_sha256 = "…"    # optional: the mesh that the printed sheet was drawn for, if it
///                            # is another one in the same frame
/// ```
///
/// Without `stable_pose` and `t_world_object`, the pose is that on the printed sheet, else the
/// stable pose nearest to the mesh's orientation, else the most probable one.
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
    /// What is done about defects of the mesh: `none`, `auto` (default), `strict`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub repair: Option<String>,
    /// Wall that an open surface gets, mm.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub wall_thickness_mm: Option<f64>,
    /// Hash of the simulated mesh in metres; a changed mesh is refused.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub mesh_sha256: Option<String>,
    /// Mass, kg.
    pub mass_kg: f64,
    /// Number of its stable pose; the most probable is 0.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub stable_pose: Option<usize>,
    /// Pose on the ground z = 0, z up.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub t_world_object: Option<Pose>,
    /// Hash of the mesh that the printed sheet was drawn for, if that is another mesh (for instance
    /// a finer one) in the same frame.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub drawn_from_sha256: Option<String>,
}

/// An object with its mesh, ready for simulation.
#[derive(Clone, Debug)]
pub struct ReplayObject {
    /// Its name in the dataset.
    pub name: ObjectName,
    /// Object file.
    pub file: ObjectFile,
    /// Path of the mesh file, or `builtin:NAME`.
    pub source: String,
    /// Unit of the mesh file.
    pub unit: LengthUnit,
    /// Closed mesh in its own frame, m.
    pub mesh: Arc<TriangleMesh>,
    /// Content hash of the mesh.
    pub mesh_sha256: String,
    /// Repairs of the mesh.
    pub warnings: Vec<String>,
}

fn one() -> f64 {
    1.0
}

impl ObjectFile {
    /// Writes the file.
    ///
    /// # Errors
    /// I/O errors.
    pub fn save(&self, path: &BeneathPath) -> Result<()> {
        let text = toml::to_string(self)
            .map_err(|e| Error::internal("cannot write the object file").because(e))?;
        path.replace(text.as_bytes())
            .map_err(|e| Error::io("cannot write the object file", e).at(path.display()))
    }

    fn mesh_options(&self, unit: LengthUnit) -> Result<MeshOptions> {
        let mut options = MeshOptions::new(unit, self.scale);
        if let Some(repair) = &self.repair {
            options.prepare.repair = repair.parse()?;
        }
        options.prepare.wall_thickness_m = self.wall_thickness_mm.map(|mm| 1e-3 * mm);
        Ok(options)
    }

    fn read(path: &BeneathPath) -> Result<Self> {
        let text = path
            .read_to_string(FileKind::Record)
            .map_err(|e| Error::io("cannot read the object file", e))?;
        let file: Self = toml::from_str(&text).map_err(|e| {
            Error::input("not an object file").because(e).remedy(
                "write schema = 1, mesh, unit, mass_kg, and stable_pose or t_world_object \
                     (docs/how-to/replay.md)",
            )
        })?;
        file.check()?;
        Ok(file)
    }

    fn check(&self) -> Result<()> {
        let invalid =
            |what: String, remedy: &str| Err(Error::input(what).remedy(remedy.to_owned()));
        if self.schema != SCHEMA {
            return invalid(
                format!(
                    "expected an object file of schema {SCHEMA}, found schema {}",
                    self.schema
                ),
                "use the version of gripcast that it was written for",
            );
        }
        if self.stable_pose.is_some() && self.t_world_object.is_some() {
            return invalid(
                "`stable_pose` and `t_world_object` exclude each other".to_owned(),
                "remove one of them",
            );
        }
        if self.unit.is_none() && !self.mesh.starts_with("builtin:") {
            return invalid(
                "`unit` is missing: mesh files do not define their unit".to_owned(),
                "write unit = \"mm\", \"cm\", \"m\" or \"in\"",
            );
        }
        Ok(())
    }
}

impl ReplayObject {
    /// Reads an object file and its mesh.
    ///
    /// # Errors
    /// Errors of reading the files; `Input` for an invalid mesh, a mesh outside of the folder, or
    /// one that does not match the hash.
    pub fn load(folder: &Root, path: &BeneathPath) -> Result<Self> {
        Self::read(folder, path).map_err(|e| e.at(path.display()))
    }

    fn read(folder: &Root, path: &BeneathPath) -> Result<Self> {
        let name = object_name(&path.name())?;
        let file = ObjectFile::read(path)?;
        let unit = file.unit.as_deref().unwrap_or("m").parse()?;
        let prepared = load_object_mesh_below(folder, &file.mesh, &file.mesh_options(unit)?)?;
        check_mass(file.mass_kg, &prepared.mesh.bounds())?;
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
                "restore the mesh, its unit and scale; or, if the new one is correct and in the same \
                 frame, update `mesh_sha256`",
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

    /// Returns the pose of the object on the ground; `sheet` is the printed sheet below it.
    ///
    /// # Errors
    /// `Input` if the sheet was drawn for another mesh, the object does not touch the ground, or
    /// the stable pose does not exist.
    pub fn t_world_object(&self, sheet: Option<&PrintedSheet>) -> Result<Pose> {
        if let Some(sheet) = sheet {
            self.check_sheet(sheet)?;
        }
        let pose = self.file.t_world_object;
        let pose = pose.or_else(|| match self.file.stable_pose {
            Some(_) => None,
            None => sheet.map(|sheet| sheet.t_world_object),
        });
        let Some(pose) = pose else {
            let (_, pose) = resting_pose(&self.mesh, self.file.stable_pose)?;
            return Ok(pose.t_world_object);
        };
        let points = self.mesh.all_corners().flatten();
        let lowest = Aabb::from_points(points.map(|v| pose.transform_point(v)))
            .min
            .z;
        if lowest.abs() > GROUND_TOLERANCE_M {
            return Err(Error::input(format!(
                "the lowest point of the object must be on the ground (z = 0), found it at \
                     {:.1} mm",
                1e3 * lowest
            ))
            .remedy("correct `t_world_object`, or use `stable_pose` instead"));
        }
        // Remove the gap or penetration that is left by rounding.
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
            "use the mesh, unit and scale that the sheet was drawn for; or, if this mesh is in the \
             same frame, set `drawn_from_sha256` to the sheet's hash",
        ))
    }
}

/// Loads all objects of a folder by name; each may fail.
///
/// # Errors
/// I/O errors of the folder; `NotFound` if it has no object file; `Input` for an invalid file name
/// or two files of one name.
pub fn load_objects(folder: &Path) -> Result<BTreeMap<ObjectName, Result<ReplayObject>>> {
    let root = Root::new(folder);
    let unreadable = |e| Error::io("cannot read the objects", e).at(folder.display());
    let mut objects = BTreeMap::new();
    for path in root.top().entries().map_err(unreadable)? {
        let file = path.name();
        // Skips hidden files of editors.
        if file.ends_with(SUFFIX) && !file.starts_with('.') {
            let name = object_name(&file).map_err(|e| e.at(folder.display()))?;
            if objects.contains_key(&name) {
                return Err(Error::input(format!(
                    "two object files of the same name `{name}`: they differ only in Unicode form \
                     or spaces"
                ))
                .at(folder.display())
                .remedy("rename or remove one of them"));
            }
            objects.insert(name, ReplayObject::load(&root, &path));
        }
    }
    if objects.is_empty() {
        return Err(Error::not_found("no object file found")
            .at(folder.display())
            .remedy("write NAME.toml for each object of the dataset (docs/how-to/replay.md)"));
    }
    Ok(objects)
}

/// Returns the object name of a file.
fn object_name(file: &str) -> Result<ObjectName> {
    ObjectName::parse(file.strip_suffix(SUFFIX).unwrap_or(file))
        .map_err(|e| e.remedy("rename the object file"))
}
