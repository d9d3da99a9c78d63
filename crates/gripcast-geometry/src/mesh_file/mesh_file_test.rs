use super::*;
use crate::builtin;
use gripcast_base::error::ErrorKind;
use proptest::prelude::*;
use std::fs;

#[path = "dialects_test.rs"]
mod dialects;

fn no_file(_: &str) -> std::io::Result<Vec<u8>> {
    Err(std::io::ErrorKind::NotFound.into())
}

fn parse(bytes: impl AsRef<[u8]>, format: MeshFormat) -> Result<TriangleMesh> {
    read_mesh(bytes.as_ref(), format, &no_file)
}

fn error_text(bytes: impl AsRef<[u8]>, format: MeshFormat) -> String {
    let error = parse(bytes, format).unwrap_err();
    assert_eq!(error.kind(), ErrorKind::Input);
    assert!(error.remedy_text().is_some(), "{error}");
    error.to_string()
}

/// A tetrahedron with exact single-precision coordinates.
fn tetrahedron() -> TriangleMesh {
    TriangleMesh {
        vertices: vec![DVec3::ZERO, DVec3::X, DVec3::Y, DVec3::Z * 0.5],
        triangles: vec![[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]],
    }
}

fn binary_stl(mesh: &TriangleMesh) -> Vec<u8> {
    let mut bytes = b"solid in a binary header".to_vec();
    bytes.resize(80, b' ');
    bytes.extend((mesh.triangles.len() as u32).to_le_bytes());
    for corners in mesh.all_corners() {
        bytes.extend([0; 12]);
        for value in corners.iter().flat_map(|c| c.to_array()) {
            bytes.extend((value as f32).to_le_bytes());
        }
        bytes.extend([0; 2]);
    }
    bytes
}

fn ascii_stl(mesh: &TriangleMesh) -> String {
    let mut text = "solid part\n".to_string();
    for corners in mesh.all_corners() {
        text += "facet normal 0 0 0\n outer loop\n";
        for c in corners {
            text += &format!("  vertex {} {} {}\n", c.x, c.y, c.z);
        }
        text += " endloop\nendfacet\n";
    }
    text + "endsolid part\n"
}

/// Positions as floats, then indices as 16-bit integers.
fn gltf_buffer(mesh: &TriangleMesh) -> Vec<u8> {
    let mut bytes = Vec::new();
    for value in mesh.vertices.iter().flat_map(|v| v.to_array()) {
        bytes.extend((value as f32).to_le_bytes());
    }
    for index in mesh.triangles.iter().flatten() {
        bytes.extend((*index as u16).to_le_bytes());
    }
    bytes
}

fn gltf_json(mesh: &TriangleMesh, uri: Option<&str>, node: &str) -> String {
    let (positions, indices) = (12 * mesh.vertices.len(), 6 * mesh.triangles.len());
    let uri = uri.map_or(String::new(), |u| format!(r#""uri":"{u}","#));
    format!(
        r#"{{"asset":{{"version":"2.0"}},"scene":0,"scenes":[{{"nodes":[0]}}],"nodes":[{node}],
        "meshes":[{{"primitives":[{{"attributes":{{"POSITION":0}},"indices":1}}]}}],
        "buffers":[{{{uri}"byteLength":{total}}}],
        "bufferViews":[{{"buffer":0,"byteLength":{positions}}},
          {{"buffer":0,"byteOffset":{positions},"byteLength":{indices}}}],
        "accessors":[{{"bufferView":0,"componentType":5126,"type":"VEC3","count":{vertices},
            "min":[0,0,0],"max":[1,1,1]}},
          {{"bufferView":1,"componentType":5123,"type":"SCALAR","count":{corners}}}]}}"#,
        total = positions + indices,
        vertices = mesh.vertices.len(),
        corners = 3 * mesh.triangles.len(),
    )
}

