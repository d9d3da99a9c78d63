use super::*;
use crate::mesh_file::ImageSource;
use base64::Engine as _;
use proptest::prelude::*;
use std::io;

fn no_file(_: &str) -> io::Result<Vec<u8>> {
    Err(io::ErrorKind::NotFound.into())
}

fn read(text: &str, mtl: &str) -> TexturedMesh {
    let companions = |name: &str| match name {
        "a b.mtl" => Ok(mtl.as_bytes().to_vec()),
        _ => no_file(name),
    };
    read_textured_mesh(text.as_bytes(), MeshFormat::Obj, &companions).unwrap()
}

const CUBE_CORNER: &str = "mtllib a b.mtl\n\
    v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nv 0 0 1\n\
    vt 0 0\nvt 1 0\nvt 1 1\nvt 0 1\nvn 0 0 -2\n\
    usemtl Bottom\nf 1/1/1 4/4/1 3/3/1 2/2/1\nusemtl Side\nf 1 2 5\nusemtl Bottom\n\
    f 1/4/1 4/1/1 3/3/1\n";

#[test]
fn obj_parts_split_by_material_and_seam() {
    let mesh = read(
        CUBE_CORNER,
        "newmtl Side\nKd 1 0 0\nnewmtl Bottom\nKd 0 1 0\n",
    );
    assert!(mesh.warnings.is_empty(), "{:?}", mesh.warnings);
    assert_eq!(mesh.parts.len(), 2);
    let [bottom, side] = &mesh.parts[..] else {
        panic!()
    };
    assert_eq!(bottom.shape.triangles.len(), 3);
    // Two of the four corners are duplicated with other texture coordinates.
    assert_eq!(bottom.shape.vertices.len(), 6);
    let uvs = bottom.uvs.as_ref().unwrap();
    assert_eq!((uvs.len(), uvs[0]), (6, [0.0, 1.0]));
    assert_eq!(bottom.normals.as_ref().unwrap()[0], DVec3::NEG_Z);
    assert!(side.uvs.is_none() && side.normals.is_none());
    let colour = |part: &MeshPart| mesh.materials[part.material.unwrap()].base_color;
    assert_eq!(
        (colour(bottom), colour(side)),
        ([0.0, 1.0, 0.0], [1.0, 0.0, 0.0])
    );
}

#[test]
fn shape_matches_the_plain_reader() {
    let textured = read(CUBE_CORNER, "");
    let plain = super::super::read_mesh(CUBE_CORNER.as_bytes(), MeshFormat::Obj, &no_file);
    let plain = plain.unwrap();
    let corners = |mesh: &TriangleMesh| mesh.all_corners().collect::<Vec<_>>();
    let mut of_parts: Vec<_> = textured
        .parts
        .iter()
        .flat_map(|p| corners(&p.shape))
        .collect();
    let mut of_plain = corners(&plain);
    let key = |c: &[DVec3; 3]| format!("{c:?}");
    of_parts.sort_by_key(key);
    of_plain.sort_by_key(key);
    assert_eq!(of_parts, of_plain);
}

#[test]
fn invalid_appearance_is_a_warning() {
    let text = "mtllib gone.mtl\nmtllib a b.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\nvt x\nvn 0 0 0\n\
                usemtl here\nf 1/1/1 2/7/-9 3/one/1\n";
    let mesh = read(
        text,
        "Kd 1 1 1\nnewmtl here\nKd one two\nNs nan\nmap_bump b.png\nKs 2\n",
    );
    let warnings = mesh.warnings.join("\n");
    for expected in [
        "gone.mtl",
        "6 corners",
        "before the first `newmtl`",
        "line 3: invalid statement `Kd one two`",
        "line 4: invalid statement `Ns nan`",
        "`map_bump` is not supported",
    ] {
        assert!(warnings.contains(expected), "{expected}: {warnings}");
    }
    assert!(mesh.parts[0].uvs.is_none() && mesh.parts[0].material == Some(0));
    // The plain reader ignores the appearance.
    assert!(super::super::read_mesh(text.as_bytes(), MeshFormat::Obj, &no_file).is_ok());
}

fn material(text: &str) -> MeshMaterial {
    let mut warnings = Vec::new();
    let all = mtl::read(format!("newmtl m\n{text}\n").as_bytes(), &mut warnings);
    assert!(warnings.is_empty(), "{warnings:?}");
    all.into_iter().next().unwrap()
}

