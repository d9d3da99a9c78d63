//! Objects of the demo data.

use std::path::Path;

use super::plan::DemoSettings;
use crate::ObjectFile;
use gripcast_base::error::{Error, Result};
use gripcast_base::files::{BeneathPath, FileKind, FileName, read_regular};
use gripcast_base::random::SeedStream;
use gripcast_geometry::{
    LengthUnit, MeshFormat, Pose, PrepareOptions, TriangleMesh, builtin, likely_poses, prepare,
    read_mesh,
};

/// Built-in shapes.
const SHAPES: [&str; 5] = ["jack", "star", "dented", "saddle", "lump"];
/// Shapes of EGAD's evaluation set (Morrison et al., RA-L 2020), and their folder below the shared
/// data.
const EGAD: [&str; 4] = ["B1", "B4", "C2", "C4"];
const EGAD_FOLDER: &str = "data/egad_eval";
/// Scale of EGAD's meshes, which are 70 mm long: fits between the fingers in most poses.
const EGAD_SCALE: f64 = 0.6;
/// Built-in shape in addition to those of EGAD.
const EXTRA_SHAPE: &str = "ring";
/// Friction coefficient from a handbook, and the maximum relative deviation of the real one.
const NOMINAL_FRICTION: f64 = 0.4;
const FRICTION_SPREAD: f64 = 0.1;
/// Range of masses, kg.
const MASS_KG: [f64; 2] = [0.040, 0.080];
/// Minimum rotation that a pose withstands, rad, and its minimum probability.
const MIN_TIP_RAD: f64 = 0.05;
const MIN_PROBABILITY: f64 = 0.04;

/// An object with its true properties.
#[derive(Clone, Debug)]
pub(super) struct DemoObject {
    /// Name in the dataset.
    pub(super) name: String,
    /// `builtin:NAME` or a file name.
    pub(super) source: String,
    /// Contents of the mesh file; none for a built-in shape.
    pub(super) file: Option<Vec<u8>>,
    /// Scale factor.
    pub(super) scale: f64,
    /// Mesh, m.
    pub(super) mesh: TriangleMesh,
    /// Mass, kg.
    pub(super) mass_kg: f64,
    /// True friction coefficient between gel and object.
    pub(super) friction: f64,
    /// Pose on the ground.
    pub(super) t_world_object: Pose,
}

/// Creates the five objects.
///
/// # Errors
/// `Input` or `Io` for an invalid file of EGAD.
pub(super) fn objects(settings: &DemoSettings) -> Result<Vec<DemoObject>> {
    let folder = settings.shared.as_ref().map(|root| root.join(EGAD_FOLDER));
    let egad = folder.filter(|folder| {
        let exists = |name: &str| folder.join(format!("{name}.obj")).is_file();
        !settings.quick && EGAD.iter().all(|name| exists(name))
    });
    let shape =
        |name: &str| DemoObject::new(name, format!("builtin:{name}"), None, 1.0, settings.seed);
    match egad {
        None => SHAPES.into_iter().map(shape).collect(),
        Some(folder) => {
            let of_file = |name: &str| from_file(&folder, name, settings.seed);
            let files = EGAD.into_iter().map(of_file);
            files.chain([shape(EXTRA_SHAPE)]).collect()
        }
    }
}

fn from_file(folder: &Path, name: &str, seed: u64) -> Result<DemoObject> {
    let path = folder.join(format!("{name}.obj"));
    let bytes = read_regular(&path, FileKind::Mesh)
        .map_err(|e| Error::io("cannot read the mesh", e).at(path.display()))?;
    let name = name.to_lowercase();
    DemoObject::new(&name, format!("{name}.obj"), Some(bytes), EGAD_SCALE, seed)
        .map_err(|e| e.at(path.display()))
}

/// EGAD's meshes have no companion files.
fn no_companion(_: &str) -> std::io::Result<Vec<u8>> {
    Err(std::io::ErrorKind::NotFound.into())
}

