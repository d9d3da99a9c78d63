//! Objects and grasps of ACRONYM.

use std::fs;
use std::path::{Path, PathBuf};

use super::draft::stored_path;
use super::{Drafts, MeshSource, ObjectDraft};
use crate::error::{Error, ErrorKind, Result};
use crate::render::visual::SeedStream;
use crate::synth::acronym::read_acronym;
use crate::synth::family::Category;
use crate::synth::properties::Material;

/// What things are of whose category says nothing about it.
const MATERIALS: [&str; 6] = ["abs", "wood", "polypropylene", "steel", "ceramic", "rubber"];

/// The objects of a folder of ACRONYM's `.h5` files, with their grasps; `most` of them, drawn by
/// the seed. Meshes are below `mesh_root`. What cannot be read is left out.
///
/// # Errors
/// Those of reading the folder; `Input` for one without `.h5` files.
pub fn acronym_drafts(
    folder: &Path,
    mesh_root: &Path,
    plan_folder: &Path,
    most: Option<usize>,
    seed: u64,
) -> Result<Drafts> {
    let mut files = h5_files(folder)?;
    if let Some(most) = most {
        files.sort_by_key(|file| SeedStream::named(seed, &stem(file)).bits());
        files.truncate(most);
        files.sort();
    }
    let mut drafts = Drafts::default();
    for file in files {
        drafts.note(&stem(&file), draft(&file, mesh_root, plan_folder, seed))?;
    }
    Ok(drafts)
}

fn stem(file: &Path) -> String {
    let stem = file.file_stem().unwrap_or_default();
    stem.to_string_lossy().into_owned()
}

fn h5_files(folder: &Path) -> Result<Vec<PathBuf>> {
    let cannot = |e| Error::io("cannot read the folder of grasps", e).at(folder.display());
    let mut files = Vec::new();
    for entry in fs::read_dir(folder).map_err(cannot)? {
        let path = entry.map_err(cannot)?.path();
        if path.extension().is_some_and(|ending| ending == "h5") {
            files.push(path);
        }
    }
    if files.is_empty() {
        return Err(Error::new(ErrorKind::Input, "the folder has no .h5 files")
            .at(folder.display())
            .remedy("give the folder `grasps` of ACRONYM"));
    }
    files.sort();
    Ok(files)
}

fn draft(file: &Path, mesh_root: &Path, plan_folder: &Path, seed: u64) -> Result<ObjectDraft> {
    let set = read_acronym(file)?;
    let mesh = set.object.load_mesh(mesh_root)?.mesh;
    let mesh_path = set.object.mesh_path(mesh_root)?;
    let category = match &set.object.category {
        Some(category) => category.to_lowercase(),
        None => "thing".to_owned(),
    };
    let mut draw = SeedStream::named(seed, &format!("material {}", set.name));
    let known = Category::parse(&category).map(Category::materials);
    let materials = known.unwrap_or(&MATERIALS);
    let material = materials[draw.index(materials.len())];
    Ok(ObjectDraft {
        name: set.name,
        category,
        source: MeshSource::File {
            path: stored_path(&mesh_path, plan_folder)?,
            unit: "m".to_owned(),
            scale: set.object.scale,
        },
        mesh,
        material: Material::named(material)?,
        // ACRONYM states masses for one density, and friction of its own simulator.
        fill: None,
        mass_kg: None,
        friction: None,
        looks: Vec::new(),
        textures: Vec::new(),
        grasps: Some(set.grasps.iter().map(|g| g.t_object_gripper).collect()),
    })
}
