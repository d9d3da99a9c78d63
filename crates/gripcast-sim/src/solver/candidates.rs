//! Broad phase: pairs of gel and object features that may touch, built rarely and reused over
//! many steps.
//!
//! The object's features do not move in its own frame, so the distance of a pair shrinks by no more
//! than its gel nodes move in that frame. All pairs within `d_hat + margin` are built. They stay
//! complete while no gel node has moved further than `margin` in that frame, and a pair whose
//! distance at the build exceeds `d_hat` by more than its nodes have moved needs no distance query.

use glam::DVec3;

use super::collider::Collider;
use crate::affine::AffineState;
use crate::contact::distance::{Closest, edge_edge, point_triangle};
use crate::contact::mollifier;
use crate::fem::Surface;
use gripcast_geometry::Aabb;

/// Fraction of its area that weighs a pair (Taccel): half for vertex-triangle and half for
/// edge-edge pairs, and half of each for either side.
const AREA_FRACTION: f64 = 0.25;

/// Returns the closest points if their squared distance is below `limit` (m²).
#[inline]
pub(super) fn within(closest: Closest, limit: f64) -> Option<Closest> {
    (closest.squared < limit).then_some(closest)
}

/// A gel node and a triangle of the object.
#[derive(Clone, Copy, Debug)]
pub(super) struct NodeTriangle {
    pub(super) node: u32,
    pub(super) triangle: [u32; 3],
    pub(super) weight: f64,
    pub(super) build_distance: f64,
}

/// A vertex of the object and a triangle of the gel.
#[derive(Clone, Copy, Debug)]
pub(super) struct VertexTriangle {
    pub(super) vertex: u32,
    pub(super) nodes: [u32; 3],
    pub(super) weight: f64,
    pub(super) build_distance: f64,
}

/// An edge of the gel and one of the object.
#[derive(Clone, Copy, Debug)]
pub(super) struct EdgeEdge {
    pub(super) nodes: [u32; 2],
    pub(super) vertices: [u32; 2],
    pub(super) weight: f64,
    pub(super) mollifier_threshold: f64,
    pub(super) build_distance: f64,
}

/// The object's vertices that occur in a pair, numbered in the order of their first use.
#[derive(Clone, Debug, Default)]
struct LocalVertices {
    /// Material positions, m.
    material: Vec<DVec3>,
    /// Local number of each of the object's vertices, `u32::MAX` if it has none.
    numbers: Vec<u32>,
}

impl LocalVertices {
    fn clear(&mut self, vertex_count: usize) {
        self.material.clear();
        self.numbers.clear();
        self.numbers.resize(vertex_count, u32::MAX);
    }

    fn number(&mut self, vertex: u32, collider: &Collider) -> u32 {
        let number = &mut self.numbers[vertex as usize];
        if *number == u32::MAX {
            *number = self.material.len() as u32;
            self.material.push(collider.vertices[vertex as usize]);
        }
        *number
    }
}

/// The candidate pairs of one gel with the object.
#[derive(Clone, Debug, Default)]
pub(super) struct Candidates {
    pub(super) node_triangles: Vec<NodeTriangle>,
    pub(super) vertex_triangles: Vec<VertexTriangle>,
    pub(super) edge_edges: Vec<EdgeEdge>,
    /// Vertices of the object that the pairs refer to.
    local: LocalVertices,
    /// Positions of all gel nodes in the object's frame at the build, m.
    build_positions: Vec<DVec3>,
    margin: f64,
}

impl Candidates {
    /// Material positions of the object's vertices that occur in a pair; pairs index these.
    pub(super) fn materials(&self) -> &[DVec3] {
        &self.local.material
    }

    pub(super) fn material(&self, vertex: u32) -> DVec3 {
        self.local.material[vertex as usize]
    }

    /// Writes how far each surface node has moved in the object's frame since the build, with an
    /// allowance for rounding in the affine matrix; returns the largest, m.
    pub(super) fn max_displacement(
        &self,
        surface: &Surface,
        x: &[DVec3],
        object: &AffineState,
        displacements: &mut [f64],
    ) -> f64 {
        let inverse = object.a.inverse();
        let mut largest = 0.0_f64;
        for &node in surface.vertices() {
            let i = node as usize;
            let here = inverse * (x[i] - object.p);
            let distance = here.distance(self.build_positions[i]) * (1.0 + 1e-6);
            displacements[i] = distance;
            largest = largest.max(distance);
        }
        largest
    }

