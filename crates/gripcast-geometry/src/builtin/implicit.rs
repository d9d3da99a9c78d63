//! Meshes of implicit surfaces by surface nets (Gibson, *Constrained elastic surface nets*, MICCAI
//! 1998), smoothed on the surface.

use std::collections::BTreeMap;

use glam::DVec3;

use super::shapes::{push, push_quad};
use crate::mesh::TriangleMesh;

/// Smoothing rounds.
const SMOOTHING_ROUNDS: usize = 12;
/// Maximum number of lattice offsets to try.
const MAX_ATTEMPTS: u32 = 16;
/// Step of the numerical gradient, m.
const GRADIENT_M: f64 = 1e-5;

/// Signed function of the position (m), negative inside the body, with a slope of about 1.
pub type Field<'a> = &'a dyn Fn(DVec3) -> f64;

/// A surface of quadrilaterals, counter-clockwise seen from outside.
#[derive(Clone, Debug, Default)]
pub struct QuadMesh {
    /// Positions, m.
    pub vertices: Vec<DVec3>,
    /// Vertex indices of each quadrilateral.
    pub quads: Vec<[u32; 4]>,
}

/// Meshes the zero surface inside ±`half` (m) with faces about `cell` (m) wide.
///
/// One vertex per cell cannot represent a surface that passes a cell twice, e.g. where a lattice
/// plane grazes a saddle. The lattice is then shifted.
pub(super) fn surface(field: Field<'_>, half: DVec3, cell: f64) -> TriangleMesh {
    let mut mesh = TriangleMesh::default();
    for attempt in 0..MAX_ATTEMPTS {
        mesh = on_lattice(
            field,
            half,
            cell,
            f64::from(attempt) / f64::from(MAX_ATTEMPTS),
        );
        if mesh.edges().is_closed() {
            break;
        }
    }
    mesh
}