#[test]
fn mtl_statements_become_metallic_roughness() {
    let paint = material("Kd 0.5 0.25 0\nKs 0.1\nNs 30\nillum 2");
    assert_eq!((paint.metallic, paint.transmission), (0.0, 0.0));
    assert!((paint.roughness - 0.5).abs() < 1e-12, "{}", paint.roughness);
    let dull = material("Kd 0.5 0.5 0.5\nNs 900");
    assert_eq!(dull.roughness, MeshMaterial::default().roughness);
    let fork = material("Kd 0.02 0.02 0.02\nKs 0.9 0.9 0.85\nNs 500\nillum 3");
    assert_eq!((fork.metallic, fork.base_color), (1.0, [0.9, 0.9, 0.85]));
    assert!(fork.roughness < 0.3);
    let glass = material("Kd 0 0 0\nKs 0.9\nillum 4\nNi 1.45\nTf 0.9 1 0.9");
    assert_eq!(
        (glass.transmission, glass.ior, glass.metallic),
        (1.0, 1.45, 0.0)
    );
    assert_eq!(
        (glass.base_color, glass.roughness),
        ([0.9, 1.0, 0.9], 0.0_f64.max(glass.roughness))
    );
    let tinted = material("d 0.25");
    assert_eq!((tinted.transmission, tinted.roughness), (0.75, 0.0));
    assert_eq!(material("Tr 0.75").transmission, 0.75);
    // MeshLab writes the opacity as `Tr`; `d` decides where both are given.
    assert_eq!(material("Tr 1\nillum 2").transmission, 0.0);
    assert_eq!(material("d 1\nTr 1").transmission, 0.0);
    assert_eq!(material("Tr 0.5\nd 0.75").transmission, 0.25);
    let pbr = material("Kd 1 1 1\nPr 0.35\nPm 0.5");
    assert_eq!((pbr.roughness, pbr.metallic), (0.35, 0.5));
}

#[test]
fn image_names_with_options_and_spaces_are_parsed() {
    for (words, name) in [
        ("wood.png", "wood.png"),
        ("-s 1 1 1 -o 0.5 0 0 my wood.png", "my wood.png"),
        ("-blendu on -mm 0 1 tex\\wood.jpg", "tex/wood.jpg"),
        ("-clamp on \"wood 2.png\"", "wood 2.png"),
    ] {
        let found = material(&format!("map_Kd {words}")).base_color_image;
        assert_eq!(found, Some(ImageSource::File(name.to_string())), "{words}");
    }
    assert_eq!(material("map_Kd a.png").base_color, [1.0; 3]);
    let commented = material("Kd 0 0 0\nmap_kd a.png # the label");
    assert_eq!(commented.base_color, [1.0; 3], "exporters leave Kd at 0");
    let image = Some(ImageSource::File("a.png".to_string()));
    assert_eq!(commented.base_color_image, image);
}

#[test]
fn map_options_place_the_image() {
    let placed = |words: &str| material(&format!("map_Kd {words}")).uv_transform;
    let identity = MeshMaterial::default().uv_transform;
    assert_eq!(placed("a.png"), identity);
    assert_eq!(placed("-s 1 1 1 -o 0 0 0 -bm 1 a.png"), identity);
    // v points up in the file, down in the mesh: v' = 1 - (2 (1 - v) + 0.25).
    assert_eq!(
        placed("-s 3 2 1 -o 0.5 0.25 0 a.png"),
        [[3.0, 0.0, 0.5], [0.0, 2.0, -1.25]]
    );
    assert_eq!(placed("-S 2 2.png"), [[2.0, 0.0, 0.0], [0.0, 1.0, 0.0]]);
}

#[test]
fn keywords_count_in_any_case() {
    let shouted = material("KD 0.5 0.25 0\nILLUM 2\nMAP_KD A.PNG\nD 0.25");
    assert_eq!(shouted.base_color_image.unwrap().name(), "A.PNG");
    assert_eq!((shouted.base_color, shouted.transmission), ([1.0; 3], 0.75));
}

