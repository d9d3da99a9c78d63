//! Files as other programs write them.

use super::*;

#[test]
fn text_stl_dialects_are_read() {
    let mesh = tetrahedron();
    let text = ascii_stl(&mesh);
    let named = text.replace("solid part", "solid facet of a vertex");
    let split = text.replacen("endfacet\n", "endfacet\nendsolid a\nsolid b\n", 2);
    let quad = "solid q\nfacet normal 0 0 1\nouter loop\nvertex 0 0 0\nvertex 1 0 0\n\
                vertex 1 1 0\nvertex 0 1 0\nendloop\nendfacet\nendsolid";
    for (name, dialect) in [
        ("upper case", text.to_uppercase()),
        ("byte order mark", "\u{feff}".to_string() + &text),
        ("leading blanks", format!("\n \t{text}")),
        ("no name", text.replace("solid part", "solid")),
        ("words of the format in the name", named),
        (
            "NaN normals",
            text.replace("normal 0 0 0", "normal nan -nan(ind) nan"),
        ),
        ("no normals", text.replace("normal 0 0 0", "")),
        ("end solid", text.replace("endsolid", "end solid")),
        (
            "end loop",
            text.replace("endloop", "end loop")
                .replace("endfacet", "end facet"),
        ),
        ("no end", text.replace("endsolid part\n", "")),
        ("decimal commas", text.replace("0.5", "0,5")),
        ("CR", text.replace('\n', "\r")),
        (
            "CR LF and tabs",
            text.replace('\n', "\r\n").replace(' ', "\t"),
        ),
        ("two solids", split),
        ("one line", text.replace('\n', " ")),
    ] {
        let found = parse(&dialect, MeshFormat::Stl).unwrap_or_else(|e| panic!("{name}: {e}"));
        assert_same_shape(&found, &mesh);
    }
    let utf16: Vec<u8> = ("\u{feff}".to_string() + &text)
        .encode_utf16()
        .flat_map(u16::to_le_bytes)
        .collect();
    assert_same_shape(&parse(utf16, MeshFormat::Stl).unwrap(), &mesh);
    assert_eq!(parse(quad, MeshFormat::Stl).unwrap().triangles.len(), 2);
    let text = error_text(
        text.replace("vertex 1 0 0", "vertex 1 x 0"),
        MeshFormat::Stl,
    );
    assert!(text.contains("line ") && text.contains("\"x\""), "{text}");
    let empty = error_text("solid a\nendsolid a\n", MeshFormat::Stl);
    assert!(empty.contains("no faces"), "{empty}");
}

#[test]
fn binary_stl_count_may_be_missing_or_followed_by_more() {
    let mesh = tetrahedron();
    let mut streamed = binary_stl(&mesh);
    streamed[80..84].fill(0);
    let mut followed = binary_stl(&mesh);
    followed.extend(b"colours of a program");
    let mut facet_in_header = binary_stl(&mesh);
    facet_in_header[..12].copy_from_slice(b"solid facet ");
    for bytes in [streamed, followed, facet_in_header] {
        assert_same_shape(&parse(bytes, MeshFormat::Stl).unwrap(), &mesh);
    }
}

#[test]
fn obj_dialects_are_read() {
    let mesh = tetrahedron();
    let text = String::from_utf8(obj::write(&mesh)).unwrap();
    let faces = text
        .replace("f 1 3 2", "f 1.0 3.0 2.0")
        .replace("f 1 2 4", "fo 1 2 4");
    for (name, dialect) in [
        ("decimal commas", text.replace("0.5", "0,5")),
        ("CR", text.replace('\n', "\r")),
        (
            "byte order mark",
            "\u{feff}".to_string() + &text.replace("# unit: metre\n", ""),
        ),
        ("float indices, fo", faces),
        ("two corners", text.clone() + "f 1 2\n"),
    ] {
        let found = parse(&dialect, MeshFormat::Obj).unwrap_or_else(|e| panic!("{name}: {e}"));
        assert_same_shape(&found, &mesh);
    }
    let text = error_text("v 0 0 0\nf 0 1 1\n", MeshFormat::Obj);
    assert!(text.contains("counts vertices from 1"), "{text}");
    let text = error_text("v 0 0 0\nv 1 0 0\n", MeshFormat::Obj);
    assert!(text.contains("2 points but no faces"), "{text}");
}

#[test]
fn concave_polygons_do_not_fold() {
    let l_shape = "v 0 0 0\nv 2 0 0\nv 2 1 0\nv 1 1 0\nv 1 2 0\nv 0 2 0\n";
    for face in ["1 2 3 4 5 6", "4 5 6 1 2 3", "2 3 4 5 6 1"] {
        let mesh = parse(format!("{l_shape}f {face}\n"), MeshFormat::Obj).unwrap();
        assert!((mesh.area() - 3.0).abs() < 1e-12, "{face}: {}", mesh.area());
    }
}

