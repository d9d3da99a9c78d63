//! glTF 2.0, binary and text: the triangles of the default scene.
//!
//! Parsed here because the `gltf` crate panics on damaged documents. One file: the types of the format
//! and their readers belong together.

use base64::Engine as _;
use base64::engine::general_purpose::STANDARD;
use glam::{DMat3, DMat4, DQuat, DVec3};
use percent_encoding::percent_decode_str;
use serde::Deserialize;

use super::textured::MeshPart;
use super::{Companions, malformed};
use crate::mesh::TriangleMesh;
use gripcast_base::error::{Error, Result};

/// Component types of accessors.
const BYTE: u32 = 5120;
const UNSIGNED_BYTE: u32 = 5121;
const SHORT: u32 = 5122;
const UNSIGNED_SHORT: u32 = 5123;
const UNSIGNED_INT: u32 = 5125;
const FLOAT: u32 = 5126;

/// Required extensions that do not change how the shape is read, besides all `KHR_materials_…`.
const SUPPORTED_EXTENSIONS: [&str; 3] = [
    "KHR_mesh_quantization",
    "KHR_lights_punctual",
    "KHR_xmp_json_ld",
];
/// Maximum elements of an accessor that is not stored in a buffer.
const MAX_ZEROS: usize = 1 << 24;

/// Chunk types of a binary file.
const CHUNK_JSON: &[u8] = b"JSON";
const CHUNK_BIN: &[u8] = b"BIN\0";

