use super::*;
use crate::procedural::ProceduralTexture;
use gripcast_geometry::{MeshFormat, builtin, read_textured_mesh};
use gripcast_imaging::encode_png_rgb;
use image::RgbImage;
use std::io;

const PLASTIC: Finish = Finish::Textured(ProceduralTexture::Plastic);

fn no_file(_: &str) -> io::Result<Vec<u8>> {
    Err(io::ErrorKind::NotFound.into())
}

const SQUARE: &str = "mtllib a.mtl\nv 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\n\
                      vt 0 0\nvt 1 0\nvt 1 1\nvt 0 1\nusemtl paint\nf 1/1 2/2 3/3 4/4\n";

fn read(obj: &str, files: &[(&str, Vec<u8>)]) -> LoadedModel {
    let beside = |name: &str| {
        let found = files.iter().find(|(known, _)| *known == name);
        found.map_or_else(|| no_file(name), |(_, bytes)| Ok(bytes.clone()))
    };
    let mesh = read_textured_mesh(obj.as_bytes(), MeshFormat::Obj, &beside).unwrap();
    Model::from_textured(&mesh, &beside, PLASTIC, 1).unwrap()
}

fn red_top() -> Vec<u8> {
    let image = RgbImage::from_fn(2, 2, |_, y| {
        image::Rgb([if y == 0 { 255 } else { 0 }, 0, 0])
    });
    encode_png_rgb(&image).unwrap()
}

#[test]
fn textured_square_shows_its_image_upright() {
    let mtl = b"newmtl paint\nmap_Kd top.png\n".to_vec();
    let loaded = read(SQUARE, &[("a.mtl", mtl), ("top.png", red_top())]);
    assert!(loaded.warnings.is_empty(), "{:?}", loaded.warnings);
    let model = loaded.model;
    let mesh = &model.meshes[0];
    let upper = mesh.positions.iter().position(|p| p.y == 1.0).unwrap();
    // v of the upper edge is 0: the red row is at the top.
    assert_eq!(mesh.uvs[upper][1], 0.0);
    assert!(model.textures[0].sample([0.5, 0.25])[0] > 0.9);
    assert!(mesh.normals.iter().all(|n| n.z > 0.99));
}

#[test]
fn image_is_placed_by_the_material() {
    let mtl = b"newmtl paint\nmap_Kd -s 3 2 -o 0 0.25 top.png\n".to_vec();
    let loaded = read(SQUARE, &[("a.mtl", mtl), ("top.png", red_top())]);
    let mesh = &loaded.model.meshes[0];
    for (position, uv) in mesh.positions.iter().zip(&mesh.uvs) {
        assert_eq!(*uv, [3.0 * position.x, 1.0 - (2.0 * position.y + 0.25)]);
    }
}

#[test]
fn missing_texture_leaves_the_colour_of_the_material() {
    let mtl = b"newmtl paint\nKd 0.5 0.25 0\nmap_Kd gone.png\n".to_vec();
    let loaded = read(SQUARE, &[("a.mtl", mtl)]);
    assert!(matches!(
        loaded.model.materials[0],
        Material::Principled { base_colour: Colour::Constant(colour), .. }
        if colour == [0.5, 0.25, 0.0]
    ));
}

#[test]
fn missing_texture_becomes_grey_with_warning() {
    let mtl = b"newmtl paint\nmap_Kd gone.png\n".to_vec();
    for (files, expected) in [
        (vec![], "a.mtl"),
        (vec![("a.mtl", mtl.clone())], "gone.png"),
        (
            vec![("a.mtl", mtl), ("gone.png", b"no image".to_vec())],
            "PNG or JPEG",
        ),
        (vec![("a.mtl", b"newmtl other\n".to_vec())], "paint"),
        (vec![("a.mtl", b"\x00\x01".to_vec())], "no material"),
    ] {
        let loaded = read(SQUARE, &files);
        let text = loaded.warnings.join("\n");
        assert!(text.contains(expected), "{expected}: {text}");
        assert_eq!(loaded.model.meshes.len(), 1);
    }
}

#[test]
fn texture_without_coordinates_is_box_projected() {
    let obj = "mtllib a.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\nusemtl paint\nf 1 2 3\n";
    let mtl = b"newmtl paint\nmap_Kd top.png\n".to_vec();
    let loaded = read(obj, &[("a.mtl", mtl), ("top.png", red_top())]);
    assert!(
        loaded.warnings[0].contains("box-projected"),
        "{:?}",
        loaded.warnings
    );
    assert_eq!(loaded.model.meshes[0].uvs.len(), 3);
}

