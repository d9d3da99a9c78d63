//! Pairs of gel and object features that may touch, gathered rarely and reused over many steps.
//!
//! The object's features do not move in its own frame, so a pair comes closer by no more than its
//! gel nodes move in that frame. All pairs within `d_hat + radius` are gathered; they are complete
//! for as long as no gel node has moved further than `radius` there, and a pair whose gathered
//! distance exceeds `d_hat` by more than its nodes have moved needs no look at all.

use glam::DVec3;

use super::collider::Collider;
use crate::affine::AffineState;
use crate::contact::distance::{Closest, edge_edge, point_triangle};
use crate::contact::mollifier;
use crate::fem::Surface;
use gripcast_geometry::Aabb;

/// Fraction of the area that a pair acts with (Taccel; half for vertex-triangle and half for
/// edge-edge pairs, and half of each for either side).
const PAIR_FRACTION: f64 = 0.25;

/// The closest points if they are nearer than the root of `limit` (m²).
#[inline]
pub(super) fn near(closest: Closest, limit: f64) -> Option<Closest> {
    (closest.squared < limit).then_some(closest)
}

/// A gel node and a triangle of the object.
#[derive(Clone, Copy, Debug)]
pub(super) struct NodeTriangle {
    pub(super) node: u32,
    pub(super) triangle: [u32; 3],
    pub(super) weight: f64,
    pub(super) gathered: f64,
}

/// A vertex of the object and a triangle of the gel.
#[derive(Clone, Copy, Debug)]
pub(super) struct VertexTriangle {
    pub(super) vertex: u32,
    pub(super) nodes: [u32; 3],
    pub(super) weight: f64,
    pub(super) gathered: f64,
}

/// An edge of the gel and one of the object.
#[derive(Clone, Copy, Debug)]
pub(super) struct EdgeEdge {
    pub(super) nodes: [u32; 2],
    pub(super) vertices: [u32; 2],
    pub(super) weight: f64,
    pub(super) mollifier_threshold: f64,
    pub(super) gathered: f64,
}

/// The pairs of one gel with the object.
#[derive(Clone, Debug, Default)]
pub(super) struct Candidates {
    pub(super) node_triangles: Vec<NodeTriangle>,
    pub(super) vertex_triangles: Vec<VertexTriangle>,
    pub(super) edge_edges: Vec<EdgeEdge>,
    /// Material positions of the object's vertices that occur in a pair; pairs index these.
    pub(super) material: Vec<DVec3>,
    /// Local number of each of the object's vertices, `u32::MAX` where it does not occur.
    local: Vec<u32>,
    /// Positions of all gel nodes in the object's frame when the pairs were gathered.
    gathered_at: Vec<DVec3>,
    radius: f64,
    is_gathered: bool,
}

impl Candidates {
    /// How far each surface node has moved in the object's frame since the pairs were gathered,
    /// with a hair added for the affine matrix; the largest of these.
    pub(super) fn moved(
        &self,
        surface: &Surface,
        x: &[DVec3],
        object: &AffineState,
        moved: &mut [f64],
    ) -> f64 {
        let inverse = object.a.inverse();
        let mut largest = 0.0_f64;
        for &node in surface.vertices() {
            let i = node as usize;
            let here = inverse * (x[i] - object.p);
            let distance = here.distance(self.gathered_at[i]) * (1.0 + 1e-6);
            moved[i] = distance;
            largest = largest.max(distance);
        }
        largest
    }

    pub(super) fn is_gathered(&self) -> bool {
        self.is_gathered
    }

    /// A lower bound of the distance when the pairs were gathered, m.
    pub(super) fn nearest(&self, d_hat: f64) -> f64 {
        let nodes = self.node_triangles.iter().map(|pair| pair.gathered);
        let vertices = self.vertex_triangles.iter().map(|pair| pair.gathered);
        let edges = self.edge_edges.iter().map(|pair| pair.gathered);
        nodes
            .chain(vertices)
            .chain(edges)
            .fold(d_hat + self.radius, f64::min)
    }

    /// Whether the pairs are complete for nodes that have moved this far.
    pub(super) fn cover(&self, largest_move: f64) -> bool {
        self.is_gathered && largest_move <= self.radius
    }

