//! glTF 2.0, binary and text: the triangles of the default scene.

use base64::Engine as _;
use base64::engine::general_purpose::STANDARD;
use glam::{DMat4, DVec3};
use gltf::accessor::{DataType, Dimensions};
use gltf::mesh::Mode;
use gltf::{Accessor, Document, Gltf, Node, Primitive, Semantic};

use super::{from_f32, malformed};
use crate::error::{Error, Result};
use crate::geometry::mesh::TriangleMesh;

/// Reads the bytes of a file beside the document.
type Beside<'a> = &'a dyn Fn(&str) -> std::io::Result<Vec<u8>>;

/// Parses the document and joins all its triangles in the frame of the scene.
pub(super) fn read(bytes: &[u8], beside: Beside<'_>) -> Result<TriangleMesh> {
    let Gltf { document, blob } =
        Gltf::from_slice(bytes).map_err(|e| malformed("the glTF cannot be read").because(e))?;
    let buffers = buffers(&document, blob, beside)?;
    let mut mesh = TriangleMesh::default();
    for (node, t_scene_node) in placed_nodes(&document)? {
        for primitive in node.mesh().iter().flat_map(|m| m.primitives()) {
            append(&mut mesh, &primitive, &buffers, &t_scene_node)?;
        }
    }
    Ok(mesh)
}

/// The bytes of each buffer: within the file, in a data URI, or in a file beside it.
fn buffers(document: &Document, blob: Option<Vec<u8>>, beside: Beside<'_>) -> Result<Vec<Vec<u8>>> {
    let mut blob = blob;
    let one = |buffer: gltf::Buffer<'_>| match buffer.source() {
        gltf::buffer::Source::Bin => blob
            .take()
            .ok_or_else(|| malformed("the binary part that buffer 0 lies in is missing")),
        gltf::buffer::Source::Uri(uri) => match uri.strip_prefix("data:") {
            Some(data) => {
                let encoded = data.split_once("base64,").map_or("", |(_, text)| text);
                let decoded = STANDARD.decode(encoded);
                decoded.map_err(|e| malformed("a data URI is not base64").because(e))
            }
            None => beside(&uri.replace("%20", " ")).map_err(|e| {
                Error::io("cannot read the buffer of the glTF", e)
                    .at(uri)
                    .remedy("keep the .bin file beside the .gltf, or export a .glb")
            }),
        },
    };
    document.buffers().map(one).collect()
}

/// Nodes of the default scene (else the first) with their place in it.
fn placed_nodes(document: &Document) -> Result<Vec<(Node<'_>, DMat4)>> {
    let scene = document
        .default_scene()
        .or_else(|| document.scenes().next());
    let scene = scene.ok_or_else(|| malformed("the glTF has no scene"))?;
    let mut visited = vec![false; document.nodes().len()];
    let mut open: Vec<_> = scene.nodes().map(|n| (n, DMat4::IDENTITY)).collect();
    open.reverse();
    let mut placed = Vec::new();
    while let Some((node, t_scene_parent)) = open.pop() {
        if std::mem::replace(&mut visited[node.index()], true) {
            let index = node.index();
            return Err(malformed(format!("node {index} has more than one parent")));
        }
        let columns = node.transform().matrix();
        let t_parent_node = DMat4::from_cols_array_2d(&columns.map(|c| c.map(f64::from)));
        let t_scene_node = t_scene_parent * t_parent_node;
        open.extend(node.children().map(|child| (child, t_scene_node)));
        placed.push((node, t_scene_node));
    }
    Ok(placed)
}

/// Appends the triangles of a primitive; lines and points are left out.
fn append(
    mesh: &mut TriangleMesh,
    primitive: &Primitive<'_>,
    buffers: &[Vec<u8>],
    t_scene_node: &DMat4,
) -> Result<()> {
    let Some(accessor) = primitive.get(&Semantic::Positions) else {
        return Ok(());
    };
    let positions = positions(&accessor, buffers)?;
    let corners = match primitive.indices() {
        Some(accessor) => indices(&accessor, buffers)?,
        None => (0..positions.len() as u32).collect(),
    };
    let mut triangles = assemble(primitive.mode(), &corners);
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
    let placed = positions.iter().map(|&p| t_scene_node.transform_point3(p));
    mesh.vertices.extend(placed);
    mesh.triangles
        .extend(triangles.into_iter().map(|t| t.map(|v| v + offset)));
    Ok(())
}

