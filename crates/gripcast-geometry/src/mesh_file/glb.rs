//! glTF 2.0, binary and text: the triangles of the default scene.
//!
//! Parsed here because the `gltf` crate panics on damaged documents.

use base64::Engine as _;
use base64::engine::general_purpose::STANDARD;
use glam::{DMat3, DMat4, DQuat, DVec3};
use serde::Deserialize;

use super::textured::MeshPart;
use super::{Companions, from_f32, malformed};
use crate::mesh::TriangleMesh;
use gripcast_base::error::{Error, Result};

/// Decodes one coordinate of an element.
type DecodeCoordinate = fn(&[u8], usize) -> f32;

/// Component types of accessors.
const UNSIGNED_BYTE: u32 = 5121;
const UNSIGNED_SHORT: u32 = 5123;
const UNSIGNED_INT: u32 = 5125;
const FLOAT: u32 = 5126;

/// Chunk types of a binary file.
const CHUNK_JSON: &[u8] = b"JSON";
const CHUNK_BIN: &[u8] = b"BIN\0";

#[derive(Default, Deserialize)]
#[serde(rename_all = "camelCase", default)]
struct Document {
    scene: Option<usize>,
    scenes: Vec<Scene>,
    nodes: Vec<Node>,
    meshes: Vec<Mesh>,
    accessors: Vec<Accessor>,
    buffer_views: Vec<BufferView>,
    buffers: Vec<Buffer>,
}

#[derive(Deserialize)]
struct Scene {
    #[serde(default)]
    nodes: Vec<usize>,
}

#[derive(Deserialize)]
struct Node {
    mesh: Option<usize>,
    #[serde(default)]
    children: Vec<usize>,
    /// Column-major; replaces the other three.
    matrix: Option<[f64; 16]>,
    translation: Option<[f64; 3]>,
    /// x, y, z, w.
    rotation: Option<[f64; 4]>,
    scale: Option<[f64; 3]>,
}

#[derive(Deserialize)]
struct Mesh {
    #[serde(default)]
    primitives: Vec<Primitive>,
}

#[derive(Deserialize)]
struct Primitive {
    attributes: Attributes,
    indices: Option<usize>,
    material: Option<usize>,
    #[serde(default = "triangle_list")]
    mode: u32,
}

/// Default mode.
fn triangle_list() -> u32 {
    4
}

#[derive(Deserialize)]
struct Attributes {
    #[serde(rename = "POSITION")]
    position: Option<usize>,
    #[serde(rename = "NORMAL")]
    normal: Option<usize>,
    #[serde(rename = "TEXCOORD_0")]
    uv: Option<usize>,
}

#[derive(Deserialize)]
#[serde(rename_all = "camelCase")]
struct Accessor {
    buffer_view: Option<usize>,
    #[serde(default)]
    byte_offset: usize,
    component_type: u32,
    count: usize,
    #[serde(rename = "type")]
    dimensions: String,
    sparse: Option<serde::de::IgnoredAny>,
}

#[derive(Deserialize)]
#[serde(rename_all = "camelCase")]
struct BufferView {
    buffer: usize,
    #[serde(default)]
    byte_offset: usize,
    byte_length: usize,
    byte_stride: Option<usize>,
}

#[derive(Deserialize)]
struct Buffer {
    uri: Option<String>,
}

/// A document with the bytes of its buffers.
pub(super) struct Gltf {
    document: Document,
    buffers: Vec<Vec<u8>>,
}

/// Parses the document and joins all its triangles in the scene frame.
pub(super) fn read(bytes: &[u8], companions: Companions<'_>) -> Result<TriangleMesh> {
    let gltf = Gltf::open(bytes, companions)?;
    let mut mesh = TriangleMesh::default();
    for (primitive, t_scene_node) in gltf.primitives()? {
        if let Some(shape) = gltf.shape(primitive, &t_scene_node)? {
            mesh.append(&shape);
        }
    }
    Ok(mesh)
}

impl Gltf {
    /// Parses the document and reads its buffers.
    pub(super) fn open(bytes: &[u8], companions: Companions<'_>) -> Result<Self> {
        let (json, blob) = split(bytes)?;
        let document: Document = serde_json::from_slice(json)
            .map_err(|e| malformed("invalid glTF document").because(e))?;
        let buffers = document
            .buffers
            .iter()
            .map(|buffer| buffer_bytes(buffer, blob, companions))
            .collect::<Result<Vec<_>>>()?;
        Ok(Self { document, buffers })
    }

