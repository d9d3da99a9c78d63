//! What a file of ACRONYM says.

use std::path::Path;

use glam::{DMat3, DVec3};

use super::transform::{AcronymGrasp, SkippedGrasp, gripper_pose};
use gripcast_base::error::{Error, ErrorKind, Result};
use gripcast_base::files::Root;
use gripcast_geometry::{LengthUnit, Prepared, load_object_mesh_below};
use gripcast_interop::hdf5::{Hdf5, wrong_shape};

/// Scales that are believed: coordinates of ShapeNetSem times the scale are metres, and objects are
/// centimetres to decimetres large. Those of ACRONYM are around 1e-4 to 1e-1.
const SCALES: [f64; 2] = [1e-7, 1e2];
/// Most grasps of a file; ACRONYM has 2000.
const MAX_GRASPS: u64 = 1_000_000;

const TRANSFORMS: &str = "grasps/transforms";
const HELD: &str = "grasps/qualities/flex/object_in_gripper";

/// An object of ACRONYM. What ACRONYM states of its mass holds for its own density of 150 kg/m³.
#[derive(Clone, Debug, PartialEq)]
pub struct AcronymObject {
    /// Mesh file relative to the root of the meshes, as `meshes/Mug/10f6….obj`.
    pub mesh_file: String,
    /// Category: the folder of the mesh file, as `Mug`.
    pub category: Option<String>,
    /// Factor that makes metres of the mesh file's coordinates.
    pub scale: f64,
    /// Mass, kg.
    pub mass_kg: Option<f64>,
    /// Centre of mass in the frame of the scaled mesh, m.
    pub com_m: Option<DVec3>,
    /// Moment of inertia, kg m².
    pub inertia_kg_m2: Option<DMat3>,
    /// Volume, m³.
    pub volume_m3: Option<f64>,
    /// Density, kg/m³.
    pub density_kg_m3: Option<f64>,
    /// Coefficient of friction of ACRONYM's simulation.
    pub friction: Option<f64>,
}

/// An object with its grasps.
#[derive(Clone, Debug, PartialEq)]
pub struct AcronymSet {
    /// Name of the file without its ending: different for each object and scale.
    pub name: String,
    /// The object.
    pub object: AcronymObject,
    /// Way of one finger from the middle when the hand is open, m; the opening is twice as wide.
    pub finger_opening_m: Option<f64>,
    /// Grasps in the order of the file, without those that were skipped.
    pub grasps: Vec<AcronymGrasp>,
    /// Grasps that cannot be used.
    pub skipped: Vec<SkippedGrasp>,
}

/// Reads a `.h5` file of ACRONYM.
///
/// Grasps whose matrix is no rigid motion are skipped and told. The facts of the object besides
/// its mesh and scale may be missing.
///
/// # Errors
/// Those of reading the file; `Input` for what is no HDF5, a missing key, a wrong shape, numbers
/// that are not finite, an absurd scale or mass, another gripper than the Panda, or a file without
/// any grasp that can be used.
pub fn read_acronym(path: &Path) -> Result<AcronymSet> {
    let read = || {
        let file = Hdf5::open(path, "ACRONYM")?;
        check_gripper(&file)?;
        let (grasps, skipped) = read_grasps(&file)?;
        Ok(AcronymSet {
            name: path
                .file_stem()
                .unwrap_or_default()
                .to_string_lossy()
                .into_owned(),
            object: read_object(&file)?,
            finger_opening_m: file.number("gripper/configuration")?,
            grasps,
            skipped,
        })
    };
    read().map_err(|e: Error| e.at(path.display()))
}

impl AcronymObject {
    /// The mesh in metres, fit for simulation; `meshes` is the folder that its path begins in.
    ///
    /// # Errors
    /// `Input` for a path that leads out of the folder; those of [`load_object_mesh_below`].
    pub fn load_mesh(&self, meshes: &Root) -> Result<Prepared> {
        load_object_mesh_below(meshes, &self.mesh_file, LengthUnit::Metre, self.scale).map_err(
            |e| match e.kind() {
                ErrorKind::NotFound => missing(&self.mesh_file, meshes),
                _ => e,
            },
        )
    }
}

