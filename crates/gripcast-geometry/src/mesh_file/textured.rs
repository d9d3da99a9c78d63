//! Meshes with materials, normals and texture coordinates, for renderers.

use std::collections::HashMap;
use std::path::Path;

use glam::DVec3;

use super::material::MeshMaterial;
use super::obj::{Corner, ObjFile};
use super::require_triangles;
use super::{Companions, LengthUnit, MeshFormat, explained, file_bytes};
use super::{REEXPORT, glb, glb_material, mtl, obj, ply, stl};
use crate::mesh::TriangleMesh;
use gripcast_base::error::Result;
use gripcast_base::files::companions;

/// Bytes in which the header of a PLY file is expected.
const MAX_PLY_HEADER: usize = 1 << 16;

/// A mesh with the appearance given in its file.
#[derive(Clone, Debug, Default)]
pub struct TexturedMesh {
    /// Parts with one material each.
    pub parts: Vec<MeshPart>,
    /// Materials of the parts.
    pub materials: Vec<MeshMaterial>,
    /// Ignored or replaced content, for the user.
    pub warnings: Vec<String>,
}

/// Triangles with one material. Vertices at seams of texture coordinates or normals are duplicated,
/// so the shape is not necessarily closed.
#[derive(Clone, Debug)]
pub struct MeshPart {
    /// Positions in the frame of the file (m) and triangles.
    pub shape: TriangleMesh,
    /// Unit normal of each vertex.
    pub normals: Option<Vec<DVec3>>,
    /// Texture coordinates of each vertex: u to the right, v downwards, (0, 0) at the outer corner
    /// of the top-left pixel; the image repeats with period 1.
    pub uvs: Option<Vec<[f64; 2]>>,
    /// Index into the materials.
    pub material: Option<usize>,
}

impl From<TriangleMesh> for TexturedMesh {
    /// One part without material, normals and texture coordinates.
    fn from(shape: TriangleMesh) -> Self {
        Self {
            parts: vec![MeshPart {
                shape,
                normals: None,
                uvs: None,
                material: None,
            }],
            ..Self::default()
        }
    }
}

/// Reads a mesh file with its appearance; coordinates are in `unit`, the result is in metres and in
/// the frame of [`load_mesh`](super::load_mesh).
///
/// Missing or invalid appearance (material library, texture coordinates) becomes a warning. Images
/// are not read.
///
/// # Errors
/// Those of [`load_mesh`](super::load_mesh).
pub fn load_textured_mesh(path: &Path, unit: LengthUnit) -> Result<TexturedMesh> {
    let format = MeshFormat::from_path(path)?;
    let bytes = file_bytes(path)?;
    let mut mesh =
        read_textured_mesh(&bytes, format, &companions(path)).map_err(|e| e.at(path.display()))?;
    for part in &mut mesh.parts {
        part.shape = part.shape.scaled(unit.in_metres());
    }
    Ok(mesh)
}

/// Parses a mesh with its appearance; coordinates keep the unit of the file. `companions` reads a
/// file that the mesh refers to by a relative path (material library, buffer).
///
/// # Errors
/// `Input` for invalid content.
pub fn read_textured_mesh(
    bytes: &[u8],
    format: MeshFormat,
    companions: Companions<'_>,
) -> Result<TexturedMesh> {
    let read = read_textured(bytes, format, companions);
    read.map_err(|error| explained(error, bytes, format))
}

fn read_textured(
    bytes: &[u8],
    format: MeshFormat,
    companions: Companions<'_>,
) -> Result<TexturedMesh> {
    let mut mesh = match format {
        MeshFormat::Obj => read_obj(bytes, companions)?,
        MeshFormat::Gltf => read_gltf(bytes, companions)?,
        MeshFormat::Stl => stl::read(bytes)?.into(),
        MeshFormat::Ply => ply::read(bytes)?.into(),
    };
    if mesh
        .parts
        .iter()
        .all(|part| part.shape.triangles.is_empty())
    {
        let all = mesh.parts.iter().map(|part| &part.shape);
        let joined = all.fold(TriangleMesh::default(), |all, part| all.joined(part));
        require_triangles(&joined)?;
    }
    if has_vertex_colours(bytes, format) {
        mesh.warnings.push(
            "vertex colours are not supported and are ignored; bake them into a texture"
                .to_string(),
        );
    }
    mesh.parts.retain(|part| !part.shape.triangles.is_empty());
    for part in &mut mesh.parts {
        part.shape.validate().map_err(|e| e.remedy(REEXPORT))?;
        if part.material.is_some_and(|m| m >= mesh.materials.len()) {
            part.material = None;
        }
    }
    Ok(mesh)
}

/// Whether the vertices of a file have colours: `red` in a PLY header, `COLOR_0` in a glTF, six
/// numbers in the first `v` of an OBJ.
fn has_vertex_colours(bytes: &[u8], format: MeshFormat) -> bool {
    let contains = |bytes: &[u8], word: &[u8]| bytes.windows(word.len()).any(|w| w == word);
    match format {
        MeshFormat::Ply => {
            let header = &bytes[..bytes.len().min(MAX_PLY_HEADER)];
            let end = header.windows(10).position(|w| w == b"end_header");
            contains(&header[..end.unwrap_or(header.len())], b" red")
        }
        MeshFormat::Gltf => glb::split(bytes).is_ok_and(|(json, _)| contains(json, b"\"COLOR_0\"")),
        MeshFormat::Obj => {
            let first = bytes
                .split(|b| *b == b'\n')
                .find(|line| line.starts_with(b"v "));
            let words = first.unwrap_or_default().split(u8::is_ascii_whitespace);
            words.filter(|word| !word.is_empty()).count() == 7
        }
        MeshFormat::Stl => false,
    }
}