    /// All primitives with normals and texture coordinates, in the scene frame.
    pub(super) fn parts(&self) -> Result<Vec<MeshPart>> {
        let mut parts = Vec::new();
        for (primitive, t_scene_node) in self.primitives()? {
            let Some(shape) = self.shape(primitive, &t_scene_node)? else {
                continue;
            };
            let count = shape.vertices.len();
            let to_scene = DMat3::from_mat4(t_scene_node).inverse().transpose();
            let normals = primitive.attributes.normal.and_then(|index| {
                let all = self.vectors(index, "normals").ok()?;
                let units = all.into_iter().map(|n| (to_scene * n).try_normalize());
                units.collect::<Option<Vec<_>>>()
            });
            let uvs = primitive.attributes.uv.map(|index| self.uvs(index));
            parts.push(MeshPart {
                shape,
                normals: normals.filter(|n| n.len() == count),
                uvs: uvs.transpose()?.filter(|uvs| uvs.len() == count),
                material: primitive.material,
            });
        }
        Ok(parts)
    }

    /// The bytes of a buffer view.
    pub(super) fn view(&self, index: usize) -> Option<&[u8]> {
        let view = self.document.buffer_views.get(index)?;
        let end = view.byte_offset.checked_add(view.byte_length)?;
        self.buffers.get(view.buffer)?.get(view.byte_offset..end)
    }

    /// Primitives of the default scene with the transforms of their nodes.
    fn primitives(&self) -> Result<Vec<(&Primitive, DMat4)>> {
        let mut all = Vec::new();
        for (node, t_scene_node) in scene_nodes(&self.document)? {
            let Some(index) = node.mesh else { continue };
            let mesh = item(&self.document.meshes, index, "mesh")?;
            all.extend(mesh.primitives.iter().map(|p| (p, t_scene_node)));
        }
        Ok(all)
    }
}

/// Splits either form into the JSON document and the binary blob.
pub(super) fn split(bytes: &[u8]) -> Result<(&[u8], Option<&[u8]>)> {
    if bytes.starts_with(b"glTF") {
        chunks(bytes)
    } else {
        Ok((bytes, None))
    }
}

/// Looks up an object of the document by its index.
fn item<'a, T>(items: &'a [T], index: usize, kind: &str) -> Result<&'a T> {
    items.get(index).ok_or_else(|| {
        malformed(format!(
            "the glTF refers to {kind} {index}, but has only {}",
            items.len()
        ))
    })
}

/// JSON document and binary blob of a `.glb` file.
fn chunks(bytes: &[u8]) -> Result<(&[u8], Option<&[u8]>)> {
    let word = |offset: usize| -> Option<usize> {
        let word: [u8; 4] = bytes.get(offset..offset + 4)?.try_into().ok()?;
        usize::try_from(u32::from_le_bytes(word)).ok()
    };
    let chunk = |offset: usize, kind: &[u8]| -> Option<(&[u8], usize)> {
        let end = offset + 8 + word(offset)?;
        let is_kind = bytes.get(offset + 4..offset + 8)? == kind;
        is_kind.then_some((bytes.get(offset + 8..end)?, end))
    };
    let found = chunk(12, CHUNK_JSON).filter(|_| word(4) == Some(2));
    let (json, end) =
        found.ok_or_else(|| malformed("a .glb must have version 2 and contain a document"))?;
    Ok((json, chunk(end, CHUNK_BIN).map(|(blob, _)| blob)))
}

/// Bytes of a buffer: the blob, a data URI, or a companion file.
fn buffer_bytes(
    buffer: &Buffer,
    blob: Option<&[u8]>,
    companions: Companions<'_>,
) -> Result<Vec<u8>> {
    let Some(uri) = &buffer.uri else {
        let missing = || malformed("the binary chunk of the .glb is missing or truncated");
        return blob.map(<[u8]>::to_vec).ok_or_else(missing);
    };
    if let Some(decoded) = decode_data_uri(uri) {
        return decoded.map_err(|e| malformed("a data URI is not valid base64").because(e));
    }
    companions(&uri.replace("%20", " ")).map_err(|e| {
        Error::io("cannot read the buffer of the glTF", e)
            .at(uri)
            .remedy("keep the .bin file beside the .gltf, or export a .glb")
    })
}

