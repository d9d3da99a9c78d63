//! glTF 2.0, binary and text: the triangles of the default scene.
//!
//! The few objects that carry shape are read here; the `gltf` crate indexes out of bounds while
//! it validates damaged documents.

use base64::Engine as _;
use base64::engine::general_purpose::STANDARD;
use glam::{DMat4, DQuat, DVec3};
use serde::Deserialize;

use super::{from_f32, malformed};
use crate::error::{Error, Result};
use crate::geometry::mesh::TriangleMesh;

/// Reads the bytes of a file beside the document.
type Beside<'a> = &'a dyn Fn(&str) -> std::io::Result<Vec<u8>>;

/// Component types of accessors.
const UNSIGNED_BYTE: u32 = 5121;
const UNSIGNED_SHORT: u32 = 5123;
const UNSIGNED_INT: u32 = 5125;
const FLOAT: u32 = 5126;

/// Marks of the chunks of a binary file.
const CHUNK_JSON: &[u8] = b"JSON";
const CHUNK_BIN: &[u8] = b"BIN\0";

#[derive(Deserialize)]
#[serde(rename_all = "camelCase")]
struct Document {
    scene: Option<usize>,
    #[serde(default)]
    scenes: Vec<Scene>,
    #[serde(default)]
    nodes: Vec<Node>,
    #[serde(default)]
    meshes: Vec<Mesh>,
    #[serde(default)]
    accessors: Vec<Accessor>,
    #[serde(default)]
    buffer_views: Vec<BufferView>,
    #[serde(default)]
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
    /// Column by column; in the place of the other three.
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
    #[serde(default = "triangle_list")]
    mode: u32,
}

/// The mode that the format implies.
fn triangle_list() -> u32 {
    4
}

#[derive(Deserialize)]
struct Attributes {
    #[serde(rename = "POSITION")]
    position: Option<usize>,
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

/// Parses the document and joins all its triangles in the frame of the scene.
pub(super) fn read(bytes: &[u8], beside: Beside<'_>) -> Result<TriangleMesh> {
    let (json, blob) = if bytes.starts_with(b"glTF") {
        chunks(bytes)?
    } else {
        (bytes, None)
    };
    let document: Document = serde_json::from_slice(json)
        .map_err(|e| malformed("the glTF cannot be read").because(e))?;
    let buffers = document
        .buffers
        .iter()
        .map(|buffer| contents(buffer, blob, beside))
        .collect::<Result<Vec<_>>>()?;
    let mut mesh = TriangleMesh::default();
    for (node, t_scene_node) in placed_nodes(&document)? {
        let Some(index) = node.mesh else { continue };
        for primitive in &item(&document.meshes, index, "mesh")?.primitives {
            append(&mut mesh, primitive, &document, &buffers, &t_scene_node)?;
        }
    }
    Ok(mesh)
}

/// An object of the document by its index.
fn item<'a, T>(items: &'a [T], index: usize, kind: &str) -> Result<&'a T> {
    items.get(index).ok_or_else(|| {
        malformed(format!(
            "the glTF names {kind} {index}, but has only {}",
            items.len()
        ))
    })
}

/// The document and the binary part of a `.glb` file.
fn chunks(bytes: &[u8]) -> Result<(&[u8], Option<&[u8]>)> {
    let word = |at: usize| -> Option<usize> {
        let word: [u8; 4] = bytes.get(at..at + 4)?.try_into().ok()?;
        usize::try_from(u32::from_le_bytes(word)).ok()
    };
    let chunk = |at: usize, kind: &[u8]| -> Option<(&[u8], usize)> {
        let end = at + 8 + word(at)?;
        let is_kind = bytes.get(at + 4..at + 8)? == kind;
        is_kind.then_some((bytes.get(at + 8..end)?, end))
    };
    let found = chunk(12, CHUNK_JSON).filter(|_| word(4) == Some(2));
    let (json, end) =
        found.ok_or_else(|| malformed("the .glb must be of version 2 and hold a document"))?;
    Ok((json, chunk(end, CHUNK_BIN).map(|(blob, _)| blob)))
}

/// The bytes of a buffer: within the file, in a data URI, or in a file beside it.
fn contents(buffer: &Buffer, blob: Option<&[u8]>, beside: Beside<'_>) -> Result<Vec<u8>> {
    let Some(uri) = &buffer.uri else {
        let missing = || malformed("the binary part of the .glb is missing or cut off");
        return blob.map(<[u8]>::to_vec).ok_or_else(missing);
    };
    if let Some(data) = uri.strip_prefix("data:") {
        let encoded = data.split_once("base64,").map_or("", |(_, text)| text);
        let decoded = STANDARD.decode(encoded);
        return decoded.map_err(|e| malformed("a data URI is not base64").because(e));
    }
    beside(&uri.replace("%20", " ")).map_err(|e| {
        Error::io("cannot read the buffer of the glTF", e)
            .at(uri)
            .remedy("keep the .bin file beside the .gltf, or export a .glb")
    })
}

