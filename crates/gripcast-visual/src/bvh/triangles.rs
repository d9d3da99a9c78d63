//! Intersection of a ray with the eight triangles of a leaf.

use glam::Vec3;

use super::lanes::{Lanes, WIDTH};
use super::{EMPTY, Hit};
use crate::camera::Ray;

/// Vertices of up to eight triangles as a structure of arrays; absent triangles are NaN and never
/// hit.
#[derive(Clone, Debug)]
#[repr(C, align(64))]
pub(super) struct Triangles {
    /// `corners[c][axis][lane]`.
    corners: [[[f32; WIDTH]; 3]; 3],
    /// Index of the first triangle in leaf order.
    first: u32,
}

/// A ray sheared so that the largest component of its direction is the z axis.
pub(super) struct Shear<L: Lanes> {
    /// World axes that become x, y, z.
    axes: [usize; 3],
    /// Origin along these axes.
    origin: [f32; 3],
    lanes_origin: [L::F; 3],
    /// Shear of x and y, and scale of z.
    shear: [f32; 3],
    lanes_shear: [L::F; 3],
}

impl<L: Lanes> Shear<L> {
    #[inline(always)]
    pub(super) fn new(lanes: L, ray: &Ray) -> Self {
        let d = ray.direction;
        let size = d.abs();
        let axes = if size.x > size.y && size.x > size.z {
            [1, 2, 0]
        } else if size.y > size.z {
            [2, 0, 1]
        } else {
            [0, 1, 2]
        };
        let [x, y, z] = axes;
        let o = ray.origin.to_array();
        let d = d.to_array();
        let scale = 1.0 / d[z];
        let origin = [o[x], o[y], o[z]];
        let shear = [d[x] * scale, d[y] * scale, scale];
        Self {
            axes,
            origin,
            lanes_origin: splat(lanes, origin),
            shear,
            lanes_shear: splat(lanes, shear),
        }
    }
}

#[inline(always)]
fn splat<L: Lanes>(lanes: L, [x, y, z]: [f32; 3]) -> [L::F; 3] {
    [lanes.splat(x), lanes.splat(y), lanes.splat(z)]
}

/// Result of the test of eight triangles.
struct TriangleTest<L: Lanes> {
    /// Mask of the lanes hit.
    mask: u32,
    t: L::F,
    /// Weights of the second and third vertex, not yet divided by their sum.
    weights: [L::F; 2],
    inverse_sum: L::F,
}

impl Triangles {
    /// At most [`WIDTH`] triangles by their vertices.
    pub(super) fn new(first: u32, faces: impl Iterator<Item = [Vec3; 3]>) -> Self {
        let mut corners = [[[f32::NAN; WIDTH]; 3]; 3];
        for (lane, face) in faces.take(WIDTH).enumerate() {
            for (c, corner) in face.iter().enumerate() {
                for axis in 0..3 {
                    corners[c][axis][lane] = corner[axis];
                }
            }
        }
        Self { corners, first }
    }

    #[inline(always)]
    pub(super) fn intersect<L: Lanes>(&self, lanes: L, ray: &Shear<L>, t_max: f32) -> Option<Hit> {
        let tested = self.test(lanes, ray, t_max);
        let mut mask = tested.mask;
        if mask == 0 {
            return None;
        }
        let t = lanes.store(tested.t);
        let mut nearest = mask.trailing_zeros() as usize & (WIDTH - 1);
        mask &= mask - 1;
        while mask != 0 {
            let lane = mask.trailing_zeros() as usize & (WIDTH - 1);
            mask &= mask - 1;
            if t[lane] < t[nearest] {
                nearest = lane;
            }
        }
        let inverse = lanes.store(tested.inverse_sum)[nearest];
        let [v, w] = tested.weights;
        let weights = [
            lanes.store(v)[nearest] * inverse,
            lanes.store(w)[nearest] * inverse,
        ];
        debug_assert!(self.first != EMPTY);
        Some(Hit {
            t: t[nearest],
            face: self.first + nearest as u32,
            weights,
        })
    }

    #[inline(always)]
    pub(super) fn occluded<L: Lanes>(&self, lanes: L, ray: &Shear<L>) -> bool {
        self.test(lanes, ray, f32::INFINITY).mask != 0
    }

