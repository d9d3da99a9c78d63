//! An object of a dataset: `OBJECTS/NAME.toml`.

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use glam::DVec3;
use serde::{Deserialize, Serialize};

use crate::error::{Error, ErrorKind, Result};
use crate::files::save;
use crate::geometry::{Aabb, LengthUnit, Pose, TriangleMesh, load_object_mesh};
use crate::pose::PrintedSheet;
use crate::sim::grasp::resting_pose;

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
/// mesh = "b1.obj"            # relative to this file, or builtin:NAME
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
    /// Mesh file, relative to the object file, or `builtin:NAME`.
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
    pub name: String,
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
    /// What was mended in the mesh.
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
    pub fn save(&self, path: &Path) -> Result<()> {
        let text = toml::to_string(self).map_err(|e| {
            Error::new(ErrorKind::Internal, "cannot write the object file").because(e)
        })?;
        save(path, text.as_bytes())
    }

    fn read(path: &Path) -> Result<Self> {
        let text = fs::read_to_string(path).map_err(|e| Error::io("cannot read the object", e))?;
        let file: Self = toml::from_str(&text).map_err(|e| {
            Error::new(ErrorKind::Input, "this is no object file")
                .because(e)
                .remedy(
                    "write schema = 1, mesh, unit, mass_kg, and stable_pose or t_world_object \
                     (docs/replay.md)",
                )
        })?;
        file.check()?;
        Ok(file)
    }

    fn check(&self) -> Result<()> {
        let wrong = |what: String, remedy: &str| {
            Err(Error::new(ErrorKind::Input, what).remedy(remedy.to_owned()))
        };
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
    /// Reads an object file and its mesh.
    ///
    /// # Errors
    /// Those of reading the files; `Input` for what cannot be simulated or a mesh that is another
    /// one than the file says.
    pub fn load(path: &Path) -> Result<Self> {
        Self::read(path).map_err(|e| e.at(path.display()))
    }

    fn read(path: &Path) -> Result<Self> {
        let file = ObjectFile::read(path)?;
        let name = path.file_stem().unwrap_or_default().to_string_lossy();
        let unit = file.unit.as_deref().unwrap_or("m").parse()?;
        let source = if file.mesh.starts_with("builtin:") {
            file.mesh.clone()
        } else {
            let folder = path.parent().unwrap_or(Path::new(""));
            folder.join(&file.mesh).to_string_lossy().into_owned()
        };
        let prepared = load_object_mesh(&source, unit, file.scale)?;
        let mesh_sha256 = prepared.mesh.content_hash();
        if let Some(expected) = &file.mesh_sha256
            && *expected != mesh_sha256
        {
            return Err(Error::new(
                ErrorKind::Input,
                format!("the mesh changed: expected {expected}, found {mesh_sha256}"),
            )
            .remedy(
                "restore the mesh, its unit and scale; or, if the new one is right and in the same \
                 frame, write its hash into `mesh_sha256`",
            ));
        }
        Ok(Self {
            name: name.into_owned(),
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
            return Err(Error::new(
                ErrorKind::Input,
                format!(
                    "the lowest point of the object must lie on the ground (z = 0), found it at \
                     {:.1} mm",
                    1e3 * lowest
                ),
            )
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
        Err(Error::new(
            ErrorKind::Input,
            format!(
                "the printed sheet was drawn for another mesh ({}, {drawn}) than {} ({}): shape, \
                 unit, scale or frame may differ",
                sheet.object, self.source, self.mesh_sha256
            ),
        )
        .remedy(
            "give the mesh, unit and scale that the sheet was drawn for; or, if this one is in the \
             same frame, write the sheet's hash into `drawn_from_sha256`",
        ))
    }
}

/// All objects of a folder by name, or why one cannot be used.
///
/// # Errors
/// That of the operating system if the folder cannot be read; `NotFound` if it has no object file.
pub fn load_objects(folder: &Path) -> Result<BTreeMap<String, Result<ReplayObject>>> {
    let unreadable = |e| Error::io("cannot read the objects", e).at(folder.display());
    let mut paths: Vec<PathBuf> = Vec::new();
    for entry in fs::read_dir(folder).map_err(unreadable)? {
        let path = entry.map_err(unreadable)?.path();
        if path.extension().is_some_and(|suffix| suffix == "toml") {
            paths.push(path);
        }
    }
    if paths.is_empty() {
        return Err(Error::new(ErrorKind::NotFound, "there is no object file")
            .at(folder.display())
            .remedy("write NAME.toml for each object of the dataset (docs/replay.md)"));
    }
    let named = paths.iter().map(|path| {
        let name = path
            .file_stem()
            .unwrap_or_default()
            .to_string_lossy()
            .into_owned();
        (name, ReplayObject::load(path))
    });
    Ok(named.collect())
}