fn missing(mesh_file: &str, meshes: &Root) -> Error {
    Error::not_found("the mesh of the grasps is missing")
        .at(mesh_file)
        .at(meshes.path().display())
        .remedy(
            "download the meshes of ShapeNetSem, make them watertight as ACRONYM's readme says, and \
             give the folder that has `meshes` in it",
        )
}

fn check_gripper(file: &Hdf5) -> Result<()> {
    match file.text("gripper/type")? {
        Some(other) if other != "panda" => Err(Error::input(format!(
            "the grasps are for the gripper {other:?}, known is \"panda\""
        ))
        .remedy("convert the grasps to poses of the Panda's hand")),
        _ => Ok(()),
    }
}

fn read_object(file: &Hdf5) -> Result<AcronymObject> {
    let mesh_file = file
        .text("object/file")?
        .ok_or_else(|| file.missing("object/file"))?;
    let scale = file
        .number("object/scale")?
        .ok_or_else(|| file.missing("object/scale"))?;
    let [low, high] = SCALES;
    if !(low..=high).contains(&scale) {
        return Err(Error::input(format!(
            "`object/scale` must be from {low:e} to {high:e}, found {scale:e}"
        )));
    }
    let positive = |key: &str| match file.number(key)? {
        Some(value) if value <= 0.0 => Err(Error::input(format!(
            "`{key}` must be above 0, found {value}"
        ))),
        value => Ok(value),
    };
    let folder = Path::new(&mesh_file).parent().and_then(Path::file_name);
    Ok(AcronymObject {
        category: folder.map(|f| f.to_string_lossy().into_owned()),
        scale,
        mass_kg: positive("object/mass")?,
        com_m: file.array::<3>("object/com")?.map(DVec3::from_array),
        inertia_kg_m2: file
            .array::<9>("object/inertia")?
            .map(|rows| DMat3::from_cols_array(&rows).transpose()),
        volume_m3: positive("object/volume")?,
        density_kg_m3: positive("object/density")?,
        friction: positive("object/friction")?,
        mesh_file,
    })
}

fn read_grasps(file: &Hdf5) -> Result<(Vec<AcronymGrasp>, Vec<SkippedGrasp>)> {
    let (shape, matrices) = file
        .numbers(TRANSFORMS)?
        .ok_or_else(|| file.missing(TRANSFORMS))?;
    match shape.as_slice() {
        &[count, 4, 4] if (1..=MAX_GRASPS).contains(&count) => {}
        _ => return Err(wrong_shape(TRANSFORMS, "[N, 4, 4] with N above 0", &shape)),
    }
    let (held_shape, held) = file.numbers(HELD)?.ok_or_else(|| file.missing(HELD))?;
    if held_shape != shape[..1] || 16 * held.len() != matrices.len() {
        return Err(wrong_shape(
            HELD,
            &format!("[{}] as the transforms", shape[0]),
            &held_shape,
        ));
    }
    let mut grasps = Vec::with_capacity(held.len());
    let mut skipped = Vec::new();
    for (number, (matrix, &held)) in matrices.chunks_exact(16).zip(&held).enumerate() {
        let known = held == 0.0 || held == 1.0;
        let pose = match gripper_pose(matrix) {
            Ok(_) if !known => Err(format!("its result is {held}, not 0 or 1")),
            pose => pose,
        };
        match pose {
            Ok(t_object_gripper) => grasps.push(AcronymGrasp {
                number,
                t_object_gripper,
                held: held == 1.0,
            }),
            Err(why) => skipped.push(SkippedGrasp { number, why }),
        }
    }
    if let ([], Some(SkippedGrasp { number, why })) = (grasps.as_slice(), skipped.first()) {
        return Err(Error::input(format!(
            "none of the {} grasps can be used; grasp {number}: {why}",
            skipped.len()
        )));
    }
    Ok((grasps, skipped))
}