fn glb(mesh: &TriangleMesh, node: &str) -> Vec<u8> {
    let mut json = gltf_json(mesh, None, node).into_bytes();
    json.resize(json.len().next_multiple_of(4), b' ');
    let mut blob = gltf_buffer(mesh);
    blob.resize(blob.len().next_multiple_of(4), 0);
    let mut bytes = b"glTF".to_vec();
    let total = 12 + 8 + json.len() + 8 + blob.len();
    bytes.extend([2, total as u32].map(u32::to_le_bytes).concat());
    bytes.extend((json.len() as u32).to_le_bytes());
    bytes.extend(b"JSON");
    bytes.extend(json);
    bytes.extend((blob.len() as u32).to_le_bytes());
    bytes.extend(b"BIN\0");
    bytes.extend(blob);
    bytes
}

/// The same corners in the same order, whatever the numbering of the vertices.
fn assert_same_shape(found: &TriangleMesh, expected: &TriangleMesh) {
    assert_eq!(found.vertices.len(), expected.vertices.len());
    let corners = |mesh: &TriangleMesh| mesh.all_corners().collect::<Vec<_>>();
    assert_eq!(corners(found), corners(expected));
}

#[test]
fn all_formats_read_the_same_tetrahedron() {
    let mesh = tetrahedron();
    let obj = "# a comment\no part\nv 0 0 0 1.0\nv 1 0 0\nv 0 1 0 0.5 0.5 0.5\nv 0 0 0.5\n\
               vt 0 0\nvn 0 0 1\nusemtl a\nf 1/1/1 3//1 2\nf -4 \\\n -3 -1\nf 1 4 3\nf 2 3 4\n";
    let ascii_ply = "ply\nformat ascii 1.0\nelement vertex 4\nproperty float x\n\
                     property float y\nproperty float z\nproperty uchar red\nelement face 4\n\
                     property list uchar int vertex_indices\nelement edge 1\n\
                     property int vertex1\nend_header\n0 0 0 9\n1 0 0 9\n0 1 0 9\n0 0 0.5 9\n\
                     3 0 2 1\n3 0 1 3\n3 0 3 2\n3 1 2 3\n7\n";
    let identity = r#"{"mesh":0}"#;
    for (name, found) in [
        ("obj", parse(obj, MeshFormat::Obj)),
        ("obj written", parse(obj::write(&mesh), MeshFormat::Obj)),
        ("binary stl", parse(binary_stl(&mesh), MeshFormat::Stl)),
        ("ascii stl", parse(ascii_stl(&mesh), MeshFormat::Stl)),
        ("ascii ply", parse(ascii_ply, MeshFormat::Ply)),
        ("binary ply", parse(ply::write(&mesh), MeshFormat::Ply)),
        ("glb", parse(glb(&mesh, identity), MeshFormat::Gltf)),
    ] {
        let found = found.unwrap_or_else(|e| panic!("{name}: {e}"));
        assert_same_shape(&found, &mesh);
    }
}