#[test]
fn materials_are_found_by_name_in_all_libraries() {
    let library = |name: &str| match name {
        "a.mtl" => Ok(b"\xef\xbb\xbfnewmtl red\nKd 1 0 0\n".to_vec()),
        "b.mtl" => Ok(b"newmtl Material #25\nKd 0 1 0\rnewmtl m # blue\rKd 0 0 1\r".to_vec()),
        "my c.mtl" => Ok(b"newmtl red\nKd 1 0 0\n".to_vec()),
        _ => no_file(name),
    };
    let face = "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n";
    for (statement, name, color) in [
        ("mtllib a.mtl b.mtl", "red", [1.0, 0.0, 0.0]),
        ("mtllib a.mtl b.mtl # both", "Material #25", [0.0, 1.0, 0.0]),
        (
            "mtllib a.mtl\nmtllib b.mtl",
            "m # any comment",
            [0.0, 0.0, 1.0],
        ),
        ("mtllib my c.mtl", "red", [1.0, 0.0, 0.0]),
    ] {
        let text = format!("{statement}\nusemtl {name}\n{face}");
        let mesh = read_textured_mesh(text.as_bytes(), MeshFormat::Obj, &library).unwrap();
        assert!(mesh.warnings.is_empty(), "{:?}", mesh.warnings);
        assert_eq!(mesh.materials[0].base_color, color, "{statement} {name}");
    }
    let text = format!("usemtl red\n{face}");
    let mesh = read_textured_mesh(text.as_bytes(), MeshFormat::Obj, &library).unwrap();
    assert!(
        mesh.warnings[0].contains("names no material library"),
        "{:?}",
        mesh.warnings
    );
}

#[test]
fn vertex_colours_are_reported_as_ignored() {
    let face = "f 1 2 3\n";
    let corners = "v 0 0 0\nv 1 0 0\nv 0 1 0\n";
    let coloured = "v 0 0 0 1 0 0\nv 1 0 0 0 1 0\nv 0 1 0 0 0 1\n";
    let ply = |colour: &str| {
        format!(
            "ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\n\
             property float z\n{colour}element face 1\nproperty list uchar int vertex_indices\n\
             end_header\n0 0 0 9\n1 0 0 9\n0 1 0 9\n3 0 1 2\n"
        )
    };
    let attributes = r#""TEXCOORD_0":2"#;
    let gltf = gltf("{}", "");
    for (text, format, is_coloured) in [
        (format!("{corners}{face}"), MeshFormat::Obj, false),
        (format!("{coloured}{face}"), MeshFormat::Obj, true),
        (ply("property float quality\n"), MeshFormat::Ply, false),
        (ply("property uchar red\n"), MeshFormat::Ply, true),
        (gltf.clone(), MeshFormat::Gltf, false),
        (
            gltf.replace(attributes, &format!(r#"{attributes},"COLOR_0":1"#)),
            MeshFormat::Gltf,
            true,
        ),
    ] {
        let mesh = read_textured_mesh(text.as_bytes(), format, &no_file).unwrap();
        let is_told = mesh.warnings.join("\n").contains("vertex colours");
        assert_eq!(is_told, is_coloured, "{text}: {:?}", mesh.warnings);
    }
}

#[test]
fn material_names_and_textures_are_found_in_other_case() {
    let folder = tempfile::tempdir().unwrap();
    let save = |name: &str, text: &str| std::fs::write(folder.path().join(name), text).unwrap();
    save("Cup.MTL", "newmtl Red\nKd 1 0 0\n");
    save(
        "cup.obj",
        "mtllib cup.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\nusemtl RED\nf 1 2 3\n",
    );
    let mesh = load_textured_mesh(&folder.path().join("cup.obj"), LengthUnit::Metre).unwrap();
    assert!(mesh.warnings.is_empty(), "{:?}", mesh.warnings);
    assert_eq!(mesh.materials[0].base_color, [1.0, 0.0, 0.0]);
}

/// One triangle with normals, texture coordinates and an embedded image.
fn gltf(materials: &str, extra: &str) -> String {
    let mut buffer: Vec<u8> = Vec::new();
    let positions = [[0.0_f32, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]];
    let normals = [[0.0_f32, 0.0, 1.0]; 3];
    for value in positions.iter().chain(&normals).flatten() {
        buffer.extend(value.to_le_bytes());
    }
    for value in [0.0_f32, 0.0, 1.0, 0.0, 0.0, 1.0] {
        buffer.extend(value.to_le_bytes());
    }
    buffer.extend(b"IMAGE!");
    let data = base64::engine::general_purpose::STANDARD.encode(&buffer);
    format!(
        r#"{{"asset":{{"version":"2.0"}},"scenes":[{{"nodes":[0]}}],
        "nodes":[{{"mesh":0,"scale":[2,1,4],"translation":[0,0,3]}}],
        "meshes":[{{"primitives":[{{"attributes":{{"POSITION":0,"NORMAL":1,"TEXCOORD_0":2}},
            "material":0}}]}}],
        "buffers":[{{"uri":"data:application/octet-stream;base64,{data}","byteLength":102}}],
        "bufferViews":[{{"buffer":0,"byteLength":36}},{{"buffer":0,"byteOffset":36,"byteLength":36}},
          {{"buffer":0,"byteOffset":72,"byteLength":24}},{{"buffer":0,"byteOffset":96,"byteLength":6}}],
        "accessors":[{{"bufferView":0,"componentType":5126,"type":"VEC3","count":3}},
          {{"bufferView":1,"componentType":5126,"type":"VEC3","count":3}},
          {{"bufferView":2,"componentType":5126,"type":"VEC2","count":3}}],
        "textures":[{{"source":0}}],"images":[{{"bufferView":3,"mimeType":"image/png"}}],
        {extra}"materials":[{materials}]}}"#
    )
}

