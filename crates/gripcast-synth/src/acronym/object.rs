//! Reads ACRONYM's files.

use std::path::Path;

use super::transform::{AcronymGrasp, SkippedGrasp, gripper_pose};
use gripcast_base::error::{Error, ErrorKind, Result};
use gripcast_base::files::Root;
use gripcast_geometry::{LengthUnit, MeshOptions, PreparedMesh, load_object_mesh_below};
use gripcast_interop::hdf5::{Hdf5, wrong_shape};

/// Plausible scales: coordinates of ShapeNetSem times the scale are metres, and objects are
/// centimetres to decimetres large. ACRONYM's scales are around 1e-4 to 1e-1.
const SCALES: [f64; 2] = [1e-7, 1e2];
/// Maximum grasps of a file; ACRONYM has 2000.
const MAX_GRASPS: u64 = 1_000_000;

const TRANSFORMS: &str = "grasps/transforms";
const RESULTS: &str = "grasps/qualities/flex/object_in_gripper";

/// An object of ACRONYM. Its mass and friction, which are those of ACRONYM's own simulator, are not
/// read.
#[derive(Clone, Debug, PartialEq)]
pub struct AcronymObject {
    /// Mesh file relative to the root of the meshes, for instance `meshes/Mug/10f6….obj`.
    pub mesh_file: String,
    /// Category: the folder of the mesh file, for instance `Mug`.
    pub category: Option<String>,
    /// Factor from the mesh file's coordinates to metres.
    pub scale: f64,
}

/// An object with its grasps.
#[derive(Clone, Debug, PartialEq)]
pub struct AcronymSet {
    /// Name of the file without its suffix: unique for each object and scale.
    pub name: String,
    /// The object.
    pub object: AcronymObject,
    /// Usable grasps in the order of the file.
    pub grasps: Vec<AcronymGrasp>,
    /// Grasps that cannot be used.
    pub skipped: Vec<SkippedGrasp>,
}

/// Reads a `.h5` file of ACRONYM.
///
/// Grasps whose matrix is not a rigid transform are skipped and listed.
///
/// # Errors
/// Errors of reading the file; `Input` for an invalid HDF5 file, a missing key, an unexpected
/// shape, numbers that are not finite, an implausible scale, another gripper than the Panda, or a
/// file without usable grasps.
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
            grasps,
            skipped,
        })
    };
    read().map_err(|e: Error| e.at(path.display()))
}

impl AcronymObject {
    /// Loads the mesh in metres, ready for simulation; `meshes` is the root of its path.
    ///
    /// # Errors
    /// `Input` for a path that leads out of the root; errors of [`load_object_mesh_below`].
    pub fn load_mesh(&self, meshes: &Root) -> Result<PreparedMesh> {
        let options = MeshOptions::new(LengthUnit::Metre, self.scale);
        load_object_mesh_below(meshes, &self.mesh_file, &options).map_err(|e| match e.kind() {
            ErrorKind::NotFound => missing(&self.mesh_file, meshes),
            _ if e
                .remedy_text()
                .is_some_and(|remedy| remedy.contains("scale")) =>
            {
                e.replace_remedy(format!(
                    "the mesh's coordinates times `object/scale` ({}) must be metres: correct it \
                     in the .h5 file, for a mesh in millimetres to 0.001",
                    self.scale
                ))
            }
            _ => e,
        })
    }
}

fn missing(mesh_file: &str, meshes: &Root) -> Error {
    Error::not_found("the mesh of the grasps is missing")
        .at(mesh_file)
        .at(meshes.path().display())
        .remedy(
            "download the meshes of ShapeNetSem, make them watertight as ACRONYM's readme says, and \
             name the folder that contains `meshes`",
        )
}

fn check_gripper(file: &Hdf5) -> Result<()> {
    match file.text("gripper/type")? {
        Some(other) if other != "panda" => Err(Error::input(format!(
            "expected grasps of the gripper \"panda\", found {other:?}"
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
    let folder = Path::new(&mesh_file).parent().and_then(Path::file_name);
    Ok(AcronymObject {
        category: folder.map(|f| f.to_string_lossy().into_owned()),
        scale,
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
    let (results_shape, results) = file
        .numbers(RESULTS)?
        .ok_or_else(|| file.missing(RESULTS))?;
    if results_shape != shape[..1] || 16 * results.len() != matrices.len() {
        return Err(wrong_shape(
            RESULTS,
            &format!("[{}] as the transforms", shape[0]),
            &results_shape,
        ));
    }
    let mut grasps = Vec::with_capacity(results.len());
    let mut skipped = Vec::new();
    for (number, (matrix, &result)) in matrices.chunks_exact(16).zip(&results).enumerate() {
        let pose = match gripper_pose(matrix) {
            Ok(_) if result != 0.0 && result != 1.0 => {
                Err(format!("its result is {result}, not 0 or 1"))
            }
            pose => pose,
        };
        match pose {
            Ok(t_object_gripper) => grasps.push(AcronymGrasp {
                number,
                t_object_gripper,
                stable: result == 1.0,
            }),
            Err(reason) => skipped.push(SkippedGrasp { number, reason }),
        }
    }
    if let ([], Some(SkippedGrasp { number, reason })) = (grasps.as_slice(), skipped.first()) {
        return Err(Error::input(format!(
            "none of the {} grasps can be used; grasp {number}: {reason}",
            skipped.len()
        )));
    }
    Ok((grasps, skipped))
}