/// Nodes of the default scene (else the first) with their place in it.
fn placed_nodes(document: &Document) -> Result<Vec<(&Node, DMat4)>> {
    let scene = item(&document.scenes, document.scene.unwrap_or(0), "scene")?;
    let mut visited = vec![false; document.nodes.len()];
    let mut open: Vec<_> = scene.nodes.iter().map(|&n| (n, DMat4::IDENTITY)).collect();
    open.reverse();
    let mut placed = Vec::new();
    while let Some((index, t_scene_parent)) = open.pop() {
        let node = item(&document.nodes, index, "node")?;
        if std::mem::replace(&mut visited[index], true) {
            return Err(malformed(format!("node {index} has more than one parent")));
        }
        let t_scene_node = t_scene_parent * transform(node);
        open.extend(node.children.iter().map(|&child| (child, t_scene_node)));
        placed.push((node, t_scene_node));
    }
    Ok(placed)
}

/// Transform of a node into its parent.
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

/// Appends the triangles of a primitive; lines and points are left out.
fn append(
    mesh: &mut TriangleMesh,
    primitive: &Primitive,
    document: &Document,
    buffers: &[Vec<u8>],
    t_scene_node: &DMat4,
) -> Result<()> {
    let Some(index) = primitive.attributes.position else {
        return Ok(());
    };
    let positions = positions(document, index, buffers)?;
    let corners = match primitive.indices {
        Some(index) => indices(document, index, buffers)?,
        None => (0..positions.len() as u32).collect(),
    };
    let mut triangles = assemble(primitive.mode, &corners);
    let count = positions.len();
    if let Some(bad) = triangles.iter().flatten().find(|&&v| v as usize >= count) {
        return Err(malformed(format!(
            "a triangle names vertex {bad}, but the primitive has {count}"
        )));
    }
    if t_scene_node.determinant() < 0.0 {
        triangles.iter_mut().for_each(|t| t.swap(0, 1));
    }
    let offset = mesh.vertices.len() as u32;
    let placed = positions
        .iter()
        .map(|&p| (*t_scene_node * p.extend(1.0)).truncate());
    mesh.vertices.extend(placed);
    mesh.triangles
        .extend(triangles.into_iter().map(|t| t.map(|v| v + offset)));
    Ok(())
}

/// Triangles of a list (mode 4), strip (5) or fan (6) of corners.
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

fn positions(document: &Document, index: usize, buffers: &[Vec<u8>]) -> Result<Vec<DVec3>> {
    let accessor = item(&document.accessors, index, "accessor")?;
    if (accessor.component_type, accessor.dimensions.as_str()) != (FLOAT, "VEC3") {
        return Err(malformed(format!(
            "positions must be VEC3 of 32-bit floats ({FLOAT}), found {} of {}",
            accessor.dimensions, accessor.component_type
        )));
    }
    let coordinate = |bytes: &[u8], at: usize| {
        f32::from_le_bytes([bytes[at], bytes[at + 1], bytes[at + 2], bytes[at + 3]])
    };
    let position = |bytes: &[u8]| from_f32([0, 4, 8].map(|at| coordinate(bytes, at)));
    let all = elements(document, accessor, 12, buffers);
    Ok(all
        .map_err(|e| e.at(format!("accessor {index}")))?
        .map(position)
        .collect())
}

fn indices(document: &Document, index: usize, buffers: &[Vec<u8>]) -> Result<Vec<u32>> {
    let accessor = item(&document.accessors, index, "accessor")?;
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
    let index_of = |bytes: &[u8]| {
        let digits = bytes.iter().rev();
        digits.fold(0, |value, &byte| (value << 8) | u32::from(byte))
    };
    let all = elements(document, accessor, size, buffers);
    Ok(all
        .map_err(|e| e.at(format!("accessor {index}")))?
        .map(index_of)
        .collect())
}

/// The bytes of each element of an accessor, checked against its buffer.
fn elements<'b>(
    document: &Document,
    accessor: &Accessor,
    size: usize,
    buffers: &'b [Vec<u8>],
) -> Result<impl Iterator<Item = &'b [u8]> + use<'b>> {
    let (Some(view), None) = (accessor.buffer_view, &accessor.sparse) else {
        return Err(malformed("the mesh data is sparse or compressed")
            .remedy("export the mesh without compression"));
    };
    let view = item(&document.buffer_views, view, "bufferView")?;
    let buffer = item(buffers, view.buffer, "buffer")?;
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
            "{count} elements of {size} bytes are announced, more than the buffer holds"
        ))
    })?;
    Ok(bytes.chunks(stride).map(move |element| &element[..size]))
}
