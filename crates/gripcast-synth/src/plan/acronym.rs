//! Drafts from ACRONYM's objects and grasps.

use std::path::Path;

use super::{Drafts, MeshSource, ObjectDraft};
use crate::acronym::read_acronym;
use crate::family::Category;
use crate::properties::Material;
use gripcast_base::error::{Error, Result};
use gripcast_base::files::{BeneathPath, FileKind, Root, SimulationId};
use gripcast_base::random::SeedStream;

/// Suffix of ACRONYM's files.
const SUFFIX: &str = ".h5";
/// Materials of objects whose category is not a built-in one.
const MATERIALS: [&str; 6] = ["abs", "wood", "polypropylene", "steel", "ceramic", "rubber"];

/// Reads a folder of ACRONYM's `.h5` files: objects with their grasps, at most `max` of them drawn
/// by the seed. Meshes are below `mesh_root`. Files that cannot be read are left out.
///
/// # Errors
/// Errors of reading the folder; `Input` for one without `.h5` files.
pub fn acronym_drafts(
    folder: &Path,
    mesh_root: &Path,
    max: Option<usize>,
    seed: u64,
) -> Result<Drafts> {
    let mut files = h5_files(folder)?;
    if let Some(max) = max {
        files.sort_by_key(|file| SeedStream::named(seed, &stem(file)).bits());
        files.truncate(max);
        files.sort_by_key(BeneathPath::name);
    }
    let meshes = Root::new(mesh_root);
    let mut drafts = Drafts::default();
    for file in files {
        drafts.push(&stem(&file), draft(&file, &meshes, seed))?;
    }
    Ok(drafts)
}

fn stem(file: &BeneathPath) -> String {
    let name = file.name();
    name.strip_suffix(SUFFIX).unwrap_or(&name).to_owned()
}

fn h5_files(folder: &Path) -> Result<Vec<BeneathPath>> {
    let mut files = Root::new(folder)
        .top()
        .entries()
        .map_err(|e| Error::io("cannot read the folder with grasps", e).at(folder.display()))?;
    files.retain(|file| file.name().ends_with(SUFFIX));
    if files.is_empty() {
        return Err(Error::input("the folder has no .h5 files")
            .at(folder.display())
            .remedy("name ACRONYM's folder `grasps`"));
    }
    Ok(files)
}

fn draft(file: &BeneathPath, meshes: &Root, seed: u64) -> Result<ObjectDraft> {
    // Refuses links that lead out of the folder, and directories.
    file.open_file(FileKind::Bulk)
        .map_err(|e| Error::io("cannot read the file", e).at(file.display()))?;
    let set = read_acronym(&file.shown())?;
    let name = SimulationId::parse(&set.name)?;
    let mesh = set.object.load_mesh(meshes)?.mesh;
    let category = match &set.object.category {
        Some(category) => category.to_lowercase(),
        None => "thing".to_owned(),
    };
    let mut draw = SeedStream::named(seed, &format!("material {}", set.name));
    let materials = Category::parse(&category).map(Category::materials);
    let materials = materials.unwrap_or(MATERIALS.to_vec());
    let material = materials[draw.index(materials.len())];
    Ok(ObjectDraft {
        source: MeshSource::stored(&name)?,
        name,
        category,
        mesh,
        material: Material::named(material)?,
        // ACRONYM gives masses for one density, and the friction of its own simulator.
        fill: None,
        mass_kg: None,
        friction: None,
        appearances: Vec::new(),
        textures: Vec::new(),
        grasps: Some(set.grasps),
    })
}

#[cfg(test)]
mod tests {
    use std::fs;

    use hdf5_pure::{FileBuilder, GroupBuilder};

    use super::*;
    use gripcast_geometry::{builtin, save_mesh};

    /// A file with two grasps of a mesh: from above, and offset by 10 mm.
    fn h5(mesh: &str) -> Vec<u8> {
        #[rustfmt::skip]
        let matrix = |x: f64| [
            1.0, 0.0, 0.0, x,
            0.0, -1.0, 0.0, 0.0,
            0.0, 0.0, -1.0, 0.12,
            0.0, 0.0, 0.0, 1.0,
        ];
        let mut file = FileBuilder::new();
        let scalar = |group: &mut GroupBuilder, key, value| {
            let data = group.create_dataset(key);
            data.with_f64_data(&[value]).with_shape(&[]);
        };
        let mut object = file.create_group("object");
        object
            .create_dataset("file")
            .with_vlen_strings(&[mesh])
            .with_shape(&[]);
        scalar(&mut object, "scale", 0.5);
        file.add_group(object.finish());
        let mut gripper = file.create_group("gripper");
        scalar(&mut gripper, "configuration", 0.04);
        file.add_group(gripper.finish());
        let mut grasps = file.create_group("grasps");
        grasps
            .create_dataset("transforms")
            .with_f64_data(&[matrix(0.0), matrix(0.01)].concat())
            .with_shape(&[2, 4, 4]);
        let mut qualities = grasps.create_group("qualities");
        let mut flex = qualities.create_group("flex");
        flex.create_dataset("object_in_gripper")
            .with_i64_data(&[1, 0]);
        qualities.add_group(flex.finish());
        grasps.add_group(qualities.finish());
        file.add_group(grasps.finish());
        file.finish().unwrap()
    }

    #[test]
    fn objects_have_scale_category_and_grasps() {
        let folder = tempfile::tempdir().unwrap();
        let at = |name: &str| folder.path().join(name);
        fs::create_dir_all(at("meshes/Box")).unwrap();
        fs::create_dir(at("grasps")).unwrap();
        let mesh = builtin("box").unwrap();
        save_mesh(&at("meshes/Box/a.obj"), &mesh.scaled(2.0)).unwrap();
        for (name, mesh) in [("Box_a", "meshes/Box/a.obj"), ("Box_b", "meshes/Box/b.obj")] {
            fs::write(at("grasps").join(format!("{name}_0.5.h5")), h5(mesh)).unwrap();
        }
        fs::write(at("grasps/broken.h5"), "no hdf5").unwrap();
        let read = |most| acronym_drafts(&at("grasps"), folder.path(), most, 1);
        let found = read(None).unwrap();
        let [object] = found.drafts.as_slice() else {
            panic!("one object, found {:?}", found.left_out);
        };
        assert_eq!(
            (object.name.as_str(), object.category.as_str()),
            ("Box_a_0.5", "box")
        );
        let materials = Category::parse("box").unwrap().materials();
        assert!(materials.contains(&&*object.material.name));
        let grasps = object.grasps.as_ref().unwrap().iter();
        let grasps: Vec<_> = grasps.map(|grasp| (grasp.number, grasp.stable)).collect();
        assert_eq!(grasps, [(0, true), (1, false)]);
        let sizes = [&object.mesh, &mesh].map(|mesh| mesh.bounds().extent());
        assert!((sizes[0] - sizes[1]).length() < 1e-6, "{sizes:?}");
        let names: Vec<&str> = found.left_out.iter().map(|l| l.name.as_str()).collect();
        assert_eq!(names, ["Box_b_0.5", "broken"]);
        assert!(found.left_out[0].reason.contains("b.obj"));
        let one = read(Some(1)).unwrap();
        assert_eq!(one.drafts.len() + one.left_out.len(), 1);
        let error = acronym_drafts(&at("meshes"), folder.path(), None, 1);
        assert!(error.unwrap_err().to_string().contains(".h5"));
    }
}