impl DemoObject {
    fn new(
        name: &str,
        source: String,
        file: Option<Vec<u8>>,
        scale: f64,
        seed: u64,
    ) -> Result<Self> {
        let raw = match &file {
            None => builtin(&source)?,
            Some(bytes) => read_mesh(bytes, MeshFormat::Obj, &no_companion)?
                .scaled(LengthUnit::Millimetre.in_metres()),
        };
        let mesh = prepare(&raw.scaled(scale), &PrepareOptions::default())?.mesh;
        let mut draw = SeedStream::named(seed, &format!("object {name}"));
        let spread = draw.between(-FRICTION_SPREAD, FRICTION_SPREAD);
        let mass_g = 1e3 * draw.between(MASS_KG[0], MASS_KG[1]);
        let poses = likely_poses(&mesh, MIN_TIP_RAD, MIN_PROBABILITY)?;
        let t_world_object = poses[draw.index(poses.len())].t_world_object;
        Ok(Self {
            name: name.to_owned(),
            source,
            file,
            scale,
            mesh,
            mass_kg: 1e-3 * mass_g.round(),
            friction: NOMINAL_FRICTION * (1.0 + spread),
            t_world_object,
        })
    }

    /// Writes the object file `NAME.toml` with the known properties, and the mesh file.
    ///
    /// # Errors
    /// I/O errors.
    pub(super) fn save(&self, folder: &BeneathPath) -> Result<()> {
        if let Some(bytes) = &self.file {
            let path = folder.join(&FileName::parse(&self.source)?);
            path.replace(bytes)
                .map_err(|e| Error::io("cannot write the mesh", e).at(path.display()))?;
        }
        let unit = self
            .file
            .is_some()
            .then(|| LengthUnit::Millimetre.to_string());
        let file = ObjectFile {
            schema: 1,
            mesh: self.source.clone(),
            unit,
            scale: self.scale,
            repair: None,
            wall_thickness_mm: None,
            mesh_sha256: Some(self.mesh.content_hash()),
            mass_kg: self.mass_kg,
            stable_pose: None,
            t_world_object: Some(self.t_world_object),
            drawn_from_sha256: None,
        };
        file.save(&folder.join(&FileName::parse(&format!("{}.toml", self.name))?))
    }
}

#[cfg(test)]
mod tests {
    use std::fs;

    use super::*;
    use gripcast_base::files::Root;

    fn settings(seed: u64) -> DemoSettings {
        DemoSettings {
            seed,
            quick: true,
            shared: None,
            jobs: 1,
        }
    }

    #[test]
    fn objects_are_on_the_ground_and_within_ranges() {
        let all = objects(&settings(0)).unwrap();
        assert_eq!(all.len(), 5);
        for object in &all {
            assert!((0.04..=0.08).contains(&object.mass_kg), "{}", object.name);
            assert!((0.36..=0.44).contains(&object.friction), "{}", object.name);
            let min_z = object
                .mesh
                .transformed(&object.t_world_object)
                .bounds()
                .min
                .z;
            assert!(min_z.abs() < 1e-9, "{}: {min_z}", object.name);
        }
        let again = objects(&settings(0)).unwrap();
        assert!(
            all.iter()
                .zip(&again)
                .all(|(a, b)| a.friction == b.friction)
        );
        let other = objects(&settings(1)).unwrap();
        assert!(
            all.iter()
                .zip(&other)
                .any(|(a, b)| a.friction != b.friction)
        );
    }

    #[test]
    fn object_file_omits_the_friction() {
        let folder = tempfile::tempdir().unwrap();
        let object = &objects(&settings(3)).unwrap()[0];
        object.save(&Root::new(folder.path()).top()).unwrap();
        let text = fs::read_to_string(folder.path().join("jack.toml")).unwrap();
        let file: ObjectFile = toml::from_str(&text).unwrap();
        assert_eq!(file.mesh, "builtin:jack");
        assert_eq!(file.mesh_sha256, Some(object.mesh.content_hash()));
        assert_eq!(file.t_world_object, Some(object.t_world_object));
        assert!(!text.contains("friction"));
    }

    #[test]
    fn egad_shapes_are_used_if_present() {
        let Some(folder) = gripcast_testing::shared("data/egad_eval") else {
            return;
        };
        let settings = DemoSettings {
            quick: false,
            shared: folder.ancestors().nth(2).map(Path::to_owned),
            ..settings(0)
        };
        let all = objects(&settings).unwrap();
        let names: Vec<&str> = all.iter().map(|object| object.name.as_str()).collect();
        assert_eq!(names, ["b1", "b4", "c2", "c4", "ring"]);
        let longest = |object: &DemoObject| object.mesh.bounds().extent().max_element();
        assert!(all[..4].iter().all(|o| (longest(o) - 0.042).abs() < 1e-6));
    }
}