    #[inline(always)]
    fn test<L: Lanes>(&self, lanes: L, ray: &Shear<L>, t_max: f32) -> TriangleTest<L> {
        let zero = lanes.splat(0.0);
        let a = self.sheared(lanes, ray, 0);
        let b = self.sheared(lanes, ray, 1);
        let c = self.sheared(lanes, ray, 2);
        let mut edges = [edge(lanes, c, b), edge(lanes, a, c), edge(lanes, b, a)];
        let on_edge =
            lanes.eq(edges[0], zero) | lanes.eq(edges[1], zero) | lanes.eq(edges[2], zero);
        if on_edge != 0 {
            let [u, v, w] = edges;
            let edges_f32 = [lanes.store(u), lanes.store(v), lanes.store(w)];
            let [u, v, w] = self.exact_edges(on_edge, ray.axes, ray.origin, ray.shear, edges_f32);
            edges = [lanes.load(&u), lanes.load(&v), lanes.load(&w)];
        }
        let [u, v, w] = edges;
        let sum = lanes.add(u, lanes.add(v, w));
        let inverse_sum = lanes.div(lanes.splat(1.0), sum);
        let scaled = lanes.add(
            lanes.mul(u, a[2]),
            lanes.add(lanes.mul(v, b[2]), lanes.mul(w, c[2])),
        );
        let t = lanes.mul(lanes.mul(scaled, ray.lanes_shear[2]), inverse_sum);
        let min_edge = lanes.min(u, lanes.min(v, w));
        let max_edge = lanes.max(u, lanes.max(v, w));
        // NaN lanes fail every comparison, including that of the distance.
        let inside = lanes.le(zero, min_edge) | lanes.le(max_edge, zero);
        let ahead = lanes.lt(zero, t) & lanes.lt(t, lanes.splat(t_max));
        let flat = lanes.eq(sum, zero);
        TriangleTest {
            mask: inside & ahead & !flat,
            t,
            weights: [v, w],
            inverse_sum,
        }
    }

    /// Vertex of each triangle relative to the ray origin, sheared.
    #[inline(always)]
    fn sheared<L: Lanes>(&self, lanes: L, ray: &Shear<L>, corner: usize) -> [L::F; 3] {
        let corner = &self.corners[corner];
        let x = lanes.sub(lanes.load(&corner[ray.axes[0]]), ray.lanes_origin[0]);
        let y = lanes.sub(lanes.load(&corner[ray.axes[1]]), ray.lanes_origin[1]);
        let z = lanes.sub(lanes.load(&corner[ray.axes[2]]), ray.lanes_origin[2]);
        [
            lanes.sub(x, lanes.mul(ray.lanes_shear[0], z)),
            lanes.sub(y, lanes.mul(ray.lanes_shear[1], z)),
            z,
        ]
    }

    /// Edge functions in double precision for rays that hit an edge exactly in single precision:
    /// both triangles at the edge must get the same sign.
    #[cold]
    #[inline(never)]
    fn exact_edges(
        &self,
        mut mask: u32,
        axes: [usize; 3],
        origin: [f32; 3],
        shear: [f32; 3],
        mut edges: [[f32; WIDTH]; 3],
    ) -> [[f32; WIDTH]; 3] {
        while mask != 0 {
            let lane = mask.trailing_zeros() as usize & (WIDTH - 1);
            mask &= mask - 1;
            // The same single-precision coordinates as in the SIMD test.
            let [a, b, c] = [0, 1, 2].map(|corner| {
                let coordinate = |k: usize| self.corners[corner][axes[k]][lane] - origin[k];
                let z = coordinate(2);
                [0, 1].map(|k| f64::from(coordinate(k) - shear[k] * z))
            });
            let edge = |p: [f64; 2], q: [f64; 2]| (p[0] * q[1] - p[1] * q[0]) as f32;
            edges[0][lane] = edge(c, b);
            edges[1][lane] = edge(a, c);
            edges[2][lane] = edge(b, a);
        }
        edges
    }
}

/// Edge function of two sheared vertices: twice the signed area with the ray.
#[inline(always)]
fn edge<L: Lanes>(lanes: L, p: [L::F; 3], q: [L::F; 3]) -> L::F {
    lanes.sub(lanes.mul(p[0], q[1]), lanes.mul(p[1], q[0]))
}