fn on_lattice(field: Field<'_>, half: DVec3, cell: f64, shift: f64) -> TriangleMesh {
    let mut net = Net::new(field, half, cell, shift).quad_mesh();
    smooth_on_surface(field, &mut net, SMOOTHING_ROUNDS);
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

/// Surface net near the zero surface inside ±`half` (m) on a lattice of `cell` (m) with an offset
/// `shift` from 0 to 1. Each sheet of the surface in a cell has its own vertex, which separates the
/// sides of thin walls. [`smooth_on_surface`] moves the vertices onto the surface.
pub fn surface_net_by_sheet(field: Field<'_>, half: DVec3, cell: f64, shift: f64) -> QuadMesh {
    let mut net = Net::new(field, half, cell, shift);
    net.by_sheet = true;
    net.quad_mesh()
}

/// Projects vertices onto the surface; then, in each round, moves them halfway to the mean of their
/// neighbours and projects them again.
pub fn smooth_on_surface(field: Field<'_>, net: &mut QuadMesh, rounds: usize) {
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

/// Rotates the corners so that the quadrilateral is split along its shorter diagonal.
fn along_shorter_diagonal([a, b, c, d]: [u32; 4], vertices: &[DVec3]) -> [u32; 4] {
    let length = |i: u32, j: u32| vertices[i as usize].distance_squared(vertices[j as usize]);
    if length(a, c) <= length(b, d) {
        [a, b, c, d]
    } else {
        [b, c, d, a]
    }
}

/// Projects a point close to the surface onto it by two Newton steps.
fn on_surface(field: Field<'_>, point: DVec3) -> DVec3 {
    let mut projected = point;
    for _ in 0..2 {
        let gradient = gradient(field, projected);
        projected -= gradient * (field(projected) / gradient.length_squared().max(1e-12));
    }
    projected
}

/// Numerical gradient of the field.
pub fn gradient(field: Field<'_>, point: DVec3) -> DVec3 {
    DVec3::from_array(DVec3::AXES.map(|axis| {
        let step = GRADIENT_M * axis;
        (field(point + step) - field(point - step)) / (2.0 * GRADIENT_M)
    }))
}

/// Vertices that share a side with each vertex, ascending.
pub fn neighbours(quads: &[[u32; 4]], count: usize) -> Vec<Vec<u32>> {
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

/// Lattice node by its indices along x, y and z.
type Node = [usize; 3];

/// The next node along each of the axes.
fn next_node(mut node: Node, axes: &[usize]) -> Node {
    for axis in axes {
        node[*axis] += 1;
    }
    node
}

/// Field values on a lattice.
struct Net {
    nodes: Node,
    low: DVec3,
    cell: f64,
    values: Vec<f64>,
    /// Whether each sheet of the surface in a cell has its own vertex.
    by_sheet: bool,
    /// Vertices by cell and first edge of the sheet.
    vertices: BTreeMap<(Node, usize), u32>,
}

impl Net {
    fn new(field: Field<'_>, half: DVec3, cell: f64, shift: f64) -> Self {
        // Irregular offsets keep nodes off symmetric surfaces.
        let low = -half - cell * (DVec3::new(1.37, 1.41, 1.43) + 0.61 * shift);
        let nodes = half
            .to_array()
            .map(|h| (2.0 * h / cell).ceil() as usize + 5);
        let mut net = Self {
            nodes,
            low,
            cell,
            values: Vec::new(),
            by_sheet: false,
            vertices: BTreeMap::new(),
        };
        for z in 0..nodes[2] {
            for y in 0..nodes[1] {
                for x in 0..nodes[0] {
                    net.values.push(field(net.position([x, y, z])));
                }
            }
        }
        net
    }

    fn quad_mesh(mut self) -> QuadMesh {
        let mut mesh = TriangleMesh::default();
        let quads = self.quads(&mut mesh);
        QuadMesh {
            vertices: mesh.vertices,
            quads,
        }
    }

    fn position(&self, node: Node) -> DVec3 {
        self.low + self.cell * DVec3::from_array(node.map(|n| n as f64))
    }

    fn value(&self, [x, y, z]: Node) -> f64 {
        self.values[x + self.nodes[0] * (y + self.nodes[1] * z)]
    }

    /// The quadrilaterals around all lattice edges that the surface crosses, facing outwards.
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

    /// The quadrilateral around the edge from a node along an axis, if the surface crosses the
    /// edge.
    fn quad(&mut self, mesh: &mut TriangleMesh, node: Node, axis: usize) -> Option<[u32; 4]> {
        let (here, there) = (self.value(node), self.value(next_node(node, &[axis])));
        if (here < 0.0) == (there < 0.0) {
            return None;
        }
        let [u, v] = [(axis + 1) % 3, (axis + 2) % 3];
        // The cells around the edge; it is another of the four edges along the axis in each.
        let around = [(1, 1), (0, 1), (0, 0), (1, 0)];
        let mut quad = around.map(|(before_u, before_v)| {
            let mut cell = node;
            cell[u] -= before_u;
            cell[v] -= before_v;
            self.vertex(mesh, cell, 4 * axis + before_u + 2 * before_v)
        });
        if here > 0.0 {
            quad.reverse();
        }
        Some(quad)
    }

    /// The vertex of the sheet that crosses an edge of a cell: the mean of its crossings.
    fn vertex(&mut self, mesh: &mut TriangleMesh, cell: Node, edge: usize) -> u32 {
        let sheets = if self.by_sheet {
            self.sheets(cell)
        } else {
            [0; 12]
        };
        let key = (cell, sheets[edge]);
        if let Some(&vertex) = self.vertices.get(&key) {
            return vertex;
        }
        let (mut sum, mut count) = (DVec3::ZERO, 0.0);
        for edge in (0..12).filter(|&edge| sheets[edge] == key.1) {
            let [from, to] = edge_ends(cell, edge);
            let (here, there) = (self.value(from), self.value(to));
            if (here < 0.0) != (there < 0.0) {
                let fraction = here / (here - there);
                sum += self.position(from).lerp(self.position(to), fraction);
                count += 1.0;
            }
        }
        let vertex = push(mesh, sum / f64::max(count, 1.0));
        self.vertices.insert(key, vertex);
        vertex
    }

    /// For each edge of a cell, the first edge crossed by the same sheet of the surface; thin walls
    /// pass a cell twice (Nielson, *Dual marching cubes*, IEEE Visualization 2004).
    fn sheets(&self, cell: Node) -> [usize; 12] {
        let crossed: [bool; 12] = std::array::from_fn(|edge| {
            let [from, to] = edge_ends(cell, edge).map(|end| self.value(end) < 0.0);
            from != to
        });
        let mut first: [usize; 12] = std::array::from_fn(|edge| edge);
        let mut join = |[a, b]: [usize; 2]| {
            let (low, high) = (first[a].min(first[b]), first[a].max(first[b]));
            for sheet in first.iter_mut().filter(|sheet| **sheet == high) {
                *sheet = low;
            }
        };
        for axis in 0..3 {
            let [a, b] = [(axis + 1) % 3, (axis + 2) % 3];
            for side in 0..2 {
                // Edges along a at both ends of b, and along b at both ends of a.
                let along_a = [0, 1].map(|end| 4 * a + end + 2 * side);
                let along_b = [0, 1].map(|end| 4 * b + side + 2 * end);
                let edges = [along_a[0], along_a[1], along_b[0], along_b[1]];
                let found: Vec<usize> = edges.into_iter().filter(|&e| crossed[e]).collect();
                if let [one, other] = found[..] {
                    join([one, other]);
                } else if found.len() == 4 {
                    // Two diagonal corners are inside: each is cut off separately.
                    let corner = if side == 1 {
                        next_node(cell, &[axis])
                    } else {
                        cell
                    };
                    let swap = usize::from(self.value(corner) >= 0.0);
                    join([along_a[0], along_b[swap]]);
                    join([along_a[1], along_b[1 - swap]]);
                }
            }
        }
        first
    }
}

/// End nodes of an edge of a cell: four edges along each axis, numbered by their positions along
/// the next two axes.
fn edge_ends(cell: Node, edge: usize) -> [Node; 2] {
    let axis = edge / 4;
    let mut from = cell;
    from[(axis + 1) % 3] += edge % 2;
    from[(axis + 2) % 3] += edge / 2 % 2;
    [from, next_node(from, &[axis])]
}
