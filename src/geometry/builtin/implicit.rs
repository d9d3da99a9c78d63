//! Meshes of bodies that a function describes: surface nets (Gibson, *Constrained elastic surface
//! nets*, MICCAI 1998), evened out on the surface.

use std::collections::BTreeMap;

use glam::DVec3;

use super::shapes::{push, push_quad};
use crate::geometry::mesh::TriangleMesh;

/// Rounds in which vertices move to the middle of their neighbours and back to the surface.
const ROUNDS: usize = 12;
/// Lattices that are tried.
const ATTEMPTS: u32 = 16;
/// Step of the numerical gradient, m.
const GRADIENT_M: f64 = 1e-5;

/// Signed function of place (m), negative inside the body, growing by about 1 for each metre.
pub(crate) type Field<'a> = &'a dyn Fn(DVec3) -> f64;

/// A surface of quadrilaterals, their corners counter-clockwise seen from outside.
#[derive(Clone, Debug, Default)]
pub(crate) struct QuadMesh {
    /// Positions, m.
    pub(crate) vertices: Vec<DVec3>,
    /// Indices into `vertices`.
    pub(crate) quads: Vec<[u32; 4]>,
}

/// Mesh of the zero surface within ±`half` (m), which must enclose it, with faces about `cell` (m)
/// wide.
///
/// A vertex for each cell cannot follow a surface that passes a cell twice, as it does where a
/// plane of the lattice grazes a saddle. Then another lattice is taken.
pub(super) fn surface(field: Field<'_>, half: DVec3, cell: f64) -> TriangleMesh {
    let mut mesh = TriangleMesh::default();
    for attempt in 0..ATTEMPTS {
        mesh = on_lattice(field, half, cell, f64::from(attempt) / f64::from(ATTEMPTS));
        if mesh.edges().is_closed() {
            break;
        }
    }
    mesh
}

fn on_lattice(field: Field<'_>, half: DVec3, cell: f64, shift: f64) -> TriangleMesh {
    let mut net = net_of_quads(field, half, cell, shift);
    even_out(field, &mut net, ROUNDS);
    let mut mesh = TriangleMesh {
        vertices: net.vertices,
        triangles: Vec::new(),
    };
    for quad in net.quads {
        let quad = along_shorter_diagonal(quad, &mesh.vertices);
        push_quad(&mut mesh, quad);
    }
    mesh
}

/// Quadrilaterals near the zero surface within ±`half` (m) on a lattice of `cell` (m) moved by a
/// `shift` from 0 to 1. [`even_out`] brings their corners onto the surface.
pub(crate) fn net_of_quads(field: Field<'_>, half: DVec3, cell: f64, shift: f64) -> QuadMesh {
    let mut mesh = TriangleMesh::default();
    let quads = Net::new(field, half, cell, shift).quads(&mut mesh);
    QuadMesh {
        vertices: mesh.vertices,
        quads,
    }
}

/// Moves vertices onto the surface, then in each round to the middle of their neighbours and back.
pub(crate) fn even_out(field: Field<'_>, net: &mut QuadMesh, rounds: usize) {
    let neighbours = neighbours(&net.quads, net.vertices.len());
    for vertex in &mut net.vertices {
        *vertex = on_surface(field, *vertex);
    }
    for _ in 0..rounds {
        let before = net.vertices.clone();
        for (vertex, around) in net.vertices.iter_mut().zip(&neighbours) {
            let sum: DVec3 = around.iter().map(|&n| before[n as usize]).sum();
            let middle = sum / around.len().max(1) as f64;
            *vertex = on_surface(field, vertex.lerp(middle, 0.5));
        }
    }
}

/// The quadrilateral, turned so that it is cut along its shorter diagonal.
fn along_shorter_diagonal([a, b, c, d]: [u32; 4], vertices: &[DVec3]) -> [u32; 4] {
    let length = |i: u32, j: u32| vertices[i as usize].distance_squared(vertices[j as usize]);
    if length(a, c) <= length(b, d) {
        [a, b, c, d]
    } else {
        [b, c, d, a]
    }
}

/// The point of the surface near a point close to it: two Newton steps.
fn on_surface(field: Field<'_>, point: DVec3) -> DVec3 {
    let mut at = point;
    for _ in 0..2 {
        let gradient = gradient(field, at);
        at -= gradient * (field(at) / gradient.length_squared().max(1e-12));
    }
    at
}

/// Numerical gradient of the field.
pub(crate) fn gradient(field: Field<'_>, at: DVec3) -> DVec3 {
    DVec3::from_array(DVec3::AXES.map(|axis| {
        let step = GRADIENT_M * axis;
        (field(at + step) - field(at - step)) / (2.0 * GRADIENT_M)
    }))
}