#[test]
fn gltf_buffers_are_embedded_or_companion_files() {
    let mesh = tetrahedron();
    let data = base64::Engine::encode(
        &base64::engine::general_purpose::STANDARD,
        gltf_buffer(&mesh),
    );
    let uri = format!("data:application/octet-stream;base64,{data}");
    let inside = gltf_json(&mesh, Some(&uri), r#"{"mesh":0}"#);
    assert_same_shape(&parse(inside, MeshFormat::Gltf).unwrap(), &mesh);

    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("part.gltf");
    let text = gltf_json(&mesh, Some("part%20data.bin"), r#"{"mesh":0}"#);
    fs::write(&path, text).unwrap();
    let missing = load_mesh(&path, LengthUnit::Metre).unwrap_err().to_string();
    assert!(missing.contains("part%20data.bin"), "{missing}");
    fs::write(folder.path().join("part data.bin"), gltf_buffer(&mesh)).unwrap();
    assert_same_shape(&load_mesh(&path, LengthUnit::Metre).unwrap(), &mesh);
}

#[test]
fn gltf_node_transforms_are_applied() {
    let mesh = tetrahedron();
    let nested = r#"{"children":[1],"translation":[0,0,1]},{"mesh":0,"scale":[-1,1,1]}"#;
    let found = parse(glb(&mesh, nested), MeshFormat::Gltf).unwrap();
    let volume = crate::MassProperties::from_mesh(&found).unwrap();
    assert!((volume.volume_m3 - 1.0 / 12.0).abs() < 1e-15);
    assert!(
        volume
            .center_of_mass_m
            .distance(DVec3::new(-0.25, 0.25, 1.125))
            < 1e-15
    );
    let cycle = r#"{"children":[1]},{"mesh":0,"children":[0]}"#;
    let text = error_text(glb(&mesh, cycle), MeshFormat::Gltf);
    assert!(text.contains("more than one parent"), "{text}");
}

#[test]
fn gltf_strips_and_fans_become_triangles() {
    let mut mesh = tetrahedron();
    mesh.triangles = vec![[0, 1, 2], [3, 0, 1]];
    let with_mode = |mode: u32| {
        let text = gltf_json(&mesh, Some("x.bin"), r#"{"mesh":0}"#);
        let text = text.replace(r#""indices":1"#, &format!(r#""indices":1,"mode":{mode}"#));
        let buffer = gltf_buffer(&mesh);
        read_mesh(text.as_bytes(), MeshFormat::Gltf, &|_: &str| {
            Ok(buffer.clone())
        })
    };
    let strip = with_mode(5).unwrap();
    assert_eq!(
        strip.triangles,
        [[0, 1, 2], [2, 1, 3], [2, 3, 0], [0, 3, 1]]
    );
    let fan = with_mode(6).unwrap();
    assert_eq!(fan.triangles, [[0, 1, 2], [0, 2, 3], [0, 3, 0], [0, 0, 1]]);
    assert!(with_mode(1).unwrap_err().to_string().contains("no faces"));
}

#[test]
fn invalid_gltf_references_are_rejected() {
    let mesh = tetrahedron();
    let good = gltf_json(&mesh, Some("x.bin"), r#"{"mesh":0}"#);
    let buffer = gltf_buffer(&mesh);
    let read = |text: &str| {
        read_mesh(text.as_bytes(), MeshFormat::Gltf, &|_: &str| {
            Ok(buffer.clone())
        })
    };
    read(&good).unwrap();
    for (from, to, expected) in [
        (r#""POSITION":0"#, r#""POSITION":7"#, "accessor 7"),
        (r#""scene":0"#, r#""scene":2"#, "scene 2"),
        (r#""mesh":0"#, r#""mesh":1"#, "mesh 1"),
        (r#""nodes":[0]"#, r#""nodes":[3]"#, "node 3"),
        (r#""bufferView":0,"#, r#""bufferView":9,"#, "bufferView 9"),
        (r#""bufferView":0,"#, "", "compressed"),
        (
            r#""count":4"#,
            r#""count":99999999999999999"#,
            "more than the buffer",
        ),
        (r#""count":4"#, r#""count":0"#, "more than the buffer"),
        (r#""type":"VEC3""#, r#""type":"VEC2""#, "found VEC2"),
        ("5123", "5122", "component type 5122"),
    ] {
        let text = good.replace(from, to);
        assert_ne!(text, good);
        let error = read(&text).unwrap_err();
        assert!(error.to_string().contains(expected), "{to}: {error}");
        assert!(error.remedy_text().is_some(), "{error}");
    }
}

#[test]
fn polygons_become_fans() {
    let text = "v 0 0 0\nv 1 0 0\nv 2 1 0\nv 1 2 0\nv 0 2 0\nf 1 2 3 4 5\n";
    let mesh = parse(text, MeshFormat::Obj).unwrap();
    assert_eq!(mesh.triangles, [[0, 1, 2], [0, 2, 3], [0, 3, 4]]);
    let quad = "ply\nformat ascii 1.0\nelement vertex 4\nproperty double x\nproperty double y\n\
                property double z\nelement face 1\nproperty list uint8 uint16 vertex_index\n\
                end_header\n0 0 0\n1 0 0\n1 1 0\n0 1 0\n4 0 1 2 3\n";
    let mesh = parse(quad, MeshFormat::Ply).unwrap();
    assert_eq!(mesh.triangles, [[0, 1, 2], [0, 2, 3]]);
}

#[test]
fn files_round_trip_bit_for_bit_and_units_scale() {
    let folder = tempfile::tempdir().unwrap();
    let mesh = builtin("mug").unwrap();
    for name in ["mug.ply", "mug.OBJ"] {
        let path = folder.path().join(name);
        save_mesh(&path, &mesh).unwrap();
        let back = load_mesh(&path, LengthUnit::Metre).unwrap();
        assert_eq!(back.content_hash(), mesh.content_hash(), "{name}");
        let in_mm = load_mesh(&path, LengthUnit::Millimetre).unwrap();
        assert_eq!(in_mm, mesh.scaled(1e-3));
    }
    let text = save_mesh(&folder.path().join("mug.stl"), &mesh)
        .unwrap_err()
        .to_string();
    assert!(text.contains(".ply or .obj"), "{text}");
}

#[test]
fn units_parse_their_names() {
    for (name, metres) in [("mm", 0.001), ("cm", 0.01), ("m", 1.0), ("in", 0.0254)] {
        let unit: LengthUnit = name.parse().unwrap();
        assert_eq!(unit.in_metres(), metres);
        assert_eq!(unit.to_string(), name);
    }
    let text = "foot".parse::<LengthUnit>().unwrap_err().to_string();
    assert!(text.contains("mm, cm, m or in"), "{text}");
}

#[test]
fn missing_files_and_unknown_suffixes_are_rejected() {
    let missing = load_mesh(Path::new("/nowhere/cup.obj"), LengthUnit::Metre).unwrap_err();
    assert_eq!(missing.kind(), ErrorKind::NotFound);
    assert!(
        missing.to_string().starts_with("/nowhere/cup.obj: "),
        "{missing}"
    );
    assert!(missing.remedy_text().is_some());
    let step = load_mesh(Path::new("cup.step"), LengthUnit::Metre)
        .unwrap_err()
        .to_string();
    assert!(step.contains("\"step\"") && step.contains(".glb"), "{step}");
    let near = load_mesh(Path::new("cup.stll"), LengthUnit::Metre)
        .unwrap_err()
        .to_string();
    assert!(near.contains("did you mean .stl?"), "{near}");
    assert!(load_mesh(Path::new("cup"), LengthUnit::Metre).is_err());
}

#[test]
fn invalid_obj_errors_state_the_line() {
    let text = error_text("v 0 0 0\nv 1 0 0\nv 0 1 0\n\nf 1 2 4\n", MeshFormat::Obj);
    assert!(
        text.contains("line 5") && text.contains("vertex 4"),
        "{text}"
    );
    let text = error_text("v 0 0 0\nv 0 nan 0\n", MeshFormat::Obj);
    assert!(text.contains("line 2") && text.contains("finite"), "{text}");
    let text = error_text("v 0 0 inf\n", MeshFormat::Obj);
    assert!(text.contains("finite"), "{text}");
    let text = error_text("v 0 0\n", MeshFormat::Obj);
    assert!(
        text.contains("line 1") && text.contains("3 coordinates"),
        "{text}"
    );
    // A face of two corners has no area.
    let text = error_text("v 0 0 0\nf 1 1\n", MeshFormat::Obj);
    assert!(text.contains("1 points but no faces"), "{text}");
    for index in ["0", "-2", "99999999999", "one"] {
        let text = error_text(format!("v 0 0 0\nf 1 1 {index}\n"), MeshFormat::Obj);
        assert!(text.contains(index), "{text}");
    }
    let text = error_text("hello\n", MeshFormat::Obj);
    assert!(text.contains("no vertices and no faces"), "{text}");
}

#[test]
fn empty_and_truncated_files_are_rejected() {
    let mesh = tetrahedron();
    let identity = r#"{"mesh":0}"#;
    let whole = [
        (MeshFormat::Stl, binary_stl(&mesh)),
        (MeshFormat::Stl, ascii_stl(&mesh).into_bytes()),
        (MeshFormat::Ply, ply::write(&mesh)),
        (MeshFormat::Gltf, glb(&mesh, identity)),
    ];
    for (format, bytes) in whole {
        let text = error_text([], format);
        assert!(text.contains("empty"), "{text}");
        parse(&bytes, format).unwrap();
        for cut in 1..bytes.len() {
            // Content after the last face (`endsolid`, padding) is not required, and a text STL
            // does not declare how many facets it has.
            match parse(&bytes[..cut], format) {
                Err(error) => assert!(error.remedy_text().is_some(), "{error}"),
                Ok(cut_mesh) if bytes.starts_with(b"solid part") => {
                    let found: Vec<_> = cut_mesh.all_corners().collect();
                    let expected: Vec<_> = mesh.all_corners().take(found.len()).collect();
                    assert_eq!(found, expected, "cut at {cut}");
                }
                Ok(_) => assert!(cut + 16 > bytes.len(), "{format:?} cut at {cut}"),
            }
        }
    }
    let pointer = "version https://git-lfs.github.com/spec/v1\noid sha256:0\nsize 1\n";
    assert!(error_text(pointer, MeshFormat::Obj).contains("git lfs pull"));
}

#[test]
fn invalid_numbers_in_binary_files_are_rejected() {
    let mut mesh = tetrahedron();
    mesh.vertices[1].x = f64::NAN;
    let text = error_text(ply::write(&mesh), MeshFormat::Ply);
    assert!(
        text.contains("vertex 1") && text.contains("finite"),
        "{text}"
    );
    let text = error_text(binary_stl(&mesh), MeshFormat::Stl);
    assert!(text.contains("finite"), "{text}");
    let text = error_text(glb(&mesh, r#"{"mesh":0}"#), MeshFormat::Gltf);
    assert!(text.contains("finite"), "{text}");
    let mut mesh = tetrahedron();
    mesh.triangles[2][1] = 4;
    let text = error_text(ply::write(&mesh), MeshFormat::Ply);
    assert!(
        text.contains("triangle 2") && text.contains("only 4"),
        "{text}"
    );
    let text = error_text(glb(&mesh, r#"{"mesh":0}"#), MeshFormat::Gltf);
    assert!(text.contains("vertex 4"), "{text}");
}

#[test]
fn absurd_counts_are_rejected_without_allocation() {
    let face = "property list uchar int vertex_indices\n";
    let ply = format!(
        "ply\nformat binary_little_endian 1.0\nelement face 99999999999\n{face}end_header\n"
    );
    assert!(error_text(ply, MeshFormat::Ply).contains("more than the file holds"));
    let bare = "ply\nformat binary_little_endian 1.0\nelement face 9\nend_header\n         ";
    assert!(error_text(bare, MeshFormat::Ply).contains("more than the file holds"));
    let flat = "ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nend_header\n1\n";
    assert!(error_text(flat, MeshFormat::Ply).contains("x, y and z"));
    let mut stl = vec![0; 84];
    stl[80..].fill(0xff);
    assert!(error_text(stl, MeshFormat::Stl).contains("214748364834 bytes"));
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(4096))]

    #[test]
    fn damaged_files_never_panic(
        which in 0..6usize, edits in prop::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 1..6)
    ) {
        let mesh = tetrahedron();
        let nested = r#"{"children":[1],"translation":[0,0,1]},{"mesh":0,"scale":[-1,1,1]}"#;
        let (format, mut bytes) = match which {
            0 => (MeshFormat::Obj, obj::write(&mesh)),
            1 => (MeshFormat::Stl, binary_stl(&mesh)),
            2 => (MeshFormat::Stl, ascii_stl(&mesh).into_bytes()),
            3 => (MeshFormat::Ply, ply::write(&mesh)),
            4 => (MeshFormat::Gltf, gltf_json(&mesh, Some("x.bin"), nested).into_bytes()),
            _ => (MeshFormat::Gltf, glb(&mesh, nested)),
        };
        for (index, value) in edits {
            let index = index.index(bytes.len());
            bytes[index] = value;
        }
        let buffer = gltf_buffer(&mesh);
        if let Err(error) = read_mesh(&bytes, format, &|_: &str| Ok(buffer.clone())) {
            prop_assert!(error.remedy_text().is_some(), "{error}");
        }
    }
}

/// A folder `jail/` for a mesh; `secret` and `link` lead to a valid companion outside it.
struct Jail(tempfile::TempDir);

impl Jail {
    fn new(companion: &[u8]) -> Self {
        let dir = tempfile::tempdir().unwrap();
        let inside = dir.path().join("jail");
        fs::create_dir(&inside).unwrap();
        fs::write(dir.path().join("secret"), companion).unwrap();
        std::os::unix::fs::symlink("../secret", inside.join("link")).unwrap();
        Self(dir)
    }

    fn mesh(&self, name: &str, contents: &str) -> std::path::PathBuf {
        let path = self.0.path().join("jail").join(name);
        fs::write(&path, contents).unwrap();
        path
    }

    fn names(&self) -> [String; 3] {
        let absolute = self.0.path().join("secret").display().to_string();
        [absolute, "../secret".to_owned(), "link".to_owned()]
    }
}

fn with_library(library: &str) -> String {
    format!("mtllib {library}\nv 0 0 0\nv 1 0 0\nv 0 1 0\nusemtl secret\nf 1 2 3\n")
}

#[test]
fn material_libraries_outside_the_folder_are_not_read() {
    let jail = Jail::new(b"newmtl secret\nKd one TOP-SECRET\n");
    for name in jail.names() {
        let path = jail.mesh("m.obj", &with_library(&name));
        let mesh = load_textured_mesh(&path, LengthUnit::Metre).unwrap();
        let warnings = mesh.warnings.join("\n");
        assert!(mesh.materials.is_empty(), "{name}: {warnings}");
        assert!(
            warnings.contains(&name) && !warnings.contains("TOP-SECRET"),
            "{warnings}"
        );
    }
}

#[test]
fn gltf_buffers_outside_the_folder_are_not_read() {
    let mesh = tetrahedron();
    let jail = Jail::new(&gltf_buffer(&mesh));
    for name in jail.names() {
        let path = jail.mesh("m.gltf", &gltf_json(&mesh, Some(&name), r#"{"mesh":0}"#));
        let text = load_mesh(&path, LengthUnit::Metre).unwrap_err().to_string();
        assert!(text.contains(&name), "{text}");
    }
}

#[test]
fn pipes_and_devices_are_not_read_as_libraries() {
    let jail = Jail::new(b"");
    let pipe = jail.0.path().join("jail/pipe");
    rustix::fs::mknodat(
        rustix::fs::CWD,
        &pipe,
        rustix::fs::FileType::Fifo,
        rustix::fs::Mode::RUSR | rustix::fs::Mode::WUSR,
        0,
    )
    .unwrap();
    // Writes to any reader of the pipe.
    let writer = std::thread::spawn({
        let pipe = pipe.clone();
        move || fs::write(pipe, "newmtl secret\n")
    });
    let path = jail.mesh("m.obj", &with_library("pipe"));
    let mesh = load_textured_mesh(&path, LengthUnit::Metre).unwrap();
    // Unblocks the writer.
    let reader = fs::File::options().read(true).write(true).open(&pipe);
    let _ = writer.join().unwrap();
    drop(reader);
    assert!(mesh.materials.is_empty(), "{:?}", mesh.warnings);
    assert!(mesh.warnings[0].contains("a pipe"), "{:?}", mesh.warnings);

    std::os::unix::fs::symlink("/dev/null", jail.0.path().join("jail/device")).unwrap();
    for name in ["/dev/null", "device"] {
        let path = jail.mesh("m.obj", &with_library(name));
        let mesh = load_textured_mesh(&path, LengthUnit::Metre).unwrap();
        let warnings = mesh.warnings.join("\n");
        assert!(warnings.contains(name), "{warnings}");
    }
}