#[test]
fn glass_and_metal_are_recognised() {
    let obj = "mtllib a.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\nusemtl glass\nf 1 2 3\n\
               usemtl steel\nf 1 3 2\nusemtl lamp\nf 1 2 3\n";
    let mtl = "newmtl glass\nd 0.1\nNi 1.45\nKd 0 0 0\nnewmtl steel\nKd 0.3 0.3 0.3\nPm 1\n\
               Pr 0.3\nnewmtl lamp\nKe 1 1 1\n";
    let loaded = read(obj, &[("a.mtl", mtl.as_bytes().to_vec())]);
    let [glass, steel, _] = loaded.model.materials[..] else {
        panic!("{:?}", loaded.model.materials);
    };
    assert!(matches!(glass, Material::Dielectric { ior, .. } if ior == 1.45));
    assert!(
        matches!(steel, Material::Principled { metallic, roughness, .. }
        if metallic == 1.0 && roughness == 0.3)
    );
    let text = loaded.warnings.join("\n");
    assert!(
        text.contains("not closed") && text.contains("emission"),
        "{text}"
    );
}

#[test]
fn inside_out_mesh_is_flipped() {
    let mut shape = builtin("box").unwrap();
    shape.triangles.iter_mut().for_each(|t| t.swap(0, 1));
    let loaded = Model::from_textured(&shape.into(), &no_file, Finish::Glass, 0).unwrap();
    assert!(
        loaded.warnings[0].contains("inside out"),
        "{:?}",
        loaded.warnings
    );
    let mesh = &loaded.model.meshes[0];
    let turned = TriangleMesh {
        vertices: mesh.positions.iter().map(|p| p.as_dvec3()).collect(),
        triangles: mesh.triangles.clone(),
    };
    assert!(signed_volume(&turned.into()) > 0.0);
    let normal_out = |mesh: &Mesh| {
        let pairs = mesh.positions.iter().zip(&mesh.normals);
        pairs.map(|(p, n)| p.dot(*n)).sum::<f32>()
    };
    assert!(normal_out(&loaded.model.meshes[0]) > 0.0);
}

#[test]
fn scene_renumbers_materials_and_textures() {
    let shape = builtin("box").unwrap();
    let mut scene = Scene::empty(
        crate::EnvMap::uniform([1.0; 3]),
        crate::Camera::centred(8, 8, 1.0, Pose::IDENTITY),
    );
    for finish in [
        PLASTIC,
        Finish::Glass,
        Finish::Textured(ProceduralTexture::Wood),
    ] {
        let model = Model::with_finish(&shape, finish, 3).unwrap();
        model.add_to(&mut scene, &Pose::from_translation(DVec3::X));
    }
    scene.validate().unwrap();
    assert_eq!((scene.meshes.len(), scene.textures.len()), (3, 2));
    assert_eq!(scene.materials[2].colour(), Some(Colour::Texture(1)));
    assert!(scene.meshes[2].positions.iter().all(|p| p.x > 0.9));
}

#[test]
fn textures_outside_the_folder_are_not_read() {
    let dir = tempfile::tempdir().unwrap();
    let inside = dir.path().join("jail");
    std::fs::create_dir(&inside).unwrap();
    std::fs::write(dir.path().join("secret.png"), red_top()).unwrap();
    std::os::unix::fs::symlink("../secret.png", inside.join("link.png")).unwrap();
    std::fs::write(inside.join("own.png"), red_top()).unwrap();
    std::fs::write(inside.join("m.obj"), SQUARE).unwrap();
    let textures = |name: &str| {
        let mtl = format!("newmtl paint\nmap_Kd {name}\n");
        std::fs::write(inside.join("a.mtl"), mtl).unwrap();
        let loaded = Model::load(&inside.join("m.obj"), LengthUnit::Metre, PLASTIC, 1).unwrap();
        (loaded.model.textures.len(), loaded.warnings.join("\n"))
    };
    assert_eq!(textures("own.png").0, 1);
    let absolute = dir.path().join("secret.png").display().to_string();
    for name in [&*absolute, "../secret.png", "link.png"] {
        let (count, expected) = textures(name);
        assert!(count == 0 && expected.contains(name), "{name}: {expected}");
    }
}