fn read_gltf_text(text: &str) -> TexturedMesh {
    read_textured_mesh(text.as_bytes(), MeshFormat::Gltf, &no_file).unwrap()
}

#[test]
fn gltf_parts_have_normals_coordinates_and_images() {
    let mesh = read_gltf_text(&gltf(
        r#"{"name":"m","pbrMetallicRoughness":{"baseColorFactor":[1,0.5,0.25,1],
            "baseColorTexture":{"index":0},"metallicFactor":0,"roughnessFactor":0.4}}"#,
        "",
    ));
    assert!(mesh.warnings.is_empty(), "{:?}", mesh.warnings);
    let part = &mesh.parts[0];
    assert_eq!(part.shape.vertices[1], DVec3::new(2.0, 0.0, 3.0));
    assert_eq!(part.normals.as_ref().unwrap()[0], DVec3::Z);
    assert_eq!(part.uvs.as_ref().unwrap()[2], [0.0, 1.0]);
    let material = &mesh.materials[part.material.unwrap()];
    assert_eq!(material.base_color, [1.0, 0.5, 0.25]);
    assert_eq!((material.metallic, material.roughness), (0.0, 0.4));
    let image = material.base_color_image.clone().unwrap();
    assert_eq!(
        image,
        ImageSource::Embedded("image 0".into(), b"IMAGE!".to_vec())
    );
}

#[test]
fn gltf_transmission_and_unsupported_features() {
    let mesh = read_gltf_text(&gltf(
        r#"{"extensions":{"KHR_materials_transmission":{"transmissionFactor":0.9},
            "KHR_materials_ior":{"ior":1.33}},"normalTexture":{"index":0}},
          {"alphaMode":"BLEND","pbrMetallicRoughness":{"baseColorFactor":[1,1,1,0.2],
            "baseColorTexture":{"index":0,"texCoord":1}}},
          {"alphaMode":"MASK","pbrMetallicRoughness":{"baseColorTexture":{"index":9}}}"#,
        "",
    ));
    let [glass, blend, mask] = &mesh.materials[..] else {
        panic!()
    };
    assert_eq!((glass.transmission, glass.ior), (0.9, 1.33));
    assert!((blend.transmission - 0.8).abs() < 1e-12);
    // Defaults of the format.
    assert_eq!((mask.metallic, mask.roughness), (1.0, 1.0));
    let warnings = mesh.warnings.join("\n");
    for expected in ["normal map", "first set", "MASK", "texture 9 not found"] {
        assert!(warnings.contains(expected), "{expected}: {warnings}");
    }
}

#[test]
fn gltf_material_extensions_are_read() {
    let mesh = read_gltf_text(&gltf(
        r#"{"extensions":{"KHR_materials_pbrSpecularGlossiness":{"diffuseFactor":[0.5,0.25,1,1],
            "diffuseTexture":{"index":0},"glossinessFactor":0.75}}},
          {"extensions":{"KHR_materials_unlit":{}},
            "pbrMetallicRoughness":{"baseColorFactor":[0,1,0,1]}},
          {"pbrMetallicRoughness":{"baseColorTexture":{"index":0,"texCoord":1,"extensions":
            {"KHR_texture_transform":{"offset":[0,1],"rotation":1.5707963267948966,
              "scale":[0.5,0.5],"texCoord":0}}}}}"#,
        "",
    ));
    let [glossy, unlit, placed] = &mesh.materials[..] else {
        panic!()
    };
    assert_eq!(glossy.base_color, [0.5, 0.25, 1.0]);
    assert!(glossy.base_color_image.is_some());
    assert_eq!((glossy.metallic, glossy.roughness), (0.0, 0.25));
    assert_eq!((unlit.metallic, unlit.roughness), (0.0, 1.0));
    assert!(
        mesh.warnings.join("\n").contains("unlit"),
        "{:?}",
        mesh.warnings
    );
    // The example of the extension: the lower left quadrant, turned clockwise.
    assert!(placed.base_color_image.is_some());
    let [[_, b, c], [d, _, f]] = placed.uv_transform;
    for (found, expected) in [(b, 0.5), (c, 0.0), (d, -0.5), (f, 1.0)] {
        assert!(
            (found - expected).abs() < 1e-12,
            "{:?}",
            placed.uv_transform
        );
    }
}