/// Decodes the base64 data of a data URI; `None` for another URI.
pub(super) fn decode_data_uri(uri: &str) -> Option<Result<Vec<u8>, base64::DecodeError>> {
    let data = uri.strip_prefix("data:")?;
    let encoded = data.split_once("base64,").map_or("", |(_, text)| text);
    Some(STANDARD.decode(encoded))
}

/// Nodes of the default (else the first) scene with their transforms into it.
fn scene_nodes(document: &Document) -> Result<Vec<(&Node, DMat4)>> {
    let scene = item(&document.scenes, document.scene.unwrap_or(0), "scene")?;
    let mut visited = vec![false; document.nodes.len()];
    let mut open: Vec<_> = scene.nodes.iter().map(|&n| (n, DMat4::IDENTITY)).collect();
    open.reverse();
    let mut nodes = Vec::new();
    while let Some((index, t_scene_parent)) = open.pop() {
        let node = item(&document.nodes, index, "node")?;
        if std::mem::replace(&mut visited[index], true) {
            return Err(malformed(format!("node {index} has more than one parent")));
        }
        let t_scene_node = t_scene_parent * transform(node);
        open.extend(node.children.iter().map(|&child| (child, t_scene_node)));
        nodes.push((node, t_scene_node));
    }
    Ok(nodes)
}

/// Transform from a node into its parent.
fn transform(node: &Node) -> DMat4 {
    if let Some(columns) = node.matrix {
        return DMat4::from_cols_array(&columns);
    }
    DMat4::from_scale_rotation_translation(
        node.scale.map_or(DVec3::ONE, DVec3::from_array),
        node.rotation.map_or(DQuat::IDENTITY, DQuat::from_array),
        node.translation.map_or(DVec3::ZERO, DVec3::from_array),
    )
}

impl Gltf {
    /// Triangles of a primitive in the scene frame; `None` without positions, empty for lines and
    /// points.
    fn shape(&self, primitive: &Primitive, t_scene_node: &DMat4) -> Result<Option<TriangleMesh>> {
        let Some(index) = primitive.attributes.position else {
            return Ok(None);
        };
        let positions = self.vectors(index, "positions")?;
        let corners = match primitive.indices {
            Some(index) => self.indices(index)?,
            None => (0..positions.len() as u32).collect(),
        };
        let mut triangles = assemble(primitive.mode, &corners);
        let count = positions.len();
        if let Some(bad) = triangles.iter().flatten().find(|&&v| v as usize >= count) {
            return Err(malformed(format!(
                "a triangle refers to vertex {bad}, but the primitive has only {count}"
            )));
        }
        if t_scene_node.determinant() < 0.0 {
            triangles.iter_mut().for_each(|t| t.swap(0, 1));
        }
        let vertices = positions
            .iter()
            .map(|&p| (*t_scene_node * p.extend(1.0)).truncate());
        Ok(Some(TriangleMesh {
            vertices: vertices.collect(),
            triangles,
        }))
    }

    /// Vectors of an accessor, which must be VEC3 of floats.
    fn vectors(&self, index: usize, what: &str) -> Result<Vec<DVec3>> {
        let accessor = item(&self.document.accessors, index, "accessor")?;
        if (accessor.component_type, accessor.dimensions.as_str()) != (FLOAT, "VEC3") {
            return Err(malformed(format!(
                "{what} must be VEC3 of 32-bit floats ({FLOAT}), found {} of {}",
                accessor.dimensions, accessor.component_type
            )));
        }
        let elements = self.elements(index, 12)?;
        Ok(elements
            .map(|bytes| from_f32([0, 4, 8].map(|offset| float(bytes, offset))))
            .collect())
    }

