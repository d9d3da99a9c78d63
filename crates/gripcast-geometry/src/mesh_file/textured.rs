//! Meshes with their materials, normals and texture coordinates, for renderers.

use std::collections::HashMap;
use std::path::Path;

use glam::DVec3;

use super::appearance::MeshMaterial;
use super::obj::{Corner, ObjFile};
use super::{LengthUnit, MeshFormat, file_bytes, refuse_placeholders};
use super::{glb, glb_material, mtl, obj, ply, stl};
use crate::mesh::TriangleMesh;
use gripcast_base::error::{Error, Result};
use gripcast_base::files::companions;

/// A mesh as its file says it looks.
#[derive(Clone, Debug, Default)]
pub struct TexturedMesh {
    /// Parts of one material each.
    pub parts: Vec<MeshPart>,
    /// Materials that the parts name.
    pub materials: Vec<MeshMaterial>,
    /// What could not be read and was left out or replaced, in words.
    pub warnings: Vec<String>,
}

/// Triangles of one material. Vertices at seams of texture coordinates or normals are there more
/// than once, so that the shape need not be closed.
#[derive(Clone, Debug)]
pub struct MeshPart {
    /// Positions in the frame of the file, m, and triangles.
    pub shape: TriangleMesh,
    /// Unit normals, one for each vertex.
    pub normals: Option<Vec<DVec3>>,
    /// Texture coordinates, one for each vertex: u to the right, v downwards, (0, 0) the outer
    /// corner of the top-left pixel, the image repeats every 1.
    pub uvs: Option<Vec<[f64; 2]>>,
    /// Index into the materials; none where the file names none.
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

/// Reads a mesh file with its looks; coordinates are in `unit`, the result is in metres and in
/// the frame of [`load_mesh`](super::load_mesh).
///
/// What is missing or damaged beside the shape (material library, texture coordinates that do not
/// exist) becomes a warning. Images are named, not read.
///
/// # Errors
/// Those of [`load_mesh`](super::load_mesh).
pub fn load_textured_mesh(path: &Path, unit: LengthUnit) -> Result<TexturedMesh> {
    let format = MeshFormat::of_path(path)?;
    let bytes = file_bytes(path)?;
    let mut mesh =
        read_textured_mesh(&bytes, format, &companions(path)).map_err(|e| e.at(path.display()))?;
    for part in &mut mesh.parts {
        part.shape = part.shape.scaled(unit.in_metres());
    }
    Ok(mesh)
}

/// Parses a mesh with its looks; coordinates stay in the unit of the file. `beside` reads a file
/// that the mesh refers to by a relative path (material library, buffer).
///
/// # Errors
/// `Input` if the content is no mesh.
pub fn read_textured_mesh(
    bytes: &[u8],
    format: MeshFormat,
    beside: &dyn Fn(&str) -> std::io::Result<Vec<u8>>,
) -> Result<TexturedMesh> {
    refuse_placeholders(bytes)?;
    let mut mesh = match format {
        MeshFormat::Obj => read_obj(bytes, beside)?,
        MeshFormat::Gltf => read_gltf(bytes, beside)?,
        MeshFormat::Stl => stl::read(bytes)?.into(),
        MeshFormat::Ply => ply::read(bytes)?.into(),
    };
    mesh.parts.retain(|part| !part.shape.triangles.is_empty());
    if mesh.parts.is_empty() {
        return Err(Error::input("the mesh has no triangles")
            .remedy("check that the file was copied whole, or export the mesh again"));
    }
    for part in &mut mesh.parts {
        part.shape.validate().map_err(|e| {
            e.remedy("check that the file was copied whole, or export the mesh again")
        })?;
        if part.material.is_some_and(|m| m >= mesh.materials.len()) {
            part.material = None;
        }
    }
    Ok(mesh)
}

fn read_gltf(
    bytes: &[u8],
    beside: &dyn Fn(&str) -> std::io::Result<Vec<u8>>,
) -> Result<TexturedMesh> {
    let gltf = glb::Gltf::open(bytes, beside)?;
    let (json, _) = glb::parts(bytes)?;
    let mut warnings = Vec::new();
    let materials = glb_material::read(json, &gltf, &mut warnings);
    let parts = gltf.pieces()?.into_iter().map(|piece| MeshPart {
        shape: piece.shape,
        normals: piece.normals,
        uvs: piece.uvs,
        material: piece.material,
    });
    Ok(TexturedMesh {
        parts: parts.collect(),
        materials,
        warnings,
    })
}

fn read_obj(
    bytes: &[u8],
    beside: &dyn Fn(&str) -> std::io::Result<Vec<u8>>,
) -> Result<TexturedMesh> {
    let file = obj::parse(bytes)?;
    let mut warnings = Vec::new();
    if file.dangling > 0 {
        warnings.push(format!(
            "{} corners name a texture coordinate or normal that does not exist; they have none",
            file.dangling
        ));
    }
    let library = read_libraries(&file, beside, &mut warnings);
    let mut materials = Vec::new();
    // Index into `materials` of each name of the file.
    let found: Vec<Option<usize>> = file
        .material_names
        .iter()
        .map(|name| {
            let entry = library.iter().find(|entry| entry.name == *name)?;
            materials.push(entry.clone());
            Some(materials.len() - 1)
        })
        .collect();
    if !file.libraries.is_empty() {
        let missing = |(name, _): (&String, _)| format!("no library defines material {name:?}");
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
    beside: &dyn Fn(&str) -> std::io::Result<Vec<u8>>,
    warnings: &mut Vec<String>,
) -> Vec<MeshMaterial> {
    let mut all = Vec::new();
    for name in &file.libraries {
        match beside(&name.replace('\\', "/")) {
            Ok(bytes) => {
                let mut told = Vec::new();
                let read = mtl::read(&bytes, &mut told);
                if read.is_empty() {
                    told.push("no material is defined in it".to_string());
                }
                warnings.extend(told.into_iter().map(|text| format!("{name}: {text}")));
                all.extend(read);
            }
            Err(error) => warnings.push(format!(
                "the material library {name:?} cannot be read ({error}); keep it beside the .obj"
            )),
        }
    }
    all
}

/// Triangles of each material in the order of their first use.
fn split_by_material(file: &ObjFile) -> Vec<(Option<u32>, Vec<[Corner; 3]>)> {
    let mut parts: Vec<(Option<u32>, Vec<[Corner; 3]>)> = Vec::new();
    let mut last = 0;
    for (corners, material) in file.triangles.iter().zip(&file.materials) {
        if parts.get(last).is_none_or(|part| part.0 != *material) {
            let known = parts.iter().position(|part| part.0 == *material);
            last = known.unwrap_or_else(|| {
                parts.push((*material, Vec::new()));
                parts.len() - 1
            });
        }
        parts[last].1.push(*corners);
    }
    parts
}

/// One vertex for each distinct corner.
fn obj_part(file: &ObjFile, triangles: &[[Corner; 3]]) -> MeshPart {
    let has_uvs = triangles.iter().flatten().all(|c| c.uv.is_some());
    let has_normals = triangles.iter().flatten().all(|c| c.normal.is_some());
    let mut vertex_of: HashMap<Corner, u32> = HashMap::new();
    let mut corners = Vec::new();
    let renamed = triangles.iter().map(|triangle| {
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
    let triangles = renamed.collect();
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