/// Vertices with which each vertex shares a side, ascending.
pub(crate) fn neighbours(quads: &[[u32; 4]], count: usize) -> Vec<Vec<u32>> {
    let mut around = vec![Vec::with_capacity(6); count];
    for quad in quads {
        for corner in 0..4 {
            let (a, b) = (quad[corner], quad[(corner + 1) % 4]);
            around[a as usize].push(b);
            around[b as usize].push(a);
        }
    }
    for list in &mut around {
        list.sort_unstable();
        list.dedup();
    }
    around
}

/// Place on the lattice by its numbers along x, y and z.
type Node = [usize; 3];

/// The node one step further along each of the axes.
fn further(mut node: Node, axes: &[usize]) -> Node {
    for axis in axes {
        node[*axis] += 1;
    }
    node
}

/// Values of a function on a lattice.
struct Net {
    nodes: Node,
    low: DVec3,
    cell: f64,
    values: Vec<f64>,
    /// Vertex of each cell that the surface passes through.
    vertices: BTreeMap<Node, u32>,
}

impl Net {
    fn new(field: Field<'_>, half: DVec3, cell: f64, shift: f64) -> Self {
        // A lattice that no symmetry of the body can put a node of on the surface.
        let low = -half - cell * (DVec3::new(1.37, 1.41, 1.43) + 0.61 * shift);
        let nodes = half
            .to_array()
            .map(|h| (2.0 * h / cell).ceil() as usize + 5);
        let mut net = Self {
            nodes,
            low,
            cell,
            values: Vec::new(),
            vertices: BTreeMap::new(),
        };
        for z in 0..nodes[2] {
            for y in 0..nodes[1] {
                for x in 0..nodes[0] {
                    net.values.push(field(net.place([x, y, z])));
                }
            }
        }
        net
    }

    fn place(&self, node: Node) -> DVec3 {
        self.low + self.cell * DVec3::from_array(node.map(|n| n as f64))
    }

    fn value(&self, [x, y, z]: Node) -> f64 {
        self.values[x + self.nodes[0] * (y + self.nodes[1] * z)]
    }

    /// Four cells around each edge of the lattice that the surface crosses, facing outwards.
    fn quads(&mut self, mesh: &mut TriangleMesh) -> Vec<[u32; 4]> {
        let mut quads = Vec::new();
        let [width, depth, height] = self.nodes;
        for z in 1..height - 1 {
            for y in 1..depth - 1 {
                for x in 1..width - 1 {
                    for axis in 0..3 {
                        quads.extend(self.quad(mesh, [x, y, z], axis));
                    }
                }
            }
        }
        quads
    }

    /// The quadrilateral around the edge from a node along an axis, if the surface crosses it.
    fn quad(&mut self, mesh: &mut TriangleMesh, node: Node, axis: usize) -> Option<[u32; 4]> {
        let (here, there) = (self.value(node), self.value(further(node, &[axis])));
        if (here < 0.0) == (there < 0.0) {
            return None;
        }
        let [u, v] = [(axis + 1) % 3, (axis + 2) % 3];
        let before = |axes: &[usize]| {
            let mut cell = node;
            axes.iter().for_each(|axis| cell[*axis] -= 1);
            cell
        };
        let around = [before(&[u, v]), before(&[v]), node, before(&[u])];
        let mut quad = around.map(|cell| self.vertex(mesh, cell));
        if here > 0.0 {
            quad.reverse();
        }
        Some(quad)
    }

    /// The vertex of a cell: the mean of the places where the surface crosses its edges.
    fn vertex(&mut self, mesh: &mut TriangleMesh, cell: Node) -> u32 {
        if let Some(&known) = self.vertices.get(&cell) {
            return known;
        }
        let (mut sum, mut count) = (DVec3::ZERO, 0.0);
        for axis in 0..3 {
            let [u, v] = [(axis + 1) % 3, (axis + 2) % 3];
            for beside in [&[][..], &[u], &[v], &[u, v]] {
                let from = further(cell, beside);
                let to = further(from, &[axis]);
                let (here, there) = (self.value(from), self.value(to));
                if (here < 0.0) != (there < 0.0) {
                    let share = here / (here - there);
                    sum += self.place(from).lerp(self.place(to), share);
                    count += 1.0;
                }
            }
        }
        let vertex = push(mesh, sum / f64::max(count, 1.0));
        self.vertices.insert(cell, vertex);
        vertex
    }
}
