//! Real domes, textures and meshes for visual images.

use std::fs;
use std::path::{Path, PathBuf};

use gripcast_geometry::LengthUnit;
use gripcast_visual::{
    Colour, Finish, Model, ProceduralTexture, load_bitmap, load_hdr, white_table_luminance,
};

use gripcast_testing::shared;

/// Files of a folder with a suffix, sorted.
fn files(folder: &Path, suffix: &str) -> Vec<PathBuf> {
    let all = fs::read_dir(folder).unwrap().map(|e| e.unwrap().path());
    let mut found: Vec<_> = all
        .filter(|path| path.extension().is_some_and(|e| e == suffix))
        .collect();
    found.sort();
    found
}

#[test]
fn reads_environment_maps_of_poly_haven() {
    let Some(folder) = shared("data/hdri_polyhaven_cc0") else {
        return;
    };
    let domes = files(&folder, "hdr");
    assert!(domes.len() >= 6);
    for path in domes {
        let dome = load_hdr(&path).unwrap();
        assert_eq!((dome.width, dome.height), (1024, 512), "{}", path.display());
        let table = white_table_luminance(&dome);
        assert!((0.05..50.0).contains(&table), "{}: {table}", path.display());
    }
}

#[test]
fn reads_textures_of_poly_haven() {
    let Some(folder) = shared("data/textures_polyhaven_cc0") else {
        return;
    };
    for path in files(&folder, "jpg") {
        let [width, height] = load_bitmap(&path).unwrap().size();
        assert!(width >= 512 && height >= 512, "{}", path.display());
    }
}

#[test]
fn missing_texture_renders_grey_with_warning() {
    let Some(path) = shared("data/ycb_drake/004_sugar_box_textured.obj") else {
        return;
    };
    let finish = Finish::Textured(ProceduralTexture::Plastic);
    let loaded = Model::load(&path, LengthUnit::Metre, finish, 0).unwrap();
    let text = loaded.warnings.join("\n");
    assert!(text.contains("004_sugar_box_textured.png"), "{text}");
    let mesh = &loaded.model.meshes[0];
    assert_eq!(mesh.triangles.len(), 16_384);
    assert_eq!(mesh.normals.len(), mesh.positions.len());
    let colour = loaded.model.materials[0].colour();
    assert_eq!(colour, Some(Colour::Constant([0.5; 3])));
}