#[test]
fn gltf_image_names_are_percent_decoded() {
    let text = gltf(
        r#"{"pbrMetallicRoughness":{"baseColorTexture":{"index":0}}}"#,
        "",
    );
    let text = text.replace(
        r#""bufferView":3,"mimeType":"image/png""#,
        r#""uri":"b%C3%BCx%201.png""#,
    );
    let image = read_gltf_text(&text).materials[0].base_color_image.clone();
    assert_eq!(image, Some(ImageSource::File("büx 1.png".into())));
}

#[test]
fn invalid_gltf_materials_keep_the_shape() {
    let mesh = read_gltf_text(&gltf(r#"{"pbrMetallicRoughness":7}"#, ""));
    assert!(mesh.materials.is_empty() && mesh.parts[0].material.is_none());
    assert!(
        mesh.warnings[0].contains("invalid materials"),
        "{:?}",
        mesh.warnings
    );
    let text = gltf("{}", "").replace(r#""type":"VEC2""#, r#""type":"VEC4""#);
    let error = read_textured_mesh(text.as_bytes(), MeshFormat::Gltf, &no_file).unwrap_err();
    assert!(error.to_string().contains("texture coordinates"), "{error}");
}

#[test]
fn other_formats_have_one_part_without_appearance() {
    let folder = tempfile::tempdir().unwrap();
    let mug = crate::builtin("mug").unwrap();
    let path = folder.path().join("mug.ply");
    super::super::save_mesh(&path, &mug).unwrap();
    let mesh = load_textured_mesh(&path, LengthUnit::Millimetre).unwrap();
    assert_eq!(mesh.parts.len(), 1);
    assert!(mesh.parts[0].uvs.is_none() && mesh.materials.is_empty());
    assert_eq!(mesh.parts[0].shape, mug.scaled(1e-3));
    let error = read_textured_mesh(b"", MeshFormat::Stl, &no_file).unwrap_err();
    assert!(error.to_string().contains("empty"));
    let error = read_textured_mesh(b"v 0 0 0\n", MeshFormat::Obj, &no_file).unwrap_err();
    assert!(error.to_string().contains("no faces"), "{error}");
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(1024))]

    #[test]
    fn damaged_appearance_never_panics(
        which in 0..3usize,
        edits in prop::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 1..6)
    ) {
        let mtl = "newmtl Side\nmap_Kd -s 1 1 a.png\nd -halo 0.5\nnewmtl Bottom\nKd 0 1 0\n";
        let document = gltf(r#"{"pbrMetallicRoughness":{"baseColorTexture":{"index":0}}}"#, "");
        let mut bytes = match which {
            0 => CUBE_CORNER.as_bytes().to_vec(),
            1 => mtl.as_bytes().to_vec(),
            _ => document.into_bytes(),
        };
        for (index, value) in edits {
            let index = index.index(bytes.len());
            bytes[index] = value;
        }
        let damaged = bytes.clone();
        let companions = |_: &str| Ok(if which == 1 { damaged.clone() } else { Vec::new() });
        let (text, format) = match which {
            0 => (&bytes[..], MeshFormat::Obj),
            1 => (CUBE_CORNER.as_bytes(), MeshFormat::Obj),
            _ => (&bytes[..], MeshFormat::Gltf),
        };
        if let Ok(mesh) = read_textured_mesh(text, format, &companions) {
            for part in &mesh.parts {
                let count = part.shape.vertices.len();
                prop_assert!(part.uvs.as_ref().is_none_or(|uvs| uvs.len() == count));
                prop_assert!(part.normals.as_ref().is_none_or(|all| all.len() == count));
            }
        }
    }
}