    /// Texture coordinates: floats, or normalised integers.
    fn uvs(&self, index: usize) -> Result<Vec<[f64; 2]>> {
        let accessor = item(&self.document.accessors, index, "accessor")?;
        let (size, coordinate): (usize, DecodeCoordinate) =
            match (accessor.component_type, accessor.dimensions.as_str()) {
                (FLOAT, "VEC2") => (4, |bytes, k| float(bytes, 4 * k)),
                (UNSIGNED_BYTE, "VEC2") => (1, |bytes, k| f32::from(bytes[k]) / 255.0),
                (UNSIGNED_SHORT, "VEC2") => (2, |bytes, k| {
                    f32::from(u16::from_le_bytes([bytes[2 * k], bytes[2 * k + 1]])) / 65535.0
                }),
                (found, dimensions) => {
                    return Err(malformed(format!(
                        "texture coordinates must be VEC2 of floats or normalised integers, \
                         found {dimensions} of {found}"
                    )));
                }
            };
        let elements = self.elements(index, 2 * size)?;
        Ok(elements
            .map(|bytes| [0, 1].map(|k| f64::from(coordinate(bytes, k))))
            .collect())
    }

    fn indices(&self, index: usize) -> Result<Vec<u32>> {
        let accessor = item(&self.document.accessors, index, "accessor")?;
        let size = match (accessor.component_type, accessor.dimensions.as_str()) {
            (UNSIGNED_BYTE, "SCALAR") => 1,
            (UNSIGNED_SHORT, "SCALAR") => 2,
            (UNSIGNED_INT, "SCALAR") => 4,
            (found, dimensions) => {
                return Err(malformed(format!(
                    "indices must be SCALAR unsigned integers, found {dimensions} of {found}"
                )));
            }
        };
        let decode = |bytes: &[u8]| {
            let digits = bytes.iter().rev();
            digits.fold(0, |value, &byte| (value << 8) | u32::from(byte))
        };
        Ok(self.elements(index, size)?.map(decode).collect())
    }

    /// Bytes of each element of an accessor, checked against its buffer.
    fn elements(&self, index: usize, size: usize) -> Result<impl Iterator<Item = &[u8]>> {
        let accessor = item(&self.document.accessors, index, "accessor")?;
        let bytes = self.accessor_bytes(accessor, size);
        let (bytes, stride) = bytes.map_err(|e| e.at(format!("accessor {index}")))?;
        Ok(bytes.chunks(stride).map(move |element| &element[..size]))
    }

    /// Bytes of an accessor with elements of `size` bytes, and their stride.
    fn accessor_bytes(&self, accessor: &Accessor, size: usize) -> Result<(&[u8], usize)> {
        let (Some(view), None) = (accessor.buffer_view, &accessor.sparse) else {
            return Err(malformed("the mesh data is sparse or compressed")
                .remedy("export the mesh without compression"));
        };
        let view = item(&self.document.buffer_views, view, "bufferView")?;
        let buffer = item(&self.buffers, view.buffer, "buffer")?;
        let (count, stride) = (accessor.count, view.byte_stride.unwrap_or(size));
        let slice = || {
            let view_end = view.byte_offset.checked_add(view.byte_length)?;
            let start = view.byte_offset.checked_add(accessor.byte_offset)?;
            let span = stride
                .checked_mul(count.checked_sub(1)?)?
                .checked_add(size)?;
            let end = start.checked_add(span)?;
            (end <= view_end && stride >= size).then_some(())?;
            buffer.get(start..end)
        };
        let bytes = slice().ok_or_else(|| {
            malformed(format!(
                "{count} elements of {size} bytes are declared, more than the buffer holds"
            ))
        })?;
        Ok((bytes, stride))
    }
}

fn float(bytes: &[u8], offset: usize) -> f32 {
    f32::from_le_bytes([0, 1, 2, 3].map(|i| bytes[offset + i]))
}

/// Triangles of a list (mode 4), strip (5) or fan (6); none for other modes.
fn assemble(mode: u32, corners: &[u32]) -> Vec<[u32; 3]> {
    match mode {
        4 => corners
            .chunks_exact(3)
            .map(|c| [c[0], c[1], c[2]])
            .collect(),
        5 => corners
            .windows(3)
            .enumerate()
            .map(|(i, c)| match i % 2 {
                0 => [c[0], c[1], c[2]],
                _ => [c[1], c[0], c[2]],
            })
            .collect(),
        6 => corners
            .windows(2)
            .skip(1)
            .map(|c| [corners[0], c[0], c[1]])
            .collect(),
        _ => Vec::new(),
    }
}