#[derive(Default, Deserialize)]
#[serde(rename_all = "camelCase", default)]
struct Document {
    extensions_required: Vec<String>,
    scene: Option<usize>,
    scenes: Vec<Scene>,
    nodes: Vec<Node>,
    meshes: Vec<Mesh>,
    skins: Vec<Skin>,
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
    skin: Option<usize>,
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
#[serde(rename_all = "camelCase")]
struct Skin {
    joints: Vec<usize>,
    inverse_bind_matrices: Option<usize>,
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
    #[serde(rename = "JOINTS_0")]
    joints: Option<usize>,
    #[serde(rename = "WEIGHTS_0")]
    weights: Option<usize>,
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
    #[serde(default)]
    normalized: bool,
    sparse: Option<Sparse>,
}

/// Elements that replace those of the accessor.
#[derive(Deserialize)]
struct Sparse {
    count: usize,
    indices: SparsePart,
    values: SparsePart,
}

#[derive(Deserialize)]
#[serde(rename_all = "camelCase")]
struct SparsePart {
    buffer_view: usize,
    #[serde(default)]
    byte_offset: usize,
    /// Of the indices only.
    component_type: Option<u32>,
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
    for drawn in gltf.primitives()? {
        if let Some(shape) = gltf.shape(&drawn)? {
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
        require_supported(&document.extensions_required)?;
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
        for drawn in self.primitives()? {
            let Some(shape) = self.shape(&drawn)? else {
                continue;
            };
            let primitive = drawn.primitive;
            let count = shape.vertices.len();
            let to_scene = DMat3::from_mat4(drawn.t_scene_node).inverse().transpose();
            // Normals of a skin would have to be blended too.
            let normal = primitive
                .attributes
                .normal
                .filter(|_| drawn.joints.is_none());
            let normals = normal.and_then(|index| {
                let all = self.numbers::<3>(index, "normals").ok()?;
                let units = all
                    .into_iter()
                    .map(|n| (to_scene * DVec3::from_array(n)).try_normalize());
                units.collect::<Option<Vec<_>>>()
            });
            let uvs = primitive
                .attributes
                .uv
                .map(|index| self.numbers::<2>(index, "texture coordinates"));
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

    /// Primitives of the default scene.
    fn primitives(&self) -> Result<Vec<Drawn<'_>>> {
        let nodes = scene_nodes(&self.document)?;
        let mut all = Vec::new();
        for &(index, t_scene_node) in &nodes {
            let node = &self.document.nodes[index];
            let Some(mesh) = node.mesh else { continue };
            let mesh = item(&self.document.meshes, mesh, "mesh")?;
            let joints = node
                .skin
                .map(|skin| self.joints(skin, &nodes))
                .transpose()?;
            all.extend(mesh.primitives.iter().map(|primitive| Drawn {
                primitive,
                t_scene_node,
                joints: joints.clone(),
            }));
        }
        Ok(all)
    }

    /// Transforms from a skinned mesh into the scene, one per joint, in the pose of the file.
    fn joints(&self, skin: usize, nodes: &[(usize, DMat4)]) -> Result<Vec<DMat4>> {
        let skin = item(&self.document.skins, skin, "skin")?;
        let inverses = match skin.inverse_bind_matrices {
            Some(index) => self.numbers::<16>(index, "inverse bind matrices")?,
            None => Vec::new(),
        };
        let joints = skin.joints.iter().enumerate().map(|(k, joint)| {
            let found = nodes.iter().find(|(node, _)| node == joint);
            let (_, t_scene_joint) = found
                .ok_or_else(|| malformed(format!("joint {joint} of a skin is not in the scene")))?;
            let inverse = inverses
                .get(k)
                .map_or(DMat4::IDENTITY, DMat4::from_cols_array);
            Ok(*t_scene_joint * inverse)
        });
        joints.collect()
    }
}

/// A primitive in the scene.
struct Drawn<'a> {
    primitive: &'a Primitive,
    t_scene_node: DMat4,
    /// Transforms of the joints of a skin, which replace that of the node.
    joints: Option<Vec<DMat4>>,
}

/// Rejects a document that needs an extension which is not supported.
fn require_supported(extensions: &[String]) -> Result<()> {
    let is_supported = |name: &&String| {
        SUPPORTED_EXTENSIONS.contains(&name.as_str()) || name.starts_with("KHR_materials_")
    };
    let Some(name) = extensions.iter().find(|name| !is_supported(name)) else {
        return Ok(());
    };
    let remedy = if name.contains("draco") || name.contains("compression") {
        "export the mesh without compression (`gltf-transform copy` decompresses a file)"
    } else {
        "export the mesh without this extension"
    };
    Err(Error::input(format!(
        "the glTF requires the extension {name}, which is not supported"
    ))
    .remedy(remedy))
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
    companions(&percent_decode_str(uri).decode_utf8_lossy()).map_err(|e| {
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

/// Indices of the nodes of the default (else the first) scene with their transforms into it; all
/// nodes if the file has no scene.
fn scene_nodes(document: &Document) -> Result<Vec<(usize, DMat4)>> {
    let roots: Vec<usize> = match (document.scene, document.scenes.as_slice()) {
        (None, []) => {
            let is_child =
                |index: &usize| document.nodes.iter().any(|n| n.children.contains(index));
            (0..document.nodes.len()).filter(|n| !is_child(n)).collect()
        }
        (scene, scenes) => item(scenes, scene.unwrap_or(0), "scene")?.nodes.clone(),
    };
    let mut visited = vec![false; document.nodes.len()];
    let mut open: Vec<_> = roots.into_iter().map(|n| (n, DMat4::IDENTITY)).collect();
    open.reverse();
    let mut nodes = Vec::new();
    while let Some((index, t_scene_parent)) = open.pop() {
        let node = item(&document.nodes, index, "node")?;
        if std::mem::replace(&mut visited[index], true) {
            return Err(malformed(format!("node {index} has more than one parent")));
        }
        let t_scene_node = t_scene_parent * transform(node);
        open.extend(node.children.iter().map(|&child| (child, t_scene_node)));
        nodes.push((index, t_scene_node));
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
    fn shape(&self, drawn: &Drawn<'_>) -> Result<Option<TriangleMesh>> {
        let primitive = drawn.primitive;
        let Some(index) = primitive.attributes.position else {
            return Ok(None);
        };
        let positions = self.numbers::<3>(index, "positions")?;
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
        let blended = match &drawn.joints {
            Some(joints) => Some(self.blended(&primitive.attributes, joints, count)?),
            None => None,
        };
        let t_scene_vertex = |v: usize| blended.as_ref().map_or(drawn.t_scene_node, |t| t[v]);
        if count > 0 && t_scene_vertex(0).determinant() < 0.0 {
            triangles.iter_mut().for_each(|t| t.swap(0, 1));
        }
        let vertices = positions
            .iter()
            .enumerate()
            .map(|(v, &p)| (t_scene_vertex(v) * DVec3::from_array(p).extend(1.0)).truncate());
        Ok(Some(TriangleMesh {
            vertices: vertices.collect(),
            triangles,
        }))
    }

    /// Transform of each vertex of a skinned primitive into the scene: the weighted sum of those of
    /// its joints.
    fn blended(
        &self,
        attributes: &Attributes,
        joints: &[DMat4],
        count: usize,
    ) -> Result<Vec<DMat4>> {
        let (Some(indices), Some(weights)) = (attributes.joints, attributes.weights) else {
            return Err(malformed("a skinned mesh must have JOINTS_0 and WEIGHTS_0"));
        };
        let indices = self.numbers::<4>(indices, "joints")?;
        let weights = self.numbers::<4>(weights, "weights")?;
        if indices.len() != count || weights.len() != count {
            return Err(malformed("a skinned mesh must have joints for each vertex"));
        }
        let blend = |(indices, weights): (&[f64; 4], &[f64; 4])| {
            let used = indices
                .iter()
                .zip(weights)
                .filter(|(_, weight)| **weight > 0.0);
            let mut sum = DMat4::ZERO;
            let mut total = 0.0;
            for (&index, &weight) in used {
                sum += *item(joints, index as usize, "joint")? * weight;
                total += weight;
            }
            if total > 0.0 {
                Ok(sum * (1.0 / total))
            } else {
                Err(malformed("a vertex of a skinned mesh has no weight"))
            }
        };
        indices.iter().zip(&weights).map(blend).collect()
    }

    fn indices(&self, index: usize) -> Result<Vec<u32>> {
        let accessor = item(&self.document.accessors, index, "accessor")?;
        if !matches!(
            accessor.component_type,
            UNSIGNED_BYTE | UNSIGNED_SHORT | UNSIGNED_INT
        ) {
            return Err(malformed(format!(
                "indices must be unsigned integers, found component type {}",
                accessor.component_type
            )));
        }
        let numbers = self.numbers::<1>(index, "indices")?;
        Ok(numbers.into_iter().map(|[number]| number as u32).collect())
    }

    /// Elements of an accessor with `N` components, checked against its buffer.
    fn numbers<const N: usize>(&self, index: usize, what: &str) -> Result<Vec<[f64; N]>> {
        let accessor = item(&self.document.accessors, index, "accessor")?;
        let expected = match N {
            1 => "SCALAR",
            2 => "VEC2",
            3 => "VEC3",
            4 => "VEC4",
            _ => "MAT4",
        };
        let decode = decoder(accessor.component_type, accessor.normalized);
        let (Some(decode), true) = (decode, accessor.dimensions == expected) else {
            return Err(malformed(format!(
                "{what} must be {expected}, found {} of component type {}",
                accessor.dimensions, accessor.component_type
            )));
        };
        let read = || {
            let mut all = match accessor.buffer_view {
                Some(view) => self.elements(view, accessor.byte_offset, accessor.count, decode)?,
                None if accessor.sparse.is_some() && accessor.count <= MAX_ZEROS => {
                    vec![[0.0; N]; accessor.count]
                }
                None => {
                    return Err(malformed("the mesh data is compressed")
                        .remedy("export the mesh without compression"));
                }
            };
            if let Some(sparse) = &accessor.sparse {
                self.replace_sparse(&mut all, sparse, decode)?;
            }
            Ok(all)
        };
        read().map_err(|e: Error| e.at(format!("accessor {index}")))
    }

    /// Replaces the elements that a sparse accessor stores separately.
    fn replace_sparse<const N: usize>(
        &self,
        all: &mut [[f64; N]],
        sparse: &Sparse,
        decode: Decoder,
    ) -> Result<()> {
        let (indices, values) = (&sparse.indices, &sparse.values);
        let index_decoder = indices.component_type.and_then(|t| decoder(t, false));
        let index_decoder =
            index_decoder.ok_or_else(|| malformed("sparse indices must be unsigned integers"))?;
        let indices: Vec<[f64; 1]> = self.elements(
            indices.buffer_view,
            indices.byte_offset,
            sparse.count,
            index_decoder,
        )?;
        let values: Vec<[f64; N]> =
            self.elements(values.buffer_view, values.byte_offset, sparse.count, decode)?;
        let count = all.len();
        for ([index], value) in indices.into_iter().zip(values) {
            let slot = all
                .get_mut(index as usize)
                .ok_or_else(|| malformed(format!("sparse index {index} of {count} elements")))?;
            *slot = value;
        }
        Ok(())
    }

    /// Elements of a buffer view.
    fn elements<const N: usize>(
        &self,
        view: usize,
        byte_offset: usize,
        count: usize,
        (size, decode): Decoder,
    ) -> Result<Vec<[f64; N]>> {
        let view = item(&self.document.buffer_views, view, "bufferView")?;
        let buffer = item(&self.buffers, view.buffer, "buffer")?;
        let width = N * size;
        let stride = view.byte_stride.unwrap_or(width);
        let slice = || {
            let view_end = view.byte_offset.checked_add(view.byte_length)?;
            let start = view.byte_offset.checked_add(byte_offset)?;
            let span = stride
                .checked_mul(count.checked_sub(1)?)?
                .checked_add(width)?;
            let end = start.checked_add(span)?;
            (end <= view_end && stride >= width).then_some(())?;
            buffer.get(start..end)
        };
        let bytes = slice().ok_or_else(|| {
            malformed(format!(
                "{count} elements of {width} bytes are declared, more than the buffer holds"
            ))
        })?;
        let element = |bytes: &[u8]| std::array::from_fn(|k| decode(&bytes[k * size..]));
        Ok(bytes.chunks(stride).map(element).collect())
    }
}

/// Size of a component in bytes, and the function that decodes it from the start of a slice.
type Decoder = (usize, fn(&[u8]) -> f64);

/// Decoder of a component type; integers are normalised as the format says (section 3.11).
fn decoder(component_type: u32, normalized: bool) -> Option<Decoder> {
    fn ratio(number: f32, maximum: f32) -> f64 {
        f64::from((number / maximum).max(-1.0))
    }
    Some(match (component_type, normalized) {
        (BYTE, false) => (1, |b| f64::from(b[0] as i8)),
        (BYTE, true) => (1, |b| ratio(f32::from(b[0] as i8), 127.0)),
        (UNSIGNED_BYTE, false) => (1, |b| f64::from(b[0])),
        (UNSIGNED_BYTE, true) => (1, |b| ratio(f32::from(b[0]), 255.0)),
        (SHORT, false) => (2, |b| f64::from(i16::from_le_bytes([b[0], b[1]]))),
        (SHORT, true) => (2, |b| {
            ratio(f32::from(i16::from_le_bytes([b[0], b[1]])), 32767.0)
        }),
        (UNSIGNED_SHORT, false) => (2, |b| f64::from(u16::from_le_bytes([b[0], b[1]]))),
        (UNSIGNED_SHORT, true) => (2, |b| {
            ratio(f32::from(u16::from_le_bytes([b[0], b[1]])), 65535.0)
        }),
        (UNSIGNED_INT, _) => (4, |b| {
            f64::from(u32::from_le_bytes([b[0], b[1], b[2], b[3]]))
        }),
        (FLOAT, _) => (4, |b| {
            f64::from(f32::from_le_bytes([b[0], b[1], b[2], b[3]]))
        }),
        _ => return None,
    })
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