#[test]
fn ply_strips_are_read() {
    let strips = "ply\nformat ascii 1.0\nelement tristrips 1\n\
                  property list int int vertex_indices\nelement vertex 4\nproperty float x\n\
                  property float y\nproperty float z\nend_header\n\
                  9 0 2 1 3 -1 0 3 2 -1\n0 0 0\n1 0 0\n0 1 0\n0 0 0.5\n";
    let mesh = parse(strips, MeshFormat::Ply).unwrap();
    assert_eq!(mesh.triangles, [[0, 2, 1], [1, 2, 3], [0, 3, 2]]);
}

/// A document of the tetrahedron whose accessors, nodes or extensions are replaced.
fn changed_gltf(changes: &[(&str, &str)], buffer: Vec<u8>) -> Result<TriangleMesh> {
    let mut text = gltf_json(&tetrahedron(), Some("x%20y%C3%BC.bin"), r#"{"mesh":0}"#);
    for (from, to) in changes {
        assert!(text.contains(from), "{from}");
        text = text.replace(from, to);
    }
    read_mesh(text.as_bytes(), MeshFormat::Gltf, &move |name: &str| {
        assert_eq!(name, "x y\u{fc}.bin");
        Ok(buffer.clone())
    })
}

#[test]
fn gltf_quantised_sparse_and_sceneless_files_are_read() {
    let mesh = tetrahedron();
    let plain = gltf_buffer(&mesh);
    let no_scene = [(r#""scene":0,"scenes":[{"nodes":[0]}],"#, "")];
    assert_same_shape(&changed_gltf(&no_scene, plain.clone()).unwrap(), &mesh);

    // Corners 0, 1 and 2 as normalised bytes with a stride of 4; corner 3 is sparse.
    let mut quantised = vec![0_u8; plain.len()];
    quantised[..12].copy_from_slice(&[0, 0, 0, 0, 255, 0, 0, 0, 0, 255, 0, 0]);
    quantised[16] = 3;
    quantised[20..23].copy_from_slice(&[0, 0, 128]);
    quantised[48..].copy_from_slice(&plain[48..]);
    let changes = [
        (
            r#""asset""#,
            r#""extensionsRequired":["KHR_mesh_quantization"],"asset""#,
        ),
        (r#""byteLength":48}"#, r#""byteLength":48,"byteStride":4}"#),
        (
            r#""componentType":5126,"#,
            r#""componentType":5121,"normalized":true,"sparse":{"count":1,
               "indices":{"bufferView":0,"byteOffset":16,"componentType":5121},
               "values":{"bufferView":0,"byteOffset":20}},"#,
        ),
    ];
    let found = changed_gltf(&changes, quantised).unwrap();
    let expected = [DVec3::ZERO, DVec3::X, DVec3::Y, DVec3::Z * (128.0 / 255.0)];
    for (found, expected) in found.vertices.iter().zip(expected) {
        assert!(found.distance(expected) < 1e-6, "{found}");
    }
}

#[test]
fn gltf_skins_are_read_in_the_pose_of_the_file() {
    let mut buffer = gltf_buffer(&tetrahedron());
    let start = buffer.len();
    buffer.extend([0_u8; 16]);
    buffer.extend(
        [1.0_f32, 0.0, 0.0, 0.0]
            .repeat(4)
            .iter()
            .flat_map(|w| w.to_le_bytes()),
    );
    let views = format!(
        r#"{{"buffer":0,"byteOffset":{start},"byteLength":16}},
           {{"buffer":0,"byteOffset":{},"byteLength":64}}"#,
        start + 16
    );
    let changes = [
        (
            r#""nodes":[{"mesh":0}]"#,
            r#""nodes":[{"mesh":0,"skin":0,"scale":[100,100,100],
            "children":[1]},{"scale":[0.02,0.02,0.02]}],"skins":[{"joints":[1]}]"#,
        ),
        (
            r#""POSITION":0"#,
            r#""POSITION":0,"JOINTS_0":2,"WEIGHTS_0":3"#,
        ),
        (
            r#""byteLength":24}],"#,
            &format!(r#""byteLength":24}},{views}],"#),
        ),
        (
            r#""type":"SCALAR","count":12}"#,
            r#""type":"SCALAR","count":12},
            {"bufferView":2,"componentType":5121,"type":"VEC4","count":4},
            {"bufferView":3,"componentType":5126,"type":"VEC4","count":4}"#,
        ),
    ];
    let found = changed_gltf(&changes, buffer).unwrap();
    // The transform of the joint (100 × 0.02), not that of the node.
    assert!(
        found.vertices[1].distance(DVec3::X * 2.0) < 1e-9,
        "{found:?}"
    );
}

#[test]
fn gltf_with_an_unsupported_required_extension_is_rejected() {
    for name in [
        "KHR_draco_mesh_compression",
        "EXT_meshopt_compression",
        "ACME_shape",
    ] {
        let required = format!(r#""extensionsRequired":["{name}"],"asset""#);
        let error = changed_gltf(&[(r#""asset""#, &required)], Vec::new()).unwrap_err();
        assert!(error.to_string().contains(name), "{error}");
        assert!(error.remedy_text().is_some(), "{error}");
    }
}
