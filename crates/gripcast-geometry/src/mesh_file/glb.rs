//! glTF 2.0, binary and text: the triangles of the default scene.
//!
//! The few objects that carry shape are read here; the `gltf` crate indexes out of bounds while
//! it validates damaged documents.

use base64::Engine as _;
use base64::engine::general_purpose::STANDARD;
use glam::{DMat3, DMat4, DQuat, DVec3};
use serde::Deserialize;

use super::{from_f32, malformed};
use crate::mesh::TriangleMesh;
use gripcast_base::error::{Error, Result};

/// Reads one coordinate of an element.
type ReadPart = fn(&[u8], usize) -> f32;

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
    material: Option<usize>,
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

/// The triangles of one primitive in the frame of the scene.
pub(super) struct Piece {
    pub(super) shape: TriangleMesh,
    /// Unit normals, one for each vertex.
    pub(super) normals: Option<Vec<DVec3>>,
    /// One for each vertex; u to the right, v downwards.
    pub(super) uvs: Option<Vec<[f64; 2]>>,
    pub(super) material: Option<usize>,
}

/// Parses the document and joins all its triangles in the frame of the scene.
pub(super) fn read(bytes: &[u8], beside: Beside<'_>) -> Result<TriangleMesh> {
    let gltf = Gltf::open(bytes, beside)?;
    let mut mesh = TriangleMesh::default();
    for (primitive, t_scene_node) in gltf.primitives()? {
        if let Some(shape) = gltf.shape(primitive, &t_scene_node)? {
            let offset = mesh.vertices.len() as u32;
            mesh.vertices.extend(shape.vertices);
            let triangles = shape.triangles.into_iter();
            mesh.triangles
                .extend(triangles.map(|t| t.map(|v| v + offset)));
        }
    }
    Ok(mesh)
}

impl Gltf {
    /// Parses the document and gathers its buffers.
    pub(super) fn open(bytes: &[u8], beside: Beside<'_>) -> Result<Self> {
        let (json, blob) = parts(bytes)?;
        let document: Document = serde_json::from_slice(json)
            .map_err(|e| malformed("the glTF cannot be read").because(e))?;
        let buffers = document
            .buffers
            .iter()
            .map(|buffer| contents(buffer, blob, beside))
            .collect::<Result<Vec<_>>>()?;
        Ok(Self { document, buffers })
    }

    /// All primitives with normals and texture coordinates, placed in the scene.
    pub(super) fn pieces(&self) -> Result<Vec<Piece>> {
        let mut pieces = Vec::new();
        for (primitive, t_scene_node) in self.primitives()? {
            let Some(shape) = self.shape(primitive, &t_scene_node)? else {
                continue;
            };
            let count = shape.vertices.len();
            let turn = DMat3::from_mat4(t_scene_node).inverse().transpose();
            let normals = primitive.attributes.normal.and_then(|index| {
                let all = self.normals(index).ok()?;
                let placed = all.into_iter().map(|n| (turn * n).try_normalize());
                placed.collect::<Option<Vec<_>>>()
            });
            let uvs = primitive.attributes.uv.map(|index| self.uvs(index));
            pieces.push(Piece {
                shape,
                normals: normals.filter(|n| n.len() == count),
                uvs: uvs.transpose()?.filter(|uvs| uvs.len() == count),
                material: primitive.material,
            });
        }
        Ok(pieces)
    }

    /// The bytes of a buffer view.
    pub(super) fn view(&self, index: usize) -> Option<&[u8]> {
        let view = self.document.buffer_views.get(index)?;
        let end = view.byte_offset.checked_add(view.byte_length)?;
        self.buffers.get(view.buffer)?.get(view.byte_offset..end)
    }

    /// Primitives of the default scene with the place of their nodes in it.
    fn primitives(&self) -> Result<Vec<(&Primitive, DMat4)>> {
        let mut all = Vec::new();
        for (node, t_scene_node) in placed_nodes(&self.document)? {
            let Some(index) = node.mesh else { continue };
            let mesh = item(&self.document.meshes, index, "mesh")?;
            all.extend(mesh.primitives.iter().map(|p| (p, t_scene_node)));
        }
        Ok(all)
    }
}

/// The document and the binary part of either form.
pub(super) fn parts(bytes: &[u8]) -> Result<(&[u8], Option<&[u8]>)> {
    if bytes.starts_with(b"glTF") {
        chunks(bytes)
    } else {
        Ok((bytes, None))
    }
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

impl Gltf {
    /// Triangles of a primitive in the frame of the scene; none for lines, points and primitives
    /// without positions.
    fn shape(&self, primitive: &Primitive, t_scene_node: &DMat4) -> Result<Option<TriangleMesh>> {
        let Some(index) = primitive.attributes.position else {
            return Ok(None);
        };
        let positions = self.positions(index)?;
        let corners = match primitive.indices {
            Some(index) => indices(&self.document, index, &self.buffers)?,
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
        let placed = positions
            .iter()
            .map(|&p| (*t_scene_node * p.extend(1.0)).truncate());
        Ok(Some(TriangleMesh {
            vertices: placed.collect(),
            triangles,
        }))
    }

    fn positions(&self, index: usize) -> Result<Vec<DVec3>> {
        let accessor = item(&self.document.accessors, index, "accessor")?;
        if (accessor.component_type, accessor.dimensions.as_str()) != (FLOAT, "VEC3") {
            return Err(malformed(format!(
                "positions must be VEC3 of 32-bit floats ({FLOAT}), found {} of {}",
                accessor.dimensions, accessor.component_type
            )));
        }
        self.vectors(index)
    }

    /// Normals in the frame of the node.
    fn normals(&self, index: usize) -> Result<Vec<DVec3>> {
        let accessor = item(&self.document.accessors, index, "accessor")?;
        if (accessor.component_type, accessor.dimensions.as_str()) != (FLOAT, "VEC3") {
            return Err(malformed("normals must be VEC3 of 32-bit floats"));
        }
        self.vectors(index)
    }

    /// An accessor that is known to be VEC3 of floats.
    fn vectors(&self, index: usize) -> Result<Vec<DVec3>> {
        let accessor = item(&self.document.accessors, index, "accessor")?;
        let all = elements(&self.document, accessor, 12, &self.buffers);
        Ok(all
            .map_err(|e| e.at(format!("accessor {index}")))?
            .map(|bytes| from_f32([0, 4, 8].map(|at| float(bytes, at))))
            .collect())
    }

    /// Texture coordinates: floats, or integers that stand for 0 to 1.
    fn uvs(&self, index: usize) -> Result<Vec<[f64; 2]>> {
        let accessor = item(&self.document.accessors, index, "accessor")?;
        let read: (usize, ReadPart) = match (accessor.component_type, accessor.dimensions.as_str())
        {
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
        let (size, part) = read;
        let all = elements(&self.document, accessor, 2 * size, &self.buffers);
        Ok(all
            .map_err(|e| e.at(format!("accessor {index}")))?
            .map(|bytes| [0, 1].map(|k| f64::from(part(bytes, k))))
            .collect())
    }
}

fn float(bytes: &[u8], at: usize) -> f32 {
    f32::from_le_bytes([bytes[at], bytes[at + 1], bytes[at + 2], bytes[at + 3]])
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