/// Triangles of a list, strip or fan of corners.
fn assemble(mode: Mode, corners: &[u32]) -> Vec<[u32; 3]> {
    match mode {
        Mode::Triangles => corners
            .chunks_exact(3)
            .map(|c| [c[0], c[1], c[2]])
            .collect(),
        Mode::TriangleStrip => corners
            .windows(3)
            .enumerate()
            .map(|(i, c)| match i % 2 {
                0 => [c[0], c[1], c[2]],
                _ => [c[1], c[0], c[2]],
            })
            .collect(),
        Mode::TriangleFan => corners
            .windows(2)
            .skip(1)
            .map(|c| [corners[0], c[0], c[1]])
            .collect(),
        Mode::Points | Mode::Lines | Mode::LineLoop | Mode::LineStrip => Vec::new(),
    }
}

fn positions(accessor: &Accessor<'_>, buffers: &[Vec<u8>]) -> Result<Vec<DVec3>> {
    let found = (accessor.data_type(), accessor.dimensions());
    if found != (DataType::F32, Dimensions::Vec3) {
        return Err(malformed(format!(
            "positions must be three 32-bit floats, found {found:?}"
        )));
    }
    let coordinate = |item: &[u8], at: usize| {
        f32::from_le_bytes([item[at], item[at + 1], item[at + 2], item[at + 3]])
    };
    let position = |item: &[u8]| from_f32([0, 4, 8].map(|at| coordinate(item, at)));
    Ok(items(accessor, buffers)?.map(position).collect())
}

fn indices(accessor: &Accessor<'_>, buffers: &[Vec<u8>]) -> Result<Vec<u32>> {
    let found = (accessor.data_type(), accessor.dimensions());
    let unsigned = matches!(
        found,
        (
            DataType::U8 | DataType::U16 | DataType::U32,
            Dimensions::Scalar
        )
    );
    if !unsigned {
        return Err(malformed(format!(
            "indices must be unsigned integers, found {found:?}"
        )));
    }
    let index = |item: &[u8]| {
        let digits = item.iter().rev();
        digits.fold(0, |value, &byte| (value << 8) | u32::from(byte))
    };
    Ok(items(accessor, buffers)?.map(index).collect())
}

/// The bytes of each item of an accessor, checked against its buffer.
fn items<'b>(
    accessor: &Accessor<'_>,
    buffers: &'b [Vec<u8>],
) -> Result<impl Iterator<Item = &'b [u8]> + use<'b>> {
    let index = accessor.index();
    let view = match (accessor.view(), accessor.sparse()) {
        (Some(view), None) => view,
        _ => {
            return Err(
                malformed(format!("accessor {index} is sparse or compressed"))
                    .remedy("export the mesh without compression"),
            );
        }
    };
    let (count, size) = (accessor.count(), accessor.size());
    let stride = view.stride().unwrap_or(size);
    let slice = || {
        let buffer = buffers.get(view.buffer().index())?;
        let view_end = view.offset().checked_add(view.length())?;
        let start = view.offset().checked_add(accessor.offset())?;
        let span = stride
            .checked_mul(count.checked_sub(1)?)?
            .checked_add(size)?;
        let end = start.checked_add(span)?;
        (end <= view_end && stride >= size).then_some(())?;
        buffer.get(start..end)
    };
    let bytes = slice().ok_or_else(|| {
        malformed(format!(
            "accessor {index} needs {count} items of {size} bytes, more than its buffer holds"
        ))
    })?;
    Ok(bytes.chunks(stride).map(move |item| &item[..size]))
}