    pub(super) fn is_built(&self) -> bool {
        !self.build_positions.is_empty()
    }

    /// Lower bound of the distance between gel and object at the build, m.
    pub(super) fn min_build_distance(&self, d_hat: f64) -> f64 {
        let nodes = self.node_triangles.iter().map(|pair| pair.build_distance);
        let vertices = self.vertex_triangles.iter().map(|pair| pair.build_distance);
        let edges = self.edge_edges.iter().map(|pair| pair.build_distance);
        nodes
            .chain(vertices)
            .chain(edges)
            .fold(d_hat + self.margin, f64::min)
    }

    /// Whether the pairs are complete for nodes that have moved this far.
    pub(super) fn covers(&self, displacement: f64) -> bool {
        self.is_built() && displacement <= self.margin
    }

    /// Builds all pairs within `d_hat + margin`.
    pub(super) fn build(
        &mut self,
        surface: &Surface,
        rest: &[DVec3],
        x: &[DVec3],
        object: &AffineState,
        collider: &Collider,
        (d_hat, margin): (f64, f64),
    ) {
        let inverse = object.a.inverse();
        self.build_positions.clear();
        self.build_positions
            .extend(x.iter().map(|&x| inverse * (x - object.p)));
        self.margin = margin;
        self.local.clear(collider.vertices.len());
        let limit = d_hat + margin;
        self.build_node_triangles(surface, collider, limit);
        self.build_vertex_triangles(surface, collider, limit);
        self.build_edges(surface, rest, collider, limit);
    }

    fn build_node_triangles(&mut self, surface: &Surface, collider: &Collider, limit: f64) {
        self.node_triangles.clear();
        for (&node, &area) in surface.vertices().iter().zip(surface.vertex_areas()) {
            let x = self.build_positions[node as usize];
            let query = Aabb::from_points([x]).inflated(limit);
            collider.triangle_tree.for_each_overlap(&query, |triangle| {
                let corners = collider.triangles[triangle as usize];
                let [a, b, c] = corners.map(|v| collider.vertices[v as usize]);
                if let Some(closest) = within(point_triangle(x, a, b, c), limit * limit) {
                    self.node_triangles.push(NodeTriangle {
                        node,
                        triangle: corners.map(|v| self.local.number(v, collider)),
                        weight: AREA_FRACTION * area,
                        build_distance: closest.distance(),
                    });
                }
            });
        }
    }

    fn build_vertex_triangles(&mut self, surface: &Surface, collider: &Collider, limit: f64) {
        self.vertex_triangles.clear();
        for &nodes in surface.triangles() {
            let [a, b, c] = nodes.map(|node| self.build_positions[node as usize]);
            let query = Aabb::from_points([a, b, c]).inflated(limit);
            collider.corner_tree.for_each_overlap(&query, |corner| {
                let vertex = collider.corners[corner as usize];
                let x = collider.vertices[vertex as usize];
                if let Some(closest) = within(point_triangle(x, a, b, c), limit * limit) {
                    self.vertex_triangles.push(VertexTriangle {
                        vertex: self.local.number(vertex, collider),
                        nodes,
                        weight: AREA_FRACTION * collider.vertex_areas[vertex as usize],
                        build_distance: closest.distance(),
                    });
                }
            });
        }
    }

    fn build_edges(&mut self, surface: &Surface, rest: &[DVec3], collider: &Collider, limit: f64) {
        self.edge_edges.clear();
        for (&nodes, &area) in surface.edges().iter().zip(surface.edge_areas()) {
            let [a0, a1] = nodes.map(|node| self.build_positions[node as usize]);
            let rest_a = rest[nodes[1] as usize] - rest[nodes[0] as usize];
            let query = Aabb::from_points([a0, a1]).inflated(limit);
            collider.edge_tree.for_each_overlap(&query, |edge| {
                let edge = edge as usize;
                let vertices = collider.edges[edge];
                let [b0, b1] = vertices.map(|v| collider.vertices[v as usize]);
                if let Some(closest) = within(edge_edge(a0, a1, b0, b1), limit * limit) {
                    self.edge_edges.push(EdgeEdge {
                        nodes,
                        vertices: vertices.map(|v| self.local.number(v, collider)),
                        weight: AREA_FRACTION * (area + collider.edge_areas[edge]),
                        mollifier_threshold: mollifier::threshold(rest_a, b1 - b0),
                        build_distance: closest.distance(),
                    });
                }
            });
        }
    }
}

#[cfg(test)]
#[path = "candidates_test.rs"]
mod tests;