    /// Gathers all pairs within `d_hat + radius`.
    pub(super) fn gather(
        &mut self,
        surface: &Surface,
        rest: &[DVec3],
        x: &[DVec3],
        object: &AffineState,
        collider: &Collider,
        (d_hat, radius): (f64, f64),
    ) {
        let inverse = object.a.inverse();
        self.gathered_at.clear();
        self.gathered_at
            .extend(x.iter().map(|&x| inverse * (x - object.p)));
        self.radius = radius;
        self.is_gathered = true;
        self.local.clear();
        self.local.resize(collider.vertices.len(), u32::MAX);
        self.material.clear();
        let limit = d_hat + radius;
        self.gather_node_triangles(surface, collider, limit);
        self.gather_vertex_triangles(surface, collider, limit);
        self.gather_edges(surface, rest, collider, limit);
    }

    fn local_vertex(local: &mut [u32], material: &mut Vec<DVec3>, at: u32, x: &[DVec3]) -> u32 {
        let entry = &mut local[at as usize];
        if *entry == u32::MAX {
            *entry = material.len() as u32;
            material.push(x[at as usize]);
        }
        *entry
    }

    fn gather_node_triangles(&mut self, surface: &Surface, collider: &Collider, limit: f64) {
        self.node_triangles.clear();
        for (&node, &area) in surface.vertices().iter().zip(surface.vertex_areas()) {
            let x = self.gathered_at[node as usize];
            let query = Aabb::from_points([x]).inflated(limit);
            collider.triangle_tree.for_each_overlap(&query, |triangle| {
                let corners = collider.triangles[triangle as usize];
                let [a, b, c] = corners.map(|v| collider.vertices[v as usize]);
                if let Some(closest) = near(point_triangle(x, a, b, c), limit * limit) {
                    self.node_triangles.push(NodeTriangle {
                        node,
                        triangle: corners.map(|v| {
                            Self::local_vertex(
                                &mut self.local,
                                &mut self.material,
                                v,
                                &collider.vertices,
                            )
                        }),
                        weight: PAIR_FRACTION * area,
                        gathered: closest.distance(),
                    });
                }
            });
        }
    }

    fn gather_vertex_triangles(&mut self, surface: &Surface, collider: &Collider, limit: f64) {
        self.vertex_triangles.clear();
        for &nodes in surface.triangles() {
            let [a, b, c] = nodes.map(|node| self.gathered_at[node as usize]);
            let query = Aabb::from_points([a, b, c]).inflated(limit);
            collider.corner_tree.for_each_overlap(&query, |corner| {
                let vertex = collider.corners[corner as usize];
                let x = collider.vertices[vertex as usize];
                if let Some(closest) = near(point_triangle(x, a, b, c), limit * limit) {
                    self.vertex_triangles.push(VertexTriangle {
                        vertex: Self::local_vertex(
                            &mut self.local,
                            &mut self.material,
                            vertex,
                            &collider.vertices,
                        ),
                        nodes,
                        weight: PAIR_FRACTION * collider.vertex_areas[vertex as usize],
                        gathered: closest.distance(),
                    });
                }
            });
        }
    }

    fn gather_edges(&mut self, surface: &Surface, rest: &[DVec3], collider: &Collider, limit: f64) {
        self.edge_edges.clear();
        for (&nodes, &area) in surface.edges().iter().zip(surface.edge_areas()) {
            let [a0, a1] = nodes.map(|node| self.gathered_at[node as usize]);
            let rest_a = rest[nodes[1] as usize] - rest[nodes[0] as usize];
            let query = Aabb::from_points([a0, a1]).inflated(limit);
            collider.edge_tree.for_each_overlap(&query, |edge| {
                let edge = edge as usize;
                let vertices = collider.edges[edge];
                let [b0, b1] = vertices.map(|v| collider.vertices[v as usize]);
                if let Some(closest) = near(edge_edge(a0, a1, b0, b1), limit * limit) {
                    self.edge_edges.push(EdgeEdge {
                        nodes,
                        vertices: vertices.map(|v| {
                            Self::local_vertex(
                                &mut self.local,
                                &mut self.material,
                                v,
                                &collider.vertices,
                            )
                        }),
                        weight: PAIR_FRACTION * (area + collider.edge_areas[edge]),
                        mollifier_threshold: mollifier::threshold(rest_a, b1 - b0),
                        gathered: closest.distance(),
                    });
                }
            });
        }
    }
}

#[cfg(test)]
#[path = "candidates_test.rs"]
mod tests;