fn read_gltf(bytes: &[u8], companions: Companions<'_>) -> Result<TexturedMesh> {
    let gltf = glb::Gltf::open(bytes, companions)?;
    let (json, _) = glb::split(bytes)?;
    let mut warnings = Vec::new();
    let materials = glb_material::read(json, &gltf, &mut warnings);
    Ok(TexturedMesh {
        parts: gltf.parts()?,
        materials,
        warnings,
    })
}

fn read_obj(bytes: &[u8], companions: Companions<'_>) -> Result<TexturedMesh> {
    let file = obj::parse(bytes)?;
    let mut warnings = Vec::new();
    if file.dangling > 0 {
        warnings.push(format!(
            "{} corners refer to an invalid texture coordinate or normal, which is ignored",
            file.dangling
        ));
    }
    let library = read_libraries(&file, companions, &mut warnings);
    let mut materials = Vec::new();
    let mut of_name = |name: &String| {
        let by = |is: &dyn Fn(&str) -> bool| library.iter().find(|entry| is(&entry.name));
        let entry = by(&|entry| entry == name)
            .or_else(|| by(&|entry| entry.to_lowercase() == name.to_lowercase()))?;
        materials.push(entry.clone());
        Some(materials.len() - 1)
    };
    // Index into `materials` of each name of the file.
    let found: Vec<Option<usize>> = file.material_names.iter().map(&mut of_name).collect();
    if file.libraries.is_empty() && !file.material_names.is_empty() {
        warnings
            .push("the file uses materials but names no material library (`mtllib`)".to_string());
    } else {
        let missing =
            |(name, _): (&String, _)| format!("material {name:?} is not defined in a library");
        let names = file.material_names.iter().zip(&found);
        warnings.extend(names.filter(|(_, m)| m.is_none()).map(missing));
    }
    let parts = split_by_material(&file)
        .into_iter()
        .map(|(name, triangles)| {
            let mut part = obj_part(&file, &triangles);
            part.material = name.and_then(|index| found[index as usize]);
            part
        });
    Ok(TexturedMesh {
        parts: parts.collect(),
        materials,
        warnings,
    })
}

fn read_libraries(
    file: &ObjFile,
    companions: Companions<'_>,
    warnings: &mut Vec<String>,
) -> Vec<MeshMaterial> {
    let mut all = Vec::new();
    let read = |name: &str| companions(&name.replace('\\', "/"));
    // A name may contain blanks, and a statement may list several files.
    let names = file.libraries.iter().flat_map(|names| match read(names) {
        Err(_) if names.contains(' ') => names.split_whitespace().collect(),
        _ => vec![names.as_str()],
    });
    for name in names {
        match read(name) {
            Ok(bytes) => {
                let mut messages = Vec::new();
                let materials = mtl::read(&bytes, &mut messages);
                if materials.is_empty() {
                    messages.push("no materials defined".to_string());
                }
                warnings.extend(messages.into_iter().map(|text| format!("{name}: {text}")));
                all.extend(materials);
            }
            Err(error) => warnings.push(format!(
                "cannot read the material library {name:?} ({error}); keep it beside the .obj"
            )),
        }
    }
    all
}

/// Groups triangles by material, in the order of first use.
fn split_by_material(file: &ObjFile) -> Vec<(Option<u32>, Vec<[Corner; 3]>)> {
    let mut parts: Vec<(Option<u32>, Vec<[Corner; 3]>)> = Vec::new();
    let mut last = 0;
    for (corners, material) in file.triangles.iter().zip(&file.materials) {
        if parts.get(last).is_none_or(|part| part.0 != *material) {
            let index = parts.iter().position(|part| part.0 == *material);
            last = index.unwrap_or_else(|| {
                parts.push((*material, Vec::new()));
                parts.len() - 1
            });
        }
        parts[last].1.push(*corners);
    }
    parts
}

/// Part with one vertex per distinct corner.
fn obj_part(file: &ObjFile, triangles: &[[Corner; 3]]) -> MeshPart {
    let has_uvs = triangles.iter().flatten().all(|c| c.uv.is_some());
    let has_normals = triangles.iter().flatten().all(|c| c.normal.is_some());
    let mut vertex_of: HashMap<Corner, u32> = HashMap::new();
    let mut corners = Vec::new();
    let indexed = triangles.iter().map(|triangle| {
        triangle.map(|corner| {
            let key = Corner {
                position: corner.position,
                uv: corner.uv.filter(|_| has_uvs),
                normal: corner.normal.filter(|_| has_normals),
            };
            *vertex_of.entry(key).or_insert_with(|| {
                corners.push(key);
                corners.len() as u32 - 1
            })
        })
    });
    let triangles = indexed.collect();
    let uv = |c: &Corner| {
        c.uv.map(|i| file.uvs[i as usize])
            .map(|[u, v]| [u, 1.0 - v])
    };
    let normal = |c: &Corner| {
        c.normal
            .and_then(|i| file.normals[i as usize].try_normalize())
    };
    MeshPart {
        uvs: has_uvs.then(|| corners.iter().filter_map(uv).collect()),
        normals: has_normals.then(|| corners.iter().filter_map(normal).collect()),
        shape: TriangleMesh {
            vertices: corners
                .iter()
                .map(|c| file.positions[c.position as usize])
                .collect(),
            triangles,
        },
        material: None,
    }
}

#[cfg(test)]
#[path = "textured_test.rs"]
mod tests;
